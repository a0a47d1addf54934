"""What happens when not all goes well with a stop: the bus takes nothing, a drive is slow or deaf, runs off or will not
say what it has. On simulated drives (`rack`)."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from time import monotonic, sleep
from types import SimpleNamespace
from typing import Any

import can
import pytest

from drivers.axis_group import Cia402Group
from drivers.canopen_bus import BusConfig
from drivers.stopping import Stopping
from ppshw.errors import (
    BusLost,
    ConfigurationMismatch,
    DriveFault,
    FollowingError,
    HardwareError,
    HardwareTimeout,
    IdentityMismatch,
    ProtocolError,
)
from simulators.clock import SteppedClock
from simulators.drive import Power, SimulatedDrive
from tests.unit.axes.rack import LIFT, SLEW, SLIDE, Machine

FAR = {"slide": 0.9, "lift": 0.9, "slew": 1.4}


class Deaf(SimulatedDrive):
    """Answers, moves on, and no longer heeds any controlword, as firmware whose state machine hangs."""

    deaf = False

    def _obey(self, command: int, risen: int) -> None:
        if not self.deaf:
            super()._obey(command, risen)


class Deliberate(SimulatedDrive):
    """Acts on a controlword some machine time after it came in, as firmware does in its next cycle."""

    after_s = 0.0

    def _obey(self, command: int, risen: int) -> None:
        if not self.after_s:
            super()._obey(command, risen)
            return

        def late() -> None:
            with self.lock:
                SimulatedDrive._obey(self, command, risen)

        self.clock.at(self.clock.now() + self.after_s, late)  # type: ignore[attr-defined]


class RunsOff(SimulatedDrive):
    """Its encoder counts the other way round from some moment on, and it watches no following error."""

    wrong = False

    def position(self, time: float) -> float:
        return -super().position(time) if self.wrong else super().position(time)

    def _watch_following(self, error: float, now: float) -> None:
        pass


def power_cut_at(m: Machine, monkeypatch: pytest.MonkeyPatch) -> dict[int, float]:
    """Speeds [counts/s] at which drives lost their power."""
    speeds: dict[int, float] = {}
    switch = SimulatedDrive._switch

    def watched(drive: SimulatedDrive, to: Power) -> None:
        if to is Power.SWITCH_ON_DISABLED:
            speeds[drive.id] = abs(drive.motor_velocity(drive.clock.now()))
        switch(drive, to)

    monkeypatch.setattr(SimulatedDrive, "_switch", watched)
    return speeds


@pytest.mark.parametrize("seconds", [0.1, 0.4])
def test_a_stop_that_the_bus_did_not_take_is_said_again(machine: Machine, seconds: float) -> None:
    """A full queue of socketcan, or a bus-off that ends by itself."""
    bus = machine.group._bus.network.bus
    assert bus is not None
    send, since = bus.send, list[float]()

    def full(message: can.Message, timeout: float | None = None) -> None:
        if not since and machine.clock.now() > 2.5:
            since.append(machine.clock.now())
        if since and machine.clock.now() < since[0] + seconds:
            raise can.CanOperationError("Failed to transmit: [Errno 105] No buffer space available")
        send(message, timeout)

    bus.send = full  # type: ignore[method-assign]
    with pytest.raises(BusLost, match=r"cannot send: .* No buffer space available"):
        machine.group.move(FAR)
    assert machine.clock.now() < since[0] + seconds + 0.2
    assert machine.group.unstopped == []
    assert all(drive.power is not Power.OPERATION_ENABLED for drive in machine.drives)
    machine.group.close()
    assert machine.group.unstopped == []


def test_a_stop_that_gets_out_only_while_the_group_is_closed_is_a_stop(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    speeds = power_cut_at(machine, monkeypatch)
    bus = machine.group._bus.network.bus
    assert bus is not None
    send, until = bus.send, [0.0]

    def full(message: can.Message, timeout: float | None = None) -> None:
        if machine.clock.now() < until[0]:
            raise can.CanOperationError("No buffer space available")
        send(message, timeout)

    bus.send = full  # type: ignore[method-assign]
    machine.after(2.5, lambda: until.__setitem__(0, machine.clock.now() + 3.5))
    with pytest.raises(BusLost):
        machine.group.move(FAR)
    assert set(machine.group.unstopped) == set(machine.group.names)
    machine.group.close()
    assert machine.group.unstopped == []
    assert speeds == {1: 0.0, 2: 0.0, 3: 0.0}  # by their ramps first


def test_a_drive_that_needs_a_moment_to_obey_stops_by_its_ramp(
    build: Callable[..., Machine], monkeypatch: pytest.MonkeyPatch
) -> None:
    m = build(kind=Deliberate)
    m.group.start()
    speeds = power_cut_at(m, monkeypatch)

    def interrupt() -> None:
        for drive in m.drives:
            drive.after_s = 0.05  # type: ignore[attr-defined]
        raise KeyboardInterrupt

    sleep = m.clock.sleep
    m.clock.sleep = lambda s: interrupt() if m.clock.now() > 3.0 and not m.drive("slide").after_s else sleep(s)  # type: ignore
    with pytest.raises(KeyboardInterrupt):
        m.group.move(FAR)
    assert speeds == {}
    assert {drive.power for drive in m.drives} == {Power.QUICK_STOP_ACTIVE}
    assert m.group.unstopped == []


def test_a_drive_that_acknowledges_a_stop_and_moves_on_is_said(build: Callable[..., Machine]) -> None:
    m = build(kind=Deaf)
    m.group.start()
    m.after(2.0, lambda: setattr(m.drive("lift"), "deaf", True))
    m.after(2.5, lambda: m.drive("slew").trip(0x2310))
    with pytest.raises(DriveFault, match="slew: drive fault 0x2310"):
        m.group.move(FAR)
    assert m.group.unstopped == ["lift"]
    m.group.close()
    assert m.group.unstopped == ["lift"]
    assert abs(m.drive("lift").motor_velocity(m.clock.now())) > 0


def test_only_a_silent_axis_is_said_where_waiting_for_it_takes_as_long_as_all_ramps(
    build: Callable[..., Machine],
) -> None:
    m = build(answer_timeout=5.0)
    m.group.start()
    m.after(2.5, m.drive("slew").go_silent)
    with pytest.raises(HardwareError, match="slew: no "):
        m.group.move(FAR)
    m.group.close()
    assert m.group.unstopped == ["slew"]
    assert [m.drive(name).power for name in ("slide", "lift")] == [Power.SWITCH_ON_DISABLED] * 2


def test_an_axis_whose_power_went_before_it_stood_is_said(machine: Machine) -> None:
    for drive in machine.drives:
        drive.store(0x6085, 0, 500)  # 10 mrad/s² of the slew, which needs 10 s; 5 and 2.5 mm/s² of the others
    machine.after(2.5, lambda: machine.drive("slew").trip(0x2310))
    with pytest.raises(DriveFault):
        machine.group.move(FAR)
    assert machine.group.unstopped == []  # they obeyed
    machine.group.close()
    assert set(machine.group.unstopped) == {"slide", "lift", "slew"}


def test_answers_to_the_stop_itself_that_come_late_are_no_looks_at_axes_that_stand(machine: Machine) -> None:
    """A laden host's: two of the moment of the stop came after it, and were taken for two looks 0.1 s apart."""
    for drive in machine.drives:
        drive.store(0x6085, 0, 500)
    bus, late = machine.group._bus, threading.Event()
    received = bus.received

    def slowly(node_id: int) -> None:
        if late.is_set():
            sleep(0.01)  # messages cross the bus in real time
        received(node_id)

    bus.received = slowly  # type: ignore[method-assign]
    machine.after(2.5, lambda: machine.drive("slew").trip(0x2310))
    with pytest.raises(DriveFault):
        machine.group.move(FAR)
    late.set()
    for _ in range(4):
        bus.sync()  # as a stop that is said again
    machine.group.close()
    assert set(machine.group.unstopped) == {"slide", "lift", "slew"}


