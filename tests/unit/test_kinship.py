"""A rival without a name that is the named effect by definition does not cost it its name; another one may."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ppshw.diagnosis.kinship import (
    AKIN,
    ALWAYS,
    OTHER_WAYS,
    WOUND_UP,
    Unturned,
    counts,
    never_turned,
    of_a_load,
    of_its_kind,
    stranger_than,
    that_hold,
)
from ppshw.diagnosis.library import Candidate
from ppshw.machine import WRENCH_COMPONENTS, load_machine
from ppshw.terms.shapes import Column


def _named(effect: str, joint: str | None, frame: str | None, component: str | None, covariate: str) -> Candidate:
    over = (f"q_{joint}", covariate) if effect == "cross_coupling" else ()
    return Candidate(effect, joint, frame, component, covariate, (), covariates=over)


def _rival(
    frame: str | None, component: str | None, *over: str, function: str = "covariate", count: int = 3
) -> Candidate:
    columns = (Column("frame", function, {"count": count}, 1, 0),)
    return Candidate("nameless", None, frame, component, " × ".join(over), columns, covariates=over)


def on_rails(*frames: str) -> Unturned:
    """Frames that never turn, and links of their joints but the last."""
    shifts = frozenset(itertools.product(frames, ("tx", "ty", "tz")))
    return Unturned(frames, shifts, frozenset(range(len(frames) - 1)))


@pytest.mark.parametrize(
    ("named", "kin", "stranger"),
    [
        (_named("cross_coupling", "yaw", "yaw", "ty", "q_roll"), _rival("roll", "tx", "q_roll", "q_yaw"),
         _rival("yaw", "ty", "q_yaw", "temp_air_C")),
        (_named("drift", None, "base", None, "time"), _rival("base", "tz", "time"), _rival("base", "tz", "temp_air_C")),
        (_named("drift", None, "base", None, "time"), _rival("base", "tz", "time"), _rival("pitch", "tz", "time")),
        (_named("drift", None, "ground", None, "time"), _rival("ground", "tz", "time"), _rival("base", "tz", "time")),
        (_named("zero_shift", "yaw", "yaw", "ry", "time"), _rival("yaw", "ry", "q_yaw", "time", function="step"),
         _rival("yaw", "ry", "q_yaw", "time", function="clock")),
        (_named("zero_shift", "yaw", "yaw", "ry", "time"), _rival("yaw", "ry", "q_yaw", "time", function="hopping"),
         _rival("roll", "ry", "q_roll", "time", function="hopping")),
        (_named("backlash", "yaw", "yaw", "ry", "approach_yaw"), _rival("yaw", "ry", "approach_yaw"),
         _rival("yaw", "ry", "approach_yaw", "way_yaw")),
        (_named("backlash", "yaw", "yaw", "ry", "approach_yaw"), _rival("yaw", "ry", "approach_yaw"),
         _rival("yaw", "rx", "approach_yaw")),
        (_named("friction_hysteresis", "yaw", "yaw", "ry", "move_yaw"),
         _rival("yaw", "ry", "approach_yaw", "way_yaw", function="winding"),
         _rival("yaw", "ry", "approach_yaw", "way_yaw")),
        (_named("thermal_growth", "yaw", "yaw", "ry", "temp_air_C"), _rival("yaw", "rx", "late_1_temp_air_C"),
         _rival("yaw", "ry", "cov_humidity")),
        (_named("thermal_growth", "yaw", "yaw", "ry", "temp_air_C"), _rival("yaw", "ry", "q_yaw", "temp_air_C"),
         _rival("roll", "ry", "q_yaw", "temp_air_C")),
        (_named("thermal_growth", "yaw", "yaw", "ry", "temp_air_C"), _rival("yaw", "ry", "q_yaw", "late_2_temp_arm_C"),
         _rival("yaw", "ry", "q_roll", "late_2_temp_arm_C")),
        (_named("thermal_growth", "yaw", "yaw", "ry", "temp_air_C"), _rival("yaw", "rx", "temp_arm_C"),
         _rival("yaw", "ry", "q_yaw")),
        (_named("periodic_transmission", "yaw", "yaw", "ry", "q_yaw"), _rival("yaw", "ry", "q_yaw", function="wave"),
         _rival("yaw", "rx", "q_yaw", function="wave")),
        (_named("periodic_transmission", "yaw", "yaw", "ry", "q_yaw"), _rival("yaw", "ry", "q_yaw", function="wave"),
         _rival("yaw", "ry", "q_yaw")),
        (_named("target_moved", None, None, None, "P2"), _rival(None, None, "P2"), _rival(None, None, "cov_humidity")),
        (_named("creep", "yaw", "yaw", "rx", "since_load_change"), _rival("yaw", "rx", "on_yaw_Mx", "late_1_on_yaw_Mx"),
         _rival("yaw", "rx", "on_yaw_Mx")),
        (_named("wrench_error", None, None, None, "Fy"), _rival(None, None, "Fy", function="sensor_error"),
         _rival(None, None, "Fy", "q_yaw", function="sensor_off")),
        (_named("wrench_error", None, None, None, "Fy"), _rival(None, None, "Fy", function="sensor_off", count=1),
         _rival(None, None, "q_yaw", function="sensor_off", count=1)),
        (_named("wrench_error", None, None, None, "Fy"), _rival(None, None, "Fy", function="sensor_off", count=1),
         _rival(None, None, "Fy", function="sensor_off", count=3)),
    ],
)  # fmt: skip
def test_a_rival_is_kin_where_the_name_s_own_meaning_covers_it(
    named: Candidate, kin: Candidate, stranger: Candidate
) -> None:
    assert of_its_kind(named, kin)
    assert not of_its_kind(named, stranger)


def test_sides_that_a_load_holds_are_clearance_and_a_load_that_lags_is_creep_at_whichever_joint() -> None:
    """Joints whose axes are parallel carry nearly the same moment: which of them it is the name's own forms say."""
    clearance = _named("clearance", "wrist", "wrist", "rz", "Mz")
    over = ("on_elbow_My", "previous_on_elbow_My")
    assert of_its_kind(clearance, _rival("elbow", "ry", *over, function="load_side_held"))
    assert of_its_kind(clearance, _rival("elbow", "ry", "on_elbow_My", function="load_side"))
    assert not of_its_kind(clearance, _rival("elbow", "ry", *over))
    creep = _named("creep", "wrist", "wrist", "rz", "since_load_change")
    assert of_its_kind(creep, _rival("elbow", "ry", "on_elbow_My", "late_0.4_on_elbow_My"))
    assert not of_its_kind(creep, _rival("elbow", "ry", "late_0.4_temp_air_C"))


