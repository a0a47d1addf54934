"""The joint estimate: model (17) from all visits at once, prior strengths and noise learnt from the data.

    y = X θ + u + e,   θ ~ N(0, Λ),   u: pose repeatability of a visit,   e: instrument noise

Λ has one variance per group of parameters (`strengths`), u and e follow `noise_fit`; around both, X is rebuilt with the
exact product where the prediction has moved far. Straight lines come first, so that the rest is laid out once, near
the truth. Of a long recording the strengths and the noise are learnt from some thousand visits spread over it; all of
it passes twice, block by block, so that memory does not grow with their number. docs/derivations.md §5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from ppshw.errors import IdentificationFailed
from ppshw.identification.judgement import Judgement, level
from ppshw.identification.noise import Noise, pose_rank
from ppshw.identification.noise_fit import Form
from ppshw.identification.start import align, fold, to_base
from ppshw.identification.strengths import Groups, Posterior, alone, learn, silent
from ppshw.identification.visits import Linearisation
from ppshw.model import Model
from ppshw.recording import Recording
from ppshw.terms import Situation, parts_of
from ppshw.transforms import from_xyz_rpy

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
Progress = Callable[[int, int], None]
# The first idea of the noise is this share of what the ideal machine misses: signal is believed step by step.
FIRST_NOISE_SHARE = 0.2
# Strengths and noise are learnt from so many visits at most; six numbers each tell them to a percent.
LEARNT_FROM = 4096
# X is rebuilt once a prediction has moved so far [m]: then what is left of second order is below a micrometre.
FAR = 2e-4
# The search ends when no coordinate moves by more than this share of its noise, and twice the log likelihood of the
# noise grows by no more than this.
STILL, SAME_NOISE = 0.2, 1.0
# Steps of the strengths per round.
STRENGTH_STEPS = 4
# Visits that hold to noise this well are believed in full.
BELIEVED = 0.999
# Visits that are believed less than this are set aside.
SET_ASIDE = 0.5


@dataclass(frozen=True)
class Estimate:
    """What a recording says of a model.

    theta, covariance   (p,), (p, p) posterior mean and covariance
    groups              prior standard deviation of every group
    noise               pose repeatability and instrument noise
    measuring_in_base   (4, 4) where the measuring frame stands
    weights             (N,) 1 for a visit that was believed, less for an outlier
    alone               (p,) what the variance of a single parameter is more than by `covariance`, which is for what
                        parameters do together; None for nothing   (5.7)
    """

    model: Model
    theta: Array
    covariance: Array
    groups: dict[str, float]
    noise: Noise
    measuring_in_base: Array
    weights: Array
    alone: Array | None = field(default=None, kw_only=True)


@dataclass
class _State:
    theta: Array
    variances: Array  # per group
    noise: Noise
    form: Form | None  # None: not chosen yet
    weights: Array  # of the visits learnt from, at last of all
    frame: Array
    active: Mask  # per parameter


@dataclass(frozen=True)
class _Solved:
    """The last normal equations, over the parameters `kept` (p,), and what they say."""

    gram: Array
    moment: Array
    kept: Mask
    posterior: Posterior


@dataclass(frozen=True)
class _Task:
    """What does not change during the search; which: the visits learnt from."""

    model: Model
    recording: Recording
    groups: Groups
    which: Index

    def linearised(self, state: _State, which: Index | None = None) -> Linearisation:
        """About the state's θ, after an error of the base was taken for the instrument's place where that is open."""
        if self.model.machine.tracker.base is None:
            state.theta, state.frame = _fold_base(self.model, state.theta, state.frame)
        which = self.which if which is None else which
        return Linearisation(self.model, self.recording, state.theta, state.frame, which)


def estimate(
    model: Model,
    recording: Recording,
    rounds: int = 14,
    progress: Progress | None = None,
) -> Estimate:
    """Identify a model from any recording: any poses, loads, targets; missing targets; position only.

    Raises IdentificationFailed when no visit has a target.
    """
    used = recording.measured
    if not used.any():
        raise IdentificationFailed(f"{recording.source}: every target of every visit was lost")
    if not used.all():
        recording = recording.subset(used)
    model, frame = _start(model, recording)
    # where the alignment put an unknown tracker is off by what the machine is: that is known before, not learnt
    open_base = [f"geometric.{model.machine.frame_names[0]}."] if model.machine.tracker.base is None else []
    groups = Groups.among(model.parameters(), held=open_base)
    count = len(recording)
    which = np.arange(count) if count <= LEARNT_FROM else np.linspace(0, count - 1, LEARNT_FROM).astype(int)
    task = _Task(model, recording, groups, which)
    state = _first_state(task, frame)
    solved = _search(task, state, rounds, progress)
    if count > len(which):
        solved = _everything(task, state, solved.kept)
    if model.machine.tracker.base is None:
        state.theta, state.frame = _fold_base(model, state.theta, state.frame)
    if progress:
        progress(rounds, rounds)
    return _answer(task, state, solved, used)


def _search(task: _Task, state: _State, rounds: int, progress: Progress | None) -> _Solved:
    """Strengths, noise, outliers and θ₀, in turn until nothing moves; `state` holds them."""
    groups, first = task.groups, lines(task.model)
    seen = task.recording.seen[task.which]
    rank, believed = pose_rank(seen), believed_to(3 * seen.sum(axis=1))
    linear = task.linearised(state)
    for turn in range(rounds):
        if progress:
            progress(turn, rounds)
        settled = turn >= 2
        kept = state.active & first if turn == 0 else state.active
        if not kept.any():
            raise IdentificationFailed(f"{task.recording.source}: its visits contradict one another, none is left")
        gram, moment, whites = linear.normal_equations(state.noise, state.weights, kept)
        state.variances, posterior = learn(gram, moment, groups, kept, state.variances, STRENGTH_STEPS)
        before, state.theta = state.theta, np.zeros(len(kept))
        state.theta[kept] = posterior.theta
        judged = Judgement(len(task.which), linear.coordinates, task.model.machine.own_ways**2)
        moved, since = (state.theta - before)[kept], (state.theta - linear.theta)[kept]
        for white in whites or linear.whitened(state.noise, state.weights, kept):
            judged.add(white, posterior, moved, since, state.weights)
        previous, told = state.noise, np.inf
        if settled:
            state.weights = np.minimum(1.0, believed / np.maximum(judged.distance(state.noise), 1e-12))
            form = state.form if turn > 3 else None
            state.form, state.noise, told = judged.noise(previous, rank, form)
        else:
            state.noise = judged.first_noise(previous, rank)
        if settled and judged.moved < STILL and judged.far < FAR and told < SAME_NOISE:
            break
        if turn > 0:
            rows = linear.rows * level(previous, state.noise)
            state.active = state.active & ~silent(gram, groups, kept, state.variances, rows)
            state.theta = np.where(state.active, state.theta, 0.0)
        if judged.far > FAR and turn < rounds - 1:
            linear = task.linearised(state)
    return _Solved(gram, moment, kept, posterior)


def _everything(task: _Task, state: _State, kept: Mask) -> _Solved:
    """What was learnt from some visits, applied to all of them: whom to believe, then one solution."""
    everyone = np.arange(len(task.recording))
    linear = task.linearised(state, everyone)
    state.weights = np.ones(len(everyone))
    freedom = 3 * task.recording.seen.sum(axis=1)
    for block in linear:  # at θ₀ itself; the model's own uncertainty is small beside so many visits
        distance = np.maximum(block.distance(state.noise), 1e-12)
        state.weights[block.visits] = np.minimum(1.0, believed_to(freedom[block.visits]) / distance)
    gram, moment, _ = linear.normal_equations(state.noise, state.weights, kept)
    state.variances, posterior = learn(gram, moment, task.groups, kept, state.variances, STRENGTH_STEPS)
    state.theta = np.zeros(len(kept))
    state.theta[kept] = posterior.theta
    return _Solved(gram, moment, kept, posterior)


def lines(model: Model) -> Mask:
    """(p,) constants, slopes, compliances, targets: what a first solution needs."""
    groups = [parts_of(p.group) for p in model.parameters()]
    return np.array([parts[0] != "own" and not parts[-1].startswith("band") for parts in groups])


def believed_to(coordinates: Array | Index) -> Array:
    """Squared distance, in units of the noise, up to which a visit of so many coordinates is believed in full: the
    quantile BELIEVED of χ²."""
    return np.asarray(2.0 * gammaincinv(0.5 * coordinates, BELIEVED))


def believable(weights: Array) -> Index:
    """Visits that an estimate did not set aside: weights (N,), 0 … 1 → their indices (K,), rising."""
    return np.flatnonzero(weights > SET_ASIDE)


def _answer(task: _Task, state: _State, solved: _Solved, used: Mask) -> Estimate:
    """Parameters that were left out keep their prior."""
    groups, kept = task.groups, solved.kept
    covariance = np.diag(groups.scale**2 * state.variances[groups.of])
    covariance[np.ix_(kept, kept)] = solved.posterior.covariance(groups, kept)
    more = alone(solved.gram, solved.moment, groups, kept, state.variances, covariance, state.theta)
    weights = np.zeros(len(used))
    weights[used] = state.weights
    strengths = dict(zip(groups.names, np.sqrt(state.variances).tolist(), strict=True))
    return Estimate(task.model, state.theta, covariance, strengths, state.noise, state.frame, weights, alone=more)


def _start(model: Model, recording: Recording) -> tuple[Model, Array]:
    machine = model.machine
    if machine.tracker.base is not None:
        return model, machine.tracker.base
    frame, targets = align(machine, recording, targets_free=not machine.tracker.targets_known)
    moved = machine.with_targets(dict(zip(machine.targets, targets, strict=True)))
    return replace(model, machine=moved), frame


def _first_state(task: _Task, frame: Array) -> _State:
    """Before any fit: the noise is the maker's claim, or a share of what the ideal machine misses."""
    machine, groups = task.model.machine, task.groups
    theta, some = np.zeros(len(groups.scale)), task.recording.subset(task.which)
    gap = (to_base(some.points, frame) - task.model.predict(Situation.of(some), theta))[some.seen]
    sigma = max((machine.repeatability or 1.4e-4) / 3, FIRST_NOISE_SHARE * float(np.sqrt((gap**2).mean())))
    noise = Noise(np.diag([sigma**2] * 6), machine.tracker.position_sigma)
    everything = np.ones(len(theta), dtype=bool)
    return _State(theta, groups.start**2, noise, None, np.ones(len(task.which)), frame, everything)


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
