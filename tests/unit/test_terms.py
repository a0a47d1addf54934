"""Terms and their bases: derivatives by finite differences, beams by hand, files that give back what they were told."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import ppshw.terms
from ppshw.machine import load_machine
from ppshw.model import Model
from ppshw.terms import FrameTerm, Situation
from ppshw.terms.basis import Basis, Constant, Interpolated, Polynomial, Smooth, basis_from_dict
from ppshw.terms.elastic import Compliance, pattern, skew
from ppshw.terms.geometric import Geometric
from ppshw.terms.own_motion import OwnMotion
from ppshw.terms.target import TargetOffset
from simulators.beams import along, box, cantilever, turned

Array = NDArray[np.float64]
PPS = load_machine(Path(__file__).parents[2] / "machines/pps.yaml")
BASES: list[Basis] = [
    Constant(),
    Smooth(0.1, 1.0, 5),
    Polynomial(0.1, 1.0, 3),
    Interpolated((-0.9, -0.2, 0.3, 1.1)),
]
ALL_LOADS = tuple(range(6))
BEAM = tuple((a, b) for a in range(6) for b in range(a, 6))
TERMS: list[FrameTerm | TargetOffset] = [
    Geometric(0, Constant()),
    *(Geometric(k, basis) for k, basis in zip((1, 2, 3, 4), BASES, strict=True)),
    *(Compliance(k, BEAM, ALL_LOADS, basis) for k, basis in zip((2, 3, 5, 6), BASES, strict=True)),
    Compliance(1, ((1, 1), (1, 3)), (1, 3), Constant()),
    OwnMotion(1, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0, 1.125, 17, 40),
    OwnMotion(4, (0.0, 0.0, 0.0, 0.0, 1.0, 0.0), 0.0, 1.5, 30, 33),
    TargetOffset(tuple(PPS.targets)),
]


def situations(count: int = 6) -> Situation:
    rng = np.random.default_rng(3)
    lower, upper = PPS.limits()
    force = np.column_stack([20 * rng.normal(size=(count, 3)), 100 * rng.normal(size=(count, 3))])
    force[:, 1] -= 1500.0
    return Situation(rng.uniform(lower, upper, (count, PPS.n)), force, time=np.arange(count, dtype=float))


def model_of(term: FrameTerm | TargetOffset) -> Model:
    return Model(PPS, (), term) if isinstance(term, TargetOffset) else Model(PPS, (term,))


@pytest.mark.parametrize("term", TERMS, ids=lambda t: f"{t.kind}-{getattr(t, 'frame', '')}")
def test_every_term_moves_the_targets_as_its_regressors_say(term: FrameTerm | TargetOffset) -> None:
    """The model's derivative against central differences of its prediction, at zero and away from it.

    Away from zero the wrenches that a deflection shifts are left out of the derivative, a share of some 1e-3
    where the deflections are some millimetres.
    """
    model, situation = model_of(term), situations()
    parameters = model.parameters()
    start = np.array([p.start for p in parameters])
    somewhere = 0.2 * start * np.random.default_rng(7).normal(size=len(start))
    for theta, share in ((0.0 * start, 2e-6), (somewhere, 5e-3)):
        design = model.linearise(situation, theta).design
        for k in range(len(start)):
            step = np.zeros(len(start))
            step[k] = 1e-2 * start[k]
            moved = model.predict(situation, theta + step) - model.predict(situation, theta - step)
            numeric = moved / (2 * step[k])
            assert design[..., k] == pytest.approx(numeric, rel=share, abs=share * np.abs(numeric).max() + 1e-12)


def test_every_term_is_in_the_test_above() -> None:
    """A class with a `kind` and `parameters` in ppshw.terms is a term: whoever writes one puts it into TERMS."""
    modules = [importlib.import_module(f"ppshw.terms.{m.name}") for m in pkgutil.iter_modules(ppshw.terms.__path__)]
    classes = {
        c
        for module in modules
        for _, c in inspect.getmembers(module, inspect.isclass)
        if c.__module__ == module.__name__ and hasattr(c, "parameters") and hasattr(c, "kind")
    }
    assert classes == {type(t) for t in TERMS}


@pytest.mark.parametrize("term", TERMS, ids=lambda t: f"{t.kind}-{getattr(t, 'frame', '')}")
def test_a_term_has_one_name_and_unit_per_column(term: FrameTerm | TargetOffset) -> None:
    model = model_of(term)
    parameters = model.parameters()
    names = [p.name for p in parameters]
    assert len(set(names)) == len(names) == model.linearise(situations(), np.zeros(len(names))).design.shape[-1]
    assert {p.unit for p in parameters} <= {"m", "rad", "m/N", "rad/N", "rad/(N m)"}
    assert all(p.start > 0 for p in parameters)


@pytest.mark.parametrize("term", TERMS, ids=lambda t: f"{t.kind}-{getattr(t, 'frame', '')}")
def test_a_term_comes_back_from_its_own_description(term: FrameTerm | TargetOffset) -> None:
    assert type(term).from_dict(term.as_dict()) == term  # type: ignore[union-attr]


@pytest.mark.parametrize("basis", BASES, ids=lambda b: type(b).__name__)
def test_a_basis_is_held_outside_its_range_and_keeps_its_promises(basis: Basis) -> None:
    x = np.array([-50.0, -1.0, 0.1, 1.2, 50.0])
    values = basis.values(x)
    assert values.shape == (5, basis.size) == (5, len(basis.bands))
    edge = basis.values(np.array([-0.9, 1.1]))
    assert values[[0, -1]] == pytest.approx(edge)
    assert basis_from_dict(basis.as_dict()) == basis


def test_between_samples_the_papers_functions_are_straight_lines() -> None:
    basis = Interpolated((-1.0, 0.0, 2.0))
    heights = np.array([5.0, 1.0, 3.0])
    x = np.array([-1.0, -0.25, 0.0, 0.5, 2.0, 3.0, -7.0])
    assert basis.values(x) @ heights == pytest.approx([5.0, 2.0, 1.0, 1.5, 3.0, 3.0, 5.0])


def test_smooth_functions_have_a_line_and_bounded_waves() -> None:
    """At u = 0 of 1.2: sin(jπ/2)/j."""
    values = Smooth(0.1, 1.0, 3).values(np.array([0.1, 0.6]))
    assert values[0] == pytest.approx([1, 0, 1, 0, -1 / 3], abs=1e-12)
    assert values[1, 1] == pytest.approx(0.5)


def test_a_cantilever_droops_by_hand_calculation() -> None:
    """1 m, E I = 2e6 N m²: 1 kN at the end sinks F L³/3EI = 0.1667 mm and turns F L²/2EI = 0.25 mrad."""
    stiffness = 2e6
    beam = Compliance(3, ((1, 1), (1, 3), (3, 3)), (1, 3), Constant())
    theta = np.array([1 / (3 * stiffness), -1 / (2 * stiffness), 1 / stiffness])  # along +z; up turns it about −x
    wrenches = np.zeros((1, 7, 6))
    wrenches[0, 3, 1] = -1000.0
    error = beam.regressors(situations(1), wrenches)[0] @ theta
    assert error == pytest.approx([0, -1000 / 6e6, 0, 0.25e-3, 0, 0])


def test_the_elements_that_three_loads_can_excite_are_fifteen() -> None:
    """21 of a symmetric matrix, less the 6 whose both loads, of Fx, Fz and My, are absent."""
    elastic = PPS.joints[0].elastic
    assert elastic is not None
    assert len(pattern(elastic)) == 21 - 6


def test_a_compliance_takes_only_the_loads_that_act() -> None:
    term = Compliance(2, BEAM, (1,), Constant())
    wrenches = np.ones((1, 7, 6))
    regressors = term.regressors(situations(1), wrenches)[0]
    assert np.count_nonzero(regressors) == 6  # the column Fy of a symmetric matrix


@pytest.mark.parametrize("axis", np.eye(3))
def test_a_symmetric_beam_along_an_axis_has_no_skew_elements(axis: Array) -> None:
    beam = turned(cantilever(box(0.1, 0.2, 0.01, 2.1e11), np.array([1.2])), along(axis))[0]
    size = np.sqrt(np.diag(beam))
    there = np.abs(beam) > 1e-9 * np.outer(size, size)
    assert there.sum() == 6 + 2 * 2  # the diagonal, and bending in two planes
    assert not any(skew(a, b) for a, b in BEAM if there[a, b])


def test_elements_that_a_symmetric_beam_lacks_are_expected_smaller() -> None:
    found = {p.name: p for p in Compliance(1, BEAM, ALL_LOADS, Constant()).parameters(PPS.frame_names)}
    assert found["lateral.C[tx,Mx][0]"].scale == pytest.approx(0.2 * found["lateral.C[tx,My][0]"].scale)
    assert found["lateral.C[rx,My][0]"].scale == pytest.approx(0.2 * found["lateral.C[rx,Mx][0]"].scale)
    assert len({p.group for p in found.values()}) == 21
