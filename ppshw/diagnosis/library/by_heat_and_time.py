"""What goes with temperatures, or with time as what nobody measures does: thermal growth, drift."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from ppshw.diagnosis.library.candidate import Candidate
from ppshw.diagnosis.library.sampled import AIR, LAGS_H, moving_joints, nearest_component, temperature_places
from ppshw.terms import COMPONENTS
from ppshw.terms.shapes import Column, Context

# Half waves over the recording of a base that wanders, in any of three directions or in one; and of one that does so
# restlessly, in one (a random walk that keeps its pace for half an hour: by four it was a rail that jumps four times,
# 85 of log evidence and 82; 107 by six; 37076).
WANDERS, RESTLESS = (2, 3, 4), (6,)
# Time constants with which a base, or an instrument that was set up anew, goes back after it moved at once: rails were
# homed anew by 126, 50 and 32 of log evidence where any course of the base in time said 46 (another author's 65022).
GOES_BACK_H = (0.5, 1.5)


def thermal(c: Context) -> Iterator[Candidate]:
    places = temperature_places(c)
    for place in places:
        for tau in LAGS_H:
            args = {"place": place, "tau": tau}
            if AIR in places and place != AIR:  # all of the machine, by its own thermometer, or a scale by the air's
                every = Column("frames", "link_growth", {**args, "joint": -1})
                yield Candidate("thermal_growth", None, None, None, f"temp_{place}_C", (every,), {"lag_h": tau})
            for k, name in moving_joints(c):
                own = nearest_component(c, k)
                along = Column("frames", "link_growth", {**args, "joint": k})
                if np.any(along.value(c)):
                    yield Candidate("thermal_growth", name, name, None, f"temp_{place}_C", (along,), {"lag_h": tau})
                for comp in range(6):
                    flat = Column("frame", "temperature", args, k + 1, comp)
                    grows = Column("frame", "temperature_q", {**args, "joint": k}, k + 1, comp)
                    where = ("thermal_growth", name, name, COMPONENTS[comp], f"temp_{place}_C")
                    yield Candidate(*where, (flat,), {"lag_h": tau}, 0.5)
                    yield Candidate(*where, (flat, grows), {"lag_h": tau}, 1.0 if comp == own else 0.2)
                any_way = tuple(Column("frame", "temperature", args, k + 1, comp) for comp in range(6))
                # bends and shifts, as its own shape has it
                yield Candidate("thermal_growth", name, name, None, f"temp_{place}_C", any_way, {"lag_h": tau}, 0.2)
    for place, slow in itertools.product(places, LAGS_H[1:]):  # bends while its skin is warmer than its core
        for (k, name), comp in itertools.product(moving_joints(c), range(6)):
            uneven = Column("frame", "temperature", {"place": place, "tau": 0.0, "than": slow}, k + 1, comp)
            where = ("thermal_growth", name, name, COMPONENTS[comp], f"temp_{place}_C")
            yield Candidate(*where, (uneven,), {"core_lag_h": slow}, 0.2)
    for (place, other), tau in itertools.product(itertools.combinations(places, 2), LAGS_H):
        for (k, name), comp in itertools.product(moving_joints(c), range(6)):  # bends as one side gets warmer
            sides = tuple(
                Column("frame", "temperature", {"place": each, "tau": tau}, k + 1, comp) for each in (place, other)
            )
            where = ("thermal_growth", name, name, COMPONENTS[comp], f"temp_{place}_C")
            yield Candidate(*where, sides, {"lag_h": tau}, 0.2)


def drift(c: Context, moments: Sequence[float]) -> Iterator[Candidate]:
    forms: list[tuple[str, float]] = [("linear", 1.0)]
    forms += [("exponential", t) for t in (0.3, 0.7, 1.5, 3.0)] + [("log", t) for t in (0.1, 0.5)]
    base = c.machine.frame_names[0]
    for form, tau in forms:
        all6 = tuple(Column("frame", "clock", {"form": form, "tau": tau}, 0, comp) for comp in range(6))
        shape = {} if form == "linear" else {"tau_h": tau}
        yield Candidate("drift", None, base, None, "time", all6[:3], shape, 1.0)
        yield Candidate("drift", None, base, None, "time", all6, shape, 1.0)
        for comp in range(6):
            yield Candidate("drift", None, base, COMPONENTS[comp], "time", (all6[comp],), shape, 0.5)
    for moment in moments:
        for form in ("step", "ramp"):
            all6 = tuple(Column("frame", "clock", {"form": form, "tau": moment}, 0, comp) for comp in range(6))
            yield Candidate("drift", None, base, None, "time", all6[:3], {"time_h": moment}, 1 / len(moments))
            yield Candidate("drift", None, base, None, "time", all6, {"time_h": moment}, 1 / len(moments))
        for tau in GOES_BACK_H:
            all6 = tuple(Column("frame", "settling", {"visit_time": moment, "tau": tau}, 0, comp) for comp in range(6))
            for some in (all6[:3], all6):
                shape = {"time_h": moment, "tau_h": tau}
                yield Candidate("drift", None, base, None, "time", some, shape, 0.2 / len(moments))
        every: list[tuple[range, str | None, float]] = [(range(3), None, 0.3), (range(6), None, 0.3)]
        every += [(range(comp, comp + 1), COMPONENTS[comp], 0.1) for comp in range(6)]
        for comps, said, share in every:  # goes one way, then another
            turns = tuple(
                Column("frame", "clock", {"form": form, "tau": tau}, 0, comp)
                for form, tau in (("until", moment), ("ramp", moment)) for comp in comps
            )  # fmt: skip
            yield Candidate("drift", None, base, said, "time", turns, {"time_h": moment}, share / len(moments))
    for order in (*WANDERS, *RESTLESS):
        waves = [
            tuple(Column("frame", "clock", {"form": "cosine", "tau": j}, 0, comp) for j in range(1, order + 1))
            for comp in range(6)
        ]
        share = 0.3 if order in WANDERS else 0.15
        for comp in range(6):
            yield Candidate("drift", None, base, COMPONENTS[comp], "time", waves[comp], {}, share)
        if order in WANDERS:
            yield Candidate("drift", None, base, None, "time", waves[0] + waves[1] + waves[2], {}, 0.5)
        every_way = tuple(column for mine in waves for column in mine)  # it turns, too, and not by the course of warmth
        yield Candidate("drift", None, base, None, "time", every_way, {}, share)
