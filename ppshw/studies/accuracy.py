"""Studies: accuracy against repeatability (fig. 12) and against the number of measurements (fig. 15)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ppshw.errors import PpshwError
from ppshw.studies import tasks
from ppshw.studies.engine import Cluster, Job, Outcome, run_jobs
from ppshw.studies.simulated import PAPER_VISITS, PLANS
from ppshw.studies.study import Json, Rows, Study, nothing

REPEATABILITIES_MM = (0.0, 0.05, 0.10, 0.15, 0.20, 0.25, 0.30)
VISITS = (669, 400, 202, 139, 100, 67)
DESIGNED = (202, 139, 100, 67)
# How many machines the bound's prior is estimated from: with 200 the bound stands to 0.3 % (docs/studies.md).
MACHINES, FEW_MACHINES = 200, 12
METHODS = {"paper": ["paper", "joint"], "random": ["joint"], "designed": ["joint"]}
NAMES = {"paper": "paper's method", "joint": "joint estimate", "bound": "bound"}
REMARK = (
    "98.6 % of the residual at the treatment point on 110 unseen visits, measured minus predicted, medians over the "
    "machines [mm]. `noise`: a perfect model on the same visits. `bound`: the Bayesian Cramér-Rao bound of the same "
    "visits (docs/derivations.md §8). `× bound`: ratio of the medians; `model × bound`: of the rms without "
    "repeatability and tracker."
)


# --- against repeatability ---------------------------------------------------------------------------------------
def repeatability_jobs(seeds: Sequence[int], short: bool, prepared: Json) -> list[Job]:
    visits = 139 if short else PAPER_VISITS
    return [
        Job(f"{value:.2f}mm-{seed}", {
            "seed": seed, "plan": "paper", "visits": visits, "methods": METHODS["paper"],
            "machines": FEW_MACHINES if short else MACHINES, "repeatability_mm": value,
        })
        for seed in seeds
        for value in ((0.05, 0.15) if short else REPEATABILITIES_MM)
    ]  # fmt: skip


def repeatability_rows(outcome: Outcome) -> tuple[Rows, Json]:
    groups: dict[str, list[Json]] = {}
    for key, result in outcome.results.items():
        groups.setdefault(key.split("mm-")[0], []).append(result)
    rows: Rows = []
    for value in sorted(groups, key=float):
        rows += _rows(groups[value], {"repeatability": float(value)})
    return rows, {}


# --- against visits ------------------------------------------------------------------------------------------------
def designs(out: Path, short: bool, cluster: Cluster) -> Json:
    """By number of visits: the campaign. One design takes minutes, so that the short study goes without."""
    jobs = [] if short else [Job(f"{visits}", {"visits": visits}) for visits in DESIGNED]
    found = run_jobs(tasks.design, jobs, out / "designs.jsonl", cluster)
    for visits, trouble in found.lost.items():
        raise PpshwError(f"no campaign of {visits} visits could be designed: {trouble}")
    return {visits: result["campaign"] for visits, result in found.results.items()}


def visits_jobs(seeds: Sequence[int], short: bool, campaigns: Json) -> list[Job]:
    out: list[Job] = []
    for seed in seeds:
        for visits in (100, 67) if short else VISITS:
            for plan in PLANS:
                more = {"campaign": campaigns.get(f"{visits}")} if plan == "designed" else {}
                if plan != "designed" or f"{visits}" in campaigns:
                    out.append(Job(f"{plan}-{visits}-{seed}", {
                        "seed": seed, "plan": plan, "visits": visits, "methods": METHODS[plan],
                        "machines": FEW_MACHINES if short else MACHINES, **more,
                    }))  # fmt: skip
    return out


def visits_rows(outcome: Outcome) -> tuple[Rows, Json]:
    groups: dict[tuple[str, int], list[Json]] = {}
    for key, result in outcome.results.items():
        plan, asked, _ = key.split("-")
        groups.setdefault((plan, int(asked)), []).append(result)
    rows: Rows = []
    for plan, visits in sorted(groups, key=lambda k: (PLANS.index(k[0]), -k[1])):
        rows += _rows(groups[plan, visits], {"plan": plan, "visits": groups[plan, visits][0]["visits"]})
    return rows, {}


# --- both ----------------------------------------------------------------------------------------------------------
def _rows(results: list[Json], of: dict[str, Any]) -> Rows:
    """One row per method, and the bound's own."""
    bound, least = _p98_6(results, "bound"), _model_rms(results, "bound")
    rows: Rows = []
    for method in [m for m in NAMES if m in results[0]]:
        every = np.array([one[method]["p98_6_mm"] for one in results])
        rows.append({
            **of, "estimate": NAMES[method], "98.6 %": float(np.median(every)),
            "least": float(every.min()), "most": float(every.max()),
            "rms": float(np.median([one[method]["rms_mm"] for one in results])),
            "× bound": None if method == "bound" else float(np.median(every)) / bound,
            "model rms": _model_rms(results, method),
            "model × bound": None if method == "bound" or not least else _model_rms(results, method) / least,
            "noise": _p98_6(results, "noise"), "machines": len(results),
        })  # fmt: skip
    return rows


