"""What the instruments read wrong: the tracker's scale, the force sensor."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ppshw.diagnosis.library.candidate import Candidate
from ppshw.diagnosis.library.sampled import (
    AIR,
    LAGS_H,
    MOMENTS,
    moments_between,
    nobody_knows,
    temperature_places,
    that_act,
)
from ppshw.diagnosis.library.weighing import reads_other, surely_misread
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.terms.shapes import Column, Context

# Share of a scale that goes with what the machine's own parts measure, where the air has a thermometer: beams go
# through the air.
OF_THE_MACHINE = 0.05
# Noise of the sensor, too, makes a model expect what is not: by 1 to 11 µm, in recordings of three authors.
LEAST_MISREAD = 5e-6  # m, rms at the reflectors
MOST_TARES = 24  # changes of the load after each of which a force sensor may have another zero


def about_another_place(function: str, args: Mapping[str, object]) -> tuple[Column, ...]:
    """What distances that are wrong by a factor do besides, where the instrument stands elsewhere than it is said to:
    everything shifts with the same."""
    return tuple(Column("frame", function, dict(args), 0, comp) for comp in range(3))


def tracker_scale(c: Context) -> Iterator[Candidate]:
    constant = Column("points", "scale", {})
    yield Candidate("tracker_scale", None, None, None, "distance", (constant,))
    places = temperature_places(c)
    for place in places:
        likely = OF_THE_MACHINE if AIR in places and place != AIR else 1.0
        grows = Column("points", "scale", {"place": place})
        yield Candidate("tracker_scale", None, None, None, f"temp_{place}_C", (grows,), share=0.5 * likely)
        yield Candidate("tracker_scale", None, None, None, f"temp_{place}_C", (constant, grows), share=0.5 * likely)
        shifts = about_another_place("temperature", {"place": place, "tau": 0.0})
        yield Candidate(
            "tracker_scale", None, None, None, f"temp_{place}_C", (grows, *shifts), share=0.3 * likely, led=True
        )
        for tau in LAGS_H[1:-1]:  # the air in the beam follows the thermometer's
            late, lag = Column("points", "scale", {"place": place, "tau": tau}), {"lag_h": tau}
            yield Candidate("tracker_scale", None, None, None, f"temp_{place}_C", (late,), lag, share=0.05 * likely)
            late_shifts = (late, *about_another_place("temperature", {"place": place, "tau": tau}))
            yield Candidate(
                "tracker_scale", None, None, None, f"temp_{place}_C", late_shifts, lag, share=0.03 * likely, led=True
            )
    moments = moments_between(c, MOMENTS)
    for moment in moments:  # a distance meter or its weather station was set anew
        anew, when = Column("points", "scale", {"since": moment}), {"time_h": moment}
        yield Candidate("tracker_scale", None, None, None, "time", (anew,), when, share=0.3 / len(moments))
        shifts = about_another_place("step", {"visit_time": moment})
        yield Candidate(
            "tracker_scale", None, None, None, "time", (anew, *shifts), when, share=0.3 / len(moments), led=True
        )
    for name in nobody_knows(c):  # the air's pressure or humidity, if it is that
        grows = Column("points", "scale", {"name": name})
        shifts = about_another_place("covariate", {"name": name})
        for columns in ((grows,), (constant, grows), (grows, *shifts)):
            yield Candidate("tracker_scale", None, None, None, name, columns, share=0.1, led=len(columns) > 2)


def force_sensor(c: Context) -> Iterator[Candidate]:
    if not c.recording.has_wrench:
        return
    matrix = {
        (to, source): Column("frames", "sensor_error", {"component": to, "source": source})
        for to, source in itertools.product(range(6), repeat=2)
    }
    for comp in range(6):
        where = ("wrench_error", None, None, None, WRENCH_COMPONENTS[comp])
        yield Candidate(*where, (Column("frames", "sensor_error", {"component": comp}),))
        drifting = Column("frames", "sensor_error", {"component": comp, "time": "linear"})
        yield Candidate(*where, (drifting,))
        waves = tuple(
            Column("frames", "sensor_error", {"component": comp, "time": "cosine", "tau": j}) for j in range(1, 5)
        )
        yield Candidate("wrench_error", None, None, None, "time", waves, share=0.5)
        for bent in ("odd", "even", "sided"):
            curve = Column("frames", "sensor_error", {"component": comp, "source": comp, "bent": bent})
            yield Candidate(*where, (curve,), share=0.5)
        yield Candidate(*where, (matrix[comp, comp], curve), share=0.3)  # another gain for pull than for push
        for source in range(6):
            yield Candidate(*where, (matrix[comp, source],), share=1.0 if comp == source else 0.2)
    if (beside := weighed(c)) is not None:  # whatever it is that no rigid payload weighs
        yield Candidate("wrench_error", None, None, None, "load", (beside,), share=3.0, way=1)
    gain = Column("frames", "sensor_error", {"component": -1})
    yield Candidate("wrench_error", None, None, None, "load", (gain,), share=3.0)
    for only in ("forces", "moments"):  # in other units, for one
        of_some = Column("frames", "sensor_error", {"component": -1, "only": only})
        yield Candidate("wrench_error", None, None, None, "load", (of_some,))
    turns = [Column("frames", "sensor_error", {"component": -1, "turned": axis}) for axis in range(3)]
    for turn in turns:
        farther = Column("frames", "sensor_error", {**turn.args, "times": 2})
        yield Candidate("wrench_error", None, None, None, "load", (turn, farther))
    yield Candidate("wrench_error", None, None, None, "load", tuple(turns))
    elsewhere = tuple(Column("frames", "sensor_error", {"component": -1, "about": axis}) for axis in range(3))
    if alive := that_act(c, elsewhere):  # its moments are not about the origin that its file says
        yield Candidate("wrench_error", None, None, None, "load", alive)
    ageing = Column("frames", "sensor_error", {"component": -1, "time": "linear"})
    yield Candidate("wrench_error", None, None, None, "time", (ageing,), share=0.5)
    # a calibration matrix of its own: of every channel's gain, or of all that it has
    for some in ([matrix[k, k] for k in range(6)], [*matrix.values()]):
        if alive := that_act(c, some):
            yield Candidate("wrench_error", None, None, None, "load", alive)
    constant = tuple(Column("frames", "sensor_error", {"component": comp}) for comp in range(6))
    walking = tuple(
        Column("frames", "sensor_error", {"component": comp, "time": "cosine", "tau": j})
        for comp, j in itertools.product(range(6), range(1, 7))
    )
    for covariate, zeros in (("load", constant), ("time", walking)):  # of all channels at once
        if alive := that_act(c, zeros):
            yield Candidate("wrench_error", None, None, None, covariate, alive, share=0.5)
    for source in range(3):
        leak = tuple(matrix[m, source] for m in (3, 4, 5))
        yield Candidate("wrench_error", None, None, None, WRENCH_COMPONENTS[source], leak)
    for place in temperature_places(c):
        for tau in LAGS_H:
            every = tuple(
                Column("frames", "sensor_error", {"component": comp, "place": place, "tau": tau}) for comp in range(6)
            )
            where = ("wrench_error", None, None, None, f"temp_{place}_C")
            yield Candidate(*where, every, {"lag_h": tau}, 0.5)
            by_heat = Column("frames", "sensor_error", {"component": -1, "place": place, "tau": tau})
            yield Candidate(*where, (by_heat,), {"lag_h": tau}, 0.5)
            for comp in range(6):
                own = Column("frames", "sensor_error", {"component": comp, "source": comp, "place": place, "tau": tau})
                yield Candidate(*where, (own,), {"lag_h": tau}, 0.1)
            for column in every:
                yield Candidate(*where, (column,), {"lag_h": tau}, 0.15)


def sensor_errors(c: Context) -> Iterator[Candidate]:
    """Every form of them that few moments ask for."""
    yield from force_sensor(c)
    yield from force_sensor_jumps(c, moments_between(c, MOMENTS))


def weighed(c: Context) -> Column | None:
    """What the sensor read beside the rigid payloads; None where that is noise, or moves hardly anything and may be
    something else than the sensor's error."""
    column = Column("frames", "weighed", {})
    moved = column.evaluate(c)
    misread = float(np.sqrt((moved**2).mean() * 3)) > LEAST_MISREAD
    return column if reads_other(c) and (misread or surely_misread(c)) else None


