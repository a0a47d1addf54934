"""Is a recording like its twin? Posterior predictive checks by name, before and after what was found is modelled.

Each check is one number of the whitened residual, taken of the recording and of replicas that the model made itself
(`replicas`), so that what the fit absorbs is in the null. Ranks are exact whatever the number's distribution. A model
that is right fails one check in twenty at p = 0.05, by chance: up to sixteen are made.
docs/diagnosis-method.md §5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.locate import DRAWS, Map, Scores, bounded
from ppshw.diagnosis.replicas import Compared, of_space
from ppshw.diagnosis.workspace import Workspace

Array = NDArray[np.float64]
Single = NDArray[np.float32]
# A check is said to fail below this: with up to sixteen of them, one recording in fourteen or so does by chance.
ODD = 0.005
MOST_SAID = 3  # checks that a sentence names
# The kinds of dependence that the map of `locate` looks at, as checks.
DEPENDS = {
    "travel": "dependence on a joint's position",
    "waves": "short waves along a joint's travel",
    "approach": "dependence on the direction of approach",
    "pairs": "dependence on two joints at once",
    "load": "dependence on the load",
    "temperature": "dependence on a temperature",
    "other": "dependence on another column",
    "pause": "dependence on the pause before a visit",
    "time": "dependence on time, in blocks",
}


@dataclass(frozen=True)
class Check:
    """observed: the recording's number; low, high: the middle 95 % of the replicas'; p of being so far out by chance;
    where: the strongest dependence, for those that look for one."""

    name: str
    about: str
    observed: float
    low: float
    high: float
    p: float
    where: str | None = None

    @property
    def odd(self) -> bool:
        return self.p <= ODD

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def check(compared: Compared, seed: int = 0, draws: int = DRAWS) -> tuple[list[Check], Map]:
    """All checks of a recording, and the map of where its residual depends on what."""
    rng = np.random.default_rng(seed)
    numbers, scores = _Numbers(compared), Scores(compared)
    freedom = compared.live.sum(axis=1)
    observed = compared.left[None].astype(np.float32)
    for left in (observed, *compared.replicas(rng, draws)):
        numbers.add(left)
        scores.add(bounded(left, freedom))
    return numbers.checks() + _dependences(found := scores.map()), found


def before_and_after(space: Workspace, seed: int = 0) -> dict[str, list[dict[str, Any]]]:
    """The checks by the base model alone, of every visit; and with the findings, of the visits that were believed."""
    before = check(of_space(space, found=False, everything=True), seed)[0]
    after = before
    if space.taken.shape[2] or space.calmed or not space.fit[space.recording.measured].all():
        after = check(of_space(space), seed)[0]
    return {"before": [c.as_dict() for c in before], "after": [c.as_dict() for c in after]}


def sentence(checks: Sequence[dict[str, Any]]) -> str:
    """In one line, the checks named that stand out most."""
    odd = sorted((c for c in checks if c["p"] <= ODD), key=_out, reverse=True)
    if not odd:
        return f"like its twin in all {len(checks)} checks"
    names = "; ".join(c["about"] + (f" ({c['where']})" if c["where"] else "") for c in odd[:MOST_SAID])
    most = ", most in" if len(odd) > MOST_SAID else ":"
    return f"unlike its twin in {len(odd)} of {len(checks)} checks{most} {names}"


def _out(c: dict[str, Any]) -> float:
    """How far a check is from the middle of its replicas, in halves of their middle 95 %."""
    return float(abs(2.0 * c["observed"] - c["low"] - c["high"]) / max(c["high"] - c["low"], 1e-12))


class _Numbers:
    """The checks that no map gives, of the recording and then of its replicas."""

    def __init__(self, compared: Compared) -> None:
        r = compared.recording
        self._freedom = np.maximum(compared.live.sum(axis=1), 1)
        self._total = float(compared.live.sum())
        self._sizes: dict[str, Array] = {}
        if np.isfinite(r.settle_s).all() and np.ptp(r.settle_s) > 0:
            self._sizes["scatter_settling"] = np.stack([np.exp(-r.settle_s / t) for t in (1.0, 3.0, 8.0, 1e3)])
        if r.has_wrench and np.ptp(r.wrench, axis=0).max() > 0:
            self._sizes["scatter_load"] = np.linalg.norm(r.wrench[:, :3], axis=1)[None]
        self._found: dict[str, list[Array]] = {}

    def add(self, left: Single) -> None:
        """left (d, M, 3T)"""
        square = (left.astype(float) ** 2).sum(axis=2)  # (d, M)
        size = square / self._freedom
        self._keep("rms", np.sqrt(square.sum(axis=1) / self._total))
        self._keep("largest_visit", np.sqrt(size.max(axis=1)))
        near = (left[:, 1:] * left[:, :-1]).sum(axis=(1, 2))
        self._keep("neighbours", near / square.sum(axis=1))
        fourth = (left**4).sum(axis=(1, 2)) / self._total
        self._keep("tails", fourth / (square.sum(axis=1) / self._total) ** 2)
        log = np.log(np.maximum(size, 1e-6))
        log = (log - log.mean(axis=1, keepdims=True)) / np.maximum(log.std(axis=1, keepdims=True), 1e-12)
        for name, columns in self._sizes.items():
            unit = columns - columns.mean(axis=1, keepdims=True)
            unit /= np.maximum(unit.std(axis=1, keepdims=True), 1e-12)
            r = log @ unit.T / unit.shape[1]
            self._keep(name, r[np.arange(len(r)), np.abs(r).argmax(axis=1)])

    def _keep(self, name: str, values: Array) -> None:
        self._found.setdefault(name, []).append(np.asarray(values, dtype=float))

    def checks(self) -> list[Check]:
        about = {
            "rms": ("size of the residual, in units of the noise", 0),
            "largest_visit": ("the largest visit, in units of the noise", 1),
            "neighbours": ("likeness of consecutive visits", 0),
            "tails": ("heavy tails: mean fourth power against three", 0),
            "scatter_settling": ("scatter against settling time", 0),
            "scatter_load": ("scatter against load", 0),
        }
        return [
            _check(name, about[name][0], np.concatenate(parts), one_sided=bool(about[name][1]))
            for name, parts in self._found.items()
        ]


def _check(name: str, about: str, values: Array, one_sided: bool) -> Check:
    """values (D+1,), the recording's first"""
    above, below = float((values >= values[0]).mean()), float((values <= values[0]).mean())
    p = above if one_sided else min(1.0, 2 * min(above, below))
    low, high = np.quantile(values[1:], [0.025, 0.975])
    return Check(name, about, float(values[0]), float(low), float(high), p)


