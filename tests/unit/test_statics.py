"""Wrenches on links: by hand on the positioner, and by virtual work on any chain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ppshw.kinematics import frames
from ppshw.machine import Joint, Machine, TrackerModel, load_machine
from ppshw.statics import link_wrenches

Array = NDArray[np.float64]
ROOT = Path(__file__).parents[2]
PPS = load_machine(ROOT / "machines/pps.yaml")
G = 9.80665


def place(rng: np.random.Generator) -> Array:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_rotvec(rng.normal(size=3)).as_matrix(), rng.normal(size=3)
    return out


def random_machine(kinds: list[bool], seed: int) -> Machine:
    rng = np.random.default_rng(seed)
    joints = []
    for k, prismatic in enumerate(kinds):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        joints.append(Joint(f"j{k}", prismatic, place(rng), axis, None, rng.uniform(1, 50), rng.normal(size=3), None))
    return Machine("random", rng.normal(size=3), tuple(joints), place(rng), {"P": np.zeros(3)}, {}, place(rng), None,
                   TrackerModel(2e-5, np.eye(4), True), "random.yaml", "")  # fmt: skip


def hanging(machine: Machine, chain: Array, mass: float, com: Array) -> Array:
    """What a load of this mass at com (sensor frame) applies to the sensor."""
    sensor = chain[0, -1] @ machine.sensor_in_link
    force = mass * sensor[:3, :3].T @ machine.gravity
    return np.concatenate([force, np.cross(com, force)])[None]


def test_every_link_of_the_positioner_carries_what_is_above_it() -> None:
    """100 kg, 0.5 m along the couch and 0.1 m to the left of the sensor, all joints at home."""
    chain = frames(PPS, np.zeros(6))
    wrench = link_wrenches(PPS, chain, hanging(PPS, chain, 100.0, np.array([0.1, 0.2, 0.5])))[0]
    masses = np.array([680, 450, 290, 75, 32, 28])
    for i in range(1, 7):
        assert wrench[i, 1] == pytest.approx(-G * (masses[i - 1 :].sum() + 100))
    assert wrench[0, 1] == pytest.approx(-G * (masses.sum() + 100))
    assert wrench[:, [0, 2]] == pytest.approx(np.zeros((7, 2)), abs=1e-9)
    # about the last frame: the load alone has a lever, (0.1, ·, 0.5): Mx = −z Fy, Mz = x Fy
    assert wrench[6, 3:] == pytest.approx([0.5 * G * 100, 0, -0.1 * G * 100])
    # about the longitudinal frame: yaw, roll, pitch and load 0.25 m ahead, its own body 0.45 m behind
    ahead = 0.25 * (75 + 32 + 28 + 100) + 0.5 * 100 - 0.45 * 290
    assert wrench[3, 3:] == pytest.approx([ahead * G, 0, -0.1 * G * 100])
    # about the vertical frame: what is beyond stands 0.60 m further on, its own body 0.06 m ahead
    ahead += 0.60 * (290 + 75 + 32 + 28 + 100) + 0.06 * 450
    assert wrench[2, 3] == pytest.approx(ahead * G)


def test_a_quarter_turn_of_yaw_makes_pitching_of_rolling() -> None:
    chain = frames(PPS, np.array([0, 0, 0, np.pi / 2, 0, 0]))
    wrench = link_wrenches(PPS, chain, hanging(PPS, chain, 100.0, np.array([0.0, 0.2, 0.5])))[0]
    assert wrench[4, 3:] == pytest.approx([0.5 * G * 100, 0, 0], abs=1e-9)  # turns with the couch
    assert wrench[3, 5] == pytest.approx(-0.5 * G * 100)  # the couch now points along +x: Mz = x Fy
    assert wrench[3, 3] == pytest.approx(G * (0.25 * (75 + 32 + 28 + 100) - 0.45 * 290))


def test_wrenches_add_up_and_nothing_weighs_nothing() -> None:
    rng = np.random.default_rng(0)
    chain = frames(PPS, rng.normal(size=(4, 6)))
    a, b = rng.normal(size=(2, 4, 6))
    none = np.zeros((4, 3))
    both = link_wrenches(PPS, chain, a, none) + link_wrenches(PPS, chain, b, none)
    assert link_wrenches(PPS, chain, a + b, none) == pytest.approx(both)
    assert link_wrenches(PPS, chain, 0 * a, none) == pytest.approx(np.zeros((4, 7, 6)))


@settings(deadline=None, max_examples=60)
@given(st.lists(st.booleans(), min_size=1, max_size=8), st.integers(0, 2**31))
def test_a_displacement_of_a_frame_does_the_work_of_its_wrench(kinds: list[bool], seed: int) -> None:
    """δ(Σ m g·r) = W_i · δε_i, over all bodies from joint i outwards and the load, by central differences."""
    machine, rng = random_machine(kinds, seed), np.random.default_rng(seed + 1)
    q, mass, com = rng.normal(size=(1, machine.n)), rng.uniform(1, 100), rng.normal(size=3)
    chain = frames(machine, q)
    wrench = link_wrenches(machine, chain, hanging(machine, chain, mass, com))[0]

    def work(errors: Array) -> float:
        moved = frames(machine, q, errors)[0]
        bodies = sum(
            joint.mass * machine.gravity @ (moved[k + 1, :3, :3] @ joint.com + moved[k + 1, :3, 3])
            for k, joint in enumerate(machine.joints)
        )
        at = (moved[-1] @ machine.sensor_in_link @ [*com, 1.0])[:3]
        return float(bodies + mass * machine.gravity @ at)

    for i in range(machine.n + 1):
        step = np.zeros((1, machine.n + 1, 6))
        step[0, i] = 1e-5 * rng.normal(size=6)
        size = np.abs(wrench[i]) @ np.abs(step[0, i])
        assert wrench[i] @ step[0, i] == pytest.approx((work(step) - work(-step)) / 2, abs=1e-6 * size)
