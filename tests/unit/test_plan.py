"""Plans: the paper's counts, limits before motion, few load changes, the same every time."""

from __future__ import annotations

import itertools
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from campaigns.plan import Plan, plan_campaign, travel_time
from campaigns.script import load_script
from drivers.axis_config import AxisConfig
from ppshw.errors import CampaignError
from ppshw.machine import Joint, Limits, Machine, load_machine

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def pps() -> Machine:
    return load_machine(ROOT / "machines/pps.yaml")


def plan(folder: Path, text: str, machine: Machine) -> Plan:
    path = folder / "trial.yaml"
    path.write_text("name: trial\n" + text, encoding="utf-8")
    return plan_campaign(load_script(path), machine)


def test_the_papers_campaign_has_63_and_606_visits(pps: Machine) -> None:
    steps = plan_campaign(load_script("paper"), pps).summary().steps
    initial = steps["initial"] + steps["initial_yaw"]
    assert initial == 63
    assert sum(steps.values()) - initial == 606
    assert steps["sweep_lateral"] == 53 * 3
    assert steps["sweep_longitudinal"] == 31 * 5


def test_the_papers_initial_cases_are_seven_with_nine_visits_each(pps: Machine) -> None:
    visits = plan_campaign(load_script("paper"), pps).visits
    cases = Counter((v.load, v.setpoints) for v in visits if v.step.startswith("initial"))
    assert list(cases.values()) == [9] * 7


def test_each_load_of_the_paper_is_put_on_once(pps: Machine) -> None:
    assert plan_campaign(load_script("paper"), pps).summary().load_changes == 4


def test_verification_measures_the_treatment_point_under_20_to_200_kg(pps: Machine) -> None:
    found = plan_campaign(load_script("verification"), pps)
    assert len(found.visits) == 110
    assert found.extra_targets == ("treatment",)
    assert found.summary().readings == 440
    masses = [found.loads[v.load].mass for v in found.visits]
    assert min(masses) >= 20
    assert max(masses) <= 200
    assert len({v.setpoints for v in found.visits}) == 110


def test_repeatability_leaves_a_pose_before_it_comes_back(pps: Machine) -> None:
    visits = plan_campaign(load_script("repeatability"), pps).visits
    assert len(visits) == 300
    assert set(Counter(v.setpoints for v in visits).values()) == {10}
    for before, visit in itertools.pairwise(visits):
        assert before.setpoints != visit.setpoints or visit.via not in (None, visit.setpoints)
    # from both sides: lateral comes up from below and down from above, either in at least a fifth of the visits
    lateral = np.array([v.setpoints[0] for v in visits])
    assert 60 <= np.count_nonzero(np.diff(lateral) > 0) <= 240


def test_a_pose_asked_for_twice_in_a_row_is_left_in_between(tmp_path: Path, pps: Machine) -> None:
    found = plan(tmp_path, "steps: [{step: a, kind: poses, poses: [{q: {yaw: 0.3}}], repeat: 3}]", pps)
    assert found.visits[0].via is None
    lower, upper = pps.limits()
    for visit in found.visits[1:]:
        assert visit.via is not None
        assert np.all((np.array(visit.via) >= lower) & (np.array(visit.via) <= upper))
        assert abs(visit.via[3] - 0.3) > 1e-4
        assert np.all(np.abs(np.array(visit.via) - visit.setpoints) <= 0.08 * (upper - lower) + 1e-12)


def test_home_is_zero_where_the_limits_allow_it(tmp_path: Path, pps: Machine) -> None:
    found = plan(tmp_path, "steps: [{step: a, kind: poses, poses: [{q: {}}]}]", pps)
    assert found.visits[0].setpoints == (0, 0, 0, 0, 0, 0)
    moved = plan(tmp_path, "home: {longitudinal: 0.7}\nsteps: [{step: a, kind: poses, poses: [{q: {}}]}]", pps)
    assert moved.visits[0].setpoints == (0, 0, 0.7, 0, 0, 0)


def test_a_setpoint_beyond_a_limit_names_line_joint_value_and_limits(tmp_path: Path, pps: Machine) -> None:
    text = "steps:\n  - step: a\n    kind: poses\n    poses:\n      - {q: {yaw: 0.3}}\n      - {q: {vertical: 0.4}}\n"
    with pytest.raises(CampaignError, match=r"trial\.yaml:7: step a: joint vertical at 0.4 m .* -0.28 … 0.28"):
        plan(tmp_path, text, pps)


def test_a_joint_or_target_that_the_machine_lacks_is_named(tmp_path: Path, pps: Machine) -> None:
    with pytest.raises(CampaignError, match="no joint 'slew' \\(there are: lateral, "):
        plan(tmp_path, "steps: [{step: a, kind: sweep, joint: slew, count: 3}]", pps)
    with pytest.raises(CampaignError, match="no target 'P9'"):
        plan(tmp_path, "targets: [P9]\nsteps: [{step: a, kind: sweep, joint: yaw, count: 3}]", pps)


