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
LEAST_BEND = 1e-6  # m, rad
# Part of what the mass of a body does, or a shift along another axis: one along gravity bends by tilts of a thousandth
# alone, and something else that went by them was a body shifted by 150 t m (another author's telescope).
HARDLY = 0.02
# A joint that turns by less pulls nothing along: a coupling to a couch that tilts by 0.2 rad was a chain there of 35 kg
# (another author's).
LEAST_TURN = 0.5  # rad


def own_moment(c: Context, frame: int, component: int) -> Column | None:
    """What a frame does by a moment (component 3, 4 or 5) of the machine's own weight; None where it hardly changes."""
    column = Column("frame", "own_weight", {"frame": frame, "component": component}, frame, component)
    return column if float(np.std(column.value(c))) > LEAST_MOMENT else None


def _body(c: Context, joint: int, **growing: int) -> tuple[Column, ...]:
    """What mass and shifts of it do at a joint's body, of those that do anything."""
    every = [Column("frames", "body_weight", {"joint": joint, "what": what, **growing}) for what in ("mass", *"xyz")]
    return that_act(c, every, HARDLY)


def _pulls(c: Context, joint: int) -> bool:
    """Whether a joint goes far enough to pull a chain or a hose along."""
    return c.machine.joints[joint].prismatic or float(np.ptp(c.recording.q[:, joint])) > LEAST_TURN


def moving_weight(c: Context) -> Iterator[Candidate]:
    for k, name in moving_joints(c):
        where = ("moving_weight", name, name, None, f"q_{name}")
        for column in _body(c, k):
            yield Candidate(*where, (column,), share=1.0 if column.args["what"] == "mass" else 0.2)
        # a cable chain hangs there, as long as its joint has it
        linear, squared = (_body(c, k, grows=power) if _pulls(c, k) else () for power in (1, 2))
        for some in (linear[:1], linear[:1] + squared[:1], linear + squared):
            if some:
                yield Candidate(*where, some, share=0.3)
        for other, by in moving_joints(c):  # a hose that another joint pulls along
            if other != k and _pulls(c, other) and (hose := _body(c, k, grows=1, by=other)):
                for column in hose:
                    yield Candidate("moving_weight", name, name, None, f"q_{by}", (column,), share=0.03)
                yield Candidate("moving_weight", name, name, None, f"q_{by}", hose, share=0.05)
    floor = tuple(bends for b in (3, 4, 5) if (bends := own_moment(c, 0, b)) is not None)
    if floor:  # it gives way to what moves over it, not to what it always bears
        first = c.machine.joint_names[0]
        yield Candidate("moving_weight", None, c.machine.frame_names[0], None, f"q_{first}", floor)
    for frame, name in enumerate(c.machine.joint_names, start=1):
        own = Column("frames", "own_bend", {"frame": frame})  # more, or less, than the payload bends it
        if float(np.ptp(own.value(c)[:, frame], axis=0).max()) > LEAST_BEND:
            yield Candidate("moving_weight", name, name, None, f"q_{name}", (own,))
        for b in range(3, 6):
            if (own_part := own_moment(c, frame, b)) is not None:
                yield Candidate("moving_weight", name, name, COMPONENTS[b], f"q_{name}", (own_part,), {}, 0.5)
            if frame < c.machine.n:
                args = {"frame": frame, "component": b, "joint": frame}
                hangs = Column("frame", "hanging", args, frame, b)
                if HEAVIEST_CHAIN * float(np.std(hangs.value(c))) > LEAST_MOMENT:
                    after = c.machine.joint_names[frame]
                    yield Candidate("moving_weight", name, name, COMPONENTS[b], f"q_{after}", (hangs,), {}, 0.5)
