"""What happened before each visit: reversals, lagged temperatures, load changes. Covariates of effects with a memory.

Everything here is a function of a recording's visits in the order they were measured; the machine's path between two
visits is taken as straight (a move never turns back on its way).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ppshw.recording import STANDSTILL

Array = NDArray[np.float64]
UNSEEN = 1e-2  # of the largest singular value: along gravity that hardly turns a first moment does nothing
FORGOTTEN_H = 8.0  # when creep with the logarithm of time is taken to have ended; a guess: a shift


def hours_since(start: float, time: Array) -> Array:
    """(N,) seconds since 1970 → hours since `start`; visits counted (40 an hour) where the time is unknown."""
    if not np.isfinite(time).all():
        return np.arange(len(time)) / 40.0
    return np.asarray((time - start) / 3600.0)


def slip(q: Array, approach: NDArray[np.int64], width: float, past: float = math.inf) -> Array:
    """State of a slipping spring (Jenkins element): follows the motion, held within ±width, −1 … 1 when divided by it.

        z ← clip(z + Δq, −w, w)                                     (Al-Bender et al. 2005, generalized Maxwell slip)

    q (N,), approach (N,) of the first visit sets where it starts; width in the joint's unit; past: how far it went past
    where it then came to from the other side, in its unit (more than any width where nobody says).
    """
    z = float(approach[0]) * width if len(approach) else 0.0
    out = np.empty(len(q))
    for k, ways in enumerate(_ways(q, approach, past)):
        for way in ways:
            z = min(width, max(-width, z + way))
        out[k] = z
    return out / width


def _ways(q: Array, approach: NDArray[np.int64], past: float) -> list[tuple[float, ...]]:
    """Per visit the ways that the joint went one after the other, each to one side."""
    return [
        (step - float(side) * past, float(side) * past) if anew else (step,) if step else ()
        for (step, anew), side in zip(_steps(q, approach), approach, strict=True)
    ]


def _steps(q: Array, approach: NDArray[np.int64]) -> list[tuple[float, bool]]:
    """Per visit how far the joint went, and whether it came from the other side than that way says: a move there and
    back between visits leaves its mark. What an encoder reads anew at standstill is no step."""
    if not len(q):
        return []
    step, side = np.diff(q), approach[1:]
    step = np.where(np.abs(step) > STANDSTILL * float(np.ptp(q)), step, 0.0)
    turned = np.where(step != 0.0, side * step, side * approach[:-1]) < 0
    return [(0.0, False), *zip(step.tolist(), turned.tolist(), strict=True)]


def wind_up(
    q: Array, approach: NDArray[np.int64], way: float, past: float = math.inf, left: Array | None = None
) -> Array:
    """Friction that builds up exponentially with the way since the last reversal, −1 … 1.

        dz = dq (1 − z sgn dq)/way                                  (Dahl 1968, exponent 1)

    q (N,), approach (N,), past as in `slip`; way in the joint's unit; left (N,): the share of it that is left from the
    visit before when it moves on (None: all).
    """
    z = float(approach[0]) if len(approach) else 0.0
    shares = [1.0] * len(q) if left is None else left.tolist()
    out = np.empty(len(q))
    for k, ways in enumerate(_ways(q, approach, past)):
        z *= shares[k]
        for gone in ways:
            wall = math.copysign(1.0, gone)
            z = wall + (z - wall) * math.exp(-abs(gone) / way)
        out[k] = z
    return out


def way_since_reversal(q: Array, approach: NDArray[np.int64]) -> Array:
    """(N,) how far the joint has gone since it last turned back, in its unit; as far as it ever travels where it came
    from the other side by a move that no visit shows."""
    out, far = np.zeros(len(q)), float(np.ptp(q))
    gone, direction = 0.0, 0.0
    for k, (step, anew) in enumerate(_steps(q, approach)):
        if anew:
            gone, direction = far, float(approach[k])
        elif step:
            gone = min(far, abs(step) + (gone if step * direction > 0 else 0.0))
            direction = float(np.sign(step))
        out[k] = gone
    return out


def lagged(values: Array, hours: Array, tau: float) -> Array:
    """First-order lag with time constant tau [h] of values (N,) at hours (N,) that go straight from one visit to the
    next; tau = 0: the values themselves. Returns (N,) in their unit."""
    if tau <= 0:
        return values
    out = np.empty(len(values))
    state = values[0]
    for k in range(len(values)):
        if k:
            way = max(0.0, hours[k] - hours[k - 1]) / tau
            behind = -math.expm1(-way) / way if way > 0.0 else 1.0  # share of the change that has not come
            state = values[k] - behind * (values[k] - values[k - 1]) + math.exp(-way) * (state - values[k - 1])
        out[k] = state
    return out


def changed_at(load: Sequence[str], hours: Array, load_age_s: Array | None) -> Array:
    """(N,) hours at which what is at a visit came: its load, where that is another one than before and somebody wrote
    down for how long it had lain there [s], and else halfway since the visit before."""
    before = np.concatenate([hours[:1], hours[:-1]])
    halfway = 0.5 * (before + hours)
    if load_age_s is None:
        return np.asarray(halfway)
    another = np.array([k > 0 and load[k] != load[k - 1] for k in range(len(load))])
    came = np.clip(hours - load_age_s / 3600.0, before, hours)
    return np.where(another & np.isfinite(came), came, halfway)


def followed(values: Array, hours: Array, came: Array, tau: float) -> Array:
    """First-order lag with time constant tau [h] of values (N, …) that stand still but for a step between two visits at
    `came` (N,) [h], and had stood for long before the first."""
    out = np.array(values, dtype=float)
    for k in range(1, len(out)):
        middle = values[k - 1] + (out[k - 1] - values[k - 1]) * np.exp(-max(0.0, came[k] - hours[k - 1]) / tau)
        out[k] = values[k] + (middle - values[k]) * np.exp(-max(0.0, hours[k] - came[k]) / tau)
    return out


def former(values: Array, load: tuple[str, ...]) -> Array:
    """(N,) the value at the last visit under the load before this one; under the first load its own first value."""
    out = np.empty(len(values))
    before = values[0]
    for k in range(len(values)):
        if k and load[k] != load[k - 1]:
            before = values[k - 1]
        out[k] = before
    return out


def payloads(wrench: Array, load: tuple[str, ...], gravity: Array) -> Array:
    """What a rigid payload must be that the sensor felt so, one for all visits of a load label, by least squares:

        F = m g,   M = S × g                                        (S = m r, the first moment about the sensor)

    wrench (N, 6) and gravity (N, 3) in the sensor frame; what no visit shows of S (along g) is 0
    returns (N, 4): mass [kg], first moment [kg·m]
    """
    labels = np.array(load)
    out = np.empty((len(wrench), 4))
    for label in dict.fromkeys(load):
        mine = labels == label
        g = gravity[mine]
        mass = float((g * wrench[mine, :3]).sum() / max(float((g**2).sum()), 1e-30))
        moment = np.linalg.lstsq(_minus_cross(g).reshape(-1, 3), wrench[mine, 3:].ravel(), rcond=UNSEEN)[0]
        out[mine] = np.concatenate([[mass], moment])
    return out


def unseen_moment(gravity: Array) -> Array:
    """(3,) unit vector along which gravity (N, 3) tells nothing of a first moment, as `payloads` takes it, or (0,)."""
    _, size, directions = np.linalg.svd(_minus_cross(gravity).reshape(-1, 3), full_matrices=False)
    return np.asarray(directions[-1] if size[-1] < UNSEEN * size[0] else directions[0, :0])


def weighs(held: Array, gravity: Array) -> Array:
    """(N, 6) what rigid payloads (N, 4), or one (1, 4), as of `payloads`, make the sensor feel under gravity (N, 3), in
    its frame."""
    return np.concatenate([held[:, :1] * gravity, np.cross(held[:, 1:], gravity)], axis=1)


def beside_payloads(wrenches: Array, load: tuple[str, ...], gravity: Array) -> Array:
    """What no rigid payloads make of wrenches (k, N, 6), one of `payloads` for each label of each: (k, N, 6)."""
    out = wrenches.copy()
    labels = np.array(load)
    for label in dict.fromkeys(load):
        mine = np.flatnonzero(labels == label)
        g, some = gravity[mine], wrenches[:, mine]
        mass = np.einsum("nb,knb->k", g, some[..., :3]) / max(float((g**2).sum()), 1e-30)
        out[:, mine, :3] -= mass[:, None, None] * g
        turns = _minus_cross(g).reshape(-1, 3)
        moment = some[..., 3:].reshape(len(some), -1) @ np.linalg.pinv(turns, rcond=UNSEEN).T
        out[:, mine, 3:] -= (moment @ turns.T).reshape(len(some), -1, 3)
    return out


def _minus_cross(g: Array) -> Array:
    """(N, 3, 3) of gravity (N, 3): S × g = −[g]× S."""
    out = np.zeros((len(g), 3, 3))
    out[:, [0, 1, 2], [1, 2, 0]] = g[:, [2, 0, 1]]
    out[:, [0, 1, 2], [2, 0, 1]] = -g[:, [1, 2, 0]]
    return out


def load_memory(
    payload: Array, load: tuple[str, ...], hours: Array, came: Array, tau: float, form: str, asked: Array | None = None
) -> Array:  # fmt: skip
    """What of the load changes is still to come: loads superpose (Boltzmann), Σ ΔL r(age), with

        r = e^(−age/τ)  ("exponential"),   r = 1 − ln(1 + age/τ)/ln(1 + FORGOTTEN/τ), 0 from then on  ("log")

    What hung there before the first visit is taken to have hung there for long; "first" is e^(−t/τ) of it, had it come
    just when the calibration's recording began (`hours` 0; before that all of it). "last" is what the last change alone
    does, as the logarithm of its age.

    payload  (N, k) in any measure that adds up
    hours    (N,) of the visits;  came (N,) when the load of each did, as of `changed_at`
    asked    (N,) when each is asked for, None: at its visit
    returns  (N, k)
    """
    asked = hours if asked is None else asked
    if form == "first":
        return np.asarray(payload[0] * np.exp(-np.maximum(asked, 0.0) / tau)[:, None])
    out = np.zeros_like(payload)
    for k in range(1, len(payload)):
        if load[k] == load[k - 1]:
            continue
        age = asked[k:] - came[k]
        if form == "exponential":
            remaining = np.exp(-age / tau)
        elif form == "last":
            out[k:] = 0.0
            remaining = -np.log1p(age / tau) / np.log1p(FORGOTTEN_H / tau)
        else:
            remaining = np.maximum(1.0 - np.log1p(age / tau) / np.log1p(FORGOTTEN_H / tau), 0.0)
        out[k:] += (payload[k] - payload[k - 1]) * remaining[:, None]
    return out


def side_held(load: Array, width: float, start: int = 0) -> Array:
    """(N,) 1 or −1: the side a joint with play was last pushed to by more than ±width, and lies on since; before that
    on the one that it started on, by the sign of the first load where nobody says."""
    side = np.sign(np.where(np.abs(load) > width, load, 0.0))
    last = np.maximum.accumulate(np.where(side != 0, np.arange(len(load)), -1))
    return np.asarray(np.where(last >= 0, side[np.maximum(last, 0)], start or np.sign(load[0]) or 1.0))


def hours_since_change(load: tuple[str, ...], hours: Array, came: Array) -> Array:
    """(N,) hours since the load label last changed; came (N,) [h] as of `changed_at`."""
    out = np.empty(len(load))
    since = hours[0]
    for k in range(len(load)):
        if k and load[k] != load[k - 1]:
            since = came[k]
        out[k] = hours[k] - since
    return out
