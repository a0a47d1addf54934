"""Study: which way errors point and where in the volume they are, before compensation and after it (figure 10)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.studies import tasks
from ppshw.studies.engine import Job, Outcome
from ppshw.studies.simulated import PAPER_VISITS
from ppshw.studies.study import Json, Rows, Study, nothing
from ppshw.verification import QUANTILE

Array = NDArray[np.float64]
WHATS = {"nominal": "not compensated", "residual": "residual", "model": "of it the model's"}
AXES = ("x (lateral)", "y (vertical)", "z (longitudinal)")
CELL_MM = 500.0


def jobs(seeds: Sequence[int], short: bool, prepared: Json) -> list[Job]:
    visits = 139 if short else PAPER_VISITS
    return [Job(f"{s}", {"seed": s, "plan": "paper", "visits": visits, "method": "joint"}) for s in seeds]


def summarise(outcome: Outcome) -> tuple[Rows, Json]:
    """Components, principal directions, and thirds of the volume along each axis."""
    at = _all(outcome, "at", 1.0)
    rows: Rows = []
    more: Json = {"principal": {}}
    for what, name in WHATS.items():
        vectors = _all(outcome, what, 1e-3)
        for k, axis in enumerate(AXES):
            rows.append(_row(name, axis, vectors[:, k : k + 1], float(vectors[:, k].mean())))
        rows.append(_row(name, "length", vectors, None))
        spread, directions = np.linalg.eigh(np.cov(vectors.T))
        more["principal"][what] = [
            {"sigma_mm": float(np.sqrt(spread[k])), "direction": directions[:, k].tolist()} for k in (2, 1, 0)
        ]
    for k, axis in enumerate(AXES):
        edges = np.quantile(at[:, k], [0.0, 1 / 3, 2 / 3, 1.0])
        third = np.digitize(at[:, k], edges[1:-1])  # an edge belongs to the third above it
        for j, (low, high) in enumerate(itertools.pairwise(edges)):
            for what in ("residual", "model"):
                where = f"length, {axis[0]} {low / 1e3:.2f} … {high / 1e3:.2f} m"
                rows.append(_row(WHATS[what], where, _all(outcome, what, 1e-3)[third == j], None))
    return rows, more


def _row(name: str, what: str, vectors: Array, mean: float | None) -> dict[str, Any]:
    size = np.linalg.norm(vectors, axis=1)
    return {
        "error": name, "component": what, "mean": mean, "rms": float(np.sqrt((size**2).mean())),
        "98.6 %": float(np.quantile(size, QUANTILE)), "max": float(size.max()), "visits": len(size),
    }  # fmt: skip


def _all(outcome: Outcome, what: str, scale: float) -> Array:
    """(machines · visits, 3)"""
    return np.concatenate([np.array(result[what]) for result in outcome.results.values()]) * scale


def draw(outcome: Outcome, rows: Rows, path: Path) -> None:
    """The first machine's errors as in figure 10; over all machines where the model's error is, and components."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    figure = Figure(figsize=(13.5, 4.4), layout="constrained")
    front, volume, parts = figure.subplots(1, 3)
    first = next(iter(outcome.results.values()))
    for what, mark, colour in (("nominal", "o", "tab:gray"), ("residual", "x", "tab:blue")):
        x, y, _ = np.array(first[what]).T / 1e3
        front.plot(x, y, mark, color=colour, mfc="none", ms=4, label=WHATS[what])
    front.add_patch(Circle((0.0, 0.0), 0.5, fill=False, color="black", lw=0.8, label="0.5 mm"))
    front.set(xlabel="error in x [mm]", ylabel="error in y [mm]", title="one machine, from the front", aspect="equal")
    front.set_xlim(-4.5, 4.5)
    front.legend(fontsize=8, loc="lower left")
    _map(volume, _all(outcome, "at", 1e-3), np.linalg.norm(_all(outcome, "model", 1e-3), axis=1), figure)
    edges = np.arange(-0.3, 0.301, 0.01)
    for k, axis in enumerate(AXES):
        values = _all(outcome, "residual", 1e-3)[:, k]
        parts.hist(values, edges, histtype="step", weights=np.full(len(values), 100 / len(values)), label=axis)
    parts.set(xlabel="residual [mm]", ylabel="share of visits [%]", title="components, all machines")
    parts.legend(fontsize=8)
    figure.savefig(path, dpi=100)


def _map(axes: Any, at: Array, size: Array, figure: Any) -> None:
    """Rms of the model's error in cells of half a metre, seen from above."""
    cells = [np.arange(np.floor(v.min() * 2) / 2, v.max() + 0.5, CELL_MM / 1e3) for v in (at[:, 0], at[:, 2])]
    count, x, z = np.histogram2d(at[:, 0], at[:, 2], cells)
    square, _, _ = np.histogram2d(at[:, 0], at[:, 2], cells, weights=size**2)
    rms = np.sqrt(np.divide(square, count, out=np.full_like(square, np.nan), where=count > 0))
    image = axes.pcolormesh(x, z, rms.T, cmap="viridis", vmin=0.0)
    figure.colorbar(image, ax=axes, label="mm rms", shrink=0.6)
    axes.set(xlabel="x [m]", ylabel="z [m]", title="the model's error, all machines, from above", aspect="equal")


STUDY = Study(
    "directions", "errors and their directions over the volume, from the paper's campaign, joint estimate (figure 10)",
    20, tasks.directions, nothing, jobs, summarise, draw,
    "At the treatment point on 110 unseen visits per machine, base frame [mm]. `of it the model's`: what is left "
    "without repeatability and tracker's noise. Thirds of the volume hold equally many visits.",
)  # fmt: skip
