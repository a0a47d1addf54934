"""The joint estimate: model (17) from all visits at once, prior strengths and noise learnt from the data.

    y = X θ + u + e,   θ ~ N(0, Λ),   u: pose repeatability of a visit,   e: instrument noise

Λ has one variance per group of parameters. Variances follow MacKay's fixed point of the marginal likelihood (MacKay
1992, Bayesian interpolation), noise follows its expectation-maximisation step (Dempster et al. 1977); around both, X is
rebuilt with the exact product until the prediction stands still. docs/derivations.md §5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, lapack
from scipy.stats import chi2

from ppshw.errors import IdentificationFailed
from ppshw.identification.noise import Noise, pose_rank
from ppshw.identification.start import align, fold, to_base
from ppshw.machine import Machine
from ppshw.model import Model
from ppshw.recording import Recording
from ppshw.terms import Situation
from ppshw.transforms import from_xyz_rpy

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
# Prior variances stay within these factors of where they start (as variances): from nothing to some 30 mm and 15 mrad.
# Without the upper one, errors of parallel axes that cancel each other may grow to metres while noise is still unknown.
SMALLEST, LARGEST = 1e-10, 1e3
# The first idea of the noise is this share of what the ideal machine misses: signal is believed step by step.
FIRST_NOISE_SHARE = 0.2


@dataclass(frozen=True)
class Estimate:
    """What a recording says of a model.

    theta, covariance   (p,), (p, p) posterior mean and covariance
    groups              prior standard deviation of every group
    noise               pose repeatability and instrument noise
    measuring_in_base   (4, 4) where the measuring frame stands
    weights             (N,) 1 for a visit that was believed, less for an outlier
    """

    model: Model
    theta: Array
    covariance: Array
    groups: dict[str, float]
    noise: Noise
    measuring_in_base: Array
    weights: Array


@dataclass
class _State:
    theta: Array
    variances: Array  # per group
    noise: Noise
    weights: Array
    frame: Array


class _System:
    """One linearisation: whitened design and data of all visits, and the normal equations."""

    def __init__(self, model: Model, situation: Situation, measured: Array, seen: NDArray[np.bool_], state: _State):
        lin = model.linearise(situation, state.theta)
        count, size = seen.shape
        self.rows = np.repeat(seen, 3, axis=1)
        self.design = lin.design.reshape(count, 3 * size, -1) * self.rows[..., None]
        gap = np.where(seen[..., None], measured - lin.positions, 0.0).reshape(count, -1)
        self.data = gap + self.design @ state.theta
        self.levers = lin.levers
        self.seen = seen
        self.covariance = state.noise.covariance(lin.levers, seen, state.weights)
        lower = np.linalg.cholesky(self.covariance)
        stacked = np.concatenate([self.design, self.data[..., None]], axis=2)
        white = np.linalg.solve(lower, stacked).reshape(count * 3 * size, -1)
        gram = white.T @ white
        self.gram, self.moment, self.power = gram[:-1, :-1], gram[:-1, -1], float(gram[-1, -1])


def estimate(
    model: Model,
    recording: Recording,
    rounds: int = 12,
    progress: Progress | None = None,
) -> Estimate:
    """Identify a model from any recording: any poses, loads, targets; missing targets; position only.

    Raises IdentificationFailed when no visit has a target.
    """
    machine = model.machine
    seen = recording.seen
    if not seen.any():
        raise IdentificationFailed(f"{recording.source}: every target of every visit was lost")
    used = np.asarray(seen.any(axis=1))
    recording, seen = recording.subset(used), seen[used]
    model, frame = _start(model, recording)
    situation = Situation.of(recording)
    group_of, names, scale, start = _groups(model)
    theta = np.zeros(len(scale))
    gap = (to_base(recording.points, frame) - model.predict(situation, theta))[seen]
    state = _State(theta, start**2, _first_noise(machine, gap), np.ones(len(seen)), frame)
    z = state.theta
    covariance = np.zeros((len(z), len(z)))
    for turn in range(rounds):
        if progress:
            progress(turn, rounds)
        measured = to_base(recording.points, state.frame)
        system = _System(model, situation, measured, seen, state)
        settled = turn >= 2
        before = system.design @ state.theta
        for _ in range(8 if settled else 4):
            prior = scale * np.sqrt(state.variances[group_of])
            z, zz = _solve(system.gram, system.moment, prior)
            _update_variances(state, z, np.diag(zz), group_of, start)
        prior = scale * np.sqrt(state.variances[group_of])
        z, zz = _solve(system.gram, system.moment, prior)
        state.theta, covariance = prior * z, prior[:, None] * zz * prior
        old_noise = state.noise
        residual = system.data - system.design @ state.theta
        spread = system.design @ covariance @ np.swapaxes(system.design, 1, 2)
        state.noise = _update_noise(state, system, residual, spread) if settled else _moments(state, system, residual)
        if settled:
            state.weights = _believe(system, residual, spread, state.weights)
        moved = np.abs((system.design @ state.theta - before)[system.rows]).max()
        steady = np.allclose(old_noise.pose, state.noise.pose, rtol=0.03, atol=1e-3 * np.abs(state.noise.pose).max())
        if machine.tracker.base is None:
            state.theta, state.frame = _fold_base(model, state.theta, state.frame)
        if settled and moved < 2e-6 and steady:
            break
    if progress:
        progress(rounds, rounds)
    weights = np.zeros(len(used))
    weights[used] = state.weights
    groups = dict(zip(names, np.sqrt(state.variances).tolist(), strict=True))
    return Estimate(model, state.theta, covariance, groups, state.noise, state.frame, weights)


def _start(model: Model, recording: Recording) -> tuple[Model, Array]:
    machine = model.machine
    if machine.tracker.base is not None:
        return model, machine.tracker.base
    frame, targets = align(machine, recording, targets_free=not machine.tracker.targets_known)
    moved = machine.with_targets(dict(zip(machine.targets, targets, strict=True)))
    return replace(model, machine=moved), frame


def _first_noise(machine: Machine, gap: Array) -> Noise:
    """Before any fit: the maker's claim, or a share of what the ideal machine misses; gap (R, 3) [m]."""
    sigma = max((machine.repeatability or 1.4e-4) / 3, FIRST_NOISE_SHARE * float(np.sqrt((gap**2).mean())))
    return Noise(np.diag([sigma**2] * 6), machine.tracker.position_sigma)


