"""Site file (YAML) → Site → Bench: which machine stands here, on which bus and ports, with which scales. docs/site.md.

Reading a site file opens nothing. `open_bench` makes the drivers, and they connect when they are checked or started.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from campaigns.bench import STANDARD_AIR, Bench, nominal_aim
from campaigns.operator import AutomaticOperator, ConsoleOperator, Operator
from campaigns.plan import Plan
from campaigns.remote_operator import put_on_by_line
from drivers.axis_config import AxisConfig, HomingConfig
from drivers.axis_group import Cia402Group
from drivers.bota import BotaSensor
from drivers.canopen_bus import BusConfig, Entry
from drivers.cia402_objects import (
    ACCELERATION,
    CONSUMER_HEARTBEAT,
    CONTROLWORD,
    DECELERATION,
    FOLLOWING_TIME,
    FOLLOWING_WINDOW,
    HOME_OFFSET,
    HOMING_ACCELERATION,
    HOMING_FAST,
    HOMING_METHOD,
    HOMING_SLOW,
    LIMIT_HIGH,
    LIMIT_LOW,
    MODE,
    POSITION_TIME,
    POSITION_WINDOW,
    PRODUCER_HEARTBEAT,
    TARGET,
    VELOCITY,
)
from drivers.geocom import GeoComTracker
from drivers.gsv8 import Gsv8Sensor
from drivers.ports import Atmosphere, Clock, ForceSensor, Thermometer, Tracker, WallClock
from drivers.serial_port import Port
from drivers.thermometer_file import FileThermometer
from ppshw.errors import CampaignError, InstrumentFault, SiteError, SoftLimit
from ppshw.machine import Joint, Machine, load_machine
from ppshw.strict_yaml import Section, read_yaml
from ppshw.transforms import from_xyz_rpy

Array = NDArray[np.float64]
# A device of the site, made when the bench is opened: (clock, what a port's name stands for) → driver.
Ports = Mapping[str, Port]
# Real seconds between which each time of the bus makes sense: milliseconds in their place would switch supervision off.
BUS_TIMES = {
    "sync_period": (1e-3, 0.2), "poll_period": (0.01, 1.0), "heartbeat_period": (0.01, 3.0),
    "answer_timeout": (0.02, 5.0), "sdo_timeout": (0.02, 5.0),
}  # fmt: skip
LONGEST_SILENCE_S, BEATS = 10.0, 2.0  # heartbeat_timeout: at most so long, at least so many periods
# What an instrument's settings may be, in their units: seconds that are milliseconds would wait for hours, micrometres
# that are nanometres change every distance.
LONGEST_ANSWER_S, LONGEST_HOMING_S, OLDEST_TEMPERATURE_S = 120.0, 3600.0, 3600.0
TRACKER_RANGES = {
    "wavelength_um": (0.35, 1.7), "reference_index": (1.0, 1.001), "search_rad": (1e-9, 0.2), "gate_m": (1e-9, 0.5),
    "timeout_s": (1e-9, LONGEST_ANSWER_S),
}  # fmt: skip
WIDEST_WINDOW, WIDEST_FOLLOWING = 1e-3, 0.1  # m or rad; what is to be calibrated to tenths of a millimetre
HOME_BEYOND = 0.1  # of the travel: so far beyond a limit a home switch may be
PROCESS_DATA = (0x1400, 0x1600, 0x1800, 0x1A00)  # of the first RPDO and TPDO; the others are the site's
SIMULATED = ("socket://127.0.0.1:", "socket://localhost:", "loopback:")


@dataclass(frozen=True)
class Site:
    """speed, epoch: only for simulated hardware in another process, see WallClock."""

    name: str
    machine: Machine
    bus: BusConfig
    axes: tuple[AxisConfig, ...]
    make_tracker: Callable[[Clock, Ports], Tracker]
    make_force_sensor: Callable[[Clock, Ports], ForceSensor] | None
    make_thermometers: tuple[Callable[[Clock], Thermometer], ...]
    air: Atmosphere
    air_temperature_from: str | None
    tracker_in_base: Array
    operator: tuple[str, str]
    speed: float
    epoch: float | None
    file: str
    text: str
    sha256: str

    def clock(self) -> WallClock:
        return WallClock(self.speed, self.epoch)

    def make_operator(self) -> Operator:
        """Who puts loads on: a person at this terminal, or the simulated operator at the site's control line."""
        kind, port = self.operator
        return ConsoleOperator() if kind == "console" else AutomaticOperator(partial(put_on_by_line, port), "simulated")