def _p98_6(results: list[Json], what: str) -> float:
    return float(np.median([one[what]["p98_6_mm"] for one in results]))


def _model_rms(results: list[Json], what: str) -> float:
    return float(np.sqrt(np.mean([one[what]["model_rms_mm"] ** 2 for one in results])))


def draw_repeatability(outcome: Outcome, rows: Rows, path: Path) -> None:
    _draw(rows, path, "repeatability", "repeatability [mm]", lambda row: row["estimate"], [(0.15, 0.41), (0.14, 0.45)])


def draw_visits(outcome: Outcome, rows: Rows, path: Path) -> None:
    paper = [(float(PAPER_VISITS), 0.45), (202.0, 0.5)]
    _draw(rows, path, "visits", "visits", lambda row: f"{row['plan']} plan, {row['estimate']}", paper)


COLOURS = {"paper": "tab:red", "random": "tab:blue", "designed": "tab:green"}
BY_METHOD = {"paper's method": "tab:red", "joint estimate": "tab:blue", "bound": "black"}
STYLES = {"paper's method": ":", "joint estimate": "-", "bound": "--"}


def _draw(rows: Rows, path: Path, x: str, label: str, name: Any, paper: list[tuple[float, float]]) -> None:
    """Medians over the machines with the span from the least to the most; the paper's figures as crosses."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 4.6), layout="constrained")
    axes = figure.subplots()
    groups: dict[str, Rows] = {}
    for row in rows:
        groups.setdefault(name(row), []).append(row)
    for title, group in groups.items():
        colour = COLOURS[group[0]["plan"]] if "plan" in group[0] else BY_METHOD[group[0]["estimate"]]
        at = [row[x] for row in group]
        axes.plot(at, [row["98.6 %"] for row in group], STYLES[group[0]["estimate"]], color=colour, label=title)
        if group[0]["estimate"] == "joint estimate":
            axes.fill_between(at, [r["least"] for r in group], [r["most"] for r in group], color=colour, alpha=0.12)
    axes.plot(*zip(*paper, strict=True), "x", color="tab:red", label="the paper")
    axes.axhline(0.5, color="gray", lw=0.8)
    axes.text(0.99, 0.5, "specification", transform=axes.get_yaxis_transform(), ha="right", va="bottom", fontsize=8)
    if x == "visits":
        axes.set_xscale("log")
        ticks = sorted({row[x] for row in rows if row.get("plan") == "random"} | {int(visits) for visits, _ in paper})
        axes.set_xticks(ticks, [str(t) for t in ticks])
        axes.minorticks_off()
    axes.set(xlabel=label, ylabel="98.6 % of the residual at the treatment point [mm]")
    top = max(0.8, 1.1 * max(row["98.6 %"] for row in rows if row["estimate"] == "joint estimate"))
    axes.set_ylim(0.0, top)
    for row in (row for row in rows if row["98.6 %"] > top):
        colour = COLOURS[row["plan"]] if "plan" in row else BY_METHOD[row["estimate"]]
        axes.annotate(f"{row['98.6 %']:.1f} ↑", (row[x], top), (0, -10), textcoords="offset points", ha="center",
                      fontsize=8, color=colour)  # fmt: skip
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=110)


AGAINST_REPEATABILITY = Study(
    "accuracy-repeatability", "accuracy against the machine's repeatability, from the paper's campaign (figure 12)",
    20, tasks.accuracy, nothing, repeatability_jobs, repeatability_rows, draw_repeatability, REMARK,
)  # fmt: skip
AGAINST_VISITS = Study(
    "accuracy-visits", "accuracy against the number of visits, by plan and method (figure 15)",
    20, tasks.accuracy, designs, visits_jobs, visits_rows, draw_visits, REMARK,
)  # fmt: skip
