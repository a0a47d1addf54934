"""Where a tracker stands, from readings of the simulators' own chain, and readings that cannot say it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from simulators import chain as kinematics
from tests.contract.desk import ppshw, refused

Array = NDArray[np.float64]
MACHINE = Path(__file__).parents[2] / "machines/pps.yaml"
JOINTS = [0.2, 0.1, 0.9, 0.3, 0.02, -0.03]
XYZ, RPY = np.array([2.1, -0.9, 3.4]), np.array([-np.pi / 2, 0.8, 0.0])  # levelled where y points up


def circles(point: Array) -> Array:
    """Horizontal circle from y towards x, vertical circle from the zenith [rad], slope distance [m]."""
    x, y, z = point
    distance = np.sqrt(point @ point)
    return np.array([np.arctan2(x, y) % (2 * np.pi), np.arccos(z / distance), distance])


def readings(rpy: Array = RPY, file: Path = MACHINE, joints: Sequence[float] = JOINTS) -> dict[str, Array]:
    chain = kinematics.read_chain(file)
    tip = kinematics.link_poses(chain, np.array([joints]))[0, -1] @ chain.tip
    turned = Rotation.from_euler("xyz", rpy)
    return {
        name: circles(turned.inv().apply(tip[:3, :3] @ at + tip[:3, 3] - XYZ)) for name, at in chain.targets.items()
    }


def words(read: dict[str, Array], unit: float, angles: str, file: Path = MACHINE) -> list[str]:
    said = [f"{name}={hz / unit:.6f},{v / unit:.6f},{distance:.6f}" for name, (hz, v, distance) in read.items()]
    given = ["station", "--machine", str(file), "--joints", *map(str, JOINTS), "--angles", angles]
    return [*given, "--read", *said] if said else given


@pytest.mark.parametrize(("unit", "angles"), [(np.pi / 200, "gon"), (np.pi / 180, "deg"), (1.0, "rad")])
def test_the_place_is_that_of_the_instrument_in_whatever_unit_its_circles_read(unit: float, angles: str) -> None:
    said = ppshw(*words(readings(), unit, angles))
    assert said.code == 0
    first, rest = said.out.split("\n", 1)
    numbers = [float(x) for x in first.translate(str.maketrans("[]{},:", "      ")).split() if x[-1].isdigit()]
    assert numbers == pytest.approx([*XYZ, *RPY], abs=3e-4)
    assert "0.0 mm" in rest
    assert "0.00° from upright" in rest
    assert max(map(len, said.out.splitlines())) <= 80


def test_reflectors_that_could_be_any_are_warned_of() -> None:
    """Those of the positioner stand at the corners of a triangle of three equal sides: level, in any order."""
    level = [*JOINTS[:4], 0.0, 0.0]
    given = words(readings(joints=level), 1.0, "rad")
    at = given.index("--joints") + 1
    given[at : at + 6] = map(str, level)
    said = ppshw(*given)
    assert said.code == 0
    assert said.err.startswith("warning: station: ")
    assert "would fit as P1, P2, P3 as well: make sure which reflector is which" in said.err


def test_a_tracker_that_is_not_level_is_warned_of() -> None:
    said = ppshw(*words(readings(RPY + np.array([0.1, 0.0, 0.0])), 1.0, "rad"))
    assert said.code == 0
    assert "comes out 5.7° from upright: is the tracker levelled" in said.err


def test_two_that_are_exchanged_would_stand_the_tracker_on_its_head(tmp_path: Path) -> None:
    read = readings()
    read["P1"], read["P2"] = read["P2"], read["P1"]
    assert refused(tmp_path, *words(read, 1.0, "rad")).strip().endswith("fits as P1, P2, P3: are they exchanged?")


def test_two_of_unequal_sides_that_are_exchanged_are_named(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text(
        MACHINE.read_text(encoding="utf-8").replace("P1: [0, 0.01, 0.30]", "P1: [0.1, 0.01, 0.60]"), encoding="utf-8"
    )
    read = readings(file=tmp_path / "m.yaml")
    good = words(read, 1.0, "rad", tmp_path / "m.yaml")
    assert (ppshw(*good).code, ppshw(*good).err) == (0, "")
    read["P1"], read["P2"] = read["P2"], read["P1"]
    said = refused(tmp_path, *words(read, 1.0, "rad", tmp_path / "m.yaml"))
    assert "what was read as P2, P1, P3 fits as P1, P2, P3: are they exchanged?" in said


def test_a_wrong_distance_is_no_other_order(tmp_path: Path) -> None:
    read = readings()
    read["P2"][2] += 0.3
    said = refused(tmp_path, *words(read, 1.0, "rad"))
    assert said.strip().endswith("is a reading wrong, or do the joints stand elsewhere?")


def test_reflectors_on_a_line_say_nothing_of_the_turn_about_it(tmp_path: Path) -> None:
    text = MACHINE.read_text(encoding="utf-8")
    for k, (name, at) in enumerate(kinematics.read_chain(MACHINE).targets.items()):
        text = text.replace(f"{name}: [{at[0]:g}, {at[1]:g}, {at[2]:.2f}]", f"{name}: [{0.2 * k}, 0.0, 0.1]")
    (tmp_path / "m.yaml").write_text(text, encoding="utf-8")
    said = refused(tmp_path, *words(readings(), 1.0, "rad", tmp_path / "m.yaml"))
    assert "by the machine file within 0 mm of one line" in said


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"P1": None}, "readings of 2 reflectors, expected 3 or more"),
        ({"P1": "1,2"}, "--read P1: '1,2' holds 2 values, expected 3 finite numbers"),
        ({"P1": "1,4,2"}, "--read P1: vertical circle 4 rad, expected 0 … 3.14159 from the zenith"),
        ({"P1": "1,2,2000"}, "--read P1: slope distance 2000 m, expected 0 … 1000 m"),
        ({"P9": "1,2,3"}, "--read: no target named 'P9', expected one of P1, P2, P3"),
    ],
)
def test_what_is_no_reading_is_said_in_a_line(tmp_path: Path, change: dict[str, str | None], says: str) -> None:
    read = dict(w.split("=") for w in words(readings(), 1.0, "rad") if "=" in w)
    given = [f"{name}={text}" for name, text in (read | change).items() if text is not None]
    start = words({}, 1.0, "rad")
    assert says in refused(tmp_path, *start, "--read", *given)


def test_joints_beyond_their_limits_are_no_place_to_read_from(tmp_path: Path) -> None:
    given = words(readings(), 1.0, "rad")
    given[given.index("--joints") + 1] = "30"
    assert "is outside its limits" in refused(tmp_path, *given)