def load_site(path: Path | str) -> Site:
    """Read and check a site file and the machine file it names. Raises SiteError (or MachineFileError)."""
    path = Path(path)
    top = read_yaml(path, SiteError)
    machine = load_machine(path.parent / top.text("machine"))
    speed, epoch = _clock(top)
    bus = _bus(top, speed)
    tracker_section = top.need("tracker")
    pose = _rough_pose(tracker_section, machine)
    air, temperature_from = _air(tracker_section)
    thermometers = top.sections("thermometers", optional=True)
    site = Site(
        name=top.text("name"),
        machine=machine,
        bus=bus,
        axes=_axes(top, machine, bus.host_node_id),
        make_tracker=_tracker(tracker_section),
        make_force_sensor=_force_sensor(top),
        make_thermometers=tuple(_thermometer(s, path.parent, speed) for s in thermometers),
        air=air,
        air_temperature_from=temperature_from,
        tracker_in_base=pose,
        operator=_operator(top),
        speed=speed,
        epoch=epoch,
        file=str(path),
        text=path.read_text(encoding="utf-8"),
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
    )
    tracker_section.done()
    _check_ports(top, speed)
    top.done()
    return site


def open_bench(site: Site, clock: Clock | None = None, ports: Ports | None = None) -> Bench:
    """The drivers of a site. Use as a context manager; nothing is connected before check() or start().

    clock  by default the site's
    ports  what a port's name in the site file stands for, where it is no real port (hardware simulated in-process)
    """
    clock = clock or site.clock()
    ports = ports or {}
    thermometers = tuple(make(clock) for make in site.make_thermometers)
    return Bench(
        axes=Cia402Group(site.axes, site.bus, clock),
        tracker=site.make_tracker(clock, ports),
        force_sensor=None if site.make_force_sensor is None else site.make_force_sensor(clock, ports),
        clock=clock,
        aim=nominal_aim(site.machine, site.tracker_in_base),
        thermometers=thermometers,
        atmosphere=partial(_air_now, site, thermometers),
        notes={"site": site.text, "site_name": site.name, "site_sha256": site.sha256},
    )


def check_moves(plan: Plan, site: Site) -> None:
    """Every move of a plan against the axes of this site. Raises CampaignError for one beyond a limit.

    A plan knows the machine's limits; where a final approach begins is the site's.
    """
    for visit in plan.visits:
        who = f"{visit.where}: step {visit.step}"
        if visit.via is not None:
            _check_move(visit.via, site, f"{who}, stepping aside before it")
        _check_move(visit.setpoints, site, who)


def _check_move(setpoints: Sequence[float], site: Site, who: str) -> None:
    for axis, setpoint in zip(site.axes, setpoints, strict=True):
        what = axis.name
        try:
            axis.require_within_limits(setpoint)
            if (start := axis.approach_start(setpoint)) is not None:
                what = f"the final approach to {axis.name} = {setpoint:g} begins beyond its limits"
                axis.require_within_limits(start)
        except SoftLimit as beyond:
            raise CampaignError(f"{who}: {what}: {beyond.cause}") from None


def _air_now(site: Site, thermometers: tuple[Thermometer, ...]) -> Atmosphere:
    place = site.air_temperature_from
    if place is None:
        return site.air
    for thermometer in thermometers:
        if place in (found := thermometer.read()):
            return Atmosphere(found[place], site.air.pressure_hpa, site.air.humidity_pct)
    cause = f"none reads '{place}', where 'tracker.atmosphere.temperature_from' of {site.file} takes the air's from"
    raise InstrumentFault("thermometers", cause)


# --- sections ------------------------------------------------------------------------------------------------
def _clock(top: Section) -> tuple[float, float | None]:
    section = top.section("clock", optional=True)
    if section is None:
        return 1.0, None
    speed, epoch = section.number("speed", low=1e-3, high=1e5), section.number("epoch", default=None)
    section.done()
    return speed, epoch


