"""Zeros and reflectors that jumped more than once: found at the visits where they did, and said so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.forms import near_forms
from ppshw.diagnosis.jumps import APART, _best_hops, _best_sets, jumps_of_reflectors, jumps_of_zeros
from ppshw.diagnosis.library import Candidate, library
from ppshw.diagnosis.library.jumps import ALL
from ppshw.diagnosis.parameters import along_its_axis, numbers_of
from ppshw.diagnosis.wording import sentence
from ppshw.diagnosis.workspace import Workspace, prepare
from tests.unit.clean_case import clean_case

JUMPS = {43: 3e-4, 93: 2e-4, 133: 2.5e-4}  # visit from which on, and how far [rad]
JUMPS_WITH_LOAD = 93
HOPS, HOP = (20, 31, 60, 64, 100, 142, 170), 2e-4  # visits, and [rad]
KNOCKS = {40: (2e-4, 0.0, 0.0), 110: (0.0, 1e-4, -2e-4)}  # of a reflector, in the end effector's axes [m]


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    machine, recording = clean_case(60534, "arm6", 240, 180, tmp_path_factory.mktemp("clean"))
    return prepare(machine, recording, np.ones(len(recording), dtype=bool))


@pytest.fixture(scope="module")
def slipped(clean: Workspace) -> Workspace:
    """Its third joint did; each link's error turns about its own axis through the joint, by hand."""
    turned = np.zeros(len(clean.recording))
    for visit, angle in JUMPS.items():
        turned[visit:] += angle
    return _turned(clean, 2, turned)


def _turned(clean: Workspace, k: int, angle: np.ndarray) -> Workspace:
    """With a joint's link turned about its axis by angle (N,) [rad]."""
    axis = np.array(clean.machine.joints[k].axis, dtype=float)
    frame = clean.context.chain[:, k + 1]
    about = np.einsum("nij,j->ni", frame[:, :3, :3], axis)
    arms = clean.context.points - frame[:, None, :3, 3]
    return _moved(clean, np.cross(angle[:, None, None] * about[:, None], arms))


def _moved(clean: Workspace, by: np.ndarray) -> Workspace:
    """With its reflectors moved by (N, T, 3) in the base [m], noise known as it is once what moved them is."""
    points = clean.recording.points + by @ clean.base.measuring_in_base[:3, :3]
    return prepare(clean.machine, replace(clean.recording, points=points), clean.fit, clean.base)


@pytest.mark.long
def test_three_jumps_are_found_at_their_visits_and_speak_louder_than_one(slipped: Workspace) -> None:
    joint, hours = slipped.machine.joint_names[2], slipped.context.hours
    found = [k.moments for k in jumps_of_zeros(slipped) if k.of == joint and not k.hops]
    assert [len(moments) for moments in found] == [2, 3, 4]
    assert np.searchsorted(hours, found[1]).tolist() == list(JUMPS)
    load = np.array(slipped.recording.load)
    load[JUMPS_WITH_LOAD:] = "another"
    changed = replace(slipped, context=replace(slipped.context, recording=replace(slipped.recording, load=tuple(load))))
    without_it = [k.moments for k in jumps_of_zeros(changed) if k.of == joint and not k.hops]
    assert len(without_it) == 3
    for moments in without_it:
        assert JUMPS_WITH_LOAD not in np.searchsorted(hours, moments)

    without_drift = frozenset({"drift", "periodic_transmission", "cross_coupling", "target_moved"})
    candidates = library(slipped.context, without_drift, jumps=jumps_of_zeros(slipped))
    tried = Tried(slipped, candidates, slipped.unit, without_drift)
    evidence = tried.evidence(tried.scores()[None])[0] + tried.log_share
    best = candidates[int(np.argmax(evidence))]
    assert (best.effect, best.joint, len(best.columns)) == ("zero_shift", joint, 3)
    ones = [j for j, k in enumerate(candidates) if k.effect == "zero_shift" and len(k.columns) == 1]
    assert evidence.max() > evidence[ones].max() + 20

    values = np.array([3e-4, -2e-4, 2.5e-4])
    said = sentence(slipped.context, best, values, 1e-4)
    assert "+0.300 mrad after" in said
    assert "and -0.200 mrad after" in said
    assert list(numbers_of(slipped.context, best, values, np.diag(values))) == [
        "step", "second_step", "third_step", "time_h", "second_time_h", "third_time_h"
    ]  # fmt: skip


