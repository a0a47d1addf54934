"""Reflectors that are not where they were: (N, T, 3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppshw.terms.shapes.context import Context
from ppshw.terms.shapes.covariates import covariate
from ppshw.terms.shapes.time_and_heat import clock, step

Array = NDArray[np.float64]


def target_shift(
    c: Context, target: int, axis: int, since: float = -1.0, order: int = 0, slow: float = 0.0, name: str = "",
    load: int = -1, plumb: int = -1, knot: int = 0, count: int = 1,
) -> Array:  # fmt: skip
    """One reflector moved along one axis of the end effector, always or from a moment on (hours since the start), at
    once or with a time constant `slow` [h]; in the `order`-th half wave over the recording; with a column, or a bump of
    it (`covariate`); in proportion to a component of the sensor's wrench (by the greatest that this read), or to how
    far the `plumb`-th axis of the end effector points down."""
    out = np.zeros_like(c.points)
    out[:, target] = c.tips[:, :3, axis]
    if order:
        out = out * clock(c, "cosine", order)[:, None, None]
    if name:
        out = out * covariate(c, name, knot, count)[:, None, None]
    if load >= 0:
        read = c.recording.wrench[:, load]
        out = out * (read / c.frozen(f"most.read.{load}", float(np.abs(read).max())))[:, None, None]
    if plumb >= 0:
        out = out * gravity_in_tip(c)[:, plumb, None, None]
    if since >= 0:
        out = out * step(c, since)[:, None, None]
    if slow:
        out = out * (1.0 - np.exp(-np.maximum(c.hours - since, 0.0) / slow))[:, None, None]
    return out


def carrier_shift(c: Context, axis: int, turn: bool, since: float) -> Array:
    """All reflectors moved as one body along an axis of the end effector, or turned about one through its tip, from a
    moment on (hours since the start): what carries them was knocked."""
    along = c.tips[:, None, :3, axis]
    out = np.cross(along, c.points - c.tips[:, None, :3, 3]) if turn else np.broadcast_to(along, c.points.shape)
    return np.asarray(out * step(c, since)[:, None, None])


def turned_shift(c: Context, target: int, along: int, axis: int = -1, points: int = -1) -> Array:
    """One reflector moved along an axis of the base (`along`), in proportion to how far an axis of the end effector
    points along one of the base's (`points`), or evenly where no axes are given: read from far away, where the beam
    hardly changes its direction, by how aslant it falls in, wherever the instrument stands."""
    out = np.zeros_like(c.points)
    out[:, target, along] = c.tips[:, points, axis] if axis >= 0 else 1.0
    return out


def gravity_in_tip(c: Context) -> Array:
    """(N, 3) which way is down, in the end effector's axes."""
    g = np.asarray(c.machine.gravity)
    return np.asarray(np.einsum("nij,i->nj", c.tips[:, :3, :3], g / max(float(np.linalg.norm(g)), 1e-9)))
