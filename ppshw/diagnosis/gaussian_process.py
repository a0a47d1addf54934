"""What no name explains, learnt as a Gaussian process over the columns that the search located it at.

Where it acts (frame, components), how large and how fast it changes is what makes the recording likeliest, base model
and named findings integrated out (terms/gaussian_process.py has the function, docs/derivations.md §9 the equations).
With unit-variance functions φ, the whitened Jacobian column u of every visit and P of docs/diagnosis-method.md §2,

    S = Σ φ uᵀ P y,   I = (uφ)ᵀ P (uφ),   ln evidence = ½ Sᵀ (σ⁻² + I)⁻¹ S − ½ ln det(1 + σ² I)

In the directions of I the coefficients are independent a posteriori, each 1/(1 + σ²λ) of what it was before; those that
the recording says nothing about are left out and stay as unsure as they were.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, eigh, solve_triangular

from ppshw.diagnosis.workspace import Workspace
from ppshw.machine import Machine
from ppshw.terms import COMPONENTS
from ppshw.terms.gaussian_process import Region
from ppshw.terms.shapes import Column, named_column

Array = NDArray[np.float64]
LENGTHS = (0.25, 0.5, 1.0, 2.0)  # tried for every column, in its standard deviations
FIRST_LENGTH = 0.7  # with which the frame is looked for
SIZES = tuple(np.geomspace(0.1, 10.0, 13).tolist())  # rms at the reflectors, in units of `Workspace.unit`
MORE = 3.0  # log evidence for which a further component is taken in
TOLD = 0.05  # a direction's information, in units of its prior's, from which on it is carried
MOST_MODES = 64


@dataclass(frozen=True)
class Correction:
    """region: where, over which columns; frame and components (C,) that move; amplitude (C,) standard deviations before
    any data [m, rad]; modes (k, C, m) directions in φ, scaled so that their coefficients are N(0, 1) before any data;
    evidence: log, against nothing, counting all that was tried"""

    region: Region
    frame: int
    components: tuple[int, ...]
    amplitude: Array
    modes: Array
    evidence: float

    def columns(self) -> tuple[Column, ...]:
        where = {
            **self.region.as_dict(), "frame": self.frame, "components": list(self.components),
            "amplitude": self.amplitude.tolist(),
        }  # fmt: skip
        return tuple(Column("frames", "unexplained", {**where, "mode": m.tolist()}, self.frame) for m in self.modes)


def in_words(columns: tuple[Column, ...], machine: Machine) -> str:
    """What a correction is, beside what it depends on."""
    a = columns[0].args
    moved = ", ".join(COMPONENTS[c] for c in a["components"])
    return (
        f"a smooth function (Gaussian process) that moves {machine.frame_names[a['frame']]} {moved}, only where the "
        "recording has data; no axis is driven by it"
    )


class _Evidence:
    """Of functions on one component of one frame, beside the base model and what the workspace has taken up."""

    def __init__(self, space: Workspace) -> None:
        self.space = space
        self.known = np.concatenate([space.white, space.taken_white], axis=1)
        precision = self.known.T @ self.known
        precision[np.diag_indices_from(precision)] += 1.0 / np.concatenate([space.prior, space.taken_prior]) ** 2
        self.lower = cho_factor(precision, lower=True)[0]
        self.left = space.left()

    def sums(self, phi: Array, frame: int, component: int) -> tuple[Array, Array, Array]:
        """φ (N, m) → whitened columns (F·3T, m), their A = L⁻¹Xᵀ(uφ) (p, m), and S (m,)."""
        space = self.space
        u = (space.root[space.fit] @ space.context.jacobian[space.fit, :, frame, component, None])[..., 0]
        white = (u[:, :, None] * phi[space.fit][:, None, :]).reshape(-1, phi.shape[1])
        taken = solve_triangular(self.lower, self.known.T @ white, lower=True)
        return white, np.asarray(taken), white.T @ self.left


def information(parts: list[tuple[Array, Array, Array]]) -> tuple[Array, Array]:
    """I (Cm, Cm) and S (Cm,) of several components together."""
    blocks = [[a[0].T @ b[0] - a[1].T @ b[1] for b in parts] for a in parts]
    return np.block(blocks), np.concatenate([p[2] for p in parts])


def log_evidence(info: Array, score: Array, sigma: Array) -> float:
    """sigma (Cm,) prior standard deviation of every coefficient."""
    whole = np.eye(len(info)) + sigma[:, None] * info * sigma
    lower = np.linalg.cholesky(whole)
    along = solve_triangular(lower, sigma * score, lower=True)
    return float(0.5 * along @ along - np.log(np.diag(lower)).sum())


def learn(space: Workspace, names: tuple[str, ...], unit: float) -> Correction | None:
    """The likeliest Gaussian process over these columns of the recording; None where nothing is likelier.

    space  has the named findings taken up, and none of what the correction is to explain
    """
    values = np.stack([named_column(space.context, name) for name in names], axis=1).astype(float)
    fitted = values[space.fit]
    if not np.isfinite(fitted).all() or (np.ptp(fitted, axis=0) <= 0).any():
        return None
    model = _Evidence(space)
    sizes = _unit_sizes(space, unit)
    region = Region.over(names, fitted, np.full(len(names), FIRST_LENGTH))
    phi = region.basis(values)
    places = [(f, c) for f in range(sizes.shape[0]) for c in range(6) if np.isfinite(sizes[f, c])]
    frame, component = max(places, key=lambda p: _one(model, phi, p[0], p[1], float(sizes[p]))[0])
    tried = []
    for lengths in itertools.product(LENGTHS if len(names) < 3 else LENGTHS[2:], repeat=len(names)):
        region = Region.over(names, fitted, np.array(lengths))
        found, size = _one(model, region.basis(values), frame, component, float(sizes[frame, component]))
        tried.append((found, size, region))
    evidence, size, region = max(tried, key=lambda t: t[0])
    phi = region.basis(values)
    chosen, evidence = _components(model, phi, frame, {component: size}, evidence, sizes[frame])
    evidence -= float(np.log(len(places) * len(tried)))  # the likeliest of so many is so much less likely
    return None if evidence <= 0 else _correction(model, region, phi, frame, chosen, evidence)


def _unit_sizes(space: Workspace, unit: float) -> Array:
    """(n+1, 6) [m, rad] of every component that move the reflectors by that much, rms; inf for none."""
    readings = max(int(space.recording.seen.sum()), 1)
    scale = np.sqrt((space.context.jacobian**2).sum(axis=(0, 1)) / readings)
    return np.where(scale > 1e-12, unit / np.maximum(scale, 1e-12), np.inf)


def _one(model: _Evidence, phi: Array, frame: int, component: int, unit: float) -> tuple[float, float]:
    """Log evidence of a function on one component, at the likeliest of SIZES, and that size [m, rad]."""
    info, score = information([model.sums(phi, frame, component)])
    values, vectors = eigh(info)
    values, along = np.maximum(values, 0.0), vectors.T @ score
    sizes = unit * np.array(SIZES)
    told = sizes[:, None] ** 2 * values
    evidence = (0.5 * sizes[:, None] ** 2 * along**2 / (1 + told) - 0.5 * np.log1p(told)).sum(axis=1)
    best = int(np.argmax(evidence))
    return float(evidence[best]), float(sizes[best])


def _components(
    model: _Evidence, phi: Array, frame: int, first: dict[int, float], evidence: float, unit: Array
) -> tuple[dict[int, float], float]:
    """Further components of the frame, one by one, while the recording is likelier by MORE with them; their sizes, and
    the log evidence of all."""
    chosen = dict(first)
    parts = {c: model.sums(phi, frame, c) for c in range(6) if np.isfinite(unit[c])}
    while len(chosen) < len(parts):
        best = evidence + MORE, -1, 0.0
        for c in parts.keys() - chosen.keys():
            info, score = information([parts[d] for d in (*chosen, c)])
            for size in np.array(SIZES[::2]) * unit[c]:
                sigma = np.repeat([*chosen.values(), size], phi.shape[1])
                best = max(best, (log_evidence(info, score, sigma), c, float(size)))
        if best[1] < 0:
            break
        evidence = best[0]
        chosen[best[1]] = best[2]
    return chosen, evidence


def _correction(
    model: _Evidence, region: Region, phi: Array, frame: int, chosen: dict[int, float], evidence: float
) -> Correction:
    """In the directions that the recording tells apart: with σ² I = V diag(λ) Vᵀ the coefficients along V have the
    posterior variances 1/(1 + λ) of what they had."""
    amplitude = np.array(list(chosen.values()))
    info, _ = information([model.sums(phi, frame, c) for c in chosen])
    sigma = np.repeat(amplitude, phi.shape[1])
    told, vectors = eigh(sigma[:, None] * info * sigma)
    kept = np.flatnonzero(told > TOLD)[::-1][:MOST_MODES]
    modes = (sigma[:, None] * vectors[:, kept]).T.reshape(len(kept), len(chosen), phi.shape[1])
    return Correction(region, frame, tuple(chosen), amplitude, modes, evidence)
