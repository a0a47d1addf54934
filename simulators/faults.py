"""Trouble on schedule: at a time, or after a visit, something happens to a device.

    Fault("yaw", "trip", 0x8611, after_visit=4)
    Fault("tracker", "lose_beam", at_s=90)

Devices: the joints' names (their drives), `bus` (all drives at once), `tracker`, `force_sensor`.

Known limitations: what has happened stays until `repair`; a fault at a time strikes when the clock passes it, which
on stepped time is at the next wait of the bench.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from simulators.drive import SimulatedDrive
from simulators.hardware import SimulatedHardware
from simulators.serial_line import SerialDevice

LOST_SUPPLY = 0x3220  # "under-voltage" in CiA 402's list: what a drive says when nothing else was asked for


@dataclass(frozen=True)
class Fault:
    """Exactly one of at_s (machine time from arming) and after_visit (visits that are done)."""

    device: str
    do: str
    value: Any = None
    at_s: float | None = None
    after_visit: int | None = None


Action = Callable[[Any, Any], None]
_DRIVE: dict[str, Action] = {
    "trip": lambda drive, code: drive.trip(LOST_SUPPLY if code is None else int(code)),
    "lose_power": lambda drive, _: drive.lose_power(),
    "stick": lambda drive, _: drive.stick(),
    "go_silent": lambda drive, _: drive.go_silent(),
    "unplug": lambda drive, _: drive.unplug(),
}
_LINE: dict[str, Action] = {
    "garble": lambda device, count: device.garble(10_000 if count is None else int(count)),
    "bit_errors": lambda device, rate: device.bit_errors(float(rate)),
    "go_silent": lambda device, _: device.go_silent(),
    "unplug": lambda device, _: device.unplug(),
}
_TRACKER: dict[str, Action] = {**_LINE, "lose_beam": lambda tracker, target: tracker.lose_beam(target)}
_SENSOR: dict[str, Action] = {**_LINE, "overrange": lambda sensor, _: sensor.overrange()}


class FaultSchedule:
    """Arm once; tell it of every visit that is done."""

    def __init__(self, hardware: SimulatedHardware, faults: Sequence[Fault]) -> None:
        self._hardware = hardware
        self._after_visit = [fault for fault in faults if fault.after_visit is not None]
        self.struck: list[Fault] = []
        for fault in faults:
            if (fault.at_s is None) == (fault.after_visit is None):
                raise ValueError(f"{fault.device} {fault.do}: give either at_s or after_visit")
            _action(hardware, fault)  # a misspelt one is found now
            if fault.at_s is not None:
                hardware.clock.at(hardware.clock.now() + fault.at_s, lambda f=fault: self._strike(f))

    def visit_done(self, done: int) -> None:
        """`done` visits are done."""
        for fault in [f for f in self._after_visit if f.after_visit == done]:
            self._after_visit.remove(fault)
            self._strike(fault)

    def _strike(self, fault: Fault) -> None:
        self.struck.append(fault)
        for device in _devices(self._hardware, fault):
            _action(self._hardware, fault)(device, fault.value)


def repair(hardware: SimulatedHardware) -> None:
    """Everything is plugged in, heard and seen again; drives in FAULT stay there, as real ones do."""
    for drive in hardware.rack.drives.values():
        drive.release()
        if not drive.online:
            drive.replug()
    for device in (hardware.tracker, hardware.force_sensor):
        device.plug()
        device.speak()
        device.garble(0)
        device.bit_errors(0.0)
    hardware.tracker.find_beam()
    hardware.force_sensor.recover()


def _devices(hardware: SimulatedHardware, fault: Fault) -> Sequence[SimulatedDrive | SerialDevice]:
    if fault.device == "bus":
        return list(hardware.rack.drives.values())
    if fault.device in hardware.plant.joint_names:
        return [hardware.drive(fault.device)]
    return [hardware.device(fault.device)]


def _action(hardware: SimulatedHardware, fault: Fault) -> Action:
    joints = dict.fromkeys((*hardware.plant.joint_names, "bus"), _DRIVE)
    known = {**joints, "tracker": _TRACKER, "force_sensor": _SENSOR}
    if fault.device not in known:
        raise ValueError(f"no device '{fault.device}' (there are: {', '.join(known)})")
    if fault.do not in known[fault.device]:
        raise ValueError(f"{fault.device}: cannot do '{fault.do}' (can: {', '.join(known[fault.device])})")
    return known[fault.device][fault.do]
