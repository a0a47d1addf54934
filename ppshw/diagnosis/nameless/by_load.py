"""What a frame does under its load, by any function of it; what hangs there is other than the sensor said."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.library.by_instrument import MOST_TARES, weighed
from ppshw.diagnosis.library.by_load import MOST_POSTS, between_posts, changes_side
from ppshw.diagnosis.library.candidate import Candidate
from ppshw.diagnosis.library.sampled import (
    elastic_frames,
    loads_on,
    moving_joints,
    read_channels,
    temperature_places,
)
from ppshw.diagnosis.library.weight import own_moment
from ppshw.diagnosis.nameless.rival import ABOUT_ZERO, LATE_H, bumps, most_alike, rival, smooth_pair
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.terms.shapes import Column, Context, named_column
from ppshw.terms.shapes.loads import load_of
from ppshw.terms.shapes.wrenches import beside_the_payload

Array = NDArray[np.float64]
LOAD_LATE_H = (0.1, 0.4, 1.5)  # lags of loads
SLIPS = (0.1, 0.3, 1.0)  # widths of slipping springs that a load drives, relative to its spread
LEAST_MOUNTED = 3  # loads one after the other, of which each may seat otherwise
SUDDENLY_AT, SUDDEN = np.linspace(0.1, 0.9, 9), 0.05  # shares of the visits below a load; over how much of its spread
SIDES = (0.1, 0.25, 0.5)  # widths that a load must go beyond to push something over


def under_load(c: Context) -> Iterator[Candidate]:
    """What a frame does under its load: by any function of it, late, with what it was before, with a temperature;
    and all its loads alike with a temperature."""
    for frame in range(1, c.machine.n + 1):
        for b in loads_on(c, frame):
            load = f"on_{c.machine.frame_names[frame]}_{WRENCH_COMPONENTS[b]}"
            late = [f"late_{tau:g}_{load}" for tau in LOAD_LATE_H]
            where = {"frame": frame, "component": b}
            powers = [Column("frame", "load_legendre", {**where, "order": k}, frame, b) for k in range(2, 6)]
            about_zero = [
                Column("frame", "load_bump", {**where, "knot": k, "count": ABOUT_ZERO}, frame, b)
                for k in range(ABOUT_ZERO)
            ]
            slips = [Column("frame", "load_slip", {**where, "width": w}, frame, b) for w in SLIPS]
            sides = [Column("frame", "load_side_held", {**where, "width": w}, frame, b) for w in SIDES]
            lagging = [Column("frame", "covariate", {"name": name}, frame, b) for name in late]
            # what hung there before the recording is not known
            first = [Column("frame", "settling", {"visit_time": 0.0, "tau": t}, frame, b) for t in LOAD_LATE_H]
            found = [
                rival(c, frame, b, (load,), bumps(load, frame, b)),
                rival(c, frame, b, (load,), powers),
                rival(c, frame, b, (load, late[1]), lagging),
                rival(c, frame, b, (load, late[1]), [*lagging, *first]),
                smooth_pair(c, frame, b, load, f"previous_{load}"),
                rival(c, frame, b, (load,), about_zero),
                rival(c, frame, b, (load, f"previous_{load}"), slips),
                rival(c, frame, b, (load, f"previous_{load}"), sides),
            ]
            for place in temperature_places(c):
                for tau in (0.0, 1.0):
                    args = {**where, "place": place, "tau": tau}
                    warm = [Column("frame", "load_warm", {**args, "width": w}, frame, b) for w in (0.0, 0.3)]
                    found.append(rival(c, frame, b, (load, f"temp_{place}_C"), warm))
            found += [rival(c, frame, comp, (load,), _across(frame, b, comp)) for comp in range(6) if comp != b]
            found += _between_posts(c, frame, b, load)
            found += _suddenly(c, frame, b, load)
            yield from found if c.recording.has_wrench else _by_positions(c, found, c.wrenches[:, frame, b])
        if (most := _bends_most(c, frame)) is None:
            continue
        for place, tau in itertools.product(temperature_places(c), (0.0, 1.0)):
            softer = [Column("frames", "softened", {"frame": frame, "place": place, "tau": tau})]
            load = f"on_{c.machine.frame_names[frame]}_{WRENCH_COMPONENTS[most]}"
            found = [rival(c, frame, None, (load, f"temp_{place}_C"), softer)]
            yield from found if c.recording.has_wrench else _by_positions(c, found, c.wrenches[:, frame, most])


def in_proportion(c: Context) -> Iterator[Candidate]:
    """A link that the machine file has rigid gives way in proportion to its load, in the load's own direction or
    across. With the name of missing compliance taken out it was a stiffness out of proportion, whose form there has
    such a part (a sixty-second author's 019), and a clearance across (a sixty-third's 016)."""
    bent = {frame: set(acting) for frame, _, acting in elastic_frames(c)}
    for frame in range(1, c.machine.n + 1):
        for b in set(loads_on(c, frame)) - bent.get(frame, set()):
            load = f"on_{c.machine.frame_names[frame]}_{WRENCH_COMPONENTS[b]}"
            columns = [Column("frame", "load", {"frame": frame, "component": b}, frame, comp) for comp in range(6)]
            found = [rival(c, frame, column.component, (load,), (column,)) for column in columns]
            yield from found if c.recording.has_wrench else _by_positions(c, found, c.wrenches[:, frame, b])


def _across(frame: int, component: int, comp: int) -> list[Column]:
    """How a frame gives way across its load: names do too, and stiffness stood for a compliance that has none (another
    author's 37014)."""
    where = {"frame": frame, "component": component}
    return [Column("frame", "load_legendre", {**where, "order": k}, frame, comp) for k in (1, 2, 3)]


def _between_posts(c: Context, frame: int, component: int, load: str) -> Iterator[Candidate]:
    """A frame gives way under its load by where its joint stands: a rail on posts, balls of a bearing."""
    joint = frame - 1
    if np.ptp(c.recording.q[:, joint]) == 0.0:
        return
    names, every = (load, f"q_{c.machine.joint_names[joint]}"), between_posts(c, frame, component)
    for waves in (every[: MOST_POSTS // 2], every[MOST_POSTS // 2 :]):
        yield rival(c, frame, component, names, [*itertools.chain(*waves)])
    for wave in every:
        yield replace(rival(c, frame, component, names, wave), share=1 / MOST_POSTS)


def _suddenly(c: Context, frame: int, component: int, load: str) -> Iterator[Candidate]:
    """A frame gives way at once where its load passes some value, or changes sign, all of it or the payload's part,
    which smooth functions only follow by and by."""
    w, where = c.wrenches[:, frame, component], {"frame": frame, "component": component, "width": SUDDEN}
    ways: list[dict[str, object]] = [{"offset": float(at)} for at in np.quantile(w, SUDDENLY_AT) / w.std()]
    ways += [{"of": of} for of in ("", "payload") if changes_side(load_of(c, frame, component, of))]
    for way in ways:
        column = Column("frame", "load_side", {**where, **way}, frame, component)
        yield replace(rival(c, frame, component, (load,), [column]), share=1 / len(ways))


def _bends_most(c: Context, frame: int) -> int | None:
    """The component of a frame's load by which its compliance moves the reflectors most; None where it has none."""
    moves = np.einsum("nia,nab->nib", c.jacobian[:, :, frame], c.compliance[:, frame])
    size = (moves * c.wrenches[:, None, frame]).std(axis=0).sum(axis=0)
    return int(np.argmax(size)) if size.max() > 0 else None


def _by_positions(c: Context, found: list[Candidate], load: Array) -> Iterator[Candidate]:
    """Where a frame bears the machine's own weight alone (N,), as where no sensor says what hangs there: what depends
    on it is said to depend on the positions it changes with most."""
    positions = most_alike(c, load)
    for candidate in found:
        beside = [name for name in candidate.covariates if name.startswith("temp_")]
        names = (*positions[: 1 if beside else 2], *beside)
        yield replace(candidate, covariate=" × ".join(names), covariates=names)


def by_own_weight(c: Context) -> Iterator[Candidate]:
    """A frame gives way to the weight of the machine's own bodies other than to what the end effector bears."""
    for frame in range(1, c.machine.n + 1):
        for b in range(3, 6):
            if (column := own_moment(c, frame, b)) is not None:
                yield from _by_positions(c, [rival(c, frame, b, (), [column])], column.value(c))


def mounted(c: Context) -> Iterator[Candidate]:
    """A frame comes to rest a little otherwise with every load that is put on, in one direction or in all: whatever
    seats anew, or falls to another side, until the load is changed."""
    stays = np.unique(named_column(c, "mounting")).astype(int).tolist()
    if not LEAST_MOUNTED <= len(stays) <= MOST_TARES + 1:
        return
    for frame in range(1, c.machine.n + 1):
        seats = [
            [Column("frame", "seated", {"name": "mounting", "stay": s}, frame, comp) for s in stays]
            for comp in range(6)
        ]  # fmt: skip
        for comp, columns in enumerate(seats):
            yield rival(c, frame, comp, ("mounting",), columns)
        yield rival(c, frame, None, ("mounting",), [column for columns in seats for column in columns])


def of_what_was_read(c: Context) -> Iterator[Candidate]:
    """What hangs there is other than the sensor said, by something that goes with a temperature, up to two hours late,
    or by a smooth function of a position or of what the sensor read besides. Nothing of the kind where nothing hung."""
    if not (read := read_channels(c)):
        return
    if (beside := weighed(c)) is not None:
        most = int(np.argmax(beside_the_payload(c).std(axis=0) / c.recording.wrench.std(axis=0).clip(min=1e-9)))
        yield rival(c, None, None, (WRENCH_COMPONENTS[most],), (beside,))
    for place, component in itertools.product(temperature_places(c), range(6)):
        args = {"component": component, "place": place}
        off = [Column("frames", "sensor_error", {**args, "tau": tau}) for tau in (0.0, *LATE_H)]
        yield rival(c, None, None, (WRENCH_COMPONENTS[component], f"temp_{place}_C"), off)
    others = [f"q_{joint}" for _, joint in moving_joints(c)] + [WRENCH_COMPONENTS[k] for k in read]
    for component, name in itertools.product(range(6), others):
        if name != WRENCH_COMPONENTS[component]:
            args = {"component": component, "name": name, "count": 3}
            yield rival(c, None, None, (WRENCH_COMPONENTS[component], name), [
                Column("frames", "sensor_off", {**args, "knot": k}) for k in range(3)
            ])  # fmt: skip
    whole = [(name, "sensor_off", {"name": name, "knot": 0, "count": 1}) for name in others]
    whole += [(f"temp_{place}_C", "sensor_error", {"place": place, "tau": 0.0}) for place in temperature_places(c)]
    for (name, function, args), components in itertools.product(whole, (range(3), range(3, 6))):
        leaks = [Column("frames", function, {**args, "component": k}) for k in components]
        yield rival(c, None, None, (name,), leaks)


def pulls(c: Context) -> Iterator[Candidate]:
    """Something pulls at the end effector, the more the farther it reaches: hoses, cables."""
    reach = named_column(c, "reach")
    nearest = most_alike(c, reach)[:2]
    for axis in range(4):
        pull = [Column("frames", "pulled", {"axis": axis, "knot": k, "count": 3}) for k in range(3)]
        yield replace(rival(c, None, None, ("reach",), pull), covariate=" × ".join(nearest), covariates=nearest)
