"""Positions of joints and of reflectors, by where the ideal machine has them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.columns.mistake import ANGLES, AXES, BETTER, LENGTHS, SIGN, Mistake, from_to
from ppshw.identification.plausible import misfit
from ppshw.identification.start import to_base
from ppshw.kinematics import point_positions
from ppshw.machine import Machine
from ppshw.recording import Recording, listed
from ppshw.transforms import fit_rigid

Array = NDArray[np.float64]
GROSS_M = 0.01
SIGN_M = 1e-3  # of a joint's sign
MANY, MEANS_M = 10, 0.05  # visits; how far the reflectors' means may be off for anything to be said of exchanges


def mistaken_positions(machine: Machine, recording: Recording) -> Iterator[tuple[Mistake, Recording]]:
    if not recording.seen.any():  # other points alone
        return
    before = misfit(machine, recording)
    if before < SIGN_M:
        return
    for k, joint in enumerate(machine.joints):
        units = SIGN if before < GROSS_M else LENGTHS if joint.prismatic else ANGLES
        for factor, what in units.items():
            yield _tried(machine, _scaled(recording, [k], factor), f"q_{joint.name}", factor, what, before)
    for one, other in itertools.combinations(range(machine.n), 2):
        if machine.joints[one].prismatic == machine.joints[other].prismatic:
            q = recording.q.copy()
            q[:, [one, other]] = q[:, [other, one]]
            names = [f"q_{machine.joint_names[k]}" for k in (one, other)]
            yield _tried(machine, replace(recording, q=q), " and ".join(names), None, "is exchanged", before)
    if before < GROSS_M:
        return
    names = [f"{name}_{axis}" for name in recording.target_names for axis in "xyz"]
    for factor, what in LENGTHS.items():
        changed = replace(recording, points=factor * recording.points)
        yield _tried(machine, changed, from_to(names), factor, what, before)
    turning = [k for k, joint in enumerate(machine.joints) if not joint.prismatic]
    if len(turning) > 1:
        names, degrees = [f"q_{machine.joint_names[k]}" for k in turning], float(np.pi / 180)
        changed = _scaled(recording, turning, degrees)
        yield _tried(machine, changed, from_to(names), degrees, ANGLES[degrees], before)
    for t, name in enumerate(recording.target_names):
        for a, axis in enumerate("xyz"):
            for factor, what in LENGTHS.items():
                points = recording.points.copy()
                points[:, t, a] *= factor
                yield _tried(machine, replace(recording, points=points), f"{name}_{axis}", factor, what, before)
        for factor in (1e-3, 1e3):
            points = recording.points.copy()
            points[:, t] *= factor
            column, changed = from_to([f"{name}_{axis}" for axis in "xyz"]), replace(recording, points=points)
            yield _tried(machine, changed, column, factor, LENGTHS[factor], before)
    for column, points in _exchanged(recording):
        yield _tried(machine, replace(recording, points=points), column, None, "is exchanged", before)


def _scaled(recording: Recording, joints: Sequence[int], factor: float) -> Recording:
    q = recording.q.copy()
    q[:, joints] *= factor
    return replace(recording, q=q)


def exchanged_at_times(machine: Machine, recording: Recording) -> tuple[Recording, list[Mistake]]:
    """Two reflectors that are exchanged at many visits: by where the ideal machine has them, once the instrument is
    laid by the reflectors' means, which no exchange changes. At a few it is a matter of those visits."""
    whole, count = recording.seen.all(axis=1), len(recording.target_names)
    if count < 2 or whole.sum() < MANY:
        return recording, []
    ideal = point_positions(machine, recording.q, machine.target_array)
    laid = fit_rigid(recording.points[whole].mean(axis=1), ideal[whole].mean(axis=1))
    points = recording.points @ laid[:3, :3].T + laid[:3, 3]
    if np.median(np.linalg.norm((points - ideal)[whole].mean(axis=1), axis=1)) > MEANS_M:  # something else is wrong
        return recording, []

    def missed(order: Sequence[int]) -> Array:
        return _missed(points[:, order], ideal)

    pairs = list(itertools.combinations(range(count), 2))
    given = missed(list(range(count)))
    others = np.array([missed([b if k == a else a if k == b else k for k in range(count)]) for a, b in pairs])
    mended, found = recording.points.copy(), []
    for (a, b), after in zip(pairs, others, strict=True):
        here = (after < BETTER * given) & (after <= others.min(axis=0)) & (given > GROSS_M)
        if here.sum() < MANY or here[recording.measured].all():
            continue
        mended[np.ix_(here, [a, b])] = mended[np.ix_(here, [b, a])]
        what = f"is exchanged in {here.sum()} visits ({listed(np.flatnonzero(here).tolist())})"
        was, left = (float(np.sqrt((each[here] ** 2).mean())) for each in (given, after))
        found.append(Mistake(f"{recording.target_names[a]} and {recording.target_names[b]}", None, what, was, left))
    return (replace(recording, points=mended), found) if found else (recording, [])


