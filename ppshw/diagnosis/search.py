"""Which effects are there: taken up one by one while anything stands out from noise, then each name put to the question
again beside the others."""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from ppshw.diagnosis.evidence import Name, Tried, corrected_residual, p_value
from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.workspace import Workspace

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
# What counts as significant, family-wise: the first finding, and any beside it (what a form leaves unexplained of a
# large effect must not become a second one).
FIRST, FURTHER = 0.03, 0.01
MOST_FINDINGS = 5
# No finding without real odds, however quiet the null: e³ = 20 to 1 against nothing, e⁵ beside another finding.
LEAST_FIRST, LEAST_FURTHER = 3.0, 5.0
# Weights of names are tempered: forms of real machines differ from the library's, so evidence overstates.
# Beside a large effect a small one is more likely what the large one's form leaves of it than another effect.
LEAST_SIZE, SAME_EFFECT = 0.4, 0.5
TEMPER = 0.6
PRIOR_SD = 3.0  # of a coefficient once taken up, in units of the repeatability


@dataclass
class Found:
    """best: the candidate that stands for the name; weights of all names; p family-wise when it was found."""

    best: int
    name: Name
    p: float
    evidence: float
    weights: dict[Name, float] = field(default_factory=dict)


def search(space: Workspace, tried: Tried, rng: np.random.Generator, progress: Progress | None = None) -> list[Found]:
    """Findings in the order of their strength; the workspace has their columns taken up at its end."""
    found: list[Found] = []
    for turn in range(MOST_FINDINGS):
        if progress:
            progress(turn, MOST_FINDINGS + 1)
        best, evidence = _best(tried, {f.name[0] for f in found})
        if evidence < (LEAST_FURTHER if found else LEAST_FIRST):
            break
        p = p_value(evidence, tried.null(corrected_residual(space), rng))
        if p > (FURTHER if found else FIRST):
            break
        before = [replace(f) for f in found]
        found.append(Found(best, _name(tried, best), p, evidence))
        take_up(space, tried, found)
        _reconsider(space, tried, found)
        sizes = [coefficients(space, tried.candidates[f.best])[2] for f in found]
        if sizes[-1] < LEAST_SIZE * max(sizes) and found[-1].name[0] not in [f.name[0] for f in before]:
            found = before
            take_up(space, tried, found)
            break
    _weigh(space, tried, found)
    return found


def _name(tried: Tried, candidate: int) -> Name:
    return tried.names[int(tried.name_of[candidate])]


def _best(tried: Tried, known: Set[str] = frozenset()) -> tuple[int, float]:
    """The best candidate of the best name, and the name's evidence.

    known  effects found already: what a form left of them goes to the same effect, if that explains most of it
    """
    evidence, names = _names(tried)
    chosen = int(np.argmax(names))
    for j in np.argsort(-names):
        if tried.names[j][0] in known and names[j] > SAME_EFFECT * names[chosen]:
            chosen = int(j)
            break
    inside = tried.name_of == chosen
    return int(np.argmax(np.where(inside, evidence + tried.log_share, -np.inf))), float(names[chosen])


def _names(tried: Tried) -> tuple[Array, Array]:
    """Log evidence of all candidates (C,) and of all names."""
    evidence = tried.evidence(tried.scores()[None])
    return evidence[0], tried.by_name(evidence)[0]


def columns_of(space: Workspace, candidate: Candidate) -> Array:
    """(N, 3T, k) of a candidate, at its own units."""
    return np.stack([c.evaluate(space.context) for c in candidate.columns], axis=2)


def coefficients(space: Workspace, candidate: Candidate) -> tuple[Array, Array, float]:
    """Coefficients of the candidate as taken up, their standard deviations, and its rms at the reflectors [m]."""
    columns = columns_of(space, candidate)
    _, all_values = space.coefficients()
    at = _where(space.taken, columns)
    k = columns.shape[2]
    values = all_values[at : at + k]
    std = np.sqrt(np.maximum(np.diag(space.middle)[at : at + k], 0.0))
    readings = max(int(space.recording.seen.sum()), 1)
    rms = float(np.sqrt(((columns @ values) ** 2).sum() / readings))
    return values, std, rms


def _where(taken: Array, columns: Array) -> int:
    for at in range(taken.shape[2] - columns.shape[2] + 1):
        if np.array_equal(taken[:, :, at : at + columns.shape[2]], columns):
            return at
    raise AssertionError("a finding's columns are not in the workspace")


def take_up(space: Workspace, tried: Tried, found: list[Found]) -> None:
    """The workspace with exactly these findings."""
    if not found:
        space.forget()
    else:
        columns = [columns_of(space, tried.candidates[f.best]) for f in found]
        scales = [tried.scale[tried.index[f.best]] for f in found]
        space.take_up(np.concatenate(columns, axis=2), PRIOR_SD * tried.repeatability / np.concatenate(scales))
    tried.update()


def _reconsider(space: Workspace, tried: Tried, found: list[Found]) -> None:
    """Each earlier finding once more, given the others: a better form or name may take its place."""
    if len(found) < 2:
        return
    for f in found:
        take_up(space, tried, [g for g in found if g is not f])
        f.best, f.evidence = _best(tried)
        f.name = _name(tried, f.best)
    take_up(space, tried, found)


def _weigh(space: Workspace, tried: Tried, found: list[Found]) -> None:
    """Posterior weights of the names for every finding, given the others."""
    for f in found:
        take_up(space, tried, [g for g in found if g is not f])
        tempered = TEMPER * _names(tried)[1]
        weights = np.exp(tempered - logsumexp(tempered))
        f.weights = {tried.names[j]: float(weights[j]) for j in np.argsort(-weights)[:6]}
    take_up(space, tried, found)