def test_a_step_of_what_never_turns_is_the_jump_of_a_rail_in_its_direction() -> None:
    named = _named("zero_shift", "vertical", "vertical", "ty", "time")
    rails = on_rails("base", "lateral", "vertical")
    for frame in ("base", "lateral"):
        assert of_its_kind(named, _rival(frame, "ty", "time", function="step"), rails)
        assert not of_its_kind(named, _rival(frame, "tx", "time", function="step"), rails)
        assert not of_its_kind(named, _rival(frame, "ty", "time", function="step"))
        assert not of_its_kind(named, _rival(frame, "ty", "time", function="clock"), rails)


def test_a_shift_of_what_never_turns_is_the_growth_of_any_link_before_it() -> None:
    named = _named("thermal_growth", "vertical", "vertical", None, "temp_air_C")
    rails = on_rails("base", "lateral", "vertical")
    for frame, component in (("base", None), ("base", "tx"), ("lateral", "ty")):
        assert of_its_kind(named, _rival(frame, component, "late_2_temp_air_C"), rails)
        assert not of_its_kind(named, _rival(frame, component, "late_2_temp_air_C"))
    assert not of_its_kind(named, _rival("base", "rx", "late_2_temp_air_C"), rails)
    bends = _named("thermal_growth", "vertical", "vertical", "rz", "temp_air_C")
    assert not of_its_kind(bends, _rival("base", None, "late_2_temp_air_C"), rails)
    assert not of_its_kind(named, _rival("base", "tx", "time"), rails)
    assert not of_its_kind(named, _rival("yaw", "tx", "late_2_temp_air_C"), rails)
    warm = (Column("frame", "temperature", {"place": "air", "tau": 0.0}, 2, 1),)
    along = replace(_named("thermal_growth", "vertical", "vertical", "ty", "temp_air_C"), columns=warm)
    of_base = replace(_rival("roll", "rx", "temp_air_C"), columns=(Column("frame", "covariate", {"count": 3}, 0, 3),))
    assert of_its_kind(along, of_base, rails)  # of the base, in whichever direction, beside anything
    assert not of_its_kind(replace(along, component="rz"), of_base, rails)
    turning = _named("thermal_growth", "yaw", "yaw", None, "temp_air_C")
    assert not of_its_kind(turning, _rival("base", "tx", "late_2_temp_air_C"), rails)


