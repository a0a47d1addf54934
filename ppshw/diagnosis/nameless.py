"""Rivals without a name: what any smooth function of the columns and their history would explain.

Any smooth function of columns, of their history, of loads and of time, at the frames that may move by it; what the
force sensor, the reflectors and the instrument may do. A test that does not know the catalogue: what it finds is
located by its columns. docs/diagnosis.md §1, step 3.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from ppshw.diagnosis.library.by_position import FINELY_TWO
from ppshw.diagnosis.library.candidate import Candidate, all_kept
from ppshw.diagnosis.library.sampled import (
    MOMENTS,
    loads_on,
    moments_between,
    moving_joints,
    own_component,
    temperature_places,
    within,
)
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.terms import COMPONENTS
from ppshw.terms.shapes import Column, Context, named_column

Array = NDArray[np.float64]
LATE_H = (0.5, 1.0, 2.0)  # lags of columns that nothing is known about
LOAD_LATE_H = (0.1, 0.4, 1.5)  # of loads
# Half waves in time that nobody names: down to half an hour in a campaign of ten, and to a third of one.
RHYTHMS, QUICKER = 36, 64
SLIPS = (0.1, 0.3, 1.0)  # widths of slipping springs that a load drives, relative to its spread
SIDES = (0.1, 0.25, 0.5)  # widths that a load must go beyond to push something over
ABOUT_ZERO = 9  # bumps over what is finest about zero
OCTAVES = (3, 6, 12)  # waves over a joint's travel, from these to twice as many, that nobody names
IN_ITS_DIRECTION = (24, 48)  # and in the joint's own direction
AROUND = ((1, 2), (1, 6), (7, 13), (13, 25), (25, 49))  # waves to a turn of the instrument's circles
FROM_WITHIN = 0.05  # share of a temperature of an inner joint by which the base is said to move
LEAST_SEATS, MOST_SEATS = 8, 80  # stays of several visits
KNOTS = 5  # bumps over the ranks of a column


@all_kept()
def nameless(c: Context) -> list[Candidate]:
    """All rivals without a name for a recording: kinds share alike, and candidates in a kind as they say; shares add up
    to one."""
    makers = (
        _of_one_column, _along_a_joint, _base_in_all_directions, _at_a_moment, _rhythms, _seats, _reversals,
        _under_load, _of_what_was_read, _pulls, _own_heat, _with_another_position, _of_two_columns, _finely,
        _of_two_positions, _of_three_positions, _at_the_reflectors,
    )  # fmt: skip
    kinds = [kind for kind in (list(make(c)) for make in makers) if kind]
    for kind in kinds:
        whole = sum(k.share for k in kind)
        for k in kind:
            k.share /= len(kinds) * whole
    return [k for kind in kinds for k in kind]


def _nameless(
    c: Context, frame: int | None, comp: int | None, names: tuple[str, ...], columns: Sequence[Column]
) -> Candidate:  # fmt: skip
    where = None if frame is None else c.machine.frame_names[frame]
    return Candidate(
        "nameless", None, where, None if comp is None else COMPONENTS[comp], " × ".join(names), tuple(columns),
        covariates=names,
    )  # fmt: skip


def _ends(c: Context) -> list[tuple[int, int]]:
    """Every component of the base, then of the tip."""
    return [(frame, comp) for frame in (0, c.machine.n) for comp in range(6)]


def _nobody_knows(c: Context) -> list[str]:
    """Covariates that no name is about."""
    r = c.recording
    return [f"cov_{k}" for k, v in r.covariates.items() if np.isfinite(v).all() and np.ptp(v) > 0]


def _late(c: Context) -> list[str]:
    warm = [f"temp_{place}_C" for place in temperature_places(c)]
    return [f"late_{tau:g}_{k}" for k in (*_nobody_knows(c), *warm) for tau in LATE_H]


def _columns(c: Context) -> list[str]:
    r = c.recording
    joints = [f"q_{name}" for _, name in moving_joints(c)]
    out = [*joints, "time", "since_load_change"]
    out += [f"temp_{p}_C" for p in r.temperatures if np.isfinite(r.temperatures[p]).all()]
    out += _came_from(c) + _nobody_knows(c)
    out += ["pause"] if np.ptp(named_column(c, "pause")) > 0 else []
    if np.isfinite(r.settle_s).all():
        out.append("settle_s")
    if r.has_wrench:
        out += [w for k, w in enumerate(WRENCH_COMPONENTS) if np.ptp(r.wrench[:, k]) > 0]
        out += ["former_load"] if len(set(r.load)) > 2 else []
    return out


def _came_from(c: Context) -> list[str]:
    joints = [f"q_{name}" for _, name in moving_joints(c)]
    return [f"previous_{j}" for j in joints] + [f"move_{j[2:]}" for j in joints]


def _anywhere(c: Context) -> set[str]:
    """Of what no name knows no place is likelier than another."""
    late = (name for name in _late(c) if "_temp_" not in name)
    return {*_nobody_knows(c), *late, *_came_from(c), "pause", "former_load"}


def _bumps(name: str, frame: int, comp: int) -> list[Column]:
    return [Column("frame", "covariate", {"name": name, "knot": j, "count": KNOTS}, frame, comp) for j in range(KNOTS)]


def _of_one_column(c: Context) -> Iterator[Candidate]:
    anywhere = _anywhere(c)
    for name in [*_columns(c), *_late(c)]:
        frames = range(c.machine.n + 1) if name in anywhere else (0, c.machine.n)
        for frame, comp in itertools.product(frames, range(6)):
            yield _nameless(c, frame, comp, (name,), _bumps(name, frame, comp))
            if name in anywhere:  # where five bumps are many, in proportion
                yield _nameless(c, frame, comp, (name,), (Column("frame", "covariate", {"name": name}, frame, comp),))


def _along_a_joint(c: Context) -> Iterator[Candidate]:
    anywhere, before = _anywhere(c), _came_from(c)
    columns = [name for name in (*_columns(c), *_late(c)) if name not in anywhere or name in before]
    for k, joint in moving_joints(c):
        frame, comp = k + 1, own_component(c, k)
        for name in columns:
            if name not in (f"q_{joint}", "time"):  # the base model's own, and the waves below
                if name not in before:
                    yield _nameless(c, frame, comp, (f"q_{joint}", name), _bumps(name, frame, comp))
                args = {"first": name, "second": f"q_{joint}", "a": 0, "b": 0, "count": 1}
                yield _nameless(c, frame, comp, (f"q_{joint}", name), [
                    Column("frame", "covariate", {"name": name}, frame, comp),
                    Column("frame", "covariate_pair", args, frame, comp),
                ])  # fmt: skip


def _base_in_all_directions(c: Context) -> Iterator[Candidate]:
    """The base shifts with one column, each direction by a function of its own: nobody knows its axes. What warms
    within the machine is unlikely to move what it stands on."""
    slow = ("time", *_nobody_knows(c), *(s for s in [*_columns(c), *_late(c)] if "temp_" in s))
    for name in slow:
        args = {"name": name, "count": 3}
        shifts = [Column("frame", "covariate", {**args, "knot": j}, 0, comp) for j in range(3) for comp in range(3)]
        share = FROM_WITHIN if name.endswith(within(c.machine)) else 1.0
        yield replace(_nameless(c, 0, None, (name,), shifts), share=share)


def _over_time(c: Context) -> list[tuple[int, int, tuple[str, ...]]]:
    """Where what nobody names may go on in time: every joint in its own direction, base and tip; over which columns."""
    own = [(k + 1, own_component(c, k), (f"q_{joint}", "time")) for k, joint in moving_joints(c)]
    return [*own, *((frame, comp, ("time",)) for frame, comp in _ends(c))]


def _at_a_moment(c: Context) -> Iterator[Candidate]:
    """Something changes once, at one of some moments, and stays."""
    for frame, comp, names in _over_time(c):
        for moment in moments_between(c, MOMENTS):
            yield _nameless(c, frame, comp, names, [Column("frame", "step", {"visit_time": moment}, frame, comp)])


def _rhythms(c: Context) -> Iterator[Candidate]:
    for frame, comp, names in _over_time(c):
        for most in (RHYTHMS, QUICKER):
            waves = [Column("frame", "clock", {"form": "cosine", "tau": j}, frame, comp) for j in range(1, most + 1)]
            yield _nameless(c, frame, comp, names, waves)
    for k, name in moving_joints(c):
        places = [(frame, comp, RHYTHMS) for frame, comp in _ends(c)]
        places += [(k + 1, comp, QUICKER) for comp in range(6) if k + 1 < c.machine.n]
        for frame, comp, most in places:
            waves = [Column("frame", "clock_q", {"order": j, "joint": k}, frame, comp) for j in range(1, most + 1)]
            yield _nameless(c, frame, comp, (f"q_{name}", "time"), waves)


def _seats(c: Context) -> Iterator[Candidate]:
    """A joint comes to rest a little otherwise whenever it moves, and stays so while only others move: a brake or a
    clamp that seats at random."""
    for k, name in moving_joints(c):
        stays, visits = np.unique(named_column(c, f"stay_{name}"), return_counts=True)
        seats = stays[visits > 1]
        if not LEAST_SEATS <= len(seats) <= MOST_SEATS:
            continue
        for comp in range(6):
            at_random = [Column("frame", "seated", {"joint": k, "stay": int(s)}, k + 1, comp) for s in seats]
            yield _nameless(c, k + 1, comp, (f"stay_{name}",), at_random)


def _reversals(c: Context) -> Iterator[Candidate]:
    """What remembers from which side a joint came: the side alone, with any function of the way since, and with the
    position."""
    for k, name in moving_joints(c):
        if len(np.unique(c.recording.approach[:, k])) < 2:
            continue
        came, way = f"approach_{name}", f"way_{name}"
        for frame, comp in [(k + 1, own_component(c, k)), *_ends(c)[6:]]:
            side = Column("frame", "approach", {"joint": k}, frame, comp)
            args = {"joint": k, "count": KNOTS}
            since = [Column("frame", "reversal", {**args, "knot": j}, frame, comp) for j in range(KNOTS)]
            where = [Column("frame", "approach_q", {"joint": k, "power": p}, frame, comp) for p in (1, 2)]
            yield _nameless(c, frame, comp, (came,), (side,))
            yield _nameless(c, frame, comp, (came, way), since)
            yield _nameless(c, frame, comp, (came, way), (*since, *where))
            args = {"joint": k, "count": ABOUT_ZERO}
            yield _nameless(c, frame, comp, (came, way), [
                Column("frame", "turning", {**args, "knot": j}, frame, comp) for j in range(ABOUT_ZERO)
            ])  # fmt: skip
        own = own_component(c, k)
        for other in _goes_along(c, k + 1):  # what it loses goes with something else as well
            both = {"first": came, "second": other, "a": 0, "b": 0, "count": 1}
            yield _nameless(c, k + 1, own, (came, other), [
                Column("frame", "approach", {"joint": k}, k + 1, own),
                Column("frame", "covariate_pair", both, k + 1, own),
            ])  # fmt: skip
        for comp in set(range(6)) - {own_component(c, k)} if k + 1 < c.machine.n else ():  # what drags sideways
            side = Column("frame", "approach", {"joint": k}, k + 1, comp)
            where = [Column("frame", "approach_q", {"joint": k, "power": p}, k + 1, comp) for p in (1, 2)]
            yield _nameless(c, k + 1, comp, (came,), (side,))
            yield _nameless(c, k + 1, comp, (came, f"q_{name}"), (side, *where))


def _goes_along(c: Context, frame: int) -> list[str]:
    """With what a joint's lost motion may change: temperatures, time, how long it settled, what hangs on its frame."""
    out = [*(f"temp_{place}_C" for place in temperature_places(c)), "time"]
    out += ["settle_s"] if np.isfinite(c.recording.settle_s).all() and np.ptp(c.recording.settle_s) > 0 else []
    if c.recording.has_wrench:
        out += [f"on_{c.machine.frame_names[frame]}_{WRENCH_COMPONENTS[b]}" for b in loads_on(c, frame)]
    return out


