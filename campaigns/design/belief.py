"""What is believed before the first visit: the model, how large its parameters may be, and what scatters.

The model is the joint estimate's own over the joints' whole travel. Prior strengths are those that a calibration
learnt, or typical ones where there is none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppshw.errors import CampaignError
from ppshw.identification.noise import Noise
from ppshw.identification.structure import joint_model
from ppshw.machine import RADIUS_986, Machine
from ppshw.model import Model
from ppshw.recording import Recording
from ppshw.terms import Parameter, Situation, parts_of

Array = NDArray[np.float64]
# Typical prior standard deviations, as factors on where the estimate starts its search (which is wide on purpose). Our
# choice: medians of what the joint estimate learnt from 669 random visits of five simulated positioners (seeds 100 to
# 104, never among those that figures are reported on; of a link's elements the rms), rounded upwards. Rails and
# bearings bend in long waves.
GEOMETRIC = {"line": 0.3, "band0": 0.3, "band1": 0.1}
SHORT_WAVES = 0.03
COMPLIANCE = {
    "rM.line": 1.0, "rM.shape": 0.1, "tM.line": 0.1, "tM.shape": 0.03, "tF.line": 0.1, "tF.shape": 0.03,
    "rM-skew.line": 0.2, "rM-skew.shape": 0.1, "tM-skew.line": 0.3, "tM-skew.shape": 0.15, "tF-skew.line": 0.2,
    "tF-skew.shape": 0.05,
}  # fmt: skip
BLOCK = 256
# Where the instrument stands is known to metres only when the machine file says `base: estimate`.
FREE_BASE = 1e3
CLAIMED = 1.4e-4  # where the machine file says nothing: the paper's [m]


@dataclass(frozen=True)
class Belief:
    """theta (p,) where the model is linearised; strengths (p,) prior standard deviations; origin: said in words."""

    model: Model
    theta: Array
    strengths: Array
    noise: Noise
    origin: str

    @property
    def machine(self) -> Machine:
        return self.model.machine


def typical(machine: Machine, visits: int, point: Array) -> Belief:
    """A machine that nobody has measured yet; point (3,) of interest in the end-effector frame [m]."""
    return _typical(_model(machine, visits), point)


def typical_of(machine: Machine, recording: Recording, point: Array) -> Belief:
    """The same with the model that a recording of just these visits would be given."""
    return _typical(joint_model(machine, recording), point)


def _typical(model: Model, point: Array) -> Belief:
    strengths = np.array([_typical_strength(p) for p in model.parameters()])
    noise = _claimed_noise(model.machine, point)
    return Belief(model, np.zeros(len(strengths)), _free_base(model, strengths), noise, "a typical machine")


def learnt(machine: Machine, visits: int, groups: Mapping[str, float], noise: Noise, origin: str) -> Belief:
    """Strengths per group, and noise, that an estimate learnt; groups that it did not have are typical ones."""
    model = _model(machine, visits)
    strengths = [p.scale * groups[p.group] if p.group in groups else _typical_strength(p) for p in model.parameters()]
    return Belief(model, np.zeros(len(strengths)), _free_base(model, np.array(strengths)), noise, origin)


def _model(machine: Machine, visits: int) -> Model:
    """The estimate's model for that many visits spread over all limits."""
    for joint in machine.joints:
        if joint.limits is None:
            raise CampaignError(f"{machine.file}: joint {joint.name} has no limits; without limits nothing is designed")
    low, high = machine.limits()
    q = low + np.linspace(0.0, 1.0, max(visits, 3))[:, None] * (high - low)
    return joint_model(machine, poses_only(machine, q))


def poses_only(machine: Machine, q: Array) -> Recording:
    """A recording of poses (N, n) without a single reading: what a model's form is decided by."""
    n = len(q)
    return Recording(
        machine.joint_names, tuple(machine.targets), np.full(n, np.nan), ("",) * n, ("",) * n, q, q,
        np.zeros(q.shape, dtype=np.int64), np.full(n, np.nan), np.zeros((n, 6)),
        np.full((n, len(machine.targets), 3), np.nan), {}, {}, {}, False, "design", "",
    )  # fmt: skip


def _typical_strength(p: Parameter) -> float:
    kind, *rest = parts_of(p.group)
    factor = 1.0
    if kind == "geometric":
        factor = GEOMETRIC.get(rest[-1], SHORT_WAVES)
    elif kind == "compliance":
        factor = COMPLIANCE.get(f"{rest[1]}.{rest[-1]}", 1.0)
    return p.scale * p.start * factor


def _free_base(model: Model, strengths: Array) -> Array:
    if model.machine.tracker.base is not None:
        return strengths
    base = [p.group.startswith(f"geometric.{model.machine.frame_names[0]}.") for p in model.parameters()]
    return np.where(base, FREE_BASE * strengths, strengths)


def _claimed_noise(machine: Machine, point: Array) -> Noise:
    """Half of the claimed variance at the point of interest by shifts, half by turns about the end effector."""
    sigma = (machine.repeatability or CLAIMED) / RADIUS_986
    arm = max([float(np.linalg.norm(p)) for p in (point, *machine.target_array)])
    turn = sigma / np.sqrt(2) / max(arm, 0.1) * np.sqrt(1.5)  # a lever arm sees two of the three turns
    return Noise(np.diag([sigma**2 / 2] * 3 + [turn**2] * 3), machine.tracker.position_sigma)


def white_rows(
    belief: Belief, situation: Situation, into: Array | None = None, weights: Array | None = None,
    seen: NDArray[np.bool_] | None = None,
) -> Array:  # fmt: skip
    """What visits say of z = θ/strength, with unit noise.

    into     (p, r) directions of z to keep, all p by default
    weights  (N,) how much each visit is believed, 1 by default;  seen (N, T) targets not lost, all by default
    returns  (N, k, r), k as few rows as the targets have independent ones (six of the nine of three targets)

    From the design X of `Model.linearise` and the covariance R of a visit's coordinates: R^(-1/2) X diag(strengths),
    rows then turned so that those that say nothing can be left out.
    """
    parts: list[Array] = []
    for start in range(0, len(situation), BLOCK):
        some = slice(start, start + BLOCK)
        here = Situation(situation.q[some], situation.payload[some])
        lin = belief.model.linearise(here, belief.theta)
        n, size = len(here), lin.positions.shape[1]
        believed = np.ones(n) if weights is None else np.maximum(weights[some], 1e-9)
        there = np.ones((n, size), dtype=bool) if seen is None else seen[some]
        covariance = belief.noise.covariance(lin.levers, there, believed)
        design = lin.design.reshape(n, 3 * size, -1) * belief.strengths * np.repeat(there, 3, axis=1)[..., None]
        rows = np.linalg.solve(np.linalg.cholesky(covariance), design)
        values, vectors = np.linalg.eigh(rows @ np.swapaxes(rows, 1, 2))
        k = int((values > 1e-9 * values[:, -1:]).sum(axis=1).max())
        rows = np.swapaxes(vectors[:, :, -k:], 1, 2) @ rows
        parts.append(rows if into is None else (rows.reshape(-1, rows.shape[2]) @ into).reshape(n, k, -1))
    most = max(part.shape[1] for part in parts)
    return np.concatenate([np.pad(part, ((0, 0), (most - part.shape[1], 0), (0, 0))) for part in parts])
