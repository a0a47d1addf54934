"""Designed campaigns: information against dense algebra, orders against enumeration, scripts against the plan."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from campaigns.design import choose, designer, order
from campaigns.design.ask import Answer, Question, answer
from campaigns.design.belief import Belief, typical, white_rows
from campaigns.design.bound import lower_bound
from campaigns.design.choose import Chooser, inside, situation
from campaigns.design.designer import Designer, Request, loads_for
from campaigns.design.information import Pool, Posterior, visible, work_of
from campaigns.design.loads import extremes, measured_with, range_of, telling_cases, usual_range, wrench
from campaigns.design.order import length, shortest_rounds
from campaigns.design.sequential import known_from
from campaigns.plan import Plan, plan_campaign, travel, travel_time
from campaigns.script import LoadCase, load_script
from ppshw.errors import CampaignError
from ppshw.identification import identify
from ppshw.machine import Machine, load_machine
from ppshw.recording import load_recording
from ppshw.terms import Situation
from simulators.offline import simulate_recording_csv
from simulators.plant import Load, Plant
from tests.unit.small_campaign import SLIDE

ROOT = Path(__file__).parents[2]
# A carriage with a turning arm on it: two joints, so that a design takes a second.
SMALL = (
    f"name: small\n{SLIDE}"
    + """\
  - name: turn
    type: revolute
    origin: {xyz: [0, 0, 0.5], rpy: [0, 0, 0]}
    axis: [0, 0, 1]
    limits: {lower: -1.5, upper: 1.5, velocity: 0.2, acceleration: 0.2}
    link: {mass: 100, com: [0.3, 0, 0]}
    elastic: {loads: [Fz, Mx, My], varies: false}
tip:
  origin: {xyz: [0.8, 0, 0], rpy: [0, 0, 0]}
  targets: {P1: [0.2, 0, 0], P2: [0, 0.2, 0], P3: [0, -0.2, 0]}
  points: {treatment: [0.3, 0, 0.2]}
repeatability: {position: 1.4e-4}
"""
)


def machine_of(folder: Path, text: str = SMALL) -> Machine:
    path = folder / "small.yaml"
    path.write_text(text, encoding="utf-8")
    return load_machine(path)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer candidates than a design for a real machine deserves."""
    monkeypatch.setattr(choose, "CANDIDATES", 240)
    monkeypatch.setattr(choose, "EXCHANGED", 120)
    monkeypatch.setattr(designer, "FIRST_LOOK", 160)
    monkeypatch.setattr(designer, "EXCHANGES", 1)
    monkeypatch.setattr(order, "LEAST_ITERATIONS", 300)


@pytest.fixture
def small(tmp_path: Path) -> Machine:
    return machine_of(tmp_path)


@pytest.fixture(scope="module")
def pps() -> Machine:
    return load_machine(ROOT / "machines/pps.yaml")


def ask(machine: Machine, out: Path, **changes: object) -> Answer:
    plain = Question(machine, None, None, None, None, None, None, None, 1, "trial", "a test")
    return answer(replace(plain, **changes), out)  # type: ignore[arg-type]


def planned(machine: Machine, out: Path, **changes: object) -> Plan:
    found = ask(machine, out, **changes).plan
    assert found is not None
    return found


# --- loads -----------------------------------------------------------------------------------------------------
def test_a_hundred_kilograms_half_a_metre_out_turn_the_sensor_by_490_newton_metres(pps: Machine) -> None:
    # everything level and straight: 100 kg · 9.80665 m/s² down, at x = 0.2, z = 0.5 from the sensor's axis
    found = wrench(pps, np.zeros((1, 6)), 100.0, np.array([0.2, 0.1, 0.5]))[0]
    assert found == pytest.approx([0, -980.665, 0, 490.3325, 0, -196.133], abs=1e-6)


def test_the_positioner_is_measured_empty_and_under_three_loads_a_little_over_200_kg(pps: Machine) -> None:
    work, cases = loads_for(pps, pps.point("treatment"), None, 4)
    assert work.mass == (20, 200)
    assert [case.mass for case in cases] == [0, 204, 204, 204]
    # no three of them in a line: force and both moments can be told apart
    across = np.array([[case.mass, case.mass * case.com[0], case.mass * case.com[2]] for case in cases])
    assert np.linalg.matrix_rank(across[1:] - across[0]) == 3


def test_an_arm_of_500_kg_is_not_loaded_with_200(tmp_path: Path) -> None:
    arm = load_machine(ROOT / "machines/arm6.yaml")
    work = usual_range(arm, arm.point("treatment"))
    assert 50 < work.mass[1] < 80


