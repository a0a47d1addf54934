"""Names against rivals without one, on what a positioner measured with a displacement put in by hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from ppshw.diagnosis import standing, weights
from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.forms import WIDEST_SIDE, near_forms
from ppshw.diagnosis.found import Found
from ppshw.diagnosis.library import Candidate, library
from ppshw.diagnosis.library.by_load import FALLS_AT
from ppshw.diagnosis.library.sampled import own_component
from ppshw.diagnosis.nameless import nameless
from ppshw.diagnosis.search import _best as best_beside
from ppshw.diagnosis.search import search
from ppshw.diagnosis.shadows import SHADOW, caster_of
from ppshw.diagnosis.weights import MAY_BE_PLAY, OUTSIDE, _soft_walls
from ppshw.diagnosis.wording import finding, parameters_of, stand_ins
from ppshw.diagnosis.workspace import Workspace, prepare
from ppshw.terms import COMPONENTS
from ppshw.terms.shapes import Column
from tests.unit.clean_case import clean_case

NAME = "pitch"  # whose travel is short


@pytest.fixture(scope="module")
def space(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    machine, recording = clean_case(60533, "pps", 240, 180, tmp_path_factory.mktemp("clean"))
    return prepare(machine, recording, np.ones(len(recording), dtype=bool))


def _on_the_joint(space: Workspace, function: str, **args: object) -> Column:
    k = space.machine.joint_names.index(NAME)
    return Column("frame", function, {"joint": k, **args}, k + 1, own_component(space.context, k))


def _travel(space: Workspace) -> float:
    return float(np.ptp(space.recording.q[:, space.machine.joint_names.index(NAME)]))


def _with(space: Workspace, column: Column, times: float) -> Workspace:
    """The same recording of a machine whose joint does this as well, so many repeatabilities rms at the reflectors."""
    moved = column.evaluate(space.context)
    moved *= times * 5e-5 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    return replace(space, data=space.data + moved)


_CANDIDATES: dict[int, list[Candidate]] = {}  # of a context, which all workspaces of a recording share


def _named(space: Workspace, *effects: str) -> list[Candidate]:
    """Candidates of some effects, or without a name."""
    every = _CANDIDATES.setdefault(id(space.context), [])
    every += [] if every else library(space.context) + nameless(space.context)
    return [k for k in every if k.effect in effects]


def _creep_and_riddles(space: Workspace) -> list[Candidate]:
    """Of one joint's own component: few, for what only asks who is who."""
    creeping = [k for k in _named(space, "creep") if k.joint == NAME and k.component]
    place = creeping[0].frame, creeping[0].component
    return creeping + [k for k in _named(space, "nameless") if (k.frame, k.component) == place]


def _search(space: Workspace, effects: Sequence[str], about: str = "") -> tuple[list[Found], Tried]:
    """about: a joint that rivals without a name sit at or speak of; all of them by default."""
    rivals = [k for k in _named(space, "nameless") if k.frame == about or any(about in name for name in k.covariates)]
    some = _named(space, *effects) + rivals
    tried = Tried(space, some, 5e-5)
    return search(space, tried, np.random.default_rng(0)), tried


def _best(tried: Tried, found: Found) -> Candidate:
    return tried.candidates[found.best]


def test_play_is_not_called_friction_where_play_is_not_in_the_library(space: Workspace) -> None:
    found, tried = _search(_with(space, _on_the_joint(space, "approach"), 3.0), ["friction_hysteresis"], NAME)
    assert [f.name for f in found] == [("nameless", None)]
    assert _best(tried, found[0]).covariates[0] == f"approach_{NAME}"
    found, _ = _search(_with(space, _on_the_joint(space, "approach"), 3.0), ["friction_hysteresis", "backlash"], NAME)
    assert [f.name for f in found] == [("backlash", NAME)]


def test_a_gap_is_said_as_if_all_of_it_were_play(space: Workspace) -> None:
    """Near forms that are the same or its opposite do not share it, nor make it vague."""
    there = _with(space, _on_the_joint(space, "approach"), 2.0)
    found, tried = _search(there, ["friction_hysteresis", "backlash"], NAME)
    moved = _on_the_joint(space, "approach").evaluate(space.context)
    half = 2.0 * 5e-5 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    gap = finding(there, tried, found[0])["parameters"]["gap"]
    assert gap["std"] < 0.1 * 2 * half
    assert gap["value"] == pytest.approx(-2 * half, abs=3 * gap["std"])


def test_friction_keeps_its_name_and_never_all_of_the_weight(space: Workspace) -> None:
    width = 0.15 * _travel(space)
    there = _with(space, _on_the_joint(space, "slipping", width=width), 3.0)
    found, tried = _search(there, ["friction_hysteresis", "backlash"], NAME)
    assert [f.name for f in found] == [("friction_hysteresis", NAME)]
    weights = found[0].weights
    assert sum(weights.values()) == pytest.approx(1.0, abs=0.01)
    assert weights["nameless", None] >= 0.99 * OUTSIDE
    assert weights["friction_hysteresis", NAME] > 0.85
    assert _best(tried, found[0]).shape["width"] == pytest.approx(width)


def test_friction_of_a_joint_that_goes_a_little_past_where_it_comes_back_to_is_friction(space: Workspace) -> None:
    """It has not taken up what it lost when it stands: near to no lag there, and no play."""
    k, recording = space.machine.joint_names.index(NAME), space.recording
    approach = recording.approach.copy()
    approach[::4, k] *= -1  # a quarter of the visits, from the other side than the way from the last one says
    turned = replace(space, context=replace(space.context, recording=replace(recording, approach=approach)))
    width, past = 0.15 * _travel(space), 0.03 * _travel(space)
    there = _with(turned, _on_the_joint(turned, "slipping", width=width, past=past), 3.0)
    some = [each for each in library(turned.context) if each.effect in ("friction_hysteresis", "backlash")]
    tried = Tried(there, some, 5e-5)
    evidence = tried.evidence(tried.scores()[None])[0] + tried.log_share
    best = some[int(np.argmax(evidence))]
    assert (best.effect, best.joint) == ("friction_hysteresis", NAME)
    assert 0.5 * past < best.shape["past"] < 2 * past
    far = [j for j, each in enumerate(some) if "past" not in each.shape]
    assert evidence.max() > evidence[far].max() + 20
    assert all(column.args["past"] == best.shape["past"] for column in near_forms(turned.context, best)[:10])
    assert not any("past" in each.shape for each in library(space.context))  # where no joint did so


