"""What a site says of one axis: its drive, its scale both ways, its limits, how it approaches a target.

Checked when it is made, so that a mistake shows before anything is connected.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ppshw.errors import SiteError, SoftLimit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HomingConfig:
    """Speeds in SI units per second; `offset` is the axis position at the home switch, where the drive counts 0."""

    method: int
    offset: float = 0.0
    fast: float | None = None
    slow: float | None = None
    timeout_s: float = 120.0


@dataclass(frozen=True)
class AxisConfig:
    """One axis of a machine. Positions in m or rad, as `unit` says; counts = direction·counts_per_unit·(q − zero).

    offset               where the drive counts 0; an axis that is homed counts from its home position instead
    window, window_s     at rest means within `window` of the target for `window_s`
    following_window     the drive's following-error window; None leaves what is in the drive; following_s: for how long
    approach_from        side that the final approach comes from: −1 from below, +1 from above, None as it comes
    approach_distance    length of that final approach
    velocity_units       drive velocity units per count/s, where a maker deviates from the standard; acceleration alike
    parameters           further objects (index, sub-index) → value, written and read back before all else
    """

    name: str
    node_id: int
    counts_per_unit: float
    lower: float
    upper: float
    velocity: float
    acceleration: float
    deceleration: float | None = None
    direction: int = 1
    offset: float = 0.0
    unit: str = "m"
    window: float = 5e-5
    window_s: float = 0.05
    following_window: float | None = None
    following_s: float | None = None
    approach_from: int | None = None
    approach_distance: float = 0.0
    velocity_units: float = 1.0
    acceleration_units: float = 1.0
    homing: HomingConfig | None = None
    vendor: int | None = None
    product: int | None = None
    firmware: str | None = None
    serial: int | None = None
    parameters: Mapping[tuple[int, int], int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        positive = ("counts_per_unit", "velocity", "acceleration", "window", "velocity_units", "acceleration_units")
        for what in positive:
            if not (math.isfinite(getattr(self, what)) and getattr(self, what) > 0):
                raise SiteError(f"{self.name}: {what} must be positive, not {getattr(self, what)!r}")
        if self.direction not in (-1, 1):
            raise SiteError(f"{self.name}: direction must be -1 or 1, not {self.direction!r}")
        if self.approach_from not in (None, -1, 1):
            raise SiteError(f"{self.name}: approach_from must be -1, 1 or null, not {self.approach_from!r}")
        if self.approach_from is not None and self.approach_distance <= 0:
            raise SiteError(f"{self.name}: approach_from needs a positive approach_distance")
        if not self.lower < self.upper:
            raise SiteError(f"{self.name}: limits {self.lower:g} … {self.upper:g} leave no travel")
        if not 1 <= self.node_id <= 127:
            raise SiteError(f"{self.name}: node id {self.node_id} is not in 1 … 127")
        for end in (self.lower, self.upper):
            if not -(2**31) <= self.to_counts(end) < 2**31:
                raise SiteError(f"{self.name}: limit {end:g} {self.unit} is outside the drive's 32-bit counts")

    @property
    def zero(self) -> float:
        """Axis position where the drive counts 0."""
        return self.offset if self.homing is None else self.homing.offset

    @property
    def window_counts(self) -> int:
        """The window as a drive takes it, a count at least: a servo holds no better."""
        return max(1, round(self.window * self.counts_per_unit))

    def to_counts(self, position: float) -> int:
        return round(self.direction * self.counts_per_unit * (position - self.zero))

    def to_si(self, counts: float) -> float:
        return self.zero + self.direction * counts / self.counts_per_unit

    def require_within_limits(self, position: float) -> None:
        """Half a count beyond a limit is rounding, not a violation."""
        slack = 0.5 / self.counts_per_unit
        if not math.isfinite(position):
            raise SoftLimit(self.name, f"setpoint {position} is no position")
        if position > self.upper + slack:
            raise SoftLimit(self.name, f"setpoint {position:.6g} {self.unit} is above the limit {self.upper:g}")
        if position < self.lower - slack:
            raise SoftLimit(self.name, f"setpoint {position:.6g} {self.unit} is below the limit {self.lower:g}")

    def require_possible(self, reading: float) -> None:
        """Where an axis stands: inside its limits, or between them and its home switch, which may lie beyond."""
        home = [] if self.homing is None else [self.homing.offset]
        slack = self.window + 0.5 / self.counts_per_unit
        if not min([self.lower, *home]) - slack <= reading <= max([self.upper, *home]) + slack:
            limits = f"outside its limits {self.lower:g} … {self.upper:g} {self.unit}"
            what_to_do = "bring it back with the drive's own tool; if its encoder is wrong, see to that first"
            raise SoftLimit(self.name, f"stands at {reading:.6g} {self.unit}, {limits}: {what_to_do}")

    def approach_start(self, setpoint: float) -> float | None:
        """Where the final approach to `setpoint` begins; None where it is taken as it comes."""
        return None if self.approach_from is None else setpoint + self.approach_from * self.approach_distance

    def travel_time(self, distance: float) -> float:
        """Seconds from rest to rest, speeding up no faster than it slows down: never less than it takes."""
        slowest = min(self.acceleration, self.deceleration or self.acceleration)
        return float(trapezoid_time(distance, self.velocity, slowest))


def trapezoid_time(distance: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> Array:
    """From rest to rest: trapezoid, or triangle where it is too short for full speed: d/v + v/a, or 2 √(d/a).  [s]"""
    way, v, a = np.abs(distance), np.asarray(velocity), np.asarray(acceleration)
    return np.asarray(np.where(way >= v**2 / a, way / v + v / a, 2.0 * np.sqrt(way / a)))
