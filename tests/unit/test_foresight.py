"""What a campaign would show before it is run, and the visits that tell two effects apart."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from campaigns.design.blocks import blocks
from campaigns.design.separate import (
    Separation,
    Wanted,
    _chosen,
    _followed_by,
    _Pair,
    _shown,
    _State,
    _worth,
    separate,
)
from campaigns.foresight import Foresight, foresee, would_be
from campaigns.plan import Plan, plan_campaign
from campaigns.script import EMPTY, LOAD_CHANGE_S, load_script
from ppshw.errors import CampaignError
from ppshw.machine import Elastic, Machine, load_machine
from ppshw.recording import Recording, load_recording
from simulators.concealed.case import make_case
from tests.unit.small_campaign import RANDOM, planned, positioner

SWEEPS = """name: sweeps
seed: 3
order: as_written
loads: [{name: box, mass: 100, com: [0, 0.15, 0.3]}]
steps:
  - {step: a, kind: sweep, joint: lateral, count: 25, direction: up}
  - {step: b, kind: sweep, joint: longitudinal, count: 25, direction: up}
  - {step: c, kind: sweep, joint: yaw, count: 25, direction: both}
"""


@pytest.fixture(scope="module")
def machine() -> Machine:
    return positioner()


@pytest.fixture(scope="module")
def sweeps(machine: Machine, tmp_path_factory: pytest.TempPathFactory) -> Plan:
    return planned(SWEEPS, machine, tmp_path_factory.mktemp("sweeps"))


@pytest.fixture(scope="module")
def seen(sweeps: Plan) -> Foresight:
    return foresee(sweeps)


def shares(foresight: Foresight, effect: str) -> dict[str | None, float]:
    return {row["joint"]: row["share"] for row in foresight.rows if row["effect"] == effect}


def test_one_joint_sweeps_are_blind_to_cross_joint_errors_and_random_poses_are_not(
    seen: Foresight, machine: Machine, tmp_path: Path
) -> None:
    assert max(shares(seen, "cross_coupling").values()) < 0.01  # blind to it
    anywhere = foresee(planned(RANDOM, machine, tmp_path))
    assert min(shares(anywhere, "cross_coupling").values()) > 0.1  # 11 % there
    assert any(line.startswith("  cross_coupling of ") and "add random poses" in line for line in seen.warnings())
    assert not any("cross_coupling" in line for line in anywhere.warnings())


@pytest.mark.long
def test_a_link_that_gives_way_to_no_load_at_all_is_foreseen_too(machine: Machine, tmp_path: Path) -> None:
    """`elastic: {loads: []}` was a division by zero."""
    stiff = replace(machine, joints=(replace(machine.joints[0], elastic=Elastic((), False)), *machine.joints[1:]))
    assert foresee(planned(SWEEPS, stiff, tmp_path)).rows


def test_a_single_load_shows_neither_creep_nor_clearance_nor_nonlinear_stiffness(seen: Foresight) -> None:
    blind = {row["effect"] for row in seen.rows if row["blind"]}
    assert {"creep", "clearance", "nonlinear_stiffness"} <= blind
    assert len(seen.warnings()) <= 8


@pytest.mark.long
def test_a_joint_that_comes_from_one_side_only_shows_no_backlash(machine: Machine, tmp_path: Path) -> None:
    low, _ = machine.limits()
    text = f"""name: up
order: as_written
home: {{lateral: {low[0]}}}
steps:
  - {{step: a, kind: sweep, joint: lateral, count: 40, direction: DIRECTION}}
