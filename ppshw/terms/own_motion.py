"""A joint's motion that is not what its encoder says, as a fine function of its own position.

Gears, screws and encoders err along the joint's own freedom and do so many times per revolution or per metre, faster
than anything that the rails and bearings do to the other five components. The term is the part of `Geometric` along
that one freedom that the smooth functions there are too slow for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.terms import Mask, Parameter, Situation
from ppshw.terms.basis import WIDENING

Array = NDArray[np.float64]
# Waves that share one prior strength: narrow, because a gear mesh is a line in the spectrum and its neighbours are not.
BAND = 8
# Prior standard deviation where the search starts, for a wave's amplitude.
START = {"m": 2e-5, "rad": 5e-5}


@dataclass(frozen=True)
class OwnMotion:
    """ε_frame = d Σ_j θ_j sin(jπ(u + w)/(2w)),   u = (q − centre)/half,  w = 1.2,  j = first … last.

    The sines are those of `basis.Smooth` continued to shorter waves; here without the 1/j, each band having a strength
    of its own. Outside the travel the function is held at its end value.

    frame      i, behind joint i
    direction  (6,) the joint's freedom as a unit displacement in its own frame: translation, then rotation
    centre     of the sampled travel, half: half its length    [m, rad]
    """

    frame: int
    direction: tuple[float, ...]
    centre: float
    half: float
    first: int
    last: int
    kind: str = "own_motion"

    @property
    def unit(self) -> str:
        return "m" if any(self.direction[:3]) else "rad"

    def parameters(self, frame_names: Sequence[str]) -> list[Parameter]:
        name, unit = frame_names[self.frame], self.unit
        return [
            Parameter(f"{name}.own[{j}]", unit, f"own.{name}.{(j - self.first) // BAND}", 1.0, START[unit])
            for j in range(self.first, self.last + 1)
        ]

    def values(self, x: Array) -> Array:
        """(N,) joint positions → (N, m) sines."""
        u = np.clip((x - self.centre) / self.half, -1.0, 1.0)
        j = np.arange(self.first, self.last + 1)
        return np.asarray(np.sin(np.pi / (2 * WIDENING) * np.multiply.outer(u + WIDENING, j)))

    def regressors(self, situation: Situation, wrenches: Array) -> Array:
        values = self.values(situation.q[:, self.frame - 1])
        return np.asarray(np.asarray(self.direction)[None, :, None] * values[:, None, :])

    def fill(self, out: Array, jacobian: Array, situation: Situation, wrenches: Array, which: Mask) -> None:
        values = self.values(situation.q[:, self.frame - 1])[:, None, which]
        np.multiply((jacobian @ np.asarray(self.direction))[..., None], values, out=out)

    def as_dict(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "frame": self.frame,
            "direction": list(self.direction),
            "centre": self.centre,
            "half": self.half,
            "first": self.first,
            "last": self.last,
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> OwnMotion:
        direction = tuple(float(d) for d in data["direction"])
        if len(direction) != 6:
            raise ValueError(f"own_motion: direction has {len(direction)} components, expected 6")
        return cls(
            int(data["frame"]), direction, float(data["centre"]), float(data["half"]),
            int(data["first"]), int(data["last"]),
        )  # fmt: skip
