"""Pictures of where a mismatch sits: before any name is given, and of what was found, against what it was found in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from numpy.typing import NDArray

from ppshw.diagnosis.checks import ODD
from ppshw.diagnosis.locate import CYCLES, Channel, Covariate, Map, bounded, gradients
from ppshw.diagnosis.replicas import Compared
from ppshw.report.picture import AFTER, FAINT, INK, MARK, Picture, canvas
from ppshw.terms import COMPONENTS
from ppshw.terms.shapes import Context, named_column

Array = NDArray[np.float64]
BINS = 14
DRAWS = 99  # of the noise band
FEW = 4  # so many values of a column are drawn as values, not as bins
SHADES = LinearSegmentedColormap.from_list("strength", ["#ffffff", "#cfe0ee", AFTER, "#3a0d2c"])
DARKEST = 12.0  # of the map [standard deviations]
TICKS = 6  # at most along an axis: "1007.25" is wide


@dataclass(frozen=True)
class Reading:
    """The residual read as one component of one frame, visit by visit.

    values   (M,) [µm, µrad], nan where the visit cannot show it;  weights (M,) how well it can
    replicas (D, M) the same of visits that the model itself made
    """

    channel: Channel
    values: Array
    weights: Array
    replicas: Array

    @property
    def unit(self) -> str:
        """Of what is drawn."""
        return "µrad" if self.channel.component.startswith("r") else "µm"

    @property
    def label(self) -> str:
        """The channel in words, without its unit."""
        if self.channel.index < 0:
            return f"distance {self.channel.component}"
        what = "turned about" if self.channel.component.startswith("r") else "shifted along"
        return f"{self.channel.frame} {what} {self.channel.component[1]}"


def read(compared: Compared, channels: tuple[Channel, ...], which: int, shift: Array | None = None) -> Reading:
    """The residual as channel `which`; `shift` (M, 3T) [m] is added to it (a fitted effect: partial residuals)."""
    gradient = gradients(compared)[:, :, which]
    weight = (gradient**2).sum(axis=1)
    freedom = compared.live.sum(axis=1)
    left = bounded(compared.left[None].astype(np.float32), freedom)[0].astype(float)
    if shift is not None:
        left = left + (compared.root @ shift[..., None])[..., 0]
    draws = np.concatenate(
        [(bounded(d, freedom) * gradient).sum(axis=2) for d in compared.replicas(np.random.default_rng(1), DRAWS)]
    )
    known = weight > 1e-3 * weight.max()
    scale = np.where(known, 1e6 / np.where(known, weight, 1.0), np.nan)
    return Reading(channels[which], (left * gradient).sum(axis=1) * scale, np.where(known, weight, 0.0), draws * scale)


def strength_map(found: Map) -> Picture:
    """Every frame and component (columns) against everything it may depend on (rows)."""
    rows, columns = found.strength.shape
    with canvas(11.0, 1.5 + 0.19 * rows) as c:
        ax = c.axes
        shown = np.ma.masked_invalid(found.strength)
        mesh = ax.pcolormesh(np.arange(columns + 1), np.arange(rows + 1), shown, cmap=SHADES, vmin=0, vmax=DARKEST)
        ax.set_facecolor("#ececec")
        ax.invert_yaxis()
        over = np.argwhere(np.nan_to_num(found.strength, nan=-9.0) > found.threshold)
        ax.plot(over[:, 1] + 0.5, over[:, 0] + 0.5, "o", ms=2.6, color="white", mec="none")
        ax.set_yticks(np.arange(rows) + 0.5, [k.label for k in found.covariates], fontsize=7.5)
        ax.set_xticks(np.arange(columns) + 0.5, [ch.component for ch in found.channels], fontsize=7, rotation=90)
        ax.tick_params(length=0)
        ax.grid(visible=False)
        edges = [0] + [k for k in range(1, columns) if found.channels[k].frame != found.channels[k - 1].frame]
        for begin, end in zip(edges, [*edges[1:], columns], strict=True):
            ax.axvline(begin, color="#9a9a9a", lw=0.8)
            ax.text((begin + end) / 2, -0.5, found.channels[begin].frame, ha="center", va="bottom", fontsize=8.5)
        kinds = [k.kind for k in found.covariates]
        for k in range(1, rows):
            if kinds[k] != kinds[k - 1]:
                ax.axhline(k, color="#9a9a9a", lw=0.8)
        bar = c.figure.colorbar(mesh, ax=ax, pad=0.01, aspect=40, extend="max")
        bar.set_label("standard deviations above what noise alone gives")
        bar.ax.axhline(found.threshold, color=MARK, lw=1.5)
        best = [f"{_name(found.channels[j])} over {found.covariates[r].label}" for r, j in found.strongest(1)]
        alt = (
            f"Map of {columns} components against {rows} columns; the strongest dependence is {' '.join(best)} with "
            f"{np.nanmax(found.strength):.1f} standard deviations, family-wise p {found.p:.3g}."
        )
        note = (
            "Columns: the residual read as a displacement of each frame along each component, and as a change of the "
            f"distance between reflectors. A white dot: beyond {found.threshold:.1f} (red in the scale), which the "
            "strongest cell of the whole map reaches in one of twenty recordings of a machine that the model describes "
            "fully. Grey: the fit leaves nothing to see. Neighbouring frames that move the reflectors alike light up "
            "together."
        )
        return c.picture("What the residual of the base model depends on", alt, note)


def _name(channel: Channel) -> str:
    return f"{channel.frame} {channel.component}"


def dependence(reading: Reading, covariate: Covariate, c: Context, joint_units: dict[str, str]) -> Picture:
    """The residual against one column, or against two as a plane."""
    if len(covariate.names) == 2:
        return _plane(reading, *covariate.names, c, joint_units)
    name = covariate.names[0]
    if covariate.kind == "always":
        return over(reading, "time", np.asarray(c.hours), joint_units)
    if covariate.kind == "waves":
        return _folded(reading, name, c, joint_units)
    return over(reading, name, np.asarray(named_column(c, name)), joint_units)


def over(
    reading: Reading, name: str, x: Array, units: dict[str, str], fitted: Array | None = None, title: str = "",
) -> Picture:  # fmt: skip
    """Visits, their means in bins, and the band in which 95 % of the replicas' means lie.

    fitted  (M,) what a finding says of each visit, in the reading's unit
    """
    known = np.isfinite(x) & np.isfinite(reading.values)
    x, values, weights = x[known], reading.values[known], reading.weights[known]
    groups, at = _groups(x)
    mean = _means(values[None], weights, groups, len(at))[0]
    low, high = np.quantile(_means(reading.replicas[:, known], weights, groups, len(at)), [0.025, 0.975], axis=0)
    few = len(np.unique(x)) <= FEW
    with canvas() as c:
        jitter = 0.16 * (np.random.default_rng(0).random(len(x)) - 0.5) if few else 0.0
        c.axes.plot(x + jitter, values, ".", ms=2.8, color=FAINT, alpha=0.55, rasterized=len(x) > 400, label="visit")
        if few:
            half = np.array([at - 0.12, at + 0.12]).T
            for (a, b), lo, hi in zip(half, low, high, strict=True):
                c.axes.fill_between([a, b], lo, hi, color=AFTER, alpha=0.25, lw=0)
            c.axes.plot([], [], "s", ms=8, color=AFTER, alpha=0.25, label="noise, 95 %")
            c.axes.plot(at, mean, "D", ms=6, color=AFTER, mec="white", label="mean", zorder=4)
            c.axes.set_xticks(at)
        else:
            c.axes.fill_between(at, low, high, color=AFTER, alpha=0.2, lw=0, label="noise, 95 %")
            c.axes.plot(at, mean, "o-", ms=4, color=AFTER, label="mean of a bin", zorder=4)
        if fitted is not None:
            order = np.argsort(x, kind="stable")
            c.axes.plot((x + jitter)[order], fitted[known][order], ".", ms=3.2, color=MARK, label="as found",
                        rasterized=len(x) > 400)  # fmt: skip
        reach = 1.15 * max(float(np.quantile(np.abs(values), 0.97)), float(np.abs([*mean, *low, *high]).max()))
        c.axes.set(ylim=(-reach, reach), xlabel=f"{name} {_unit(name, units)}".strip(),
                   ylabel=f"{reading.label} [{reading.unit}]")  # fmt: skip
        c.axes.locator_params(axis="x", nbins=TICKS)
        c.figure.legend(loc="outside upper center", ncols=4, handletextpad=0.3, columnspacing=1.0)
        out = int(((mean < low) | (mean > high)).sum())
        beyond = int((np.abs(values) > reach).sum())
        note = f"{beyond} visit{'s lie' if beyond > 1 else ' lies'} beyond the edges." if beyond else ""
        alt = (
            f"{reading.label} of {len(x)} visits over {name}: means of bins from {mean.min():.0f} to {mean.max():.0f} "
            f"{reading.unit}, {out} of {len(mean)} outside the band of noise."
        )
        return c.picture(title or f"{_name(reading.channel)} over {name}", alt, note)


def _groups(x: Array) -> tuple[NDArray[np.int64], Array]:
    """The bin of every visit, equally filled, and the bins' middles; of few values, the values."""
    values = np.unique(x)
    if len(values) <= FEW:
        return np.searchsorted(values, x), values
    edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))
    which = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    used, which = np.unique(which, return_inverse=True)
    return which, np.array([x[which == k].mean() for k in range(len(used))])


