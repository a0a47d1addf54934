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

ROOT = Path(__file__).parents[2]
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
        ("zero: [1.2, -310.4,", "zero: [-310.4,", "expected 6 numbers"),
    ],
)
def test_a_mistake_is_reported_with_file_and_line(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    with pytest.raises(SiteError, match=r"hall\.yaml:\d+: ") as caught:
        load_site(site_file(tmp_path, (old, new)))
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_machine_with_its_tracker_anywhere_needs_a_rough_pose(tmp_path: Path) -> None:
    machine = (ROOT / "machines/pps.yaml").read_text(encoding="utf-8")
    (tmp_path / "m.yaml").write_text(re.sub(r"(?m)^tracker:$", "tracker:\n  base: estimate", machine), encoding="utf-8")
    here = (str(ROOT / "machines/pps.yaml"), "m.yaml")
    with pytest.raises(SiteError, match=r"missing key 'tracker\.pose'"):
        load_site(site_file(tmp_path, here))
    pose = ("# pose: {xyz: [4.2, 1.5, -3.0], rpy: [-1.571, 0, 0.35]}", "pose: {xyz: [4.2, 1.5, -3.0]}")
    site = load_site(site_file(tmp_path, here, pose))
    np.testing.assert_array_equal(site.tracker_in_base[:3, 3], [4.2, 1.5, -3.0])


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
