"""What goes on in time by no law: it changes once, or in any rhythm."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from ppshw.diagnosis.library.candidate import Candidate
from ppshw.diagnosis.library.jumps import Jumps, one_of_so_many, shift_of_zero, shifts_of_zero, visits_between
from ppshw.diagnosis.library.sampled import MOMENTS, moments_between, moving_joints, own_component
from ppshw.diagnosis.nameless.rival import ends, rival
from ppshw.terms.shapes import Column, Context

# Half waves in time that nobody names: down to half an hour in a campaign of ten, and to a third of one.
RHYTHMS, QUICKER = 36, 64
# Half waves over the recording of a beat of one period that moves the base (a compressor, an air conditioning): from so
# few to one in every so many visits, and to so many where a recording is long.
SLOWEST_BEAT, VISITS_A_HALF, MOST_BEATS = 20, 2, 240


def _over_time(c: Context) -> list[tuple[int, int, tuple[str, ...]]]:
    """Where what nobody names may go on in time: every joint in its own direction, base and tip; over which columns."""
    own = [(k + 1, own_component(c, k), (f"q_{joint}", "time")) for k, joint in moving_joints(c)]
    return [*own, *((frame, comp, ("time",)) for frame, comp in ends(c))]


def at_a_moment(c: Context, jumps: Sequence[Jumps] = ()) -> Iterator[Candidate]:
    """Something changes at a moment and stays: once, a joint in its own direction between any two visits and base and
    tip at one of some moments; or several times, at moments that the recording speaks for."""
    every, some = visits_between(c), moments_between(c, MOMENTS)
    for k, joint in moving_joints(c):
        place = k + 1, own_component(c, k), (f"q_{joint}", "time")
        for moment in every:
            yield replace(rival(c, *place, [shift_of_zero(c, k, moment)]), share=1.0 / len(every))
        for many in (many for many in jumps if many.of == joint):
            yield replace(rival(c, *place, shifts_of_zero(c, k, many)), share=one_of_so_many(c, many))
    for frame, comp in ends(c):
        for moment in some:
            once = rival(c, frame, comp, ("time",), [Column("frame", "step", {"visit_time": moment}, frame, comp)])
            yield replace(once, share=1.0 / len(some))


def rhythms(c: Context) -> Iterator[Candidate]:
    for frame, comp, names in _over_time(c):
        for most in (RHYTHMS, QUICKER):
            waves = [Column("frame", "clock", {"form": "cosine", "tau": j}, frame, comp) for j in range(1, most + 1)]
            yield rival(c, frame, comp, names, waves)
    quickest = min(len(c.hours) // VISITS_A_HALF, MOST_BEATS)
    for order in range(SLOWEST_BEAT, quickest + 1):
        beat = [
            Column("frame", "clock", {"form": form, "tau": order}, 0, comp)
            for comp in range(6) for form in ("beat_cos", "beat_sin")
        ]  # fmt: skip
        yield rival(c, 0, None, ("time",), beat)
        yield from (rival(c, 0, comp, ("time",), beat[2 * comp : 2 * comp + 2]) for comp in range(6))
    for k, name in moving_joints(c):
        places = [(frame, comp, RHYTHMS) for frame, comp in ends(c)]
        places += [(k + 1, comp, QUICKER) for comp in range(6) if k + 1 < c.machine.n]
        for frame, comp, most in places:
            waves = [Column("frame", "clock_q", {"order": j, "joint": k}, frame, comp) for j in range(1, most + 1)]
            yield rival(c, frame, comp, (f"q_{name}", "time"), waves)
