"""Which parameters are redundant, and least squares with those set to zero   (paper, below eq. 24).

Redundant in principle: a column that others can replace. Redundant in this recording: a column that adds no more than
noise would. The second bound is the stricter one by far and what keeps identified parameters from chasing noise; the
paper's "some simple knowledge on the system's physics" does the same work by hand.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

Array = NDArray[np.float64]
# A column is redundant in principle when the kept ones explain all but this share of it.
SHARE = 1e-3
# … and in this recording when pure noise would add as much once in a thousand times.
CONFIDENCE = 0.999


def independent_columns(
    designs: Sequence[Array], data: Sequence[Array] | None, first: Sequence[int] = (), share: float = SHARE
) -> list[int]:
    """Columns to keep, in the order of a pivoted orthogonalisation; one choice for all places.

    Without data the pivot is the longest remaining column in units of its length (QR with column pivoting). With data
    it is the one that explains most of what is left, until that is no more than noise: Δχ² below the quantile of χ²
    with one degree of freedom per place.

    designs  at every place (rows, p), rows of unit variance;  data  at every place (rows,)
    first    columns kept before all others
    """
    left = [np.array(d, dtype=float) for d in designs]
    goal = None if data is None else [np.array(y, dtype=float) for y in data]
    length = np.array([np.linalg.norm(d, axis=0) for d in designs])
    whole = np.linalg.norm(length, axis=0)
    length[:, whole <= 1e-12 * whole.max(initial=0.0)] = 0.0
    kept: list[int] = []
    coming = list(first)
    while len(kept) < len(whole):
        size = np.array([np.linalg.norm(d, axis=0) for d in left])
        alive = (size > share * length) & (length > 0)
        alive[:, kept] = False
        if coming:
            best = coming.pop(0)
        elif goal is None:
            worth = np.linalg.norm(np.where(alive, size, 0.0), axis=0) / np.where(whole > 0, whole, 1.0)
            best = int(np.argmax(worth))
            if worth[best] <= share:
                break
        else:
            along = np.array([y @ d for y, d in zip(goal, left, strict=True)])
            gain = (np.where(alive, along / np.where(alive, size, 1.0), 0.0) ** 2).sum(axis=0)
            best = int(np.argmax(gain))
            if gain[best] <= chi2.ppf(CONFIDENCE, max(1, int(alive[:, best].sum()))):
                break
        kept.append(best)
        for k in np.flatnonzero(alive[:, best]):
            unit = left[k][:, best] / size[k, best]
            left[k] -= np.outer(unit, unit @ left[k])
            if goal is not None:
                goal[k] -= unit * (unit @ goal[k])
    return kept


def solver(design: Array, kept: Sequence[int], share: float = SHARE) -> Array:
    """(p, rows) operator of the least-squares solution in the kept columns, zero in all others.

    Where kept columns depend on each other at this very place, the smallest solution in scaled columns is taken.
    """
    out = np.zeros(design.T.shape)
    if len(kept):
        chosen = design[:, list(kept)]
        size = np.linalg.norm(chosen, axis=0)
        size[size == 0.0] = 1.0
        out[list(kept)] = np.linalg.pinv(chosen / size, rcond=share) / size[:, None]
    return out
