"""CiA 402 axes against simulated drives on a virtual CAN bus (`rack`). Time is stepped, nothing sleeps for a motion."""

from __future__ import annotations

import itertools
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import can
import canopen
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.axis_config import HomingConfig
from drivers.axis_group import Cia402Group
from drivers.canopen_bus import BusConfig, CanBus, Entry, SdoPort
from drivers.cia402 import Cia402Axis
from drivers.cia402_objects import State, decode_state
from drivers.emcy import meaning
from ppshw.errors import (
    BadInput,
    BusLost,
    ConfigurationMismatch,
    DriveFault,
    FollowingError,
    HardwareError,
    HardwareTimeout,
    HeartbeatLost,
    IdentityMismatch,
    ProtocolError,
    SiteError,
    SoftLimit,
    Stopped,
)
from simulators.clock import SteppedClock
from simulators.drive import Identity, Power, SimulatedDrive
from tests.unit.axes.rack import LIFT, SLEW, SLIDE, Machine

# moving


def test_a_move_turns_every_motor_by_its_own_scale_sign_and_offset(machine: Machine) -> None:
    report = machine.group.move({"slide": 0.25, "lift": 0.25, "slew": 0.1})
    # 0.25 m · 100 000; −0.25 m · 200 000; (0.1 − 0.5) rad · 50 000
    assert [round(d.motor_position()) for d in machine.drives] == [25_000, -50_000, -20_000]
    assert report.positions == pytest.approx({"slide": 0.25, "lift": 0.25, "slew": 0.1}, abs=1e-5)


def test_a_move_takes_as_long_as_its_longest_trapezoid(machine: Machine) -> None:
    began = machine.clock.now()
    report = machine.group.move({"slide": 1.0, "lift": 0.1})
    # 1 m at 0.1 m/s and 0.1 m/s² takes 11 s; the handshake and the look at rest add some SYNCs of 20 ms
    assert report.ended_at - began == pytest.approx(11.0, abs=0.15)
    assert machine.clock.now() - report.ended_at >= 0.05  # it stayed at rest for its window's time


def test_all_axes_start_at_the_same_sync(machine: Machine) -> None:
    machine.group.move({"slide": 0.3, "lift": -0.2, "slew": 0.9})
    starts = {tuple(drive.starts) for drive in machine.drives}
    assert len(starts) == 1
    assert len(starts.pop()) == 1


class LateToStart(SimulatedDrive):
    """Sends process data only some SYNCs after it was told to start: many stacks act on NMT in their main loop."""

    missed = 0

    def _on_nmt(self, can_id: int, data: bytearray, timestamp: float) -> None:
        super()._on_nmt(can_id, data, timestamp)
        if data[0] == 1:
            self.missed = 1

    def _on_sync(self, can_id: int, data: bytearray, timestamp: float) -> None:
        if self.missed:
            self.missed -= 1
        else:
            super()._on_sync(can_id, data, timestamp)


def test_a_drive_may_miss_the_sync_that_follows_the_word_to_start(build: Callable[..., Machine]) -> None:
    m = build(kind=LateToStart)
    m.group.start()
    assert m.group.move({"slide": 0.1}).positions["slide"] == pytest.approx(0.1, abs=1e-5)


class Hunting(SimulatedDrive):
    """A servo that holds within a count."""

    looks = 0

    def read(self, index: int, subindex: int) -> int | None:
        value = super().read(index, subindex)
        if index != 0x6064 or value is None:
            return value
        self.looks += 1
        return value + self.looks % 2


def test_an_encoder_whose_count_is_coarser_than_the_window_comes_to_rest(build: Callable[..., Machine]) -> None:
    """The drive has a window of a count, and so has the host: it had half of one, and no move ever ended."""
    m = build(replace(SLEW, counts_per_unit=10_000, following_window=None), kind=Hunting)
    m.group.start()
    assert m.drive("slew").value(0x6067) == 1
    assert m.group.move({"slew": 0.9}).positions["slew"] == pytest.approx(0.9, abs=1.5e-4)


def test_the_direction_of_approach_is_kept_until_an_axis_moves_again(machine: Machine) -> None:
    assert machine.group.move({"slide": 0.1, "lift": 0.1}).approach == {"slide": 1, "lift": 1, "slew": 0}
    assert machine.group.move({"slide": 0.05, "lift": 0.1}).approach == {"slide": -1, "lift": 1, "slew": 0}
    assert machine.group.move({"slide": 0.05, "slew": 0.4}).approach == {"slide": -1, "lift": 1, "slew": -1}


def test_a_move_to_where_it_stands_starts_nothing(machine: Machine) -> None:
    machine.group.move({"slide": 0.1})
    machine.group.move({"slide": 0.1})
    assert len(machine.drive("slide").starts) == 1


def test_an_axis_that_is_not_moved_rests_since_its_last_motion(machine: Machine) -> None:
    ended_at = machine.group.move({"slide": 0.1}).ended_at
    machine.clock.sleep(60.0)
    assert machine.group.move({"slide": 0.1}).ended_at == ended_at
    machine.clock.sleep(60.0)
    assert machine.group.move({"slide": 0.1, "lift": 0.1}).ended_at > ended_at + 120.0


def test_an_axis_that_was_stopped_meanwhile_is_not_taken_to_rest_since_its_last_motion(machine: Machine) -> None:
    ended_at = machine.group.move({"slide": 0.1}).ended_at
    machine.group.quick_stop()
    machine.group.start()
    assert machine.group.move({}).ended_at > ended_at
    assert machine.group.move({"slide": 0.1}).ended_at > ended_at


@pytest.mark.parametrize(("side", "direction", "turning_point"), [(-1, 1, 0.18), (1, -1, 0.22)])
def test_the_final_approach_comes_from_the_configured_side(
    build: Callable[..., Machine], side: int, direction: int, turning_point: float
) -> None:
    m = build(replace(SLIDE, approach_from=side, approach_distance=0.02))
    m.group.start()
    for start in (0.0, 0.5, 0.201, 0.199):
        m.group.move({"slide": start})
        seen: list[float] = []
        m.clock.every(0.05, lambda seen=seen: seen.append(m.drive("slide").motor_position() / 1e5))
        assert m.group.move({"slide": 0.2}).approach == {"slide": direction}
        assert direction * (turning_point - min(direction * x for x in seen) * direction) > -1e-4


def test_an_axis_that_stands_where_it_is_wanted_is_not_driven_away_for_its_side(build: Callable[..., Machine]) -> None:
    """Another joint moves: one that stays stands as it came."""
    m = build(replace(SLIDE, approach_from=-1, approach_distance=0.02), LIFT)
    m.group.start()
    m.group.move({"slide": 0.2, "lift": 0.0})
    seen: list[float] = []
    m.clock.every(0.02, lambda: seen.append(m.drive("slide").motor_position() / 1e5))
    m.group.move({"slide": 0.2, "lift": 0.3})
    assert len(seen) > 10
    assert max(seen) - min(seen) < 1e-4


def test_no_axis_moves_when_one_setpoint_is_outside_its_limits(machine: Machine) -> None:
    with pytest.raises(SoftLimit, match=r"slew: setpoint 1\.6 rad is above the limit 1\.5"):
        machine.group.move({"slide": 0.1, "slew": 1.6})
    with pytest.raises(SoftLimit, match="slide: setpoint nan is no position"):
        machine.group.move({"slide": float("nan")})
    assert [drive.starts for drive in machine.drives] == [[], [], []]


