"""A campaign over the wires of simulated hardware: what ends up in the recording is what the machine did."""

from __future__ import annotations

import json
import os
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from campaigns.site import open_bench
from ppshw.errors import BeamLost
from ppshw.recording import load_recording
from ppshw.recording_file import RecordingFile
from simulators.faults import Fault
from tests.end_to_end.rig import ROOT, SCRIPT, Rig


def test_a_campaign_completes_and_records_what_the_machine_did(rig: Rig) -> None:
    result = rig.run()
    assert (result.measured, result.done, result.lost_beams) == (12, 12, 0)
    recording = load_recording(rig.out, rig.site.machine)
    wanted = np.array([visit.setpoints for visit in rig.plan.visits])
    np.testing.assert_allclose(recording.q_cmd, wanted, atol=1e-9)
    np.testing.assert_allclose(recording.q, wanted, atol=3e-7)  # two counts of the coarser encoder
    # the truth, asked directly and not over any wire: reflectors where the plant has them, within repeatability
    # (0.14 mm at the couch) and tracker noise (0.02 mm)
    plant = rig.hardware.plant
    loaded = np.array(recording.load) == "box"
    wrench = plant.wrench(wanted, None)
    wrench[loaded] = recording.wrench[loaded]
    truth = plant.true_points(wanted, wrench)
    for k, target in enumerate(recording.target_names):
        away = np.linalg.norm(recording.points[:, k] - truth[target], axis=1)
        assert away.max() < 4e-4
        assert np.median(away) < 1.5e-4


def test_the_sensor_weighs_what_the_operator_put_on(rig: Rig) -> None:
    rig.run()
    recording = load_recording(rig.out, rig.site.machine)
    weight = np.linalg.norm(recording.wrench[:, :3], axis=1)
    loaded = np.array(recording.load) == "box"
    np.testing.assert_allclose(weight[loaded], 120 * 9.80665, atol=1.0)
    assert weight[~loaded].max() < 1.0


def test_approach_and_temperatures_are_recorded(rig: Rig) -> None:
    rig.run()
    recording = load_recording(rig.out, rig.site.machine)
    sweep = np.array([step == "sweep" for step in recording.step])
    moves = np.diff(recording.q_cmd[:, 0])
    np.testing.assert_array_equal(recording.approach[1:, 0], np.sign(moves))
    assert recording.approach[sweep][1:4, 0].tolist() == [1, 1, 1]
    assert set(recording.temperatures) == {"air", "rail", "force_sensor"}
    assert np.all(np.abs(recording.temperatures["air"] - 21.0) < 1.0)
    assert np.all(recording.settle_s >= 3.0)


TURNS_BACK = """\
name: back
settle_s: 1
loads: [{name: empty, mass: 0}]
steps: [{step: a, kind: poses, poses: [{q: {pitch: 0}}, {q: {pitch: 0.02}}, {q: {pitch: 0.0196}}, {q: {yaw: 0.1}}]}]
"""


def test_from_which_side_a_joint_came_in_a_visit_that_was_broken_off_nobody_knows(tmp_path: Path) -> None:
    """It had turned back by less than an axis gives way when it is let go, and was said to have come on."""
    rig = Rig(tmp_path, TURNS_BACK)
    with rig.hardware:
        with pytest.raises(BeamLost):
            rig.run(Fault("tracker", "lose_beam", None, after_visit=2))
        rig.hardware.tracker.find_beam()
        assert rig.run().done == 4
    recording = load_recording(rig.out, rig.site.machine)
    pitch, lateral = (recording.joint_names.index(name) for name in ("pitch", "lateral"))
    assert recording.approach[:3, pitch].tolist() == [0, 1, 0]
    assert recording.q[2, pitch] == pytest.approx(0.0196, abs=1e-6)
    assert not recording.approach[:, lateral].any()


def test_the_tracker_is_corrected_for_the_air_of_the_hall(rig: Rig) -> None:
    rig.run()
    with RecordingFile.open(rig.out) as file:
        shot = dict(file.shots(1))["P1"]
    # red light at 21.1 °C, 1008 hPa, against 12 °C and 1013 hPa: 1 ppm/K and 0.27 ppm/hPa
    assert shot["ppm"] == pytest.approx(9.1 + 1.4, abs=1.0)
    assert shot["atmosphere"]["pressure_hpa"] == 1008.0