def _bus(top: Section, speed: float) -> BusConfig:
    section = top.need("can")
    given = section.plain("bus")
    if not isinstance(given, dict) or not all(isinstance(key, str) for key in given):
        section.fail("'can.bus' must hold python-can's own arguments: interface, channel, bitrate, …", "bus")
    hurry = max(1.0, speed)
    times = {
        name: section.number(name, low=low, high=high * hurry)
        for name, (low, high) in BUS_TIMES.items()
        if name in section
    }
    beat = times.get("heartbeat_period", BusConfig.heartbeat_period)
    times["heartbeat_timeout"] = section.number(
        "heartbeat_timeout", max(BusConfig.heartbeat_timeout, 3 * beat), BEATS * beat, LONGEST_SILENCE_S * hurry
    )
    host = section.integer("host_node_id", low=1, high=127) if "host_node_id" in section else None
    config = BusConfig(given, host_node_id=host, **times)
    section.done()
    return config


def _check_ports(top: Section, speed: float) -> None:
    """Each is a port of its own; time is hurried for simulated hardware only."""
    named: dict[str, str] = {}
    for name, key in (("can", "bus"), ("tracker", "port"), ("force_sensor", "port"), ("operator", "port")):
        section = top.section(name, optional=True)
        if section is None or key not in section:
            continue
        path, port = section.path(key), section.plain(key)
        if key == "bus":
            if port.get("interface") == "virtual" or "channel" not in port:
                continue
            path, port = f"{path}.channel", port["channel"]
        if str(port) in named and "://" not in str(port):  # a network port says so itself when it is taken
            section.fail(f"'{path}' is {port}, as is '{named[str(port)]}'; expected a port of its own", key)
        if speed != 1.0 and not str(port).startswith(SIMULATED):
            section.fail(f"'clock.speed' is {speed:g}, but '{path}' is {port}: only simulated hardware can hurry", key)
        named[str(port)] = path


def _axes(top: Section, machine: Machine, host: int | None) -> tuple[AxisConfig, ...]:
    section = top.need("axes")
    axes = [_axis(section.need(joint.name), joint, section, host) for joint in machine.joints]
    section.done()
    nodes = [axis.node_id for axis in axes]
    for axis in axes:
        if nodes.count(axis.node_id) > 1:
            section.fail(f"axis {axis.name}: node {axis.node_id} is given to two axes", axis.name)
        if axis.node_id == host:
            section.fail(f"'can.host_node_id' is {host}, the node of axis {axis.name}; expected another", axis.name)
    return tuple(axes)


def _axis(s: Section, joint: Joint, axes: Section, host: int | None) -> AxisConfig:
    """Limits and speeds are the machine file's; the site may be slower, never faster or wider."""
    if joint.limits is None:
        axes.fail(f"joint {joint.name} has no limits in the machine file; without limits nothing is moved", joint.name)
    speeds = [_speed(s, key, getattr(joint.limits, key)) for key in ("velocity", "acceleration")]
    deceleration = _speed(s, "deceleration", joint.limits.acceleration) if "deceleration" in s else None
    homing = _homing(s, joint)
    side = s.text("approach_from", default="", choices=("below", "above")) if "approach_from" in s else ""
    config = _site_error(
        s, AxisConfig,
        name=joint.name,
        node_id=s.integer("node", low=1, high=127),
        counts_per_unit=s.number("counts_per_unit", low=1e-9),
        lower=joint.limits.lower,
        upper=joint.limits.upper,
        velocity=speeds[0],
        acceleration=speeds[1],
        deceleration=deceleration,
        direction=s.integer("direction", default=1, low=-1, high=1),
        offset=s.number("offset", default=0.0),
        unit=joint.unit,
        window=s.number("window", default=5e-5, low=1e-12, high=WIDEST_WINDOW),
        window_s=s.number("window_s", default=0.05, low=0.0, high=10.0),
        following_window=s.number("following_window", default=None, low=1e-12, high=WIDEST_FOLLOWING),
        following_s=s.number("following_s", default=None, low=0.0, high=5.0),
        approach_from={"below": -1, "above": 1, "": None}[side],
        approach_distance=s.number("approach_distance", default=0.0, low=0.0),
        velocity_units=s.number("velocity_units", default=1.0, low=1e-12),
        acceleration_units=s.number("acceleration_units", default=1.0, low=1e-12),
        homing=homing,
        vendor=s.integer("vendor") if "vendor" in s else None,
        product=s.integer("product") if "product" in s else None,
        firmware=s.text("firmware") if "firmware" in s else None,
        serial=s.integer("serial") if "serial" in s else None,
        parameters=_parameters(s, _set_afterwards(s, homing, host)),
    )  # fmt: skip
    s.done()
    assert isinstance(config, AxisConfig)
    return config


