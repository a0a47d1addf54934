"""Wanted pose and load → corrected joint setpoints   (paper figure 3).

The real machine, as calibrated, is asked where it would go; Newton's method moves the setpoints until it goes where it
should. What cannot be honoured is refused with a reason: nothing is clipped.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppshw.calibration import Calibration
from ppshw.errors import CompensationRefused
from ppshw.kinematics import frames, joint_jacobian, point_positions, tip_poses
from ppshw.machine import WRENCH_COMPONENTS, Machine
from ppshw.terms import Situation
from ppshw.transforms import inverse, rotation_vector, transform

Array = NDArray[np.float64]
# Reached when no residual is larger: micrometres and microradians are far below any repeatability.
POSITION_TOLERANCE, ROTATION_TOLERANCE = 1e-7, 1e-7


@dataclass(frozen=True)
class Bounds:
    """How far a corrected setpoint may lie from the wanted one, and how far outside what was identified one may go.

    travel        [m] per prismatic joint;  angle  [rad] per revolute joint
    range_margin  share of the identified range of a joint or load component that is tolerated beyond its ends
    """

    travel: float = 0.03
    angle: float = 0.03
    range_margin: float = 0.02


@dataclass(frozen=True)
class Setpoints:
    """corrected and nominal (n,) [m, rad]; predicted_error (3,) of the point without correction, base axes [m];
    std (3,) of the point's position after correction: model's uncertainty [m]."""

    corrected: Array
    nominal: Array
    predicted_error: Array
    std: Array


def solve_pose(
    machine: Machine,
    wanted_tip: Array,
    start: Array,
    calibration: Calibration | None = None,
    payload: Array | None = None,
) -> tuple[Array, Array]:
    """Joint values at which the end-effector frame stands at `wanted_tip`, by Newton's method, vectorised.

    wanted_tip  (N, 4, 4) in the base;  start (N, n);  payload (N, 6) on the sensor (with a calibration)
    calibration None: the ideal machine
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
            errors, _ = calibration.model.errors(Situation(q, payload), calibration.theta)
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
        nearest = np.linalg.norm(left[:, :3], axis=1).min() * 1e3
        raise CompensationRefused(
            f"the pose cannot be reached by '{machine.name}': the nearest joint values miss it by {nearest:.3g} mm"
        )
    inside = reached & ((q >= lower - 1e-9) & (q <= upper + 1e-9)).all(axis=1)
    if not inside.any():
        k, over = _worst_limit(machine, q[reached])
        raise CompensationRefused(
            f"the pose needs joint '{machine.joint_names[k]}' {over:.4g} {machine.joints[k].unit} beyond its limits"
        )
    candidates = q[inside]
    return np.asarray(candidates[np.argmin(np.linalg.norm(candidates - centre, axis=1))])


def _worst_limit(machine: Machine, q: Array) -> tuple[int, float]:
    lower, upper = machine.limits()
    over = np.maximum(np.maximum(lower - q, q - upper), 0.0)
    best = over[np.argmin(over.max(axis=1))]
    return int(np.argmax(best)), float(best.max())