def _under_load(c: Context) -> Iterator[Candidate]:
    """What a frame does under its load: by any function of it, late, with what it was before, with a temperature."""
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
                _nameless(c, frame, b, (load,), _bumps(load, frame, b)),
                _nameless(c, frame, b, (load,), powers),
                _nameless(c, frame, b, (load, late[1]), lagging),
                _nameless(c, frame, b, (load, late[1]), [*lagging, *first]),
                _smooth_pair(c, frame, b, load, f"previous_{load}"),
                _nameless(c, frame, b, (load,), about_zero),
                _nameless(c, frame, b, (load, f"previous_{load}"), slips),
                _nameless(c, frame, b, (load, f"previous_{load}"), sides),
            ]
            for place in temperature_places(c):
                for tau in (0.0, 1.0):
                    args = {**where, "place": place, "tau": tau}
                    warm = [Column("frame", "load_warm", {**args, "width": w}, frame, b) for w in (0.0, 0.3)]
                    found.append(_nameless(c, frame, b, (load, f"temp_{place}_C"), warm))
            yield from found if c.recording.has_wrench else _by_positions(c, found, c.wrenches[:, frame, b])


def _by_positions(c: Context, found: list[Candidate], load: Array) -> Iterator[Candidate]:
    """Where no sensor says what hangs there, a frame bears the machine's own weight (N,): what depends on it is said to
    depend on the positions it changes with most."""
    positions = most_alike(c, load)
    for candidate in found:
        beside = [name for name in candidate.covariates if name.startswith("temp_")]
        names = (*positions[: 1 if beside else 2], *beside)
        yield replace(candidate, covariate=" × ".join(names), covariates=names)


