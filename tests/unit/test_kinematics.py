"""Forward kinematics and Jacobians, against products of scipy's rotations, hand calculations and finite differences."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ppshw.kinematics import (
    error_transforms,
    frames,
    joint_jacobian,
    point_jacobian,
    point_positions,
    tip_jacobian,
    tip_poses,
)
from ppshw.machine import Joint, Machine, TrackerModel, load_machine
from ppshw.transforms import rotation_vector

Array = NDArray[np.float64]
ROOT = Path(__file__).parents[2]
PPS, ARM6 = (load_machine(ROOT / f"machines/{name}.yaml") for name in ("pps", "arm6"))
HALF = 0.5 * np.pi


def homogeneous(rotation: Rotation, translation: Array) -> Array:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation.as_matrix(), translation
    return out


def product(machine: Machine, q: Array, errors: Array) -> Array:
    """A_0 E_0 A_1 E_1 … A_n E_n A_tip of one pose, written down as the paper has it   (eq. 5)."""

    def displaced(e: Array) -> Array:
        return homogeneous(Rotation.from_euler("ZYX", [e[5], e[4], e[3]]), e[:3])

    pose = displaced(errors[0])
    for joint, value, error in zip(machine.joints, q, errors[1:], strict=True):
        if joint.prismatic:
            motion = homogeneous(Rotation.identity(), value * joint.axis)
        else:
            motion = homogeneous(Rotation.from_rotvec(value * joint.axis), np.zeros(3))
        pose = pose @ joint.origin @ motion @ displaced(error)
    return np.asarray(pose @ machine.tip_in_link)


def twist(step: Array) -> Array:
    """The six elements of E_T − I that eq. (8) names."""
    return np.array([*step[:3, 3], step[2, 1], step[0, 2], step[1, 0]])


def reflectors(machine: Machine, q: Array, errors: Array | None = None) -> Array:
    return point_positions(machine, q, machine.target_array, errors)


def random_poses(machine: Machine, count: int, seed: int) -> Array:
    lower, upper = machine.limits()
    return np.random.default_rng(seed).uniform(lower, upper, (count, machine.n))


def random_machine(kinds: list[bool], seed: int) -> Machine:
    """A chain of prismatic (True) and revolute joints with any origins and axes; bodies and sensor as well."""
    rng = np.random.default_rng(seed)
    joints = []
    for k, prismatic in enumerate(kinds):
        axis = rng.normal(size=3)
        origin = homogeneous(Rotation.from_rotvec(rng.normal(size=3)), rng.normal(size=3))
        joints.append(
            Joint(f"j{k}", prismatic, origin, axis / np.linalg.norm(axis), None, rng.uniform(0, 50),
                  rng.normal(size=3), None)
        )  # fmt: skip
    tip, sensor = (homogeneous(Rotation.from_rotvec(rng.normal(size=3)), rng.normal(size=3)) for _ in range(2))
    targets = {f"T{k}": rng.normal(size=3) for k in range(3)}
    return Machine("random", rng.normal(size=3), tuple(joints), tip, targets, {}, sensor, None,
                   TrackerModel(2e-5, np.eye(4), True), "random.yaml", "")  # fmt: skip


chains = st.builds(random_machine, st.lists(st.booleans(), min_size=1, max_size=12), st.integers(0, 2**31))
seeds = st.integers(0, 2**31)


# Forward -----------------------------------------------------------------------------------------------------------
def test_the_positioner_at_home_stands_where_its_lengths_add_up() -> None:
    """y: 0.31 + 1.02 + 0.30 + 0.14 + 0.12 + 0.10 + 0.07; z: 0.10 + 0.60 + 0.25; all axes parallel."""
    tip = tip_poses(PPS, np.zeros(6))[0]
    assert tip[:3, 3] == pytest.approx([0.0, 2.06, 0.95])
    assert tip[:3, :3] == pytest.approx(np.eye(3))
    treatment = point_positions(PPS, np.zeros(6), PPS.point("treatment")[None])[0, 0]
    assert treatment == pytest.approx([0.0, 2.26, 2.05])


def test_yaw_by_a_quarter_turn_swings_the_couch_to_the_side() -> None:
    """About +Y, z goes to +x: the treatment point 1.10 m along z ends up 1.10 m along x of the yaw axis at z = 0.95."""
    q = np.array([0.2, 0.1, 0.3, HALF, 0, 0])
    treatment = point_positions(PPS, q, PPS.point("treatment")[None])[0, 0]
    assert treatment == pytest.approx([0.2 + 1.10, 2.26 + 0.1, 0.95 + 0.3])


def test_the_arm_reaches_forward_at_zero_and_up_when_the_shoulder_leans_back() -> None:
    """x: 0.25 + 0.35 + 0.85 + 0.12 + 0.15, z: 0.45 + 0.35 + 1.05 + 0.12; then turned by −90° at the shoulder."""
    assert tip_poses(ARM6, np.zeros(6))[0, :3, 3] == pytest.approx([1.72, 0, 1.97])
    tip = tip_poses(ARM6, np.array([0, -HALF, 0, 0, 0, 0]))[0]
    assert tip[:3, 3] == pytest.approx([0.25 - 1.17, 0, 0.80 + 1.47])
    assert tip[:3, 0] == pytest.approx([0, 0, 1])


@settings(deadline=None, max_examples=60)
@given(chains, seeds)
def test_any_chain_is_the_product_of_its_frames(machine: Machine, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, errors = rng.normal(size=(3, machine.n)), 0.1 * rng.normal(size=(3, machine.n + 1, 6))
    found = tip_poses(machine, q, errors)
    assert found == pytest.approx(np.array([product(machine, a, b) for a, b in zip(q, errors, strict=True)]))
    ideal = tip_poses(machine, q)
    assert ideal == pytest.approx(np.array([product(machine, a, 0 * b) for a, b in zip(q, errors, strict=True)]))


def test_an_error_matrix_turns_about_x_then_y_then_z() -> None:
    """The paper's E_i: Rz(ε6) Ry(ε5) Rx(ε4). X first: y goes to z by a quarter turn, then Y takes z to x."""
    e = error_transforms(np.array([1.0, 2.0, 3.0, HALF, HALF, 0.0]))
    assert e @ [0, 1, 0, 1] == pytest.approx([1 + 1, 2, 3, 1])