def test_a_final_approach_that_begins_outside_the_limits_is_refused(build: Callable[..., Machine]) -> None:
    m = build(replace(SLIDE, approach_from=-1, approach_distance=0.02))
    m.group.start()
    with pytest.raises(SoftLimit, match="below the limit"):
        m.group.move({"slide": -0.99})


def test_an_axis_nobody_knows_is_refused(machine: Machine) -> None:
    with pytest.raises(BadInput, match="no axis is called 'elbow'; the axes are slide, lift, slew"):
        machine.group.move({"elbow": 0.0})


@given(
    q=st.floats(-1.5, 1.5),
    scale=st.floats(1e3, 1e8),
    offset=st.floats(-2.0, 2.0),
    direction=st.sampled_from([-1, 1]),
)
def test_counts_and_positions_are_each_others_inverse(q: float, scale: float, offset: float, direction: int) -> None:
    axis = replace(SLEW, counts_per_unit=scale, offset=offset, direction=direction)
    counts = axis.to_counts(q)
    assert axis.to_si(counts) == pytest.approx(q, abs=0.5 / scale + 1e-12)
    assert (axis.to_counts(q + 2.0 / scale) - counts) * direction > 0


# trouble


def test_a_tripped_drive_says_why(machine: Machine) -> None:
    machine.drive("slew").trip(0x8611)
    with pytest.raises(DriveFault, match=r"^slew: drive fault 0x8611, following error$"):
        machine.group.axis("slew").enable()


def test_a_drive_that_trips_under_way_stops_all_others(machine: Machine) -> None:
    machine.after(3.0, lambda: machine.drive("slew").trip(0x2310))
    with pytest.raises(DriveFault, match="slew: drive fault 0x2310, continuous overcurrent on the motor side"):
        machine.group.move({"slide": 1.0, "lift": 1.0, "slew": 1.4})
    machine.clock.sleep(5.0)
    assert machine.drive("slide").power is Power.SWITCH_ON_DISABLED
    # 3 s at 0.1 m/s less 0.05 m for speeding up is 0.25 m; noticed within one poll of 1 s, braked at 1 m/s²
    assert 0.24 < machine.drive("slide").motor_position() / 1e5 < 0.37
    assert machine.drive("slide").motor_velocity(machine.clock.now()) == 0.0


def test_a_drive_that_trips_at_rest_is_found_and_stops_the_others(machine: Machine) -> None:
    machine.group.raise_if_faulty()
    machine.drive("lift").trip(0x3220)
    machine.clock.sleep(1.0)
    with pytest.raises(DriveFault, match="lift: drive fault 0x3220, DC link undervoltage"):
        machine.group.move({"slide": 0.1})
    assert machine.drive("slide").starts == []
    machine.clock.sleep(0.1)
    assert machine.drive("slide").power is Power.SWITCH_ON_DISABLED


def test_a_drive_that_loses_its_power_without_a_word_is_found_by_a_look(machine: Machine) -> None:
    """As by a safe torque off: no emergency, no silence."""
    machine.drive("lift").lose_power()
    with pytest.raises(DriveFault, match="lift: is SWITCH ON DISABLED, not OPERATION ENABLED"):
        machine.group.raise_if_faulty()
    machine.clock.sleep(0.1)
    assert machine.drive("slide").power is Power.SWITCH_ON_DISABLED


def test_an_axis_that_was_pushed_off_its_place_does_not_rest(machine: Machine) -> None:
    stood = machine.group.positions()
    machine.drive("slew").lie_about(0x6064, 2)  # 2 counts / 50 000 counts/rad = 40 µrad, inside the window of 50
    machine.group.require_at_rest(stood)
    machine.drive("slew").lie_about(0x6064, -50)
    with pytest.raises(FollowingError, match=r"slew: moved from 0\.5 to 0\.499 rad while it should stand"):
        machine.group.require_at_rest(stood)
    assert machine.drive("slide").power is not Power.OPERATION_ENABLED


def test_an_axis_may_give_way_by_more_where_that_is_said(machine: Machine) -> None:
    stood = machine.group.positions()
    machine.drive("slew").lie_about(0x6064, -50)  # 1 mrad, twenty windows
    machine.group.require_at_rest(stood, within=1.1e-3)
    with pytest.raises(FollowingError, match=r"slew: moved from 0\.5 to 0\.499 rad .* \(window 0\.0009 rad\)"):
        machine.group.require_at_rest(stood, within=0.9e-3)
    assert machine.drive("slide").power is not Power.OPERATION_ENABLED


def test_a_trip_stops_the_others_at_once_not_only_when_the_program_looks(machine: Machine) -> None:
    machine.drive("lift").trip(0x3220)
    deadline = time.monotonic() + 5.0  # the messages cross the bus in real time
    while machine.drive("slide").power is Power.OPERATION_ENABLED and time.monotonic() < deadline:
        time.sleep(0.001)
    assert machine.drive("slide").power is Power.QUICK_STOP_ACTIVE


def test_a_node_that_left_operational_is_stopped_by_sdo(machine: Machine) -> None:
    machine.drive("lift").node.nmt.state = "PRE-OPERATIONAL"
    with pytest.raises(HeartbeatLost, match=r"lift: no process data within 0\.5 s of SYNC, .* PRE-OPERATIONAL"):
        machine.group.move({"slide": 0.1})
    assert machine.drive("lift").power is Power.QUICK_STOP_ACTIVE
    assert machine.group.unstopped == []


def test_nodes_that_all_left_operational_in_mid_move_are_stopped_by_sdo_and_why_is_said(machine: Machine) -> None:
    """As at one word of another NMT master, or by CiA 301's default when the host's heartbeat lapses."""

    def fall_back() -> None:
        for name in machine.group.names:
            machine.drive(name).node.nmt.state = "PRE-OPERATIONAL"

    machine.after(2.0, fall_back)
    with pytest.raises(BusLost, match="every axis is PRE-OPERATIONAL: another program's word"):
        machine.group.move({"slide": 0.8, "lift": 0.8})
    machine.clock.sleep(1.0)
    before = [machine.drive(name).motor_position() for name in machine.group.names]
    machine.clock.sleep(10.0)
    assert [machine.drive(name).motor_position() for name in machine.group.names] == before
    assert before[0] < 0.7 * 100_000
    assert machine.group.unstopped == []


def test_who_was_not_seen_to_stop_is_told(machine: Machine) -> None:
    machine.after(2.0, machine.drive("lift").unplug)
    with pytest.raises(HeartbeatLost, match="lift: no process data"):
        machine.group.move({"slide": 0.8, "lift": 0.8})
    assert machine.group.unstopped == ["lift"]
    machine.group.close()
    assert machine.group.unstopped == ["lift"]


def test_a_stuck_axis_is_a_following_error_with_its_numbers(machine: Machine) -> None:
    machine.after(2.0, machine.drive("slide").stick)
    with pytest.raises(FollowingError, match=r"slide: following error at 0\.1\d* m, target 0\.8 m, 0\.\d+ m to go"):
        machine.group.move({"slide": 0.8, "lift": 0.8})
    assert machine.drive("lift").power is not Power.OPERATION_ENABLED


def test_reached_is_believed_only_with_the_position_inside_the_window(machine: Machine) -> None:
    machine.drive("slide").lie_about(0x6064, 19_000)  # 10 mm short, whatever the statusword says
    with pytest.raises(
        HardwareTimeout, match=r"slide: not at rest on its target .* 0\.01 m away, 'target reached' set, OPERATION"
    ):
        machine.group.move({"slide": 0.2})


