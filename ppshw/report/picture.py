"""One way to draw: sober, vector, self-contained, with a title and a text for who cannot see it.

Matplotlib's object interface alone is used: no pyplot, no display, no state left behind. A picture is an SVG in a data
address, so that its ids cannot clash with another's; letters are outlines, so that it looks the same everywhere.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

# Blue and orange of Okabe & Ito's palette, darkened for white paper: told apart in every kind of colour vision.
BEFORE, AFTER, MARK, INK, FAINT = "#b8560a", "#0a5a94", "#a3123f", "#222222", "#8a8a8a"
SERIES = ("#0a5a94", "#b8560a", "#00805f", "#8b4789", "#5f5f5f", "#b08900", "#3d8fc2")
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.edgecolor": "#666666",
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.formatter.limits": (-3, 5),
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.6,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.4,
    "figure.constrained_layout.use": True,
    "svg.fonttype": "path",
    "svg.hashsalt": "ppshw",
}
RASTER_DPI = 180  # of clouds with too many marks to be vectors


@dataclass(frozen=True)
class Picture:
    """title says what it shows; alt says it in words and numbers; note stands below; src is a data address."""

    title: str
    alt: str
    note: str
    src: str


class Canvas:
    """An open figure; `picture` closes it into a Picture."""

    def __init__(self, figure: Figure, axes: Axes) -> None:
        self.figure, self.axes = figure, axes

    def picture(self, title: str, alt: str, note: str = "") -> Picture:
        """What was drawn, as an SVG for the page; title and note stand beside it, alt says in words what it shows."""
        out = io.BytesIO()
        if (layout := self.figure.get_layout_engine()) is not None:  # else savefig draws all of it twice
            layout.execute(self.figure)
            with mpl.rc_context({"figure.constrained_layout.use": False}):
                self.figure.set_layout_engine(None)
        self.figure.savefig(out, format="svg", dpi=RASTER_DPI, metadata={"Date": None, "Creator": None})
        return Picture(title, alt, note, "data:image/svg+xml;base64," + base64.b64encode(out.getvalue()).decode())


@contextmanager
def canvas(width: float = 4.7, height: float = 3.4) -> Iterator[Canvas]:
    """One set of axes, width × height inches; half of the page's width on a screen, all of it on a phone."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height))
        FigureCanvasSVG(figure)
        yield Canvas(figure, figure.add_subplot())
