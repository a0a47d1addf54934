"""What scatters is learnt: of the end effector, or of every joint, whichever the recording speaks for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ppshw.identification.noise import Noise
from ppshw.identification.noise_fit import Form, Moments, choose, fit
from ppshw.kinematics import frames, point_jacobian
from ppshw.machine import load_machine
from simulators.plant import Plant

Array = NDArray[np.float64]
ARM = Path(__file__).parents[2] / "machines/arm6.yaml"
SIGMA = 2e-5
START = Noise(np.diag([4e-9] * 3 + [1e-9] * 3), 3e-5)


def levers_of(count: int, seed: int) -> Array:
    """(count, 9, 42) of an arm at random poses: the end effector in base axes, then the joints."""
    machine = load_machine(ARM)
    q = Plant.from_file(ARM, 1).random_poses(count, np.random.default_rng(seed))
    chain = frames(machine, q)
    tip = chain[:, -1] @ machine.tip_in_link
    points = np.einsum("nij,tj->nti", tip[:, :3, :3], machine.target_array) + tip[:, None, :3, 3]
    joints = point_jacobian(chain, points)[:, :, :, 1:].reshape(count, 9, 36)
    arms = points - tip[:, None, :3, 3]
    turns = np.cross(np.eye(3)[None, None], arms[:, :, None]).swapaxes(2, 3)  # ω × arm, column by column
    shifts = np.broadcast_to(np.eye(3), turns.shape)
    return np.concatenate([np.concatenate([shifts, turns], axis=3).reshape(count, 9, 6), joints], axis=2)


def moments_of(scatter: Array, columns: slice, count: int, seed: int) -> Moments:
    rng = np.random.default_rng(seed)
    levers = levers_of(count, seed)
    drawn = rng.normal(size=(count, len(scatter))) * scatter
    r = np.einsum("nik,nk->ni", levers[..., columns], drawn) + SIGMA * rng.normal(size=(count, 9))
    second = r[:, :, None] * r[:, None, :]
    own = load_machine(ARM).own_ways ** 2
    return Moments(levers, np.ones((count, 9), dtype=bool), second, np.ones(count), 0.0, 0.0, own)


def test_joints_that_scatter_differently_are_told_apart_on_an_arm() -> None:
    shifts, turns = np.array([2, 1, 1, 0.5, 0.5, 0.5]) * 3e-5, np.array([4, 1, 0.5, 0.5, 3, 0.5]) * 2e-5
    scatter = np.repeat(np.stack([shifts, turns], axis=1).ravel(), 3)
    form, noise = choose(moments_of(scatter, slice(6, None), 600, 3), START, 6)
    assert form is Form.JOINTS
    assert noise.parts is not None
    assert noise.instrument == pytest.approx(SIGMA, rel=0.05)
    assert np.sqrt(noise.parts[1, 3]) == pytest.approx(turns[0], rel=0.15)
    # the three axes of the wrist meet nearly in a point, so only together do their turns show
    assert np.sqrt(noise.parts[4:, 3].sum()) == pytest.approx(np.sqrt((turns[3:] ** 2).sum()), rel=0.15)


def test_drives_that_scatter_are_told_from_an_end_effector_that_does_besides() -> None:
    turns = np.array([1, 4, 0, 0, 6, 30]) * 1e-5  # of the last the reflectors are near the axis
    scatter = np.concatenate([np.repeat([3e-5, 5e-5], 3), np.ravel(turns[:, None] * load_machine(ARM).own_ways)])
    form, noise = choose(moments_of(scatter, slice(0, None), 450, 8), START, 6)
    assert form is Form.DRIVES
    assert noise.parts is not None
    assert noise.instrument == pytest.approx(SIGMA, rel=0.05)
    assert np.sqrt(noise.parts[0, [0, 3]]) == pytest.approx([3e-5, 5e-5], rel=0.15)
    found = np.sqrt((noise.parts[1:] * load_machine(ARM).own_ways ** 2).sum(axis=1))
    assert found[[1, 5]] == pytest.approx(turns[[1, 5]], rel=0.1)
    assert (noise.parts[1:].sum(axis=1) == noise.parts[1:] @ [0, 0, 0, 1, 1, 1]).all()  # no joint shifts here


def test_an_end_effector_that_scatters_the_same_everywhere_is_no_matter_of_joints() -> None:
    scatter = np.array([6, 2, 2, 1, 3, 1]) * 2e-5
    form, noise = choose(moments_of(scatter, slice(0, 6), 600, 4), START, 6)
    assert form is Form.TIP
    assert noise.parts is None
    found = np.sqrt(np.diag(noise.pose))
    assert found[:3] == pytest.approx(scatter[:3], rel=0.1)
    assert found[4] == pytest.approx(scatter[4], rel=0.25)  # targets 0.2 m apart show turns badly
    assert noise.instrument == pytest.approx(SIGMA, rel=0.05)


def test_forty_visits_are_no_reason_for_a_form_with_many_numbers() -> None:
    scatter = np.repeat([4e-5, 3e-5], 3)
    form, _ = choose(moments_of(scatter, slice(0, 6), 40, 5), START, 6)
    assert form is Form.EVEN


@pytest.mark.parametrize("form", Form)
def test_no_noise_that_is_learnt_is_less_likely_than_a_tenth_more_or_less_of_it(form: Form) -> None:
    """The scoring stops at a maximum, for a form that is right and for one that is not."""
    moments = moments_of(np.repeat([5e-5, 4e-5], 3), slice(0, 6), 300, 6)
    noise = fit(form, moments, START, 6)
    for factor in (0.9, 1.1):
        for pose, instrument in ((factor, 1.0), (1.0, factor)):
            parts = None if noise.parts is None else noise.parts * pose
            other = Noise(noise.pose * pose, noise.instrument * instrument, parts)
            assert moments.likelihood(other) < moments.likelihood(noise)


def test_the_noise_varies_with_the_pose_when_it_comes_from_joints() -> None:
    levers = levers_of(50, 7).reshape(50, 3, 3, 42)
    seen, whole = np.ones((50, 3), dtype=bool), np.ones(50)
    noise = Noise(np.eye(6) * 1e-9, SIGMA, np.concatenate([np.zeros((1, 6)), np.full((6, 6), 1e-9)]))
    varying = np.trace(noise.covariance(levers, seen, whole), axis1=1, axis2=2)
    assert varying.max() > 1.5 * varying.min()
    # who has no levers of the joints gets the mean
    plain = noise.covariance(levers[..., :6], seen, whole)
    assert plain == pytest.approx(Noise(noise.pose, SIGMA).covariance(levers, seen, whole))
