"""An end effector of fewer than six degrees of freedom: the point's position is put right, what stays is said."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ppshw.calibration import Calibration
from ppshw.compensation import Bounds, Compensator, Corrections
from ppshw.compensation.fast_setpoints import FastCompensator
from ppshw.compensation.inverse import nominal_joints
from ppshw.errors import CalibrationError, CompensationRefused
from ppshw.identification import identify
from ppshw.identification.noise import Noise
from ppshw.kinematics import tip_poses
from ppshw.machine import Machine, load_machine
from ppshw.model import Model
from ppshw.recording import Around, load_recording
from ppshw.terms.basis import Constant
from ppshw.terms.geometric import Geometric
from ppshw.transforms import from_xyz_rpy
from simulators.chain import link_poses
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant

Array = NDArray[np.float64]
NOTHING = np.zeros(6)
TIP = """
tip: {origin: {xyz: [0, 0, 0.1]}, targets: {P1: [0.3, 0, 0], P2: [-0.2, 0.2, 0], P3: [-0.2, -0.2, 0]}}
force_sensor: {origin: {xyz: [0, 0, 0.02]}}
tracker: {position_sigma: 2.0e-5}
gravity: [0, 0, -9.80665]
"""
X, Y, Z = "[1, 0, 0]", "[0, 1, 0]", "[0, 0, 1]"
GANTRY = [("x", "prismatic", X, 1.0), ("y", "prismatic", Y, 0.8), ("z", "prismatic", Z, 0.5)]
SCARA = [("a", "revolute", Z, 1.2), ("b", "revolute", Z, 1.2), ("c", "prismatic", Z, 0.3), ("d", "revolute", Z, 1.5)]
MILL = [*GANTRY, ("turn", "revolute", Z, 1.0), ("nod", "revolute", Y, 0.6)]
TWICE = [*GANTRY, ("turn", "revolute", Z, 1.0), ("again", "revolute", Z, 0.4), ("nod", "revolute", Y, 0.6)]


def machine(folder: Path, name: str, joints: list[tuple[str, str, str, float]]) -> Machine:
    text = f"name: {name}\njoints:\n"
    for k, (joint, kind, axis, reach) in enumerate(joints):
        ahead = "[0, 0, 0.5]" if name != "scara" or k == 0 else "[0.6, 0, 0.05]"
        text += (
            f"  - {{name: {joint}, type: {kind}, axis: {axis}, origin: {{xyz: {ahead}}}, link: {{mass: 80}},\n"
            f"     limits: {{lower: {-reach}, upper: {reach}, velocity: 0.1, acceleration: 0.1}},\n"
            "     elastic: {loads: [Fz, Mx, My], varies: false}}\n"
        )
    (folder / f"{name}.yaml").write_text(text + TIP, encoding="utf-8")
    return load_machine(folder / f"{name}.yaml")


@cache
def calibrated(name: str) -> tuple[Plant, Calibration]:
    """A machine that always arrives at the same place, measured at 200 visits with the tracker's noise."""
    with TemporaryDirectory() as folder:
        made = machine(Path(folder), name, {"gantry": GANTRY, "scara": SCARA, "mill": MILL, "twice": TWICE}[name])
        plant = Plant.from_file(made.file, seed=3, repeatability=0.0)
        csv = simulate_recording_csv(plant, Path(folder) / "r.csv", 200, np.random.default_rng(1), "mixed")
        recording = load_recording(csv, made)
    return plant, Calibration.of(identify(made, recording), recording, "joint")


def with_errors(made: Machine, errors: dict[int, list[float]]) -> Compensator:
    """Calibrated to constant errors (tx ty tz rx ry rz) [m, rad] behind some frames, for what can be done by hand."""
    terms = tuple(Geometric(frame, Constant()) for frame in errors)
    theta = np.concatenate([np.array(e, dtype=float) for e in errors.values()])
    low, high = made.limits()
    return Compensator(
        Calibration(
            Model(made, terms), theta, np.zeros((len(theta),) * 2), Noise(np.eye(6) * 1e-9, 2e-5), np.eye(4),
            np.stack([low, high], axis=1), np.zeros((6, 2)), {}, {},
        ),
        Bounds(travel=0.03, angle=3.0),
    )  # fmt: skip


