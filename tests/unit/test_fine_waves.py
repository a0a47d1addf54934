"""Waves finer than each can be tried: the residual shows their period, along a joint's travel and across."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.fine_waves import LINEAR, fine_waves
from ppshw.diagnosis.library import library
from ppshw.diagnosis.library.by_position import FINE_ACROSS, FineWave, half_waves_tried
from ppshw.diagnosis.nameless import nameless
from ppshw.diagnosis.parameters import spread_of
from ppshw.diagnosis.wording import sentence
from ppshw.diagnosis.workspace import Workspace, prepare
from tests.unit.clean_case import clean_case

RAIL, PERIOD, HEIGHT = 0, 0.0041, 1.5e-4  # joint, period [m], half the way from crest to hollow [m]


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    machine, recording = clean_case(60534, "pps", 240, 180, tmp_path_factory.mktemp("clean"))
    return prepare(machine, recording, np.ones(len(recording), dtype=bool))


def moved(clean: Workspace, component: int) -> Workspace:
    """Its first rail carries everything by a wave along an axis of its own frame; noise known as once that is."""
    q = clean.recording.q[:, RAIL]
    way = clean.context.chain[:, RAIL + 1, :3, component]
    by = (HEIGHT * np.sin(2 * np.pi * q / PERIOD + 0.4))[:, None] * way
    points = clean.recording.points + by[:, None] @ clean.base.measuring_in_base[:3, :3]
    return prepare(clean.machine, replace(clean.recording, points=points), clean.fit, clean.base)


def of_its_joint(waves: list[FineWave], component: int) -> FineWave:
    return next(w for w in waves if (w.joint, w.component) == (RAIL, component))


def test_a_wave_along_and_one_across_a_travel_have_their_period(clean: Workspace) -> None:
    span = float(np.ptp(clean.recording.q[:, RAIL]))
    assert 2 * span / half_waves_tried(clean.context, RAIL)[-1] > PERIOD > LINEAR  # no candidate of every joint's
    own, tried = int(np.argmax(np.abs(clean.machine.joints[RAIL].axis))), []
    for component in range(3):
        found = of_its_joint(fine_waves(moved(clean, component)), component)
        assert found.period == pytest.approx(PERIOD, rel=0.2 * PERIOD / span)  # a fifth of a wave over the travel
        tried.append(found.tried)
    assert int(np.argmin(tried)) == own  # whose longer ones are candidates of every joint's


@pytest.mark.long
def test_it_has_a_name_that_says_which_way_and_structure_where_the_name_is_taken_out(clean: Workspace) -> None:
    own = int(np.argmax(np.abs(clean.machine.joints[RAIL].axis)))
    said = []
    for component in (own, (own + 1) % 3):
        space = moved(clean, component)
        waves = fine_waves(space)
        tried = Tried(space, library(space.context, fine_waves=waves), space.unit)
        evidence, names = tried.said()
        best = int(np.argmax(names))
        assert tried.names[best] == ("periodic_transmission", clean.machine.joint_names[RAIL])
        candidate = tried.candidates[tried.strongest(evidence, best)]
        assert candidate.shape["period"] == pytest.approx(PERIOD, rel=2e-3)
        spread = spread_of(tried, tried.strongest(evidence, best), evidence)["period"]
        assert abs(candidate.shape["period"] - PERIOD) < 3.0 * spread < 1e-3 * PERIOD
        said.append(sentence(space.context, candidate, np.array([HEIGHT, 0.0]), 1e-4))
        without = [*library(space.context, frozenset({"periodic_transmission"})), *nameless(space.context, (), waves)]
        tried = Tried(space, without, space.unit)
        evidence, names = tried.said()
        assert tried.names[int(np.argmax(names))] == ("nameless", None)
        riddle = tried.candidates[int(np.argmax(evidence + tried.log_share))]
        assert riddle.covariates == (f"q_{clean.machine.joint_names[RAIL]}",)
        # a second look asks out of bands of waves, of which it is none
        again = library(space.context, bands=[riddle], fine_waves=waves)
        assert len(again) == len(library(space.context, fine_waves=waves))
    assert "along its own travel: a screw" in said[0]
    assert "across its own travel" in said[1]


def test_what_a_wave_is_worth_counts_all_that_it_was_chosen_from(clean: Workspace) -> None:
    assert fine_waves(clean) == []
    shares = []
    for tried in (10, 1000):
        candidates = library(clean.context, fine_waves=[FineWave(RAIL, 4, PERIOD, tried)])
        periodic = [k for k in candidates if k.effect == "periodic_transmission"]
        assert sum(k.share for k in periodic) == pytest.approx(1.0)
        near = [k.share for k in periodic if abs(k.shape["period"] / PERIOD - 1.0) < 1e-3]
        assert len(near) == 5
        shares.append(sum(near))
    assert shares[0] == pytest.approx(100 * shares[1], rel=0.01)
    assert shares[0] < FINE_ACROSS / 10
