"""What a model would leave of visits that it had made itself: the yardstick for what it leaves of the recorded ones.

A twin of the recording is noise on top of the model's own prediction. Fitted as the recording was, it leaves

    r = √w e − D δ,    δ = G (Dᵀe − Λ^−½ z),    e, z ~ N(0, 1)

(whitened; D: all columns of the fit, G = (DᵀD + Λ⁻¹)⁻¹ what it is unsure of, w: how far a visit was believed), so that
what a fit absorbs of anything is in the null. Gelman, Meng & Stern (1996), posterior predictive checks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve

from ppshw.diagnosis.workspace import Workspace
from ppshw.recording import Recording
from ppshw.terms.shapes import Context

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Single = NDArray[np.float32]
Wrong = Callable[[Single, np.random.Generator], Single]
AT_ONCE = 1 << 21  # numbers drawn at a time: 16 MB


@dataclass(frozen=True)
class Compared:
    """What a model leaves of M visits, and what it would leave of its own.

    left     (M, 3T)      whitened residual, a visit's own weight taken out again; 0 where a target was lost
    root     (M, 3T, 3T)  what whitens
    live     (M, 3T)      which coordinates were measured
    weights  (M,)         how far the fit believed a visit
    design   (M·3T, k)    whitened columns of the fit
    wrong    draws of white noise (d, M·3T) → how wrong a fit of them is in its coefficients (d, k)
    context  of the M visits
    calming  (M, 3T, 3T) by what the fit multiplied a visit's noise besides; None: by nothing
    """

    left: Array
    root: Array
    live: Mask
    weights: Array
    design: Single
    wrong: Wrong
    context: Context
    calming: Array | None = None

    def __len__(self) -> int:
        return len(self.left)

    @property
    def recording(self) -> Recording:
        return self.context.recording

    def replicas(self, rng: np.random.Generator, draws: int) -> Iterator[Single]:
        """(d, M, 3T) at a time, `draws` in all: like `left`, of visits that the model itself made."""
        size = self.left.size
        step = max(1, min(draws, AT_ONCE // size))
        weight = np.repeat(np.sqrt(self.weights), self.left.shape[1]).astype(np.float32)
        scale = self.live.ravel() * weight
        back = None if self.calming is None else np.asarray(np.linalg.inv(self.calming))
        for at in range(0, draws, step):
            count = min(step, draws - at)
            noise = np.asarray(rng.standard_normal((count, size), dtype=np.float32) * scale, dtype=np.float32)
            noise = self._multiplied(noise, self.calming)
            noise -= self.wrong(noise, rng) @ self.design.T
            noise = self._multiplied(noise, back)
            yield np.asarray(noise / weight, dtype=np.float32).reshape(count, *self.left.shape)

    def _multiplied(self, noise: Single, by: Array | None) -> Single:
        """(d, M·3T), each visit's part by its matrix."""
        if by is None:
            return noise
        parts = noise.reshape(len(noise), *self.left.shape)
        return np.asarray(np.einsum("mij,dmj->dmi", by, parts), dtype=np.float32).reshape(noise.shape)


def of_space(space: Workspace, found: bool = True, everything: bool = False) -> Compared:
    """What the fit of a diagnosis leaves.

    found       with the findings taken up, or by the base model alone
    everything  also the visits that were set aside
    """
    if not found:
        space = copy(space)
        space.forget()
    weights = np.ones(len(space.recording))
    weights[space.fit] = np.maximum(space.base.weights, 1e-3)
    which = space.recording.measured if everything else space.fit
    columns = np.concatenate([space.design, space.taken], axis=2)[which]
    base, extra = space.coefficients()
    left = space.data[which] - columns @ np.concatenate([base, extra])
    size = space.rows
    rows = np.repeat(space.recording.seen, 3, axis=1)[which]
    white = (space.root[which] @ columns).reshape(-1, columns.shape[2]).astype(np.float32)
    fitted = np.repeat(space.fit[which], size)
    inside = white if fitted.all() else white * fitted[:, None]
    number = len(base)
    cross = space.white.T @ space.taken_white
    prior = np.concatenate([space.prior, space.taken_prior])

    def wrong(noise: Single, rng: np.random.Generator) -> Single:
        moment = np.asarray(noise @ inside, dtype=float).T
        moment -= rng.standard_normal(moment.shape) / prior[:, None]
        a, b = moment[:number], moment[number:]
        more = space.middle @ (b - cross.T @ cho_solve(space.factor, a))
        delta = np.concatenate([cho_solve(space.factor, a - cross @ more), more])
        return delta.T.astype(np.float32)

    root = space.root[which] / np.sqrt(weights[which])[:, None, None]
    calming = None if found else space.calming[which]  # that some visits swing more was found too
    if calming is not None:
        root = np.asarray(np.linalg.solve(calming, root))
    return Compared(
        np.einsum("nij,nj->ni", root, left * rows), root, rows, weights[which], white, wrong,
        visits_of(space.context, which), calming,
    )  # fmt: skip


def visits_of(c: Context, which: Mask) -> Context:
    """The context of some of its visits, referring to the same moments and ranges."""
    if which.all():
        return c
    return replace(
        c, recording=c.recording.subset(which), jacobian=c.jacobian[which], wrenches=c.wrenches[which],
        points=c.points[which], tips=c.tips[which], chain=c.chain[which], compliance=c.compliance[which],
        hours=c.hours[which],
    )  # fmt: skip