def test_an_axis_that_leaves_its_way_is_stopped_without_a_following_error_of_its_own(
    build: Callable[..., Machine],
) -> None:
    m = build(replace(SLIDE, following_window=None, lower=-0.2), LIFT, kind=RunsOff)
    m.group.start()
    m.drive("slide").wrong = True  # type: ignore[attr-defined]
    began = m.clock.now()
    with pytest.raises(FollowingError, match=r"slide: stands at -0\.\d+ m, its way is 0 to 0\.9 m: its encoder's or"):
        m.group.move({"slide": 0.9, "lift": 0.1})
    assert m.clock.now() - began < 2.0
    assert m.drive("lift").power is Power.QUICK_STOP_ACTIVE


def test_an_axis_that_shall_stand_and_is_carried_off_stops_the_move(machine: Machine) -> None:
    machine.group.move({"slew": 0.6})
    machine.after(1.0, lambda: machine.drive("slew").lie_about(0x6064, 6_000))  # 0.62 rad
    began = machine.clock.now()
    with pytest.raises(FollowingError, match=r"slew: stands at 0\.62 rad, its way is 0\.6 to 0\.6 rad"):
        machine.group.move({"slide": 0.9})
    assert machine.clock.now() - began < 3.0


def test_the_others_stop_before_a_faulty_drive_is_asked_what_it_has(build: Callable[..., Machine]) -> None:
    m = build(missing=(0x1014,))  # no emergency message
    m.group.start()
    seen: list[Power] = []
    read = m.group._axes["slew"].sdo.read_if_present

    def ask(entry: Any) -> int | None:
        if entry.index == 0x603F:
            until = monotonic() + 5.0  # messages cross the bus in real time
            while m.drive("slide").power is Power.OPERATION_ENABLED and monotonic() < until:
                sleep(0.001)
            seen.append(m.drive("slide").power)
            raise HardwareError("slew", "no SDO answer")
        return read(entry)

    m.group._axes["slew"].sdo.read_if_present = ask  # type: ignore[method-assign]
    m.after(2.5, lambda: m.drive("slew").trip(0x2310))
    with pytest.raises(DriveFault, match="slew: drive fault, its code cannot be read: no SDO answer"):
        m.group.move(FAR)
    assert seen[0] is Power.QUICK_STOP_ACTIVE


