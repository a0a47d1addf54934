"""Structure that nobody has a name for: learnt as a Gaussian process, used where there were data and nowhere else."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ppshw.calibration import Calibration, load_calibration
from ppshw.cli import main
from ppshw.compensation import Bounds, Compensator
from ppshw.diagnosis.carried import Carried, a_matter_of_time, carry
from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.found import Found, take_up
from ppshw.diagnosis.modelled import extended
from ppshw.diagnosis.nameless import nameless
from ppshw.diagnosis.search import search
from ppshw.diagnosis.workspace import Workspace, prepare
from ppshw.evaluation import evaluate, predicted, residuals
from ppshw.identification.joint import estimate
from ppshw.identification.structure import joint_model
from ppshw.machine import Machine, load_machine
from ppshw.recording import Recording, load_recording
from ppshw.terms import Situation
from ppshw.terms.effect import instrument_error
from ppshw.terms.gaussian_process import Region
from ppshw.terms.shapes import Context
from ppshw.terms.unexplained import unexplained_at
from ppshw.twin import compare, simulate
from simulators.concealed.case import make_case

Array = NDArray[np.float64]
SEED, VISITS, FIT = 21, 240, 170
VERTICAL_FRAME, RZ = 2, 5
SIZE = 2.5e-4  # [rad]


# --- the function -----------------------------------------------------------------------------------------------------
def line(count: int = 200) -> Array:
    """Evenly over −1 … 1, but nothing from 0.1 to 0.6."""
    x = np.linspace(-1.0, 1.0, count)
    return x[(x < 0.1) | (x > 0.6)][:, None]


def test_with_all_sites_it_is_the_textbook_regression() -> None:
    """Rasmussen & Williams 2006, eq. 2.25 with the covariance 4.17, written down here once more."""
    rng = np.random.default_rng(3)
    x = rng.uniform(-1, 1, (60, 2))
    y, noise = np.sin(3 * x[:, 0]) * x[:, 1] + 0.1 * rng.standard_normal(60), 0.1
    region = Region.over(("a", "b"), x, np.array([0.8, 1.5]))
    phi = region.basis(x)
    mean = phi @ np.linalg.solve(phi.T @ phi + noise**2 * np.eye(phi.shape[1]), phi.T @ y)
    away = (x[:, None] - x) / x.std(axis=0) / [0.8, 1.5]
    r = np.sqrt(5) * np.linalg.norm(away, axis=2)
    k = (1 + r + r**2 / 3) * np.exp(-r)
    assert mean == pytest.approx(k @ np.linalg.solve(k + noise**2 * np.eye(60), y), abs=0.5 * noise)


def test_nothing_is_added_where_there_were_no_data() -> None:
    """Beyond the travel, in a hole of it, and where the column is missing; close by it goes out without a step."""
    x = line()
    region = Region.over(("a",), x, np.array([0.3]))
    assert region.weight(x).min() > 0.9
    assert not region.basis(np.array([[0.35], [1.25], [-1.25], [40.0], [np.nan]])).any()
    fine = np.linspace(-1.5, 1.5, 4001)[:, None]
    steps = np.abs(np.diff(region.basis(fine), axis=0)).max()
    assert steps < 0.03  # of 3000 steps over what is a tenth of a length each at most


def test_in_two_columns_an_empty_corner_is_a_hole() -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (400, 2))
    x = x[(x[:, 0] < 0) | (x[:, 1] < 0)]
    region = Region.over(("a", "b"), x, np.array([0.4, 0.4]))
    corner, middle = region.weight(np.array([[0.7, 0.7], [-0.5, 0.2]]))
    assert corner == 0.0
    assert middle > 0.9


# --- learnt from a recording ------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Rig:
    """A positioner that the model describes, but that its lifting column turns by where the pose before left it."""

    machine: Machine
    first: Recording
    later: Recording
    space: Workspace
    tried: Tried
    carried: Carried
    base: Calibration
    calibration: Calibration


def hidden(recording: Recording, lateral: int = 0) -> Array:
    """(N,) [rad] a bend in the middle of the lateral axis' last position."""
    q = recording.q[:, lateral]
    u = np.concatenate([q[:1], q[:-1]]) / 0.5
    return np.asarray(SIZE * np.tanh(2 * u) * np.cos(2 * u))


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    folder = tmp_path_factory.mktemp("unexplained")
    make_case(SEED, "pps", "null", 1.0, folder, folder / "sealed", visits=VISITS, fit=VISITS)
    machine = load_machine(folder / "machine.yaml")
    whole = load_recording(folder / "recording.csv", machine)
    plain = estimate(joint_model(machine, whole), whole)
    context = Context.of(plain.model, plain.theta, whole, plain.measuring_in_base)
    moved = context.jacobian[:, :, VERTICAL_FRAME, RZ] * hidden(whole)[:, None]
    whole = replace(whole, points=whole.points + moved.reshape(whole.points.shape) @ plain.measuring_in_base[:3, :3])
    first, later = whole.subset(np.arange(VISITS) < FIT), whole.subset(np.arange(VISITS) >= FIT)
    base = estimate(joint_model(machine, first), first)
    space = prepare(machine, first, np.ones(FIT, dtype=bool), base)
    repeatability = float(np.sqrt(np.trace(base.noise.pose[:3, :3])))
    lateral = machine.joint_names[0]
    before, time = (f"previous_q_{lateral}",), ("time",)
    some = [k for k in nameless(space.context) if k.covariates in (before, time) and len(k.columns) > 1]
    tried = Tried(space, [replace(k, share=1.0 / len(some)) for k in some], repeatability)
    found = search(space, tried, np.random.default_rng(0))
    space = space.as_learnt()
    carried = carry(space, tried, found)
    return Rig(machine, first, later, space, tried, carried, Calibration.of(base, first, "joint"),
               extended(space, carried.found))  # fmt: skip


