"""A simulated servo drive behind real CANopen: CiA 402 state machine, profile position, homing, faults.

Restated from CiA 402-2 and from how drives behave in the field: the statusword in a TPDO is older than the
controlword of the same SYNC; a target is latched on the rising edge of bit 4 only, and not before bit 12 has
fallen; bit 10 still tells of the old target until the new one is latched; what was configured is gone after a
power cycle.

Known limitations: modes 1 and 6 only; one set-point is queued, not more; halt (bit 8) stops and forgets the
set-point; homing goes straight to the home position, whatever the method; no torque, no brake timing, no
current limit; faults that depend on time are noticed at SYNC, heartbeat or SDO access, like all else; `stick`
freezes the axis at once.
"""

from __future__ import annotations

import enum
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path

import canopen

from simulators import motion
from simulators.canopen_node import CanopenNode, SimClock

EDS = Path(__file__).with_name("drive.eds")
PROFILE_POSITION, HOMING = 1, 6
FOLLOWING_ERROR = 0x8611
COASTING = 0.1  # without power a motor only has friction: so much of a quick stop's deceleration (a guess)


class Power(enum.Enum):
    """States of the CiA 402 power drive system; the value is the state's part of the statusword."""

    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


@dataclass(frozen=True)
class Identity:
    vendor: int = 0x0
    product: int = 0x50505301
    revision: int = 0x00010000
    serial: int = 0
    name: str = "Simulated drive"
    firmware: str = "ppshw-sim 1.0"