def most_alike(c: Context, values: Array) -> tuple[str, ...]:
    """Positions, the one first that says most of what values (N,) are."""
    left = {}
    for k, name in moving_joints(c):
        q = c.recording.q[:, k]
        left[f"q_{name}"] = float(np.var(values - Polynomial.fit(q, values, 3)(q)))
    return tuple(sorted(left, key=lambda name: left[name]))


def _of_what_was_read(c: Context) -> Iterator[Candidate]:
    """What hangs there is other than the sensor said, by something that goes with a temperature, up to two hours late,
    or by a smooth function of a position or of what the sensor read besides."""
    if not c.recording.has_wrench:
        return
    for place, component in itertools.product(temperature_places(c), range(6)):
        args = {"component": component, "place": place}
        off = [Column("frames", "sensor_error", {**args, "tau": tau}) for tau in (0.0, *LATE_H)]
        yield _nameless(c, None, None, (WRENCH_COMPONENTS[component], f"temp_{place}_C"), off)
    read = [k for k in range(6) if np.ptp(c.recording.wrench[:, k]) > 0]
    others = [f"q_{joint}" for _, joint in moving_joints(c)] + [WRENCH_COMPONENTS[k] for k in read]
    for component, name in itertools.product(range(6), others):
        if name != WRENCH_COMPONENTS[component]:
            args = {"component": component, "name": name, "count": 3}
            yield _nameless(c, None, None, (WRENCH_COMPONENTS[component], name), [
                Column("frames", "sensor_off", {**args, "knot": k}) for k in range(3)
            ])  # fmt: skip
    whole = [(name, "sensor_off", {"name": name, "knot": 0, "count": 1}) for name in others]
    whole += [(f"temp_{place}_C", "sensor_error", {"place": place, "tau": 0.0}) for place in temperature_places(c)]
    for (name, function, args), components in itertools.product(whole, (range(3), range(3, 6))):
        leaks = [Column("frames", function, {**args, "component": k}) for k in components]
        yield _nameless(c, None, None, (name,), leaks)


