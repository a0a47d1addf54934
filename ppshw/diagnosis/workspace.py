"""A recording seen through the base model: what is left, whitened, and what the base model would absorb of anything.

With V = R + X Λ Xᵀ (noise and everything the base model may still mean), a candidate with columns Z has

    score  S = Zᵀ V⁻¹ y,    information  I = Zᵀ V⁻¹ Z,    V⁻¹ = R⁻¹ − R⁻¹X (XᵀR⁻¹X + Λ⁻¹)⁻¹ XᵀR⁻¹

so that no candidate is credited with what the base model can explain. docs/diagnosis-method.md §2.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, cho_factor, cho_solve

from ppshw.identification.joint import Estimate, estimate
from ppshw.identification.start import to_base
from ppshw.identification.structure import MOST_WAVES, joint_model
from ppshw.machine import Machine
from ppshw.model import Model
from ppshw.recording import Recording
from ppshw.terms import Situation
from ppshw.terms.basis import BAND_EDGES
from ppshw.terms.shapes import Column, Context
from ppshw.terms.target import TargetOffset

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
# While names are sought the base model may take so many times what its learnt strengths say. A coefficient that is
# large in its group is held back by the group's strength, and what is held back would be found as an effect (measured:
# with 1, one of sixteen clean recordings had a finding and two with an invisible effect one of something else; with 2
# none of these).
CAUTION = 2.0
# Compliances even more: an error of the force sensor or another weight acts through the very compliance that the
# prior's zero mean has made too small, always to the same side (in 23 clean recordings of an arm, which bends under its
# own weight most, a sensor's gain stood 2.0 standard deviations off on average with 2, 0.7 with 5, 0.1 with 20).
CAUTION_ELASTIC = 20.0
# Reflectors are measured on the end effector as well as instruments do, a few µm, and sit in their nests again as well
# as that: with what 450 visits say of them, to 1 µm, an author's that were 4 µm (one coordinate) from where his files
# have them were said to have moved in eight of 64 recordings, or made a scale of 12 to 25 ppm. Two or more say by their
# distances how well they are known, up to what a site's own survey leaves; one of three or more that was moved, by as
# much as any of these, is no measure of the others. Each step costs log evidence, and so does one that was moved
# (judgements): without, two of seed 54 that had been moved by 83 and 168 µm were three that are known to 40 µm.
KNOWN_TO, A_STEP = (5e-6, 10e-6, 20e-6, 40e-6), 3.0
MOVED, ONE_MOVED = (6e-5, 2e-4, 1e-3), 3.0
A_SCALE, NO_SCALE = 3e-5, 1e-12  # of the instrument: stretches what is between three reflectors alike
FOLDS, BLOCK = 4, 15  # of visits that are held out in turn
NOTHING = 1e-8  # squared length of a direction that takes up less than this share of any column
# Machined guides and bearings err slowly along their travel. A joint whose finest waves (four to seven of them over the
# travel) are so many times the median joint's has something there that is no geometry: it is not to be absorbed. Nor
# where those before (two to three) stand out more: 5.4 times at most in 16 clean machines, 43 where a gear did.
FINEST = int(np.searchsorted(BAND_EDGES, MOST_WAVES))
STANDS_OUT = {f".band{FINEST}": 3.0, f".band{FINEST - 1}": 6.0}


@dataclass
class Workspace:
    """N visits of which some, that saw a target, are for the fit; rows are the 3T coordinates of a visit.

    fit        (N,)               which visits the fit may use; F of them
    context    what the shapes of effects look at
    design     (N, 3T, p)         of the base model
    data       (N, 3T)            measured − predicted + design θ
    root       (N, 3T, 3T)        L⁻¹ of the noise covariance, so that root·(noise) is white; 0 for lost targets
    prior      (p,)               prior standard deviations of the base model's parameters
    caution    (p,)               how many times what was learnt they are
    calming    (N, 3T, 3T)        part of root: by what a visit's noise is multiplied where it swings more than others'
    active     which of all the base model's parameters the p columns are
    taken      (N, 3T, k), taken_prior (k,): columns of findings that were taken up
    """

    machine: Machine
    recording: Recording
    fit: Mask
    base: Estimate
    context: Context
    design: Array
    data: Array
    root: Array
    prior: Array
    active: Mask
    caution: Array
    calming: Array
    taken: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))
    taken_prior: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        self.white = self.whiten(self.design)
        precision = self.white.T @ self.white
        precision[np.diag_indices_from(precision)] += 1.0 / self.prior**2
        self.factor = cho_factor(precision, lower=True)
        self.y = self.whiten(self.data[..., None])[:, 0]
        self.forget()

    def with_fit(self, fit: Mask) -> Workspace:
        """The same with other visits for the fit, and nothing taken up."""
        return replace(self, fit=fit)

    def as_learnt(self, but_elastic: bool = False) -> Workspace:
        """The same with the prior strengths as the base model learnt them: for values and predictions.

        but_elastic  leave the compliances as free as they are: held back, they make too much or too little of what acts
                     through them
        """
        caution = np.where(but_elastic & (self.caution > CAUTION), self.caution, 1.0)
        final = replace(self, prior=self.prior / self.caution * caution, caution=caution)
        final.take_up(self.taken, self.taken_prior)
        return final

    def as_estimated(self) -> Workspace:
        """The base model of the estimate, which takes known reflectors to be where the machine file has them: the
        same without their offsets, and without what was taken up; itself where they were estimated."""
        if not self.machine.tracker.targets_known:
            return self
        keep = np.flatnonzero(self.active) < len(self.active) - 3 * len(self.machine.targets)
        active = self.active.copy()
        active[-3 * len(self.machine.targets) :] = False
        return replace(
            self, design=self.design[:, :, keep], prior=self.prior[keep], caution=self.caution[keep], active=active
        )  # fmt: skip

    @property
    def calmed(self) -> bool:
        """Whether some visits were found to swing more than others."""
        return bool((self.calming != np.eye(self.rows)).any())

    @property
    def unit(self) -> float:
        """What sizes of effects are measured in, rms at the reflectors [m]: the repeatability, and where the instrument
        scatters more than the machine, its noise (what a reflector that moved leaves is put down to the instrument, to
        the last of the repeatability where it is much: nothing had a size then, and nothing was found)."""
        return max(self.base.noise.repeatability, self.base.noise.instrument)

    @property
    def reflectors_off(self) -> float | None:
        """How far known reflectors are from where the machine file has them [m], rms of a coordinate, where that is
        more than surveys leave; they say so themselves (_reflectors_learnt)."""
        known_to = self.base.groups.get("target", 0.0)
        return known_to if self.machine.tracker.targets_known and known_to > KNOWN_TO[1] else None

    @property
    def rows(self) -> int:
        return int(self.data.shape[1])

    def whiten(self, columns: Array) -> Array:
        """(N, 3T, k) → (F·3T, k): of the fit visits, whitened."""
        white = self.root[self.fit] @ columns[self.fit]
        return white.reshape(white.shape[0] * white.shape[1], columns.shape[2])

    def absorb(self, white: Array) -> Array:
        """P Z: whitened columns (F·3T, k) less what the base model takes of them."""
        return np.asarray(white - self.white @ cho_solve(self.factor, self.white.T @ white, check_finite=False))

    @cached_property
    def directions(self) -> tuple[Array, Array, Array]:
        """A (F·3T, a), s² (a,) and W (p, a) of the base model's columns at their prior standard deviations, whitened:
        A = X Λ½ W with orthogonal columns of squared lengths s², of the a directions that take up anything."""
        scaled = self.white * self.prior
        lengths, turn = np.linalg.eigh(scaled.T @ scaled)
        some = lengths > NOTHING  # few visits tell fewer directions of the base model than it has parameters
        return scaled @ turn[:, some], lengths[some], turn[:, some]

    @cached_property
    def kept(self) -> Array:
        """(F, 3T, 3T) of P: what the base model leaves of a fit visit's own readings."""
        blocks = self.white.reshape(-1, self.rows, self.white.shape[1])
        half = cho_solve(self.factor, self.white.T, check_finite=False).T.reshape(blocks.shape)
        return np.asarray(np.eye(self.rows) - blocks @ np.swapaxes(half, 1, 2))

    def forget(self) -> None:
        """Nothing taken up."""
        self.take_up(np.zeros((*self.data.shape, 0)), np.zeros(0))

    def take_up(self, columns: Array, prior: Array, seen: tuple[Array, Array] | None = None) -> None:
        """Let the model have exactly these further columns (N, 3T, k) with prior standard deviations (k,).

        seen  the columns whitened and less what the base model takes of them, (F·3T, k) each, where that is known

        What they absorb beyond the base model is a projection of rank k: P' = P − P F M Fᵀ P, M = (Λ⁻¹ + Fᵀ P F)⁻¹.
        """
        self.taken, self.taken_prior = columns, prior
        white = self.whiten(columns) if seen is None else seen[0]
        self.taken_white, self.absorbed = (white, self.absorb(white)) if seen is None else seen
        self.middle = np.linalg.inv(self.taken_white.T @ self.absorbed + np.diag(1.0 / prior**2))

    def keeping(self, keep: Mask) -> Workspace:
        """Another workspace with only these (k,) of the columns that were taken up."""
        some = copy(self)
        known = self.taken_white[:, keep], self.absorbed[:, keep]
        some.take_up(self.taken[:, :, keep], self.taken_prior[keep], known)
        return some

    def log_evidence(self) -> float:
        """Log evidence of what was taken up against nothing (MacKay 1992): ½ bᵀMb − ½ ln det(Λ M⁻¹), b = Fᵀ P y."""
        if not len(self.taken_prior):
            return 0.0
        along = self.absorbed.T @ self.y
        logdet = -np.linalg.slogdet(self.middle)[1] + 2 * np.log(self.taken_prior).sum()
        return float(0.5 * (along @ self.middle @ along - logdet))

    def left(self) -> Array:
        """(F·3T,) P' y: whitened residual of the fit visits."""
        return self.left_of(self.y[:, None])[:, 0]

    def left_of(self, white: Array) -> Array:
        """P' Z: whitened columns (F·3T, k) less what the base model and all that was taken up take of them."""
        return np.asarray(self.absorb(white) - self.absorbed @ (self.middle @ (self.absorbed.T @ white)))

    def coefficients(self) -> tuple[Array, Array]:
        """θ of the base model (p,) and of what was taken up (k,), from the fit visits."""
        extra = self.middle @ (self.absorbed.T @ self.y)
        base = cho_solve(self.factor, self.white.T @ (self.y - self.taken_white @ extra))
        return np.asarray(base), np.asarray(extra)

    def mimicked(self, moved: Array) -> Array:
        """θ of the base model (p,) by which it would take what it can of a displacement (N, 3T) of the fit visits."""
        return np.asarray(cho_solve(self.factor, self.white.T @ self.whiten(moved[..., None])[:, 0]))

    def moved(self) -> Array:
        """(N, 3T) what was taken up does to every visit [m], base axes."""
        return np.asarray(self.taken @ self.coefficients()[1])

    def beyond(self, moved: Array) -> Array:
        """(N, 3T) what the base model leaves of a displacement (N, 3T) of every visit [m], fitted to the fit visits."""
        return np.asarray(moved - self.design @ self.mimicked(moved))

    def rms(self, displacement: Array) -> float:
        """Of a displacement (N, 3T) over all readings [m]."""
        return float(np.sqrt((displacement**2).sum() / max(int(self.recording.seen.sum()), 1)))

    def residual(self) -> Array:
        """(N, 3T) what the fitted model leaves of every visit, held-out ones included [m]; nan where lost."""
        base, extra = self.coefficients()
        left = self.data - self.design @ base - self.taken @ extra
        return np.where(np.repeat(self.recording.seen, 3, axis=1), left, np.nan)


