"""What visits would teach: the posterior covariance of the model, exactly, visit by visit.

In coordinates z = θ/strength the prior is N(0, I). A visit with white rows W (k, r) changes the covariance P by rank k:

    K = P Wᵀ (I ± W P Wᵀ)^(-½),   P ← P ∓ K Kᵀ        (upper sign: the visit is made, lower: it is taken out again)

The mean variance of the point of interest over the work is tr(M P), and a visit takes tr((I + W P Wᵀ)⁻¹ W P M P Wᵀ)
off it; `Pool` keeps both factors for thousands of visits that might be made. docs/design.md §1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.stats import qmc

from campaigns.design.belief import Belief
from campaigns.design.loads import LoadRange, wrench
from ppshw.terms import Situation
from ppshw.verification import QUANTILE

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
# Directions that all candidates together would hardly see (their information, summed, against the prior's 1) are no
# choice's business: they keep their prior.
UNSEEN = 0.03
TESTS = 512
DRAWS = 64
CHUNK = 384


@dataclass(frozen=True)
class Work:
    """Where accuracy counts: a point at poses all over the joints' travel, under loads of the range.

    rows   (T, 3, p)  how the point moves with z                        [m]
    noise  (T, 3, 3)  how it scatters there, as a tracker would see it  [m²]
    """

    rows: Array
    noise: Array


def work_of(belief: Belief, point: Array, loads: LoadRange) -> Work:
    """TESTS poses spread evenly (scrambled Sobol, always the same) over the limits, each under a load of its own."""
    machine = belief.machine
    low, high = machine.limits()
    spread = qmc.Sobol(machine.n + 4, rng=np.random.default_rng(0)).random(TESTS)
    q = low + spread[:, : machine.n] * (high - low)
    mass = loads.mass[0] + spread[:, machine.n] * (loads.mass[1] - loads.mass[0])
    centre = np.array(loads.low) + spread[:, machine.n + 1 :] * (np.array(loads.high) - np.array(loads.low))
    lin = belief.model.linearise(Situation(q, wrench(machine, q, mass, centre)), belief.theta, point[None])
    noise = belief.noise.covariance(lin.levers, np.ones((TESTS, 1), dtype=bool), np.ones(TESTS))
    return Work(lin.design[:, 0] * belief.strengths, noise)


def visible(rows: Array) -> Array:
    """(p, r) orthonormal directions of z that candidate visits (C, k, p) can see at all."""
    flat = rows.reshape(-1, rows.shape[2])
    values, vectors = np.linalg.eigh(flat.T @ flat)
    return np.asarray(vectors[:, values > UNSEEN])


@dataclass(frozen=True)
class Step:
    """One visit made (sign −1) or taken out (+1): P ← P + sign K Kᵀ.   (D2)

    seed (r, k) Wᵀ (I ± W P Wᵀ)^(-½);  gain (r, k) K = P seed
    """

    seed: Array
    gain: Array
    sign: float


class Posterior:
    """Covariance P (r, r) of the visible directions; `unseen` is what the others add to the point's variance."""

    def __init__(self, work: Work, basis: Array) -> None:
        self.work, self.basis = work, basis
        flat = work.rows.reshape(-1, len(basis))
        self._rows = flat @ basis
        self.metric = self._rows.T @ self._rows / len(work.rows)  # M: tr(M P) is the mean variance [m²]
        rest = work.rows - (self._rows @ basis.T).reshape(work.rows.shape)
        self._unseen = rest @ np.swapaxes(rest, 1, 2)
        self.covariance = np.eye(basis.shape[1])

    def step(self, rows: Array, made: bool = True) -> Step:
        """What making one visit (k, r) will change, or taking it out again."""
        sign = 1.0 if made else -1.0
        half = rows @ self.covariance
        # a visit taken out leaves I − W P Wᵀ, positive as long as it was made before
        root = cholesky(np.eye(len(rows)) + sign * half @ rows.T, lower=True)
        seed, gain = (solve_triangular(root, part, lower=True).T for part in (rows, half))
        return Step(np.asarray(seed), np.asarray(gain), -sign)

    def take(self, step: Step) -> None:
        self.covariance += step.sign * step.gain @ step.gain.T

    def add_all(self, rows: Array) -> None:
        """Many visits (N, k, r) at once."""
        flat = rows.reshape(-1, rows.shape[2])
        self.add_information(flat.T @ flat)

    def add_information(self, more: Array) -> None:
        """Wᵀ W (r, r) of any number of visits."""
        found = np.linalg.inv(np.linalg.inv(self.covariance) + more)
        self.covariance = 0.5 * (found + found.T)

    def spread(self) -> Array:
        """How far the model may be off the point over the work: covariances (T, 3, 3) [m²]."""
        rows = self._rows.reshape(self._unseen.shape[0], 3, -1)
        seen = (self._rows @ self.covariance).reshape(rows.shape) @ np.swapaxes(rows, 1, 2)
        return np.asarray(seen + self._unseen)

    def accuracy(self) -> tuple[float, float]:
        """98.6 % of the distance between model and point over the work, without and with noise [m]."""
        spread = self.spread()
        return quantile(spread), quantile(spread + self.work.noise)


def quantile(covariances: Array) -> float:
    """98.6 % of |x|, x ~ N(0, Σ_t) with t any of the tests; covariances (T, 3, 3)."""
    values, vectors = np.linalg.eigh(covariances)
    draws = np.random.default_rng(0).normal(size=(len(values), DRAWS, 3))
    x = draws * np.sqrt(np.maximum(values, 0.0))[:, None] @ np.swapaxes(vectors, 1, 2)
    return float(np.quantile(np.linalg.norm(x, axis=2), QUANTILE))


class Pool:
    """Visits that might be made, and what each of them would take off the mean variance.

    W (C, k, r) their rows. Kept: A = W P, S = W P Wᵀ and Q = W P M P Wᵀ, brought up to date with every visit made.
    """

    def __init__(self, rows: Array, posterior: Posterior) -> None:
        self.rows = rows
        self._posterior = posterior
        count, k, r = rows.shape
        self._a = rows.reshape(-1, r) @ posterior.covariance
        a = self._a.reshape(rows.shape)
        self._s = a @ np.swapaxes(rows, 1, 2)
        self._q = (self._a @ posterior.metric).reshape(count, k, r) @ np.swapaxes(a, 1, 2)

    def gains(self) -> Array:
        """(C,) what each visit would take off the mean variance [m²]."""
        k = self._s.shape[1]
        solved = np.linalg.solve(np.eye(k) + self._s, self._q)
        return np.asarray(np.trace(solved, axis1=1, axis2=2))

    def follow(self, step: Step) -> None:
        """Bring all up to date with a step; call before `Posterior.take`."""
        gain, pull = step.gain, self._posterior.metric @ step.gain
        both = np.hstack([step.seed, pull])
        seen = np.empty((len(self._a), both.shape[1]))
        for start in range(0, len(self._a), CHUNK):  # in pieces that stay in the cache
            piece = self._a[start : start + CHUNK]
            np.matmul(piece, both, out=seen[start : start + CHUNK])
            piece += (step.sign * seen[start : start + CHUNK, : gain.shape[1]]) @ gain.T
        u, v = np.split(seen.reshape(*self._s.shape[:2], -1), [gain.shape[1]], axis=2)  # W K and W P M K
        ut = np.swapaxes(u, 1, 2)
        cross = v @ ut
        self._q += step.sign * (cross + np.swapaxes(cross, 1, 2)) + u @ (gain.T @ pull) @ ut
        self._s += step.sign * u @ ut
