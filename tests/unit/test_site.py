"""Site files: scales and limits reach the drivers; mistakes name file and line; nothing is opened by reading."""

from __future__ import annotations

import json
import re
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from campaigns.operator import ConsoleOperator
from campaigns.site import load_site
from drivers.ports import WallClock
from drivers.thermometer_file import FileThermometer
from ppshw.errors import HardwareTimeout, InstrumentFault, ProtocolError, SiteError
from simulators.clock import START, SteppedClock
from simulators.serve import times_at

ROOT = Path(__file__).parents[2]
AS_WRITTEN = {"sync_period": 0.02, "poll_period": 0.1, "heartbeat_period": 0.5, "heartbeat_timeout": 1.5}
EXAMPLE = (ROOT / "sites/example.yaml").read_text(encoding="utf-8")


def site_file(folder: Path, *changes: tuple[str, str]) -> Path:
    text = EXAMPLE.replace("../machines/pps.yaml", str(ROOT / "machines/pps.yaml"))
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "hall.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_example_is_a_site_of_six_axes() -> None:
    site = load_site(ROOT / "sites/example.yaml")
    assert [axis.name for axis in site.axes] == ["lateral", "vertical", "longitudinal", "yaw", "roll", "pitch"]
    lateral, vertical, _, yaw, *_ = site.axes
    assert (lateral.lower, lateral.upper, lateral.velocity) == (-1.125, 1.125, 0.08)
    assert lateral.parameters == {(0x6085, 0): 1_500_000}
    assert lateral.homing is not None
    assert vertical.approach_from == -1
    assert yaw.to_counts(0.5) == -4_000_000
    assert site.bus.can == {"interface": "slcan", "channel": "/dev/ttyACM0", "bitrate": 500000}
    assert site.bus.host_node_id == 100
    assert site.speed == 1.0
    assert isinstance(site.make_operator(), ConsoleOperator)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("node: 2\n", "node: 1\n", "node 1 is given to two axes"),
        ("node: 2\n", "node: 200\n", "'axes.vertical.node' is 200"),
        ("velocity: 0.08", "velocity: 0.8", "'axes.lateral.velocity' is 0.8, the machine file allows 0.1"),
        ("approach_from: below", "approach_from: left", "expected below or above"),
        ("approach_distance: 0.005", "approach_distance: 0", "approach_from needs a positive approach_distance"),
        ("direction: 1 ", "direction: 0 ", "direction must be -1 or 1"),
        ("counts_per_unit: 8.0e6", "counts_per_rad: 8.0e6", "missing key 'axes.yaw.counts_per_unit'"),
        ("  pitch: {node: 6, counts_per_unit: 3.0e7}\n", "", "missing key 'axes.pitch'"),
        ("  pitch:", "  pitsch: {node: 7, counts_per_unit: 1}\n  pitch:", "unknown key 'axes.pitsch'"),
        ('"0x6085:0"', '"6085h"', "is no object; expected index:subindex"),
        ("protocol: geocom", "protocol: emscon", "'tracker.protocol' is 'emscon', expected geocom"),
        ("gate_m: 0.05", "gate: 0.05", "unknown key 'tracker.gate'"),
        ("pressure_hPa: 1008", "pressure_hPa: 1.008", "expected between 500 and 1100"),
        ("zero: [1.2, -4.4,", "zero: [-4.4,", "expected 6 numbers"),
    ],
)
def test_a_mistake_is_reported_with_file_and_line(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    with pytest.raises(SiteError, match=r"hall\.yaml:\d+: ") as caught:
        load_site(site_file(tmp_path, (old, new)))
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)