def _pulls(c: Context) -> Iterator[Candidate]:
    """Something pulls at the end effector, the more the farther it reaches: hoses, cables."""
    reach = named_column(c, "reach")
    nearest = most_alike(c, reach)[:2]
    for axis in range(4):
        pull = [Column("frames", "pulled", {"axis": axis, "knot": k, "count": 3}) for k in range(3)]
        yield replace(_nameless(c, None, None, ("reach",), pull), covariate=" × ".join(nearest), covariates=nearest)


def _own_heat(c: Context) -> Iterator[Candidate]:
    """A drive warms by its own work where no thermometer is."""
    for (k, name), tau in itertools.product(moving_joints(c), LATE_H):
        pace = f"late_{tau:g}_pace_{name}"
        for comp in range(6):
            args = {"first": pace, "second": f"q_{name}", "a": 0, "b": 0, "count": 1}
            yield _nameless(c, k + 1, comp, (pace, f"q_{name}"), [
                Column("frame", "covariate", {"name": pace}, k + 1, comp),
                Column("frame", "covariate_pair", args, k + 1, comp),
            ])  # fmt: skip


def _with_another_position(c: Context) -> Iterator[Candidate]:
    """What a link does with a temperature, as it is or an hour late, with time, from the side that its joint came from,
    or under its load, goes in proportion to another joint's position; what it does with something that no name is
    about, in proportion to any joint's, its own among them."""
    warm = [f"temp_{place}_C" for place in temperature_places(c)]
    anywhere = [*warm, *(f"late_1_{name}" for name in warm), "time"]
    for (k, name), (_, other) in itertools.permutations(moving_joints(c), 2):
        frame, directions = k + 1, range(6)
        if frame == c.machine.n:  # the tip's are below
            continue
        ways = [(what, comp) for what in anywhere for comp in directions]
        if c.recording.has_wrench:
            ways += [(f"on_{name}_{WRENCH_COMPONENTS[b]}", b) for b in loads_on(c, frame)]
        if len(np.unique(c.recording.approach[:, k])) > 1:
            ways += [(f"approach_{name}", comp) for comp in directions]
        for what, comp in ways:
            args = {"first": what, "second": f"q_{other}", "a": 0, "b": 0, "count": 1}
            product = Column("frame", "covariate_pair", args, frame, comp)
            yield _nameless(c, frame, comp, (what, f"q_{other}"), (product,))
    strange = [*_nobody_knows(c), *(f"late_1_{name}" for name in _nobody_knows(c))]
    inner = [k + 1 for k, _ in moving_joints(c) if k + 1 < c.machine.n]
    for frame, what, (_, joint), comp in itertools.product(inner, strange, moving_joints(c), range(6)):
        args = {"first": what, "second": f"q_{joint}", "a": 0, "b": 0, "count": 1}
        product = Column("frame", "covariate_pair", args, frame, comp)
        yield _nameless(c, frame, comp, (what, f"q_{joint}"), (product,))


