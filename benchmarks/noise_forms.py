"""Does it help to know how the pose scatters? Log score of unseen readings, by form of the noise.

    python -m benchmarks.noise_forms [--seeds 10] [--visits 300] [--machines pps arm6] [--short]

Every simulated machine scatters in one of four ways: all joints alike (how the plants are made), every joint by a
factor of its own between 1/4 and 4 (its shifts, its turns), the last link alone, or every drive, along or about its
joint's axis by a factor of its own, beside a third of the first. It is identified with each form of
noise and with the one that the estimate chooses. Larger is better; 0.01 per coordinate is 1 % of each likelihood.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from benchmarks.coverage import UNSEEN, readings
from benchmarks.figures import ROOT, table
from ppshw.identification import judgement
from ppshw.identification.joint import Estimate, estimate
from ppshw.identification.noise import Noise
from ppshw.identification.noise_fit import Form, Moments, choose, fit
from ppshw.identification.structure import joint_model
from ppshw.machine import Machine, load_machine
from ppshw.recording import Recording, load_recording
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant

Array = NDArray[np.float64]
WAYS = ("alike", "each its own", "last link", "drives")


def scattering(plant: Plant, machine: Machine, way: str, rng: np.random.Generator) -> Plant:
    """The same machine with another random part of every arrival, about as large."""
    scatter = plant.truth.scatter
    if way == "each its own":
        factors = np.repeat(4.0 ** rng.uniform(-1, 1, (len(scatter), 2)), 3, axis=1)
        scatter = scatter * factors / np.sqrt((factors**2).mean())
    elif way == "last link":
        scatter = np.zeros_like(scatter)
        scatter[-1] = plant.truth.scatter[-1] * np.sqrt(len(scatter))
    elif way == "drives":
        factors = 4.0 ** rng.uniform(-1, 1, (len(scatter), 1))
        scatter = scatter / 3 + scatter * factors * np.abs(machine.own_ways)
    plant.truth = replace(plant.truth, scatter=scatter)
    return plant


def identified(machine: Machine, known: Recording, form: Form | None) -> tuple[Estimate, Form]:
    """With the noise held to a form, or left to the estimate; and which it was."""
    taken: list[Form] = []

    def choice(moments: Moments, before: Noise, rank: int) -> tuple[Form, Noise]:
        one = choose(moments, before, rank) if form is None else (form, fit(form, moments, before, rank))
        taken.append(one[0])
        return one

    with patch.object(judgement, "choose", choice):
        found = estimate(joint_model(machine, known), known)
    return found, taken[-1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--visits", type=int, default=300)
    parser.add_argument("--machines", nargs="+", default=["pps", "arm6"])
    parser.add_argument("--short", action="store_true", help="one seed of one machine that scatters one way, 40 visits")
    given = parser.parse_args()
    seeds, visits, machines = (1, 40, ["pps"]) if given.short else (given.seeds, given.visits, given.machines)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name in machines:
            for way in ["each its own"] if given.short else WAYS:
                rows.append([name, way, *row(ROOT / f"machines/{name}.yaml", way, seeds, visits, Path(folder))])
    header = ["machine", "scatters", *(form.name.lower() for form in Form), "chosen", "which"]
    command = " ".join(["python -m benchmarks.noise_forms", *sys.argv[1:]])
    print(f"`{command}`: log score per coordinate, {visits} visits, mean of {seeds} machines\n")
    print(table(header, rows))


def row(file: Path, way: str, seeds: int, visits: int, folder: Path) -> list[str]:
    machine = load_machine(file)
    scores: list[list[float]] = []
    chosen: Counter[str] = Counter()
    for seed in range(seeds):
        plant = scattering(Plant.from_file(file, seed=seed), machine, way, np.random.default_rng(9000 + seed))
        train, test = folder / "train.csv", folder / "test.csv"
        simulate_recording_csv(plant, train, visits, rng=np.random.default_rng(1000 + seed), loads=10)
        simulate_recording_csv(plant, test, UNSEEN, rng=np.random.default_rng(5000 + seed), interleave=True)
        known, unseen = load_recording(train, machine), load_recording(test, machine)
        found = [identified(machine, known, form) for form in (*Form, None)]
        scores.append([readings(each, unseen)[1] for each, _ in found])
        chosen[found[-1][1].name.lower()] += 1
    means = np.mean(scores, axis=0)
    return [*(f"{mean:.3f}" for mean in means), ", ".join(f"{k} {n}" for k, n in chosen.most_common())]


if __name__ == "__main__":
    main()
