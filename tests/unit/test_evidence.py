"""How rare what was found is when nothing is there."""

from __future__ import annotations

import numpy as np
import pytest

from ppshw.diagnosis.evidence import DRAWS, p_value


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
    values = [p_value(x, null) for x in np.linspace(100.0, 230.0, 131)]
    assert values == sorted(values, reverse=True)
    assert p_value(5000.0, null) == 1e-300