def test_one_wrong_visit_is_no_jump_there_and_back() -> None:
    """Steps at every visit of 60, as columns; one visit off, and a zero that jumps after another."""
    steps = np.tri(60, 60)
    data = np.zeros(60)
    data[20] = 10.0
    data[40:] += 5.0
    for chosen in _best_sets((steps.T @ data)[:, None], (steps.T @ steps)[:, None, :, None]):
        assert 40 in chosen
        assert np.diff(sorted(chosen)).min() >= APART


def test_a_zero_that_hops_to_and_fro_is_one_amplitude_and_said_so(clean: Workspace) -> None:
    joint = clean.machine.joint_names[2]
    there = np.searchsorted(HOPS, np.arange(len(clean.recording)), side="right") % 2
    hopped = _turned(clean, 2, HOP * there)
    found = [k for k in jumps_of_zeros(hopped) if k.of == joint and k.hops]
    assert len(found) == 1
    at = np.searchsorted(hopped.context.hours, found[0].moments)
    assert np.abs(at - HOPS).max() <= 1  # where a single visit's noise may have it

    without_drift = frozenset({"drift", "periodic_transmission", "cross_coupling", "target_moved"})
    candidates = library(hopped.context, without_drift, jumps=jumps_of_zeros(hopped))
    tried = Tried(hopped, candidates, hopped.unit, without_drift)
    evidence = tried.evidence(tried.scores()[None])[0] + tried.log_share
    best = candidates[int(np.argmax(evidence))]
    assert (best.effect, best.joint, best.shape["hops"]) == ("zero_shift", joint, len(HOPS))
    value = np.array([HOP])
    c = hopped.context
    assert "zero hops between two values 0.200 mrad apart, 7 times, first after" in sentence(c, best, value, 1e-4)
    assert list(numbers_of(c, best, value, np.diag(value))) == ["step", "time_h", "hops"]


def test_noise_is_not_split_into_hops() -> None:
    """Steps at every visit of 100 under noise, and under noise with hops; none shorter than three visits."""
    rng = np.random.default_rng(3)
    steps, hops = np.tri(100), [20, 40, 43, 70]
    for seen in (0.0, 5.0):
        data = rng.standard_normal(100) + seen * (np.searchsorted(hops, np.arange(100), side="right") % 2)
        found = _best_hops(steps.T @ data, steps.T @ steps)
        assert found == ([hops] if seen else [])


def test_a_reflector_that_was_moved_twice_is_found_at_both_visits_and_said_so(clean: Workspace) -> None:
    which = clean.recording.target_names[1]
    shift = np.zeros((len(clean.recording), 3))
    for visit, far in KNOCKS.items():
        shift[visit:] += far
    by = np.zeros_like(clean.context.points)
    by[:, 1] = np.einsum("nij,nj->ni", clean.context.chain[:, -1, :3, :3], shift)
    knocked = _moved(clean, by)
    found = [k for k in jumps_of_reflectors(knocked) if k.of == which and len(k.moments) == 2]
    at = np.searchsorted(knocked.context.hours, found[0].moments)
    assert np.abs(at - list(KNOCKS)).max() <= 1  # not every visit is tried

    candidates = library(knocked.context, knocks=jumps_of_reflectors(knocked))
    candidates = [k for k in candidates if k.effect == "target_moved"]
    tried = Tried(knocked, candidates, knocked.unit)
    evidence = tried.evidence(tried.scores()[None])[0] + tried.log_share
    best = candidates[int(np.argmax(evidence))]
    assert (best.covariate, len(best.columns)) == (which, 6)
    once = [j for j, k in enumerate(candidates) if len(k.columns) == 3]
    assert evidence.max() > evidence[once].max() + 20
    values = np.array(list(KNOCKS.values())).ravel()
    said = sentence(knocked.context, best, values, 1e-4)
    assert f"reflector {which} moved by 0.200 mm after" in said
    assert " and 0.224 mm after" in said
    names = ["dx", "dy", "dz", "second_dx", "second_dy", "second_dz"]
    assert list(numbers_of(knocked.context, best, values, np.eye(6)))[:6] == names


AT, FAR, TURNED = 83, np.array([2e-4, -1e-4, 2e-4]), np.array([1e-4, 3e-4, -2e-4])  # visit, [m], [rad]
HOMED = np.array([1.5e-4, -0.4e-4, 1e-4, -4e-4, 3e-4, 2e-4])  # [rad]


def _knocked(clean: Workspace) -> Workspace:
    """The plate that carries all reflectors was."""
    tips, points = clean.context.tips, clean.context.points
    axes = tips[:, :3, :3]
    by = (axes @ FAR)[:, None] + np.cross((axes @ TURNED)[:, None], points - tips[:, None, :3, 3])
    by[:AT] = 0.0
    return _moved(clean, by)