def test_a_position_inside_the_window_counts_only_once_the_drive_says_reached(machine: Machine) -> None:
    machine.drive("slide").store(0x6068, 0, 60_000)  # the drive wants to see a minute of rest first
    with pytest.raises(HardwareTimeout, match=r"slide: not at rest .* 0 m away, 'target reached' not set"):
        machine.group.move({"slide": 0.2})


def test_a_set_point_that_is_not_acknowledged_is_no_move(machine: Machine) -> None:
    machine.drive("lift").lie_about(0x6041, 0x0637)  # enabled and "reached", but bit 12 never comes
    with pytest.raises(HardwareTimeout, match=r"lift: does not acknowledge its set-point \(bit 12\) within 0\.5 s"):
        machine.group.move({"lift": 0.2})


def test_a_node_that_falls_silent_at_rest_is_missed(machine: Machine) -> None:
    machine.clock.sleep(2.0)
    machine.group.raise_if_faulty()
    machine.drive("lift").go_silent()
    machine.clock.sleep(2.0)
    with pytest.raises(HeartbeatLost, match=r"lift: no heartbeat for [12]\.\d s \(node 2\)"):
        machine.group.raise_if_faulty()


def test_a_node_whose_heartbeat_alone_has_ended_is_missed_at_rest(machine: Machine) -> None:
    machine.clock.sleep(2.0)
    machine.group.positions()
    machine.drive("lift").end_heartbeat()
    machine.clock.sleep(2.0)
    with pytest.raises(HeartbeatLost, match=r"lift: no heartbeat for [12]\.\d s \(node 2\)"):
        machine.group.positions()  # it answers SYNC: no silence of the other kind
    with pytest.raises(HeartbeatLost, match=r"lift: no heartbeat for [12]\.\d s \(node 2\)"):
        machine.group.raise_if_faulty()
    assert machine.drive("slide").power is not Power.OPERATION_ENABLED


def test_a_node_whose_heartbeat_alone_ends_under_way_stops_the_others(machine: Machine) -> None:
    machine.after(2.0, machine.drive("lift").end_heartbeat)
    began = machine.clock.now()
    with pytest.raises(HeartbeatLost, match=r"lift: no heartbeat for [12]\.\d s \(node 2\)"):
        machine.group.move({"slide": 1.0})  # 11 s; a heartbeat counts as lost after 1.5 s
    assert machine.clock.now() - began < 5.0
    assert machine.drive("slide").power is not Power.OPERATION_ENABLED


def test_a_node_that_falls_silent_under_way_stops_the_others(machine: Machine) -> None:
    machine.after(2.0, machine.drive("slew").go_silent)
    with pytest.raises(HeartbeatLost, match=r"slew: no process data within 0\.5 s of SYNC"):
        machine.group.move({"slide": 1.0, "slew": 1.4})
    assert machine.drive("slide").power is not Power.OPERATION_ENABLED


def test_a_node_that_is_late_is_not_named_in_the_place_of_one_that_is_gone(machine: Machine) -> None:
    machine.drive("slide").late = 1
    machine.drive("slew").unplug()
    with pytest.raises(HeartbeatLost, match=r"slew: no process data within 0\.5 s of SYNC"):
        machine.group.move({"lift": 0.3})
    assert machine.drive("slide").power is not Power.OPERATION_ENABLED


def test_a_node_that_is_late_alone_is_no_less_a_reason_to_stop(machine: Machine) -> None:
    machine.drive("slide").late = 1
    with pytest.raises(HeartbeatLost, match=r"slide: no process data within 0\.5 s of SYNC"):
        machine.group.move({"lift": 0.3})
    machine.group.start()
    for name in ("slide", "lift"):
        machine.drive(name).late = 1
    with pytest.raises(HeartbeatLost, match=r"slide: no process data within 0\.5 s of SYNC"):
        machine.group.move({"lift": 0.3})
    assert machine.drive("lift").power is not Power.OPERATION_ENABLED


def test_nodes_that_are_all_late_together_are_the_buss_fault(machine: Machine) -> None:
    for drive in machine.drives:
        drive.late = 1
    late = (
        r"^CAN virtual .*: every drive's answer to a SYNC came more than 0\.5 s late: the adapter or this computer\?$"
    )
    with pytest.raises(HardwareTimeout, match=late):
        machine.group.move({"lift": 0.3})
    assert all(drive.power is not Power.OPERATION_ENABLED for drive in machine.drives)


def test_a_node_that_is_gone_while_all_others_are_late_is_named(machine: Machine) -> None:
    machine.drive("slide").late = machine.drive("lift").late = 1
    machine.drive("slew").unplug()
    with pytest.raises(HeartbeatLost, match=r"slew: no process data within 0\.5 s of SYNC"):
        machine.group.move({"lift": 0.3})


def test_a_single_node_that_is_late_is_named(build: Callable[..., Machine]) -> None:
    m = build(SLIDE)
    m.group.start()
    m.drive("slide").late = 1
    with pytest.raises(HeartbeatLost, match=r"slide: no process data within 0\.5 s of SYNC"):
        m.group.move({"slide": 0.3})


def test_a_silent_bus_is_told_from_a_silent_node(machine: Machine) -> None:
    for drive in machine.drives:
        machine.after(2.0, drive.go_silent)
    with pytest.raises(BusLost, match=r"CAN virtual .*: silent: nothing from slide, lift, slew"):
        machine.group.move({"slide": 1.0})


