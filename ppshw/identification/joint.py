"""The joint estimate: model (17) from all visits at once, prior strengths and noise learnt from the data.

    y = X θ + u + e,   θ ~ N(0, Λ),   u: pose repeatability of a visit,   e: instrument noise

Λ has one variance per group of parameters. Variances follow MacKay's fixed point of the marginal likelihood (MacKay
1992, Bayesian interpolation), noise follows its expectation-maximisation step (Dempster et al. 1977); around both, X is
rebuilt with the exact product until the prediction stands still. Groups that the data drive to nothing are left out of
the sums. Visits pass in blocks, so that memory does not grow with their number. docs/derivations.md §5.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, lapack
from scipy.stats import chi2

from ppshw.errors import IdentificationFailed
from ppshw.identification.noise import Noise, NoiseUpdate
from ppshw.identification.start import align, fold, to_base
from ppshw.model import Model
from ppshw.recording import Recording
from ppshw.terms import Situation
from ppshw.transforms import from_xyz_rpy

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Progress = Callable[[int, int], None]
# Prior variances stay within these factors of where they start (as variances): from nothing to some 30 mm and 15 mrad.
# Without the upper one, errors of parallel axes that cancel each other may grow to metres while noise is still unknown.
SMALLEST, LARGEST = 1e-10, 1e3
# The first idea of the noise is this share of what the ideal machine misses: signal is believed step by step.
FIRST_NOISE_SHARE = 0.2
# A group whose prior would, summed over all visits, show through the noise by less than this (squared) is left out.
NEGLIGIBLE = 0.3
BLOCK = 512
# Designs of a recording up to this many numbers (0.4 GB) are kept between passes; beyond, they are made again.
KEPT = 5e7


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
    active: Mask  # per parameter


@dataclass(frozen=True)
class Block:
    """Some visits, linearised: rows (n, 3T), design (n, 3T, p) of the active parameters, data y + Xθ₀, levers."""

    visits: slice
    seen: Mask
    rows: Mask
    design: Array
    data: Array
    levers: Array


class _Blocks:
    """All visits about one θ₀, block by block; kept in memory where they fit."""

    def __init__(self, model: Model, recording: Recording, state: _State) -> None:
        self._model, self._recording = model, recording
        self._theta, self._active, self._frame = state.theta.copy(), state.active.copy(), state.frame
        numbers = recording.points.size * int(state.active.sum())
        self._kept: list[Block] | None = list(self._make()) if numbers <= KEPT else None

    def __iter__(self) -> Iterator[Block]:
        return iter(self._kept) if self._kept is not None else self._make()

    def _make(self) -> Iterator[Block]:
        for start in range(0, len(self._recording), BLOCK):
            visits = slice(start, min(start + BLOCK, len(self._recording)))
            part = self._recording.subset(np.arange(visits.start, visits.stop))
            seen = part.seen
            lin = self._model.linearise(Situation.of(part), self._theta)
            rows = np.repeat(seen, 3, axis=1)
            design = lin.design.reshape(len(seen), rows.shape[1], -1)[:, :, self._active] * rows[..., None]
            gap = np.where(seen[..., None], to_base(part.points, self._frame) - lin.positions, 0.0)
            data = gap.reshape(len(seen), -1) + design @ self._theta[self._active]
            yield Block(visits, seen, rows, design, data, lin.levers)

    def normal_equations(self, noise: Noise, weights: Array) -> tuple[Array, Array]:
        """XᵀR⁻¹X and XᵀR⁻¹y over the active parameters."""
        size = int(self._active.sum()) + 1
        gram = np.zeros((size, size))
        for block in self:
            root = np.linalg.inv(np.linalg.cholesky(noise.covariance(block.levers, block.seen, weights[block.visits])))
            white = root @ np.concatenate([block.design, block.data[..., None]], axis=2)
            flat = white.reshape(-1, size)
            gram += flat.T @ flat
        return gram[:-1, :-1], gram[:-1, -1]


def estimate(
    model: Model,
    recording: Recording,
    rounds: int = 14,
    progress: Progress | None = None,
) -> Estimate:
    """Identify a model from any recording: any poses, loads, targets; missing targets; position only.

    Raises IdentificationFailed when no visit has a target.
    """
    machine = model.machine
    used = np.asarray(recording.seen.any(axis=1))
    if not used.any():
        raise IdentificationFailed(f"{recording.source}: every target of every visit was lost")
    recording = recording.subset(used)
    model, frame = _start(model, recording)
    groups = _Groups(model)
    state = _first_state(model, recording, groups, frame)
    inverse, kept = np.zeros((0, 0)), state.active
    for turn in range(rounds):
        if progress:
            progress(turn, rounds)
        settled = turn >= 2
        blocks = _Blocks(model, recording, state)
        gram, moment = blocks.normal_equations(state.noise, state.weights)
        before = state.theta
        theta, inverse = _strengths(gram, moment, groups, state, 6 if settled else 4)
        kept = state.active.copy()
        state.theta = np.zeros_like(before)
        state.theta[kept] = theta
        previous = state.noise
        update = NoiseUpdate(previous, recording.seen, settled)
        distance = np.zeros(len(recording))
        moved = 0.0
        for block in blocks:
            residual = block.data - block.design @ theta
            half = (block.design.reshape(-1, len(inverse)) @ inverse).reshape(block.design.shape)
            spread = half @ np.swapaxes(block.design, 1, 2)
            weights = state.weights[block.visits]
            update.add(block.levers, block.seen, residual, spread, weights)
            distance[block.visits] = _distance(previous, block, residual, spread)
            step = block.design @ (state.theta - before)[state.active]
            moved = max(moved, float(np.abs(step).max()))
        state.noise = update.result()
        if settled:
            limit = chi2.ppf(0.999, 3 * recording.seen.sum(axis=1))
            state.weights = np.minimum(1.0, limit / np.maximum(distance, 1e-12))
        last = settled and moved < 2e-6 and previous.close_to(state.noise)
        if not last:
            _leave_out(gram, groups, state)
        if machine.tracker.base is None:
            state.theta, state.frame = _fold_base(model, state.theta, state.frame)
        if last:
            break
    if progress:
        progress(rounds, rounds)
    return _answer(model, groups, state, inverse, kept, used)


def _answer(model: Model, groups: _Groups, state: _State, inverse: Array, kept: Mask, used: Mask) -> Estimate:
    """`inverse` is the covariance of the parameters `kept` in the last round; the rest keep their prior."""
    covariance = np.diag(groups.scale**2 * state.variances[groups.of])
    covariance[np.ix_(kept, kept)] = inverse
    weights = np.zeros(len(used))
    weights[used] = state.weights
    strengths = dict(zip(groups.names, np.sqrt(state.variances).tolist(), strict=True))
    return Estimate(model, state.theta, covariance, strengths, state.noise, state.frame, weights)


def _start(model: Model, recording: Recording) -> tuple[Model, Array]:
    machine = model.machine
    if machine.tracker.base is not None:
        return model, machine.tracker.base
    frame, targets = align(machine, recording, targets_free=not machine.tracker.targets_known)
    moved = machine.with_targets(dict(zip(machine.targets, targets, strict=True)))
    return replace(model, machine=moved), frame


def _first_state(model: Model, recording: Recording, groups: _Groups, frame: Array) -> _State:
    """Before any fit: the noise is the maker's claim, or a share of what the ideal machine misses."""
    machine = model.machine
    theta = np.zeros(len(groups.scale))
    gap = (to_base(recording.points, frame) - model.predict(Situation.of(recording), theta))[recording.seen]
    sigma = max((machine.repeatability or 1.4e-4) / 3, FIRST_NOISE_SHARE * float(np.sqrt((gap**2).mean())))
    noise = Noise(np.diag([sigma**2] * 6), machine.tracker.position_sigma)
    everything = np.ones(len(theta), dtype=bool)
    return _State(theta, groups.start**2, noise, np.ones(len(recording)), frame, everything)


