"""The README's picture, from what `make demo` left: python docs/img/demo_picture.py demo-out docs/img/demo.png"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from ppshw.machine import load_machine
from ppshw.recording import load_recording
from ppshw.report.picture import AFTER, BEFORE, INK, STYLE
from ppshw.verification import QUANTILE, point_errors


def main(folder: Path, out: Path) -> None:
    machine = load_machine(folder / "machine.yaml")
    errors = {}
    for case in ("nominal", "compensated"):
        recording = load_recording(folder / f"verification_{case}.db", machine)
        errors[case] = 1e3 * point_errors(recording, machine, "treatment")
    size = {case: np.sort(np.linalg.norm(e[np.isfinite(e).all(axis=1)], axis=1)) for case, e in errors.items()}
    looks = {"nominal": (BEFORE, "o", "not compensated"), "compensated": (AFTER, "x", "compensated")}
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.2, 3.7), dpi=110)
        FigureCanvasAgg(figure)
        plane, close, share = figure.subplots(1, 3)
        for case, (colour, mark, label) in looks.items():
            plane.plot(errors[case][:, 2], errors[case][:, 1], mark, ms=3.5, mfc="none", color=colour, label=label)
            mark_at = float(np.quantile(size[case], QUANTILE))
            steps = 100 * np.arange(1, len(size[case]) + 1) / len(size[case])
            share.step(size[case], steps, where="post", color=colour, label=f"98.6 % below {mark_at:.2f} mm")
        close.plot(errors["compensated"][:, 2], errors["compensated"][:, 1], "x", ms=4, color=AFTER)
        for axes, title in ((plane, "error at the treatment point"), (close, "compensated, close up")):
            axes.add_patch(Circle((0, 0), 0.5, fill=False, color=INK, lw=1.1))
            axes.set(xlabel="along z [mm]", ylabel="along y (up) [mm]", title=title, aspect="equal")
        plane.axis("equal")
        close.set(xlim=(-0.6, 0.6), ylim=(-0.6, 0.6))
        close.text(0, 0.52, "0.5 mm", ha="center", fontsize=8)
        plane.legend(loc="best", fontsize=8)
        share.set(xscale="log", xlabel="radial error [mm]", ylabel="share of visits below [%]", ylim=(0, 103),
                  title=f"{len(size['compensated'])} unseen configurations")  # fmt: skip
        share.legend(loc="upper center", bbox_to_anchor=(0.5, 0.45), fontsize=8, frameon=True)
        figure.savefig(out, metadata={"Software": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