def test_a_bus_that_falls_silent_between_two_answers_is_no_node(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    syncs = itertools.count()
    send = CanBus.sync

    def sync(bus: CanBus) -> None:
        for drive in machine.drives if next(syncs) else [machine.drive("slew")]:
            drive.go_silent()
        send(bus)

    monkeypatch.setattr(CanBus, "sync", sync)
    with pytest.raises(BusLost, match=r"CAN virtual .*: silent: nothing from slide, lift, slew"):
        machine.group.move({"slide": 0.3})


def test_a_long_wait_between_moves_raises_no_false_alarm(machine: Machine) -> None:
    machine.clock.sleep(600.0)
    machine.group.raise_if_faulty()
    machine.group.move({"slide": 0.1})


def test_a_drive_that_restarts_by_itself_is_not_driven_on(machine: Machine) -> None:
    machine.drive("lift").unplug()
    machine.drive("lift").replug()
    with pytest.raises(DriveFault, match="lift: restarted by itself"):
        machine.group.move({"slide": 0.1})


def test_a_drive_that_is_back_keeps_its_position(machine: Machine) -> None:
    machine.group.move({"lift": 0.3})
    machine.drive("lift").unplug()
    machine.drive("lift").replug()
    machine.group.reset_faults()
    machine.group.start()
    assert machine.group.positions()["lift"] == pytest.approx(0.3, abs=1e-5)


@pytest.mark.parametrize("counts", [-524_288, 100_007])  # turns that an encoder lost; a window and two counts too far
def test_an_axis_that_reads_beyond_its_limits_is_not_started(build: Callable[..., Machine], counts: int) -> None:
    m = build(SLIDE, LIFT)
    m.drive("slide").lie_about(0x6064, counts)
    with pytest.raises(SoftLimit, match=r"slide: stands at (-5\.24288|1\.00007) m, outside its limits -1 … 1 m: "):
        m.group.start()
    assert [drive.power for drive in m.drives] == [Power.SWITCH_ON_DISABLED] * 2


def test_an_axis_on_its_limit_or_at_a_home_switch_beyond_it_is_started(build: Callable[..., Machine]) -> None:
    m = build(replace(SLIDE, homing=HomingConfig(method=17, offset=-1.005, fast=0.1)), LIFT, start=3_000)
    m.drive("lift").lie_about(0x6064, 200_005)  # -1.000025 m
    assert m.group.start() == ["slide"]
    assert m.group.start() == []  # it still stands there
    m.group.move({"slide": -0.9})


def test_an_interrupt_by_the_operator_stops_all_axes(machine: Machine) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    machine.after(2.0, interrupt)
    with pytest.raises(KeyboardInterrupt):
        machine.group.move({"slide": 1.0, "lift": 1.0})
    machine.clock.sleep(1.0)
    assert [drive.power for drive in machine.drives] == [Power.SWITCH_ON_DISABLED] * 3


def test_after_a_quick_stop_nothing_moves_until_the_group_is_started_again(machine: Machine) -> None:
    machine.group.quick_stop()
    with pytest.raises((DriveFault, Stopped), match="start"):
        machine.group.move({"slide": 0.1})
    machine.group.start()
    machine.group.move({"slide": 0.1})
    assert round(machine.drive("slide").motor_position()) == 10_000


def test_a_motor_without_power_coasts(machine: Machine) -> None:
    """The trap that waiting for the end of the ramp avoids; here to show that the simulated drive has it."""
    machine.after(3.0, machine.drive("slide").lose_power)
    with pytest.raises(DriveFault, match="slide: is SWITCH ON DISABLED"):
        machine.group.move({"slide": 1.0})
    machine.clock.sleep(5.0)
    # 0.25 m after 3 s, then 0.1 m/s braked at a tenth of 1 m/s²: 0.05 m
    assert machine.drive("slide").motor_position() / 1e5 == pytest.approx(0.30, abs=5e-3)


@pytest.mark.parametrize("afterwards", [2, 6])  # 0x605A: power off after the ramp, or stay in QUICK STOP ACTIVE
def test_closing_leaves_the_power_on_until_the_axes_have_braked(build: Callable[..., Machine], afterwards: int) -> None:
    m = build(replace(SLIDE, parameters={(0x605A, 0): afterwards, (0x6085, 0): 20_000}), LIFT)
    m.group.start()

    def interrupt() -> None:
        raise KeyboardInterrupt

    m.after(2.0, interrupt)
    with pytest.raises(KeyboardInterrupt):
        m.group.move({"slide": 1.0, "lift": 1.0})
    began, from_where = m.clock.now(), m.drive("slide").motor_position()
    m.group.close()
    assert m.drive("slide").power is Power.SWITCH_ON_DISABLED
    assert m.clock.now() - began < 1.0
    m.clock.sleep(60.0)
    # 0.1 m/s braked at 0.2 m/s² is 0.025 m; coasting would be ten times that
    assert (m.drive("slide").motor_position() - from_where) / 1e5 == pytest.approx(0.025, abs=3e-3)


def test_closing_does_not_wait_for_ever_for_a_drive_that_goes_on_braking(build: Callable[..., Machine]) -> None:
    m = build(replace(SLIDE, parameters={(0x6085, 0): 100}), LIFT)  # 0.001 m/s²: 100 s from 0.1 m/s
    m.group.start()
    m.after(2.0, m.group.quick_stop)
    with pytest.raises((DriveFault, Stopped)):
        m.group.move({"slide": 1.0})
    began = m.clock.now()
    m.group.close()
    assert 4.0 < m.clock.now() - began < 6.0
    assert m.drive("slide").power is Power.SWITCH_ON_DISABLED


def test_a_quick_stop_never_raises_not_even_on_a_dead_bus(machine: Machine) -> None:
    machine.rack.close()
    machine.group.quick_stop()


def test_a_speed_that_whole_drive_units_would_make_much_faster_is_refused(build: Callable[..., Machine]) -> None:
    coarse = replace(SLIDE, velocity=0.01, velocity_units=1.46e-4)  # 0.146 units, which was sent as 1
    with pytest.raises(SiteError, match=r"axes\.slide\.velocity: 0\.146 of the drive's units"):
        build(coarse).group.start()


def test_a_fault_is_reset_when_the_drive_s_reaction_to_it_has_ended(build: Callable[..., Machine]) -> None:
    """During the reaction the edge is lost."""
    m = build(reaction_s=0.5)
    m.group.start()
    m.drive("lift").trip(0x2310)
    assert m.drive("lift").power is Power.FAULT_REACTION_ACTIVE
    m.group.reset_faults()
    assert m.drive("lift").power is Power.SWITCH_ON_DISABLED


def test_a_fault_reaction_that_does_not_end_is_no_reset(build: Callable[..., Machine]) -> None:
    m = build(reaction_s=60.0)
    m.drive("lift").trip(0x2310)
    with pytest.raises(HardwareTimeout, match="lift: still FAULT REACTION ACTIVE 2 s after its fault"):
        m.group.reset_faults()


@pytest.mark.parametrize("missing", [(), (0x1014,)])  # 0x1014: drives without it send no emergency
def test_a_drive_that_still_reacts_to_its_fault_says_why(
    build: Callable[..., Machine], missing: tuple[int, ...]
) -> None:
    m = build(reaction_s=30.0, missing=missing)
    m.group.start()
    m.after(3.0, lambda: m.drive("lift").trip(0x2310))
    with pytest.raises(DriveFault, match="lift: drive fault 0x2310, continuous overcurrent on the motor side"):
        m.group.move({"slide": 1.0, "lift": 1.0})
    assert m.drive("lift").power is Power.FAULT_REACTION_ACTIVE
    assert m.drive("slide").power is not Power.OPERATION_ENABLED


def test_a_drive_that_keeps_its_error_code_until_the_reaction_has_ended_is_faulty_all_the_same(
    build: Callable[..., Machine],
) -> None:
    m = build(reaction_s=30.0, missing=(0x1014,))
    m.group.start()
    m.drive("lift").lie_about(0x603F, 0)
    m.drive("lift").trip(0x2310)
    with pytest.raises(DriveFault, match="lift: drive fault without a code, error register 0x1"):
        m.group.raise_if_faulty()


def test_a_faulty_drive_that_does_not_say_what_it_has_is_faulty_all_the_same(build: Callable[..., Machine]) -> None:
    m = build(reaction_s=30.0, missing=(0x1014,))
    m.group.start()
    m.drive("lift").lie_about(0x603F, 0)
    read = m.group._axes["lift"].sdo.read_if_present

    def ask(entry: Any) -> int | None:
        if entry.index == 0x1001:
            raise HardwareTimeout("lift", "no SDO answer")
        return read(entry)

    m.group._axes["lift"].sdo.read_if_present = ask  # type: ignore[method-assign]
    m.drive("lift").trip(0x2310)
    with pytest.raises(DriveFault, match="lift: drive fault, its code cannot be read: no SDO answer"):
        m.group.raise_if_faulty()


def test_a_fault_reset_enables_nothing(machine: Machine) -> None:
    machine.drive("slew").trip(0x4310)
    machine.group.reset_faults()
    assert machine.drive("slew").power is Power.SWITCH_ON_DISABLED
    machine.group.start()
    machine.group.move({"slew": 0.2})
    assert machine.drive("slew").power is Power.OPERATION_ENABLED


def test_a_machine_that_another_program_moves_is_left_alone(machine: Machine) -> None:
    other = Cia402Group(machine.axes, machine.group._bus.config, machine.clock)

    def start_beside() -> None:
        began, here = machine.clock.now(), machine.drive("slide").motor_position()
        with pytest.raises(HardwareError, match=r"slide: moves \(0\.25\d* to 0\.26\d* m within 0\.1 s\) .* another"):
            other.start()
        other.quick_stop()
        other.close()
        assert machine.clock.now() - began < 1.0
        assert machine.drive("slide").motor_position() > here

    machine.after(3.1, start_beside)
    report = machine.group.move({"slide": 0.8})
    assert report.positions["slide"] == pytest.approx(0.8, abs=1e-5)
    other.start()  # what stands enabled may be what an earlier run has left
    other.close()
    assert machine.drive("slide").power is Power.SWITCH_ON_DISABLED


def test_start_does_not_reset_a_fault_behind_the_operators_back(build: Callable[..., Machine]) -> None:
    m = build()
    m.drive("lift").trip(0x7305)
    with pytest.raises(DriveFault, match="lift: drive fault 0x7305, incremental encoder 1 fault"):
        m.group.start()
    assert m.drive("lift").power is Power.FAULT


# identity and configuration


def test_check_says_who_is_there_and_enables_nothing(build: Callable[..., Machine]) -> None:
    m = build(replace(SLEW, product=0x77), identity=Identity(vendor=0x1A, serial=4711), start=25_000)
    (info,) = m.group.check()
    assert (info.device, info.serial, info.firmware) == ("slew", "4711", "ppshw-sim 1.0")
    assert "vendor 0x1A" in info.model
    assert info.status == (  # 0.5 rad + 25 000 counts / 50 000 counts per rad
        "SWITCH ON DISABLED, at 1.000000 rad, heartbeat off, WRONG DEVICE: product code is 0x50505301, expected 0x77"
    )
    assert m.drive("slew").power is Power.SWITCH_ON_DISABLED


def test_check_tells_a_running_heartbeat(machine: Machine) -> None:
    assert [info.status.split(", ")[2] for info in machine.group.check()] == ["heartbeat ok"] * 3


def test_a_drive_that_is_not_there_is_named(build: Callable[..., Machine]) -> None:
    m = build()
    m.drive("lift").go_silent()
    with pytest.raises(HardwareTimeout, match=r"lift: no SDO answer on vendor 0x1018:01 within 0\.4 s"):
        m.group.check()


def test_a_look_at_the_axes_has_a_row_for_each_whatever_is_wrong_with_it(build: Callable[..., Machine]) -> None:
    m = build(SLIDE, LIFT, replace(SLEW, product=0x77))
    m.drive("slide").go_silent()
    slide, lift, slew = m.group.look()
    assert (slide.device, slide.model, lift.device, slew.device) == ("slide", "", "lift", "slew")
    assert slide.problem == "no SDO answer on vendor 0x1018:01 within 0.4 s"
    assert lift.problem == ""
    assert slew.problem == "WRONG DEVICE: product code is 0x50505301, expected 0x77"
    assert m.drive("slew").power is Power.SWITCH_ON_DISABLED


def test_a_bus_that_cannot_be_opened_is_one_problem_and_names_the_axes_on_it() -> None:
    bus = BusConfig(can={"interface": "slcan", "channel": "socket://127.0.0.1:9", "sleep_after_open": 0})
    (row,) = Cia402Group((SLIDE, LIFT), bus, SteppedClock()).look()
    assert row.device == "CAN slcan socket://127.0.0.1:9"
    assert row.problem.startswith("cannot be opened: ")
    assert row.problem.endswith("; not reached: slide, lift")


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"vendor": 0x99}, "slide: vendor is 0x0, expected 0x99"),
        ({"product": 0x99}, "slide: product code is 0x50505301, expected 0x99"),
        ({"firmware": "2.0"}, "slide: firmware is 'ppshw-sim 1.0', expected '2.0'"),
    ],
)
def test_another_drive_than_the_site_file_says_is_not_started(
    build: Callable[..., Machine], wanted: dict[str, Any], message: str
) -> None:
    m = build(replace(SLIDE, **wanted))
    with pytest.raises(IdentityMismatch, match=message):
        m.group.start()
    assert m.drive("slide").power is Power.SWITCH_ON_DISABLED


