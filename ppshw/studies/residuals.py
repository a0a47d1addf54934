"""Study: how residuals are distributed over many machines, before and after compensation (figures 11 and 14)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ppshw.studies import tasks
from ppshw.studies.engine import Job, Outcome
from ppshw.studies.simulated import PAPER_VISITS
from ppshw.studies.study import Json, Rows, Study, nothing
from ppshw.verification import QUANTILE

Array = NDArray[np.float64]
METHODS = ["paper", "joint"]
NAMES = {"nominal": "not compensated", "paper": "paper's method", "joint": "joint estimate"}
SPECIFICATION_MM = 0.5


def jobs(seeds: Sequence[int], short: bool, prepared: Json) -> list[Job]:
    visits = 139 if short else PAPER_VISITS
    return [Job(f"{s}", {"seed": s, "plan": "paper", "visits": visits, "methods": METHODS}) for s in seeds]


def summarise(outcome: Outcome) -> tuple[Rows, Json]:
    rows: Rows = []
    for what, name in NAMES.items():
        lengths = _lengths(outcome, what)
        of_machine = np.quantile(lengths, QUANTILE, axis=1)
        rows.append({
            "estimate": name, "mean": float(lengths.mean()), "rms": float(np.sqrt((lengths**2).mean())),
            "median": float(np.median(lengths)), "95 %": float(np.quantile(lengths, 0.95)),
            "98.6 %": float(np.quantile(lengths, QUANTILE)), "max": float(lengths.max()),
            "machine by machine, 98.6 %: median": float(np.median(of_machine)),
            "least": float(of_machine.min()), "most": float(of_machine.max()),
            "within 0.5 mm": f"{100 * float((lengths <= SPECIFICATION_MM).mean()):.2f} %",
            "machines": len(lengths),
        })  # fmt: skip
    return rows, {"visits_per_machine": int(_lengths(outcome, "nominal").shape[1])}


def _lengths(outcome: Outcome, what: str) -> Array:
    """(machines, visits) [mm]"""
    return np.array([result[what] for result in outcome.results.values()]) / 1e3


def draw(outcome: Outcome, rows: Rows, path: Path) -> None:
    """Left as figures 11 and 14: how often which residual; right: each machine's 98.6 %."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    edges = np.arange(0.0, 0.81, 0.02)
    of_machine = np.arange(0.0, 0.81, 0.02)
    for what, colour in (("paper", "tab:red"), ("joint", "tab:blue")):
        lengths = _lengths(outcome, what)
        share = np.full(lengths.size, 100 / lengths.size)
        left.hist(lengths.ravel(), edges, weights=share, color=colour, alpha=0.5, label=NAMES[what])
        left.axvline(float(np.quantile(lengths, QUANTILE)), color=colour, ls="--", lw=1)
        right.hist(np.quantile(lengths, QUANTILE, axis=1), of_machine, color=colour, alpha=0.5, label=NAMES[what])
    for axes in (left, right):
        axes.axvline(SPECIFICATION_MM, color="gray", lw=0.8)
        axes.legend(fontsize=8)
    right.axvline(0.41, color="tab:red", ls=":", lw=1)
    right.axvline(0.45, color="tab:red", ls=":", lw=1)
    left.set(xlabel="residual at the treatment point [mm] (dashed: 98.6 %)", ylabel="share of visits [%]")
    right.set(xlabel="98.6 % of one machine [mm] (dotted: the paper's two)", ylabel="machines")
    figure.savefig(path, dpi=110)


STUDY = Study(
    "residuals", "distribution of the residuals over many machines, from the paper's campaign (figures 11 and 14)",
    100, tasks.residuals, nothing, jobs, summarise, draw,
    "Length of measured minus predicted at the treatment point on 110 unseen visits per machine, all of them together "
    "[mm]; repeatability and tracker's noise are in it.",
)  # fmt: skip
