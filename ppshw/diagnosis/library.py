"""Every effect that is tried, as candidates: per effect of the contract's table the joints, components and shapes.

Shares are prior weights among the candidates of one effect; what sits in a drive has the joint's
own direction alone. Grids of nonlinear parameters are part of the candidates: the evidence averages over them.
"""

from __future__ import annotations

import gc
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.machine import WRENCH_COMPONENTS, Machine
from ppshw.terms import COMPONENTS
from ppshw.terms.elastic import skew
from ppshw.terms.history import STANDSTILL
from ppshw.terms.shapes import Column, Context
from ppshw.terms.shapes.loads import load_of

Array = NDArray[np.float64]
ORDINALS = ("", "second_", "third_", "fourth_")
LAGS_H = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)
CREEP_H = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
SLOWER = 3  # steps of that grid from a fast creep to the slow one beside it: eight times
KNOCKS = 150  # moments between which a reflector may be moved more than once
MOST_TARES = 24  # changes of the load after each of which a force sensor may have another zero
MOMENTS = 40  # at which something may have happened, where trying every moment would take too long
# What may be left out of a diagnosis: every effect of the contract's table but outliers, which are no bias.
NAMES = (
    "backlash", "friction_hysteresis", "thermal_growth", "drift", "tracker_scale", "periodic_transmission",
    "nonlinear_stiffness", "clearance", "cross_coupling", "moving_weight", "wrench_error", "creep", "zero_shift",
    "missing_compliance", "target_moved", "unsettled",
)  # fmt: skip
# Shortest periods: a screw of 5 mm a turn; a strain wave gear of 160:1, which errs twice a turn of its generator.
SCREW, GEAR, MOST_PERIODS = 0.005, np.pi / 160, 900
# Parts of a joint's travel over which it takes up what it lost: friction winds up over a fiftieth of it or more (most
# authors' does), play between soft walls over less. But walls give way by some gaps: where a hundredth of the travel is
# more than SOFTEST times what a joint can have lost, that much winds up (a ninth author's friction of 0.6 to 5 %).
WINDS_UP = np.array([0.02, 0.04, 0.08, 0.15, 0.3])
LOADS = frozenset({  # effects that loads make
    "nonlinear_stiffness", "clearance", "creep", "missing_compliance", "wrench_error", "moving_weight",
})  # fmt: skip
WENT_PAST = (0.015, 0.04)  # parts of a joint's travel by which it may have gone past where it came to
SOME_CAME_BACK = 0.03  # of the visits
SOFT_WALLS = np.array([0.002, 0.005, 0.01])
SOFTEST, TYPICAL, BRIEFLY = 20.0, 1e-4, 0.3  # a repeatability where the file has none [m]; share of winding up so fast
FINER = (-0.8, -0.6, -0.4, -0.2, 0.2, 0.4, 0.6, 0.8)  # half waves more over the travel, about a wave that was found
LEAST_PERIODS = 160  # half waves over the travel that are tried of every joint
SLIDES_H = (0.3, 1.0)  # time constants with which a reflector slides away from some moment on
TAKEN_UP = (0.6, 0.85, 1.2)  # widths, relative to the load's spread, over which slack is taken up by a load
# Shares of the visits whose load is below that at which stiffness changes.
KNEES_AT = (1 / 6, 1 / 3, 1 / 2, 2 / 3, 5 / 6)
OPENS_AT = (0.3, 0.5, 0.7, 1.0, 1.4)  # relative to a load's spread: beyond it, either way, a link is softer
USED_UP = (0.1, 0.3)  # relative to a load's spread: widths of clearances, too
ROUNDED = np.array([0.2, 0.8])  # over how much of the load's spread it does
ANY_WAY = ("exponential", "log", "total")  # ways to creep in all directions under one component of the load
# Loads at which a joint falls to its other side, relative to the spread; the share of those that are far from zero.
FALLS_AT, PRELOADED = (0.0, -0.3, 0.3, -0.7, 0.7, -1.2, 1.2), 0.3
BALANCED = (0.35, 0.5, 0.65)  # shares of the visits below the load at which one falls that never changes sign
# Powers of polynomials in two positions, to the ninth order: five half waves of one where there are four of the other.
FINELY_TWO = tuple((i, j) for i in range(1, 9) for j in range(1, 10 - i))
# Moments that change by less bend nothing: a weak joint of 1e-4 rad/(N m) turns by 5 µrad. The heaviest chain: 100 N.
LEAST_MOMENT, HEAVIEST_CHAIN = 0.05, 100.0  # N m (standard deviation over the visits), N
LUMPS = (3, 4, 5, 6, 8, 10)  # half waves over one joint's travel that go in proportion to another's position


