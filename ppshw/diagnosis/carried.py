"""What of the findings a calibration carries, and how much better visits are predicted that no fit saw.

Named findings always. Structure without a name as a Gaussian process, where that makes the held-out visits better and
where it is no matter of time, which does not come again; so too what a named finding's form leaves over a column. What
goes on with time alone is carried as it was, beyond its end as `clock` says, where that makes held-out visits better.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.found import Found
from ppshw.diagnosis.gaussian_process import Correction, in_words, learn
from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.library.sampled import called
from ppshw.diagnosis.wording import column_of, history_of, listed
from ppshw.diagnosis.workspace import Workspace, folds
from ppshw.identification.plausible import wrench_never_changes
from ppshw.recording import Recording
from ppshw.terms import COMPONENTS
from ppshw.terms.shapes import Column, Context
from ppshw.terms.shapes.covariates import columns_at

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
LIKE_TIME = 0.95  # rank correlation with the order of visits
COMES_AGAIN = ("pause", "since_load_change")
NAMELESS_GAIN = 0.99  # held-out rms with a correction that has no name must be less than this times the rms without


@dataclass(frozen=True)
class Carried:
    """before, after: rms [mm] of held-out readings by the base model as `identify` has it, and with all carried;
    found: every finding with its form, corrections among them; corrections: those, in the answer's words"""

    before: float
    after: float
    found: list[tuple[Found, Candidate]]
    corrections: list[dict[str, Any]]


@dataclass(frozen=True)
class _Left:
    """Structure over columns that no name explains: whose finding; instead (K,): columns that a correction replaces."""

    of: Found
    names: tuple[str, ...]
    instead: Mask


def carry(space: Workspace, tried: Tried, found: list[Found]) -> Carried:
    """Learn a correction for whatever has no name, and keep it where it earns its place.

    space  has all findings taken up; left with what is carried in place of what it replaces
    """
    taken, prior = space.taken, space.taken_prior
    kept = np.zeros(taken.shape[2], dtype=bool)  # columns that a calibration carries
    for f in found:
        f.carried = tried.candidates[f.best].effect != "nameless"
        kept[f.columns(tried.candidates[f.best])] = f.carried
    before = held_out(space.as_estimated(), taken[:, :, :0], prior[:0])
    after = held_out(space, taken[:, :, kept], prior[kept]) if found else before
    for f in found:
        if f.carried or tried.candidates[f.best].covariates != ("time",) or nobody_knows_loads(space.recording):
            continue
        mine = kept.copy()
        mine[f.columns(tried.candidates[f.best])] = True
        if (better := held_out(space, taken[:, :, mine], prior[mine])) < NAMELESS_GAIN * after:
            f.carried, kept, after = True, mine, better
    beside = np.ones(taken.shape[2], dtype=bool)  # columns that stay in the fit
    corrections: list[tuple[_Left, Correction]] = []
    more = np.zeros((*taken.shape[:2], 0))
    for left in _left_over(tried, found):
        others = beside & ~left.instead
        space.take_up(*_with(taken[:, :, others], prior[others], more))
        correction = learn(space, left.names, tried.unit)
        if correction is None:
            continue
        columns = np.stack([c.evaluate(space.context) for c in correction.columns()], axis=2)
        now = np.concatenate([more, columns], axis=2)
        mine = kept & ~left.instead
        better = held_out(space, *_with(taken[:, :, mine], prior[mine], now))
        if better < NAMELESS_GAIN * after:
            after, beside, kept, more = better, others, mine, now
            corrections.append((left, correction))
    space.take_up(*_with(taken[:, :, beside], prior[beside], more))
    as_it_was = [f for f in found if f.carried and tried.candidates[f.best].effect == "nameless"]
    words = [_held_words(space, tried.candidates[f.best], f) for f in as_it_was]
    words += [_words(space, left, correction) for left, correction in corrections]
    some = kept.any() or corrections
    return Carried(before, after if some else before, _placed(tried, found, beside, corrections), words)


def _with(columns: Array, prior: Array, more: Array) -> tuple[Array, Array]:
    """Further columns whose coefficients are N(0, 1) before any data."""
    return np.concatenate([columns, more], axis=2), np.concatenate([prior, np.ones(more.shape[2])])


def _left_over(tried: Tried, found: list[Found]) -> list[_Left]:
    """Nameless findings, and what has no name beside the form of a named one; nothing that is a matter of time."""
    size = max((f.columns(tried.candidates[f.best]).stop for f in found), default=0)
    out: dict[tuple[str, ...], _Left] = {}

    def add(f: Found, names: tuple[str, ...], which: slice | int) -> None:
        left = out.setdefault(names, _Left(f, names, np.zeros(size, dtype=bool)))
        left.instead[which] = True

    for f in sorted(found, key=lambda f: f.name[0] != "nameless"):  # a finding of its own before another's shadow
        candidate = tried.candidates[f.best]
        if candidate.effect == "nameless":
            if not candidate.covariates:
                continue  # nothing to be a function of
            add(f, candidate.covariates, f.columns(tried.candidates[f.best]))
            continue
        for k, column in enumerate(f.near, start=f.at + len(candidate.columns)):
            if names := _smooth_over(column):
                add(f, names, k)
    return [left for left in out.values() if not a_matter_of_time(tried.space.context, left.names)]


