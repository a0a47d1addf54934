"""Columns with the wrong sign or the wrong unit, looked for before anything else: the ideal machine is right to a few
centimetres, a payload hangs down, and a mistake of a whole column is not to be explained by physics.

    mistake.py    what is wrong, in words and in the contract's form
    positions.py  joints and reflectors, by where the ideal machine has them
    sides.py      directions of approach, by the ways that joints went
    payloads.py   forces and moments, by what a payload may be
    levers.py     their units, by the machine that gives way to them where loads would hang far off
    moments.py    their sign, by the same
    halves.py     what the base model of half of the visits leaves of the others

A payload's moments fit its forces with either sign, as a load on the other side; which it is the machine says, that
gives way to them. What cannot be told: a single moment's sign where the sensor stays level; the scale of all forces
and moments, which is another load.
"""

from __future__ import annotations

from ppshw.diagnosis.columns.levers import with_their_units
from ppshw.diagnosis.columns.mistake import Mistake
from ppshw.diagnosis.columns.moments import doubts_of_moments, with_their_sign
from ppshw.diagnosis.columns.payloads import doubts_of_gravity, mistaken_units, mistaken_wrenches
from ppshw.diagnosis.columns.positions import a_row_off, askew, exchanged_at_times, mistaken_positions
from ppshw.diagnosis.columns.sides import mistaken_sides
from ppshw.identification.plausible import is_another_machine, refuse_frozen
from ppshw.machine import Machine
from ppshw.recording import Recording

__all__ = ["Mistake", "column_mistakes", "doubts_of_gravity", "doubts_of_moments", "plain_mistakes"]


def column_mistakes(machine: Machine, recording: Recording) -> tuple[Recording, list[Mistake]]:
    """The recording with its columns set right, and what was wrong with them; one mistake after the other.

    Whether moments have the sign of their forces is asked of the base model, which takes some seconds, and whether both
    are in units that go together where loads would hang far off. Raises RecordingError where the recording can be none
    of this machine's even so.
    """
    return with_their_sign(machine, *with_their_units(machine, *plain_mistakes(machine, recording)))


def plain_mistakes(machine: Machine, recording: Recording) -> tuple[Recording, list[Mistake]]:
    """The same by what needs no fit: the sign of all moments together is not asked for, and said to be open where the
    forces have the opposite one. What leaves the recording none of this machine's is no correction."""
    refuse_frozen(machine, recording)
    at_first = recording
    recording, found = a_row_off(machine, recording)
    recording, exchanged = exchanged_at_times(machine, recording)
    found += exchanged
    given, before = recording, list(found)
    for look in (mistaken_positions, mistaken_wrenches, mistaken_units):
        for _ in range(3):
            tried = list(look(machine, recording))
            best = min(tried, key=lambda pair: pair[0].after + askew(machine, pair[1]), default=None)
            if best is None or best[0].after > best[0].asked * best[0].before:
                break
            mistake, recording = best
            found.append(mistake)
        # of some rows only, or of more
        if look is mistaken_positions and found and is_another_machine(machine, recording):
            recording, found = given, list(before)
    recording, turned = mistaken_sides(at_first, recording)
    return recording, found + turned
