"""How often the truth lies within the 95 % intervals that an identification states, on visits it has not seen.

    python -m benchmarks.coverage [--seeds 20] [--visits 669 300 100 67] [--machine FILE] [--short]

One simulated machine per seed, random campaigns, 110 other random visits each. Every coordinate counts by itself.
*prediction*: where the treatment point is without the arrival's random part, against the parameters' covariance alone.
*reading*: what the tracker measures of the targets, against parameters, pose noise and instrument together.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from benchmarks.figures import ROOT, number, table
from ppshw.identification.joint import Estimate, estimate
from ppshw.identification.structure import joint_model
from ppshw.machine import Machine, load_machine
from ppshw.recording import Recording, load_recording
from ppshw.terms import Situation
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant

Array = NDArray[np.float64]
SHARE = 0.95
UNSEEN = 110


def coverage(file: Path, seed: int, visits: int, folder: Path) -> tuple[float, float, float]:
    """Share of predictions and of readings within their interval, and the noise's log score per reading coordinate."""
    machine, plant = load_machine(file), Plant.from_file(file, seed=seed)
    train, test = folder / "train.csv", folder / "test.csv"
    point = next(iter(plant.points))
    simulate_recording_csv(plant, train, visits, rng=np.random.default_rng(1000 + seed), loads=10)
    rng = np.random.default_rng(5000 + seed)
    simulate_recording_csv(plant, test, UNSEEN, rng=rng, interleave=True)
    known, unseen = load_recording(train, machine), load_recording(test, machine)
    found = estimate(joint_model(machine, known), known)
    true = plant.true_points(unseen.q, unseen.wrench, names=[point])[point]
    inside, score = readings(found, unseen)
    return predictions(found, machine, unseen, plant.points[point], true), inside, score


def predictions(found: Estimate, machine: Machine, unseen: Recording, point: Array, true: Array) -> float:
    linear = found.model.linearise(Situation.of(unseen), found.theta, point[None])
    design = linear.design[:, 0]
    variance = np.einsum("nip,nip->ni", design @ found.covariance, design)
    inverse = np.linalg.inv(found.measuring_in_base)
    predicted = linear.positions[:, 0] @ inverse[:3, :3].T + inverse[:3, 3]
    # the intervals are in base axes
    off = (true - predicted) @ found.measuring_in_base[:3, :3].T
    return float((np.abs(off) < norm.ppf(0.5 + SHARE / 2) * np.sqrt(variance)).mean())


def readings(found: Estimate, unseen: Recording) -> tuple[float, float]:
    """Share within the interval, and mean log density per coordinate [log 1/m]."""
    linear = found.model.linearise(Situation.of(unseen), found.theta)
    count, width = len(unseen), 3 * unseen.points.shape[1]
    design = linear.design.reshape(count, width, -1)
    whole = found.noise.covariance(linear.levers, unseen.seen, np.ones(count))
    whole = whole + (design @ found.covariance) @ np.swapaxes(design, 1, 2)
    measured = unseen.points @ found.measuring_in_base[:3, :3].T + found.measuring_in_base[:3, 3]
    off = (measured - linear.positions).reshape(count, width)
    distance = np.einsum("ni,ni->n", off, np.linalg.solve(whole, off[..., None])[..., 0])
    score = -0.5 * (distance + np.linalg.slogdet(whole)[1] + width * np.log(2 * np.pi)).mean() / width
    limit = norm.ppf(0.5 + SHARE / 2) * np.sqrt(np.einsum("nii->ni", whole))
    return float((np.abs(off) < limit).mean()), float(score)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--visits", type=int, nargs="+", default=[669, 300, 100, 67])
    parser.add_argument("--machine", type=Path, default=ROOT / "machines/pps.yaml")
    parser.add_argument("--short", action="store_true", help="two seeds, 100 visits")
    given = parser.parse_args()
    seeds, sizes = (2, [100]) if given.short else (given.seeds, given.visits)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for visits in sizes:
            found = np.array([coverage(given.machine, seed, visits, Path(folder)) for seed in range(seeds)]) * 100
            prediction, reading, _ = found.T
            rows.append([
                str(visits), number(prediction.mean()), f"{prediction.min():.0f} … {prediction.max():.0f}",
                number(reading.mean()), f"{reading.min():.0f} … {reading.max():.0f}", f"{found[:, 2].mean() / 100:.3f}",
            ])  # fmt: skip
    command = " ".join(["python -m benchmarks.coverage", *sys.argv[1:]])
    print(f"`{command}`, {given.machine.name}, {seeds} machines: % within 95 %; bar 93 … 97")
    header = ["visits", "predictions", "least … most", "readings", "least … most", "log score"]
    print("\n" + table(header, rows))


if __name__ == "__main__":
    main()
