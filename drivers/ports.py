"""What the campaign needs of a device, as Protocols. A new instrument is one more file that fits one of these.

Time is handed in as a `Clock`: on site it is the wall clock; in tests it is stepped by hand, so that nothing sleeps.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Clock(Protocol):
    """Seconds of machine time. Waiting for a message takes real time; waiting for a motion takes machine time."""

    def now(self) -> float:
        """Monotonic seconds."""

    def utc(self) -> datetime:
        """The time of day, timezone-aware, that goes with now()."""

    def sleep(self, seconds: float) -> None: ...

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout: float) -> bool:
        """Wait on a held condition until predicate() or until `timeout` seconds of machine time have passed."""


class WallClock:
    """Real time; `speed` > 1 runs a simulated plant in another process faster than real time.

    epoch   seconds since 1970 at which hurried time and real time agreed: every process given the same epoch and
            speed reads the same time of day, so that a run that is taken up again finds it later and not earlier
    """

    def __init__(self, speed: float = 1.0, epoch: float | None = None) -> None:
        self.speed = speed
        self._monotonic_0 = time.monotonic()
        real = time.time()
        self._utc_0 = real if epoch is None else epoch + (real - epoch) * speed

    def now(self) -> float:
        return (time.monotonic() - self._monotonic_0) * self.speed

    def utc(self) -> datetime:
        return datetime.fromtimestamp(self._utc_0 + self.now(), UTC)

    def sleep(self, seconds: float) -> None:
        time.sleep(max(0.0, seconds) / self.speed)

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout: float) -> bool:
        return condition.wait_for(predicate, max(0.0, timeout) / self.speed)


@dataclass(frozen=True)
class DeviceInfo:
    """Who a device says it is and how it is; what `ppshw check` prints.

    problem  why it cannot be used; empty: nothing known
    """

    device: str
    model: str
    serial: str
    firmware: str
    status: str
    problem: str = ""


@dataclass(frozen=True)
class MoveReport:
    """How a group move ended.

    positions   joint value per axis at rest, encoder, SI
    approach    −1, 0, 1 per axis: direction of the axis' last motion (0: has not moved yet)
    ended_at    Clock.now() when the last axis came to rest (start of the settle window), in a move before where this
                one moved nothing
    """

    positions: Mapping[str, float]
    approach: Mapping[str, int]
    ended_at: float


def not_stopped(axes: Sequence[str]) -> str:
    """What somebody who stands there must be told of `unstopped` axes."""
    return f"{', '.join(axes)} could NOT be told to stop, and may move or hold power: press the emergency stop"


class AxisGroup(Protocol):
    """All axes of a machine; one fault stops them all.

    unstopped  axes of which neither the last quick stop nor closing could see that they obeyed and stood
    """

    names: Sequence[str]

    @property
    def unstopped(self) -> Sequence[str]: ...

    def connect(self) -> None:
        """Open the bus for this program alone; asks, enables and moves nothing. Raises BusTaken where another program
        has it."""

    def check(self) -> list[DeviceInfo]:
        """Connect and say who and how each drive is; enables and moves nothing."""

    def look(self) -> list[DeviceInfo]:
        """check() that does not end at the first drive that cannot be used: its row says why. One row for a bus that
        cannot be opened."""

    def start(self) -> list[str]:
        """Check identities, write and read back the configuration, start supervision, enable, home if needed.

        Returns the axes that were homed: their zeros are new.
        """

    def move(self, setpoints: Mapping[str, float]) -> MoveReport:
        """Drive to the setpoints, all axes starting together; returns when all are settled."""

    def positions(self) -> dict[str, float]: ...

    def reset_faults(self) -> None:
        """Acknowledge the faults of all drives; enables none."""

    def raise_if_faulty(self) -> None:
        """Look at every started axis: raise the HardwareError of one that is silent, faulty or no longer enabled, after
        all were stopped."""

    def require_at_rest(self, at: Mapping[str, float], within: float | None = None) -> None:
        """raise_if_faulty(), and raise for an axis that is farther than `within` (None: than its window) from where it
        was (`at`)  [m or rad]."""

    def quick_stop(self) -> None:
        """Stop every axis now; never raises. What did not obey is in `unstopped`."""

    def close(self) -> None: ...


@dataclass(frozen=True)
class Atmosphere:
    temperature_c: float
    pressure_hpa: float
    humidity_pct: float


@dataclass(frozen=True)
class Shot:
    """One measured target.

    target       the name asked for
    xyz          (3,) position in the tracker's frame, corrected for the atmosphere  [m]
    raw          the instrument's own numbers (angles [rad], distance [m], …), before any correction
    ppm          the refraction correction that was applied on the host, parts per million
    atmosphere   what the air was when it was applied
    """

    target: str
    xyz: Array
    raw: Mapping[str, float]
    ppm: float
    atmosphere: Atmosphere
    extra: Mapping[str, str] = field(default_factory=dict)


class Tracker(Protocol):
    name: str

    def check(self) -> DeviceInfo: ...

    def start(self) -> None: ...

    def set_atmosphere(self, atmosphere: Atmosphere) -> None: ...

    def measure(self, target: str, expected: Array) -> Shot:
        """Point at `expected` (3,) [m, tracker frame], lock on, measure. Raises BeamLost when nothing is there."""

    def close(self) -> None: ...


@dataclass(frozen=True)
class WrenchReading:
    """wrench (6,) median over `samples` frames [N, N·m]; spread (6,) their standard deviation."""

    wrench: Array
    spread: Array
    samples: int
    temperature_c: float | None = None


class ForceSensor(Protocol):
    name: str

    def check(self) -> DeviceInfo: ...

    def start(self) -> None: ...

    def read(self) -> WrenchReading:
        """Payload wrench on the sensor, sensor frame. Raises SensorOverrange, ProtocolError, HardwareTimeout."""

    def close(self) -> None: ...


class Thermometer(Protocol):
    """Places and their temperatures in °C; a recording gets one `temp_<place>_C` column each."""

    name: str

    def check(self) -> DeviceInfo: ...

    def read(self) -> Mapping[str, float]: ...
