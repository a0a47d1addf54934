"""A quick look: residual at the treatment point on 110 unseen visits, against the number of visits identified from.

    python -m benchmarks.accuracy [--seeds 20] [--visits 669 202 100 67] [--short]

Random campaigns, joint estimate, the machines of `ppshw study accuracy-visits`, which does the same with every plan,
the paper's method, and the bound. "noise" is what repeatability and instrument leave of a perfect model.
"""

from __future__ import annotations

import argparse

import numpy as np

from ppshw.evaluation import figures
from ppshw.identification import identify
from ppshw.studies.simulated import POINT, machine_file, make_trial
from ppshw.studies.study import FIRST_SEED

__all__ = ["MACHINE", "POINT", "residual"]
MACHINE = machine_file()


def residual(seed: int, visits: int) -> tuple[float, float]:
    """98.6 % of the residual and of noise alone at the treatment point [mm]."""
    trial = make_trial(seed, "random", visits)
    missed = trial.missed(identify(trial.machine, trial.train))
    return figures(missed)["p98_6_mm"], figures(trial.measured - trial.perfect)["p98_6_mm"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--visits", type=int, nargs="+", default=[669, 202, 100, 67])
    parser.add_argument("--short", action="store_true", help="one seed, 67 visits")
    given = parser.parse_args()
    seeds, sizes = (1, [67]) if given.short else (given.seeds, given.visits)
    print(f"| visits | residual 98.6 %, median of {seeds} machines [mm] | least … most | noise alone |")
    print("|---|---|---|---|")
    for visits in sizes:
        found = np.array([residual(FIRST_SEED + k, visits) for k in range(seeds)])
        middle, noise = np.median(found, axis=0)
        low, high = found[:, 0].min(), found[:, 0].max()
        print(f"| {visits} | {middle:.3f} | {low:.3f} … {high:.3f} | {noise:.3f} |", flush=True)


if __name__ == "__main__":
    main()
