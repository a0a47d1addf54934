"""What the residuals of a solution say about the noise, about outliers, and how far predictions moved."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas

from ppshw.identification.noise import Noise, first_noise
from ppshw.identification.noise_fit import Form, Moments, choose, fit
from ppshw.identification.strengths import Posterior
from ppshw.identification.visits import White

Array = NDArray[np.float64]


class Judgement:
    """Collects the visits block by block.

    moved  most that a coordinate moved since the last round, in units of its noise;  far: since θ₀ [m]
    """

    def __init__(self, count: int, size: int, own: Array) -> None:
        """count visits of size coordinates; own: as in `Moments`."""
        self._own = own
        self.moved = self.far = 0.0
        self._near = np.zeros(count)
        self._second = np.zeros((count, size, size))
        self._residual = np.zeros((count, size))
        self._rest2, self._freedom, self._weights = np.zeros(count), np.zeros(count), np.ones(count)
        self._levers = np.zeros((0, size, 0))
        self._live = np.zeros((count, size), dtype=bool)

    def add(self, white: White, posterior: Posterior, moved: Array, since: Array, weights: Array) -> None:
        """moved, since (p,): how far θ went since the last round and since θ₀;  weights (count,)."""
        block, where = white.block, white.block.visits
        w = weights[where]
        left = white.data - white.design @ posterior.theta
        spread = _spread(white.design, posterior.root)
        # a distance counts the model's uncertainty too, and a visit in full however much it was believed
        whole = np.eye(left.shape[1]) + spread / w[:, None, None]
        self._near[where] = np.einsum("ni,ni->n", left, np.linalg.solve(whole, left[..., None])[..., 0]) / w
        self._second[where] = white.colour(left[:, :, None] * left[:, None, :] + spread) * w[:, None, None]
        self._residual[where] = (white.lower @ left[..., None])[..., 0]
        self.moved = max(self.moved, float(np.abs(white.design @ moved).max(initial=0.0)))
        far = white.lower @ (white.design @ since)[..., None]
        self.far = max(self.far, float(np.abs(far).max(initial=0.0)))
        if not self._levers.size:
            self._levers = np.zeros((*self._residual.shape, block.levers.shape[2]))
        self._levers[where], self._live[where] = block.levers, block.live
        self._rest2[where], self._freedom[where], self._weights[where] = block.rest2, block.freedom, w

    def distance(self, noise: Noise) -> Array:
        """(count,) squared Mahalanobis distance of every visit, the model's own uncertainty included."""
        return self._near + self._rest2 / noise.instrument**2

    def first_noise(self, before: Noise, rank: int) -> Noise:
        freedom = self._freedom.astype(np.int64)
        return first_noise(self._levers[..., :6], self._live, self._residual, self._rest2, freedom, before, rank)

    def noise(self, before: Noise, rank: int, form: Form | None) -> tuple[Form, Noise, float]:
        """The most likely noise, of the form given or the best one; and by how much twice the log likelihood grew."""
        count = np.ones(len(self._near))
        moments = Moments(
            self._levers, self._live, self._second, count, float(self._weights @ self._rest2), self._freedom.sum(),
            self._own,
        )  # fmt: skip
        form, found = (form, fit(form, moments, before, rank)) if form else choose(moments, before, rank)
        return form, found, moments.likelihood(found) - moments.likelihood(before)


def level(before: Noise, after: Noise) -> float:
    """By what factor the noise's variance changed."""
    one, two = (float(np.trace(n.pose[:3, :3]) + n.instrument**2) for n in (before, after))
    return two / one


def _spread(design: Array, root: Array) -> Array:
    """X Cov θ Xᵀ of every visit, Cov θ = rootᵀ root: (n, K, p), (p, p) lower triangular → (n, K, K).

    In single precision: six digits of a variance are plenty, and it is half the time.
    """
    count, size, number = design.shape
    if number == 0:
        return np.zeros((count, size, size))
    flat = design.reshape(-1, number).astype(np.float32)
    half = blas.strmm(1.0, np.asfortranarray(root, dtype=np.float32), flat.T, side=0, lower=1, overwrite_b=1)
    half = half.T.reshape(count, size, number)
    return np.asarray(half @ np.swapaxes(half, 1, 2), dtype=float)