def _groups(model: Model) -> tuple[NDArray[np.int64], list[str], Array, Array]:
    parameters = model.parameters()
    names = list(dict.fromkeys(p.group for p in parameters))
    group_of = np.array([names.index(p.group) for p in parameters])
    scale = np.array([p.scale for p in parameters])
    start = np.zeros(len(names))
    for p in parameters:
        start[names.index(p.group)] = p.start
    return group_of, names, scale, start


def _solve(gram: Array, moment: Array, prior: Array) -> tuple[Array, Array]:
    """Posterior mean and covariance of z = θ/prior, z ~ N(0, 1)."""
    precision = prior[:, None] * gram * prior
    precision[np.diag_indices_from(precision)] += 1.0
    factor = cho_factor(precision, lower=True)
    mean = cho_solve(factor, prior * moment)
    inverse, info = lapack.dpotri(factor[0], lower=1)
    if info != 0:
        raise IdentificationFailed(f"the normal equations are singular (dpotri {info})")
    return mean, np.tril(inverse) + np.tril(inverse, -1).T


def _update_variances(state: _State, z: Array, zz: Array, group_of: NDArray[np.int64], start: Array) -> None:
    """MacKay's step where the data speak, the slower EM step where they hardly do."""
    count = len(start)
    size = np.bincount(group_of, minlength=count)
    square = np.bincount(group_of, z**2, minlength=count)
    spread = np.bincount(group_of, zz, minlength=count)
    effective = size - spread
    fast = square / np.maximum(effective, 1e-12)
    slow = (square + spread) / size
    factor = np.where(effective > 0.05 * size, fast, slow)
    state.variances = np.clip(
        state.variances * np.clip(factor, 0.03, 30.0), SMALLEST * start**2, LARGEST * start**2
    )