def nobody_knows_loads(recording: Recording) -> bool:
    """Whether neither labels nor a force sensor say which load it was: what changed with it looks like a matter of
    time then, and blocks between its visits are predicted better by what the next ones are not."""
    return wrench_never_changes(recording) and not any(recording.load)


def a_matter_of_time(c: Context, names: tuple[str, ...]) -> bool:
    """Whether one of the columns is the time, or rises or falls with it so steadily that nothing tells them apart. A
    pause or the age of a load comes again."""
    for name in names:
        if column_of(name)[0] == "time" and name not in COMES_AGAIN:
            return True
        values = columns_at(c, (name,))[:, 0]
        if np.ptp(values) > 0 and abs(spearmanr(values, np.arange(len(values))).statistic) > LIKE_TIME:
            return True
    return False


def _smooth_over(column: Column) -> tuple[str, ...]:
    """The columns that a nameless function is one of; empty for any other."""
    keys = {"covariate": ("name",), "covariate_pair": ("first", "second")}.get(column.function, ())
    return tuple(str(column.args[k]) for k in keys)


def _placed(
    tried: Tried, found: list[Found], beside: Mask, corrections: list[tuple[_Left, Correction]]
) -> list[tuple[Found, Candidate]]:
    """Every finding with its form, `at` where its columns now are in the workspace; corrections come last. One may
    stand for several findings over the same columns."""
    out: list[tuple[Found, Candidate]] = []
    forms = [(f, tried.candidates[f.best]) for f in found]
    replaced = {id(f) for f, k in forms if k.effect == "nameless" and not beside[f.columns(k)].any()}
    for f, candidate in forms:
        start = f.at + len(candidate.columns)
        f.near = tuple(c for k, c in enumerate(f.near, start) if beside[k])
        f.at = int(beside[: f.at].sum())
        if id(f) not in replaced:
            out.append((f, candidate))
    at = int(beside.sum())
    for left, correction in corrections:
        columns = correction.columns()
        f = left.of
        if id(f) not in replaced:  # beside a named finding
            f = Found(f.best, ("nameless", None), f.p, correction.evidence, {("nameless", None): 1.0})
        f.near, f.at, f.carried = (), at, True
        out.append((f, _candidate(tried, left, correction, columns)))
        at += len(columns)
    return out


def _candidate(tried: Tried, left: _Left, correction: Correction, columns: tuple[Column, ...]) -> Candidate:
    own = COMPONENTS[correction.components[0]] if len(correction.components) == 1 else None
    frame = tried.space.machine.frame_names[correction.frame]
    return Candidate("nameless", None, frame, own, " × ".join(left.names), columns, covariates=left.names)


def _words(space: Workspace, left: _Left, correction: Correction) -> dict[str, Any]:
    """A correction in the answer's words; lengths in the columns' own units, sizes in metres or radians."""
    said = [column_of(name) for name in left.names]
    length = correction.region.length * correction.region.spread
    return {
        "effect": "unexplained",
        "covariates": [column for column, _ in said],
        "history": history_of(said),
        "frame": space.machine.frame_names[correction.frame],
        "components": [COMPONENTS[c] for c in correction.components],
        "length": dict(zip(left.names, length.tolist(), strict=True)),
        "std": correction.amplitude.tolist(),
        "region": {n: [float(a), float(b)] for n, a, b in
                   zip(left.names, correction.region.low, correction.region.high, strict=True)},
        "log_evidence": correction.evidence,
        "sentence": f"what depends on {listed(said)} is carried without a name, as "
        f"{in_words(correction.columns(), space.machine)}.",
    }  # fmt: skip


def _held_words(space: Workspace, candidate: Candidate, f: Found) -> dict[str, Any]:
    """What goes on with time alone, in the answer's words."""
    hours = space.context.hours
    moved = sorted({called(space.context, c.frame, c.component) for c in candidate.columns if c.on == "frame"})
    return {
        "effect": "unexplained",
        "covariates": ["time"],
        "history": None,
        "frame": candidate.frame,
        "components": moved,
        "length": {},
        "std": [],
        "region": {"time": [float(hours[0]), float(hours[-1])]},
        "log_evidence": f.evidence,
        "sentence": f"what depends on time and moves {candidate.frame} {', '.join(moved)} is carried without a name, "
        "as it was, and held where it was at the end; waves fade from there on, those of one period are left out.",
    }  # fmt: skip


def held_out(space: Workspace, columns: Array, prior: Array) -> float:
    """rms of readings [mm] of visits the fit never saw (blocks in time, in turn), with these columns (N, 3T, k) and
    their prior standard deviations (k,) taken up."""
    out = np.full(space.data.shape, np.nan)
    for held in folds(len(space.recording)):
        part = space.with_fit(space.fit & ~held)
        part.take_up(columns, prior)
        out[held] = part.residual()[held]
    out[~space.fit] = np.nan  # gross errors are no test of a model
    square = np.nansum(out.reshape(-1, 3) ** 2, axis=1)
    square = square[np.isfinite(out.reshape(-1, 3)).all(axis=1)]
    return float(np.sqrt(square.mean()) * 1e3)
