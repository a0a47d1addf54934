"""All axes of a machine on one CAN bus: they start together, and one fault stops them all.

A move is a handshake (bit 4 and bit 12, two fresh process data per step), a SYNC that starts every axis at once, and a
wait in coarse steps of machine time until each drive says "reached" and stands inside its window for the window's time.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from types import TracebackType

from drivers.axis_config import AxisConfig
from drivers.canopen_bus import BusConfig, CanBus
from drivers.cia402 import Cia402Axis
from drivers.cia402_objects import CHANGE_AT_ONCE, ENABLE, NEW_SET_POINT, PROFILE_POSITION, Snapshot, State
from drivers.homing import home
from drivers.ports import Clock, DeviceInfo, MoveReport
from drivers.stopping import Stopping
from ppshw.errors import (
    BadInput,
    BusLost,
    DriveFault,
    FollowingError,
    HardwareError,
    HardwareTimeout,
    SiteError,
    Stopped,
)

log = logging.getLogger(__name__)

AWAKE_S = 1.0  # of machine time for a drive to send process data once it was told to
HANDSHAKE_TIMEOUT, HANDSHAKE_SYNCS = 0.5, 20  # s of machine time and SYNCs; a drive needs two SYNCs
ASTRAY = 0.01  # m or rad; by so much no axis leaves its way, whatever it overshoots (ours)
MARGIN_FACTOR, MARGIN_S = 1.5, 5.0  # a move may take this much longer than its trapezoid before it is given up


class Cia402Group:
    """The AxisGroup of a CANopen machine. Connects in check() or start(), not before."""

    def __init__(self, axes: Sequence[AxisConfig], bus: BusConfig, clock: Clock) -> None:
        self.names: Sequence[str] = tuple(axis.name for axis in axes)
        if not axes:
            raise SiteError("a group needs at least one axis")
        for what, values in (("name", self.names), ("node id", [axis.node_id for axis in axes])):
            if len(set(values)) < len(values):
                raise SiteError(f"two axes have the same {what}: {', '.join(map(str, values))}")
        self._configs = {axis.name: axis for axis in axes}
        self._clock = clock
        self._bus = CanBus(bus, clock)
        self._axes: dict[str, Cia402Axis] = {}
        self._approach = dict.fromkeys(self.names, 0)
        self._at_rest_since = 0.0  # since the last motion, the start or a homing ended
        self._started = False
        self._ours = False  # nobody else was found to move these axes
        self._stopping = Stopping(self._bus, clock, self._axes_now)

    @property
    def unstopped(self) -> Sequence[str]:
        return self._stopping.unstopped

    def _axes_now(self) -> Collection[Cia402Axis]:
        return self._axes.values()

    def axis(self, name: str) -> Cia402Axis:
        self.connect()
        return self._axes[name]

    def connect(self) -> None:
        self._bus.open()
        if not self._axes:
            self._axes = {
                name: Cia402Axis(config, self._bus, on_emergency=self._on_emergency)
                for name, config in self._configs.items()
            }

    def check(self) -> list[DeviceInfo]:
        self.connect()
        return [axis.info() for axis in self._axes.values()]

    def look(self) -> list[DeviceInfo]:
        try:
            self.connect()
        except HardwareError as error:
            unreached = f"{error.cause}; not reached: {', '.join(self.names)}"
            return [DeviceInfo(error.device, "", "", "", "", unreached)]
        rows = []
        for axis in self._axes.values():
            try:
                rows.append(axis.info())
            except HardwareError as error:
                cause = error.cause if error.device == axis.name else str(error)
                rows.append(DeviceInfo(axis.name, "", "", "", "", cause))
        return rows

    def start(self) -> list[str]:
        self.connect()
        for axis in self._axes.values():
            axis.check_identity()
            axis.refuse_in_motion()
        self._ours = True
        self._bus.stopped = False
        self._bus.begin_heartbeat()
        try:
            for axis in self._axes.values():
                axis.target = None
                axis.configure()
            self._started = True
            self._await_process_data()
            self._exchange(expect_enabled=False)
            for axis in self._axes.values():
                if axis.config.homing is None or axis.homed:  # else its reading means nothing yet
                    axis.config.require_possible(axis.here())
            for axis in self._axes.values():
                axis.enable()
            homed = [axis for axis in self._axes.values() if axis.config.homing is not None and not axis.homed]
            for axis in homed:
                self._home(axis)
            self._exchange()
            self._at_rest_since = self._clock.now()
        except BaseException as error:
            self.quick_stop()
            if isinstance(error, Stopped):
                self._raise_trouble()  # the reason, where an emergency stopped all meanwhile
            raise
        return [axis.name for axis in homed]

    def home(self, name: str) -> None:
        """Home one axis again, homed or not."""
        self.raise_if_faulty()
        try:
            self._home(self.axis(name))
        except BaseException:
            self.quick_stop()
            raise

    def _home(self, axis: Cia402Axis) -> None:
        try:
            home(axis, self._bus, lambda: self._exchange(but=axis))
            self._at_rest_since = self._clock.now()
        except Stopped:
            self._raise_trouble()  # the reason, where an emergency stopped all in between two looks
            raise

    def reset_faults(self) -> None:
        """Acknowledge the faults of all drives; enables none. start() goes on from there."""
        self.connect()
        for axis in self._axes.values():
            axis.reset_fault()

    def positions(self) -> dict[str, float]:
        self.connect()
        if self._started:
            self._exchange(expect_enabled=False)
        return {name: axis.here() for name, axis in self._axes.items()}

    def close(self) -> None:
        """Disable every drive (brakes close), end its watch over our heartbeat, leave the bus; no step is left out for
        one that failed."""
        steps = [self._stopping.stand_still] if self._started else []
        for axis in self._axes.values():
            steps += [partial(self._stopping.switch_off, axis)] if self._started else []
            steps += [axis.end_watch]
        try:
            for step in steps:
                try:
                    step()
                except Exception as error:
                    log.warning("closing: %s", error)
        finally:
            self._started = self._ours = False
            self._axes = {}
            self._bus.close()

    def __enter__(self) -> Cia402Group:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # stopping

    def quick_stop(self) -> None:
        """Best effort: what fails is logged and in `unstopped`. Axes that another program moves are left to it."""
        if not self._ours:
            return
        try:
            self._stopping.stop()
        finally:
            for axis in self._axes.values():
                axis.target = None

    def _on_emergency(self) -> None:
        """Called in the receiving thread; a bus that we only look at is left alone, and so is one that was stopped."""
        if self._started and not self._bus.stopped:
            self._stopping.at_once()

    # supervision

    def raise_if_faulty(self) -> None:
        if not self._started:
            return
        try:
            self._raise_trouble()
            self._raise_silence({axis.name: s for axis in self._axes.values() if (s := axis.silence())})
            self._exchange()
        except BaseException as error:
            self.quick_stop()
            if isinstance(error, Stopped):
                self._raise_trouble()  # the reason, where an emergency stopped all before the look
            raise

    def require_at_rest(self, at: Mapping[str, float], within: float | None = None) -> None:
        self.raise_if_faulty()
        for axis in self._axes.values():
            now, before, config = axis.here(), at[axis.name], axis.config
            window, rounding = (config.window, 0.5 / config.counts_per_unit) if within is None else (within, 0.0)
            if abs(now - before) > window + rounding:
                self.quick_stop()
                moved = f"moved from {before:.6g} to {now:.6g} {config.unit} while it should stand"
                raise FollowingError(axis.name, f"{moved} (window {window:g} {config.unit})")

    def _raise_trouble(self) -> None:
        self._bus.check()
        if any(axis.in_trouble for axis in self._axes.values()):
            self._on_emergency()  # before anybody is asked what it is
        for axis in self._axes.values():
            if (trouble := axis.trouble()) is not None:
                raise trouble

    def _raise_silence(self, silences: Mapping[str, HardwareError]) -> None:
        if not silences:
            return
        if len(silences) == len(self._axes) > 1:
            fallen = {axis.fell_back() for axis in self._axes.values()}
            if len(fallen) == 1 and (state := fallen.pop()):
                raise BusLost(self._bus.config.name, f"every axis is {state}: another program's word (NMT), or theirs")
            raise BusLost(self._bus.config.name, f"silent: nothing from {', '.join(silences)}")
        raise next(iter(silences.values()))

    def _exchange(self, expect_enabled: bool = True, but: Cia402Axis | None = None) -> None:
        """Fresh process data from every axis, or the reason why not; all are to be enabled, `but` one that homes."""
        axes = self._axes.values()
        silent = self._bus.exchange([axis.node_id for axis in axes])
        self._raise_trouble()
        if silent:
            silent = self._still_silent(silent)
        self._raise_silence({a.name: a.silent_after_sync() for a in axes if a.node_id in silent})
        self._raise_silence({a.name: s for a in axes if (s := a.silence())})
        if not expect_enabled:
            return
        if self._bus.stopped:
            raise Stopped("the axes were quick-stopped; start them again")
        for axis in axes:
            state = _snapshot(axis).state
            if axis is not but and state is not State.OPERATION_ENABLED:
                raise DriveFault(axis.name, f"is {state}, not {State.OPERATION_ENABLED}; start it again")

    def _await_process_data(self) -> None:
        """Until every axis has answered a SYNC, for a bounded time: between the word to start and when a drive acts on
        it some milliseconds may pass, and a SYNC meanwhile is lost. Nothing is enabled yet."""
        silent, until = {axis.node_id for axis in self._axes.values()}, self._clock.now() + AWAKE_S
        while silent and self._clock.now() < until:
            silent = self._bus.exchange(silent)

    def _still_silent(self, silent: set[int]) -> set[int]:
        """Everyone is asked once more: all nodes if none answers now (the bus fell silent in between two answers), else
        those that did not answer both times, or one of them if they were only late: none that was late shall be named
        in the place of one that is gone. Raises HardwareTimeout of the bus where all nodes were late together. Nothing
        is forgiven for it: all is stopped first."""
        self._stopping.at_once()
        everyone = {axis.node_id for axis in self._axes.values()}
        again = self._bus.exchange(everyone)
        self._raise_trouble()
        if silent == everyone and not again and len(everyone) > 1:
            late = f"every drive's answer to a SYNC came more than {self._bus.config.answer_timeout:g} s late"
            raise HardwareTimeout(self._bus.config.name, f"{late}: the adapter or this computer?")
        return again if again == everyone else again & silent or {min(silent)}

    # moving

    def move(self, setpoints: Mapping[str, float]) -> MoveReport:
        legs = self._plan(setpoints)
        try:
            if not self._started:
                raise HardwareError("axes", "not started")
            self._exchange()
            for leg in legs():
                self._run_leg(leg)
        except BaseException as error:
            self.quick_stop()
            if isinstance(error, Stopped):
                self._raise_trouble()  # the reason, where an emergency stopped all in between two looks
            raise
        positions = {name: axis.here() for name, axis in self._axes.items()}
        return MoveReport(positions, dict(self._approach), self._at_rest_since)

    def _plan(self, setpoints: Mapping[str, float]) -> Callable[[], Iterable[dict[str, int]]]:
        """Every limit is checked here, before anything moves."""
        starts: dict[str, float] = {}
        for name, setpoint in setpoints.items():
            if name not in self._configs:
                raise BadInput(f"no axis is called {name!r}; the axes are {', '.join(self.names)}")
            config = self._configs[name]
            config.require_within_limits(setpoint)
            if (start := config.approach_start(setpoint)) is not None:
                config.require_within_limits(start)
                starts[name] = start

        def legs() -> Iterable[dict[str, int]]:
            final = {name: self._configs[name].to_counts(q) for name, q in setpoints.items()}
            detours = {
                name: self._configs[name].to_counts(q)
                for name, q in starts.items()
                if self._needs_detour(name, q, final[name])
            }
            if detours:
                yield final | detours
            yield final

        return legs

    def _needs_detour(self, name: str, start: float, target: int) -> bool:
        """Whether the axis would otherwise come from the wrong side, or from too near."""
        axis, config = self._axes[name], self._configs[name]
        if axis.target == target:
            return False
        assert config.approach_from is not None
        here = config.to_si(self._departure(axis))
        return (here - start) * config.approach_from < 0

    def _departure(self, axis: Cia402Axis) -> int:
        return axis.target if axis.target is not None else _snapshot(axis).counts

    def _run_leg(self, targets: Mapping[str, int]) -> None:
        moving: list[Cia402Axis] = []
        ways = {name: (axis.target, axis.target) for name, axis in self._axes.items() if axis.target is not None}
        duration = 0.0
        for name, target in targets.items():
            axis = self._axes[name]
            if axis.target == target:
                continue
            known = axis.target is not None
            distance = target - (here := self._departure(axis))
            ways[name] = min(here, target), max(here, target)
            # where no target was known, it stands somewhere about where it was sent: less is no motion
            if abs(distance) > (0 if known else axis.config.window * axis.config.counts_per_unit):
                self._approach[name] = axis.config.direction * (1 if distance > 0 else -1)
            duration = max(duration, axis.config.travel_time(abs(distance) / axis.config.counts_per_unit))
            axis.target = target
            moving.append(axis)
        if not moving:
            return
        started = self._start_together(moving)
        self._at_rest_since = self._wait_until_at_rest(started, duration, ways)

    def _start_together(self, moving: Sequence[Cia402Axis]) -> float:
        """Targets out, one SYNC for all. Returns when the SYNC went out."""
        if any(_snapshot(a).acknowledged or _snapshot(a).mode != PROFILE_POSITION for a in moving):
            self._command(moving, ENABLE)
            self._shake_hands(
                moving,
                lambda s: not s.acknowledged and s.mode == PROFILE_POSITION,
                "is not ready for a set-point in profile position mode",
            )
        self._command(moving, ENABLE | NEW_SET_POINT | CHANGE_AT_ONCE)
        started = self._clock.now()
        self._shake_hands(moving, lambda s: s.acknowledged, "does not acknowledge its set-point (bit 12)")
        self._command(moving, ENABLE)
        self._shake_hands(moving, lambda s: not s.acknowledged, "does not take back its acknowledgement (bit 12)")
        return started

    def _command(self, axes: Sequence[Cia402Axis], controlword: int) -> None:
        for axis in axes:
            axis.command(self._departure(axis), controlword)

    def _shake_hands(self, axes: Sequence[Cia402Axis], done: Callable[[Snapshot], bool], otherwise: str) -> None:
        """The first process data were sampled at the SYNC that carried the command; the second answer it."""
        deadline = self._clock.now() + HANDSHAKE_TIMEOUT
        self._exchange()
        for look in itertools.count(1):
            self._clock.sleep(self._bus.config.sync_period)
            self._exchange()
            laggard = next((axis for axis in axes if not done(_snapshot(axis))), None)
            if laggard is None:
                return
            if self._clock.now() > deadline and look >= HANDSHAKE_SYNCS:
                state = _snapshot(laggard).state
                raise HardwareTimeout(laggard.name, f"{otherwise} within {HANDSHAKE_TIMEOUT:g} s, {state}")

    def _wait_until_at_rest(self, started: float, duration: float, ways: Mapping[str, tuple[int, int]]) -> float:
        """Returns when the last axis came to rest: the begin of the time that it then stayed at rest. Raises
        FollowingError for an axis that leaves its way [counts]: a drive that runs off (its encoder's or motor's sign, a
        belt) needs no following error of its own for that."""
        expected_end = started + duration
        deadline = started + MARGIN_FACTOR * duration + MARGIN_S
        at_rest_since: dict[str, float] = {}
        while True:
            now = self._clock.now()
            self._clock.sleep(self._next_look(now, expected_end, at_rest_since))
            self._exchange()
            now = self._clock.now()
            for name, way in ways.items():
                self._require_on(way, self._axes[name])
            for axis in self._axes.values():
                if _is_at_rest(axis):
                    at_rest_since.setdefault(axis.name, now)
                else:
                    at_rest_since.pop(axis.name, None)
            if all(
                axis.name in at_rest_since and now - at_rest_since[axis.name] >= axis.config.window_s - 1e-9
                for axis in self._axes.values()
            ):
                return max(at_rest_since.values())
            if now > deadline:
                raise self._late(now - started, at_rest_since)

    def _require_on(self, way: tuple[int, int], axis: Cia402Axis) -> None:
        c, counts = axis.config, _snapshot(axis).counts
        if max(way[0] - counts, counts - way[1]) > ASTRAY * c.counts_per_unit:
            ends = sorted(c.to_si(end) for end in way)
            text = f"stands at {c.to_si(counts):.6g} {c.unit}, its way is {ends[0]:.6g} to {ends[1]:.6g} {c.unit}"
            raise FollowingError(axis.name, f"{text}: its encoder's or motor's sign, or another program?")

    def _next_look(self, now: float, expected_end: float, at_rest_since: Mapping[str, float]) -> float:
        config = self._bus.config
        if now < expected_end:
            return min(config.poll_period, max(config.sync_period, expected_end - now))
        if len(at_rest_since) == len(self._axes):
            until = max(since + self._configs[name].window_s for name, since in at_rest_since.items())
            return min(config.poll_period, max(1e-3, until - now))
        return config.sync_period

    def _late(self, after: float, at_rest_since: Mapping[str, float]) -> HardwareTimeout:
        axes = list(self._axes.values())
        axis = next((a for a in axes if a.name not in at_rest_since), axes[-1])
        config, snapshot = axis.config, _snapshot(axis)
        gap = (self._departure(axis) - snapshot.counts) / config.counts_per_unit
        reached = "set" if snapshot.target_reached else "not set"
        limited = ", limited by the drive (bit 11)" if snapshot.statusword & 0x0800 else ""
        return HardwareTimeout(
            axis.name,
            f"not at rest on its target {after:.1f} s after the start: {abs(gap):.3g} {config.unit} away, "
            f"'target reached' {reached}{limited}, {snapshot.state}",
        )


def _snapshot(axis: Cia402Axis) -> Snapshot:
    if axis.snapshot is None:
        raise axis.silent_after_sync()
    return axis.snapshot


def _is_at_rest(axis: Cia402Axis) -> bool:
    """On its target by the drive's word and by our own measure; an axis that was never sent anywhere rests."""
    if axis.target is None:
        return True
    snapshot = _snapshot(axis)
    return snapshot.target_reached and abs(snapshot.counts - axis.target) <= axis.config.window_counts
