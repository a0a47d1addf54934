"""Columns with the wrong sign or the wrong unit, looked for before anything else: the ideal machine is right to a few
centimetres, a payload hangs down, and a mistake of a whole column is not to be explained by physics.

What cannot be told: a single moment's sign where the sensor stays level, which is a load on the other side; the scale
of a force, which is another load.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.kinematics import frames, point_positions
from ppshw.machine import WRENCH_COMPONENTS, Machine
from ppshw.recording import Recording
from ppshw.terms.history import payloads

Array = NDArray[np.float64]
# A mistake is said when one column's correction takes the misfit to less than this share of what it was, and the misfit
# was gross: for positions in metres, for wrenches as a share of the wrench itself.
BETTER = 0.2
GROSS_M = 0.05
GROSS_WRENCH = 0.3
SIGN = {-1.0: "has the opposite sign"}
LENGTHS = {**SIGN, 1e-3: "is in millimetres, expected metres", 1e3: "is in kilometres, expected metres"}
ANGLES = {**SIGN, float(np.pi / 180): "is in degrees, expected radians"}


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
    """The recording with its columns set right, and what was wrong with them; one mistake after the other."""
    found: list[Mistake] = []
    for look in (_positions, _wrenches):
        for _ in range(3):
            best = min(look(machine, recording), key=lambda pair: pair[0].after, default=None)
            if best is None or best[0].after > BETTER * best[0].before:
                break
            mistake, recording = best
            found.append(mistake)
    return recording, found


def _positions(machine: Machine, recording: Recording) -> Iterator[tuple[Mistake, Recording]]:
    before = _misfit(machine, recording)
    if before < GROSS_M:
        return
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
    return Mistake(column, factor, what, before, _misfit(machine, changed)), changed


def _misfit(machine: Machine, recording: Recording) -> float:
    """Middle distance [m] between what was measured and the ideal machine, laid upon each other as rigid bodies."""
    targets = machine.target_array
    ideal = point_positions(machine, recording.q, targets)[recording.seen]
    measured = recording.points[recording.seen]
    a, b = ideal - ideal.mean(axis=0), measured - measured.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return float(np.median(np.linalg.norm(a @ turn - b, axis=1)))


def _wrenches(machine: Machine, recording: Recording) -> Iterator[tuple[Mistake, Recording]]:
    if not recording.has_wrench or not np.isfinite(recording.wrench).all() or not recording.wrench.any():
        return
    sensor = frames(machine, recording.q)[:, -1] @ machine.sensor_in_link
    g = np.einsum("nji,j->ni", sensor[:, :3, :3], machine.gravity)
    before = _unlike_a_payload(recording, recording.wrench, g)
    if before < GROSS_WRENCH:
        return
    for columns in [tuple(range(6)), (0, 1, 2), (3, 4, 5), *((k,) for k in range(6))]:
        wrench = recording.wrench.copy()
        wrench[:, columns] *= -1.0
        first, last = WRENCH_COMPONENTS[columns[0]], WRENCH_COMPONENTS[columns[-1]]
        name = first if len(columns) == 1 else f"{first} … {last}"
        after = _unlike_a_payload(recording, wrench, g)
        yield Mistake(name, -1.0, SIGN[-1.0], before, after), replace(recording, wrench=wrench)


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