def test_what_points_along_an_axis_is_not_turned_about_it() -> None:
    """Growth of a pillar that only turns about its own axis had lost its name to whatever moves the base (sealed
    64009)."""
    machine = load_machine(Path(__file__).parents[2] / "machines/pps.yaml")
    found = never_turned(machine)
    assert found.frames == ("base", "lateral", "vertical", "longitudinal")
    assert {component for frame, component in found.shifts if frame == "longitudinal"} == {"tx", "ty", "tz"}
    for frame in ("yaw", "roll", "pitch"):  # yaw is upright; roll and pitch turn by 3 degrees either way
        assert {component for name, component in found.shifts if name == frame} == {"ty"}
    assert found.links == set(range(6))  # those from yaw on are upright
    arm = never_turned(load_machine(Path(__file__).parents[2] / "machines/arm6.yaml"))
    assert arm.frames == ("base",)
    assert arm.turns == {("base", "rz"), ("waist", "rz")}
    assert found.turns == frozenset()  # a rail
    assert {shift for shift in arm.shifts if shift[0] != "base"} == {("waist", "tz")}
    assert arm.links == frozenset()
    column, base = Column("frames", "link_growth", {"joint": 3}), Column("frame", "covariate", {"count": 3}, 0, 1)
    pillar = replace(_named("thermal_growth", "yaw", "yaw", None, "temp_air_C"), columns=(column,))
    shifts = replace(_rival("base", None, "temp_air_C"), columns=(base,))
    assert not of_its_kind(pillar, shifts, found)
    assert (counts(pillar, shifts, found), counts(pillar, shifts, arm)) == (OTHER_WAYS, 1.0)
    lengths = replace(shifts, columns=(Column("points", "scale", {}), base))  # from afar that is a shift
    assert of_its_kind(pillar, lengths, found)
    assert not of_its_kind(pillar, lengths, arm)
    post = replace(pillar, joint="vertical", frame="vertical", columns=(replace(column, args={"joint": 1}),))
    for name, kin in (("temp_air_C", True), ("late_1_temp_rail_C", True), ("time", False), ("q_vertical", False)):
        assert of_its_kind(post, replace(shifts, covariates=(name,)), found) == kin
    assert counts(pillar, replace(shifts, covariates=("time",)), found) == 1.0


def test_a_jump_of_a_first_joint_that_turns_about_the_base_s_axis_is_one_of_the_base() -> None:
    """It had lost its name to that (a fifty-eighth author's 003)."""
    machine = load_machine(Path(__file__).parents[2] / "machines/arm6.yaml")
    named = _named("zero_shift", "waist", "waist", "rz", "time")
    of_base = _rival("base", "rz", "time", function="step")
    assert of_its_kind(named, of_base, never_turned(machine))
    assert not of_its_kind(named, _rival("base", "ry", "time", function="step"), never_turned(machine))
    first, *others = machine.joints
    askew = np.array([[1.0, 0.0, 0.0], [0.0, 0.9, -0.43589], [0.0, 0.43589, 0.9]])
    origins = {"aside": first.origin + 0.1 * np.eye(4, k=3), "askew": first.origin.copy()}
    origins["askew"][:3, :3] = askew
    for origin in origins.values():
        elsewhere = replace(machine, joints=(replace(first, origin=origin), *others))
        assert not of_its_kind(named, of_base, never_turned(elsewhere))