@dataclass(frozen=True)
class Jumps:
    """A joint's zero or a reflector jumps at these moments [h]: by any amounts, or there and back (`hops`)."""

    of: str
    moments: tuple[float, ...]
    hops: bool = False


@dataclass
class Candidate:
    """effect: the contract's name, or "nameless"; joint, frame, component, covariate: where it sits;
    columns: what it adds; shape: its nonlinear parameters; share: prior weight; covariates: of what has no name;
    way: the sign that physics gives its first coefficient, 0 where it gives none."""

    effect: str
    joint: str | None
    frame: str | None
    component: str | None
    covariate: str
    columns: tuple[Column, ...]
    shape: dict[str, float] = field(default_factory=dict)
    share: float = 1.0
    covariates: tuple[str, ...] = ()
    way: int = 0


@contextmanager
def all_kept() -> Iterator[None]:
    """Makes some 100,000 small objects, none of which is looked at for garbage meanwhile, again and again."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


@all_kept()
def library(
    c: Context, without: frozenset[str] = frozenset(), moments: Sequence[float] = (),
    periods: Sequence[tuple[str, float]] = (), bands: Sequence[Candidate] = (),
    jumps: Sequence[Jumps] = (), knocks: Sequence[Jumps] = (),
) -> list[Candidate]:  # fmt: skip
    """All candidates for a recording; shares of an effect add up to one.

    without  effects that are left out
    moments  at which something seems to have happened [h]: what is tried at MOMENTS moments of a recording is tried
             between all visits about them
    periods  of joints that seem to have a wave: what is tried at half waves over the travel is tried between them
    bands    of waves without a name that seem to be there across a joint's own direction: one of them may be all of it
    jumps    moments of several jumps of a joint's zero that the recording speaks for most
    knocks   the same of reflectors
    """
    makers = (
        _backlash, _friction, _thermal, _tracker_scale, _nonlinear, _clearance, _coupling, _moving_weight,
        _wrench, _creep, _creep_from_nothing, _missing_compliance,
    )  # fmt: skip
    found = [k for make in makers for k in make(c)]
    found += [k for make in (_drift, _sensor_jumps) for k in make(c, _with_more(c, moments))]
    found += _target(c, _with_more(c, moments), knocks)
    found += [*_periodic(c, periods), *_periodic_across(c, bands), *_zero_shift(c, jumps)]
    found = [k for k in found if k.effect not in without]
    total: dict[str, float] = {}
    for k in found:
        total[k.effect] = total.get(k.effect, 0.0) + k.share
    for k in found:
        k.share /= total[k.effect]
    return found


def own_component(c: Context, k: int) -> int:
    axis = np.abs(c.machine.joints[k].axis)
    return int(np.argmax(axis)) + (0 if c.machine.joints[k].prismatic else 3)


def moving_joints(c: Context) -> Iterator[tuple[int, str]]:
    for k, name in enumerate(c.machine.joint_names):
        if np.ptp(c.recording.q[:, k]) > 0:
            yield k, name


def _backlash(c: Context) -> Iterator[Candidate]:
    for k, name in moving_joints(c):
        if not _came_from_both_sides(c, k):
            continue
        own = own_component(c, k)  # what pulls sideways, a cable, is no lost motion
        where = ("backlash", name, name, COMPONENTS[own], f"approach_{name}")
        for width, column in _taken_up(c, k, SOFT_WALLS):
            if not winds_up(c, k, width):
                yield Candidate(*where, (column,), {"width": width}, 0.05)
        sign = Column("frame", "approach", {"joint": k}, k + 1, own)
        drag = Column("frame", "approach_q", {"joint": k}, k + 1, own)
        worn = Column("frame", "approach_q", {"joint": k, "power": 2}, k + 1, own)
        for columns, share in (((sign,), 1.0), ((sign, drag), 0.1), ((sign, drag, worn), 0.1)):
            yield Candidate(*where, columns, share=share)


def _friction(c: Context) -> Iterator[Candidate]:
    for k, name in moving_joints(c):
        where = ("friction_hysteresis", name, name, COMPONENTS[own_component(c, k)], f"move_{name}")
        # where nobody knows from which side a joint came, lost motion of any kind is friction
        parts = WINDS_UP if _came_from_both_sides(c, k) else np.concatenate([SOFT_WALLS[-1:], WINDS_UP])
        if _came_from_both_sides(c, k):
            for width, column in _taken_up(c, k, SOFT_WALLS):
                if winds_up(c, k, width):
                    yield Candidate(*where, (column,), {"width": width}, BRIEFLY)
        for width, column in _taken_up(c, k, parts):
            for lag, shape, share in _went_past(c, k, column):
                yield Candidate(*where, (lag,), {"width": width, **shape}, share)
                for by in (-1, own_component(c, k)):
                    more = replace(lag, args={**lag.args, "pressed": by})
                    yield Candidate(*where, (lag, more), {"width": width, **shape}, 0.05 * share)


def winds_up(c: Context, k: int, way: float) -> bool:
    """Whether what a joint lost and takes up over such a way is friction that winds it up: longer than soft walls are
    for any play that the recording may show (three repeatabilities at the reflectors)."""
    travel = float(np.ptp(c.recording.q[:, k]))
    moves = c.jacobian[:, :, k + 1, own_component(c, k)].reshape(len(c.hours), -1, 3)
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


def _came_from_both_sides(c: Context, k: int) -> bool:
    return c.recording.has_approach and len(np.unique(c.recording.approach[:, k])) > 1


def _taken_up(c: Context, k: int, parts: Array) -> Iterator[tuple[float, Column]]:
    """What a joint lost when it turned back is taken up over a part of its travel, evenly or ever more slowly."""
    for width in map(float, float(np.ptp(c.recording.q[:, k])) * parts):
        for function, how in (("slipping", "width"), ("winding", "way")):
            yield width, Column("frame", function, {"joint": k, how: width}, k + 1, own_component(c, k))


def _thermal(c: Context) -> Iterator[Candidate]:
    for place in temperature_places(c):
        for tau in LAGS_H:
            args = {"place": place, "tau": tau}
            for k, name in moving_joints(c):
                own = own_component(c, k)
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
    for (place, other), tau in itertools.product(itertools.combinations(temperature_places(c), 2), LAGS_H[::2]):
        for (k, name), comp in itertools.product(moving_joints(c), range(6)):  # bends as one side gets warmer
            sides = tuple(
                Column("frame", "temperature", {"place": each, "tau": tau}, k + 1, comp) for each in (place, other)
            )
            where = ("thermal_growth", name, name, COMPONENTS[comp], f"temp_{place}_C")
            yield Candidate(*where, sides, {"lag_h": tau}, 0.2)


def _drift(c: Context, moments: Sequence[float]) -> Iterator[Candidate]:
    forms: list[tuple[str, float]] = [("linear", 1.0)]
    forms += [("exponential", t) for t in (0.3, 0.7, 1.5, 3.0)] + [("log", t) for t in (0.1, 0.5)]
    for form, tau in forms:
        all6 = tuple(Column("frame", "clock", {"form": form, "tau": tau}, 0, comp) for comp in range(6))
        yield Candidate("drift", None, "base", None, "time", all6[:3], {"tau_h": tau}, 1.0)
        yield Candidate("drift", None, "base", None, "time", all6, {"tau_h": tau}, 1.0)
        for comp in range(6):
            yield Candidate("drift", None, "base", COMPONENTS[comp], "time", (all6[comp],), {"tau_h": tau}, 0.5)
    for moment in moments:
        for form in ("step", "ramp"):
            all6 = tuple(Column("frame", "clock", {"form": form, "tau": moment}, 0, comp) for comp in range(6))
            yield Candidate("drift", None, "base", None, "time", all6[:3], {"time_h": moment}, 1 / len(moments))
            yield Candidate("drift", None, "base", None, "time", all6, {"time_h": moment}, 1 / len(moments))
        every: list[tuple[range, str | None, float]] = [(range(3), None, 0.3), (range(6), None, 0.3)]
        every += [(range(comp, comp + 1), COMPONENTS[comp], 0.1) for comp in range(6)]
        for comps, said, share in every:  # goes one way, then another
            turns = tuple(
                Column("frame", "clock", {"form": form, "tau": tau}, 0, comp)
                for form, tau in (("linear", 1.0), ("ramp", moment)) for comp in comps
            )  # fmt: skip
            yield Candidate("drift", None, "base", said, "time", turns, {"time_h": moment}, share / len(moments))
    for order in (2, 3, 4):
        waves = [
            tuple(Column("frame", "clock", {"form": "cosine", "tau": j}, 0, comp) for j in range(1, order + 1))
            for comp in range(6)
        ]
        for comp in range(6):
            yield Candidate("drift", None, "base", COMPONENTS[comp], "time", waves[comp], {}, 0.3)
        yield Candidate("drift", None, "base", None, "time", waves[0] + waves[1] + waves[2], {}, 0.5)


def _with_more(c: Context, about: Sequence[float]) -> list[float]:
    """Forty moments, and all between two visits that are as near to one of `about` as its neighbours are."""
    grid, every = np.array(moments_between(c, MOMENTS)), np.array(moments_between(c, len(c.hours)))
    if not len(grid) or not len(about):
        return [float(t) for t in grid]
    away = np.min(np.abs(every[:, None] - np.array(about)), axis=1)
    return sorted({*map(float, grid), *map(float, every[away <= 1.01 * np.diff(grid).max()])})


def moments_between(c: Context, most: int) -> list[float]:
    """Moments between visits, evenly, some way from both ends [h]."""
    count = len(c.hours)
    return [float(t) for t in (0.5 * (c.hours[1:] + c.hours[:-1]))[8 : count - 8 : max(1, count // most)]]


def _tracker_scale(c: Context) -> Iterator[Candidate]:
    constant = Column("points", "scale", {})
    yield Candidate("tracker_scale", None, None, None, "distance", (constant,))
    for place in temperature_places(c):
        grows = Column("points", "scale", {"place": place})
        yield Candidate("tracker_scale", None, None, None, f"temp_{place}_C", (grows,), share=0.5)
        yield Candidate("tracker_scale", None, None, None, f"temp_{place}_C", (constant, grows), share=0.5)
        # about another point than where the instrument is said to stand: everything shifts with the temperature as well
        shifts = tuple(Column("frame", "temperature", {"place": place, "tau": 0.0}, 0, comp) for comp in range(3))
        yield Candidate("tracker_scale", None, None, None, f"temp_{place}_C", (grows, *shifts), share=0.3)


def _periodic(c: Context, about: Sequence[tuple[str, float]]) -> Iterator[Candidate]:
    for k, name in moving_joints(c):
        joint = c.machine.joints[k]
        span = float(np.ptp(c.recording.q[:, k]))
        most = int(np.clip(2 * span / (SCREW if joint.prismatic else GEAR), LEAST_PERIODS, MOST_PERIODS))
        half_waves = np.arange(6.0, most + 1)
        near = [2 * span / period + np.array(FINER) for joint_name, period in about if joint_name == name]
        periods = 2 * span / np.unique(np.round(np.concatenate([half_waves, *near]), 3))
        own = own_component(c, k)
        yield from _single_waves(c, k, own, list(map(float, periods)))


def _periodic_across(c: Context, bands: Sequence[Candidate]) -> Iterator[Candidate]:
    """A bent screw or shaft turns the carriage about: single waves out of bands of them."""
    for band in bands:
        frequencies = sorted({1 / column.args["period"] for column in band.columns})
        step = (frequencies[-1] - frequencies[0]) / (len(frequencies) - 1) / 4
        tried = np.arange(frequencies[0] - 2 * step, frequencies[-1] + 3 * step, step)
        first = band.columns[0]
        yield from _single_waves(c, first.args["joint"], first.component, list(map(float, 1 / tried[tried > 0])))


def _single_waves(c: Context, k: int, component: int, periods: Sequence[float]) -> Iterator[Candidate]:
    """Of joint k's position, in one component of its frame; shares alike."""
    name = c.machine.joint_names[k]
    for period in periods:
        args = {"joint": k, "period": period}
        pair = tuple(Column("frame", "wave", {**args, "phase": p}, k + 1, component) for p in ("sin", "cos"))
        yield Candidate(
            "periodic_transmission", name, name, COMPONENTS[component], f"q_{name}", pair, {"period": period},
            share=1.0 / len(periods),
        )  # fmt: skip


