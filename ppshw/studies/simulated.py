"""Simulated positioners for the studies, one per seed, and what is recorded of them.

The one module of the studies that knows simulators and campaigns. Everything is drawn from the seed: the machine as in
`simulators.truth`, the campaign's random poses, and the 110 unseen visits under 22 loads with a reflector at the
treatment point that every figure is measured on (section 4.2 of the paper, and its verification campaign here).
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from campaigns.design.ask import Question, answer
from campaigns.plan import plan_campaign
from campaigns.script import LoadCase, PosesStep, Script, SweepStep, load_script
from ppshw.errors import BadInput
from ppshw.identification.joint import Estimate
from ppshw.identification.start import to_base
from ppshw.machine import Machine, load_machine, shipped_machines
from ppshw.recording import Recording, load_recording
from ppshw.studies.bound import Ensemble, Functions, positions
from ppshw.terms import Situation
from ppshw.verification import measured_point
from simulators.offline import simulate_recording_csv, write_visits
from simulators.plant import Load, Plant

Array = NDArray[np.float64]
POINT = "treatment"
TEST_VISITS, TEST_LOADS = 110, 22
RANDOM_LOADS = 10
PAPER_VISITS = 669
# With fewer visits than the paper's 202 the nine repeats of the initial configurations would take all of them.
REPEATS_FROM, REPEATS = 200, 9
ENSEMBLE_SEED = 1_000_000
PLANS = ("paper", "random", "designed")


@dataclass(frozen=True)
class Trial:
    """One machine, recorded twice.

    train     what the model is identified from
    test      unseen visits
    measured  (V, 3) the treatment point on them as measured, base frame                                [m]
    perfect   (V, 3) what the perfect model says of the same visits: measured less repeatability and tracker noise
    nominal   (V, 3) what the ideal machine says
    scatter   (n, 6) one standard deviation of every link's random part at an arrival                [m, rad]
    """

    machine: Machine
    train: Recording
    test: Recording
    measured: Array
    perfect: Array
    nominal: Array
    scatter: Array

    def missed(self, found: Estimate) -> Array:
        """Measured minus predicted at the treatment point: (V, 3) [m]."""
        return np.asarray(self.measured - self.predicted(found))

    def predicted(self, found: Estimate) -> Array:
        where = self.machine.point(POINT)[None]
        return found.model.predict(Situation.of(self.test), found.theta, where)[:, 0]


def machine_file() -> Path:
    return shipped_machines() / "pps.yaml"


def make_trial(
    seed: int, plan: str, visits: int, repeatability: float | None = None, campaign: str | None = None
) -> Trial:
    """Machine number `seed`; repeatability [m] instead of the machine file's.

    plan      "paper": its campaign, with fewer positions where fewer visits are asked for; "random": poses anywhere
              under ten loads; "designed": `campaign`
    campaign  the text of a campaign script, as `designed_campaign` gives it
    """
    machine = load_machine(machine_file())
    plant = Plant.from_file(machine_file(), seed, repeatability)
    rng = np.random.default_rng([seed, 21])
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "train.csv"
        if plan == "random":
            per_load = -(-visits // RANDOM_LOADS)
            simulate_recording_csv(plant, file, visits, rng, loads=RANDOM_LOADS, visits_per_load=per_load)
        else:
            _visit(plant, _script(plan, visits, campaign, Path(folder)), machine, file, rng)
        train = load_recording(file, machine)
        file = Path(folder) / "test.csv"
        names = [*plant.targets, POINT]
        rng = np.random.default_rng([seed, 22])
        simulate_recording_csv(plant, file, TEST_VISITS, rng, loads=TEST_LOADS, interleave=True, names=names)
        test = load_recording(file, machine)
    frame = plant.measuring_in_base
    measured, perfect, nominal = (
        to_base(points, frame)
        for points in (
            measured_point(test, machine, POINT),
            plant.true_points(test.q, test.wrench, names=[POINT])[POINT],
            plant.nominal_points(test.q, names=[POINT])[POINT],
        )
    )
    return Trial(machine, train, test, measured, perfect, nominal, plant.truth.scatter)


def _visit(plant: Plant, script: Script, machine: Machine, file: Path, rng: np.random.Generator) -> None:
    """The visits of a campaign script in their order, offline."""
    found = plan_campaign(script, machine)
    loads = {name: _on_the_sensor(plant, case) for name, case in found.loads.items()}
    write_visits(
        plant, file,
        [v.step for v in found.visits], [v.load for v in found.visits],
        np.round([v.setpoints for v in found.visits], 8), [loads[v.load] for v in found.visits], rng,
    )  # fmt: skip


def _on_the_sensor(plant: Plant, case: LoadCase) -> Load | None:
    """A script says where a load lies on the end effector, the plant wants to know it in the sensor's frame."""
    if case.mass == 0:
        return None
    at = np.linalg.inv(plant.chain.sensor) @ plant.chain.tip @ np.append(case.com, 1.0)
    return Load(case.mass, at[:3])


