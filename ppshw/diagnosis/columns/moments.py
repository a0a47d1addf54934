"""The sign of all moments together: by either the loads may hang there, and which it is the machine says."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.columns.halves import FARTHEST, left_of_the_others, of_each_load, plainly, roughly, surely_less
from ppshw.diagnosis.columns.mistake import SIGN, Mistake
from ppshw.diagnosis.columns.payloads import FORCES, MOMENTS, TOO, has, loaded, named, times
from ppshw.identification.own_weight import fitted
from ppshw.identification.plausible import LOADED_NM, without_gross_errors
from ppshw.machine import Machine
from ppshw.recording import Recording

Array = NDArray[np.float64]
TOLD = 1.01  # times as much that one sign must leave for two to be told apart at all
FEWEST = 10  # visits of which a standard error says something


def with_their_sign(
    machine: Machine, recording: Recording, found: Sequence[Mistake]
) -> tuple[Recording, list[Mistake]]:
    """The recording with its moments' sign set right, and what is wrong with it: that, beside what was found before."""
    found = list(found)
    sound, _ = without_gross_errors(machine, recording)
    if not has(recording, MOMENTS) or not loaded(recording, MOMENTS, LOADED_NM):
        return recording, found
    forces = next((m for m in found if m.column == named(FORCES) and m.factor == -1.0), None)
    first = roughly if forces is None else plainly  # the moments' sign goes by the forces' unless it is told apart
    _, (given, other), sure = _by_either_sign(sound, lambda r: left_of_the_others(machine, r, first))
    if sure:  # other weights than those that bend the machine may look so too
        _, (given, other), sure = _by_either_sign(sound, lambda r: left_of_the_others(machine, r, fitted))
    if forces is None and sure:  # how a load that a half never saw bends the machine is a guess where there are few
        _, (seen_given, seen_other), _ = _by_either_sign(
            sound, lambda r: left_of_the_others(machine, r, first, of_each_load)
        )
        sure = bool(seen_given > seen_other)
    if forces is None and sure:
        alone, less = min(((k, _turned(machine, sound, k)) for k in MOMENTS), key=lambda pair: pair[1])
        columns, after = ((alone,), less) if TOLD * less < other else (MOMENTS, float(other))
        found.append(Mistake(named(columns), -1.0, SIGN[-1.0], float(given), after))
        return times(recording, columns, -1.0), found
    if forces is None:
        return recording, found
    turned = other < TOLD * given  # a sensor mounted the other way round turns all six
    what = SIGN[-1.0] + (TOO if turned and given <= TOLD * other else "")
    found[found.index(forces)] = replace(forces, column=named(range(6) if turned else FORCES), what=what)
    return (times(recording, MOMENTS, -1.0) if turned else recording), found


def doubts_of_moments(recording: Recording, left: Callable[[Recording], Array]) -> list[str]:
    """A line where a calibration leaves less of the recording with its moments' signs turned.

    left  what the calibration leaves of every visit of a recording (V,) [m], nan of one without a reading
    """
    if not has(recording, MOMENTS) or not loaded(recording, MOMENTS, LOADED_NM):
        return []
    if recording.measured.sum() < FEWEST:
        return []
    (given, other), _, sure = _by_either_sign(recording, left)
    if not sure:
        return []
    return [f"the columns {named(MOMENTS)} seem to have the opposite sign to those of the recording that the "
            f"calibration was made from: it leaves {1e3 * given:.3f} mm rms, with the signs turned "
            f"{1e3 * other:.3f}"]  # fmt: skip


def _by_either_sign(recording: Recording, left: Callable[[Recording], Array]) -> tuple[Array, Array, bool]:
    """See `surely_less`: as the moments are, and with their signs turned."""
    return surely_less(*(left(r) for r in (recording, times(recording, MOMENTS, -1.0))))


def _turned(machine: Machine, recording: Recording, column: int) -> float:
    """What is left with the sign of one column turned alone, rms [m] with the farthest as far as the others."""
    left = left_of_the_others(machine, times(recording, (column,), -1.0), fitted)
    left = left[np.isfinite(left)]
    return float(np.sqrt((np.minimum(left, np.quantile(left, FARTHEST)) ** 2).mean()))
