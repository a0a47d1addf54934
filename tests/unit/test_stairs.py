"""A joint's zero that jumped more than once: found at the visits where it did, and said so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.library import library
from ppshw.diagnosis.stairs import APART, _best_sets, stairs
from ppshw.diagnosis.wording import parameters_of, sentence
from ppshw.diagnosis.workspace import Workspace, prepare
from tests.unit.clean_case import clean_case

JUMPS = {43: 3e-4, 93: 2e-4, 133: 2.5e-4}  # visit from which on, and how far [rad]
JUMPS_WITH_LOAD = 93


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    machine, recording = clean_case(60534, "arm6", 240, 180, tmp_path_factory.mktemp("clean"))
    return prepare(machine, recording, np.ones(len(recording), dtype=bool))


@pytest.fixture(scope="module")
def slipped(clean: Workspace) -> Workspace:
    """Its third joint did; each link's error turns about its own axis through the joint, by hand."""
    machine, recording = clean.machine, clean.recording
    k = 2
    axis = np.array(machine.joints[k].axis, dtype=float)
    frame = clean.context.chain[:, k + 1]
    about = np.einsum("nij,j->ni", frame[:, :3, :3], axis)
    arms = clean.context.points - frame[:, None, :3, 3]
    turned = np.zeros(len(recording))
    for visit, angle in JUMPS.items():
        turned[visit:] += angle
    moved = np.cross(turned[:, None, None] * about[:, None], arms)
    points = recording.points + moved @ clean.base.measuring_in_base[:3, :3]
    return prepare(machine, replace(recording, points=points), clean.fit)


def test_three_jumps_are_found_at_their_visits_and_speak_louder_than_one(slipped: Workspace) -> None:
    joint, hours = slipped.machine.joint_names[2], slipped.context.hours
    found = [moments for name, moments in stairs(slipped) if name == joint]
    assert [len(moments) for moments in found] == [2, 3, 4]
    assert np.searchsorted(hours, found[1]).tolist() == list(JUMPS)
    load = np.array(slipped.recording.load)
    load[JUMPS_WITH_LOAD:] = "another"
    changed = replace(slipped, context=replace(slipped.context, recording=replace(slipped.recording, load=tuple(load))))
    without_it = [moments for name, moments in stairs(changed) if name == joint]
    assert len(without_it) == 3
    for moments in without_it:
        assert JUMPS_WITH_LOAD not in np.searchsorted(hours, moments)

    without_drift = frozenset({"drift", "periodic_transmission", "cross_coupling", "target_moved"})
    candidates = library(slipped.context, without_drift, stairs=stairs(slipped))
    tried = Tried(slipped, candidates, slipped.unit, without_drift)
    evidence = tried.evidence(tried.scores()[None])[0] + tried.log_share
    best = candidates[int(np.argmax(evidence))]
    assert (best.effect, best.joint, len(best.columns)) == ("zero_shift", joint, 3)
    ones = [j for j, k in enumerate(candidates) if k.effect == "zero_shift" and len(k.columns) == 1]
    assert evidence.max() > evidence[ones].max() + 20

    values = np.array([3e-4, -2e-4, 2.5e-4])
    said = sentence(best, values, 1e-4)
    assert "+0.300 mrad after" in said
    assert "and -0.200 mrad after" in said
    assert list(parameters_of(best, values, values)) == [
        "step", "second_step", "third_step", "time_h", "second_time_h", "third_time_h"
    ]  # fmt: skip


def test_one_wrong_visit_is_no_jump_there_and_back() -> None:
    """Steps at every visit of 60, as columns; one visit off, and a zero that jumps after another."""
    steps = np.tri(60, 60)
    data = np.zeros(60)
    data[20] = 10.0
    data[40:] += 5.0
    for chosen in _best_sets(steps.T @ data, steps.T @ steps):
        assert 40 in chosen
        assert np.diff(sorted(chosen)).min() >= APART


def test_a_machine_that_stands_still_has_no_stairs(clean: Workspace) -> None:
    recording = clean.recording
    still = replace(recording, q=np.tile(recording.q[:1], (len(recording), 1)))
    assert stairs(replace(clean, context=replace(clean.context, recording=still))) == []


def test_noise_has_no_stairs_that_are_worth_the_sets_they_were_chosen_from(clean: Workspace) -> None:
    candidates = [k for k in library(clean.context, stairs=stairs(clean)) if k.effect == "zero_shift"]
    tried = Tried(clean, candidates, clean.unit)
    evidence = tried.evidence(tried.scores()[None])[0] + tried.log_share
    many = np.array([len(k.columns) > 1 and "second_time_h" in k.shape for k in candidates])
    assert evidence[many].max() < 0