def test_friction_that_grows_with_the_load_says_by_how_much(space: Workspace) -> None:
    k = space.machine.joint_names.index(NAME)
    width, weight = 0.15 * _travel(space), np.linalg.norm(space.context.wrenches[:, k + 1, :3], axis=1)
    lag = _on_the_joint(space, "slipping", width=width)
    moved = lag.evaluate(space.context) * (weight / weight.mean())[:, None]  # Coulomb's, by hand
    moved *= 4 * 5e-5 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    there = replace(space, data=space.data + moved)
    found, tried = _search(there, ["friction_hysteresis", "backlash"], NAME)
    assert [f.name for f in found] == [("friction_hysteresis", NAME)]
    said = finding(there, tried, found[0])["parameters"]
    assert list(said)[:2] == ["lag", "added_at_twice_the_load"]
    ratio = said["added_at_twice_the_load"]["value"] / said["lag"]["value"]
    assert ratio == pytest.approx(1.0, abs=0.3)


def test_friction_that_costs_much_of_the_way_may_be_play_between_soft_walls(space: Workspace) -> None:
    """What it loses is more than an eighth of the way over which it builds up."""
    width = 0.02 * _travel(space)
    there = _with(space, _on_the_joint(space, "slipping", width=width), 6.0)
    found, _ = _search(there, ["friction_hysteresis", "backlash"], NAME)
    name, play = ("friction_hysteresis", NAME), ("backlash", NAME)
    assert found[0].name == name
    assert found[0].weights[play] == pytest.approx(MAY_BE_PLAY * found[0].weights[name], rel=1e-6)


@pytest.mark.parametrize("form", [("slipping", "width"), ("winding", "way")])
def test_what_is_taken_up_within_a_hundredth_of_the_travel_is_play_between_soft_walls(
    space: Workspace, form: tuple[str, str]
) -> None:
    function, how = form
    there = _with(space, _on_the_joint(space, function, **{how: 0.004 * _travel(space)}), 3.0)
    found, tried = _search(there, ["friction_hysteresis", "backlash"], NAME)
    assert [f.name for f in found] == [("backlash", NAME)]
    assert _best(tried, found[0]).shape["width"] == pytest.approx(0.005 * _travel(space))
    assert {"gap", "width"} <= set(finding(there, tried, found[0])["parameters"])


def test_what_is_taken_up_over_far_more_than_could_be_lost_is_no_play(space: Workspace) -> None:
    """Walls of rubber give way by some gaps; a hundredth of a rail's travel is hundreds of them."""
    k = space.machine.joint_names.index("longitudinal")
    travel = float(np.ptp(space.recording.q[:, k]))
    column = Column("frame", "winding", {"joint": k, "way": 0.01 * travel}, k + 1, own_component(space.context, k))
    precise = replace(space.machine, repeatability=5e-6)
    for machine, name in ((replace(precise, repeatability=1e-3), "backlash"), (precise, "friction_hysteresis")):
        there = _with(replace(space, machine=machine, context=replace(space.context, machine=machine)), column, 3.0)
        some = [c for c in library(there.context) if c.effect in ("backlash", "friction_hysteresis")]
        tried = Tried(there, some + _named(space, "nameless")[:1], 5e-5)
        found = search(there, tried, np.random.default_rng(0))
        assert [f.name for f in found] == [(name, "longitudinal")]
        assert _best(tried, found[0]).shape.get("width", 0.0) <= 0.0101 * travel


@pytest.mark.parametrize(("unsure", "may_be"), [(0.0, False), (0.05, True)])
def test_a_loss_that_is_not_sure_may_be_larger(
    space: Workspace, monkeypatch: pytest.MonkeyPatch, unsure: float, may_be: bool
) -> None:
    width = 0.04 * _travel(space)
    slipping = _with(space, _on_the_joint(space, "slipping", width=width), 3.0)
    found, tried = _search(slipping, ["friction_hysteresis"], NAME)
    tried.names.append(("backlash", NAME))
    lag = np.array([0.05 * width]), np.array([unsure * width]), 0.0
    monkeypatch.setattr(weights, "coefficients", lambda *_: lag)
    found[0].weights = {found[0].name: 0.95}
    _soft_walls(space, tried, found[0])
    assert (("backlash", NAME) in found[0].weights) == may_be


def test_a_name_beside_a_riddle_in_the_same_component_is_none(space: Workspace) -> None:
    """Friction keeps its name while what nobody knows goes on elsewhere."""
    both = _with(space, _on_the_joint(space, "slipping", width=0.15 * _travel(space)), 3.0)
    swells = {"name": "cov_humidity", "knot": 2, "count": 5}
    k = space.machine.joint_names.index(NAME)
    elsewhere = _with(both, Column("frame", "covariate", swells, 1, 0), 3.0)
    found, _ = _search(elsewhere, ["friction_hysteresis"])
    assert {f.name for f in found} == {("friction_hysteresis", NAME), ("nameless", None)}
    there = _with(both, Column("frame", "covariate", swells, k + 1, own_component(space.context, k)), 3.0)
    found, tried = _search(there, ["friction_hysteresis"])
    assert {f.name for f in found} == {("nameless", None)}
    assert any("cov_humidity" in covariate for f in found for covariate in _best(tried, f).covariates)


@pytest.mark.parametrize(("share", "beside"), [(0.05, False), (0.2, True)])
def test_a_riddle_ten_times_more_quiet_costs_no_name(space: Workspace, share: float, beside: bool) -> None:
    """It is what the named form leaves, however large its size came out."""
    some = _creep_and_riddles(space)
    there = next(j for j, k in enumerate(some) if k.effect == "nameless")
    tried = Tried(space, some, 5e-5)
    named = Found(0, ("creep", NAME), 0.0, 160.0, size=5e-5, first=160.0)
    riddle = Found(there, ("nameless", None), 0.0, 160.0 * share, size=4e-5, first=160.0 * share)
    assert standing._beside_a_riddle(tried, named, [riddle]) is beside
    riddle.size = 2e-5  # less than half as large
    assert not standing._beside_a_riddle(tried, named, [riddle])


