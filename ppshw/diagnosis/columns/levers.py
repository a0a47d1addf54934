"""Units of forces beside those of moments: by where loads hang, and by the machine that gives way to them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce

from ppshw.diagnosis.columns.halves import left_of_the_others, roughly, surely_less
from ppshw.diagnosis.columns.mistake import Mistake
from ppshw.diagnosis.columns.payloads import (
    FORCES,
    MOMENTS,
    a_thousandfold,
    hanging_at,
    has,
    loaded,
    named,
    times,
)
from ppshw.identification.plausible import LOADED_NM, without_gross_errors
from ppshw.machine import Machine
from ppshw.recording import Recording

# How far from the sensor loads hang at the middle visit: 0.04 to 0.90 m in 200 recordings of nine authors.
FARTHEST_M, NEAREST_M = 1.2, 0.02
STANDARD_GRAVITY, POUND_N, POUND_INCH_NM = 9.80665, 4.4482216, 0.11298483  # exactly, and by the pound's 0.45359237 kg

Wrong = tuple[tuple[int, ...], str, float]  # columns, what they are in, and by which factor they are set right
ANY: tuple[tuple[Wrong, ...], ...] = (
    ((FORCES, "is in kilograms, expected newtons", STANDARD_GRAVITY),),
    (
        (FORCES, "is in pounds-force, expected newtons", POUND_N),
        (MOMENTS, "is in pound-force inches, expected newton metres", POUND_INCH_NM),
    ),
    ((MOMENTS, "is in newton centimetres, expected newton metres", 1e-2),),
)
THOUSANDFOLD = {(named(FORCES), 1e3), (named(MOMENTS), 1e-3)}  # columns and factors of `a_thousandfold`


def with_their_units(
    machine: Machine, recording: Recording, found: Sequence[Mistake]
) -> tuple[Recording, list[Mistake]]:
    """The recording with its forces and moments in units that go together, and what is wrong with them, beside what was
    found before.

    Loads that seem to hang farther from the sensor than they do are tried in every pair of units that has them near
    it, and set right in that of which the base model leaves least, if it surely leaves less than as they were read; as
    what the levers alone took for kilonewtons or newton millimetres was.
    """
    kept = [m for m in found if (m.column, m.factor) not in THOUSANDFOLD]
    given = reduce(_undone, (m for m in found if m not in kept), recording)
    if not has(given, FORCES) or not loaded(given, MOMENTS, LOADED_NM):
        return recording, list(found)
    lever, force = hanging_at(machine, given)
    if lever <= FARTHEST_M:
        return recording, list(found)
    thousandfold = a_thousandfold(force)
    some = [*ANY, *([(thousandfold,)] if thousandfold else [])]
    likely = [units for units in some if NEAREST_M < lever / _times_as_far(units) < FARTHEST_M]
    sound, _ = without_gross_errors(machine, given)
    before = left_of_the_others(machine, sound, roughly)
    tried = [(surely_less(before, left_of_the_others(machine, _in(sound, units), roughly)), units) for units in likely]
    sure = [(float(left[1]), float(left[0]), units) for (_, left, is_so), units in tried if is_so]
    if not sure:
        return recording, list(found)
    after, before_it, units = min(sure, key=lambda one: one[0])
    far = f"(loads would hang {lever:.1f} m off the sensor)"
    mistakes = [Mistake(named(columns), factor, f"{what} {far}", before_it, after) for columns, what, factor in units]
    return _in(given, units), [*kept, *mistakes]


def _undone(recording: Recording, mistake: Mistake) -> Recording:
    columns = FORCES if mistake.column == named(FORCES) else MOMENTS
    return times(recording, columns, 1.0 / (mistake.factor or 1.0))


def _in(recording: Recording, units: Sequence[Wrong]) -> Recording:
    """The recording set right as one whose forces and moments were in these."""
    for columns, _, factor in units:
        recording = times(recording, columns, factor)
    return recording


def _times_as_far(units: Sequence[Wrong]) -> float:
    """How many times as far from the sensor loads seem to hang."""
    return math.prod(factor if columns == FORCES else 1.0 / factor for columns, _, factor in units)
