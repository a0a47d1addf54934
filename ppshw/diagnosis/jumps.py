"""When a joint's zero or a reflector may have jumped more than once: of all sets of moments those that the recording
speaks for most.

There are too many sets to try them all; moments are added one by one to where most is explained, and each is then moved
while the others stay (forward selection with replacement; Miller 2002, Subset Selection in Regression). What a set
found so is worth counts all the sets it was chosen from: `library` gives it their share.

A zero that hops between two values (a coupling with a loose key, a counter that misses a line and finds it again) has
one amplitude whatever the number of its hops: of all courses of noughts and ones the best is sought by turning
stretches over, one by one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.laid import Laid
from ppshw.diagnosis.library.jumps import (
    ORDINALS,
    Jumps,
    shift_of_reflector,
    shift_of_zero,
    some_between,
    visits_between,
)
from ppshw.diagnosis.library.sampled import moving_joints
from ppshw.diagnosis.workspace import Workspace
from ppshw.terms.shapes import Context

Array = NDArray[np.float64]
MOST_JUMPS = len(ORDINALS)
MOSTLY = 0.7  # of all moments
AGAIN = 3  # times that all moments of a set are moved
APART = 5  # visits between two jumps at least: what is back after one or two was a wrong visit, and no zero
STAYS = 3  # visits that a zero stays where it is at least, where it hops to and fro
FEWEST_HOPS, MOST_HOPS = 3, 60


def jumps_of_zeros(space: Workspace) -> list[Jumps]:
    """For every joint that moves, the best two, three and four moments [h] of jumps of its zero, and the best of hops
    between two values, apart from those at which the load was changed."""
    c = space.context
    moments, joints = _not_with_the_load(c, visits_between(c)), list(moving_joints(c))
    if not moments or not joints:
        return []
    laid = Laid(space, [shift_of_zero(c, k, t) for k, _ in joints for t in moments])
    scores = laid.scores().reshape(len(joints), -1)
    of_joint = np.arange(scores.size).reshape(scores.shape)
    found = []
    for (_, name), said, columns in zip(joints, scores, of_joint, strict=True):
        information = laid.information(columns[None])[0]
        sets = [(chosen, False) for chosen in _best_sets(said[:, None], information[:, None, :, None])]
        sets += [(chosen, True) for chosen in _best_hops(said, information) if len(chosen) >= FEWEST_HOPS]
        found += [Jumps(name, tuple(moments[j] for j in sorted(chosen)), hops) for chosen, hops in sets]
    return found


def jumps_of_reflectors(space: Workspace) -> list[Jumps]:
    """For every reflector the best two, three and four moments [h] at which it was moved, by any way each time."""
    c = space.context
    moments, targets = some_between(c), c.points.shape[1]
    if len(moments) < APART:
        return []
    laid = Laid(space, [k for target in range(targets) for t in moments for k in shift_of_reflector(target, t)])
    width = len(laid.scale) // (targets * len(moments))
    scores = laid.scores().reshape(targets, -1, width)
    of_target = np.arange(scores.size).reshape(targets, -1)
    found = []
    for name, said, columns in zip(c.recording.target_names, scores, of_target, strict=True):
        information = laid.information(columns[None])[0].reshape(2 * said.shape)
        sets = _best_sets(said, information)
        found += [Jumps(name, tuple(moments[j] for j in sorted(chosen))) for chosen in sets]
    return found


def _not_with_the_load(c: Context, moments: Sequence[float]) -> list[float]:
    """Those at which the load stays: what changes whenever the load does is no matter of time. All, where loads are
    changed so often that most are such."""
    after = np.searchsorted(c.hours, moments)
    load = np.asarray(c.recording.load)
    stays = load[after] == load[after - 1]
    return [t for t, kept in zip(moments, stays, strict=True) if kept or stays.mean() < MOSTLY]


def _best_sets(scores: Array, information: Array) -> list[list[int]]:
    """Sets of 2 … MOST_JUMPS moments out of K for scores (K, w) and information (K, w, K, w) of w columns each."""
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
    """The moment that explains most beside others, and not too near to them; None where nothing is left of any."""
    count, width = scores.shape
    size = np.einsum("kakb->kab", information)
    cross = information[:, :, others].reshape(count, width, len(others) * width)
    inner = information[np.ix_(others, range(width), others, range(width))].reshape(2 * cross.shape[2:])
    both = np.column_stack([scores[others].ravel(), cross.reshape(count * width, -1).T])
    weights = np.linalg.lstsq(inner, both, rcond=1e-9)[0]
    left = scores - cross @ weights[:, 0]
    own = size - cross @ weights[:, 1:].reshape(-1, count, width).transpose(1, 0, 2)
    least = 1e-6 * np.maximum(np.trace(size, axis1=1, axis2=2), 1e-30) / width
    seen = np.linalg.eigvalsh(own)[:, 0] > least
    for other in others:
        seen[max(0, other - APART + 1) : other + APART] = False
    if not seen.any():
        return None
    own[~seen] = np.eye(width)
    explained = np.einsum("ka,ka->k", left, np.linalg.solve(own, left[..., None])[..., 0])
    return int(np.argmax(np.where(seen, explained, -1.0)))


def _best_hops(scores: Array, information: Array) -> list[list[int]]:
    """The moments between which a zero hops there and back, for columns of steps with scores (K,) and information
    (K, K): [] or one set. Stretches are turned over one by one, whichever gains most."""
    count = len(scores)
    # of stretches [k, k + 1): what begins at one step ends at the next
    ends = np.append(scores[1:], 0.0)
    there = scores - ends
    within = np.pad(information, (0, 1))
    within = within[:-1, :-1] - within[1:, :-1] - within[:-1, 1:] + within[1:, 1:]
    state = np.zeros(count)
    price = np.array([math.log(math.comb(count, k)) for k in range(count + 1)])
    worth = 0.0
    for _ in range(2 * MOST_HOPS):
        sign = 1.0 - 2.0 * state  # what a stretch gains when it is turned over
        score = state @ there + _sums(sign * there)
        own = np.pad(np.cumsum(np.cumsum(sign[:, None] * within * sign, axis=0), axis=1), ((1, 0), (1, 0)))
        square = np.diag(own)[None, :] - own - own.T + np.diag(own)[:, None]
        size = state @ within @ state + 2.0 * _sums(sign * (within @ state)) + square
        gain = np.where(size > 1e-9 * np.diag(information).max(), 0.5 * score**2 / np.maximum(size, 1e-300), 0.0)
        at = np.append(np.abs(np.diff(state, prepend=0.0)), 0.0)  # hops as they are; the end is none
        hops = at.sum() + np.add.outer(1.0 - 2.0 * at, 1.0 - 2.0 * at)
        hops[:, -1] = at.sum() + 1.0 - 2.0 * at  # turned over to the end
        gain = gain - price[np.clip(hops, 0, count).astype(int)]
        gain[(np.subtract.outer(np.arange(count + 1), np.arange(count + 1)) > -STAYS) | (hops > MOST_HOPS)] = -np.inf
        begin, end = np.unravel_index(int(np.argmax(gain)), gain.shape)
        if gain[begin, end] <= worth + 1e-9:
            break
        worth = float(gain[begin, end])
        state[begin:end] = 1.0 - state[begin:end]
    at = np.flatnonzero(np.diff(state, prepend=0.0))
    stays = np.diff(at) >= STAYS  # shorter ones that two turns left between them are none
    while len(at) > 1 and not stays.all():
        short = int(np.argmin(stays))
        at = np.delete(at, [short, short + 1])
        stays = np.diff(at) >= STAYS
    return [list(map(int, at))] if len(at) else []


def _sums(values: Array) -> Array:
    """Sums of values (K,) over stretches from one step (row) to before another (column): (K + 1, K + 1)."""
    whole = np.append(0.0, np.cumsum(values))
    return np.asarray(whole[None, :] - whole[:, None])
