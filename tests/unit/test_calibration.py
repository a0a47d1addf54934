"""A calibration file says what was identified, where it holds and where it came from; and it comes back the same."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from ppshw import __version__
from ppshw.calibration import Calibration, content_digest, load_calibration
from ppshw.errors import CalibrationError
from ppshw.evaluation import residuals
from ppshw.identification import identify
from ppshw.machine import Machine, load_machine
from ppshw.recording import Recording, load_recording
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant
from tests.contract.desk import MACHINE

Made = tuple[Machine, Recording, Calibration, Path]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """The small cell with a tracker that nobody located and targets that are only roughly known."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "m.yaml").write_text(MACHINE + "  base: estimate\n  targets: estimate\n", encoding="utf-8")
    machine = load_machine(folder / "m.yaml")
    plant = Plant.from_file(folder / "m.yaml", seed=3)
    recording = load_recording(simulate_recording_csv(plant, folder / "r.csv", 80), machine)
    now = datetime(2026, 3, 5, 12, tzinfo=UTC)
    calibration = Calibration.of(identify(machine, recording), recording, "joint", now)
    calibration.save(folder / "cal.json")
    return machine, recording, calibration, folder / "cal.json"


def test_it_comes_back_as_it_was(made: Made) -> None:
    machine, recording, calibration, path = made
    back = load_calibration(path, machine)
    np.testing.assert_array_equal(back.theta, calibration.theta)
    np.testing.assert_array_equal(np.tril(back.covariance), np.tril(calibration.covariance))
    np.testing.assert_array_equal(back.covariance, back.covariance.T)
    np.testing.assert_array_equal(back.measuring_in_base, calibration.measuring_in_base)
    np.testing.assert_array_equal(back.machine.target_array, calibration.machine.target_array)
    np.testing.assert_array_equal(residuals(recording, back), residuals(recording, calibration))
    assert back.provenance == calibration.provenance
    back.save(path.with_name("again.json"))
    assert path.with_name("again.json").read_bytes() == path.read_bytes()
    assert not list(path.parent.glob("*.part"))


def test_noise_of_several_parts_comes_back_and_joints_alone_are_read_from_older_files(
    made: Made, tmp_path: Path
) -> None:
    machine, _, calibration, _ = made
    parts = np.linspace(1e-10, 2e-9, 6 * (1 + machine.n)).reshape(-1, 6)
    path = tmp_path / "cal.json"
    replace(calibration, noise=replace(calibration.noise, parts=parts)).save(path)
    np.testing.assert_array_equal(load_calibration(path, machine).noise.parts, parts)
    data = json.loads(path.read_text(encoding="utf-8"))
    del data["noise"]["end_effector"]
    data["content_sha256"] = content_digest(data)
    path.write_text(json.dumps(data), encoding="utf-8")
    np.testing.assert_array_equal(load_calibration(path, machine).noise.parts, np.vstack([np.zeros(6), parts[1:]]))


def test_a_base_frame_that_nobody_located_is_a_doubt_about_setpoints(made: Made) -> None:
    _, _, calibration, _ = made
    of_base, of_reflectors = calibration.doubts()
    assert of_base.startswith("where the tracker stood was estimated: poses are right relative to each other but for")
    assert of_reflectors.startswith("where the reflectors sit was estimated: what the end effector is off at every")
    located = replace(calibration.machine.tracker, base=np.eye(4), targets_known=True)
    machine = replace(calibration.machine, tracker=located)
    assert replace(calibration, model=replace(calibration.model, machine=machine)).doubts() == []
    alone = replace(machine, targets={"P1": next(iter(machine.targets.values()))})
    (of_one,) = replace(calibration, model=replace(calibration.model, machine=alone)).doubts()
    assert of_one.startswith("P1 is its only reflector")


