"""What reflectors, what carries them, the instrument and the air between may do."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from ppshw.diagnosis.library.by_instrument import about_another_place
from ppshw.diagnosis.library.candidate import Candidate
from ppshw.diagnosis.library.sampled import LAGS_H, moving_joints, nobody_knows, read_channels, temperature_places
from ppshw.diagnosis.nameless.rival import KNOTS, late_columns, rival
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.terms.shapes import Column, Context
from ppshw.terms.shapes.reflectors import gravity_in_tip
from ppshw.terms.shapes.sight import rays_to

AROUND = ((1, 2), (1, 6), (7, 13), (13, 25), (25, 49))  # waves to a turn of the instrument's circles
FEWEST_WAVES, MOST_WAVES = 4, 300  # half waves over all distances from the instrument
# Standard deviation of where an axis points, of one: a reflector whose mount is always upright is elsewhere for good.
TURNED_OVER = 0.1


def at_the_reflectors(c: Context) -> Iterator[Candidate]:
    """A single reflector wanders, or goes by any function of a column that nobody knows; its mount gives way as it is
    turned over, or it reads otherwise as it is turned to an instrument that stands nobody knows where; what carries
    them all swells or bends with a column, a load, a position; distances are off the more aslant the beam falls in,
    directions by waves over the instrument's own angles; the space around it is stretched, for good or with a
    temperature."""
    if c.points.shape[1] > 1:
        for t, name in enumerate(c.recording.target_names):
            moves = tuple(
                Column("points", "target_shift", {"target": t, "axis": a, "order": j})
                for j, a in itertools.product(range(5), range(3))
            )
            yield Candidate("nameless", None, None, None, name, moves)
        targets, axes = range(c.points.shape[1]), range(3)
        changes = [*nobody_knows(c), *(f"temp_{place}_C" for place in temperature_places(c)), *late_columns(c)]
        ways: list[tuple[str, dict[str, object]]] = [
            (name, {"name": name}) for name in (*changes, *(f"q_{joint}" for _, joint in moving_joints(c)))
        ]
        ways += [(WRENCH_COMPONENTS[k], {"load": k}) for k in read_channels(c)]
        ways += [("load", {"name": "load"})] if read_channels(c) else []  # in whichever attitude it hangs there
        for name, by in ways:
            swells = [
                Column("points", "target_shift", {"target": t, "axis": a, **by})
                for t, a in itertools.product(targets, axes)
            ]
            yield rival(c, None, None, (name,), swells)
        for t, name in itertools.product(targets, nobody_knows(c)):
            yield rival(c, None, None, (name,), [
                Column("points", "target_shift", {"target": t, "axis": a, "name": name, "knot": j, "count": KNOTS})
                for j, a in itertools.product(range(KNOTS), axes)
            ])  # fmt: skip
        turns = np.flatnonzero(gravity_in_tip(c).std(axis=0) > TURNED_OVER)
        for t, name in enumerate(c.recording.target_names) if len(turns) else ():
            sags = tuple(
                Column("points", "target_shift", {"target": t, "axis": a, "plumb": int(b)})
                for a, b in itertools.product(range(3), turns)
            )
            yield Candidate("nameless", None, None, None, name, sags)
        turned = np.argwhere(c.tips[:, :3, :3].std(axis=0) > TURNED_OVER).tolist()
        for t, name in enumerate(c.recording.target_names) if turned else ():
            from_afar = [Column("points", "turned_shift", {"target": t, "along": a}) for a in axes]
            from_afar += [
                Column("points", "turned_shift", {"target": t, "along": a, "points": i, "axis": j})
                for a, (i, j) in itertools.product(axes, turned)
            ]
            yield Candidate("nameless", None, None, None, name, tuple(from_afar))
    products = [(a, -1) for a in range(3)] + list(itertools.combinations_with_replacement(range(3), 2))
    for target in range(-1, c.points.shape[1] if c.points.shape[1] > 1 else 0):
        aslant = tuple(
            Column("points", "range_error", {"first": a, "second": b, "target": target}) for a, b in products
        )
        yield Candidate("nameless", None, None, None, "incidence", aslant)
    for angle in ("azimuth", "elevation"):
        for least, most in AROUND:
            off = tuple(
                Column("points", "angle_error", {"angle": angle, "order": order, "phase": phase})
                for order in range(least, most + 1) for phase in ("sin", "cos")
            )  # fmt: skip
            yield Candidate("nameless", None, None, None, angle, off)
    span = float(np.ptp(np.linalg.norm(rays_to(c), axis=2)))
    for halves in range(FEWEST_WAVES, MOST_WAVES + 1) if span > 0.0 else ():  # of a meter that compares phases
        period = 2.0 * span / halves
        wave = tuple(Column("points", "range_wave", {"period": period, "phase": phase}) for phase in ("sin", "cos"))
        yield Candidate("nameless", None, None, None, "distance", wave, share=1.0 / MOST_WAVES)
    warm = temperature_places(c)
    for places in (*zip(warm, strict=True), *itertools.combinations(warm, 2)):
        names = tuple(f"temp_{place}_C" for place in places)
        bends = [
            Column("points", "refraction", {"place": place, "part": part}) for place in places for part in range(5)
        ]
        yield replace(rival(c, None, None, names, bends), covariate=f"distance × {' × '.join(names)}")
    yield Candidate("nameless", None, None, None, "distance", tuple(_stretched({})))
    ways_to_shift: list[tuple[str, Mapping[str, str], str, Mapping[str, object]]] = [
        *(
            (f"late_{tau:g}_temp_{place}_C" if tau else f"temp_{place}_C", {"place": place}, "temperature",
             {"place": place, "tau": tau})
            for place in warm for tau in LAGS_H[:-1]
        ),
        *((name, {"name": name}, "covariate", {"name": name}) for name in nobody_knows(c)),
    ]  # fmt: skip
    for name, how, function, args in ways_to_shift:
        # what lags is the air in the beam, and lengths alone: space that is sheared late would be any far shift
        late = bool(args.get("tau"))
        stretched = [Column("points", "scale", dict(args))] if late else _stretched(how)
        for columns in (stretched, [*stretched, *about_another_place(function, args)]):
            yield replace(rival(c, None, None, (name,), columns), covariate=f"distance × {name}")


def _stretched(by: Mapping[str, str]) -> list[Column]:
    """Every way in which the space around the instrument may be stretched or sheared."""
    pairs = itertools.combinations_with_replacement(range(3), 2)
    return [Column("points", "strain", {"first": a, "second": b, **by}) for a, b in pairs]
