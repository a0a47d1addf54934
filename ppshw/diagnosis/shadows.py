"""What a finding's form leaves is no other effect: whose shadow a candidate beside a louder finding is."""

from __future__ import annotations

import math

import numpy as np

from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.found import LOST_MOTION, Found
from ppshw.diagnosis.kinship import never_turned, of_its_kind
from ppshw.diagnosis.library import LOADS, Candidate
from ppshw.diagnosis.library.sampled import within
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.terms.shapes.covariates import speaks_of, whose

# Beside a large effect a small one is more likely what the large one's form leaves of it than another effect.
SAME_EFFECT = 0.5
# What is left beside a finding that spoke so many times louder, and sits in the same joint or acts by the same cause,
# is what the finding's form got wrong, not another effect.
# A short wave, though, is not what anything else's form leaves over the same joint, nor a jump what growth leaves in
# another direction (another author's 66003): there a fifth of it. What has no name has no near forms either and leaves
# twice as much.
# What heat did while nobody measured, in a break, shows over time beside it, in any joint; what a wandering base leaves
# over hours shows as creep of a whole rail.
SHADOW, OF_A_WAVE, LEFT_OF_A_RIDDLE, ANYWHERE = 0.1, 0.2, 2.0, 0.1
OF_HEAT_OR_LOAD = frozenset({"thermal_growth", "creep"})
OF_THE_WAY = frozenset({*LOST_MOTION, "periodic_transmission"})  # what goes with a joint's own way or place alone
ALIKE = 0.98  # cosine of what two ways to move do to the reflectors
AT_ONCE = 0.02  # of the recording's duration: moments that are one


def caster_of(tried: Tried, best: int, evidence: float, found: list[Found]) -> Found | None:
    """The finding whose shadow a candidate is, if it is one."""
    candidate = tried.candidates[best]
    unturned, inside = never_turned(tried.space.machine), within(tried.space.machine)
    for f in found:
        other = tried.candidates[f.best]
        if candidate.effect == other.effect == "target_moved" and candidate.covariate == other.covariate:
            return f  # a reflector that moves now and again
        of = {whose(name) for name in candidate.covariate.split(" × ")}
        same_joint = other.joint is not None and (candidate.joint == other.joint or other.joint in of)
        by_load = other.effect in LOADS and (candidate.effect in LOADS or candidate.covariate in WRENCH_COMPONENTS)
        same_cause = candidate.covariate == other.covariate or at_once(tried, candidate, other)
        alike = candidate.effect == other.effect and candidate.covariate == other.covariate
        if by_load and not same_joint and not alike and _left_there(tried, other, "on_") < SAME_EFFECT * evidence:
            by_load = same_cause = False
        if candidate.joint != other.joint and candidate.frame != other.frame:  # elsewhere, over this joint's position
            same_joint = same_joint and _left_there(tried, other) >= SAME_EFFECT * evidence
        if candidate.effect in OF_HEAT_OR_LOAD and other.effect in OF_THE_WAY:  # which neither tells of
            same_joint = False
        if other.effect == "zero_shift":  # at once along the own way: nothing elsewhere but in time
            same_joint = same_joint and (same_place(candidate, other) or candidate.covariate == "time")
        riddle = other.effect == "nameless" and of_a_riddle(candidate, other)
        # what a base that wanders leaves may by chance go with a temperature
        wanders = other.effect == "drift" and candidate.frame == other.frame and "temp_" in candidate.covariate
        heat = other.effect == "thermal_growth" and candidate.covariate == "time"
        by_rail = other.effect == "drift" and candidate.frame in unturned.frames[1:]
        if heat and acts_alike(tried, candidate, other):  # how warm its link was when nobody measured yet
            same_joint = True
        slowly = heat or (by_rail and candidate.effect == "creep" and candidate.component is None)
        # a seat that each load finds anew follows anything slow, if loads lie there for long
        seats = candidate.frame == other.frame and all(column.function == "seated" for column in candidate.columns)
        wave = candidate.effect == "periodic_transmission" != other.effect
        apart = wave or _leaps_elsewhere(tried, candidate, other)
        least = SHADOW * f.first * (OF_A_WAVE if apart else LEFT_OF_A_RIDDLE if riddle else 1.0)
        more = candidate.effect == "nameless" and of_its_kind(other, candidate, unturned, inside)
        if more and same_place(candidate, other) and evidence < SAME_EFFECT * f.first:
            return f  # more of the same, by what the name means
        if (same_joint or by_load or same_cause or riddle or wanders or seats) and evidence < least:
            return f
        if slowly and evidence < ANYWHERE * least:
            return f
    return None


