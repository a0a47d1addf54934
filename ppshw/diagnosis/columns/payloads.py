"""Forces and moments, by what a payload that hangs there may be."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.columns.mistake import AXES, SIGN, Mistake, from_to
from ppshw.identification.plausible import LOADED_N, LOADED_NM
from ppshw.kinematics import frames
from ppshw.machine import WRENCH_COMPONENTS, Machine
from ppshw.recording import Recording
from ppshw.statics import gravity_in_sensor, sensor_axes
from ppshw.terms.history import payloads, weighs

Array = NDArray[np.float64]
GROSS_WRENCH = 0.3
# A payload's centre of mass is not this far from the sensor: forces in kilonewtons beside N·m put it a thousand times
# as far as it is, and so do newtons beside moments in N·mm. Which, the forces say: half a tonne is 5 kN, a kilogram
# 10 N; between nobody can tell.
LEVER_M = 20.0
MOST_KN, LEAST_N = 5.0, 10.0
ASKEW = np.pi / 4  # a payload's weight does not point this far from gravity, whatever a sensor's zero adds [rad]
# Times as unlike a payload as two exchanged columns set right the next best two leave a wrench: 4 and more of 378 that
# were exchanged in six authors' recordings, 1.5 of one whose Mz reads 0.86 m times Fz besides (036 of the
# fifty-ninth's).
ONE_PAIR = 2.5
FORCES, MOMENTS = (0, 1, 2), (3, 4, 5)
KILO = "is in kilonewtons, expected newtons"
MILLI = "is in newton millimetres, expected newton metres"
BASE_AXES = "is in axes of the base, expected the force sensor's own"
TOO = " (the moments too, if they go with the forces)"  # where nobody asked, or the visits do not tell


def mistaken_wrenches(machine: Machine, recording: Recording) -> Iterator[tuple[Mistake, Recording]]:
    either = loaded(recording, FORCES, LOADED_N) or loaded(recording, MOMENTS, LOADED_NM)
    if not has(recording, range(6)) or not either:
        return
    chain = frames(machine, recording.q)
    g = gravity_in_sensor(machine, chain)
    before = _unlike_a_payload(recording, recording.wrench, g)
    if before < GROSS_WRENCH:
        return
    for columns in (FORCES, *((k,) for k in range(6))):
        changed = times(recording, columns, -1.0)
        after = _unlike_a_payload(recording, changed.wrench, g)
        what = SIGN[-1.0] + (TOO if columns == FORCES and loaded(recording, MOMENTS, LOADED_NM) else "")
        yield Mistake(named(columns), -1.0, what, before, after), changed
    for k in FORCES:
        changed = times(recording, (k,), 1e3)
        yield Mistake(WRENCH_COMPONENTS[k], 1e3, KILO, before, _unlike_a_payload(recording, changed.wrench, g)), changed
    turned = _from_base_axes(recording, sensor_axes(machine, chain))
    after = _unlike_a_payload(recording, turned.wrench, g)
    yield Mistake(named(range(6)), None, BASE_AXES, before, after, "turned by the ideal machine"), turned
    exchanged = []
    for three, (first, second) in itertools.product((FORCES, MOMENTS), AXES):
        wrench, a, b = recording.wrench.copy(), three[first], three[second]
        wrench[:, [a, b]] = wrench[:, [b, a]]
        after = _unlike_a_payload(recording, wrench, g)
        column = f"{WRENCH_COMPONENTS[a]} and {WRENCH_COMPONENTS[b]}"
        exchanged.append((Mistake(column, None, "is exchanged", before, after), replace(recording, wrench=wrench)))
    least, next_to_it = sorted(mistake.after for mistake, _ in exchanged)[:2]
    if next_to_it > ONE_PAIR * least:
        yield from exchanged


def _from_base_axes(recording: Recording, sensor: Array) -> Recording:
    """The recording whose wrenches, about the sensor, were in axes of the base: in the sensor's (N, 3, 3)."""
    in_base = recording.wrench.reshape(-1, 2, 3)
    return replace(recording, wrench=np.einsum("nji,ncj->nci", sensor, in_base).reshape(-1, 6))


