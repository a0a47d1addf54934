"""When a joint's zero may have jumped more than once: of all sets of moments those that the recording speaks for most.

There are too many sets to try them all; moments are added one by one to where most is explained, and each is then moved
while the others stay (forward selection with replacement; Miller 2002, Subset Selection in Regression). What a set
found so is worth counts all the sets it was chosen from: `library` gives it their share.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.laid import Laid
from ppshw.diagnosis.library import ORDINALS, Stairs, moving_joints, shift_of_zero, visits_between
from ppshw.diagnosis.workspace import Workspace
from ppshw.terms.shapes import Context

Array = NDArray[np.float64]
MOST_JUMPS = len(ORDINALS)
MOSTLY = 0.7  # of all moments
AGAIN = 3  # times that all moments of a set are moved
APART = 5  # visits between two jumps at least: what is back after one or two was a wrong visit, and no zero


def stairs(space: Workspace) -> list[Stairs]:
    """For every joint that moves, the best two, three and four moments [h] of jumps of its zero, apart from those at
    which the load was changed."""
    c = space.context
    moments, joints = _not_with_the_load(c, visits_between(c)), list(moving_joints(c))
    if not moments or not joints:
        return []
    laid = Laid(space, [shift_of_zero(c, k, t) for k, _ in joints for t in moments])
    scores = laid.product(space.absorb(space.y[:, None]))[:, 0].reshape(len(joints), -1)
    of_joint = np.arange(scores.size).reshape(scores.shape)
    found = []
    for (_, name), said, columns in zip(joints, scores, of_joint, strict=True):
        sets = _best_sets(said, laid.information(columns[None])[0])
        found += [(name, tuple(moments[j] for j in sorted(chosen))) for chosen in sets]
    return found


def _not_with_the_load(c: Context, moments: Sequence[float]) -> list[float]:
    """Those at which the load stays: what changes whenever the load does is no matter of time. All, where loads are
    changed so often that most are such."""
    after = np.searchsorted(c.hours, moments)
    load = np.asarray(c.recording.load)
    stays = load[after] == load[after - 1]
    return [t for t, kept in zip(moments, stays, strict=True) if kept or stays.mean() < MOSTLY]


def _best_sets(scores: Array, information: Array) -> list[list[int]]:
    """Sets of 2 … MOST_JUMPS columns for scores (K,) and information (K, K)."""
    chosen: list[int] = []
    out = []
    while len(chosen) < min(MOST_JUMPS, len(scores)):
        another = _next(scores, information, chosen)
        if another is None:
            break
        chosen = [*chosen, another]
        for _ in range(AGAIN if len(chosen) > 1 else 0):
            before = list(chosen)
            for at in range(len(chosen)):
                others = chosen[:at] + chosen[at + 1 :]
                better = _next(scores, information, others)
                chosen[at] = chosen[at] if better is None else better
            if chosen == before:
                break
        if len(chosen) > 1:
            out.append(chosen)
    return out


def _next(scores: Array, information: Array, others: list[int]) -> int | None:
    """The column that explains most beside others, and not too near to them; None where nothing is left of any."""
    size = np.diag(information)
    cross = information[:, others]
    both = np.column_stack([scores[others], cross.T])
    weights = np.linalg.lstsq(information[np.ix_(others, others)], both, rcond=1e-9)[0]
    left = scores - cross @ weights[:, 0]
    own = size - np.einsum("kj,jk->k", cross, weights[:, 1:])
    seen = own > 1e-6 * np.maximum(size, 1e-30)
    for other in others:
        seen[max(0, other - APART + 1) : other + APART] = False
    if not seen.any():
        return None
    return int(np.argmax(np.where(seen, left**2 / np.where(seen, own, 1.0), -1.0)))
