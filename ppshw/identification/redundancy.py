"""Which parameters are redundant, and least squares with those set to zero   (paper, below eq. 24).

Redundant in principle is a column that others can replace. Redundant in this recording is also one whose parameter, of
any plausible size, adds no more to the data than noise does. The second bound does what the paper does by hand with
"some simple knowledge on the system's physics": without it, identified compliances chase noise, and under loads beyond
those of the weight pairs they miss by millimetres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# A column is redundant in principle when the kept ones explain all but this share of it. Tried on simulated machines:
# from 0.02 downwards near-twins are kept that tear each other apart outside the sampled poses, from 0.1 upwards columns
# are lost that matter.
SHARE = 0.03
# A parameter may well be this many times as large as its term thinks before it saw any data.
PLAUSIBLE = 3.0


@dataclass(frozen=True)
class Evidence:
    """data  at every place (rows,), of unit variance;  plausible  (p,) standard deviation of every parameter."""

    data: Sequence[Array]
    plausible: Array


def independent_columns(designs: Sequence[Array], evidence: Evidence | None, first: Sequence[int] = ()) -> list[int]:
    """Columns to keep, in the order of a pivoted orthogonalisation; one choice for all places.

    Without evidence the pivot is the column of which the largest share is left: QR with column pivoting on columns of
    unit length. With evidence it is the one that raises the marginal likelihood most, for a parameter N(0, s²),

        2 Δ log p = (aᵀr)² / (aᵀa + 1/s²) − log(1 + s² aᵀa)        (a what is left of the column, r of the data)

    until none raises it.

    designs  at every place (rows, p), rows of unit variance
    first    columns kept before all others
    """
    left = [np.array(d, dtype=float) for d in designs]
    rest = None if evidence is None else [np.array(y, dtype=float) for y in evidence.data]
    length = np.array([np.linalg.norm(d, axis=0) for d in designs])
    whole = np.linalg.norm(length, axis=0)
    kept: list[int] = []
    coming = list(first)
    while len(kept) < len(whole):
        size = np.array([np.linalg.norm(d, axis=0) for d in left])
        alive = (size > SHARE * length) & (length > 1e-12 * whole.max())
        alive[:, kept] = False
        if coming:
            best = coming.pop(0)
        elif evidence is None or rest is None:
            worth = np.linalg.norm(np.where(alive, size, 0.0), axis=0) / np.where(whole > 0, whole, 1.0)
            best = int(np.argmax(worth))
            if worth[best] <= SHARE:
                break
        else:
            along = np.array([y @ d for y, d in zip(rest, left, strict=True)])
            gain = along**2 / (size**2 + evidence.plausible**-2) - np.log1p((size * evidence.plausible) ** 2)
            worth = np.where(alive, gain, 0.0).sum(axis=0)
            best = int(np.argmax(worth))
            if worth[best] <= 0.0:
                break
        kept.append(best)
        for k in np.flatnonzero(alive[:, best]):
            unit = left[k][:, best] / size[k, best]
            left[k] -= np.outer(unit, unit @ left[k])
            if rest is not None:
                rest[k] -= unit * (unit @ rest[k])
    return kept


def solver(design: Array, kept: Sequence[int]) -> Array:
    """(p, rows) operator of the least-squares solution in the kept columns, zero in all others.

    Where kept columns depend on each other at this very place, the smallest solution in scaled columns is taken.
    """
    out = np.zeros(design.T.shape)
    if len(kept):
        chosen = design[:, list(kept)]
        size = np.linalg.norm(chosen, axis=0)
        size[size == 0.0] = 1.0
        out[list(kept)] = np.linalg.pinv(chosen / size, rcond=SHARE**2) / size[:, None]
    return out
