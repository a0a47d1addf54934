"""What is no error of a machine: found before any fit, named, and not allowed to spoil the rest."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ppshw.calibration import Calibration
from ppshw.diagnosis import diagnose
from ppshw.errors import IdentificationFailed, RecordingError
from ppshw.evaluation import evaluate, figures, residuals
from ppshw.identification import identify
from ppshw.identification.plausible import (
    doubts,
    is_another_machine,
    misread,
    refuse_frozen,
    rests_off,
    without_gross_errors,
)
from ppshw.kinematics import point_positions
from ppshw.machine import Machine, load_machine
from ppshw.machine import doubts as doubts_of_file
from ppshw.recording import Recording, load_recording
from ppshw.transforms import inverse
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant
from tests.contract.desk import MACHINE

FRAMES = {"the tracker's place is known": "", "nobody placed the tracker": "  base: estimate\n  targets: estimate\n"}


@pytest.fixture(params=FRAMES)
def measured(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Machine, Recording]:
    (tmp_path / "m.yaml").write_text(MACHINE + FRAMES[request.param], encoding="utf-8")
    machine, plant = load_machine(tmp_path / "m.yaml"), Plant.from_file(tmp_path / "m.yaml", seed=2)
    csv = simulate_recording_csv(plant, tmp_path / "r.csv", 90, np.random.default_rng(4), "mixed", loads=4)
    return machine, load_recording(csv, machine)


def test_a_good_recording_is_left_alone(measured: tuple[Machine, Recording]) -> None:
    machine, recording = measured
    kept, gross = without_gross_errors(machine, recording)
    assert not gross.any()
    np.testing.assert_array_equal(kept.points, recording.points)


def test_what_the_ideal_machine_would_have_been_read_at_is_no_measurement(measured: tuple[Machine, Recording]) -> None:
    """Without any noise a covariance had no inverse."""
    machine, recording = measured
    into = inverse(machine.tracker.frame)
    ideal = point_positions(machine, recording.q, machine.target_array) @ into[:3, :3].T + into[:3, 3]
    for command in (identify, diagnose):
        with pytest.raises(RecordingError, match="are within 10 nm of where the ideal 'cell' has them: computed"):
            command(machine, replace(recording, points=ideal))


@pytest.mark.parametrize("metres", [0.2, 20.0, 1e8])
def test_a_gross_reading_spoils_nothing_but_its_own_visit(measured: tuple[Machine, Recording], metres: float) -> None:
    """A beam on another reflector, a slipped point, a flipped bit: from centimetres to the moon."""
    machine, recording = measured
    points = recording.points.copy()
    points[4, 0, 0] += metres
    points[60, 2, 1] -= metres
    found = identify(machine, replace(recording, points=points))
    assert np.flatnonzero(found.weights < 0.5).tolist() == [4, 60]
    calibration = Calibration.of(found, recording, "joint")
    assert calibration.provenance["visits_down_weighted"] == 2
    assert figures(residuals(recording, calibration))["p98_6_mm"] < 0.2  # of the readings as they should have been


@pytest.mark.parametrize(("metres", "another"), [(0.09, False), (0.11, True)])
def test_from_a_tenth_of_a_metre_on_it_is_another_machine(metres: float, another: bool, tmp_path: Path) -> None:
    """Half a metre of travel: more than a tenth of it, too."""
    (tmp_path / "m.yaml").write_text(MACHINE, encoding="utf-8")
    machine, plant = load_machine(tmp_path / "m.yaml"), Plant.from_file(tmp_path / "m.yaml", seed=2)
    csv = simulate_recording_csv(plant, tmp_path / "r.csv", 90, np.random.default_rng(4), "mixed", loads=4)
    recording = load_recording(csv, machine)
    here_and_there = np.where(np.arange(90) % 2, metres, -metres)[:, None, None] * [0.0, 0.0, 1.0]
    assert is_another_machine(machine, replace(recording, points=recording.points + here_and_there)) is another


def test_visits_that_no_machine_explains_are_told_by_their_number_from_one(
    measured: tuple[Machine, Recording],
) -> None:
    machine, recording = measured
    points = recording.points.copy()
    points[0, 1, 2] += 3.0  # the first visit's
    points[-1, 0, 0] -= 3.0  # and the last one's
    assert evaluate(replace(recording, points=points), machine, None)["far_off"] == [1, len(recording)]
    assert evaluate(recording, machine, None)["far_off"] == []


def test_a_damaged_encoder_cell_is_no_travel(measured: tuple[Machine, Recording]) -> None:
    """Degrees in one cell: the waves of every function were laid over sixty radians."""
    machine, recording = measured
    q = recording.q.copy()
    q[50, 1] = 57.2958
    found = identify(machine, replace(recording, q=q))
    calibration = Calibration.of(found, replace(recording, q=q), "joint")
    assert calibration.joint_range[1].tolist() == [recording.q[:, 1].min(), recording.q[:, 1].max()]
    clean = Calibration.of(identify(machine, recording), recording, "joint")
    rms = [figures(residuals(recording, c))["rms_mm"] for c in (clean, calibration)]
    assert rms[1] < 1.03 * rms[0]


@pytest.mark.parametrize("factor", [4.0, 10.0, 100.0, -1.0])
def test_a_misread_wrench_spoils_nothing_but_its_own_visit(measured: tuple[Machine, Recording], factor: float) -> None:
    """Of a load that hangs there: such a row draws the compliances to itself and is fitted well."""
    machine, recording = measured
    one = int(np.argmax(np.abs(recording.wrench[:, 2])))
    wrench = recording.wrench.copy()
    wrench[one] *= factor
    spoilt = replace(recording, wrench=wrench)
    assert np.flatnonzero(misread(machine, spoilt)).tolist() == [one]
    assert not misread(machine, recording).any()
    found = identify(machine, spoilt)
    assert found.weights[one] < 1e-2
    calibration = Calibration.of(found, spoilt, "joint")
    others = np.delete(recording.wrench[:, 2], one)
    assert calibration.payload_range[2].tolist() == [others.min(), others.max()]
    (said,) = doubts(machine, spoilt)
    assert said == (
        f"the wrench read at 1 visit ({one + 1}) is not that of the load '{recording.load[one]}' at its other visits"
    )


def test_one_visit_at_another_tilt_is_not_misread_as_only_it_says_how_high_the_load_is(
    measured: tuple[Machine, Recording], tmp_path: Path
) -> None:
    """Another author's clean recording: a load that a sweep of a linear axis bore, and one pose that is tilted."""
    (tmp_path / "t.yaml").write_text(MACHINE.replace("axis: [0, 0, 1]", "axis: [0, 1, 0]"), encoding="utf-8")
    machine, recording = load_machine(tmp_path / "t.yaml"), measured[1]
    rng, n = np.random.default_rng(1), len(recording)
    tilt = np.where(np.arange(n) == 7, 0.05, 0.1)
    g = np.column_stack([9.80665 * np.sin(tilt), np.zeros(n), -9.80665 * np.cos(tilt)])  # in the sensor
    wrench = np.concatenate([60 * g, np.cross(60 * np.array([0.1, 0.0, 0.6]), g)], axis=1)
    wrench += rng.normal(0, [0.3, 0.3, 0.3, 0.05, 0.05, 0.05], (n, 6))
    q = np.column_stack([recording.q[:, 0], tilt])
    hung = replace(recording, q=q, wrench=wrench, load=("box",) * n)
    assert not misread(machine, hung).any()
    for column, off in ((0, 30.0), (3, 8.0), (5, 8.0)):  # what no height can do
        wrong = wrench.copy()
        wrong[7, column] += off
        assert np.flatnonzero(misread(machine, replace(hung, wrench=wrong))).tolist() == [7]


