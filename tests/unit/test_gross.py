"""Visits that are simply wrong, and those that only look so beside structure that nobody can name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ppshw.diagnosis.gross import GrossErrors, gross_errors, still_gross
from ppshw.diagnosis.workspace import Workspace, prepare
from tests.unit.clean_case import clean_case

BAD, OFF = 17, 0.9e-3  # the visit, and how far all reflectors are off along one axis [m]


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    machine, recording = clean_case(60533, "pps", 240, 180, tmp_path_factory.mktemp("clean"))
    return prepare(machine, recording, np.ones(len(recording), dtype=bool))


@pytest.fixture(scope="module")
def bad(clean: Workspace) -> Workspace:
    points = clean.recording.points.copy()
    points[BAD, :, 0] += OFF
    recording = replace(clean.recording, points=points)
    return prepare(clean.machine, recording, np.ones(len(recording), dtype=bool))


def test_a_wrong_visit_is_found_and_none_in_a_clean_recording(clean: Workspace, bad: Workspace) -> None:
    assert gross_errors(clean).visits == ()
    assert gross_errors(bad).visits == (BAD,)


@pytest.fixture(scope="module")
def aside(bad: Workspace) -> Workspace:
    """Fitted to the others."""
    believed = np.arange(len(bad.recording)) != BAD
    return prepare(bad.machine, bad.recording, believed)


def test_a_visit_stays_wrong_until_something_explains_it(clean: Workspace, bad: Workspace, aside: Workspace) -> None:
    gross = gross_errors(bad)
    assert still_gross(aside, gross).visits == (BAD,)
    assert still_gross(clean, gross).visits == ()  # what was odd is gone from the data


def test_beside_a_riddle_a_visit_must_be_off_by_more_than_it_leaves(bad: Workspace, aside: Workspace) -> None:
    gross = gross_errors(bad)
    assert still_gross(aside, gross, riddle=0.1e-3).visits == (BAD,)
    assert still_gross(aside, gross, riddle=0.3e-3).visits == ()


@pytest.mark.parametrize(("amount", "kept"), [(0.3e-3, (BAD,)), (1.5e-3, ())])
def test_a_visit_that_a_finding_moves_further_than_it_is_off_is_what_its_form_leaves(
    aside: Workspace, amount: float, kept: tuple[int, ...]
) -> None:
    """Everything is thrown to and fro along one axis, in a way that no machine does."""
    sides = np.random.default_rng(3).choice([-1.0, 1.0], size=len(aside.recording))
    column = np.zeros(aside.data.shape)
    column[:, ::3] = sides[:, None]
    shaken = replace(aside, data=aside.data + amount * column)
    shaken.take_up(column[..., None], np.array([1.0]))
    assert still_gross(shaken, GrossErrors(visits=(BAD,))).visits == kept
