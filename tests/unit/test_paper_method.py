"""The paper's campaign on simulated positioners that share no code with the model: what it leaves, what it needs."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from campaigns.plan import plan_campaign
from campaigns.script import load_script
from ppshw.errors import IdentificationFailed
from ppshw.identification.paper import PaperEstimate, identify_paper
from ppshw.identification.redundancy import Evidence, independent_columns, solver
from ppshw.identification.sweeps import find_sweeps
from ppshw.machine import Machine, load_machine
from ppshw.recording import Recording
from ppshw.terms import Situation
from ppshw.terms.basis import Interpolated
from ppshw.terms.elastic import Compliance
from simulators.offline import ENCODER_SIGMA, FORCE_SIGMA
from simulators.plant import Load, Plant

Array = NDArray[np.float64]
FILE = Path(__file__).parents[2] / "machines/pps.yaml"
PPS = load_machine(FILE)


def measure(
    plant: Plant, q: Array, loads: list[Load | None] | Array, rng: np.random.Generator, noisy: bool
) -> Recording:
    """What instruments say of these visits, with the true treatment point beside it; no labels at all."""
    count = len(q)
    scatter = plant.draw_repeatability(count, rng) if noisy else None
    points = plant.true_points(q, loads, scatter, [*PPS.targets, "treatment"])
    measured = np.stack([points[t] for t in PPS.targets], axis=1)
    return Recording(
        joint_names=PPS.joint_names,
        target_names=tuple(PPS.targets),
        time=np.arange(count, dtype=float),
        step=("",) * count,
        load=("",) * count,
        q=q + noisy * ENCODER_SIGMA * rng.normal(size=q.shape),
        q_cmd=q,
        approach=np.zeros(q.shape, dtype=np.int64),
        settle_s=np.full(count, 5.0),
        wrench=plant.wrench(q, loads) + noisy * FORCE_SIGMA * rng.normal(size=(count, 6)),
        points=measured + noisy * plant.position_sigma * rng.normal(size=measured.shape),
        extra_points={"treatment": points["treatment"]},
        temperatures={},
        covariates={},
        has_wrench=True,
        source="simulated.csv",
        sha256="",
    )


@cache
def campaign(name: str, seed: int, noisy: bool) -> Recording:
    """One of the shipped campaigns on machine number `seed`; repeatability 0.14 mm, or none at all."""
    plant = Plant.from_file(FILE, seed, repeatability=1.4e-4 if noisy else 0.0)
    plan = plan_campaign(load_script(name), PPS)
    to_sensor = np.linalg.inv(PPS.sensor_in_link) @ PPS.tip_in_link
    loads = {c.name: Load(c.mass, (to_sensor @ [*c.com, 1.0])[:3]) if c.mass else None for c in plan.loads.values()}
    q = np.array([v.setpoints for v in plan.visits])
    return measure(plant, q, [loads[v.load] for v in plan.visits], np.random.default_rng([seed, len(q)]), noisy)


@cache
def identified(seed: int, noisy: bool, by_noise: bool = True) -> PaperEstimate:
    return identify_paper(PPS, campaign("paper", seed, noisy), by_noise)


def left_at_treatment_mm(found: PaperEstimate, theta: Array, seed: int, noisy: bool) -> Array:
    check = campaign("verification", seed, noisy)
    predicted = found.model.predict(Situation.of(check), theta, PPS.point("treatment")[None])[:, 0]
    return np.asarray(1e3 * np.linalg.norm(predicted - check.extra_points["treatment"], axis=1))


# What it leaves -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_papers_campaign_meets_the_papers_specification(seed: int) -> None:
    """0.5 mm for 98.6 % of 110 treatment configurations; the paper left 0.45 mm of 8 mm."""
    assert len(campaign("paper", seed, True)) == 669
    found = identified(seed, True)
    left = left_at_treatment_mm(found, found.theta, seed, True)
    nominal = left_at_treatment_mm(found, 0.0 * found.theta, seed, True)
    assert len(left) == 110
    assert np.quantile(nominal, 0.986) > 7.0
    assert np.quantile(left, 0.986) < 0.5


@pytest.mark.parametrize("seed", [0, 1])
def test_without_noise_only_second_order_errors_stay(seed: int) -> None:
    """Errors of 8 mm and some 3 mrad leave products of some 10 µm, which eq. (9) drops."""
    found = identified(seed, False)
    left = left_at_treatment_mm(found, found.theta, seed, False)
    assert np.quantile(left, 0.986) < 0.04
    assert left.max() < 0.05


def test_compliances_that_are_not_above_noise_do_harm() -> None:
    """What can be told apart in principle, 1 mm or more; what is above noise, less than 0.5 mm."""
    found = identified(0, True, by_noise=False)
    assert np.quantile(left_at_treatment_mm(found, found.theta, 0, True), 0.986) > 1.0
    assert len(found.kept) > 1.5 * len(identified(0, True).kept)


def test_equation_25_mends_the_first_choice() -> None:
    """ε_g(0) = 0 makes the error at home enter once per joint instead of once; the correction takes that out."""
    found = identified(0, True)
    first = left_at_treatment_mm(found, found.first_theta, 0, True)
    final = left_at_treatment_mm(found, found.theta, 0, True)
    assert np.median(first) > 20 * np.median(final)
    assert found.left_before > 3 * found.left_after


def test_the_stated_uncertainty_is_the_error_that_is_there() -> None:
    ratios = []
    for seed in (0, 1, 2):
        found = identified(seed, True)
        plant = Plant.from_file(FILE, seed, repeatability=0.0)
        check = campaign("verification", seed, True)
        point = PPS.point("treatment")[None]
        true = plant.true_points(check.q_cmd, check.wrench, None, ["treatment"])["treatment"]
        linear = found.model.linearise(Situation.of(check), found.theta, point)
        covariance = linear.design[:, 0] @ found.covariance @ np.swapaxes(linear.design[:, 0], 1, 2)
        error = linear.positions[:, 0] - true
        ratios.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error).mean() / 3)
    assert 0.4 < np.mean(ratios) < 2.5  # 1 where covariance and error agree


def test_669_visits_take_seconds() -> None:
    start = time.process_time()
    identify_paper(PPS, campaign("paper", 3, True))
    assert time.process_time() - start < 20.0


def test_the_noise_it_reports_is_the_noise_that_was_put_in() -> None:
    found = identified(0, True)
    assert found.noise.instrument == pytest.approx(2e-5, rel=0.1)
    plant = Plant.from_file(FILE, 0, repeatability=1.4e-4)
    q, rng = campaign("paper", 0, True).q_cmd, np.random.default_rng(9)
    scattered = plant.true_tip(q, None, plant.draw_repeatability(len(q), rng))[:, :3, 3] - plant.true_tip(q)[:, :3, 3]
    assert np.sqrt(np.diag(found.noise.pose)[:3]) == pytest.approx(scattered.std(axis=0), rel=0.2)


# What is redundant --------------------------------------------------------------------------------------------------
def test_the_positioner_has_36_geometric_parameters_and_90_compliances_at_home() -> None:
    """6 × 6 as in the paper; of each symmetric 6 × 6 matrix 15 elements touch one of Fy, Mx, Mz."""
    found = identified(0, True)
    names = [*found.kept, *found.zeroed]
    assert sum("C[" not in name for name in names) == 36
    assert sum("C[" in name for name in names) == 90


def test_at_most_six_geometric_parameters_at_home_matter() -> None:
    """Only their sum at the end effector does, six numbers (derivations §4.4)."""
    for by_noise in (True, False):
        assert sum("C[" not in name for name in identified(0, False, by_noise).kept) <= 6


def test_redundant_parameters_are_zero() -> None:
    found = identified(0, True)
    parameters = [p.name for p in found.model.parameters()]
    at = 0
    checked = 0
    for term in found.model.terms:
        size = len(term.parameters(PPS.frame_names))
        basis = term.basis  # type: ignore[attr-defined]
        home = basis.knots.index(0.0) if isinstance(basis, Interpolated) else 0
        for k in range(home, size, basis.size):
            name = parameters[at + k].rpartition("[")[0] + "(0)"
            if name in found.zeroed:
                assert found.theta[at + k] == 0.0
                assert found.covariance[at + k, at + k] == 0.0
                checked += 1
            else:
                assert found.theta[at + k] != 0.0
        at += size
    assert checked == len(found.zeroed) > 90


def test_weight_pairs_at_home_determine_fifteen_compliances() -> None:
    """Fy, Mx and Mz each move the end effector in six ways: 18 numbers, whatever the number of links; by reciprocity
    (Maxwell, Betti) what they do along one another is symmetric, which makes 3 of them the same."""
    whole = campaign("paper", 0, False)
    sweeps = find_sweeps(PPS, whole)
    one_load = [c.loads[0] for c in sweeps.configurations if c.away and set(c.away) <= {0, 3, 4, 5}]
    rest = [c.visits for c in sweeps.configurations if not c.away or set(c.away) <= {1, 2}]
    found = identify_paper(PPS, whole.subset(np.sort(np.concatenate([*one_load, *rest]))), by_noise=False)
    assert found.differences == 45 + (3 + 5 + 5 + 3 + 3 + 3) - 1  # every sweep passes home once more
    assert len(found.kept_by_pairs) == 18 - 3


def test_a_column_that_others_replace_is_redundant() -> None:
    rng = np.random.default_rng(4)
    a, b = rng.normal(size=(2, 30))
    design = np.column_stack([a, a + b, b, 0 * a])
    kept = independent_columns([design], None)
    assert len(kept) == 2
    assert 3 not in kept
    solution = solver(design, kept) @ (2 * a + b)
    assert design @ solution == pytest.approx(2 * a + b)
    assert np.count_nonzero(solution) == 2


def test_a_parameter_of_pure_noise_is_redundant() -> None:
    rng = np.random.default_rng(5)
    design = rng.normal(size=(200, 10))
    data = design[:, 3] * 2.0 + rng.normal(size=200)
    assert independent_columns([design], Evidence([data], np.full(10, 5.0))) == [3]


# What it needs ------------------------------------------------------------------------------------------------------
def random_visits(count: int = 40) -> Recording:
    plant, rng = Plant.from_file(FILE, 0), np.random.default_rng(1)
    q = plant.random_poses(count, rng)
    return measure(plant, q, list(plant.random_loads(count, rng)), rng, True)


def refused(recording: Recording, machine: Machine = PPS) -> str:
    with pytest.raises(IdentificationFailed) as caught:
        identify_paper(machine, recording)
    message = str(caught.value)
    assert message.startswith("simulated.csv: ")
    assert "--method joint" in message
    assert "\n" not in message
    return message


def test_random_poses_do_not_do() -> None:
    assert "no visit with all joints at home together" in refused(random_visits())


def test_a_campaign_under_one_load_does_not_do() -> None:
    whole = campaign("paper", 0, True)
    empty = np.abs(whole.wrench[:, 1]) < 50.0
    assert 100 < empty.sum() < 300
    assert "no configuration was measured under two different loads" in refused(whole.subset(empty))


def test_a_campaign_without_the_force_sensor_does_not_do() -> None:
    whole = campaign("paper", 0, True)
    message = refused(replace(whole, wrench=0 * whole.wrench, has_wrench=False))
    assert "nothing in columns Fx … Mz" in message


def test_a_joint_that_was_never_moved_alone_is_named() -> None:
    whole = campaign("paper", 0, True)
    q = whole.q_cmd.copy()
    q[np.abs(q[:, 4]) > 1e-3, 3] = 0.3
    assert "roll was never moved alone" in refused(replace(whole, q_cmd=q))


def test_a_single_target_does_not_do() -> None:
    whole = campaign("paper", 0, True)
    points = whole.points.copy()
    points[:, 1:] = np.nan
    assert "three targets" in refused(replace(whole, points=points))


def test_visits_without_a_full_pose_are_left_out_and_said() -> None:
    whole = campaign("paper", 0, True)
    points = whole.points.copy()
    points[[3, 200, 500], 1] = np.nan
    found = identify_paper(PPS, replace(whole, points=points))
    assert np.flatnonzero(found.weights == 0).tolist() == [3, 200, 500]
    left = left_at_treatment_mm(found, found.theta, 0, True)
    assert np.quantile(left, 0.986) < 0.5


def test_structure_is_found_from_setpoints_and_wrenches() -> None:
    """53, 17, 31, 31, 19 and 19 positions of the six joints; five loads at home and where the compliance varies."""
    sweeps = find_sweeps(PPS, campaign("paper", 0, True))
    assert sweeps.home == pytest.approx(np.zeros(6))
    assert [len(sweeps.knots(k)) for k in range(6)] == [53, 17, 31, 31, 19, 19]
    assert all(len(c.loads) == 5 for c in sweeps.configurations if not c.away or set(c.away) <= {1, 2})
    assert {len(c.loads) for c in sweeps.of_joint(0)} == {3}


def test_home_may_be_anywhere() -> None:
    """Longitudinal at 0.5 m throughout, where it is not itself swept."""
    plant = Plant.from_file(FILE, 1, repeatability=1.4e-4)
    plan = campaign("paper", 1, True)
    q = plan.q_cmd.copy()
    q[q[:, 2] == 0.0, 2] = 0.5
    found = identify_paper(PPS, measure(plant, q, plan.wrench, np.random.default_rng(2), True))
    assert found.home == pytest.approx([0, 0, 0.5, 0, 0, 0])
    left = left_at_treatment_mm(found, found.theta, 1, True)
    inside = campaign("verification", 1, True).q_cmd[:, 2] > 0.05
    assert inside.sum() > 90
    assert np.quantile(left[inside], 0.986) < 0.5


def test_the_tracker_may_stand_anywhere_and_targets_sit_a_little_off(tmp_path: Path) -> None:
    """Seen at the targets, since where the tracker's frame is in the base is a matter of convention then."""
    text = FILE.read_text(encoding="utf-8")
    assert "position_sigma: 2.0e-5" in text
    path = tmp_path / "pps.yaml"
    unknown = "position_sigma: 2.0e-5\n  base: estimate\n  targets: estimate"
    path.write_text(text.replace("position_sigma: 2.0e-5", unknown), encoding="utf-8")
    machine, plant = load_machine(path), Plant.from_file(path, 4, repeatability=1.4e-4)
    plan, check = campaign("paper", 4, True), campaign("verification", 4, True)
    found = identify_paper(machine, measure(plant, plan.q_cmd, plan.wrench, np.random.default_rng(2), True))
    frame = found.measuring_in_base
    assert np.linalg.norm(frame[:3, 3]) > 2.0
    seen = measure(plant, check.q_cmd, check.wrench, np.random.default_rng(3), True)
    real = seen.points @ frame[:3, :3].T + frame[:3, 3]
    left = np.linalg.norm(found.model.predict(Situation.of(seen), found.theta) - real, axis=2)
    assert np.quantile(left, 0.986) < 0.5e-3