def _means(values: Array, weights: Array, groups: NDArray[np.int64], count: int) -> Array:
    """(D, M) → (D, count) weighted means."""
    member = (groups[:, None] == np.arange(count)) * weights[:, None]
    return np.asarray(values @ member / np.maximum(member.sum(axis=0), 1e-30))


def _folded(reading: Reading, name: str, c: Context, units: dict[str, str]) -> Picture:
    """Over the phase of the strongest period: that is a choice of many, so it looks like something even in noise."""
    q = np.asarray(named_column(c, name))
    known = np.isfinite(reading.values)
    turn = 2 * np.pi * np.outer(CYCLES, (q - q.min()) / np.ptp(q))[:, known]
    push = (reading.weights * np.nan_to_num(reading.values))[known]
    best = CYCLES[int(np.argmax((np.cos(turn) @ push) ** 2 + (np.sin(turn) @ push) ** 2))]
    period = float(np.ptp(q)) / best
    phase = (q - q.min()) % period
    unit = units.get(name, "")
    title = f"{_name(reading.channel)} over {name}, folded at its strongest period {period:.4g} {unit}".strip()
    return over(reading, f"{name} within a period", phase, {f"{name} within a period": unit}, title=title)


def _plane(reading: Reading, first: str, second: str, c: Context, units: dict[str, str]) -> Picture:
    x, y = (np.asarray(named_column(c, n)) for n in (first, second))
    known = np.isfinite(reading.values)
    edges = [np.quantile(v[known], np.linspace(0, 1, 7)) for v in (x, y)]
    cell = [np.clip(np.searchsorted(e, v[known], side="right") - 1, 0, 5) for e, v in zip(edges, (x, y), strict=True)]
    mean = _means(reading.values[None, known], reading.weights[known], 6 * cell[1] + cell[0], 36).reshape(6, 6)
    with canvas() as k:
        reach = float(np.abs(mean).max())
        mesh = k.axes.pcolormesh(*edges, mean, cmap="RdBu_r", vmin=-reach, vmax=reach)
        k.axes.grid(visible=False)
        k.axes.set(xlabel=f"{first} {_unit(first, units)}".strip(), ylabel=f"{second} {_unit(second, units)}".strip())
        k.axes.locator_params(axis="x", nbins=TICKS)
        k.figure.colorbar(mesh, ax=k.axes).set_label(f"mean, {reading.label} [{reading.unit}]")
        alt = f"Mean residual in 6 × 6 cells of {first} and {second}, up to {reach:.0f} {reading.unit} either way."
        return k.picture(f"{_name(reading.channel)} over {first} and {second}", alt)


