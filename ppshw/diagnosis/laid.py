"""Columns of all candidates laid over a workspace: whitened, of unit size, kept as what they are made of.

A column on one component of a frame is a function of the visits times that component's column of the Jacobian. Products
with it are products with the function alone, and the function is all that is kept: of three reflectors a ninth of the
readings that it moves. With Z = whitened columns at unit rms, A = X Λ½ W whose columns are orthogonal with squared
lengths s² (R⁻½ in X and Z), and G = (1 + s²)⁻½ Aᵀ Z,

    Zᵀ V⁻¹ Z = Zᵀ Z − Gᵀ G                         V as in `workspace`; docs/diagnosis-method.md §2

which is worked out in double precision, as the base model may take nearly all of a column. Functions themselves and G
are kept in single precision.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.workspace import Workspace
from ppshw.process import cores
from ppshw.terms.shapes import Column, Context, What

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Single = NDArray[np.float32]
BLOCK = 512  # columns at a time in double precision
FIELDS = 32  # of those that are not on one component of a frame
MOST_THREADS = 4  # each holds a part of its own
NOWHERE = -1


class Laid:
    """K columns over the F visits of a workspace's fit, R = F·3T whitened readings.

    scale      (K,)    rms at the reflectors per unit, over all visits [m]
    plain      (K,)    ZᵀR⁻¹Z at unit rms
    absorbing  (R, a)  A, of the a directions that take up anything;  lengths (a,) s²;  turn (p, a) W
    """

    def __init__(self, space: Workspace, columns: Sequence[Column]) -> None:
        self.space = space
        self.absorbing, self.lengths, self.turn = space.directions
        fit, rows = int(space.fit.sum()), space.rows
        self.scale = np.empty(len(columns))
        self._place = np.empty(len(columns), dtype=np.int64)  # rows are sorted by where they act
        self._group = np.full(len(columns), NOWHERE)
        of_group, elsewhere = _sorted(columns)
        self._values = np.empty((sum(map(len, of_group.values())), fit), dtype=np.float32)
        self._fields = np.empty((len(elsewhere), fit * rows), dtype=np.float32)
        readings = max(int(space.recording.seen.sum()), 1)
        known: dict[What, Array] = {}
        block = np.empty((BLOCK, len(space.fit)))
        self._white: list[Array] = []  # (F, 3T) of every group
        self._spans: list[slice] = []
        at = 0
        for (frame, component), members in of_group.items():
            there = space.context.moved(frame, component)
            squares = (there**2).sum(axis=1)
            self._place[members] = np.arange(at, at + len(members))
            self._group[members] = len(self._white)
            self._white.append(np.einsum("nij,nj->ni", space.root[space.fit], there[space.fit]))
            self._spans.append(slice(at, at + len(members)))
            for first in range(0, len(members), BLOCK):
                part = members[first : first + BLOCK]
                values = block[: len(part)]
                for row, k in enumerate(part):
                    values[row] = _value(columns[k], space.context, known)
                scale = np.maximum(np.sqrt(np.einsum("kn,kn,n->k", values, values, squares) / readings), 1e-30)
                self.scale[part] = scale
                fitted = values if fit == len(space.fit) else values[:, space.fit]
                np.divide(fitted, scale[:, None], out=self._values[at : at + len(part)], casting="same_kind")
                at += len(part)
        self._place[elsewhere] = np.arange(at, at + len(elsewhere))

        def of_some(first: int) -> None:
            part = elsewhere[first : first + FIELDS]
            raw = np.stack([columns[k].evaluate(space.context) for k in part], axis=2)
            self.scale[part] = np.maximum(np.sqrt((raw**2).sum(axis=(0, 1)) / readings), 1e-30)
            self._fields[first : first + len(part)] = (space.whiten(raw) / self.scale[part]).T

        side_by_side(of_some, range(0, len(elsewhere), FIELDS))
        self._column = np.argsort(self._place)  # of every row
        self._weights = np.array([(white**2).sum(axis=1) for white in self._white]).reshape(-1, fit)
        self.plain = self._squares()[self._place]
        self._taken, absorbed = self._absorbed(self.absorbing / np.sqrt(1.0 + self.lengths))
        self._seen = self.plain - absorbed[self._place]

    def product(self, x: Array) -> Single:
        """Zᵀ x of every column for x (R, d): (K, d), in single precision."""
        out = np.empty((len(self.scale), x.shape[1]), dtype=np.float32)

        def of_group(k: int) -> None:
            span = self._spans[k]
            out[self._column[span]] = self._values[span] @ self._along(x, k).astype(np.float32)

        def of_fields(first: int) -> None:
            at = len(self._values) + first
            out[self._column[at : at + BLOCK]] = self._fields[first : first + BLOCK] @ single

        single = x.astype(np.float32)
        side_by_side(of_fields, range(0, len(self._fields), BLOCK))
        side_by_side(of_group, range(len(self._spans)))
        return out

    def scores(self) -> Array:
        """(K,) Zᵀ V⁻¹ y of every column for what was read, in double precision."""
        return self.product(self.space.absorb(self.space.y[:, None]))[:, 0].astype(float)

    def information(self, columns: Indices) -> Array:
        """(C, k) columns of C candidates → (C, k, k) ZᵀV⁻¹Z of each."""
        count, k = columns.shape
        out = np.empty((count, k, k))
        step = max(1, BLOCK // k)
        for at in range(0, count, step):
            part = columns[at : at + step]
            groups = self._group[part]
            together = (groups == groups[:, :1]).all(axis=1) & (groups[:, 0] != NOWHERE)
            inner = np.empty((len(part), k, k))
            values = self._values[self._place[part[together]]].astype(float)
            inner[together] = (values * self._weights[groups[together, 0]][:, None]) @ np.swapaxes(values, 1, 2)
            for c in np.flatnonzero(~together):
                rows = self.rows(part[c])
                inner[c] = rows @ rows.T
            taken = self.taken(part).astype(float)
            out[at : at + step] = inner - taken @ np.swapaxes(taken, 1, 2)
        return out

    def seen(self) -> Array:
        """(K,) ZᵀV⁻¹Z of every column alone."""
        return self._seen

    def taken(self, which: Indices) -> Single:
        """(…, a) G of some of the columns."""
        return np.asarray(self._taken[self._place[which]])

    def rows(self, which: Indices) -> Array:
        """(k, R) some of the columns as whitened readings."""
        out = np.empty((len(which), self._fields.shape[1]))
        for row, k in enumerate(which):
            place, group = self._place[k], self._group[k]
            if group == NOWHERE:
                out[row] = self._fields[place - len(self._values)]
            else:
                out[row] = (self._values[place, :, None] * self._white[group]).ravel()
        return out

    def of_noise(self, rng: np.random.Generator, draws: int) -> Single:
        """(K, draws) Zᵀ V⁻¹ n for n of covariance V: noise, and what the base model may mean besides."""
        meant = self.absorbing @ rng.standard_normal((len(self.lengths), draws))
        return self.product(self.space.absorb(rng.standard_normal((len(meant), draws)) + meant))

    def _along(self, x: Array, group: int) -> Array:
        """(F, d) what readings x (R, d) come to along a group's column of the Jacobian. Of one group at a time: those
        of all are several times the columns themselves."""
        visits = x.reshape(len(x) // self.space.rows, self.space.rows, x.shape[1])
        return np.asarray(np.einsum("fr,frd->fd", self._white[group], visits))

    def _absorbed(self, x: Array) -> tuple[Single, Array]:
        """Zᵀ x of every column, worked out in double precision, and the squared length of each: (K, a), (K,); in the
        order of the rows."""
        out, squares = np.empty((len(self.scale), x.shape[1]), dtype=np.float32), np.empty(len(self.scale))

        def keep(part: slice, exact: Array) -> None:
            squares[part] = np.einsum("ka,ka->k", exact, exact)
            out[part] = exact

        def of_group(k: int) -> None:
            along, span = self._along(x, k), self._spans[k]
            for at in range(span.start, span.stop, BLOCK):
                part = slice(at, min(at + BLOCK, span.stop))
                keep(part, self._values[part].astype(float) @ along)

        def of_fields(first: int) -> None:
            at = len(self._values) + first
            keep(slice(at, at + BLOCK), self._fields[first : first + BLOCK].astype(float) @ x)

        side_by_side(of_fields, range(0, len(self._fields), BLOCK))
        side_by_side(of_group, range(len(self._spans)))
        return out, squares

    def _squares(self) -> Array:
        """ZᵀZ of every column, in the order of the rows."""
        out = np.empty(len(self.scale))
        for weights, span in zip(self._weights, self._spans, strict=True):
            out[span] = self._values[span].astype(float) ** 2 @ weights
        for row, field in enumerate(self._fields, start=len(self._values)):
            exact = field.astype(float)
            out[row] = exact @ exact
        return out


def _sorted(columns: Sequence[Column]) -> tuple[dict[tuple[int, int], list[int]], list[int]]:
    """Indices of columns on each component of a frame, and of those that are on none."""
    of_group: dict[tuple[int, int], list[int]] = {}
    elsewhere = []
    for k, column in enumerate(columns):
        if column.on == "frame":
            of_group.setdefault((column.frame, column.component), []).append(k)
        else:
            elsewhere.append(k)
    return of_group, elsewhere


def side_by_side(work: Callable[[int], None], parts: Iterable[int]) -> None:
    """Parts that write to places of their own, on several cores: each is a product in one thread (`process`)."""
    if (count := min(MOST_THREADS, cores())) == 1:
        for part in parts:
            work(part)
        return
    with ThreadPoolExecutor(count) as threads:
        list(threads.map(work, parts))


def _value(column: Column, context: Context, known: dict[What, Array]) -> Array:
    """A column's function (N,), worked out once for all places that it acts at."""
    what = column.what
    if what not in known:
        known[what] = column.value(context)
    return known[what]
