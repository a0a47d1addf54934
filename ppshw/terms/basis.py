"""Functions of one variable, linear in their coefficients: what a generalized error or a compliance may look like.

Every basis gives its values (N, m) at positions (N,), its names, and for each coefficient a band: coefficients of one
band share one prior strength, which the data decide.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Basis(Protocol):
    @property
    def size(self) -> int: ...

    @property
    def bands(self) -> tuple[str, ...]:
        """Per coefficient the band it belongs to."""

    def values(self, x: Array) -> Array:
        """(N,) → (N, m)."""

    def as_dict(self) -> dict[str, Any]: ...


@dataclass(frozen=True)
class Constant:
    """A parameter that does not depend on position."""

    @property
    def size(self) -> int:
        return 1

    @property
    def bands(self) -> tuple[str, ...]:
        return ("line",)

    def values(self, x: Array) -> Array:
        return np.ones((len(x), 1))

    def as_dict(self) -> dict[str, Any]:
        return {"kind": "constant"}


# Upper edges of the bands of sines, in half waves over the widened travel: octaves.
BAND_EDGES = (2, 4, 8, 16, 32, 64, 128, 256)
# The sines live on a travel widened by this factor, so that they are free at its ends.
WIDENING = 1.2


@dataclass(frozen=True)
class Smooth:
    """A straight line and `waves` sines: the Hilbert-space form of a Gaussian process on an interval.

        1,  u,  sin(jπ(u + w)/(2w)) / j,   u = (x − centre)/half,  w = 1.2,  j = 1 … waves

    Solin & Särkkä (2020), Hilbert space methods for reduced-rank Gaussian process regression. Outside the travel the
    function is held at its end value.
    """

    centre: float
    half: float
    waves: int

    @property
    def size(self) -> int:
        return 2 + self.waves

    @property
    def bands(self) -> tuple[str, ...]:
        j = np.arange(1, self.waves + 1)
        return ("line", "line", *(f"band{np.searchsorted(BAND_EDGES, k)}" for k in j))

    def values(self, x: Array) -> Array:
        u = np.clip((np.asarray(x, dtype=float) - self.centre) / self.half, -1.0, 1.0)
        j = np.arange(1, self.waves + 1)
        waves = np.sin(np.pi / (2 * WIDENING) * np.multiply.outer(u + WIDENING, j)) / j
        return np.concatenate([np.ones((len(u), 1)), u[:, None], waves], axis=1)

    def as_dict(self) -> dict[str, Any]:
        return {"kind": "smooth", "centre": self.centre, "half": self.half, "waves": self.waves}


@dataclass(frozen=True)
class Polynomial:
    """Powers 0 … degree of u = (x − centre)/half; compliances of beams are cubic in their free length."""

    centre: float
    half: float
    degree: int

    @property
    def size(self) -> int:
        return self.degree + 1

    @property
    def bands(self) -> tuple[str, ...]:
        return ("line", *("shape",) * self.degree)

    def values(self, x: Array) -> Array:
        u = np.clip((np.asarray(x, dtype=float) - self.centre) / self.half, -1.0, 1.0)
        return np.asarray(np.polynomial.legendre.legvander(u, self.degree))

    def as_dict(self) -> dict[str, Any]:
        return {"kind": "polynomial", "centre": self.centre, "half": self.half, "degree": self.degree}


@dataclass(frozen=True)
class Interpolated:
    """Values at sampled positions, straight lines between them, held beyond the first and last: the paper's form."""

    knots: tuple[float, ...]

    @property
    def size(self) -> int:
        return len(self.knots)

    @property
    def bands(self) -> tuple[str, ...]:
        return ("knots",) * self.size

    def values(self, x: Array) -> Array:
        knots = np.asarray(self.knots)
        x = np.clip(np.asarray(x, dtype=float), knots[0], knots[-1])
        out = np.zeros((len(x), len(knots)))
        right = np.clip(np.searchsorted(knots, x, side="right"), 1, max(1, len(knots) - 1))
        if len(knots) == 1:
            return np.ones((len(x), 1))
        share = (x - knots[right - 1]) / (knots[right] - knots[right - 1])
        rows = np.arange(len(x))
        out[rows, right - 1] = 1.0 - share
        out[rows, right] += share
        return out

    def as_dict(self) -> dict[str, Any]:
        return {"kind": "interpolated", "knots": list(self.knots)}


def basis_from_dict(data: dict[str, Any]) -> Basis:
    """The inverse of `as_dict`. Raises KeyError or TypeError on data that no basis wrote."""
    fields = {k: v for k, v in data.items() if k != "kind"}
    if data["kind"] == "interpolated":
        return Interpolated(tuple(float(k) for k in fields["knots"]))
    kinds: dict[str, type[Constant] | type[Smooth] | type[Polynomial]] = {
        "constant": Constant, "smooth": Smooth, "polynomial": Polynomial,
    }  # fmt: skip
    return kinds[data["kind"]](**fields)