def _dependences(found: Map) -> list[Check]:
    """The strongest dependence of each kind, standardised; that of distances between reflectors on anything apart."""
    out = []
    for j, kind in enumerate(found.kinds):
        if kind not in DEPENDS:
            continue
        p = float((found.highest[:, j] >= found.highest[0, j]).mean())
        low, high = np.quantile(found.shown[1:, j], [0.025, 0.975])
        of_kind = [r for r, k in enumerate(found.covariates) if k.kind == kind]
        out.append(
            Check(kind, DEPENDS[kind], float(found.shown[0, j]), float(low), float(high), p, _where(found, of_kind))
        )
    if found.sides is not None:
        pooled, own = found.sides
        low, high = np.quantile(own[1:], [0.025, 0.975])
        p = float((pooled >= pooled[0]).mean())
        out.append(Check("triangle", "distances between reflectors", float(own[0]), float(low), float(high), p))
    return out


def _where(found: Map, rows: list[int]) -> str | None:
    best = [float(np.nanmax(found.strength[r], initial=-np.inf)) for r in rows]
    if not np.isfinite(best).any():
        return None
    row = rows[int(np.argmax(best))]
    channel = found.channels[found.channel_of(row)]
    return f"{channel.frame} {channel.component} over {found.covariates[row].label}"
