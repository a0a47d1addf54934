"""Directions of approach, by the ways that joints went from visit to visit."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.columns.mistake import SIGN, Mistake, from_to
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
    if turned := _turned_over(replace(recording, approach=approach)):
        first, last = turned
        approach[first:last] *= -1
        what = f"{SIGN[-1.0]} from visit {first + 1} on" if first else f"{SIGN[-1.0]} up to visit {last}"
        found.append(_mistake(names, None, what, _own(along)))
    along = _along(replace(recording, approach=approach))
    against = [k for k in range(len(names)) if along[k, k] < 1 - NEARLY_ALL]
    approach[:, against] *= -1
    if wrong := [k for k in against if before[k, k] < 1 - NEARLY_ALL]:
        if len(wrong) == len(names):
            found.append(_mistake(names, -1.0, SIGN[-1.0], _own(along)))
        else:
            found += [_mistake((names[k],), -1.0, SIGN[-1.0], along[k, k]) for k in wrong]
    if np.array_equal(approach, recording.approach):
        return recording, found
    return replace(recording, approach=approach), found


def _turned_over(recording: Recording) -> tuple[int, int] | None:
    """The visits, first and one behind the last, at which the directions of all joints are against their ways, where
    they are along them before or after: as signs are that turn over with a controller's update. None where there are
    no such, or where one joint alone says so: it may have gone past where it came to."""
    went, approach = directions(recording.q), recording.approach
    along = np.where((went != 0) & (approach != 0), np.sign(went * approach), 0)
    joints, count = np.flatnonzero(np.any(along != 0, axis=0)), len(along)
    if len(joints) < 2:
        return None
    before = np.concatenate([[0], np.cumsum(along.sum(axis=1))])
    change = int(np.argmax(np.abs(2 * before - before[-1])))  # where what is along and against differ most
    parts = [along[some][:, joints] for some in (slice(0, change), slice(change, count))]
    if min(np.abs(part).sum(axis=0).min(initial=count) for part in parts) < ENOUGH:
        return None
    first, second = ((part == 1).sum(axis=0) / np.abs(part).sum(axis=0) for part in parts)
    if first.min() > NEARLY_ALL and second.max() < 1 - NEARLY_ALL:
        return change, count
    if second.min() > NEARLY_ALL and first.max() < 1 - NEARLY_ALL:
        return 0, change
    return None


def _own(along: Array) -> float:
    """The share of visits to which joints came from the side that their own directions say."""
    return float(np.nanmean(np.diag(along)))


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


def _mistake(joints: Sequence[str], factor: float | None, what: str, along: float) -> Mistake:
    columns = [f"approach_{name}" for name in joints]
    two = factor is None and len(columns) == 2
    return Mistake(" and ".join(columns) if two else from_to(columns), factor, what, 1 - along, along)
