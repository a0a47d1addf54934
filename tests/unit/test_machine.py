"""The machine file as the contract has it: what it means when all is said, and when only the least is."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ppshw.errors import MachineFileError
from ppshw.machine import Machine, load_machine

ROOT = Path(__file__).parents[2]
LEAST = """\
name: least
gravity: [0, 0, -9.81]
joints: [{name: only, type: revolute, axis: [0, 0, 1]}]
tip: {targets: {P: [0.1, 0, 0]}}
"""


def written(folder: Path, text: str) -> Machine:
    (folder / "m.yaml").write_text(text, encoding="utf-8")
    return load_machine(folder / "m.yaml")


def test_the_least_that_a_file_must_say(tmp_path: Path) -> None:
    machine = written(tmp_path, LEAST)
    (joint,) = machine.joints
    assert (joint.name, joint.prismatic, joint.unit, joint.limits, joint.elastic, joint.mass) == (
        "only", False, "rad", None, None, 0.0)  # fmt: skip
    np.testing.assert_array_equal(joint.origin, np.eye(4))
    np.testing.assert_array_equal(machine.tip_in_link, np.eye(4))
    np.testing.assert_array_equal(machine.sensor_in_link, np.eye(4))
    assert machine.limits()[0].tolist() == [-np.inf]
    assert (machine.points, machine.repeatability) == ({}, None)
    np.testing.assert_array_equal(machine.tracker.base, np.eye(4))
    assert machine.tracker.targets_known


def test_an_optional_key_that_holds_nothing_is_not_there(tmp_path: Path) -> None:
    least = written(tmp_path, LEAST)
    nothing = LEAST.replace("[0, 0, 1]}", "[0, 0, 1], origin: null, limits: , link: ~, elastic: null}")
    nothing = (
        nothing.replace("0]}}", "0]}, points: null}") + "tracker: {base: }\nforce_sensor: null\nrepeatability: null\n"
    )
    assert written(tmp_path, nothing).sha256 == least.sha256
    with pytest.raises(MachineFileError, match="'gravity' is nothing, expected 3 numbers"):
        written(tmp_path, LEAST.replace("[0, 0, -9.81]", ""))


def test_its_hash_is_of_what_it_says_however_that_is_written(tmp_path: Path) -> None:
    text = (ROOT / "machines/pps.yaml").read_text(encoding="utf-8")
    machine, said = load_machine(ROOT / "machines/pps.yaml"), yaml.safe_load(text)
    in_json = json.dumps(dict(reversed(said.items())))
    for way in (text + "# measured on Monday\n", text.replace("\n", "\r\n"), in_json):
        assert written(tmp_path, way).sha256 == machine.sha256
    said["joints"][0]["limits"]["velocity"] /= 2.0  # to be careful
    said["tip"].setdefault("points", {})["couch end"] = [0.0, 0.2, 1.9]
    assert written(tmp_path, yaml.safe_dump(said)).sha256 == machine.sha256

    def other(change: Callable[[dict[str, Any]], None]) -> str:
        changed = copy.deepcopy(said)
        change(changed)
        return written(tmp_path, yaml.safe_dump(changed)).sha256

    found = {
        other(lambda m: m.update(name="its twin")),
        other(lambda m: m.update(gravity=[0, -9.81, 0])),
        other(lambda m: m["joints"][1]["link"].update(mass=1.0)),
        other(lambda m: m["joints"][1]["elastic"].update(varies=False, loads=["Mz"])),
        other(lambda m: m["joints"][2]["origin"].update(xyz=[0, 0, 1e-6])),
        other(lambda m: m["tip"]["targets"].update(P1=[0, 0, 0])),
        other(lambda m: m.update(force_sensor={"origin": {"xyz": [0, 0, 0.01]}})),
        other(lambda m: m.update(tracker={"base": "estimate"})),
        machine.sha256,
    }
    assert len(found) == 9


def test_up_is_against_gravity_and_along_z_where_there_is_none() -> None:
    machine = load_machine(ROOT / "machines/pps.yaml")
    np.testing.assert_allclose(machine.up, [0, 1, 0])
    np.testing.assert_allclose(replace(machine, gravity=np.zeros(3)).up, [0, 0, 1])


def test_rpy_turns_about_fixed_axes_x_then_y_then_z(tmp_path: Path) -> None:
    """Quarter turns by hand: x → after roll x → after pitch −z → after yaw −z; y → z → x → y."""
    quarter = "1.5707963267948966"
    text = LEAST.replace("axis:", f"origin: {{xyz: [1, 2, 3], rpy: [{quarter}, {quarter}, {quarter}]}}, axis:")
    origin = written(tmp_path, text).joints[0].origin
    np.testing.assert_allclose(origin @ [1, 0, 0, 0], [0, 0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(origin @ [0, 1, 0, 0], [0, 1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(origin @ [0, 0, 0, 1], [1, 2, 3, 1], atol=1e-15)


def test_the_positioner_is_the_paper_s() -> None:
    machine = load_machine(ROOT / "machines/pps.yaml")
    travel = {j.name: j.limits.upper - j.limits.lower for j in machine.joints if j.limits}
    assert travel == pytest.approx({"lateral": 2.25, "vertical": 0.56, "longitudinal": 1.47, "yaw": np.pi,
                                    "roll": np.radians(6), "pitch": np.radians(6)}, abs=1e-4)  # fmt: skip
    assert [j.prismatic for j in machine.joints] == [True, True, True, False, False, False]
    assert len(machine.targets) == 3
    assert {xyz[1] for xyz in machine.targets.values()} == {0.01}  # 10 mm above the couch
    assert "treatment" in machine.points
    assert machine.repeatability == 1.4e-4


def test_the_measuring_frame_and_the_targets_may_be_open(tmp_path: Path) -> None:
    machine = written(tmp_path, LEAST + "tracker: {base: estimate, targets: estimate, position_sigma: 1.0e-5}\n")
    assert machine.tracker.base is None
    assert not machine.tracker.targets_known
    assert machine.tracker.position_sigma == 1e-5


def test_a_number_without_a_point_is_a_number_all_the_same(tmp_path: Path) -> None:
    """YAML 1.1 takes 2e-5 for a text; people write it."""
    assert written(tmp_path, LEAST + "tracker: {position_sigma: 2e-5}\n").tracker.position_sigma == 2e-5


def test_twelve_joints_are_allowed_and_frames_have_names(tmp_path: Path) -> None:
    joints = ", ".join(f"{{name: j{k}, type: prismatic, axis: [0, 1, 0]}}" for k in range(12))
    machine = written(tmp_path, LEAST.replace("{name: only, type: revolute, axis: [0, 0, 1]}", joints))
    assert machine.n == 12
    assert machine.frame_names == ("base", *(f"j{k}" for k in range(12)))
    assert written(tmp_path, LEAST.replace("only", "base")).frame_names == ("ground", "base")


def test_an_axis_may_be_off_unit_by_rounding_only(tmp_path: Path) -> None:
    for digits in (7, 5, 3):
        half = round(0.5**0.5, digits)
        nearly = written(tmp_path, LEAST.replace("axis: [0, 0, 1]", f"axis: [0, {half}, {half}]"))
        assert np.linalg.norm(nearly.joints[0].axis) == pytest.approx(1.0, abs=1e-15)
    with pytest.raises(MachineFileError, match="expected a unit vector"):
        written(tmp_path, LEAST.replace("axis: [0, 0, 1]", "axis: [0, 0.70, 0.71]"))


def test_a_reflector_that_is_called_tip_is_where_the_file_has_it(tmp_path: Path) -> None:
    """Else verification holds its readings against where the end effector's frame ought to be: 0.1 m off."""
    assert written(tmp_path, LEAST.replace("{P:", "{tip:")).point("tip").tolist() == [0.1, 0.0, 0.0]
    assert written(tmp_path, LEAST).point("tip").tolist() == [0.0, 0.0, 0.0]


def test_points_and_targets_and_the_tip_are_found_by_name(tmp_path: Path) -> None:
    machine = written(tmp_path, LEAST.replace("{targets: {P: [0.1, 0, 0]}}",
                                              "{targets: {P: [0.1, 0, 0]}, points: {nose: [0, 0, 2]}}"))  # fmt: skip
    assert machine.point("tip").tolist() == [0, 0, 0]
    assert machine.point("P").tolist() == [0.1, 0, 0]
    assert machine.point("nose").tolist() == [0, 0, 2]
