"""The Bayesian Cramér-Rao bound against hand calculation, and against drawn machines that are as it supposes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ppshw.machine import Machine, load_machine
from ppshw.recording import Recording, load_recording
from ppshw.studies.bound import Ensemble, Functions, bound

Array = NDArray[np.float64]
RAIL = """
name: rail
gravity: [0, 0, -9.80665]
joints:
  - {name: rail, type: prismatic, axis: [1, 0, 0], limits: {lower: -1, upper: 1}}
tip: {origin: {xyz: [0, 0, 0.5]}, targets: {ball: [0, 0, 0]}}
tracker: {position_sigma: 2.0e-5}
"""
STILL = np.zeros((1, 6))


@pytest.fixture
def rail(tmp_path: Path) -> Machine:
    path = tmp_path / "rail.yaml"
    path.write_text(RAIL, encoding="utf-8")
    return load_machine(path)


def visits(folder: Path, machine: Machine, q: Array) -> Recording:
    path = folder / "visits.csv"
    path.write_text("q_rail,ball_x,ball_y,ball_z\n" + "".join(f"{x!r},{x!r},0,0.5\n" for x in q.tolist()))
    return load_recording(path, machine)


def rails(sizes: Array, shape: Array) -> list[Functions]:
    """Rails whose error is one shape (121, 6) over the travel, a size for each rail."""
    return [Functions([size * shape], [None]) for size in sizes]


def test_one_unknown_shift_is_known_to_prior_and_readings_together(rail: Machine, tmp_path: Path) -> None:
    """1/(1/s² + N/(σ² + u²)) per component: s = 1 mm, 25 visits, 20 µm of tracker, 50 µm of repeatability."""
    sizes = np.array([1e-3, -1e-3])
    shape = np.zeros((121, 6))
    shape[:, :3] = 1.0
    kind = Ensemble.of(rail, rails(sizes, shape))
    there = visits(tmp_path, rail, np.linspace(-0.9, 0.9, 25))
    scatter = np.array([[5e-5, 5e-5, 5e-5, 0, 0, 0]])
    found = bound(kind, there, there.subset(np.arange(3)), np.zeros(3), scatter)
    expected = np.sqrt(3 / (1 / 1e-6 + 25 / (4e-10 + 25e-10))) * 1e3
    assert found.rms_mm == pytest.approx(expected, rel=1e-6)


def test_what_the_visits_cannot_see_keeps_its_prior(tmp_path: Path) -> None:
    """A ball on the rail's axis says nothing of its turns; half a metre above it 1 mrad is 0.5 mm."""
    path = tmp_path / "rail.yaml"
    path.write_text(RAIL.replace("ball: [0, 0, 0]", "ball: [0, 0, -0.5]"), encoding="utf-8")
    rail = load_machine(path)
    shape = np.zeros((121, 6))
    shape[:, 3:] = 1.0
    kind = Ensemble.of(rail, rails(np.array([1e-3, -1e-3]), shape))
    there = visits(tmp_path, rail, np.linspace(-1, 1, 9))
    above = bound(kind, there, there, np.zeros(3), STILL)
    assert above.rms_mm == pytest.approx(np.sqrt(2) * 0.5, rel=1e-6)  # about x and y; about z nothing moves
    on_the_axis = bound(kind, there, there, np.array([0.0, 0.0, -0.5]), STILL)
    assert on_the_axis.rms_mm == pytest.approx(0.0, abs=1e-9)


def test_no_estimate_of_machines_as_supposed_is_better_than_the_bound_and_the_best_one_reaches_it(
    rail: Machine, tmp_path: Path
) -> None:
    """Straightness as two long waves of independent normal sizes, read with 20 µm. The best estimate is the posterior
    mean; it is computed here in function space, by kriging, which shares no line with the bound's parameters."""
    rng = np.random.default_rng(3)
    x = np.linspace(-1, 1, 121)
    waves = np.stack([np.sin(2 * x), np.cos(3 * x)])
    many = [Functions([np.einsum("ck,kg->gc", a, waves)], [None]) for a in _sizes(rng, 4000)]
    kind = Ensemble.of(rail, many)
    q, points = np.linspace(-0.9, 0.9, 7), np.linspace(-1, 1, 21)
    found = bound(kind, visits(tmp_path, rail, q), visits(tmp_path, rail, points), np.zeros(3), STILL)

    def kernel(a: Array, b: Array) -> Array:
        return np.asarray(1e-8 * (np.multiply.outer(np.sin(2 * a), np.sin(2 * b))
                                  + np.multiply.outer(np.cos(3 * a), np.cos(3 * b))))  # fmt: skip

    gain = kernel(points, q) @ np.linalg.inv(kernel(q, q) + 4e-10 * np.eye(7))
    square = []
    for a in _sizes(rng, 3000)[:, :3]:
        truth, seen = (np.einsum("ck,kg->gc", a, np.stack([np.sin(2 * t), np.cos(3 * t)])) for t in (points, q))
        square.append(((gain @ (seen + 2e-5 * rng.normal(size=seen.shape)) - truth) ** 2).sum(axis=1).mean())
    assert found.rms_mm == pytest.approx(np.sqrt(np.mean(square)) * 1e3, rel=0.03)


def _sizes(rng: np.random.Generator, count: int) -> Array:
    """(count, 6, 2): shifts of 0.1 mm, no turns."""
    return np.asarray(rng.normal(size=(count, 6, 2)) * np.repeat([1e-4, 0.0], 3)[:, None])
