"""Noise of which each visit has some of the one before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.found import Found, take_up
from ppshw.diagnosis.nameless import nameless
from ppshw.diagnosis.serial import SerialNoise, drop_what_noise_may_be, sentence
from ppshw.diagnosis.workspace import Workspace, prepare
from ppshw.terms import Situation
from tests.unit.clean_case import clean_case


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    machine, recording = clean_case(60533, "pps", 300, 300, tmp_path_factory.mktemp("clean"))
    return prepare(machine, recording, np.ones(len(recording), dtype=bool))


def remembering(space: Workspace, correlation: float, seed: int) -> Workspace:
    """The same visits of a machine whose end effector's scatter remembers, drawn here visit by visit."""
    rng = np.random.default_rng(seed)
    noise, recording = space.base.noise, space.recording
    levers = space.base.model.linearise(Situation.of(recording), space.base.theta).levers[..., :6]
    spread = np.linalg.cholesky(noise.pose + 1e-18 * np.eye(6))
    swing = np.zeros(6)
    read = []
    for lever in levers:  # (T, 3, 6)
        fresh = spread @ rng.standard_normal(6)
        swing = correlation * swing + np.sqrt(1 - correlation**2) * fresh if read else fresh
        read.append(lever @ swing + noise.instrument * rng.standard_normal(lever.shape[:2]))
    fitted = space.design @ space.coefficients()[0]
    return replace(space, data=fitted + np.array(read).reshape(fitted.shape))


def test_noise_of_the_models_own_is_white_and_remembers(clean: Workspace) -> None:
    noise = SerialNoise.of(clean)
    drawn = noise.draws(0.6, 400, np.random.default_rng(1))
    np.testing.assert_allclose(drawn.var(axis=0).mean(), 1.0, atol=0.01)
    near = np.einsum("dnr,dnr->n", drawn[:, 1:], drawn[:, :-1]) / len(drawn)
    scatter = np.einsum("nrf,nrf->n", noise.freedoms[1:], noise.freedoms[:-1])
    assert near.mean() > 0.3 * scatter.mean() > 0.0
    np.testing.assert_allclose(near.mean(), 0.6 * scatter.mean(), rtol=0.05)
    still = noise.draws(0.0, 400, np.random.default_rng(1))
    assert abs(np.einsum("dnr,dnr->n", still[:, 1:], still[:, :-1]).mean() / len(still)) < 0.02


@pytest.mark.parametrize("correlation", [0.3, 0.5, 0.7])
def test_the_correlation_is_found_though_the_fit_took_half_of_it(clean: Workspace, correlation: float) -> None:
    found = [
        SerialNoise.of(clean).correlation(remembering(clean, correlation, seed), np.random.default_rng(seed))
        for seed in range(4)
    ]
    assert abs(np.mean(found) - correlation) < 0.1, found


def test_independent_noise_does_not_remember(clean: Workspace) -> None:
    noise = SerialNoise.of(clean)
    assert noise.correlation(clean, np.random.default_rng(0)) == 0.0
    for seed in range(6):
        assert noise.correlation(remembering(clean, 0.0, seed), np.random.default_rng(seed)) == 0.0


def wandering(space: Workspace) -> tuple[Tried, list[Found]]:
    """That the base wanders with time, found as the search would have it."""
    candidates = [k for k in nameless(space.context) if k.covariates == ("time",) and k.frame == "base"]
    tried = Tried(space, candidates, space.unit)
    evidence, names = tried.said()
    best = int(np.argmax(evidence))
    found = [Found(best, tried.name(best), 0.001, float(names[0]), first=float(names[0]))]
    take_up(space, tried, found)
    return tried, found


@pytest.mark.long
def test_what_such_noise_says_as_well_is_dropped(clean: Workspace) -> None:
    """In four of ten recordings of such noise a base that wanders says 4 to 5 of log evidence, which signs of visits
    take for one in ten thousand; these four."""
    kept = 0
    for seed in (0, 2, 3, 9):
        space = remembering(clean, 0.6, seed)
        tried, found = wandering(space)
        assert found[0].evidence > 3.5
        drop_what_noise_may_be(space, tried, found, np.random.default_rng(0))
        kept += len(found)
    assert kept <= 1


def test_what_stands_out_from_such_noise_stays(clean: Workspace) -> None:
    space = remembering(clean, 0.6, 0)
    goes = clean.context.hours / clean.context.hours[-1]
    along_x = np.zeros(space.rows)
    along_x[0::3] = 1.0
    space = replace(space, data=space.data + 6.0 * space.unit * goes[:, None] * along_x)
    tried, found = wandering(space)
    drop_what_noise_may_be(space, tried, found, np.random.default_rng(0))
    assert [f.p < 0.01 for f in found] == [True]


def test_beside_independent_noise_nothing_is_dropped(clean: Workspace) -> None:
    space = remembering(clean, 0.0, 5)
    tried, found = wandering(space)
    drop_what_noise_may_be(space, tried, found, np.random.default_rng(0))
    assert len(found) == 1


def test_it_is_said_where_it_is_there() -> None:
    assert sentence({"serial_correlation": 0.0}) is None
    assert sentence({}) is None
    assert "0.42 of that of the visit before" in str(sentence({"serial_correlation": 0.42}))
