"""Moving weight: a body heavier than the file says or elsewhere, a cable chain, a hose."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ppshw.diagnosis.library.candidate import Candidate
from ppshw.diagnosis.library.sampled import moving_joints, that_act
from ppshw.terms import COMPONENTS
from ppshw.terms.shapes import Column, Context

# Moments that change by less bend nothing: a weak joint of 1e-4 rad/(N m) turns by 5 µrad. The heaviest chain: 100 N.
LEAST_MOMENT, HEAVIEST_CHAIN = 0.05, 100.0  # N m (standard deviation over the visits), N


def own_moment(c: Context, frame: int, component: int) -> Column | None:
    """What a frame does by a moment (component 3, 4 or 5) of the machine's own weight; None where it hardly changes."""
    column = Column("frame", "own_weight", {"frame": frame, "component": component}, frame, component)
    return column if float(np.std(column.value(c))) > LEAST_MOMENT else None


def moving_weight(c: Context) -> Iterator[Candidate]:
    for k, name in moving_joints(c):
        mass = Column("frames", "body_weight", {"joint": k, "what": "mass"})
        yield Candidate("moving_weight", name, name, None, f"q_{name}", (mass,))
        for axis in "xyz":
            shift = Column("frames", "body_weight", {"joint": k, "what": axis})
            yield Candidate("moving_weight", name, name, None, f"q_{name}", (shift,), share=0.2)
        chain = tuple(
            Column("frames", "body_weight", {"joint": k, "what": what, "grows": power})
            for power in (1, 2) for what in ("mass", "x", "y", "z")
        )  # fmt: skip
        for some in (chain[:1], (chain[0], chain[4]), chain):  # a cable chain hangs there, as long as its joint has it
            if alive := that_act(c, some):
                yield Candidate("moving_weight", name, name, None, f"q_{name}", alive, share=0.3)
        for other, by in moving_joints(c):  # a hose that another joint pulls along
            if other == k:
                continue
            hose = tuple(
                Column("frames", "body_weight", {"joint": k, "what": what, "grows": 1, "by": other})
                for what in ("mass", *"xyz")
            )
            if all(not np.any(column.value(c)) for column in hose):
                continue
            for some in ((column,) for column in hose if np.any(column.value(c))):
                yield Candidate("moving_weight", name, name, None, f"q_{by}", some, share=0.03)
            yield Candidate("moving_weight", name, name, None, f"q_{by}", that_act(c, hose), share=0.05)
    for frame, name in enumerate(c.machine.joint_names, start=1):
        for b in range(3, 6):
            if (column := own_moment(c, frame, b)) is not None:
                yield Candidate("moving_weight", name, name, COMPONENTS[b], f"q_{name}", (column,), {}, 0.5)
            if frame < c.machine.n:
                args = {"frame": frame, "component": b, "joint": frame}
                column = Column("frame", "hanging", args, frame, b)
                if HEAVIEST_CHAIN * float(np.std(column.value(c))) > LEAST_MOMENT:
                    after = c.machine.joint_names[frame]
                    yield Candidate("moving_weight", name, name, COMPONENTS[b], f"q_{after}", (column,), {}, 0.5)
