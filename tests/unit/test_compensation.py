"""Wanted pose and load → setpoints, judged by the plant, which shares no code with the model."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from ppshw.calibration import Calibration
from ppshw.compensation import Bounds, Compensator
from ppshw.compensation.hanging import Hanging
from ppshw.compensation.inverse import nominal_joints, solve_pose
from ppshw.errors import CompensationRefused, MachineFileError
from ppshw.identification import identify
from ppshw.kinematics import freedoms, tip_poses
from ppshw.machine import load_machine
from ppshw.recording import load_recording
from ppshw.statics import payload_at
from ppshw.transforms import from_xyz_rpy
from simulators.chain import link_poses
from simulators.offline import simulate_recording_csv
from simulators.plant import Load, Plant

Array = NDArray[np.float64]
MACHINES = Path(__file__).parents[2] / "machines"
PATIENT = np.array([0.0, -981.0, 0.0, 294.0, 0.0, 0.0])  # 100 kg, 0.3 m out along z; gravity is −y
POSE = np.array([0.1, -0.05, 0.5, 0.3, 0.01, -0.01])


@cache
def calibrated(name: str) -> tuple[Plant, Calibration]:
    """A machine that always arrives at the same place, measured at 260 visits under eight loads.

    The positioner without any noise; the arm with its tracker's 20 µm, because without noise the joint estimate makes
    use of offsets of nearly a metre that cancel each other along parallel axes.
    """
    plant = Plant.from_file(MACHINES / f"{name}.yaml", seed=11, repeatability=0.0)
    machine = load_machine(MACHINES / f"{name}.yaml")
    with TemporaryDirectory() as folder:
        csv = simulate_recording_csv(
            plant, Path(folder) / "r.csv", 260, np.random.default_rng(1), "mixed", visits_per_load=5,
            measurement_noise=name != "pps",
        )  # fmt: skip
        recording = load_recording(csv, machine)
    return plant, Calibration.of(identify(machine, recording), recording, "joint")


@pytest.fixture
def couch() -> Compensator:
    return Compensator(calibrated("pps")[1])


def moved(q: Array, joint: int, by: float) -> Array:
    out = q.copy()
    out[joint] += by
    return out


# --- does it help? ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("name", "without_mm"), [("pps", 3.0), ("arm6", 3.0)])
def test_the_loop_closes_on_the_plant(name: str, without_mm: float) -> None:
    """Sent to corrected setpoints, the treatment point of the real machine is where the ideal one would have it."""
    plant, calibration = calibrated(name)
    compensator, rng = Compensator(calibration), np.random.default_rng(2)
    low, high = calibration.joint_range.T
    inset = 0.1 * (high - low)
    before, after = [], []
    for wanted, load in zip(rng.uniform(low + inset, high - inset, (40, 6)), plant.random_loads(40, rng), strict=True):
        ideal = plant.nominal_points(wanted, ["treatment"])["treatment"][0]
        try:
            setpoints = compensator.for_joints(wanted, plant.wrench(wanted, load)[0])
        except CompensationRefused:  # a load that the eight of the recording do not span
            continue
        for q, errors in ((wanted, before), (setpoints.corrected, after)):
            errors.append(plant.true_points(q, load, names=["treatment"])["treatment"][0] - ideal)
    assert len(after) >= 20
    size = [np.linalg.norm(errors, axis=1).max() * 1e3 for errors in (before, after)]
    assert size[0] > without_mm
    assert size[1] < 0.1


def test_pose_and_joints_are_two_ways_to_ask_for_the_same(couch: Compensator) -> None:
    by_joints = couch.for_joints(POSE, PATIENT, "treatment")
    machine = couch.machine
    tip, _ = pose_of(POSE)
    at_point = tip @ from_xyz_rpy(machine.point("treatment"), np.zeros(3))
    by_pose = couch.for_pose(at_point, PATIENT, "treatment", near=POSE)
    np.testing.assert_allclose(by_pose.nominal, POSE, atol=1e-6)
    np.testing.assert_allclose(by_pose.corrected, by_joints.corrected, atol=1e-6)


def pose_of(q: Array) -> tuple[Array, Array]:
    """The nominal end-effector frame, by the simulators' own kinematics."""
    plant, _ = calibrated("pps")
    tip = link_poses(plant.chain, q[None])[0, -1] @ plant.chain.tip
    return tip, q


