"""Hilti Trailblazer, lifting column + 6R arm before a total station (Kindle et al. 2025): flat.yaml, pallet.yaml, …

A station is one column height and one branch of the arm's inverse kinematics. Rows are ordered by time, which the files
are not. Encoder positions only: no setpoints are published. The tilt sensors' accelerations are kept as they are and
given as angles too, because an angle of the column's tip is what shifts the arm.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import yaml

from ppshw.converters.table import read_text, shortest, write_csv
from ppshw.errors import RecordingError

JOINTS = ("column", "arm1", "arm2", "arm3", "arm4", "arm5", "arm6")
_SOURCE_JOINTS = ["column_prismatic_joint", *(f"dsr_joint{k}" for k in range(1, 7))]
_PHASES = {"stationing_measurements": "stationing", "evaluation_measurements": "evaluation"}
# libyaml where PyYAML has it: ten times faster on these files.
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass(frozen=True)
class _Visit:
    """joints [m, rad × 6]; prism [m]; base, tip: specific force at the two tilt sensors, up when at rest [m/s²]."""

    time: float
    step: str
    id: int
    upside_down: bool
    joints: list[float]
    prism: list[float]
    base: list[float]
    tip: list[float]
    command: list[float]


def convert(source: Path, out_csv: Path) -> int:
    """Write the contract's CSV for machines/real/hilti.yaml; returns the number of visits. Raises RecordingError."""
    visits = sorted(_visits(source), key=lambda v: v.time)
    if not visits:
        raise RecordingError(f"{source}: no measurement in it")
    columns: dict[str, list[str]] = {
        "time": [_iso(v.time) for v in visits],
        "step": [v.step for v in visits],
    }
    for k, joint in enumerate(JOINTS):
        columns[f"q_{joint}"] = shortest([v.joints[k] for v in visits])
    for k, axis in enumerate("xyz"):
        columns[f"prism_{axis}"] = shortest([v.prism[k] for v in visits])
    for place, forces in (("base", [v.base for v in visits]), ("tip", [v.tip for v in visits])):
        angles = [tilt(force) for force in forces]
        for k, axis in enumerate("xy"):
            columns[f"cov_tilt_{place}_{axis}"] = shortest([angle[k] for angle in angles])
        for k, axis in enumerate("xyz"):
            columns[f"cov_acc_{place}_{axis}"] = shortest([force[k] for force in forces])
    columns["source_id"] = [str(v.id) for v in visits]
    columns["upside_down"] = [str(int(v.upside_down)) for v in visits]
    for k, axis in enumerate("xyz"):
        columns[f"arm_goal_{axis}"] = shortest([v.command[k] for v in visits])
    return write_csv(out_csv, columns)


def tilt(force: list[float]) -> tuple[float, float]:
    """How far a sensor at rest leans about its own x and y, with its mounting error in it.   [rad]

        f = Rᵀ (0, 0, g) = g (−sin θy, sin θx cos θy, cos θx cos θy),   R = Rz Ry(θy) Rx(θx)

    force    (3,)  specific force in the sensor's frame   [m/s²]
    """
    fx, fy, fz = force
    return math.atan2(fy, fz), math.atan2(-fx, math.hypot(fy, fz))


def _visits(source: Path) -> Iterator[_Visit]:
    try:
        content = yaml.load(read_text(source), Loader=_LOADER)
    except yaml.YAMLError as exc:
        raise RecordingError(f"{source}: not valid YAML ({' '.join(str(exc).split())})") from None
    names = _need(content, "joint_names", list, str(source))
    if names != _SOURCE_JOINTS:
        raise RecordingError(f"{source}: joint_names are {names}, expected {_SOURCE_JOINTS}")
    for height, station in _need(content, "column_heights", dict, str(source)).items():
        branches = _need(station, "solution_spaces", dict, f"{source}: height {height}")
        for branch, phases in branches.items():
            where = f"{source}: height {height}, solution space {branch}"
            for key, phase in _PHASES.items():
                for entry in _need(phases, key, list, where):
                    yield _visit(entry, f"h{height}_b{branch}:{phase}", f"{where}, {key}")


def _visit(entry: Any, step: str, where: str) -> _Visit:
    number = _need(entry, "id", int, where)
    where = f"{where}, id {number}"
    return _Visit(
        time=_numbers(entry, "time", None, where)[0],
        step=step,
        id=number,
        upside_down=_need(entry, "upside_down", bool, where),
        joints=_numbers(entry, "joint_states", len(JOINTS), where),
        prism=_numbers(entry, "prism_position", 3, where),
        base=_numbers(entry, "tilt_sensor_base_accel", 3, where),
        tip=_numbers(entry, "tilt_sensor_column_accel", 3, where),
        command=_numbers(entry, "doosan_cmd", 3, where),
    )


def _need(mapping: Any, key: str, kind: type, where: str) -> Any:
    if not isinstance(mapping, dict) or key not in mapping:
        raise RecordingError(f"{where}: no '{key}'; is this one of the published files?")
    if not isinstance(mapping[key], kind):
        raise RecordingError(f"{where}: '{key}' is {mapping[key]!s:.60}, expected a {kind.__name__}")
    return mapping[key]


def _numbers(entry: dict[str, Any], key: str, size: int | None, where: str) -> list[float]:
    """`size` finite numbers; None: a single one."""
    values = [_need(entry, key, float, where)] if size is None else _need(entry, key, list, where)
    sound = all(isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in values)
    if not sound or len(values) != (size or 1):
        wanted = "a finite number" if size is None else f"{size} finite numbers"
        raise RecordingError(f"{where}: '{key}' is {entry[key]!s:.80}, expected {wanted}")
    return [float(v) for v in values]


def _iso(seconds: float) -> str:
    stamp = datetime.fromtimestamp(seconds, UTC)
    return stamp.isoformat(timespec="microseconds").replace("+00:00", "Z")