"""
    up = foresee(planned(text.replace("DIRECTION", "up"), machine, tmp_path))
    both = foresee(planned(text.replace("DIRECTION", "both"), machine, tmp_path))
    rows = [next(r for r in f.rows if (r["effect"], r["joint"]) == ("backlash", "lateral")) for f in (up, both)]
    assert [row["blind"] for row in rows] == [True, False]
    assert (rows[0]["detectable_mm"], rows[0]["share"]) == (None, 0.0)  # none came from above
    assert rows[1]["detectable_mm"] > 0.0
    assert shares(up, "backlash")["yaw"] == 0.0  # never moved
    assert shares(both, "backlash")["lateral"] > 0.5  # every position from both sides: nothing else does that


def test_a_would_be_recording_has_the_plan_s_order_times_loads_and_directions(sweeps: Plan, machine: Machine) -> None:
    r = would_be(sweeps)
    assert len(r) == 100  # the last sweep there and back
    assert r.time[-1] == pytest.approx(sum(sweeps.durations))
    up = np.array(r.step) == "a"
    assert (r.approach[up][1:, 0] == 1).all()
    back = r.approach[-24:, machine.joint_names.index("yaw")]
    assert (back == -1).all()
    # 100 kg pull with 980.665 N, whatever the pose
    assert np.linalg.norm(r.wrench[:, :3], axis=1) == pytest.approx(980.665)


def test_the_diagnosis_campaign_misses_nothing_that_a_campaign_on_the_positioner_could_show(machine: Machine) -> None:
    plan = plan_campaign(load_script("diagnosis"), machine)
    found = foresee(plan)  # as `ppshw plan` asks
    blind = {(r["effect"], r["joint"]) for r in found.rows if r["blind"]}
    assert blind <= found.never
    # own weight behind rails, and a floor that gives way: docs/campaigns.md's table of what no campaign shows
    assert {("moving_weight", "lateral"), ("missing_compliance", None)} <= found.never
    assert len(found.warnings()) == 2
    assert "that a campaign can show" in found.warnings()[0]
    assert "moving_weight of lateral" in found.warnings()[1]


def test_the_diagnosis_campaign_turns_back_within_a_hundredth_of_every_travel(machine: Machine) -> None:
    visits = plan_campaign(load_script("diagnosis"), machine).visits
    low, high = machine.limits()
    q = (np.array([v.setpoints for v in visits]) - low) / (high - low)
    moves = np.diff(q, axis=0)
    for joint in range(machine.n):
        alone = np.isclose(np.delete(moves, joint, axis=1), 0.0).all(axis=1)
        small = moves[alone, joint]
        assert ((np.abs(small) < 0.011) & (np.abs(small) > 0)).sum() >= 2
        assert (np.diff(np.sign(small)) != 0).sum() >= 3


@pytest.mark.long
def test_what_the_noise_hides_is_not_laid_on_constants_and_compliances(machine: Machine, tmp_path: Path) -> None:
    """A tracker of three millimetres: of backlash the base model leaves more than half, and nobody sees it."""
    coarse = replace(machine, tracker=replace(machine.tracker, position_sigma=3e-3))
    found = foresee(planned(RANDOM, coarse, tmp_path))
    assert ("backlash", "lateral") in found.noisy
    assert ("moving_weight", "lateral") in found.never - found.noisy
    lines = "\n".join(found.warnings())
    assert "sees every" not in lines
    assert "the noise hides backlash of " in lines
    taken = next(line for line in found.warnings() if "constants and compliances take them" in line)
    assert "backlash" not in taken
    assert "moving_weight of lateral" in taken


@pytest.mark.long
def test_a_short_campaign_is_told_to_hold_its_loads(machine: Machine, tmp_path: Path) -> None:
    """Creep shows to who waits; it was said that no campaign shows it, because 450 visits of an hour do not."""
    found = foresee(planned(RANDOM, machine, tmp_path))
    assert ("creep", "yaw") not in found.never


def test_what_no_campaign_shows_is_not_asked_for(seen: Foresight) -> None:
    asked = "\n".join(line for line in seen.warnings() if ": add " in line)
    assert "moving_weight of lateral" not in asked
    assert "cross_coupling" in asked


def test_visits_that_separate_two_effects_raise_what_tells_them_apart(
    machine: Machine, sweeps: Plan, tmp_path: Path
) -> None:
    found: Separation = separate(
        Wanted(machine, ("backlash", "friction_hysteresis"), "vertical", sweeps, 15, 1, "next", "a test")
    )
    assert all(r["after"] > r["before"] for r in found.rows)
    assert any("turns back" in block.what for block in found.blocks)  # small reversals: docs/diagnosis.md §5
    plan = planned(found.text, machine, tmp_path)
    wanted = np.concatenate([block.q for block in found.blocks])
    assert np.array([v.setpoints for v in plan.visits]) == pytest.approx(wanted, abs=1e-4)  # in the order chosen
    assert len(plan.visits) <= 15


@pytest.mark.long
def test_what_happens_at_a_moment_happened_in_the_visits_so_far(machine: Machine, sweeps: Plan) -> None:
    """Jumps were put at moments over all that might be measured as well: seven of eight after the last visit, √λ 0.0
    before and after for every joint (a reviewer's)."""
    found = separate(Wanted(machine, ("zero_shift", "drift"), "lateral", sweeps, 8, 1, "next", "a test"))
    jumps = [r["before"] for r in found.rows if r["effect"] == "zero_shift"]
    assert jumps
    assert min(jumps) > 1.0


@pytest.mark.long
def test_where_no_visits_are_written_it_is_said_whether_none_are_needed_or_none_help(
    machine: Machine, sweeps: Plan
) -> None:
    effects = ("backlash", "friction_hysteresis")
    found = separate(Wanted(machine, effects, "vertical", sweeps, 2, 1, "next", "a test"))  # no block is as short
    assert not found.blocks
    assert found.why_none().startswith("not told apart, and none of the visits tried would help")
    assert all(0 <= r["nearest"] <= r["before"] + 0.1 for r in found.rows)
    apart = replace(found, rows=[{**r, "before": 6.1, "after": 6.1, "nearest": 1.26} for r in found.rows])
    said = "middling forms are told apart already (√λ of 6 is enough)"
    assert apart.why_none() == f"{said}; the forms most alike stay so (√λ 1.3): nothing written"
    apart = replace(found, rows=[{**r, "nearest": 6.1} for r in apart.rows])
    assert apart.why_none() == f"{said}: nothing written"


@pytest.mark.long
def test_what_may_be_measured_next_goes_on_in_all_columns_of_a_recording(machine: Machine, sweeps: Plan) -> None:
    """Ages of loads, which every run writes, and columns of other kinds had the command fall over (a reviewer's)."""
    before = would_be(sweeps)
    pressure = np.linspace(1007.0, 1009.0, len(before))
    measured = before.points + np.random.default_rng(1).normal(scale=5e-5, size=before.points.shape)
    ages = np.arange(1.0, len(before) + 1)
    recording = replace(before, points=measured, load_age_s=ages, covariates={"pressure": pressure})
    wanted = Wanted(machine, ("tracker_scale", "drift"), None, recording, 4, 1, "next", "a test")
    block = blocks(machine, [EMPTY], [1], 1)[0]
    after = _followed_by(recording, [block], machine)
    for field in fields(Recording):
        column = getattr(recording, field.name)
        if hasattr(column, "__len__") and len(column) == len(recording):
            assert len(getattr(after, field.name)) == len(recording) + len(block.q), field.name
    assert after.covariates["pressure"].tolist() == [*pressure, *[1009.0] * len(block.q)]
    assert after.load_age_s is not None
    assert np.isnan(after.load_age_s[len(recording) :]).all()
    assert {r["effect"] for r in separate(wanted).rows} == {"tracker_scale", "drift"}


def test_a_load_that_still_hangs_there_takes_its_time_to_be_taken_off(machine: Machine, sweeps: Plan) -> None:
    """Creep of a load that went before the first of the next visits was there seconds after the last one (a
    reviewer's)."""
    ended, (block, *_) = would_be(sweeps), blocks(machine, [EMPTY], [1], 1)
    apart = []
    for load in ("empty", "box"):
        recording = replace(ended, load=(*ended.load[:-1], load))
        time = _followed_by(recording, [block, block], machine).time[len(recording) - 1 :]
        apart.append(np.diff(time)[[0, len(block.q)]])
    np.testing.assert_allclose(apart[1] - apart[0], [LOAD_CHANGE_S, 0.0], atol=1e-3)


@pytest.mark.long
def test_where_a_recording_shows_an_effect_it_is_that_form_which_is_told_from_the_other(tmp_path: Path) -> None:
    """Middling forms were told apart, and nothing was written, in five of six recordings of a reviewer's whose own were
    not."""
    make_case(4, "pps", "friction_hysteresis", 2.0, tmp_path / "case", tmp_path / "sealed", 150, 150)
    (truth,) = json.loads((tmp_path / "sealed" / "truth.json").read_text())["effects"]
    slipping = load_machine(tmp_path / "case" / "machine.yaml")
    recording = load_recording(tmp_path / "case" / "recording.csv", slipping)
    names = ("backlash", "friction_hysteresis")
    found = separate(Wanted(slipping, names, None, recording, 12, 1, "next", "a test"))
    assert {(r["joint"], r["for_joint"]) for r in found.rows} == {(truth["joint"], truth["joint"])}
    assert len(found.rows) == 2  # both ways round
    assert all("as found" in line for line in found.lines()[:2])
    assert all(r["nearest"] == r["before"] <= r["after"] for r in found.rows)
    here = Wanted(slipping, ("drift", names[1]), truth["joint"], recording, 12, 1, "next", "a test")
    assert set(_shown(here, recording)) == {("drift", None), (names[1], truth["joint"])}  # of the base, wherever asked
    assert _shown(replace(here, effects=("gremlins", names[1])), recording) == {}
    apart = replace(found, blocks=(), rows=[{**r, "before": 6.1, "nearest": 6.1} for r in found.rows])
    assert apart.why_none() == "they are told apart already (√λ of 6 is enough): nothing written"


def test_more_of_what_is_told_apart_already_is_no_help() -> None:
    """Thirty visits were written that raised 30.1 to 31.4 and left the 5.4 beside it as it was."""

    none = np.zeros(0, dtype=np.int64)
    told, lacking = (_Pair(("drift", None), ("zero_shift", "yaw"), np.eye(2)[k : k + 1], none) for k in (0, 1))

    def worth(one: float, other: float) -> float:
        return _worth([told, lacking], np.diag([one**2, other**2]))

    assert worth(30.1, 5.4) == worth(31.4, 5.4)
    assert worth(30.1, 5.5) > worth(31.4, 5.4)


@dataclass
class Visits:
    """What the choice asks of a block."""

    q: NDArray[np.float64]
    minutes: float

    def seconds(self, machine: Machine) -> NDArray[np.float64]:
        return np.full(len(self.q), 60.0 * self.minutes / len(self.q))


def test_where_visits_are_short_they_are_chosen_for_what_each_of_them_tells_and_none_is_needless(
    machine: Machine,
) -> None:
    """Cheap reversals of joints that nobody had asked for filled the thirty visits (a reviewer's: √λ 4.1 to 4.2)."""
    pair = _Pair(("drift", None), ("creep", None), np.eye(1), np.zeros(0, dtype=np.int64))
    state = _State(np.eye(1), np.zeros((1, 1)), np.array([[1.0]]))
    offered = [Visits(np.zeros((5, 1)), minutes) for minutes in (1.0, 1.0, 30.0)]
    rows = [(np.zeros((1, 1)), np.array([[gain]])) for gain in (0.8, 0.05, 2.5)]
    assert _chosen(state, offered, rows, [pair], 5, machine) == [2]  # type: ignore[arg-type]
    assert sorted(_chosen(state, offered, rows, [pair], 10, machine)) == [0, 2]  # type: ignore[arg-type]
    assert sorted(_chosen(state, offered, rows, [pair], 99, machine)) == [0, 2]  # type: ignore[arg-type]
    assert _chosen(state, offered[:2], rows[1:2] * 2, [pair], 99, machine) == []  # type: ignore[arg-type]


def test_an_effect_that_does_not_exist_cannot_be_separated(machine: Machine, sweeps: Plan) -> None:
    with pytest.raises(CampaignError, match="gremlins"):
        separate(Wanted(machine, ("backlash", "gremlins"), None, sweeps, None, 1, "next", "a test"))
