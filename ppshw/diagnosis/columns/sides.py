"""Directions of approach, by the ways that joints went from visit to visit."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.columns.mistake import SIGN, Mistake
from ppshw.recording import Recording, directions

Array = NDArray[np.float64]
# A joint is hardly ever gone past where it came to, at more than half of the visits; another one's directions are along
# its way at half of them; visits at which both are known. Ours.
NEARLY_ALL, NOT_ITS_OWN, ENOUGH = 0.9, 0.75, 10


def mistaken_sides(given: Recording, recording: Recording) -> tuple[Recording, list[Mistake]]:
    """The recording with directions of approach that are against their joint's way turned round, and those that are
    along each other's exchanged: without them lost motion would be taken out the wrong way round.

    given  as it was before its positions were set right: directions that were along those are set right with them,
           and are no mistake of their own
    """
    approach, found = recording.approach.copy(), []
    names, along, before = recording.joint_names, _along(recording), _along(given)
    for one, other in itertools.combinations(range(len(names)), 2):
        if _exchanged(along, one, other):
            approach[:, [one, other]] = approach[:, [other, one]]
            if _exchanged(before, one, other):
                found.append(_mistake((names[one], names[other]), None, "is exchanged", along[one, one]))
    along = _along(replace(recording, approach=approach))
    for k, name in enumerate(names):
        if along[k, k] < 1 - NEARLY_ALL:
            approach[:, k] *= -1
            if before[k, k] < 1 - NEARLY_ALL:
                found.append(_mistake((name,), -1.0, SIGN[-1.0], along[k, k]))
    if np.array_equal(approach, recording.approach):
        return recording, found
    return replace(recording, approach=approach), found


def _along(recording: Recording) -> Array:
    """(n, n) the share of visits to which joint k came from the side that j's direction says, in row j and column k;
    NaN where hardly any tell."""
    went = directions(recording.q)
    told = (recording.approach != 0)[:, :, None] & (went != 0)[:, None, :]
    same = (recording.approach[:, :, None] == went[:, None, :]) & told
    count = told.sum(axis=0)
    return np.where(count < ENOUGH, np.nan, same.sum(axis=0) / np.maximum(count, 1))


def _exchanged(along: Array, one: int, other: int) -> bool:
    """Whether two joints' directions are along each other's ways, and hardly along their own."""
    apart = max(along[one, one], along[other, other]) < NOT_ITS_OWN
    return bool(apart and min(along[one, other], along[other, one]) > NEARLY_ALL)


def _mistake(joints: tuple[str, ...], factor: float | None, what: str, along: float) -> Mistake:
    return Mistake(" and ".join(f"approach_{name}" for name in joints), factor, what, 1 - along, along)
