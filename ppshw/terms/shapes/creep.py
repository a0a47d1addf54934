"""Creep: what acts on a link that does not follow yet, by what acted there before."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppshw.terms.history import followed, hours_since_change, load_memory
from ppshw.terms.shapes.context import Context
from ppshw.terms.shapes.covariates import loads_came
from ppshw.terms.shapes.wrenches import by_payload, deflection, gravity_at_sensor, payload_wrenches, payloads_of

Array = NDArray[np.float64]
OLDEST_LOAD_H = "oldest load"  # in a calibration's reference [h]


def creeping(c: Context, frame: int, component: int, tau: float, form: str) -> Array:
    """A component of the wrench on a frame that has not come yet; forms: see `_late`. Component −1: of the weight of
    what hangs there [N], whatever its lever is in the pose; forms: see `load_memory`."""
    if component < 0:
        return np.asarray(_held(c, tau, form)[:, 0] * np.linalg.norm(gravity_at_sensor(c), axis=1))
    return np.asarray(_late(c, tau, form)[:, frame, component])


def creep(c: Context, tau: float, form: str, frame: int = -1) -> Array:
    """What is still missing of every link's deflection after load changes, or of one frame's."""
    missing = -deflection(c, _late(c, tau, form))
    if frame >= 0:
        missing[:, np.arange(missing.shape[1]) != frame] = 0.0
    return missing


def _as_seen(c: Context) -> Array:
    """(N,) hours, but after a load has lain there for longer than any did in the calibration's recording those of when
    it had lain there for so long: forms that agree as far as they were seen go far apart beyond."""

    def as_seen() -> Array:
        age = hours_since_change(c.recording.load, c.hours, loads_came(c))
        oldest = c.frozen(OLDEST_LOAD_H, float(age.max(initial=0.0)))
        return np.asarray(c.hours - np.maximum(age - oldest, 0.0))

    return c.once(("as seen",), as_seen)


def _late(c: Context, tau: float, form: str) -> Array:
    """(N, n+1, 6) of every link's wrench that it does not follow yet.

    form  "wrench": of the payload's, "total": of the machine's own weight too, a first-order lag of the wrench on the
          link, which every move changes; "began": what that adds had nothing acted there before the calibration's
          recording; else of former changes of load alone, as they act in the pose of now: see `load_memory`
    """

    def late() -> Array:
        if form == "began":
            return np.asarray(c.wrenches[:1] * np.exp(-np.maximum(c.hours, 0.0) / tau)[:, None, None])
        _as_seen(c)  # for how long loads lay there a calibration keeps, whichever form it has
        if form in ("wrench", "total"):
            whole = payload_wrenches(c) if form == "wrench" else c.wrenches
            return np.asarray(whole - followed(whole, c.hours, loads_came(c), tau))
        g, held = gravity_at_sensor(c), _held(c, tau, form)
        return by_payload(c, np.concatenate([held[:, :1] * g, np.cross(held[:, 1:], g)], axis=1))

    return c.once(("late", tau, form), late)


def _held(c: Context, tau: float, form: str) -> Array:
    """(N, 4) of payloads, as of `payloads_of`, what is still to come of former changes of load."""

    def held() -> Array:
        seen = _as_seen(c)
        return load_memory(payloads_of(c), c.recording.load, c.hours, loads_came(c), tau, form, seen)

    return c.once(("held", tau, form), held)