def test_what_a_load_did_at_the_visit_before_goes_with_that_load() -> None:
    """A side that is held is structure over both where its width is between those of the first look (a sixtieth
    author's 033)."""
    my = WRENCH_COMPONENTS.index("My")
    assert of_a_load(_rival("S5", "ry", "on_S5_My", "previous_on_S5_My")) == my
    assert of_a_load(_rival("S5", "ry", "on_S5_My")) == my
    for other in (("on_S5_My", "q_S5"), ("on_S5_My", "previous_on_S5_Mx"), ("previous_q_S5",)):
        assert of_a_load(_rival("S5", "ry", *other)) is None


def test_what_grows_everywhere_may_grow_more_where_a_joint_stands() -> None:
    named = _named("thermal_growth", None, None, None, "temp_air_C")
    assert of_its_kind(named, _rival("roll", "rx", "late_1_temp_air_C", "q_roll"))
    assert not of_its_kind(named, _rival("roll", "rx", "q_roll"))
    assert not of_its_kind(named, _rival("roll", "rx", "temp_air_C", "time"))


def test_a_scale_about_wherever_the_instrument_stands_is_a_scale() -> None:
    named = _named("tracker_scale", None, None, None, "temp_air_C")
    scale, base, roll = (
        Column("points", "scale", {}),
        Column("frame", "clock", {}, 0, 1),
        Column("frame", "clock", {}, 5, 1),
    )
    for columns, kin in (((scale,), True), ((scale, base), True), ((base,), False), ((scale, roll), False)):
        assert of_its_kind(named, replace(_rival("base", "ty", "temp_air_C"), columns=columns)) == kin


def test_a_base_that_goes_with_what_warms_within_the_machine_drifts() -> None:
    named = _named("drift", None, "base", None, "time")
    inside = ("temp_pitch_C",)
    for name in ("temp_pitch_C", "late_1_temp_pitch_C"):
        assert of_its_kind(named, _rival("base", None, name), (), inside)
        assert not of_its_kind(named, _rival("base", None, name))
        assert not of_its_kind(named, _rival("pitch", None, name), (), inside)
    assert not of_its_kind(named, _rival("base", None, "late_1_temp_air_C"), (), inside)


def test_a_gap_that_goes_with_something_or_tilts_is_a_gap_if_most_of_it_is_always_there() -> None:
    named = _named("backlash", "yaw", "yaw", "ry", "approach_yaw")
    changing = _rival("yaw", "ry", "approach_yaw", "temp_air_C", function="approach")
    assert not of_its_kind(named, changing)
    assert counts(named, changing) == ALWAYS < 1.0
    tilting = _rival("pitch", "rx", "approach_yaw", function="approach")
    assert not of_its_kind(named, tilting)
    assert counts(named, tilting) == ALWAYS
    for other in (
        _rival("yaw", "ry", "approach_yaw", function="approach"),
        _rival("yaw", "ry", "approach_roll", "temp_air_C", function="approach"),
        _rival("yaw", "ry", "q_yaw", "approach_yaw"),
        _rival("yaw", "ry", "approach_yaw", "way_yaw", function="reversal"),
    ):
        assert counts(named, other) == 1.0
    rocks = replace(named, columns=tuple(Column("frame", "approach", {}, 4, k) for k in (4, 3)))  # about ry, and rx
    assert counts(rocks, tilting) == 1.0  # what rocks sideways alone is a cable
    assert counts(rocks, replace(changing, frame="pitch", component="rx")) == ALWAYS


