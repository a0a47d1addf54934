"""How the instrument sees the reflectors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppshw.terms.shapes.context import Context

Array = NDArray[np.float64]


def rays_to(c: Context) -> Array:
    """(N, T, 3) from the instrument to the targets, in the base's axes [m]."""
    return np.asarray(c.points - c.measuring_in_base[:3, 3])


def seen_at(c: Context, angle: str) -> tuple[Array, Array]:
    """The angle at which the instrument sees every target (N, T), and how that moves as it grows (N, T, 3)."""
    rays, up = rays_to(c), c.machine.up
    ahead = c.measuring_in_base[:3, 0] if abs(c.measuring_in_base[:3, 0] @ up) < 0.9 else c.measuring_in_base[:3, 1]
    ahead = ahead - (ahead @ up) * up
    ahead /= np.linalg.norm(ahead)
    height = rays @ up
    level = rays - height[..., None] * up
    away = np.maximum(np.linalg.norm(level, axis=2), 1e-9)
    if angle == "azimuth":
        return np.arctan2(rays @ np.cross(up, ahead), rays @ ahead), np.cross(up, level)
    return np.arctan2(height, away), away[..., None] * up - (height / away)[..., None] * level


def incidence(c: Context) -> tuple[Array, Array]:
    """Unit vectors of the beams in the base and in the end effector's axes: (N, T, 3) each."""
    rays = rays_to(c)
    beam = rays / np.maximum(np.linalg.norm(rays, axis=2, keepdims=True), 1e-9)
    return beam, np.einsum("nji,ntj->nti", c.tips[:, :3, :3], beam)
