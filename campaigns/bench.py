"""Named axes and instruments under one context manager: on any way out the axes stop and every device is closed."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from drivers.ports import (
    Atmosphere,
    AxisGroup,
    Clock,
    DeviceInfo,
    ForceSensor,
    Thermometer,
    Tracker,
    WallClock,
    not_stopped,
)
from ppshw import kinematics
from ppshw.errors import BusTaken, HardwareError
from ppshw.interruptions import INTERRUPTIONS
from ppshw.machine import Machine
from ppshw.transforms import inverse

Array = NDArray[np.float64]
# Joint values (n,) and a target's name → where the tracker should look (3,) [m, tracker frame].
Aim = Callable[[Array, str], Array]

STANDARD_AIR = Atmosphere(temperature_c=20.0, pressure_hpa=1013.25, humidity_pct=50.0)


@dataclass
class Bench:
    """force_sensor None: a machine without one; its recordings have no wrench columns filled.

    atmosphere  the air now; its temperature is recorded as `temp_air_C`
    notes       what goes into the recording's meta (the site file's text and hash)
    homed       the axes that were homed at the last start
    places      of which temperatures are recorded since the last start, a force sensor's own one with them
    """

    axes: AxisGroup
    tracker: Tracker
    force_sensor: ForceSensor | None
    clock: Clock
    aim: Aim
    thermometers: tuple[Thermometer, ...] = ()
    atmosphere: Callable[[], Atmosphere] = lambda: STANDARD_AIR
    notes: Mapping[str, str] = field(default_factory=dict)
    homed: tuple[str, ...] = field(default=(), init=False)
    places: tuple[str, ...] = field(default=(), init=False)
    _started: bool = field(default=False, init=False)
    _places: tuple[str, ...] = field(default=(), init=False)  # of the thermometers, at the first look
    _until_closed: ExitStack = field(default_factory=ExitStack, init=False)

    def __enter__(self) -> Bench:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        # a second Ctrl-C must not leave motors on behind it
        with self._until_closed, uninterrupted():
            try:
                self.stop()
            finally:
                problems = self._close()
        if error is None and problems:
            error = problems.pop(0)
        for problem in problems:  # the first error is the cause; these stay with it for whoever debugs
            assert error is not None
            error.add_note(f"while closing: {problem}")
        if self.axes.unstopped:
            raise _with_unstopped(error, self.axes.unstopped) from error
        if kind is None and error is not None:
            raise error

    def check(self) -> list[DeviceInfo]:
        """Who every device is and how it is; nothing moves. Raises for the first that does not answer."""
        return [*self.axes.check(), *(device.check() for device in self._instruments())]

    def look(self) -> list[DeviceInfo]:
        """check() that goes through every device: a row each, with the problem of those that cannot be used. Where
        another program has the axes, instruments are not asked anything: it would hear the answers."""
        rows, taken = self.axes.look(), False
        try:
            self.axes.connect()
        except HardwareError as error:  # as the rows say
            taken = isinstance(error, BusTaken)
        for device in self._instruments():
            try:
                if taken:
                    raise HardwareError(device.name, "not asked: the program that has the axes may be measuring")
                rows.append(device.check())
            except HardwareError as error:
                rows.append(DeviceInfo(device.name, "", "", "", "", error.cause))
        return rows

    def _instruments(self) -> list[Tracker | ForceSensor | Thermometer]:
        sensors = [] if self.force_sensor is None else [self.force_sensor]
        return [self.tracker, *sensors, *self.thermometers]

    def start(self, reset_faults: bool = False) -> list[DeviceInfo]:
        """Make everything ready: instruments first, so that no axis is enabled beside a dead tracker or thermometer;
        but where another program has the axes, they are its, too.

        reset_faults  acknowledge what the drives have reported; never done unasked
        """
        self.axes.connect()
        self.tracker.start()
        if self.force_sensor is not None:
            self.force_sensor.start()
        found = self.check()
        places, own = list(self.temperatures()), self._of_the_sensor()
        if own and own[0] in places:
            raise HardwareError("thermometers", f"a place is called '{own[0]}', as the sensor's own")
        self.places = (*places, *own)
        self.start_axes(reset_faults)
        return found

    def _of_the_sensor(self) -> list[str]:
        has_one = self.force_sensor is not None and self.force_sensor.read().temperature_c is not None
        return ["force_sensor"] if has_one else []

    def start_axes(self, reset_faults: bool = False) -> None:
        """The axes alone, for a move that measures nothing."""
        if reset_faults:
            self.axes.reset_faults()
        self._started = True
        if isinstance(self.clock, WallClock):  # a machine simulated in this process is suspended with it
            self._until_closed.enter_context(not_suspended())
        self.homed = tuple(self.axes.start())

    def temperatures(self) -> dict[str, float]:
        """Place → °C of every thermometer; `air` is the tracker's atmosphere where no thermometer hangs there.

        A place that two thermometers claim is a HardwareError, and so is one that was read before and is no more.
        """
        found: dict[str, float] = {}
        for thermometer in self.thermometers:
            for place, value in thermometer.read().items():
                if place in found:
                    raise HardwareError("thermometers", f"two of them report a place called '{place}'")
                found[place] = value
        if gone := [place for place in self._places if place not in found]:
            raise HardwareError("thermometers", f"no reading of {', '.join(gone)} any more")
        self._places = self._places or tuple(found)
        found = {place: found[place] for place in self._places}  # one that comes later has no column
        found.setdefault("air", self.atmosphere().temperature_c)
        return found

    def stop(self) -> None:
        """Quick stop, once; a bus that was only looked at is left alone."""
        if self._started:
            with uninterrupted():
                self.axes.quick_stop()
            self._started = False

    def _close(self) -> list[Exception]:
        """Close every device even when closing another one fails."""
        problems: list[Exception] = []
        devices: list[Callable[[], None]] = [self.axes.close, self.tracker.close]
        if self.force_sensor is not None:
            devices.append(self.force_sensor.close)
        for close in devices:
            try:
                close()
            except Exception as problem:
                problems.append(problem)
        return problems


def _with_unstopped(error: BaseException | None, axes: Sequence[str]) -> HardwareError:
    """What goes wrong beside an axis that was not stopped is the lesser evil, and said beside it."""
    if isinstance(error, HardwareError):
        return type(error)(error.device, f"{error.cause}; {not_stopped(axes)}")
    said = f" ({str(error) or type(error).__name__})" if error is not None else ""
    return HardwareError("axes", f"{not_stopped(axes)}{said}")


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Nobody's Ctrl-C and no request to end or hang up is heard meanwhile (in the main thread, which hears them)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {s: signal.signal(s, signal.SIG_IGN) for s in INTERRUPTIONS}
    try:
        yield
    finally:
        for s, handler in before.items():
            signal.signal(s, handler)


@contextmanager
def not_suspended() -> Iterator[None]:
    """Ctrl-Z is refused with a word meanwhile: axes would travel on and nobody watch them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTSTP, _refuse)
    try:
        yield
    finally:
        signal.signal(signal.SIGTSTP, before)


def _refuse(*_: object) -> None:
    with suppress(OSError):  # past Python's own stream, in whose midst the signal may have come
        os.write(2, b"\nppshw: not suspended: nobody would watch the axes. Ctrl-C stops them\n")


def nominal_aim(machine: Machine, tracker_in_base: Array) -> Aim:
    """Where a perfect machine would have its reflectors: millimetres off, near enough for a tracker to find them.

    tracker_in_base  (4, 4) the measuring frame in the base frame
    """
    to_tracker = inverse(tracker_in_base)

    def aim(q: Array, target: str) -> Array:
        in_base = kinematics.point_positions(machine, q[None, :], machine.point(target)[None, :])[0, 0]
        return np.asarray(to_tracker[:3, :3] @ in_base + to_tracker[:3, 3])

    return aim