def test_what_goes_with_a_load_is_stiffness_or_clearance_where_both_have_a_name() -> None:
    for effect in ("clearance", "nonlinear_stiffness"):
        named = _named(effect, "yaw", "yaw", "rx", "Mx")
        bent = _rival("yaw", "rx", "on_yaw_Mx", function="load_bump")
        assert of_its_kind(named, bent, both_of_a_load=True)
        assert not of_its_kind(named, bent)
        assert not of_its_kind(named, _rival("yaw", "rx", "on_yaw_Mx", "q_yaw"), both_of_a_load=True)
        assert not of_its_kind(named, _rival("yaw", "ry", "on_yaw_Mx"), both_of_a_load=True)
        held = _rival("yaw", "rx", "on_yaw_Mx", "previous_on_yaw_Mx", function="load_side_held")
        assert of_its_kind(named, held) == (effect == "clearance")


@pytest.mark.parametrize("effect", ["clearance", "backlash", "friction_hysteresis"])
def test_neighbours_that_are_each_other_s_rivals_have_no_kin(effect: str) -> None:
    """Any function of a load is as much a clearance as a stiffness: which it is its form must say."""
    named = _named(effect, "yaw", "yaw", "rx", "Mx")
    for function in ("load_bump", "load_legendre"):
        rival = _rival("yaw", "rx", "on_yaw_Mx", function=function)
        assert not of_its_kind(named, rival)
        assert counts(named, rival) == 1.0
    assert not of_its_kind(named, _rival("yaw", "rx", "approach_yaw", function="approach"))


def test_any_function_of_the_way_since_its_joint_turned_back_may_say_a_little_more_than_friction() -> None:
    named = _named("friction_hysteresis", "yaw", "yaw", "ry", "move_yaw")
    assert counts(named, _rival("yaw", "ry", "approach_yaw", "way_yaw", function="turning")) == WOUND_UP < 1.0
    for other in (
        _rival("yaw", "ry", "approach_yaw", function="approach"),
        _rival("yaw", "rx", "approach_yaw", "way_yaw", function="turning"),
        _rival("yaw", "ry", "approach_roll", "way_roll", function="turning"),
    ):
        assert counts(named, other) == 1.0


def test_a_smooth_function_of_its_own_load_is_stiffness_and_one_that_is_fine_at_zero_nearly() -> None:
    named = _named("nonlinear_stiffness", "yaw", "yaw", "rx", "Mx")
    assert of_its_kind(named, _rival("yaw", "rx", "on_yaw_Mx", function="load_legendre"))
    sharp = _rival("yaw", "rx", "on_yaw_Mx", function="load_bump")
    assert not of_its_kind(named, sharp)
    assert counts(named, sharp) == AKIN < 1.0
    for elsewhere in (
        _rival("roll", "rx", "on_roll_Mx", function="load_legendre"),
        _rival("yaw", "rx", "on_yaw_Mx", "previous_on_yaw_Mx", function="load_slip"),
        _rival("yaw", "rx", "on_yaw_Mz", function="load_legendre"),
    ):
        assert not of_its_kind(named, elsewhere)
        assert counts(named, elsewhere) == 1.0


@pytest.mark.parametrize(("effect", "place", "function", "stranger"), [
    ("thermal_growth", "air", "load_warm", True), ("thermal_growth", "air", "softened", True),
    ("thermal_growth", "rail", "load_warm", False), ("thermal_growth", "air", "covariate", False),
    ("clearance", "air", "load_warm", False),
])  # fmt: skip
def test_compliance_that_goes_with_a_temperature_is_the_odder_story_beside_growth_that_does(
    effect: str, place: str, function: str, stranger: bool
) -> None:
    named = _named(effect, "yaw", "yaw", "ty", "temp_air_C")
    assert stranger_than(named, _rival("roll", "ty", "on_roll_Fy", f"temp_{place}_C", function=function)) is stranger


def test_a_single_zero_is_one_of_all_and_that_of_the_last_joint_one_of_what_is_behind_it() -> None:
    every, carrier = ("zero_shift", None), ("target_moved", None)
    assert that_hold(("zero_shift", "yaw"), "pitch") == [every]
    assert that_hold(("zero_shift", "pitch"), "pitch") == [every, carrier]
    for other in (every, carrier, ("backlash", "pitch")):
        assert that_hold(other, "pitch") == []
