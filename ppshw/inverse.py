"""Joint values for a wanted pose, of the ideal machine or of a calibrated one, by Newton's method."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ppshw.calibration import Calibration
from ppshw.errors import CompensationRefused
from ppshw.kinematics import frames, joint_jacobian, tip_poses
from ppshw.machine import Machine
from ppshw.quantities import distance, rounded
from ppshw.terms import Situation
from ppshw.transforms import rotation_vector

Array = NDArray[np.float64]
# Reached when no residual is larger: micrometres and microradians are far below any repeatability.
POSITION_TOLERANCE, ROTATION_TOLERANCE = 1e-7, 1e-7
# (q (1, n), the base model's errors (1, n+1, 6) and wrenches there) → errors of effects beyond it
EffectErrors = Callable[[Array, Array, Array], Array]


def solve_pose(
    machine: Machine,
    wanted_tip: Array,
    start: Array,
    calibration: Calibration | None = None,
    payload: Array | None = None,
    effects: EffectErrors | None = None,
) -> tuple[Array, Array]:
    """Joint values at which the end-effector frame stands at `wanted_tip`, by Newton's method, vectorised.

    wanted_tip  (N, 4, 4) in the base;  start (N, n);  payload (N, 6) on the sensor (with a calibration)
    calibration None: the ideal machine
    effects     errors beyond the calibration's base model, for one pose (N = 1)
    returns     (N, n) joint values, (N, 6) what is left [m, rad]; not converged where that is large
    """
    q = np.array(start, dtype=float)
    point = np.zeros((1, 3))
    left = np.zeros((len(q), 6))
    for _ in range(30):
        if calibration is None:
            tip, chain = tip_poses(machine, q), frames(machine, q)
        else:
            assert payload is not None
            errors, wrenches = calibration.model.errors(Situation(q, payload), calibration.theta)
            if effects is not None:
                errors = errors + effects(q, errors, wrenches)
            chain = frames(machine, q, errors)
            tip = chain[:, -1] @ machine.tip_in_link
        left[:, :3] = wanted_tip[:, :3, 3] - tip[:, :3, 3]
        left[:, 3:] = rotation_vector(wanted_tip[:, :3, :3] @ np.swapaxes(tip[:, :3, :3], 1, 2))
        if np.abs(left[:, :3]).max() < POSITION_TOLERANCE and np.abs(left[:, 3:]).max() < ROTATION_TOLERANCE:
            break
        jacobian = np.empty((len(q), 6, machine.n))
        jacobian[:, :3] = joint_jacobian(machine, chain, tip[:, None, :3, 3] + point)[:, 0]
        for k, joint in enumerate(machine.joints):
            axis = chain[:, k + 1, :3, :3] @ joint.axis
            jacobian[:, 3:, k] = 0.0 if joint.prismatic else axis
        # A little damping keeps the step finite near singular poses and vanishes as the residual does.
        square = np.swapaxes(jacobian, 1, 2) @ jacobian
        damping = 1e-12 + 1e-4 * np.minimum(1.0, (left**2).sum(axis=1))
        square[:, np.arange(machine.n), np.arange(machine.n)] += damping[:, None]
        step = np.linalg.solve(square, np.einsum("nij,ni->nj", jacobian, left)[..., None])[..., 0]
        largest = np.abs(step).max(axis=1, keepdims=True)
        q = q + step * np.minimum(1.0, 0.5 / np.maximum(largest, 1e-12))
    return q, left


def nominal_joints(machine: Machine, wanted_tip: Array, near: Array | None = None) -> Array:
    """The ideal machine's joint values for one pose (4, 4): within limits, nearest to `near` (default mid-travel).

    Newton's method from many starts spread over the travel. Raises CompensationRefused when none reaches the pose.
    """
    lower, upper = machine.limits()
    low, high = np.maximum(lower, -np.pi), np.minimum(upper, np.pi)
    centre = (low + high) / 2 if near is None else np.asarray(near, dtype=float)
    starts = np.random.default_rng(0).uniform(low, high, (200, machine.n))
    starts[0] = centre
    q, left = solve_pose(machine, np.broadcast_to(wanted_tip, (len(starts), 4, 4)), starts)
    for k, joint in enumerate(machine.joints):
        if not joint.prismatic:  # whole turns: the one nearest to the middle of the travel
            middle = (lower[k] + upper[k]) / 2 if np.isfinite(lower[k] + upper[k]) else 0.0
            q[:, k] = middle + (q[:, k] - middle + np.pi) % (2 * np.pi) - np.pi
    reached = (np.abs(left) < 1e-6).all(axis=1)
    if not reached.any():
        nearest = distance(np.linalg.norm(left[:, :3], axis=1).min())
        raise CompensationRefused(
            f"the pose cannot be reached by '{machine.name}': the nearest joint values miss it by {nearest}"
        )
    inside = reached & ((q >= lower - 1e-9) & (q <= upper + 1e-9)).all(axis=1)
    if not inside.any():
        k, over = _worst_limit(machine, q[reached])
        joint = machine.joints[k]
        raise CompensationRefused(
            f"the pose needs joint '{joint.name}' {rounded(over)} {joint.unit} beyond its limits"
        )
    candidates = q[inside]
    return np.asarray(candidates[np.argmin(np.linalg.norm(candidates - centre, axis=1))])


def _worst_limit(machine: Machine, q: Array) -> tuple[int, float]:
    lower, upper = machine.limits()
    over = np.maximum(np.maximum(lower - q, q - upper), 0.0)
    best = over[np.argmin(over.max(axis=1))]
    return int(np.argmax(best)), float(best.max())
