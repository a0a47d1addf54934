"""A plan corrected before the run: what would be refused on the way is refused while nothing has moved."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from campaigns.corrected import corrected_plan
from campaigns.plan import Plan, plan_campaign
from campaigns.script import load_script
from ppshw.calibration import Calibration
from ppshw.compensation import Compensator
from ppshw.errors import CampaignError
from ppshw.identification import identify
from ppshw.machine import load_machine
from ppshw.recording import load_recording
from simulators.offline import simulate_recording_csv
from simulators.plant import Load, Plant

PPS = Path(__file__).parents[2] / "machines/pps.yaml"
BOX = "loads: [{name: box, mass: 80, com: [0, 0.15, 0.3]}]\n"
HOME = "steps: [{step: home, kind: poses, poses: [{q: {}}]}]\n"


@pytest.fixture(scope="module")
def plant() -> Plant:
    return Plant.from_file(PPS, seed=1)


@pytest.fixture(scope="module")
def compensator(plant: Plant, tmp_path_factory: pytest.TempPathFactory) -> Compensator:
    csv = simulate_recording_csv(plant, tmp_path_factory.mktemp("r") / "r.csv", 120)
    machine = load_machine(PPS)
    recording = load_recording(csv, machine)
    return Compensator(Calibration.of(identify(machine, recording), recording, "joint"))


def plan(folder: Path, text: str, compensator: Compensator) -> Plan:
    (folder / "trial.yaml").write_text("name: trial\n" + text, encoding="utf-8")
    return plan_campaign(load_script(folder / "trial.yaml"), compensator.machine)


def test_a_home_at_the_end_of_a_rail_is_refused_with_step_and_visit(tmp_path: Path, compensator: Compensator) -> None:
    with pytest.raises(CampaignError, match=r"trial\.yaml:3: step home, visit 1: .*'longitudinal' -.* beyond its lim"):
        corrected_plan(plan(tmp_path, BOX + HOME, compensator), compensator)
    with pytest.raises(CampaignError, match="home_margin"):
        plan(tmp_path, "home_margin: 0.7\n" + HOME, compensator)
    kept = plan(tmp_path, "home_margin: 0.02\n" + BOX + HOME, compensator)
    assert kept.visits[0].setpoints == pytest.approx([0, 0, 0.02 * 1.47, 0, 0, 0])
    assert len(corrected_plan(kept, compensator).visits) == 1


@pytest.mark.parametrize("name", ["quick", "verification", "diagnosis"])
def test_what_comes_with_ppshw_leaves_room_for_corrections(name: str, compensator: Compensator) -> None:
    found = plan_campaign(load_script(name), compensator.machine)
    if name == "diagnosis":  # its hundreds of random poses would take seconds
        found = replace(found, visits=tuple(v for v in found.visits if v.step in ("reference", "back_1")))
    low, high = compensator.machine.limits()
    q = np.array([v.setpoints for v in corrected_plan(found, compensator).visits])
    assert ((low < q) & (q < high)).all()
    apart = np.abs(q - [v.setpoints for v in found.visits])
    assert 1e-3 < apart.max() < 0.02


def test_they_are_what_the_run_will_correct_to(tmp_path: Path, plant: Plant, compensator: Compensator) -> None:
    """By the load's wrench on the plant, which the run would measure."""
    text = BOX + "steps: [{step: some, kind: poses, poses: [{q: {longitudinal: 0.6, yaw: 0.4, pitch: 0.01}}]}]\n"
    found = plan(tmp_path, text, compensator)
    wanted = np.array(found.visits[0].setpoints)
    measured = plant.wrench(wanted, Load(80.0, np.array([0.0, 0.15, 0.3])))[0]
    corrected = compensator.for_joints(wanted, measured).corrected
    (visit,) = corrected_plan(found, compensator).visits
    assert visit.setpoints == pytest.approx(corrected, abs=2e-5)


def test_a_load_far_outside_what_was_identified_is_refused_before_it_is_put_on(
    tmp_path: Path, compensator: Compensator
) -> None:
    """Of 900 kg the farthest component is said, where the first one was."""
    heavy = BOX.replace("mass: 80", "mass: 900") + "steps: [{step: some, kind: poses, poses: [{q: {}}]}]\n"
    with pytest.raises(CampaignError, match=r"step some, visit 1: load 'box': Fy = -8825\.\d* N is far outside what"):
        corrected_plan(plan(tmp_path, "home_margin: 0.02\n" + heavy, compensator), compensator)
