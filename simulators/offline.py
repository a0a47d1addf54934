"""A recording in the contract's CSV (§2) straight from the plant, with no wire in between: for offline tests.

Known limitations: encoders repeat to 0.1 µm or µrad and carry no error; no beam is ever lost; visits follow each other
every minute or so whatever the distance; temperatures are recorded but act on nothing.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from simulators.chain import Array
from simulators.plant import Load, Plant, temperatures
from simulators.recorded import ENCODER_SIGMA, FORCE_SIGMA, header, last_motion

START = datetime(2026, 3, 2, 6, 0, tzinfo=UTC)
SWEEP_LENGTH = 10  # visits in one pass of one joint
PLANS = ("random", "sweeps", "mixed")


def simulate_recording_csv(
    plant: Plant,
    out_csv: str | Path,
    visits: int = 300,
    rng: np.random.Generator | None = None,
    plan: str = "random",
    loads: int | Sequence[Load | None] = 8,
    visits_per_load: int = 30,
    interleave: bool = False,
    names: Sequence[str] | None = None,
    measurement_noise: bool = True,
) -> Path:
    """Visit poses under loads and write what the instruments say; returns out_csv.

    plan        "random" poses anywhere; "sweeps" of one joint after the other through a random pose; "mixed": passes of
                both in turn. Either way every joint is approached from both sides.
    loads       how many random ones to draw, or the load cases themselves (None: nothing on the sensor)
    interleave  False: blocks of visits_per_load visits per load, round and round; True: any load at any visit
    names       reflectors to measure; by default those of the machine file
    measurement_noise  False: tracker, force sensor and encoders without noise (the repeatability stays)
    """
    if plan not in PLANS:
        raise ValueError(f"no plan {plan!r}; there are {', '.join(PLANS)}")
    rng = np.random.default_rng(plant.seed) if rng is None else rng
    cases = plant.random_loads(loads, rng) if isinstance(loads, int) else list(loads)
    steps, commanded = _poses(plant, visits, plan, rng)
    block = np.arange(visits) // visits_per_load % len(cases)
    case = rng.integers(0, len(cases), visits) if interleave else block
    applied = [cases[c] for c in case]
    labels = [f"L{c}" for c in case]
    return write_visits(plant, out_csv, steps, labels, commanded, applied, rng, names, measurement_noise)


def write_visits(
    plant: Plant,
    out_csv: str | Path,
    steps: Sequence[str],
    labels: Sequence[str],
    commanded: Array,
    applied: Sequence[Load | None],
    rng: np.random.Generator,
    names: Sequence[str] | None = None,
    measurement_noise: bool = True,
) -> Path:
    """The recording of given visits: step and load labels, commanded joint values (N, n), what lies on the sensor."""
    visits = len(commanded)
    noise = 1.0 if measurement_noise else 0.0
    q = commanded + noise * ENCODER_SIGMA * rng.normal(size=commanded.shape)
    points = plant.true_points(q, applied, plant.draw_repeatability(visits, rng), names)
    measured = {k: p + noise * plant.position_sigma * rng.normal(size=p.shape) for k, p in points.items()}
    wrench = plant.wrench(q, applied) + noise * FORCE_SIGMA * rng.normal(size=(visits, 6))
    home = np.clip(0.0, plant.lower, plant.upper)
    approach = last_motion(np.diff(commanded, axis=0, prepend=home[None]))
    settle = rng.uniform(2.0, 12.0, visits)
    seconds = np.cumsum(rng.uniform(55.0, 95.0, visits))

    with Path(out_csv).open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(header(plant.joint_names, measured, temperatures(0.0)))
        for v in range(visits):
            when = (START + timedelta(seconds=float(seconds[v]))).isoformat(timespec="milliseconds")
            rows.writerow(
                [
                    when.replace("+00:00", "Z"),
                    steps[v],
                    labels[v],
                    *(f"{x:.8f}" for x in commanded[v]),
                    *(f"{x:.8f}" for x in q[v]),
                    *approach[v],
                    f"{settle[v]:.2f}",
                    *(f"{x:.4f}" for x in wrench[v]),
                    *(f"{x:.7f}" for xyz in measured.values() for x in xyz[v]),
                    *(f"{t:.3f}" for t in temperatures(float(seconds[v])).values()),
                ]
            )
    return Path(out_csv)


def _poses(plant: Plant, visits: int, plan: str, rng: np.random.Generator) -> tuple[list[str], Array]:
    """Labels and commanded joint values (visits, n), to the 8 decimals that the file holds."""
    steps: list[str] = []
    poses: list[Array] = []
    turns = _turns(plant, plan, rng)
    while len(poses) < visits:
        label, batch = next(turns)
        steps += [label] * len(batch)
        poses += list(batch)
    rounded = np.round(np.array(poses[:visits]), 8)
    inside = np.clip(rounded, np.ceil(plant.lower * 1e8) / 1e8, np.floor(plant.upper * 1e8) / 1e8)
    return steps[:visits], inside.astype(np.float64)


def _turns(plant: Plant, plan: str, rng: np.random.Generator) -> Iterator[tuple[str, Array]]:
    joint, n = 0, len(plant.joint_names)
    while True:
        if plan != "sweeps":
            yield "random", plant.random_poses(SWEEP_LENGTH, rng)
        if plan != "random":
            through = np.repeat(plant.random_poses(1, rng), SWEEP_LENGTH, axis=0)
            spaced = (np.arange(SWEEP_LENGTH) + rng.uniform(0.0, 1.0, SWEEP_LENGTH)) / SWEEP_LENGTH
            upward = plant.lower[joint] + (plant.upper[joint] - plant.lower[joint]) * spaced
            through[:, joint] = upward if rng.random() < 0.5 else upward[::-1]
            yield f"sweep:{plant.joint_names[joint]}", through
            joint = (joint + 1) % n
