"""What the instrument reads wrong on the measured points: (N, T, 3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppshw.terms.shapes.context import Context
from ppshw.terms.shapes.covariates import above_mean
from ppshw.terms.shapes.sight import incidence, rays_to, seen_at
from ppshw.terms.shapes.time_and_heat import step, temperature

Array = NDArray[np.float64]


def scale(c: Context, place: str = "", tau: float = 0.0, name: str = "", since: float = -1.0) -> Array:
    """Distances from the instrument longer by a factor; with a place, per kelvin of that temperature, lagging by tau
    hours where the beam's air follows the thermometer's; with a column's name, per unit of it above its mean; from a
    moment on (hours since the start)."""
    rays = _rays(c, place, tau, name)
    return rays if since < 0 else rays * step(c, since)[:, None, None]


def strain(c: Context, first: int, second: int, place: str = "", name: str = "") -> Array:
    """The space around the instrument stretched (twice the same axis) or sheared; per kelvin with a place, per unit of
    a column with its name."""
    rays = _rays(c, place, name=name)
    out = np.zeros_like(rays)
    out[..., first], out[..., second] = rays[..., second], rays[..., first]
    return out


def angle_error(c: Context, angle: str, order: int, phase: str) -> Array:
    """The instrument's azimuth or elevation off by the sine or cosine of `order` times itself: its encoders' error. Its
    standing axis is taken for plumb."""
    at, moves = seen_at(c, angle)
    return np.asarray(moves * (np.sin(order * at) if phase == "sin" else np.cos(order * at))[..., None])


def range_wave(c: Context, period: float, phase: str) -> Array:
    """Distances longer by the sine or cosine of themselves: what a distance meter that compares phases errs by."""
    rays = rays_to(c)
    far = np.linalg.norm(rays, axis=2, keepdims=True)
    angle = 2 * np.pi * far / period
    return np.asarray(rays / far * (np.sin(angle) if phase == "sin" else np.cos(angle)))


def range_error(c: Context, first: int, second: int = -1, target: int = -1) -> Array:
    """Distances longer by a component of the direction in which the end effector's axes see the beam, or by the product
    of two: reflectors whose cube corner or sphere is off, the more the more aslant the beam falls in. target: of one
    reflector; -1: of all alike."""
    beam, seen = incidence(c)
    by = seen[..., first] * (seen[..., second] if second >= 0 else 1.0)
    if target >= 0:
        by = by * (np.arange(by.shape[1]) == target)
    return np.asarray(beam * by[..., None])


def refraction(c: Context, place: str, part: int) -> Array:
    """What bends upwards per kelvin: by a coordinate in the measuring frame (part 0 to 2), evenly (3), with the squared
    distance from its origin (4): together with the squared distance from wherever the instrument stands. The beam does
    in air whose temperature changes with height."""
    rays, up = rays_to(c), c.machine.up
    parts = (*np.moveaxis(rays, 2, 0), np.ones(rays.shape[:2]), (rays**2).sum(axis=2))
    return np.asarray((parts[part] * temperature(c, place, 0.0)[:, None])[..., None] * up)


def _rays(c: Context, place: str = "", tau: float = 0.0, name: str = "") -> Array:
    """(N, T, 3) from the instrument to the targets; times a temperature with a place, a column with a name."""
    rays = rays_to(c)
    if name:
        return np.asarray(rays * above_mean(c, name)[:, None, None])
    return np.asarray(rays * temperature(c, place, tau)[:, None, None] if place else rays)
