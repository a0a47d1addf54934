"""What a machine went through before a move: poses, directions, loads, temperatures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Signs = NDArray[np.int64]
AS_IT_CAME = 1e-7  # a joint that is commanded less than this away stays as it came [m, rad]


@dataclass(frozen=True)
class Moment:
    """A pose at which the machine stood, and what was known there.

    q, approach   (n,) [m, rad]; −1, 0 (unknown), 1
    payload       (6,) on the sensor, sensor frame   [N, N·m]
    time          [s] since 1970, nan: unknown;   load: its label;   temperatures: place → °C
    run_up        (n,) the last way there of joints that a site has come from one side, signed [m, rad]; None: no such
    seen_to       (n,) directions that somebody sees to, whatever way a move goes; None: it goes straight there
    """

    q: Array
    approach: Signs
    payload: Array
    time: float = math.nan
    load: str = ""
    temperatures: Mapping[str, float] = field(default_factory=dict)
    run_up: Array | None = None
    seen_to: Signs | None = None

    def ways(self, before: Array) -> tuple[Moment, ...]:
        """This moment, and the one before it where joints had gone to from `before` (n,) for their run-up."""
        if self.run_up is None or not self.run_up.any():
            return (self,)
        turned = self.q - self.run_up
        return replace(self, q=turned, approach=approach_of(before, turned, self.approach), run_up=None), self


@dataclass(frozen=True)
class Past:
    """What went before a move, oldest first, with what the base model says of every moment: (M, …) as in Context.

    known     whether it reaches back to the last change of load
    recorded  whether it begins with a recording's first visit, or with what else had lain there for long
    lay_long  whether what had lain there at its beginning is only taken to have lain there for long
    on_nothing  whether its load is taken to have been put on an empty machine, for want of anybody who says so
    standing  whether nobody says where the move starts: the machine stood where it goes to
    """

    moments: tuple[Moment, ...] = ()
    wrenches: Array | None = None
    chain: Array | None = None
    compliance: Array | None = None
    known: bool = False
    recorded: bool = False
    lay_long: bool = False
    on_nothing: bool = False
    standing: bool = False

    def before(self, q: Array) -> tuple[Moment, ...]:
        """Its moments, of a move to q (n,)."""
        return tuple(replace(m, q=q) for m in self.moments) if self.standing else self.moments

    def followed_by(self, wrenches: Array, chain: Array, compliance: Array) -> tuple[Array, Array, Array]:
        """The same of later moments, with those of this past before them."""
        if not self.moments:
            return wrenches, chain, compliance
        assert self.wrenches is not None
        assert self.chain is not None
        assert self.compliance is not None
        return (
            np.concatenate([self.wrenches, wrenches]), np.concatenate([self.chain, chain]),
            np.concatenate([self.compliance, compliance]),
        )  # fmt: skip


def approach_of(start: Array, end: Array, before: Signs | None = None) -> Signs:
    """Direction (n,) of a straight move; a joint that stays keeps the one that it had (0 where that is unknown)."""
    moved = end - start
    kept = np.zeros(len(moved), dtype=np.int64) if before is None else before
    return np.where(np.abs(moved) < AS_IT_CAME, kept, np.sign(moved)).astype(np.int64)