def loads_on(c: Context, frame: int) -> list[int]:
    """Wrench components that really vary on a frame: a constant load says nothing."""
    w = c.wrenches[:, frame]
    size = np.abs(w).max(axis=0)
    reference = np.array([size[:3].max()] * 3 + [size[3:].max()] * 3)
    return [k for k in range(6) if np.ptp(w[:, k]) > 0.05 * max(reference[k], 1e-9)]


def _elastic_frames(c: Context) -> Iterator[tuple[int, str, list[int]]]:
    for k, joint in enumerate(c.machine.joints):
        if joint.elastic is not None:
            known = joint.elastic.load_indices
            yield k + 1, joint.name, [b for b in loads_on(c, k + 1) if b in known]


def _nonlinear(c: Context) -> Iterator[Candidate]:
    for frame, name, acting in _elastic_frames(c):
        for b in acting:
            where = {"frame": frame, "component": b}
            # by an exponent below one or above; slack that is taken up little by little: soft at first, then stiff
            powers = ((0.5, 0.5), (0.67, 0.5), (0.8, 0.5), (1.5, 1.0), (2.0, 1.0), (3.0, 1.0))
            shapes: list[tuple[str, dict[str, Any], dict[str, float], float]] = [
                ("load_power", {"exponent": e}, {"exponent": e}, share) for e, share in powers
            ]
            for side in [{"width": w, **of} for w in TAKEN_UP for of in ({}, *_of_payload(c, frame, b))]:
                shapes.append(("load_side", side, _of_load(c, frame, b, side), 2 / len(TAKEN_UP)))
            for function, args, shape, share in shapes:
                for comp in range(6):
                    yield Candidate(
                        "nonlinear_stiffness", name, name, COMPONENTS[comp], WRENCH_COMPONENTS[b],
                        (Column("frame", function, {**where, **args}, frame, comp),), shape,
                        share if comp == b else 0.2 * share,
                    )  # fmt: skip
            if _changes_side(c.wrenches[:, frame, b]):
                for column, shape, way in _opened(c, frame, b):
                    yield Candidate(
                        "nonlinear_stiffness", name, name, COMPONENTS[b], WRENCH_COMPONENTS[b], (column,), shape, 0.5,
                        way=way,
                    )  # fmt: skip
            for knees, width in _knees(c, frame, b):
                columns = tuple(
                    Column("frame", "load_knee", {**where, "at": at, "width": width}, frame, b) for at in knees
                )
                shape = dict(zip(("knee_load", "other_knee_load"), knees, strict=False))
                yield Candidate(
                    "nonlinear_stiffness", name, name, COMPONENTS[b], WRENCH_COMPONENTS[b], columns, shape, 0.2
                )