def test_a_sweep_up_and_down_meets_every_position_from_both_sides(tmp_path: Path, pps: Machine) -> None:
    step = "{step: a, kind: sweep, joint: yaw, positions: [-1, 0, 1], direction: both}"
    found = plan(tmp_path, f"steps: [{step}]", pps)
    assert [v.setpoints[3] for v in found.visits] == [-1, 0, 1, 1, 0, -1]


def test_random_poses_keep_their_margin_and_volume(tmp_path: Path, pps: Machine) -> None:
    step = (
        "{step: a, kind: random, count: 40, margin: 0.1, within: {yaw: [0, 9]}, "
        "volume: {point: tip, x: [0, 2], y: [-9, 9], z: [-9, 9]}}"
    )
    q = np.array([v.setpoints for v in plan(tmp_path, f"steps: [{step}]", pps).visits])
    assert q.shape == (40, 6)
    assert np.all(np.abs(q[:, 0]) <= 0.8 * 1.125)
    assert np.all((q[:, 3] >= 0) & (q[:, 3] <= 0.8 * np.pi / 2))
    assert np.all(q[:, 0] > -0.1)  # the tip is near the yaw axis, so x of the tip is the lateral joint's


def test_reference_poses_come_back_every_so_many_visits(tmp_path: Path, pps: Machine) -> None:
    text = "reference: {every: 4, q: {}}\nsteps: [{step: a, kind: random, count: 10}]"
    assert [v.step for v in plan(tmp_path, text, pps).visits].count("reference") == 3


def test_the_same_script_and_machine_give_the_same_plan(pps: Machine) -> None:
    first, second = (plan_campaign(load_script("diagnosis"), pps) for _ in range(2))
    assert first.visits == second.visits
    assert first.digest == second.digest


def test_another_seed_gives_another_plan(tmp_path: Path, pps: Machine) -> None:
    step = "steps: [{step: a, kind: random, count: 10}]"
    assert plan(tmp_path, f"seed: 1\n{step}", pps).digest != plan(tmp_path, f"seed: 2\n{step}", pps).digest


@pytest.mark.parametrize(
    ("distance", "seconds"),
    [
        (1.0, 11.0),  # 0.1 m/s and 0.1 m/s²: 1 s up, 1 s down over 0.1 m together, 0.9 m at full speed
        (0.1, 2.0),  # just reaches full speed
        (0.025, 1.0),  # triangle: half the distance in half a second, ½·0.1·0.5² = 0.0125
        (0.0, 0.0),
    ],
)
def test_travel_takes_what_a_trapezoid_takes(distance: float, seconds: float) -> None:
    joint = Joint("x", True, np.eye(4), np.array([1.0, 0, 0]), Limits(-2, 2, 0.1, 0.1), 0.0, np.zeros(3), None)
    assert travel_time(joint, distance) == pytest.approx(seconds)
    axis = AxisConfig("x", 1, 1e5, -2, 2, velocity=0.1, acceleration=0.5, deceleration=0.1)
    assert axis.travel_time(distance) == pytest.approx(seconds)  # the driver's law, with the slower of both rates


def test_the_duration_counts_travel_settling_measuring_and_load_changes(tmp_path: Path, pps: Machine) -> None:
    text = """\
settle_s: 5
measure_s: 2
load_change_s: 100
loads: [{name: empty, mass: 0}, {name: box, mass: 10}]
steps: [{step: a, kind: poses, poses: [{q: {lateral: 1.0}, load: empty}, {q: {}, load: box}]}]
"""
    # two visits: 5 s and three targets of 2 s each; one load change; lateral 1 m there and back at 11 s each
    assert plan(tmp_path, text, pps).summary().duration_s == pytest.approx(2 * (5 + 6) + 100 + 2 * 11)


@pytest.mark.parametrize("loads", ["[box]", "[]"])
def test_a_pose_is_measured_under_its_own_load_whatever_its_step_has(tmp_path: Path, pps: Machine, loads: str) -> None:
    text = f"""
loads: [{{name: empty, mass: 0}}, {{name: box, mass: 60}}, {{name: one, random: 1, mass: [5, 9], com: {{x: [0, 0], y: [0, 0], z: [0, 0]}}}}]
steps:
  - {{step: a, kind: poses, loads: {loads}, poses: [{{q: {{}}, load: empty}}, {{q: {{yaw: 0.1}}, load: box}}, {{q: {{}}, load: one}}]}}
"""  # noqa: E501
    assert [visit.load for visit in plan(tmp_path, text, pps).visits] == ["empty", "box", "one-1"]
