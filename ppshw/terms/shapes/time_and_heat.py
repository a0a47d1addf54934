"""Functions of the time and of temperatures: courses, steps, what follows a thermometer late. (N,) but where said.

Times, time constants and moments in hours, from the start of the recording that a calibration was made from;
temperatures in kelvin above their mean there; joint 0 … n−1, its position −1 … 1 over what was sampled.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ppshw.terms.history import lagged
from ppshw.terms.shapes.context import Context

Array = NDArray[np.float64]


def clock(c: Context, form: str, tau: float = 1.0) -> Array:
    """Time since the start.

    form  "linear" [h], "exponential" 1 − e^(−t/τ) and "log" ln(1 + t/τ), both 0 before the start; "step" 1 and "ramp"
          t − τ from τ on, "until" t up to τ: both carried on for as long again as they were seen; "cosine" of τ half
          waves over the recording, which fades before and after it, to 1/e in the time of one radian of the wave;
          "beat_cos" and "beat_sin" of as many, 0 beyond it
    """
    t = c.clock

    def lasted() -> float:
        return max(c.frozen("hours", float(t[-1])), 1e-9)

    match form:
        case "linear":
            return t
        case "exponential":
            return np.asarray(1.0 - np.exp(-np.maximum(t, 0.0) / tau))
        case "log":
            return np.asarray(np.log1p(np.maximum(t, 0.0) / tau))
        case "step":
            return step(c, tau)
        case "ramp":
            return np.clip(t - tau, 0.0, 2.0 * max(lasted() - tau, 0.0))
        case "until":
            return np.clip(t, -tau, tau)
        case "cosine":  # what wanders without a law is forgotten as fast as it changed
            phase, whole = np.pi * tau * c.hours / lasted(), np.pi * tau
            inside = np.clip(phase, 0.0, whole)
            return np.asarray(np.cos(inside) * np.exp(-np.abs(phase - inside)))
        case "beat_cos" | "beat_sin":  # where a beat is later, nobody knows
            wave, whole = np.cos if form == "beat_cos" else np.sin, lasted()
            return np.asarray(wave(np.pi * tau * t / whole) * ((c.hours >= 0.0) & (c.hours <= whole)))
    raise ValueError(f"unknown course in time '{form}'")


def clock_q(c: Context, order: int, joint: int) -> Array:
    """A wave in time, the `order`-th half wave over the recording, times a joint's position."""
    return clock(c, "cosine", order) * c.u(joint)


def step(c: Context, visit_time: float) -> Array:
    """1 from a moment on (hours since the start)."""
    return np.asarray((c.hours >= visit_time).astype(float))


def hopping(c: Context, times: Sequence[float]) -> Array:
    """0 and 1 by turns: another one from each of these moments on (hours since the start, rising)."""
    return np.asarray((np.searchsorted(times, c.hours, side="right") % 2).astype(float))


def settling(c: Context, visit_time: float, tau: float) -> Array:
    """e^(−(t − t₀)/τ) from a moment t₀ on: what a step loses again."""
    late = c.hours - visit_time
    return np.asarray(np.where(late >= 0, np.exp(-np.maximum(late, 0.0) / tau), 0.0))


def temperature(c: Context, place: str, tau: float, than: float | None = None) -> Array:
    """A thermometer's temperature, lagged by `tau` (0: as it reads), above its mean; above itself lagged by `than`
    instead where that is given: nothing where it has been steady for long."""
    if than is not None:
        return temperature(c, place, tau) - temperature(c, place, than)
    values = c.recording.temperatures[place]
    mean = c.frozen(f"mean.{place}", float(np.mean(values)))
    return c.once(("temperature", place, tau), lambda: lagged(values, c.hours, tau) - mean)


def temperature_q(c: Context, place: str, tau: float, joint: int, than: float | None = None) -> Array:
    """The same times a joint's position: a rail that grows along its travel."""
    return temperature(c, place, tau, than) * c.u(joint)


def link_growth(c: Context, place: str, tau: float, joint: int, than: float | None = None) -> Array:
    """(N, n+1, 6) the link behind a joint (−1: every one) longer by a metre per metre and kelvin, towards the next
    joint or the tip; `than` as in `temperature`."""
    machine, warm = c.machine, temperature(c, place, tau, than)[:, None]
    out = np.zeros((len(c.hours), machine.n + 1, 6))
    for k in range(machine.n) if joint < 0 else (joint,):
        after = machine.joints[k + 1].origin if k + 1 < machine.n else machine.tip_in_link
        out[:, k + 1, :3] = warm * after[:3, 3]
    return out
