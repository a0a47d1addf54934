"""One CiA 402 servo drive as an axis in SI units: identity, configuration, state machine, homing, set-points.

Built on canopen's SDO client and PDO maps, not on its BaseNode402, which has no profile-position move, calls a second
homing done without homing, and enables power while it resets a fault. No maker's EDS is needed: the objects used here
have the standard's types, and parameters beyond them take the size that the drive reports.

Process data: RPDO 1 carries target, mode and controlword **in that order** (a drive that sees the controlword first
latches the old target), TPDO 1 statusword, position and mode. Both are synchronous: what the host sends takes effect at
the next SYNC, and the answer to it is in the TPDO after that.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping

import canopen
from canopen.emcy import EmcyError
from canopen.pdo import PdoMap

from drivers.axis_config import AxisConfig
from drivers.canopen_bus import CanBus, Entry, SdoPort
from drivers.cia402_objects import (
    ABORT_BY_FAULT,
    ABORT_OPTION,
    ACCELERATION,
    CONSUMER_HEARTBEAT,
    CONTROLWORD,
    DECELERATION,
    DISABLE_VOLTAGE,
    ERROR_CODE,
    ERROR_REGISTER,
    FAULT_OPTION,
    FAULT_RESET,
    FAULTY,
    FOLLOWING_TIME,
    FOLLOWING_WINDOW,
    LIMIT_HIGH,
    LIMIT_LOW,
    MODE,
    MODE_DISPLAY,
    NEXT_COMMAND,
    POSITION,
    POSITION_TIME,
    POSITION_WINDOW,
    PRODUCER_HEARTBEAT,
    PRODUCT,
    PROFILE_POSITION,
    QUICK_STOP,
    QUICK_STOP_OPTION,
    REVISION,
    SERIAL,
    STATUSWORD,
    TARGET,
    VELOCITY,
    VENDOR,
    Snapshot,
    State,
    decode_state,
    pdo_dictionary,
)
from drivers.emcy import meaning
from drivers.ports import DeviceInfo
from ppshw.errors import (
    ConfigurationMismatch,
    DriveFault,
    FollowingError,
    HardwareError,
    HardwareTimeout,
    HeartbeatLost,
    IdentityMismatch,
    SiteError,
    Stopped,
)

COARSE = 0.05  # share by which whole drive units may change a speed
MOTION_S = 0.1  # s between two looks that tell an axis in motion from one that stands
OBEY_S = 0.1  # s of machine time that a drive may take to act on a controlword; most take 1 to 10 ms (a guess)
LONGEST_WATCH_S = 5.0  # that is listened for another master's heartbeat
TO_ENABLE, TO_RESET = 5.0, 2.0  # s of machine time until a drive is enabled, and out of a fault
FOLLOWING_S = 0.1  # s outside a following-error window until it is an error, where the site gives a window alone


class Cia402Axis:
    """A drive on an open bus. `on_emergency` is called from the receiving thread and must neither block nor raise."""

    def __init__(self, config: AxisConfig, bus: CanBus, on_emergency: Callable[[], None] = lambda: None) -> None:
        self.config = config
        self.name = config.name
        self.node_id = config.node_id
        self.homed = False
        self.target: int | None = None  # last commanded target [counts]; None: not known
        self.snapshot: Snapshot | None = None
        self._bus = bus
        self._on_emergency = on_emergency
        self._emergency: int | None = None
        self._restarted = False
        self._supervised = False
        self._watches = False  # the drive watches a heartbeat
        self._last_heard = bus.clock.now()
        self._node = canopen.RemoteNode(config.node_id, pdo_dictionary(config.node_id))
        bus.network.add_node(self._node)
        self.sdo = SdoPort(config.name, self._node, bus)
        self._node.emcy.add_callback(self._heard_emergency)
        self._node.nmt.add_heartbeat_callback(self._heard_heartbeat)
        self._rpdo: PdoMap = self._node.rpdo[1]
        self._tpdo: PdoMap = self._node.tpdo[1]
        self._tpdo.add_callback(self._heard_process_data)

    # callbacks: receiving thread; no SDO, nothing raised

    def _heard_emergency(self, message: EmcyError) -> None:
        if message.code & 0xFF00 == 0:  # error reset
            return
        self._emergency = int(message.code)
        self._on_emergency()
        with self._bus.arrival:
            self._bus.arrival.notify_all()

    def _heard_heartbeat(self, nmt_state: int) -> None:
        self._last_heard = self._bus.clock.now()
        if nmt_state == 0 and self._supervised:
            self._restarted, self.homed = True, False
            self._on_emergency()
        with self._bus.arrival:
            self._bus.arrival.notify_all()

    def _heard_process_data(self, pdo: PdoMap) -> None:
        if len(pdo.data) >= 7:  # a shorter one is not what was mapped: the node then counts as silent
            self.snapshot = Snapshot(*struct.unpack_from("<Hib", pdo.data))
            if self._supervised and self.shows(*FAULTY):
                self._on_emergency()
            self._bus.received(self.node_id)

    # who and how

    def info(self) -> DeviceInfo:
        """Reads only."""
        vendor, product, revision = (self.sdo.read_if_present(e) for e in (VENDOR, PRODUCT, REVISION))
        model = f"{self.sdo.text_if_present(0x1008) or 'drive'} (vendor {_hex(vendor)}, product {_hex(product)})"
        firmware = self.sdo.text_if_present(0x100A) or f"revision {_hex(revision)}"
        state = self.state()
        on = " (motor left on by another program)" if state is State.OPERATION_ENABLED and not self._supervised else ""
        status = f"{state}{on}, at {self.position():.6f} {self.config.unit}, heartbeat {self._heartbeat_status()}"
        problem = ""
        try:
            self.check_identity()
        except IdentityMismatch as mismatch:
            problem = f"WRONG DEVICE: {mismatch.cause}"
            status += f", {problem}"
        serial = self.sdo.read_if_present(SERIAL)
        return DeviceInfo(self.name, model, "" if serial is None else str(serial), firmware, status, problem)

    def _heartbeat_status(self) -> str:
        period_ms = self.sdo.read_if_present(PRODUCER_HEARTBEAT)
        if not period_ms:
            return "off"
        since = self._bus.clock.now()
        with self._bus.arrival:
            heard = self._bus.clock.wait_for(
                self._bus.arrival, lambda: self._last_heard > since, 2.5 * period_ms / 1000.0
            )
        return "ok" if heard else f"missing (set to {period_ms} ms)"

    def check_identity(self) -> None:
        c = self.config
        for entry, wanted, said in (VENDOR, c.vendor, _hex), (PRODUCT, c.product, _hex), (SERIAL, c.serial, _number):
            found = self.sdo.read_if_present(entry)
            if wanted is not None and found != wanted:
                raise IdentityMismatch(self.name, f"{entry.name} is {said(found)}, expected {said(wanted)}")
        if self.config.firmware is not None:
            firmware = self.sdo.text_if_present(0x100A)
            if firmware != self.config.firmware:
                raise IdentityMismatch(self.name, f"firmware is {firmware!r}, expected {self.config.firmware!r}")

    def state(self) -> State:
        """By SDO: true also before the first process data."""
        return decode_state(self.sdo.read(STATUSWORD))

    def position(self) -> float:
        """By SDO."""
        return self.config.to_si(self.sdo.read(POSITION))

    def here(self) -> float:
        """By its last process data, where there are any."""
        return self.position() if self.snapshot is None else self.config.to_si(self.snapshot.counts)

    def refuse_in_motion(self) -> None:
        """Raises where the drive moves before this program has started it: to configure it would cut its power."""
        if self.state() is not State.OPERATION_ENABLED:
            return
        before = self.position()
        self._bus.clock.sleep(MOTION_S)
        if abs((now := self.position()) - before) > self.config.window:
            moves = f"moves ({before:.6g} to {now:.6g} {self.config.unit} within {MOTION_S:g} s)"
            raise HardwareError(self.name, f"{moves} before it was started: another program drives it; end that first")

    # configuration

    def configure(self) -> None:
        """Write the configuration and read it back; the node is OPERATIONAL afterwards, the drive not enabled."""
        self._supervised, self._restarted = True, False  # what restarts from here on has lost what it was told
        if self.state() is State.OPERATION_ENABLED:
            self.disable()  # an enabled drive that loses its process data may do anything
        self._node.nmt.state = "PRE-OPERATIONAL"
        for (index, subindex), value in self.config.parameters.items():
            self.sdo.set(self._entry_of_reported_size(index, subindex), value)
        self._require_a_stop()
        self._configure_motion()
        self._map_process_data()
        self.sdo.set(PRODUCER_HEARTBEAT, round(self._bus.config.heartbeat_period * 1000))
        self._set_watch()
        self.snapshot = None
        self._node.nmt.state = "OPERATIONAL"
        self._last_heard = self._bus.clock.now()

    def _set_watch(self) -> None:
        """Ours, or none that a program before us left: it would end in a fault. One over a node that lives (a safety
        PLC's) is not ours to take away, nor one that the site file asks for."""
        host = self._bus.config.host_node_id
        found = self.sdo.read_if_present(CONSUMER_HEARTBEAT) or 0
        node, watch_s = found >> 16 & 0x7F, min((found & 0xFFFF) / 1000.0, LONGEST_WATCH_S)
        asked = (CONSUMER_HEARTBEAT.index, CONSUMER_HEARTBEAT.subindex) in self.config.parameters
        others = bool(watch_s) and node != host and not asked and self._bus.hears_heartbeat(node, watch_s)
        if host is not None:
            if others:
                cause = f"watches node {node}, which lives; 'can.host_node_id' needs its {CONSUMER_HEARTBEAT}"
                raise ConfigurationMismatch(self.name, cause)
            watch_ms = round(self._bus.config.host_heartbeat_period * 5000)
            self.sdo.set_asked(CONSUMER_HEARTBEAT, host << 16 | watch_ms, "can.host_node_id")
            self._watches = True
        elif found and not asked and not others:
            self._watches = True
            self.end_watch()

    def _require_a_stop(self) -> None:
        """By the drive's own option codes (CiA 402-2): without a brake, an axis whose power is cut coasts."""
        cut, dead = "would only cut its power", "when this program dies it"
        self._refuse_option(QUICK_STOP_OPTION, {0: f"a quick stop {cut}"})
        if self._bus.config.host_node_id is not None:
            abort = self._refuse_option(ABORT_OPTION, {0: f"{dead} would not stop", 2: f"{dead} {cut}"})
            if abort == ABORT_BY_FAULT:
                self._refuse_option(FAULT_OPTION, {0: f"{dead} {cut}"})

    def _refuse_option(self, entry: Entry, unfit: Mapping[int, str]) -> int | None:
        """What an option code is, None where the drive has none; unfit: by value, what it would do then."""
        option = self.sdo.read_if_present(entry)
        if option is not None and option in unfit:
            key = f"axes.{self.name}.parameters {{0x{entry.index:04X}: …}}"
            raise ConfigurationMismatch(self.name, f"{entry} is {option}: {unfit[option]}; set it in {key}")
        return option

    def end_watch(self) -> None:
        """The drive no longer faults (0x8130) when this program's heartbeat ends."""
        if self._watches:
            self.sdo.set(CONSUMER_HEARTBEAT, 0)
            self._watches = False

    def _configure_motion(self) -> None:
        """Only what is derived may be missing in the drive: a safety setting that was asked for is not left out."""
        c = self.config
        per_s, per_s2 = c.counts_per_unit * c.velocity_units, c.counts_per_unit * c.acceleration_units
        self.sdo.set(VELOCITY, self.in_whole_units(c.velocity * per_s, "velocity"))
        acceleration = self.in_whole_units(c.acceleration * per_s2, "acceleration")
        self.sdo.set(ACCELERATION, acceleration)
        if c.deceleration is not None:
            braking = self.in_whole_units(c.deceleration * per_s2, "deceleration")
            self.sdo.set_asked(DECELERATION, braking, self._key("deceleration"))
        else:
            self.sdo.set_if_present(DECELERATION, acceleration)
        low, high = sorted((c.to_counts(c.lower), c.to_counts(c.upper)))
        self.sdo.set_if_present(LIMIT_LOW, low)
        self.sdo.set_if_present(LIMIT_HIGH, high)
        self.sdo.set_if_present(POSITION_WINDOW, c.window_counts)
        self.sdo.set_if_present(POSITION_TIME, round(c.window_s * 1000))
        if c.following_window is not None:
            window = max(1, round(c.following_window * c.counts_per_unit))
            self.sdo.set_asked(FOLLOWING_WINDOW, window, self._key("following_window"))
        if c.following_s is not None:
            self.sdo.set_asked(FOLLOWING_TIME, round(c.following_s * 1000), self._key("following_s"))
        elif c.following_window is not None:
            self.sdo.set_if_present(FOLLOWING_TIME, round(FOLLOWING_S * 1000))

    def in_whole_units(self, amount: float, of: str) -> int:
        """A speed or an acceleration as the drive takes it. Raises SiteError where whole units are too coarse for it:
        0.15 of a unit would be driven as one, seven times too fast."""
        whole = round(amount)
        if abs(whole - amount) > COARSE * amount:
            raise SiteError(
                f"{self._key(of)}: {amount:.3g} of the drive's units, which takes whole ones; expected finer units "
                "(velocity_units, acceleration_units) or another value"
            )
        return whole

    def _key(self, of: str) -> str:
        """Where the site file says it."""
        return f"axes.{self.name}.{of}"

    def _entry_of_reported_size(self, index: int, subindex: int) -> Entry:
        probe = Entry(index, subindex, "", "parameter")
        raw = self.sdo.upload(probe)
        if raw is None:
            raise ConfigurationMismatch(self.name, f"has no {probe}")
        signed = self.config.parameters[index, subindex] < 0
        code = {1: "b", 2: "h", 4: "i", 8: "q"}.get(len(raw))
        if code is None:
            raise ConfigurationMismatch(self.name, f"{probe} is {len(raw)} bytes long, not a number")
        return Entry(index, subindex, code if signed else code.upper(), "parameter")

    def _map_process_data(self) -> None:
        for pdo, base, objects in (
            (self._rpdo, 0x1400, (TARGET, MODE, CONTROLWORD)),
            (self._tpdo, 0x1800, (STATUSWORD, POSITION, MODE_DISPLAY)),
        ):
            cob_id = self.sdo.read(Entry(base, 1, "I", "COB-ID"))
            pdo.cob_id = pdo.predefined_cob_id
            pdo.rtr_allowed = not cob_id & 1 << 30  # some drives accept only their own value of that bit
            pdo.trans_type = 1
            pdo.enabled = True
            pdo.clear()
            for entry in objects:
                pdo.add_variable(entry.index, entry.subindex)
            try:
                with self.sdo.answered(f"PDO 0x{base:04X}"):
                    pdo.save()
            except canopen.SdoAbortedError as error:
                raise ConfigurationMismatch(self.name, f"PDO 0x{base:04X} cannot be mapped: {error}") from error
            self._compare_mapping(base, pdo)

    def _compare_mapping(self, base: int, pdo: PdoMap) -> None:
        wanted = [v.index << 16 | v.subindex << 8 | v.length for v in pdo.map]
        count = self.sdo.read(Entry(base + 0x200, 0, "B", "mapping"))
        found = [self.sdo.read(Entry(base + 0x200, k + 1, "I", "mapping")) for k in range(count)]
        if found != wanted:
            shown = " ".join(f"{entry:08X}" for entry in found)
            raise ConfigurationMismatch(self.name, f"PDO 0x{base:04X} is mapped to [{shown}] instead")
        cob_id = self.sdo.read(Entry(base, 1, "I", "COB-ID"))
        kind = self.sdo.read(Entry(base, 2, "B", "transmission type"))
        if cob_id & 0x800007FF != pdo.cob_id or kind != 1:
            raise ConfigurationMismatch(self.name, f"PDO 0x{base:04X} reads back COB-ID 0x{cob_id:X}, type {kind}")

    # state machine

    def enable(self) -> None:
        """Mode 1 and OPERATION ENABLED, step by step. A drive in FAULT stays there: see reset_fault()."""
        deadline = self._bus.clock.now() + TO_ENABLE
        self._select_profile_position(deadline)
        last = None
        while True:
            state = self.state()
            if state in FAULTY:
                raise self._drive_fault()
            if state is State.OPERATION_ENABLED:
                return
            if self._bus.clock.now() > deadline:
                raise HardwareTimeout(self.name, f"still {state} {TO_ENABLE:g} s after enable")
            if self._bus.stopped:
                raise Stopped(f"{self.name}: the axes were quick-stopped while it was enabled")
            if state in NEXT_COMMAND:
                self.sdo.write(CONTROLWORD, NEXT_COMMAND[state])
            if state is last:
                self._bus.clock.sleep(self._bus.config.sync_period)
            last = state

    def _select_profile_position(self, deadline: float) -> None:
        self.sdo.write(MODE, PROFILE_POSITION)
        while (shown := self.sdo.read(MODE_DISPLAY)) != PROFILE_POSITION:
            if self._bus.clock.now() > deadline:
                raise HardwareTimeout(self.name, f"refuses mode {PROFILE_POSITION} (profile position), shows {shown}")
            self._bus.clock.sleep(self._bus.config.sync_period)

    def stopped_by_sdo(self) -> bool:
        """For a drive that was not seen to obey a quick stop by process data; one that does not by SDO either is
        switched off. Returns whether it obeyed in the end."""
        if self.state() is not State.OPERATION_ENABLED:
            return True
        for word in (QUICK_STOP, DISABLE_VOLTAGE):
            self.sdo.write(CONTROLWORD, word)
            if self.leaves_operation():
                return True
        return False

    def leaves_operation(self) -> bool:
        """Whether it is seen to within the time that drives take."""
        until = self._bus.clock.now() + OBEY_S
        while self.state() is State.OPERATION_ENABLED:
            if self._bus.clock.now() > until:
                return False
            self._bus.clock.sleep(self._bus.config.sync_period)
        return True

    def disable(self) -> None:
        """Power off the motor; the drive leaves OPERATION ENABLED at once."""
        self.sdo.write(CONTROLWORD, DISABLE_VOLTAGE)

    def reset_fault(self) -> None:
        """Acknowledge a fault. Never enables: no bit that could is set in either controlword."""
        if self.state() in FAULTY:
            self.sdo.write(CONTROLWORD, DISABLE_VOLTAGE)
            self._wait_while(State.FAULT_REACTION_ACTIVE, "after its fault")  # a reset would be lost meanwhile
            self.sdo.write(CONTROLWORD, FAULT_RESET)
            self._wait_while(State.FAULT, "after fault reset")
            self.sdo.write(CONTROLWORD, DISABLE_VOLTAGE)
        self._emergency, self._restarted, self.snapshot, self.target = None, False, None, None

    def _wait_while(self, bad: State, since: str) -> None:
        deadline = self._bus.clock.now() + TO_RESET
        while self.state() is bad:
            if self._bus.clock.now() > deadline:
                raise HardwareTimeout(self.name, f"still {bad} {TO_RESET:g} s {since}")
            self._bus.clock.sleep(self._bus.config.sync_period)

    # process data

    def command(self, target: int, controlword: int, mode: int = PROFILE_POSITION) -> None:
        """Takes effect at the next SYNC."""
        with self._bus.commanding:
            if self._bus.stopped:
                raise Stopped(f"{self.name}: the axes were quick-stopped; start them again")
            self._send(target, controlword, mode)

    def send_quick_stop(self) -> None:
        counts = self.snapshot.counts if self.snapshot else 0
        self._send(counts, QUICK_STOP, self.snapshot.mode if self.snapshot else PROFILE_POSITION)

    def _send(self, target: int, controlword: int, mode: int) -> None:
        self._bus.send(0x200 + self.node_id, struct.pack("<ibH", target, mode, controlword))

    # supervision

    @property
    def in_trouble(self) -> bool:
        """Whether `trouble` is any; asks nobody."""
        return self._off_course or self._faulty or self._restarted

    @property
    def _off_course(self) -> bool:
        return self.snapshot is not None and self.snapshot.off_course and self.snapshot.mode == PROFILE_POSITION

    @property
    def _faulty(self) -> bool:
        return self._emergency is not None or self.shows(*FAULTY)

    def shows(self, *states: State) -> bool:
        """Whether its last process data say one of these states."""
        return self.snapshot is not None and self.snapshot.state in states

    def trouble(self) -> HardwareError | None:
        """What process data, emergencies and boot-ups say is wrong with this drive. A fault's code may be asked for."""
        if self._off_course and (snapshot := self.snapshot) is not None:
            return self._following_error(snapshot)
        if self._faulty:
            return self._drive_fault()
        if self._restarted:
            return DriveFault(self.name, "restarted by itself (boot-up message); its configuration is gone")
        return None

    def silence(self) -> HeartbeatLost | None:
        """A heartbeat that is overdue, after messages in flight have had their chance."""
        clock, limit = self._bus.clock, self._bus.config.heartbeat_timeout
        if clock.now() - self._last_heard <= limit:
            return None
        with self._bus.arrival:
            seen = self._last_heard
            if clock.wait_for(self._bus.arrival, lambda: self._last_heard != seen, 0.1):
                return None
        silent = clock.now() - self._last_heard
        return HeartbeatLost(self.name, f"no heartbeat for {silent:.1f} s (node {self.node_id})")

    def fell_back(self) -> str:
        """The NMT state that its heartbeat says, where that is fresh and none that process data come in; else ''."""
        fresh = self._bus.clock.now() - self._last_heard <= self._bus.config.heartbeat_timeout
        state = str(self._node.nmt.state)
        return state if fresh and state in ("PRE-OPERATIONAL", "STOPPED") else ""

    def silent_after_sync(self) -> HeartbeatLost:
        waited, heard = self._bus.config.answer_timeout, self._bus.clock.now() - self._last_heard
        text = f"no process data within {waited:g} s of SYNC, last heartbeat {heard:.1f} s ago, {self._node.nmt.state}"
        return HeartbeatLost(self.name, f"{text} (node {self.node_id})")

    def _following_error(self, snapshot: Snapshot) -> FollowingError:
        c = self.config
        aim = "no target" if self.target is None else f"target {c.to_si(self.target):.6g} {c.unit}"
        text = f"following error at {c.to_si(snapshot.counts):.6g} {c.unit}, {aim}"
        if self.target is not None:
            text += f", {abs(snapshot.counts - self.target) / c.counts_per_unit:.3g} {c.unit} to go"
        if c.following_window is not None:
            seconds = FOLLOWING_S if c.following_s is None else c.following_s
            text += f" (window {c.following_window:g} {c.unit} for {seconds:g} s)"
        return FollowingError(self.name, text)

    def _drive_fault(self) -> DriveFault:
        code = self._emergency
        try:
            if code is None:
                code = self.sdo.read_if_present(ERROR_CODE)
            if not code:  # none, or none yet: some drives give it when their reaction has ended
                register = self.sdo.read_if_present(ERROR_REGISTER)
                return DriveFault(self.name, f"drive fault without a code, error register {_hex(register)}")
        except HardwareError as error:
            return DriveFault(self.name, f"drive fault, its code cannot be read: {error.cause}")
        return DriveFault(self.name, f"drive fault 0x{code:04X}, {meaning(code)}")


def _number(value: int | None) -> str:
    return "not given" if value is None else str(value)


def _hex(value: int | None) -> str:
    return "not given" if value is None else f"0x{value:X}"