def _script(plan: str, visits: int, campaign: str | None, folder: Path) -> Script:
    if plan == "paper":
        return paper_campaign(visits)
    if plan != "designed" or campaign is None:
        raise BadInput(f"plan '{plan}': expected paper, random, or designed with its campaign")
    file = folder / "campaign.yaml"
    file.write_text(campaign, encoding="utf-8")
    return load_script(file)


def designed_campaign(visits: int) -> str:
    """What `ppshw plan --visits` designs for the machine file before anything was measured; a minute and more."""
    question = Question(
        load_machine(machine_file()), visits, None, None, None, None, None, None, 1, "designed", "a study"
    )
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "campaign.yaml"
        answer(question, out)
        return out.read_text(encoding="utf-8")


@cache
def paper_campaign(visits: int) -> Script:
    """The paper's campaign with at most so many visits: fewer positions of each joint, in the proportions of its own.

    The initial configurations keep their nine repeats down to the paper's own reduced campaign (63 + 139), below that
    repeats are given up too. Raises BadInput where two positions per joint are already too many.
    """
    script = load_script("paper")
    if visits >= PAPER_VISITS:
        return script
    repeat = REPEATS if visits >= REPEATS_FROM else max(1, visits // 33)
    sweeps = [step for step in script.steps if isinstance(step, SweepStep)]
    cost = [len(step.loads) for step in sweeps]
    count = [2] * len(sweeps)
    initial = sum(len(s.loads) * len(s.poses) for s in script.steps if isinstance(s, PosesStep))
    left = visits - repeat * initial - 2 * sum(cost)
    if left < 0:
        raise BadInput(f"{visits} visits: too few for the paper's plan, expected at least {visits - left}")
    while fits := [k for k, c in enumerate(cost) if c <= left]:
        k = min(fits, key=lambda k: count[k] / sweeps[k].count)
        count[k] += 1
        left -= cost[k]
    counts = dict(zip((s.name for s in sweeps), count, strict=True))
    steps = [
        replace(s, count=counts[s.name]) if isinstance(s, SweepStep) else replace(s, repeat=repeat)
        for s in script.steps
    ]
    return replace(script, steps=tuple(steps))


@cache
def ensemble(count: int) -> Ensemble:
    """What positioners of this kind are like, from the true error functions of `count` of them.

    Their seeds are far from those that any study measures. Takes 0.07 s each, once per process.
    """
    machine = load_machine(machine_file())
    grid = positions(machine)
    return Ensemble.of(machine, [_functions(seed, grid) for seed in range(ENSEMBLE_SEED, ENSEMBLE_SEED + count)])


def _functions(seed: int, grid: list[Array]) -> Functions:
    truth = Plant.from_file(machine_file(), seed).truth
    return Functions(
        [shape.at(q) for shape, q in zip(truth.shapes, grid, strict=True)],
        [None if s is None else s.compliance(q) for s, q in zip(truth.springs, grid, strict=True)],
    )
