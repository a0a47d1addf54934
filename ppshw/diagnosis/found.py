"""What was found, laid into the workspace with what else it may be like."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.evidence import HANDICAP, LEAST_FURTHER, Name, Tried
from ppshw.diagnosis.forms import near_forms
from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.workspace import Workspace
from ppshw.terms import Situation
from ppshw.terms.shapes import Column
from ppshw.terms.shapes.context import compliances

Array = NDArray[np.float64]
PRIOR_SD = 3.0  # of a coefficient once taken up, in `Workspace.unit`s; of more than FEW the less
FEW = 6  # columns
STILL = 1e-11  # [m] what moves the reflectors by less per unit does not move them: a link of no length that grows
LOST_MOTION = ("backlash", "friction_hysteresis")
TAKEN_UP = frozenset({"approach", "slipping", "winding"})  # at once, or over some way since a joint turned back
NEAR_SD = 1.0  # of all near forms together, in units of the main form's size


@dataclass
class Found:
    """best: the candidate that stands for the name; weights of all names; p family-wise when it was found;
    size: rms of its form at the reflectors [m], 0 before it was fitted; near: columns of near forms, with `more` of
    what its own left over; first: evidence when it was found; at: where its columns begin in the workspace;
    carried: whether a calibration is to have it; was: the candidate that stood for a name that was given up;
    spread: standard deviations of its nonlinear parameters; pulled: what these make of its coefficients, as in
    `parameters.pulled_along`; read: whether the force sensor's readings say so, whatever deflections do; also: what
    else it may as well do, in words."""

    best: int
    name: Name
    p: float
    evidence: float
    weights: dict[Name, float] = field(default_factory=dict)
    size: float = 0.0
    near: tuple[Column, ...] = ()
    more: tuple[Column, ...] = ()
    first: float = 0.0
    at: int = 0
    carried: bool = True
    was: int | None = None
    spread: dict[str, float] = field(default_factory=dict)
    pulled: Array | None = field(default=None, compare=False)
    read: bool = False
    also: tuple[str, ...] = ()

    def columns(self, candidate: Candidate) -> slice:
        """Where its columns are in the workspace, near forms among them; candidate: its best."""
        return slice(self.at, self.at + len(candidate.columns) + len(self.near))


def pieces_of(f: Found, found: Sequence[Found]) -> list[Found]:
    """The other findings of its name, one effect with it; of what has no name none."""
    return [g for g in found if g is not f and g.name == f.name and f.name[0] != "nameless"]


def is_both(f: Found, g: Found) -> bool:
    """Whether one is the play and the other the friction of one joint."""
    return f.name[1] == g.name[1] and {f.name[0], g.name[0]} == set(LOST_MOTION)


def take_up(space: Workspace, tried: Tried, found: list[Found], and_look: bool = True) -> None:
    """The workspace with exactly these findings, and with what else each of them may be like.

    and_look  candidates are to be looked at beside them; False, which is quick, for what they explain together
    """
    for f in found:
        if f.size == 0.0:
            _measure(space, tried, f, [g for g in found if g is not f])
    _lay(space, tried, found)
    if and_look:
        tried.update([c.key for f in found for c in (*tried.candidates[f.best].columns, *f.near)])


def _measure(space: Workspace, tried: Tried, f: Found, others: list[Found]) -> None:
    """The size of a finding's own form, alone beside the others; its near forms scale with it. Of one joint's play and
    friction neither has the other's among them."""
    candidate = tried.candidates[f.best]
    f.near = ()
    _lay(space, tried, [*(g for g in others if g.size > 0.0), f])
    f.size = coefficients(space, candidate, f)[2]
    near = (*near_forms(space.context, candidate, tried.without), *f.more)
    if any(is_both(f, g) for g in others):
        along = candidate.columns[0].component
        near = tuple(c for c in near if c.function not in TAKEN_UP or c.component != along)
    near = tuple({c.key: c for c in near}.values())
    f.near = tuple(c for c, (moved, *_) in zip(near, tried.values(near), strict=True) if space.rms(moved) > STILL)