def test_given_load_cases_span_the_work_and_are_the_only_ones(pps: Machine) -> None:
    given = load_script("paper").loads
    work, cases = loads_for(pps, pps.point("treatment"), given, None)
    assert work.mass == (0, 205)
    assert work.low == pytest.approx((-0.22, 0.15, 0.30))
    assert {case.name for case in cases} == {"empty", "middle", "head", "left", "right"}
    few = telling_cases(pps, range_of(given), given, 4)
    assert "middle" not in {case.name for case in few}  # inside of what the others span


# --- information -------------------------------------------------------------------------------------------------
def chooser_of(machine: Machine, seed: int = 1) -> tuple[Belief, Chooser, Posterior, list[LoadCase]]:
    point = machine.point("treatment")
    belief = typical(machine, 40, point)
    work = usual_range(machine, point)
    cases = telling_cases(machine, work, extremes(work), 4)
    rng = np.random.default_rng(0)
    low, high = machine.limits()
    q = rng.uniform(low, high, (300, machine.n))
    basis = visible(white_rows(belief, situation(machine, q, np.arange(300) % 4, cases)))
    return belief, Chooser(belief, basis, cases, seed), Posterior(work_of(belief, point, work), basis), cases


def mean_variance(posterior: Posterior) -> float:
    """Of the point over the work [m²], all three directions together, as its accuracy is reckoned from."""
    return float(np.trace(posterior.spread(), axis1=1, axis2=2).mean())


def test_visits_made_one_by_one_leave_the_covariance_of_all_at_once(small: Machine) -> None:
    belief, chooser, posterior, cases = chooser_of(small)
    low, high = small.limits()
    q, load = np.random.default_rng(2).uniform(low, high, (12, 2)), np.arange(12) % 4
    rows = chooser.rows_of(q, load)
    for one in rows:
        posterior.take(posterior.step(one))
    # the same from the estimate's own design and noise, dense: (Λ⁻¹ + Σ Xᵀ R⁻¹ X)⁻¹, seen at the point
    lin = belief.model.linearise(situation(small, q, load, cases), belief.theta)
    design = lin.design.reshape(12, 9, -1)
    noise = belief.noise.covariance(lin.levers, np.ones((12, 3), dtype=bool), np.ones(12))
    information = np.diag(1 / belief.strengths**2)
    information += np.einsum("nip,nij,njq->pq", design, np.linalg.inv(noise), design)
    covariance = np.linalg.inv(information)
    rows_there = posterior.work.rows / belief.strengths
    dense = np.einsum("tip,pq,tiq->ti", rows_there, covariance, rows_there).sum(axis=1).mean()
    assert mean_variance(posterior) == pytest.approx(dense, rel=2e-3)  # what is hardly visible keeps its prior


def test_a_visit_takes_off_the_mean_variance_what_the_pool_said_before(small: Machine) -> None:
    _, chooser, posterior, _ = chooser_of(small)
    low, high = small.limits()
    rows = chooser.rows_of(np.random.default_rng(3).uniform(low, high, (30, 2)), np.arange(30) % 4)
    pool = Pool(rows, posterior)
    for k in (4, 17, 4, 21):
        promised, before = pool.gains()[k], mean_variance(posterior)
        step = posterior.step(rows[k])
        pool.follow(step)
        posterior.take(step)
        assert before - mean_variance(posterior) == pytest.approx(promised, rel=1e-6)
    fresh = Pool(rows, posterior)
    assert pool.gains() == pytest.approx(fresh.gains(), rel=1e-6)


def test_a_visit_taken_out_again_leaves_no_trace(small: Machine) -> None:
    _, chooser, posterior, _ = chooser_of(small)
    rows = chooser.rows_of(np.array([[0.5, 1.5], [-0.3, 0.2]]), np.array([1, 2]))
    posterior.take(posterior.step(rows[0]))
    before, covariance = Pool(rows, posterior).gains(), posterior.covariance.copy()
    pool = Pool(rows, posterior)
    for made in (True, False):
        step = posterior.step(rows[1], made)
        pool.follow(step)
        posterior.take(step)
    assert np.abs(posterior.covariance - covariance).max() < 1e-9
    assert pool.gains() == pytest.approx(before, rel=1e-6)


