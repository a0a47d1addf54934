"""The joint estimate: what it finds on simulated machines, how sure it is of it, and that short cuts change nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ppshw.identification import joint, visits
from ppshw.identification.joint import Estimate, estimate
from ppshw.identification.noise import Noise
from ppshw.identification.strengths import Groups, alone, held_back, learn
from ppshw.identification.structure import joint_model
from ppshw.identification.visits import Linearisation
from ppshw.machine import Machine, load_machine
from ppshw.recording import Recording, load_recording
from ppshw.terms import Parameter, Situation
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant

Array = NDArray[np.float64]
MACHINES = Path(__file__).parents[2] / "machines"
PPS = MACHINES / "pps.yaml"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Machine, Plant, Recording]:
    machine, plant = load_machine(PPS), Plant.from_file(PPS, 11)
    path = tmp_path_factory.mktemp("joint") / "r.csv"
    return machine, plant, load_recording(simulate_recording_csv(plant, path, 260), machine)


def treatment_off(found: Estimate, plant: Plant, seed: int) -> Array:
    """(100,) how far the treatment point is from its prediction at unseen visits, without the arrival's scatter [m]."""
    rng = np.random.default_rng(seed)
    q, load = plant.random_poses(100, rng), plant.random_loads(100, rng)
    wrench = plant.wrench(q, load)
    true = plant.true_points(q, wrench, names=["treatment"])["treatment"]
    predicted = found.model.predict(Situation(q, wrench), found.theta, plant.points["treatment"][None])[:, 0]
    return np.asarray(np.linalg.norm(true - predicted, axis=1))


def test_six_numbers_of_a_visit_say_all_that_nine_coordinates_do(recorded: tuple[Machine, Plant, Recording]) -> None:
    """The reduced normal equations against those of all coordinates, laid out the long way round, one target lost."""
    machine, _, recording = recorded
    points = recording.points[:40].copy()
    points[3, 1] = points[7, 0] = points[7, 2] = np.nan
    some = replace(recording.subset(np.arange(40)), points=points)
    model = joint_model(machine, some, waves=2)
    theta = np.random.default_rng(0).normal(size=len(model.parameters())) * [p.start / 5 for p in model.parameters()]
    weights = np.linspace(0.2, 1.0, 40)
    everything = np.ones(len(theta), dtype=bool)
    for noise in (
        Noise(np.diag([4e-9, 2e-9, 1e-9, 4e-10, 3e-10, 2e-10]), 2e-5),
        Noise(np.eye(6) * 1e-9, 3e-5, np.linspace(1e-10, 2e-9, 42).reshape(7, 6)),
    ):
        linear = Linearisation(model, some, theta, np.eye(4), np.arange(40))
        gram, moment, _ = linear.normal_equations(noise, weights, everything)
        whole = model.linearise(Situation.of(some), theta)
        rows = np.repeat(some.seen, 3, axis=1)
        design = whole.design.reshape(40, 9, -1) * rows[..., None]
        gap = np.where(some.seen[..., None], points - whole.positions, 0.0).reshape(40, 9)
        inverse = np.linalg.inv(noise.covariance(whole.levers, some.seen, weights))
        expected = np.einsum("nip,nij,njq->pq", design, inverse, design, optimize=True)
        np.testing.assert_allclose(gram, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max())
        data = gap + design @ theta
        expected = np.einsum("nip,nij,nj->p", design, inverse, data, optimize=True)
        np.testing.assert_allclose(moment, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max())