def _speed(s: Section, key: str, allowed: float | None) -> float:
    if key in s:
        value = float(s.number(key, low=1e-9))
        if allowed is not None and value > allowed:
            s.fail(f"'{s.path(key)}' is {value:g}, the machine file allows {allowed:g}", key)
        return value
    if allowed is None:
        s.fail(f"missing key '{s.path(key)}': neither the machine file nor the site file gives it")
    return allowed


def _homing(s: Section, joint: Joint) -> HomingConfig | None:
    section = s.section("homing", optional=True)
    if section is None:
        return None
    assert joint.limits is not None
    beyond = HOME_BEYOND * (joint.limits.upper - joint.limits.lower)
    fast, slow = (_speed(section, key, joint.limits.velocity) if key in section else None for key in ("fast", "slow"))
    config = HomingConfig(
        method=section.integer("method", low=-128, high=127),
        offset=section.number("offset", 0.0, joint.limits.lower - beyond, joint.limits.upper + beyond),
        fast=fast,
        slow=slow,
        timeout_s=section.number("timeout_s", default=120.0, low=0.1, high=LONGEST_HOMING_S),
    )
    section.done()
    return config


def _set_afterwards(s: Section, homing: HomingConfig | None, host: int | None) -> dict[tuple[int, int], str]:
    """What a drive is told after a site's own parameters, and by what: a parameter would be overwritten in silence."""
    by: dict[Entry, str] = {
        VELOCITY: "'velocity'", ACCELERATION: "'acceleration'", DECELERATION: "'deceleration'",
        LIMIT_LOW: "the machine file", LIMIT_HIGH: "the machine file",
        POSITION_WINDOW: "'window'", POSITION_TIME: "'window_s'", PRODUCER_HEARTBEAT: "'can.heartbeat_period'",
        CONTROLWORD: "every move", MODE: "every move", TARGET: "every move",
    }  # fmt: skip
    if homing is not None:
        by |= {HOMING_METHOD: "'homing.method'", HOME_OFFSET: "'homing.offset'", HOMING_ACCELERATION: "'acceleration'"}
        by |= {HOMING_FAST: "'homing.fast'"} if homing.fast is not None else {}
        by |= {HOMING_SLOW: "'homing.slow'"} if homing.slow is not None else {}
    if "following_window" in s:
        by |= {FOLLOWING_WINDOW: "'following_window'", FOLLOWING_TIME: "'following_s'"}
    if "following_s" in s:
        by[FOLLOWING_TIME] = "'following_s'"
    if host is not None:
        by[CONSUMER_HEARTBEAT] = "'can.host_node_id'"
    return {(entry.index, entry.subindex): what for entry, what in by.items()}


def _parameters(s: Section, set_afterwards: Mapping[tuple[int, int], str]) -> dict[tuple[int, int], int]:
    """`"0x6080:0": 3000`, as a concise configuration has them."""
    section = s.section("parameters", optional=True)
    out: dict[tuple[int, int], int] = {}
    for key in [] if section is None else section.keys():
        assert section is not None
        index, _, sub = key.partition(":")
        try:
            address = int(index, 0), int(sub or "0", 0)
        except ValueError:
            section.fail(f"'{section.path(key)}' is no object; expected index:subindex such as 0x6080:0", key)
        by = "ppshw's process data" if address[0] in PROCESS_DATA else set_afterwards.get(address)
        if by is not None:
            section.fail(f"'{section.path(key)}' is an object that {by} sets afterwards; expected it there alone", key)
        out[address] = section.integer(key)
    return out


