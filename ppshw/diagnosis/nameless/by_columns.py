"""Any smooth function of a column or two: at base and tip, along a joint, of what no name is about anywhere."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

from ppshw.diagnosis.library.candidate import Candidate
from ppshw.diagnosis.library.sampled import (
    came_from_both_sides,
    loads_on,
    moving_joints,
    nobody_knows,
    own_component,
    temperature_places,
    within,
)
from ppshw.diagnosis.nameless.rival import (
    KNOTS,
    bumps,
    came_from,
    columns_of,
    ends,
    late_columns,
    rival,
    smooth_pair,
    stands_still,
    without_a_place,
)
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.terms.shapes import Column, Context

ALONG_IT = 9  # bumps over a travel
FROM_WITHIN = 0.05  # share of a temperature of an inner joint by which the base is said to move


def of_one_column(c: Context) -> Iterator[Candidate]:
    anywhere = without_a_place(c)
    for name in [*columns_of(c), *late_columns(c)]:
        frames = range(c.machine.n + 1) if name in anywhere else (0, c.machine.n)
        for frame, comp in itertools.product(frames, range(6)):
            yield rival(c, frame, comp, (name,), bumps(name, frame, comp))
            if name in anywhere:  # where five bumps are many, in proportion
                yield rival(c, frame, comp, (name,), (Column("frame", "covariate", {"name": name}, frame, comp),))


def along_a_joint(c: Context) -> Iterator[Candidate]:
    anywhere, before = without_a_place(c), came_from(c)
    columns = [name for name in (*columns_of(c), *late_columns(c)) if name not in anywhere or name in before]
    for k, joint in moving_joints(c):
        frame, comp = k + 1, own_component(c, k)
        for name in nobody_knows(c):  # in waves of its position, say, as a field that turns a resolver's reading
            args = {"first": name, "second": f"q_{joint}", "a": 0, "count": ALONG_IT, "in_proportion": True}
            yield rival(c, frame, comp, (name, f"q_{joint}"), [
                Column("frame", "covariate_pair", {**args, "b": b}, frame, comp) for b in range(ALONG_IT)
            ])  # fmt: skip
        for name in columns:
            if name not in (f"q_{joint}", "time"):  # the base model's own, and the waves of by_time
                if name not in before:
                    yield rival(c, frame, comp, (f"q_{joint}", name), bumps(name, frame, comp))
                args = {"first": name, "second": f"q_{joint}", "a": 0, "b": 0, "count": 1}
                yield rival(c, frame, comp, (f"q_{joint}", name), [
                    Column("frame", "covariate", {"name": name}, frame, comp),
                    Column("frame", "covariate_pair", args, frame, comp),
                ])  # fmt: skip


def base_in_all_directions(c: Context, without: frozenset[str] = frozenset()) -> Iterator[Candidate]:
    """The base shifts with one column, each direction by a function of its own: nobody knows its axes. With what no
    name is about it may tilt as well, by functions of their own or in proportion: with time, too, where drift has none
    (a base that crept was growth of the next link in all directions, 0.81; a sixty-third author's 020). What warms
    within the machine is unlikely to move what it stands on."""
    strange = [*nobody_knows(c), *["time"] * ("drift" in without)]
    slow = ["time", *strange, *(s for s in [*columns_of(c), *late_columns(c)] if "temp_" in s)]
    for name in dict.fromkeys(slow):
        whole: dict[str, object] = {"name": name}
        bent = [{**whole, "count": 3, "knot": j} for j in range(3)]
        share = FROM_WITHIN if name.endswith(within(c.machine)) else 1.0
        ways = [(range(3), bent)]
        ways += [(range(6), bent), (range(6), [whole])] if name in strange else []
        if name in strange and stands_still(c, name):
            ways.append((range(6), [{**whole, "count": KNOTS, "knot": j, "evenly": True} for j in range(KNOTS)]))
        for directions, forms in ways:
            moves = [Column("frame", "covariate", args, 0, comp) for args in forms for comp in directions]
            yield replace(rival(c, 0, None, (name,), moves), share=share)


def with_another_position(c: Context) -> Iterator[Candidate]:
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
        if came_from_both_sides(c, k):
            ways += [(f"approach_{name}", comp) for comp in directions]
        for what, comp in ways:
            args = {"first": what, "second": f"q_{other}", "a": 0, "b": 0, "count": 1}
            product = Column("frame", "covariate_pair", args, frame, comp)
            yield rival(c, frame, comp, (what, f"q_{other}"), (product,))
    strange = [*nobody_knows(c), *(f"late_1_{name}" for name in nobody_knows(c))]
    inner = [k + 1 for k, _ in moving_joints(c) if k + 1 < c.machine.n]
    for frame, what, (_, joint), comp in itertools.product(inner, strange, moving_joints(c), range(6)):
        args = {"first": what, "second": f"q_{joint}", "a": 0, "b": 0, "count": 1}
        product = Column("frame", "covariate_pair", args, frame, comp)
        yield rival(c, frame, comp, (what, f"q_{joint}"), (product,))


def _smooth_pairs(c: Context) -> list[tuple[str, str]]:
    joints = [f"q_{name}" for _, name in moving_joints(c)]
    others = ["time", *(s for s in columns_of(c) if s.startswith(("temp_", "F", "M")))]
    loads = [s for s in others if s in WRENCH_COMPONENTS]
    return [
        *itertools.combinations(joints, 2), *itertools.product(joints, others),
        *((a, b) for a in loads for b in others if b not in WRENCH_COMPONENTS),
    ]  # fmt: skip


def of_two_columns(c: Context) -> Iterator[Candidate]:
    smooth = _smooth_pairs(c)
    for first, second in smooth:
        for frame, comp in ends(c)[6:]:
            yield smooth_pair(c, frame, comp, first, second)
    for k, name in moving_joints(c):  # a guide wears
        for comp in range(6) if k + 1 < c.machine.n else ():
            yield smooth_pair(c, k + 1, comp, f"q_{name}", "time")
    known = {*smooth, *((b, a) for a, b in smooth)}
    for first, second in itertools.combinations(columns_of(c), 2):
        for frame, comp in ends(c)[:6] if (first, second) in known else ends(c):
            args = {"first": first, "second": second, "a": 0, "b": 0, "count": 1}
            product = Column("frame", "covariate_pair", args, frame, comp)
            yield rival(c, frame, comp, (first, second), (product,))
