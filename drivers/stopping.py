"""Stopping all axes of a group: at once by process data, then by SDO whoever did not show it, and power off at
standstill. What fails is logged, not raised: the reason for stopping is what must be heard.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Collection, Iterator

from drivers.canopen_bus import CanBus
from drivers.cia402 import OBEY_S, Cia402Axis
from drivers.cia402_objects import State
from drivers.ports import Clock
from ppshw.errors import HardwareError

log = logging.getLogger(__name__)

# s of machine time: for how long a stop is said again that could not be sent, what its ramp may take at most, and
# between two looks at it
INSIST_S, RAMP_S, LOOK_S = 1.0, 5.0, 0.1
# s of real time that a round of quick stops may take: an adapter that takes no more messages takes SEND_S for each
ROUND_S = 0.5


class Stopping:
    """unstopped  axes of which neither the last quick stop nor closing could see that they obeyed, and stood"""

    def __init__(self, bus: CanBus, clock: Clock, axes: Callable[[], Collection[Cia402Axis]]) -> None:
        self.unstopped: list[str] = []
        self._bus, self._clock, self._axes = bus, clock, axes
        self._moving: list[str] = []  # when the ramps should have ended

    def at_once(self) -> bool:
        """No waiting and no SDO, so that it can be done in the receiving thread. Returns whether all of it went out."""
        sent, began = True, time.monotonic()
        with self._bus.commanding:
            self._bus.stopped = True
            for axis in self._axes():
                sent &= self._tried(axis.send_quick_stop)
                if time.monotonic() - began > ROUND_S:
                    return False
            return self._tried(self._bus.sync) and sent

    def _tried(self, send: Callable[[], None]) -> bool:
        try:
            send()
        except Exception as error:
            log.info("quick stop: %s", error)
            return False
        return True

    def stop(self) -> None:
        """Quick stop to every axis: by process data and a SYNC, again and again while the bus takes none, then by SDO
        where that does not show within a drive's time."""
        self.unstopped = [axis.name for axis in self._axes()]
        pause, until = self._bus.config.sync_period, self._clock.now() + INSIST_S
        while not self.at_once() and self._clock.now() < until:
            with self._bus.arrival:  # also what raised may have gone out
                self._clock.wait_for(self._bus.arrival, lambda: False, pause)
            pause = min(2.0 * pause, LOOK_S)
        try:
            suspects = self._suspects()
        except Exception as error:
            log.error("quick stop: %s", error)
            suspects = list(self._axes())
        self.unstopped = [axis.name for axis in suspects if not self._stopped_by_sdo(axis)]

    def _suspects(self) -> list[Cia402Axis]:
        """Who was not seen to obey; those that say nothing last. They may still answer SDO, for instance when they fell
        back to PRE-OPERATIONAL, as all do at one word of an NMT master."""
        heard, silent = list(self._axes()), list[Cia402Axis]()
        until = self._clock.now() + OBEY_S
        while heard:
            missing = self._bus.exchange([axis.node_id for axis in heard])
            silent += [axis for axis in heard if axis.node_id in missing]
            heard = [axis for axis in heard if axis.node_id not in missing]
            running = [axis for axis in heard if axis.shows(State.OPERATION_ENABLED)]
            if not running or self._clock.now() >= until:
                return running + silent
            self._clock.sleep(self._bus.config.sync_period)
        return silent

    def _stopped_by_sdo(self, axis: Cia402Axis) -> bool:
        try:
            if axis.stopped_by_sdo():
                return True
            log.error("quick stop: %s obeys neither by process data nor by SDO", axis.name)
        except Exception as error:
            log.error("quick stop: %s", error)
        return False

    def stand_still(self) -> None:
        """Until the ramps of a quick stop have ended: a motor without power coasts, or drops its brake at speed. For a
        bounded time, and not for an axis that says nothing, by process data or SDO. Whoever was not seen to obey is
        told at every look."""
        before: dict[str, float] = {}
        silent: set[int] = set()  # who sent no process data at the last look
        dumb: set[int] = set()  # who did not answer SDO either: each takes its time limit
        self._moving = []
        self._bus.answered(LOOK_S)  # a stop awaits no answers to its SYNCs: what is still on its way is no look
        for late in self._looks():
            if self.unstopped:
                self.at_once()
            waived = silent if late else set[int]()  # waiting for them is what took the time
            try:
                silent = waived | self._bus.exchange([a.node_id for a in self._axes() if a.node_id not in waived])
            except Exception as error:
                log.info("closing: %s", error)
                with self._bus.arrival:  # unseen, the ramps are given their time
                    self._clock.wait_for(self._bus.arrival, lambda: False, LOOK_S)
                continue
            here: dict[str, float] = {}
            self._moving = []
            for axis in self._axes():
                if (unheard := axis.node_id in silent) and axis.node_id in dumb:
                    continue
                if (at := self._where(axis, by_sdo=unheard)) is None:
                    dumb.add(axis.node_id)
                    continue
                here[axis.name] = at
                if abs(at - before.get(axis.name, math.inf)) > axis.config.window_counts / axis.config.counts_per_unit:
                    self._moving.append(axis.name)
            if here and not self._moving:
                return
            before = here
            self._clock.sleep(LOOK_S)
        log.warning("closing: axes still moved, or were not seen, %g s after the quick stop", RAMP_S)
        self.unstopped += [name for name in self._moving if name not in self.unstopped]

    def _looks(self) -> Iterator[bool]:
        """For as long as a ramp may take, then two more, since only a second one tells who moves, and the first may
        have taken all the time. Says whether it is over."""
        until = self._clock.now() + RAMP_S
        while self._clock.now() < until:
            yield False
        yield from (True, True)

    def _where(self, axis: Cia402Axis, by_sdo: bool) -> float | None:
        """By process data, or by SDO of one that fell back to PRE-OPERATIONAL; None of one that does not answer."""
        try:
            return axis.position() if by_sdo else axis.here()
        except HardwareError as error:
            log.info("closing: %s", error)
            return None

    def switch_off(self, axis: Cia402Axis) -> None:
        """Raises HardwareError of a drive that does not answer."""
        if axis.name not in self.unstopped:
            self.unstopped.append(axis.name)
        axis.disable()
        if axis.leaves_operation() and axis.name not in self._moving:
            self.unstopped.remove(axis.name)