class SimulatedDrive(CanopenNode):
    """One drive with its motor. Positions are in counts.

    start       where the motor stands at power-up, in the motor's own absolute counts
    absolute    the encoder knows its absolute position; an incremental one reads 0 at power-up until it is homed
    home_at     absolute position of the home switch
    home_offset_sense  1: zero = home + 0x607C, as CiA 402 has it; -1: home = zero + 0x607C, as some makers have it
    lag_s       the motor follows the demand this much later
    reaction_s  how long its reaction to a fault takes, in which it heeds no command
    missing     objects this model does not have
    modes       supported modes of operation; a request for another is ignored, as real drives do
    """

    def __init__(
        self,
        node_id: int,
        clock: SimClock,
        network: canopen.Network,
        *,
        identity: Identity | None = None,
        start: float = 0.0,
        absolute: bool = True,
        home_at: float = 0.0,
        home_offset_sense: int = 1,
        lag_s: float = 0.002,
        reaction_s: float = 0.0,
        missing: Collection[int] = (),
        modes: Collection[int] = (PROFILE_POSITION, HOMING),
        eds: Path = EDS,
    ) -> None:
        super().__init__(node_id, clock, network, eds, missing)
        self.identity = identity or Identity(serial=1000 + node_id)
        self.starts: list[float] = []  # when each profile-position motion began
        self.targets: list[float] = []  # and where to, in the motor's absolute counts
        self._absolute, self._home_at, self._lag, self._modes = absolute, home_at, lag_s, modes
        self._home_offset_sense = home_offset_sense
        self._reaction, self._reacts_until = reaction_s, 0.0
        self._motions = [motion.at_rest(start)]  # the one before the last is still needed for the lag
        self._stuck_at: float | None = None
        self._power_up()
        self.boot()

    # what the world sees

    def motor_position(self) -> float:
        return self.position(self.clock.now())

    def position(self, time: float) -> float:
        """Where the motor is at `time` [counts], not rounded to the encoder."""
        if self._stuck_at is not None:
            return self._stuck_at
        return self._demand(time - self._lag)

    def motor_velocity(self, time: float) -> float:
        return 0.0 if self._stuck_at is not None else self._motions[-1].velocity(time - self._lag)

    @property
    def power(self) -> Power:
        with self.lock:
            self.tick()
            return self._power

    # trouble

    def trip(self, code: int) -> None:
        """The drive faults: reports `code` by EMCY at once, brakes, and stays in FAULT until it is reset."""
        with self.lock:
            self._enter_fault(code)

    def heartbeat_missed(self) -> None:
        self.trip(0x8130)

    def lose_power(self) -> None:
        """Power stage off (safe torque off): no longer enabled, and not a word about it."""
        with self.lock:
            self._switch(Power.SWITCH_ON_DISABLED)

    def stick(self) -> None:
        """The motor no longer moves, whatever the drive does."""
        with self.lock:
            self._stuck_at = self.motor_position()

    def release(self) -> None:
        with self.lock:
            stuck_at, self._stuck_at = self._stuck_at, None
            if stuck_at is not None:
                self._motions = [motion.at_rest(stuck_at, self.clock.now())]

    def go_silent(self) -> None:
        """Electronics hang: nothing more is heard from the node. A motion that has begun goes on."""
        self.leave_bus()

    def unplug(self) -> None:
        """Power off: the motor stops where it is (brake)."""
        with self.lock:
            self._motions = [motion.at_rest(self.motor_position(), self.clock.now())]
        self.leave_bus()

    def replug(self) -> None:
        with self.lock:
            self._power_up()
        self.boot()

    def lie_about(self, index: int, value: int, subindex: int = 0) -> None:
        """Answer `value` for that object, whatever was written."""
        self.lies[index, subindex] = value

    # objects

    def _power_up(self) -> None:
        self._power = Power.SWITCH_ON_DISABLED
        self._controlword = 0
        self._mode = 0
        self._acknowledged = self._limited = self._following_error = False
        self._homing = self._homed = False
        self._queued: float | None = None
        self._reached_since: float | None = None
        self._exceeded_since: float | None = None
        self._error_code = 0
        self._sent_status: int | None = None
        self._origin = 0.0 if self._absolute else self.motor_position()

    def boot(self) -> None:
        super().boot()
        with self.lock:
            who = self.identity
            for subindex, value in enumerate((who.vendor, who.product, who.revision, who.serial), start=1):
                self.store(0x1018, subindex, value)
            self.store(0x1008, 0, who.name)
            self.store(0x100A, 0, who.firmware)

    def read(self, index: int, subindex: int) -> int | None:
        now = self.clock.now()
        match index:
            case 0x6041:
                self.tick()
                return self._statusword()
            case 0x6064:
                return round(self.position(now) - self._origin)
            case 0x6061:
                return self._mode
            case 0x6062:
                return round(self._demand(now) - self._origin)
            case 0x606C:
                return round(self.motor_velocity(now))
            case 0x60F4:
                return round(self._demand(now) - self.position(now))
            case 0x603F:
                return self._error_code
            case 0x1001:
                return 1 if self._error_code else 0
        return None

    def written(self, index: int, subindex: int, data: bytes) -> None:
        if index == 0x6040:
            before, self._controlword = self._controlword, int.from_bytes(data, "little")
            self._obey(self._controlword, risen=self._controlword & ~before)
            self._announce()
        elif index == 0x6060:
            mode = int.from_bytes(data, "little", signed=True)
            if mode in self._modes:
                self._mode = mode

    # state machine

    def _obey(self, command: int, risen: int) -> None:
        if risen & 0x80 and self._power is Power.FAULT:
            self._power = Power.SWITCH_ON_DISABLED
            self._error_code, self._following_error, self._exceeded_since = 0, False, None
            self.emergency(0, 0)
            return
        if self._power in (Power.FAULT, Power.FAULT_REACTION_ACTIVE):
            return
        if not command & 0x2:  # disable voltage
            self._switch(Power.SWITCH_ON_DISABLED)
        elif not command & 0x4:  # quick stop
            if self._power is Power.OPERATION_ENABLED:
                self._brake()
                self._power = Power.QUICK_STOP_ACTIVE
            elif self._power is not Power.QUICK_STOP_ACTIVE:
                self._switch(Power.SWITCH_ON_DISABLED)
        elif self._power is Power.QUICK_STOP_ACTIVE:
            if command & 0xF == 0xF and self.value(0x605A) >= 5:
                self._switch(Power.OPERATION_ENABLED)
        elif command & 0xF == 0xF:
            if self._power in (Power.READY_TO_SWITCH_ON, Power.SWITCHED_ON):
                self._switch(Power.OPERATION_ENABLED)
            if self._power is Power.OPERATION_ENABLED:
                self._operate(command, risen)
        elif command & 0xF == 0x7:
            if self._power is not Power.SWITCH_ON_DISABLED:
                self._switch(Power.SWITCHED_ON)
        elif command & 0x7 == 0x6:
            self._switch(Power.READY_TO_SWITCH_ON)

    def _switch(self, to: Power) -> None:
        powered = self._power in (Power.OPERATION_ENABLED, Power.QUICK_STOP_ACTIVE)
        if powered and to in (Power.SWITCH_ON_DISABLED, Power.READY_TO_SWITCH_ON):
            self._brake(COASTING)
        elif self._power is Power.OPERATION_ENABLED and to is not Power.OPERATION_ENABLED:
            self._brake()
        if to is Power.OPERATION_ENABLED and self._power is not to:
            self._start_motion(motion.at_rest(self.motor_position(), self.clock.now()))
            self._acknowledged = False
        self._power = to

    def _operate(self, command: int, risen: int) -> None:
        if command & 0x100:
            self._brake()
        elif self._mode == HOMING and risen & 0x10:
            self._start_homing()
        elif self._mode == PROFILE_POSITION and risen & 0x10 and not self._acknowledged:
            self._take_set_point(command)
        if not command & 0x10:
            self._acknowledged = False
            if self._homing:
                self._homing = False
                self._brake()

    def _take_set_point(self, command: int) -> None:
        target = float(self.value(0x607A))
        if command & 0x40:
            target += self._motions[-1].target - self._origin
        low, high = self.value(0x607D, 1, -(2**31)), self.value(0x607D, 2, 2**31 - 1)
        self._limited = not low <= target <= high
        target = min(max(target, low), high) + self._origin
        self._acknowledged = True
        if command & 0x20 or self.clock.now() >= self._motions[-1].end:
            self._go(target, self.value(0x6081), self.value(0x6083))
            self.targets.append(target)
            self.starts.append(self.clock.now())
        else:
            self._queued = target

    def _start_homing(self) -> None:
        self._homing, self._homed = True, False
        self._go(self._home_at, self.value(0x6099, 1), self.value(0x609A, 0, 10_000))

    # motion

    def _demand(self, time: float) -> float:
        for piece in reversed(self._motions[1:]):
            if time >= piece.start:
                return piece.position(time)
        return self._motions[0].position(time)

    def _start_motion(self, new: motion.Motion) -> None:
        self._motions = [self._motions[-1], new]
        self._queued = None
        self._reached_since = None

    def _go(self, target: float, velocity: float, acceleration: float) -> None:
        now = self.clock.now()
        position, speed = self._motions[-1].at(now)
        braking = float(self.value(0x6084, default=round(acceleration)))
        self._start_motion(
            motion.move(now, position, target, max(1.0, velocity), max(1.0, acceleration), braking, speed)
        )

    def _brake(self, share: float = 1.0) -> None:
        """As hard as a quick stop does, or a share of it."""
        now = self.clock.now()
        position, speed = self._motions[-1].at(now)
        deceleration = share * float(self.value(0x6085, default=100_000))
        self._start_motion(motion.stop(now, position, speed, max(1.0, deceleration)))

    def tick(self) -> None:
        now = self.clock.now()
        last = self._motions[-1]
        if self._queued is not None and now >= last.end:
            self._go(self._queued, self.value(0x6081), self.value(0x6083))
        at_rest = now >= last.end + self._lag
        if self._power is Power.QUICK_STOP_ACTIVE and at_rest and self.value(0x605A) < 5:
            self._power = Power.SWITCH_ON_DISABLED
        if self._power is Power.FAULT_REACTION_ACTIVE and now >= self._reacts_until:
            self._power = Power.FAULT
        error = abs(self._demand(now) - self.position(now))
        if self._homing and at_rest and error == 0:
            self._homing, self._homed = False, True
            self._origin = self._home_at + self._home_offset_sense * self.value(0x607C)
        if abs(last.target - self.position(now)) > self.value(0x6067):
            self._reached_since = None
        elif self._reached_since is None:
            # polls may be seconds apart, but when the motor came to rest is known
            self._reached_since = last.end + self._lag if at_rest and self._stuck_at is None else now
        self._watch_following(error, now)
        self._announce()

    def _watch_following(self, error: float, now: float) -> None:
        if self._power is not Power.OPERATION_ENABLED or error <= self.value(0x6065):
            self._exceeded_since = None
        elif self._exceeded_since is None:
            self._exceeded_since = now
        elif now - self._exceeded_since >= self.value(0x6066) / 1000.0:
            self._following_error = True
            self._enter_fault(FOLLOWING_ERROR)

    def _enter_fault(self, code: int) -> None:
        self._brake()
        self._power = Power.FAULT_REACTION_ACTIVE if self._reaction else Power.FAULT
        self._reacts_until = self.clock.now() + self._reaction
        self._error_code = code
        self._homing = False
        self.emergency(code, 0x01)
        self._announce()

    def _statusword(self) -> int:
        word = self._power.value | 0x0200
        if self._power in (Power.SWITCHED_ON, Power.OPERATION_ENABLED, Power.QUICK_STOP_ACTIVE):
            word |= 0x10
        if self._mode == HOMING:
            idle = not self._homing
            word |= 0x0400 * idle | 0x1000 * (idle and self._homed)
        else:
            since = self._reached_since
            settled = since is not None and self.clock.now() - since >= self.value(0x6068) / 1000.0
            word |= 0x0400 * settled | 0x1000 * self._acknowledged
        return word | 0x0800 * self._limited | 0x2000 * self._following_error

    def _announce(self) -> None:
        status = self._statusword()
        if status != self._sent_status:
            self._sent_status = status
            self.send_events()


class SimulatedDriveRack:
    """Drives on one CAN bus: a python-can `virtual` channel, which simulators/can_gateway.py can open to the outside.

    Open questions of wiring (which axis, which scale) belong to the plant; here drives go by node id.
    """

    def __init__(self, clock: SimClock, channel: str, node_ids: Iterable[int] = (), lag_s: float = 0.002) -> None:
        self.clock = clock
        self.channel = channel
        self.network = canopen.Network()
        self.network.NOTIFIER_CYCLE = 0.02  # how long closing may take
        self.network.connect(interface="virtual", channel=channel, ignore_config=True)
        self.drives: dict[int, SimulatedDrive] = {}
        for node_id in node_ids:
            self.add(SimulatedDrive(node_id, clock, self.network, lag_s=lag_s))

    def add(self, drive: SimulatedDrive) -> SimulatedDrive:
        self.drives[drive.id] = drive
        return drive

    def motor_positions(self) -> dict[int, float]:
        return {node_id: drive.motor_position() for node_id, drive in self.drives.items()}

    def close(self) -> None:
        self.network.disconnect()

    def __enter__(self) -> SimulatedDriveRack:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
