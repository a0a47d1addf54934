"""The paper's own identification: stepwise, linear, not iterative   (section 3, figures 4 and 5).

    c(0) from weight pairs (24) → Δc_i(q_i) (20) → Δε_gi(q_i) (23) → c(0), ε_g(0) from what is left (25) → all again

Every step is linear in the measured pose errors y and in the choice x₀ = (ε_g(0), c(0)). So the whole of it is two
matrices, θ = A y + T x₀, and a prediction D θ, which makes eq. (25) explicit: y − D A y = D T x₀, with D T = [M_g M_c].
docs/derivations.md §4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppshw.errors import IdentificationFailed
from ppshw.identification.joint import Estimate
from ppshw.identification.noise import Noise
from ppshw.identification.paper_steps import REDUNDANT, choice_names, from_weight_pairs, linear_steps, paper_terms
from ppshw.identification.pose_error import PoseErrors, pose_errors
from ppshw.identification.redundancy import independent_columns, solver
from ppshw.identification.sweeps import ADVICE, SAME_POSITION, Sweeps, find_sweeps
from ppshw.machine import Machine
from ppshw.model import Model
from ppshw.recording import Recording

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PaperEstimate(Estimate):
    """An Estimate, and how the paper's method came to it.

    home            (n,) home configuration
    kept, zeroed    parameters of ε_g(0) and c(0) that were identified, and those that are redundant
    kept_by_pairs   those of c(0) that the weight pairs (24) alone determine
    differences     how many independent weight differences (24) had
    left_before, left_after   rms of ΔX − ΔX^c at the tip, before and after eq. (25)      [m]
    """

    home: Array
    kept: tuple[str, ...]
    zeroed: tuple[str, ...]
    kept_by_pairs: tuple[str, ...]
    differences: int
    left_before: float
    left_after: float


def identify_paper(machine: Machine, recording: Recording, same_position: float = SAME_POSITION) -> PaperEstimate:
    """Identify model (17) from a campaign of the paper's form.

    Visits without a full pose are left out (weight 0). The covariance is that of one visit's pose error, the same for
    every visit in base axes, carried through all steps; what straight lines between sampled positions miss is not in it.

    same_position  setpoints closer than this are one position   [m, rad]

    Raises IdentificationFailed, saying what the recording lacks.
    """
    pose = pose_errors(machine, recording)
    visits = recording.subset(pose.used)
    sweeps = find_sweeps(visits, same_position)
    _check_pairs(machine, recording, sweeps)
    terms = paper_terms(machine, sweeps)
    row_scale = _row_scale(pose.machine)
    y = (pose.errors * row_scale).ravel()
    steps = linear_steps(pose.machine, terms, visits, sweeps, row_scale)

    choice, by_pairs, differences = from_weight_pairs(steps, y, terms, sweeps)
    influence = steps.design @ steps.start  # [M_g M_c] of eq. (25)
    left = y - steps.design @ (steps.data @ y) - influence @ choice  # ΔX − ΔX^c
    kept = independent_columns(influence, REDUNDANT, first=by_pairs)
    correct = solver(influence, kept)
    correction = correct @ left
    theta = steps.data @ y + steps.start @ (choice + correction)
    still_left = left - influence @ correction

    from_data = correct - (correct @ steps.design) @ steps.data  # the final x₀ is linear in y as well
    freedom = len(y) - float(steps.design.multiply(steps.data.T).sum()) - float(np.sum(from_data.T * influence))
    scatter = _scatter(pose, still_left.reshape(-1, 6) / row_scale, freedom / len(y))
    names = choice_names(machine, terms)
    return PaperEstimate(
        model=Model(pose.machine, terms),
        theta=theta,
        covariance=_carried(steps.data.toarray() + steps.start @ from_data, scatter, pose.tips, row_scale),
        groups={},  # no priors here
        noise=_noise(pose, scatter),
        measuring_in_base=pose.frame,
        weights=pose.used.astype(float),
        home=sweeps.home,
        kept=tuple(names[k] for k in sorted(kept)),
        zeroed=tuple(name for k, name in enumerate(names) if k not in kept),
        kept_by_pairs=tuple(names[k] for k in sorted(by_pairs)),
        differences=differences,
        left_before=_tip_rms(left),
        left_after=_tip_rms(still_left),
    )


def _check_pairs(machine: Machine, recording: Recording, sweeps: Sweeps) -> None:
    """Elastic links need weight pairs, and one that varies needs them along its travel."""
    elastic = [k for k, joint in enumerate(machine.joints) if joint.elastic is not None]
    if elastic and not any(c.paired for c in sweeps.configurations):
        why = "under two different loads" if recording.has_wrench else "under known loads (no columns Fx … Mz)"
        raise IdentificationFailed(f"{recording.source}: no configuration was measured {why}; {ADVICE}")
    for k in elastic:
        joint, swept = machine.joints[k], sweeps.of_joint(k)
        if joint.elastic is not None and joint.elastic.varies and swept and not any(c.paired for c in swept):
            raise IdentificationFailed(
                f"{recording.source}: the compliance of {joint.name} varies, but no position of it was measured under "
                f"two different loads; {ADVICE}"
            )


def _row_scale(machine: Machine) -> Array:
    """1 for translations; for rotations the rms distance of targets and points from the tip, where accuracy counts [m]."""
    arms = np.array([*machine.targets.values(), *machine.points.values()])
    length = float(np.sqrt((arms**2).sum(axis=1).mean()))
    return np.repeat([1.0, length], 3)


def _tip_rms(rows: Array) -> float:
    return float(np.sqrt((rows.reshape(-1, 6)[:, :3] ** 2).sum(axis=1).mean()))


def _scatter(pose: PoseErrors, left: Array, freedom: float) -> Array:
    """(6, 6) covariance of a visit's ΔX about the end effector's origin, turned into base axes.

    left     (V, 6) ΔX less the final prediction, end-effector frame
    freedom  share of the measured numbers that the parameters did not use up
    """
    if freedom < 1e-3:
        raise IdentificationFailed("as many parameters as measurements: nothing is left to tell the noise from")
    turn = pose.tips[:, :3, :3]
    twist = np.concatenate([np.einsum("vij,vj->vi", turn, half) for half in (left[:, :3], left[:, 3:])], axis=1)
    return np.asarray(twist.T @ twist / (len(left) * freedom))


def _noise(pose: PoseErrors, scatter: Array) -> Noise:
    """What of the scatter the instrument does not explain is the machine's repeatability."""
    turn = np.zeros((len(pose.tips), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = pose.tips[:, :3, :3]
    by_instrument = (turn @ pose.spread @ np.swapaxes(turn, 1, 2)).mean(axis=0) * pose.instrument**2
    # the difference of two estimates may have a slightly negative direction
    values, vectors = np.linalg.eigh(scatter - by_instrument)
    return Noise((vectors * np.maximum(values, 0.0)) @ vectors.T, pose.instrument)


def _carried(gain: Array, scatter: Array, tips: Array, row_scale: Array) -> Array:
    """Cov θ = G blockdiag(Σ_v) Gᵀ with Σ_v the scatter in the axes of each visit's end effector, rows scaled.

    gain  (P, 6V)
    """
    root = np.linalg.cholesky(scatter + 1e-12 * np.diag(np.diag(scatter)) + 1e-30 * np.eye(6))
    back = np.zeros((len(tips), 6, 6))
    back[:, :3, :3] = back[:, 3:, 3:] = np.swapaxes(tips[:, :3, :3], 1, 2)
    roots = row_scale[:, None] * (back @ root)
    spread = np.einsum("pvi,vij->pvj", gain.reshape(len(gain), -1, 6), roots).reshape(len(gain), -1)
    return np.asarray(spread @ spread.T)
