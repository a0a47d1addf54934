"""How rare what was found is when nothing is there."""

from __future__ import annotations

from copy import copy
from pathlib import Path

import numpy as np
import pytest

from ppshw.diagnosis.evidence import DRAWS, corrected_residual, p_value
from ppshw.diagnosis.workspace import prepare
from ppshw.terms.shapes import Column
from tests.unit.clean_case import clean_case


def _evidence(rng: np.random.Generator, draws: int) -> np.ndarray:
    """The greatest log evidence of ten names, each the average over forty forms, when all is noise."""
    score = rng.standard_normal((draws, 10, 40))
    gain, size = 0.9, 10.0
    odds = np.exp(0.5 * gain * score**2) / np.sqrt(size)
    return np.asarray(np.log(odds.mean(axis=2)).max(axis=1))


def test_what_noise_does_once_in_two_thousand_times_is_not_said_to_be_rarer() -> None:
    rng = np.random.default_rng(5)
    rare = float(np.quantile(_evidence(rng, 40_000), 1 - 1 / 2000))
    said = [p_value(rare, _evidence(rng, DRAWS)) for _ in range(40)]
    assert 1 / 4000 < float(np.exp(np.mean(np.log(said)))) < 1 / 250


def test_within_the_draws_it_is_their_share_and_beyond_them_it_falls_with_the_odds() -> None:
    null = np.arange(199.0)
    assert p_value(149.0, null) == pytest.approx(51 / 200)
    assert p_value(-1.0, null) == 1.0
    assert p_value(206.0, null) == pytest.approx(p_value(204.0, null) * np.exp(-2.0))
    values = [p_value(x, null) for x in np.linspace(100.0, 230.0, 261)]
    assert values == sorted(values, reverse=True)
    assert p_value(5000.0, null) == 1e-300


def test_what_a_fit_leaves_of_noise_is_made_as_large_as_noise_at_every_visit(tmp_path: Path) -> None:
    """Of recordings that the base model, a finding and noise make at random: a fit to eighty visits bends to each of
    them and leaves of the noise's variance two thirds, at some a third. Signs drawn at random of that would be of too
    little."""
    machine, recording = clean_case(60533, "pps", 80, 80, tmp_path)
    space = copy(prepare(machine, recording, np.ones(80, dtype=bool)))
    space.take_up(Column("frame", "approach", {"joint": 3}, 4, 5).evaluate(space.context)[..., None], np.array([1e-3]))
    live = np.repeat(recording.seen, 3, axis=1)
    rng, left, corrected = np.random.default_rng(6), [], []
    for _ in range(150):
        meant = space.white @ rng.normal(0.0, space.prior) + space.taken_white @ rng.normal(0.0, space.taken_prior)
        space.y = meant + (live * rng.normal(size=live.shape)).ravel()
        left.append(space.left().reshape(live.shape))
        corrected.append(corrected_residual(space))
    before, after = (np.square(each).sum(axis=(0, 2)) / 150 / live.sum(axis=1) for each in (left, corrected))
    assert before.mean() == pytest.approx(0.7, abs=0.05)
    assert before.min() < 0.4
    assert after.mean() == pytest.approx(1.0, abs=0.03)
    # but for what a fit leaves next to nothing of
    assert (np.abs(after - 1.0) < 0.15).mean() > 0.95