@pytest.mark.parametrize(
    ("rival", "own", "with_all", "stands"),
    [
        (100.0, 100.7, 105.9, False), (100.0, 100.9, 0.0, True), (100.0, 91.0, 106.1, True),
        (100.0, 91.0, 100.9, False), (100.0, 89.0, 106.1, False),
        (2000.0, 1998.0, 0.0, True), (2000.0, 1996.0, 0.0, False),
    ],
)  # fmt: skip
def test_a_name_stands_by_its_own_form_or_well_ahead_by_all_it_may_be_like(
    space: Workspace, monkeypatch: pytest.MonkeyPatch, rival: float, own: float, with_all: float, stands: bool
) -> None:
    """By its own form a step ahead of the best rival without a name, less a five-hundredth of what it says; or by its
    near forms six ahead, where its own says nine tenths as much as the rival."""
    some = _creep_and_riddles(space)
    tried = Tried(space, some, 5e-5)
    without = np.array([k.effect == "nameless" for k in some])
    evidence = np.where(without, rival, own)
    evidence -= math.log(sum(math.exp(share) for share in tried.log_share[without]))
    monkeypatch.setattr(standing, "_by_itself", lambda *_: (own, with_all, evidence))
    found = [Found(0, ("creep", NAME), 0.0, 160.0, first=160.0)]
    standing.give_up(space, tried, found)
    space.forget()
    assert [f.name[0] for f in found] == ["creep" if stands else "nameless"]


@pytest.mark.parametrize(
    ("effect", "own", "stands"),
    [("zero_shift", 14.0, False), ("zero_shift", 15.0, True), ("creep", 24.0, False), ("creep", 26.0, True)],
)
def test_a_name_that_goes_with_time_alone_is_left_of_a_riddle_ten_times_as_loud_and_a_quiet_one_of_any_louder(
    space: Workspace, monkeypatch: pytest.MonkeyPatch, effect: str, own: float, stands: bool
) -> None:
    """Rivals without a name say 100 after their handicap, 143 before it."""
    some = [k for k in _named(space, effect) if k.joint == NAME][:1] + [
        k for k in _named(space, "nameless") if k.covariates[:1] == (f"approach_{NAME}",)
    ]  # fmt: skip
    tried = Tried(space, some, 5e-5)
    said = {"nameless": 100.0, effect: own}
    monkeypatch.setattr(standing, "_by_itself", lambda _, __, f, ___: (said[f.name[0]], 200.0, None))
    found = [Found(0, (effect, NAME), 0.0, own, first=own), Found(1, ("nameless", None), 0.0, 100.0, first=100.0)]
    standing.drop_what_riddles_leave(space, tried, found)
    space.forget()
    assert [f.name[0] for f in found] == ([effect] if stands else []) + ["nameless"]


