"""What a recording shows of each effect: sizes that are found nine times of ten, aliases that are real."""

from __future__ import annotations

import numpy as np
import pytest

from campaigns.foresight import foresee
from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.library import library
from ppshw.diagnosis.visibility import (
    NEVER,
    Alias,
    across,
    alias_words,
    aliases_of,
    directions,
    displaced,
    least,
    mimicked,
    sights,
    thinned,
    visibility,
)  # fmt: skip
from tests.unit.small_campaign import RANDOM, planned, positioner


@pytest.fixture(scope="module")
def tried(tmp_path_factory: pytest.TempPathFactory) -> Tried:
    return foresee(planned(RANDOM, positioner(), tmp_path_factory.mktemp("random")), most=6).tried


def test_nine_draws_of_ten_of_the_size_said_are_found(tried: Tried) -> None:
    rng = np.random.default_rng(8)
    noise = tried.laid.of_noise(rng, 200).T
    found, enough = [], least(tried)
    for sight in sights(tried):
        if not sight.visible:  # the base model takes the typical form whole
            continue
        field = sight.seen_at * across(tried, directions(tried, np.array([sight.form])))
        evidence = tried.by_name(tried.evidence(noise + field))[:, tried.names.index(sight.name)]
        found.append(float((evidence >= enough).mean()))
    assert len(found) > 20
    assert np.mean(found) == pytest.approx(0.9, abs=0.03)
    assert min(found) > 0.8


def test_an_effect_is_its_own_alias_and_a_different_place_is_none(tried: Tried) -> None:
    seen = sights(tried)
    alike = mimicked(tried, across(tried, directions(tried, np.array([s.form for s in seen]))))
    own = [alike[k, tried.names.index(s.name)] for k, s in enumerate(seen) if np.isfinite(tried.log_share[s.form])]
    assert np.array(own) == pytest.approx(1.0, abs=0.02)  # one of its own forms is the form itself
    assert alike[[s.name for s in seen].index(("backlash", "yaw")), tried.names.index(("backlash", "lateral"))] < 0.2
    assert ("backlash", "lateral") not in [a.name for a in aliases_of(tried, ("backlash", "yaw"))]


def test_friction_that_turns_within_a_small_part_of_the_travel_is_an_alias_of_backlash(tried: Tried) -> None:
    assert ("friction_hysteresis", "pitch") in [a.name for a in aliases_of(tried, ("backlash", "pitch"))]


def test_the_louder_an_effect_the_farther_its_aliases_are_apart(tried: Tried) -> None:
    sight = next(s for s in sights(tried) if s.name == ("backlash", "pitch"))
    white = tried.space.whiten(displaced(tried, sight.form)[..., None])
    of_one = np.sqrt(float(white[:, 0] @ tried.space.absorb(white)[:, 0]))
    for loud in (7.0, 21.0):
        found = aliases_of(tried, sight.name, sight.form, loud / of_one / tried.scale[tried.index[sight.form]])
        assert ("friction_hysteresis", "pitch") in [a.name for a in found]
        for alias in found:
            assert alias.apart == pytest.approx(loud * np.sqrt(1.0 - alias.alike), rel=1e-3)


def test_what_is_told_apart_is_said_otherwise_than_what_is_not() -> None:
    name = ("backlash", "roll")
    near = Alias(("friction_hysteresis", "roll"), 0.97, 1.4)
    far = [Alias(("creep", "yaw"), 0.93, 12.3), Alias(("drift", None), 0.91, 15.0)]
    assert alias_words(name, [near]) == " This recording cannot tell it from friction hysteresis."
    said = " Nearly like it, though such recordings tell them apart by 12 standard deviations: creep of yaw, drift."
    assert alias_words(name, far) == said
    assert alias_words(name, [far[0], near, far[1]]) == alias_words(name, [near]) + said
    assert alias_words(name, []) == ""