def test_loads_that_are_not_single_rows_or_have_no_label_are_not_misread(measured: tuple[Machine, Recording]) -> None:
    machine, recording = measured
    wrench = recording.wrench.copy()
    wrench[::7] *= 3.0  # two loads under one label
    assert not misread(machine, replace(recording, wrench=wrench)).any()
    wrench = recording.wrench.copy()
    wrench[5] *= 100.0
    assert not misread(machine, replace(recording, wrench=wrench, load=("",) * len(wrench))).any()


def test_millimetres_for_metres_are_another_machine(measured: tuple[Machine, Recording]) -> None:
    machine, recording = measured
    with pytest.raises(RecordingError, match=r"half of the targets .* \d+ m from where 'cell' should") as said:
        identify(machine, replace(recording, points=1e3 * recording.points))
    nobody_wrote_estimate = machine.tracker.base is not None
    assert ("or is `tracker.base: estimate` wanted there?" in str(said.value)) == nobody_wrote_estimate


@pytest.mark.parametrize("command", [identify, diagnose])
def test_an_instrument_that_froze_is_none_in_other_units(
    measured: tuple[Machine, Recording], command: Callable[[Machine, Recording], object]
) -> None:
    """All joints were in degrees then, of weight 1.00 (a reviewer's)."""
    machine, recording = measured
    stood = np.broadcast_to(recording.points[0], recording.points.shape)
    with pytest.raises(RecordingError, match=r"at the same place at all 90 visits, .* by up to [\d.]+ m: expected"):
        command(machine, replace(recording, points=stood))


