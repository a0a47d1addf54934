"""What scatters: the machine's pose repeatability, common to all targets of a visit, and the instrument's own noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
# Steps of expectation-maximisation per round; it converges slowly, but few rounds start far away.
EM_STEPS = 10


@dataclass(frozen=True)
class Noise:
    """pose (6, 6) covariance of the end effector's displacement about its origin, base axes [m², m·rad, rad²];
    instrument: standard deviation per coordinate [m]."""

    pose: Array
    instrument: float

    def covariance(self, levers: Array, seen: Mask, weights: Array) -> Array:
        """Covariance of one visit's coordinates, for every visit.

        levers   (N, T, 3, 6)
        seen     (N, T)       lost targets get unit variance and no correlation
        weights  (N,)         a visit of weight w counts as w visits
        returns  (N, 3T, 3T)  [m²]
        """
        count, size = seen.shape
        b = levers.reshape(count, 3 * size, 6)
        out = b @ self.pose @ np.swapaxes(b, 1, 2) + self.instrument**2 * np.eye(3 * size)
        out = out / weights[:, None, None]
        rows = np.repeat(seen, 3, axis=1)
        out = out * (rows[:, :, None] & rows[:, None, :])
        k = np.arange(3 * size)
        out[:, k, k] += ~rows
        return np.asarray(out)

    def close_to(self, other: Noise) -> bool:
        """Within 3 %: closer than a recording can tell."""
        atol = 1e-3 * float(np.abs(other.pose).max())
        return bool(np.allclose(self.pose, other.pose, rtol=0.03, atol=atol))


def pose_rank(seen: Mask) -> int:
    """How many of the six displacement components a visit's targets determine: 3 with one target, 6 with three."""
    return 3 if int(seen.sum(axis=1).max()) < 3 else 6


class NoiseUpdate:
    """Collects the residuals of all visits, block by block, and says what noise they speak of.

    settled  False: a first idea from moments; True: expectation-maximisation from the noise so far
    Only second moments are kept, per visit 3T × 3T numbers.
    """

    def __init__(self, noise: Noise, seen: Mask, settled: bool) -> None:
        self._noise, self._settled = noise, settled
        self._rank = pose_rank(seen)
        self._most = int(seen.sum(axis=1).max())
        self._blocks: list[tuple[Array, Mask, Array]] = []
        self._shared: list[tuple[Array, Array, Array]] = []

    def add(self, levers: Array, seen: Mask, residual: Array, spread: Array, weights: Array) -> None:
        """levers (n, T, 3, 6); seen (n, T); residual (n, 3T); spread (n, 3T, 3T) of the model; weights (n,)."""
        if self._settled:
            second = weights[:, None, None] * (residual[:, :, None] * residual[:, None, :] + spread)
            self._blocks.append((levers, seen, second))
        else:
            self._shared.append(_moments(levers, seen, residual, self._rank, self._most))

    def result(self) -> Noise:
        return self._maximise() if self._settled else self._first()

    def _first(self) -> Noise:
        u, inverse2, rest2 = (np.concatenate(parts) for parts in zip(*self._shared, strict=True))
        return first_moments(u, inverse2, rest2, self._noise.instrument, self._rank, self._most)

    def _maximise(self) -> Noise:
        noise = self._noise
        visits = sum(len(seen) for _, seen, _ in self._blocks)
        readings = 3 * sum(int(seen.sum()) for _, seen, _ in self._blocks)
        for _ in range(EM_STEPS):
            pose, instrument = np.zeros((6, 6)), 0.0
            for levers, seen, second in self._blocks:
                more_pose, more = _expect(noise, levers, seen, second, self._rank)
                pose += more_pose
                instrument += more
            pose = noise.pose + pose / visits
            sigma2 = noise.instrument**2
            if self._rank == 6:
                sigma2 = float(np.clip(sigma2 + instrument / readings, 0.04 * sigma2, 25 * sigma2))
            noise = Noise(0.5 * (pose + pose.T), float(np.sqrt(sigma2)))
        return noise


def _expect(noise: Noise, levers: Array, seen: Mask, second: Array, rank: int) -> tuple[Array, float]:
    """One E step over a block: what its residuals add to the pose covariance and the instrument's variance (sums)."""
    rows = np.repeat(seen, 3, axis=1)
    b = levers.reshape(*rows.shape, 6) * rows[..., None]
    if rank < 6:
        b = b * (np.arange(6) < 3)
    covariance = noise.covariance(levers, seen, np.ones(len(seen)))
    precision = np.linalg.inv(covariance)
    gain = noise.pose @ np.swapaxes(b, 1, 2) @ precision  # (n, 6, 3T)
    excess = second - covariance * (rows[:, :, None] & rows[:, None, :])
    pose = (gain @ excess @ np.swapaxes(gain, 1, 2)).sum(axis=0)
    if rank < 6:
        return pose, 0.0
    change = precision @ excess @ precision * noise.instrument**4
    return pose, float(np.trace(change * rows[:, :, None], axis1=1, axis2=2).sum())


def _moments(levers: Array, seen: Mask, residual: Array, rank: int, most: int) -> tuple[Array, Array, Array]:
    """Of the visits with most targets: displacement (n, rank), its noise amplification, squared rest (n,)."""
    full = seen.sum(axis=1) == most
    rows = np.repeat(seen, 3, axis=1)
    b = (levers.reshape(*rows.shape, 6) * rows[..., None])[full][:, :, :rank]
    inverse = np.linalg.pinv(b)
    u = np.einsum("nki,ni->nk", inverse, residual[full])
    rest = residual[full] - np.einsum("nik,nk->ni", b, u)
    return u, inverse @ np.swapaxes(inverse, 1, 2), (rest**2).sum(axis=1)


def first_moments(u: Array, inverse2: Array, rest2: Array, instrument: float, rank: int, most: int) -> Noise:
    """A first idea of the noise: what targets of a visit share, and what they do not.

    With fewer than three targets the two cannot be told apart: the instrument keeps its stated noise (or all that
    there is, where that is less) and the pose takes the rest.
    """
    # the middle of the squares, so that a gross outlier does not shape the first guess
    size = np.einsum("nk,kl,nl->n", u, np.linalg.pinv(u.T @ u / len(u)), u)
    core = size <= np.quantile(size, 0.95)
    shared = u[core].T @ u[core] / core.sum()
    freedom = 3 * most - rank
    if freedom > 0:
        instrument = float(np.sqrt(max(np.median(rest2) / freedom, 1e-16)))
    else:
        instrument = min(instrument, float(np.sqrt(max(np.linalg.eigvalsh(shared)[0], 1e-16))))
    values, vectors = np.linalg.eigh(shared - instrument**2 * inverse2.mean(axis=0))
    values = np.maximum(values, 0.01 * instrument**2)
    pose = np.zeros((6, 6))
    pose[:rank, :rank] = (vectors * values) @ vectors.T
    return Noise(pose, instrument)
