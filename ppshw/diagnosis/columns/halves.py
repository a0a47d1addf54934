"""What the base model of half of a recording's visits leaves of the other half, as its columns are and changed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ppshw.evaluation import by_visit
from ppshw.identification.joint import Estimate, estimate
from ppshw.identification.start import to_base
from ppshw.identification.structure import joint_model
from ppshw.machine import Machine
from ppshw.recording import Recording
from ppshw.terms import Situation

Array = NDArray[np.float64]
# With the moments' right sign the base model, identified from half of so many visits in blocks, leaves less of the
# other half: in 34 recordings of another author the other one left 1.02 to 6.3 times as much, in 29 of them 1.04 and
# more. (Of the visits that it was identified from it may leave less with the wrong one: 0.89 times as much beside a
# zero that jumped.) How much less it must leave for the given columns to be wrong, and by how many standard errors.
ASKED, IN_A_ROW, LESS, SURE = 400, 15, 1.04, 3.0
BLOCKS = 5  # of the visits of a load, where there are not many
FIRST_ROUNDS = 3  # of the estimates that ask first; where columns may be wrong, others go on to the end
FARTHEST = 0.9  # share of the visits, the others counting as these


def surely_less(given: Array, changed: Array) -> tuple[Array, Array, bool]:
    """Of what is left of every visit (V,) [m], as its columns are and changed: rms (2,) [m] of all visits and with the
    farthest as far as the others, and whether the latter is surely less when they are changed."""
    both = np.stack([given, changed])
    both = both[:, np.isfinite(both).all(axis=0)]
    if not both.size:
        return np.zeros(2), np.zeros(2), False
    near = np.minimum(both, np.quantile(both.min(axis=0), FARTHEST))
    all_visits, most = (np.sqrt((each**2).mean(axis=1)) for each in (both, near))
    more = near[0] ** 2 - near[1] ** 2
    sure = more.mean() > SURE * more.std() / np.sqrt(len(more))
    return all_visits, most, bool(most[0] > LESS * most[1] and sure)


def plainly(machine: Machine, sound: Recording, recording: Recording) -> Estimate:
    return estimate(joint_model(machine, sound), recording)


def roughly(machine: Machine, sound: Recording, recording: Recording) -> Estimate:
    return estimate(joint_model(machine, sound), recording, rounds=FIRST_ROUNDS)


def in_blocks(load: Sequence[str]) -> NDArray[np.bool_]:
    """(N,) one of two halves of the visits: blocks, dealt in turn."""
    return np.asarray(np.arange(len(load)) // IN_A_ROW % 2 == 0)


def of_each_load(load: Sequence[str]) -> NDArray[np.bool_]:
    """The same with blocks of the visits of each load, so that both halves have all loads."""
    labels = np.array(load)
    out = np.zeros(len(labels), dtype=bool)
    for label in set(load):
        mine = np.flatnonzero(labels == label)
        length = max(1, min(IN_A_ROW, len(mine) // BLOCKS))
        out[mine] = np.arange(len(mine)) // length % 2 == 0
    return out


def left_of_the_others(
    machine: Machine,
    recording: Recording,
    fit_to: Callable[[Machine, Recording, Recording], Estimate] = plainly,
    halves: Callable[[Sequence[str]], NDArray[np.bool_]] = in_blocks,
) -> Array:
    """(V,) rms [m] of what the base model of half of the visits leaves of every visit of the others."""
    some = recording.subset(np.linspace(0, len(recording) - 1, min(ASKED, len(recording))).astype(int))
    fit = halves(some.load)
    base, others = fit_to(machine, some, some.subset(fit)), some.subset(~fit)
    missed = to_base(others.points, base.measuring_in_base) - base.model.predict(Situation.of(others), base.theta)
    return by_visit(missed)
