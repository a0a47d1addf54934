"""Machines nobody has seen: a patient positioner or a six-revolute arm with dimensions and masses of its own.

All lengths and masses are our guesses, spread about those of the two machine files in `machines/`.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np

MACHINES = ("pps", "arm6")
ALL_LOADS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
Entry = dict[str, Any]


def draw_machine(kind: str, rng: np.random.Generator) -> Entry:
    """A machine file's contents (contract §1), elastic in every joint."""
    if kind not in MACHINES:
        raise ValueError(f"no machine {kind!r}; there are {', '.join(MACHINES)}")
    return _positioner(rng) if kind == "pps" else _arm(rng)


def without_compliance(machine: Entry, joint: str) -> Entry:
    """The same file, written by somebody who took this joint for rigid."""
    left = copy.deepcopy(machine)
    for entry in left["joints"]:
        if entry["name"] == joint:
            del entry["elastic"]
    return left


def _positioner(rng: np.random.Generator) -> Entry:
    """3P3R: floor rails, column, cantilever, then yaw and two small tilts below the couch. Y is up."""

    def about(value: float, spread: float = 0.2) -> float:
        return round(float(value * rng.uniform(1 - spread, 1 + spread)), 4)

    tilt = about(0.0523, 0.1)
    lateral, column, reach = about(1.1), about(0.28), about(1.45, 0.15)
    loads = ("Fy", "Mx", "Mz")
    joints = [
        _joint("lateral", "prismatic", (0, about(0.3), 0), (1, 0, 0), (-lateral, lateral), about(640),
               (0, about(0.21), about(0.02)), loads),
        _joint("vertical", "prismatic", (0, about(1.0), about(0.11)), (0, 1, 0), (-column, column), about(430),
               (0, about(0.09), about(0.05)), loads, varies=True),
        _joint("longitudinal", "prismatic", (0, about(0.32), about(0.57)), (0, 0, 1), (0.0, reach), about(275),
               (0, 0, -about(0.42)), loads, varies=True),
        _joint("yaw", "revolute", (0, about(0.15), about(0.24)), (0, 1, 0), (-1.5708, 1.5708), about(72),
               (0, about(0.05), 0), loads),
        _joint("roll", "revolute", (0, about(0.12), 0), (0, 0, 1), (-tilt, tilt), about(31), (0, 0, 0), loads),
        _joint("pitch", "revolute", (0, about(0.1), 0), (1, 0, 0), (-tilt, tilt), about(33),
               (0, about(0.04), 0), loads),
    ]  # fmt: skip
    side, near, far = about(0.25), about(0.155), about(0.29)
    return _machine(
        "pps", (0.0, -9.80665, 0.0), joints, (0, about(0.065), 0),
        {"P1": (0, 0.01, far), "P2": (-side, 0.01, -near), "P3": (side, 0.01, -near)},
        (0, about(0.2), about(0.85)), about(1.4e-4, 0.15),
    )  # fmt: skip


def _arm(rng: np.random.Generator) -> Entry:
    """6R with a spherical wrist; Z is up."""

    def about(value: float, spread: float = 0.2) -> float:
        return round(float(value * rng.uniform(1 - spread, 1 + spread)), 4)

    def turn(value: float) -> tuple[float, float]:
        return -about(value, 0.1), about(value, 0.1)

    joints = [
        _joint("j1", "revolute", (0, 0, about(0.4)), (0, 0, 1), turn(2.6), about(180), (0, 0, about(0.1)), ALL_LOADS),
        _joint("j2", "revolute", (about(0.2), 0, about(0.3)), (0, 1, 0), turn(0.9), about(120), (0, 0, about(0.45)),
               ALL_LOADS),
        _joint("j3", "revolute", (0, 0, about(0.9)), (0, 1, 0), turn(0.9), about(90), (about(0.1), 0, 0.05), ALL_LOADS),
        _joint("j4", "revolute", (about(0.3), 0, about(0.1)), (1, 0, 0), turn(2.5), about(40), (about(0.3), 0, 0),
               ALL_LOADS),
        _joint("j5", "revolute", (about(0.7), 0, 0), (0, 1, 0), turn(1.6), about(20), (0.05, 0, 0), ALL_LOADS),
        _joint("j6", "revolute", (about(0.1), 0, 0), (1, 0, 0), turn(2.8), about(8), (0.02, 0, 0), ALL_LOADS),
    ]  # fmt: skip
    high, side, low = about(0.2), about(0.17), about(0.1)
    return _machine(
        "arm6", (0.0, 0.0, -9.80665), joints, (about(0.12), 0, 0),
        {"P1": (0.02, 0, high), "P2": (0.02, -side, -low), "P3": (0.02, side, -low)},
        (about(0.3), 0, 0), about(1.4e-4, 0.15),
    )  # fmt: skip


def _joint(
    name: str,
    kind: str,
    xyz: Sequence[float],
    axis: Sequence[float],
    limits: tuple[float, float],
    mass: float,
    com: Sequence[float],
    loads: Sequence[str],
    varies: bool = False,
) -> Entry:
    return {
        "name": name,
        "type": kind,
        "origin": _placed(xyz),
        "axis": [float(x) for x in axis],
        "limits": {"lower": limits[0], "upper": limits[1], "velocity": 0.1, "acceleration": 0.1},
        "link": {"mass": mass, "com": [float(x) for x in com]},
        "elastic": {"loads": list(loads), "varies": varies},
    }


def _machine(
    name: str,
    gravity: Sequence[float],
    joints: list[Entry],
    tip: Sequence[float],
    targets: dict[str, Sequence[float]],
    treatment: Sequence[float],
    repeatability: float,
) -> Entry:
    return {
        "name": name,
        "gravity": list(gravity),
        "joints": joints,
        "tip": {
            "origin": _placed(tip),
            "targets": {k: [float(x) for x in v] for k, v in targets.items()},
            "points": {"treatment": [float(x) for x in treatment]},
        },
        "force_sensor": {"origin": _placed((0, 0, 0))},
        "repeatability": {"position": repeatability},
        "tracker": {"position_sigma": 2.0e-5},
    }


def _placed(xyz: Sequence[float]) -> Entry:
    return {"xyz": [float(x) for x in xyz], "rpy": [0.0, 0.0, 0.0]}
