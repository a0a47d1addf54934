"""The bench's commands as programs, on simulated hardware that is a program too: exit codes, stops, goes on."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from campaigns.site import open_bench
from ppshw.calibration import Calibration, content_digest
from ppshw.identification import identify
from ppshw.machine import load_machine
from ppshw.recording import load_recording
from ppshw.recording_file import RecordingFile
from ppshw.terms.effect import Effect
from ppshw.terms.shapes import Column
from simulators.faults import Fault, FaultSchedule
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant
from tests.contract.desk import MACHINE, one_line, ppshw
from tests.end_to_end.rig import ROOT, Rig

PROGRAM = str(Path(sys.executable).with_name("ppshw"))
SCRIPT = """\
name: short
settle_s: 1
loads: [{name: empty, mass: 0}, {name: box, mass: 100, com: [0, 0.1, 0.3]}]
steps: [{step: any, kind: random, count: COUNT, margin: 0.3, within: {lateral: [-0.2, 0.2], vertical: [-0.1, 0.1]}}]
"""


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with a site file; behind it `ppshw simulate` runs."""
    folder = tmp_path_factory.mktemp("hall")
    for count in (4, 60):
        (folder / f"{count}.yaml").write_text(SCRIPT.replace("COUNT", str(count)), encoding="utf-8")
    with simulated(folder, "pps"):
        yield folder


