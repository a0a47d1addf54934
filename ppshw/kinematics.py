"""Forward kinematics with and without generalized errors, and the generalized-error Jacobian   (paper eqs 1–12).

Frames: F_0 is the base, F_i follows joint i. The real chain puts a small displacement E_i behind every frame:

    A_T = A_0 E_0 A_1 E_1 … A_n E_n A_tip                                                   (paper eq. 5)

with ε_i = (t_x t_y t_z r_x r_y r_z) in frame F_i and E_i = [Rz(ε6) Ry(ε5) Rx(ε4) | ε1..3]. A_tip is the constant
end-effector frame in the last link. Everything is vectorised over N poses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppshw.machine import Machine
from ppshw.transforms import from_xyz_rpy, rotation_about, rotation_rpy, skew

Array = NDArray[np.float64]


def joint_transforms(machine: Machine, q: Array) -> Array:
    """A_i of eq. (1) for every joint: origin, then motion.

    q        (N, n)         joint values                    [m, rad]
    returns  (N, n, 4, 4)   frame i after motion in frame i−1
    """
    q = np.atleast_2d(np.asarray(q, dtype=float))
    out = np.empty((len(q), machine.n, 4, 4))
    for k, joint in enumerate(machine.joints):
        motion = np.broadcast_to(np.eye(4), (len(q), 4, 4)).copy()
        if joint.prismatic:
            motion[:, :3, 3] = q[:, k, None] * joint.axis
        else:
            motion[:, :3, :3] = rotation_about(joint.axis, q[:, k])
        out[:, k] = joint.origin @ motion
    return out


def error_transforms(errors: Array) -> Array:
    """E_i of the paper, exact: ε (..., 6) [m, rad] → (..., 4, 4)."""
    return from_xyz_rpy(errors[..., :3], errors[..., 3:])


def frames(machine: Machine, q: Array, errors: Array | None = None) -> Array:
    """Frames F_0 … F_n in the base, each with its own error behind it   (eq. 5 up to frame i).

    q        (N, n)            joint values                     [m, rad]
    errors   (N, n+1, 6)       generalized errors, None for the ideal machine (eq. 3)   [m, rad]
    returns  (N, n+1, 4, 4)
    """
    a = joint_transforms(machine, q)
    e = None if errors is None else error_transforms(errors)
    out = np.empty((len(a), machine.n + 1, 4, 4))
    out[:, 0] = np.eye(4) if e is None else e[:, 0]
    for i in range(machine.n):
        step = a[:, i] if e is None else a[:, i] @ e[:, i + 1]
        out[:, i + 1] = out[:, i] @ step
    return out


def tip_poses(machine: Machine, q: Array, errors: Array | None = None) -> Array:
    """The end-effector frame in the base: (N, 4, 4). Eq. (3), or eq. (5) with errors."""
    return frames(machine, q, errors)[:, -1] @ machine.tip_in_link


def point_positions(machine: Machine, q: Array, points: Array, errors: Array | None = None) -> Array:
    """Points of the end-effector frame seen from the base.

    points   (P, 3)       in the end-effector frame    [m]
    returns  (N, P, 3)    in the base frame            [m]
    """
    tip = tip_poses(machine, q, errors)
    return np.asarray(np.einsum("nij,pj->npi", tip[:, :3, :3], points) + tip[:, None, :3, 3])


def tip_levers(arms: Array) -> Array:
    """(N, T, 3) from the end effector's origin to the targets → (N, T, 3, 6): ∂p/∂(translation, rotation)."""
    return np.concatenate([np.broadcast_to(np.eye(3), (*arms.shape, 3)), -skew(arms)], axis=-1)


