"""How much a recording speaks for every candidate, and what noise alone would have made it say.

A candidate's coefficients get a zero-mean normal prior of three amplitudes (a third, one and three times the
repeatability at the reflectors); the log evidence against nothing is

    ½ Sᵀ (I + Λ⁻¹)⁻¹ S − ½ ln det(1 + Λ I)                       per amplitude, averaged

(MacKay 1992). What counts as significant is decided by the greatest evidence anything tried reaches when the visits'
residuals change sign at random, whole visits at a time and corrected for leverage (wild bootstrap; Davidson &
Flachaire 2008), so that pose-dependent noise and the number of things tried are both in the null.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve
from scipy.special import logsumexp
from scipy.stats import gumbel_r

from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.workspace import Workspace
from ppshw.terms.shapes import Column

Array = NDArray[np.float64]
AMPLITUDES = (1 / 3, 1.0, 3.0)
DRAWS = 199
LEAST_SHARE = 3e-4
Name = tuple[str, str | None]


@dataclass
class _Batch:
    """Candidates with the same number of columns k: which (C,), columns (C, k)."""

    which: NDArray[np.int64]
    columns: NDArray[np.int64]


class Tried:
    """All candidates over one workspace: whitened columns of unit size, and the same less what is absorbed."""

    def __init__(self, space: Workspace, candidates: Sequence[Candidate], repeatability: float) -> None:
        self.candidates = list(candidates)
        self.repeatability = repeatability
        self.space = space
        unique: dict[_Key, int] = {}
        index = [[unique.setdefault(_key(c), len(unique)) for c in k.columns] for k in candidates]
        self._columns = list(unique)
        count, size = len(space.recording), space.rows
        fit = int(space.fit.sum())
        self.white = np.zeros((fit * size, len(unique)), dtype=np.float32)
        self.scale = np.ones(len(unique))
        readings = max(int(space.recording.seen.sum()), 1)
        for k, column in enumerate(self._columns):
            raw = column.value.evaluate(space.context)
            self.scale[k] = max(float(np.sqrt((raw**2).sum() / readings)), 1e-30)
            scaled = (raw / self.scale[k]).reshape(count, size, 1)
            self.white[:, k] = space.whiten(scaled)[:, 0]
        self.index = [np.array(i) for i in index]
        sizes = sorted({len(i) for i in index})
        self._batches = [
            _Batch(
                np.array([c for c, i in enumerate(index) if len(i) == k]),
                np.array([i for i in index if len(i) == k]),
            )
            for k in sizes
        ]
        self.log_share = np.log([max(k.share, 1e-300) for k in candidates])
        self.names: list[Name] = list(dict.fromkeys((k.effect, k.joint) for k in candidates))
        position = {n: j for j, n in enumerate(self.names)}
        self.name_of = np.array([position[k.effect, k.joint] for k in candidates])
        white32 = space.white.astype(np.float32)
        inner = cho_solve(space.factor, (white32.T @ self.white).astype(float))
        self.projected = self.white - white32 @ inner.astype(np.float32)
        # what the base model takes whole leaves rounding errors, not evidence
        plain = np.einsum("rk,rk->k", self.white, self.white)
        visible = np.einsum("rk,rk->k", self.white, self.projected) > LEAST_SHARE * np.maximum(plain, 1e-30)
        self.log_share = np.where([visible[i].all() for i in self.index], self.log_share, -np.inf)
        self._info0 = [self._information(batch.columns) for batch in self._batches]
        self.update()

    def _information(self, columns: NDArray[np.int64]) -> Array:
        """(C, k) columns → (C, k, k) information of each candidate, given the base model alone."""
        k = columns.shape[1]
        info = np.empty((len(columns), k, k))
        for a in range(k):
            for b in range(a, k):
                info[:, a, b] = info[:, b, a] = np.einsum(
                    "rc,rc->c", self.white[:, columns[:, a]], self.projected[:, columns[:, b]]
                )
        return info

    def update(self) -> None:
        """Account for what the workspace has taken up now."""
        space = self.space
        self._cross = np.asarray(space.taken_white.T.astype(np.float32) @ self.projected, dtype=float)  # (kF, K)
        self._info = []
        for batch, info in zip(self._batches, self._info0, strict=True):
            w = self._cross[:, batch.columns]  # (kF, C, k)
            self._info.append(info - np.einsum("fca,fg,gcb->cab", w, space.middle, w))

    # --- evidence ------------------------------------------------------------------------------------------------
    def evidence(self, scores: Array) -> Array:
        """Log evidence of every candidate for scores (D, K) of all columns: (D, C)."""
        out = np.empty((len(scores), len(self.candidates)))
        for batch, info in zip(self._batches, self._info, strict=True):
            k = batch.columns.shape[1]
            s = scores[:, batch.columns].transpose(1, 2, 0)  # (C, k, D)
            parts = []
            for amplitude in AMPLITUDES:
                prior = (amplitude * self.repeatability) ** 2 / k
                whole = np.eye(k) + prior * info
                solved = np.linalg.solve(whole, prior * s)
                logdet = np.linalg.slogdet(whole)[1]
                parts.append(0.5 * np.einsum("ckd,ckd->cd", s, solved) - 0.5 * logdet[:, None])
            out[:, batch.which] = (logsumexp(np.array(parts), axis=0) - np.log(len(AMPLITUDES))).T
        return out

    def scores(self) -> Array:
        """Zᵀ V⁻¹ y of every column, what was taken up included in V: (K,)."""
        space = self.space
        plain = np.asarray(self.projected.T @ space.y.astype(np.float32), dtype=float)
        return plain - self._cross.T @ (space.middle @ (space.absorbed.T @ space.y))

    def by_name(self, evidence: Array) -> Array:
        """Log evidence of every name, its candidates averaged by their shares: (D, C) → (D, names)."""
        weighted = evidence + self.log_share
        out = np.full((len(evidence), len(self.names)), -np.inf)
        for j in range(len(self.names)):
            out[:, j] = logsumexp(weighted[:, self.name_of == j], axis=1)
        return out

    def null(self, residual: Array, rng: np.random.Generator, draws: int = DRAWS) -> Array:
        """The greatest log evidence of any name under random signs of whole visits: (draws,).

        residual  (F, 3T) whitened and corrected for leverage
        """
        fit, size = residual.shape
        parts = np.einsum(
            "vrk,vr->vk", self.projected.reshape(fit, size, -1), residual.astype(np.float32), optimize=True
        )
        taken = np.einsum("vrf,vr->vf", self.space.absorbed.reshape(fit, size, self.space.absorbed.shape[1]), residual)
        parts -= (taken @ self.space.middle @ self._cross).astype(np.float32)
        signs = rng.choice(np.array([-1.0, 1.0], dtype=np.float32), size=(draws, fit))
        return np.asarray(self.by_name(self.evidence(np.asarray(signs @ parts, dtype=float))).max(axis=1))


@dataclass(frozen=True)
class _Key:
    text: str
    value: Column

    def __hash__(self) -> int:
        return hash(self.text)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self.text == other.text


def _key(column: Column) -> _Key:  # columns hold dictionaries, which do not hash
    return _Key(repr(column), column)


def p_value(observed: float, null: Array) -> float:
    """Share of the null at or above what was observed; beyond its range by a Gumbel tail fitted to it."""
    counted = (1 + int((null >= observed).sum())) / (len(null) + 1)
    if counted > 3 / (len(null) + 1):
        return float(counted)
    location, scale = gumbel_r.fit(null)
    return float(min(counted, max(gumbel_r.sf(observed, location, scale), 1e-300)))


def corrected_residual(space: Workspace) -> Array:
    """(F, 3T) whitened residuals of the fit visits, corrected for leverage per visit: noise alone has unit variance."""
    size = space.rows
    blocks = space.white.reshape(-1, size, space.white.shape[1])
    half = cho_solve(space.factor, space.white.T).T.reshape(blocks.shape)
    extra = space.absorbed.reshape(len(blocks), size, space.absorbed.shape[1])
    keep = np.eye(size) - blocks @ np.swapaxes(half, 1, 2) - extra @ space.middle @ np.swapaxes(extra, 1, 2)
    values, vectors = np.linalg.eigh(0.5 * (keep + np.swapaxes(keep, 1, 2)))
    root = (vectors / np.sqrt(np.maximum(values, 0.05))[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return np.asarray((root @ space.left().reshape(-1, size, 1))[..., 0])
