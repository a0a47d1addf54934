"""The paper's figures 10, 11, 13 and 14 from this run, and what the identification recording looked like."""

from __future__ import annotations

import numpy as np
from matplotlib.patches import Circle
from numpy.typing import NDArray
from scipy.stats import norm

from ppshw.machine import Joint
from ppshw.report.picture import AFTER, BEFORE, FAINT, INK, MARK, Picture, canvas
from ppshw.verification import QUANTILE

Array = NDArray[np.float64]
# "The maximum acceptable radial error between the nominal tumor position and the isocenter" (the paper, section 4.1).
TOLERANCE_MM = 0.5
CLEAR = {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.85}  # behind words that stand on bars
MOST_VECTOR_MARKS = 400  # more marks than this are drawn as pixels, or the page grows heavy
AXES = "xyz"


def error_plane(
    before: Array | None, after: Array | None, point: str, plane: tuple[int, int], near: bool,
    label: str = "compensated",
) -> Picture:  # fmt: skip
    """Figure 10: errors in one plane with the circle of the tolerance.

    before, after  (N, 3) errors [m], None where not measured
    near           close up on the circle instead of everything
    label          what `after` is called
    """
    a, b = plane
    name = f"{AXES[a]}–{AXES[b]}"
    with canvas(4.7, 4.5) as c:
        ax = c.axes
        if before is not None:
            ax.plot(*_mm(before)[:, plane].T, "o", ms=3.6, mfc="none", mew=0.8, color=BEFORE, label="not compensated")
        if after is not None:
            ax.plot(*_mm(after)[:, plane].T, "x", ms=4.2, mew=0.9, color=AFTER, label=label)
        ax.add_patch(Circle((0, 0), TOLERANCE_MM, fill=False, lw=1.2, color=INK))
        ax.plot([], [], "o", ms=9, mfc="none", mew=1.2, color=INK, label=f"radius {TOLERANCE_MM:g} mm")
        reach = _reach(after if near else before if before is not None else after, near)
        ax.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        ax.set(xlabel=f"error along {AXES[a]} [mm]", ylabel=f"error along {AXES[b]} [mm]")
        c.figure.legend(loc="outside upper center", ncols=3, handletextpad=0.3, columnspacing=1.0)
        shown = "Initial and residual" if before is not None and after is not None else "Residual" if near else ""
        title = f"{shown} errors in the {name} plane{', close up' if near else ''}".strip().capitalize()
        parts = [f"Scatter of the error of '{point}' in the {name} plane of the base frame."]
        for errors, word in ((before, "Without"), (after, "With")):
            if errors is not None:
                size = np.nanmax(np.linalg.norm(_mm(errors)[:, plane], axis=1))
                parts.append(f"{word} compensation {_count(errors)} points, the farthest {size:.2f} mm from zero.")
        return c.picture(title, " ".join(parts) + f" A circle marks {TOLERANCE_MM:g} mm.")


def _reach(errors: Array | None, near: bool) -> float:
    largest = 0.0 if errors is None else float(np.nanmax(np.abs(_mm(errors))))
    return max(1.15 * TOLERANCE_MM if near else 1.6 * TOLERANCE_MM, 1.08 * largest)