def _opened(c: Context, frame: int, b: int) -> Iterator[tuple[Column, dict[str, float], int]]:
    """A preload is lost beyond some load to either side, from where on a link is softer: sharply, or little by little,
    as a clearance is used up, but against the load. Columns, their shapes and signs."""
    where, std = {"frame": frame, "component": b}, float(c.wrenches[:, frame, b].std())
    for at in OPENS_AT:
        shape = {"at": at * std, "width": 0.1 * std}
        yield Column("frame", "load_beyond", {**where, **shape}, frame, b), {"knee_load": at * std}, 1
    for width in USED_UP:
        side = {"width": width}
        yield Column("frame", "load_side", {**where, **side}, frame, b), _of_load(c, frame, b, side), -1


def _knees(c: Context, frame: int, component: int) -> Iterator[tuple[tuple[float, ...], float]]:
    """Loads above which a link may be stiffer or softer than below, one, or two as where a bolted flange opens either
    way; and over how much it changes [N, N m]."""
    w = c.wrenches[:, frame, component]
    at = [float(load) for load in np.quantile(w, KNEES_AT)]
    for width in ROUNDED * float(w.std()):
        yield from (((one,), float(width)) for one in at)
        yield from ((pair, float(width)) for pair in ((at[0], at[-1]), (at[1], at[-2])))


