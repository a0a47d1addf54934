"""Where the reflectors really sit on the end effector, when the machine file only gives a start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.terms import Parameter

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TargetOffset:
    """A constant shift of every target in the end-effector frame.

    names   the targets, in the recording's order
    """

    names: tuple[str, ...]
    kind: str = "target_offset"

    def parameters(self, frame_names: Sequence[str]) -> list[Parameter]:
        return [Parameter(f"target.{t}.{c}", "m", "target", 1.0, 5e-3) for t in self.names for c in "xyz"]

    def point_regressors(self, tip_rotation: Array) -> Array:
        """(N, 3, 3) end-effector orientation in the base → (N, T, 3, 3T) with δp = D θ."""
        count = len(self.names)
        out = np.zeros((len(tip_rotation), count, 3, 3 * count))
        for t in range(count):
            out[:, t, :, 3 * t : 3 * t + 3] = tip_rotation
        return out

    def as_dict(self) -> dict[str, Any]:
        return {"kind": self.kind, "names": list(self.names)}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> TargetOffset:
        return cls(tuple(data["names"]))