def test_a_parameter_that_reads_back_otherwise_stops_the_start(build: Callable[..., Machine]) -> None:
    m = build()
    m.drive("slide").lie_about(0x6081, 9_999)  # 0.1 m/s · 100 000 counts/m = 10 000
    with pytest.raises(ConfigurationMismatch, match="slide: profile velocity 0x6081:00: wrote 10000, read back 9999"):
        m.group.start()


def test_the_sites_own_parameters_are_written_and_read_back(build: Callable[..., Machine]) -> None:
    m = build(replace(SLIDE, parameters={(0x6085, 0): 77_000, (0x605A, 0): 6}))
    m.group.start()
    assert (m.drive("slide").value(0x6085), m.drive("slide").value(0x605A)) == (77_000, 6)


def test_scale_and_limits_reach_the_drive_in_counts(machine: Machine) -> None:
    slew = machine.drive("slew")
    # 0.1 rad/s · 50 000; (±1.5 − 0.5) rad · 50 000
    assert (slew.value(0x6081), slew.value(0x6083), slew.value(0x6084)) == (5_000, 5_000, 5_000)
    assert (slew.value(0x607D, 1), slew.value(0x607D, 2)) == (-100_000, 50_000)


def test_the_target_is_mapped_before_the_controlword(machine: Machine) -> None:
    slide = machine.drive("slide")
    assert [slide.value(0x1600, k) for k in range(4)] == [3, 0x607A0020, 0x60600008, 0x60400010]


def test_a_drive_whose_controlword_is_mapped_first_goes_to_the_old_target(machine: Machine) -> None:
    """The trap that the mapping order avoids; here to show that the simulated drive has it."""
    sdo = machine.group.axis("slide").sdo
    sdo.write(Entry(0x1400, 1, "I", "COB-ID"), 0x80000201)
    for k, mapped in enumerate((0x60400010, 0x607A0020, 0x60600008), start=1):
        sdo.write(Entry(0x1600, k, "I", "mapping"), mapped)
    sdo.write(Entry(0x1400, 1, "I", "COB-ID"), 0x201)
    with can.Bus(interface="virtual", channel=machine.rack.channel, ignore_config=True) as bus:
        new_set_point = struct.pack("<Hib", 0x3F, 10_000, 1)
        bus.send(can.Message(arbitration_id=0x201, data=new_set_point, is_extended_id=False))
        bus.send(can.Message(arbitration_id=0x080, is_extended_id=False))
        heard = bus.recv(2.0)
        while heard is not None and heard.arbitration_id != 0x181:  # its answer to the SYNC
            heard = bus.recv(2.0)
    assert sdo.read(Entry(0x607A, 0, "i", "target")) == 10_000
    machine.clock.sleep(10.0)
    assert machine.drive("slide").motor_position() == 0.0
    assert machine.drive("slide").value(0x6041) & 0x0400  # "reached"


def watched(m: Machine, period: float = 0.05) -> Cia402Group:
    """The group of a site with `host_node_id`; drives wait for five periods."""
    bus = BusConfig(
        can={"interface": "virtual", "channel": m.rack.channel}, host_node_id=0x7E, host_heartbeat_period=period
    )
    return Cia402Group(m.axes, bus, m.clock)


