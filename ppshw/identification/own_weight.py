"""Does the machine's own weight bend it, and whose which joint? Machines differ in where their compliance sits, no file
says it, and recordings do.

Bearings and drives stand behind a joint's motion and carry the link: its weight bends them. A link that is rigid at its
joint and bends towards its end is bent by what lies beyond it alone, as paper eq. (15) may be read. Where weights are
balanced the payload alone bends anything. Some visits are asked first, under the first fit's noise: each way's
strengths are moved towards where they are likeliest. A way that is ahead there is fitted as a whole, and stands if that
fit is the likelier one. docs/decisions/own-weight.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from ppshw.identification.joint import SET_ASIDE, Estimate, Progress, estimate
from ppshw.identification.start import to_base
from ppshw.identification.strengths import Groups, learn
from ppshw.identification.structure import joint_model
from ppshw.identification.visits import Linearisation
from ppshw.kinematics import frames
from ppshw.machine import WRENCH_COMPONENTS, BentBy, Machine
from ppshw.recording import Recording
from ppshw.statics import link_wrenches
from ppshw.terms import Situation

Array = NDArray[np.float64]
Index = NDArray[np.int64]
# By how much the whole fit of another way must be likelier (log evidence). Of 46 recordings of machines whose links
# hang on their joints the payload alone was less likely by 7 to 1,223; of 49 where it alone bends anything it was
# likelier by 5 to 1,247, but in two whose effect acts as own weight does. The links beyond were likelier by up to 5:
# free compliances take up much of what a link weighs.
LIKELIER: dict[BentBy, float] = {"payload": 3.0, "beyond": 10.0}
NOT_BENT = {
    "beyond": "of a link do not bend its own joint here, only those before it",
    "payload": "bend nothing here, the payload alone does",
}
VARIES = 1e-3  # of the largest force or moment of own weights on a joint, at least
FEWEST, ASKED, STEPS = 40, 256, 4  # visits that a recording needs; that are asked first; steps of the strengths there


def fitted(machine: Machine, sound: Recording, recording: Recording, progress: Progress | None = None) -> Estimate:
    """The joint estimate of a recording, its model laid over the travel of the sound visits, of a machine that is bent
    as the recording says."""

    def fit(way: BentBy) -> Estimate:
        return estimate(joint_model(replace(machine, bent_by=way), sound), recording, progress=progress)

    found = fit(machine.bent_by)
    visits = np.flatnonzero(found.weights > SET_ASIDE)
    if len(visits) < FEWEST or not _own_weights_vary(machine, recording.q):
        return found
    asked = visits[:: -(-len(visits) // ASKED)]
    known = _moved_evidence(found, machine.bent_by, recording, asked)
    ahead = {
        way: _moved_evidence(found, way, recording, asked) - known - LIKELIER[way]
        for way in LIKELIER if way != machine.bent_by
    }  # fmt: skip
    likeliest = max(ahead, key=lambda way: ahead[way])
    if ahead[likeliest] <= 0.0:
        return found
    other = fit(likeliest)
    before, after = log_evidences([found, other], recording)
    return other if after > before + LIKELIER[likeliest] else found


def _own_weights_vary(machine: Machine, q: Array) -> bool:
    """Whether a joint that may bend carries other own weights at one visit than at another. What they always bend alike
    is geometry as well: a rail's chance offset said that its weights bend nothing."""
    alone = replace(machine, bent_by="own")
    carried = link_wrenches(alone, frames(machine, q), np.zeros((len(q), 6)))
    for joint, wrench in zip(machine.joints, np.moveaxis(carried[:, 1:], 1, 0), strict=True):
        if joint.elastic:
            some = wrench[:, [WRENCH_COMPONENTS.index(load) for load in joint.elastic.loads]]
            if some.size and np.ptp(some, axis=0).max() > VARIES * np.abs(wrench).max():
                return True
    return False


def _moved_evidence(found: Estimate, way: BentBy, recording: Recording, visits: Index) -> float:
    """Log marginal likelihood of some visits of a machine that is bent this way, linear about what was found, with its
    noise; strengths from there a few steps on."""
    model = replace(found.model, machine=replace(found.model.machine, bent_by=way))
    groups, active = Groups.among(model.parameters()), found.theta != 0.0
    about = Linearisation(model, recording, found.theta, found.measuring_in_base, visits)
    size, squares = int(active.sum()), 0.0
    gram, moment = np.zeros((size, size)), np.zeros(size)
    for white in about.whitened(found.noise, found.weights[visits], active):
        design, data = white.design.reshape(-1, size), white.data.ravel()
        gram, moment, squares = gram + design.T @ design, moment + design.T @ data, squares + float(data @ data)
    variances = np.array([found.groups[name] for name in groups.names]) ** 2
    _, posterior = learn(gram, moment, groups, active, variances, STEPS)
    taken = float(moment @ posterior.theta)
    return float(np.log(np.diag(posterior.root) / posterior.prior).sum()) - 0.5 * (squares - taken)


def log_evidences(fits: Sequence[Estimate], recording: Recording) -> list[float]:
    """Log marginal likelihood of each fit of a recording, of the visits that all of them believe; with the strengths
    and the noise that each has learnt, about its own solution, but for what is the same for all (MacKay 1992)."""
    believed = np.min([fit.weights for fit in fits], axis=0) > SET_ASIDE
    recording = recording.subset(believed)
    return [_log_evidence(fit, recording) for fit in fits]


def _log_evidence(fit: Estimate, recording: Recording) -> float:
    count, model = len(recording), fit.model
    about = model.linearise(Situation.of(recording), fit.theta)
    points = to_base(recording.points, fit.measuring_in_base)
    gap = np.where(recording.seen[..., None], points - about.positions, 0.0)
    root = fit.noise.whitener(about.levers, recording.seen)

    def white(columns: Array) -> Array:
        return (root @ columns.reshape(count, root.shape[1], -1)).reshape(count * root.shape[1], -1)

    prior = np.array([fit.groups[p.group] * p.scale for p in model.parameters()])
    scaled = white(about.design) * prior
    # a parameter without a prior is 0 and moves nothing
    data = white(gap)[:, 0] + scaled @ np.divide(fit.theta, prior, out=np.zeros_like(prior), where=prior > 0)
    inner = scaled.T @ scaled
    inner[np.diag_indices_from(inner)] += 1.0
    factor = cholesky(inner, lower=True)
    taken = solve_triangular(factor, scaled.T @ data, lower=True)
    diagonal = np.einsum("nkk->nk", root)[np.repeat(recording.seen, 3, axis=1)]  # root is triangular
    return float(np.log(diagonal).sum() - np.log(np.diag(factor)).sum() - 0.5 * (data @ data - taken @ taken))