def _tracker(s: Section) -> Callable[[Clock, Ports], Tracker]:
    s.text("protocol", choices=("geocom",))
    port = s.text("port")
    options: dict[str, Any] = {"baudrate": s.integer("baud", default=115200, low=300)}
    if "serial_number" in s:
        options["serial_number"] = s.integer("serial_number")
    options |= {k: s.text(k) for k in ("prism",) if k in s}
    options |= {k: s.number(k, low=low, high=high) for k, (low, high) in TRACKER_RANGES.items() if k in s}
    options |= {k: s.flag(k) for k in ("checksum",) if k in s}
    return lambda clock, ports: _site_error(s, GeoComTracker, ports.get(port, port), clock, **options)


def _force_sensor(top: Section) -> Callable[[Clock, Ports], ForceSensor] | None:
    s = top.section("force_sensor", optional=True)
    if s is None:
        return None
    protocol, port = s.text("protocol", choices=("bota", "gsv8")), s.text("port")
    options: dict[str, Any] = {"baudrate": s.integer("baud", low=300)} if "baud" in s else {}
    options |= {k: s.integer(k, low=1) for k in ("samples", "sinc_length") if k in s and protocol == "bota"}
    options |= {k: s.integer(k, low=1) for k in ("samples",) if k in s and protocol == "gsv8"}
    highest = {"timeout_s": LONGEST_ANSWER_S}
    highest |= {} if protocol == "bota" else dict.fromkeys(("force_limit", "moment_limit", "rate"), np.inf)
    options |= {k: s.number(k, low=1e-9, high=high) for k, high in highest.items() if k in s}
    options |= {"zero": s.vector("zero", 6).tolist()} if "zero" in s else {}
    if "matrix" in s:
        flat = s.vector("matrix", 36)
        options["matrix"] = matrix = flat.reshape(6, 6).tolist()
        rows = np.array(matrix) / np.maximum(np.linalg.norm(matrix, axis=1, keepdims=True), 1e-300)
        if np.linalg.matrix_rank(rows, tol=1e-6) < 6:
            s.fail("'force_sensor.matrix' is singular, expected six independent rows", "matrix")
    s.done()
    driver: Any = BotaSensor if protocol == "bota" else Gsv8Sensor
    return lambda clock, ports: _site_error(s, driver, ports.get(port, port), clock, **options)


def _thermometer(s: Section, folder: Path, speed: float) -> Callable[[Clock], Thermometer]:
    s.text("protocol", choices=("file",))
    oldest = OLDEST_TEMPERATURE_S * max(1.0, speed)
    path, age = folder / s.text("path"), s.number("max_age_s", default=300.0, low=0.0, high=oldest)
    s.done()
    return lambda clock: FileThermometer(path, clock, max_age_s=age)


def _air(tracker: Section) -> tuple[Atmosphere, str | None]:
    s = tracker.section("atmosphere", optional=True)
    if s is None:
        return STANDARD_AIR, None
    place = s.text("temperature_from") if "temperature_from" in s else None
    default = STANDARD_AIR.temperature_c
    temperature = default if place else s.number("temperature_C", low=-40, high=60)
    pressure, humidity = s.number("pressure_hPa", low=500, high=1100), s.number("humidity_pct", low=0, high=100)
    air = Atmosphere(temperature, pressure, humidity)
    s.done()
    return air, place


def _rough_pose(tracker: Section, machine: Machine) -> Array:
    """The measuring frame in the base frame: the machine file's where it is known, else the site's rough one."""
    pose = tracker.section("pose", optional=True)
    if pose is None:
        if machine.tracker.base is None:
            tracker.fail("missing key 'tracker.pose': the machine file does not know where the tracker stands")
        return machine.tracker.base
    out = from_xyz_rpy(pose.vector("xyz", 3), pose.vector("rpy", 3, default=(0, 0, 0)))
    pose.done()
    return out


def _operator(top: Section) -> tuple[str, str]:
    s = top.section("operator", optional=True)
    if s is None:
        return "console", ""
    kind = s.text("kind", choices=("console", "simulated"))
    port = s.text("port") if kind == "simulated" else ""
    s.done()
    return kind, port


def _site_error(s: Section, make: Callable[..., Any], *args: Any, **options: Any) -> Any:
    """A driver that refuses its settings does so with the place they stand at."""
    try:
        return make(*args, **options)
    except (SiteError, ValueError, KeyError) as problem:
        s.fail(str(problem).strip("'"))