def _of_load(c: Context, frame: int, component: int, side: Mapping[str, Any]) -> dict[str, float]:
    """What the width of a side, relative to its load's spread, is in N or N m."""
    return {"load_width": side["width"] * float(load_of(c, frame, component, side.get("of", "")).std())}


def _of_payload(c: Context, frame: int, component: int) -> list[dict[str, str]]:
    """Where its own weight may be balanced, so that the payload alone pushes a joint over to its other side."""
    if c.recording.has_wrench and _changes_side(load_of(c, frame, component, "payload")):
        return [{"of": "payload"}]
    return []


def _changes_side(w: Array) -> bool:
    return bool(min((w > 0).mean(), (w < 0).mean()) > 0.03)


def _clearance(c: Context) -> Iterator[Candidate]:
    for frame in range(1, c.machine.n + 1):
        name = c.machine.joint_names[frame - 1]
        for b in loads_on(c, frame):
            for function, shape, share in _falls(c, frame, b):
                args = {"frame": frame, "component": b, **shape}
                for comp in range(6):
                    yield Candidate(
                        "clearance", name, name, COMPONENTS[comp], WRENCH_COMPONENTS[b],
                        (Column("frame", function, args, frame, comp),), _of_load(c, frame, b, shape),
                        share if comp == b else 0.1 * share, way=int(comp == b),  # with the load, never against it
                    )  # fmt: skip
            uneven = (0.02, 0.08, 0.17, 0.35) if _changes_side(c.wrenches[:, frame, b]) else ()
            for wide in uneven:  # the gap is wider on one side than on the other
                args = {"frame": frame, "component": b, "width": wide}
                sides = tuple(Column("frame", "load_side", {**args, **e}, frame, b) for e in ({}, {"either": True}))
                at = COMPONENTS[b], WRENCH_COMPONENTS[b]
                yield Candidate("clearance", name, name, *at, sides, _of_load(c, frame, b, args), 0.3, way=1)


