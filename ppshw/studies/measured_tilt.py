"""Inclinometers on the machine as covariates: what they read is how a frame leans, up to their mounting.

    ε_frame = Σ_s (θ_s + θ'_s u) (t_s − t̄_s)

t_s two tilts [rad], t̄_s their mean in the recording that was identified (mounting errors are constants, and those are
the geometric terms' own), u the joint's position over its travel. A rotation should come out as the tilt itself; a
translation follows because the frame's origin is not where the structure pivots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.recording import Recording
from ppshw.terms import COMPONENTS, Parameter, Situation
from ppshw.terms.basis import Basis

Array = NDArray[np.float64]
UNITS = {"t": "m/rad", "r": "1"}
# Prior standard deviation where the search starts: a tilt enters once as itself, and with some metre of lever.
START = 1.0


@dataclass(frozen=True)
class MeasuredTilt:
    """frame, and the covariates of two tilts; `minus` names what is subtracted from each ("" for nothing)."""

    frame: int
    tilts: tuple[str, str]
    minus: tuple[str, str]
    mean: tuple[float, float]
    basis: Basis
    kind: str = "measured_tilt"

    @classmethod
    def of(
        cls, frame: int, tilts: tuple[str, str], minus: tuple[str, str], basis: Basis, recording: Recording
    ) -> MeasuredTilt:
        """Centred on what the recording shows; raises KeyError when it has no such covariate."""
        raw = _read(recording.covariates, tilts, minus)
        return cls(frame, tilts, minus, (float(raw[:, 0].mean()), float(raw[:, 1].mean())), basis)

    def parameters(self, frame_names: Sequence[str]) -> list[Parameter]:
        name = frame_names[self.frame]
        return [
            Parameter(f"{name}.{c}/{t}[{j}]", UNITS[c[0]], f"tilt.{name}.{c[0]}.{band}", 1.0, START)
            for c in COMPONENTS
            for t in self.tilts
            for j, band in enumerate(self.basis.bands)
        ]

    def regressors(self, situation: Situation, wrenches: Array) -> Array:
        tilt = _read(situation.covariates, self.tilts, self.minus) - np.asarray(self.mean)
        x = situation.q[:, self.frame - 1] if self.frame > 0 else np.zeros(len(situation))
        each = np.einsum("ns,nj->nsj", tilt, self.basis.values(x)).reshape(len(situation), -1)
        m = each.shape[1]
        out = np.zeros((len(each), 6, 6 * m))
        for k in range(6):
            out[:, k, k * m : (k + 1) * m] = each
        return out

    def as_dict(self) -> dict[str, Any]:
        return {
            "kind": self.kind, "frame": self.frame, "tilts": list(self.tilts), "minus": list(self.minus),
            "mean": list(self.mean), "basis": self.basis.as_dict(),
        }  # fmt: skip


def _read(covariates: Any, tilts: tuple[str, str], minus: tuple[str, str]) -> Array:
    """(N, 2) [rad]"""
    return np.column_stack([covariates[t] - (covariates[m] if m else 0.0) for t, m in zip(tilts, minus, strict=True)])
