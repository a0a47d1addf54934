"""All visits about one θ₀, each reduced to what a rigid end effector can do, and whitened block by block.

However many targets a visit has, the model moves them as one rigid body, in six ways. With H (3T × 6) how they move, in
the end effector's axes, H = U A with orthonormal U, a visit is the six numbers Uᵀy; the other 3T − 6 hold nothing but
the instrument's noise, of which the sum of squares is kept. Where targets are parameters themselves, nothing is
reduced. docs/derivations.md §5.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppshw.identification.noise import Noise
from ppshw.identification.start import to_base
from ppshw.model import Model
from ppshw.recording import Recording
from ppshw.terms import Situation
from ppshw.transforms import skew

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
BLOCK = 512
# Visits whose linearisation is kept between passes (3 KiB each); beyond, it is made again.
KEPT_VISITS = 8192
# Whitened designs up to this many numbers (0.2 GB) are kept within a pass; beyond, they are made twice.
KEPT_NUMBERS = 2.5e7
# A direction in which targets lie closer together than this share of their spread is none.
FLAT = 1e-6


@dataclass(frozen=True)
class Block:
    """n visits about θ₀, K coordinates each.

    gap       (n, K)            measured − predicted at θ₀     [m]
    data      (n, K)            the same + X θ₀                [m]
    jacobian  (n, K, n+1, 6)    per generalized error
    levers    (n, K, 6 + 6n)    what scatters: the end effector in base axes, then the joints
    offsets   (n, K, 3T)        per target offset, None where targets are known
    live      (n, K)            False: there is no such coordinate
    rest2, freedom (n,)         squared length [m²] and number of the coordinates that no motion reaches
    """

    visits: slice
    situation: Situation
    wrenches: Array
    gap: Array
    data: Array
    jacobian: Array
    levers: Array
    offsets: Array | None
    live: Mask
    rest2: Array
    freedom: Index

    def distance(self, noise: Noise) -> Array:
        """(n,) squared Mahalanobis distance of every visit from the prediction at θ₀."""
        covariance = noise.of_rows(self.levers, self.live, np.ones(len(self.gap)))
        inner = np.linalg.solve(covariance, self.gap[..., None])[..., 0]
        return np.asarray(np.einsum("ni,ni->n", self.gap, inner) + self.rest2 / noise.instrument**2)


@dataclass(frozen=True)
class White:
    """A block with its noise made white: design (n, K, p) and data (n, K) times L⁻¹; lower (n, K, K) is L, L Lᵀ = R."""

    block: Block
    lower: Array
    design: Array
    data: Array

    def colour(self, second: Array) -> Array:
        """Second moments (n, K, K) of whitened coordinates as they were before   [m²]."""
        live = self.block.live[:, :, None] & self.block.live[:, None, :]
        return np.asarray(self.lower @ second @ np.swapaxes(self.lower, 1, 2) * live)


class Linearisation:
    """The visits `which` of a recording about θ₀, in blocks; kept where they are few, else made again."""

    def __init__(self, model: Model, recording: Recording, theta: Array, frame: Array, which: Index) -> None:
        self._model, self._recording, self._theta, self._frame = model, recording, theta.copy(), frame
        self.which = which
        self._kept = list(self._make()) if len(which) <= KEPT_VISITS else None

    @property
    def theta(self) -> Array:
        """(p,) θ₀."""
        return self._theta

    def __iter__(self) -> Iterator[Block]:
        return iter(self._kept) if self._kept is not None else self._make()

    def _make(self) -> Iterator[Block]:
        reduction = _Reduction(self._model, self._theta)
        for start in range(0, len(self.which), BLOCK):
            visits = slice(start, min(start + BLOCK, len(self.which)))
            part = self._recording.subset(self.which[visits])
            yield self._linearised(reduction, visits, part)

    def _linearised(self, reduction: _Reduction, visits: slice, part: Recording) -> Block:
        situation = Situation.of(part)
        tangent = self._model.tangent(situation, self._theta)
        turn = tangent.tips[:, :3, :3]
        predicted = np.einsum("nij,pj->npi", turn, reduction.targets) + tangent.tips[:, None, :3, 3]
        gap = np.where(part.seen[..., None], to_base(part.points, self._frame) - predicted, 0.0)
        local = gap @ turn  # base axes → the end effector's
        across, along, live = reduction.of(part.seen)
        count = len(part)
        flat = local.reshape(count, -1, 1)
        short = (along @ flat)[..., 0]
        rest2 = np.maximum((flat[..., 0] ** 2).sum(axis=1) - (short**2).sum(axis=1), 0.0)
        jacobian = across @ tangent.jacobian.reshape(count, 6, -1)
        data = short + (jacobian @ tangent.errors.reshape(count, -1, 1))[..., 0]
        offsets = along if self._model.target_offset is not None else None
        if offsets is not None:
            data = data + offsets @ self._theta[-offsets.shape[2] :]
        to_tip = np.zeros((count, 6, 6))
        to_tip[:, :3, :3] = to_tip[:, 3:, 3:] = np.swapaxes(turn, 1, 2)
        levers = np.concatenate([across @ to_tip, jacobian[:, :, 6:]], axis=2)
        freedom = 3 * part.seen.sum(axis=1) - live.sum(axis=1)
        return Block(
            visits, situation, tangent.wrenches, short, data, jacobian.reshape(count, -1, *tangent.jacobian.shape[2:]),
            levers, offsets, live, rest2, freedom,
        )  # fmt: skip

    def whitened(self, noise: Noise, weights: Array, active: Mask) -> Iterator[White]:
        """Every block under this noise; design of the active parameters alone."""
        for block in self:
            covariance = noise.of_rows(block.levers, block.live, weights[block.visits])
            lower = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
            root = np.linalg.inv(lower) * block.live[:, :, None]
            shape = block.jacobian.shape
            jacobian = (root @ block.jacobian.reshape(shape[0], shape[1], -1)).reshape(shape)
            offsets = None if block.offsets is None else root @ block.offsets
            design = self._model.columns(jacobian, block.situation, block.wrenches, offsets, active)
            yield White(block, lower, design, (root @ block.data[..., None])[..., 0])

    def normal_equations(self, noise: Noise, weights: Array, active: Mask) -> tuple[Array, Array, list[White] | None]:
        """XᵀR⁻¹X and XᵀR⁻¹y over the active parameters, and the whitened blocks where they are few."""
        size = int(active.sum())
        gram, moment = np.zeros((size, size)), np.zeros(size)
        keep = len(self.which) * self.coordinates * size <= KEPT_NUMBERS
        kept: list[White] = []
        for white in self.whitened(noise, weights, active):
            flat = white.design.reshape(-1, size)
            gram += flat.T @ flat
            moment += flat.T @ white.data.ravel()
            if keep:
                kept.append(white)
        return gram, moment, kept if keep else None

    @property
    def rows(self) -> int:
        return len(self.which) * self.coordinates

    @property
    def coordinates(self) -> int:
        """K."""
        return _Reduction(self._model, self._theta).size


class _Reduction:
    """Per pattern of seen targets: A (K, 6), Uᵀ (K, 3T), and which of the K coordinates there are."""

    def __init__(self, model: Model, theta: Array) -> None:
        self.targets = model.targets(theta)
        self._whole = model.target_offset is not None or 3 * len(self.targets) <= 6
        self.size = 3 * len(self.targets) if self._whole else 6
        levers = np.zeros((len(self.targets), 3, 6))
        levers[..., :3], levers[..., 3:] = np.eye(3), -skew(self.targets)
        self._levers = levers

    def of(self, seen: Mask) -> tuple[Array, Array, Mask]:
        """For N visits: (N, K, 6), (N, K, 3T), (N, K)."""
        patterns, which = np.unique(seen, axis=0, return_inverse=True)
        parts = [self._pattern(pattern) for pattern in patterns]
        across, along, live = (np.stack(part)[which.ravel()] for part in zip(*parts, strict=True))
        return across, along, live

    def _pattern(self, seen: Mask) -> tuple[Array, Array, Mask]:
        rows = np.repeat(seen, 3)
        levers = self._levers.reshape(-1, 6) * rows[:, None]
        if self._whole:
            return levers, np.diag(rows.astype(float)), rows
        spread = max(float(np.ptp(self.targets, axis=0).max()), 1e-3)
        units = np.repeat([1.0, spread], 3)  # so that a small angle and a small shift weigh alike
        u, s, vt = np.linalg.svd(levers / units, full_matrices=False)
        live = s > FLAT * max(s.max(), 1e-300)
        along = u.T * live[:, None]
        return (s * live)[:, None] * vt * units, along, live