def test_it_says_where_it_came_from_and_where_it_holds(made: Made) -> None:
    machine, recording, _, path = made
    data = json.loads(path.read_text(encoding="utf-8"))
    source = data["provenance"]
    assert source["machine_sha256"] == machine.sha256
    assert source["recording_sha256"] == recording.sha256
    assert (source["recording"], source["ppshw"], source["method"]) == ("r.csv", __version__, "joint")
    assert source["date"] == "2026-03-05T12:00:00+00:00"
    assert (source["visits"], source["readings"]) == (80, 240)
    assert data["valid"]["joints"]["rail"] == [recording.q[:, 0].min(), recording.q[:, 0].max()]
    assert data["valid"]["payload"]["Fz"] == [recording.wrench[:, 2].min(), recording.wrench[:, 2].max()]
    assert len(data["sampled"]["turn"]) > 60  # random poses: nearly every visit is a position of its own
    for term in data["terms"]:
        for parameter in term["parameters"]:
            assert set(parameter) == {"name", "value", "std", "unit"}
            assert parameter["std"] >= 0


def test_only_positions_that_were_used_widen_the_valid_range(made: Made) -> None:
    machine, recording, _, _ = made
    lost = recording.points.copy()
    end = int(np.argmax(recording.q[:, 0]))
    lost[end] = np.nan
    holed = replace(recording, points=lost)
    calibration = Calibration.of(identify(machine, holed), holed, "joint")
    assert calibration.joint_range[0, 1] == np.delete(recording.q[:, 0], end).max()


def test_visits_that_were_set_aside_widen_neither_range(made: Made) -> None:
    machine, recording, _, _ = made
    found = identify(machine, recording)
    end, heavy = int(np.argmax(recording.q[:, 0])), int(np.argmin(recording.wrench[:, 2]))
    weights = found.weights.copy()
    weights[[end, heavy]] = 0.3
    calibration = Calibration.of(replace(found, weights=weights), recording, "joint")
    kept = np.delete(np.arange(len(recording)), [end, heavy])
    assert calibration.joint_range[0, 1] == recording.q[kept, 0].max()
    assert calibration.payload_range[2, 0] == recording.wrench[kept, 2].min()


def test_it_says_between_which_temperatures_it_was_measured(made: Made, tmp_path: Path) -> None:
    machine, recording, _, _ = made
    rail = np.linspace(19.0, 23.5, len(recording))
    rail[[0, -1]] = np.nan
    warm = replace(recording, temperatures={"rail": rail, "dead": np.full(len(recording), np.nan)})
    Calibration.of(identify(machine, warm), warm, "joint").save(tmp_path / "warm.json")
    said = json.loads((tmp_path / "warm.json").read_text(encoding="utf-8"))["valid"]["temperatures"]
    assert said == {"rail": [rail[1], rail[-2]]}
    assert load_calibration(tmp_path / "warm.json", machine).temperature_range == {"rail": (rail[1], rail[-2])}


def test_another_machine_refuses_it_even_of_the_same_name(made: Made, tmp_path: Path) -> None:
    machine, _, _, path = made
    text = Path(machine.file).read_text(encoding="utf-8")
    (tmp_path / "m.yaml").write_text(text.replace("mass: 120", "mass: 121"), encoding="utf-8")
    said = r"made for machine 'cell' \(file \w{12}\), not for 'cell' \(.*m\.yaml.* changed since"
    with pytest.raises(CalibrationError, match=said):
        load_calibration(path, load_machine(tmp_path / "m.yaml"))


def test_a_changed_digit_is_noticed_and_another_layout_is_not(made: Made, tmp_path: Path) -> None:
    machine, _, calibration, path = made
    data = json.loads(path.read_text(encoding="utf-8"))
    (tmp_path / "flat.json").write_text(json.dumps(data), encoding="utf-8")
    np.testing.assert_array_equal(load_calibration(tmp_path / "flat.json", machine).theta, calibration.theta)
    data["terms"][0]["parameters"][0]["value"] += 1e-12
    (tmp_path / "flat.json").write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(CalibrationError, match="does not match its content_sha256"):
        load_calibration(tmp_path / "flat.json", machine)


def test_it_is_not_written_where_there_is_no_folder(made: Made, tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="nowhere does not exist"):
        made[2].save(tmp_path / "nowhere" / "cal.json")


def test_what_no_command_would_read_is_not_written(made: Made, tmp_path: Path) -> None:
    calibration = made[2]
    wide = replace(calibration, covariance=calibration.covariance * 1e60)
    said = r"cal\.json: not written, as no command would read it: covariance holds values that are not finite numbers"
    with pytest.raises(CalibrationError, match=said):
        wide.save(tmp_path / "cal.json")
    assert not list(tmp_path.iterdir())
