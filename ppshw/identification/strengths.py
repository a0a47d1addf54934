"""How strong the priors are: one variance per group of parameters, by the marginal likelihood.

All of it happens on the p × p normal equations; visits are not looked at. Given the others, the likelihood of one
group's variance is a function of one number that can be written down (5.5), so that every group is moved towards its
maximum instead of by a fixed point's small steps. Variances of the same kind of group (the shifts' first waves, say, or
a link's turns by moments) are drawn together over joints and elements. docs/derivations.md §5.3.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from ppshw.errors import IdentificationFailed
from ppshw.terms import Parameter, parts_of

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
# Prior variances stay within these factors of where they start (as variances): from nothing to some 30 mm and 15 mrad.
# Without the upper one, errors of parallel axes that cancel each other may grow to metres while noise is still unknown.
SMALLEST, LARGEST = 1e-10, 1e3
# Compliances may grow to 2e-3 rad/(N m): the wrist of a small arm gives way a thousand times as much as a positioner's
# link, and under its few newton metres that is no more than a turn may be.
LARGEST_COMPLIANCE = 1e8
# Logarithms of one kind's variances scatter by this much over joints and elements (a factor of 3.5 in size) about a
# mean that starts at exp(KIND) of the group's start and counts as half a group there. Our judgement of machines.
ALIKE, KIND, KIND_COUNTS = 2.5, -3.0, 0.5
# Factors that a variance is tried at in one step, and how much of the way is gone: all groups move at once, and two
# that explain the same would swing. Less than the whole way also spares groups that matter once the noise is known.
TIMES = np.geomspace(1e-3, 1e3, 121)
SHARE, MOST = 0.5, 30.0
AT_LIMIT = 0.99  # of the largest size
# A group whose prior adds less than this share to the noise's variance, at the mean over all visits, is left out.
NEGLIGIBLE = 1e-3


@dataclass(frozen=True)
class Groups:
    """Which parameters share a prior variance: of (p,) index, scale (p,), and per group name, start, kind and whether
    its variance is held where it is."""

    names: list[str]
    of: Index
    scale: Array
    start: Array
    kind: Index
    held: Mask

    @classmethod
    def among(cls, parameters: Sequence[Parameter], held: Sequence[str] = ()) -> Groups:
        """held: groups' names begin with one of these."""
        names = list(dict.fromkeys(p.group for p in parameters))
        index = {name: k for k, name in enumerate(names)}
        start = np.zeros(len(names))
        for p in parameters:
            start[index[p.group]] = p.start
        kinds = [_kind(name) for name in names]
        order = {kind: k for k, kind in enumerate(dict.fromkeys(kinds))}
        return cls(
            names, np.array([index[p.group] for p in parameters], dtype=np.int64),
            np.array([p.scale for p in parameters]), start, np.array([order[k] for k in kinds], dtype=np.int64),
            np.array([any(name.startswith(h) for h in held) for name in names], dtype=bool),
        )  # fmt: skip

    @cached_property
    def bent(self) -> list[str | None]:
        """Of every group that is an element of a compliance's mean over the travel the joint, None of others."""
        parts = [parts_of(name) for name in self.names]
        return [each[1] if each[0] == "compliance" and each[-1] == "line" else None for each in parts]

    @property
    def of_compliances(self) -> Mask:
        """(p,) these elements, each a group by itself."""
        return np.array([joint is not None for joint in self.bent], dtype=bool)[self.of]

    @property
    def limits(self) -> tuple[Array, Array]:
        """(G,) the least and the most that a variance may become."""
        most = np.where([name.startswith("compliance.") for name in self.names], LARGEST_COMPLIANCE, LARGEST)
        return SMALLEST * self.start**2, most * self.start**2

    def expected(self, variances: Array, which: Index) -> Array:
        """(G,) mean logarithm of the variances of every group's kind, over the groups `which`."""
        total = np.full(self.kind.max() + 1, 0.0)
        count = np.zeros(len(total))
        start = np.zeros(len(total))
        start[self.kind] = np.log(self.start**2) + KIND
        np.add.at(total, self.kind[which], np.log(variances[which]))
        np.add.at(count, self.kind[which], 1.0)
        return np.asarray(((total + KIND_COUNTS * start) / (count + KIND_COUNTS))[self.kind])


