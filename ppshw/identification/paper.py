"""The paper's own identification: stepwise, linear, not iterative   (section 3, figures 4 and 5).

    c(0) from weight pairs (24) → Δc_i(q_i) (20) → Δε_gi(q_i) (23) → c(0), ε_g(0) from what is left (25) → all again

Every step is linear in the measured pose errors y and in the choice x₀ = (ε_g(0), c(0)). So the whole of it is two
matrices, θ = A y + T x₀, and a prediction D θ, which makes eq. (25) explicit: y − D A y = D T x₀, with D T = [M_g M_c].
docs/derivations.md §4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppshw.identification.joint import Estimate
from ppshw.identification.noise import Noise
from ppshw.identification.paper_steps import (
    Regression,
    choice_names,
    from_weight_pairs,
    linear_process,
    pair_places,
    paper_terms,
)
from ppshw.identification.pose_error import PoseErrors, pose_errors
from ppshw.identification.redundancy import Evidence, independent_columns, solver
from ppshw.identification.sweeps import Sweeps, find_sweeps
from ppshw.machine import Machine
from ppshw.model import Model
from ppshw.recording import Recording

Array = NDArray[np.float64]
# Fewer repeated visits than this say too little of six numbers that scatter together; then the makers' claims count.
ENOUGH_REPEATS = 24
# Below this no scatter is believed; a recording without any noise would have none [m].
LEAST_SCATTER = 1e-6


@dataclass(frozen=True)
class PaperEstimate(Estimate):
    """An Estimate, and how the paper's method came to it: tests/unit/test_paper_method.py holds each step against the
    paper by that, and nobody else reads it.

    home            (n,) home configuration
    kept, zeroed    parameters of ε_g(0) and c(0) that were identified, and those that are redundant
    kept_by_pairs   those of c(0) that the weight pairs (24) gave
    differences     how many independent weight differences (24) had
    first_theta     (p,) of the first choice c^c(0), ε_g(0) = 0, before eq. (25)
    left_before, left_after   rms of ΔX − ΔX^c at the tip, before and after eq. (25)      [m]
    """

    home: Array
    kept: tuple[str, ...]
    zeroed: tuple[str, ...]
    kept_by_pairs: tuple[str, ...]
    differences: int
    first_theta: Array
    left_before: float
    left_after: float


def identify_paper(machine: Machine, recording: Recording, by_noise: bool = True) -> PaperEstimate:
    """Identify model (17) from a campaign of the paper's form.

    Visits without a full pose are left out (weight 0). The covariance is that of one visit's pose error, the same for
    every visit in base axes, carried through all steps; it leaves out what straight lines between sampled positions
    miss, and that redundant parameters were chosen by looking at the data.

    by_noise  parameters that are not above noise are redundant too; False: only those that others can replace

    Raises IdentificationFailed, saying what the recording lacks.
    """
    pose = pose_errors(machine, recording)
    visits = recording.subset(pose.used)
    sweeps = find_sweeps(machine, visits)
    terms = paper_terms(machine, sweeps)
    first_scatter = _scatter_of_repeats(pose, sweeps)
    whiten = np.linalg.inv(np.linalg.cholesky(first_scatter))
    errors = pose.errors @ whiten.T
    regression = Regression.of(pose.machine, terms, visits, whiten)
    places = pair_places(terms, sweeps)

    choice, by_pairs = from_weight_pairs(regression, errors, places, by_noise)  # flag 1 of figure 5
    data, start = linear_process(regression, errors, choice, sweeps, by_noise)
    y, design = errors.ravel(), regression.design
    influence = design @ start  # [M_g M_c] of eq. (25)
    left = y - design @ (data @ y) - influence @ choice  # ΔX − ΔX^c
    evidence = Evidence([left], regression.plausible) if by_noise else None
    kept = independent_columns([influence], evidence, first=by_pairs)  # flag 2
    solve = solver(influence, kept)
    correction = solve @ left  # flag 3
    theta = data @ y + start @ (choice + correction)  # flag 4
    still_left = left - influence @ correction

    of_choice = solve - (solve @ design) @ data  # the final x₀ = of_choice · y, whatever the first choice was
    freedom = 1.0 - (float(design.multiply(data.T).sum()) + float(np.sum(of_choice.T * influence))) / len(y)
    unwhiten = np.linalg.inv(whiten).T
    scatter = _scatter_of_rest(pose, still_left.reshape(-1, 6) @ unwhiten, freedom, first_scatter)
    names = choice_names(machine, terms)
    return PaperEstimate(
        model=Model(pose.machine, terms),
        theta=theta,
        covariance=_carried(data.toarray() + start @ of_choice, scatter, pose.tips, whiten),
        groups={},  # no priors here
        noise=_noise(pose, scatter),
        measuring_in_base=pose.frame,
        weights=pose.used.astype(float),
        home=sweeps.home,
        kept=tuple(names[k] for k in sorted(kept)),
        zeroed=tuple(name for k, name in enumerate(names) if k not in kept),
        kept_by_pairs=tuple(names[k] for k in sorted(by_pairs)),
        differences=sum(len(c.visits) - 1 for c in places),
        first_theta=data @ y + start @ choice,
        left_before=_tip_rms(left.reshape(-1, 6) @ unwhiten),
        left_after=_tip_rms(still_left.reshape(-1, 6) @ unwhiten),
    )


def _scatter_of_repeats(pose: PoseErrors, sweeps: Sweeps) -> Array:
    """(6, 6) covariance of ΔX, end-effector axes, from visits to one pose under one load."""
    groups = [pose.errors[visits] for c in sweeps.configurations for visits in c.loads]
    centred = np.concatenate([g - g.mean(axis=0) for g in groups])
    repeats = len(centred) - len(groups)
    by_instrument = pose.machine.tracker.position_sigma**2 * pose.spread
    if repeats >= ENOUGH_REPEATS:
        out = centred.T @ centred / repeats
    else:
        out = by_instrument + ((pose.machine.repeatability or 1.4e-4) / 3) ** 2 * np.eye(6)
    return np.asarray(out + LEAST_SCATTER**2 * np.eye(6))


def _scatter_of_rest(pose: PoseErrors, rest: Array, freedom: float, first: Array) -> Array:
    """(6, 6) covariance of a visit's ΔX about the end effector's origin, base axes.

    rest     (V, 6) ΔX less the final prediction, end-effector frame
    freedom  share of the measured numbers that the parameters did not use up; where there is none left, `first` counts
    """
    twist = _turned(pose.tips, rest[:, :, None])[:, :, 0]
    if freedom < 0.02:
        both = _turned(pose.tips, np.broadcast_to(first, (len(rest), 6, 6)))
        return np.asarray(_turned(pose.tips, np.swapaxes(both, 1, 2)).mean(axis=0))
    return np.asarray(twist.T @ twist / (len(rest) * freedom))


def _turned(tips: Array, values: Array) -> Array:
    """(V, 6, k) from end-effector axes to base axes, translations and rotations each."""
    turn = tips[:, :3, :3]
    return np.concatenate([turn @ values[:, :3], turn @ values[:, 3:]], axis=1)


def _noise(pose: PoseErrors, scatter: Array) -> Noise:
    """What of the scatter the instrument does not explain is the machine's repeatability."""
    half = _turned(pose.tips, np.broadcast_to(pose.spread, (len(pose.tips), 6, 6)))
    by_instrument = _turned(pose.tips, np.swapaxes(half, 1, 2)).mean(axis=0) * pose.instrument**2
    # the difference of two estimates may have a slightly negative direction
    values, vectors = np.linalg.eigh(scatter - by_instrument)
    return Noise(np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T), pose.instrument)


def _carried(gain: Array, scatter: Array, tips: Array, whiten: Array) -> Array:
    """Cov θ = G blockdiag(Σ_v) Gᵀ, Σ_v the scatter in the axes of each visit's end effector, whitened.

    gain  (P, 6V)
    """
    root = np.linalg.cholesky(scatter + 1e-20 * np.eye(6))
    roots = whiten @ _turned(np.swapaxes(tips, 1, 2), np.broadcast_to(root, (len(tips), 6, 6)))
    spread = np.empty_like(gain)
    for v, r in enumerate(roots):
        spread[:, 6 * v : 6 * v + 6] = gain[:, 6 * v : 6 * v + 6] @ r
    return np.asarray(spread @ spread.T)


def _tip_rms(errors: Array) -> float:
    return float(np.sqrt((errors[:, :3] ** 2).sum(axis=1).mean()))