@pytest.mark.parametrize("command", [identify, diagnose])
def test_an_encoder_that_froze_is_told_from_a_joint_that_stood_still(
    measured: tuple[Machine, Recording], command: Callable[[Machine, Recording], object]
) -> None:
    machine, recording = measured
    frozen = recording.q.copy()
    frozen[:, 0] = frozen[0, 0]
    name = machine.joint_names[0]
    with pytest.raises(RecordingError, match=rf"q_{name} is .* at all 90 visits, .* expected positions that change"):
        command(machine, replace(recording, q=frozen))
    # another setpoint for a joint that did stand still, as its encoder says, is no encoder that froze
    refuse_frozen(machine, replace(recording, q_cmd=recording.q_cmd, q=frozen, points=_of_poses(machine, frozen)))


def _of_poses(machine: Machine, q: NDArray[np.float64]) -> NDArray[np.float64]:
    into = inverse(machine.tracker.frame)
    return np.asarray(point_positions(machine, q, machine.target_array) @ into[:3, :3].T + into[:3, 3])


def test_what_cannot_be_determined_is_said(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text(MACHINE + FRAMES["nobody placed the tracker"], encoding="utf-8")
    machine, plant = load_machine(tmp_path / "m.yaml"), Plant.from_file(tmp_path / "m.yaml", seed=2)
    recording = load_recording(simulate_recording_csv(plant, tmp_path / "r.csv", 4), machine)
    with pytest.raises(IdentificationFailed, match="no target was measured"):
        identify(machine, replace(recording, points=np.full_like(recording.points, np.nan)))
    one = recording.points.copy()
    one[1:] = np.nan
    one[0, 1:] = np.nan
    with pytest.raises(IdentificationFailed, match="1 reading cannot place the measuring frame"):
        identify(machine, replace(recording, points=one))


def test_an_encoder_s_column_that_is_one_row_late_is_said(measured: tuple[Machine, Recording]) -> None:
    machine, recording = measured
    q = recording.q.copy()
    name = machine.joint_names[1]
    for rows, how in ((1, "late"), (-1, "early")):
        q[:, 1] = np.roll(recording.q_cmd[:, 1], rows)
        said = doubts(machine, replace(recording, q=q))
        assert len(said) == 1
        assert said[0].endswith(f"or more from q_cmd_{name}: is it one row {how}?")
    q[:, 1] = recording.q_cmd[:, 1] + 0.3 * np.ptp(q[:, 1]) * np.sin(np.arange(len(q)) ** 2)
    assert "do these columns belong together?" in doubts(machine, replace(recording, q=q))[0]


def test_of_a_joint_that_was_sent_to_one_place_nothing_is_far(measured: tuple[Machine, Recording]) -> None:
    machine, recording = measured
    assert doubts(machine, recording.subset(np.array([0]))) == []


def test_air_in_degrees_fahrenheit_is_asked_about(measured: tuple[Machine, Recording]) -> None:
    machine, recording = measured
    felt = {"air": np.full(len(recording), 70.0), "motor": np.full(len(recording), 70.0)}
    said = doubts(machine, replace(recording, temperatures=felt))
    assert said == ["temp_air_C reads 70 °C; is that degrees Fahrenheit?"]


def test_load_labels_that_say_nothing_of_the_weight_are_asked_about(measured: tuple[Machine, Recording]) -> None:
    machine, recording = measured
    labels = np.array([f"L{k % 4}" for k in range(len(recording))])
    weights = np.repeat(recording.wrench[:1] * 0.0, len(recording), axis=0)
    weights[:, 2] = -300.0 * np.random.default_rng(0).integers(1, 5, len(recording))
    said = doubts(machine, replace(recording, wrench=weights, load=tuple(labels)))
    assert any("differs as much under one load label as between them (L0, L1, L2 …)" in line for line in said)
    weights[:, 2] = -300.0 * (1 + np.arange(len(recording)) % 4)
    said = doubts(machine, replace(recording, wrench=weights, load=tuple(labels)))
    assert not any("load label" in line for line in said)


def test_settling_for_longer_than_there_was_time_is_asked_about(measured: tuple[Machine, Recording]) -> None:
    machine, recording = measured
    timed = replace(recording, time=1e9 + 60.0 * np.arange(len(recording)))
    for settled, asked in ((5000.0, True), (5.0, False)):
        said = doubts(machine, replace(timed, settle_s=np.full(len(recording), settled)))
        assert any("are these milliseconds?" in line for line in said) == asked
    still = replace(timed, q=np.repeat(recording.q[:1], len(recording), axis=0), settle_s=np.full(len(recording), 1e4))
    assert not any("are these milliseconds?" in line for line in doubts(machine, still))  # since it moved last


def test_loads_of_less_than_two_kilograms_are_asked_about(measured: tuple[Machine, Recording]) -> None:
    """All six columns in kilonewtons and kilonewton metres were creep of a joint with 0.95."""
    machine, recording = measured
    labels = tuple("box" if k % 2 else "couch" for k in range(len(recording)))
    said = doubts(machine, replace(recording, wrench=recording.wrench / 1000.0, load=labels))
    assert any("are Fx … Mz kilonewtons" in line for line in said)
    for other in (replace(recording, load=labels), replace(recording, wrench=0.0 * recording.wrench, load=labels),
                  replace(recording, wrench=recording.wrench / 1000.0, load=("box",) * len(recording))):  # fmt: skip
        assert not any("kilonewtons" in line for line in doubts(machine, other))


def test_an_axis_that_rests_off_where_it_was_sent_is_said_of_it(measured: tuple[Machine, Recording]) -> None:
    """Compensated setpoints were 0.3 mm off without a word (a reviewer's drive that droops)."""
    machine, recording = measured
    assert rests_off(machine, recording) == {}
    k = next(k for k, joint in enumerate(machine.joints) if joint.prismatic)
    name, sent = machine.joint_names[k], recording.q_cmd.copy()
    sent[:, k] += 3e-4
    droops = replace(recording, q_cmd=sent)
    (said,) = (line for line in doubts(machine, droops) if name in line)
    assert said.startswith(f"{name} rests -0.300 mm")
    calibration = Calibration.of(identify(machine, droops), droops, "joint")
    assert any(f"{name} rested -0.300 mm" in line for line in calibration.doubts())
    sent[:, k] -= 3e-4 - 4e-5  # a tenth of what the beam allows, and less
    assert rests_off(machine, replace(recording, q_cmd=sent)) == {}


def test_how_far_an_axis_that_rests_off_moves_is_said_by_all_reflectors_and_poses(
    measured: tuple[Machine, Recording],
) -> None:
    """Reflectors all round the last axis have their mean on it (a reviewer's flange: 0.25 mm unsaid)."""
    machine, recording = measured
    last = machine.joint_names[-1]
    end = np.linalg.inv(machine.tip_in_link)  # the last link frame in the end effector's
    axis = end[:3, :3] @ machine.joints[-1].axis
    across = np.cross(axis, np.roll(axis, 1))
    turns = Rotation.from_rotvec(np.array([[0.0], [2.0], [4.0]]) * np.pi / 3 * axis)
    around = replace(machine, targets=dict(zip(machine.targets, end[:3, 3] + 0.25 * turns.apply(across), strict=True)))
    sent = recording.q_cmd - np.eye(machine.n)[-1] * 1e-3
    assert rests_off(around, replace(recording, q_cmd=sent)).keys() == {last}


def test_a_joint_that_always_came_from_one_side_is_said_where_it_comes_from_the_other(
    measured: tuple[Machine, Recording],
) -> None:
    machine, recording = measured
    approach = recording.approach.copy()
    approach[:, 1] = 1
    oneside = replace(recording, approach=approach)
    found = identify(machine, oneside)
    calibration, name = Calibration.of(found, oneside, "joint"), machine.joint_names[1]
    assert calibration.provenance["one_side"] == {name: 1}
    comes = np.zeros(machine.n)
    for side, said in ((1.0, []), (0.0, ["may come in the other"]), (-2.0, ["comes in the other"])):
        comes[1] = side
        lines = calibration.other_sides(comes)
        assert [s in line for s, line in zip(said, lines, strict=True)] == [True] * len(said)
    assert "one_side" not in Calibration.of(found, recording, "joint").provenance


def test_a_reflector_whose_place_in_the_machine_file_is_wrong_is_named(tmp_path: Path) -> None:
    """Every visit is gross then, and none was left to be fitted."""
    (tmp_path / "m.yaml").write_text(MACHINE, encoding="utf-8")
    machine, plant = load_machine(tmp_path / "m.yaml"), Plant.from_file(tmp_path / "m.yaml", seed=2)
    csv = simulate_recording_csv(plant, tmp_path / "r.csv", 90, np.random.default_rng(4), "mixed", loads=4)
    recording, name = load_recording(csv, machine), list(machine.targets)[1]
    targets = {k: np.asarray(place) - (np.array([0.0, 0.24, 0.0]) if k == name else 0.0)
               for k, place in machine.targets.items()}  # fmt: skip
    with pytest.raises(RecordingError, match=rf"reflector '{name}' is 2\d\d mm from .*, at 90 of 90 visits") as said:
        without_gross_errors(machine.with_targets(targets), recording)
    by = re.search(r"by ([+-]\d+), ([+-]\d+), ([+-]\d+) mm", str(said.value))
    assert by is not None
    np.testing.assert_allclose([int(mm) for mm in by.groups()], [0, 240, 0], atol=15)


def test_readings_that_are_gross_at_most_visits_are_no_single_ones(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text(MACHINE, encoding="utf-8")
    machine, plant = load_machine(tmp_path / "m.yaml"), Plant.from_file(tmp_path / "m.yaml", seed=2)
    csv = simulate_recording_csv(plant, tmp_path / "r.csv", 90, np.random.default_rng(4), "mixed", loads=4)
    recording, rng = load_recording(csv, machine), np.random.default_rng(1)
    points = recording.points.copy()
    for visit in range(60):
        points[visit, rng.integers(points.shape[1])] += 3.0
    with pytest.raises(RecordingError, match="60 of 90 visits have a reading far from where the machine has the oth"):
        without_gross_errors(machine, replace(recording, points=points))


@pytest.mark.parametrize(
    ("odd", "said"),
    [
        (lambda m: replace(m, gravity=np.array([0.0, 0.0, -1.0])), "gravity is 1 m/s², expected 9.5 to 10.1"),
        (lambda m: replace(m, joints=(replace(m.joints[0], com=np.array([50.0, 300.0, 20.0])), *m.joints[1:])),
         r"com of joint 'rail' is 305 m off its frame, the whole machine reaches [\d.]+ m: are these millimetres\?"),
        (lambda m: replace(m, joints=(*m.joints[:1], replace(m.joints[1], mass=5.4e5))),
         r"mass of joint 'turn' is 5.4e\+05 kg: are these grams\?"),
        (lambda m: replace(m, repeatability=0.14), r"repeatability is 0.14 m: are these millimetres\?"),
        (lambda m: replace(m, tracker=replace(m.tracker, position_sigma=0.02)), "position_sigma is 0.02 m: are these"),
        (lambda m: replace(m, sensor_in_link=np.array([[1, 0, 0, 0], [0, 1, 0, 30], [0, 0, 1, 0], [0, 0, 0, 1.0]])),
         "the origin of force_sensor is 30 m off its frame"),
        (lambda m: replace(m, points={**m.points, "tip": np.array([0.0, 0.0, 0.5])}),
         "a point is called 'tip': --point tip, and no --point, mean that point, not the end-effector frame"),
    ],
)  # fmt: skip
def test_what_a_machine_file_can_hardly_mean_is_asked(
    tmp_path: Path, odd: Callable[[Machine], Machine], said: str
) -> None:
    """Each was taken without a line (a reviewer's)."""
    (tmp_path / "m.yaml").write_text(MACHINE, encoding="utf-8")
    machine = load_machine(tmp_path / "m.yaml")
    assert doubts_of_file(machine) == []
    found = doubts_of_file(odd(machine))
    assert len(found) == 1
    assert re.search(said, found[0])
