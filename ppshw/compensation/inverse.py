"""Joint values for a wanted pose, of the ideal machine or of a calibrated one, by Newton's method."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ppshw.calibration import Calibration
from ppshw.errors import CompensationRefused
from ppshw.kinematics import frames, freedoms, joint_jacobian, travel
from ppshw.machine import Machine
from ppshw.quantities import angle, distance, rounded
from ppshw.terms import Situation
from ppshw.transforms import rotation_vector

Array = NDArray[np.float64]
# Reached when no residual is larger: micrometres and microradians are far below any repeatability.
POSITION_TOLERANCE, ROTATION_TOLERANCE = 1e-7, 1e-7
# Where a position goes before the orientation a radian counts as a tenth of a millimetre: ten milliradians that cannot
# be put right then cost the position a nanometre on a lever of 0.1 m.
POSITION_FIRST = 1e-4  # m/rad
# A wanted pose is one that the ideal machine reaches; with fewer than six degrees of freedom not all of its six numbers
# are free, and it may be written with four decimals.
REACHED, REACHED_IF_ROUNDED = 1e-6, 1e-4  # m, rad
# A nearest pose, which leaves something, is found when no joint moves by more any longer [m, rad].
AT_NEAREST = 1e-7
AT_LIMIT = 1e-9  # m, rad
A_TIE = 1e-6  # of what is left: of two as near the later one
# Where effects change faster with the joints than the joints themselves do (a screw whose error is steep) they count in
# the slope too, by differences over so little [m, rad], from so many starts about where the plain steps went.
LITTLE, STARTS, STEPS, HALVINGS = 1e-7, 12, 20, 8
# (q (1, n), the base model's errors (1, n+1, 6) and wrenches there) → errors of effects beyond it
EffectErrors = Callable[[Array, Array, Array], Array]


def solve_pose(
    machine: Machine,
    wanted_tip: Array,
    start: Array,
    calibration: Calibration | None = None,
    payload: Array | None = None,
    effects: EffectErrors | None = None,
    point: Array | None = None,
) -> tuple[Array, Array]:
    """Joint values at which the end-effector frame stands at `wanted_tip`, by Newton's method, vectorised.

    wanted_tip  (N, 4, 4) in the base;  start (N, n);  payload (N, 6) on the sensor (with a calibration)
    calibration None: the ideal machine
    effects     errors beyond the calibration's base model, for one pose (N = 1)
    point       (3,) in the end-effector frame [m]: its position goes first, and the orientation is as near as that
                allows, by what the ideal joints can do, for machines that cannot have both; None: position and
                orientation alike, which can be had
                Where plain steps, which leave the effects' slopes out, come to no rest, slopes by differences are tried
    returns     (N, n) joint values, (N, 6) what is left: of the position, of the point if there is one, and the
                rotation vector, base axes [m, rad]; without a point of the nearest met, not converged where it is large
    Raises CompensationRefused where a point is given and Newton's method comes to no rest (near singular poses).
    """
    q = np.array(start, dtype=float)
    offset = np.zeros(3) if point is None else point
    share = np.repeat([1.0, 1.0 if point is None else POSITION_FIRST], 3)
    left, went = np.zeros((len(q), 6)), []

    def stands(q: Array) -> tuple[Array, Array, Array]:
        return _stands(machine, wanted_tip, q, calibration, payload, effects, offset)

    nearest = q, np.full((len(q), 6), np.inf)
    for _ in range(30):
        chain, reached, left = stands(q)
        if _is_reached(left):
            break
        closer = (np.linalg.norm(left, axis=1) <= (1.0 + A_TIE) * np.linalg.norm(nearest[1], axis=1))[:, None]
        nearest = np.where(closer, q, nearest[0]), np.where(closer, left, nearest[1])
        went.append(q)
        there = reached
        if point is not None:  # errors would lend the joints ways, and levers, that they have by a thousandth only
            chain = frames(machine, q)
            tip = chain[:, -1] @ machine.tip_in_link
            there = tip[:, :3, 3] + tip[:, :3, :3] @ offset
        jacobian = np.empty((len(q), 6, machine.n))
        jacobian[:, :3] = joint_jacobian(machine, chain, there[:, None])[:, 0]
        for k, joint in enumerate(machine.joints):
            axis = chain[:, k + 1, :3, :3] @ joint.axis
            jacobian[:, 3:, k] = 0.0 if joint.prismatic else axis
        jacobian *= share[:, None]
        aim = left * share
        # A little damping keeps the step finite near singular poses and vanishes as the residual does.
        square = np.swapaxes(jacobian, 1, 2) @ jacobian
        damping = 1e-12 + 1e-4 * np.minimum(1.0, (aim**2).sum(axis=1))
        square[:, np.arange(machine.n), np.arange(machine.n)] += damping[:, None]
        step = np.linalg.solve(square, np.einsum("nij,ni->nj", jacobian, aim)[..., None])[..., 0]
        largest = np.abs(step).max(axis=1, keepdims=True)
        if point is not None and largest.max() < AT_NEAREST:
            break
        q = q + step * np.minimum(1.0, 0.5 / np.maximum(largest, 1e-12))
    else:
        if point is not None:
            raise CompensationRefused(
                f"the nearest joint values were not found: '{machine.name}' stands nearly stretched there, or in "
                "another singular pose"
            )
        if effects is not None:
            return _by_slopes(lambda q: stands(q[None])[2][0], np.concatenate(went))
        return nearest
    return q, left


def left_of(
    machine: Machine, wanted_tip: Array, q: Array, calibration: Calibration, payload: Array,
    effects: EffectErrors | None, point: Array,
) -> Array:  # fmt: skip
    """(1, 6) what joint values q (1, n) leave of a wanted pose, at a point; arguments as of `solve_pose`."""
    return _stands(machine, wanted_tip, q, calibration, payload, effects, point)[2]


def _stands(
    machine: Machine, wanted_tip: Array, q: Array, calibration: Calibration | None, payload: Array | None,
    effects: EffectErrors | None, offset: Array,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Frames and the point with all errors, and what is left (N, 6) of the wanted pose."""
    errors = None
    if calibration is not None:
        assert payload is not None
        errors, wrenches = calibration.model.errors(Situation(q, payload), calibration.theta)
        if effects is not None:
            errors = errors + effects(q, errors, wrenches)
    chain = frames(machine, q, errors)
    tip = chain[:, -1] @ machine.tip_in_link
    reached = tip[:, :3, 3] + tip[:, :3, :3] @ offset
    turned = rotation_vector(wanted_tip[:, :3, :3] @ np.swapaxes(tip[:, :3, :3], 1, 2))
    wanted = wanted_tip[:, :3, 3] + wanted_tip[:, :3, :3] @ offset
    return chain, reached, np.concatenate([wanted - reached, turned], axis=1)


