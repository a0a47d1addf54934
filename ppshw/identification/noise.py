"""What scatters: the machine's pose repeatability, common to all targets of a visit, and the instrument's own noise.

The pose scatters in one of several ways, whichever the recording makes more likely: the end effector by one 6 × 6
covariance wherever it stands, or joints by variances of their own, which reach the end effector through the pose, alone
or beside the end effector's. docs/derivations.md §5.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Noise:
    """pose (6, 6) covariance of the end effector's displacement about its origin, base axes [m², m·rad, rad²];
    instrument: standard deviation per coordinate [m];
    parts (1 + n, 6) variances of the random part of the end effector's displacement (base axes) and of every joint's
    generalized errors (its own frame) [m², rad²], where that is the better description: `pose` is then the mean over
    the recording's visits, for people to read."""

    pose: Array
    instrument: float
    parts: Array | None = None

    @property
    def repeatability(self) -> float:
        """rms of a reading by pose repeatability alone [m]."""
        return float(np.sqrt(np.trace(self.pose[:3, :3])))

    def covariance(self, levers: Array, seen: Mask, weights: Array) -> Array:
        """Covariance of one visit's coordinates, for every visit.

        levers   (N, T, 3, 6 + 6n) of `Model.linearise`, or the first 6 alone: then the mean pose covariance counts
        seen     (N, T)       lost targets get unit variance and no correlation
        weights  (N,)         a visit of weight w counts as w visits
        returns  (N, 3T, 3T)  [m²]
        """
        count, size = seen.shape
        return self.of_rows(levers.reshape(count, 3 * size, -1), np.repeat(seen, 3, axis=1), weights)

    def of_rows(self, levers: Array, live: Mask, weights: Array) -> Array:
        """The same for any coordinates on which the instrument's noise is white: levers (N, K, 6 + 6n), live (N, K)."""
        out = self.of_pose(levers)
        k = np.arange(live.shape[1])
        out[:, k, k] += self.instrument**2
        out /= weights[:, None, None]
        if not live.all():
            out *= live[:, :, None] & live[:, None, :]
            out[:, k, k] += ~live
        return out

    def whitener(self, levers: Array, seen: Mask) -> Array:
        """(N, 3T, 3T) L⁻¹ of the covariance of every visit's readings, 0 for lost targets."""
        root = np.linalg.inv(np.linalg.cholesky(self.covariance(levers, seen, np.ones(len(seen)))))
        rows = np.repeat(seen, 3, axis=1)
        return np.asarray(root * (rows[:, :, None] & rows[:, None, :]))

    def scatter(self, levers: Array) -> Array:
        """(N, K, f) what a standard deviation of each freedom in which the machine scatters does."""
        if self.parts is None or levers.shape[2] == 6:
            return np.asarray(levers[..., :6] @ half(self.pose))
        variances = self.parts.ravel()
        return np.asarray(levers[..., variances > 0] * np.sqrt(variances[variances > 0]))

    def of_pose(self, levers: Array) -> Array:
        """The pose's part alone: (N, K, K)."""
        if self.parts is None or levers.shape[2] == 6:
            b = levers[..., :6]
            return np.asarray(b @ self.pose @ np.swapaxes(b, 1, 2))
        b = self.scatter(levers)
        return np.asarray(b @ np.swapaxes(b, 1, 2))


def half(covariance: Array) -> Array:
    """A square root; what rounding made negative is nothing."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def pose_rank(seen: Mask) -> int:
    """How many of the six displacement components a visit's targets determine: 3 with one target, 6 with three."""
    return 3 if int(seen.sum(axis=1).max()) < 3 else 6


def first_noise(
    levers: Array, live: Mask, residual: Array, rest2: Array, freedom: NDArray[np.int64], before: Noise, rank: int
) -> Noise:
    """A first idea of the noise from the residuals' moments: what targets of a visit share, and what they do not.

    Only visits with the most coordinates count, and of them the middle of the squares, so that a gross outlier does not
    shape it. With fewer than three targets the two cannot be told apart: the instrument keeps its stated noise (or all
    that there is, where that is less) and the pose takes the rest.

    levers (n, K, 6);  live (n, K);  residual (n, K) [m];  rest2, freedom (n,): squared length and number of the
    coordinates that no motion of the end effector reaches
    """
    known = live.sum(axis=1) + freedom
    full = known == known.max()
    b = levers[full][:, :, :rank] * live[full][..., None]
    r, squares = residual[full] * live[full], rest2[full]
    inverse = np.linalg.pinv(b)
    u = np.einsum("nki,ni->nk", inverse, r)
    squares = squares + ((r - np.einsum("nik,nk->ni", b, u)) ** 2).sum(axis=1)
    size = np.einsum("nk,kl,nl->n", u, np.linalg.pinv(u.T @ u / len(u)), u)
    core = size <= np.quantile(size, 0.95)
    shared = u[core].T @ u[core] / core.sum()
    free = int(known.max()) - rank
    if free > 0:
        instrument = float(np.sqrt(max(np.median(squares) / free, 1e-16)))
    else:
        instrument = min(before.instrument, float(np.sqrt(max(np.linalg.eigvalsh(shared)[0], 1e-16))))
    amplified = (inverse @ np.swapaxes(inverse, 1, 2)).mean(axis=0)
    values, vectors = np.linalg.eigh(shared - instrument**2 * amplified)
    values = np.maximum(values, 0.01 * instrument**2)
    pose = np.zeros((6, 6))
    pose[:rank, :rank] = (vectors * values) @ vectors.T
    return Noise(pose, instrument)