def test_the_drives_are_told_to_watch_the_hosts_heartbeat(build: Callable[..., Machine]) -> None:
    m = build(SLIDE)
    m.group = watched(m)
    m.group.start()
    assert m.drive("slide").value(0x1016, 1) == 0x7E << 16 | 250  # node and time-out in ms, five periods
    with can.Bus(interface="virtual", channel=m.rack.channel, ignore_config=True) as listener:
        deadline = time.monotonic() + 5.0
        while (heard := listener.recv(1.0)) is None or heard.arbitration_id != 0x77E:
            assert time.monotonic() < deadline, "the host's heartbeat is missing"
    assert bytes(heard.data) == b"\x05"  # OPERATIONAL


def failing_heartbeats(m: Machine, monkeypatch: pytest.MonkeyPatch, times: float) -> Iterator[int]:
    """So many heartbeats in a row cannot be sent. Gives how many were tried, in all."""
    adapter = m.group._bus.network.bus
    assert adapter is not None
    send, tried = adapter.send, itertools.count(1)
    last = 0

    def refuse(message: can.Message, timeout: float | None = None) -> None:
        nonlocal last
        if message.arbitration_id == 0x77E:
            last = next(tried)
            if last <= times:
                raise can.CanOperationError("transmit buffer full")
        send(message, timeout)

    monkeypatch.setattr(adapter, "send", refuse)
    deadline = time.monotonic() + 5.0
    while time.monotonic() < deadline:
        yield last
        time.sleep(0.005)


def test_one_heartbeat_that_could_not_be_sent_does_not_end_them(
    build: Callable[..., Machine], monkeypatch: pytest.MonkeyPatch
) -> None:
    m = build(SLIDE)
    m.group = watched(m)
    m.group.start()
    assert any(tried > 5 for tried in failing_heartbeats(m, monkeypatch, times=1))
    m.group.raise_if_faulty()


def test_a_host_that_cannot_send_its_heartbeat_has_lost_the_bus(
    build: Callable[..., Machine], monkeypatch: pytest.MonkeyPatch
) -> None:
    on_the_terminal: list[threading.ExceptHookArgs] = []
    monkeypatch.setattr(threading, "excepthook", on_the_terminal.append)
    m = build(SLIDE)
    m.group = watched(m)
    m.group.start()

    def look_again_and_again() -> None:
        for _ in failing_heartbeats(m, monkeypatch, times=float("inf")):
            m.group.raise_if_faulty()

    with pytest.raises(BusLost, match="this program's heartbeat: cannot send: transmit buffer full"):
        look_again_and_again()
    m.clock.sleep(1.0)
    assert m.drive("slide").power is not Power.OPERATION_ENABLED
    m.group.close()
    assert on_the_terminal == []


def test_drives_stop_when_the_program_dies_and_not_when_it_ends(build: Callable[..., Machine]) -> None:
    m = build(SLIDE, LIFT)
    m.group = watched(m, period=0.2)
    m.group.start()
    for drive in m.drives:
        drive.miss_heartbeats()
    time.sleep(1.2)  # longer than they wait
    assert [drive.power for drive in m.drives] == [Power.OPERATION_ENABLED] * 2
    heartbeat = m.group._bus._heartbeat
    assert heartbeat is not None
    heartbeat.end()  # as if it were killed
    deadline = time.monotonic() + 5.0
    while any(drive.power is Power.OPERATION_ENABLED for drive in m.drives):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    with pytest.raises(DriveFault, match="0x8130"):
        m.group.raise_if_faulty()
    m.group.close()

    m.group.reset_faults()
    m.group.start()
    m.group.close()
    time.sleep(1.2)
    assert [drive.power for drive in m.drives] == [Power.SWITCH_ON_DISABLED] * 2


def test_who_only_looks_sends_no_heartbeat_that_drives_of_an_earlier_program_would_miss_afterwards(
    build: Callable[..., Machine],
) -> None:
    m = build(SLIDE)
    m.group = watched(m)
    with can.Bus(interface="virtual", channel=m.rack.channel, ignore_config=True) as listener:
        m.group.check()
        heard = list(iter(lambda: listener.recv(0.2), None))
    assert heard
    assert all(message.arbitration_id != 0x77E for message in heard)


@pytest.mark.parametrize(("index", "of_whom"), [(0x605A, "quick stop option"), (0x6007, "abort connection option")])
def test_a_drive_that_would_not_stop_is_not_started(
    build: Callable[..., Machine], monkeypatch: pytest.MonkeyPatch, index: int, of_whom: str
) -> None:
    m = build(SLIDE)
    m.group = watched(m)
    read = SdoPort.read_if_present
    monkeypatch.setattr(SdoPort, "read_if_present", lambda s, entry: 0 if entry.index == index else read(s, entry))
    with pytest.raises(ConfigurationMismatch, match=rf"slide: {of_whom} 0x{index:04X}:00 is 0: .* axes\.slide\.par"):
        m.group.start()
    assert m.drive("slide").power is not Power.OPERATION_ENABLED


@pytest.mark.parametrize(
    ("abort", "fault", "refused"),
    [(1, 0, "fault reaction option 0x605E:00 is 0"), (2, 2, "abort connection option 0x6007:00 is 2"), (3, 0, "")],
)
def test_a_drive_that_would_only_cut_its_power_when_the_program_dies_is_not_started(
    build: Callable[..., Machine], monkeypatch: pytest.MonkeyPatch, abort: int, fault: int, refused: str
) -> None:
    """An abort does what a fault does (1), cuts the power (2) or is a quick stop (3)."""
    m = build(SLIDE)
    m.group = watched(m)
    read, says = SdoPort.read_if_present, {0x6007: abort, 0x605E: fault}
    monkeypatch.setattr(
        SdoPort, "read_if_present", lambda s, entry: says[entry.index] if entry.index in says else read(s, entry)
    )
    expected = pytest.raises(ConfigurationMismatch, match=f"slide: {refused}: when this program dies it would only cut")
    with expected if refused else nullcontext():
        m.group.start()
    assert (m.drive("slide").power is Power.OPERATION_ENABLED) == (not refused)


def test_no_axis_is_enabled_after_another_one_stopped_them_all(
    build: Callable[..., Machine], monkeypatch: pytest.MonkeyPatch
) -> None:
    m = build(SLIDE, LIFT, SLEW)
    enable, asked = Cia402Axis.enable, list[str]()

    def trip_meanwhile(axis: Cia402Axis) -> None:
        asked.append(axis.name)
        if axis.name == "lift":
            m.drive("slide").trip(0x3220)
            with m.group._bus.arrival:
                m.group._bus.arrival.wait_for(lambda: m.group._bus.stopped, 5.0)
        enable(axis)

    monkeypatch.setattr(Cia402Axis, "enable", trip_meanwhile)
    with pytest.raises(DriveFault, match="slide: drive fault 0x3220"):
        m.group.start()
    assert asked == ["slide", "lift"]
    assert m.drive("lift").power is Power.SWITCH_ON_DISABLED


def test_who_answers_another_programs_question_is_not_called_silent(
    build: Callable[..., Machine], monkeypatch: pytest.MonkeyPatch
) -> None:
    m = build(SLIDE)
    axis = m.group.axis("slide")

    def of_another(index: int, subindex: int) -> bytes:
        raise canopen.SdoCommunicationError("Node returned a value for 0x1400:01 instead")

    monkeypatch.setattr(axis.sdo._sdo, "upload", of_another)
    with pytest.raises(ProtocolError, match=r"slide: the SDO answer on statusword .* does another program speak to"):
        axis.state()


