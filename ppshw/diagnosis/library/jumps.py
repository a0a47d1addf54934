"""What jumps at a moment, once or several times: the zero of a joint, a reflector."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ppshw.diagnosis.library.candidate import Candidate
from ppshw.diagnosis.library.sampled import MOMENTS, called, moments_between, moving_joints, own_component
from ppshw.terms.shapes import Column, Context

ORDINALS = ("", "second_", "third_", "fourth_")
KNOCKS = 150  # moments between visits at which reflectors may be moved
ALL = "all reflectors"  # as one body
SLIDES_H = (0.3, 1.0)  # time constants with which a reflector slides away from some moment on


@dataclass(frozen=True)
class Jumps:
    """A joint's zero or a reflector jumps at these moments [h]: by any amounts, or there and back (`hops`)."""

    of: str
    moments: tuple[float, ...]
    hops: bool = False


def zero_shift(c: Context, jumps: Sequence[Jumps]) -> Iterator[Candidate]:
    for k, name in moving_joints(c):
        own = own_component(c, k)
        where = ("zero_shift", name, name, called(c, k + 1, own), "time")
        every, some = visits_between(c), moments_between(c, MOMENTS)
        for moment in every:
            yield Candidate(*where, (shift_of_zero(c, k, moment),), {"time_h": moment}, 1.0 / len(every))
        for first, second in itertools.combinations(some, 2):
            pairs = len(some) * (len(some) - 1) / 2
            both = shift_of_zero(c, k, first), shift_of_zero(c, k, second)
            yield Candidate(*where, both, _moments(first, second), 0.2 / pairs)
        for many in (many for many in jumps if many.of == name):
            shape = _moments(many.moments[0]) if many.hops else _moments(*many.moments)
            shape |= {"hops": float(len(many.moments))} if many.hops else {}
            yield Candidate(*where, shifts_of_zero(c, k, many), shape, one_of_so_many(c, many))
        for moment in some:
            for tau in (0.5, 1.5):
                back = Column("frame", "settling", {"visit_time": moment, "tau": tau}, k + 1, own)
                yield Candidate(*where, (shift_of_zero(c, k, moment), back), {"time_h": moment}, 0.1 / len(some))

    if len(moving := list(moving_joints(c))) > 1:  # whatever lost its zeros was homed anew
        for moment in (every := visits_between(c)):
            homed = tuple(shift_of_zero(c, k, moment) for k, _ in moving)
            yield Candidate("zero_shift", None, None, None, "time", homed, {"time_h": moment}, 1.0 / len(every))


def moved_reflector(c: Context, moments: Sequence[float], knocks: Sequence[Jumps]) -> Iterator[Candidate]:
    # there from the start (where it stands alone nobody can say so); knocked at a moment; or sliding from then on
    courses = [(-1.0, 0.0, 1.0)] if c.points.shape[1] > 1 else []
    some = sorted({*moments, *some_between(c)})
    courses += [(t, 0.0, 1.0 / len(some)) for t in some]
    courses += [(t, slow, 0.5 / len(SLIDES_H) / len(moments)) for t in moments for slow in SLIDES_H]
    for t, name in enumerate(c.recording.target_names):
        for moment, slow, share in courses:
            columns = shift_of_reflector(t, moment, **({"slow": slow} if slow else {}))
            shape = {"time_h": moment} if moment >= 0 else {}
            shape |= {"tau_h": slow} if slow else {}
            yield Candidate("target_moved", None, None, None, name, columns, shape, share)
        for many in (many for many in knocks if many.of == name):
            columns = tuple(column for moment in many.moments for column in shift_of_reflector(t, moment))
            share = 0.2 / math.comb(len(some_between(c)), len(many.moments))
            yield Candidate("target_moved", None, None, None, name, columns, _moments(*many.moments), share)
    for moment in some if c.points.shape[1] > 1 else []:
        knocked = knocked_carrier(moment)
        yield Candidate("target_moved", None, None, None, ALL, knocked, {"time_h": moment}, 1.0 / len(some))


def shift_of_zero(c: Context, k: int, moment: float) -> Column:
    """What a jump of a joint's zero at a moment [h] does from then on."""
    return Column("frame", "step", {"visit_time": moment}, k + 1, own_component(c, k))


def shifts_of_zero(c: Context, k: int, jumps: Jumps) -> tuple[Column, ...]:
    """What several jumps of a joint's zero do."""
    if jumps.hops:
        return (Column("frame", "hopping", {"times": jumps.moments}, k + 1, own_component(c, k)),)
    return tuple(shift_of_zero(c, k, moment) for moment in jumps.moments)


def one_of_so_many(c: Context, jumps: Jumps) -> float:
    """The share of several jumps, beside one of one jump: they were chosen from all that there may be."""
    return 0.1 / math.comb(len(visits_between(c)), len(jumps.moments))


def shift_of_reflector(target: int, moment: float, **more: float) -> tuple[Column, ...]:
    """A reflector elsewhere from a moment on [h], along each axis of the end effector; always where it is negative."""
    args = {"target": target, "since": moment, **more}
    return tuple(Column("points", "target_shift", {**args, "axis": a}) for a in range(3))


def knocked_carrier(moment: float) -> tuple[Column, ...]:
    """What carries all reflectors elsewhere from a moment on [h], shifted along and turned about each axis of the end
    effector."""
    ways = itertools.product((False, True), range(3))
    return tuple(Column("points", "carrier_shift", {"axis": a, "turn": turn, "since": moment}) for turn, a in ways)


def visits_between(c: Context) -> list[float]:
    """Moments between visits at which a zero may have jumped [h]."""
    return moments_between(c, 450)


def some_between(c: Context) -> list[float]:
    """Moments between visits at which reflectors may have been moved [h]."""
    return moments_between(c, KNOCKS)


def _moments(*moments: float) -> dict[str, float]:
    return {f"{word}time_h": moment for word, moment in zip(ORDINALS, moments, strict=False)}
