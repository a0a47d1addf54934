"""What the force sensor reads wrong, and what pulls beyond it: deflections wrongly expected, (N, n+1, 6)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.terms.shapes.context import Context
from ppshw.terms.shapes.covariates import covariate
from ppshw.terms.shapes.time_and_heat import clock, temperature
from ppshw.terms.shapes.wrenches import beside_the_payload, expected_by

Array = NDArray[np.float64]


def sensor_error(c: Context, component: int, **args: Any) -> Array:
    """Deflection wrongly expected when a component of the sensor is off as in `misread`."""
    return -expected_by(c, misread(c, component, **args))


def misread(
    c: Context, component: int, source: int = -1, time: str = "", place: str = "", tau: float = 0.0, bent: str = "",
    only: str = "", turned: int = -1, times: int = 1, about: int = -1,
) -> Array:  # fmt: skip
    """(N, 6) what is read too much [N, N·m] when a component of the sensor is off by 1, by its reading `source`, with
    time (form and tau of `clock`), or with a temperature (lagged by tau hours).

    component  −1: all six, each by its own reading (gain), in proportion to time or a temperature where one is given
    bent       by the square of that reading, "even" or with its sign, "odd": the gain changes with the load; by its
               size, "sided": it is another one for pull than for push
    only       of all six "forces" or "moments" alone
    turned     an axis of its own, 0 to 2: it is mounted turned about it by an angle whose sine is 1 (times 1), or whose
               versine is −1 (times 2); of any angle both
    about      its moments are about a point 1 m along an axis of its own, 0 to 2, from the origin in the machine file
    """
    count = len(c.recording)
    size = np.ones(count) if source < 0 else c.recording.wrench[:, source]
    if bent == "sided":
        size = np.abs(size)
    elif bent:
        size = size * (np.abs(size) if bent == "odd" else size)
    if time:
        size = size * clock(c, time, tau or 1.0)
    if place:
        size = size * temperature(c, place, tau)
    wrench = np.zeros((count, 6))
    if component < 0:
        vectors = c.recording.wrench.reshape(count, 2, 3)
        if turned >= 0:
            for _ in range(times):
                vectors = np.cross(vectors, np.eye(3)[turned])
        if about >= 0:
            vectors = np.stack([np.zeros((count, 3)), np.cross(vectors[:, 0], np.eye(3)[about])], axis=1)
        if only:
            vectors = vectors * (np.array(["forces", "moments"]) == only)[:, None]
        wrench = size[:, None] * vectors.reshape(count, 6)
    else:
        wrench[:, component] = size
    return wrench


def weighed(c: Context) -> Array:
    """Deflection wrongly expected by all that the sensor read beside what hung there rigidly, one payload a label."""
    return -expected_by(c, beside_the_payload(c))


def sensor_off(c: Context, component: int, name: str, knot: int, count: int) -> Array:
    """Deflection wrongly expected when a component of the sensor is off by a smooth function of any column, see
    `covariate`."""
    wrench = np.zeros((len(c.recording), 6))
    wrench[:, component] = covariate(c, name, knot, count)
    return -expected_by(c, wrench)


def pulled(c: Context, axis: int, knot: int, count: int) -> Array:
    """Deflection by a force of 1 N on the end effector, along an axis of the base (0, 1, 2) or towards it (3), times a
    smooth function of how far it reaches, see `covariate`."""
    sensor = (c.chain[:, -1] @ c.machine.sensor_in_link)[:, :3, :3]
    to = c.chain[:, 0, :3, 3] - c.chain[:, -1, :3, 3] if axis == 3 else c.chain[:, 0, :3, axis]
    force = to / np.linalg.norm(to, axis=1, keepdims=True) * covariate(c, "reach", knot, count)[:, None]
    wrench = np.concatenate([np.einsum("nji,nj->ni", sensor, force), np.zeros_like(force)], axis=1)
    return -expected_by(c, wrench)