def _smooth_pairs(c: Context) -> list[tuple[str, str]]:
    joints = [f"q_{name}" for _, name in moving_joints(c)]
    others = ["time", *(s for s in _columns(c) if s.startswith(("temp_", "F", "M")))]
    loads = [s for s in others if s in WRENCH_COMPONENTS]
    return [
        *itertools.combinations(joints, 2), *itertools.product(joints, others),
        *((a, b) for a in loads for b in others if b not in WRENCH_COMPONENTS),
    ]  # fmt: skip


def _smooth_pair(c: Context, frame: int, comp: int, first: str, second: str) -> Candidate:
    pair = {"first": first, "second": second, "count": 3}
    return _nameless(c, frame, comp, (first, second), [
        Column("frame", "covariate_pair", {**pair, "a": a, "b": b}, frame, comp)
        for a, b in itertools.product(range(3), repeat=2)
    ])  # fmt: skip


def _of_two_columns(c: Context) -> Iterator[Candidate]:
    smooth = _smooth_pairs(c)
    for first, second in smooth:
        for frame, comp in _ends(c)[6:]:
            yield _smooth_pair(c, frame, comp, first, second)
    known = {*smooth, *((b, a) for a, b in smooth)}
    for first, second in itertools.combinations(_columns(c), 2):
        for frame, comp in _ends(c)[:6] if (first, second) in known else _ends(c):
            args = {"first": first, "second": second, "a": 0, "b": 0, "count": 1}
            product = Column("frame", "covariate_pair", args, frame, comp)
            yield _nameless(c, frame, comp, (first, second), (product,))


def _finely(c: Context) -> Iterator[Candidate]:
    """A function of one position finer than the base model's, octave by octave."""
    for k, name in moving_joints(c):
        span = float(np.ptp(c.recording.q[:, k]))
        finer = [(own_component(c, k), least) for least in IN_ITS_DIRECTION]
        for comp, least in [*itertools.product(range(6), OCTAVES), *finer]:
            waves = [
                Column("frame", "wave", {"joint": k, "period": 2 * span / j, "phase": phase}, k + 1, comp)
                for j in range(2 * least, 4 * least, 2) for phase in ("sin", "cos")
            ]  # fmt: skip
            yield _nameless(c, k + 1, comp, (f"q_{name}",), waves)


