"""What a recording can show: per effect and joint the share that the base model leaves visible, and the aliases."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.workspace import Workspace

Array = NDArray[np.float64]
# √λ at which nine of ten are found when everything in the library is tried: the null's reach and 1.28 beyond it.
SEEN_AT = 6.0
ALIAS = 0.9


def visibility(space: Workspace, tried: Tried) -> list[dict[str, Any]]:
    """One row per effect and joint, for its likeliest single-column form.

    share          of the effect's squared size at the reflectors that is left after the base model
    detectable_mm  rms at the reflectors that would be found with 90 % power
    aliases        effects whose visible part is the same to within a correlation of 0.9
    """
    chosen = _representatives(tried)
    index = np.array([tried.index[c][0] for c in chosen.values()])
    plain, seen = tried.plain[index], tried.seen[index]
    unit = tried.half[index] / np.maximum(np.sqrt(seen), 1e-30)[:, None]
    alike = np.abs(unit @ unit.T)
    out = []
    for k, (effect, joint) in enumerate(chosen):
        aliases = sorted({
            other for j, (other, _) in enumerate(chosen) if j != k and alike[k, j] > ALIAS and other != effect
        })  # fmt: skip
        share = float(np.clip(seen[k] / max(plain[k], 1e-30), 0.0, 1.0))
        out.append(
            {
                "effect": effect, "joint": joint, "share": share,
                "detectable_mm": float(SEEN_AT / np.sqrt(max(seen[k], 1e-12)) * 1e3), "aliases": aliases,
            }
        )  # fmt: skip
    return out


def _representatives(tried: Tried) -> dict[tuple[str, str | None], int]:
    """Per name the candidate of fewest columns with the largest share."""
    chosen: dict[tuple[str, str | None], int] = {}
    for c, candidate in enumerate(tried.candidates):
        if candidate.effect == "nameless":
            continue
        name = (candidate.effect, candidate.joint)
        rank = (-len(candidate.columns), candidate.share)
        if name not in chosen or rank > _rank(tried, chosen[name]):
            chosen[name] = c
    return chosen


def _rank(tried: Tried, c: int) -> tuple[int, float]:
    return -len(tried.candidates[c].columns), tried.candidates[c].share