def test_which_point_is_asked_for_changes_the_prediction_and_not_the_setpoints(couch: Compensator) -> None:
    """The whole frame is put right, so it is right at every point of the couch."""
    found = {point: couch.for_joints(POSE, PATIENT, point) for point in ("tip", "treatment", "P1")}
    for one in found.values():
        np.testing.assert_allclose(one.corrected, found["tip"].corrected, atol=1e-9)
    lengths = {point: np.linalg.norm(one.predicted_error) for point, one in found.items()}
    assert lengths["treatment"] > 1.2 * lengths["tip"]  # 0.85 m further out on the couch


def test_a_target_is_brought_where_it_is_wanted_though_the_file_has_it_elsewhere(tmp_path: Path) -> None:
    """`targets: estimate`: the file's P1 is a start, 3 mm off."""
    plant = Plant.from_file(MACHINES / "pps.yaml", seed=11, repeatability=0.0)
    file = yaml.safe_load((MACHINES / "pps.yaml").read_text(encoding="utf-8"))
    file["tracker"]["targets"] = "estimate"
    file["tip"]["targets"]["P1"][0] += 3e-3
    (tmp_path / "machine.yaml").write_text(yaml.safe_dump(file), encoding="utf-8")
    machine = load_machine(tmp_path / "machine.yaml")
    csv = simulate_recording_csv(plant, tmp_path / "r.csv", 80, np.random.default_rng(1), "mixed", visits_per_load=5)
    recording = load_recording(csv, machine)
    compensator = Compensator(Calibration.of(identify(machine, recording), recording, "joint"))
    tip, _ = pose_of(POSE)
    wanted = tip @ from_xyz_rpy(np.array([0.1, 0.0, 0.05]), np.zeros(3))
    found = compensator.for_pose(wanted, PATIENT, "P1", near=POSE)
    real = plant.true_points(found.corrected, PATIENT, names=["P1"])["P1"][0]
    assert np.linalg.norm(real - wanted[:3, 3]) < 3e-4
    # how unsure its place is goes with how unsure the end effector is: both together are what the reflector was read to
    assert np.linalg.norm(real - wanted[:3, 3]) / 3 < np.linalg.norm(found.std) < 1e-4
    with pytest.raises(MachineFileError, match="no point named 'P9'"):
        compensator.for_pose(wanted, PATIENT, "P9", near=POSE)


def test_a_target_that_was_never_read_is_as_unsure_as_it_was_built(tmp_path: Path) -> None:
    file = yaml.safe_load((MACHINES / "pps.yaml").read_text(encoding="utf-8"))
    file["tracker"]["targets"] = "estimate"
    for k, at in enumerate(file["tip"]["targets"].values()):
        at[k] += 2e-3
    (tmp_path / "machine.yaml").write_text(yaml.safe_dump(file), encoding="utf-8")
    machine = load_machine(tmp_path / "machine.yaml")
    plant = Plant.from_file(MACHINES / "pps.yaml", seed=11)
    csv = simulate_recording_csv(plant, tmp_path / "r.csv", 60, np.random.default_rng(1), "mixed", visits_per_load=5)
    recording = load_recording(csv, machine)
    recording.points[:, 2] = np.nan
    calibration = Calibration.of(identify(machine, recording), recording, "joint")
    assert "P3 was never read: taken to sit as built" in calibration.doubts()
    assert any(said.startswith("the reflectors that were read (P1, P2) lie on a line") for said in calibration.doubts())
    compensator = Compensator(calibration)
    read, never = (np.linalg.norm(compensator.for_joints(POSE, PATIENT, name).std) for name in ("P1", "P3"))
    assert never > 5e-4 > 5 * read