def test_the_share_said_is_what_the_base_model_leaves_with_the_strengths_that_it_learnt(tried: Tried) -> None:
    learnt = tried.space.as_learnt()
    for sight in sights(tried)[::7]:
        white = learnt.whiten(displaced(tried, sight.form)[..., None])
        left = float(white[:, 0] @ learnt.absorb(white)[:, 0])
        assert sight.share == pytest.approx(left / float(white[:, 0] @ white[:, 0]), rel=1e-3, abs=1e-6)


def test_the_size_said_is_the_rms_at_the_reflectors_of_the_field_that_is_found(tried: Tried) -> None:
    readings = int(tried.space.recording.seen.sum())
    for sight in [s for s in sights(tried) if s.visible][::7]:
        field = displaced(tried, sight.form)
        white = tried.space.whiten(field[..., None])
        strength = np.sqrt(float(white[:, 0] @ tried.space.absorb(white)[:, 0]))
        rms = np.sqrt((field**2).sum() / readings)
        assert sight.detectable * strength / rms == pytest.approx(sight.seen_at, rel=0.01)


def test_evidence_of_one_name_is_that_among_all_names(tried: Tried) -> None:
    scores = np.random.default_rng(2).normal(size=(3, len(tried.scale)))
    every = tried.by_name(tried.evidence(scores))
    alone = tried.evidence_of(("creep", "yaw"), scores)
    assert alone == pytest.approx(every[:, tried.names.index(("creep", "yaw"))], rel=1e-9)


def test_chance_alone_reaches_what_a_finding_needs_in_three_of_a_hundred_at_most(tried: Tried) -> None:
    noise = tried.laid.of_noise(np.random.default_rng(5), 300).T
    alarms = (tried.by_name(tried.evidence(noise)).max(axis=1) >= least(tried)).mean()
    assert alarms <= 0.06  # 3 % and three standard deviations of 300 draws


def test_rows_say_what_the_contract_asks_for(tried: Tried) -> None:
    rows = visibility(tried)
    assert {"effect", "joint", "share", "detectable_mm", "aliases"} <= set(rows[0])
    assert all(0.0 <= r["share"] <= 1.0 and r["detectable_mm"] > 0 for r in rows)
    assert all(r["share_range"][0] <= r["share"] <= r["share_range"][1] for r in rows)
    assert all(r["detectable_range_mm"][0] <= r["detectable_mm"] <= r["detectable_range_mm"][1] for r in rows)


def test_a_best_tenth_that_shows_is_said_where_the_typical_form_does_not(tried: Tried) -> None:
    hidden = [s for s in sights(tried) if not s.visible]
    assert all(s.detectable == NEVER and not s.aliases for s in hidden)
    assert any(s.detectables[0] < 1e-2 for s in hidden)


def test_forms_that_the_readings_of_a_sensor_rule_out_are_no_less_visible(tried: Tried) -> None:
    of_sensor = [k for k in tried.candidates if k.effect == "wrench_error"]
    others = [k for k in tried.candidates if k.effect != "wrench_error"]
    whole = next(r for r in visibility(tried) if r["effect"] == "wrench_error")
    worst = sorted(of_sensor, key=lambda k: float(tried.seen[tried.index[tried.candidates.index(k)]].sum()))[:1]
    out = [k for k in of_sensor if k is not worst[0]]
    rest = Tried(tried.space, others + worst, tried.unit, ruled_out=out)
    rows = visibility(rest)
    assert [(r["effect"], r["joint"]) for r in rows] == [s.name for s in sights(rest)]
    mine = next(r for r in rows if r["effect"] == "wrench_error")
    assert mine["detectable_mm"] == pytest.approx(whole["detectable_mm"], rel=0.1)
    assert mine["share"] == pytest.approx(whole["share"], rel=1e-6)  # in single precision


def test_fewer_forms_of_a_name_stand_for_all_of_them(tried: Tried) -> None:
    every = library(tried.space.context)
    kept, weights = thinned(every, 5)
    assert {(k.effect, k.joint) for k in kept} == {(k.effect, k.joint) for k in every}
    count: dict[tuple[str, str | None], float] = {}
    for k, w in zip(kept, weights, strict=True):
        count[k.effect, k.joint] = count.get((k.effect, k.joint), 0.0) + float(w)
    assert set(count.values()) == {5.0}
