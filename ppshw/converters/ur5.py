"""UR5 with one reflector before a laser tracker (Jacobi 2025): grid.csv and random.csv.

`x_dif` may be actual − target or target − actual: the publisher refers to the thesis. Taken here as actual − target:
with it the arm sags under its own weight (shoulder 3.2e-5 ± 0.2e-5 rad/(N·m) in a fit of ours), with the other sign
it would rise by as much. The nominal residual is the same either way (0.701 and 0.702 mm).
"""

from __future__ import annotations

import math
from pathlib import Path

from ppshw.converters.table import plain, read_table, shortest, write_csv

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
_MM = -3  # power of ten to metres
_COLUMNS = (
    "step_order", "x_t", "y_t", "z_t", "x_dif", "y_dif", "z_dif",
    "joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6",
)  # fmt: skip


def convert(source: Path, out_csv: Path) -> int:
    """Write the contract's CSV for machines/real/ur5.yaml; returns the number of visits. Raises RecordingError."""
    table = read_table(source, ",", _COLUMNS)
    columns: dict[str, list[str]] = {"step": [source.stem] * len(table)}
    for k, joint in enumerate(JOINTS, start=1):
        columns[f"q_cmd_{joint}"] = shortest([math.radians(v) for v in table.numbers(f"joint_{k}")])
    goals = {axis: table.numbers(f"{axis}_t", _MM) for axis in "xyz"}
    for axis, goal in goals.items():
        difference = table.numbers(f"{axis}_dif", _MM)
        columns[f"smr_{axis}"] = plain([g + d for g, d in zip(goal, difference, strict=True)])
    columns["cov_index"] = plain(table.numbers("step_order"))
    columns |= {f"goal_{axis}": plain(goal) for axis, goal in goals.items()}
    return write_csv(out_csv, columns)
