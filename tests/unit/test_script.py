"""Campaign scripts: what they may say, and how they complain."""

from __future__ import annotations

from pathlib import Path

import pytest

from campaigns.plan import plan_campaign
from campaigns.script import ON_ANY_MACHINE, RandomStep, SweepStep, load_script, script_path, shipped_scripts
from ppshw.errors import CampaignError
from ppshw.machine import load_machine
from tests.contract.desk import MACHINE

GOOD = """\
name: trial
loads:
  - {name: empty, mass: 0}
  - {name: box, mass: 50, com: [0, 0.1, 0.2]}
steps:
  - {step: home, kind: poses, poses: [{q: {yaw: 0.1}}], loads: [empty], repeat: 3}
  - {step: sweep, kind: sweep, joint: yaw, count: 5, from: -1, to: 1, direction: both}
  - {step: any, kind: random, count: 4, margin: 0.1, within: {yaw: [-0.5, 0.5]}}
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "trial.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_script_is_read_with_its_steps_and_loads(tmp_path: Path) -> None:
    script = load_script(written(tmp_path, GOOD))
    assert [step.name for step in script.steps] == ["home", "sweep", "any"]
    assert script.loads[1].mass == 50.0
    assert script.steps[0].loads == ("empty",)
    assert script.steps[1].loads == ("empty", "box")
    assert isinstance(script.steps[1], SweepStep)
    assert isinstance(script.steps[2], RandomStep)
    assert script.steps[2].within == {"yaw": (-0.5, 0.5)}


@pytest.mark.parametrize(
    ("old", "new", "line", "complaint"),
    [
        ("repeat: 3", "repeets: 3", 6, "unknown key"),
        ("loads: [empty]", "loads: [full]", 6, "'full'"),
        ("count: 5", "count: 0", 7, "is 0, expected between 1"),
        ("direction: both", "direction: sideways", 7, "expected up or down or both"),
        ("count: 5, ", "", 7, "either 'positions' or 'count'"),
        ("kind: random", "kind: guess", 8, "expected poses or sweep or random"),
        ("[-0.5, 0.5]", "[0.5, -0.5]", 8, "runs from 0.5 down to -0.5"),
        ("step: any", "step: home", 8, "used twice"),
        ("mass: 50", "mass: -50", 4, "expected between 0 and 100000"),
    ],
)
def test_a_mistake_is_reported_with_file_and_line(
    tmp_path: Path, old: str, new: str, line: int, complaint: str
) -> None:
    path = written(tmp_path, GOOD.replace(old, new))
    with pytest.raises(CampaignError, match=rf"trial\.yaml:{line}: ") as caught:
        load_script(path)
    assert complaint in str(caught.value)


def test_random_loads_are_the_same_every_time_and_lie_in_their_ranges(tmp_path: Path) -> None:
    text = GOOD.replace(
        "{name: empty, mass: 0}",
        "{name: empty, random: 12, mass: [20, 200], com: {x: [-0.1, 0.1], y: [0, 0], z: [0.5, 0.6]}}",
    )
    first, second = (load_script(written(tmp_path, text)).loads for _ in range(2))
    assert first == second
    assert [load.name for load in first[:2]] == ["empty-01", "empty-02"]
    assert len(first) == 13
    for load in first[:12]:
        assert 20 <= load.mass <= 200
        assert 0.5 <= load.com[2] <= 0.6


def test_a_script_for_the_positioner_says_on_another_machine_which_go_with_any(tmp_path: Path) -> None:
    text = MACHINE.replace("P1", "A").replace("P2", "B").replace("P3", "C")
    (tmp_path / "machine.yaml").write_text(text, encoding="utf-8")
    machine = load_machine(tmp_path / "machine.yaml")
    for name in shipped_scripts():
        if name in ON_ANY_MACHINE:
            plan_campaign(load_script(name), machine)
            continue
        which = r"no (target 'P1'|joint 'lateral') .* diagnosis and quick go with any machine"
        with pytest.raises(CampaignError, match=which):
            plan_campaign(load_script(name), machine)


def test_every_shipped_script_can_be_called_by_its_name() -> None:
    assert set(shipped_scripts()) >= {"paper", "verification", "repeatability", "quick", "diagnosis"}
    for name in shipped_scripts():
        assert load_script(name).name == name


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(CampaignError, match=r"papr: no such file.*there are: .*paper"):
        script_path("papr")
