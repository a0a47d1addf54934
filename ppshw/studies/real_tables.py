"""The study of real recordings on paper: its table beside the quick trials', and its picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ppshw.report.picture import FAINT, SERIES, STYLE

Array = NDArray[np.float64]
# What quick trials reached on the same data before this project began: 3-D RMS, cross-validated [mm], unless said.
TRIALS = {
    ("hilti flat", "nominal"): "9.01",
    ("hilti flat", "straight lines"): "1.98 (no arm compliance)",
    ("hilti flat", "joint"): "1.54; 1.38 with clearance",
    ("hilti flat", "joint + tilts"): "0.64",
    ("hilti pallet", "nominal"): "mean 8.45, p95 18.4 (six floors)",
    ("hilti pallet", "joint"): "mean 2.50, p95 7.07 (six floors)",
    ("hilti pallet", "joint + tilts, gravity follows the base"): "mean 1.90, p95 5.12 (six floors)",
    ("ur10 C", "nominal"): "0.99",
    ("ur10 C", "straight lines"): "0.491",
    ("ur10 C", "joint"): "0.112",
    ("ur10 B", "nominal"): "1.085",
    ("ur10 B", "straight lines"): "0.446",
    ("ur10 B", "joint"): "0.375",
    ("ur5 grid", "nominal"): "0.701 (fitted, not held out)",
    ("ur5 grid", "straight lines"): "0.113; 0.103 with gravity",
    ("ur5 grid", "joint"): "0.095",
    ("ur5 random", "straight lines"): "mean 0.100, max 0.158",
}


@dataclass(frozen=True)
class Row:
    """figures in mm, of readings held out; seconds of one fit, by the clock and of the processor (0: not timed)."""

    data: str
    model: str
    held_out: str
    figures: dict[str, float]
    seconds: float
    cpu_seconds: float

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class Check:
    """value [mm] against what is to be reached: at least, and better."""

    what: str
    least: float
    bar: float
    value: float

    def as_dict(self) -> dict[str, Any]:
        least = self.least if np.isfinite(self.least) else None
        return {"what": self.what, "least_mm": least, "bar_mm": self.bar, "value_mm": self.value,
                "reached": bool(self.value <= self.bar)}  # fmt: skip


def markdown(rows: Sequence[Row], checks: Sequence[Check], short: bool) -> str:
    lines = ["| recording | model | held out | readings | RMS | mean | p95 | max | CPU s per fit | quick trials |"]
    lines.append("|---|---|---|---|---|---|---|---|---|---|")
    said = set()
    for r in rows:
        f, key = r.figures, (r.data, r.model)
        trial = "" if key in said else TRIALS.get(key, "")
        said.add(key)
        sizes = " | ".join(f"{f[k]:.{_digits(f['rms_mm'])}f}" for k in ("rms_mm", "mean_mm", "p95_mm", "max_mm"))
        seconds = f"{r.cpu_seconds:.1f}" if r.cpu_seconds else ""
        lines.append(f"| {r.data} | {r.model} | {r.held_out} | {f['readings']:.0f} | {sizes} | {seconds} | {trial} |")
    lines += ["", "| to be reached, mm | least | bar | here | |", "|---|---|---|---|---|"]
    for c in checks:
        least = f"{c.least:g}" if np.isfinite(c.least) else ""
        verdict = "reached" if c.value <= c.bar else "least only" if c.value <= c.least else "missed"
        lines.append(f"| {c.what} | {least} | {c.bar:g} | {c.value:.3f} | {verdict} |")
    if short:
        lines += ["", "Short run: one fold of five."]
    return "\n".join(lines) + "\n"


def _digits(size: float) -> int:
    return 2 if size > 0.5 else 4 if size < 0.2 else 3


def draw(residuals: dict[tuple[str, str], Array], motions: Sequence[tuple[str, Array, Array]], out: Path) -> None:
    """Shares of held-out readings below a residual, per recording; and the UR10's joints about their own axes.

    residuals  (recording, model) → (N, T, 3) [m], nan where not held out
    motions    name, positions [rad], error [rad]
    """
    panels = [
        ("hilti flat", "Hilti flat, blocks of ten visits held out"),
        ("hilti pallet", "Hilti pallet, model from flat"),
        ("hilti orthogonal_wood", "Hilti orthogonal_wood, model from flat"),
        ("ur10 C", "UR10 series C, blocks of ten visits held out"),
        ("ur5 random", "UR5, 20 test poses"),
    ]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(13.5, 7.2))
        FigureCanvasSVG(figure)
        for k, (name, title) in enumerate(panels):
            models = {model: r for (data, model), r in residuals.items() if data == name}
            if models:
                _shares(figure.add_subplot(2, 3, k + 1), models, title)
        if motions:
            _motions(figure.add_subplot(2, 3, 6), motions)
        figure.savefig(out, metadata={"Date": None, "Creator": None} if out.suffix == ".svg" else None)


def _shares(ax: Axes, models: dict[str, Array], title: str) -> None:
    for colour, (model, errors) in zip(SERIES, models.items(), strict=False):
        size = np.linalg.norm(errors, axis=-1).ravel() * 1e3
        size = np.sort(size[np.isfinite(size)])
        ideal, label = model == "nominal", model.replace("gravity follows the base", "g turned")
        share = 100 * (np.arange(len(size)) + 0.5) / len(size)
        ax.plot(size, share, color=FAINT if ideal else colour, linestyle="--" if ideal else "-", label=label)
    ax.set(xscale="log", xlabel="residual [mm]", ylabel="share of readings below [%]", ylim=(0, 100))
    ax.set_title(title, fontsize=10)
    ax.legend(loc="upper left", fontsize=7.5)


def _motions(ax: Axes, motions: Sequence[tuple[str, Array, Array]]) -> None:
    for k, (name, position, error) in enumerate(motions):
        ax.plot(np.degrees(position - position.mean()), error * 1e6 - 1000 * k, color=SERIES[k], label=name)
    ax.set(xlabel="joint position from the middle of its travel [°]", ylabel="error about its own axis [µrad], shifted")
    ax.set_title("UR10 C: joints about their own axes, less a line", fontsize=10)
    ax.legend(loc="upper right")