def _about_reflectors(base: Estimate) -> Estimate:
    """The base model with reflectors that are known as well as they can be, no better."""
    if base.model.target_offset is not None:
        return base
    offset = TargetOffset(tuple(base.model.machine.targets))
    more = offset.parameters(())
    covariance = block_diag(base.covariance, KNOWN_TO[0] ** 2 * np.eye(len(more)))
    groups = {**base.groups, **{p.group: KNOWN_TO[0] for p in more}}
    theta, model = np.append(base.theta, np.zeros(len(more))), replace(base.model, target_offset=offset)
    alone = None if base.alone is None else np.append(base.alone, np.zeros(len(more)))
    return replace(base, model=model, theta=theta, covariance=covariance, groups=groups, alone=alone)


def _reflectors_learnt(space: Workspace) -> Workspace:
    """The same with known reflectors as well known as two or more of them say themselves: the largest evidence of what
    their offsets leave (as log_evidence), all alike or, of three or more, but for one, beside a scale of the
    instrument, or both. Equal for those of one: they turn with the tip."""
    count = 3 * len(space.machine.targets)  # the last parameters
    active = np.flatnonzero(space.active) - (len(space.active) - count)
    mine = active >= 0
    which = active[mine] // 3
    if len(np.unique(which)) < 2:
        return space
    scale = space.whiten(Column("points", "scale", {}).evaluate(space.context)[..., None])
    asked, others = np.hstack([space.white[:, mine], scale]), space.white[:, ~mine]
    precision = others.T @ others + np.diag(1.0 / space.prior[~mine] ** 2)
    across = np.linalg.solve(precision, others.T @ asked)
    information = asked.T @ asked - (others.T @ asked).T @ across
    score = asked.T @ space.y - across.T @ (others.T @ space.y)

    def said(targets: Array, factor: float = NO_SCALE) -> float:
        known = np.append(targets, factor)
        inner = np.diag(1.0 / known**2) + information
        logdet = np.linalg.slogdet(inner)[1] + 2.0 * np.log(known).sum()
        return float(0.5 * (score @ np.linalg.solve(inner, score) - logdet))

    tried = []
    for step, s in enumerate(KNOWN_TO):
        alike = np.full(len(which), s)
        tried.append((said(alike) - A_STEP * step, s))
        if len(np.unique(which)) > 2:
            one = [np.where(which == k, moved, s) for k in np.unique(which) for moved in MOVED]
            either = max(*(said(each) for each in one), said(alike, A_SCALE))
            both = max(said(each, A_SCALE) for each in one) - ONE_MOVED
            tried.append((max(either, both) - A_STEP * step - ONE_MOVED, s))
    known_to = max(tried)[1]
    covariance = space.base.covariance.copy()
    covariance[-count:, -count:] = known_to**2 * np.eye(count)
    base = replace(space.base, covariance=covariance, groups={**space.base.groups, "target": known_to})
    return replace(space, base=base, prior=np.where(mine, known_to, space.prior))