@contextmanager
def simulated(folder: Path, machine: str) -> Iterator[None]:
    words = ["simulate", "--machine", machine, "--site-out", "site.yaml", "--speed", "40", "--json"]
    process = subprocess.Popen([PROGRAM, *words], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert json.loads(process.stdout.readline()) == {"site": str(folder / "site.yaml")}
    yield
    process.terminate()
    _, err = process.communicate(timeout=20)
    assert (process.returncode, err) == (0, "")


def run(folder: Path, *words: str, code: int = 0) -> Any:
    """A command of that program: its answer, or the line that it failed with."""
    done = subprocess.run([PROGRAM, *words], cwd=folder, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == code, done.stderr
    if code == 0:
        assert done.stderr == ""
        return json.loads(done.stdout)
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    return done.stderr


def test_check_says_who_every_device_is(hall: Path) -> None:
    found = run(hall, "check", "--site", "site.yaml", "--json")
    names = [device["device"] for device in found["devices"]]
    assert names == ["lateral", "vertical", "longitudinal", "yaw", "roll", "pitch", "tracker", "force sensor",
                     "thermometers"]  # fmt: skip
    assert all(device["model"] for device in found["devices"])
    assert all(device["serial"] for device in found["devices"][:-1])


def test_a_simulated_hall_has_files_of_its_own_name(hall: Path) -> None:
    """Two halls may stand in one folder."""
    assert f"path: {hall / 'site.temperatures.json'}\n" in (hall / "site.yaml").read_text(encoding="utf-8")
    assert sorted(p.name for p in hall.glob("*temperatures*")) == ["site.temperatures.json"]


def test_a_run_completes_and_once_more_has_nothing_left_to_do(hall: Path) -> None:
    words = ["run", "4.yaml", "--site", "site.yaml", "--out", "done.db", "--json"]
    found = run(hall, *words)
    assert found == {"out": "done.db", "measured": 4, "done": 4, "planned": 4, "skipped": 0, "lost_beams": 0}
    before = (hall / "done.db").read_bytes()
    assert run(hall, *words) == {**found, "measured": 0}
    assert (hall / "done.db").read_bytes() == before
    assert not list(hall.glob("*.lock"))


@pytest.mark.parametrize("request_to_end", [signal.SIGTERM, signal.SIGQUIT])
def test_a_run_that_is_told_to_end_stops_the_axes_and_goes_on_later(hall: Path, request_to_end: signal.Signals) -> None:
    """SIGTERM, as a service manager sends it, and Ctrl-\\ are as good as Ctrl-C; meanwhile nobody else may write the
    recording."""
    out = f"{request_to_end.name}.db"
    (hall / "60.yaml").write_text(SCRIPT.replace("COUNT", "60"), encoding="utf-8")
    words = ["run", "60.yaml", "--site", "site.yaml", "--out", out, "--json"]
    process = subprocess.Popen([PROGRAM, *words], cwd=hall, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not (hall / out).exists() or measured(hall / out) < 2:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert f"{out}: another run is writing it" in run(hall, *words, code=2)
    os.kill(process.pid, request_to_end)
    said, err = process.communicate(timeout=30)
    assert (process.returncode, said) == (1, "")
    assert err == f"ppshw: stopped by the operator; {out} holds everything up to the last visit\n"
    so_far = measured(hall / out)
    assert 2 <= so_far < 60
    with RecordingFile.open(hall / out) as file:
        assert file.events()[-1][1] == "stopped"
    (hall / "60.yaml").write_text("# another script\n" + SCRIPT.replace("COUNT", "60"), encoding="utf-8")
    assert f"{out}: was begun with another campaign script" in run(hall, *words, code=2)


def measured(path: Path) -> int:
    try:
        with RecordingFile.open(path, readonly=True) as file:
            return len(file.done())
    except Exception:  # it is being made at this moment
        return 0


def test_a_run_does_not_go_on_with_another_calibration_of_the_same_recording(hall: Path) -> None:
    calibrate(hall, "one.json")
    data = json.loads((hall / "one.json").read_text(encoding="utf-8"))
    data["terms"][0]["parameters"][0]["value"] += 1e-4
    (hall / "two.json").write_text(json.dumps({**data, "content_sha256": content_digest(data)}), encoding="utf-8")
    loaded = SCRIPT.replace("{name: empty, mass: 0}, ", "").replace("COUNT", "4")
    (hall / "loaded.yaml").write_text(loaded, encoding="utf-8")
    words = ["run", "loaded.yaml", "--site", "site.yaml", "--out", "corrected.db", "--json", "--calibration"]
    assert run(hall, *words, "one.json")["measured"] == 4
    assert "corrected.db: was begun with another setpoint correction" in run(hall, *words, "two.json", code=2)
    with RecordingFile.open(hall / "corrected.db", readonly=True) as file:
        assert file.meta()["setpoints"] == hashlib.sha256((hall / "one.json").read_bytes()).hexdigest()


def test_a_run_says_at_how_many_visits_which_effect_was_taken_out_and_why_not(hall: Path) -> None:
    by_side = Effect("backlash", "yaw", (Column("frame", "approach", {"joint": 3}, 4, 5),), (1e-5,), (1e-6,), "by hand")
    by_time = Effect("drift", None, (Column("frame", "clock", {"form": "linear"}, 0, 2),), (1e-5,), (1e-6,), "by hand")
    calibrate(hall, "found.json", (by_side, by_time))
    loaded = SCRIPT.replace("{name: empty, mass: 0}, ", "").replace("COUNT", "5")
    (hall / "five.yaml").write_text(loaded, encoding="utf-8")
    words = ["run", "five.yaml", "--site", "site.yaml", "--out", "five.db", "--calibration", "found.json", "--json"]
    found = run(hall, *words)
    assert found["compensated"] == [{"effect": "backlash", "joint": "yaw", "why": None, "visits": 5}]
    (left,) = found["not_compensated"]
    assert (left["effect"], left["visits"]) == ("drift", 5)
    assert "cannot be known" in left["why"]


def test_a_run_of_a_machine_with_two_joints_says_what_they_cannot_put_right(tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text(MACHINE, encoding="utf-8")
    machine = load_machine(tmp_path / "cell.yaml")
    csv = simulate_recording_csv(Plant.from_file(machine.file, seed=1), tmp_path / "r.csv", 90)
    recording = load_recording(csv, machine)
    Calibration.of(identify(machine, recording), recording, "joint").save(tmp_path / "cal.json")
    weight, moment = recording.wrench[:, [2, 4]].mean(axis=0).tolist()
    mass, com = -weight / 9.80665, [-moment / weight, 0.0, 0.1]
    (tmp_path / "two.yaml").write_text(
        f"name: two\nloads: [{{name: box, mass: {mass}, com: {com}}}]\n"
        "steps: [{step: any, kind: random, count: 2, margin: 0.3}]\n", encoding="utf-8")  # fmt: skip
    with simulated(tmp_path, "cell.yaml"):
        words = ["run", "two.yaml", "--site", "site.yaml", "--out", "two.db", "--calibration", "cal.json", "--json"]
        found = run(tmp_path, *words)
        assert found["measured"] == 2
        assert 0.01 < found["most_left_mm"] < 3
        assert 0.01 < found["most_left_mrad"] < 5
        at_tip = run(tmp_path, *words[:5], "tip.db", *words[6:], "--point", "tip")
        assert at_tip["most_left_mm"] != pytest.approx(found["most_left_mm"], abs=1e-3)
        said = run(tmp_path, *words[:5], "no.db", *words[6:-1], "--point", "nose", code=2)
        assert "--point: no point named 'nose'" in said
        for option in ("--point", "--after"):
            said = run(tmp_path, *words[:5], "no.db", option, "tip", code=2)
            assert f"{option}: has no meaning without --calibration" in said
        assert "most_left_mm" not in run(tmp_path, *words)  # nothing is left to do, so that nothing was corrected


def calibrate(folder: Path, name: str, effects: tuple[Effect, ...] = ()) -> Path:
    """A calibration of the machine in the hall, written there; returns its machine file."""
    found, start = identified(folder)
    replace(found, effects=effects, reference={"start": start, "hours": 2.0}).save(folder / name)
    return Path(found.machine.file)


@cache
def identified(folder: Path) -> tuple[Calibration, float]:
    """A calibration of the machine in the hall, and when its recording begins; as often as it is asked for, once."""
    machine = load_machine(ROOT / "machines/pps.yaml")
    plant = Plant.from_file(machine.file, seed=1)
    recording = load_recording(simulate_recording_csv(plant, folder / "r.csv", 90), machine)
    return Calibration.of(identify(machine, recording), recording, "joint"), float(recording.time[0])


def test_move_drives_to_the_corrected_setpoints_and_only_on_the_machine_that_stands_there(hall: Path) -> None:
    machine_file = calibrate(hall, "cal.json")
    wanted = ["--joints", "0.1 0.05 0.4 0.1 0 0", "--wrench", "0 -981 0 294 0 0", "--calibration", "cal.json"]
    for command in ("move", "compensate"):  # which without --site moves nothing
        found = run(hall, command, "--machine", "pps", "--site", "site.yaml", *wanted, "--json")
        assert found["reached"] == pytest.approx(found["setpoints"], abs=1e-6)
        assert found["reached"] != pytest.approx(found["nominal"], abs=1e-6)
    other = hall / "other.yaml"
    heavier = machine_file.read_text(encoding="utf-8").replace("mass: 680", "mass: 690")
    other.write_text(heavier, encoding="utf-8")  # not the one in the hall
    data = json.loads((hall / "cal.json").read_text(encoding="utf-8"))
    data["provenance"]["machine_sha256"] = load_machine(other).sha256
    (hall / "cal.json").write_text(json.dumps({**data, "content_sha256": content_digest(data)}), encoding="utf-8")
    line = run(hall, "move", "--machine", str(other), "--site", "site.yaml", *wanted, "--json", code=2)
    assert "machine 'pps'" in line
    assert "stands there, the calibration is for" in line


def test_a_site_that_does_not_answer_is_a_failed_run_not_bad_input(hall: Path) -> None:
    text = (hall / "site.yaml").read_text(encoding="utf-8")
    silent = "\n".join("  port: socket://127.0.0.1:9" if "port: socket" in line and line.startswith("  ") else line
                       for line in text.splitlines())  # fmt: skip
    (hall / "silent.yaml").write_text(silent, encoding="utf-8")
    line = run(hall, "run", "4.yaml", "--site", "silent.yaml", "--out", "silent.db", code=1)
    assert "tracker" in line
    assert not (hall / "silent.db").exists()


def test_a_tripped_drive_is_acknowledged_only_on_the_operator_s_word(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command line in this process, on the rig's own clock and ports."""
    monkeypatch.setattr("campaigns.site.open_bench", lambda site: open_bench(site, rig.clock, rig.hardware.ports))
    monkeypatch.setattr("campaigns.site.Site.make_operator", lambda site: rig.operator)
    words = ["run", rig.folder / "small.yaml", "--site", rig.folder / "site.yaml", "--out", rig.out, "--json"]
    FaultSchedule(rig.hardware, [Fault("yaw", "trip", 0x8611, at_s=30.0)])
    for _ in range(2):
        said = ppshw(*words)
        assert (said.code, said.out) == (1, "")
        assert one_line(said.err)
        assert "yaw: drive fault 0x8611, following error" in said.err
    assert json.loads(ppshw(*words, "--reset-faults").out)["done"] == 12


def test_a_corrected_run_goes_on_though_no_beam_was_ever_seen(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it did so far says from where the axes came, whatever was seen of it."""
    monkeypatch.setattr("campaigns.site.open_bench", lambda site: open_bench(site, rig.clock, rig.hardware.ports))
    monkeypatch.setattr("campaigns.site.Site.make_operator", lambda site: rig.operator)
    calibrate(rig.folder, "cal.json")
    loaded = SCRIPT.replace("{name: empty, mass: 0}, ", "").replace("COUNT", "4") + "on_lost_beam: skip\n"
    (rig.folder / "loaded.yaml").write_text(loaded, encoding="utf-8")
    words = ["run", rig.folder / "loaded.yaml", "--site", rig.folder / "site.yaml", "--out", rig.out, "--json"]
    words += ["--calibration", rig.folder / "cal.json"]
    rig.hardware.tracker.lose_beam()
    FaultSchedule(rig.hardware, [Fault("yaw", "trip", 0x8611, at_s=32.0)])
    assert "yaw: drive fault 0x8611" in ppshw(*words).err
    assert 0 < measured(rig.out) < 4
    found = json.loads(ppshw(*words, "--reset-faults").out)
    assert (found["done"], found["lost_beams"]) == (4, 3 * found["measured"])