class _Groups:
    """Which parameters share a prior variance: of (p,) index, scale (p,), and per group name and start."""

    def __init__(self, model: Model) -> None:
        parameters = model.parameters()
        self.names = list(dict.fromkeys(p.group for p in parameters))
        index = {name: k for k, name in enumerate(self.names)}
        self.of = np.array([index[p.group] for p in parameters])
        self.scale = np.array([p.scale for p in parameters])
        self.start = np.zeros(len(self.names))
        for p in parameters:
            self.start[index[p.group]] = p.start


def _strengths(gram: Array, moment: Array, groups: _Groups, state: _State, steps: int) -> tuple[Array, Array]:
    """Prior variances by their fixed point; returns posterior mean and covariance of the active parameters."""
    of, scale = groups.of[state.active], groups.scale[state.active]
    for step in range(steps + 1):
        prior = scale * np.sqrt(state.variances[of])
        z, zz = _solve(gram, moment, prior)
        if step < steps:
            _update_variances(state, z, np.diag(zz), of, groups.start)
    return prior * z, prior[:, None] * zz * prior


def _solve(gram: Array, moment: Array, prior: Array) -> tuple[Array, Array]:
    """Posterior mean and covariance of z = θ/prior, z ~ N(0, 1)."""
    if not len(moment):  # everything was left out: LAPACK would complain on stderr
        return np.zeros(0), np.zeros((0, 0))
    precision = prior[:, None] * gram * prior
    precision[np.diag_indices_from(precision)] += 1.0
    factor = cho_factor(precision, lower=True)
    mean = cho_solve(factor, prior * moment)
    inverse, info = lapack.dpotri(factor[0], lower=1)
    if info != 0:
        raise IdentificationFailed(f"the normal equations are singular (dpotri {info})")
    return mean, np.tril(inverse) + np.tril(inverse, -1).T


