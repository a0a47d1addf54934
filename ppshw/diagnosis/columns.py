"""Columns with the wrong sign or the wrong unit, looked for before anything else: the ideal machine is right to a few
centimetres, a payload hangs down, and a mistake of a whole column is not to be explained by physics.

A payload's moments fit its forces with either sign, as a load on the other side; which it is the machine says, that
gives way to them. What cannot be told: a single moment's sign where the sensor stays level; the scale of all forces
and moments, which is another load.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.identification.joint import estimate
from ppshw.identification.plausible import misfit
from ppshw.identification.start import to_base
from ppshw.identification.structure import joint_model
from ppshw.kinematics import frames
from ppshw.machine import WRENCH_COMPONENTS, Machine
from ppshw.recording import Recording
from ppshw.terms import Situation
from ppshw.terms.history import payloads

Array = NDArray[np.float64]
# A mistake is said when one column's correction takes the misfit to less than this share of what it was, and the misfit
# was gross: for positions in metres, for wrenches as a share of the wrench itself.
BETTER = 0.2
GROSS_M = 0.05
GROSS_WRENCH = 0.3
# A payload's centre of mass is not this far from the sensor: forces in kilonewtons beside N·m put it a thousand times
# as far as it is.
LEVER_M = 20.0
# The base model of so many visits leaves less with the moments' right sign: in 72 recordings of another author the
# other one left 0.99 to 7.5 times as much, 1.04 or more in 65. How much less it must leave for the given sign to be
# wrong; and for two signs to be told apart at all.
ASKED, REVERSED, TOLD = 200, 1.04, 1.01
SIGN = {-1.0: "has the opposite sign"}
LENGTHS = {**SIGN, 1e-3: "is in millimetres, expected metres", 1e3: "is in kilometres, expected metres"}
ANGLES = {**SIGN, float(np.pi / 180): "is in degrees, expected radians"}
FORCES, MOMENTS = (0, 1, 2), (3, 4, 5)


@dataclass(frozen=True)
class Mistake:
    """column times factor is what it should have been; misfit before and after the correction [m], or shares of the
    wrench."""

    column: str
    factor: float
    what: str
    before: float
    after: float

    def finding(self) -> dict[str, Any]:
        """In the contract's form (§4), under a name of its own."""
        return {
            "effect": "column_mistake", "joint": None, "frame": None, "component": None, "covariate": self.column,
            "region": None, "parameters": {"factor": {"value": self.factor, "std": 0.0, "unit": "1"}},
            "p_value": 0.0, "rms_mm": None, "weight": 1.0, "alternatives": [],
            "sentence": f"the column {self.column} {self.what}; it was taken times {self.factor:g}.",
        }  # fmt: skip


def column_mistakes(machine: Machine, recording: Recording) -> tuple[Recording, list[Mistake]]:
    """The recording with its columns set right, and what was wrong with them; one mistake after the other.

    Whether moments have the sign of their forces is asked of the base model, which takes some seconds.
    """
    recording, found = plain_mistakes(machine, recording)
    if not _has(recording, MOMENTS):
        return recording, found
    given, other = (_left(machine, r) for r in (recording, _times(recording, MOMENTS, -1.0)))
    forces = next((m for m in found if m.column == _named(FORCES) and m.factor == -1.0), None)
    if forces is None and given > REVERSED * other:
        found.append(Mistake(_named(MOMENTS), -1.0, SIGN[-1.0], given, other))
        return _times(recording, MOMENTS, -1.0), found
    if forces is not None and other < TOLD * given:  # a sensor mounted the other way round turns all six
        what = forces.what + ("" if given > TOLD * other else " (its moments too, if they go with its forces)")
        found[found.index(forces)] = replace(forces, column=_named(range(6)), what=what)
        return _times(recording, MOMENTS, -1.0), found
    return recording, found


def plain_mistakes(machine: Machine, recording: Recording) -> tuple[Recording, list[Mistake]]:
    """The same by what needs no fit: the sign of all moments together is not asked for."""
    found: list[Mistake] = []
    for look in (_positions, _wrenches, _kilonewtons):
        for _ in range(3):
            best = min(look(machine, recording), key=lambda pair: pair[0].after, default=None)
            if best is None or best[0].after > BETTER * best[0].before:
                break
            mistake, recording = best
            found.append(mistake)
    return recording, found


