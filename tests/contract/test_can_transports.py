"""One contract for every way onto the bus: inside the process, and through an slcan adapter on a TCP port."""

from __future__ import annotations

import contextlib
import itertools
import os
import pty
import socket
import subprocess
import sys
import time
import tty
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import can
import canopen
import pytest

from drivers.axis_config import AxisConfig
from drivers.axis_group import Cia402Group
from drivers.bus_lock import BusLock, lock_file
from drivers.canopen_bus import BusConfig, CanBus
from drivers.cia402 import Cia402Axis
from ppshw.errors import BusLost, DriveFault, HardwareError, HeartbeatLost
from ppshw.file_lock import locked
from simulators.can_gateway import SlcanGateway, decode, encode
from simulators.clock import SteppedClock
from simulators.drive import Power, SimulatedDriveRack

AXES = [
    AxisConfig(f"axis {n}", n, 100_000, -1.0, 1.0, velocity=0.1, acceleration=0.1, following_window=0.005)
    for n in (1, 2, 3)
]
channels = (f"transport-{n}" for n in itertools.count())
ports = itertools.count(10 * os.getpid())  # of nobody: names of buses that are never opened


@dataclass
class Machine:
    clock: SteppedClock
    rack: SimulatedDriveRack
    gateway: SlcanGateway | None
    group: Cia402Group


def _machine(transport: str) -> Machine:
    clock = SteppedClock()
    rack = SimulatedDriveRack(clock, next(channels), node_ids=(1, 2, 3))
    gateway = None
    arguments: dict[str, Any] = {"interface": "virtual", "channel": rack.channel}
    if transport == "slcan":
        gateway = SlcanGateway(rack.channel)
        arguments = {"interface": "slcan", "channel": gateway.url, "bitrate": 500_000, "sleep_after_open": 0}
    return Machine(clock, rack, gateway, Cia402Group(AXES, BusConfig(can=arguments), clock))


def _close(machine: Machine) -> None:
    machine.group.close()
    if machine.gateway is not None:
        machine.gateway.close()
    machine.rack.close()


@pytest.fixture(params=["virtual", "slcan"])
def machine(request: pytest.FixtureRequest) -> Iterator[Machine]:
    m = _machine(request.param)
    yield m
    _close(m)


@pytest.fixture
def over_slcan() -> Iterator[Machine]:
    m = _machine("slcan")
    yield m
    _close(m)


def test_a_move_ends_on_its_setpoints(machine: Machine) -> None:
    machine.group.start()
    report = machine.group.move({"axis 1": 0.3, "axis 2": -0.2, "axis 3": 0.05})
    assert [round(p) for p in machine.rack.motor_positions().values()] == [30_000, -20_000, 5_000]
    assert report.positions == pytest.approx({"axis 1": 0.3, "axis 2": -0.2, "axis 3": 0.05}, abs=1e-5)
    assert len({tuple(drive.starts) for drive in machine.rack.drives.values()}) == 1


