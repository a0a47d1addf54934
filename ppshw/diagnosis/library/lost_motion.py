"""What a joint loses when it turns back: backlash and friction."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.library.candidate import Candidate
from ppshw.diagnosis.library.sampled import (
    MOMENTS,
    called,
    came_from_both_sides,
    moments_between,
    moving_joints,
    nearest_component,
    own_component,
    presses,
    tilts,
)
from ppshw.recording import STANDSTILL
from ppshw.terms.shapes import Column, Context

Array = NDArray[np.float64]
# Parts of a joint's travel over which it takes up what it lost: friction winds up over a fiftieth of it or more (most
# authors' does), play between soft walls over less. But walls give way by some gaps: where a hundredth of the travel is
# more than SOFTEST times what a joint can have lost, that much winds up (a ninth author's friction of 0.6 to 5 %).
WINDS_UP = np.array([0.02, 0.04, 0.08, 0.15, 0.3])
SOFT_WALLS = np.array([0.002, 0.005, 0.01])
# Once it is known what a joint loses, walls give way by two to eight gaps (sealed cases), and what takes fifteen or a
# hundred times that is friction (a fourteenth author's 14585 and 14576), unless it is over in a five-hundredth of the
# travel: three of the twenty-second author's plays, whose walls give way by 28 to 37 gaps, were called friction.
SOFTEST, TYPICAL, BRIEFLY = 20.0, 1e-4, 0.3  # a repeatability where the file has none [m]; share of winding up so fast
SOFTEST_KNOWN = 12.0
WENT_PAST = (0.015, 0.04)  # parts of a joint's travel by which it may have gone past where it came to
SOME_CAME_BACK = 0.03  # of the visits
LOOSENS = 0.1  # share of a gap that is another one from some moment on
ROCKS = 0.02  # share of a form that goes sideways besides
# Bristles let go in a joint that rests, within a quarter of an hour or so (two other authors'): no play does.
LETS_GO, RESTS_H, AT_REST = np.array([0.02, 0.06, 0.2]), (0.1, 0.3, 1.0), 0.05


def backlash(c: Context, lost: Mapping[str, float]) -> Iterator[Candidate]:
    """lost: what joints lose, as far as it is known, along or about their own axes [m or rad]"""
    for k, name in moving_joints(c):
        if not came_from_both_sides(c, k):
            continue
        own = own_component(c, k)  # what pulls sideways alone, a cable, is no lost motion
        where = ("backlash", name, name, called(c, k + 1, own), f"approach_{name}")
        for width, column in _taken_up(c, k, SOFT_WALLS):
            if not winds_up(c, k, width, lost.get(name)):
                yield Candidate(*where, (column,), {"width": width}, 0.05)
        sign = Column("frame", "approach", {"joint": k}, k + 1, own)
        drag = Column("frame", "approach_q", {"joint": k}, k + 1, own)
        worn = Column("frame", "approach_q", {"joint": k, "power": 2}, k + 1, own)
        for columns, share in (((sign,), 1.0), ((sign, drag), 0.1), ((sign, drag, worn), 0.1)):
            yield Candidate(*where, columns, share=share)
        for taken, share in _by_its_load(c, k, sign):  # a gap that the load takes up
            yield Candidate(*where, (sign, taken), share=share)
        some = moments_between(c, MOMENTS)
        for moment in some:  # what comes loose (a gap four times as wide; another author's 65004)
            looser = replace(sign, args={**sign.args, "since": moment})
            yield Candidate(*where, (sign, looser), {"time_h": moment}, LOOSENS / len(some))
        for sideways in _across(c, k, sign):  # a carriage that rocks as it turns back
            yield Candidate(*where, (sign, sideways), share=ROCKS)


def friction(c: Context, lost: Mapping[str, float]) -> Iterator[Candidate]:
    for k, name in moving_joints(c):
        where = ("friction_hysteresis", name, name, called(c, k + 1, own_component(c, k)), f"move_{name}")
        # of a joint that comes from one side alone lost motion of any kind is friction
        parts = WINDS_UP if came_from_both_sides(c, k) else np.concatenate([SOFT_WALLS[-1:], WINDS_UP])
        if came_from_both_sides(c, k):
            for width, column in _taken_up(c, k, SOFT_WALLS):
                if winds_up(c, k, width, lost.get(name)):
                    yield Candidate(*where, (column,), {"width": width}, BRIEFLY)
                    for more, part in _by_its_load(c, k, column):
                        yield Candidate(*where, (column, more), {"width": width}, part * BRIEFLY)
        for width, column in _taken_up(c, k, parts):
            for lag, shape, share in _went_past(c, k, column):
                yield Candidate(*where, (lag,), {"width": width, **shape}, share)
                for more, part in _by_its_load(c, k, lag):
                    yield Candidate(*where, (lag, more), {"width": width, **shape}, part * share)
                for sideways in _across(c, k, lag) if not shape else ():  # as it winds up, it rocks
                    yield Candidate(*where, (lag, sideways), {"width": width}, ROCKS)
        for width, rest_h in itertools.product(map(float, float(np.ptp(c.recording.q[:, k])) * LETS_GO), RESTS_H):
            column = _along_it(c, k, "winding", way=width, rest_h=rest_h)
            yield Candidate(*where, (column,), {"width": width, "rest_h": rest_h}, AT_REST)


def _across(c: Context, k: int, lost: Column) -> list[Column]:
    """What a joint loses in every component but its own."""
    return [replace(lost, component=comp) for comp in range(6) if comp != nearest_component(c, k)]


def _by_its_load(c: Context, k: int, lost: Column) -> Iterator[tuple[Column, float]]:
    """What goes with the loads upon a joint of what it loses, and the share of such a form."""
    for by in presses(c, k):
        yield replace(lost, args={**lost.args, "pressed": by}), 0.05
    for by in tilts(c, k):
        yield replace(lost, args={**lost.args, "tilted": by}), 0.02


def winds_up(c: Context, k: int, way: float, known: float | None = None) -> bool:
    """Whether what a joint lost and takes up over such a way is friction that winds it up: longer than soft walls are
    for what it is known to lose, or for any play that the recording may show (three repeatabilities at the
    reflectors)."""
    travel = float(np.ptp(c.recording.q[:, k]))
    if known is not None:
        return way > max(SOFTEST_KNOWN * known, float(SOFT_WALLS[0]) * travel * (1 + 1e-9))
    moves = c.moved(k + 1, own_component(c, k)).reshape(len(c.hours), -1, 3)
    lever = float(np.sqrt((moves**2).sum(axis=2).mean()))
    lost = 2 * 3.0 * (c.machine.repeatability or TYPICAL) / max(lever, 1e-9)
    return way > float(np.clip(SOFTEST * lost, SOFT_WALLS[0] * travel, SOFT_WALLS[-1] * travel)) * (1 + 1e-9)


def _went_past(c: Context, k: int, lag: Column) -> Iterator[tuple[Column, dict[str, float], float]]:
    """A lag as it is where a joint went far past what it then came back to, and where it went a little past: visits to
    which it came from the other side than the way from the last one says ask for it."""
    yield lag, {}, 1.0
    q, side = c.recording.q[:, k], c.recording.approach[:, k]
    far = float(np.ptp(q))
    if np.mean(np.diff(q) * side[1:] < -STANDSTILL * far) >= SOME_CAME_BACK:
        for part in WENT_PAST:
            yield replace(lag, args={**lag.args, "past": part * far}), {"past": part * far}, 0.2


def _taken_up(c: Context, k: int, parts: Array) -> Iterator[tuple[float, Column]]:
    """What a joint lost when it turned back is taken up over a part of its travel, evenly or ever more slowly."""
    for width in map(float, float(np.ptp(c.recording.q[:, k])) * parts):
        for function, how in (("slipping", "width"), ("winding", "way")):
            yield width, _along_it(c, k, function, **{how: width})


def _along_it(c: Context, k: int, function: str, **args: float) -> Column:
    return Column("frame", function, {"joint": k, **args}, k + 1, own_component(c, k))