def test_the_watch_over_the_hosts_heartbeat_ends_with_the_program(build: Callable[..., Machine]) -> None:
    m = build(SLIDE, LIFT)
    m.group = watched(m)
    m.group.start()
    m.drive("slide").go_silent()
    m.group.close()
    assert m.drive("slide").value(0x1016, 1) != 0  # it could not be told
    assert m.drive("lift").value(0x1016, 1) == 0
    assert m.drive("lift").power is Power.SWITCH_ON_DISABLED


def test_the_watch_ends_also_where_a_drive_refuses_to_be_disabled(
    build: Callable[..., Machine], monkeypatch: pytest.MonkeyPatch
) -> None:
    m = build(SLIDE, LIFT)
    m.group = watched(m)
    m.group.start()

    def refuse(axis: Cia402Axis) -> None:
        raise HardwareTimeout(axis.name, "no SDO answer")

    monkeypatch.setattr(Cia402Axis, "disable", refuse)
    m.group.close()
    assert [drive.value(0x1016, 1) for drive in m.drives] == [0, 0]


def test_a_start_that_fails_half_way_leaves_no_watch_behind(build: Callable[..., Machine]) -> None:
    m = build(SLIDE, LIFT)
    m.group = watched(m)
    m.drive("lift").lie_about(0x6081, 1)
    with pytest.raises(ConfigurationMismatch, match="lift: profile velocity"):
        m.group.start()
    assert m.drive("slide").value(0x1016, 1) != 0
    m.group.close()
    assert m.drive("slide").value(0x1016, 1) == 0


def test_a_watch_that_another_program_left_in_a_drive_is_taken_back(build: Callable[..., Machine]) -> None:
    m = build(SLIDE, replace(LIFT, parameters={(0x1016, 1): 0x50 << 16 | 900}))
    for drive in m.drives:
        drive.store(0x1016, 1, 0x7E << 16 | 250)
    m.group.start()
    assert m.drive("slide").value(0x1016, 1) == 0
    assert m.drive("lift").value(0x1016, 1) == 0x50 << 16 | 900  # its site asks for it


def test_a_drive_may_lack_every_object_that_some_real_drive_lacks(build: Callable[..., Machine]) -> None:
    m = build(missing=(0x100A, 0x6084, 0x603F, 0x1016, 0x607D, 0x60FD))
    assert m.group.check()[0].firmware == "revision 0x10000"
    m.group.start()
    assert m.group.move({"slide": 0.1}).positions["slide"] == pytest.approx(0.1, abs=1e-5)
    m.drive("slide").trip(0x4310)
    with pytest.raises(DriveFault, match="slide: drive fault 0x4310, motor temperature too high"):
        m.group.axis("slide").enable()


@pytest.mark.parametrize(
    ("wanted", "missing", "message"),
    [
        ({}, 0x6065, r"has no following error window 0x6065:00, but the site file gives axes\.slide\.following_window"),
        ({"following_s": 0.2}, 0x6066, r"0x6066:00, but the site file gives axes\.slide\.following_s"),
        ({"deceleration": 0.05}, 0x6084, r"0x6084:00, but the site file gives axes\.slide\.deceleration"),
    ],
)
def test_what_the_site_asks_for_and_the_drive_does_not_have_is_not_dropped(
    build: Callable[..., Machine], wanted: dict[str, Any], missing: int, message: str
) -> None:
    m = build(replace(SLIDE, **wanted), missing=(missing,))
    with pytest.raises(ConfigurationMismatch, match=rf"^slide: .*{message}"):
        m.group.start()
    assert m.drive("slide").power is not Power.OPERATION_ENABLED


def test_a_drive_that_cannot_watch_the_host_is_refused_where_it_shall(build: Callable[..., Machine]) -> None:
    m = build(SLIDE, missing=(0x1016,))
    m.group = watched(m)
    with pytest.raises(ConfigurationMismatch, match=r"slide: has no .* 0x1016:01, but .* can\.host_node_id"):
        m.group.start()


def test_what_is_only_derived_may_be_missing(build: Callable[..., Machine]) -> None:
    m = build(replace(SLIDE, homing=HomingConfig(35)), missing=(0x6066, 0x6067, 0x6068, 0x607C, 0x607D, 0x6084))
    m.group.start()
    assert m.group.move({"slide": 0.1}).positions["slide"] == pytest.approx(0.1, abs=1e-5)