def force_sensor_jumps(c: Context, moments: Sequence[float]) -> Iterator[Candidate]:
    """A channel's zero is another from some moment on."""
    if not c.recording.has_wrench:
        return
    for comp, moment in itertools.product(range(6), moments):
        jump = Column("frames", "sensor_error", {"component": comp, "time": "step", "tau": moment})
        where = ("wrench_error", None, None, None, WRENCH_COMPONENTS[comp])
        yield Candidate(*where, (jump,), {"time_h": moment}, 1.0 / len(moments))
    load = c.recording.load
    changes = [float(c.hours[k]) for k in range(1, len(load)) if load[k] != load[k - 1]]
    if not 2 <= len(changes) <= MOST_TARES:
        return
    tared = [
        (
            Column("frames", "sensor_error", {"component": comp}),
            *(Column("frames", "sensor_error", {"component": comp, "time": "step", "tau": t}) for t in changes),
        )
        for comp in range(6)
    ]  # tared before it began and whenever the load was changed, and each time not quite
    for comp, columns in enumerate(tared):
        yield Candidate("wrench_error", None, None, None, WRENCH_COMPONENTS[comp], columns, {}, 0.5)
    if alive := that_act(c, tuple(itertools.chain.from_iterable(tared))):
        yield Candidate("wrench_error", None, None, None, "since_load_change", alive, {}, 0.5)
