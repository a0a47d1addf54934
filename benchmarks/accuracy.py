"""Residual at the treatment point on 110 unseen visits, against the number of visits identified from.

    python -m benchmarks.accuracy [--seeds 20] [--visits 669 202 100 67] [--short]

Random campaigns on simulated positioners (one machine per seed, repeatability 0.14 mm), joint estimate. "noise" is what
repeatability and instrument leave of a perfect model on the same visits.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from ppshw.evaluation import figures
from ppshw.identification.joint import estimate
from ppshw.identification.structure import joint_model
from ppshw.machine import load_machine
from ppshw.recording import load_recording
from ppshw.terms import Situation
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant

MACHINE = Path(__file__).resolve().parents[1] / "machines" / "pps.yaml"
POINT = "treatment"


def residual(seed: int, visits: int, folder: Path) -> tuple[float, float]:
    """98.6 % of the residual and of noise alone at the treatment point [mm]."""
    plant = Plant.from_file(MACHINE, seed=seed)
    machine = load_machine(MACHINE)
    train, test = folder / "train.csv", folder / "test.csv"
    simulate_recording_csv(plant, train, visits, rng=np.random.default_rng(1000 + seed), loads=10)
    rng = np.random.default_rng(5000 + seed)
    simulate_recording_csv(plant, test, 110, rng=rng, interleave=True, names=[*plant.targets, POINT])
    seen = load_recording(test, machine)
    found = estimate(joint_model(machine, recording := load_recording(train, machine)), recording)
    where = machine.point(POINT)[None]
    predicted = found.model.predict(Situation.of(seen), found.theta, where)[:, 0]
    perfect = plant.true_points(seen.q, seen.wrench, names=[POINT])[POINT]
    measured = seen.extra_points[POINT]
    return figures(measured - predicted)["p98_6_mm"], figures(measured - perfect)["p98_6_mm"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--visits", type=int, nargs="+", default=[669, 202, 100, 67])
    parser.add_argument("--short", action="store_true", help="one seed, 67 visits")
    given = parser.parse_args()
    seeds, sizes = (1, [67]) if given.short else (given.seeds, given.visits)
    print(f"| visits | residual 98.6 %, median of {seeds} machines [mm] | least … most | noise alone |")
    print("|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for visits in sizes:
            found = np.array([residual(seed, visits, Path(folder)) for seed in range(seeds)])
            middle, noise = np.median(found, axis=0)
            low, high = found[:, 0].min(), found[:, 0].max()
            print(f"| {visits} | {middle:.3f} | {low:.3f} … {high:.3f} | {noise:.3f} |", flush=True)


if __name__ == "__main__":
    main()