def test_a_refused_mode_is_said(build: Callable[..., Machine]) -> None:
    m = build(SLIDE, modes=(6,))
    with pytest.raises(HardwareTimeout, match=r"slide: refuses mode 1 \(profile position\), shows 0"):
        m.group.start()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"counts_per_unit": 0.0}, "counts_per_unit must be positive"),
        ({"direction": 2}, "direction must be -1 or 1"),
        ({"lower": 2.0}, "leave no travel"),
        ({"counts_per_unit": 1e10}, "outside the drive's 32-bit counts"),
        ({"approach_from": -1}, "needs a positive approach_distance"),
        ({"node_id": 128}, "node id 128"),
    ],
)
def test_an_axis_that_cannot_be_is_refused_before_anything_is_connected(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(SiteError, match=message):
        replace(SLIDE, **wrong)


# homing


HOMED = replace(SLIDE, homing=HomingConfig(method=17, offset=-0.5, fast=0.2, slow=0.01))


def test_a_drives_own_homing_speed_is_not_used_where_the_axis_may_not_move_so_fast(
    build: Callable[..., Machine],
) -> None:
    m = build(replace(HOMED, homing=HomingConfig(method=17, offset=-0.5)), absolute=False, home_at=20_000)
    m.drive("slide").store(0x6099, 1, 50_000)  # 0.5 m/s, where 0.1 are allowed
    with pytest.raises(SiteError, match=r"axes\.slide\.homing\.fast is missing, and .* 0\.5 m/s, .* move at 0\.1"):
        m.group.start()


def test_homing_brakes_and_accelerates_as_every_move_does(build: Callable[..., Machine]) -> None:
    m = build(HOMED, absolute=False, home_at=20_000)
    m.drive("slide").store(0x609A, 0, 900_000)
    m.group.start()
    assert m.drive("slide").value(0x609A) == 10_000


def test_an_incremental_axis_homes_at_start_and_knows_where_it_is(build: Callable[..., Machine]) -> None:
    m = build(HOMED, absolute=False, start=70_000, home_at=20_000)
    assert not m.group.axis("slide").homed
    assert m.group.start() == ["slide"]
    assert m.group.axis("slide").homed
    assert round(m.drive("slide").motor_position()) == 20_000
    assert m.group.positions()["slide"] == pytest.approx(-0.5)
    m.group.move({"slide": 0.0})
    assert round(m.drive("slide").motor_position()) == 70_000  # home + 0.5 m


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("left_over", [0, 30_000])
def test_the_position_at_home_is_the_same_whichever_way_a_drive_takes_its_home_offset(
    build: Callable[..., Machine], sense: int, left_over: int
) -> None:
    """By the words of CiA 402 the zero lies 0x607C from home; with some makers home lies 0x607C from the zero."""
    m = build(HOMED, absolute=False, start=70_000, home_at=20_000, home_offset_sense=sense)
    m.drive("slide").store(0x607C, 0, left_over)  # by whoever set it up
    m.group.start()
    assert m.group.positions()["slide"] == pytest.approx(-0.5)
    m.group.move({"slide": -0.4})
    assert round(m.drive("slide").motor_position()) == 30_000


def test_a_drive_without_a_home_offset_can_be_homed(build: Callable[..., Machine]) -> None:
    m = build(HOMED, absolute=False, home_at=20_000, missing=(0x607C,))
    m.group.start()
    assert m.group.positions()["slide"] == pytest.approx(-0.5)


def test_a_drive_that_does_not_count_from_its_home_position_is_not_homed(build: Callable[..., Machine]) -> None:
    m = build(HOMED, absolute=False, home_at=20_000)
    m.drive("slide").lie_about(0x6064, 100_000)  # as with a maker's own home position of 1 m
    with pytest.raises(DriveFault, match=r"slide: homing ended at 0\.5 m, expected -0\.5 m \(homing\.offset\): "):
        m.group.start()
    assert not m.group.axis("slide").homed
    assert m.drive("slide").power is not Power.OPERATION_ENABLED


def test_a_drive_may_stop_a_little_beyond_its_home_position(build: Callable[..., Machine]) -> None:
    m = build(HOMED, absolute=False, home_at=20_000)
    m.drive("slide").lie_about(0x6064, 300)  # 3 mm; at the slow 0.01 m/s of the last piece it may be 5
    assert m.group.start() == ["slide"]
    assert m.group.positions()["slide"] == pytest.approx(-0.497)


def test_a_second_homing_homes_again(build: Callable[..., Machine]) -> None:
    m = build(HOMED, home_at=20_000)
    m.group.start()
    assert m.group.start() == []
    m.group.move({"slide": 0.3})
    m.group.home("slide")
    assert round(m.drive("slide").motor_position()) == 20_000
    assert m.group.positions()["slide"] == pytest.approx(-0.5)


def test_an_incremental_axis_that_lost_its_power_is_homed_again(build: Callable[..., Machine]) -> None:
    m = build(HOMED, absolute=False, start=70_000, home_at=20_000)
    m.group.start()
    m.group.move({"slide": 0.25})
    m.drive("slide").unplug()
    m.drive("slide").replug()
    with pytest.raises(DriveFault, match="restarted by itself"):
        m.group.move({"slide": 0.3})
    m.group.reset_faults()
    m.group.start()
    assert round(m.drive("slide").motor_position()) == 20_000
    assert m.group.positions()["slide"] == pytest.approx(-0.5)


def test_homing_that_does_not_begin_is_no_homing(build: Callable[..., Machine]) -> None:
    m = build(HOMED, home_at=20_000)
    m.group.start()
    m.drive("slide").lie_about(0x6041, 0x1637)  # "attained", from the homing before
    with pytest.raises(HardwareTimeout, match=r"slide: homing has not begun after 1\.0 s, OPERATION ENABLED"):
        m.group.home("slide")
    assert not m.group.axis("slide").homed


FAR_HOME = 100_000  # counts; at 0.2 m/s and 0.1 m/s² the way there takes 7 s


def test_an_axis_that_trips_while_another_one_homes_is_named(build: Callable[..., Machine]) -> None:
    m = build(HOMED, LIFT, home_at=FAR_HOME)
    m.after(2.0, lambda: m.drive("lift").trip(0x2310))
    with pytest.raises(DriveFault, match="lift: drive fault 0x2310, continuous overcurrent on the motor side"):
        m.group.start()
    assert m.drive("slide").motor_position() < FAR_HOME / 2
    assert m.drive("slide").power is not Power.OPERATION_ENABLED


def test_an_axis_that_loses_its_power_while_another_one_homes_stops_the_homing(build: Callable[..., Machine]) -> None:
    m = build(HOMED, LIFT, home_at=FAR_HOME)
    m.after(2.0, m.drive("lift").lose_power)
    with pytest.raises(DriveFault, match="lift: is SWITCH ON DISABLED, not OPERATION ENABLED"):
        m.group.start()
    assert m.drive("slide").motor_position() < FAR_HOME / 2
    assert m.drive("slide").power is not Power.OPERATION_ENABLED


def test_an_axis_that_loses_its_power_while_it_homes_is_said_to_have_left_homing(build: Callable[..., Machine]) -> None:
    m = build(HOMED, LIFT, home_at=FAR_HOME)
    m.after(2.0, m.drive("slide").lose_power)
    with pytest.raises(DriveFault, match="slide: left homing: SWITCH ON DISABLED"):
        m.group.start()


def test_an_axis_that_falls_silent_while_another_one_homes_stops_the_homing(build: Callable[..., Machine]) -> None:
    m = build(HOMED, LIFT, home_at=FAR_HOME)
    m.after(1.0, m.drive("lift").unplug)
    with pytest.raises(HeartbeatLost, match=r"lift: no process data within 0\.5 s of SYNC"):
        m.group.start()
    assert m.drive("slide").motor_position() < FAR_HOME / 2
    assert m.drive("slide").power is not Power.OPERATION_ENABLED


def trip_lift_and_wait(m: Machine) -> None:
    """Until the emergency has stopped the slide."""
    m.drive("lift").trip(0x2310)
    deadline = time.monotonic() + 5.0
    while m.drive("slide").power is Power.OPERATION_ENABLED and time.monotonic() < deadline:
        time.sleep(0.001)


def test_an_axis_that_trips_just_before_a_homing_command_is_named(
    build: Callable[..., Machine], monkeypatch: pytest.MonkeyPatch
) -> None:
    m = build(HOMED, LIFT)
    m.group.start()
    monkeypatch.setattr(m.group, "raise_if_faulty", lambda: trip_lift_and_wait(m))
    with pytest.raises(DriveFault, match="lift: drive fault 0x2310"):
        m.group.home("slide")


def test_an_axis_that_trips_just_before_a_move_is_commanded_is_named(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine.group, "_exchange", lambda: trip_lift_and_wait(machine))
    with pytest.raises(DriveFault, match="lift: drive fault 0x2310"):
        machine.group.move({"slide": 0.3})


# words


def test_before_the_first_process_data_the_state_comes_by_sdo(build: Callable[..., Machine]) -> None:
    m = build()
    m.group.check()
    assert m.group.axis("slide").snapshot is None
    assert m.group.axis("slide").state() is State.SWITCH_ON_DISABLED


@pytest.mark.parametrize(
    ("statusword", "state"),
    [  # as drives report them, with voltage, remote and target bits set
        (0x0000, State.NOT_READY_TO_SWITCH_ON),
        (0x0250, State.SWITCH_ON_DISABLED),
        (0x0231, State.READY_TO_SWITCH_ON),
        (0x0233, State.SWITCHED_ON),
        (0x1637, State.OPERATION_ENABLED),
        (0x0217, State.QUICK_STOP_ACTIVE),
        (0x021F, State.FAULT_REACTION_ACTIVE),
        (0x0218, State.FAULT),
        (0x0238, State.FAULT),
    ],
)
def test_statuswords_are_read_as_the_standard_says(statusword: int, state: State) -> None:
    assert decode_state(statusword) is state


def test_a_makers_own_sub_code_still_says_its_group() -> None:
    assert meaning(0x8611) == "following error"
    assert meaning(0x2341) == "short circuit on the motor side"
    assert meaning(0x4FFF) == "temperature"
    assert meaning(0xFF12) == "maker's own code"
    assert meaning(0x0042) == "unknown code"