def mistaken_units(machine: Machine, recording: Recording) -> Iterator[tuple[Mistake, Recording]]:
    """Forces in kilonewtons or moments in newton millimetres; by how far off the payloads' centres of mass would be.
    That is said of the whole force: the part along gravity is small where the machine file has another gravity."""
    if not has(recording, FORCES) or not loaded(recording, MOMENTS, LOADED_NM):
        return
    lever, hangs = hanging_at(machine, recording)
    if lever <= LEVER_M:
        return
    if (thousandfold := a_thousandfold(hangs)) is not None:
        columns, what, factor = thousandfold
        far = f"(loads would hang {lever:.0f} m off the sensor)"
        yield Mistake(named(columns), factor, f"{what} {far}", lever, 1e-3 * lever), times(recording, columns, factor)


def a_thousandfold(hangs: float) -> tuple[tuple[int, ...], str, float] | None:
    """Which columns are in which units where loads hang a thousand times too far off, by what pulls there [N], and by
    which factor they are set right; None where it may be either."""
    if hangs < MOST_KN:
        return FORCES, KILO, 1e3
    return (MOMENTS, MILLI, 1e-3) if hangs > LEAST_N else None


def hanging_at(machine: Machine, recording: Recording) -> tuple[float, float]:
    """How far from the sensor loads hang [m], and what pulls there [N], at the middle one of the visits with one."""
    g = gravity_in_sensor(machine, frames(machine, recording.q))
    held = payloads(recording.wrench, recording.load, g)
    size = np.linalg.norm(recording.wrench[:, MOMENTS], axis=1)
    heavy = size > 0.1 * size.max()
    force = np.linalg.norm(recording.wrench[heavy, :3], axis=1)
    weights = np.linalg.norm(held[heavy, 1:], axis=1) * np.linalg.norm(g[heavy], axis=1)
    return float(np.median(weights / np.maximum(force, 1e-30))), float(np.median(force))


def doubts_of_gravity(machine: Machine, recording: Recording) -> list[str]:
    """A line where what hangs there does not pull along the machine file's gravity, at the middle one of the visits
    with a load; up or down is a matter of sign. Nobody can tell which of the two to set right."""
    if not has(recording, FORCES) or not loaded(recording, FORCES, LOADED_N):
        return []
    g, force = gravity_in_sensor(machine, frames(machine, recording.q)), recording.wrench[:, :3]
    size = np.linalg.norm(force, axis=1)
    heavy = size > max(LOADED_N, 0.3 * size.max())
    along = np.abs((force * g).sum(axis=1)[heavy]) / np.maximum(size * np.linalg.norm(g, axis=1), 1e-30)[heavy]
    away = float(np.arccos(np.clip(np.median(along), 0.0, 1.0)))
    if not g.any() or away < ASKEW:
        return []
    return [
        f"forces of loaded visits point {np.degrees(away):.0f}° away from gravity: is gravity in {machine.file} wrong, "
        "or are the axes of force_sensor?"
    ]


def has(recording: Recording, columns: Sequence[int]) -> bool:
    """Whether these components of the wrench were read."""
    read = recording.wrench[:, list(columns)]
    return bool(recording.has_wrench and np.isfinite(read).all() and read.any())


def loaded(recording: Recording, columns: Sequence[int], least: float) -> bool:
    """Whether forces or moments are ever those of a load, and no sensor's zero [N, N·m]."""
    return bool(recording.has_wrench and np.linalg.norm(recording.wrench[:, list(columns)], axis=1).max() > least)


def times(recording: Recording, columns: Sequence[int], factor: float) -> Recording:
    wrench = recording.wrench.copy()
    wrench[:, list(columns)] *= factor
    return replace(recording, wrench=wrench)


def named(columns: Sequence[int]) -> str:
    return from_to([WRENCH_COMPONENTS[k] for k in columns])


def _unlike_a_payload(recording: Recording, wrench: Array, g: Array) -> float:
    """Share of the wrenches that no rigid payload under gravity explains: force and moment each count half. Without
    labels every visit may have one of its own: a force is its weight then, a moment across it."""
    if any(recording.load):
        held = payloads(wrench, recording.load, g)
        held[:, 0] = np.maximum(held[:, 0], 0.0)  # nothing weighs less than nothing
        beside = wrench - weighs(held, g)
    else:
        along = np.einsum("ncx,nx->nc", wrench.reshape(-1, 2, 3), g) / np.maximum((g**2).sum(axis=1), 1e-30)[:, None]
        weight, turns = np.maximum(along[:, :1], 0.0) * g, along[:, 1:] * g
        beside = np.concatenate([wrench[:, :3] - weight, turns], axis=1)
    shares = [
        float((beside[:, some] ** 2).sum() / max(float((wrench[:, some] ** 2).sum()), 1e-30))
        for some in (slice(0, 3), slice(3, 6))
    ]
    return float(np.sqrt(np.mean(shares)))
