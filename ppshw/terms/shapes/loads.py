"""Functions of a component of the wrench on a frame: (N,); of several, what they do to the frames: (N, n+1, 6).

frame 0 … n (0: the base), component 0 … 5: Fx, Fy, Fz [N], Mx, My, Mz [N·m] in the frame's own axes, payload and the
machine's own bodies together; joint 0 … n−1, its position −1 … 1 over what was sampled. A function is in the
component's unit where nothing else is said; sides, bumps and polynomials are pure numbers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppshw.terms.history import side_held, slip
from ppshw.terms.shapes.context import Context
from ppshw.terms.shapes.covariates import bump
from ppshw.terms.shapes.time_and_heat import temperature
from ppshw.terms.shapes.wrenches import deflection, own_weight

Array = NDArray[np.float64]


def load(c: Context, frame: int, component: int) -> Array:
    """The component itself: what a spring gives way by."""
    return np.asarray(c.wrenches[:, frame, component])


def load_q(c: Context, frame: int, component: int, joint: int, degree: int = 1) -> Array:
    """Times a power of a joint's position: a spring that gets softer along a travel."""
    return np.asarray(c.wrenches[:, frame, component] * c.u(joint) ** degree)


def load_near(c: Context, frame: int, component: int, joint: int, at: float, width: float) -> Array:
    """Times a window over a joint's position [m, rad], 1 at `at` and nothing from `width` away: a spring that is softer
    over a stretch of a travel, where a bolt is loose or a race worn."""
    away = np.minimum(np.abs(c.recording.q[:, joint] - at) / width, 1.0)
    return np.asarray(c.wrenches[:, frame, component] * np.cos(0.5 * np.pi * away) ** 2)


def load_wave(c: Context, frame: int, component: int, joint: int, period: float, phase: str) -> Array:
    """Times a wave of a joint's position: a spring that is softer between posts than on them."""
    angle = 2 * np.pi * c.recording.q[:, joint] / period
    return np.asarray(c.wrenches[:, frame, component] * (np.sin(angle) if phase == "sin" else np.cos(angle)))


def load_turn(c: Context, frame: int, component: int, joint: int, order: int, phase: str) -> Array:
    """A component of the wrench on a frame times sine or cosine of `order` times a joint's angle: what gives way more
    in some directions than in others."""
    angle = order * c.recording.q[:, joint]
    return np.asarray(c.wrenches[:, frame, component] * (np.sin(angle) if phase == "sin" else np.cos(angle)))


def bearing(c: Context, frame: int, joint: int, phase: str) -> Array:
    """(N, n+1, 6) what the moments across a turning joint's axis do behind it, per rad/(N m), if its bearing is softer
    against tilt in one direction of its housing than across that: along two axes of the frame (phase "cos") at angle 0,
    or between them ("sin"). The frame turns; the bearing's ring stays."""
    axis = c.machine.joints[joint].axis
    along = int(np.argmax(np.abs(axis)))
    first, second = (along + 1) % 3, (along + 2) % 3
    angle = 2.0 * c.recording.q[:, joint] * np.sign(axis[along])
    cos, sin = (np.cos(angle), -np.sin(angle)) if phase == "cos" else (np.sin(angle), np.cos(angle))
    moments = c.wrenches[:, frame, 3:]
    out = np.zeros_like(c.wrenches)
    out[:, frame, 3 + first] = cos * moments[:, first] + sin * moments[:, second]
    out[:, frame, 3 + second] = sin * moments[:, first] - cos * moments[:, second]
    return out


def load_power(c: Context, frame: int, component: int, exponent: float) -> Array:
    """sgn(w)|w|^exponent, in units of w at the largest that was seen: a contact (Hertz: 2/3)."""
    w = c.wrenches[:, frame, component]
    return np.asarray(np.sign(w) * np.abs(w) ** exponent / _most(c, frame, component) ** (exponent - 1))


def load_knee(c: Context, frame: int, component: int, at: float, width: float) -> Array:
    """How far a component of the wrench on a frame is above `at`, rounded over `width` (both N or N m): what is stiffer
    on one side of a load than on the other."""
    above = c.wrenches[:, frame, component] - at
    return np.asarray(0.5 * (above + np.hypot(above, width)))


def load_beyond(c: Context, frame: int, component: int, at: float, width: float) -> Array:
    """How far a component of the wrench on a frame is beyond `at` to either side, rounded over `width` (both N or N m):
    what is softer once a preload is lost."""
    w = c.wrenches[:, frame, component]
    above, below = w - at, -w - at
    return np.asarray(0.5 * (above + np.hypot(above, width)) - 0.5 * (below + np.hypot(below, width)))


