"""Functions of where a joint stands, which side it came from, and what it did since: (N,), pure numbers.

joint 0 … n−1; a side is −1, 1, or 0 where it is not known; a position is −1 … 1 over what was sampled. `width`, `way`,
`past` and `period` are in the joint's own unit [m, rad] where nothing else is said.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ppshw.terms.history import slip, way_since_reversal, wind_up
from ppshw.terms.shapes.context import Context
from ppshw.terms.shapes.covariates import bump, covariate, named_column

Array = NDArray[np.float64]


def approach(
    c: Context, joint: int, pressed: int | None = None, tilted: int | None = None, since: float = -math.inf
) -> Array:  # fmt: skip
    """The side a joint came from; with `pressed` what is more of it where the joint is loaded more than on average,
    with `tilted` per newton metre of a moment upon it (3 to 5), with `since` from that moment on (hours since the
    start)."""
    side = c.recording.approach[:, joint] * (c.hours >= since)
    return np.asarray(side * _by_its_load(c, joint, pressed, tilted), dtype=float)


def approach_q(c: Context, joint: int, power: int = 1) -> Array:
    """The side a joint came from times a power of its position: a gap that is wider at one end."""
    return c.recording.approach[:, joint] * c.u(joint) ** power


def reversal(c: Context, joint: int, knot: int, count: int) -> Array:
    """The side a joint came from times a smooth function of the way since it turned back: the knot-th of `count` bumps
    over its ranks, as `covariate`."""
    return approach(c, joint) * covariate(c, f"way_{c.machine.joint_names[joint]}", knot, count)


def turning(c: Context, joint: int, knot: int, count: int) -> Array:
    """As `reversal`, finest where the joint has just turned back: bumps over the root of the way since."""
    q = c.recording.q[:, joint]
    way = way_since_reversal(q, c.recording.approach[:, joint])
    far = max(c.frozen(f"high.{joint}", q.max()) - c.frozen(f"low.{joint}", q.min()), 1e-9)
    at = np.sqrt(np.minimum(way / far, 1.0))
    return approach(c, joint) * bump(at, knot, count)


def slipping(
    c: Context, joint: int, width: float, pressed: int | None = None, past: float = math.inf, tilted: int | None = None
) -> Array:
    """Evenly taken up; `pressed` and `tilted` as in `approach`; `past` how far it went past where it came to from the
    other side."""
    lag = slip(c.recording.q[:, joint], c.recording.approach[:, joint], width, past)
    return lag * _by_its_load(c, joint, pressed, tilted)


def winding(
    c: Context, joint: int, way: float, pressed: int | None = None, past: float = math.inf, tilted: int | None = None,
    rest_h: float = math.inf,
) -> Array:  # fmt: skip
    """Ever more slowly; `pressed`, `past` and `tilted` as in `slipping`; `rest_h` the hours in which it lets go to a
    part in e while its joint rests."""
    rested = np.diff(c.hours, prepend=c.hours[:1])
    left = np.exp(-np.maximum(rested, 0.0) / rest_h)
    lag = wind_up(c.recording.q[:, joint], c.recording.approach[:, joint], way, past, left)
    return lag * _by_its_load(c, joint, pressed, tilted)


def _by_its_load(c: Context, joint: int, pressed: int | None, tilted: int | None) -> Array | float:
    if tilted is not None:  # one way it presses together what the other way it lifts off
        moment = c.wrenches[:, joint + 1, tilted]
        return np.asarray(moment - c.frozen(f"tilted.{joint}.{tilted}", float(moment.mean())))
    return 1.0 if pressed is None else _pressed(c, joint, pressed)


def _pressed(c: Context, joint: int, component: int) -> Array:
    """By what share a joint's load is above its mean: the force upon it (-1), or what its drive holds (a component),
    either way. Friction goes with it (Coulomb), a gap that a load takes up against it."""
    w = c.wrenches[:, joint + 1]
    load = np.linalg.norm(w[:, :3], axis=1) if component < 0 else np.abs(w[:, component])
    return np.asarray(load / max(c.frozen(f"pressed.{joint}.{component}", float(load.mean())), 1e-9) - 1.0)


def seated(c: Context, name: str, stay: int) -> Array:
    """1 while a joint stays where its `stay`-th move took it, or a load where it was put the `stay`-th time: see the
    columns stay_<joint> and mounting."""
    return np.asarray((named_column(c, name) == stay).astype(float))


def wave(c: Context, joint: int, period: float, phase: str, pressed: int | None = None) -> Array:
    """With `pressed` what is more of it where the joint is loaded more than on average, as of teeth that give way."""
    angle = 2 * np.pi * c.recording.q[:, joint] / period
    whole = np.sin(angle) if phase == "sin" else np.cos(angle)
    return np.asarray(whole * _by_its_load(c, joint, pressed, None))


def wave_q(c: Context, joint: int, period: float, phase: str, by: int) -> Array:
    """A wave along one joint's travel times another's position."""
    return wave(c, joint, period, phase) * c.u(by)


def dent(c: Context, joint: int, at: float, width: float, order: int) -> Array:
    """At one place of a joint's travel alone: a bell about `at` of this width, both for a travel of −1 … 1.

    order  1: down before the place and up behind it; 2: down at it and up on both sides
    """
    x = (c.u(joint) - at) / width
    return np.asarray(np.exp(-0.5 * x**2) * (1.0, x, x**2 - 1.0)[order])


def splice(c: Context, joint: int, at: float) -> Array:
    """A step at one place of a joint's travel, for a travel of −1 … 1: a rail goes on a little beside where the one
    before it ended."""
    return np.asarray(0.5 * np.sign(c.u(joint) - at))


def pair(c: Context, a: int, power_a: int, b: int, power_b: int) -> Array:
    """Legendre polynomials of two joints, multiplied."""
    return c.legendre(a, power_a) * c.legendre(b, power_b)


def pair_waves(c: Context, a: int, half_a: int, b: int, half_b: int) -> Array:
    """Cosines of so many half waves over the travels of two joints, multiplied: in a corner of both travels they are no
    larger than elsewhere, where polynomials of high order are many times so, and beyond they stay as they are."""
    u = [np.clip(c.u(k), -1.0, 1.0) for k in (a, b)]
    return np.asarray(np.cos(half_a * np.pi / 2 * (u[0] + 1)) * np.cos(half_b * np.pi / 2 * (u[1] + 1)))


def product(c: Context, joints: Sequence[int]) -> Array:
    """Positions of several joints, −1 … 1 each, multiplied."""
    return np.asarray(np.prod([c.u(k) for k in joints], axis=0))