def test_the_predicted_error_is_the_plant_s(couch: Compensator) -> None:
    plant, _ = calibrated("pps")
    found = couch.for_joints(POSE, PATIENT, "treatment")
    true = plant.true_points(POSE, PATIENT, names=["treatment"])["treatment"]
    ideal = plant.nominal_points(POSE, ["treatment"])["treatment"]
    np.testing.assert_allclose(found.predicted_error, (true - ideal)[0], atol=1e-4)
    assert 0 < np.linalg.norm(found.std) < 1e-4


def test_of_several_ways_to_reach_a_pose_the_nearest_is_taken() -> None:
    """An arm reaches a pose with its wrist turned either way: half a turn of the forearm, wrist bent the other way."""
    machine = load_machine(MACHINES / "arm6.yaml")
    plant = Plant.from_file(machine.file)
    q = np.array([0.2, 0.3, -0.4, 0.9, 0.8, -0.5])
    tip = link_poses(plant.chain, q[None])[0, -1] @ plant.chain.tip
    other = np.array([0.2, 0.3, -0.4, 0.9 - np.pi, -0.8, -0.5 + np.pi])
    np.testing.assert_allclose(nominal_joints(machine, tip, near=q), q, atol=1e-6)
    np.testing.assert_allclose(nominal_joints(machine, tip, near=other), other, atol=1e-6)


def test_of_whole_turns_the_nearest_is_taken_and_the_next_where_a_limit_is_in_the_way() -> None:
    machine = load_machine(MACHINES / "real" / "ur5.yaml")  # every joint makes a turn to either side
    q = np.array([4.5, -1.0, 1.2, -0.7, 1.1, 3.5])
    tip = tip_poses(machine, q[None])[0]
    np.testing.assert_allclose(nominal_joints(machine, tip, near=q), q, atol=1e-6)
    turn = np.array([2 * np.pi, 0, 0, 0, 0, 2 * np.pi])
    np.testing.assert_allclose(nominal_joints(machine, tip, near=q - turn), q - turn, atol=1e-6)
    short = [replace(j, limits=replace(j.limits, lower=-3.2, upper=3.2)) for j in machine.joints]  # hardly any choice
    found = nominal_joints(replace(machine, joints=tuple(short)), tip, near=q)
    assert np.abs(found).max() < 3.2
    np.testing.assert_allclose(tip_poses(machine, found[None])[0], tip, atol=1e-6)


def test_a_rail_that_lies_beyond_half_a_turn_of_metres_is_a_rail() -> None:
    machine = load_machine(MACHINES / "pps.yaml")
    rail = replace(machine.joints[0], limits=replace(machine.joints[0].limits, lower=4.0, upper=8.0))
    far = replace(machine, joints=(rail, *machine.joints[1:]))
    assert freedoms(far) == freedoms(machine)
    q = np.array([7.5, 0.0, 0.9, 0.3, 0.0, 0.0])
    np.testing.assert_allclose(nominal_joints(far, tip_poses(far, q[None])[0]), q, atol=1e-6)


def test_many_poses_are_solved_at_once() -> None:
    machine = load_machine(MACHINES / "pps.yaml")
    plant = Plant.from_file(machine.file)
    q = plant.random_poses(200, np.random.default_rng(3))
    tips = link_poses(plant.chain, q)[:, -1] @ plant.chain.tip
    found, left = solve_pose(machine, tips, np.tile([0, 0, 0.7, 0, 0, 0], (200, 1)))
    np.testing.assert_allclose(found, q, atol=1e-6)
    assert np.abs(left).max() < 1e-6