# --- does it help? the plant says, which shares no code with the model -----------------------------------------------
@pytest.mark.parametrize("name", ["gantry", "scara", "mill", "twice"])
@pytest.mark.parametrize("point", ["tip", "P1"])
def test_the_named_point_of_the_real_machine_comes_where_it_should(name: str, point: str) -> None:
    plant, calibration = calibrated(name)
    compensator, rng = Compensator(calibration), np.random.default_rng(2)
    low, high = calibration.joint_range.T
    before, after = [], []
    poses = rng.uniform(low + 0.1 * (high - low), high - 0.1 * (high - low), (30, len(low)))
    for wanted, load in zip(poses, plant.random_loads(30, rng), strict=True):
        payload = plant.wrench(wanted, load)[0]
        try:
            found = compensator.for_joints(wanted, payload, point)
        except CompensationRefused:  # another load than in the recording, or a SCARA that is nearly stretched
            continue
        ideal = link_poses(plant.chain, wanted[None])[0, -1] @ plant.chain.tip
        at = np.append(calibration.machine.point(point), 1.0)
        for q, errors in ((wanted, before), (found.corrected, after)):
            real = plant.true_tip(q, load)[0]
            errors.append(((real - ideal) @ at)[:3])
        np.testing.assert_allclose(found.predicted_error, before[-1], atol=1e-4)
        assert np.abs(found.left[:3]).max() < 1e-6
        said = Rotation.from_matrix(real[:3, :3] @ ideal[:3, :3].T).as_rotvec()
        np.testing.assert_allclose(found.left[3:], said, atol=2e-4)
    size = [np.linalg.norm(errors, axis=1) * 1e3 for errors in (before, after)]
    assert len(after) >= 10
    assert np.median(size[0]) > 1.0
    assert size[1].max() < 0.1


def test_what_joints_are_left_over_turn_it_as_far_as_they_can() -> None:
    """Four joints of a SCARA put three coordinates and the heading right; the tilt stays as it was."""
    with TemporaryDirectory() as folder:
        made = machine(Path(folder), "scara", SCARA)
    compensator = with_errors(made, {4: [1e-3, 2e-3, 3e-3, 4e-4, 0, 5e-3]})
    found = compensator.for_joints(np.array([0.3, 0.4, 0.1, -0.7]), NOTHING, "P1")
    np.testing.assert_allclose(found.left[:3], 0, atol=1e-7)
    np.testing.assert_allclose(found.left[3:], [4e-4, 0, 0], atol=5e-6)  # the heading of this pose is 0
    assert found.corrected[:2].sum() + found.corrected[3] == pytest.approx(-5e-3, abs=1e-5)


def test_a_pose_is_corrected_for_the_point_that_was_asked_for(tmp_path: Path) -> None:
    """By hand: the tip is 1 mm off along x and turned by 1 mrad about z: P1, 0.3 m along x, is 0.3 mm off in y."""
    compensator = with_errors(machine(tmp_path, "gantry", GANTRY), {3: [1e-3, 0, 0, 0, 0, 1e-3]})
    at = np.array([0.2, 0.3, 1.7])
    for point, offset, correction in (("tip", 0.0, [-1e-3, 0, 0]), ("P1", 0.3, [-1e-3, -3e-4, 0])):
        found = compensator.for_pose(from_xyz_rpy(at, np.zeros(3)), NOTHING, point)
        np.testing.assert_allclose(found.nominal, [0.2 - offset, 0.3, 0.1], atol=1e-8)
        np.testing.assert_allclose(found.corrected - found.nominal, correction, atol=1e-6)
        np.testing.assert_allclose(found.left, [0, 0, 0, 0, 0, 1e-3], atol=1e-8)


def test_a_point_on_a_tables_axis_is_not_turned_to_its_place(tmp_path: Path) -> None:
    """By hand: what stands 2 mm beside its place across the rail stays there, and the table puts the heading right."""
    made = machine(tmp_path, "turner", [GANTRY[0], GANTRY[2], ("table", "revolute", Z, 3.0)])
    found = with_errors(made, {3: [1e-3, 2e-3, -1e-3, 0, 0, 3e-3]}).for_joints(np.array([0.2, 0.1, 0.0]), NOTHING)
    np.testing.assert_allclose(found.corrected - [0.2, 0.1, 0.0], [-1e-3, 1e-3, -3e-3], atol=1e-5)
    np.testing.assert_allclose(found.left, [0, 2e-3, 0, 0, 0, 0], atol=1e-5)


def test_a_wanted_pose_of_few_joints_may_be_written_with_four_decimals(tmp_path: Path) -> None:
    made = machine(tmp_path, "scara", SCARA)
    compensator, q = with_errors(made, {4: [1e-3, 0, 0, 0, 0, 0]}), np.array([0.31234, 0.44321, 0.12345, -0.71234])
    wanted = tip_poses(made, q)[0]
    exact = np.concatenate([wanted[:3, 3], Rotation.from_matrix(wanted[:3, :3]).as_euler("xyz")])
    found = compensator.for_pose(from_xyz_rpy(np.round(exact, 4)[:3], np.round(exact, 4)[3:]), NOTHING, near=q)
    np.testing.assert_allclose(found.nominal, q, atol=3e-4)
    assert np.abs(found.left[:3]).max() < 1e-7
    with pytest.raises(CompensationRefused, match="cannot be reached"):
        compensator.for_pose(from_xyz_rpy(exact[:3], exact[3:] + np.array([1e-3, 0, 0])), NOTHING, near=q)