def test_a_jump_of_another_joint_at_another_moment_is_not_what_a_jump_left(
    space: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the next finding the name that is found already is preferred, where it explains more than half as much: not
    for what happened at another moment."""
    some = _named(space, "zero_shift", "drift")
    tried = Tried(space, some, 5e-5)
    jumps = [j for j, k in enumerate(some) if k.effect == "zero_shift"]
    first = next(j for j in jumps if some[j].joint == "roll")
    elsewhere = [j for j in jumps if some[j].joint == "lateral"]
    at_once = next(j for j in elsewhere if some[j].shape["time_h"] == some[first].shape["time_h"])
    later = next(j for j in elsewhere if some[j].shape["time_h"] > some[first].shape["time_h"] + 1.0)
    slow = next(j for j, k in enumerate(some) if k.effect == "drift")
    found = [Found(first, ("zero_shift", "roll"), 0.0, 100.0, first=100.0)]
    for again, wanted in ((at_once, at_once), (later, slow)):
        evidence = np.where(np.isin(np.arange(len(some)), [again, slow]), 50.0, -50.0)
        names = np.array([{("drift", None): 62.0, ("zero_shift", "lateral"): 55.0}.get(n, -9.0) for n in tried.names])
        monkeypatch.setattr(tried, "said", lambda said=(evidence, names): said)
        assert best_beside(tried, found)[0] == wanted


def test_what_has_no_name_draws_no_other_place_to_itself(space: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """A name is not given up for a function without one, because another stands elsewhere already."""
    some = _creep_and_riddles(space) + [k for k in _named(space, "nameless") if k.frame == "lateral"]
    tried = Tried(space, some, 5e-5)
    there = next(j for j, k in enumerate(some) if k.covariates[:1] == (f"approach_{NAME}",) and k.frame == NAME)
    elsewhere = next(j for j, k in enumerate(some) if k.covariates == ("cov_humidity",) and k.frame == "lateral")
    found = [Found(elsewhere, ("nameless", None), 0.0, 100.0, first=100.0)]
    names = np.array([20.0 if name[0] == "creep" else 11.0 for name in tried.names])
    for again, wanted in ((there, "creep"), (elsewhere, "nameless")):
        evidence = np.where(np.arange(len(some)) == again, 15.0, -50.0)
        monkeypatch.setattr(tried, "said", lambda said=(evidence, names): said)
        assert some[best_beside(tried, found)[0]].effect == wanted


def test_what_a_link_does_with_the_air_and_another_joint_s_position_has_no_name(space: Workspace) -> None:
    k, other = (space.machine.joint_names.index(name) for name in ("vertical", "yaw"))
    air, q = space.recording.temperatures["air"], space.recording.q[:, other]
    moved = space.context.jacobian[:, :, k + 1, 0] * ((air - air.mean()) * (q - q.mean()))[:, None]
    moved *= 2e-4 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    found, tried = _search(replace(space, data=space.data + moved), ["thermal_growth", "wrench_error", "tracker_scale"])
    assert {f.name for f in found} == {("nameless", None)}
    assert set(_best(tried, found[0]).covariates) >= {"q_yaw"}


def test_a_screw_s_wave_without_its_name_is_unexplained_over_its_joint(space: Workspace) -> None:
    k = space.machine.joint_names.index("longitudinal")
    period = float(np.ptp(space.recording.q[:, k])) / 44.3
    own = own_component(space.context, k)
    wave = Column("frame", "wave", {"joint": k, "period": period, "phase": "sin"}, k + 1, own)
    found, tried = _search(_with(space, wave, 2.0), ["cross_coupling", "friction_hysteresis"])
    assert [f.name for f in found] == [("nameless", None)]
    assert _best(tried, found[0]).covariates == ("q_longitudinal",)
    assert 0.8e-4 < found[0].size < 1.2e-4


def test_creep_may_have_a_fast_and_a_slow_rate_and_says_both(space: Workspace) -> None:
    k = space.machine.joint_names.index("longitudinal") + 1
    where = {"frame": k, "component": 3, "form": "total"}
    fast, slow = (Column("frame", "creeping", {**where, "tau": tau}, k, 3) for tau in (0.1, 0.8))
    found, tried = _search(_with(_with(space, fast, 6.0), slow, 6.0), ["creep", "nonlinear_stiffness"])
    assert found[0].name == ("creep", "longitudinal")
    candidate = _best(tried, found[0])
    said = parameters_of(candidate, np.array([1e-9, 2e-9]), np.array([1e-10, 1e-10]))
    assert [said[name]["value"] for name in ("tau_h", "slow_tau_h")] == [0.1, 0.8]
    assert (said["slow_compliance"]["value"], said["slow_compliance"]["unit"]) == (2e-9, "rad/(N m)")
    pushed = next(k for k in tried.candidates if k.effect == "creep" and k.component == "ty")
    assert parameters_of(pushed, np.array([1e-9]), np.array([1e-10]))["compliance"]["unit"] == "m/N"


def test_creep_may_begin_with_the_recording_where_nothing_had_hung_before(space: Workspace) -> None:
    k, c = space.machine.joint_names.index("longitudinal") + 1, space.context
    followed = np.zeros(len(c.hours))  # a spring and a dashpot, from rest, stepped as time goes
    for n in range(1, len(followed)):
        step = (c.hours[n] - c.hours[n - 1]) / 200
        follows = followed[n - 1]
        for _ in range(200):
            follows += step / 0.4 * (c.wrenches[n - 1, k, 3] - follows)
        followed[n] = follows
    moved = c.jacobian[:, :, k, 3] * (c.wrenches[:, k, 3] - followed)[:, None]
    moved *= 3e-4 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    found, tried = _search(replace(space, data=space.data + moved), ["creep", "drift", "zero_shift"])
    assert [f.name[0] for f in found] == ["creep"]
    candidate = _best(tried, found[0])
    assert [column.args["form"] for column in candidate.columns] == ["total", "began"]
    assert "compliance_at_first" in parameters_of(candidate, np.ones(2), np.ones(2))


def test_what_the_pose_before_does_is_found_at_any_frame(space: Workspace) -> None:
    """Wherever it turns, with the column that it depends on and at its own place."""
    bend = {"name": f"previous_q_{NAME}", "knot": 3, "count": 5}
    there = _with(space, Column("frame", "covariate", bend, 3, 4), 1.0)
    found, tried = _search(there, ["friction_hysteresis", "backlash", "cross_coupling"])
    assert [f.name for f in found] == [("nameless", None)]
    best = _best(tried, found[0])
    assert best.covariates == (f"previous_q_{NAME}",)
    assert (best.frame, best.component) == (space.machine.frame_names[3], "ry")


def test_what_sits_in_no_one_joint_for_sure_is_no_less_likely_for_it(space: Workspace) -> None:
    """Three joints that say 20 each are 21.1 together, more than one effect's 20.5 elsewhere and less than 21.5."""
    tried = Tried(space, _named(space, "thermal_growth", "tracker_scale"), 5e-5)
    joints = [j for j, (effect, _) in enumerate(tried.names) if effect == "thermal_growth"][:3]
    for elsewhere, wanted in ((20.5, "thermal_growth"), (21.5, "tracker_scale")):
        names = np.where([effect == "tracker_scale" for effect, _ in tried.names], elsewhere, -50.0)
        names[joints] = (20.0, 20.1, 19.9)
        best = tried.likeliest(names)
        assert tried.names[best][0] == wanted
        assert wanted == "tracker_scale" or best == joints[1]


@pytest.mark.parametrize(("said", "wanted"), [(94.0, "backlash"), (85.0, "friction_hysteresis")])
def test_play_in_another_drive_does_not_make_friction_play(
    space: Workspace, monkeypatch: pytest.MonkeyPatch, said: float, wanted: str
) -> None:
    """Play found in one joint; in another friction says 99, and play less. So with clearance about another axis."""
    some = _named(space, "backlash", "friction_hysteresis")
    tried = Tried(space, some, 5e-5)
    there = next(j for j, k in enumerate(some) if k.effect == "backlash" and k.joint == "yaw")
    names = np.full(len(tried.names), -50.0)
    names[tried.names.index(("friction_hysteresis", NAME))] = 99.0
    names[tried.names.index(("backlash", NAME))] = said
    monkeypatch.setattr(tried, "said", lambda: (np.zeros(len(some)), names))
    best = best_beside(tried, [Found(there, ("backlash", "yaw"), 0.0, 400.0, first=400.0)])[0]
    assert (some[best].effect, some[best].joint) == (wanted, NAME)


@pytest.mark.parametrize(("said", "wanted"), [(94.0, "clearance"), (85.0, "nonlinear_stiffness")])
def test_clearance_about_one_axis_does_not_make_stiffness_about_another_clearance(
    space: Workspace, monkeypatch: pytest.MonkeyPatch, said: float, wanted: str
) -> None:
    some = [k for k in _named(space, "clearance", "nonlinear_stiffness") if k.joint == "yaw"]
    tried = Tried(space, some, 5e-5)
    about = {(k.effect, k.component): j for j, k in enumerate(some)}
    loud = [about[effect, "rz"] for effect in ("clearance", "nonlinear_stiffness")]
    evidence = np.where(np.isin(np.arange(len(some)), loud), 50.0, 0.0)
    names = np.array([{"nonlinear_stiffness": 99.0}.get(effect, said) for effect, _ in tried.names])
    monkeypatch.setattr(tried, "said", lambda: (evidence, names))
    found = Found(about["clearance", "rx"], ("clearance", "yaw"), 0.0, 400.0, first=400.0)
    assert some[best_beside(tried, [found])[0]].effect == wanted
    found.best = about["clearance", "rz"]
    assert some[best_beside(tried, [found])[0]].effect == "clearance"



def test_a_link_that_is_stiffer_one_way_is_no_clearance_and_says_at_which_load_it_changes(space: Workspace) -> None:
    frame = space.machine.joint_names.index("lateral") + 1  # whose load takes all values, not a few
    load = space.context.wrenches[:, frame, 3]
    beyond = np.where(load > np.quantile(load, 0.45), load - np.quantile(load, 0.45), 0.0)
    moved = space.context.jacobian[:, :, frame, 3] * beyond[:, None]
    moved *= 5e-4 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    found, tried = _search(replace(space, data=space.data + moved), ["nonlinear_stiffness", "clearance"])
    assert [f.name[0] for f in found] == ["nonlinear_stiffness"]
    candidate = _best(tried, found[0])
    said = parameters_of(candidate, np.array([1e-9]), np.array([1e-10]))
    assert (said["compliance"]["unit"], said["knee_load"]["unit"]) == ("rad/(N m)", "N m")
    frame, component = candidate.columns[0].frame, candidate.columns[0].args["component"]
    at = space.context.wrenches[:, frame, component]
    assert np.quantile(at, 0.3) < said["knee_load"]["value"] < np.quantile(at, 0.7)


def test_a_gap_may_be_wider_on_one_side_and_says_by_how_much(space: Workspace) -> None:
    sides = [k for k in _named(space, "clearance") if len(k.columns) == 2]
    assert sides
    for candidate in sides:
        side, either = (column.value(space.context) for column in candidate.columns)
        assert min((side > 0).mean(), (side < 0).mean()) > 0.03  # else the two are the same
        assert np.array_equal(either, np.abs(side))
    said = parameters_of(candidate, np.array([2e-4, 5e-5]), np.array([1e-6, 1e-6]))
    assert [said[name]["value"] for name in ("half_gap", "half_difference")] == [2e-4, 5e-5]
    assert said["load_width"]["unit"] in ("N", "N m")


def test_a_joint_whose_weight_is_balanced_falls_about_a_load_that_never_changes_sign(space: Workspace) -> None:
    """By the contract's clearance, about the middle of its loads."""
    always = [
        (k, b) for k in range(1, space.machine.n + 1) for b in range(3, 6)
        if np.ptp(space.context.wrenches[:, k, b]) > 0 and (space.context.wrenches[:, k, b] > 0).mean() in (0.0, 1.0)
    ]  # fmt: skip
    sides = [k.columns[0] for k in _named(space, "clearance") if k.columns[0].function == "load_side"]
    balanced = [
        s for s in sides
        if (s.args["frame"], s.args["component"]) in always and s.args.get("offset", 0.0) not in FALLS_AT
    ]  # fmt: skip
    assert balanced
    for column in balanced:
        assert 0.2 < (column.value(space.context) > 0).mean() < 0.8


def test_a_reflector_that_moves_twice_is_one_finding(space: Workspace) -> None:
    some = [k for k in _named(space, "target_moved") if "time_h" in k.shape]
    first, later = 0, len(some) - 1
    tried = Tried(space, some, 5e-5)
    found = Found(first, ("target_moved", None), 0.0, 50.0, first=50.0)
    assert some[first].covariate != some[later].covariate
    assert caster_of(tried, later, 60.0, [found]) is None
    again = next(j for j in range(later, 0, -1) if some[j].covariate == some[first].covariate)
    assert some[again].shape["time_h"] > some[first].shape["time_h"] + 1.0
    assert caster_of(tried, again, 60.0, [found]) is found


def test_a_small_jump_as_a_reflector_is_knocked_is_left_of_the_knock(space: Workspace) -> None:
    """What is a hundredth of it and happens an hour later is a jump of its own; so is a large one at the same time."""
    some = [k for k in _named(space, "target_moved", "zero_shift") if "time_h" in k.shape]
    tried = Tried(space, some, 5e-5)
    knocks = [j for j, k in enumerate(some) if k.effect == "target_moved"]
    knock = knocks[len(knocks) // 2]
    moment = some[knock].shape["time_h"]
    away = np.array([abs(k.shape["time_h"] - moment) if k.effect == "zero_shift" else np.inf for k in some])
    there, later = int(np.argmin(away)), int(np.argmin(np.abs(away - 1.0)))
    found = Found(knock, ("target_moved", None), 0.0, 1000.0, first=1000.0)
    assert caster_of(tried, there, 10.0, [found]) is found
    assert caster_of(tried, later, 10.0, [found]) is None
    assert caster_of(tried, there, 500.0, [found]) is None


def test_what_a_sensor_misreads_is_not_left_of_a_creep_a_hundred_times_as_loud(space: Workspace) -> None:
    """What the form of an effect leaves is at the effect's own place, as a function of the load there."""
    some = _named(space, "creep", "wrench_error") + [k for k in _named(space, "nameless") if k.frame in (None, NAME)]
    creep = next(j for j, k in enumerate(some) if k.effect == "creep" and k.joint == NAME and k.component)
    tried = Tried(space, some, 5e-5)
    shows = [float((tried.seen / tried.laid.plain)[tried.index[j]].min()) for j in range(len(some))]
    misread = max((j for j, k in enumerate(some) if k.effect == "wrench_error"), key=lambda j: shows[j])
    found = Found(creep, ("creep", NAME), 0.0, 1000.0, first=1000.0)
    frame, component = some[creep].columns[0].frame, some[creep].columns[0].component
    where = {"frame": frame, "component": component, "order": 3}
    left = _with(space, Column("frame", "load_legendre", where, frame, component), 1.0)
    assert caster_of(Tried(left, some, 5e-5), misread, 10.0, [found]) is found
    assert caster_of(tried, misread, 10.0, [found]) is None
    both = _with(_with(space, some[creep].columns[0], 10.0), some[misread].columns[0], 2.0)
    names = {f.name for f in _search(both, ["creep", "wrench_error"])[0]}
    assert names == {("creep", NAME), ("wrench_error", None)}


def test_slack_that_a_load_takes_up_little_by_little_is_stiffness_and_an_abrupt_change_of_sides_is_clearance(
    space: Workspace,
) -> None:
    k = space.machine.joint_names.index("yaw") + 1
    for width, effect in ((0.9, "nonlinear_stiffness"), (0.1, "clearance")):
        column = Column("frame", "load_side", {"frame": k, "component": 3, "width": width}, k, 3)
        found, tried = _search(_with(space, column, 5.0), ["nonlinear_stiffness", "clearance"])
        assert [f.name[0] for f in found] == [effect]
        candidate = _best(tried, found[0])
        said = parameters_of(candidate, np.array([1e-4]), np.array([1e-5]))
        own = candidate.columns[0].args
        spread = float(space.context.wrenches[:, own["frame"], own["component"]].std())
        assert (said["load_width"]["value"], said["load_width"]["unit"]) == (own["width"] * spread, "N m")


def test_a_side_that_is_held_until_a_load_pushes_it_over_is_no_stiffness_where_clearance_is_left_out(
    space: Workspace,
) -> None:
    k = space.machine.joint_names.index("longitudinal") + 1
    column = Column("frame", "load_side_held", {"frame": k, "component": 3, "width": 0.35}, k, 3)
    there = _with(space, column, 5.0)
    found, tried = _search(there, ["nonlinear_stiffness"])
    assert [f.name for f in found] == [("nameless", None)]
    assert _best(tried, found[0]).covariates[0].startswith("on_")
    found, _ = _search(there, ["nonlinear_stiffness", "clearance"])
    assert [f.name[0] for f in found] == ["clearance"]


def test_a_side_that_loads_of_several_sizes_push_over_is_clearance(space: Workspace) -> None:
    k = space.machine.joint_names.index("longitudinal") + 1
    there = space
    for width in (0.1, 0.5):
        there = _with(there, Column("frame", "load_side_held", {"frame": k, "component": 3, "width": width}, k, 3), 3.0)
    found, _ = _search(there, ["clearance", "nonlinear_stiffness"])
    assert [f.name for f in found] == [("clearance", "longitudinal")]


def test_clearance_and_stiffness_of_one_load_at_one_place_are_not_without_a_name(space: Workspace) -> None:
    """The two pull against each other, so that no form of either is both."""
    k = space.machine.joint_names.index("longitudinal") + 1
    where = {"frame": k, "component": 3}
    there = _with(space, Column("frame", "load_side", {**where, "width": 0.1}, k, 3), 3.0)
    there = _with(there, Column("frame", "load_power", {**where, "exponent": 2.5}, k, 3), 6.0)
    found, _ = _search(there, ["clearance", "nonlinear_stiffness"])
    assert found
    assert {f.name[0] for f in found} <= {"clearance", "nonlinear_stiffness"}


def test_what_a_loud_clearance_is_is_not_taken_for_what_a_quiet_one_of_the_next_link_may_be_like(
    space: Workspace,
) -> None:
    k = space.machine.joint_names.index("yaw") + 1
    column = Column("frame", "load_side_held", {"frame": k, "component": 5, "width": 0.15}, k, 5)
    for times in (8.0, 20.0):
        found, _ = _search(_with(space, column, times), ["clearance", "nonlinear_stiffness"])
        assert [f.name for f in found] == [("clearance", "yaw")]


def test_the_bumps_of_a_track_are_no_coupling_where_no_wave_has_a_name(space: Workspace) -> None:
    """Ten waves over the travel, steep on one side."""
    joint = space.machine.joint_names.index(NAME)
    q = space.recording.q[:, joint]
    period = float(np.ptp(q)) / 10
    tooth = np.abs((q / period) % 1.0 - 0.2)
    moved = space.context.jacobian[:, :, joint + 1, own_component(space.context, joint)] * tooth[:, None]
    moved *= 1e-4 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    found, tried = _search(replace(space, data=space.data + moved), ["cross_coupling", "moving_weight"])
    assert {f.name for f in found} == {("nameless", None)}
    assert _best(tried, found[0]).covariates == (f"q_{NAME}",)


def test_a_wide_side_goes_with_stiffness_when_stiffness_is_left_out(space: Workspace) -> None:
    clearance = _named(space, "clearance")[0]

    def widths(without: frozenset[str]) -> set[float]:
        near = near_forms(space.context, clearance, without)
        return {column.args["width"] for column in near if column.function == "load_side"}

    assert max(widths(frozenset())) > WIDEST_SIDE >= max(widths(frozenset({"nonlinear_stiffness"})))


def test_what_pulls_sideways_with_the_approach_is_no_lost_motion(space: Workspace) -> None:
    """A cable: the joint itself is where its encoder says."""
    k = space.machine.joint_names.index("vertical")
    drag = Column("frame", "approach", {"joint": k}, k + 1, 0)
    found, tried = _search(_with(space, drag, 3.0), ["backlash", "friction_hysteresis"])
    assert {f.name for f in found} == {("nameless", None)}
    assert {"approach_vertical", "move_vertical"} & {_best(tried, f).covariates[0] for f in found}


def test_a_coupling_by_waves_keeps_its_name_beside_any_function_of_the_two(space: Workspace) -> None:
    a, b = (space.machine.joint_names.index(name) for name in ("longitudinal", "yaw"))
    period = float(np.ptp(space.recording.q[:, a])) / 1.3
    args = {"joint": a, "period": period, "phase": "sin", "by": b}
    found, _ = _search(_with(space, Column("frame", "wave_q", args, a + 1, 1), 3.0), ["cross_coupling"])
    assert [f.name[0] for f in found] == ["cross_coupling"]


def test_a_sensor_that_is_tared_at_every_change_of_the_load_and_never_quite_is_the_sensor(space: Workspace) -> None:
    c, load = space.context, np.array(space.recording.load)
    block = np.concatenate([[0], np.cumsum(load[1:] != load[:-1])])
    zeros = np.random.default_rng(5).normal(size=block.max() + 1)[block]
    by_one = Column("frames", "sensor_error", {"component": 4}).evaluate(c)
    moved = zeros[:, None] * by_one
    moved *= 3 * 5e-5 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    there = replace(space, data=space.data + moved)
    found, tried = _search(there, ["wrench_error", "drift", "creep", "thermal_growth"])
    assert [f.name for f in found] == [("wrench_error", None)]
    best = _best(tried, found[0])
    assert (best.covariate, len(best.columns)) == ("My", 1 + block.max())
    said = finding(there, tried, found[0])["parameters"]
    assert sum(name.startswith("My_zero_step_after_") for name in said) == block.max()


def test_a_sensor_whose_gain_goes_with_a_temperature_is_the_sensor_and_says_by_how_much_a_kelvin(
    space: Workspace,
) -> None:
    c = space.context
    air = c.recording.temperatures["air"]
    read = replace(c, recording=replace(c.recording, wrench=c.recording.wrench * (air - air.mean())[:, None]))
    moved = Column("frames", "sensor_error", {"component": -1}).evaluate(read)
    moved *= 2 * 5e-5 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    there = replace(space, data=space.data + moved)
    found, tried = _search(there, ["wrench_error", "tracker_scale", "drift", "creep"])
    assert [f.name for f in found] == [("wrench_error", None)]
    assert _best(tried, found[0]).covariate == "temp_air_C"
    said = finding(there, tried, found[0])["parameters"]
    assert said["gain_per_kelvin_air_0_h"]["unit"] == "1/K"


def test_what_gives_way_less_than_in_proportion_falls_with_its_load_or_is_no_clearance(space: Workspace) -> None:
    """Nothing falls against its load: a link that is softer once a preload is lost does, beside a proportional one."""
    frame, component = space.machine.joint_names.index("longitudinal") + 1, 5
    load = space.context.wrenches[:, frame, component]
    used_up = np.clip(load / (0.3 * load.std()), -1.0, 1.0)
    moved = space.context.jacobian[:, :, frame, component] * used_up[:, None]
    moved *= 1e-4 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    for way, name in ((1.0, "clearance"), (-1.0, "nonlinear_stiffness")):
        found, _ = _search(replace(space, data=space.data + way * moved), ["nonlinear_stiffness", "clearance"])
        assert [f.name[0] for f in found] == [name]


def test_what_heat_leaves_is_a_hundred_times_more_quiet_in_any_joint_s_zero(space: Workspace) -> None:
    some = _named(space, "thermal_growth", "zero_shift")
    tried = Tried(space, some, 5e-5)
    warm = next(j for j, k in enumerate(some) if k.effect == "thermal_growth" and k.joint == "roll")
    jump = next(j for j, k in enumerate(some) if k.effect == "zero_shift" and k.joint == "yaw")
    found = Found(warm, ("thermal_growth", "roll"), 0.0, 4000.0, first=4000.0)
    assert caster_of(tried, jump, 30.0, [found]) is found
    assert caster_of(tried, jump, 50.0, [found]) is None


def test_what_a_base_that_wanders_leaves_may_go_with_a_temperature(space: Workspace) -> None:
    some = _named(space, "drift", "nameless")
    tried = Tried(space, some, 5e-5)
    drift = next(j for j, k in enumerate(some) if k.effect == "drift")
    warm = {k.frame: j for j, k in enumerate(some) if k.covariates == ("late_1_temp_air_C",)}
    found = Found(drift, ("drift", None), 0.0, 400.0, first=400.0)
    assert caster_of(tried, warm["base"], 30.0, [found]) is found
    assert caster_of(tried, warm["base"], 50.0, [found]) is None
    assert caster_of(tried, warm[space.machine.joint_names[-1]], 30.0, [found]) is None


@pytest.mark.parametrize("load", ["Fz", "Mx"])
def test_an_end_effector_that_bends_under_its_load_is_unexplained_over_that_load(space: Workspace, load: str) -> None:
    """Each reflector moves its own way, in proportion to what the sensor read."""
    c = space.context
    read = c.recording.wrench[:, ["Fx", "Fy", "Fz", "Mx", "My", "Mz"].index(load)]
    ways = np.random.default_rng(3).normal(size=(c.points.shape[1], 3))
    moved = np.einsum("nij,tj,n->nti", c.tips[:, :3, :3], ways, read).reshape(len(read), -1)
    moved *= 2 * 5e-5 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    found, tried = _search(replace(space, data=space.data + moved), ["target_moved", "wrench_error", "tracker_scale"])
    assert [f.name[0] for f in found] == ["nameless"]
    assert _best(tried, found[0]).covariates == (load,)


def test_an_instrument_s_circle_that_errs_many_times_a_turn_is_unexplained_over_its_angle(space: Workspace) -> None:
    rays = space.context.points - space.context.measuring_in_base[:3, 3]
    around = np.arctan2(rays[..., 0], rays[..., 2])  # of the positioner's base the second axis is plumb
    level = np.stack([rays[..., 2], 0 * around, -rays[..., 0]], axis=-1)
    moved = (np.sin(31.5 * around + 0.4)[..., None] * level).reshape(len(rays), -1)
    moved *= 2 * 5e-5 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    some = _named(space, "nameless", "drift", "tracker_scale")
    there = replace(space, data=space.data + moved)
    tried = Tried(there, some, 5e-5)
    found = search(there, tried, np.random.default_rng(0))
    assert [f.name[0] for f in found] == ["nameless"]
    assert _best(tried, found[0]).covariate == "azimuth"


def test_a_brake_that_seats_at_random_is_said_of_its_own_joint(space: Workspace) -> None:
    """Whenever the joint moved it stands a little aslant, until it moves again."""
    k = space.machine.joint_names.index("pitch")
    q, rng = space.recording.q[:, k], np.random.default_rng(2)
    seats = np.zeros(len(q))
    for v in range(len(q)):
        seats[v] = seats[v - 1] if v and abs(q[v] - q[v - 1]) < 1e-6 else rng.choice([-1.0, 1.0])
    moved = space.context.jacobian[:, :, k + 1, 4] * seats[:, None]
    moved *= 2 * 5e-5 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    some = [j for j in _named(space, "nameless") if any(name.startswith("stay_") for name in j.covariates)]
    assert {name for j in some for name in j.covariates} >= {"stay_pitch", "stay_roll", "stay_lateral"}
    tried = Tried(replace(space, data=space.data + moved), some, 5e-5)
    best = some[int(np.argmax(tried.evidence(tried.scores()[None])[0]))]
    assert (best.covariates, best.frame, best.component) == (("stay_pitch",), "pitch", "ry")


def test_creep_of_a_whole_rail_a_hundred_times_more_quiet_is_what_a_wandering_base_leaves(space: Workspace) -> None:
    some = _named(space, "drift", "creep")
    tried = Tried(space, some, 5e-5)
    drift = next(j for j, k in enumerate(some) if k.effect == "drift")
    whole = {k.joint: j for j, k in enumerate(some) if k.effect == "creep" and k.component is None}
    found = Found(drift, ("drift", None), 0.0, 1000.0, first=1000.0)
    assert caster_of(tried, whole["vertical"], 8.0, [found]) is found
    assert caster_of(tried, whole["vertical"], 12.0, [found]) is None
    assert caster_of(tried, whole["pitch"], 8.0, [found]) is None


def test_a_sensor_with_another_gain_for_pull_than_for_push_is_the_sensor(space: Workspace) -> None:
    c = space.context
    sided = c.recording.wrench.copy()
    sided[:, [0, 1, 2, 3, 5]] = 0.0
    sided[:, 4] = np.where(sided[:, 4] > 0, 1.0, 0.3) * sided[:, 4]
    off = replace(c, recording=replace(c.recording, wrench=sided))
    moved = Column("frames", "sensor_error", {"component": -1}).evaluate(off)
    moved *= 3 * 5e-5 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    there = replace(space, data=space.data + moved)
    found, tried = _search(there, ["wrench_error", "creep", "drift"])
    assert [f.name for f in found] == [("wrench_error", None)]
    assert _best(tried, found[0]).covariate == "My"
    said = finding(there, tried, found[0])["parameters"]
    assert set(said) == {"My_by_My", "My_by_My_sided"}


@pytest.mark.parametrize(("own", "stands"), [(1.0, True), (0.0, False)])
def test_a_carriage_may_rock_as_it_loses_motion_but_what_only_rocks_is_a_cable(
    space: Workspace, own: float, stands: bool
) -> None:
    k = space.machine.joint_names.index(NAME)
    along = _on_the_joint(space, "approach")
    across = replace(along, component=next(comp for comp in (3, 4, 5) if comp != along.component))
    there = _with(_with(space, along, 2.0 * own), across, 2.0)
    found, tried = _search(there, ["backlash", "friction_hysteresis"], NAME)
    assert [f.name for f in found] == [("backlash", NAME) if stands else ("nameless", None)]
    if stands:
        said = finding(there, tried, found[0])
        rocking = f"rocking_{COMPONENTS[across.component]}"
        assert {name: p["unit"] for name, p in said["parameters"].items()} == {"gap": "rad", rocking: "rad"}
        assert "rocks" in said["sentence"]
        assert _best(tried, found[0]).columns[1].frame == k + 1


def test_a_compressor_that_starts_every_few_visits_is_found_and_its_period_said(space: Workspace) -> None:
    """A square wave of no whole number of half waves in the recording; twelve visits long."""
    minutes = 60 * float(space.context.hours[-1]) / len(space.context.hours) * 12.3
    on = np.sign(np.sin(2 * np.pi * 60 * space.context.hours / minutes + 0.4))
    moved = (space.context.jacobian[:, :, 0, :3] @ np.array([0.5, 1.0, -0.3])) * on[:, None]
    moved *= 5e-5 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    there = replace(space, data=space.data + moved)
    found, tried = _search(there, ["drift", "creep"], "time")
    assert [f.name[0] for f in found] == ["nameless"]
    ((column, said),) = stand_ins(space.context, _best(tried, found[0]))
    assert (column, said.split()[-1]) == ("time", "min")
    assert float(said.split()[-2]) == pytest.approx(minutes, rel=0.06)
    beat, c = _best(tried, found[0]).columns[0], space.context
    assert np.abs(beat.value(c)).max() > 0.9
    assert not beat.value(replace(c, hours=c.hours + 36.0)).any()  # where it is then nobody knows


def test_a_joint_that_falls_in_proportion_and_no_farther_is_clearance_over_half_of_its_load_s_spread(
    space: Workspace,
) -> None:
    frame, component = space.machine.joint_names.index("longitudinal") + 1, 5
    load = space.context.wrenches[:, frame, component]
    fallen = np.clip((load - 0.1 * load.std()) / (0.55 * load.std()), -1.0, 1.0)
    moved = space.context.jacobian[:, :, frame, component] * fallen[:, None]
    moved *= 2e-4 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    found, tried = _search(replace(space, data=space.data + moved), ["nonlinear_stiffness", "clearance"])
    assert [f.name for f in found] == [("clearance", "longitudinal")]
    best = _best(tried, found[0]).columns[0].args
    assert best["hard"]
    assert best["width"] in (0.5, 0.7)  # the grid's next to 0.55


def test_a_force_sensor_that_was_never_tared_is_one_error_of_all_its_channels(space: Workspace) -> None:
    off = np.array([-30.0, 40.0, 25.0, 15.0, -9.0, 12.0])  # N, N m
    zeros = [Column("frames", "sensor_error", {"component": comp}).evaluate(space.context) for comp in range(6)]
    moved = np.einsum("knt,k->nt", np.array(zeros), off)
    moved *= 4e-4 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    found, tried = _search(replace(space, data=space.data + moved), ["wrench_error", "missing_compliance"])
    assert [f.name[0] for f in found] == ["wrench_error"]
    said = parameters_of(_best(tried, found[0]), np.ones(6), np.ones(6))
    assert {p["unit"] for name, p in said.items() if name.endswith("_zero")} == {"N", "N m"}


def test_what_two_joints_sides_do_together_is_said_in_both(space: Workspace) -> None:
    args = {"first": "approach_yaw", "second": "approach_lateral", "a": 0, "b": 0, "count": 1}
    together = Column("frame", "covariate_pair", args, space.machine.joint_names.index("roll") + 1, 4)
    found, tried = _search(_with(space, together, 3.0), ["backlash", "friction_hysteresis"], "yaw")
    assert [f.name[0] for f in found] == ["nameless"]
    assert {column for column, _ in stand_ins(space.context, _best(tried, found[0]))} == {
        "approach_yaw", "approach_lateral",
    }  # fmt: skip


def test_a_guide_that_wears_where_it_is_used_does_not_grow_with_a_temperature(space: Workspace) -> None:
    """Its error grows with time, by a shape over its own position."""
    c, k = space.context, space.machine.joint_names.index("longitudinal")
    at = (c.recording.q[:, k] - c.recording.q[:, k].min()) / np.ptp(c.recording.q[:, k])
    moved = c.jacobian[:, :, k + 1, 4] * (c.hours / c.hours[-1] * np.cos(5.0 * at + 0.7))[:, None]
    moved *= 1.5e-4 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    found, tried = _search(replace(space, data=space.data + moved), ["thermal_growth", "drift"], "longitudinal")
    assert {f.name[0] for f in found} == {"nameless"}
    assert set(_best(tried, found[0]).covariates) == {"q_longitudinal", "time"}


def test_a_link_that_softens_as_a_whole_as_it_warms_is_no_creep_growth_or_sensor(space: Workspace) -> None:
    c, k = space.context, space.machine.joint_names.index("longitudinal") + 1
    air = c.recording.temperatures["air"]
    bent = np.einsum("nab,nb->na", c.compliance[:, k], c.wrenches[:, k]) * (air - air.mean())[:, None]
    moved = np.einsum("nia,na->ni", c.jacobian[:, :, k], bent)
    moved *= 2e-4 / np.sqrt((moved**2).sum() / space.recording.seen.sum())
    some = ["thermal_growth", "wrench_error", "creep"]
    found, tried = _search(replace(space, data=space.data + moved), some, "longitudinal")
    assert [f.name[0] for f in found] == ["nameless"]
    assert _best(tried, found[0]).columns[0].function == "softened"
    (_, where), (warm, _) = stand_ins(c, _best(tried, found[0]))
    assert (where, warm) == ("on longitudinal", "temp_air_C")


def test_what_another_joint_does_over_its_position_is_no_shadow_of_what_leaves_nothing_at_its_own_place(
    space: Workspace,
) -> None:
    k, other = (space.machine.joint_names.index(name) for name in (NAME, "vertical"))
    loud = Column("frame", "load_power", {"frame": k + 1, "component": 3, "exponent": 2.0}, k + 1, 3)
    quiet = Column("frame", "pair", {"a": other, "power_a": 0, "b": k, "power_b": 2}, other + 1, 2)
    some = _named(space, "nonlinear_stiffness", "cross_coupling") + [
        j for j in _named(space, "nameless") if j.frame in (NAME, "vertical")
    ]
    there = _with(_with(space, loud, 8.0), quiet, 2.0)
    found = search(there, Tried(there, some, 5e-5), np.random.default_rng(0))
    assert {f.name[0] for f in found} == {"nonlinear_stiffness", "cross_coupling"}
    assert next(f.first for f in found if f.name[0] == "cross_coupling") < SHADOW * found[0].first