def test_check_names_every_device_and_moves_nothing(rig: Rig) -> None:
    before = rig.hardware.joint_values()
    with open_bench(rig.site, rig.clock, rig.hardware.ports) as bench:
        found = bench.check()
    assert [info.device for info in found] == [*rig.site.machine.joint_names, "tracker", "force sensor", "thermometers"]
    np.testing.assert_array_equal(rig.hardware.joint_values(), before)


def test_the_gsv8_amplifier_measures_the_same_load(tmp_path: Path) -> None:
    rig = Rig(tmp_path, force_protocol="gsv8")
    with rig.hardware:
        rig.run()
    recording = load_recording(rig.out, rig.site.machine)
    assert np.linalg.norm(recording.wrench[-1, :3]) == pytest.approx(120 * 9.80665, abs=1.0)


def test_an_arm_is_measured_by_a_tracker_that_nobody_has_located(tmp_path: Path) -> None:
    text = (ROOT / "machines/arm6.yaml").read_text(encoding="utf-8")
    (tmp_path / "arm.yaml").write_text(text.replace("tracker:\n", "tracker:\n  base: estimate\n"), encoding="utf-8")
    script = "name: arm\nsteps: [{step: any, kind: random, count: 5, margin: 0.1}]\n"
    rig = Rig(tmp_path, script, machine_file=tmp_path / "arm.yaml")
    with rig.hardware:
        result = rig.run()
    assert (result.measured, result.lost_beams) == (5, 0)
    points = load_recording(rig.out, rig.site.machine).points
    # in whatever frame: the sides of the triangle are the machine file's, 0.38 m between P2 and P3
    np.testing.assert_allclose(np.linalg.norm(points[:, 1] - points[:, 2], axis=1), 0.38, atol=1.5e-4)


CHILD = """\
import sys
from datetime import timedelta
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import geocompy.geo
geocompy.geo.sleep = lambda seconds: None
from simulators.clock import START, SteppedClock
import tests.end_to_end.rig as rigs
# every life of the process begins a day later: the machine's clock runs on while the process is dead
rigs.SteppedClock = lambda grace: SteppedClock(START + timedelta(days=int(sys.argv[3])), grace)
rig = rigs.Rig(Path(sys.argv[2]), Path(sys.argv[2], "given.yaml").read_text())
with rig.hardware:
    print(rig.run().done)
"""


def test_a_killed_run_goes_on_and_loses_only_the_visit_in_hand(tmp_path: Path) -> None:
    script = SCRIPT.replace("count: 4", "count: 20")
    (tmp_path / "given.yaml").write_text(script, encoding="utf-8")
    rng = np.random.default_rng(20)
    seen: list[list[tuple[str, ...]]] = []
    for life in range(3):
        child = _start(tmp_path, life)
        _wait_for_visits(tmp_path / "small.db", (len(seen[-1]) if seen else 0) + 4, child)
        time.sleep(rng.uniform(0.0, 0.1))
        os.kill(child.pid, signal.SIGKILL)
        child.wait()
        seen.append(_rows(tmp_path / "small.db"))
    last = _start(tmp_path, 3)
    out, _ = last.communicate(timeout=60)
    assert out.strip() == "60"
    rows = _rows(tmp_path / "small.db")
    assert [len(s) for s in seen] == sorted({len(s) for s in seen})  # every life got further
    for earlier in seen:
        assert rows[: len(earlier)] == earlier  # nothing lost, nothing changed
    with RecordingFile.open(tmp_path / "small.db") as file:
        assert file.done() == set(range(60))
        assert len(file.table()[1]) == 60
        assert sum(kind == "start" for _, kind, _, _ in file.events()) == 4


def _start(folder: Path, life: int) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", CHILD, str(ROOT), str(folder), str(life)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def _wait_for_visits(path: Path, wanted: int, child: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 30
    while len(_rows(path)) < wanted:
        assert child.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)


def _rows(path: Path) -> list[tuple[str, ...]]:
    if not path.exists():
        return []
    with sqlite3.connect(f"file:{path}?mode=rw", uri=True, timeout=10) as db:
        if not db.execute("SELECT name FROM sqlite_master WHERE name = 'visits'").fetchone():
            return []
        columns = json.loads(db.execute("SELECT value FROM meta WHERE key = 'columns'").fetchone()[0])
        names = ", ".join(f'"{c}"' for c in columns)
        return list(db.execute(f"SELECT {names} FROM visits ORDER BY visit"))
