"""Homing by the drive (CiA 402 mode 6), with a handshake that tells this homing from the one before.

After a homing the drive goes on saying "attained" until the next one has begun. So a result counts only after the
drive has said "in progress"; methods that take the present position for home may never say so, and are given two
fresh process data instead. The other axes stand meanwhile, enabled, and are watched as in a move.

The drive counts from its home position: 0x607C is 0. By CiA 402's words zero = home position + 0x607C, and the limits
0x607D are shifted by it; with some makers it is the position that home gets, or how far to move on.

    statusword bits 13, 12, 10:  000 in progress   001 not started   011 done   1·· homing error
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.axis_config import HomingConfig
from drivers.canopen_bus import CanBus, Entry
from drivers.cia402 import COARSE, Cia402Axis
from drivers.cia402_objects import (
    ENABLE,
    HOME_IN_PLACE,
    HOME_OFFSET,
    HOMING,
    HOMING_ACCELERATION,
    HOMING_FAST,
    HOMING_METHOD,
    HOMING_SLOW,
    NEW_SET_POINT,
    PROFILE_POSITION,
    Snapshot,
    State,
)
from ppshw.errors import DriveFault, HardwareTimeout, SiteError

OVERRUN_S, OVERRUN_WINDOWS = 0.5, 10  # how far beyond home a drive may stop: at the speed of the last piece (guesses)
START_TIMEOUT = 1.0  # s; a drive that has not begun by then is not going to (a guess, generous)


def home(axis: Cia402Axis, bus: CanBus, exchange: Callable[[], None]) -> None:
    """Home an enabled axis; `axis.homed` says afterwards that its positions can be trusted.

    exchange  brings fresh process data of every axis on the bus, or raises what is wrong with one of them
    """
    homing = axis.config.homing
    if homing is None:
        raise SiteError(f"{axis.name}: no homing method is configured")
    axis.homed = False
    axis.target = None
    c = axis.config
    axis.sdo.set(HOMING_METHOD, homing.method)
    axis.sdo.set_if_present(HOME_OFFSET, 0)
    for entry, key, speed in ((HOMING_FAST, "fast", homing.fast), (HOMING_SLOW, "slow", homing.slow)):
        _set_speed(axis, entry, key, speed)
    acceleration = c.acceleration * c.counts_per_unit * c.acceleration_units
    axis.sdo.set_if_present(HOMING_ACCELERATION, axis.in_whole_units(acceleration, "acceleration"))
    _command(axis, bus, exchange, HOMING, ENABLE)
    _command(axis, bus, exchange, HOMING, ENABLE | NEW_SET_POINT)
    _wait_until_attained(axis, bus, exchange, homing.timeout_s, in_place=homing.method in HOME_IN_PLACE)
    _command(axis, bus, exchange, PROFILE_POSITION, ENABLE)
    _require_home(axis, homing)
    axis.homed = True


def _set_speed(axis: Cia402Axis, entry: Entry, key: str, speed: float | None) -> None:
    """Without one in the site file the drive's own stays, unless that is faster than the axis may move. Raises
    SiteError."""
    c = axis.config
    unit = c.counts_per_unit * c.velocity_units
    if speed is not None:
        axis.sdo.set(entry, axis.in_whole_units(speed * unit, f"homing.{key}"))
        return
    its_own = axis.sdo.read_if_present(entry)
    if its_own is not None and its_own > (1 + COARSE) * c.velocity * unit:
        fast = f"the drive's own {entry} is {its_own / unit:.3g} {c.unit}/s"
        raise SiteError(
            f"axes.{axis.name}.homing.{key} is missing, and {fast}, where the axis may move at {c.velocity:g}"
        )


def _require_home(axis: Cia402Axis, homing: HomingConfig) -> None:
    """A drive may have a home position of its maker's own, or not have taken this one."""
    assert axis.snapshot is not None
    c, here = axis.config, axis.config.to_si(axis.snapshot.counts)
    overrun = 0.0 if homing.method in HOME_IN_PLACE else OVERRUN_S * (homing.slow or homing.fast or c.velocity)
    if abs(here - homing.offset) > max(overrun, OVERRUN_WINDOWS * c.window):
        ended = f"homing ended at {here:.6g} {c.unit}, expected {homing.offset:.6g} {c.unit} (homing.offset)"
        raise DriveFault(axis.name, f"{ended}: the drive does not count 0 at home, see its own home position")


def _wait_until_attained(
    axis: Cia402Axis, bus: CanBus, exchange: Callable[[], None], timeout: float, in_place: bool
) -> None:
    began = bus.clock.now()
    in_progress = in_place
    while True:
        snapshot = _fresh(axis, exchange)
        if snapshot.state is not State.OPERATION_ENABLED:
            raise axis.trouble() or DriveFault(axis.name, f"left homing: {snapshot.state}")
        if snapshot.off_course:
            raise DriveFault(axis.name, f"homing error, statusword 0x{snapshot.statusword:04X}")
        in_progress |= not snapshot.acknowledged and not snapshot.target_reached
        if in_progress and snapshot.acknowledged and snapshot.target_reached:
            return
        waited = bus.clock.now() - began
        if not in_progress and waited > START_TIMEOUT:
            raise HardwareTimeout(axis.name, f"homing has not begun after {waited:.1f} s, {snapshot.state}")
        if waited > timeout:
            raise HardwareTimeout(axis.name, f"homing not finished after {waited:.1f} s, {snapshot.state}")
        bus.clock.sleep(bus.config.sync_period)


def _command(axis: Cia402Axis, bus: CanBus, exchange: Callable[[], None], mode: int, controlword: int) -> None:
    """Send, and wait until two fresh process data have come and the drive shows the mode."""
    hold = axis.snapshot.counts if axis.snapshot else 0
    axis.command(hold, controlword, mode)
    began = bus.clock.now()
    _fresh(axis, exchange)
    while (snapshot := _fresh(axis, exchange)).mode != mode:
        if bus.clock.now() - began > START_TIMEOUT:
            raise HardwareTimeout(axis.name, f"refuses mode {mode}, shows {snapshot.mode}")
        bus.clock.sleep(bus.config.sync_period)


def _fresh(axis: Cia402Axis, exchange: Callable[[], None]) -> Snapshot:
    exchange()
    assert axis.snapshot is not None
    return axis.snapshot