def _update_variances(state: _State, z: Array, zz: Array, of: NDArray[np.int64], start: Array) -> None:
    """MacKay's step where the data speak, the slower EM step where they hardly do."""
    count = len(start)
    size = np.bincount(of, minlength=count)
    square = np.bincount(of, z**2, minlength=count)
    spread = np.bincount(of, zz, minlength=count)
    effective = size - spread
    fast = square / np.maximum(effective, 1e-12)
    slow = (square + spread) / np.maximum(size, 1)
    factor = np.where(effective > 0.05 * size, fast, slow)
    changed = np.clip(state.variances * np.clip(factor, 0.03, 30.0), SMALLEST * start**2, LARGEST * start**2)
    state.variances = np.where(size > 0, changed, state.variances)


def _leave_out(gram: Array, groups: _Groups, state: _State) -> None:
    """Groups whose prior could hardly be seen through the noise, summed over all visits, are left out for good.

    diag(gram)·prior² is the squared size, in units of the noise, that a parameter may have over the whole recording.
    """
    size = np.zeros(len(state.active))
    size[state.active] = np.diag(gram)
    seen = np.bincount(groups.of, size * groups.scale**2 * state.variances[groups.of], minlength=len(groups.names))
    silent = seen < NEGLIGIBLE
    state.active = state.active & ~silent[groups.of]
    state.theta = np.where(state.active, state.theta, 0.0)


def _distance(noise: Noise, block: Block, residual: Array, spread: Array) -> Array:
    """Squared Mahalanobis distance of every visit, the model's own uncertainty included."""
    ones = np.ones(len(residual))
    whole = noise.covariance(block.levers, block.seen, ones) + spread
    return np.asarray(np.einsum("ni,ni->n", residual, np.linalg.solve(whole, residual[..., None])[..., 0]))


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
