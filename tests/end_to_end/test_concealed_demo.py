"""A machine that hides something, in short: diagnosed over the wires, corrected, measured three times, seal opened."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import Any

from ppshw.demo_concealed import run_concealed, sentences
from ppshw.machine import load_machine
from ppshw.recording import load_recording
from tests.end_to_end.rig import ROOT

DIAGNOSIS = """\
name: short diagnosis
seed: 17
settle_s: 5
order: as_written
reference: {every: 24, q: {}}
loads:
  - {name: empty, mass: 0}
  - {name: left,  mass: 150, com: [-0.25, 0.15, 0.35]}
  - {name: head,  mass: 160, com: [0, 0.15, 0.85]}
steps:
  - {step: random_1, kind: random, count: 40, margin: 0.01}
  - {step: random_2, kind: random, count: 40, margin: 0.01, loads: [head, empty, left]}
"""
VERIFICATION = """\
name: short proof
seed: 18
settle_s: 5
targets: [P1, treatment]
loads: [{name: patient, random: 3, mass: [20, 180], com: {x: [-0.1, 0.1], y: [0.1, 0.2], z: [0.3, 0.7]}}]
steps: [{step: proof, kind: random, count: 12, margin: 0.06, loads: [patient]}]
"""


def run(folder: Path, effect: str) -> tuple[dict[str, Any], list[str]]:
    for name, text in (("diagnosis", DIAGNOSIS), ("verification", VERIFICATION)):
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    scripts = {name: str(folder / f"{name}.yaml") for name in ("diagnosis", "verification")}
    seals: list[str] = []

    def say(name: str, done: int, total: int) -> None:
        if name == "diagnosis":  # the seal is out before the first visit, the truth is not
            assert (folder / "out/seal.sha256").read_text(encoding="utf-8").strip() == seals[0]
        assert not (folder / "out/truth.json").exists()

    found = run_concealed(
        folder / "out", 5, 1, ROOT / "machines/pps.yaml", say, seals.append, scripts, size=3.0, effect=effect
    )
    return found, seals


def test_lost_motion_is_found_and_taken_out_by_its_approach(tmp_path: Path) -> None:
    found, seals = run(tmp_path, "backlash")
    assert seals == [hashlib.sha256((tmp_path / "out/truth.json").read_bytes()).hexdigest()] == [found["seal"]]
    assert found["truth"]["effect"] == "backlash"
    assert found["named"]
    assert found["joint_right"]
    assert [(v["effect"], v["joint"]) for v in found["taken_out"]] == [("backlash", found["truth"]["joint"])]
    assert found["extended"]["rms_mm"] < 0.75 * found["base"]["rms_mm"] < 0.1 * found["nominal"]["rms_mm"]
    assert json.loads((tmp_path / "out/concealed.json").read_text(encoding="utf-8")) == found
    machine = load_machine(tmp_path / "out/machine.yaml")
    recording = load_recording(tmp_path / "out/diagnosis.db", machine)
    assert set(recording.temperatures) >= {"air", "rail"}
    lines = sentences(found, [])
    assert max(map(len, lines)) <= 80
    unit = "mm" if found["truth"]["units"]["gap"] == "m" else "mrad"
    assert any(re.search(rf"gap [\d.]+ {unit};", line) for line in lines)
    assert any(line.startswith("effect named: yes   joint right: yes") for line in lines)


def test_a_drift_is_found_and_no_gain_is_claimed_for_it(tmp_path: Path) -> None:
    found, _ = run(tmp_path, "drift")
    assert found["named"]
    assert found["taken_out"] == []
    assert [v["effect"] for v in found["not_compensated"]] == ["drift"]
    assert "cannot be known" in found["not_compensated"][0]["why"]
    # no worse than the base calibration, and hardly better: both have the drift since, the base calibration's constants
    # some of that of the diagnosis as well (0.72 to 1.03 of its rms over seven pairs of seeds, 0.93 here)
    assert 0.7 * found["base"]["rms_mm"] < found["extended"]["rms_mm"] < 1.1 * found["base"]["rms_mm"]
    lines = sentences(found, [])
    assert any(line.startswith("not compensated, 12 visits: drift") for line in lines)
    assert not any(line.startswith("compensated") for line in lines)