def _told(there: Workspace) -> tuple[Candidate, float]:
    """What moved reflectors or zeros are likeliest, and how far any other is behind it."""
    candidates = [k for k in library(there.context) if k.effect in ("target_moved", "zero_shift")]
    tried = Tried(there, candidates, there.unit)
    evidence, names = tried.said()
    first, second = np.argsort(-names)[:2]
    return candidates[tried.strongest(evidence, int(first))], float(names[first] - names[second])


def test_what_carries_all_reflectors_was_knocked_and_no_joint_is_blamed_for_it(clean: Workspace) -> None:
    """It was the jumped zeros of three joints and a link that grows (one of two recordings that were made by hand)."""
    there = _knocked(clean)
    best, ahead = _told(there)
    assert (best.effect, best.joint, best.covariate) == ("target_moved", None, ALL)
    assert ahead > 5
    assert abs(np.searchsorted(there.context.hours, best.shape["time_h"]) - AT) <= 1
    values = np.array([*FAR, *TURNED])
    said = sentence(there.context, best, values, 1e-4)
    assert said.startswith("all reflectors are elsewhere from ")
    assert ", as one body, by 0.300 mm and 0.374 mrad" in said
    numbers = numbers_of(there.context, best, values, np.eye(6))
    assert (numbers["dx"]["unit"], numbers["turned_y"]["unit"]) == ("m", "rad")


@pytest.mark.long
def test_joints_that_are_homed_anew_are_all_said_and_a_single_zero_by_itself(clean: Workspace) -> None:
    """All zeros of a positioner, others by up to 0.37 mm at the reflectors, were the plate that was knocked for certain
    where only that was asked besides single joints."""
    after = (np.arange(len(clean.recording)) >= AT).astype(float)
    homed = clean
    for k, angle in enumerate(HOMED):
        homed = _turned(homed, k, angle * after)
    best, ahead = _told(homed)
    assert (best.effect, best.joint, len(best.columns)) == ("zero_shift", None, 6)
    assert ahead > 5
    values = HOMED * along_its_axis(homed.context, best)  # as columns have them, by their frames' axes
    said = sentence(homed.context, best, values, 1e-4)
    assert "the zeros of all joints jumped at once after " in said
    names = homed.machine.joint_names
    assert f"{names[3]} by -0.400 mrad, {names[4]} by +0.300 mrad and {names[5]} by +0.200 mrad" in said
    two = sentence(homed.context, best, values * [0, 0, 1, 0.01, 0, 1], 1e-4)
    assert f"the zeros of {names[2]} and {names[5]} jumped at once after " in two
    assert two.count("mrad") == 2
    numbers = numbers_of(homed.context, best, values, np.eye(6))
    assert numbers["step_of_joint_4"] == {"value": pytest.approx(-4e-4), "std": pytest.approx(1.0), "unit": "rad"}
    assert near_forms(homed.context, best) == ()
    alone, ahead = _told(_turned(clean, 5, 2e-4 * after))
    assert (alone.effect, alone.joint) == ("zero_shift", names[5])
    assert ahead > 5


def test_a_reflector_that_stands_alone_was_moved_at_a_moment_or_nobody_can_say_so(clean: Workspace) -> None:
    recording, first = clean.recording, clean.recording.target_names[:1]
    alone = replace(
        clean.context, points=clean.context.points[:, :1],
        recording=replace(recording, points=recording.points[:, :1], target_names=first),
    )  # fmt: skip
    moved = [k for k in library(alone) if k.effect == "target_moved"]
    assert moved
    assert all("time_h" in k.shape for k in moved)


def test_a_machine_that_stands_still_has_no_stairs(clean: Workspace) -> None:
    recording = clean.recording
    still = replace(recording, q=np.tile(recording.q[:1], (len(recording), 1)))
    assert jumps_of_zeros(replace(clean, context=replace(clean.context, recording=still))) == []


def test_noise_has_no_stairs_that_are_worth_the_sets_they_were_chosen_from(clean: Workspace) -> None:
    candidates = [k for k in library(clean.context, jumps=jumps_of_zeros(clean)) if k.effect == "zero_shift"]
    tried = Tried(clean, candidates, clean.unit)
    evidence = tried.evidence(tried.scores()[None])[0] + tried.log_share
    many = np.array([len(k.columns) > 1 and "second_time_h" in k.shape for k in candidates])
    assert evidence[many].max() < 0
