"""What nobody has a name for, as a Gaussian process over one to three columns, where there were data and nowhere else.

A function f of the standardised columns x ∈ ℝᵈ with the Matérn-5/2 covariance k, unit variance, one length per column,
is carried by its values at m sites Z that were visited (Quiñonero-Candela & Rasmussen 2005, subset of regressors):

    f(x) ≈ φ(x)ᵀ a,   φ(x) = w(x) L⁻¹ k(Z, x),   L Lᵀ = k(Z, Z),   a ~ N(0, 1)

v(x) = |L⁻¹ k(Z, x)|² ≤ 1 is the share of f's variance that the sites determine: nearly 1 where visits were, 0 far from
all of them. The window w is 1 where v says that there were data and 0 where not, beyond the sampled range of any column
too; what φ leaves of the variance, 1 − |φ|², is not known and stays in the uncertainty. docs/derivations.md §9.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

Array = NDArray[np.float64]
MOST_SITES = 120
LEFT_OUT = 0.02  # of f's variance at any visit, when sites are enough
# Share of f's variance determined by the sites from which on there is a correction, and the whole of it.
NONE_BELOW, WHOLE_ABOVE = 0.5, 0.9
BEYOND = 0.1  # of a column's sampled range, within which the correction fades out beyond its ends
JITTER = 1e-6


def matern(a: Array, b: Array) -> Array:
    """(n, d), (m, d) in units of the lengths → (n, m): (1 + √5 r + 5r²/3) e^(−√5 r)   (Rasmussen & Williams 4.17)."""
    square = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2.0 * a @ b.T
    r = np.sqrt(5.0 * np.maximum(square, 0.0))
    return np.asarray((1.0 + r + r**2 / 3.0) * np.exp(-r))


@dataclass(frozen=True)
class Region:
    """Where one to three columns were sampled, and how fast a function of them may change.

    names (d,) of the columns;  centre, spread, low, high, length (d,): in the columns' own units, lengths in spreads
    sites (m, d) standardised
    """

    names: tuple[str, ...]
    centre: Array
    spread: Array
    low: Array
    high: Array
    length: Array
    sites: Array

    @classmethod
    def over(cls, names: tuple[str, ...], values: Array, length: Array) -> Region:
        """Of the visits' values (N, d) and lengths (d,) in spreads; sites are those visits that the others say least
        about (incomplete Cholesky decomposition with pivots; Fine & Scheinberg 2001)."""
        centre, spread = values.mean(axis=0), np.maximum(values.std(axis=0), 1e-12)
        unit = (values - centre) / spread
        sites = unit[_pivots(unit / length)]
        return cls(names, centre, spread, values.min(axis=0), values.max(axis=0), length, sites)

    def as_dict(self) -> dict[str, Any]:
        return {
            "names": list(self.names), "centre": self.centre.tolist(), "spread": self.spread.tolist(),
            "low": self.low.tolist(), "high": self.high.tolist(), "length": self.length.tolist(),
            "sites": self.sites.tolist(),
        }  # fmt: skip

    def basis(self, values: Array) -> Array:
        """(N, d) → φ (N, m), zero where there were no data or a value is missing."""
        known = np.asarray(np.isfinite(values).all(axis=1))
        values = np.where(known[:, None], values, self.centre)
        phi = self._sited(values)
        return phi * (known * self._window(values, (phi**2).sum(axis=1)))[:, None]

    def weight(self, values: Array) -> Array:
        """(N, d) → (N,) share of f's variance that the sites determine, 0 where the correction is not used."""
        return np.asarray((self.basis(values) ** 2).sum(axis=1))

    def window(self, values: Array) -> Array:
        """(N, d) → (N,) 1 where there were data, 0 where not or where a value is missing."""
        known = np.asarray(np.isfinite(values).all(axis=1))
        values = np.where(known[:, None], values, self.centre)
        return known * self._window(values, (self._sited(values) ** 2).sum(axis=1))

    def _sited(self, values: Array) -> Array:
        """L⁻¹ k(Z, x), (N, m)"""
        near = matern(self.sites / self.length, (values - self.centre) / self.spread / self.length)
        lower = np.linalg.cholesky(matern(self.sites / self.length, self.sites / self.length)
                                   + JITTER * np.eye(len(self.sites)))  # fmt: skip
        return np.asarray(solve_triangular(lower, near, lower=True).T)

    def _window(self, values: Array, determined: Array) -> Array:
        fade = BEYOND * np.maximum(self.high - self.low, 1e-12)
        outside = np.maximum(np.maximum(self.low - values, values - self.high), 0.0) / fade
        inside = np.prod(1.0 - _step(outside), axis=1)
        return np.asarray(inside * _step((determined - NONE_BELOW) / (WHOLE_ABOVE - NONE_BELOW)))


def _step(t: Array) -> Array:
    """From 0 at 0 to 1 at 1, smooth at both ends."""
    t = np.clip(t, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _pivots(x: Array) -> NDArray[np.int64]:
    left = np.ones(len(x))
    rows = np.empty((MOST_SITES, len(x)))
    chosen: list[int] = []
    while len(chosen) < MOST_SITES and left.max() > LEFT_OUT:
        at, k = int(np.argmax(left)), len(chosen)
        row = matern(x[at : at + 1], x)[0] - rows[:k, at] @ rows[:k]
        rows[k] = row / np.sqrt(left[at])
        left = np.maximum(left - rows[k] ** 2, 0.0)
        left[at] = 0.0
        chosen.append(at)
    return np.array(chosen, dtype=np.int64)