def caution_of(model: Model, strengths: Array) -> Array:
    """(p,) how many times its learnt strength (p,) every parameter may take while names are sought."""
    groups = [p.group for p in model.parameters()]
    elastic = np.array([group.startswith("compliance.") for group in groups])
    out = np.where(elastic, CAUTION_ELASTIC, CAUTION)
    if model.machine.tracker.targets_known:  # what they say together is all of it
        out[np.array(groups) == "target"] = 1.0
    for band, times in STANDS_OUT.items():
        for kind in "tr":
            mine = np.array([group.startswith("geometric.") and group.endswith(f".{kind}{band}") for group in groups])
            if mine.any():
                most = times * np.median(strengths[mine])
                out[mine] *= np.minimum(1.0, most / np.maximum(strengths[mine], 1e-30))
    return out


def folds(count: int) -> list[Mask]:
    """Held-out visits of each of FOLDS: blocks of BLOCK visits in time, dealt in turn (shorter in short recordings)."""
    length = max(1, min(BLOCK, count // (3 * FOLDS)))
    which = (np.arange(count) // length) % FOLDS
    return [which == k for k in range(FOLDS)]


def prepare(
    machine: Machine, recording: Recording, fit: Mask, base: Estimate | None = None, calming: Array | None = None,
    sure: Sequence[int] = (),
) -> Workspace:  # fmt: skip
    """Fit the base model to the fit visits and lay everything ready. Visits without any target are none of them: they
    are only what went before the others.

    sure  visits that are believed in full however far off they are
    """
    base = base or estimate(joint_model(machine, recording.subset(fit)), recording.subset(fit))
    learn = base.model.target_offset is None
    base = _about_reflectors(base)
    model, situation = base.model, Situation.of(recording)
    count = len(recording)
    lin = model.linearise(situation, base.theta)
    seen = recording.seen
    rows = np.repeat(seen, 3, axis=1)
    strengths = np.array([base.groups[p.group] * p.scale for p in model.parameters()])
    size = np.sqrt(np.mean(lin.design.reshape(-1, lin.design.shape[3]) ** 2, axis=0)) * strengths
    active = size > 1e-8  # a column whose prior moves the targets by less than 10 nm is no column
    design = lin.design.reshape(count, rows.shape[1], -1)[:, :, active] * rows[..., None]
    gap = np.where(seen[..., None], to_base(recording.points, base.measuring_in_base) - lin.positions, 0.0)
    data = gap.reshape(count, -1) + design @ base.theta[active]
    caution = caution_of(model, strengths)[active]
    root = base.noise.whitener(lin.levers, seen)
    weights = np.ones(count)
    weights[fit] = np.maximum(base.weights, 1e-3)
    weights[list(sure)] = 1.0
    calming = np.tile(np.eye(rows.shape[1]), (count, 1, 1)) if calming is None else calming
    root = calming @ root * np.sqrt(weights)[:, None, None]
    context = Context.of(model, base.theta, recording, base.measuring_in_base)
    context = replace(context, jacobian=context.jacobian * rows[:, :, None, None])
    space = Workspace(
        machine,
        recording,
        fit,
        base,
        context,
        design,
        data,
        root,
        caution * strengths[active],
        active,
        caution,
        calming,
    )
    return _reflectors_learnt(space) if learn else space