LOCAL = ("/dev/ttyACM0, bitrate: 500000", "socket://127.0.0.1:5000")
HURRIED = ("axes:\n", "clock: {speed: 20}\naxes:\n")


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [  # switched-off supervision, mostly by milliseconds where seconds are meant
        ("poll_period: 0.1 ", "poll_period: 100 ", "'can.poll_period' is 100, expected between 0.01 and 1"),
        ("heartbeat_period: 0.5", "heartbeat_period: 500", "'can.heartbeat_period' is 500, expected between"),
        ("heartbeat_period: 0.5", "heartbeat_period: 0.0004", "'can.heartbeat_period' is 0.0004, expected"),
        ("heartbeat_timeout: 1.5", "heartbeat_timeout: 1500", "'can.heartbeat_timeout' is 1500, expected between"),
        ("heartbeat_timeout: 1.5", "heartbeat_timeout: 0.2", "is 0.2, expected between 1 and 10"),
        ("sync_period: 0.02", "sync_period: 20", "'can.sync_period' is 20, expected between 0.001 and 0.2"),
        ("  sync_period", "  answer_timeout: 500\n  sync_period", "'can.answer_timeout' is 500, expected between"),
        ("  sync_period", "  sdo_timeout: 300\n  sync_period", "'can.sdo_timeout' is 300, expected between"),
        ("host_node_id: 100", "host_node_id: 3", "'can.host_node_id' is 3, the node of axis longitudinal"),
        # beyond limits
        ("fast: 0.02", "fast: 2.0", "'axes.lateral.homing.fast' is 2, the machine file allows 0.1"),
        ("slow: 0.002", "slow: 2.0", "'axes.lateral.homing.slow' is 2, the machine file allows 0.1"),
        ("offset: -1.13,", "offset: 5.0,", "'axes.lateral.homing.offset' is 5, expected between -1.35 and 1.35"),
        ("window: 2.0e-5", "deceleration: 50", "'axes.lateral.deceleration' is 50, the machine file allows 0.1"),
        # what would accept anything
        ("window: 2.0e-5", "window: 1.0", "'axes.lateral.window' is 1, expected between 1e-12 and 0.001"),
        ("window_s: 0.2", "window_s: 200", "'axes.lateral.window_s' is 200, expected between 0 and 10"),
        ("following_window: 2.0e-3", "following_window: 100", "'axes.lateral.following_window' is 100, expected"),
        ("window_s: 0.2", "following_s: 100", "'axes.lateral.following_s' is 100, expected between 0 and 5"),
        ("gate_m: 0.05", "gate_m: 10", "'tracker.gate_m' is 10, expected between 1e-09 and 0.5"),
        ("gate_m: 0.05", "wavelength_um: 658", "'tracker.wavelength_um' is 658, expected between 0.35 and 1.7"),
        ("gate_m: 0.05", "reference_index: 286.3", "'tracker.reference_index' is 286.3, expected between 1 and 1.001"),
        ("gate_m: 0.05", "search_rad: 1.5", "'tracker.search_rad' is 1.5, expected between 1e-09 and 0.2"),
        ("gate_m: 0.05", "timeout_s: 15000", "'tracker.timeout_s' is 15000, expected between 1e-09 and 120"),
        ("samples: 32", "timeout_s: 2000", "'force_sensor.timeout_s' is 2000, expected between 1e-09 and 120"),
        ("fast: 0.02", "timeout_s: 120000", "'axes.lateral.homing.timeout_s' is 120000, expected between 0.1 and 3600"),
        ("max_age_s: 120", "max_age_s: 1e12", "max_age_s' is 1e+12, expected between 0 and 3600"),
        ("samples: 32", f"matrix: [{', '.join(['0'] * 36)}]", "'force_sensor.matrix' is singular"),
        ("samples: 32", f"matrix: [{', '.join(['1e-3'] * 36)}]", "expected six independent rows"),
        # two words for one thing
        ("port: /dev/ttyUSB1", "port: /dev/ttyUSB0", "'force_sensor.port' is /dev/ttyUSB0, as is 'tracker.port'"),
        ("/dev/ttyUSB0", "/dev/ttyACM0", "'tracker.port' is /dev/ttyACM0, as is 'can.bus.channel'"),
        ('"0x6085:0"', '"0x6081:0"', "'axes.lateral.parameters.0x6081:0' is an object that 'velocity' sets afterwards"),
        ('"0x6085:0"', '"0x1017"', "is an object that 'can.heartbeat_period' sets afterwards; expected it there alone"),
        ('"0x6085:0"', '"0x607C:0"', "is an object that 'homing.offset' sets afterwards"),
        ('"0x6085:0"', '"0x1016:1"', "is an object that 'can.host_node_id' sets afterwards"),
        ('"0x6085:0"', '"0x1A00:1"', "is an object that ppshw's process data sets afterwards"),
        (*HURRIED, "'clock.speed' is 20, but 'can.bus.channel' is /dev/ttyACM0: only simulated hardware"),
    ],
)
def test_a_setting_that_would_switch_off_a_check_or_exceed_a_limit_is_refused(
    tmp_path: Path, old: str, new: str, complaint: str
) -> None:
    with pytest.raises(SiteError, match=r"hall\.yaml:\d+: ") as caught:
        load_site(site_file(tmp_path, (old, new)))
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)


def test_hurried_time_beside_a_real_instrument_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SiteError, match=r"'clock\.speed' is 20, but 'tracker\.port' is /dev/ttyUSB0"):
        load_site(site_file(tmp_path, LOCAL, HURRIED))


@pytest.mark.parametrize("speed", [0.5, 1, 20, 1000])
def test_the_times_of_simulated_hardware_are_sane_at_its_speed(tmp_path: Path, speed: float) -> None:
    local = [("/dev/ttyUSB0", "socket://127.0.0.1:5001"), ("/dev/ttyUSB1", "socket://localhost:5002")]
    times = [(f"{key}: {value} ", f"{key}: {times_at(speed)[key]} ") for key, value in AS_WRITTEN.items()]
    site = load_site(site_file(tmp_path, LOCAL, *local, *times, (HURRIED[0], f"clock: {{speed: {speed}}}\naxes:\n")))
    assert site.bus.heartbeat_timeout == times_at(speed)["heartbeat_timeout"]