def moves(rig: Rig, recording: Recording) -> Array:
    c = rig.calibration
    return predicted(c, recording) - predicted(replace(c, effects=()), recording)


def context(rig: Rig, recording: Recording) -> Context:
    c = rig.calibration
    return Context.of(c.model, c.theta, recording, c.measuring_in_base, dict(c.reference))


def far_away(recording: Recording) -> Recording:
    """The same, but every visit comes after one 10 m further along the lateral axis than any was."""
    q = recording.q.copy()
    q[:, 0] += 10.0
    return replace(recording, q=q)


def test_what_is_carried_is_found_at_its_place_and_marked(rig: Rig) -> None:
    (said,) = rig.carried.corrections
    assert said["effect"] == "unexplained"
    assert said["covariates"] == ["q_" + rig.machine.joint_names[0]]
    assert said["history"] == "of the pose before"
    assert "q_lateral (of the pose before) is carried without a name" in said["sentence"]
    assert list(said["length"]) == ["previous_q_lateral"]
    (effect,) = rig.calibration.effects
    assert effect.name == "unexplained"
    assert "without a name" in effect.sentence
    assert "only where the recording has data" in effect.sentence


def test_visits_that_no_fit_saw_get_better(rig: Rig) -> None:
    """Nine tenths of what is hidden: 0.1 mm rms at the reflectors beside 0.08 of noise."""
    hides = context(rig, rig.later).jacobian[:, :, VERTICAL_FRAME, RZ] * hidden(rig.later)[:, None]
    hides -= hides.mean(axis=0)
    left = hides - (shift := moves(rig, rig.later).reshape(hides.shape)) + shift.mean(axis=0)
    assert np.sqrt((left**2).mean()) < 0.45 * np.sqrt((hides**2).mean())
    before, after = (np.nanstd(residuals(rig.later, c)) for c in (rig.base, rig.calibration))
    assert after < 0.9 * before
    assert rig.carried.after < 0.9 * rig.carried.before


def test_it_says_how_sure_it_is(rig: Rig) -> None:
    """Where data were, more than its level is known (which the base model has as well); far from them, nothing."""
    (here,), (there,) = (unexplained_at(rig.calibration.effects, context(rig, r)) for r in
                         (rig.later, far_away(rig.later)))  # fmt: skip
    assert here.weight.min() > 0.8
    assert not there.weight.any()
    args = rig.calibration.effects[0].columns[0].args
    arms = context(rig, far_away(rig.later)).jacobian[:, :, args["frame"], args["components"]]
    prior = np.sqrt(((arms * args["amplitude"]) ** 2).sum(axis=2).reshape(len(arms), -1, 3).sum(axis=2))
    assert there.std == pytest.approx(prior)
    assert here.std.mean() < 0.75 * prior.mean()
    hides = context(rig, rig.later).jacobian[:, :, VERTICAL_FRAME, RZ] * hidden(rig.later)[:, None]
    left = (hides - moves(rig, rig.later).reshape(hides.shape)).reshape(*here.std.shape, 3)
    left -= left.mean(axis=0)
    assert np.sqrt((left**2).sum(axis=2).mean()) < here.std.mean()


def test_far_from_data_a_prediction_has_no_correction_and_says_so(rig: Rig) -> None:
    assert np.abs(moves(rig, rig.later)).max() > 5e-5
    assert not moves(rig, far_away(rig.later)).any()
    apart = [c.model.predict(Situation.of(rig.later), c.theta) for c in (rig.base, rig.calibration)]
    assert np.abs(apart[0] - apart[1]).max() < 2e-5  # and the rest of the model is what it would be without it
    assert evaluate(rig.later, rig.machine, rig.calibration)["unexplained"][0]["visits_without"] == 0
    answer = evaluate(far_away(rig.later), rig.machine, rig.calibration)["unexplained"][0]
    assert answer["visits_without"] == len(rig.later)
    assert "unexplained" not in evaluate(rig.later, rig.machine, rig.base)


