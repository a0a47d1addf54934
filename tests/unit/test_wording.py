"""Whatever is in the library can be taken up and said: every form has a name and a unit for each of its numbers."""

from __future__ import annotations

import numpy as np
import pytest

from ppshw.diagnosis.columns import Mistake
from ppshw.diagnosis.forms import near_forms
from ppshw.diagnosis.library import library
from ppshw.diagnosis.parameters import numbers_of
from ppshw.diagnosis.visibility import NEVER
from ppshw.diagnosis.wording import (
    _by_its_thermometer,
    _where_it_acts,
    column_of,
    how_sure,
    sentence,
    to_separate,
    would_have_shown,
)
from ppshw.identification.joint import estimate
from ppshw.identification.structure import joint_model
from ppshw.progress import folded
from ppshw.terms.shapes import Context
from tests.unit.clean_case import clean_case


@pytest.fixture(scope="module")
def context(tmp_path_factory: pytest.TempPathFactory) -> Context:
    machine, recording = clean_case(5, "pps", 80, 80, tmp_path_factory.mktemp("clean"))
    base = estimate(joint_model(machine, recording), recording)
    return Context.of(base.model, base.theta, recording, base.measuring_in_base)


def test_every_form_names_each_of_its_numbers_once_and_knows_what_else_it_may_be_like(context: Context) -> None:
    seen = set()
    for candidate in library(context):
        kind = (candidate.effect, *(c.function for c in candidate.columns), candidate.component is None)
        if kind in seen:
            continue
        seen.add(kind)
        values = np.linspace(1e-5, 2e-5, len(candidate.columns))
        said = numbers_of(context, candidate, values, np.diag(values))
        bends = candidate.effect in ("drift", "cross_coupling") or candidate.columns[0].args.get("time") == "cosine"
        least = 2 if candidate.effect == "periodic_transmission" else 1 if bends else len(values)
        assert len(said) >= least, candidate
        assert all(entry["unit"] for entry in said.values())
        assert not any(name[1:].isdigit() for name in said), candidate
        assert sentence(context, candidate, values, 1e-4).endswith((".", "mm."))
        near = near_forms(context, candidate)
        assert len({column.key for column in (*candidate.columns, *near)}) == len(candidate.columns) + len(near)
        assert all(np.isfinite(column.evaluate(context)).all() for column in near[::9])
    assert len(seen) > 30  # of this campaign: all effects but those that need what it has not


def test_history_is_said_in_the_columns_of_the_recording() -> None:
    assert column_of("previous_q_yaw") == ("q_yaw", "of the pose before")
    assert column_of("move_yaw")[0] == "q_yaw"
    assert column_of("temp_air_C") == ("temp_air_C", "")


def test_on_the_terminal_a_name_that_is_likely_too_is_told() -> None:
    said = {"weight": 0.57, "p_value": 1e-9, "alternatives": [{"effect": "backlash", "joint": "pitch", "weight": 0.4}]}
    assert how_sure(said) == "[weight 0.57, backlash of pitch 0.40; p 1e-09]"
    said["alternatives"] = [{"effect": "thermal_growth", "joint": "pitch", "weight": 0.4}]
    assert how_sure(said) == "[weight 0.57, thermal growth of pitch 0.40; p 1e-09]"
    said["alternatives"] = [{"effect": "nameless", "joint": None, "weight": 0.05}]
    assert how_sure(said) == "[weight 0.57; p 1e-09]"
    said["alternatives"] = [{"effect": "nameless", "joint": None, "weight": 0.15}]
    assert how_sure(said) == "[weight 0.57, no name 0.15; p 1e-09]"
    assert how_sure({**said, "p_value": 1e-80}) == "[weight 0.57, no name 0.15; p < 1e-12]"


def test_lines_are_folded_to_eighty_columns_and_go_on_indented() -> None:
    long = "  " + "short-wave structure over q_longitudinal and time; " * 4
    lines = folded(["plain", long]).splitlines()
    assert lines[0] == "plain"
    assert max(map(len, lines)) <= 80
    assert len(lines) > 3
    assert all(line.startswith("    ") for line in lines[2:])
    assert " ".join(" ".join(lines[1:]).split()) == long.strip()


def test_a_moment_too_small_to_bend_anything_is_no_weight_that_moves(context: Context) -> None:
    """A couch that rolls and pitches by degrees turns its weight's moment about the plumb line by some mN m: as a
    function of the two angles that is their product, and a coupling of them would be called a weight."""
    by_weight = [k for k in library(context) if k.columns[0].function == "own_weight"]
    assert {k.joint for k in by_weight} >= {"longitudinal", "yaw"}
    for k in by_weight:
        moment = k.columns[0].value(context)
        assert moment.std() > 0.05, k
    assert ("roll", "ry") not in {(k.joint, k.component) for k in by_weight}


