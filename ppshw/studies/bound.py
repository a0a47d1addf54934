"""The Bayesian Cramér-Rao bound: what any estimate must miss, given the visits, the noise and the kind of machine.

    E (θ̂ − θ)(θ̂ − θ)ᵀ  ≥  (Λ⁻¹ + Σ_v X_vᵀ R_v⁻¹ X_v)⁻¹                                          (8.1)

X_v is the linearised model (17) of visit v, R_v the covariance of its readings as it really is, Λ the covariance of the
error functions over machines of this kind, mean and covariance known. Van Trees (1968), Detection, Estimation and
Modulation Theory I, §2.4; Gill & Levit (1995), Applications of the van Trees inequality. docs/derivations.md §8 says
what it bounds: every estimate if the functions were Gaussian, every linear one as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, cholesky, solve_triangular

from ppshw.errors import IdentificationFailed
from ppshw.evaluation import figures
from ppshw.kinematics import frames, point_jacobian
from ppshw.machine import Machine
from ppshw.model import Model
from ppshw.recording import Recording
from ppshw.terms import FrameTerm, Situation
from ppshw.terms.basis import Basis, Constant, Polynomial, Smooth
from ppshw.terms.elastic import Compliance, pattern
from ppshw.terms.geometric import Geometric

Array = NDArray[np.float64]
# Enough for a wave of 0.6 travels, the shortest there is, to some nanometres.
WAVES, DEGREE = 24, 3
# Directions of the prior smaller than this against its largest are no freedom at all.
RANK_TOLERANCE = 1e-7
DRAWS = 300


@dataclass(frozen=True)
class Functions:
    """One machine's true error functions at given positions of each joint.

    geometric   per joint (G, 6)      ε_g [m, rad]
    compliance  per joint (G, 6, 6)   C   [m/N, …]; None: rigid
    """

    geometric: Sequence[Array]
    compliance: Sequence[Array | None]


def positions(machine: Machine, count: int = 121) -> list[Array]:
    """Per joint (G,) equally spaced over its travel."""
    limits = [joint.limits for joint in machine.joints]
    return [np.linspace(limit.lower, limit.upper, count) for limit in limits if limit is not None]


def rich_model(machine: Machine) -> Model:
    """Model (17) over the whole travels, rich enough for the functions themselves; no error of the base."""
    travels = positions(machine, 2)
    terms: list[FrameTerm] = [
        Geometric(k + 1, Smooth(float(t.mean()), float(np.ptp(t)) / 2, WAVES)) for k, t in enumerate(travels)
    ]
    for k, joint in enumerate(machine.joints):
        if joint.elastic is not None:
            basis: Basis = Constant()
            if joint.elastic.varies:
                basis = Polynomial(float(travels[k].mean()), float(np.ptp(travels[k])) / 2, DEGREE)
            terms.append(Compliance(k + 1, pattern(joint.elastic), tuple(joint.elastic.load_indices), basis))
    return Model(machine, tuple(terms))


@dataclass(frozen=True)
class Ensemble:
    """What machines of a kind are like: θ = mean + factor z, z uncorrelated with unit variance.

    mean (p,), factor (p, k);  unrepresented: rms of what the basis misses of a function, relative to its own rms, by
    which the tests hold that the bound is of these machines and not of smoother ones
    """

    model: Model
    mean: Array
    factor: Array
    unrepresented: float

    @classmethod
    def of(cls, machine: Machine, machines: Sequence[Functions]) -> Ensemble:
        """Second moments over sampled machines.

        The three shifts of a joint are one kind of function, its three angles another, both of mean zero: their
        samples are pooled. Compliances have a mean, and a covariance over all links together.
        """
        model, grid = rich_model(machine), positions(machine)
        factors: list[Array] = []
        elastic: list[Array] = []
        missed = 0.0
        for term in model.terms:
            if isinstance(term, Geometric):
                values = term.basis.values(grid[term.frame - 1])
                samples = np.stack([m.geometric[term.frame - 1] for m in machines])  # (M, G, 6)
                for kind in (samples[..., :3], samples[..., 3:]):
                    flat = np.moveaxis(kind, 1, 2).reshape(-1, len(values))
                    coefficients, left = _projected(values, flat)
                    missed = max(missed, left)
                    half = _factor(coefficients / np.sqrt(len(flat)))
                    factors.append(block_diag(half, half, half))
            elif isinstance(term, Compliance):
                values = term.basis.values(grid[term.frame - 1])
                samples = np.stack([_matrix(m.compliance[term.frame - 1], len(values)) for m in machines])
                chosen = np.stack([samples[:, :, a, b] for a, b in term.elements], axis=1)  # (M, elements, G)
                coefficients, left = _projected(values, chosen.reshape(-1, len(values)))
                missed = max(missed, left)
                elastic.append(coefficients.reshape(len(machines), -1))
        together = np.concatenate(elastic, axis=1) if elastic else np.zeros((len(machines), 0))
        geometric = block_diag(*factors)
        mean = np.concatenate([np.zeros(len(geometric)), together.mean(axis=0)])
        spread = _factor((together - together.mean(axis=0)) / np.sqrt(max(len(machines) - 1, 1)))
        return cls(model, mean, block_diag(geometric, spread), missed)


def _matrix(compliance: Array | None, count: int) -> Array:
    return np.zeros((count, 6, 6)) if compliance is None else compliance


def _projected(values: Array, functions: Array) -> tuple[Array, float]:
    """Least-squares coefficients (F, m) of functions (F, G) on values (G, m), and the relative rms that they miss."""
    coefficients = np.linalg.lstsq(values, functions.T, rcond=None)[0].T
    size = float(np.sqrt((functions**2).mean()))
    left = float(np.sqrt(((functions - coefficients @ values.T) ** 2).mean()))
    return np.asarray(coefficients), left / size if size else 0.0


def _factor(samples: Array) -> Array:
    """(m, k) F with F Fᵀ = samplesᵀ samples; columns (units) are evened out before small directions are dropped."""
    size = np.sqrt((samples**2).sum(axis=0))
    _, s, v = np.linalg.svd(samples / np.where(size > 0, size, 1.0), full_matrices=False)
    kept = s > RANK_TOLERANCE * s[:1].sum()
    return np.asarray(size[:, None] * v[kept].T * s[kept])


@dataclass(frozen=True)
class Bound:
    """half (V, 3, k): the least error of a point on V visits is N(0, half halfᵀ)   [m]."""

    half: Array

    @property
    def rms_mm(self) -> float:
        """Of the point's Euclidean error, without repeatability and tracker."""
        return float(np.sqrt((self.half**2).sum() / len(self.half)) * 1e3)

    def figures(self, noise: Array, seed: int = 0) -> dict[str, float]:
        """Of the residual that the bound leaves on visits whose noise (V, 3) was this; medians over draws [mm]."""
        rng = np.random.default_rng([seed, 23])
        drawn = [figures(noise + self.half @ rng.normal(size=self.half.shape[2])) for _ in range(DRAWS)]
        return {key: float(np.median([one[key] for one in drawn])) for key in drawn[0]}


