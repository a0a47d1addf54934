"""Geometric errors: six functions of the joint's own position behind every frame   (paper eqs 13, 22)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.terms import COMPONENTS, Mask, Parameter, Situation
from ppshw.terms.basis import Basis, basis_from_dict

Array = NDArray[np.float64]
# Where the search for the prior strengths starts: wide for an assembled machine, and soon forgotten.
START = {"t": 1e-3, "r": 5e-4}


@dataclass(frozen=True)
class Geometric:
    """ε_frame,k(q_i) = Σ_j θ_kj b_j(q_i) for k = tx … rz.

    frame   0 for the base, i for the frame behind joint i
    basis   functions of the joint's position (a constant for the base)
    """

    frame: int
    basis: Basis
    kind: str = "geometric"

    def parameters(self, frame_names: Sequence[str]) -> list[Parameter]:
        name, bands = frame_names[self.frame], self.basis.bands
        return [
            Parameter(
                f"{name}.{c}[{j}]",
                "m" if c[0] == "t" else "rad",
                f"geometric.{name}.{c[0]}.{band}",
                1.0,
                START[c[0]],
            )
            for c in COMPONENTS
            for j, band in enumerate(bands)
        ]

    def regressors(self, situation: Situation, wrenches: Array) -> Array:
        x = situation.q[:, self.frame - 1] if self.frame > 0 else np.zeros(len(situation))
        values = self.basis.values(x)
        m = values.shape[1]
        out = np.zeros((len(values), 6, 6 * m))
        for k in range(6):
            out[:, k, k * m : (k + 1) * m] = values
        return out

    def fill(self, out: Array, jacobian: Array, situation: Situation, wrenches: Array, which: Mask) -> None:
        x = situation.q[:, self.frame - 1] if self.frame > 0 else np.zeros(len(situation))
        values = self.basis.values(x)[:, None]
        at = 0
        for k, wanted in enumerate(which.reshape(6, -1)):
            size = int(wanted.sum())
            np.multiply(jacobian[:, :, k, None], values[..., wanted], out=out[:, :, at : at + size])
            at += size

    def as_dict(self) -> dict[str, Any]:
        return {"kind": self.kind, "frame": self.frame, "basis": self.basis.as_dict()}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Geometric:
        return cls(int(data["frame"]), basis_from_dict(data["basis"]))