def _left_there(tried: Tried, other: Candidate, over: str = "") -> float:
    """Log evidence of the best function without a name at a finding's own place, over columns that begin so (the load
    that it bears): what its form leaves is one. Infinite for what acts at no single place."""
    if other.joint is None:
        return math.inf
    evidence, _ = tried.said()
    there = [
        j for j, k in enumerate(tried.candidates)
        if k.effect == "nameless" and k.frame == other.frame and other.component in (None, k.component)
        and k.covariates[0].startswith(over)
    ]  # fmt: skip
    return max((float(evidence[j]) for j in there), default=math.inf)


def at_once(tried: Tried, one: Candidate, other: Candidate) -> bool:
    """Whether both happen at a moment, and at the same: what was knocked is displaced, not lost."""
    if "time_h" not in one.shape or "time_h" not in other.shape:
        return False
    return abs(one.shape["time_h"] - other.shape["time_h"]) < AT_ONCE * float(np.ptp(tried.space.context.hours))


def acts_alike(tried: Tried, one: Candidate, other: Candidate) -> bool:
    """Whether both move the reflectors alike, in one component of a frame each: a link that bends about the axis of
    the next joint is as that joint's zero."""
    columns = (*one.columns, *other.columns)
    ways = [{(column.frame, column.component) for column in k.columns} for k in (one, other)]
    if any(column.on != "frame" for column in columns) or any(len(way) != 1 for way in ways):
        return False
    a, b = (tried.space.context.moved(*next(iter(way))) for way in ways)
    return abs(float((a * b).sum())) > ALIKE * float(np.linalg.norm(a) * np.linalg.norm(b))


def _leaps_elsewhere(tried: Tried, candidate: Candidate, other: Candidate) -> bool:
    """Whether a joint's zero jumps once and for good, and not along what grows: no thermometer leaps."""
    leaps = candidate.effect == "zero_shift" and [column.function for column in candidate.columns] == ["step"]
    grows = other.effect == "thermal_growth" and other.component is not None
    return leaps and grows and not same_place(candidate, other) and not acts_alike(tried, candidate, other)


def of_a_riddle(candidate: Candidate, other: Candidate) -> bool:
    """What a function without a name leaves: something in the same component, over the same columns, by a load where it
    goes with one, and over time where it goes with a temperature, lags, or a reflector wanders."""
    over = any(speaks_of(name, candidate.covariate) for name in other.covariates)
    slow = any(name.startswith(("late_", "temp_")) for name in other.covariates)
    slow = slow or any(column.function == "target_shift" and "plumb" not in column.args for column in other.columns)
    by_load = goes_with_a_load(other) and (candidate.effect in LOADS or candidate.covariate in WRENCH_COMPONENTS)
    return same_place(candidate, other) or over or by_load or (slow and candidate.covariate == "time")


def goes_with_a_load(riddle: Candidate) -> bool:
    """Whether one of the columns of what has no name is a load, at the sensor or on a frame, late or not."""
    return any(name.rsplit("_", 1)[-1] in WRENCH_COMPONENTS for name in riddle.covariates)


def same_place(one: Candidate, other: Candidate) -> bool:
    """Whether both move the same component of the same frame; what is at no frame is nowhere."""
    return one.component is not None and (one.frame, one.component) == (other.frame, other.component)