def _falls(c: Context, frame: int, b: int) -> Iterator[tuple[str, dict[str, Any], float]]:
    """How a joint may fall to its other side by a component of its load, and the shares of these; wider ones are
    nonlinear stiffness."""
    w = c.wrenches[:, frame, b]
    for wide, offset in itertools.product((0.02, 0.1, 0.3), FALLS_AT):
        if _changes_side(w - offset * w.std()):
            yield "load_side", {"width": wide, "offset": offset}, 1.0 if abs(offset) < 0.5 else PRELOADED
    if not _changes_side(w):  # whatever balances the rest of it
        middle = np.quantile(w, BALANCED) / w.std()
        for wide, offset in itertools.product((0.1, 0.3), map(float, middle)):
            yield "load_side", {"width": wide, "offset": offset}, PRELOADED
    else:
        yield from (("load_side_held", {"width": wide}, 1.0) for wide in (0.1, 0.25, 0.5))
    for of, wide in itertools.product(_of_payload(c, frame, b), (0.02, 0.1, 0.3)):
        yield "load_side", {"width": wide, **of}, 0.5


def _coupling(c: Context) -> Iterator[Candidate]:
    for a, name in moving_joints(c):
        for b, other in moving_joints(c):
            if a == b:
                continue
            for comp in range(6):
                for half_waves in LUMPS:
                    args = {"joint": a, "period": 2 * float(np.ptp(c.recording.q[:, a])) / half_waves, "by": b}
                    pair = tuple(Column("frame", "wave_q", {**args, "phase": p}, a + 1, comp) for p in ("sin", "cos"))
                    yield Candidate(
                        "cross_coupling", name, name, COMPONENTS[comp], f"q_{other}", pair, {}, 0.5 / len(LUMPS),
                        (f"q_{name}", f"q_{other}"),
                    )  # fmt: skip
                for powers, share in (
                    (FINELY_TWO, 0.3),
                    (((1, 1),), 1.0), (((0, 1), (1, 1)), 0.5), (((0, 1), (0, 2)), 0.5),
                    (((1, 1), (1, 2), (2, 1), (2, 2)), 0.5), (((0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3)), 0.3),
                    (((0, 1), (1, 1), (2, 1), (3, 1)), 0.3), (tuple((i, 1) for i in range(7)), 0.3),
                ):  # fmt: skip
                    columns = tuple(
                        Column("frame", "pair", {"a": a, "power_a": i, "b": b, "power_b": j}, a + 1, comp)
                        for i, j in powers
                    )
                    yield Candidate(
                        "cross_coupling", name, name, COMPONENTS[comp], f"q_{other}", columns, {}, share,
                        (f"q_{name}", f"q_{other}"),
                    )  # fmt: skip


def _moving_weight(c: Context) -> Iterator[Candidate]:
    for k, name in moving_joints(c):
        mass = Column("frames", "body_weight", {"joint": k, "what": "mass"})
        yield Candidate("moving_weight", name, name, None, f"q_{name}", (mass,))
        for axis in "xyz":
            shift = Column("frames", "body_weight", {"joint": k, "what": axis})
            yield Candidate("moving_weight", name, name, None, f"q_{name}", (shift,), share=0.2)
        chain = tuple(
            Column("frames", "body_weight", {"joint": k, "what": what, "grows": power})
            for power in (1, 2) for what in ("mass", "x", "y", "z")
        )  # fmt: skip
        for some in (chain[:1], (chain[0], chain[4]), chain):  # a cable chain hangs there, as long as its joint has it
            if alive := _alive(c, some):
                yield Candidate("moving_weight", name, name, None, f"q_{name}", alive, share=0.3)
        for other, by in moving_joints(c):  # a hose that another joint pulls along
            if other == k:
                continue
            hose = tuple(
                Column("frames", "body_weight", {"joint": k, "what": what, "grows": 1, "by": other})
                for what in ("mass", *"xyz")
            )
            if all(not np.any(column.value(c)) for column in hose):
                continue
            for some in ((column,) for column in hose if np.any(column.value(c))):
                yield Candidate("moving_weight", name, name, None, f"q_{by}", some, share=0.03)
            yield Candidate("moving_weight", name, name, None, f"q_{by}", _alive(c, hose), share=0.05)
    for frame, name in enumerate(c.machine.joint_names, start=1):
        for b in range(3, 6):
            column = Column("frame", "own_weight", {"frame": frame, "component": b}, frame, b)
            if float(np.std(column.value(c))) > LEAST_MOMENT:
                yield Candidate("moving_weight", name, name, COMPONENTS[b], f"q_{name}", (column,), {}, 0.5)
            if frame < c.machine.n:
                args = {"frame": frame, "component": b, "joint": frame}
                column = Column("frame", "hanging", args, frame, b)
                if HEAVIEST_CHAIN * float(np.std(column.value(c))) > LEAST_MOMENT:
                    after = c.machine.joint_names[frame]
                    yield Candidate("moving_weight", name, name, COMPONENTS[b], f"q_{after}", (column,), {}, 0.5)