def _unit(name: str, units: dict[str, str]) -> str:
    known = {"time": "h", "since_load_change": "h", "pause": "h", "settle_s": "s"}
    if name in units or name in known:
        unit = units.get(name, known.get(name, ""))
        return f"[{unit}]" if unit else ""
    if name.endswith("_C"):
        return "[°C]"
    if name in ("Fx", "Fy", "Fz"):
        return "[N]"
    return "[N m]" if name in ("Mx", "My", "Mz") else ""


def checks_picture(before: list[dict[str, object]], after: list[dict[str, object]]) -> Picture:
    """Every check: where the recording stands against the middle 95 % of its twin's replicas, before and after."""
    names = [str(c["about"]) for c in before]
    with canvas(9.0, 0.9 + 0.27 * len(names)) as c:
        ax = c.axes
        for checks, colour, shift, word in ((before, INK, -0.16, "base model"), (after, AFTER, 0.16, "with findings")):
            by_name = {k["name"]: k for k in checks}
            rows = [(j, by_name[k["name"]]) for j, k in enumerate(before) if k["name"] in by_name]
            at = [_against(k) for _, k in rows]
            ax.plot(np.clip(at, -4.0, 8.0), [j + shift for j, _ in rows], "D" if shift > 0 else "o", ms=5,
                    mfc=colour if shift > 0 else "none", color=colour, label=word, clip_on=False)  # fmt: skip
        ax.axvspan(-1, 1, color=AFTER, alpha=0.15, lw=0, label="middle 95 % of the twin’s replicas")
        ax.set_yticks(range(len(names)), names)
        ax.invert_yaxis()
        ax.set(xlim=(-4.2, 8.2), xlabel="observed, 1 = edge of the middle 95 % (4 and 8: and beyond)")
        c.figure.legend(loc="outside upper center", ncols=3, handletextpad=0.3, columnspacing=1.0)
        odd = sum(float(str(k["p"])) <= ODD for k in before), sum(float(str(k["p"])) <= ODD for k in after)
        alt = f"{len(names)} checks; {odd[0]} fail before what was found is modelled, {odd[1]} after."
        return c.picture("The recording against its twin", alt)


def _against(check: dict[str, object]) -> float:
    observed, low, high = (float(str(check[k])) for k in ("observed", "low", "high"))
    return (observed - 0.5 * (low + high)) / max(0.5 * (high - low), 1e-12)


def components_of(channels: tuple[Channel, ...], frame: int | None, component: str | None) -> list[int]:
    """The channels that a finding may be read in: its own, its frame's, or any frame's where it sits at none."""
    frames = [j for j, ch in enumerate(channels) if ch.index >= 0]
    mine = frames if frame is None else [j for j in frames if channels[j].index == frame]
    if component in COMPONENTS:
        mine = [j for j in mine if channels[j].component == component] or mine
    return mine
