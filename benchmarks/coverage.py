"""How often the truth lies within the 95 % intervals that an identification states, on visits it has not seen.

    python -m benchmarks.coverage [--seeds 20] [--visits 669 300 100 67] [--machine FILE] [--short]

One simulated machine per seed, random campaigns, 110 other random visits each. Every coordinate counts by itself.
*prediction*: where the treatment point is without the arrival's random part, against the parameters' covariance alone.
*reading*: what the tracker measures of the targets, against parameters, pose noise and instrument together.
*compliance*: elements of compliances that are the same over the travel, each against its printed standard deviation.
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
from ppshw.calibration import Calibration
from ppshw.identification.joint import Estimate, estimate
from ppshw.identification.structure import joint_model
from ppshw.machine import Machine, load_machine
from ppshw.recording import Recording, load_recording
from ppshw.terms import Situation
from ppshw.terms.basis import Constant
from ppshw.terms.elastic import Compliance
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant

Array = NDArray[np.float64]
SHARE = 0.95
UNSEEN = 110


def coverage(file: Path, seed: int, visits: int, folder: Path) -> tuple[float, float, float, float]:
    """Share of predictions, of readings and of elements of compliances within their interval, and the noise's log score
    per reading coordinate."""
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
    return (
        predictions(found, machine, unseen, plant.points[point], true),
        inside,
        elements(found, Calibration.of(found, known, "joint").std, plant),
        score,
    )


def elements(found: Estimate, std: Array, plant: Plant) -> float:
    """Of the compliances that do not vary, by printed deviations (p,); NaN where all do."""
    at, inside = 0, []
    for term in found.model.terms:
        size = len(term.parameters(found.model.machine.frame_names))
        if isinstance(term, Compliance) and isinstance(term.basis, Constant):
            joint, spring = plant.chain.joints[term.frame - 1], plant.truth.springs[term.frame - 1]
            assert spring is not None
            true = spring.compliance(np.zeros(1))[0] * joint.acts
            off = [found.theta[at + k] - true[row, load] for k, (row, load) in enumerate(term.elements)]
            inside.extend(np.abs(off) < norm.ppf(0.5 + SHARE / 2) * std[at : at + size])
        at += size
    return float(np.mean(inside)) if inside else np.nan


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
            prediction, reading, element, score = found.T
            shares = [each for share in (prediction, reading, element)
                      for each in (number(share.mean()), f"{share.min():.0f} … {share.max():.0f}")]  # fmt: skip
            rows.append([str(visits), *shares, f"{score.mean() / 100:.3f}"])
    command = " ".join(["python -m benchmarks.coverage", *sys.argv[1:]])
    print(f"`{command}`, {given.machine.name}, {seeds} machines: % within 95 %; bar 93 … 97")
    header = ["visits"]
    for each in ("predictions", "readings", "compliances"):
        header += [each, "least … most"]
    header.append("log score")
    print("\n" + table(header, rows))


if __name__ == "__main__":
    main()