class Compensator:
    """Corrects setpoints of one calibrated machine."""

    def __init__(self, calibration: Calibration, bounds: Bounds | None = None) -> None:
        self.calibration = calibration
        self.machine = calibration.machine
        self.bounds = bounds or Bounds()

    def for_pose(self, wanted: Array, payload: Array, point: str = "tip", near: Array | None = None) -> Setpoints:
        """Setpoints that bring a named point's frame to `wanted`.

        wanted   (4, 4) of the point (its axes are the end effector's) in the base frame
        payload  (6,) on the sensor, sensor frame, at that pose    [N, N·m]
        Raises CompensationRefused: out of reach, beyond a limit, outside what was identified, too large a correction.
        """
        offset = transform(np.eye(3), self.machine.point(point))
        wanted_tip = wanted @ inverse(offset)
        nominal = nominal_joints(self.machine, wanted_tip, near)
        return self._correct(wanted_tip, nominal, payload, point)

    def for_joints(self, wanted: Array, payload: Array, point: str = "tip") -> Setpoints:
        """Setpoints that bring the real machine where the ideal one would be at joint values `wanted` (n,)."""
        wanted = np.asarray(wanted, dtype=float)
        return self._correct(tip_poses(self.machine, wanted)[0], wanted, payload, point)

    def setpoint_map(self) -> Callable[[Array, Array, Array], Array]:
        """For a campaign: (wanted (n,), wrench (6,) as read at (n,)) → corrected (n,)."""

        def correct(wanted: Array, wrench: Array, here: Array) -> Array:
            return self.for_joints(wanted, payload_at(self.machine, wrench, here, wanted)).corrected

        return correct

    def _correct(self, wanted_tip: Array, nominal: Array, payload: Array, point: str) -> Setpoints:
        self._refuse_outside(nominal, payload)
        start = nominal[None]
        q, left = solve_pose(self.machine, wanted_tip[None], start, self.calibration, payload[None])
        # fewer than six joints cannot reach every real pose; what they leave must be within the same tolerance
        if np.abs(left).max() > 1e-5:
            raise CompensationRefused(
                f"the corrected pose cannot be reached: {np.linalg.norm(left[0, :3]) * 1e3:.3g} mm and "
                f"{np.linalg.norm(left[0, 3:]) * 1e3:.3g} mrad are left"
            )
        self._refuse_correction(q[0], nominal)
        where = self.machine.point(point)[None]
        situation = Situation(q, payload[None])
        uncorrected = self.calibration.model.predict(Situation(start, payload[None]), self.calibration.theta, where)
        ideal = point_positions(self.machine, start, where)
        design = self.calibration.model.linearise(situation, self.calibration.theta, where).design[0, 0]
        variance = np.einsum("ip,pq,iq->i", design, self.calibration.covariance, design)
        return Setpoints(q[0], nominal, (uncorrected - ideal)[0, 0], np.sqrt(np.maximum(variance, 0.0)))

    def _refuse_outside(self, q: Array, payload: Array) -> None:
        margin = self.bounds.range_margin
        for k, name in enumerate(self.machine.joint_names):
            low, high = self.calibration.joint_range[k]
            slack = margin * (high - low) + 1e-6
            if not low - slack <= q[k] <= high + slack:
                unit = self.machine.joints[k].unit
                raise CompensationRefused(
                    f"joint '{name}' at {q[k]:.6g} {unit} is outside what was identified, {low:.6g} … {high:.6g}"
                )
        for k, name in enumerate(WRENCH_COMPONENTS):
            low, high = self.calibration.payload_range[k]
            unit = "N" if k < 3 else "N m"
            slack = margin * (high - low) + (5.0 if k < 3 else 2.0)
            if not low - slack <= payload[k] <= high + slack:
                raise CompensationRefused(
                    f"load {name} = {payload[k]:.6g} {unit} is outside what was identified, {low:.6g} … {high:.6g}"
                )

    def _refuse_correction(self, corrected: Array, nominal: Array) -> None:
        lower, upper = self.machine.limits()
        for k, joint in enumerate(self.machine.joints):
            change = abs(corrected[k] - nominal[k])
            bound = self.bounds.travel if joint.prismatic else self.bounds.angle
            if change > bound:
                raise CompensationRefused(
                    f"joint '{joint.name}' would be corrected by {change:.4g} {joint.unit}, the bound is {bound:g}"
                )
            if not lower[k] <= corrected[k] <= upper[k]:
                raise CompensationRefused(
                    f"corrected setpoint of joint '{joint.name}' {corrected[k]:.6g} {joint.unit} is beyond its limits "
                    f"{lower[k]:g} … {upper[k]:g}"
                )


def payload_at(machine: Machine, payload: Array, here: Array, there: Array) -> Array:
    """What the sensor will read at another pose, when the payload only weighs.

    The weight keeps its direction in space and its line of action in the payload; where on that line the centre of mass
    lies one reading cannot tell, so the point nearest to the sensor is taken. Exact where the sensor only turns about
    the vertical; for tilts of δ it is off by weight × height × δ.

    payload  (6,) read at joint values `here` (n,);  returns (6,) at `there` (n,)   [N, N·m]
    """
    turn = [(tip_poses(machine, q)[0, :3, :3] @ machine.tip_in_link[:3, :3].T @ machine.sensor_in_link[:3, :3])
            for q in (here, there)]  # fmt: skip
    force, moment = payload[:3], payload[3:]
    size = float(force @ force)
    lever = np.cross(force, moment) / size if size > 0 else np.zeros(3)
    turned = turn[1].T @ turn[0] @ force
    along = moment - np.cross(lever, force)  # a pure moment, if there is one, stays with the payload
    return np.concatenate([turned, np.cross(lever, turned) + along])
