"""What a frame does under its load: stiffness out of proportion, clearance, compliance that the file has not."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.library.candidate import Candidate
from ppshw.diagnosis.library.sampled import elastic_frames, loads_on, nearest_component
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.terms import COMPONENTS
from ppshw.terms.elastic import skew
from ppshw.terms.shapes import Column, Context
from ppshw.terms.shapes.loads import load_of

Array = NDArray[np.float64]
# Widths, relative to the load's spread, over which slack is taken up by a load, little by little, and in proportion to
# it up to a stop.
TAKEN_UP, FAR_STOPS = (0.6, 0.85, 1.2), (0.85, 1.2)
# Shares of the visits whose load is below that at which stiffness changes.
KNEES_AT = (1 / 6, 1 / 3, 1 / 2, 2 / 3, 5 / 6)
OPENS_AT = (0.3, 0.5, 0.7, 1.0, 1.4)  # relative to a load's spread: beyond it, either way, a link is softer
OF_THE_RIGID = 0.3  # share of forms of a link that the machine file has rigid
USED_UP = (0.1, 0.3)  # relative to a load's spread: widths of clearances, too
ROUNDED = np.array([0.2, 0.8])  # over how much of the load's spread it does
# Loads at which a joint falls to its other side, relative to the spread; the share of those that are far from zero.
FALLS_AT, PRELOADED = (0.0, -0.3, 0.3, -0.7, 0.7, -1.2, 1.2), 0.3
# Widths, relative to the load's spread, over which it falls little by little, wider ones being nonlinear stiffness; and
# over which it falls in proportion to its load, and no farther, about these loads.
SIDES, STOPS, STOPS_ABOUT = (0.02, 0.1, 0.3), (0.3, 0.5, 0.7), (-0.3, -0.15, 0.0, 0.15, 0.3)
# By a load that something was found to go with: between those, as a fall of a width of 0.12 at 0.18 of the spread was
# one at −0.7 of the next joint's (by 7 of log evidence), and slack that ends at two loads any function of them.
FINE_SIDES, FINE_FALLS = (0.02, 0.05, 0.1, 0.17, 0.3), tuple(round(-1.2 + 0.1 * k, 1) for k in range(25))
FINE_OPENS, FINE_ROUNDED = tuple(round(0.2 + 0.1 * k, 1) for k in range(15)), (0.02, 0.1, 0.3)
FINE_STOPS = (0.8, 0.9, 1.0, 1.1, 1.2, 1.4, 1.6)
FINE_POWERS = {0.5: (0.4, 0.5, 0.6), 0.67: (0.67,), 0.8: (0.75, 0.85), 1.5: (1.25, 1.5, 1.75), 2.0: (2.0,),
               3.0: (2.5, 3.0, 4.0)}  # fmt: skip
# Widths which a load must go beyond to push over what stays on its side, about these loads.
HOLDS, HELD, HELD_ABOUT = "load_side_held", (0.07, 0.1, 0.15, 0.22, 0.33, 0.5), (0.0, -0.3, 0.3)
# By a load that something was found to go with: one visit whose load is beyond one width and not the other lies on the
# wrong side, and those after it until the next load pushes it over. Held by 0.25 of the spread said 1,587 by 0.22, any
# function of the load and the one before 2,872 (a sixtieth author's 033).
FINE_HELD = tuple(round(0.04 + 0.02 * k, 2) for k in range(30))
FINE_HELD_ABOUT = tuple(round(-0.9 + 0.15 * k, 2) for k in range(13))
# Visits beyond zero by which a load changes its sign: five to twelve of 400 showed a fall of 0.2 mrad at a p of 1e-41,
# which was stiffness of weight 0.95 where falls were tried from 3 % of them on alone (a reviewer's arms).
FEW_BEYOND, HARDLY_CHANGES = 5, 0.03
# Shares of the visits below the load at which one falls that never changes sign: as near each other as the falls of one
# that does, whose load may differ by a constant alone (three at 0.15 from each other left the right joint 7 of log
# evidence behind the next one, a reviewer's).
BALANCED = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
# Of a joint's travel: about which places, and up to how far from them, a link may be softer than elsewhere.
PLACES, STRETCHES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9), (0.12, 0.25)
MOST_POSTS = 12  # half waves over its joint's travel, by which a frame gives way under its load
HALF_A_CYCLE = 1.5  # rad that a bearing turns at least, to tell its softer direction from a compliance


def nonlinear(c: Context, finely: Collection[int] = ()) -> Iterator[Candidate]:
    """finely: components of loads that something goes with, whose forms are tried more finely.

    A link that the machine file has rigid gives way in proportion besides, which no base model has."""
    bent = {frame: set(acting) for frame, _, acting in elastic_frames(c)}
    for frame in range(1, c.machine.n + 1):
        for b in loads_on(c, frame):
            if b in bent.get(frame, ()):
                yield from _out_of_proportion(c, frame, b, b in finely)
                continue
            in_proportion = Column("frame", "load", {"frame": frame, "component": b}, frame, b)
            for k in _out_of_proportion(c, frame, b, b in finely):
                if k.component == COMPONENTS[b]:
                    yield replace(k, columns=(*k.columns, in_proportion), share=OF_THE_RIGID * k.share)


def _out_of_proportion(c: Context, frame: int, b: int, finely: bool) -> Iterator[Candidate]:
    name, where = c.machine.joint_names[frame - 1], {"frame": frame, "component": b}
    # by an exponent below one or above; slack that is taken up little by little: soft at first, then stiff
    powers = ((0.5, 0.5), (0.67, 0.5), (0.8, 0.5), (1.5, 1.0), (2.0, 1.0), (3.0, 1.0))
    about = {e: FINE_POWERS[e] if finely else (e,) for e, _ in powers}
    shapes: list[tuple[str, dict[str, Any], dict[str, float], float]] = [
        ("load_power", {"exponent": e}, {"exponent": e}, share / len(about[among]))
        for among, share in powers for e in about[among]
    ]  # fmt: skip
    for side in [{"width": w, **of} for w in TAKEN_UP for of in ({}, *_of_payload(c, frame, b))]:
        shapes.append(("load_side", side, _of_load(c, frame, b, side), 2 / len(TAKEN_UP)))
    stops = FINE_STOPS if finely else FAR_STOPS
    for stop in [{"width": w, "hard": True} for w in stops]:
        shapes.append(("load_side", stop, _of_load(c, frame, b, stop), 1 / len(stops)))
    for function, args, shape, share in shapes:
        for comp in range(6):
            yield Candidate(
                "nonlinear_stiffness", name, name, COMPONENTS[comp], WRENCH_COMPONENTS[b],
                (Column("frame", function, {**where, **args}, frame, comp),), shape,
                share if comp == b else 0.2 * share,
            )  # fmt: skip
    if changes_side(c.wrenches[:, frame, b]):
        for column, shape, way, share in _opened(c, frame, b, finely):
            yield Candidate(
                "nonlinear_stiffness", name, name, COMPONENTS[b], WRENCH_COMPONENTS[b], (column,), shape, share, way=way
            )
    for knees, width in _knees(c, frame, b):
        columns = tuple(Column("frame", "load_knee", {**where, "at": at, "width": width}, frame, b) for at in knees)
        shape = dict(zip(("knee_load", "other_knee_load"), knees, strict=False))
        yield Candidate(
            "nonlinear_stiffness", name, name, COMPONENTS[b], WRENCH_COMPONENTS[b], columns, shape, 0.2
        )  # fmt: skip


def _opened(c: Context, frame: int, b: int, finely: bool) -> Iterator[tuple[Column, dict[str, float], int, float]]:
    """A preload is lost beyond some load to either side, from where on a link is softer: sharply, or little by little,
    as a clearance is used up, but against the load. Columns, their shapes, signs and shares."""
    where, std = {"frame": frame, "component": b}, float(c.wrenches[:, frame, b].std())
    beyond = [*itertools.product(FINE_OPENS if finely else OPENS_AT, FINE_ROUNDED if finely else (0.1,))]
    for at, width in beyond:
        shape = {"at": at * std, "width": width * std}
        column = Column("frame", "load_beyond", {**where, **shape}, frame, b)
        yield column, {"knee_load": at * std}, 1, 0.5 * len(OPENS_AT) / len(beyond)
    used_up = [side for side in FINE_SIDES if side >= min(USED_UP)] if finely else USED_UP
    shares = [*[0.5 * len(USED_UP) / len(used_up)] * len(used_up), *[0.5] * len(STOPS)]
    sides = [*({"width": width} for width in used_up), *({"width": width, "hard": True} for width in STOPS)]
    for side, share in zip(sides, shares, strict=True):
        yield Column("frame", "load_side", {**where, **side}, frame, b), _of_load(c, frame, b, side), -1, share


def _knees(c: Context, frame: int, component: int) -> Iterator[tuple[tuple[float, ...], float]]:
    """Loads above which a link may be stiffer or softer than below, one, or two as where a bolted flange opens either
    way; and over how much it changes [N, N m]."""
    w = c.wrenches[:, frame, component]
    at = [float(load) for load in np.quantile(w, KNEES_AT)]
    for width in ROUNDED * float(w.std()):
        yield from (((one,), float(width)) for one in at)
        yield from ((pair, float(width)) for pair in ((at[0], at[-1]), (at[1], at[-2])))


def clearance(c: Context, finely: Collection[int] = ()) -> Iterator[Candidate]:
    """finely: components of loads that something goes with, whose falls are tried more finely."""
    for frame in range(1, c.machine.n + 1):
        name = c.machine.joint_names[frame - 1]
        for b in loads_on(c, frame):
            for function, shape, share in _falls(c, frame, b, b in finely):
                args = {"frame": frame, "component": b, **shape}
                said = {**_of_load(c, frame, b, shape), **_falls_at(c, args)}
                alone = (
                    "hard" in shape or (b in finely and _between(shape)) or (function == HOLDS and "offset" in shape)
                )
                for comp in (b,) if alone else range(6):
                    yield Candidate(
                        "clearance", name, name, COMPONENTS[comp], WRENCH_COMPONENTS[b],
                        (Column("frame", function, args, frame, comp),), said,
                        share if comp == b else 0.1 * share, way=int(comp == b),  # with the load, never against it
                    )  # fmt: skip
            uneven = (0.02, 0.08, 0.17, 0.35) if changes_side(c.wrenches[:, frame, b]) else ()
            for wide in uneven:  # the gap is wider on one side than on the other
                args = {"frame": frame, "component": b, "width": wide}
                sides = tuple(Column("frame", "load_side", {**args, **e}, frame, b) for e in ({}, {"either": True}))
                at = COMPONENTS[b], WRENCH_COMPONENTS[b]
                yield Candidate("clearance", name, name, *at, sides, _of_load(c, frame, b, args), 0.3, way=1)


def _falls(c: Context, frame: int, b: int, finely: bool) -> Iterator[tuple[str, dict[str, Any], float]]:
    """How a joint may fall to its other side by a component of its load, and the shares of these."""
    w = c.wrenches[:, frame, b]
    at, sides = (FINE_FALLS, FINE_SIDES) if finely else (FALLS_AT, SIDES)
    thin = len(FALLS_AT) * len(SIDES) / (len(at) * len(sides))
    for offset in at:
        if changes_side(w - offset * w.std()):
            share = thin * (1.0 if abs(offset) < 0.5 else PRELOADED)
            yield from (("load_side", {"width": wide, "offset": offset}, share) for wide in sides)
    for wide, offset in itertools.product(STOPS, STOPS_ABOUT):
        if changes_side(w - offset * w.std()):
            yield "load_side", {"width": wide, "offset": offset, "hard": True}, 0.5
    if min((w > 0).mean(), (w < 0).mean()) <= HARDLY_CHANGES:  # whatever balances the rest of it
        middle = np.quantile(w, BALANCED) / w.std()
        for wide, offset in itertools.product(SIDES[1:], map(float, middle)):
            yield "load_side", {"width": wide, "offset": offset}, PRELOADED
    widths, elsewhere = (FINE_HELD if finely else HELD), (FINE_HELD_ABOUT if finely else HELD_ABOUT)
    held = [(wide, 0.0, 0.5 * len(HELD) / len(widths)) for wide in widths]
    held += [(wide, about, PRELOADED / (len(elsewhere) - 1)) for wide in HELD for about in elsewhere if about]
    for wide, offset, share in held:
        beyond = w - offset * w.std()
        if changes_side(beyond):  # where no load has pushed it over yet, it may have lain on either side
            starts = (-1, 1) if abs(beyond[0]) < wide * w.std() else (0,)
            about = {"offset": offset} if offset else {}
            yield from ((HOLDS, {"width": wide, "start": k, **about}, share / len(starts)) for k in starts)
    for of, wide in itertools.product(_of_payload(c, frame, b), SIDES):
        yield "load_side", {"width": wide, **of}, 0.5


def _between(side: Mapping[str, Any]) -> bool:
    """Whether a fall is between those that are tried in all directions."""
    wide, offset = side["width"], side.get("offset", 0.0)
    return (wide in FINE_SIDES and wide not in SIDES) or (offset in FINE_FALLS and offset not in FALLS_AT)


def _of_load(c: Context, frame: int, component: int, side: Mapping[str, Any]) -> dict[str, float]:
    """What the width of a side, relative to its load's spread, is in N or N m."""
    return {"load_width": side["width"] * float(load_of(c, frame, component, side.get("of", "")).std())}


