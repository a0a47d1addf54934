"""Rivals without a name: what any smooth function of the columns and their history would explain.

    rival.py              what a rival is, and the columns that it may go over
    by_columns.py         any function of a column or two
    by_time.py            rhythms, changes at a moment
    by_motion.py          seats, the side that a joint came from, its own work
    by_position.py        finer functions of positions, of one to three joints; dents
    by_load.py            loads on a frame, what the force sensor read, what pulls
    at_the_reflectors.py  reflectors, the instrument, the air between

Any smooth function of columns, of their history, of loads and of time, at the frames that may move by it; what the
force sensor, the reflectors and the instrument may do. A test that does not know the catalogue: what it finds is
located by its columns. docs/diagnosis-method.md §1.3.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

from ppshw.diagnosis.library.by_position import FineWave
from ppshw.diagnosis.library.candidate import Candidate, all_kept
from ppshw.diagnosis.library.jumps import Jumps
from ppshw.diagnosis.nameless.at_the_reflectors import at_the_reflectors
from ppshw.diagnosis.nameless.by_columns import (
    along_a_joint,
    base_in_all_directions,
    of_one_column,
    of_two_columns,
    with_another_position,
)
from ppshw.diagnosis.nameless.by_load import by_own_weight, in_proportion, mounted, of_what_was_read, pulls, under_load
from ppshw.diagnosis.nameless.by_motion import own_heat, random_seats, reversals, where_it_rests
from ppshw.diagnosis.nameless.by_position import dents, finely, of_three_positions, of_two_positions, splices
from ppshw.diagnosis.nameless.by_time import at_a_moment, rhythms
from ppshw.terms.shapes import Context

__all__ = ["nameless"]


@all_kept()
def nameless(
    c: Context, jumps: Sequence[Jumps] = (), waves: Sequence[FineWave] = (), without: frozenset[str] = frozenset()
) -> list[Candidate]:
    """All rivals without a name for a recording: kinds share alike, and candidates in a kind as they say; shares add up
    to one.

    jumps    moments of several jumps of a joint that the recording speaks for most
    waves    finer than every joint is asked for, where they may have no name
    without  effects that have no name: what a link that the file has rigid does in proportion to its load may need
             none, and a base that moves with time
    """
    at_some_moments = partial(at_a_moment, jumps=jumps)
    makers: list[Callable[[Context], Iterator[Candidate]]] = [
        of_one_column, along_a_joint, partial(base_in_all_directions, without=without), at_some_moments, rhythms,
        random_seats, reversals, under_load, by_own_weight, mounted, of_what_was_read, pulls, own_heat,
        with_another_position, of_two_columns,
        partial(finely, waves=waves), dents, splices, of_two_positions, of_three_positions, at_the_reflectors,
        where_it_rests,
    ]  # fmt: skip
    if "missing_compliance" in without:
        makers.append(in_proportion)
    kinds = [kind for kind in (list(make(c)) for make in makers) if kind]
    for kind in kinds:
        whole = sum(k.share for k in kind)
        for k in kind:
            k.share /= len(kinds) * whole
    return [k for kind in kinds for k in kind]