def radial_distribution(errors: Array, title: str, what: str, colour: str = AFTER, limit: bool = True) -> Picture:
    """Figures 11 and 14: histogram of the radial error, its cumulative share, and the 98.6 % mark.

    errors  (N, 3) or (N, T, 3) [m], nan where a reflector was lost
    what    what one count is: "visits" or "readings"
    """
    size = np.linalg.norm(_mm(errors), axis=-1).ravel()
    size = np.sort(size[np.isfinite(size)])
    mark, median = float(np.quantile(size, QUANTILE)), float(np.median(size))
    right = max(size[-1], TOLERANCE_MM if limit and size[-1] > 0.4 * TOLERANCE_MM else 0.0) * 1.06
    if len(size) > 500:  # a few stray readings of many must not squeeze the rest into one bar
        right = min(right, 3 * mark)
    with canvas() as c:
        ax = c.axes
        bins = np.linspace(0, right, int(np.clip(np.sqrt(len(size)) * 2.2, 12, 60))).tolist()
        ax.hist(size, bins=bins, color=colour, alpha=0.35, edgecolor="white", lw=0.5)
        ax.set(xlim=(0, right), xlabel="radial error [mm]", ylabel=f"{what} per bar")
        ax.locator_params(axis="x", nbins=7)
        share = ax.twinx()
        steps = np.unique(np.linspace(0, len(size) - 1, min(len(size), MOST_VECTOR_MARKS)).astype(int))
        share.step([0, *size[steps], max(right, size[-1])], [0, *(100 * (steps + 1) / len(size)), 100],
                   where="post", color=colour)  # fmt: skip
        share.set(ylim=(0, 104), ylabel=f"share of all {what} [%]")
        share.grid(visible=False)
        share.spines["right"].set_visible(True)
        share.axvline(mark, color=MARK, lw=1.2, ls="--")
        on_left = mark > 0.5 * right
        label = f"98.6 %: {mark:.3f} mm" if mark > 0.02 else f"98.6 %: {mark:.2g} mm"
        share.annotate(label, (mark, 52), (-5 if on_left else 5, 0), textcoords="offset points",
                       ha="right" if on_left else "left", color=MARK, fontsize=9, bbox=CLEAR)  # fmt: skip
        if limit and right > TOLERANCE_MM:
            share.axvline(TOLERANCE_MM, color=INK, lw=1.0)
            inside = 0.8 * right < TOLERANCE_MM
            share.annotate(f"{TOLERANCE_MM:g} mm", (TOLERANCE_MM, 22), (-4 if inside else 4, 0), color=INK, fontsize=9,
                           textcoords="offset points", ha="right" if inside else "left", bbox=CLEAR)  # fmt: skip
        alt = (
            f"Histogram and cumulative share of the radial error of {len(size)} {what}: median {median:.3f} mm, "
            f"98.6 % below {mark:.3f} mm, largest {size[-1]:.3f} mm."
        )
        resting = max(1, int(np.ceil(len(size) * (1 - QUANTILE))))
        note = f"{len(size)} {what}, in bars (left axis) and as share below (line, right axis)."
        if beyond := int((size > right).sum()):
            note += f" {beyond} lie beyond the right edge."
        if resting <= 5:
            largest = f"the {resting} largest" if resting > 1 else "hardly more than the largest"
            note += f" The 98.6 % figure rests on {largest} of them."
        return c.picture(title, alt, note)


def axis_distribution(deviation: Array, axis: int, sigma_mm: float) -> Picture:
    """Figure 13: how visits of one pose scatter about their mean along one axis.   deviation (K, 3) [m]"""
    values = _mm(deviation)[:, axis]
    # one scale for the three axes, so that they compare at a glance
    reach = 1.08 * float(np.abs(_mm(deviation)).max())
    with canvas(3.7, 2.8) as c:
        bins = np.linspace(-reach, reach, 26).tolist()
        c.axes.hist(values, bins=bins, color=AFTER, alpha=0.35, edgecolor="white", lw=0.5)
        x = np.linspace(-reach, reach, 200)
        if sigma_mm > 0:
            c.axes.plot(x, len(values) * (bins[1] - bins[0]) * norm.pdf(x, scale=sigma_mm), color=INK, lw=1.1)
        c.axes.set(xlim=(-reach, reach), xlabel=f"deviation along {AXES[axis]} [mm]", ylabel="visits per bar")
        alt = (
            f"Histogram of {len(values)} deviations along {AXES[axis]} about the mean of their pose, standard "
            f"deviation {sigma_mm:.3f} mm, largest {np.abs(values).max():.3f} mm, with the normal curve of that width."
        )
        return c.picture(f"Repeatability along {AXES[axis]}: σ = {sigma_mm:.3f} mm", alt)