def test_a_drive_that_restarts_stops_the_others_at_once(machine: Machine) -> None:
    """Not only when the program has waited for its process data."""
    told = threading.Event()
    at_once = machine.group._stopping.at_once

    def heard() -> bool:
        told.set()
        return at_once()

    machine.group._stopping.at_once = heard  # type: ignore[method-assign]
    machine.drive("slew").unplug()
    machine.drive("slew").replug()
    assert told.wait(5.0)  # the message crosses the bus in real time
    with pytest.raises(DriveFault, match="slew: restarted by itself"):
        machine.group.raise_if_faulty()


def test_a_drive_that_restarts_while_it_is_configured_is_not_used(build: Callable[..., Machine]) -> None:
    class Restarts(SimulatedDrive):
        armed = False

        def written(self, index: int, subindex: int, data: bytes) -> None:
            super().written(index, subindex, data)
            if self.armed and index == 0x6068:
                self.armed = False
                self._power_up()
                self.boot()

    m = build(SLIDE, LIFT, kind=Restarts)
    m.drive("slide").armed = True  # type: ignore[attr-defined]
    with pytest.raises(HardwareError, match="slide: "):
        m.group.start()
    assert m.drive("slide").power is not Power.OPERATION_ENABLED


def test_where_the_target_is_not_known_less_than_the_window_is_no_motion(machine: Machine) -> None:
    assert machine.group.move({"slide": 0.05}).approach["slide"] == 1
    machine.group.close()
    machine.drive("slide").lie_about(0x6064, 5_001)  # a count beyond
    again = Cia402Group(machine.axes, BusConfig(can=machine.group._bus.config.can), machine.clock)
    with again:
        again.start()
        assert again.move({"slide": 0.05}).approach["slide"] == 0


def test_a_watch_over_a_node_that_lives_is_left_alone(build: Callable[..., Machine]) -> None:
    m = build(SLIDE, LIFT)
    for drive in m.drives:
        drive.store(0x1016, 1, 0x7F << 16 | 200)  # as of a safety controller
    beat = m.rack.network.send_periodic(0x77F, b"\x05", 0.02)
    try:
        m.group.start()
        m.group.close()
        assert [drive.value(0x1016, 1) for drive in m.drives] == [0x7F << 16 | 200] * 2
        host = BusConfig(can={"interface": "virtual", "channel": m.rack.channel}, host_node_id=0x7E)
        with (
            Cia402Group(m.axes, host, m.clock) as group,
            pytest.raises(ConfigurationMismatch, match=r"slide: watches node 127, which lives; 'can\.host_node_id'"),
        ):
            group.start()
    finally:
        beat.stop()
    assert [drive.value(0x1016, 1) for drive in m.drives] == [0x7F << 16 | 200] * 2


