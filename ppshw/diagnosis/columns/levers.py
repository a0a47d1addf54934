"""Units of forces beside those of moments: by where loads hang, and by the machine that gives way to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

from ppshw.diagnosis.columns.halves import left_of_the_others, roughly, surely_less
from ppshw.diagnosis.columns.mistake import Mistake
from ppshw.diagnosis.columns.payloads import (
    FORCES,
    KILO,
    MILLI,
    MOMENTS,
    MOST_KN,
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


@dataclass(frozen=True)
class Units:
    """What forces and moments may be in instead, and by which factors they are set right."""

    forces: tuple[str, float] | None
    moments: tuple[str, float] | None

    @property
    def ratio(self) -> float:
        """How many times as far from the sensor loads seem to hang."""
        (_, force), (_, moment) = self.forces or ("", 1.0), self.moments or ("", 1.0)
        return force / moment


POUNDS = ("is in pounds-force, expected newtons", POUND_N)
POUND_INCHES = ("is in pound-force inches, expected newton metres", POUND_INCH_NM)
ANY = (
    Units(("is in kilograms, expected newtons", STANDARD_GRAVITY), None),
    Units(POUNDS, POUND_INCHES),
    Units(None, ("is in newton centimetres, expected newton metres", 1e-2)),
)
KILONEWTONS, NEWTON_MILLIMETRES = Units((KILO, 1e3), None), Units(None, (MILLI, 1e-3))


def with_their_units(
    machine: Machine, recording: Recording, found: Sequence[Mistake]
) -> tuple[Recording, list[Mistake]]:
    """The recording with its forces and moments in units that go together, and what is wrong with them, beside what was
    found before.

    Loads that seem to hang farther from the sensor than they do are tried in every pair of units that has them near
    it, and set right in that of which the base model leaves least, if it surely leaves less than as they were read; as
    what the levers alone took for kilonewtons or newton millimetres was.
    """
    kept = [m for m in found if not m.what.startswith((f"{KILO} (", f"{MILLI} ("))]
    given = reduce(_undone, (m for m in found if m not in kept), recording)
    if not has(given, FORCES) or not loaded(given, MOMENTS, LOADED_NM):
        return recording, list(found)
    lever, force = hanging_at(machine, given)
    if lever <= FARTHEST_M:
        return recording, list(found)
    thousand = KILONEWTONS if force < MOST_KN else NEWTON_MILLIMETRES
    likely = [units for units in (*ANY, thousand) if NEAREST_M < lever / units.ratio < FARTHEST_M]
    sound, _ = without_gross_errors(machine, given)
    before = left_of_the_others(machine, sound, roughly)
    tried = [(surely_less(before, left_of_the_others(machine, _in(sound, units), roughly)), units) for units in likely]
    sure = [(float(left[1]), float(left[0]), units) for (_, left, is_so), units in tried if is_so]
    if not sure:
        return recording, list(found)
    after, before_it, units = min(sure, key=lambda one: one[0])
    far = f"(loads would hang {lever:.1f} m off the sensor)"
    wrong = [(columns, *one) for columns, one in ((FORCES, units.forces), (MOMENTS, units.moments)) if one]
    mistakes = [Mistake(named(columns), factor, f"{what} {far}", before_it, after) for columns, what, factor in wrong]
    return _in(given, units), [*kept, *mistakes]


def _undone(recording: Recording, mistake: Mistake) -> Recording:
    columns = FORCES if mistake.column == named(FORCES) else MOMENTS
    return times(recording, columns, 1.0 / (mistake.factor or 1.0))


def _in(recording: Recording, units: Units) -> Recording:
    """The recording set right as one whose forces and moments were in these."""
    for columns, one in ((FORCES, units.forces), (MOMENTS, units.moments)):
        recording = times(recording, columns, one[1]) if one else recording
    return recording