def _is_reached(left: Array) -> bool:
    """Whether of all (…, 6) so little is left."""
    position, rotation = np.abs(left[..., :3]).max(), np.abs(left[..., 3:]).max()
    return bool(position < POSITION_TOLERANCE and rotation < ROTATION_TOLERANCE)


def _by_slopes(left_at: Callable[[Array], Array], went: Array) -> tuple[Array, Array]:
    """Newton's method with slopes by differences, every step halved until it helps, from where steps (k, n) went and
    from elsewhere among them; the first that gets there, else the nearest: (1, n) joint values, (1, 6) what is left."""
    low, high = went.min(axis=0), went.max(axis=0)
    starts = np.random.default_rng(0).uniform(low, high, (STARTS, went.shape[1]))
    starts[0] = went[-1]
    nearest = went[-1], left_at(went[-1])
    for start in starts:
        q, left = start, left_at(start)
        for _ in range(STEPS):
            if _is_reached(left):
                return q[None], left[None]
            moved = np.array([left - left_at(q + LITTLE * one) for one in np.eye(len(q))]).T / LITTLE
            step = np.linalg.lstsq(moved, left, rcond=1e-9)[0]
            step *= min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-12))
            tries = (q + step / 2**k for k in range(HALVINGS))
            better = next((one for one in tries if np.linalg.norm(left_at(one)) < np.linalg.norm(left)), None)
            if better is None:
                break
            q, left = better, left_at(better)
        if np.linalg.norm(left) < np.linalg.norm(nearest[1]):
            nearest = q, left
    return nearest[0][None], nearest[1][None]


def nominal_joints(machine: Machine, wanted_tip: Array, near: Array | None = None) -> Array:
    """The ideal machine's joint values for one pose (4, 4): within limits, nearest to `near` (default mid-travel).

    Newton's method from many starts spread over the travel. Raises CompensationRefused when none reaches the pose.
    """
    lower, upper = machine.limits()
    low, high = travel(machine)
    centre = (low + high) / 2 if near is None else np.asarray(near, dtype=float)
    starts = np.random.default_rng(0).uniform(low, high, (200, machine.n))
    starts[0] = centre
    q, left = solve_pose(machine, np.broadcast_to(wanted_tip, (len(starts), 4, 4)), starts)
    for k, joint in enumerate(machine.joints):
        if not joint.prismatic:  # of whole turns the nearest, or the next that the limits allow
            turned = centre[k] + (q[:, k] - centre[k] + np.pi) % (2 * np.pi) - np.pi
            turned -= 2 * np.pi * np.ceil(np.maximum(turned - upper[k] - AT_LIMIT, 0.0) / (2 * np.pi))
            turned += 2 * np.pi * np.ceil(np.maximum(lower[k] - AT_LIMIT - turned, 0.0) / (2 * np.pi))
            q[:, k] = turned
    reached = (np.abs(left) < (REACHED_IF_ROUNDED if freedoms(machine) < 6 else REACHED)).all(axis=1)
    if not reached.any():
        nearest = amount(left[np.argmin(np.linalg.norm(left, axis=1))])
        raise CompensationRefused(
            f"the pose cannot be reached by '{machine.name}': the nearest joint values miss it by {nearest}"
        )
    inside = reached & ((q >= lower - AT_LIMIT) & (q <= upper + AT_LIMIT)).all(axis=1)
    if not inside.any():
        k, over = _worst_limit(machine, q[reached])
        joint = machine.joints[k]
        raise CompensationRefused(f"the pose needs joint '{joint.name}' {rounded(over)} {joint.unit} beyond its limits")
    candidates = q[inside]
    return np.asarray(candidates[np.argmin(np.linalg.norm(candidates - centre, axis=1))])


def amount(left: Array) -> str:
    """What is left of a pose, for the eye: (6,) [m, rad] → '1.2 mm and 0.3 mrad'."""
    return f"{distance(float(np.linalg.norm(left[:3])))} and {angle(float(np.linalg.norm(left[3:])))}"


def _worst_limit(machine: Machine, q: Array) -> tuple[int, float]:
    lower, upper = machine.limits()
    over = np.maximum(np.maximum(lower - q, q - upper), 0.0)
    best = over[np.argmin(over.max(axis=1))]
    return int(np.argmax(best)), float(best.max())
