"""Least squares with redundant parameters set to zero   (paper, below eq. 24)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

Array = NDArray[np.float64]


def independent_columns(design: Array, tolerance: float, first: Sequence[int] = ()) -> list[int]:
    """Columns that carry everything the design can see, in the order of a pivoted QR decomposition.

    Columns are scaled to unit length; one is redundant when what the kept ones leave of it is shorter than `tolerance`.
    Columns of `first` are kept before all others are looked at, so that they are never traded for their equals.

    design  (rows, p), rows of equal standard deviation
    """
    size = np.linalg.norm(design, axis=0)
    alive = np.flatnonzero(size > 1e-12 * size.max(initial=0.0))
    if not len(alive):
        return []
    scaled = design[:, alive] / size[alive]
    kept = [k for k in first if k in alive]
    if kept:
        basis, _ = np.linalg.qr(scaled[:, np.searchsorted(alive, kept)])
        scaled = scaled - basis @ (basis.T @ scaled)
    triangle, order = qr(scaled, mode="r", pivoting=True)
    rank = int((np.abs(np.diag(triangle)) > tolerance).sum())
    return kept + [int(k) for k in alive[order[:rank]] if k not in kept]


def solver(design: Array, kept: Sequence[int]) -> Array:
    """(p, rows) operator of the least-squares solution in the kept columns, zero in all others."""
    out = np.zeros(design.T.shape)
    if kept:
        chosen = design[:, list(kept)]
        size = np.linalg.norm(chosen, axis=0)
        out[list(kept)] = np.linalg.pinv(chosen / size) / size[:, None]
    return out