def a_row_off(machine: Machine, recording: Recording) -> tuple[Recording, list[Mistake]]:
    """All reflectors a row late or early from some visit on, as where a row was lost: by where the ideal machine has
    them, once the instrument is laid by the first third of the visits."""
    count = len(recording)
    if count < 2 * MANY or not recording.seen.any():
        return recording, []
    ideal = point_positions(machine, recording.q, machine.target_array)

    def missed(points: Array) -> Array:
        return _missed(points @ laid[:3, :3].T + laid[:3, 3], ideal)

    sound = recording.seen & (np.arange(count) < count / 3)[:, None]
    for _ in range(2):  # by the first visits, then by all that are right
        if not sound.any():
            return recording, []
        laid = fit_rigid(recording.points[sound], ideal[sound])
        given = missed(recording.points)
        sound = recording.seen & (given < MEANS_M)[:, None]
    for rows in (1, -1):
        points = np.full_like(recording.points, np.nan)
        into, of = (slice(rows, None), slice(None, -rows)) if rows > 0 else (slice(None, rows), slice(-rows, None))
        points[into] = recording.points[of]
        gain = np.cumsum((given - missed(points))[::-1])[::-1]  # by shifting all visits from each on
        first = int(np.argmax(gain))
        here = np.arange(count) >= first
        told = here & np.isfinite(points).any(axis=(1, 2)) & recording.measured
        if told.sum() < MANY or first < MANY:
            continue
        before, after = (float(np.sqrt((each[told] ** 2).mean())) for each in (given, missed(points)))
        if before < MEANS_M or after > BETTER * before:
            continue
        names = [f"{name}_{axis}" for name in recording.target_names for axis in "xyz"]
        what = f"is a row {'early' if rows > 0 else 'late'} from visit {first + 1} on"
        if rows > 0:
            points[first] = np.nan  # what stands before it is that visit's own
        mended = replace(recording, points=np.where(here[:, None, None], points, recording.points))
        return mended, [Mistake(from_to(names), None, what, before, after, "moved back")]
    return recording, []


def _missed(points: Array, ideal: Array) -> Array:
    """(N,) mean distance of a visit's readings (N, T, 3) from where the ideal machine has them [m], 0 without any."""
    off = np.linalg.norm(points - ideal, axis=2)
    return np.asarray(np.nansum(off, axis=1) / np.maximum(np.isfinite(off).sum(axis=1), 1))


def _exchanged(recording: Recording) -> Iterator[tuple[str, Array]]:
    """Two reflectors, or two coordinates of one or of all of them, exchanged throughout: which, and the readings as
    they should have been."""
    for one, other in itertools.combinations(range(len(recording.target_names)), 2):
        points = recording.points.copy()
        points[:, [one, other]] = points[:, [other, one]]
        yield f"{recording.target_names[one]} and {recording.target_names[other]}", points
    for t, name in enumerate(recording.target_names):
        for a, b in AXES:
            points = recording.points.copy()
            points[:, t, [a, b]] = points[:, t, [b, a]]
            yield f"{name}_{'xyz'[a]} and {'xyz'[b]}", points
    names = recording.target_names
    for a, b in AXES:
        points = recording.points.copy()
        points[..., [a, b]] = points[..., [b, a]]
        yield f"{from_to([f'{name}_' + 'xyz'[a] for name in names])} and {'xyz'[b]}", points


def askew(machine: Machine, recording: Recording) -> float:
    """A hundredth of the middle distance [m] to the ideal machine where the instrument is said to stand: what is
    mirrored is set right by several corrections, one of which leaves it there. 0 where nobody says."""
    if machine.tracker.base is None:
        return 0.0
    ideal = point_positions(machine, recording.q, machine.target_array)
    return 0.01 * float(np.nanmedian(np.linalg.norm(to_base(recording.points, machine.tracker.base) - ideal, axis=2)))


def _tried(
    machine: Machine, changed: Recording, column: str, factor: float | None, what: str, before: float
) -> tuple[Mistake, Recording]:
    return Mistake(column, factor, what, before, misfit(machine, changed)), changed
