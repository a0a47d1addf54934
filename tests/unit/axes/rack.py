"""Three simulated drives on a virtual CAN bus, and the group that drives them. Time is stepped.

slide  node 1, 100 000 counts/m, upwards           lift  node 2, 200 000 counts/m, motor turns the other way
slew   node 3, 50 000 counts/rad, zero at 0.5 rad
All speeds are 0.1 unit/s, all accelerations 0.1 unit/s².
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from drivers.axis_config import AxisConfig
from drivers.axis_group import Cia402Group
from drivers.canopen_bus import BusConfig
from simulators.clock import SteppedClock
from simulators.drive import SimulatedDrive, SimulatedDriveRack

SLIDE = AxisConfig("slide", 1, 100_000, -1.0, 1.0, velocity=0.1, acceleration=0.1, following_window=0.005)
LIFT = replace(SLIDE, name="lift", node_id=2, counts_per_unit=200_000, direction=-1)
SLEW = replace(SLIDE, name="slew", node_id=3, counts_per_unit=50_000, offset=0.5, lower=-1.5, upper=1.5, unit="rad")

channels = (f"cia402-{n}" for n in itertools.count())


class Machine:
    """Three drives and the group that drives them."""

    def __init__(
        self,
        *axes: AxisConfig,
        kind: type[SimulatedDrive] = SimulatedDrive,
        answer_timeout: float = BusConfig.answer_timeout,
        **drive: Any,
    ) -> None:
        self.clock = SteppedClock(grace=0.12)
        self.rack = SimulatedDriveRack(self.clock, next(channels))
        self.axes = axes or (SLIDE, LIFT, SLEW)
        for axis in self.axes:
            self.rack.add(kind(axis.node_id, self.clock, self.rack.network, **drive))
        virtual = {"interface": "virtual", "channel": self.rack.channel}
        bus = BusConfig(can=virtual, poll_period=1.0, sdo_timeout=0.4, answer_timeout=answer_timeout)
        self.group = Cia402Group(self.axes, bus, self.clock)

    @property
    def drives(self) -> list[SimulatedDrive]:
        return list(self.rack.drives.values())

    def drive(self, name: str) -> SimulatedDrive:
        return self.rack.drives[next(axis.node_id for axis in self.axes if axis.name == name)]

    def after(self, seconds: float, what: Callable[[], None]) -> None:
        self.clock.at(self.clock.now() + seconds, what)

    def close(self) -> None:
        self.group.close()
        self.rack.close()