def _moments(state: _State, system: _System, residual: Array) -> Noise:
    """A first idea of the noise from the residuals' moments: what targets of a visit share, and what they do not.

    With fewer than three targets the two cannot be told apart: the instrument keeps its stated noise (or all that there
    is, where that is less) and the pose takes the rest.
    """
    seen = system.seen.all(axis=1) if system.seen.all(axis=1).any() else system.seen.any(axis=1)
    rank = pose_rank(int(system.seen.sum(axis=1).max()))
    b = (system.levers.reshape(*system.rows.shape, 6) * system.rows[..., None])[seen][:, :, :rank]
    inverse = np.linalg.pinv(b)
    u = np.einsum("nki,ni->nk", inverse, residual[seen])
    # the middle of the squares, so that a gross outlier does not shape the first guess
    size = np.einsum("nk,kl,nl->n", u, np.linalg.pinv(u.T @ u / len(u)), u)
    core = size <= np.quantile(size, 0.95)
    shared = u[core].T @ u[core] / core.sum()
    instrument = state.noise.instrument
    freedom = b.shape[1] - rank
    if freedom > 0:
        rest = residual[seen] - np.einsum("nik,nk->ni", b, u)
        instrument = float(np.sqrt(np.median((rest**2).sum(axis=1)) / freedom))
    else:
        instrument = min(instrument, float(np.sqrt(np.linalg.eigvalsh(shared)[0])))
    shared = shared - instrument**2 * np.mean(inverse @ np.swapaxes(inverse, 1, 2), axis=0)
    values, vectors = np.linalg.eigh(shared)
    values = np.maximum(values, 0.01 * instrument**2)
    pose = np.zeros((6, 6))
    pose[:rank, :rank] = (vectors * values) @ vectors.T
    return Noise(pose, instrument)


def _update_noise(state: _State, system: _System, residual: Array, spread: Array) -> Noise:
    """Expectation-maximisation for the pose covariance and the instrument's noise, ten steps at fixed θ."""
    noise = state.noise
    count, width = system.rows.shape
    rank = pose_rank(int(system.seen.sum(axis=1).max()))
    b = system.levers.reshape(count, width, 6) * system.rows[..., None]
    if rank < 6:
        b = b * (np.arange(6) < 3)
    both = system.rows[:, :, None] & system.rows[:, None, :]
    second = state.weights[:, None, None] * (residual[:, :, None] * residual[:, None, :] + spread)
    ones = np.ones(count)
    readings = system.rows.sum()
    for _ in range(10):
        covariance = noise.covariance(system.levers, system.seen, ones)
        precision = np.linalg.inv(covariance)
        gain = noise.pose @ np.swapaxes(b, 1, 2) @ precision  # (N, 6, 3T)
        excess = second - covariance * both
        pose = noise.pose + (gain @ excess @ np.swapaxes(gain, 1, 2)).mean(axis=0)
        sigma2 = noise.instrument**2
        if rank == 6:
            change = precision @ excess @ precision * sigma2**2
            mass = np.trace(change * system.rows[:, :, None], axis1=1, axis2=2).sum() / readings
            sigma2 = float(np.clip(sigma2 + mass, (0.2 * noise.instrument) ** 2, (5 * noise.instrument) ** 2))
        noise = Noise(0.5 * (pose + pose.T), float(np.sqrt(sigma2)))
    return noise


def _believe(system: _System, residual: Array, spread: Array, weights: Array) -> Array:
    """Weights of visits: 1 up to the 99.9 % quantile of χ², falling with the squared distance beyond it."""
    unweighted = system.covariance * weights[:, None, None] + spread
    k = np.arange(system.rows.shape[1])
    unweighted[:, k, k] += np.where(system.rows, 0.0, 1.0)
    distance = np.einsum("ni,ni->n", residual, np.linalg.solve(unweighted, residual[..., None])[..., 0])
    limit = chi2.ppf(0.999, system.rows.sum(axis=1))
    return np.asarray(np.minimum(1.0, limit / np.maximum(distance, 1e-12)))


def _fold_base(model: Model, theta: Array, frame: Array) -> tuple[Array, Array]:
    """With an unknown measuring frame, an error of the base is where the instrument stands."""
    theta = theta.copy()
    at = 0
    for term in model.terms:
        size = len(term.parameters(model.machine.frame_names))
        if term.frame == 0 and term.kind == "geometric":
            error = theta[at : at + 6].copy()
            theta[at : at + 6] = 0.0
            return theta, fold(frame, from_xyz_rpy(error[:3], error[3:]))
        at += size
    return theta, frame