def _lay(space: Workspace, tried: Tried, found: list[Found]) -> None:
    if not found:
        space.forget()
        return
    laid: list[tuple[Array, Array, Array]] = []
    prior: list[float] = []
    for f in found:
        f.at = len(laid)
        candidate = tried.candidates[f.best]
        laid += tried.values(candidate.columns)
        many = min(1.0, FEW / len(candidate.columns))
        spread = many * PRIOR_SD * tried.unit / tried.scale[tried.index[f.best]]
        prior += (np.minimum(spread, 1.0) if f.read else spread).tolist()  # what is read too much is no more than that
        near = tried.values(f.near)
        laid += near
        for column, (moved, *_) in zip(f.near, near, strict=True):
            # what wanders does so with half the amplitude at twice the pace, like a random walk
            pace = float(column.args["tau"]) if "cosine" in (column.args.get("form"), column.args.get("time")) else 1.0
            prior.append(NEAR_SD * f.size / np.sqrt(len(f.near)) / pace / max(space.rms(moved), 1e-30))
    raw, white, absorbed = zip(*laid, strict=True)
    space.take_up(np.stack(raw, axis=-1), np.maximum(prior, 1e-30), (np.stack(white).T, np.stack(absorbed).T))


def explained(space: Workspace, tried: Tried, found: list[Found]) -> float:
    """Log evidence of all findings together, as taken up, less what each has to bring and what counts against those
    without a name."""
    cost = sum(LEAST_FURTHER - float(tried.log_share[f.best]) for f in found)
    return space.log_evidence() - cost - against_riddles(found)


def against_riddles(found: list[Found]) -> float:
    """What counts against findings without a name: their functions bend as they need."""
    return sum((1 / HANDICAP - 1) * f.first for f in found if f.name[0] == "nameless")


def coefficients(space: Workspace, candidate: Candidate, found: Found) -> tuple[Array, Array, float]:
    """Coefficients (k,) of the finding's own form, their covariance (k, k), and the rms of all its forms [m]."""
    _, values = space.coefficients()
    main, every = slice(found.at, found.at + len(candidate.columns)), found.columns(candidate)
    return values[main], np.asarray(space.middle[main, main]), space.rms(space.taken[:, :, every] @ values[every])


def moved_by(space: Workspace, candidate: Candidate, found: Found) -> Array:
    """(N, 3T) what all forms of a finding do to every visit [m], base axes."""
    every = found.columns(candidate)
    return np.asarray(space.taken[:, :, every] @ space.coefficients()[1][every])


def size_beyond(space: Workspace, candidate: Candidate, found: Found) -> float:
    """Rms [m] of all forms of a finding beyond what the base model would take of them."""
    return space.rms(space.beyond(moved_by(space, candidate, found)))


def by_its_own_form(space: Workspace, candidate: Candidate, found: Found) -> tuple[Array, Array]:
    """Coefficients (k,) of the finding's own form and their covariance (k, k), as if it had no near forms: what a gap
    or a jump is. Beside near forms, which can be the same or its opposite, they say little. A wave's harmonics are not
    like it, and would be laid on it in part (four of thirteen amplitudes off by 2.5 to 5 standard deviations)."""
    if candidate.columns[0].function == "body_weight":
        space = _as_stiff_beside(space, candidate, found)
    keep = np.ones(len(space.taken_prior), dtype=bool)
    keep[found.columns(candidate)] = False
    keep[found.at : found.at + len(candidate.columns)] = True
    for at, column in enumerate(found.near, found.at + len(candidate.columns)):
        keep[at] = _is_harmonic(column, candidate.columns[0])
    return coefficients(space.keeping(keep), candidate, replace(found, near=()))[:2]


def _is_harmonic(column: Column, of: Column) -> bool:
    waves = column.function == of.function == "wave"
    return waves and bool(column.args["period"] != of.args["period"])


def _as_stiff_beside(space: Workspace, candidate: Candidate, found: Found) -> Workspace:
    """The workspace with a finding's own columns laid by the compliances that are fitted beside it: those of the base
    fit have part of a weight that the file leaves out, which was too small by them (−0.47 ± 0.01 of −0.495 kg m)."""
    theta = np.zeros(len(space.active))
    theta[space.active] = space.coefficients()[0]
    stiff = compliances(space.base.model, theta, Situation.of(space.recording))
    beside, taken = replace(space.context, compliance=stiff), space.taken.copy()
    for at, column in enumerate(candidate.columns, found.at):
        taken[:, :, at] = column.evaluate(beside)
    again = copy(space)
    again.take_up(taken, space.taken_prior)
    return again


def modelled(space: Workspace, candidate: Candidate, found: Found) -> tuple[tuple[Column, ...], Array, Array]:
    """All columns of a finding, near forms among them, with values (k,) and their covariance (k, k)."""
    _, values = space.coefficients()
    here = found.columns(candidate)
    return (*candidate.columns, *found.near), values[here], np.asarray(space.middle[here, here])
