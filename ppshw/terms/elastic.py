"""Elastic errors: a symmetric compliance matrix behind a joint acts on its link's wrench   (paper eqs 15, 16)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.machine import WRENCH_COMPONENTS, Elastic
from ppshw.terms import COMPONENTS, Mask, Parameter, Situation
from ppshw.terms.basis import Basis, basis_from_dict

Array = NDArray[np.float64]
# Starting prior standard deviations by kind of element: displacement per force, mixed, rotation per moment. A steel
# structure of metres gives way by 1e-7 m/N; soon forgotten.
START = {"tF": 5e-7, "tM": 2e-7, "rM": 2e-7}
# A beam or bearing that is symmetric about the frame's axes gives way in its own planes: shifts along the force, turns
# about the moment, each with the other about a third axis. What couples otherwise (tx with Fy, rx with My, tx with Mx)
# comes of skewness and is smaller by its angle [rad]: a fifth is a lot.
SKEW = 0.2
# Legendre coefficients of a compliance over the travel fall: of one sliding beam (1 + u)² has 1 : 0.33 : 0 beyond its
# mean, (1 + u)³ 1 : 0.56 : 0.11; columns of several sections fall less. 0.4 was better for simulated beams (seeds 100
# to 107) and worse for Hilti's column.
DECLINE = 0.7
UNITS = {"tF": "m/N", "tM": "rad/N", "rM": "rad/(N m)"}


def pattern(elastic: Elastic) -> tuple[tuple[int, int], ...]:
    """The elements (a, b), a ≤ b, of the symmetric matrix that the acting loads can excite.

    With all six loads these are the 21 of the paper; elements whose both loads are absent change nothing and are left
    out ("the compliance parameters multiplied by the nullified components of W", section 4.1).
    """
    acting = set(elastic.load_indices)
    return tuple((a, b) for a in range(6) for b in range(a, 6) if a in acting or b in acting)


def element_kind(a: int, b: int) -> str:
    return ("t" if a < 3 else "r") + ("F" if b < 3 else "M")


def skew(a: int, b: int) -> bool:
    """Nothing that a beam along the frame's axes with a symmetric section has."""
    return (a % 3 == b % 3) == (element_kind(a, b) == "tM")


@dataclass(frozen=True)
class Compliance:
    """ε_frame = C(q_i) W_frame, C symmetric, its elements functions of the joint's own position or constants.

    elements  (a, b) pairs, a ≤ b, in the order tx ty tz rx ry rz / Fx Fy Fz Mx My Mz
    loads     indices of the wrench components that act on this link; others are taken as zero
    """

    frame: int
    elements: tuple[tuple[int, int], ...]
    loads: tuple[int, ...]
    basis: Basis
    kind: str = "compliance"

    def parameters(self, frame_names: Sequence[str]) -> list[Parameter]:
        """Every element has a strength of its own, since which of them matter depends on how the link is built."""
        name, out = frame_names[self.frame], []
        for a, b in self.elements:
            element, kind = f"{COMPONENTS[a]},{WRENCH_COMPONENTS[b]}", element_kind(a, b)
            scale = SKEW if skew(a, b) else 1.0
            group = f"compliance.{name}.{kind}{'-skew' if skew(a, b) else ''}.{element}"
            out += [
                Parameter(f"{name}.C[{element}][{j}]", UNITS[kind], f"{group}.{band}",
                          scale * DECLINE ** max(j - 1, 0), START[kind])
                for j, band in enumerate(self.basis.bands)
            ]  # fmt: skip
        return out

    def regressors(self, situation: Situation, wrenches: Array) -> Array:
        values, load = self._values(situation, wrenches)
        m = values.shape[1]
        out = np.zeros((len(values), 6, len(self.elements) * m))
        for k, (a, b) in enumerate(self.elements):
            columns = slice(k * m, (k + 1) * m)
            out[:, a, columns] = load[:, b, None] * values
            if a != b:
                out[:, b, columns] = load[:, a, None] * values
        return out

    def fill(self, out: Array, jacobian: Array, situation: Situation, wrenches: Array, which: Mask) -> None:
        values, load = self._values(situation, wrenches)
        at = 0
        for (a, b), wanted in zip(self.elements, which.reshape(len(self.elements), -1), strict=True):
            size = int(wanted.sum())
            if size == 0:
                continue
            moved = jacobian[:, :, a] * load[:, b, None]
            if a != b:
                moved = moved + jacobian[:, :, b] * load[:, a, None]
            np.multiply(moved[..., None], values[:, None, wanted], out=out[:, :, at : at + size])
            at += size

    def _values(self, situation: Situation, wrenches: Array) -> tuple[Array, Array]:
        """The basis (N, m) at the joint's position, and the acting load (N, 6)."""
        acting = np.zeros(6)
        acting[list(self.loads)] = 1.0
        return self.basis.values(situation.q[:, self.frame - 1]), wrenches[:, self.frame] * acting

    def as_dict(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "frame": self.frame,
            "elements": [[COMPONENTS[a], WRENCH_COMPONENTS[b]] for a, b in self.elements],
            "loads": [WRENCH_COMPONENTS[k] for k in self.loads],
            "basis": self.basis.as_dict(),
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Compliance:
        elements = tuple((COMPONENTS.index(a), WRENCH_COMPONENTS.index(b)) for a, b in data["elements"])
        loads = tuple(WRENCH_COMPONENTS.index(k) for k in data["loads"])
        return cls(int(data["frame"]), elements, loads, basis_from_dict(data["basis"]))