def load_side(
    c: Context, frame: int, component: int, width: float, offset: float = 0.0, of: str = "", either: bool = False,
    hard: bool = False,
) -> Array:  # fmt: skip
    """Which side a joint falls to: −1 … 1, saturating; width and offset relative to that load's spread.

    of      "payload": by what the payload does to it alone, as if its own weight were balanced
    either  how far from the middle, to whichever side: 0 … 1; beside the former, a gap that is wider on one side
    hard    in proportion to the load until it lies on that side, and no farther
    """
    at = (load_of(c, frame, component, of) / _spread(c, frame, component, of) - offset) / width
    side = np.clip(at, -1.0, 1.0) if hard else np.tanh(at)
    return np.asarray(np.abs(side) if either else side)


def load_of(c: Context, frame: int, component: int, of: str = "") -> Array:
    """A component of the wrench on a frame; of "payload": without what the machine's own bodies do."""
    w = c.wrenches[:, frame, component]
    return np.asarray(w - own_weight(c, frame, component)) if of == "payload" else w


def load_side_held(
    c: Context, frame: int, component: int, width: float, start: int = 0, offset: float = 0.0
) -> Array:  # fmt: skip
    """Which side a joint lies on that stays until the load pushes it over: −1 or 1; width and offset relative to the
    spread; start: the side at first, where that is known."""
    spread = _spread(c, frame, component)
    return side_held(c.wrenches[:, frame, component] - offset * spread, width * spread, start)


def load_bump(c: Context, frame: int, component: int, knot: int, count: int) -> Array:
    """A smooth function of a component of the wrench on a frame, finest where it changes sign: the knot-th of `count`
    Gaussian bumps over ± the root of its size."""
    w = c.wrenches[:, frame, component]
    at = np.sign(w) * np.sqrt(np.minimum(np.abs(w) / _most(c, frame, component), 1.0))
    return bump((at + 1.0) / 2.0, knot, count)


def load_slip(c: Context, frame: int, component: int, width: float) -> Array:
    """A slipping spring (`slip`) driven by a component of the wrench on a frame, width relative to the load's spread:
    any hysteresis of a load is a sum of such, unless it depends on how fast the load changes."""
    w = c.wrenches[:, frame, component]
    began = np.zeros(len(w), dtype=np.int64)  # a load comes from the side that it goes to
    began[:1] = np.sign(w[:1])
    return slip(w, began, width * _spread(c, frame, component))


def load_warm(c: Context, frame: int, component: int, place: str, tau: float, width: float = 0.0) -> Array:
    """A component of the wrench on a frame, relative to its spread, or which side the joint falls to by it (width as in
    `load_side`), times a temperature lagged by tau hours: what gives way differently as it warms."""
    w = c.wrenches[:, frame, component]
    spread = _spread(c, frame, component)
    pushed = load_side(c, frame, component, width) if width else w / spread
    return np.asarray(pushed * temperature(c, place, tau))


def softened(c: Context, frame: int, place: str, tau: float) -> Array:
    """(N, n+1, 6) a frame's whole deflection, as stiff as the calibration has it, times a temperature lagged by tau
    hours: a link that gets softer in all directions alike as it warms."""
    out = np.zeros_like(c.wrenches)
    out[:, frame] = deflection(c, c.wrenches)[:, frame] * temperature(c, place, tau)[:, None]
    return out


def load_legendre(c: Context, frame: int, component: int, order: int) -> Array:
    """Legendre polynomial of a component of the wrench on a frame, −1 … 1 over what was seen: what ranks
    (`covariate`) resolve badly at the ends."""
    w = c.wrenches[:, frame, component]
    low, high = c.frozen(f"least.{frame}.{component}", w.min()), c.frozen(f"greatest.{frame}.{component}", w.max())
    scaled = np.clip((w - (low + high) / 2) / max((high - low) / 2, 1e-9), -1.0, 1.0)
    return np.asarray(np.polynomial.legendre.legval(scaled, [0.0] * order + [1.0]))


def _spread(c: Context, frame: int, component: int, of: str = "") -> float:
    """Standard deviation of a component of the wrench on a frame, or of what `load_of` takes of it."""
    key = f"spread.{frame}.{component}{'.' if of else ''}{of}"
    return max(c.frozen(key, float(load_of(c, frame, component, of).std())), 1e-9)


def _most(c: Context, frame: int, component: int) -> float:
    return max(c.frozen(f"most.{frame}.{component}", float(np.abs(c.wrenches[:, frame, component]).max())), 1e-9)