def bound(ensemble: Ensemble, train: Recording, test: Recording, point: Array, scatter: Array) -> Bound:
    """Equation (8.1), carried to a point (3,) of the end effector on the visits of `test`.

    scatter  (n, 6) one standard deviation of each link's random part at an arrival, in its own frame    [m, rad]
    """
    model, mean = ensemble.model, ensemble.mean
    lin = model.linearise(Situation.of(train), mean)
    count, size = len(train), 3 * len(train.target_names)
    rows = np.repeat(train.seen, 3, axis=1)
    design = lin.design.reshape(count, size, -1) @ ensemble.factor * rows[..., None]
    covariance = _of_readings(model, mean, train, lin.positions, scatter)
    covariance = np.where(rows[:, :, None] & rows[:, None, :], covariance, np.eye(size))
    white = (np.linalg.inv(np.linalg.cholesky(covariance)) @ design).reshape(count * size, -1)
    precision = white.T @ white
    precision[np.diag_indices_from(precision)] += 1.0
    try:
        root = cholesky(precision, lower=True)
    except np.linalg.LinAlgError as exc:
        raise IdentificationFailed(f"{train.source}: the bound's information is singular ({exc})") from None
    there = model.linearise(Situation.of(test), mean, point[None]).design[:, 0] @ ensemble.factor
    half = solve_triangular(root, there.reshape(-1, there.shape[-1]).T, lower=True).T
    return Bound(half.reshape(there.shape))


def _of_readings(model: Model, theta: Array, train: Recording, points: Array, scatter: Array) -> Array:
    """(N, 3T, 3T) covariance of a visit's readings: what each link's random part does to them, and the tracker."""
    situation = Situation.of(train)
    errors, _ = model.errors(situation, theta)
    chain = frames(model.machine, situation.q, errors)
    jacobian = point_jacobian(chain, points, errors).reshape(len(train), points.shape[1] * 3, -1, 6)
    moved = (jacobian[:, :, 1:] * scatter).reshape(len(train), jacobian.shape[1], -1)
    return np.asarray(
        moved @ np.swapaxes(moved, 1, 2) + model.machine.tracker.position_sigma**2 * np.eye(moved.shape[1])
    )
