"""Physical effects as terms: one file each.

A term is linear in its parameters and says where it acts: a generalized error of a frame, or directly on the measured
points. Identification, compensation and diagnosis all use the same term.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ppshw.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
COMPONENTS = ("tx", "ty", "tz", "rx", "ry", "rz")
# How many parts the groups' names of each kind of term have behind the frame's own name.
BEHIND_FRAME = {"geometric": 2, "compliance": 3, "own": 1, "tilt": 2}


@dataclass(frozen=True)
class Situation:
    """What the model may know of N visits before it says where the targets are.

    q (N, n) [m, rad];  payload (N, 6) on the sensor [N, N·m];  time (N,) [s];  temperatures and
    covariates name → (N,)
    """

    q: Array
    payload: Array
    time: Array | None = None
    temperatures: Mapping[str, Array] = field(default_factory=dict)
    covariates: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, recording: Recording) -> Situation:
        return cls(
            recording.q,
            recording.wrench,
            recording.time,
            recording.temperatures,
            recording.covariates,
        )

    def __len__(self) -> int:
        return len(self.q)


@dataclass(frozen=True)
class Parameter:
    """One number to identify.

    name   e.g. "vertical.ty[3]" or "longitudinal.C[ty,Fy][0]"
    unit   of the number
    group  parameters of one group share one prior variance
    scale  prior standard deviation relative to the group's
    start  the group's prior standard deviation before any data were seen, in `unit`
    """

    name: str
    unit: str
    group: str
    scale: float
    start: float


def parts_of(group: str) -> list[str]:
    """A group's name taken apart: geometric.w3.t.line → its kind, the frame, t, line. A frame's own name may hold
    dots."""
    kind, dot, rest = group.partition(".")
    return [kind, *rest.rsplit(".", BEHIND_FRAME.get(kind, 0))] if dot else [group]


class FrameTerm(Protocol):
    """A term that adds to the generalized errors of one frame."""

    @property
    def kind(self) -> str: ...

    @property
    def frame(self) -> int: ...

    def parameters(self, frame_names: Sequence[str]) -> list[Parameter]: ...

    def regressors(self, situation: Situation, wrenches: Array) -> Array:
        """D with ε_frame = D θ.

        wrenches  (N, n+1, 6) on the frames   [N, N·m]
        returns   (N, 6, m)
        """

    def as_dict(self) -> dict[str, Any]: ...


@runtime_checkable
class Fills(Protocol):
    """A term that lays its columns out faster than by its regressors."""

    def fill(self, out: Array, jacobian: Array, situation: Situation, wrenches: Array, which: Mask) -> None:
        """`jacobian @ regressors(…)` of the parameters `which` (m,), written to `out` without the zeros in between.

        jacobian  (N, R, 6) how R coordinates move with the frame's generalized error
        out       (N, R, k) for the k parameters that are wanted
        """