def test_chosen_visits_beat_random_ones_under_the_same_loads_and_exchange_beats_greed(small: Machine) -> None:
    _, chooser, posterior, _ = chooser_of(small)
    low, high = small.limits()
    quota = np.array([6, 6, 6, 6])
    anywhere = Posterior(posterior.work, posterior.basis)
    q = np.random.default_rng(4).uniform(low, high, (24, 2))
    anywhere.add_all(chooser.rows_of(q, np.repeat(np.arange(4), 6)))
    chosen = chooser.greedy(posterior, 24, quota, candidates=400)
    assert np.bincount(chosen.load).tolist() == [6, 6, 6, 6]
    greedy = mean_variance(posterior)
    assert greedy < 0.9 * mean_variance(anywhere)
    chooser.exchange(posterior, chosen)
    assert mean_variance(posterior) < greedy
    again = Posterior(posterior.work, posterior.basis)
    again.add_all(chooser.rows_of(chosen.q, chosen.load))
    assert mean_variance(again) == pytest.approx(mean_variance(posterior), rel=1e-6)


def test_rounded_setpoints_never_leave_the_limits(pps: Machine) -> None:
    low, high = pps.limits()
    for q in (low, high):  # 90 degrees are 1.57079…, which rounds up
        assert np.all((inside(pps, q[None])[0] >= low) & (inside(pps, q[None])[0] <= high))


# --- order -------------------------------------------------------------------------------------------------------
def test_travel_takes_what_the_slowest_joint_takes(pps: Machine) -> None:
    a, b = np.zeros(6), np.array([0.02, 0.2, 0.4, -1.2, 0.01, 0.0])
    slowest = max(travel_time(joint, abs(x)) for joint, x in zip(pps.joints, b, strict=True))
    assert float(travel(pps.joints, a, b)) == pytest.approx(slowest)
    # yaw: 1.2 rad at 0.1 rad/s, a second more to start and stop
    assert slowest == pytest.approx(13.0)


@pytest.mark.parametrize("sizes", [(7,), (4, 3), (3, 3, 1)])
def test_orders_and_bounds_of_seven_visits_against_all_orders_there_are(pps: Machine, sizes: tuple[int, ...]) -> None:
    low, high = pps.limits()
    q = np.random.default_rng(5).uniform(low, high, (7, 6))
    reference = (low + high) / 2
    between, out = travel(pps.joints, q[:, None], q[None]), travel(pps.joints, q, reference)
    ends = np.cumsum(sizes)
    best = min(
        sum(length(between, out, order[end - size : end]) for size, end in zip(sizes, ends, strict=True))
        for order in itertools.permutations(range(7))
    )
    found = shortest_rounds(pps, reference, q, sizes, seed=1)
    assert sorted(k for r in found.rounds for k in r) == list(range(7))
    assert [len(r) for r in found.rounds][-1] == sizes[-1]
    assert found.seconds == pytest.approx(best, abs=1e-2)
    assert found.bound <= best + 1e-9
    assert found.bound > 0.9 * best


def test_the_bound_of_visits_on_a_line_is_the_way_there_and_back() -> None:
    # 1, 2, 3, 4 s out on one line: there and back takes 8 s, and the answer is known to be the best
    out = np.array([1.0, 2.0, 3.0, 4.0])
    assert lower_bound(np.abs(out[:, None] - out), out, [4], 8.0) == pytest.approx(8.0, rel=1e-3)


# --- campaigns ---------------------------------------------------------------------------------------------------
def test_a_designed_script_is_a_campaign_of_that_many_visits(small: Machine, tmp_path: Path) -> None:
    out = tmp_path / "designed.yaml"
    found = ask(small, out, visits=40)
    plan = plan_campaign(load_script(out), small)
    assert found.plan is not None
    assert plan.digest == found.plan.digest
    summary = plan.summary()
    assert summary.visits == 40
    assert summary.load_changes == 3
    assert summary.steps["reference"] == 5  # four rounds, and once more at the end
    assert (plan.visits[0].step, plan.visits[-1].step) == ("reference", "reference")
    between = [len(list(group)) for key, group in itertools.groupby(v.step for v in plan.visits) if key == "designed"]
    assert max(between) <= 15
    q = np.array([visit.setpoints for visit in plan.visits])
    moved = np.sign(np.diff(q, axis=0))
    assert np.all((moved > 0).sum(axis=0) >= 12)
    assert np.all((moved < 0).sum(axis=0) >= 12)
    travelled = summary.duration_s - 40 * (5 + 3 * 4) - 3 * 600
    assert found.numbers["travel_s"] == pytest.approx(travelled)
    assert found.numbers["travel_bound_s"] - 1e-6 <= travelled <= 1.05 * found.numbers["travel_bound_s"]
    assert "seed 1" in out.read_text(encoding="utf-8").splitlines()[0]