def test_targets_that_are_to_be_found_beside_a_placed_tracker_are_refused(tmp_path: Path) -> None:
    """A rigid fit took them to sit as built (a reviewer's: 1.99 mm off, 0.084 said)."""
    text = FILE.read_text(encoding="utf-8")
    path = tmp_path / "pps.yaml"
    path.write_text(text.replace("position_sigma: 2.0e-5", "position_sigma: 2.0e-5\n  targets: estimate"), "utf-8")
    with pytest.raises(IdentificationFailed, match=r"pps\.yaml: 'targets: estimate' beside .* takes `--method joint`"):
        identify_paper(load_machine(path), campaign("paper", 4, True))


def test_a_rigid_machine_has_geometric_errors_alone(tmp_path: Path) -> None:
    file = yaml.safe_load(FILE.read_text(encoding="utf-8"))
    for joint in file["joints"]:
        joint.pop("elastic", None)
    (tmp_path / "pps.yaml").write_text(yaml.safe_dump(file), encoding="utf-8")
    plant = Plant.from_file(tmp_path / "pps.yaml", 4, repeatability=1.4e-4)
    plan, check = campaign("paper", 4, True), campaign("verification", 4, True)
    machine = load_machine(tmp_path / "pps.yaml")
    found = identify_paper(machine, measure(plant, plan.q_cmd, plan.wrench, np.random.default_rng(2), True))
    assert not any(isinstance(term, Compliance) for term in found.model.terms)
    seen = measure(plant, check.q_cmd, check.wrench, np.random.default_rng(3), True)
    left = np.linalg.norm(found.model.predict(Situation.of(seen), found.theta) - seen.points, axis=2)
    assert np.quantile(left, 0.986) < 0.5e-3
