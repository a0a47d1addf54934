"""The truth behind the simulators, held against hand calculations, the paper's figures and the shared example."""

from __future__ import annotations

import csv
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from simulators.beams import LinkBeam, Section, box, cantilever
from simulators.chain import link_poses, link_wrenches, read_chain
from simulators.offline import simulate_recording_csv
from simulators.plant import LivePlant, Load, Plant

ROOT = Path(__file__).parents[2]
PPS, ARM6 = ROOT / "machines/pps.yaml", ROOT / "machines/arm6.yaml"
EXAMPLES = ROOT.parent / "shared/data/example"
SOFT = Section(ea=1e9, ga=1e15, eiy=2e6, eiz=1e6, gj=8e5)  # no shear to speak of
X = np.array([1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def pps() -> Plant:
    return Plant.from_file(PPS, seed=5)


def machine(tmp_path: Path, joints: list[dict[str, Any]], **rest: Any) -> Path:
    path = tmp_path / "machine.yaml"
    whole = {"name": "m", "gravity": [0, 0, -10], "joints": joints, "tip": {"targets": {"P": [0, 0, 0]}}}
    path.write_text(yaml.safe_dump({**whole, **rest}))
    return path


def joint(name: str, kind: str, axis: list[float], xyz: list[float], **rest: Any) -> dict[str, Any]:
    origin = {"xyz": xyz, "rpy": rest.pop("rpy", [0, 0, 0])}
    return {"name": name, "type": kind, "axis": axis, "origin": origin, **rest}


def error_mm(plant: Plant, q: np.ndarray, loads: Any, eps: np.ndarray | None = None) -> np.ndarray:
    real = plant.true_points(q, loads, eps, ["treatment"])["treatment"]
    return 1e3 * np.linalg.norm(real - plant.nominal_points(q, ["treatment"])["treatment"], axis=1)


# Beams -------------------------------------------------------------------------------------------------------------


def test_a_cantilever_bends_as_in_the_textbook() -> None:
    c = cantilever(SOFT, np.array([2.0]))[0]
    pushed_y = c @ [0, 300, 0, 0, 0, 0]
    assert pushed_y[1] == pytest.approx(300 * 2**3 / (3 * 1e6))  # F L³ / 3 E I = 0.8 mm
    assert pushed_y[5] == pytest.approx(300 * 2**2 / (2 * 1e6))  # F L² / 2 E I = 0.6 mrad
    pushed_z = c @ [0, 0, 300, 0, 0, 0]
    assert pushed_z[[2, 4]] == pytest.approx([0.4e-3, -0.3e-3])  # twice as stiff, and z turns it about −y
    assert (c @ [0, 0, 0, 0, 0, 500])[[1, 5]] == pytest.approx([1e-3, 1e-3])  # M L² / 2 E I, M L / E I
    assert (c @ [0, 0, 0, 200, 0, 0])[3] == pytest.approx(5e-4)  # T L / G J
    assert (c @ [1e6, 0, 0, 0, 0, 0])[0] == pytest.approx(2e-3)  # F L / E A


def test_a_short_cantilever_also_shears() -> None:
    stubby = Section(ea=1e9, ga=1e6, eiy=1e6, eiz=1e6, gj=1e6)
    assert cantilever(stubby, np.array([1.0]))[0, 1, 1] == pytest.approx(1 / 3e6 + 1 / 1e6)


def test_a_steel_box_has_its_section_s_stiffness() -> None:
    section = box(0.1, 0.2, 0.01, 2.1e11)
    assert section.eiy == pytest.approx(2.1e11 * (0.1 * 0.2**3 - 0.08 * 0.18**3) / 12)  # 5.835 MN m²
    assert section.eiy == pytest.approx(5.8352e6, rel=1e-5)
    assert section.ea == pytest.approx(2.1e11 * 56e-4)  # 0.02 − 0.0144 m²
    # Bredt: 4 A_m² t / perimeter = 4 (0.09·0.19)² 0.01 / 0.56 = 2.0887e-5 m⁴, G = 80.77 GPa
    assert section.gj == pytest.approx(8.0769e10 * 2.08864e-5, rel=1e-4)


def test_a_beam_that_slides_out_of_a_soft_guide_also_tips_in_it() -> None:
    guide = np.array([0, 0, 0, 0, 0, 1e-6])  # turns 1 µrad per N m about its z
    arm = LinkBeam("reaching", X, 1.0, X, SOFT, guide)
    bent = arm.compliance(np.array([0.0, 1.0])) @ [0, 300, 0, 0, 0, 0]
    # at q = 1 the free length is 2 m: 0.8 mm of bending, and 600 N m tip the guide by 0.6 mrad over 2 m
    assert bent[:, 1] == pytest.approx([1e-4 + 3e-4, 0.8e-3 + 1.2e-3])
    assert bent[:, 5] == pytest.approx([1.5e-4 + 3e-4, 0.6e-3 + 0.6e-3])


def test_a_load_at_the_end_of_a_carrying_beam_bends_it_like_a_cantilever() -> None:
    beam = LinkBeam("carrying", X, 2.0, X, SOFT, np.zeros(6))
    twist = beam.compliance(np.zeros(1))[0] @ [0, 300, 0, 0, 0, 600]  # 300 N at 2 m, taken at the root
    at_end = twist[:3] + np.cross(twist[3:], [2, 0, 0])
    assert at_end == pytest.approx([0, 0.8e-3, 0])
    assert twist[3:] == pytest.approx([0, 0, 0.6e-3])


def test_a_beam_before_a_turning_joint_is_seen_from_ever_new_sides() -> None:
    z = np.array([0.0, 0.0, 1.0])
    beam = LinkBeam("turning", X, 2.0, z, SOFT, np.zeros(6))
    straight, turned = beam.compliance(np.array([0.0, np.pi / 2]))
    assert straight[1, 1] == pytest.approx(8 / 3e6)
    assert turned[0, 0] == pytest.approx(8 / 3e6)  # a quarter turn on, the link's x is the beam's −y
    assert turned[1, 1] == pytest.approx(2 / 1e9)


@pytest.mark.parametrize("path", [PPS, ARM6])
def test_every_compliance_is_symmetric_and_only_of_its_own_joint(path: Path) -> None:
    plant = Plant.from_file(path, seed=2)
    for entry, spring in zip(plant.chain.joints, plant.truth.springs, strict=True):
        assert spring is not None
        c = spring.compliance(np.linspace(entry.lower, entry.upper, 7))
        assert np.allclose(c, c.transpose(0, 2, 1), rtol=1e-12)
        assert np.all(np.linalg.eigvalsh(c) > 0)  # a passive structure gives way, never pushes back
        assert np.ptp(c, axis=0).max() > 0 if entry.varies else np.ptp(c, axis=0).max() == 0


# Kinematics and statics ----------------------------------------------------------------------------------------------


def test_a_chain_of_two_joints_is_where_a_pencil_puts_it(tmp_path: Path) -> None:
    joints = [
        joint("slide", "prismatic", [1, 0, 0], [0, 0, 1]),
        joint("turn", "revolute", [0, 0, 1], [0.5, 0, 0], rpy=[0, 0, np.pi / 2]),
    ]
    tip = {"origin": {"xyz": [0.2, 0, 0], "rpy": [0, 0, 0]}, "targets": {"P": [0, 0, 0], "Q": [0, 0.1, 0]}}
    plant = Plant.from_file(machine(tmp_path, joints, tip=tip))
    at = plant.nominal_points(np.array([[0.3, np.pi / 2], [0.3, 0.0]]))
    assert at["P"] == pytest.approx(np.array([[0.6, 0, 1], [0.8, 0.2, 1]]))  # half a turn; a quarter turn
    assert at["Q"] == pytest.approx(np.array([[0.6, -0.1, 1], [0.7, 0.2, 1]]))


def test_every_link_carries_what_hangs_on_it(tmp_path: Path) -> None:
    joints = [
        joint("shoulder", "revolute", [0, 1, 0], [0, 0, 0], link={"mass": 10, "com": [0.5, 0, 0]}),
        joint("elbow", "revolute", [0, 1, 0], [1, 0, 0], link={"mass": 4, "com": [0.25, 0, 0]}),
    ]
    sensor = {"origin": {"xyz": [0.5, 0, 0], "rpy": [0, 0, 0]}}
    chain = read_chain(machine(tmp_path, joints, force_sensor=sensor))
    payload = np.array([0, 0, -20.0, 0, 2.0, 0])  # 2 kg whose centre of mass is 0.1 m beyond the sensor
    poses = link_poses(chain, np.array([[0.0, 0.0]]))
    carried = link_wrenches(chain, poses, payload[None])[0]
    # g = 10: elbow 60 N; 40 N at 0.25 m + 20 N at 0.6 m = 22 N m. Shoulder 160 N; 100·0.5 + 40·1.25 + 20·1.6 = 132
    assert carried[1] == pytest.approx([0, 0, -60, 0, 22, 0])
    assert carried[0] == pytest.approx([0, 0, -160, 0, 132, 0])

    plant = Plant(chain)
    hanging = np.array([[np.pi / 2, 0.0]])  # the arm points down: no moment anywhere, the weight runs along +x
    held = plant.link_wrenches(hanging, Load(2.0, np.array([0.1, 0, 0])))[0]
    assert held == pytest.approx(np.array([[160, 0, 0, 0, 0, 0], [60, 0, 0, 0, 0, 0]], dtype=float), abs=1e-9)


def test_the_sensor_feels_the_payload_s_weight_and_lever(pps: Plant) -> None:
    home = np.zeros(6)
    felt = pps.wrench(home, Load(100.0, np.array([0.1, 0.2, 0.5])))[0]
    # F = −980.665 N along y; M = com × F = (0.5·980.665, 0, −0.1·980.665)
    assert felt == pytest.approx([0, -980.665, 0, 490.3325, 0, -98.0665])
    assert pps.wrench(home, None) == pytest.approx(np.zeros((1, 6)))


def test_loads_may_be_given_as_payloads_or_as_wrenches(pps: Plant) -> None:
    rng = np.random.default_rng(0)
    q, loads = pps.random_poses(5, rng), pps.random_loads(5, rng)
    by_load, by_wrench = pps.true_points(q, loads), pps.true_points(q, pps.wrench(q, loads))
    assert all(np.array_equal(by_load[name], by_wrench[name]) for name in ("P1", "P2", "P3"))
    with pytest.raises(ValueError, match="4 loads for 5 poses"):
        pps.wrench(q, loads[:4])


# What the machine file says acts -------------------------------------------------------------------------------------


def test_only_listed_load_components_bend_the_machine(pps: Plant) -> None:
    q = np.array([0.2, 0.1, 0.7, 0.0, 0.0, 0.0])
    free = pps.true_points(q)["P1"]
    assert np.array_equal(pps.true_points(q, np.array([0, 0, 0, 0, 400.0, 0]))["P1"], free)  # My is not listed
    assert np.linalg.norm(pps.true_points(q, np.array([0, 0, 0, 400.0, 0, 0]))["P1"] - free) > 1e-4


def test_a_machine_without_elastic_entries_is_rigid(tmp_path: Path) -> None:
    raw = yaml.safe_load(PPS.read_text())
    for entry in raw["joints"]:
        del entry["elastic"]
    rigid = Plant.from_file(machine(tmp_path, **raw))
    q = np.zeros(6)
    heavy = rigid.true_points(q, Load(200.0, np.array([0, 0, 1.0])))
    assert np.array_equal(heavy["P1"], rigid.true_points(q)["P1"])
    assert error_mm(rigid, q, None)[0] > 0.1  # geometry is still wrong


def test_a_patient_makes_the_couch_sink_and_more_so_far_out(pps: Plant) -> None:
    patient = Load(150.0, np.array([0, 0.2, 0.6]))
    q = np.zeros((2, 6))
    q[1, 2] = 1.47
    sink = [pps.true_points(q, load, names=["treatment"])["treatment"][:, 1] for load in (patient, None)]
    near, far = sink[0] - sink[1]
    assert far < near < -2e-4


def test_deflection_is_proportional_to_the_load(pps: Plant) -> None:
    q = pps.random_poses(50, np.random.default_rng(1))
    one = np.array([0, -800.0, 0, 300.0, 0, 60.0])
    free, single, double = (pps.true_points(q, k * one)["P1"] for k in (0, 1, 2))
    assert np.abs((double - free) - 2 * (single - free)).max() < 1e-5  # paper: under 0.041 mm up to 150 kg


# Sizes ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", [PPS, EXAMPLES / "pps/machine.yaml"])
def test_98_6_percent_of_a_positioner_s_errors_stay_under_7_to_10_mm(path: Path) -> None:
    if not path.exists():
        pytest.skip(f"{path} is not here")
    for seed in range(20):
        plant = Plant.from_file(path, seed)
        rng = np.random.default_rng(1000 + seed)
        q = plant.random_poses(1000, rng)
        loads = plant.random_loads(1000, rng)
        assert min(load.mass_kg for load in loads) == pytest.approx(20, abs=2)
        assert max(load.mass_kg for load in loads) == pytest.approx(200, abs=2)
        whole = np.quantile(error_mm(plant, q, loads), 0.986)
        assert 7.0 < whole < 10.0, f"seed {seed}"
        geometry = np.quantile(error_mm(plant, q, None, -plant.elastic_error(q)), 0.986)
        assert geometry < 0.45 * whole, f"seed {seed}: elasticity should be the largest part"


def test_another_machine_errs_by_as_much_for_its_size() -> None:
    ratios = []
    for path in (PPS, ARM6):
        plant = Plant.from_file(path, seed=1)
        rng = np.random.default_rng(2)
        q = plant.random_poses(1000, rng)
        size = 1e3 * np.ptp(plant.nominal_points(q, ["treatment"])["treatment"], axis=0).max()
        ratios.append(np.quantile(error_mm(plant, q, plant.random_loads(1000, rng)), 0.986) / size)
    assert ratios == pytest.approx([2e-3, 2e-3], rel=0.15)


@pytest.mark.parametrize("path", [PPS, ARM6])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_plant_repeats_as_well_as_its_machine_file_claims(path: Path, seed: int) -> None:
    plant = Plant.from_file(path, seed)
    rng = np.random.default_rng(77 + seed)
    q = plant.random_poses(6000, rng)
    load = plant.random_loads(1, rng)[0]
    place = plant.true_points(q, load, names=["treatment"])["treatment"]
    eps = plant.draw_repeatability(6000, rng)
    deviation = plant.true_points(q, load, eps, ["treatment"])["treatment"] - place
    assert np.quantile(np.linalg.norm(deviation, axis=1), 0.986) == pytest.approx(1.4e-4, rel=0.06)
    assert np.sqrt(np.mean(deviation**2)) == pytest.approx(0.043e-3, rel=0.1)  # 0.14 mm / 3.26 per axis


def test_repeatability_can_be_set_or_taken_away() -> None:
    rng = np.random.default_rng(0)
    assert np.all(Plant.from_file(PPS, repeatability=0.0).draw_repeatability(3, rng) == 0)
    coarse, fine = (Plant.from_file(PPS, repeatability=r).truth.scatter for r in (2.8e-4, 1.4e-4))
    assert coarse == pytest.approx(2 * fine)


@pytest.mark.parametrize(("path", "within_mm"), [(PPS, 0.02), (ARM6, 0.03)])
def test_the_paper_s_small_error_product_represents_the_plant(path: Path, within_mm: float) -> None:
    """Eqs (5) and (7) with the plant's own ε: the linear E_i, written out here, and the sum ε_g + ε_e."""
    plant = Plant.from_file(path, seed=4)
    rng = np.random.default_rng(3)
    q = plant.random_poses(500, rng)
    loads = plant.random_loads(500, rng)
    shape = np.stack([s.at(q[:, i]) for i, s in enumerate(plant.truth.shapes)], axis=1)
    eps = shape + plant.elastic_error(q, loads)
    nominal = link_poses(plant.chain, q)
    here = np.broadcast_to(np.eye(4), (500, 4, 4))
    before = here
    for i in range(q.shape[1]):
        e = np.broadcast_to(np.eye(4), (500, 4, 4)).copy()
        e1, e2, e3, e4, e5, e6 = eps[:, i].T
        e[:, 0, 1], e[:, 0, 2], e[:, 0, 3] = -e6, e5, e1
        e[:, 1, 0], e[:, 1, 2], e[:, 1, 3] = e6, -e4, e2
        e[:, 2, 0], e[:, 2, 1], e[:, 2, 3] = -e5, e4, e3
        here = here @ np.linalg.inv(before) @ nominal[:, i] @ e
        before = nominal[:, i]
    at = np.append(plant.points["treatment"], 1.0)
    modelled = (here @ plant.chain.tip @ at)[:, :3]
    missed = np.linalg.norm(modelled - plant.true_points(q, loads, names=["treatment"])["treatment"], axis=1)
    assert 1e3 * np.quantile(missed, 0.986) < within_mm


# One machine per seed ------------------------------------------------------------------------------------------------


def test_the_same_seed_makes_the_same_machine_to_the_last_byte(tmp_path: Path) -> None:
    first, again, other = (
        simulate_recording_csv(Plant.from_file(PPS, seed), tmp_path / f"{k}.csv", 60, plan="mixed").read_bytes()
        for k, seed in enumerate((8, 8, 9))
    )
    assert first == again
    assert first != other


def test_700_visits_take_less_than_a_second(pps: Plant) -> None:
    rng = np.random.default_rng(0)
    q, loads = pps.random_poses(700, rng), pps.random_loads(700, rng)
    start = time.perf_counter()
    pps.true_points(q, loads, pps.draw_repeatability(700, rng), ["P1", "P2", "P3", "treatment"])
    assert time.perf_counter() - start < 1.0


def test_the_example_s_reflectors_are_where_the_chain_says_to_a_centimetre() -> None:
    for name in ("pps", "arm6"):
        folder = EXAMPLES / name
        if not folder.exists():
            pytest.skip(f"{folder} is not here")
        plant = Plant.from_file(folder / "machine.yaml")
        with (folder / "train.csv").open() as file:
            rows = list(csv.DictReader(file))
        q = np.array([[float(row[f"q_{joint}"]) for joint in plant.joint_names] for row in rows])
        for target, nominal in plant.nominal_points(q).items():
            measured = np.array([[float(row[f"{target}_{axis}"]) for axis in "xyz"] for row in rows])
            assert np.quantile(np.linalg.norm(measured - nominal, axis=1), 0.986) < 0.012


def test_an_unknown_tracker_stands_metres_away_and_keeps_distances(tmp_path: Path) -> None:
    raw = yaml.safe_load(PPS.read_text())
    raw["tracker"] = {"position_sigma": 2e-5, "base": "estimate", "targets": "estimate"}
    plant = Plant.from_file(machine(tmp_path, **raw), seed=5)
    known = Plant.from_file(PPS, seed=5)
    q = plant.random_poses(20, np.random.default_rng(0))
    seen, base = (p.true_points(q, names=["treatment"])["treatment"] for p in (plant, known))
    between = np.linalg.norm(seen[1:] - seen[0], axis=1)
    assert between == pytest.approx(np.linalg.norm(base[1:] - base[0], axis=1))
    assert 3.0 <= np.linalg.norm(plant.measuring_in_base[:3, 3]) <= 6.0
    shifted = np.linalg.norm(plant.targets["P1"] - known.targets["P1"])
    assert 1e-4 < shifted < 1e-2  # the file's target position is only a start


# The plant while it moves --------------------------------------------------------------------------------------------


class HandClock:
    time = 0.0

    def now(self) -> float:
        return self.time


def test_an_arrival_has_one_deviation_until_the_machine_moves(pps: Plant) -> None:
    q = np.zeros(6)
    live = LivePlant(pps, lambda: q, HandClock())
    first = live.visible_targets()
    assert set(first) == {"P1", "P2", "P3"}
    assert all(np.array_equal(live.visible_targets()[k], first[k]) for k in first)
    q[3] = 0.5
    live.visible_targets()
    q[3] = 0.0
    back = live.visible_targets()
    assert 1e-6 < np.linalg.norm(back["P1"] - first["P1"]) < 5e-4


def test_reflectors_and_loads_are_mounted_by_hand(pps: Plant) -> None:
    live = LivePlant(pps, lambda: np.zeros(6), HandClock(), fitted=["P1", "treatment"])
    empty = live.visible_targets()
    assert set(empty) == {"P1", "treatment"}
    live.set_load(Load(100.0, np.array([0, 0.1, 0.5])))
    assert live.wrench()[:3] == pytest.approx([0, -980.665, 0])
    assert live.visible_targets()["treatment"][1] < empty["treatment"][1] - 1e-4
    live.set_load(None)
    assert np.array_equal(live.visible_targets()["treatment"], empty["treatment"])
    with pytest.raises(ValueError, match="no place for a reflector called P9"):
        live.fit(["P9"])


def test_the_hall_warms_and_cools_and_the_rail_follows_late(pps: Plant) -> None:
    clock = HandClock()
    live = LivePlant(pps, lambda: np.zeros(6), clock)
    air, rail = [], []
    for clock.time in np.arange(0.0, 12 * 3600.0, 300.0):
        now = live.temperatures()
        air.append(now["air"])
        rail.append(now["rail"])
    steps = np.diff(air)
    assert steps.min() < 0 < steps.max()
    assert 15 < min(air + rail) < max(air + rail) < 30
    settled, followed = np.array(rail[72:]), np.array(air)  # once the warm-up is over
    likeness = [np.corrcoef(settled, followed[72 - lag : 144 - lag])[0, 1] for lag in range(36)]
    assert 6 <= np.argmax(likeness) <= 18  # half an hour to an hour and a half


# A recording without wires -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("plan", ["random", "sweeps", "mixed"])
def test_a_made_recording_reads_like_the_example(tmp_path: Path, pps: Plant, plan: str) -> None:
    made = simulate_recording_csv(pps, tmp_path / "made.csv", 120, plan=plan, loads=3, visits_per_load=30)
    with made.open() as file:
        rows = list(csv.DictReader(file))
    if (EXAMPLES / "pps/train.csv").exists():
        header = (EXAMPLES / "pps/train.csv").read_text().splitlines()[0]
        assert ",".join(rows[0]) == header
    assert [row["load"] for row in rows] == ["L0"] * 30 + ["L1"] * 30 + ["L2"] * 30 + ["L0"] * 30
    assert all(a["time"] < b["time"] for a, b in pairwise(rows))
    before = np.zeros(6)
    for row in rows:
        q = np.array([float(row[f"q_cmd_{name}"]) for name in pps.joint_names])
        assert np.all((q >= pps.lower) & (q <= pps.upper))
        for name, moved in zip(pps.joint_names, q - before, strict=True):
            assert moved == 0 or int(row[f"approach_{name}"]) == np.sign(moved)
        before = q
    assert {row["approach_yaw"] for row in rows} >= {"-1", "1"}
    assert (sum(row["step"].startswith("sweep:") for row in rows) > 0) == (plan != "random")


def test_loads_may_interleave_and_noise_may_be_left_out(tmp_path: Path, pps: Plant) -> None:
    exact = Plant.from_file(PPS, seed=5, repeatability=0.0)
    load = Load(80.0, np.array([0, 0.1, 0.4]))
    made = simulate_recording_csv(
        exact, tmp_path / "made.csv", 40, loads=[load, None], interleave=True, measurement_noise=False
    )
    with made.open() as file:
        rows = list(csv.DictReader(file))
    labels = [row["load"] for row in rows]
    assert set(labels) == {"L0", "L1"}
    assert sum(a != b for a, b in pairwise(labels)) > 8
    q = np.array([[float(row[f"q_{name}"]) for name in pps.joint_names] for row in rows])
    p1 = np.array([[float(row[f"P1_{axis}"]) for axis in "xyz"] for row in rows])
    applied = [load if label == "L0" else None for label in labels]
    assert np.abs(pps.true_points(q, applied)["P1"] - p1).max() < 1e-7
    with pytest.raises(ValueError, match="no plan 'zigzag'; there are random, sweeps, mixed"):
        simulate_recording_csv(pps, tmp_path / "none.csv", plan="zigzag")
