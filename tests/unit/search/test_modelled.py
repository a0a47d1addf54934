"""What a calibration with an effect predicts, and how sure it is of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ppshw.calibration import load_calibration
from ppshw.compensation import Bounds, Compensator
from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.forms import near_forms
from ppshw.diagnosis.found import Found, by_its_own_form, take_up
from ppshw.diagnosis.modelled import _theta, extended
from ppshw.diagnosis.workspace import Workspace, prepare
from ppshw.evaluation import residuals
from tests.unit.search.by_hand import having_read, named, of_size


def test_a_wave_s_amplitude_is_its_own_where_it_has_harmonics(space: Workspace) -> None:
    """Without them in the fit a part of them was laid on it, by up to five of its standard deviations."""
    waves = [k for k in named(space, "periodic_transmission") if k.joint == "yaw" and len(k.columns) == 2]
    travel = float(np.ptp(space.recording.q[:, space.machine.joint_names.index("yaw")]))
    candidate = min(waves, key=lambda k: abs(k.columns[0].args["period"] - travel / 9))
    alike, (sine, cosine) = space.as_learnt(), candidate.columns
    twice = replace(sine, args={**sine.args, "period": sine.args["period"] / 2})
    moved = 1e-3 * sine.evaluate(space.context) + 4e-4 * twice.evaluate(space.context)
    there = having_read(alike, alike.data + moved)
    tried = Tried(there, [candidate], 5e-5)
    found = Found(0, (candidate.effect, candidate.joint), 1e-9, 50.0)
    take_up(there, tried, [found])
    values, covariance = by_its_own_form(there, candidate, found)
    off = values - [1e-3, 0.0]
    assert off @ np.linalg.solve(covariance, off) < 9.0
    assert cosine.args["phase"] == "cos"


@pytest.mark.long
def test_how_unsure_base_model_and_effect_are_is_that_of_a_fit_of_both_at_once(
    space: Workspace, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """What a clearance and a compliance may take from each other moves no prediction. Counted as if they were
    independent it made what was said several times too large."""
    alike = space.as_learnt()
    name = space.machine.joint_names[1]
    candidates = [k for k in named(space, "clearance") if k.joint == name and len(k.columns) == 1]
    fields = [k.columns[0].evaluate(space.context) for k in candidates]
    whites = [alike.whiten(field[..., None]) for field in fields]
    shares = [float((white.T @ alike.absorb(white)).item() / (white.T @ white).item()) for white in whites]
    best = int(np.argmin(shares))
    assert shares[best] < 0.15  # most of it a compliance may stand for
    candidate, moved = candidates[best], fields[best]
    column = of_size(alike, moved, 1.0)
    unit = float(np.linalg.norm(column) / np.linalg.norm(moved))
    model = having_read(alike, alike.data + 2 * column)
    model.take_up(moved[..., None], np.array([unit]))
    made = extended(model, [(Found(0, ("clearance", name), 1e-9, 50.0, size=5e-5), candidate)])
    path = tmp_path_factory.mktemp("calibration") / "with_clearance.json"
    made.save(path)
    made = load_calibration(path, space.machine)
    with_it, without = (Compensator(c, Bounds()) for c in (made, replace(made, effects=())))

    both = np.concatenate([alike.design, moved[..., None]], axis=2)
    groups = np.array([p.group for p in space.base.model.parameters()])[alike.active]
    machine = np.r_[groups != "target", True]  # a point of the file is no reflector, which may be elsewhere
    prior, white = np.r_[alike.prior, unit], alike.whiten(both)
    posterior, alone = (
        np.linalg.inv(white[:, :size].T @ white[:, :size] + np.diag(1.0 / prior[:size] ** 2))
        for size in (len(prior), len(prior) - 1)
    )
    grown = []
    for visit in range(0, len(space.recording), 12):
        asked = space.recording.q[visit], space.recording.wrench[visit], next(iter(space.machine.targets))
        said = [np.square(compensator.for_joints(*asked).std).sum() for compensator in (with_it, without)]
        expected = [
            np.einsum("ip,pq,iq->", rows, covariance, rows)
            for rows, covariance in (
                (both[visit, :3] * machine, posterior),
                (alike.design[visit, :3] * machine[:-1], alone),
            )
        ]
        grown.append((said[0] / said[1], expected[0] / expected[1]))
    by_said, by_both = np.array(grown).T
    np.testing.assert_allclose(by_said, by_both, rtol=0.03)


def test_a_calibration_is_fitted_about_itself(space: Workspace) -> None:
    """A crane gave way by 45 mm: one linear step from the base fit left 0.5 mm on its own recording."""
    groups = [p.group for p in space.base.model.parameters()]
    softer = np.array([20.0 if group.startswith("compliance.") else 1.0 for group in groups])
    about = prepare(space.machine, space.recording, space.fit, replace(space.base, theta=softer * space.base.theta))
    about.forget()
    plain = extended(about, [])
    left = np.nan_to_num(residuals(space.recording, plain))
    best = np.nan_to_num(residuals(space.recording, replace(plain, theta=space.base.theta)))
    linear = np.nan_to_num(residuals(space.recording, replace(plain, theta=_theta(about))))
    rms = [float(np.sqrt((x**2).sum() / space.recording.seen.sum())) for x in (linear, left, best)]
    assert rms[0] > 2 * rms[2]
    assert rms[1] < 1.05 * rms[2]


def test_near_forms_of_a_growth_add_nothing_along_it_where_temperatures_are_steady(space: Workspace) -> None:
    steady = {place: np.full_like(values, 24.0) for place, values in space.recording.temperatures.items()}
    context = replace(space.context, recording=replace(space.recording, temperatures=steady))
    grows = [k for k in named(space, "thermal_growth") if k.joint == "vertical"]
    assert {k.columns[0].function for k in grows} == {"temperature", "link_growth"}
    for candidate in grows:
        near = near_forms(space.context, candidate, frozenset())
        late = [k for k in near if k.args["tau"] != candidate.columns[0].args["tau"]]
        assert late
        assert all(not k.value(context).any() for k in late)
