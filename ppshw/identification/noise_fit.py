"""The most likely noise for given second moments of the residuals: Fisher scoring, and the choice of its form.

    2 Q(φ) = − Σ_v  log |R_v(φ)| + tr R_v(φ)⁻¹ S_v,     R_v = Σ_k φ_k b_vk b_vkᵀ + σ² I

S_v holds the residual's expected second moment, the model's uncertainty included, so that maximising Q is the M step of
expectation-maximisation, done whole (Dempster et al. 1977; scoring: Jennrich & Sampson 1976). docs/derivations.md §5.1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import nnls

from ppshw.identification.noise import Noise

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
TURNING = np.repeat(np.eye(2), 3, axis=0)  # (6, 2) of six components: shifts, turns
STEPS = 30
# Of a step of the scoring, until the likelihood grows; and where it hardly does any more.
SHARES = (1.0, 0.3, 0.1, 0.02)
ENOUGH = 1e-3
# What was known before counts as so many visits: keeps the variances of a short recording away from zero. A guess.
PRIOR_VISITS = 12.0
# Squared, of the most that a source moves anything by: less is nothing, as of a joint on whose axis the reflector is.
SEEN = 1e-12
# σ moves by no more than this factor per fit, so that a wrong model does not pass for a wrong instrument.
SIGMA_STEP = 5.0


@dataclass(frozen=True)
class Moments:
    """Of n visits on K coordinates each.

    levers (n, K, 6 + 6n);  live (n, K);  second (n, K, K) [m²];  count (n,) as how many visits each one counts
    rest2, freedom: squared length and number of all coordinates that no motion of the end effector reaches
    own (n, 6) squares of the joints' axes in their frames: shares of their own freedoms in their six components
    """

    levers: Array
    live: Mask
    second: Array
    count: Array
    rest2: float
    freedom: float
    own: Array

    def with_prior(self, noise: Noise) -> Moments:
        """As if PRIOR_VISITS (at a few of the recording's poses) had shown `noise`."""
        where = np.linspace(0, len(self.count) - 1, min(8, len(self.count))).astype(int)
        b, live = self.levers[where], self.live[where]
        second = noise.of_rows(b, live, np.ones(len(where))) * (live[:, :, None] & live[:, None, :])
        per_visit = self.freedom / max(self.count.sum(), 1.0)
        return Moments(
            np.concatenate([self.levers, b]), np.concatenate([self.live, live]),
            np.concatenate([self.second, second]),
            np.concatenate([self.count, np.full(len(where), PRIOR_VISITS / len(where))]),
            self.rest2 + PRIOR_VISITS * per_visit * noise.instrument**2,
            self.freedom + PRIOR_VISITS * per_visit, self.own,
        )  # fmt: skip

    def likelihood(self, noise: Noise) -> float:
        """2 Q of above."""
        whole = noise.of_rows(self.levers, self.live, np.ones(len(self.count)))
        inverse = np.linalg.inv(whole)
        fit = np.einsum("nij,nij->n", inverse, self.second) + np.linalg.slogdet(whole)[1]
        rest = self.rest2 / noise.instrument**2 + self.freedom * np.log(noise.instrument**2)
        return -float(self.count @ fit + rest)


class Form(Enum):
    """How the pose scatters."""

    EVEN = "the end effector, alike in all directions"
    TIP = "the end effector, by one covariance wherever it stands"
    JOINTS = "every joint by itself: one variance for its shifts, one for its turns"
    DRIVES = "the end effector, alike in all directions, and every joint on its own way"


def choose(moments: Moments, before: Noise, rank: int) -> tuple[Form, Noise]:
    """The form that the data speak for, every free number costing log n (Schwarz 1978), and its noise."""
    cost = float(np.log(max(moments.count.sum(), 2.0)))
    even = _even(moments, before, rank)
    found = {form: _fit(form, moments, before, even, rank) for form in Form}
    value = {form: moments.likelihood(noise) - cost * _free(form, noise, rank) for form, noise in found.items()}
    best = max(value, key=lambda form: value[form])
    return best, found[best] if found[best].parts is None else replace(found[best], pose=found[Form.TIP].pose)


def fit(form: Form, moments: Moments, before: Noise, rank: int) -> Noise:
    """The most likely noise of this form; where there are many variances, drawn a little towards few."""
    even = _even(moments, before, rank)
    found = _fit(form, moments, before, even, rank)
    return found if found.parts is None else replace(found, pose=_fit(Form.TIP, moments, before, even, rank).pose)


def _even(moments: Moments, before: Noise, rank: int) -> Noise:
    """The end effector scatters alike in all directions: one variance for shifts, one for turns, and the instrument."""
    at_the_tip = TURNING[:, : rank // 3]
    return fit_variances(moments, before, at_the_tip, lambda v, sigma: Noise(np.diag(v), sigma), rank == 6)


def _fit(form: Form, moments: Moments, before: Noise, even: Noise, rank: int) -> Noise:
    """`fit`, beside the even noise, but that `pose` says nothing where the noise is of several parts."""
    if form is Form.JOINTS:
        joints = len(moments.own)
        alike = _of_parts(moments, before, rank, np.vstack([np.zeros((6, 2)), np.tile(TURNING, (joints, 1))]))
        each = block_diag(np.zeros((6, 0)), *[TURNING] * joints)
        return _of_parts(moments.with_prior(alike), alike, rank, each)
    if form is Form.EVEN:
        return even
    if form is Form.TIP:
        return fit_pose(moments.with_prior(even), even, rank)
    own = block_diag(TURNING[:, : rank // 3], *(share[:, None] for share in moments.own))
    return _of_parts(moments.with_prior(even), even, rank, own)


def _free(form: Form, noise: Noise, rank: int) -> int:
    """Free numbers; of several parts' variances those that are not nothing."""
    if noise.parts is not None:
        shifts, turns = noise.parts[:, :3] > 0, noise.parts[:, 3:] > 0
        return int(shifts.any(axis=1).sum() + turns.any(axis=1).sum())
    return rank // 3 if form is Form.EVEN else rank * (rank + 1) // 2


def fit_pose(moments: Moments, noise: Noise, rank: int) -> Noise:
    """The most likely `pose` and `instrument`. With rank 3 the rotations stay zero and the instrument as it is."""
    start = replace(noise, parts=None)
    b = moments.levers[..., :rank] * moments.live[..., None]
    twice = _symmetric(rank)
    best, value = start, moments.likelihood(start)
    for _ in range(STEPS):
        scale = np.sqrt(np.maximum(np.diag(best.pose)[:rank], 1e-18))
        inverse, excess = _excess(moments, best)
        u = inverse @ (b * scale)  # (n, K, r)
        m = np.swapaxes(b * scale, 1, 2) @ u
        score = np.einsum("n,nab->ab", moments.count, np.swapaxes(u, 1, 2) @ excess @ u)
        pairs = m.reshape(len(m), -1)
        info = ((pairs.T * moments.count) @ pairs).reshape((rank,) * 4).transpose(1, 2, 3, 0).reshape(rank**2, rank**2)
        gradient, hessian = twice.T @ score.ravel(), twice.T @ info @ twice
        if rank == 6:
            gradient, hessian = _with_instrument(moments, best, inverse, excess, twice.T @ _cross(moments, u), gradient,
                                                 hessian)  # fmt: skip
        step = np.linalg.lstsq(hessian, gradient, rcond=1e-10)[0]
        found = None
        for share in SHARES:
            move = (twice @ (share * step[: twice.shape[1]])).reshape(rank, rank) * np.outer(scale, scale)
            pose = np.zeros((6, 6))
            pose[:rank, :rank] = _positive(best.pose[:rank, :rank] + move, scale)
            sigma2 = best.instrument**2 * (1.0 + share * step[-1]) if rank == 6 else best.instrument**2
            trial = Noise(pose, _bounded(sigma2, noise.instrument))
            if (reached := moments.likelihood(trial)) > value:
                found = trial
                break
        if found is None:
            break
        gained, best, value = reached - value, found, reached
        if gained < ENOUGH:
            break
    return best


def fit_variances(
    moments: Moments, start: Noise, member: Array, make: Callable[[Array, float], Noise], learn_instrument: bool
) -> Noise:
    """The most likely variances of independent sources, and the instrument's.

    member  (M, g) share of each source in the variances of the first M levers
    make    variances (M,) and σ → the noise
    """
    number = member.shape[1]
    b = moments.levers[..., : len(member)] * moments.live[..., None]
    size = (member.T @ np.einsum("n,nik->k", moments.count, b**2)) / moments.count.sum()
    moves = size > SEEN * size.max()
    variances = np.where(moves, start.instrument**2 * b.shape[1] / np.where(moves, size, 1.0) / number, 0.0)
    best = make(member @ variances, start.instrument)
    value = moments.likelihood(best)
    for _ in range(STEPS):
        inverse, excess = _excess(moments, best)
        u = inverse @ b
        m = np.swapaxes(b, 1, 2) @ u
        score = np.einsum("n,nik,nik->k", moments.count, u, excess @ u)
        info = np.tensordot(moments.count, m**2, axes=1)
        gradient, hessian = member.T @ score, member.T @ info @ member
        scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-300))
        gradient, hessian, now = gradient * scale, hessian * np.outer(scale, scale), variances / scale
        if learn_instrument:
            cross = member.T @ np.einsum("n,nik->k", moments.count, u**2) * scale
            gradient, hessian = _with_instrument(moments, best, inverse, excess, cross, gradient, hessian)
            now = np.append(now, 1.0)
        wanted = _bounded_maximum(hessian, gradient, now)
        found = None
        for share in SHARES:
            there = now + share * (wanted - now)
            sigma2 = best.instrument**2 * (there[-1] if learn_instrument else 1.0)
            trial = make(member @ (there[:number] * scale), _bounded(sigma2, start.instrument))
            if (reached := moments.likelihood(trial)) > value:
                found = trial
                break
        if found is None:
            break
        gained, best, value, variances = reached - value, found, reached, there[:number] * scale
        if gained < ENOUGH:
            break
    return best


def _of_parts(moments: Moments, start: Noise, rank: int, member: Array) -> Noise:
    """End effector and joints scatter by themselves: member (6 + 6n, g) says which components share a variance."""

    def make(variances: Array, sigma: float) -> Noise:
        return Noise(start.pose, sigma, variances.reshape(-1, 6))

    return fit_variances(moments, start, member, make, rank == 6)


def _excess(moments: Moments, noise: Noise) -> tuple[Array, Array]:
    """R⁻¹ and S − R of every visit, dead coordinates zero."""
    live = moments.live[:, :, None] & moments.live[:, None, :]
    whole = noise.of_rows(moments.levers, moments.live, np.ones(len(moments.count)))
    return np.asarray(np.linalg.inv(whole) * live, dtype=np.float64), (moments.second - whole) * live


def _with_instrument(
    moments: Moments, noise: Noise, inverse: Array, excess: Array, cross: Array, gradient: Array, hessian: Array
) -> tuple[Array, Array]:
    """One more row for σ², in units of its present value."""
    sigma2 = noise.instrument**2
    inner = inverse @ excess @ inverse
    slope = moments.count @ np.trace(inner, axis1=1, axis2=2) * sigma2
    curve = moments.count @ np.einsum("nij,nij->n", inverse, inverse) * sigma2**2
    slope += moments.rest2 / sigma2 - moments.freedom
    curve += moments.freedom
    out = np.zeros((len(gradient) + 1,) * 2)
    out[:-1, :-1], out[-1, :-1], out[:-1, -1], out[-1, -1] = hessian, cross * sigma2, cross * sigma2, curve
    return np.append(gradient, slope), out


def _cross(moments: Moments, u: Array) -> Array:
    return np.asarray(np.einsum("n,nia,nib->ab", moments.count, u, u, optimize=True).ravel())


def _bounded_maximum(hessian: Array, gradient: Array, now: Array) -> Array:
    """arg max of gᵀ(φ − now) − ½ (φ − now)ᵀ H (φ − now) over φ ≥ 0 (Lawson & Hanson's non-negative least squares)."""
    ridge = hessian + 1e-9 * np.trace(hessian) / len(hessian) * np.eye(len(hessian))
    upper = np.linalg.cholesky(ridge).T
    return np.asarray(nnls(upper, upper @ now + np.linalg.solve(upper.T, gradient))[0])


def _bounded(sigma2: float, before: float) -> float:
    return float(np.sqrt(np.clip(sigma2, (before / SIGMA_STEP) ** 2, (before * SIGMA_STEP) ** 2)))


def _positive(pose: Array, scale: Array) -> Array:
    """The nearest covariance with no direction without any scatter."""
    values, vectors = np.linalg.eigh(pose / np.outer(scale, scale))
    return np.asarray((vectors * np.maximum(values, 1e-4)) @ vectors.T * np.outer(scale, scale))


def _symmetric(size: int) -> Array:
    """(size², size(size+1)/2): symmetric matrices from their independent elements."""
    out = []
    for a in range(size):
        for b in range(a, size):
            one = np.zeros((size, size))
            one[a, b] = one[b, a] = 1.0
            out.append(one.ravel())
    return np.array(out).T