def _of_two_positions(c: Context) -> Iterator[Candidate]:
    """Where one of the two joints stands, by any smooth function of both; by a finer one of its own that goes in
    proportion to the other."""
    for (k, one), (m, other) in itertools.combinations(moving_joints(c), 2):
        for frame, comp in itertools.product((k + 1, m + 1), range(6)):
            if frame != c.machine.n:  # the tip has been above
                yield _smooth_pair(c, frame, comp, f"q_{one}", f"q_{other}")
    for (k, one), (m, other) in itertools.permutations(moving_joints(c), 2):
        for comp in range(6):
            names = (f"q_{one}", f"q_{other}")
            yield _nameless(c, k + 1, comp, names, [
                Column("frame", "pair", {"a": k, "power_a": i, "b": m, "power_b": 1}, k + 1, comp) for i in range(7)
            ])  # fmt: skip
            yield _nameless(c, k + 1, comp, names, [
                Column("frame", "pair", {"a": k, "power_a": i, "b": m, "power_b": j}, k + 1, comp)
                for i, j in FINELY_TWO
            ])  # fmt: skip
            period = 2 * float(np.ptp(c.recording.q[:, k]))
            for least in OCTAVES[:2]:
                yield _nameless(c, k + 1, comp, names, [
                    Column("frame", "wave_q", {"joint": k, "period": period / j, "phase": phase, "by": m}, k + 1, comp)
                    for j in range(2 * least, 4 * least, 2) for phase in ("sin", "cos")
                ])  # fmt: skip


def _of_three_positions(c: Context) -> Iterator[Candidate]:
    for three in itertools.combinations([k for k, _ in moving_joints(c)], 3):
        names = tuple(f"q_{c.machine.joint_names[k]}" for k in three)
        for frame, comp in itertools.product((k + 1 for k in three), range(6)):
            product = Column("frame", "product", {"joints": three}, frame, comp)
            yield _nameless(c, frame, comp, names, (product,))


def _at_the_reflectors(c: Context) -> Iterator[Candidate]:
    """A single reflector wanders; what carries them all swells or bends with a column, a load, a position; distances
    are off the more aslant the beam falls in, directions by waves over the instrument's own angles; the space around it
    is stretched, for good or with a temperature."""
    if c.points.shape[1] > 1:
        for t, name in enumerate(c.recording.target_names):
            moves = tuple(
                Column("points", "target_shift", {"target": t, "axis": a, "order": j})
                for j, a in itertools.product(range(5), range(3))
            )
            yield Candidate("nameless", None, None, None, name, moves)
        targets, axes = range(c.points.shape[1]), range(3)
        changes = [*_nobody_knows(c), *(f"temp_{place}_C" for place in temperature_places(c)), *_late(c)]
        ways: list[tuple[str, dict[str, object]]] = [
            (name, {"name": name}) for name in (*changes, *(f"q_{joint}" for _, joint in moving_joints(c)))
        ]
        if c.recording.has_wrench:
            read = [k for k in range(6) if np.ptp(c.recording.wrench[:, k]) > 0]
            ways += [(WRENCH_COMPONENTS[k], {"load": k}) for k in read]
        for name, by in ways:
            swells = [
                Column("points", "target_shift", {"target": t, "axis": a, **by})
                for t, a in itertools.product(targets, axes)
            ]
            yield _nameless(c, None, None, (name,), swells)
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
    warm = temperature_places(c)
    for places in (*zip(warm, strict=True), *itertools.combinations(warm, 2)):
        names = tuple(f"temp_{place}_C" for place in places)
        bends = [
            Column("points", "refraction", {"place": place, "part": part}) for place in places for part in range(5)
        ]
        yield replace(_nameless(c, None, None, names, bends), covariate=f"distance × {' × '.join(names)}")
    for place in ("", *warm):
        stretched = [
            Column("points", "strain", {"first": a, "second": b, "place": place})
            for a, b in itertools.combinations_with_replacement(range(3), 2)
        ]
        if not place:
            yield Candidate("nameless", None, None, None, "distance", tuple(stretched))
            continue
        # about another point than where the instrument is said to stand: everything shifts as well
        shifts = [Column("frame", "temperature", {"place": place, "tau": 0.0}, 0, comp) for comp in range(3)]
        for columns in (stretched, [*stretched, *shifts]):
            yield replace(
                _nameless(c, None, None, (f"temp_{place}_C",), columns), covariate=f"distance × temp_{place}_C"
            )