def residual_course(time: Array, size_mm: Array, outlier: NDArray[np.bool_], lost: NDArray[np.bool_]) -> Picture:
    """What the model leaves, visit after visit.

    time  (N,) [s], nan where unknown;  size_mm (N,) root mean square over a visit's targets, nan where all were lost
    outlier, lost  (N,) visits the estimate hardly believes; visits with a target that was not found
    """
    timed = bool(np.isfinite(time).all()) and float(np.ptp(time)) > 0
    x = (time - time[0]) / 3600 if timed else np.arange(1.0, len(time) + 1)
    with canvas() as c:
        ax, plain = c.axes, ~outlier
        many = len(x) > MOST_VECTOR_MARKS
        ax.plot(x[plain], size_mm[plain], ".", ms=3.2, color=AFTER, rasterized=many, label="visit")
        if outlier.any():
            label = f"outlier ({outlier.sum()})"
            ax.plot(x[outlier], size_mm[outlier], "D", ms=4.5, mfc="none", color=MARK, label=label)
        if lost.any():
            label = f"target lost ({lost.sum()})"
            ax.plot(x[lost], np.zeros(lost.sum()), "|", ms=9, color=FAINT, label=label, clip_on=False)
        usual = float(np.nanmedian(size_mm))
        largest = float(np.nanmax(size_mm))
        if largest > 12 * usual > 0:  # gross errors would flatten everything else
            ax.set_yscale("symlog", linthresh=4 * usual, linscale=2)
            ticks = [t for d in range(-4, 5) for t in (10.0**d, 2 * 10.0**d, 5 * 10.0**d) if t <= 1.1 * largest]
            linear = [t for t in ticks if usual <= t <= 4 * usual] + [t for t in ticks if t > 4 * usual]
            ax.set_yticks([0, *linear], [f"{t:g}" for t in [0.0, *linear]])
            ax.minorticks_off()
        ax.set_ylim(0, None)
        ax.set(xlabel="time since the first visit [h]" if timed else "visit", ylabel="residual [mm], rms over targets")
        c.figure.legend(loc="outside upper center", ncols=3, handletextpad=0.3, columnspacing=1.0)
        alt = (
            f"Residual of {len(x)} visits {'over time' if timed else 'in their order'}: median {usual:.3f} mm, "
            f"largest {largest:.3f} mm, {int(outlier.sum())} marked as outliers, {int(lost.sum())} with a target lost."
        )
        note = (
            "Measured minus modelled, of the very visits that the model was fitted to. An outlier’s square is more "
            "than twice the 99.9 % bound of what noise and model uncertainty allow: by chance less than one visit in a "
            "million."
        )
        return c.picture("Residual of the identification recording, visit by visit", alt, note)


def coverage(joint: Joint, q: Array) -> Picture:
    """Where a joint stood in the identification recording, between its limits.   q (N,) [m, rad]"""
    low, high = float(q.min()), float(q.max())
    if joint.limits is not None:
        low, high = min(low, joint.limits.lower), max(high, joint.limits.upper)
    pad = 0.04 * (high - low) or 0.01
    with canvas(3.4, 2.5) as c:
        bins = np.linspace(low, high, 31).tolist() if high > low else 1
        counts, _, _ = c.axes.hist(q, bins=bins, color=AFTER, alpha=0.45)
        filled = np.asarray(counts)[np.asarray(counts) > 0]
        ylabel = "visits"
        if filled.max() > 20 * np.median(filled):  # joints at home while others move would hide all else
            c.axes.set_yscale("log")
            c.axes.set_ylim(0.7, None)
            ylabel = "visits (log scale)"
        if joint.limits is not None:
            for edge in (joint.limits.lower, joint.limits.upper):
                c.axes.axvline(edge, color=INK, lw=1.0, ls="--")
        c.axes.set(xlim=(low - pad, high + pad), xlabel=f"{joint.name} [{joint.unit}]", ylabel=ylabel)
        span = f"{q.min():.3g} to {q.max():.3g} {joint.unit}"
        alt = f"Histogram of the positions of {joint.name} over {len(q)} visits, {span}."
        return c.picture(f"Coverage of {joint.name}", alt)


def _mm(errors: Array) -> Array:
    return np.asarray(errors * 1e3)


def _count(errors: Array) -> int:
    return int(np.isfinite(errors).all(axis=-1).sum())