def test_the_same_seed_designs_the_same_campaign(small: Machine, tmp_path: Path) -> None:
    texts = []
    for k, seed in enumerate((3, 3, 4)):
        out = tmp_path / f"{k}.yaml"
        ask(small, out, visits=20, seed=seed)
        texts.append(out.read_text(encoding="utf-8"))
    assert texts[0] == texts[1]
    assert texts[0] != texts[2]


def test_an_accuracy_asked_for_is_predicted_with_fewer_visits_where_less_is_asked(
    small: Machine, tmp_path: Path
) -> None:
    coarse, fine = (ask(small, tmp_path / "a.yaml", accuracy=x) for x in (0.6e-3, 0.25e-3))
    assert coarse.numbers["predicted"]["with_noise_p98_6_mm"] <= 0.6
    assert fine.numbers["predicted"]["with_noise_p98_6_mm"] <= 0.25
    assert coarse.numbers["visits"] < fine.numbers["visits"]


def test_an_accuracy_below_the_noise_is_refused_with_the_noise(small: Machine, tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match=r"0\.1 mm: .* alone leave 0\.1\d+ mm at 98\.6 %"):
        ask(small, tmp_path / "a.yaml", accuracy=1e-4)


def test_a_rigid_machine_is_measured_without_load_changes(tmp_path: Path) -> None:
    rigid = "\n".join(line for line in SMALL.splitlines() if "elastic" not in line)
    found = planned(machine_of(tmp_path, rigid), tmp_path / "a.yaml", visits=20)
    assert found.summary().loads == {"empty": 20}


def test_one_reflector_and_no_point_of_interest_are_enough_for_a_design(tmp_path: Path) -> None:
    text = SMALL.replace(", P2: [0, 0.2, 0], P3: [0, -0.2, 0]", "")
    text = text.replace("  points: {treatment: [0.3, 0, 0.2]}\n", "")
    found = ask(machine_of(tmp_path, text), tmp_path / "a.yaml", visits=20)
    assert found.numbers["point"] == "tip"
    assert found.numbers["readings"] == 20


def test_an_instrument_that_stands_anywhere_does_not_blow_up_the_prediction(tmp_path: Path) -> None:
    free = machine_of(tmp_path, SMALL + "tracker: {base: estimate}\n")
    found = ask(free, tmp_path / "a.yaml", visits=40)
    assert found.numbers["predicted"]["model_p98_6_mm"] < 3


def test_without_limits_nothing_is_designed(tmp_path: Path) -> None:
    text = SMALL.replace("    limits: {lower: -1.5, upper: 1.5, velocity: 0.2, acceleration: 0.2}\n", "")
    with pytest.raises(CampaignError, match="joint turn has no limits"):
        ask(machine_of(tmp_path, text), tmp_path / "a.yaml", visits=20)


def test_too_few_visits_are_refused(small: Machine, tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="--visits 5: a design has 10 to 2000 visits"):
        ask(small, tmp_path / "a.yaml", visits=5)


# --- after a recording -------------------------------------------------------------------------------------------
def test_after_a_recording_it_says_how_good_it_is_what_is_missing_and_when_to_stop(tmp_path: Path) -> None:
    machine = machine_of(tmp_path)
    plant = Plant.from_file(machine.file, seed=7)
    table = simulate_recording_csv(plant, tmp_path / "r.csv", 24, np.random.default_rng(1), loads=2, visits_per_load=12)
    recording = load_recording(table, machine)
    out = tmp_path / "next.yaml"
    first = ask(machine, out, after=recording, visits=20)
    now, then = first.numbers["now"]["with_noise_p98_6_mm"], first.numbers["predicted"]["with_noise_p98_6_mm"]
    assert first.numbers["now"]["visits"] == 24
    assert then < now
    out.unlink()
    enough = ask(machine, out, after=recording, accuracy=1.01e-3 * now)
    assert enough.plan is None
    assert enough.numbers["enough"] is True
    assert not out.exists()
    wanted = 1e-3 * (now + then) / 2
    more = ask(machine, out, after=recording, accuracy=wanted)
    assert more.numbers["enough"] is False
    assert 0 < more.numbers["expected_visits"] <= 25
    assert more.numbers["predicted"]["with_noise_p98_6_mm"] <= 1e3 * wanted


