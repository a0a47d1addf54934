"""A desk with good files on it: a small machine, a recording, a calibration, a campaign, a site. Tests spoil one."""

from __future__ import annotations

import contextlib
import io
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ppshw.cli import main
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant

ROOT = Path(__file__).parents[2]

MACHINE = """\
name: cell
gravity: [0, 0, -9.80665]
joints:
  - name: rail
    type: prismatic
    origin: {xyz: [0, 0, 0.3], rpy: [0, 0, 0]}
    axis: [1, 0, 0]
    limits: {lower: -0.8, upper: 0.8, velocity: 0.2, acceleration: 0.4}
    link: {mass: 120, com: [0, 0, 0.1]}
    elastic: {loads: [Fz, Mx, My], varies: false}
  - name: turn
    type: revolute
    origin: {xyz: [0, 0, 0.2], rpy: [0, 0, 0]}
    axis: [0, 0, 1]
    limits: {lower: -1.5, upper: 1.5, velocity: 0.5, acceleration: 1.0}
    link: {mass: 40, com: [0.1, 0, 0.05]}
tip:
  origin: {xyz: [0.2, 0, 0.1], rpy: [0, 0, 0]}
  targets: {P1: [0.3, 0, 0], P2: [-0.2, 0.2, 0], P3: [-0.2, -0.2, 0.05]}
  points: {treatment: [0.4, 0, 0.1]}
force_sensor: {origin: {xyz: [0.2, 0, 0.05], rpy: [0, 0, 0]}}
repeatability: {position: 1.4e-4}
tracker:
  position_sigma: 2.0e-5
"""
CAMPAIGN = """\
name: little
seed: 3
settle_s: 1
loads:
  - {name: empty, mass: 0}
  - {name: box, mass: 60, com: [0, 0, 0.2]}
steps:
  - {step: sweep, kind: sweep, joint: rail, count: 5, loads: [empty]}
  - {step: any, kind: random, count: 3, margin: 0.1}
  - {step: poses, kind: poses, poses: [{q: {rail: 0.2, turn: 0.5}}]}
"""
SITE = """\
name: desk
machine: machine.yaml
can:
  bus: {interface: virtual, channel: desk}
  sync_period: 0.01
axes:
  rail: {node: 1, counts_per_unit: 1.0e6, velocity: 0.1}
  turn: {node: 2, counts_per_unit: 2.0e6}
tracker:
  protocol: geocom
  port: socket://127.0.0.1:9
  atmosphere: {temperature_C: 21, pressure_hPa: 1005, humidity_pct: 40}
force_sensor: {protocol: bota, port: socket://127.0.0.1:9}
"""


@dataclass(frozen=True)
class Said:
    """What a command left behind: its exit code and both streams."""

    code: int
    out: str
    err: str


def ppshw(*words: str | Path) -> Said:
    """The command line in this process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main([str(word) for word in words])
        except SystemExit as done:  # argparse's way out
            code = int(done.code or 0)
    return Said(code, out.getvalue(), err.getvalue())


def refused(folder: Path, *words: str | Path, code: int = 2) -> str:
    """Run a command that must be refused: one line on stderr, nothing on stdout, no file made or touched."""
    before = contents(folder)
    said = ppshw(*words)
    assert (said.code, said.out) == (code, ""), said
    assert one_line(said.err)
    assert contents(folder) == before
    return said.err


def one_line(err: str) -> bool:
    """One line, and one of ours: no traceback, nothing that we did not foresee."""
    assert err.count("\n") == 1, err
    assert err.endswith("\n"), err
    assert err.startswith("ppshw"), err
    assert "Traceback" not in err
    assert "internal error" not in err
    return True


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, and every folder."""
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else b"" for p in sorted(folder.rglob("*"))}


def lay_out(folder: Path) -> Path:
    """Write the good files: machine.yaml, little.yaml, site.yaml, good.csv, good.db, cal.json."""
    for name, text in (("machine.yaml", MACHINE), ("little.yaml", CAMPAIGN), ("site.yaml", SITE)):
        (folder / name).write_text(text, encoding="utf-8")
    plant = Plant.from_file(folder / "machine.yaml", seed=2)
    rng = np.random.default_rng(4)
    simulate_recording_csv(plant, folder / "good.csv", 90, rng, "mixed", loads=4, visits_per_load=9)
    machine = folder / "machine.yaml"
    for words in (
        ["import", folder / "good.csv", "--machine", machine, "--out", folder / "good.db"],
        ["identify", folder / "good.csv", "--machine", machine, "--out", folder / "cal.json"],
    ):
        said = ppshw(*words)
        assert said.code == 0, said.err
    return folder


def copy_of(desk: Path, folder: Path, names: Sequence[str] = ()) -> Path:
    for name in names or [p.name for p in desk.iterdir()]:
        shutil.copyfile(desk / name, folder / name)
    return folder
