"""Designed campaigns: residual at the treatment point on 110 unseen visits, time, travel against its lower bound.

    python -m benchmarks.designed [--seeds 20] [--first-seed 0] [--visits 669 202 100 67] [--short]

One design per number of visits (`ppshw plan --visits N`, nothing known of the machine), simulated on positioners that
it was not made for, one machine per seed, and identified by the joint estimate; the paper's campaign beside it. "noise"
is what repeatability and instrument leave of a perfect model on the same visits; time is what `ppshw plan` says.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.accuracy import MACHINE, POINT
from campaigns.design.ask import Question, answer
from campaigns.plan import Plan, plan_campaign
from campaigns.script import load_script
from ppshw.evaluation import figures
from ppshw.identification.joint import estimate
from ppshw.identification.structure import joint_model
from ppshw.machine import Machine, load_machine
from ppshw.recording import load_recording
from ppshw.terms import Situation
from ppshw.transforms import inverse
from simulators.offline import simulate_recording_csv, write_visits
from simulators.plant import Load, Plant


def design(machine: Machine, visits: int, out: Path) -> tuple[Plan, dict[str, float]]:
    """The campaign of `ppshw plan --visits N` with its default seed, and what was predicted."""
    began = time.perf_counter()
    question = Question(machine, visits, None, None, None, None, None, None, 1, f"designed-{visits}", "the benchmark")
    found = answer(question, out)
    assert found.plan is not None
    said = {k: v for k, v in found.numbers.items() if isinstance(v, float)}
    return found.plan, said | found.numbers["predicted"] | {"seconds": time.perf_counter() - began}


def simulate(plan: Plan, plant: Plant, out: Path, rng: np.random.Generator) -> Path:
    """The recording that a campaign makes on a simulated machine, without wires."""
    machine = plan.machine
    to_sensor = inverse(machine.sensor_in_link) @ machine.tip_in_link
    put_on = {
        name: Load(case.mass, to_sensor[:3, :3] @ np.array(case.com) + to_sensor[:3, 3]) if case.mass else None
        for name, case in plan.loads.items()
    }
    q = np.array([visit.setpoints for visit in plan.visits])
    labels = [visit.load for visit in plan.visits]
    steps = [visit.step for visit in plan.visits]
    return write_visits(plant, out, steps, labels, q, [put_on[name] for name in labels], rng)


def residual(plan: Plan, seed: int, folder: Path) -> tuple[float, float]:
    """98.6 % of the residual and of noise alone at the treatment point [mm]."""
    machine, plant = plan.machine, Plant.from_file(MACHINE, seed=seed)
    recording = load_recording(simulate(plan, plant, folder / "train.csv", np.random.default_rng(1000 + seed)), machine)
    rng = np.random.default_rng(5000 + seed)
    test = simulate_recording_csv(
        plant, folder / "test.csv", 110, rng=rng, interleave=True, names=[*plant.targets, POINT]
    )
    seen = load_recording(test, machine)
    found = estimate(joint_model(machine, recording), recording)
    predicted = found.model.predict(Situation.of(seen), found.theta, machine.point(POINT)[None])[:, 0]
    perfect = plant.true_points(seen.q, seen.wrench, names=[POINT])[POINT]
    measured = seen.extra_points[POINT]
    return figures(measured - predicted)["p98_6_mm"], figures(measured - perfect)["p98_6_mm"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--visits", type=int, nargs="+", default=[669, 202, 100, 67])
    parser.add_argument("--short", action="store_true", help="one seed, 20 visits, without the paper's campaign")
    given = parser.parse_args()
    seeds = range(given.first_seed, given.first_seed + (1 if given.short else given.seeds))
    machine = load_machine(MACHINE)
    print(f"| campaign | residual 98.6 %, median of {len(seeds)} machines [mm] | least … most | noise alone "
          "| predicted | load changes | hours | travel [s] | its bound [s] | above | design takes [s] |")  # fmt: skip
    print("|---" * 11 + "|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if not given.short:
            _row("paper, 669", plan_campaign(load_script("paper"), machine), {}, list(seeds), folder)
        for visits in [20] if given.short else given.visits:
            _row(f"designed, {visits}", *design(machine, visits, folder / "plan.yaml"), list(seeds), folder)


def _row(name: str, plan: Plan, said: dict[str, float], seeds: list[int], folder: Path) -> None:
    found = np.array([residual(plan, seed, folder) for seed in seeds])
    middle, noise = np.median(found, axis=0)
    summary = plan.summary()
    cells = [name, f"{middle:.3f}", f"{found[:, 0].min():.3f} … {found[:, 0].max():.3f}", f"{noise:.3f}"]
    cells += [f"{said['with_noise_p98_6_mm']:.3f}" if said else "–", f"{summary.load_changes}"]
    cells += [f"{summary.duration_s / 3600:.2f}"]
    if said:
        over = 100 * (said["travel_s"] / said["travel_bound_s"] - 1)
        cells += [f"{said['travel_s']:.0f}", f"{said['travel_bound_s']:.0f}", f"{over:.1f} %", f"{said['seconds']:.0f}"]
    else:
        cells += ["–"] * 4
    print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
