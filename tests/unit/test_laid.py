"""Columns kept as functions of the visits say the same as the readings that they move."""

from __future__ import annotations

import numpy as np
import pytest

from ppshw.diagnosis import laid
from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.laid import Laid
from ppshw.diagnosis.library import library
from ppshw.diagnosis.workspace import Workspace, prepare
from ppshw.terms.shapes import Column
from tests.unit.clean_case import clean_case

COLUMNS = (
    Column("frame", "wave", {"joint": 0, "period": 0.3, "phase": "sin"}, 1, 0),
    Column("frame", "wave", {"joint": 0, "period": 0.3, "phase": "cos"}, 1, 0),
    Column("points", "scale", {}),
    Column("frame", "approach", {"joint": 3}, 4, 5),
    Column("frames", "sensor_error", {"component": 1}),
    Column("frame", "clock", {"form": "linear"}, 0, 4),
)


@pytest.fixture(scope="module")
def space(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """With some lost targets and some visits that are not for the fit."""
    machine, recording = clean_case(60533, "pps", 240, 180, tmp_path_factory.mktemp("clean"))
    recording.points[3:60:7, 1] = np.nan
    return prepare(machine, recording, np.arange(len(recording)) % 11 != 0)


@pytest.fixture(scope="module")
def whole(space: Workspace) -> np.ndarray:
    """(F·3T, K) the columns whitened, at unit rms at the reflectors."""
    raw = np.stack([column.evaluate(space.context) for column in COLUMNS], axis=2)
    return space.whiten(raw / np.sqrt((raw**2).sum(axis=(0, 1)) / space.recording.seen.sum()))


def test_products_with_readings_are_those_of_the_readings_that_a_column_moves(
    space: Workspace, whole: np.ndarray
) -> None:
    x = np.random.default_rng(1).standard_normal((len(whole), 3))
    one = Laid(space, COLUMNS)
    assert np.allclose(one.rows(np.arange(len(COLUMNS))), whole.T, rtol=1e-5, atol=1e-4 * np.abs(whole).max())
    assert np.allclose(one.product(x), whole.T @ x, rtol=1e-4, atol=1e-4 * np.linalg.norm(whole[:, 0]))


@pytest.mark.parametrize("cores", ["1", "3"])
def test_the_parts_that_are_worked_out_side_by_side_are_together_all_columns(
    space: Workspace, whole: np.ndarray, monkeypatch: pytest.MonkeyPatch, cores: str
) -> None:
    monkeypatch.setenv("PYTHON_CPU_COUNT", cores)
    x, at_one_go = np.random.default_rng(4).standard_normal((len(whole), 2)), Laid(space, COLUMNS)
    product = at_one_go.product(x)
    monkeypatch.setattr(laid, "BLOCK", 1)
    monkeypatch.setattr(laid, "FIELDS", 1)
    in_parts = Laid(space, COLUMNS)
    assert np.allclose(in_parts.product(x), product, rtol=1e-5)
    assert np.allclose(in_parts.seen(), at_one_go.seen(), rtol=1e-9)
    assert np.allclose(in_parts.scale, at_one_go.scale, rtol=1e-12)


def test_information_is_what_the_base_model_leaves_of_columns_together(space: Workspace, whole: np.ndarray) -> None:
    """Of two on one component of a frame, of two at different places, of what is on no frame."""
    one, left = Laid(space, COLUMNS), whole.T @ space.absorb(whole)
    assert np.allclose(one.seen(), np.diag(left), rtol=1e-4)
    assert np.allclose(one.plain, (whole**2).sum(axis=0), rtol=1e-5)
    pairs = np.array([[0, 1], [0, 3], [2, 4], [5, 2]])
    scale = np.sqrt(np.diag(left))
    for pair, found in zip(pairs, one.information(pairs), strict=True):
        assert np.allclose(found, left[np.ix_(pair, pair)], atol=1e-4 * scale[pair].max() ** 2)


def test_scores_of_noise_scatter_by_the_information(space: Workspace, whole: np.ndarray) -> None:
    scores = Laid(space, COLUMNS).of_noise(np.random.default_rng(2), 4000)
    information = whole.T @ space.absorb(whole)
    scale = np.sqrt(np.diag(information))
    assert np.allclose(np.cov(scores) / np.outer(scale, scale), information / np.outer(scale, scale), atol=0.08)


def test_columns_are_told_apart_by_all_they_are_made_of() -> None:
    assert len({column.key for column in COLUMNS}) == len(COLUMNS)
    assert COLUMNS[0].key == Column("frame", "wave", dict(reversed(COLUMNS[0].args.items())), 1, 0).key


def test_what_stands_beside_a_candidate_is_accounted_for_in_whatever_units(space: Workspace) -> None:
    tried = Tried(space, library(space.context)[::40], space.unit)
    columns = np.stack([c.columns[0].evaluate(space.context) for c in tried.candidates[3::60]], axis=2)
    columns /= np.sqrt((columns**2).sum(axis=(0, 1)))
    rng = np.random.default_rng(3)

    def evidence(units: np.ndarray) -> np.ndarray:
        space.take_up(columns * units, 1e-3 / units)
        tried.update()
        said: np.ndarray = tried.evidence(tried.scores()[None])[0]
        return said

    try:
        plain = evidence(np.ones(columns.shape[2]))
        assert evidence(10.0 ** rng.uniform(-8.0, 6.0, columns.shape[2])) == pytest.approx(plain, abs=1e-3)
    finally:
        space.forget()