def test_a_parameter_that_nothing_sets_afterwards_is_the_sites_own(tmp_path: Path) -> None:
    """An absolute encoder's home offset, the third TPDO, a consumer heartbeat where the program sends none."""
    own = '{node: 5, counts_per_unit: 3.0e7, parameters: {"0x607C:0": 5, "0x1802:1": 7, "0x1016:1": 9}}'
    changes = ("{node: 5, counts_per_unit: 3.0e7}", own), ("  host_node_id: 100", "  # host_node_id: 100")
    assert len(load_site(site_file(tmp_path, *changes)).axes[4].parameters) == 3


def test_a_machine_with_its_tracker_anywhere_needs_a_rough_pose(tmp_path: Path) -> None:
    machine = (ROOT / "machines/pps.yaml").read_text(encoding="utf-8")
    (tmp_path / "m.yaml").write_text(re.sub(r"(?m)^tracker:$", "tracker:\n  base: estimate", machine), encoding="utf-8")
    here = (str(ROOT / "machines/pps.yaml"), "m.yaml")
    with pytest.raises(SiteError, match=r"missing key 'tracker\.pose'"):
        load_site(site_file(tmp_path, here))
    pose = ("# pose: {xyz: [4.2, 1.5, -3.0], rpy: [-1.571, 0.35, 0]}", "pose: {xyz: [4.2, 1.5, -3.0]}")
    site = load_site(site_file(tmp_path, here, pose))
    np.testing.assert_array_equal(site.tracker_in_base[:3, 3], [4.2, 1.5, -3.0])
    plumb = load_site(site_file(tmp_path, here, (pose[0], pose[0].removeprefix("# "))))  # as the example has it
    np.testing.assert_allclose(plumb.tracker_in_base[:3, 2], [0, 1, 0], atol=1e-3)  # standing axis: Y is up on pps


def test_hurried_time_runs_on_from_process_to_process() -> None:
    real = datetime.now(UTC).timestamp()
    first = WallClock(100.0, real - 10).utc()
    second = WallClock(100.0, real - 10).utc()
    assert first <= second
    assert first.timestamp() == pytest.approx(real - 10 + 100 * 10, abs=20)  # 10 s ago they agreed


def thermometer(folder: Path, text: str) -> FileThermometer:
    (folder / "now.json").write_text(text, encoding="utf-8")
    return FileThermometer(folder / "now.json", SteppedClock(), max_age_s=120)


def test_a_logger_file_gives_temperatures_as_long_as_it_is_fresh(tmp_path: Path) -> None:
    said = {"time": (START - timedelta(seconds=100)).isoformat(), "temperatures_C": {"hall": 21.25}}
    assert thermometer(tmp_path, json.dumps(said)).read() == {"hall": 21.25}
    info = thermometer(tmp_path, json.dumps(said)).check()
    assert (info.device, info.model, info.status) == ("thermometers", "file now.json", "100 s old, hall 21.25 °C")
    said["time"] = (START - timedelta(seconds=130)).isoformat()
    with pytest.raises(HardwareTimeout, match=r"thermometers: .*now\.json is 130 s old, allowed 120 s"):
        thermometer(tmp_path, json.dumps(said)).read()


def test_a_logger_file_from_the_future_is_refused_because_it_would_never_grow_old(tmp_path: Path) -> None:
    said = {"time": (START + timedelta(seconds=50)).isoformat(), "temperatures_C": {"hall": 21.25}}
    assert thermometer(tmp_path, json.dumps(said)).read() == {"hall": 21.25}  # clocks are never quite the same
    said["time"] = (START + timedelta(hours=2)).replace(tzinfo=None).isoformat()
    with pytest.raises(InstrumentFault, match=r"thermometers: .*now\.json is 7200 s ahead of our clock .*local time"):
        thermometer(tmp_path, json.dumps(said)).read()


def test_a_broken_logger_file_is_no_temperature(tmp_path: Path) -> None:
    with pytest.raises(ProtocolError, match="is not what it should be"):
        thermometer(tmp_path, '{"time": "2026-03-').read()
    with pytest.raises(InstrumentFault, match="hall reads 850 °C"):
        thermometer(tmp_path, json.dumps({"time": START.isoformat(), "temperatures_C": {"hall": 850}})).read()
    with pytest.raises(InstrumentFault, match="cannot be read"):
        FileThermometer(tmp_path / "none.json", SteppedClock()).read()