def test_a_bus_that_cannot_be_left_in_order_is_closed_all_the_same(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine.group.start()
    disconnect = canopen.Network.disconnect

    def fails(network: canopen.Network) -> None:
        disconnect(network)
        raise AttributeError("an adapter's own mistake")

    with monkeypatch.context() as patch:
        patch.setattr(canopen.Network, "disconnect", fails)
        machine.group.close()
    assert machine.rack.drives[1].power is Power.SWITCH_ON_DISABLED


def test_check_finds_every_drive(machine: Machine) -> None:
    assert [(i.device, i.serial) for i in machine.group.check()] == [
        ("axis 1", "1001"),
        ("axis 2", "1002"),
        ("axis 3", "1003"),
    ]


def test_a_drive_that_trips_stops_the_others(machine: Machine) -> None:
    machine.group.start()
    machine.clock.at(machine.clock.now() + 3.0, lambda: machine.rack.drives[2].trip(0x3210))
    with pytest.raises(DriveFault, match="axis 2: drive fault 0x3210, DC link overvoltage"):
        machine.group.move({"axis 1": 1.0, "axis 2": 1.0})
    machine.clock.sleep(2.0)
    assert machine.rack.drives[1].power is Power.SWITCH_ON_DISABLED
    assert machine.rack.drives[2].power is Power.FAULT


def test_a_node_that_falls_silent_is_named(machine: Machine) -> None:
    machine.group.start()
    machine.rack.drives[3].go_silent()
    machine.clock.sleep(2.0)
    with pytest.raises(HeartbeatLost, match="axis 3: no heartbeat for"):
        machine.group.raise_if_faulty()


def test_an_adapter_that_is_pulled_is_a_lost_bus(over_slcan: Machine) -> None:
    over_slcan.group.start()
    assert over_slcan.gateway is not None
    over_slcan.clock.at(over_slcan.clock.now() + 2.0, over_slcan.gateway.close)
    over_slcan.clock.at(over_slcan.clock.now() + 2.0, lambda: _expect_nothing(over_slcan))
    with pytest.raises(BusLost, match=r"CAN slcan socket://127\.0\.0\.1:\d+: "):
        over_slcan.group.move({"axis 1": 1.0})


def _expect_nothing(machine: Machine) -> None:
    """Where nobody will answer, each wait need not be given its 0.25 s; what is sent crosses the line in a few ms."""
    machine.clock.grace = 0.05


def _soon_off(machine: Machine) -> bool:
    """Whether every motor loses its power; messages cross the line in real time."""
    deadline = time.monotonic() + 5.0
    off = (Power.SWITCH_ON_DISABLED, Power.READY_TO_SWITCH_ON)
    while not (all_off := all(drive.power in off for drive in machine.rack.drives.values())):
        if time.monotonic() > deadline:
            break
        time.sleep(0.01)
    return all_off


def test_a_garbled_character_is_a_lost_bus_and_leaves_no_motor_on(over_slcan: Machine) -> None:
    group, gateway = over_slcan.group, over_slcan.gateway
    assert gateway is not None
    group.start()
    for drive in over_slcan.rack.drives.values():
        drive.store(0x605A, 0, 6)  # powered in QUICK STOP ACTIVE, until told otherwise
    over_slcan.clock.at(over_slcan.clock.now() + 2.0, gateway.garble)
    over_slcan.clock.at(over_slcan.clock.now() + 2.0, lambda: _expect_nothing(over_slcan))
    with pytest.raises(BusLost, match=r"CAN slcan socket://127\.0\.0\.1:\d+: what came over it is no CAN frame: "):
        group.move({"axis 1": 1.0})
    group.close()
    assert _soon_off(over_slcan)
    over_slcan.clock.sleep(10.0)
    # 0.15 m after 2 s, a look every 0.1 s, 0.005 m to brake at 1 m/s²; it would coast another 0.05 m
    assert 14_000 < over_slcan.rack.drives[1].motor_position() < 18_000


@pytest.mark.parametrize("after", [0, 3, 40, 75, 110, 200])
@pytest.mark.parametrize("fault", ["garble", "cut"])
def test_a_spoilt_frame_at_any_moment_of_the_start_has_a_device_and_a_cause(
    over_slcan: Machine, fault: str, after: int
) -> None:
    getattr(over_slcan.gateway, fault)(after)
    _expect_nothing(over_slcan)
    with contextlib.suppress(HardwareError):  # one that nobody waited for does no harm
        over_slcan.group.start()
    over_slcan.group.close()
    assert _soon_off(over_slcan)


@pytest.mark.parametrize("step", ["disable", "end_watch"])
def test_closing_goes_through_every_step_whatever_one_says(
    machine: Machine, step: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine.group.start()
    done = []

    def fails(axis: Cia402Axis) -> None:
        done.append(axis.name)
        raise ValueError("a library's own mistake")

    monkeypatch.setattr(Cia402Axis, step, fails)
    machine.group.close()
    assert done == ["axis 1", "axis 2", "axis 3"]
    assert not machine.group._bus.is_open


def test_an_adapter_that_is_not_there_is_a_lost_bus() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    arguments = {"interface": "slcan", "channel": f"socket://127.0.0.1:{port}", "sleep_after_open": 0}
    group = Cia402Group(AXES, BusConfig(can=arguments), SteppedClock())
    with pytest.raises(BusLost, match="cannot be opened"):
        group.check()


def test_a_bus_that_another_program_has_is_refused_until_it_is_given_back(over_slcan: Machine) -> None:
    group = over_slcan.group
    other = Cia402Group(AXES, replace(group._bus.config, sync_period=0.05), over_slcan.clock)
    group.start()
    with pytest.raises(BusLost, match=r"^CAN slcan socket://127\.0\.0\.1:\d+: another program has it; wait"):
        other.check()
    assert [row.problem.partition(";")[0] for row in other.look()] == ["another program has it"]
    group.move({"axis 1": 0.1})
    group.close()
    assert len(other.check()) == 3
    other.close()
    assert not lock_file(group._bus.config.can).exists()


def test_a_bus_that_could_not_be_opened_is_not_kept() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    arguments = {"interface": "slcan", "channel": f"socket://127.0.0.1:{port}", "sleep_after_open": 0}
    for _ in range(2):
        with pytest.raises(BusLost, match="cannot be opened"):
            Cia402Group(AXES, BusConfig(can=arguments), SteppedClock()).check()


def test_the_lock_on_a_bus_goes_with_the_program_that_was_killed() -> None:
    arguments = {"interface": "socketcand", "channel": "can0", "host": "nowhere.invalid", "port": next(ports)}
    hold = f"import drivers.bus_lock as b; held = b.BusLock('bus', {arguments}); print('held', flush=True); input()"
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", hold], stdin=pipe, stdout=pipe, text=True) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "held\n"
        with pytest.raises(BusLost, match=r"^bus: another program has it"):
            BusLock("bus", arguments)
        BusLock("bus", {**arguments, "port": next(ports)}).release()
        program.kill()
    BusLock("bus", arguments).release()


def test_the_lock_is_the_same_whatever_the_users_folder_for_temporary_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = {"interface": "slcan", "channel": "/dev/null"}
    before = lock_file(arguments)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    assert lock_file(arguments) == before


def test_a_lock_that_is_left_behind_may_be_read_by_everybody(tmp_path: Path) -> None:
    before = os.umask(0o077)
    try:
        os.close(locked(tmp_path / "bus.lock"))
    finally:
        os.umask(before)
    assert (tmp_path / "bus.lock").stat().st_mode & 0o777 == 0o644


def test_two_names_for_one_adapter_are_one_bus(tmp_path: Path) -> None:
    link = tmp_path / "usb-adapter"
    link.symlink_to("/dev/null")
    one, other = {"interface": "slcan", "channel": "/dev/null@115200"}, {"interface": "slcan", "channel": str(link)}
    assert lock_file(one) == lock_file({**other, "bitrate": 500_000})
    assert lock_file(one) != lock_file({**one, "interface": "socketcan"})


# the adapter itself: lines as the LAWICEL manual shows them


@pytest.mark.parametrize(
    ("line", "identifier", "extended", "data"),
    [
        ("t10021133", 0x100, False, b"\x11\x33"),
        ("t0000", 0x000, False, b""),
        ("T0000010021133", 0x100, True, b"\x11\x33"),
    ],
)
def test_frames_are_read_as_the_adapters_manual_writes_them(
    line: str, identifier: int, extended: bool, data: bytes
) -> None:
    message = decode(line)
    assert (message.arbitration_id, message.is_extended_id, bytes(message.data)) == (identifier, extended, data)
    assert encode(message) == line.encode() + b"\r"


@pytest.mark.parametrize("line", ["t1002113", "t100211", "t10091122334455667788", "t10021133FF"])
def test_a_frame_of_another_length_than_it_says_is_refused(line: str) -> None:
    with pytest.raises(ValueError, match=r"announced|hexadecimal|fromhex"):
        decode(line)


def test_an_adapter_answers_bel_to_what_it_does_not_understand() -> None:
    with (
        SlcanGateway(next(channels)) as gateway,
        socket.create_connection((gateway.host, gateway.port), timeout=2.0) as client,
    ):
        for line, answer in ((b"Q\r", b"\a"), (b"S6\r", b"\r"), (b"t1\r", b"\a"), (b"t1000\r", b"\a"), (b"O\r", b"\r")):
            client.sendall(line)
            assert client.recv(16) == answer


def test_two_clients_of_one_adapter_hear_each_other() -> None:
    with SlcanGateway(next(channels)) as gateway:
        buses = [
            can.Bus(interface="slcan", channel=gateway.url, sleep_after_open=0, ignore_config=True) for _ in range(2)
        ]
        # an answer to a version request shows that the adapter has also seen the second client open
        assert [bus.get_version(timeout=2.0) for bus in buses] == [(10, 13), (10, 13)]  # type: ignore[attr-defined]
        buses[0].send(can.Message(arbitration_id=0x181, data=b"\x01\x02", is_extended_id=False))
        heard = buses[1].recv(timeout=2.0)
        assert heard is not None
        assert (heard.arbitration_id, bytes(heard.data)) == (0x181, b"\x01\x02")
        for bus in buses:
            bus.shutdown()


def _flood(bus: CanBus) -> None:
    for _ in range(10_000):  # 6 bytes each, of which nobody reads one
        bus.sync()


def test_an_adapter_that_takes_no_more_bytes_is_a_lost_bus_and_no_stop_hangs_on_it() -> None:
    """Its firmware hangs, and the system's buffer is full: a safe stop hung on it for good, deaf to Ctrl-C."""
    host, adapter = pty.openpty()
    try:
        tty.setraw(host)
        tty.setraw(adapter)
        arguments = {"interface": "slcan", "channel": os.ttyname(adapter), "sleep_after_open": 0}
        bus = CanBus(BusConfig(can=arguments), SteppedClock())
        bus.open()
        try:
            with pytest.raises(BusLost, match="cannot send: "):
                _flood(bus)
        finally:
            bus.close()
    finally:
        os.close(host)
        os.close(adapter)
