"""UR10 with a Leica T-Mac (Landgraf et al. 2021): series_b.csv and series_c.csv.

Decimal commas; positions in mm, angles of the T-Mac in degrees as intrinsic x-y'-z'' ('XYZ'). Every timestamp reads
2,02011E+13, a number that a spreadsheet rounded to the month: there is no `time` column, the order of the rows is
`cov_index`.
"""

from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ppshw.converters.table import SourceTable, plain, read_table, shortest, write_csv

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
ARM = 0.1  # distance of the virtual targets from the T-Mac's origin [m]
_MM = -3  # power of ten to metres
_GOALS = ("x", "y", "z", "roll", "pitch", "yaw")
_COLUMNS = (
    "Timestamp", *(f"Goal {name}" for name in _GOALS), *(f"{joint}_joint" for joint in JOINTS),
    "measurement_temperature",
    *(f"measurement_{what}{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz") for what in ("", "std_")),
)  # fmt: skip
_log = logging.getLogger(__name__)


def convert(source: Path, out_csv: Path, with_orientation: bool = False) -> int:
    """Write the contract's CSV for machines/real/ur10.yaml (ur10_pose.yaml with the orientation); returns the visits.

    Raises RecordingError with file, line and column.
    """
    table = read_table(source, ";", _COLUMNS, comma=True)
    columns: dict[str, list[str]] = {"step": [source.stem] * len(table)}
    # The publisher does not say whether the angles are commanded or read back; exact zeros in the home pose say
    # commanded.
    for joint in JOINTS:
        columns[f"q_cmd_{joint}"] = plain(table.numbers(f"{joint}_joint"))
    for axis in "xyz":
        columns[f"tmac_{axis}"] = plain(table.numbers(f"measurement_{axis}", _MM))
    if with_orientation:
        columns |= _virtual_targets(table)
    columns["temp_air_C"] = plain(table.numbers("measurement_temperature"))
    columns["cov_index"] = [str(k) for k in range(len(table))]
    for axis in "xyz":
        columns[f"cov_std_{axis}"] = plain(table.numbers(f"measurement_std_{axis}", _MM))
    for axis in ("rx", "ry", "rz"):
        columns[f"cov_std_{axis}"] = shortest([math.radians(v) for v in table.numbers(f"measurement_std_{axis}")])
    columns |= {f"goal_{name}": plain(table.numbers(f"Goal {name}")) for name in _GOALS}
    columns |= {f"measured_{a}_deg": plain(table.numbers(f"measurement_{a}")) for a in ("rx", "ry", "rz")}
    columns["source_timestamp"] = table.texts("Timestamp")
    _warn_of_stale_readings(table)
    return write_csv(out_csv, columns)


def _virtual_targets(table: SourceTable) -> dict[str, list[str]]:
    """Points 100 mm along the T-Mac's x and y axes in the tracker's frame, p + R(rx, ry, rz) e · ARM.   [m]"""
    origin = np.array([table.numbers(f"measurement_{a}", _MM) for a in "xyz"], dtype=float).T
    angles = np.array([table.numbers(f"measurement_{a}") for a in ("rx", "ry", "rz")], dtype=float).T
    axes = Rotation.from_euler("XYZ", angles, degrees=True).as_matrix()
    return {
        f"tmac_e{name}_{axis}": shortest((origin[:, row] + ARM * axes[:, row, k]).tolist())
        for k, name in enumerate("xy")
        for row, axis in enumerate("xyz")
    }


def _warn_of_stale_readings(table: SourceTable) -> None:
    """Say, and keep, rows whose six measured values repeat the row above to the last digit while the joints moved."""
    measured = list(zip(*(table.texts(f"measurement_{a}") for a in ("x", "y", "z", "rx", "ry", "rz")), strict=True))
    joints = list(zip(*(table.texts(f"{j}_joint") for j in JOINTS), strict=True))
    for k in range(1, len(table)):
        if measured[k] == measured[k - 1] and joints[k] != joints[k - 1]:
            _log.warning("%s:%d: the measurement repeats the row above: stale? kept", table.source, table.lines[k])
