"""One contract over every line: in this process, through TCP, through a pseudo-terminal."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import geocompy.geo
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.bota import BotaSensor
from drivers.geocom import GeoComTracker
from drivers.gsv8 import Gsv8Sensor
from drivers.ports import Atmosphere, WallClock
from drivers.serial_port import Port, open_port
from ppshw.errors import BeamLost, HardwareTimeout, LineLost, ProtocolError
from simulators.force_torque import SimulatedBota, SimulatedGsv8
from simulators.serial_line import LoopbackPort, PtyLine, SerialDevice, TcpLine
from simulators.tracker import SimulatedTracker

Array = NDArray[np.float64]
Plug = Callable[[SerialDevice], Port]


@dataclass
class World:
    targets: dict[str, Array] = field(default_factory=lambda: {"P1": np.array([1.0, 5.0, -0.5])})
    load: Array = field(default_factory=lambda: np.array([10.0, -800.0, 5.0, 300.0, 1.0, -20.0]))

    def visible_targets(self) -> dict[str, Array]:
        return self.targets

    def wrench(self) -> Array:
        return self.load


@pytest.fixture(autouse=True)
def _no_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    """geocompy waits 1 s after its first exchange; nothing here needs that."""
    monkeypatch.setattr(geocompy.geo, "sleep", lambda seconds: None)


@pytest.fixture(params=["in-process", "tcp", "pty"])
def plug(request: pytest.FixtureRequest) -> Iterator[Plug]:
    with contextlib.ExitStack() as lines:

        def put_on_the_line(device: SerialDevice) -> Port:
            if request.param == "in-process":
                return LoopbackPort(device)
            return lines.enter_context(TcpLine(device) if request.param == "tcp" else PtyLine(device)).url

        yield put_on_the_line


@pytest.fixture
def world() -> World:
    return World()


@pytest.fixture
def clock() -> WallClock:
    return WallClock()


def test_a_reflector_is_measured_and_lost_and_found(plug: Plug, world: World, clock: WallClock) -> None:
    station = SimulatedTracker(world, clock, position_sigma=0.0)
    with contextlib.closing(GeoComTracker(plug(station), clock, timeout_s=2.0)) as tracker:
        assert tracker.check().model == "Simulated TS"
        tracker.start()
        tracker.set_atmosphere(Atmosphere(20.0, 1013.25, 50.0))
        p1 = world.targets["P1"]
        assert np.linalg.norm(tracker.measure("P1", p1).xyz - p1) < 2e-6
        station.lose_beam("P1")
        with pytest.raises(BeamLost, match="no target found at P1"):
            tracker.measure("P1", p1)
        station.find_beam()
        station.garble(7)
        with pytest.raises(ProtocolError):
            tracker.measure("P1", p1)
        assert np.linalg.norm(tracker.measure("P1", p1).xyz - p1) < 2e-6


def test_a_silent_tracker_times_out_and_a_pulled_plug_is_named(plug: Plug, world: World, clock: WallClock) -> None:
    station = SimulatedTracker(world, clock)
    with contextlib.closing(GeoComTracker(plug(station), clock, timeout_s=0.15)) as tracker:
        tracker.start()
        station.go_silent()
        with pytest.raises(HardwareTimeout, match="tracker: no answer"):
            tracker.check()
        station.unplug()
        time.sleep(0.12)  # until the line has noticed
        with pytest.raises(LineLost, match="tracker: lost the port"):
            tracker.check()


def sensor_on(kind: str, plug: Plug, world: World, clock: WallClock) -> tuple[BotaSensor | Gsv8Sensor, SerialDevice]:
    if kind == "bota":
        bota = SimulatedBota(world, clock)
        return BotaSensor(plug(bota), clock, sinc_length=64, samples=16, timeout_s=0.3), bota
    gsv = SimulatedGsv8(world, clock, rate=800.0)
    return Gsv8Sensor(plug(gsv), clock, samples=16, rate=800.0, timeout_s=0.3), gsv


@pytest.mark.parametrize("kind", ["bota", "gsv8"])
def test_a_load_is_read_and_old_frames_are_not(kind: str, plug: Plug, world: World, clock: WallClock) -> None:
    sensor, device = sensor_on(kind, plug, world, clock)
    with contextlib.closing(sensor):
        sensor.start()
        first = sensor.read()
        assert first.samples == 16
        assert first.wrench == pytest.approx(world.load, abs=1.0)
        time.sleep(0.15)  # 120 frames of the old load
        world.load = np.array([0.0, -1500.0, 0.0, 0.0, 0.0, 0.0])
        assert sensor.read().wrench == pytest.approx(world.load, abs=1.0)
        device.go_silent()
        with pytest.raises(HardwareTimeout, match="nothing heard"):
            sensor.read()


@pytest.mark.parametrize("kind", ["bota", "gsv8"])
def test_a_sensor_that_is_unplugged_is_named(kind: str, plug: Plug, world: World, clock: WallClock) -> None:
    sensor, device = sensor_on(kind, plug, world, clock)
    with contextlib.closing(sensor):
        sensor.start()
        device.unplug()
        time.sleep(0.12)
        with pytest.raises(LineLost, match="force sensor: lost the port"):
            sensor.read()


def test_a_backlog_that_a_network_delivers_late_is_not_read(world: World, clock: WallClock) -> None:
    """The line is quiet when a reading begins; then come the oldest 4 kB of what nobody took, 110 frames of 1.25 ms."""
    device = SimulatedBota(world, clock)
    with TcpLine(device) as line, contextlib.closing(BotaSensor(line.url, clock, sinc_length=64)) as sensor:
        sensor.start()
        sensor.read()
        for load in (-1500.0, 0.0, -700.0):
            line.hold()
            time.sleep(0.2)
            world.load = np.array([0.0, load, 0.0, 0.0, 0.0, 0.0])
            threading.Timer(0.004, line.let_go).start()
            assert sensor.read().wrench[1] == pytest.approx(load, abs=1.0)


def test_a_serial_port_that_somebody_has_is_refused_until_it_is_given_back(world: World, clock: WallClock) -> None:
    """Two programs on one adapter would each hear half of the answers."""
    with PtyLine(SimulatedTracker(world, clock)) as line:
        tracker, other = GeoComTracker(line.url, clock), Gsv8Sensor(line.url, clock, name="sensor")
        tracker.start()
        with pytest.raises(LineLost, match=f"^sensor: cannot open {line.url}: another program has it$"):
            other.start()
        tracker.close()
        open_port("sensor", line.url, baudrate=115200, timeout_s=0.1).close()


def test_a_backlog_of_a_network_line_is_not_read(world: World) -> None:
    """Simulated time runs fifty-fold: half a second unread is thousands of old frames in the network's buffers."""
    clock = WallClock(speed=50.0)
    device = SimulatedBota(world, clock)
    with TcpLine(device) as line, contextlib.closing(BotaSensor(line.url, clock, sinc_length=64)) as sensor:
        sensor.start()
        time.sleep(0.5)
        world.load = np.array([0.0, -1500.0, 0.0, 0.0, 0.0, 0.0])
        assert sensor.read().wrench[1] == pytest.approx(-1500.0, abs=1.0)