def test_a_long_recording_is_learnt_from_a_part_and_solved_whole(
    recorded: tuple[Machine, Plant, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    machine, plant, recording = recorded
    model = joint_model(machine, recording, waves=6)
    whole = estimate(model, recording)
    monkeypatch.setattr(joint, "LEARNT_FROM", 130)
    part = estimate(model, recording)
    monkeypatch.setattr(visits, "KEPT_VISITS", 10)
    monkeypatch.setattr(visits, "KEPT_NUMBERS", 10)
    monkeypatch.setattr(visits, "BLOCK", 50)
    again = estimate(model, recording)
    assert len(part.weights) == 260
    # solved from 260 visits, not from 130: as good as the whole, and kept or made again is the same
    assert np.median(treatment_off(part, plant, 1)) < 1.15 * np.median(treatment_off(whole, plant, 1))
    np.testing.assert_allclose(again.theta, part.theta, rtol=1e-5, atol=1e-9)


def test_a_visit_that_is_wrong_by_two_millimetres_is_not_believed(recorded: tuple[Machine, Plant, Recording]) -> None:
    machine, plant, recording = recorded
    points = recording.points.copy()
    points[[17, 99, 180]] += [[0.002, 0.0, 0.0]], [[0.0, -0.002, 0.0]], [[0.0, 0.0, 0.002]]
    found = estimate(joint_model(machine, recording, waves=6), replace(recording, points=points))
    assert (found.weights[[17, 99, 180]] < 0.2).all()
    assert (found.weights < 0.5).sum() < 6
    assert np.median(treatment_off(found, plant, 1)) < 6e-5


def test_a_group_that_nothing_speaks_for_shrinks_and_one_that_is_there_is_found() -> None:
    """Forty numbers of size 3 behind unit noise, forty of nothing; by hand: the variance is about 9 and about 0."""
    rng = np.random.default_rng(2)
    parameters = [Parameter(f"p{k}", "1", "there.x" if k < 40 else "nothing.y", 1.0, 1.0) for k in range(80)]
    groups = Groups.among(parameters)
    values = np.where(np.arange(80) < 40, 3.0 * rng.normal(size=80), 0.0)
    gram, moment = np.eye(80) * 4.0, 4.0 * (values + rng.normal(size=80) / 2)
    variances, posterior = learn(gram, moment, groups, np.ones(80, dtype=bool), np.ones(2), 12)
    assert variances[0] == pytest.approx(9.0, rel=0.4)
    assert variances[1] < 0.08
    covariance = posterior.covariance(groups, np.ones(80, dtype=bool))
    fixed = posterior.root.T @ posterior.root
    assert (np.diag(covariance) >= np.diag(fixed)).all()
    assert np.sqrt(np.diag(covariance)[:40].mean()) == pytest.approx(0.5, rel=0.1)


@pytest.mark.long
def test_an_element_that_came_to_nothing_beside_its_like_is_not_said_to_be_sure() -> None:
    """Of ten elements, of as many joints, the readings tell of the first two little but the sum, and the last six are
    nothing; 200 drawn recordings. One of the two often takes all, and its covariance says of the other up to a tenth of
    what it is off by."""
    rng = np.random.default_rng(4)
    names = [f"compliance.j{k // 5}.rM.rx,Mx{k}.line" for k in (0, 5, 1, 6, 2, 7, 3, 8, 4, 9)]
    parameters = [Parameter(f"C{k}", "1", name, 1.0, 1.0) for k, name in enumerate(names)]
    groups, everything = Groups.among(parameters), np.ones(10, dtype=bool)
    gram = 400.0 * np.eye(10)
    gram[0, 1] = gram[1, 0] = 400.0 * 0.997
    by_it, by_itself, of_others = [], [], []
    for _ in range(200):
        true = np.where(np.arange(10) < 4, np.abs(rng.normal(size=10)), 0.0)
        moment = gram @ true + np.linalg.cholesky(gram) @ rng.normal(size=10)
        variances, posterior = learn(gram, moment, groups, everything, np.ones(10), 60)
        covariance = posterior.covariance(groups, everything)
        more = alone(gram, moment, groups, everything, variances, covariance, posterior.theta)
        off = np.abs(posterior.theta - true)
        std = np.sqrt(np.diag(covariance) + more)
        by_it.append(off[:2] / np.sqrt(np.diag(covariance))[:2])
        by_itself.append(off[:2] / std[:2])
        of_others.append(std[2:])
    assert np.max(by_it) > 8.0
    assert np.max(by_itself) < 4.0
    assert np.mean(np.array(by_itself) < 1.96) > 0.93
    assert np.median(of_others) == pytest.approx(0.05, rel=0.1)  # what the readings tell is as sure as it was


def test_a_joint_that_nothing_was_said_of_is_taken_to_be_as_the_others_are() -> None:
    """Three rails' shifts are known to be of 2, 4 and 8 mm; what the fourth's may be is their geometric mean, and half
    a joint that starts from a twentieth (in variance) of 1 mm."""
    sizes, each = [2.0, 4.0, 8.0], 20
    groups = Groups.among([
        Parameter(f"p{k}", "mm", f"geometric.w{k // each}.t.line", 1.0, 1.0) for k in range(4 * each)
    ])  # fmt: skip
    said = np.repeat([1.0, 1.0, 1.0, 0.0], each)
    values = np.repeat([*sizes, 0.0], each) * np.resize([1.0, -1.0], 4 * each)
    gram, moment = np.diag(1e4 * said), 1e4 * values
    variances, _ = learn(gram, moment, groups, np.ones(4 * each, dtype=bool), np.ones(4), 40)
    assert np.sqrt(variances[:3]) == pytest.approx(sizes, rel=0.1)
    expected = (2.0 * np.log(sizes).sum() - 0.5 * 3.0) / 3.5
    assert np.log(variances[3]) == pytest.approx(expected, abs=0.2)


def test_a_small_arm_s_wrist_may_give_way_a_thousand_times_as_much_as_a_positioner(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """One milliradian per newton metre (1.9e-4 of an arm of harmonic drives was 0 ± 6e-6), behind moments of a few."""
    arm = MACHINES / "arm6.yaml"
    machine, plant = load_machine(arm), Plant.from_file(arm, 3)
    path = tmp_path_factory.mktemp("wrist") / "r.csv"
    recording = load_recording(simulate_recording_csv(plant, path, 120), machine)
    recording = replace(recording, wrench=recording.wrench / 50)  # a small arm's
    model = joint_model(machine, recording, waves=2)
    names = [p.name for p in model.parameters()]
    wrist = [names.index(f"{machine.joint_names[-1]}.C[{e}][0]") for e in ("rx,Mx", "ry,My", "rz,Mz")]
    theta = np.zeros(len(names))
    theta[wrist] = [1e-3, 5e-4, 1e-3]
    points = model.predict(Situation.of(recording), theta)
    noise = np.random.default_rng(0).normal(scale=2e-5, size=points.shape)
    found = estimate(model, replace(recording, points=points + noise))
    off, std = found.theta[wrist] - theta[wrist], np.sqrt(np.diag(found.covariance)[wrist])
    assert (np.abs(off) < 0.05 * theta[wrist]).all()
    assert (np.abs(off) < 4 * std).all()
    assert (std < 0.05 * theta[wrist]).all()
    assert held_back(model.parameters(), found.groups) == []


def test_a_size_at_its_limit_is_said_of_what() -> None:
    parameters = [
        Parameter("w3.C[rz,Mz][0]", "rad/(N m)", "compliance.w3.rM.rz,Mz.line", 1.0, 2e-7),
        Parameter("w2.tx[0]", "m", "geometric.w2.t.line", 1.0, 1e-3),
        Parameter("w2.rx[1]", "rad", "geometric.w2.r.band0", 1.0, 5e-4),
    ]
    sizes = {"compliance.w3.rM.rz,Mz.line": 2e-3, "geometric.w2.t.line": 0.0317, "geometric.w2.r.band0": 1e-3}
    said = held_back(parameters, sizes)
    assert [line.split(" came to ")[0] for line in said] == [
        "the compliance rz per Mz of frame w3",
        "shifts of frame w2",
    ]
    assert "(0.002 rad/(N m))" in said[0]
    assert "(31.6 mm)" in said[1]