def test_an_answer_shorter_than_its_object_is_none(machine: Machine) -> None:
    axis = machine.group.axis("slide")
    axis.sdo.upload = lambda entry: b"\x78\xec"  # type: ignore[method-assign]  -5000 in two bytes, 60 536 in four
    with pytest.raises(ProtocolError, match=r"slide: the SDO answer on position 0x6064:00 has 2 bytes, expected 4"):
        axis.position()


def test_a_drive_of_another_number_is_refused_where_the_site_says_one(build: Callable[..., Machine]) -> None:
    m = build(SLIDE, replace(LIFT, serial=1002), replace(SLEW, serial=4711))
    with pytest.raises(IdentityMismatch, match="slew: serial number is 1003, expected 4711"):
        m.group.start()


def test_an_axis_that_fell_back_is_not_cut_off_while_it_still_brakes(
    build: Callable[..., Machine], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It sends no process data any more, and answers SDO: it was at 226 mm/s when its power went (a reviewer's)."""
    m = build(replace(SLIDE, velocity=0.5, acceleration=0.25, following_window=None), LIFT, SLEW)
    m.group.start()
    slide = m.drive("slide")
    slide.store(0x6085, 0, 25_000)  # its quick stop takes two seconds
    m.group.move({"slide": -0.9})

    def fall_back() -> None:
        slide.node.nmt.state = "PRE-OPERATIONAL"

    m.after(2.0, fall_back)
    speeds = power_cut_at(m, monkeypatch)
    with pytest.raises(HardwareError, match=r"slide: no process data .* PRE-OPERATIONAL"):
        m.group.move({"slide": 0.9})
    m.group.close()
    assert speeds[slide.id] == 0.0
    assert m.group.unstopped == []


def test_a_round_of_stops_ends_where_each_message_waits_for_an_adapter_that_takes_none(machine: Machine) -> None:
    bus = machine.group._bus.network.bus
    assert bus is not None
    tried: list[int] = []

    def stalled(message: can.Message, timeout: float | None = None) -> None:
        assert timeout is not None
        tried.append(message.arbitration_id)
        sleep(0.3)
        raise can.CanTimeoutError("Could not write to serial device")

    send, bus.send = bus.send, stalled  # type: ignore[method-assign]
    assert not machine.group._stopping.at_once()
    bus.send = send  # type: ignore[method-assign]
    assert 1 <= len(tried) <= 2  # of four: three stops and a SYNC


def test_an_axis_that_missed_a_look_is_seen_again_by_its_process_data() -> None:
    """It answered neither SYNC nor SDO for a moment, and still brakes."""

    class Axis(SimpleNamespace):
        def here(self) -> float:
            return float(self.way.pop(0) if len(self.way) > 1 else self.way[0])

        def position(self) -> float:
            raise HardwareTimeout(self.name, "no SDO answer")

    axes: list[Any] = [
        Axis(name="slide", node_id=1, config=SLIDE, way=[0.5, 0.4, 0.3, 0.3]),
        Axis(name="lift", node_id=2, config=LIFT, way=[0.1]),
    ]
    looks = [{1}, set[int](), set[int](), set[int](), set[int]()]
    bus: Any = SimpleNamespace(answered=lambda seconds: None, exchange=lambda nodes: looks.pop(0))
    stopping = Stopping(bus, SteppedClock(), lambda: axes)
    stopping.stand_still()
    assert looks == []  # the fifth look is the first at which it stands
    assert stopping.unstopped == []


def test_a_stop_that_one_drive_was_not_sent_is_none_though_the_bus_took_all_else(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost() -> None:
        raise can.CanOperationError("Failed to transmit")

    assert machine.group._stopping.at_once()
    monkeypatch.setattr(machine.group._axes["lift"], "send_quick_stop", lost)
    assert not machine.group._stopping.at_once()


@pytest.mark.parametrize(
    ("silent", "again", "named"),
    [
        ({1}, {1, 2}, {1}),  # the second was late, or fell silent since: the first one is gone
        ({1, 3}, {2, 3}, {3}),
        ({3}, set(), {3}),  # late only, and no other one shall be named in its place
        ({1}, {1, 2, 3}, {1, 2, 3}),  # the bus fell silent
    ],
)
def test_who_is_named_did_not_answer_both_times(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, silent: set[int], again: set[int], named: set[int]
) -> None:
    nodes = sorted(axis.node_id for axis in machine.axes)
    monkeypatch.setattr(machine.group._bus, "exchange", lambda asked: {nodes[k - 1] for k in again})
    found = machine.group._still_silent({nodes[k - 1] for k in silent})
    assert found == {nodes[k - 1] for k in named}
