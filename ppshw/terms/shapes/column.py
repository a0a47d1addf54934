"""One function of the visits and where it acts: what effects and calibrations are made of.

A calibration's file names the function, so `FUNCTIONS` lists by its name every one that it may name; the name of a
function in the rooms beside this one is part of the format.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.terms.shapes import (
    carried,
    covariates,
    creep,
    instrument,
    loads,
    motion,
    reflectors,
    sensor,
    time_and_heat,
    wrenches,
)
from ppshw.terms.shapes.context import Context

Array = NDArray[np.float64]
FunctionOfVisits = Callable[..., Array]
What = tuple[str, tuple[tuple[str, object], ...]]
Key = tuple[str, What, int, int]


@dataclass(frozen=True)
class Column:
    """on: "frame" | "frames" | "points"; frame, component (0 to 5, or `ALONG`) where on a frame; function and its
    arguments."""

    on: str
    function: str
    args: dict[str, Any] = field(default_factory=dict)
    frame: int = 0
    component: int = 0

    @property
    def what(self) -> What:
        """What tells its function from another: arguments stand in a dictionary, which does not hash."""
        return self.function, tuple(sorted(self.args.items()))

    @property
    def key(self) -> Key:
        """What tells it from another column."""
        return self.on, self.what, self.frame, self.component

    def value(self, c: Context) -> Array:
        """The function alone: (N,) on a frame, (N, n+1, 6) on frames, (N, T, 3) on points."""
        return FUNCTIONS[self.function](c, **self.args)

    def evaluate(self, c: Context) -> Array:
        """(N, 3T) displacement of the targets per unit of the column's coefficient, base axes."""
        value = self.value(c)
        if self.on == "frame":
            return np.asarray(c.moved(self.frame, self.component) * value[:, None])
        if self.on == "frames":
            return np.asarray(np.einsum("nifk,nfk->ni", c.jacobian, value))
        return np.asarray(value.reshape(len(value), -1))

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Column:
        if data["function"] not in FUNCTIONS:
            raise ValueError(f"unknown function '{data['function']}'")
        return cls(data["on"], data["function"], dict(data["args"]), int(data["frame"]), int(data["component"]))

    def as_dict(self) -> dict[str, Any]:
        return {
            "on": self.on, "function": self.function, "args": self.args, "frame": self.frame,
            "component": self.component,
        }  # fmt: skip


def instead(c: Context, column: dict[str, Any], regions: list[dict[str, Any]]) -> Array:
    """Another column, where all of these regions had data: what else has another value beside a Gaussian process."""
    inner = Column.from_dict(column).value(c)
    return np.asarray(inner * carried.windows(c, regions).reshape(-1, *[1] * (inner.ndim - 1)))


FUNCTIONS: dict[str, FunctionOfVisits] = {
    f.__name__: f
    for f in (
        motion.approach, motion.approach_q, motion.reversal, motion.turning, motion.slipping, motion.winding,
        motion.seated, motion.wave, motion.wave_q, motion.dent, motion.splice, motion.pair, motion.pair_waves,
        motion.product,
        time_and_heat.clock, time_and_heat.clock_q, time_and_heat.step, time_and_heat.hopping, time_and_heat.settling,
        time_and_heat.temperature, time_and_heat.temperature_q, time_and_heat.link_growth,
        loads.load, loads.load_q, loads.load_near, loads.load_wave, loads.load_turn, loads.bearing, loads.load_power,
        loads.load_knee, loads.load_beyond, loads.load_side, loads.load_side_held, loads.load_bump, loads.load_slip,
        loads.load_warm, loads.softened, loads.load_legendre,
        creep.creeping, creep.creep,
        wrenches.own_weight, wrenches.own_bend, wrenches.hanging, wrenches.body_weight,
        sensor.sensor_error, sensor.weighed, sensor.sensor_off, sensor.pulled,
        instrument.scale, instrument.strain, instrument.angle_error, instrument.range_error, instrument.range_wave,
        instrument.refraction,
        reflectors.target_shift, reflectors.carrier_shift, reflectors.turned_shift,
        covariates.covariate, covariates.covariate_pair,
        carried.unexplained, carried.model_shift, instead,
    )
}  # fmt: skip