# --- what the sensor will read elsewhere -----------------------------------------------------------------------------
def test_a_payload_s_wrench_turns_with_the_sensor() -> None:
    """Exact where its centre lies on the line nearest to the sensor; the plant weighs it at both poses."""
    plant, machine = Plant.from_file(MACHINES / "pps.yaml"), load_machine(MACHINES / "pps.yaml")
    box = Load(80.0, np.array([0.1, 0.0, 0.3]))
    here, there = np.zeros(6), np.array([0.4, 0.1, 0.9, 1.2, 0.0, 0.0])
    expected = plant.wrench(there, box)[0]
    np.testing.assert_allclose(payload_at(machine, plant.wrench(here, box)[0], here, there), expected, atol=1e-6)
    tilted = moved(there, 4, 0.05)
    found = payload_at(machine, plant.wrench(here, box)[0], here, tilted)
    # 785 N, 0.05 rad: the side force is 39 N; the height of the centre, which one reading cannot tell, is zero here
    np.testing.assert_allclose(found, plant.wrench(tilted, box)[0], atol=0.5)
    assert abs(found[0]) + abs(found[2]) > 35


def test_a_sensor_that_was_only_moved_or_turned_about_the_vertical_reads_what_it_read() -> None:
    """Moved it may be pushed aside as well; turned, also what no weight does: a cable that comes along and is twisted
    by 12 N m."""
    machine = load_machine(MACHINES / "pps.yaml")
    moved_only, turned = np.array([0.4, 0.1, 0.9, 0.0, 0.0, 0.0]), np.array([-0.3, 0.0, 0.2, 1.2, 0.0, 0.0])
    for there, read in ((moved_only, [30.0, -785.0, 10.0, 235.0, 12.0, -78.0]),
                        (turned, [0.0, -785.0, 0.0, 235.0, 12.0, -78.0])):  # fmt: skip
        np.testing.assert_allclose(payload_at(machine, np.array(read), np.zeros(6), there), read, atol=1e-9)


def test_two_readings_of_a_load_tell_where_its_centre_lies_and_one_in_its_place_nothing_of_it() -> None:
    plant, machine = Plant.from_file(MACHINES / "arm6.yaml"), load_machine(MACHINES / "arm6.yaml")
    box, other = Load(40.0, np.array([0.05, -0.1, 0.4])), Load(90.0, np.array([-0.2, 0.1, 0.1]))
    first, second, there = plant.random_poses(3, np.random.default_rng(5))

    def misses(hanging: Hanging, load: Load, here: Array, label: str = "box") -> float:
        found = hanging.at(label, plant.wrench(here, load)[0], here, there)
        return float(np.abs(found - plant.wrench(there, load)[0])[3:].max())

    by_one, one = misses(Hanging(machine), box, first), Hanging(machine)
    assert misses(one, box, first) == by_one > 20.0  # N m
    assert misses(one, box, second) < 0.1
    assert misses(one, box, first) < 0.1
    # put on anew, under its label or another, it may sit otherwise; another load under its label is another
    assert misses(one, box, first, "again") == by_one
    assert misses(one, other, second, "again") == misses(Hanging(machine), other, second) > 20.0
    one = Hanging(machine)
    cable = np.array([3.0, 0.0, 0.0, 0.0, 2.0, 0.0])  # what the sensor reads beside the load stays with it
    for here in (first, second, first):
        found = one.at("box", plant.wrench(here, box)[0] + cable, here, there)
    np.testing.assert_allclose(found, plant.wrench(there, box)[0] + cable, atol=4.0)


def test_without_payload_there_is_none_anywhere() -> None:
    machine = load_machine(MACHINES / "pps.yaml")
    np.testing.assert_array_equal(payload_at(machine, np.zeros(6), np.zeros(6), POSE), np.zeros(6))