def test_small_errors_make_the_matrix_of_equation_7() -> None:
    a, b, c = 1e-5, -2e-5, 3e-5
    e = error_transforms(np.array([1e-3, 2e-3, 3e-3, a, b, c]))
    assert e == pytest.approx(np.array([[1, -c, b, 1e-3], [c, 1, -a, 2e-3], [-b, a, 1, 3e-3], [0, 0, 0, 1]]), abs=2e-9)


def error_jacobian(machine: Machine, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Eq. (12): (N, 6, 6(n+1))."""
    return tip_jacobian(frames(machine, q), tip_poses(machine, q)).reshape(-1, 6, 6 * (machine.n + 1))


# Jacobians ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("machine", [PPS, ARM6], ids=["pps", "arm6"])
def test_the_generalized_error_jacobian_is_the_derivative_of_the_exact_product(machine: Machine) -> None:
    """Eq. (12) against central differences of eq. (5); steps of 1e-6, so 1e-9 or so must agree."""
    poses = random_poses(machine, 5, 1)
    for q, jacobian in zip(poses, error_jacobian(machine, poses), strict=True):
        inverse = np.linalg.inv(product(machine, q, np.zeros((machine.n + 1, 6))))
        for k in range(6 * (machine.n + 1)):
            step = np.zeros(6 * (machine.n + 1))
            step[k] = 1e-6
            up, down = (product(machine, q, s * step.reshape(-1, 6)) for s in (1, -1))
            numeric = (twist(inverse @ up) - twist(inverse @ down)) / 2e-6
            assert jacobian[:, k] == pytest.approx(numeric, rel=1e-8, abs=2e-9)


@settings(deadline=None, max_examples=30)
@given(chains, seeds)
def test_so_it_is_for_any_chain(machine: Machine, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, small = rng.normal(size=machine.n), 1e-6 * rng.normal(size=(machine.n + 1, 6))
    inverse = np.linalg.inv(product(machine, q, 0 * small))
    exact = (twist(inverse @ product(machine, q, small)) - twist(inverse @ product(machine, q, -small))) / 2
    assert error_jacobian(machine, q)[0] @ small.ravel() == pytest.approx(exact, rel=1e-6, abs=1e-13)


@settings(deadline=None, max_examples=30)
@given(chains, seeds)
def test_points_move_with_errors_as_their_jacobian_says_even_far_from_zero(machine: Machine, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, errors = rng.normal(size=(1, machine.n)), 0.3 * rng.normal(size=(1, machine.n + 1, 6))
    step = 1e-6 * rng.normal(size=errors.shape)
    positions = reflectors(machine, q, errors)
    jacobian = point_jacobian(frames(machine, q, errors), positions, errors)[0].reshape(3, 3, -1)
    exact = (reflectors(machine, q, errors + step) - reflectors(machine, q, errors - step))[0] / 2
    assert jacobian @ step.ravel() == pytest.approx(exact, rel=1e-5, abs=1e-12)


@settings(deadline=None, max_examples=30)
@given(chains, seeds)
def test_points_move_with_joints_as_their_jacobian_says(machine: Machine, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, step = rng.normal(size=(1, machine.n)), 1e-6 * rng.normal(size=(1, machine.n))
    chain = frames(machine, q)
    jacobian = joint_jacobian(machine, chain, reflectors(machine, q))[0]
    exact = (reflectors(machine, q + step) - reflectors(machine, q - step))[0] / 2
    assert jacobian @ step[0] == pytest.approx(exact, rel=1e-5, abs=1e-12)


def test_an_error_of_the_base_is_seen_whole_and_one_of_the_tip_as_it_is() -> None:
    """At home the positioner's axes are parallel: the base turning about X moves the tip by −z along y, +y along z."""
    jacobian = error_jacobian(PPS, np.zeros(6))[0].reshape(6, 7, 6)
    assert jacobian[:, 0, 3] == pytest.approx([0, -0.95, 2.06, 1, 0, 0])  # x × (0, 2.06, 0.95)
    assert jacobian[:, 6, 3] == pytest.approx([0, 0, 0.07, 1, 0, 0])  # the tip is 0.07 above the last frame
    assert jacobian[:, 3, :3] == pytest.approx(np.eye(6)[:, :3])


@pytest.mark.parametrize("short", [0.0, 1e-13, 1e-9, 1e-6, 1e-3])
@pytest.mark.parametrize("axis", [[1, 0, 0], [0, -1, 0], [0.6, 0, -0.8], [-0.48, 0.6, 0.64]])
def test_a_rotation_vector_says_half_a_turn_too(axis: list[float], short: float) -> None:
    wanted = (np.pi - short) * np.array(axis)
    turned = Rotation.from_rotvec(wanted).as_matrix()
    found = rotation_vector(np.stack([turned, np.eye(3)]))
    assert Rotation.from_rotvec(found[0]).as_matrix() == pytest.approx(turned, abs=1e-9)
    assert np.linalg.norm(found[0]) == pytest.approx(np.pi - short, abs=1e-9)
    assert found[1].tolist() == [0.0, 0.0, 0.0]
