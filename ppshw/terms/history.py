"""What happened before each visit: reversals, lagged temperatures, load changes. Covariates of effects with a memory.

Everything here is a function of a recording's visits in the order they were measured; the machine's path between two
visits is taken as straight (a move never turns back on its way).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def hours_since(start: float, time: Array) -> Array:
    """(N,) seconds since 1970 → hours since `start`; visits counted (40 an hour) where the time is unknown."""
    if not np.isfinite(time).all():
        return np.arange(len(time)) / 40.0
    return np.asarray((time - start) / 3600.0)


def slip(q: Array, approach: NDArray[np.int64], width: float) -> Array:
    """State of a slipping spring (Jenkins element): follows the motion, held within ±width, −1 … 1 when divided by it.

        z ← clip(z + Δq, −w, w)                                     (Al-Bender et al. 2005, generalized Maxwell slip)

    q (N,), approach (N,) of the first visit sets where it starts; width in the joint's unit.
    """
    z = float(approach[0]) * width if len(approach) else 0.0
    out = np.empty(len(q))
    for k in range(len(q)):
        if k:
            z = min(width, max(-width, z + q[k] - q[k - 1]))
        # a visit says from which side it came: a move there and back between visits leaves its mark
        if approach[k] * (q[k] - q[max(k - 1, 0)]) < 0:
            z = float(approach[k]) * width
        out[k] = z
    return out / width


def lagged(values: Array, hours: Array, tau: float) -> Array:
    """First-order lag with time constant tau [h] of a sampled quantity; tau = 0: the quantity itself."""
    if tau <= 0:
        return values
    out = np.empty(len(values))
    state = values[0]
    for k in range(len(values)):
        if k:
            share = 1.0 - np.exp(-max(0.0, hours[k] - hours[k - 1]) / tau)
            state = state + share * (0.5 * (values[k] + values[k - 1]) - state)
        out[k] = state
    return out


def load_memory(wrench: Array, load: tuple[str, ...], hours: Array, tau: float) -> Array:
    """How much of each past load change is still felt: Σ ΔW exp(−t/τ).

    wrench  (N, 6) on a frame;  load labels say when the payload was changed (the wrench alone changes with every pose)
    returns (N, 6): multiply by −compliance for a deflection that is still to come
    """
    out = np.zeros_like(wrench)
    state = np.zeros(6)
    level = wrench[0]
    for k in range(1, len(wrench)):
        state = state * np.exp(-max(0.0, hours[k] - hours[k - 1]) / tau)
        if load[k] != load[k - 1]:
            state = state + wrench[k] - level
        level = wrench[k]
        out[k] = state
    return out


def hours_since_change(load: tuple[str, ...], hours: Array) -> Array:
    """(N,) hours since the load label last changed."""
    out = np.empty(len(load))
    since = hours[0]
    for k in range(len(load)):
        if k and load[k] != load[k - 1]:
            since = 0.5 * (hours[k] + hours[k - 1])
        out[k] = hours[k] - since
    return out