def test_one_joint_goes_as_near_as_it_can_and_says_what_stays(tmp_path: Path) -> None:
    compensator = with_errors(machine(tmp_path, "one", GANTRY[2:]), {1: [1e-3, -5e-4, 2e-3, 0, 4e-4, 0]})
    found = compensator.for_joints(np.array([0.2]), NOTHING)
    # the tip stands 0.1 m above the frame that is turned by 0.4 mrad about y
    np.testing.assert_allclose(found.corrected, [0.198], atol=1e-6)
    np.testing.assert_allclose(found.left, [1.04e-3, -5e-4, 0, 0, 4e-4, 0], atol=1e-6)
    np.testing.assert_allclose(found.predicted_error, [1.04e-3, -5e-4, 2e-3], atol=1e-7)


# --- what is refused -------------------------------------------------------------------------------------------------
def test_a_correction_that_would_leave_more_than_none_is_refused(tmp_path: Path) -> None:
    """By hand: a rail that leans by 20 mrad to the side that its tip, 64 mm aside, ought to go to. Lowering it by the
    1 mm that it stands too high takes the tip another 0.02 mm away."""
    leaning = with_errors(machine(tmp_path, "one", GANTRY[2:]), {0: [-0.08, 0, 1.2e-3, 0, 0.02, 0]})
    with pytest.raises(CompensationRefused, match=r"^the correction would leave 'tip' 64 mm off, without it is 64 mm$"):
        leaning.for_joints(np.array([0.2]), NOTHING)


def test_a_stretched_arm_that_ought_to_reach_farther_is_refused(tmp_path: Path) -> None:
    """Its second link is 1 mm short; no bending of the nearly straight elbow makes up for that."""
    compensator = with_errors(machine(tmp_path, "scara", SCARA[:2]), {2: [-1e-3, 0, 0, 0, 0, 0]})
    with pytest.raises(CompensationRefused, match=r"were not found: 'scara' stands nearly stretched there"):
        compensator.for_joints(np.array([0.0, 0.01]), NOTHING, "P1")


def test_an_orientation_out_of_reach_is_refused_with_its_angle(tmp_path: Path) -> None:
    gantry = machine(tmp_path, "gantry", GANTRY)
    with pytest.raises(CompensationRefused, match=r"reached by 'gantry': the nearest .* miss it by 0 mm and 200 mrad$"):
        nominal_joints(gantry, from_xyz_rpy(np.array([0.2, 0.3, 1.7]), np.array([0.2, 0, 0])))
    with pytest.raises(CompensationRefused, match=r"by 0 mm and 0\.265 mrad$"):
        nominal_joints(gantry, from_xyz_rpy(np.array([0.2, 0.3, 1.7]), np.array([2.65e-4, 0, 0])))


def test_a_pose_upside_down_is_out_of_reach_of_a_gantry(tmp_path: Path) -> None:
    made = machine(tmp_path, "gantry", GANTRY)
    for rpy in ([np.pi, 0, 0], [0, 0, np.pi]):
        upside_down = from_xyz_rpy(np.array([0.1, 0.2, 1.6]), np.array(rpy))
        with pytest.raises(CompensationRefused, match=r"cannot be reached .* miss it by 0 mm and 3\.14 rad"):
            nominal_joints(made, upside_down)


def test_compiled_setpoints_are_for_whole_poses(tmp_path: Path) -> None:
    calibration = with_errors(machine(tmp_path, "gantry", GANTRY), {3: [1e-3, 0, 0, 0, 0, 1e-3]}).calibration
    with pytest.raises(CalibrationError, match=r"'gantry' move its end effector in 3 ways, .* all six: use Co"):
        FastCompensator(calibration)


# --- a run -----------------------------------------------------------------------------------------------------------
def test_a_run_says_the_most_that_stays(tmp_path: Path) -> None:
    correct = Corrections(with_errors(machine(tmp_path, "one", GANTRY[2:]), {1: [3e-3, -4e-3, 2e-3, 0, 4e-4, 0]}))
    for q in (0.1, 0.2):
        correct(np.array([q]), NOTHING, np.array([0.0]), Around())
    assert correct.left == pytest.approx((np.hypot(3.04e-3, 4e-3), 4e-4), abs=1e-6)


def test_a_run_brings_the_point_right_that_accuracy_is_asked_at(tmp_path: Path) -> None:
    """A gantry whose tool hung 0.43 m below its tip was corrected at the tip: of 9.94 mm at the tool 3.57 stayed."""
    text = Path(machine(tmp_path, "gantry", GANTRY).file).read_text(encoding="utf-8")
    (tmp_path / "gantry.yaml").write_text(
        text.replace("targets: {P1", "points: {tool: [0.3, 0, 0.1]}, targets: {P1"), encoding="utf-8"
    )
    made = load_machine(tmp_path / "gantry.yaml")
    assert made.where_it_counts == "tool"
    compensator, wanted = with_errors(made, {3: [1e-3, 0, 0, 0, 0, 1e-3]}), np.array([0.2, 0.3, 0.1])
    for point, there in ((None, [-1e-3, -3e-4, 0]), ("tip", [-1e-3, 0, 0]), ("P2", [-0.8e-3, 2e-4, 0])):
        found = Corrections(compensator, point=point)(wanted, NOTHING, wanted, Around())
        np.testing.assert_allclose(found - wanted, there, atol=1e-6)