def _falls_at(c: Context, side: Mapping[str, Any]) -> dict[str, float]:
    """The load at which a joint falls to its other side [N or N m], where that is not held."""
    if "offset" not in side:
        return {}
    return {"falls_at": side["offset"] * float(load_of(c, side["frame"], side["component"]).std())}


def _of_payload(c: Context, frame: int, component: int) -> list[dict[str, str]]:
    """Where its own weight may be balanced, so that the payload alone pushes a joint over to its other side."""
    if c.recording.has_wrench and changes_side(load_of(c, frame, component, "payload")):
        return [{"of": "payload"}]
    return []


def changes_side(w: Array) -> bool:
    return bool(min((w > 0).sum(), (w < 0).sum()) >= FEW_BEYOND)


def missing_compliance(c: Context) -> Iterator[Candidate]:
    for frame in range(c.machine.n + 1):
        joint = c.machine.joints[frame - 1] if frame else None
        name, there = None if joint is None else joint.name, c.machine.frame_names[frame]
        known = set(joint.elastic.load_indices) if joint is not None and joint.elastic is not None else set()
        for b in loads_on(c, frame):
            for comp in range(6):
                where = ("missing_compliance", name, there, COMPONENTS[comp], WRENCH_COMPONENTS[b])
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
                        if comp == b and np.ptp(c.recording.q[:, frame - 1]) > 0:
                            for wave in between_posts(c, frame, b):
                                shape = {"period": float(wave[0].args["period"])}
                                yield Candidate(*where, wave, shape, 0.3 / MOST_POSTS)
                        continue
                    for order in (1, 2):
                        yield Candidate(*where, tuple(
                            Column("frame", "load_turn", {**args, "order": order, "phase": phase}, frame, comp)
                            for phase in ("sin", "cos")
                        ), {}, 0.15 * share)  # fmt: skip
            if b not in known and frame == c.machine.n:
                yield _last_link_in_any_direction(c, b)
            if joint is not None and np.ptp(c.recording.q[:, frame - 1]) > 0:
                yield from _softer_over_a_stretch(c, frame, b)
        if joint is not None and not joint.prismatic and float(np.ptp(c.recording.q[:, frame - 1])) > HALF_A_CYCLE:
            yield from _softer_one_way(c, frame)
        acting = [b for b in loads_on(c, frame) if b not in known]
        if len(acting) > 1:
            diagonal = tuple(Column("frame", "load", {"frame": frame, "component": b}, frame, b) for b in acting)
            yield Candidate("missing_compliance", name, there, None, "load", diagonal, {}, 2.0)


