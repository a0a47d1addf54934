"""A candidate without a name, the smooth functions that it is made of, and the columns that they may go over."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from ppshw.diagnosis.library.candidate import Candidate
from ppshw.diagnosis.library.sampled import called, moving_joints, nobody_knows, read_channels, temperature_places
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.terms.shapes import Column, Context, named_column

Array = NDArray[np.float64]
LATE_H = (0.5, 1.0, 2.0)  # lags of columns that nothing is known about
ABOUT_ZERO = 9  # bumps over what is finest about zero
STANDS_STILL = 0.1  # part of a column's range within which half of the visits lie
KNOTS = 5  # bumps over the ranks of a column


def rival(
    c: Context, frame: int | None, comp: int | None, names: tuple[str, ...], columns: Sequence[Column]
) -> Candidate:  # fmt: skip
    """Columns over some names that move a frame in one component; None: in several, or no frame."""
    where = None if frame is None else c.machine.frame_names[frame]
    way = None if frame is None or comp is None else called(c, frame, comp)
    return Candidate("nameless", None, where, way, " × ".join(names), tuple(columns), covariates=names)


def bumps(name: str, frame: int, comp: int) -> list[Column]:
    """Any smooth function of a column."""
    return [Column("frame", "covariate", {"name": name, "knot": j, "count": KNOTS}, frame, comp) for j in range(KNOTS)]


def half_waves(
    c: Context, joint: int, comp: int, halves: Iterable[int], function: str = "wave", **of: int
) -> list[Column]:
    """Waves of which so many halves go into a joint's travel, at its own frame."""
    twice = 2 * float(np.ptp(c.recording.q[:, joint]))
    return [
        Column("frame", function, {"joint": joint, "period": twice / j, "phase": phase, **of}, joint + 1, comp)
        for j in halves for phase in ("sin", "cos")
    ]  # fmt: skip


def smooth_pair(c: Context, frame: int, comp: int, first: str, second: str) -> Candidate:
    """Any smooth function of two columns."""
    pair = {"first": first, "second": second, "count": 3}
    return rival(c, frame, comp, (first, second), [
        Column("frame", "covariate_pair", {**pair, "a": a, "b": b}, frame, comp)
        for a, b in itertools.product(range(3), repeat=2)
    ])  # fmt: skip


def ends(c: Context) -> list[tuple[int, int]]:
    """Every component of the base, then of the tip."""
    return [(frame, comp) for frame in (0, c.machine.n) for comp in range(6)]


def stands_still(c: Context, name: str) -> bool:
    """Whether a column is nearly the same most of the time, as of what is parked: its ranks hardly see the rest."""
    values = named_column(c, name)
    low, high = np.quantile(values, (0.25, 0.75))
    return bool(high - low < STANDS_STILL * np.ptp(values))


def late_columns(c: Context) -> list[str]:
    """What nobody knows and temperatures, as they were some time ago."""
    warm = [f"temp_{place}_C" for place in temperature_places(c)]
    return [f"late_{tau:g}_{k}" for k in (*nobody_knows(c), *warm) for tau in LATE_H]


def columns_of(c: Context) -> list[str]:
    """All columns of a recording that something may go with."""
    r = c.recording
    joints = [f"q_{name}" for _, name in moving_joints(c)]
    out = [*joints, "time", "since_load_change"]
    out += [f"temp_{p}_C" for p in r.temperatures if np.isfinite(r.temperatures[p]).all()]
    out += came_from(c) + nobody_knows(c)
    out += ["pause"] if np.ptp(named_column(c, "pause")) > 0 else []
    if np.isfinite(r.settle_s).all():
        out.append("settle_s")
    if read := read_channels(c):
        out += [WRENCH_COMPONENTS[k] for k in read]
        out += ["former_load"] if len(set(r.load)) > 2 else []
    return out


def came_from(c: Context) -> list[str]:
    """The pose before and the last move."""
    joints = [f"q_{name}" for _, name in moving_joints(c)]
    return [f"previous_{j}" for j in joints] + [f"move_{j[2:]}" for j in joints]


def without_a_place(c: Context) -> set[str]:
    """Of what no name knows no place is likelier than another."""
    late = (name for name in late_columns(c) if "_temp_" not in name)
    return {*nobody_knows(c), *late, *came_from(c), "pause", "former_load"}


def most_alike(c: Context, values: Array) -> tuple[str, ...]:
    """Positions, the one first that says most of what values (N,) are."""
    left = {}
    for k, name in moving_joints(c):
        q = c.recording.q[:, k]
        left[f"q_{name}"] = float(np.var(values - Polynomial.fit(q, values, 3)(q)))
    return tuple(sorted(left, key=lambda name: left[name]))