def held_back(parameters: Sequence[Parameter], strengths: Mapping[str, float]) -> list[str]:
    """In a line each, which groups' prior standard deviations came to the upper limit."""
    groups, units = Groups.among(parameters), {p.group: p.unit for p in parameters}
    most = dict(zip(groups.names, np.sqrt(groups.limits[1]).tolist(), strict=True))
    return [
        f"{_spoken(name)} came to the largest size that is thought possible ({_size(most[name], units[name])}), and "
        "what is larger is fitted in part: is the machine file right there?"
        for name, strength in strengths.items()
        if strength > AT_LIMIT * most[name]
    ]


def _spoken(group: str) -> str:
    """compliance.w3.rM.rz,Mz.line → the compliance rz per Mz of frame w3; geometric.w3.t.line → shifts of frame w3"""
    match parts_of(group):
        case ["compliance", frame, _, element, _]:
            return f"the compliance {element.replace(',', ' per ')} of frame {frame}"
        case ["geometric", frame, kind, band]:
            waves = "" if band == "line" else ", in waves,"
            return f"{'shifts' if kind == 't' else 'turns'} of frame {frame}{waves}"
        case ["own", frame, _]:
            return f"{frame}'s errors along its own motion"
    return f"{group} errors"


def _size(value: float, unit: str) -> str:
    return f"{1e3 * value:.3g} m{unit}" if unit in ("m", "rad") else f"{value:.2g} {unit}"


def _kind(group: str) -> str:
    """The name without the joint's and the element's; bands of a joint's own fine motion are all of one kind."""
    kind, *rest = parts_of(group)
    if kind == "own":
        return kind
    return ".".join([kind, *([rest[1], rest[-1]] if kind == "compliance" else rest[1:])])


@dataclass(frozen=True)
class Posterior:
    """Of the active parameters: theta (p,), prior standard deviations (p,), and root (p, p) lower triangular with
    Cov θ = rootᵀ root for given strengths."""

    theta: Array
    prior: Array
    root: Array

    def covariance(self, groups: Groups, active: Mask) -> Array:
        """(p, p), with what the strengths are not known to   (5.6).

        The strengths' logarithms scatter by the inverse of their Fisher information F; θ moves with them by
        D_g = Cov θ Λ⁻¹ θ restricted to group g (Kackar & Harville 1984).
        """
        if not len(self.theta):
            return np.zeros((0, 0))
        whitened = self.root / self.prior
        inner, z = whitened.T @ whitened, self.theta / self.prior
        of = groups.of[active]
        free = [g for g in np.unique(of) if not groups.held[g]]
        member = (of[:, None] == free).astype(float)
        fisher = 0.5 * member.T @ (np.eye(len(z)) - inner) ** 2 @ member + np.eye(len(free)) / ALIKE**2
        slopes = inner @ (member * z[:, None])
        wider = np.linalg.solve(np.linalg.cholesky(fisher), slopes.T)
        return np.asarray((inner + wider.T @ wider) * np.outer(self.prior, self.prior))


def learn(
    gram: Array, moment: Array, groups: Groups, active: Mask, variances: Array, steps: int
) -> tuple[Array, Posterior]:
    """`steps` of all groups at once from `variances` (G,); gram = XᵀR⁻¹X (p, p) and moment = XᵀR⁻¹y (p,) are of the
    active parameters."""
    of, scale = groups.of[active], groups.scale[active]
    members = [(int(g), np.flatnonzero(of == g)) for g in np.unique(of) if not groups.held[g]]
    for step in range(steps + 1):
        prior = scale * np.sqrt(variances[of])
        z, root = _solve(gram, moment, prior)
        if step < steps:
            variances = _moved(variances, z, root, members, groups)
    return variances, Posterior(prior * z, prior, root * prior)