def between_posts(c: Context, frame: int, b: int) -> list[tuple[Column, Column]]:
    """A frame gives way more to a load, in the load's own direction, by each wave of its joint's position: a rail
    between its posts. In the order of their halves over the travel."""
    travel = float(np.ptp(c.recording.q[:, frame - 1]))
    of = {"frame": frame, "component": b, "joint": frame - 1}
    every = [{**of, "period": 2.0 * travel / halves} for halves in range(1, MOST_POSTS + 1)]
    return [
        (
            Column("frame", "load_wave", {**wave, "phase": "sin"}, frame, b),
            Column("frame", "load_wave", {**wave, "phase": "cos"}, frame, b),
        )
        for wave in every
    ]


def _last_link_in_any_direction(c: Context, b: int) -> Candidate:
    """What bends last moves all reflectors as one body, and so does a rival by the same load that moves each by itself:
    in six directions for its nine (a flange without a name in a forty-seventh and a forty-eighth author's)."""
    frame = c.machine.n
    ways = tuple(Column("frame", "load", {"frame": frame, "component": b}, frame, way) for way in range(6))
    name = c.machine.joint_names[-1]
    return Candidate("missing_compliance", name, name, None, WRENCH_COMPONENTS[b], ways, {}, 0.3)


def _softer_over_a_stretch(c: Context, frame: int, b: int) -> Iterator[Candidate]:
    """A link that gives way more to a load where its joint stands near some place, in the load's own direction."""
    joint = c.machine.joints[frame - 1]
    q = c.recording.q[:, frame - 1]
    low, travel = float(q.min()), float(np.ptp(q))
    for part, width in itertools.product(PLACES, STRETCHES):
        place = {"at": low + part * travel, "width": width * travel}
        args = {"frame": frame, "component": b, "joint": frame - 1, **place}
        yield Candidate(
            "missing_compliance", joint.name, joint.name, COMPONENTS[b], WRENCH_COMPONENTS[b],
            (Column("frame", "load_near", args, frame, b),), place, 0.3 / (len(PLACES) * len(STRETCHES)),
        )  # fmt: skip


def _softer_one_way(c: Context, frame: int) -> Iterator[Candidate]:
    """A turning joint whose bearing gives way more to tilt in one direction of its housing."""
    joint = c.machine.joints[frame - 1]
    across = [b for b in loads_on(c, frame) if b >= 3 and b != nearest_component(c, frame - 1)]
    if not across:
        return
    columns = tuple(
        Column("frames", "bearing", {"frame": frame, "joint": frame - 1, "phase": p}) for p in ("cos", "sin")
    )
    where = ("missing_compliance", joint.name, joint.name, None, WRENCH_COMPONENTS[across[0]])
    yield Candidate(*where, columns, {}, 0.3)
