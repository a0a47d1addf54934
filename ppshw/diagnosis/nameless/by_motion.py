"""What depends on how a joint came to where it is: seats, the side that it came from, its own work."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ppshw.diagnosis.library.candidate import Candidate
from ppshw.diagnosis.library.sampled import (
    came_from_both_sides,
    loads_on,
    moving_joints,
    nearest_component,
    own_component,
    temperature_places,
)
from ppshw.diagnosis.nameless.rival import ABOUT_ZERO, KNOTS, LATE_H, ends, rival
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.terms.shapes import Column, Context, named_column

LEAST_SEATS, MOST_SEATS = 8, 80  # stays of several visits
FLOATS_H = 0.04  # in which a carriage that floated up sinks again: some minutes
LEAST_REST = 2e-6  # m, rms of a coordinate: what encoders differ less from setpoints by moves no reflector that shows
# Parts of a joint's travel over which any hysteresis winds up: seven of 22 frictions of nine authors, their name taken
# out, were play, as a function of the way since a joint turned back says no more than play does where most moves are
# short; this said 5 to 40 of log evidence more, by which three of five looked at again are not. It says less than play
# does of their 21 plays, and at most 1.8 % more than friction does of these.
WINDS = (0.005, 0.02, 0.06, 0.2)
SELDOM = 0.1  # share of what two joints' sides do together, by which of them there are many


def random_seats(c: Context) -> Iterator[Candidate]:
    """A joint comes to rest a little otherwise whenever it moves, and stays so while only others move: a brake or a
    clamp that seats at random."""
    for k, name in moving_joints(c):
        stays, visits = np.unique(named_column(c, f"stay_{name}"), return_counts=True)
        seats = stays[visits > 1]
        if not LEAST_SEATS <= len(seats) <= MOST_SEATS:
            continue
        for comp in range(6):
            yield rival(c, k + 1, comp, (f"stay_{name}",), [
                Column("frame", "seated", {"name": f"stay_{name}", "stay": int(s)}, k + 1, comp) for s in seats
            ])  # fmt: skip


def reversals(c: Context) -> Iterator[Candidate]:
    """What remembers from which side a joint came: the side alone, with any function of the way since, and with the
    position; and what winds up, over whichever ways."""
    for k, name in moving_joints(c):
        if not came_from_both_sides(c, k):
            continue
        came, way = f"approach_{name}", f"way_{name}"
        for frame, comp in [(k + 1, own_component(c, k)), *ends(c)[6:]]:
            side = Column("frame", "approach", {"joint": k}, frame, comp)
            args = {"joint": k, "count": KNOTS}
            since = [Column("frame", "reversal", {**args, "knot": j}, frame, comp) for j in range(KNOTS)]
            where = [Column("frame", "approach_q", {"joint": k, "power": p}, frame, comp) for p in (1, 2)]
            yield rival(c, frame, comp, (came,), (side,))
            yield rival(c, frame, comp, (came, way), since)
            yield rival(c, frame, comp, (came, way), (*since, *where))
            args = {"joint": k, "count": ABOUT_ZERO}
            yield rival(c, frame, comp, (came, way), [
                Column("frame", "turning", {**args, "knot": j}, frame, comp) for j in range(ABOUT_ZERO)
            ])  # fmt: skip
        own, travel = own_component(c, k), float(np.ptp(c.recording.q[:, k]))
        winds = [Column("frame", "winding", {"joint": k, "way": part * travel}, k + 1, own) for part in WINDS]
        yield rival(c, k + 1, own, (came, way), winds)
        side = Column("frame", "approach", {"joint": k}, k + 1, own)
        across = set(range(6)) - {nearest_component(c, k)}
        for comp in across:  # and rocks as it does
            yield rival(c, k + 1, own, (came, way), [*winds, replace(winds[1], component=comp)])
            yield rival(c, k + 1, own, (came,), (side, replace(side, component=comp)))
        for other in _goes_along(c, k + 1):  # what it loses goes with something else as well
            both = {"first": came, "second": other, "a": 0, "b": 0, "count": 1}
            yield rival(c, k + 1, own, (came, other), (side, Column("frame", "covariate_pair", both, k + 1, own)))
        for comp in across if k + 1 < c.machine.n else ():  # what drags sideways
            drags = replace(side, component=comp)
            where = [Column("frame", "approach_q", {"joint": k, "power": p}, k + 1, comp) for p in (1, 2)]
            yield rival(c, k + 1, comp, (came,), (drags,))
            yield rival(c, k + 1, comp, (came, f"q_{name}"), (drags, *where))
    sides = [f"approach_{name}" for k, name in moving_joints(c) if came_from_both_sides(c, k)]
    for one, other in itertools.combinations(sides, 2):  # both together say how something seats
        product = {"first": one, "second": other, "a": 0, "b": 0, "count": 1}
        for frame, comp in itertools.product(range(1, c.machine.n + 1), range(6)):
            seats = rival(c, frame, comp, (one, other), (Column("frame", "covariate_pair", product, frame, comp),))
            yield replace(seats, share=SELDOM)


def where_it_rests(c: Context) -> Iterator[Candidate]:
    """A joint is not where its encoder says, by a share of how far that is from its setpoint: read before it came to
    rest, or on the motor's side of what winds up."""
    for k, name in moving_joints(c):
        own = own_component(c, k)
        off = named_column(c, f"rest_{name}")
        if float(np.sqrt(np.mean((c.moved(k + 1, own) * (off - off.mean())[:, None]) ** 2))) > LEAST_REST:
            yield rival(c, k + 1, own, (f"rest_{name}",), (
                Column("frame", "covariate", {"name": f"rest_{name}"}, k + 1, own),
            ))  # fmt: skip


def _goes_along(c: Context, frame: int) -> list[str]:
    """With what a joint's lost motion may change: temperatures, time, how long it settled, what hangs on its frame."""
    out = [*(f"temp_{place}_C" for place in temperature_places(c)), "time"]
    out += ["settle_s"] if np.isfinite(c.recording.settle_s).all() and np.ptp(c.recording.settle_s) > 0 else []
    if c.recording.has_wrench:
        out += [f"on_{c.machine.frame_names[frame]}_{WRENCH_COMPONENTS[b]}" for b in loads_on(c, frame)]
    return out


def own_heat(c: Context) -> Iterator[Candidate]:
    """A drive warms by its own work where no thermometer is; a carriage floats on the oil that it drags along."""
    for (k, name), tau in itertools.product(moving_joints(c), (FLOATS_H, *LATE_H)):
        pace = f"late_{tau:g}_pace_{name}"
        for comp in range(6):
            args = {"first": pace, "second": f"q_{name}", "a": 0, "b": 0, "count": 1}
            yield rival(c, k + 1, comp, (pace, f"q_{name}"), [
                Column("frame", "covariate", {"name": pace}, k + 1, comp),
                Column("frame", "covariate_pair", args, k + 1, comp),
            ])  # fmt: skip