def alone(
    gram: Array, moment: Array, groups: Groups, active: Mask, variances: Array, covariance: Array, theta: Array
) -> Array:
    """(p,) by how much more [variance] than by `covariance` (p, p) each element of a compliance is unsure, taken by
    itself; zero for all other parameters   (5.7).

    Where two elements explain the same, the likeliest strengths let one take all: the other comes to nothing and seems
    to be known well. What they do together is, and `covariance` is for that. An engineer who asks for one of them
    thinks that a joint whose one element is so many times a typical one may have others so, and that no joint is much
    stiffer than the middle one.
    """
    wide, out = variances.copy(), np.zeros(len(active))
    joints = [np.array([of == joint for of in groups.bent]) for joint in dict.fromkeys(groups.bent) if joint]
    loudest = [(variances[these] / groups.start[these] ** 2).max() for these in joints]
    for these, most in zip(joints, np.maximum(loudest, np.median(loudest or [0.0])), strict=True):
        wide[these] = most * groups.start[these] ** 2
    _, other = learn(gram, moment, groups, active, wide, 0)
    bent = groups.of_compliances[active]
    much = (other.root**2).sum(axis=0) + (other.theta - theta[active]) ** 2 - np.diag(covariance)[active]
    out[np.flatnonzero(active)[bent]] = np.maximum(much[bent], 0.0)
    return out


def silent(gram: Array, groups: Groups, active: Mask, variances: Array, rows: float) -> Mask:
    """(p,) parameters of groups whose prior hardly adds to what is predicted.

    diag(gram)·prior² is the squared size, in units of the noise, that a parameter may have over the recording's `rows`
    coordinates.
    """
    size = np.zeros(len(active))
    size[active] = np.diag(gram)
    seen = np.bincount(groups.of, size * groups.scale**2 * variances[groups.of], minlength=len(groups.names))
    return np.asarray((seen < NEGLIGIBLE * rows)[groups.of] & ~groups.of_compliances)


def _solve(gram: Array, moment: Array, prior: Array) -> tuple[Array, Array]:
    """Posterior mean z of θ/prior, z ~ N(0, 1), and L⁻¹ where L Lᵀ is its precision."""
    if not len(moment):  # everything was left out: LAPACK would complain on stderr
        return np.zeros(0), np.zeros((0, 0))
    precision = prior[:, None] * gram * prior
    precision[np.diag_indices_from(precision)] += 1.0
    # the transpose of a symmetric matrix is itself, and in the order that LAPACK works in
    factor, info = lapack.dpotrf(precision.T, lower=1, clean=1, overwrite_a=1)
    if info != 0:
        raise IdentificationFailed(f"the normal equations are singular (dpotrf {info})")
    root, info = lapack.dtrtri(factor, lower=1, overwrite_c=1)
    if info != 0:
        raise IdentificationFailed(f"the normal equations are singular (dtrtri {info})")
    return root.T @ (root @ (prior * moment)), root


def _moved(variances: Array, z: Array, root: Array, members: list[tuple[int, Index]], groups: Groups) -> Array:
    """Every group's variance towards where it is most likely, the others' as they are.

    With the group left out, the data hold of it the information S and the score q, which its posterior tells:
    Cov⁻¹ − I and Cov⁻¹ z, both in units of its prior. A variance t times the present one then has

        2 log L(t) = Σ t w²/(1 + t e) − log(1 + t e) − (log t λ − μ)²/ALIKE²                       (5.5)

    e, w: S's eigenvalues and q along its eigenvectors (Tipping & Faul 2003, for groups); μ of its kind.
    """
    out, (least, most) = variances.copy(), groups.limits
    by_size: dict[int, list[tuple[int, Index]]] = {}
    for g, which in members:
        by_size.setdefault(len(which), []).append((g, which))
    expected = groups.expected(variances, np.array([g for g, _ in members], dtype=np.int64))
    for alike in by_size.values():
        which = np.array([w for _, w in alike])  # (G, k)
        part = root[:, which].transpose(1, 2, 0)  # (G, k, p)
        values, vectors = np.linalg.eigh(part @ np.swapaxes(part, 1, 2))
        values = np.clip(values, 1e-300, 1.0)
        score2 = (np.einsum("gki,gk->gi", vectors, z[which]) / values) ** 2
        these = np.array([g for g, _ in alike])
        t, e = TIMES[None, :, None], (1.0 / values - 1.0)[:, None]
        gain = (t * score2[:, None] / (1.0 + t * e) - np.log1p(t * e)).sum(axis=-1)
        gain -= (np.log(TIMES * variances[these][:, None]) - expected[these][:, None]) ** 2 / ALIKE**2
        factor = np.clip(TIMES[np.argmax(gain, axis=1)] ** SHARE, 1.0 / MOST, MOST)
        out[these] = np.clip(variances[these] * factor, least[these], most[these])
    return out
