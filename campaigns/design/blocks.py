"""Short sequences of visits that may tell two effects apart: small reversals, positions from both sides, loads through
zero, holds under a load, two joints at once, reference revisits.

What depends on history needs an order, so a candidate is a block of visits, not a visit. Every block begins with a move
that leaves nothing of what was before: the joint in question comes from far away.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from campaigns.design.choose import inside
from campaigns.plan import travel
from campaigns.script import LOAD_CHANGE_S, MEASURE_S, SETTLE_S, LoadCase
from ppshw.machine import Machine

Array = NDArray[np.float64]
Draw = Callable[[int], Array]
# Steps back, as shares of the travel: from where friction has hardly turned to where it slides everywhere.
REVERSALS = (0.004, 0.012, 0.03, 0.08, 0.2)
# A joint comes from so far, as a share of its travel, before a reversal counts.
FAR = 0.35
# What is put on in parts, so that moments come close to zero from either side.
PARTS = (0.3, 0.6, 1.0)
HOLD = 6  # visits of a hold after a load change


@dataclass(frozen=True)
class Block:
    """what: said in words; case: the load; q (V, n) in the order of the visits."""

    what: str
    case: LoadCase
    q: Array

    def seconds(self, machine: Machine, hangs: str = "") -> Array:
        """(V,) of every visit, the load change before the first where another load hangs there, by its name; ""
        nothing."""
        here = np.vstack([self.q[:1], self.q[:-1]])
        out = travel(machine.joints, here, self.q) + SETTLE_S + MEASURE_S * len(machine.targets)
        stays = self.case.name == hangs if hangs else self.case.mass == 0
        out[0] += 0.0 if stays else LOAD_CHANGE_S
        return out


def blocks(
    machine: Machine, cases: Sequence[LoadCase], joints: Sequence[int], seed: int, in_parts: bool = True
) -> list[Block]:
    """Candidates for effects of some joints; `cases`: what may be put on, the empty machine first; in_parts: and parts
    of it."""
    rng = np.random.default_rng([seed, 815])
    low, high = machine.limits()
    empty = cases[0] if cases[0].mass == 0 else replace(cases[0], name="empty", mass=0.0, com=(0.0, 0.0, 0.0))

    def anywhere(count: int) -> Array:
        return low + rng.uniform(0.03, 0.97, (count, machine.n)) * (high - low)

    found: list[Block] = []
    for k in joints:
        found += _of_joint(machine, empty, k, anywhere, rng)
    for case in cases:
        parts = PARTS if case.mass > 0 and in_parts else (1.0,)
        for part in parts:
            some = case if part == 1.0 else replace(case, name=f"{case.name}-{part:g}", mass=round(part * case.mass, 1))
            said = f"random poses, {some.name}"
            found.append(Block(said, some, anywhere(4)))
        if case.mass > 0:
            pair = anywhere(2)
            found.append(Block(f"hold under {case.name}", case, np.tile(pair, (HOLD // 2, 1))))
    middle = np.repeat((low + high)[None] / 2, 4, axis=0)
    middle[1::2] = anywhere(2)
    found.append(Block("reference pose, there and back", empty, middle))
    return [replace(block, q=inside(machine, block.q)) for block in found]


def _of_joint(machine: Machine, empty: LoadCase, k: int, anywhere: Draw, rng: np.random.Generator) -> Iterator[Block]:
    low, high = (float(x[k]) for x in machine.limits())
    span, name = high - low, machine.joints[k].name
    for step in REVERSALS:
        for side in (-1.0, 1.0):
            q = np.repeat(anywhere(1), 5, axis=0)
            at = low + span * rng.uniform(0.42, 0.58)
            q[:, k] = [at - side * FAR * span, at, at - side * step * span, at, at - side * step * span / 2]
            yield Block(f"{name}: turns back by {step:.1%} of its travel", empty, q)
    for _ in range(2):
        q = np.repeat(anywhere(1), 6, axis=0)
        places = low + span * np.sort(rng.uniform(0.15, 0.85, 2))
        q[:, k] = [low + 0.01 * span, places[0], places[1], high - 0.01 * span, places[1], places[0]]
        yield Block(f"{name}: the same positions from both sides", empty, q)
        q = np.repeat(anywhere(1), 5, axis=0)
        q[:, k] = low + span * rng.uniform(0.02, 0.98, 5)
        yield Block(f"{name}: positions off any grid", empty, q)
    for other in range(machine.n):
        if other != k:
            q = np.repeat(anywhere(1), 4, axis=0)
            lows, highs = machine.limits()
            a = low + span * rng.uniform([0.02, 0.8], [0.2, 0.98])
            b = lows[other] + (highs[other] - lows[other]) * rng.uniform([0.02, 0.8], [0.2, 0.98])
            q[:, k], q[:, other] = [a[0], a[1], a[1], a[0]], [b[0], b[0], b[1], b[1]]
            yield Block(f"{name} and {machine.joints[other].name}: corners", empty, q)