def test_it_comes_back_from_a_file_and_the_command_counts_its_visits(
    rig: Rig, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.calibration.save(tmp_path / "cal.json")
    again = replace(rig, calibration=load_calibration(tmp_path / "cal.json", rig.machine))
    np.testing.assert_array_equal(moves(again, rig.later), moves(rig, rig.later))
    given = [rig.first.source, "--machine", str(rig.machine.file), "--calibration", str(tmp_path / "cal.json")]
    assert main(["evaluate", *given]) == 0
    said = capsys.readouterr().out
    assert "corrected without a name over " in said
    assert "where there were no data" not in said
    assert main(["evaluate", *given, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["unexplained"][0]["visits_without"] == 0
    monkeypatch.setattr("ppshw.recording.load_recording", lambda *_: far_away(rig.later))
    assert main(["evaluate", *given]) == 0
    assert "structure over q_lateral (of the pose before) is corrected at no visit" in capsys.readouterr().out


def test_no_axis_is_driven_by_it_and_its_size_is_in_the_uncertainty(rig: Rig) -> None:
    pose, load = rig.first.q[20], rig.first.wrench[20]
    bounds = Bounds(travel=0.1, angle=0.1)
    plain = replace(rig.calibration, effects=())
    without, found = (Compensator(c, bounds).for_joints(pose, load) for c in (plain, rig.calibration))
    np.testing.assert_allclose(found.corrected, without.corrected, atol=1e-12)
    assert "no axis is driven by it" in found.effects[0].why
    assert np.linalg.norm(found.std) > np.linalg.norm(without.std)


def test_the_instrument_reads_no_point_wrong_by_it(rig: Rig) -> None:
    """Reflectors have other places beside it, which are columns of the readings, as an erring instrument's are."""
    c, ideal = rig.calibration, rig.later.points[:, 0]
    assert any(column.on == "points" for column in c.effects[0].columns)
    args = (rig.later, c.measuring_in_base, c.reference, ideal)
    np.testing.assert_array_equal(instrument_error(c.effects, c.model, c.laid_at, *args), np.zeros_like(ideal))


def test_a_twin_has_it_and_the_recording_is_like_its_twin(rig: Rig) -> None:
    plain = replace(rig.calibration, effects=())
    shift = simulate(rig.calibration, rig.first, 4).points - simulate(plain, rig.first, 4).points
    assert np.nanstd(shift) > 2e-5
    odd = [c.name for c in compare(rig.calibration, rig.first) if c.p <= 0.005]
    assert "other" not in odd


WANDERED = 3e-4  # [m]


def wandering(rig: Rig) -> tuple[Workspace, list[Found], Recording]:
    """The base rises and stays up; structure over time alone, as it was taken up; later visits, with the base up."""
    c = rig.space.context
    up = WANDERED * (c.hours / c.hours[-1] > 0.4)
    space = replace(rig.space, data=rig.space.data + c.jacobian[:, :, 0, 1] * up[:, None])
    names = [(c.covariates, c.frame, c.component) for c in rig.tried.candidates]
    best = names.index((("time",), "base", "ty"))
    found = [_as_found(rig.tried, best, space)]
    moved = context(rig, rig.later).jacobian[:, :, 0, 1].reshape(rig.later.points.shape) * WANDERED
    later = replace(rig.later, points=rig.later.points + moved @ rig.base.measuring_in_base[:3, :3])
    return space, found, later


def test_what_goes_on_with_time_alone_is_carried_and_held_at_its_end(rig: Rig) -> None:
    space, found, later = wandering(rig)
    carried = carry(space, rig.tried, found)
    (said,) = carried.corrections
    assert said["covariates"] == ["time"]
    assert "held where it was at the end" in said["sentence"]
    assert carried.after < 0.9 * carried.before
    calibration = extended(space, carried.found)
    left = np.nanmean(residuals(later, calibration), axis=(0, 1))
    assert abs(left[1]) < 0.3 * WANDERED
    plain = np.nanmean(residuals(later, rig.base), axis=(0, 1))
    assert abs(plain[1]) > 0.7 * WANDERED  # a base model of before it rose
    pose, load = rig.first.q[20], rig.first.wrench[20]
    with_it, without = (
        Compensator(c, Bounds(travel=0.1, angle=0.1)).for_joints(pose, load)
        for c in (calibration, replace(calibration, effects=()))
    )
    assert np.abs(with_it.corrected - without.corrected).max() < WANDERED  # on average, not as it was at the end
    assert "no axis is driven by it" in with_it.effects[0].why


def test_where_nothing_says_which_load_it_was_no_course_in_time_is_carried(rig: Rig) -> None:
    """What changed with loads looks like one, and the next visits were worse with it (a reviewer's)."""
    r = rig.first
    still, unnamed = np.tile(r.wrench[0], (len(r), 1)), ("",) * len(r)
    for unsaid, carries in (
        (replace(r, load=unnamed, wrench=0.0 * r.wrench, has_wrench=False), False),
        (replace(r, load=unnamed, wrench=still), False),  # a sensor that does not measure
        (replace(r, load=unnamed), True),
        (replace(r, wrench=0.0 * r.wrench, has_wrench=False), True),
    ):
        space, found, _ = wandering(rig)
        space.recording = unsaid
        carried = carry(space, rig.tried, found)
        assert bool(carried.corrections) == carries


def test_what_is_not_carried_of_it_is_the_base_models_on_average(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ppshw.diagnosis.carried.NAMELESS_GAIN", 0.0)
    space, found, _ = wandering(rig)
    carried = carry(space, rig.tried, found)
    assert carried.corrections == []
    moved = (space.data - rig.space.data).reshape(rig.first.points.shape) @ rig.base.measuring_in_base[:3, :3]
    first = replace(rig.first, points=rig.first.points + moved)
    left = np.nanmean(residuals(first, extended(space, carried.found)), axis=(0, 1))
    assert np.abs(left).max() < 0.05 * WANDERED


def test_what_goes_with_time_is_no_gaussian_process(rig: Rig) -> None:
    """Nor what counts the visits, or warms up steadily while they pass."""
    counts = np.arange(FIT) ** 1.5 + np.random.default_rng(0).normal(0, 20, FIT)
    c = replace(rig.space.context, recording=replace(rig.first, covariates={"count": counts}))
    assert a_matter_of_time(c, ("q_lateral", "time"))
    assert not a_matter_of_time(c, ("since_load_change",))
    assert not a_matter_of_time(c, ("pause",))
    assert a_matter_of_time(c, ("cov_count",))
    assert not a_matter_of_time(c, ("previous_q_lateral",))


def test_one_correction_stands_for_all_that_has_no_name_over_its_columns(rig: Rig) -> None:
    """Two findings over one column had one process, of which its first modes were nought in the calibration: 0.080 mm
    were left on a recording whose diagnosis said 0.048."""
    space = rig.space.as_learnt()
    tried = Tried(space, rig.tried.candidates, rig.tried.unit)
    before = [k for k, c in enumerate(tried.candidates) if c.covariates != ("time",)]
    home = rig.carried.found[0][1].frame
    there = next(k for k in before if tried.candidates[k].frame == home)
    elsewhere = next(k for k in before if tried.candidates[k].frame != home)
    found = [Found(k, ("nameless", None), 1e-3, 10.0, size=1e-5, first=10.0) for k in (there, elsewhere)]
    take_up(space, tried, found)
    carried = carry(space, tried, found)
    assert len(carried.corrections) == 1
    assert len(carried.found) == 1
    calibration = extended(space, carried.found)
    left = residuals(rig.first, calibration)
    own = 1e3 * np.sqrt(np.nansum(left**2) / rig.first.seen.sum())
    assert own < carried.after  # of visits that the fit saw
    (effect,) = calibration.effects
    modes = [v for v, c in zip(effect.values, effect.columns, strict=True) if c.function == "unexplained"]
    assert np.abs(modes).min() > 0.0


def test_a_clean_recording_gets_no_correction(rig: Rig) -> None:
    """Signs of whole visits changed at random leave nothing to learn: what is likeliest is not held out better."""
    signs = np.random.default_rng(5).choice([-1.0, 1.0], size=len(rig.first))
    space = replace(rig.space, data=rig.space.design @ rig.space.coefficients()[0]
                    + signs[:, None] * np.nan_to_num(rig.space.residual()))  # fmt: skip
    space.forget()
    tried = rig.tried
    best = next(k for k, c in enumerate(tried.candidates) if c.covariates != ("time",))
    found = _as_found(tried, best, space)
    carried = carry(space, tried, [found])
    assert carried.corrections == []
    assert carried.after == carried.before


def _as_found(tried: Tried, best: int, space: Workspace) -> Found:
    columns = np.stack([c.evaluate(space.context) for c in tried.candidates[best].columns], axis=2)
    space.take_up(columns, np.full(columns.shape[2], 1e-4))
    return Found(best, ("nameless", None), 1e-3, 10.0)