def point_jacobian(chain: Array, positions: Array, errors: Array | None = None) -> Array:
    """How points on the end effector move per generalized error, exact at the given errors.

    A displacement δε_i turns and shifts everything beyond frame i about its origin O_i:

        δp = R_i' δt_i + (R_i' B_i δr_i) × (p − O_i)

    where R_i' is the frame's orientation before its own error and B_i turns the rates of the three angles into an
    angular velocity; both are R_i and the identity at zero error, which is the paper's J.

    chain      (N, n+1, 4, 4)          `frames(machine, q, errors)`
    positions  (N, P, 3)               the points, base frame, with the same errors     [m]
    errors     (N, n+1, 6) or None     where to linearise                               [m, rad]
    returns    (N, P, 3, n+1, 6)       ∂p/∂ε_i                                          [m/m, m/rad]
    """
    shape = (len(chain), positions.shape[1], 3, chain.shape[1], 6)
    out = np.empty(shape)
    arms = positions[:, :, None] - chain[:, None, :, :3, 3]  # (N, P, n+1, 3)
    before, turning = chain[..., :3, :3], chain[..., :3, :3]
    if errors is not None:
        before = before @ np.swapaxes(rotation_rpy(errors[..., 3:]), -1, -2)
        turning = before @ _angle_rates(errors[..., 3:])
    out[..., :3] = np.transpose(before, (0, 2, 1, 3))[:, None]
    out[..., 3:] = np.moveaxis(-skew(arms) @ turning[:, None], 2, 3)
    return out


def tip_jacobian(chain: Array, tip: Array, errors: Array | None = None) -> Array:
    """How the end effector moves per generalized error, exact at these errors, in its own axes about its own origin:
    without errors the Jacobian J(q) of eq. (12), ΔX = J ε (eq. 8, 10).

    chain    (N, n+1, 4, 4)    `frames(machine, q, errors)`;  tip (N, 4, 4);  errors (N, n+1, 6)    [m, rad]
    returns  (N, 6, n+1, 6)    translation, then rotation                                          [m/m, m/rad; rad/rad]
    """
    turning = chain[..., :3, :3]
    if errors is not None:
        turning = turning @ np.swapaxes(rotation_rpy(errors[..., 3:]), -1, -2) @ _angle_rates(errors[..., 3:])
    to_tip = np.swapaxes(tip[:, :3, :3], -1, -2)
    out = np.zeros((len(chain), 6, chain.shape[1], 6))
    translation = point_jacobian(chain, tip[:, None, :3, 3], errors)[:, 0]
    out[:, :3] = (to_tip @ translation.reshape(len(chain), 3, -1)).reshape(translation.shape)
    out[:, 3:, :, 3:] = np.swapaxes(to_tip[:, None] @ turning, 1, 2)
    return out


def _angle_rates(angles: Array) -> Array:
    """(..., 3) → (..., 3, 3): angular velocity per rate of the three angles of Rz Ry Rx."""
    c, s = np.cos(angles), np.sin(angles)
    out = np.zeros((*angles.shape, 3))
    out[..., 0, 0], out[..., 0, 1] = c[..., 2] * c[..., 1], -s[..., 2]
    out[..., 1, 0], out[..., 1, 1] = s[..., 2] * c[..., 1], c[..., 2]
    out[..., 2, 0], out[..., 2, 2] = -s[..., 1], 1.0
    return out


def joint_jacobian(machine: Machine, chain: Array, positions: Array) -> Array:
    """How points move per joint rate.

    chain    (N, n+1, 4, 4);  positions (N, P, 3) [m];  returns (N, P, 3, n)  [m/m, m/rad]
    """
    out = np.empty((*positions.shape, machine.n))
    for k, joint in enumerate(machine.joints):
        axis = chain[:, k + 1, :3, :3] @ joint.axis  # the axis is the same before and after the joint's own motion
        if joint.prismatic:
            out[..., k] = axis[:, None]
        else:
            out[..., k] = np.cross(axis[:, None], positions - chain[:, None, k + 1, :3, 3])
    return out


def travel(machine: Machine) -> tuple[Array, Array]:
    """Limits (n,), (n,) [m, rad]; half a turn to either side where the file gives none."""
    lower, upper = machine.limits()
    return np.where(np.isfinite(lower), lower, -np.pi), np.where(np.isfinite(upper), upper, np.pi)


def freedoms(machine: Machine) -> int:
    """How many degrees of freedom, of six, the joints of the ideal machine give the end effector: the most over poses
    spread over the travel, since there are fewer at singular ones."""
    q = np.random.default_rng(0).uniform(*travel(machine), (16, machine.n))
    chain = frames(machine, q)
    tip = chain[:, -1] @ machine.tip_in_link
    moved = joint_jacobian(machine, chain, tip[:, None, :3, 3])[:, 0]
    axes = [chain[:, k + 1, :3, :3] @ (j.axis * (not j.prismatic)) for k, j in enumerate(machine.joints)]
    turned = np.stack(axes, axis=-1)
    return int(np.linalg.matrix_rank(np.concatenate([moved, turned], axis=1), rtol=1e-6).max())
