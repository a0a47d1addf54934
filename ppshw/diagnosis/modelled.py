"""What was found joins the calibration: the base model's parameters refitted beside the effects, and the effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.calibration import Calibration
from ppshw.diagnosis.carried import a_matter_of_time
from ppshw.diagnosis.found import Found, coefficients, modelled
from ppshw.diagnosis.gaussian_process import in_words
from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.parameters import is_of
from ppshw.diagnosis.wording import sentence
from ppshw.diagnosis.workspace import Workspace
from ppshw.terms import Situation
from ppshw.terms.effect import UNNAMED, Effect
from ppshw.terms.shapes import Column, Context
from ppshw.terms.shapes.carried import region_of

Array = NDArray[np.float64]
ROUNDS, STILL_M = 6, 1e-7  # of a fit about itself, until nothing moves any more [m]
DIGITS = 7  # of correlations in a file: of thirty near forms nearly the same, what they do together is one part in 1e4


Pair = tuple[Found, Candidate]


def extended(space: Workspace, found: list[Pair], findings: Sequence[Mapping[str, Any]] = ()) -> Calibration:
    """The calibration with every finding modelled.

    findings  as the diagnosis answered them: an effect that is one of them has its sentence, which is of the library's
              form alone, where the values here are refitted beside its near forms (0.250 mm there, 0.246 here)

    Structure without a name is marked as such: a Gaussian process over the columns that it depends on. Beside it the
    base model and the named effects have other values than without it; these belong to it. Where the recording saw
    nothing of its columns a prediction has neither, and is what it would be without the correction.
    """
    corrections = [p for p in found if p[0].carried and _is_correction(p[1])]
    whole = _fitted_without(space, [p for p in found if _left_out(space, p)])
    alone = _fitted_without(space, [p for p in found if _left_out(space, p) or p in corrections])
    effects = []
    answered = list(findings)  # not yet said of one of them
    for f, candidate in found:
        if not f.carried:
            continue
        name = UNNAMED if candidate.effect == "nameless" else candidate.effect
        corrects = _is_correction(candidate)
        columns, values, covariance = modelled(whole if corrects else alone, candidate, f)
        own, _, rms = coefficients(whole if corrects else alone, candidate, f)
        if (mine := next((each for each in answered if is_of(each, candidate)), None)) is not None:
            answered.remove(mine)
        said = mine["sentence"] if mine is not None else sentence(space.context, candidate, own, rms)
        if corrects:
            said += f" It is carried without a name, as {in_words(columns, space.machine)}."
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        correlation = np.round(covariance / np.maximum(np.outer(std, std), 1e-300), DIGITS).tolist()
        # a Gaussian process keeps what is unsure of it with its own columns
        rows = () if corrects or len(std) == 1 else tuple(tuple(row) for row in correlation)
        of_each = np.zeros((0, 0)) if corrects else _of_each(space, f.columns(candidate))
        values_and_std = tuple(values.tolist()), tuple(std.tolist())
        effects.append(Effect(name, candidate.joint, columns, *values_and_std, said, rows, of_each))
    if corrections:
        effects = _joined(effects, _instead(whole, alone, [p for p in found if p[0].carried], corrections))
    recording = space.recording.subset(space.fit)
    theta = _theta(alone, [p for p in found if not p[0].carried and not _left_out(space, p)])
    theta += _beyond_a_straight_line(alone)
    calibration = Calibration.of(replace(space.base, theta=theta), recording, "joint")
    if mended := [f["sentence"].rstrip(".") for f in findings if f["effect"] == "column_mistake"]:
        calibration.provenance["columns_set_right"] = mended
    visits = space.recording if effects else None
    laid = space.base.theta if effects else None
    reference = _asked_for(space.context, effects)
    return replace(calibration, effects=tuple(effects), reference=reference, visits=visits, laid=laid)


class _Asked(dict[str, float]):
    """Figures of a recording, and which of them anybody asked for."""

    def __init__(self, known: Mapping[str, float]) -> None:
        super().__init__(known)
        self.names = {"start", "hours"}

    def setdefault(self, name: str, value: float = 0.0) -> float:
        self.names.add(name)
        return super().setdefault(name, value)


def _asked_for(c: Context, effects: Sequence[Effect]) -> dict[str, float]:
    """What a context froze, as far as these effects go by it: a few of some thousand figures for all that was tried."""
    reference = _Asked(c.reference)
    again = replace(c, reference=reference)
    for column in (column for effect in effects for column in effect.columns):
        column.value(again)
    return {name: value for name, value in reference.items() if name in reference.names}


def _is_correction(candidate: Candidate) -> bool:
    return candidate.columns[0].function == "unexplained"


def _left_out(space: Workspace, pair: Pair) -> bool:
    """What a calibration does not have must not be fitted, or its share would be missing from predictions. What goes
    with time stays in the fit, so that no named effect takes it; the base model has its share of it (`_theta`)."""
    f, candidate = pair
    return not f.carried and not a_matter_of_time(space.context, candidate.covariates)


def _fitted_without(space: Workspace, left_out: list[Pair]) -> Workspace:
    taken = space.taken.copy()
    for f, candidate in left_out:
        taken[:, :, f.columns(candidate)] = 0.0
    space = copy(space)
    space.take_up(taken, space.taken_prior)
    return space


def _theta(space: Workspace, gone: Sequence[Pair] = ()) -> Array:
    """(p,) of the base model; of what is in the fit and will not come again it has what it can be like: what went on
    with time was somewhere on average, and so will the machine be."""
    theta, (base, values) = np.zeros(len(space.active)), space.coefficients()
    for f, candidate in gone:
        mine = f.columns(candidate)
        base = base + space.mimicked(space.taken[:, :, mine] @ values[mine])
    theta[space.active] = base
    return theta


def _beyond_a_straight_line(space: Workspace) -> Array:
    """(p,) by how much the base model's parameters change beside what was taken up when they are fitted about
    themselves and not about the base fit: compliances that change beside creep of 1.4 mm, of a crane that gives way by
    45, left 0.5 mm on its own recording otherwise."""
    active, rows, model = space.active, np.repeat(space.recording.seen, 3, axis=1), space.base.model
    situation, about = Situation.of(space.recording), space.base.theta
    before = model.predict(situation, about)
    gap = space.data - space.design @ about[active] - space.moved()  # measured - predicted, less what was taken up
    theta = (first := _theta(space)).copy()
    for _ in range(ROUNDS):
        lin = model.linearise(situation, theta)
        left = np.where(rows, gap - (lin.positions - before).reshape(gap.shape), 0.0)
        design = lin.design.reshape(*gap.shape, -1)[:, :, active] * rows[..., None]
        white = space.whiten(design)
        precision = white.T @ white + np.diag(1.0 / space.prior**2)
        step = np.linalg.solve(
            precision, white.T @ space.whiten(left[..., None])[:, 0] - theta[active] / space.prior**2
        )
        theta[active] += step
        if np.abs(design @ step).max() < STILL_M:
            break
    return theta - first


def _of_each(space: Workspace, columns: slice) -> Array:
    """(k, p) what the base model would take of each of these columns."""
    out = np.zeros((columns.stop - columns.start, len(space.active)))
    for row, k in zip(out, range(columns.start, columns.stop), strict=True):
        row[space.active] = space.mimicked(space.taken[:, :, k])
    return out


def _instead(
    whole: Workspace, alone: Workspace, carried: list[Pair], corrections: list[Pair]
) -> list[tuple[Column, float]]:
    """Columns with coefficients: what everything else is different by where the corrections are used."""
    args = [c.columns[0].args for _, c in corrections]
    regions = [region_of(a).as_dict() for a in args]
    change = _theta(whole) - _theta(alone)
    out: list[tuple[Column, float]] = [(Column("frames", "model_shift", {"theta": change.tolist()}), 1.0)]
    if whole.base.model.target_offset is not None:
        for k, value in enumerate(change[-whole.machine.target_array.size :]):
            out.append((Column("points", "target_shift", {"target": k // 3, "axis": k % 3}), float(value)))
    for f, candidate in carried:
        if not _is_correction(candidate):
            columns, values, _ = modelled(whole, candidate, f)
            differs = values - modelled(alone, candidate, f)[1]
            out += list(zip(columns, differs.tolist(), strict=True))
    return [
        (Column(c.on, "instead", {"column": c.as_dict(), "regions": regions}, c.frame, c.component), value)
        for c, value in out
    ]


def _joined(effects: list[Effect], instead: list[tuple[Column, float]]) -> list[Effect]:
    """Each correction is used only where all of them have data; the first carries what is different there."""
    out = []
    everywhere = {
        id(e): region_of(e.columns[0].args).as_dict() for e in effects if e.columns[0].function == "unexplained"
    }
    for e in effects:
        if id(e) in everywhere:
            others = [r for key, r in everywhere.items() if key != id(e)]
            columns = tuple(replace(c, args={**c.args, "others": others}) for c in e.columns)
            values, std = e.values + tuple(v for _, v in instead), e.std + (0.0,) * len(instead)
            out.append(replace(e, columns=(*columns, *(c for c, _ in instead)), values=values, std=std))
            instead = []
        else:
            out.append(e)
    return out
