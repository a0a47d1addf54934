"""Rigid transforms as 4×4 matrices, vectorised over any leading shape. `a_in_b` maps coordinates in a to b."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rotation_rpy(rpy: Array) -> Array:
    """URDF's fixed-axis X, Y, Z angles, i.e. Rz(yaw) Ry(pitch) Rx(roll); also the paper's eq. (4).

    rpy      (..., 3)     [rad]
    returns  (..., 3, 3)
    """
    rpy = np.asarray(rpy, dtype=float)
    c, s = np.cos(rpy), np.sin(rpy)
    cx, cy, cz = c[..., 0], c[..., 1], c[..., 2]
    sx, sy, sz = s[..., 0], s[..., 1], s[..., 2]
    out = np.empty((*rpy.shape[:-1], 3, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = cy * cz, sx * sy * cz - cx * sz, cx * sy * cz + sx * sz
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = cy * sz, sx * sy * sz + cx * cz, cx * sy * sz - sx * cz
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = -sy, sx * cy, cx * cy
    return out


def transform(rotation: Array, translation: Array) -> Array:
    """(..., 3, 3) and (..., 3) → (..., 4, 4)."""
    shape = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    out = np.zeros((*shape, 4, 4))
    out[..., :3, :3] = rotation
    out[..., :3, 3] = translation
    out[..., 3, 3] = 1.0
    return out


def from_xyz_rpy(xyz: Array, rpy: Array) -> Array:
    """(..., 3) [m] and (..., 3) [rad] → (..., 4, 4)."""
    return transform(rotation_rpy(rpy), np.asarray(xyz, dtype=float))


def inverse(pose: Array) -> Array:
    """(..., 4, 4) rigid → its inverse."""
    rotation = np.swapaxes(pose[..., :3, :3], -1, -2)
    return transform(rotation, -np.einsum("...ij,...j->...i", rotation, pose[..., :3, 3]))


def skew(v: Array) -> Array:
    """(..., 3) → (..., 3, 3) with skew(a) b = a × b."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def rotation_about(axis: Array, angle: Array) -> Array:
    """Rodrigues' formula: unit axis (3,), angles (...) [rad] → (..., 3, 3)."""
    k = skew(np.asarray(axis, dtype=float))
    angle = np.asarray(angle, dtype=float)[..., None, None]
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k)


def rotation_vector(rotation: Array) -> Array:
    """The rotation vector (axis × angle) of (..., 3, 3), angle in [0, π].   [rad]

    Exact for small angles too: sin and cos of the angle are taken from the antisymmetric part and the trace. At half a
    turn, where the former is nothing, (R + Rᵀ)/2 = 2 k kᵀ − 1 has the axis, whose sign is open there.
    """
    w = 0.5 * np.stack(
        [
            rotation[..., 2, 1] - rotation[..., 1, 2],
            rotation[..., 0, 2] - rotation[..., 2, 0],
            rotation[..., 1, 0] - rotation[..., 0, 1],
        ],
        axis=-1,
    )
    s = np.linalg.norm(w, axis=-1)
    angle = np.arctan2(s, 0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1.0))
    factor = np.where(s > 1e-12, angle / np.where(s > 1e-12, s, 1.0), 1.0)
    out = w * factor[..., None]
    half = (s < 1e-7) & (angle > 3.0)
    if half.any():
        along = 0.5 * (rotation + np.swapaxes(rotation, -1, -2))[half] + np.eye(3)
        longest = np.argmax(np.diagonal(along, axis1=-2, axis2=-1), axis=-1)
        axis = along[np.arange(len(along)), longest]
        axis *= np.where((axis * w[half]).sum(axis=-1) < 0.0, -1.0, 1.0)[:, None]
        out[half] = angle[half][:, None] * axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    return out


def fit_rigid(points: Array, measured: Array) -> Array:
    """The pose that maps points (N, T, 3) or (T, 3) on measured of the same shape in the least-squares sense.

    Kabsch's solution by SVD (Kabsch 1976; Umeyama 1991 for the sign). Needs three points that are not on a line.
    returns (N, 4, 4) or (4, 4)
    """
    centre_p = points.mean(axis=-2, keepdims=True)
    centre_m = measured.mean(axis=-2, keepdims=True)
    u, _, vt = np.linalg.svd(np.swapaxes(measured - centre_m, -1, -2) @ (points - centre_p))
    sign = np.sign(np.linalg.det(u @ vt))
    flip = np.ones((*sign.shape, 3))
    flip[..., 2] = sign
    rotation = (u * flip[..., None, :]) @ vt
    return transform(rotation, (centre_m - np.einsum("...ij,...kj->...ki", rotation, centre_p))[..., 0, :])


def spans_a_frame(points: Array) -> bool:
    """Whether points (T, 3) are three or more that are not on a line (within a hundredth of their extent)."""
    if len(points) < 3:
        return False
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extent[1] > 0.01 * extent[0])
