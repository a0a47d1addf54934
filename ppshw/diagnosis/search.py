"""Which effects are there: taken up one by one while anything stands out from noise, then each name put to the question
again beside the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

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
        best, evidence = _best(tried)
        if evidence.max() < (LEAST_FURTHER if found else LEAST_FIRST):
            break
        p = p_value(evidence.max(), tried.null(corrected_residual(space), rng))
        if p > (FURTHER if found else FIRST):
            break
        found.append(Found(best, _name(tried, best), p, float(evidence.max())))
        take_up(space, tried, found)
        _reconsider(space, tried, found)
    _weigh(space, tried, found)
    return found


def _name(tried: Tried, candidate: int) -> Name:
    return tried.names[int(tried.name_of[candidate])]


def _best(tried: Tried) -> tuple[int, Array]:
    """The best candidate of the best name, and the evidence of all names."""
    evidence = tried.evidence(tried.scores()[None])
    names = tried.by_name(evidence)[0]
    inside = tried.name_of == int(np.argmax(names))
    return int(np.argmax(np.where(inside, evidence[0] + tried.log_share, -np.inf))), names


def columns_of(space: Workspace, candidate: Candidate) -> Array:
    """(N, 3T, k) of a candidate, at its own units."""
    return np.stack([c.evaluate(space.context) for c in candidate.columns], axis=2)


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
        best, evidence = _best(tried)
        f.best, f.name, f.evidence = best, _name(tried, best), float(evidence.max())
    take_up(space, tried, found)


def _weigh(space: Workspace, tried: Tried, found: list[Found]) -> None:
    """Posterior weights of the names for every finding, given the others."""
    for f in found:
        take_up(space, tried, [g for g in found if g is not f])
        _, evidence = _best(tried)
        tempered = TEMPER * evidence
        weights = np.exp(tempered - logsumexp(tempered))
        f.weights = {tried.names[j]: float(weights[j]) for j in np.argsort(-weights)[:6]}
    take_up(space, tried, found)