def _alive(c: Context, columns: Sequence[Column]) -> tuple[Column, ...]:
    """Those that do anything beside the largest: a channel that reads nothing, an axis that stays plumb do not."""
    size = [float(np.abs(column.value(c)).max()) for column in columns]
    return tuple(column for column, most in zip(columns, size, strict=True) if most > 1e-6 * max(size))


def _wrench(c: Context) -> Iterator[Candidate]:
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
    gain = Column("frames", "sensor_error", {"component": -1})
    yield Candidate("wrench_error", None, None, None, "load", (gain,), share=3.0)
    ageing = Column("frames", "sensor_error", {"component": -1, "time": "linear"})
    yield Candidate("wrench_error", None, None, None, "time", (ageing,), share=0.5)
    # a calibration matrix of its own: of every channel's gain, or of all that it has
    for some in ([matrix[k, k] for k in range(6)], [*matrix.values()]):
        if alive := _alive(c, some):
            yield Candidate("wrench_error", None, None, None, "load", alive)
    zeros = tuple(
        Column("frames", "sensor_error", {"component": comp, "time": "cosine", "tau": j})
        for comp, j in itertools.product(range(6), range(1, 7))
    )
    if alive := _alive(c, zeros):
        yield Candidate("wrench_error", None, None, None, "time", alive, share=0.5)
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


def _sensor_jumps(c: Context, moments: Sequence[float]) -> Iterator[Candidate]:
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
    if alive := _alive(c, tuple(itertools.chain.from_iterable(tared))):
        yield Candidate("wrench_error", None, None, None, "since_load_change", alive, {}, 0.5)


def temperature_places(c: Context) -> list[str]:
    """Temperatures without gaps that change at all."""
    return [p for p, t in c.recording.temperatures.items() if np.isfinite(t).all() and np.ptp(t) >= 1e-3]


def within(machine: Machine) -> tuple[str, ...]:
    """How columns of temperatures end that are of joints beyond the first: what warms there does not move the base."""
    return tuple(f"temp_{name}_C" for name in machine.joint_names[1:])


def _creep(c: Context) -> Iterator[Candidate]:
    if len(set(c.recording.load)) < 2:
        return
    forms: tuple[tuple[str, float], ...] = (
        ("exponential", 1.0), ("log", 1.0), ("last", 0.5), ("wrench", 0.5), ("total", 0.5)
    )  # fmt: skip
    if not c.recording.has_wrench:  # the machine's own weight is all that is known
        forms = forms[-1:]
    # alone, or beside one that creeps on where it has come to rest, as in load cells
    rates: list[tuple[float, ...]] = [(tau,) for tau in CREEP_H]
    rates += zip(CREEP_H, CREEP_H[SLOWER:], strict=False)
    ways = [
        (form, half, taus) for taus in rates for form, half in forms if form not in ("log", "last") or len(taus) == 1
    ]  # fmt: skip
    for form, half, taus in ways:
        shape = dict(zip(("tau_h", "slow_tau_h"), taus, strict=False))
        whole = tuple(Column("frames", "creep", {"tau": tau, "form": form}) for tau in taus)
        yield Candidate("creep", None, None, None, "since_load_change", whole, shape, 2.0 * half)
        for frame, name, acting in _elastic_frames(c):
            link = tuple(Column("frames", "creep", {"tau": tau, "form": form, "frame": frame}) for tau in taus)
            yield Candidate("creep", name, name, None, "since_load_change", link, shape, half)
            for b in acting:
                where = {"frame": frame, "component": b, "form": form}
                columns = tuple(Column("frame", "creeping", {**where, "tau": tau}, frame, b) for tau in taus)
                yield Candidate(
                    "creep", name, name, COMPONENTS[b], "since_load_change", columns, shape,
                    half if b > 2 else 0.3 * half,
                )  # fmt: skip
                if len(taus) == 1 and form in ANY_WAY:  # that load bends and stretches it in other directions too
                    where |= {"tau": taus[0]}
                    any_way = tuple(Column("frame", "creeping", where, frame, comp) for comp in range(6))
                    yield Candidate("creep", name, name, None, "since_load_change", any_way, shape, 0.2 * half)


def _creep_from_nothing(c: Context) -> Iterator[Candidate]:
    """Links that creep where nothing had hung there before the recording, or something else."""
    if len(set(c.recording.load)) < 2:
        return
    began = [("total", "began")] + [("exponential", "first")] * c.recording.has_wrench
    for forms, tau, (frame, name, acting) in itertools.product(began, CREEP_H, list(_elastic_frames(c))):
        for b in acting:
            args = {"frame": frame, "component": b, "tau": tau}
            both = tuple(Column("frame", "creeping", {**args, "form": form}, frame, b) for form in forms)
            yield Candidate("creep", name, name, COMPONENTS[b], "since_load_change", both, {"tau_h": tau}, 0.3)


