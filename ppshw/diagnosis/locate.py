"""Where a mismatch sits, before it has a name: which frame and component, and which column it depends on.

No effect of the catalogue is known here. The residual of every visit is read as a small displacement of each frame
along each component (and of each pair of reflectors apart), and correlated with functions of each column, of pairs of
joints and of short waves over a joint's travel. How strong a dependence is, replicas say (`replicas`): what a fit
absorbs of it is then accounted for, and so is the number of things looked at. docs/diagnosis-method.md §6.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from ppshw.diagnosis.library.sampled import waving_joints
from ppshw.diagnosis.replicas import Compared
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.terms import COMPONENTS
from ppshw.terms.shapes import Context, named_column

Array = NDArray[np.float64]
Single = NDArray[np.float32]
DRAWS = 399  # the least p is then 1/400, two-sided 1/200
SMOOTH = 5  # cosines over the ranks of a column
BLOCKS = 12  # of time
CYCLES = np.arange(4.0, 260.0, 0.5)  # waves over a joint's travel; below, the smooth functions see them
# A function of which the fit leaves less than this share tells of rounding.
LEAST_SHARE = 3e-3
# No visit counts for more than this, in units of its noise: one gross reading is no dependence.
BOUND = 3.0
# Neighbouring frames move the reflectors almost alike: so close to the strongest, none can be preferred to another.
ALIKE = 0.95


@dataclass(frozen=True)
class Channel:
    """frame: a frame's name, or "reflectors"; component of `COMPONENTS`, or the pair whose distance it is;
    index of the frame, −1 for reflectors."""

    frame: str
    component: str
    index: int


@dataclass(frozen=True)
class Covariate:
    """names: the one or two columns; kind: what sort of dependence; functions (M, k)."""

    names: tuple[str, ...]
    kind: str
    functions: Array

    @property
    def label(self) -> str:
        return " × ".join(self.names) + (", short waves" if self.kind == "waves" else "")


@dataclass(frozen=True)
class Map:
    """strength (R, C): how many standard deviations of the replicas the dependence of channel C on covariate R lies
    above their mean, nan where the fit leaves nothing to see; threshold: what the strongest of all reaches in one
    replica of twenty; p: of the strongest, family-wise; highest (D+1, kinds): the strongest per kind, replicas'
    standardised with the recording among them, the recording first."""

    channels: tuple[Channel, ...]
    covariates: tuple[Covariate, ...]
    strength: Array
    threshold: float
    p: float
    kinds: tuple[str, ...]
    highest: Array
    shown: Array  # (D+1, kinds) the same standardised by the replicas alone, for people to read
    sides: tuple[Array, Array] | None  # (D+1,) both, of the distances between reflectors over any column

    def strongest(self, most: int = 2) -> list[tuple[int, int]]:
        """(covariate, channel) of the strongest dependences, each covariate once."""
        best = np.nanmax(np.where(np.isnan(self.strength), -np.inf, self.strength), axis=1)
        order = np.argsort(-best)[:most]
        return [(int(r), self.channel_of(int(r))) for r in order if np.isfinite(best[r])]

    def channel_of(self, row: int) -> int:
        """The channel that depends most on a covariate; of those that cannot be told apart, one of its own joint."""
        strength = np.nan_to_num(self.strength[row], nan=-np.inf)
        names = self.covariates[row].names
        own = [
            j for j in np.flatnonzero(strength >= ALIKE * strength.max())
            if any(n.split("_", 1)[-1] == self.channels[j].frame for n in names)
        ]  # fmt: skip
        return int(max(own, key=lambda j: strength[j])) if own else int(strength.argmax())


def channels(c: Context) -> list[Channel]:
    frames = [Channel(name, comp, k) for k, name in enumerate(c.machine.frame_names) for comp in COMPONENTS]
    pairs = itertools.combinations(c.recording.target_names, 2)
    return frames + [Channel("reflectors", f"{a}–{b}", -1) for a, b in pairs]


def gradients(compared: Compared) -> Array:
    """(M, 3T, C) whitened: how the targets move with each channel, base axes [m per m or rad]."""
    c = compared.context
    count, size = compared.left.shape
    frames = c.jacobian.reshape(count, size, -1)
    apart = np.zeros((count, size // 3, 3, len(list(itertools.combinations(range(size // 3), 2)))))
    for k, (a, b) in enumerate(itertools.combinations(range(size // 3), 2)):
        along = c.points[:, a] - c.points[:, b]
        along = along / np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
        apart[:, a, :, k], apart[:, b, :, k] = 0.5 * along, -0.5 * along
    both = compared.live[:, ::3]  # a side is seen when both of its ends are
    for k, (a, b) in enumerate(itertools.combinations(range(size // 3), 2)):
        apart[:, :, :, k] *= (both[:, a] & both[:, b])[:, None, None]
    return np.asarray(compared.root @ np.concatenate([frames, apart.reshape(count, size, -1)], axis=2))


def covariates(c: Context) -> list[Covariate]:
    return [k for k in _covariates(c) if np.ptp(k.functions, axis=0).max() > 0 or k.kind == "always"]


def _covariates(c: Context) -> Iterator[Covariate]:
    r, joints = c.recording, c.machine.joint_names
    moving = [k for k in range(len(joints)) if np.ptp(r.q[:, k]) > 0]
    for k in moving:
        yield Covariate((f"q_{joints[k]}",), "travel", _cosines(r.q[:, k]))
    for k, _ in waving_joints(c):
        yield Covariate((f"q_{joints[k]}",), "waves", np.zeros((len(r), 1)) + r.q[:, k : k + 1])
    for k in moving:
        s = r.approach[:, k].astype(float)
        if np.ptp(s) > 0:
            along = np.stack([s, s * _cosines(r.q[:, k])[:, 0]], axis=1)
            yield Covariate((f"approach_{joints[k]}",), "approach", along)
    for a, b in itertools.combinations(moving, 2):
        one, two = _cosines(r.q[:, a])[:, :2], _cosines(r.q[:, b])[:, :2]
        product = (one[:, :, None] * two[:, None, :]).reshape(len(r), -1)
        yield Covariate((f"q_{joints[a]}", f"q_{joints[b]}"), "pairs", product)
    if r.has_wrench:
        for k, name in enumerate(WRENCH_COMPONENTS):
            if np.ptp(r.wrench[:, k]) > 0:
                yield Covariate((name,), "load", _cosines(r.wrench[:, k]))
    if len(set(r.load)) > 1:
        yield Covariate(("since_load_change",), "load", _cosines(named_column(c, "since_load_change")))
    yield Covariate(("pause",), "pause", _cosines(named_column(c, "pause")))
    for place in r.temperatures:
        yield Covariate((f"temp_{place}_C",), "temperature", _cosines(r.temperatures[place]))
    for name in r.covariates:
        yield Covariate((f"cov_{name}",), "other", _cosines(r.covariates[name]))
    block = np.arange(len(r)) * BLOCKS // len(r)
    yield Covariate(("time",), "time", (block[:, None] == np.arange(BLOCKS)).astype(float))
    yield Covariate(("always",), "always", np.ones((len(r), 1)))


def _cosines(values: Array) -> Array:
    """(M, SMOOTH) cosines over the ranks; what is not known stands in the middle."""
    known = np.where(np.isfinite(values), values, np.nanmedian(values) if np.isfinite(values).any() else 0.0)
    u = (rankdata(known) - 0.5) / len(known)
    return np.asarray(np.cos(np.pi * u[:, None] * np.arange(1, SMOOTH + 1)))


class Scores:
    """Collects S = Σ B(x) g·r of the recording and of its replicas, every channel g with every function B."""

    def __init__(self, compared: Compared) -> None:
        self.channels = channels(compared.context)
        self.covariates = covariates(compared.context)
        self._gradient = gradients(compared).astype(np.float32)
        self._square = (self._gradient**2).sum(axis=1)  # (M, C)
        smooth = [k.functions for k in self.covariates if k.kind != "waves"]
        self._basis = np.concatenate(smooth, axis=1).astype(np.float32)
        self._waves = []
        for k in (k for k in self.covariates if k.kind == "waves"):
            q, name = k.functions[:, 0], k.names[0][2:]
            phase = 2 * np.pi * ((q - q.min()) / np.ptp(q))[:, None] * CYCLES
            mine = [j for j, ch in enumerate(self.channels) if ch.frame == name]
            self._waves.append((np.concatenate([np.sin(phase), np.cos(phase)], axis=1).astype(np.float32), mine))
        self._parts: list[Single] = []
        self._wave_parts: list[list[Single]] = [[] for _ in self._waves]

    def add(self, left: Single) -> None:
        """left (d, M, 3T), bounded."""
        score = left.transpose(1, 0, 2) @ self._gradient  # (M, d, C)
        draws, number = score.shape[1:]
        self._parts.append(self._against(score, self._basis).reshape(draws, number, -1))
        for k, (basis, mine) in enumerate(self._waves):
            part = self._against(score[:, :, mine], basis).reshape(draws, len(mine), -1)
            self._wave_parts[k].append(part)

    @staticmethod
    def _against(score: Single, basis: Single) -> Single:
        return np.asarray(score.reshape(len(score), -1).T @ basis)

    def map(self) -> Map:
        own, pooled = self._sizes()
        return _standardised(tuple(self.channels), tuple(self.covariates), own, pooled)

    def _sizes(self) -> Array:
        """(2, D+1, R, C) squared strength. Units are variances: first over the replicas alone, for people to read; then
        with the recording among them, exchangeable, for significance."""
        parts = np.concatenate(self._parts).astype(float)  # (D+1, C, B)
        rows, waves = [], iter(zip(self._waves, self._wave_parts, strict=True))
        at = 0
        for k in self.covariates:
            if k.kind == "waves":
                (basis, mine), part = next(waves)
                whole = np.full((2, len(parts), len(self.channels)), np.nan)
                whole[:, :, mine] = self._waving(np.concatenate(part).astype(float), basis, mine)
                rows.append(whole)
            else:
                size = k.functions.shape[1]
                plain = (k.functions**2).T @ self._square
                square, units = _squares(parts[:, :, at : at + size], plain.T)
                rows.append(np.einsum("dcb,ucb->udc", square, units, optimize=True))
                at += size
        size = np.stack(rows, axis=2)  # (2, D+1, R, C)
        return np.where(size > 0, size, np.nan)

    def _waving(self, part: Array, basis: Single, mine: list[int]) -> Array:
        """The strongest wave of each channel: (2, D+1, C')."""
        plain = ((basis**2).T @ self._square[:, mine]).T
        square, units = _squares(part, plain)
        half = square.shape[2] // 2
        waves = (square * unit for unit in units)
        return np.array([(both[:, :, :half] + both[:, :, half:]).max(axis=2) for both in waves])


def _squares(part: Array, plain: Array) -> tuple[Array, Array]:
    """S² (D+1, C, B), and what it is multiplied by, (2, C, B), to be in units of its variance over the replicas, and
    over all; 0 where the fit leaves nothing of the function."""
    square = part**2
    replicas = square[1:].mean(axis=0)
    every = replicas + (square[0] - replicas) / len(square)
    seen = (replicas > LEAST_SHARE * plain) & (plain > 1e-12)
    return square, np.array([np.where(seen, 1.0 / np.maximum(v, 1e-300), 0.0) for v in (replicas, every)])


def _standardised(names: tuple[Channel, ...], rows: tuple[Covariate, ...], by_own: Array, by_all: Array) -> Map:
    """Cube roots of sums of squares are nearly normal (Wilson & Hilferty 1931): comparable whatever their number."""
    own, pooled = np.cbrt(by_own), np.cbrt(by_all)
    own = (own - own[1:].mean(axis=0)) / np.maximum(own[1:].std(axis=0), 1e-12)
    pooled = (pooled - pooled.mean(axis=0)) / np.maximum(pooled.std(axis=0), 1e-12)
    kinds = tuple(dict.fromkeys(k.kind for k in rows))
    on_frames = [j for j, ch in enumerate(names) if ch.index >= 0]
    apart = [j for j, ch in enumerate(names) if ch.index < 0]
    of_kind = [[j for j, k in enumerate(rows) if k.kind == kind] for kind in kinds]
    highest, shown = (np.stack([_highest(z[:, j][:, :, on_frames]) for j in of_kind], axis=1) for z in (pooled, own))
    sides = (_highest(pooled[:, :, apart]), _highest(own[:, :, apart])) if apart else None
    most = _highest(pooled)
    p = float((most >= most[0]).mean())
    threshold = float(np.quantile(_highest(own)[1:], 0.95))
    return Map(names, rows, own[0], threshold, p, kinds, highest, shown, sides)


def _highest(standardised: Array) -> Array:
    """(D+1, R, C) → (D+1,); cells where nothing can be seen count for nothing."""
    return np.asarray(np.nan_to_num(standardised, nan=-9.0).max(axis=(1, 2)))


def bounded(left: Single, freedom: Array) -> Single:
    """No visit longer than BOUND times its noise.   left (d, M, 3T), freedom (M,) coordinates measured"""
    length = np.sqrt((left**2).sum(axis=2) / np.maximum(freedom, 1))
    return np.asarray(left / np.maximum(length / np.float32(BOUND), 1.0)[:, :, None], dtype=np.float32)
