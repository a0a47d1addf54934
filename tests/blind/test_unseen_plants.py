"""Machines that nobody tuned anything on: identified from random poses, sweeps and mixed loads, judged on other visits.

What noise alone leaves is computed from the plant by itself: the same visits with and without the random part of every
arrival, plus the tracker's noise. No model can do better; ours may miss twice that at 98.6 % (issue A).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ppshw.calibration import Calibration
from ppshw.evaluation import evaluate
from ppshw.identification import identify
from ppshw.machine import load_machine
from ppshw.recording import load_recording
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant

Array = NDArray[np.float64]
ROOT = Path(__file__).parents[2]

# Neither is a machine of ours with other numbers alone: the order of the joints, the axes and the load path differ.
GANTRY = """\
name: gantry                       # the couch hangs from above; yaw before the long stroke; z is up
gravity: [0, 0, -9.80665]
joints:
  - {name: across, type: prismatic, origin: {xyz: [0, 0, 2.6]}, axis: [0, 1, 0], limits: {lower: -0.9, upper: 0.9},
     link: {mass: 480, com: [0, 0, -0.3]}, elastic: {loads: [Fz, Mx, My], varies: true}}
  - {name: yaw, type: revolute, origin: {xyz: [0, 0, -0.35], rpy: [0, 0, 0.1]}, axis: [0, 0, 1],
     limits: {lower: -1.4, upper: 1.4}, link: {mass: 160, com: [0.1, 0, -0.1]},
     elastic: {loads: [Mx, My], varies: false}}
  - {name: along, type: prismatic, origin: {xyz: [0.1, 0, -0.25]}, axis: [1, 0, 0], limits: {lower: -0.2, upper: 1.1},
     link: {mass: 210, com: [0, 0, -0.2]}, elastic: {loads: [Fz, Mx, My, Mz], varies: true}}
  - {name: lift, type: prismatic, origin: {xyz: [0, 0, -0.4]}, axis: [0, 0, 1], limits: {lower: -0.5, upper: 0.1},
     link: {mass: 90, com: [0, 0, -0.3]}, elastic: {loads: [Fx, Fy, Mx, My], varies: false}}
  - {name: pitch, type: revolute, origin: {xyz: [0, 0, -0.6]}, axis: [0, 1, 0], limits: {lower: -0.06, upper: 0.06},
     link: {mass: 30}, elastic: {loads: [My], varies: false}}
  - {name: roll, type: revolute, origin: {xyz: [0.05, 0, -0.08]}, axis: [1, 0, 0], limits: {lower: -0.06, upper: 0.06},
     link: {mass: 45, com: [0.4, 0, 0]}, elastic: {loads: [Fz, Mx, My], varies: false}}
tip:
  origin: {xyz: [0.3, 0, -0.05]}
  targets: {A: [0.9, 0.2, 0.02], B: [0.9, -0.2, 0.02], C: [0.1, 0.0, 0.05], D: [0.5, 0.22, 0.3]}
  points: {treatment: [0.8, 0, 0.15]}
force_sensor: {origin: {xyz: [0.25, 0, -0.04]}}
repeatability: {position: 1.0e-4}
tracker: {position_sigma: 3.0e-5}
"""
ARM = (ROOT / "machines/arm6.yaml").read_text(encoding="utf-8")
MACHINES = {
    "positioner": (ROOT / "machines/pps.yaml").read_text(encoding="utf-8"),
    "gantry": GANTRY,
    "arm": ARM,
    "arm with a tracker nobody placed": ARM.replace("tracker:\n", "tracker:\n  base: estimate\n  targets: estimate\n"),
}


def noise_alone_mm(plant: Plant, visits: int, rng: np.random.Generator) -> float:
    """98.6 % of what a perfect model would miss: the arrival's random part as it moves the targets, and the tracker."""
    q, loads = plant.random_poses(visits, rng), plant.random_loads(visits, rng)
    scattered = plant.true_points(q, loads, plant.draw_repeatability(visits, rng))
    ideal = plant.true_points(q, loads)
    off = np.stack([scattered[t] - ideal[t] for t in ideal])
    off += plant.position_sigma * rng.normal(size=off.shape)
    return float(np.quantile(np.linalg.norm(off, axis=-1), 0.986)) * 1e3


@pytest.mark.parametrize("seed", [101, 202])
@pytest.mark.parametrize("name", MACHINES)
def test_an_unseen_machine_is_known_to_twice_its_own_noise(name: str, seed: int, tmp_path: Path) -> None:
    (tmp_path / "machine.yaml").write_text(MACHINES[name], encoding="utf-8")
    machine, plant = load_machine(tmp_path / "machine.yaml"), Plant.from_file(tmp_path / "machine.yaml", seed)
    rng = np.random.default_rng(seed)
    loads = plant.random_loads(12, rng)  # the same trolley of weights for both recordings
    train = simulate_recording_csv(plant, tmp_path / "train.csv", 300, rng, "mixed", loads, visits_per_load=10)
    test = simulate_recording_csv(plant, tmp_path / "test.csv", 150, rng, "random", loads, interleave=True)
    recording = load_recording(train, machine)
    calibration = Calibration.of(identify(machine, recording), recording, "joint")
    found = evaluate(load_recording(test, machine), machine, calibration)
    noise = noise_alone_mm(plant, 2000, rng)
    assert 0.08 < noise < 0.3
    assert found["nominal"]["p98_6_mm"] > 8 * noise
    assert found["p98_6_mm"] < 2 * noise