def _positions(machine: Machine, recording: Recording) -> Iterator[tuple[Mistake, Recording]]:
    before = misfit(machine, recording)
    if before < GROSS_M:
        return
    names = [f"{name}_{axis}" for name in recording.target_names for axis in "xyz"]
    for factor, what in LENGTHS.items():
        changed = replace(recording, points=factor * recording.points)
        yield _tried(machine, changed, f"{names[0]} … {names[-1]}", factor, what, before)
    for k, joint in enumerate(machine.joints):
        for factor, what in (LENGTHS if joint.prismatic else ANGLES).items():
            q = recording.q.copy()
            q[:, k] *= factor
            yield _tried(machine, replace(recording, q=q), f"q_{joint.name}", factor, what, before)
    for t, name in enumerate(recording.target_names):
        for a, axis in enumerate("xyz"):
            for factor, what in LENGTHS.items():
                points = recording.points.copy()
                points[:, t, a] *= factor
                yield _tried(machine, replace(recording, points=points), f"{name}_{axis}", factor, what, before)


def _tried(
    machine: Machine, changed: Recording, column: str, factor: float, what: str, before: float
) -> tuple[Mistake, Recording]:
    return Mistake(column, factor, what, before, misfit(machine, changed)), changed


def _wrenches(machine: Machine, recording: Recording) -> Iterator[tuple[Mistake, Recording]]:
    if not _has(recording, range(6)):
        return
    g = _gravity(machine, recording)
    before = _unlike_a_payload(recording, recording.wrench, g)
    if before < GROSS_WRENCH:
        return
    for columns in (FORCES, *((k,) for k in range(6))):
        changed = _times(recording, columns, -1.0)
        after = _unlike_a_payload(recording, changed.wrench, g)
        yield Mistake(_named(columns), -1.0, SIGN[-1.0], before, after), changed


def _kilonewtons(machine: Machine, recording: Recording) -> Iterator[tuple[Mistake, Recording]]:
    """Forces in kilonewtons, moments in newton metres; by how far off the payloads' centres of mass would be."""
    if not _has(recording, FORCES) or not _has(recording, MOMENTS):
        return
    held = payloads(recording.wrench, recording.load, _gravity(machine, recording))
    size = np.linalg.norm(recording.wrench[:, MOMENTS], axis=1)
    heavy = size > 0.1 * size.max()
    lever = float(np.median(np.linalg.norm(held[heavy, 1:], axis=1) / np.maximum(np.abs(held[heavy, 0]), 1e-30)))
    if lever > LEVER_M:
        what = f"is in kilonewtons, expected newtons (loads would hang {lever:.0f} m off the sensor)"
        yield Mistake(_named(FORCES), 1e3, what, lever, 1e-3 * lever), _times(recording, FORCES, 1e3)


def _left(machine: Machine, recording: Recording) -> float:
    """rms [m] that the base model leaves of some visits' readings."""
    some = recording.subset(np.linspace(0, len(recording) - 1, min(ASKED, len(recording))).astype(int))
    base = estimate(joint_model(machine, some), some)
    missed = to_base(some.points, base.measuring_in_base) - base.model.predict(Situation.of(some), base.theta)
    return float(np.sqrt(np.nanmean(missed[base.weights > 0.5] ** 2)))


def _has(recording: Recording, columns: Sequence[int]) -> bool:
    """Whether these components of the wrench were read."""
    read = recording.wrench[:, list(columns)]
    return bool(recording.has_wrench and np.isfinite(read).all() and read.any())


def _gravity(machine: Machine, recording: Recording) -> Array:
    """(N, 3) of it in the sensor's frame [m/s²]."""
    sensor = frames(machine, recording.q)[:, -1] @ machine.sensor_in_link
    return np.asarray(np.einsum("nji,j->ni", sensor[:, :3, :3], machine.gravity))


def _times(recording: Recording, columns: Sequence[int], factor: float) -> Recording:
    wrench = recording.wrench.copy()
    wrench[:, list(columns)] *= factor
    return replace(recording, wrench=wrench)


def _named(columns: Sequence[int]) -> str:
    first, last = WRENCH_COMPONENTS[columns[0]], WRENCH_COMPONENTS[columns[-1]]
    return first if first == last else f"{first} … {last}"


def _unlike_a_payload(recording: Recording, wrench: Array, g: Array) -> float:
    """Share of the wrenches that no rigid payload under gravity explains: force and moment each count half."""
    held = payloads(wrench, recording.load, g)
    mass = np.maximum(held[:, :1], 0.0)  # nothing weighs less than nothing
    force = wrench[:, :3] - mass * g
    moment = wrench[:, 3:] - np.cross(held[:, 1:], g)
    shares = [
        float((rest**2).sum() / max(float((whole**2).sum()), 1e-30))
        for rest, whole in ((force, wrench[:, :3]), (moment, wrench[:, 3:]))
    ]
    return float(np.sqrt(np.mean(shares)))