def visits_between(c: Context) -> list[float]:
    """Moments between visits at which a zero may have jumped [h]."""
    return moments_between(c, 450)


def some_between(c: Context) -> list[float]:
    """Moments between visits at which a reflector may have been moved more than once [h]."""
    return moments_between(c, KNOCKS)


def shift_of_zero(c: Context, k: int, moment: float) -> Column:
    """What a jump of a joint's zero at a moment [h] does from then on."""
    return Column("frame", "step", {"visit_time": moment}, k + 1, own_component(c, k))


def _zero_shift(c: Context, jumps: Sequence[Jumps]) -> Iterator[Candidate]:
    for k, name in moving_joints(c):
        own = own_component(c, k)
        where = ("zero_shift", name, name, COMPONENTS[own], "time")
        every, some = visits_between(c), moments_between(c, MOMENTS)
        for moment in every:
            yield Candidate(*where, (shift_of_zero(c, k, moment),), {"time_h": moment}, 1.0 / len(every))
        for first, second in itertools.combinations(some, 2):
            pairs = len(some) * (len(some) - 1) / 2
            both = shift_of_zero(c, k, first), shift_of_zero(c, k, second)
            yield Candidate(*where, both, _moments(first, second), 0.2 / pairs)
        for many in (many for many in jumps if many.of == name):
            share = 0.1 / math.comb(len(every), len(many.moments))
            if many.hops:
                hopping = Column("frame", "hopping", {"times": many.moments}, k + 1, own)
                shape = {"time_h": many.moments[0], "hops": float(len(many.moments))}
                yield Candidate(*where, (hopping,), shape, share)
            else:
                columns = tuple(shift_of_zero(c, k, moment) for moment in many.moments)
                yield Candidate(*where, columns, _moments(*many.moments), share)
        for moment in some:
            for tau in (0.5, 1.5):
                back = Column("frame", "settling", {"visit_time": moment, "tau": tau}, k + 1, own)
                yield Candidate(*where, (shift_of_zero(c, k, moment), back), {"time_h": moment}, 0.1 / len(some))


def _moments(*moments: float) -> dict[str, float]:
    return {f"{word}time_h": moment for word, moment in zip(ORDINALS, moments, strict=False)}


def _missing_compliance(c: Context) -> Iterator[Candidate]:
    for frame in range(c.machine.n + 1):
        joint = c.machine.joints[frame - 1] if frame else None
        name = None if joint is None else joint.name
        known = set(joint.elastic.load_indices) if joint is not None and joint.elastic is not None else set()
        for b in loads_on(c, frame):
            for comp in range(6):
                where = ("missing_compliance", name, name or "base", COMPONENTS[comp], WRENCH_COMPONENTS[b])
                share = 1.0 if comp == b else 0.05 if skew(*sorted((comp, b))) else 0.2
                if b not in known:
                    args = {"frame": frame, "component": b}
                    yield Candidate(*where, (Column("frame", "load", args, frame, comp),), {}, share)
                if joint is not None and not (joint.elastic is not None and joint.elastic.varies):
                    args = {"frame": frame, "component": b, "joint": frame - 1}
                    grows = Column("frame", "load_q", args, frame, comp)
                    yield Candidate(*where, (grows,), {}, 0.3 * share)
                    if joint.prismatic:
                        faster = Column("frame", "load_q", {**args, "degree": 2}, frame, comp)
                        yield Candidate(*where, (grows, faster), {}, 0.3 * share)
                        continue
                    for order in (1, 2):
                        yield Candidate(*where, tuple(
                            Column("frame", "load_turn", {**args, "order": order, "phase": phase}, frame, comp)
                            for phase in ("sin", "cos")
                        ), {}, 0.15 * share)  # fmt: skip
        acting = [b for b in loads_on(c, frame) if b not in known]
        if len(acting) > 1:
            diagonal = tuple(Column("frame", "load", {"frame": frame, "component": b}, frame, b) for b in acting)
            yield Candidate("missing_compliance", name, name or "base", None, "load", diagonal, {}, 2.0)


def shift_of_reflector(target: int, moment: float, **more: float) -> tuple[Column, ...]:
    """A reflector elsewhere from a moment on [h], along each axis of the end effector; always where it is negative."""
    args = {"target": target, "since": moment, **more}
    return tuple(Column("points", "target_shift", {**args, "axis": a}) for a in range(3))


def _target(c: Context, moments: Sequence[float], knocks: Sequence[Jumps]) -> Iterator[Candidate]:
    # there from the start (where it stands alone nobody can say so); knocked at a moment; or sliding from then on
    courses = [(-1.0, 0.0, 1.0)] if c.points.shape[1] > 1 else []
    courses += [(t, 0.0, 1.0 / len(moments)) for t in moments]
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