def test_after_a_recording_the_loads_are_those_that_it_was_made_with(tmp_path: Path) -> None:
    """Planned for 6 to 83 kg, by a guess from a crane's own mass, after 100 to 400 kg had been measured."""
    machine = machine_of(tmp_path)
    plant = Plant.from_file(machine.file, seed=7)
    table = simulate_recording_csv(plant, tmp_path / "r.csv", 24, np.random.default_rng(1), loads=2, visits_per_load=12)
    recording = load_recording(table, machine)
    # the plant's centres are in its sensor's frame, 0.8 m behind the tip
    loads = {name: Load(mass, np.array(com)) for name, mass, com in (
        ("box", 310.4, [0.85, -0.1, 0.3]), ("couch", 0.4, [0, 0, 0]), ("beam", 120.0, [0.8, 0, 0]),
    )}  # fmt: skip
    labels = ("box",) * 12 + ("couch",) * 4 + ("beam",) * 8
    felt = [plant.wrench(q, loads[label])[0] for q, label in zip(recording.q, labels, strict=True)]
    recording = replace(recording, wrench=np.array(felt), load=labels)
    found = {case.name: (case.mass, case.com) for case in measured_with(recording, machine)}
    assert found["box"][0] == pytest.approx(310.4, abs=0.05)
    assert found["beam"] == (pytest.approx(120.0, abs=0.05), pytest.approx((0, 0, 0), abs=1e-3))
    assert found["box"][1] == pytest.approx((0.05, -0.1, 0.0), abs=1e-3)  # it turns about the vertical alone
    assert set(found) == {"box", "beam"}
    asked = ask(machine, tmp_path / "next.yaml", after=recording, visits=20)
    assert asked.lines[0] == "for loads of 0 to 310 kg, as in the recording"
    assert asked.plan is not None
    assert set(asked.plan.loads) <= {"empty", "box", "beam"}
    assert not measured_with(replace(recording, has_wrench=False), machine)
    # what is fitted for good is felt with the machine empty, and is no load that anybody puts on
    good = replace(recording, load=tuple("empty" if label == "beam" else label for label in labels))
    (box,) = measured_with(good, machine)
    assert (box.name, box.mass) == ("box", pytest.approx(310.4 - 120.0, abs=0.1))
    assert box.com[0] * box.mass == pytest.approx(310.4 * 0.05, abs=0.2)


def test_what_a_recording_tells_is_what_its_visits_would_have_told_beforehand(tmp_path: Path) -> None:
    machine = machine_of(tmp_path)
    plant = Plant.from_file(machine.file, seed=8)
    table = simulate_recording_csv(plant, tmp_path / "r.csv", 40, np.random.default_rng(2), loads=4, visits_per_load=10)
    recording = load_recording(table, machine)
    known = known_from(recording, identify(machine, recording), 20)
    rows = white_rows(known.belief, Situation(recording.q, recording.wrench))
    flat = rows.reshape(-1, rows.shape[2])
    # a robust weight or two below one may take a little off
    assert np.trace(known.information) == pytest.approx(np.trace(flat.T @ flat), rel=0.05)
    point = machine.point("treatment")
    work, cases = loads_for(machine, point, None, 4)
    before = Designer(Request(known.belief, "treatment", work, cases, 4, 1)).posterior().accuracy()
    after = Designer(Request(known.belief, "treatment", work, cases, 4, 1, known.information)).posterior().accuracy()
    assert after[0] < 0.5 * before[0]


def test_of_many_weights_the_telling_few_are_found_one_by_one_too(pps: Machine) -> None:
    rng = np.random.default_rng(6)
    many = [LoadCase(f"w{k}", float(rng.uniform(20, 100)), (0.0, 0.1, 0.5)) for k in range(40)]
    at = [(-0.2, 0.8), (0.2, 0.8), (0.0, 0.3)]
    corners = [LoadCase(f"corner{k}", 200.0, (x, 0.1, z)) for k, (x, z) in enumerate(at)]
    found = telling_cases(pps, range_of([*many, *corners]), [*many, *corners], 6)
    assert {"corner0", "corner1", "corner2"} <= {case.name for case in found}


def test_names_that_yaml_would_take_for_something_else_survive(small: Machine, tmp_path: Path) -> None:
    weights = tmp_path / "weights.yaml"
    text = "loads: [{name: 'no', mass: 0}, {name: '12', mass: 30, com: [0, 0, 0.1]}, {name: 'a: b', mass: 50}, "
    text += "{name: '<b> &,1', mass: 60}]\n"
    weights.write_text(f"name: weights\n{text}steps: [{{step: a, kind: random, count: 2}}]\n", encoding="utf-8")
    found = planned(small, tmp_path / "a.yaml", visits=30, loads=load_script(weights), name="1e3")
    assert set(found.summary().loads) == {"no", "12", "a: b", "<b> &,1"}