def test_lost_motion_that_a_load_takes_up_is_said_with_what_is_left_of_it(context: Context) -> None:
    taken_up = next(k for k in library(context) if k.effect == "backlash" and "pressed" in k.columns[-1].args)
    unit = "mm" if str(taken_up.component).startswith("t") else "mrad"
    said = sentence(context, taken_up, np.array([-5e-5, 4e-5]), 1e-4)
    assert f"by 0.100 {unit} (0.020 {unit} at twice its mean load)" in said
    # more than all of it: it said 0.100 once more, as if the gap opened under its load (a reviewer's)
    said = sentence(context, taken_up, np.array([-5e-5, 1e-4]), 1e-4)
    assert f"by 0.100 {unit} (nothing from 1.50 times its mean load on)" in said


def of(effect: str, joint: str | None, **more: float) -> dict[str, object]:
    return {"effect": effect, "joint": joint, **more}


def test_visits_are_asked_for_where_a_finding_may_well_be_another_effect() -> None:
    far, near = (of("friction_hysteresis", "yaw", alike=0.95, sqrt_lambda_apart=x) for x in (9.0, 2.0))
    drift = of("drift", None, weight=0.3)
    play = of("backlash", "yaw")

    def asked(alternatives: list[object], aliases: list[object]) -> tuple[str, str, str | None] | None:
        return to_separate({**play, "alternatives": alternatives, "aliases": aliases})

    assert to_separate(Mistake("Fx", -1.0, "has the opposite sign", 1.0, 0.1).finding()) is None
    assert asked([], [far]) is None
    likely = of("friction_hysteresis", "yaw", weight=0.3)
    assert asked([likely], []) == ("backlash", "friction_hysteresis", "yaw")
    assert asked([likely], [far]) is None  # forms are told apart already: `plan` wrote nothing
    never = of("friction_hysteresis", "yaw", alike=0.95, sqrt_lambda_apart=2.0, never_told_apart=True)
    assert asked([likely], [never]) is None  # `as_well`
    assert asked([], [far, near]) == ("backlash", "friction_hysteresis", "yaw")
    assert asked([of("nameless", None, weight=0.3)], []) is None
    assert asked([of("drift", None, weight=0.05)], []) is None
    assert asked([drift], [near]) == ("backlash", "drift", "yaw")
    assert asked([of("backlash", "roll", weight=0.4)], []) is None  # no visits are planned for which joint it is
    assert asked([of("creep", "roll", weight=0.4)], []) == ("backlash", "creep", None)


def test_growth_by_two_thermometers_is_of_the_one_that_it_follows(context: Context) -> None:
    both = next(
        k for k in library(context)
        if k.effect == "thermal_growth" and len({column.args["place"] for column in k.columns}) == 2
    )  # fmt: skip
    places = [column.args["place"] for column in both.columns]
    swings = np.array([column.value(context).std() for column in both.columns])
    for moves, place in (([1.0, 1.1], places[1]), ([-1.1, 1.0], places[0])):
        values = 1e-5 * np.array(moves) / swings
        assert _by_its_thermometer(context, both, values).covariate == f"temp_{place}_C"
    assert swings[1] > 1.1 * swings[0]  # so that the first does more per kelvin in both


def test_the_region_of_a_load_is_of_the_one_that_acts_there(context: Context) -> None:
    falls = next(k for k in library(context) if k.effect == "clearance")
    assert _where_it_acts(falls) == f"on_{falls.frame}_{falls.covariate}"
    sensor = next(k for k in library(context) if k.effect == "wrench_error" and k.covariate == "Mx")
    assert _where_it_acts(sensor) == "Mx"
    play = next(k for k in library(context) if k.effect == "backlash")
    assert (play.covariate, _where_it_acts(play)) == (f"approach_{play.joint}", f"q_{play.joint}")


def test_where_nothing_was_found_it_is_said_from_which_size_on_something_would_have_been() -> None:
    """45 visits with a clearance of 0.15 mm were consistent without a word (a reviewer's)."""
    rows = [
        {"effect": effect, "joint": joint, "detectable_mm": size}
        for effect, joint, size in (("creep", "turn", 1.8211), ("backlash", "arm", 0.1239), ("drift", None, 0.4))
    ]
    said = "nine of ten such recordings would show backlash of arm from 0.124 mm rms on, creep of turn from 1.821 mm on"
    assert would_have_shown(rows) == said
    hidden = {"effect": "missing_compliance", "joint": "arm", "detectable_mm": 1e3 * NEVER}
    assert would_have_shown([hidden, *rows]) == f"{said}, and 1 of 4 at no size"
    assert would_have_shown([hidden]) is None