# --- what is refused -------------------------------------------------------------------------------------------------
def test_a_pose_out_of_reach_is_refused() -> None:
    machine = load_machine(MACHINES / "arm6.yaml")
    with pytest.raises(CompensationRefused, match=r"by 'arm6': the nearest .* miss it by [\d.]+ m and [\d.]+ m?rad$"):
        nominal_joints(machine, from_xyz_rpy(np.array([0, 0, 9.0]), np.zeros(3)))


def test_a_pose_beyond_a_limit_is_refused_with_joint_and_amount(couch: Compensator) -> None:
    tip, _ = pose_of(moved(POSE, 0, 1.125))  # 0.1 m beyond 1.125 m
    with pytest.raises(CompensationRefused, match=r"the pose needs joint 'lateral' 0\.1 m beyond its limits"):
        couch.for_pose(tip, PATIENT)


def test_a_joint_value_outside_what_was_identified_is_refused(couch: Compensator) -> None:
    narrow = replace(couch.calibration, joint_range=couch.calibration.joint_range * [[0.5, 0.5]])
    with pytest.raises(CompensationRefused, match=r"joint 'lateral' at 0\.9 m is outside what was identified, -0\."):
        Compensator(narrow).for_joints(moved(POSE, 0, 0.8), PATIENT)


def test_a_little_outside_is_carried_on_to_and_as_far_as_somebody_says(couch: Compensator) -> None:
    """A payload that was identified comes to lie otherwise: 6 of 100 held-out visits of the arm's example did."""
    low, high = couch.calibration.payload_range[0]
    load = PATIENT.copy()
    load[0] = high + 0.09 * (high - low)
    assert couch.for_joints(POSE, load).std.max() > couch.for_joints(POSE, PATIENT).std.max()
    (said,) = couch.calibration.outside(POSE, load)
    assert said.startswith(f"load Fx = {load[0]:.6g} N is outside what was identified")
    load[0] = high + 0.5 * (high - low) + 4.9
    with pytest.raises(CompensationRefused, match="load Fx"):
        couch.for_joints(POSE, load)
    Compensator(couch.calibration, Bounds(loads=0.5)).for_joints(POSE, load)


@pytest.mark.parametrize(
    ("k", "value", "text"),
    [(1, -3000.0, "load Fy = -3000 N"), (3, 2000.0, "load Mx = 2000 N m"), (0, 500.0, "load Fx = 500 N")],
)
def test_a_load_outside_what_was_identified_is_refused(couch: Compensator, k: int, value: float, text: str) -> None:
    load = PATIENT.copy()
    load[k] = value
    with pytest.raises(CompensationRefused, match=text + " is outside what was identified"):
        couch.for_joints(POSE, load)


def test_a_correction_larger_than_its_bound_is_refused() -> None:
    _, calibration = calibrated("pps")
    with pytest.raises(CompensationRefused, match=r"joint '\w+' would be corrected by \S+ m, the bound is 1e-05"):
        Compensator(calibration, Bounds(travel=1e-5)).for_joints(POSE, PATIENT)
    with pytest.raises(CompensationRefused, match=r"joint '\w+' would be corrected by \S+ rad, the bound is 1e-06"):
        Compensator(calibration, Bounds(angle=1e-6)).for_joints(POSE, PATIENT)


def test_a_corrected_setpoint_beyond_a_limit_is_refused_not_clipped() -> None:
    """At the very end of the travel, on the side where the correction points outwards."""
    _, calibration = calibrated("pps")
    lower, upper = calibration.machine.limits()
    couch = Compensator(calibration, Bounds(joints=0.1))
    refusals = []
    for end in (lower, upper):
        wanted = POSE.copy()
        wanted[1] = end[1]
        try:
            found = couch.for_joints(wanted, PATIENT)
        except CompensationRefused as refused:
            refusals.append(str(refused))
        else:
            assert (lower <= found.corrected).all()
            assert (found.corrected <= upper).all()
    assert len(refusals) == 1
    assert refusals[0].startswith("corrected setpoint of joint 'vertical' ")
    assert "is beyond its limits -0.28 … 0.28" in refusals[0]
