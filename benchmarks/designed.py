"""Designed campaigns beside the paper's: residual on unseen visits, time, travel against its lower bound.

    python -m benchmarks.designed [--seeds 20] [--visits 669 202 100 67] [--without-paper] [--short]

One design per number of visits (`ppshw plan --visits N`, nothing known of the machine), simulated on the machines of
`ppshw study accuracy-visits`, one per seed, and identified by the joint estimate. "noise" is what repeatability and
instrument leave of a perfect model, "× bound" the ratio to the Bayesian Cramér-Rao bound of the same visits
(docs/derivations.md §8); hours are what `ppshw plan` says; the design's own seconds are processor time.
"""

from __future__ import annotations

import ppshw.process  # noqa: F401  # isort: skip  before numpy comes in with the rest

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from campaigns.design.ask import Question, answer
from campaigns.plan import Summary, plan_campaign
from campaigns.script import load_script
from ppshw.evaluation import figures
from ppshw.identification import identify
from ppshw.machine import Machine, load_machine
from ppshw.studies.accuracy import FEW_MACHINES, MACHINES
from ppshw.studies.bound import bound
from ppshw.studies.simulated import POINT, ensemble, machine_file, make_trial
from ppshw.studies.study import FIRST_SEED

Array = NDArray[np.float64]
HEAD = ("campaign", "residual 98.6 % [mm]", "× bound", "least … most", "noise alone", "predicted", "load changes",
        "hours", "travel [s]", "bound [s]", "above", "designed in [s]")  # fmt: skip


def design(machine: Machine, visits: int, out: Path) -> tuple[Summary, dict[str, Any]]:
    """The campaign of `ppshw plan --visits N` with its default seed, and what is said of it."""
    began = time.process_time()
    question = Question(machine, visits, None, None, None, None, None, None, 1, f"designed-{visits}", "the benchmark")
    found = answer(question, out)
    assert found.plan is not None
    return found.plan.summary(), found.numbers | {"seconds": time.process_time() - began}


def residuals(plan: str, visits: int, seeds: int, campaign: str | None, machines: int) -> Array:
    """98.6 % at the treatment point of residual, bound and noise alone, per machine: (seeds, 3) [mm]."""
    out = []
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        trial = make_trial(seed, plan, visits, campaign=campaign)
        noise = trial.measured - trial.perfect
        least = bound(ensemble(machines), trial.train, trial.test, trial.machine.point(POINT), trial.scatter)
        missed = trial.missed(identify(trial.machine, trial.train))
        out.append([figures(missed)["p98_6_mm"], least.figures(noise, seed)["p98_6_mm"], figures(noise)["p98_6_mm"]])
    return np.array(out)


def row(name: str, summary: Summary, found: Array, said: dict[str, Any] | None) -> str:
    missed, least, noise = np.median(found, axis=0)
    cells = [name, f"{missed:.3f}", f"{missed / least:.2f}"]
    cells += [f"{found[:, 0].min():.3f} … {found[:, 0].max():.3f}", f"{noise:.3f}"]
    cells += [f"{said['predicted']['with_noise_p98_6_mm']:.3f}" if said else "–", f"{summary.load_changes}"]
    cells += [f"{summary.duration_s / 3600:.2f}"]
    if said is None:
        return "| " + " | ".join([*cells, *["–"] * 4]) + " |"
    travel, shortest = said["travel_s"], said["travel_bound_s"]
    cells += [f"{travel:.0f}", f"{shortest:.0f}", f"{100 * (travel / shortest - 1):.1f} %", f"{said['seconds']:.0f}"]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--visits", type=int, nargs="+", default=[669, 202, 100, 67])
    parser.add_argument("--short", action="store_true", help="one machine, 12 visits, without the paper's campaign")
    parser.add_argument("--without-paper", action="store_true", help="designed campaigns alone")
    given = parser.parse_args()
    seeds, sizes = (1, [12]) if given.short else (given.seeds, given.visits)
    machines = FEW_MACHINES if given.short else MACHINES
    machine = load_machine(machine_file())
    print(f"Median of {seeds} machines (seeds from {FIRST_SEED}).\n")
    print("| " + " | ".join(HEAD) + " |\n" + "|---" * len(HEAD) + "|", flush=True)
    if not given.short and not given.without_paper:
        summary = plan_campaign(load_script("paper"), machine).summary()
        print(row("paper, 669", summary, residuals("paper", 669, seeds, None, machines), None), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for visits in sizes:
            script = Path(folder) / "campaign.yaml"
            planned, said = design(machine, visits, script)
            found = residuals("designed", visits, seeds, script.read_text(encoding="utf-8"), machines)
            print(row(f"designed, {visits}", planned, found, said), flush=True)


if __name__ == "__main__":
    main()
