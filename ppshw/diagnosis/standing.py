"""Which names stand when all is found: those that no rival without a name says as much in place of."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from ppshw.diagnosis.as_read import surely_reads_other
from ppshw.diagnosis.evidence import HANDICAP, LEAST_FURTHER, Name, Tried
from ppshw.diagnosis.found import LOST_MOTION, Found, by_its_own_form, coefficients, pieces_of, take_up
from ppshw.diagnosis.kinship import (
    OF_A_LOAD,
    WOUND_UP,
    counts,
    never_turned,
    of_its_kind,
    only_shifts,
    stranger_than,
    winds_up,
)
from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.library.lost_motion import SOFTEST_KNOWN
from ppshw.diagnosis.library.sampled import called, within
from ppshw.diagnosis.parameters import along_its_axis, runs_ahead
from ppshw.diagnosis.shadows import SHADOW, goes_with_a_load, same_place
from ppshw.diagnosis.workspace import Workspace
from ppshw.terms import COMPONENTS

Array = NDArray[np.float64]
# When all is found, a name stands only if it is ahead of every rival without one: by e⁴ by its own form, or by an
# eighth of what it says where that is less, or by e¹² with all that it may be like, which is nearly as free as its
# rivals are. Of 115 right names (single effects of 1 and 2 times the repeatability of sealed seeds 37 to 39, and the
# fifteenth author's) none to one is not that far ahead, of 51 wrong ones, most of whose names had been taken out, 12.
AHEAD, AHEAD_OF_QUIET, ALL_AHEAD = 4.0, 0.12, 12.0
# Some effects have neighbours close by that nobody has named (slack that closes softly, stiffness in steps). Where they
# are what is there their rivals are hardly behind: of names in recordings of four authors, in part with the names taken
# out, wrong friction was 5, 5, 6, 8 and 8 ahead (14 and 29 in two), right friction 10.5, 25 and more (19 names);
# wrong clearance 4, 6, 6 and 9, right 11 and more (18; 8.2 in sealed 44065); wrong stiffness 3, 3 and 6, right 8, 11
# and more (14); wrong coupling 1 to 6.5 (four), right 7.5 and more (19). Right play, growth and jumps stand by 3 to 9.
FARTHER_AHEAD = {"friction_hysteresis": 10.0, "clearance": 7.0, "nonlinear_stiffness": 7.0, "cross_coupling": 7.0}
FARTHER_OF_QUIET = 0.5
# Of a loud effect a form with few parameters never says quite as much as functions that bend: a softening joint said
# 2,299.7 and nine bumps 2,301.1 (23058); wrong names in its deck of removed cases were 3.5 % and more behind.
NEARLY = 2e-3
# Near forms may make up for no more than this of what its own says: right names that stood by them were 0.4, 4 and 9 %
# behind a rival by their own form, wrong ones 4, 13 and 14 %.
FAR_BEHIND = 1.11
# In five sealed cases of strangers and none of known effects (seeds of 11 and 12) a name stood beside structure without
# one in the same component of the same frame; sizes were 0.75 to 1.8 times the name's.
RIDDLE = 0.5
# Names beside louder structure without one, in decks of three authors: 5 to 22 of log evidence were wrong in four
# cases, 92 and 102 right.
QUIET = 25.0
# Structure that is louder than thousands is never followed as closely: beside a reflector that slid (140,000 of log
# evidence, its name taken out) the sensor seemed to err, by 29.
LEFT = 1 / 300
# What noise makes once in a thousand recordings or more often says that something is there, hardly what: of names with
# a greater p one was right and seven wrong, of all others 128 and 16 (seed 42 and a nineteenth author, with and without
# names taken out).
NAMED = 1e-3
# What a name says with all that it may be like, as a calibration would carry it: of 297 names in recordings of four
# other authors, in part with the names taken out, ten said less and one of these was right; of the 287 others 239.
WITH_ALL = 6.0
SURE = 3.0  # standard deviations by which a sign is one that physics denies
AS_MUCH = 3.0  # by which friction may say more than play of the same joint that is asked in its place
# What bands of waves say beside a wave, which any function of a position leaves and a period hardly does: beside those
# of errors linear between knots 10 to 33 % of what the wave said (six of two reviewers'), beside waves of four other
# authors less than nothing, beside loud ones whose height grows along the travel 2 to 3 %.
IN_BANDS, IN_BANDS_OF_LOUD = 3.0, 0.05
SIBLING = 10.0  # by which clearance must say more to stand for a stiffness, or the other way round
# Any column that changes slowly is a clock too: that the base moves by it costs a drift its name only where it says so
# much more (an air's pressure said 49.7 and a base that wanders 49.0; 38062).
BY_THE_CLOCK = 5.0


def give_up(space: Workspace, tried: Tried, found: list[Found]) -> None:
    """A name stands while no rival without one says as much in its place as the name does by its bare form, or nearly
    as much as with all its near forms: what any smooth function fits as well is something else. Of one effect that acts
    in several directions the loudest (when it was found) is asked, for all; where it stands the others do. What bears
    the name of one that was given up, for the same cause and saying no more, goes with it, and so does what the others
    then explain. An error of the force sensor that its readings surely show stands."""
    given_up: dict[tuple[str, str], float] = {}
    freely = tried.names.index(("nameless", None))
    stand: set[Name] = set()
    for _ in range(2):
        stand.clear()
        for f in sorted(found, key=lambda f: -f.first):
            cause = f.name[0], tried.candidates[f.best].covariate
            if f.name[0] == "nameless" or f.name in stand:
                continue
            if f.name[0] == "wrench_error":  # whatever goes with a load as well
                sure = surely_reads_other(space, tried, [g for g in found if g is not f])
                take_up(space, tried, found)
                if sure:
                    stand.add(f.name)
                    continue
            if f.p <= NAMED and (both := _as_both(space, tried, f, found, freely)):
                names = {g.name for g in both}
                found[:] = [*(g for g in found if g.name not in names), *both]
                stand |= names
                take_up(space, tried, found)
                continue
            answer = _asked(space, tried, f, found, freely)
            if not answer.stands and f.p <= NAMED and (play := _as_play(tried, f, answer)) is not None:
                again = _asked(space, tried, play, [play if g is f else g for g in found], freely)
                if again.stands:
                    f.best, f.name, f.evidence, f.first = play.best, play.name, play.evidence, play.first
                    f.size, f.more, answer = 0.0, (), again
            if answer.own <= given_up.get(cause, -math.inf) or not answer.stands:
                given_up[cause] = max(answer.own, given_up.get(cause, -math.inf))
                f.was, f.best, f.name, f.evidence, f.first = (
                    f.best, answer.best, tried.names[freely], answer.rival, answer.rival,
                )  # fmt: skip
                f.size, f.more = 0.0, ()
            else:
                stand.add(f.name)
            take_up(space, tried, found)
        if not given_up:
            return
    drop_what_others_explain(space, tried, found)


def drop_what_others_explain(space: Workspace, tried: Tried, found: list[Found]) -> None:
    """What says too little beside the other findings goes; what the force sensor's readings say stays."""
    for f in [g for g in found if not g.read]:
        others = [g for g in found if g is not f]
        own, every = _by_itself(space, tried, f, others)[:2]
        if others and (own if f.name[0] == "nameless" else max(own, every)) < LEAST_FURTHER:
            found.remove(f)
    take_up(space, tried, found)


@dataclass(frozen=True)
class _Answer:
    """own, rival  what a name says by its bare form, and what those without one say [log evidence]; best: the index of
    the strongest of these; stands: whether the name does"""

    own: float
    rival: float
    best: int
    stands: bool


def _asked(space: Workspace, tried: Tried, f: Found, found: list[Found], freely: int) -> _Answer:
    """Whether a finding's name stands beside the others; its other directions are not among these."""
    pieces = pieces_of(f, found)
    others = [g for g in found if g is not f and g not in pieces and not _left_by(tried, f, g)]
    if not pieces:
        _as_its_sibling(space, tried, f, others)
    against = _against_physics(space, tried, f)
    carried_on = _runs_ahead(space, tried, f, others, pieces)
    own, every, evidence = _by_itself(space, tried, f, others, pieces)
    rival, best = _other_than(tried, f, evidence, freely, fully=carried_on)
    by_bare = own
    if pieces and not _bends_as_it_needs(tried, f, pieces):
        by_bare = max(own, _bare(space, tried, f, others, pieces))
    ahead = min(AHEAD, AHEAD_OF_QUIET * own)
    if f.name[0] in FARTHER_AHEAD:
        ahead = min(FARTHER_AHEAD[f.name[0]], FARTHER_OF_QUIET * own)
    slowly = f.name[0] == "drift" and tried.candidates[best].frame == tried.candidates[f.best].frame
    by_form = max((1.0 + NEARLY) * own - ahead, own + BY_THE_CLOCK if slowly else -math.inf)

    def ahead_of(without_name: float, with_near: float) -> bool:
        with_all = min(with_near - ALL_AHEAD, FAR_BEHIND * by_bare)
        return without_name / HANDICAP <= max(by_form, with_all)

    leads = ahead_of(rival, every)
    if leads and f.name[0] in OF_A_LOAD:  # beside rivals in one component by what it says in its own directions
        here = min(every, _here(space, tried, f, others, pieces))
        wide = tried.candidates[best].component is None
        leads = ahead_of(_other_than(tried, f, evidence, freely, in_one=True)[0] if wide else rival, here)
    # Of many near forms what it says by its bare one alone; but where reflectors are the base model may say, too.
    if every < WITH_ALL and (f.name[0] != "target_moved" or space.machine.tracker.targets_known):
        every = max(every, _bare(space, tried, f, others, pieces))
    behind = not leads or against or every < WITH_ALL or f.p > NAMED or _has_no_period(tried, f, own, others, pieces)
    if stands := not (behind or _beside_a_riddle(tried, f, others)):
        return _Answer(own, rival, best, stands)
    best = tried.strongest(evidence, freely)  # what means the same as the name, too, says over which columns it goes
    return _Answer(own, HANDICAP * float(evidence[best] + tried.log_share[best]), best, stands)


def _as_play(tried: Tried, f: Found, answer: _Answer) -> Found | None:
    """The play that friction may as well be, where both say nearly as much: hard play was friction that winds up over
    a hundredth of the travel, by 1.2 of log evidence, and lost both names (two of a reviewer's seventeen). None where
    there is no such. What is beside it is taken up."""
    play = "backlash", f.name[1]
    if f.name[0] != "friction_hysteresis" or play not in tried.names:
        return None
    evidence, names = tried.said()
    said = float(names[k := tried.names.index(play)])
    if said < answer.own - AS_MUCH:
        return None
    return replace(f, best=tried.strongest(evidence, k), name=play, evidence=said, first=said, size=0.0, more=())


def _as_both(space: Workspace, tried: Tried, f: Found, found: list[Found], freely: int) -> list[Found]:
    """Play and friction of the joint of a finding that is one of the two, where both together, each by one column, say
    so much more than either, and than every rival without a name, and both lag; else none. What is beside them is taken
    up.

    Of a joint that has both either alone is behind any function of the way since it turned back, or stands for their
    sum: of 60 µm each they said 1,742 and 1,722 of log evidence, nine bumps 1,753, and both 1,787. Of one of the two as
    three other authors have it both said up to 3 more than that one, once 15, and then one of them ran ahead. What
    is taken up over more than walls give way by is one more bristle of friction (one of six, over a five-hundredth of
    the travel and 36 times what it lost; another author's 55050).
    """
    names = [(effect, f.name[1]) for effect in LOST_MOTION]
    if f.name not in names or not all(name in tried.names for name in names):
        return []
    others = [g for g in found if g.name not in names]
    take_up(space, tried, others)
    evidence, by_name = tried.said()
    play, friction = (float(by_name[tried.names.index(name)]) for name in names)
    as_play = replace(f, best=tried.strongest(evidence, tried.names.index(names[0])), name=names[0])
    rival = _other_than(tried, as_play, evidence, freely)[0] / HANDICAP

    def by(forms: Sequence[int]) -> list[Found]:
        return [replace(f, best=k, name=tried.name(k), size=tried.unit, near=(), more=()) for k in forms]

    def said(forms: Sequence[int]) -> float:
        return _beside(space, tried, by(forms), others) + float(tried.log_share[list(forms)].sum())

    every = [(said(forms), forms) for forms in itertools.product(*(_of_one_column(tried, name) for name in names))]
    if not every:
        return []
    together, best = max(every, key=lambda each: each[0])
    both = by(best)
    if together < max(max(play, friction) + ALL_AHEAD, rival + AHEAD) + LEAST_FURTHER:
        return []
    take_up(space, tried, [*others, *both], and_look=False)
    lags = [float(coefficients(space, tried.candidates[g.best], g)[0][0]) for g in both]
    take_up(space, tried, others)
    bristle = tried.candidates[best[0]].shape.get("width", 0.0) > SOFTEST_KNOWN * 2.0 * abs(lags[0])
    if max(lags) * min(lags) <= 0.0 or bristle:
        return []
    for g, without in zip(both, (friction, play), strict=True):
        g.size, g.p = 0.0, max(f.p, float(np.exp(without - together)))
    return both


def _of_one_column(tried: Tried, name: Name) -> list[int]:
    """Candidates of a name that have one column."""
    mine = np.flatnonzero(tried.name_of == tried.names.index(name))
    return [int(k) for k in mine if len(tried.index[k]) == 1 and np.isfinite(tried.log_share[k])]


def _as_its_sibling(space: Workspace, tried: Tried, f: Found, others: list[Found]) -> None:
    """Of clearance and stiffness the one that says more beside the others, at whichever joint: beside a scale a wrist
    that falls was a stiffness by 2,895 of log evidence where clearance said 2,921, and lost that name to a fall without
    one (another author's 26054)."""
    siblings = [k for k, name in enumerate(tried.names) if name[0] in OF_A_LOAD - {f.name[0]}]
    if f.name[0] not in OF_A_LOAD or not siblings:
        return
    take_up(space, tried, others)
    evidence, names = tried.said()
    best = max(siblings, key=lambda k: float(names[k]))
    if names[best] > names[tried.names.index(f.name)] + SIBLING:
        f.best, f.name, f.first = tried.strongest(evidence, best), tried.names[best], float(names[best])
        f.evidence, f.size, f.more = f.first, 0.0, ()
    take_up(space, tried, [*others, f])


def drop_what_riddles_leave(space: Workspace, tried: Tried, found: list[Found]) -> None:
    """What has no name is only known by functions that bend as they need, and leaves something anywhere: a name that
    speaks more quietly, and quietly by itself, is that. Loads, places and sides come in blocks of time: a name that
    goes with time alone may speak loudly and is that still if it is ten times more quiet. What noise may be (NAMED)
    leaves nothing."""
    riddles = [f for f in found if f.name[0] == "nameless" and f.p <= NAMED]
    named = [f for f in found if f.name[0] != "nameless"]
    if not riddles or not named:
        return

    def said(f: Found) -> float:
        pieces = pieces_of(f, found)
        return _by_itself(space, tried, f, [g for g in found if g is not f and g not in pieces])[0]

    loudest = max(said(f) for f in riddles) / HANDICAP

    def least(f: Found) -> float:
        slow = tried.candidates[f.best].covariate == "time"
        return SHADOW * loudest if slow else max(min(loudest, QUIET), LEFT * loudest)

    quiet = [f for f in named if said(f) < least(f)]
    found[:] = [f for f in found if f not in quiet]
    take_up(space, tried, found)


def _other_than(
    tried: Tried, f: Found, evidence: Array, freely: int, in_one: bool = False, fully: bool = False
) -> tuple[float, int]:
    """What rivals without a name say that are not by what they mean the finding's own effect, for the evidence (C,) of
    all candidates; and the strongest of them.

    in_one  of those alone that act in one component
    fully   all of what they say counts, be they nearly the same motion as the finding's
    """
    mine, machine = tried.candidates[f.best], tried.space.machine
    unturned, inside = never_turned(machine), within(machine)
    forms = [mine, *_next_door(tried, f, evidence)]
    both = not OF_A_LOAD & tried.without
    others = np.array([
        j for j in np.flatnonzero(tried.name_of == freely)
        if not any(of_its_kind(form, tried.candidates[j], unturned, inside, both) for form in forms)
        and not (in_one and tried.candidates[j].component is None)
    ])  # fmt: skip
    counted = np.array([
        1.0 if fully else min(counts(form, tried.candidates[j], unturned) for form in forms) for j in others
    ])  # fmt: skip
    if mine.effect == "friction_hysteresis":  # nearly the same motion of another frame says no more of how it winds up
        wound = np.array([winds_up(mine, tried.candidates[j]) for j in others])
        here = np.max(evidence[others], where=wound & (counted < 1.0), initial=-math.inf)
        counted = np.where(wound & (evidence[others] <= here), np.minimum(counted, WOUND_UP), counted)
    strange = np.array([stranger_than(mine, tried.candidates[j]) for j in others])
    weighed = counted * evidence[others] + tried.log_share[others] - AHEAD * strange
    said = float(logsumexp(weighed))
    return HANDICAP * said if said > 0 else said, int(others[np.argmax(weighed)])


def _next_door(tried: Tried, f: Found, evidence: Array) -> list[Candidate]:
    """What a load does to one joint is said of the next one too, where both bear nearly the same: the best forms of a
    finding's effect at other joints that say nearly as much. A function without a name of that joint's load is no other
    explanation (a cubic stiffness said 106 at the first joint and 103 at its own, the second, where any function of the
    second's load said 100; another author's 56056)."""
    if f.name[0] not in OF_A_LOAD:
        return []
    names = tried.by_name(evidence[None])[0]
    least = names[tried.names.index(f.name)] - AHEAD
    there = [k for k, n in enumerate(tried.names) if n[0] == f.name[0] and n != f.name and names[k] > least]
    return [tried.candidates[tried.strongest(evidence, k)] for k in there]


def _by_itself(
    space: Workspace, tried: Tried, f: Found, others: list[Found], pieces: Sequence[Found] = ()
) -> tuple[float, float, Array]:
    """What a finding says beside the others, by its bare form; with all near forms, less what it took over from other
    names, and with further pieces of the same effect; the log evidence of all candidates beside the others. The others
    are then taken up."""
    every = _beside(space, tried, [_without_more(f), *pieces], others)
    evidence, names = tried.said()
    return _at_any_joint(tried, f, evidence, names), every, evidence


def _without_more(f: Found) -> Found:
    """A finding without what it took over from other names."""
    return replace(f, more=(), size=0.0) if f.more else f


def _at_any_joint(tried: Tried, f: Found, evidence: Array, names: Array) -> float:
    """What a name says; growth along what never turns at whichever joint, since nothing tells them apart."""
    own = float(names[tried.names.index(f.name)])
    if f.name[0] != "thermal_growth":
        return own
    unturned = never_turned(tried.space.machine)
    if not only_shifts(tried.candidates[f.best], unturned):
        return own
    same = [k for k, name in enumerate(tried.names) if name[0] == f.name[0] and name[1] is not None]
    alike = [names[k] for k in same if only_shifts(tried.candidates[tried.strongest(evidence, k)], unturned)]
    return max(own, float(logsumexp(alike)))


def _bare(space: Workspace, tried: Tried, f: Found, others: list[Found], pieces: Sequence[Found]) -> float:
    """What an effect in several directions says beside the others, in each by its bare form. The others are then taken
    up."""
    return _beside(space, tried, [replace(g, near=(), more=()) for g in (f, *pieces)], others)


def _here(space: Workspace, tried: Tried, f: Found, others: list[Found], pieces: Sequence[Found]) -> float:
    """What an effect says with those of its near forms that act as it does itself: rivals of a load act in one
    component, and what its joint does across that makes up for nothing there (stiffness as a clearance, another
    author's 37016). The others are then taken up."""
    ways = {tried.candidates[g.best].component for g in (f, *pieces)}
    kept = [[k for k in g.near if k not in g.more] for g in (f, *pieces)]
    mine = [
        replace(g, near=tuple(k for k in near if called(space.context, k.frame, k.component) in ways), more=())
        for g, near in zip((f, *pieces), kept, strict=True)
    ]
    return _beside(space, tried, mine, others)


def _beside(space: Workspace, tried: Tried, mine: list[Found], others: list[Found]) -> float:
    """What some findings say together beside others, which are then taken up."""
    take_up(space, tried, [*others, *mine], and_look=False)
    whole = space.log_evidence()
    take_up(space, tried, others)
    return whole - space.log_evidence()


def _bends_as_it_needs(tried: Tried, f: Found, pieces: Sequence[Found]) -> bool:
    """Whether all pieces of an effect are functions of one load at one place: no other directions of it, but a form as
    free as its rivals (a fall to one side, its name taken out, was stiffness by two forms: 1,376 and 1,824 of log
    evidence where nine bumps said 1,736)."""
    mine = tried.candidates[f.best]
    here = mine.frame, mine.component, mine.covariate
    forms = (tried.candidates[g.best] for g in pieces)
    return f.name[0] in OF_A_LOAD and all((k.frame, k.component, k.covariate) == here for k in forms)


def _has_no_period(tried: Tried, f: Found, own: float, others: list[Found], pieces: Sequence[Found]) -> bool:
    """Whether a wave leaves bands of waves over its position, in its component: an error of a joint that is any
    function of its position has a strongest wave, and about as much at other periods. Where one more wave says more
    than they do what is left is that of a second wheel, and they are asked beside both. The others are then taken up.

    own  what the wave says by its bare form
    """
    mine, space = tried.candidates[f.best], tried.space
    if mine.effect != "periodic_transmission":
        return False
    rivals = [k for k, c in enumerate(tried.candidates) if c.effect == "nameless" and of_its_kind(mine, c)]
    waves = [k for k, c in enumerate(tried.candidates) if c.effect == mine.effect and same_place(c, mine)]
    alone = _without_more(f)

    def said(wave: Found) -> tuple[float, int, float]:
        """What bands say beside it; the strongest further wave, and what this says of all that were tried."""
        take_up(space, tried, [*others, *pieces, wave])
        evidence = tried.said()[0]
        by_bands = float(logsumexp(evidence[rivals])) - math.log(len(rivals))
        by_waves = evidence[waves] + tried.log_share[waves]
        return by_bands, waves[int(np.argmax(by_waves))], float(logsumexp(by_waves))

    most, left = max(IN_BANDS, IN_BANDS_OF_LOUD * own), -math.inf
    if rivals:
        left, second, by_waves = said(alone)
        if left > most and by_waves > left + AHEAD:
            left = said(replace(alone, more=tried.candidates[second].columns, size=0.0))[0]
    take_up(space, tried, others)
    return left > most


def _left_by(tried: Tried, f: Found, g: Found) -> bool:
    """Whether a finding lives on what the form of a louder one left, and would speak for it if it were gone: without a
    name at its place (growth of a bowed column said 1,496 of log evidence, what its column's seats left beside it 19,
    and beside that the growth little; another author's 24032), or with its name elsewhere (two clearances of one load
    left one of a third joint, by 7)."""
    mine, other = tried.candidates[f.best], tried.candidates[g.best]
    alike = f.name[0] == g.name[0] and mine.covariate == other.covariate
    return g.first < SHADOW * f.first and (alike or (g.name[0] == "nameless" and same_place(mine, other)))


def _runs_ahead(space: Workspace, tried: Tried, f: Found, others: list[Found], pieces: Sequence[Found]) -> bool:
    """Whether a joint's lost motion surely carries it on: no drive does that, but a cable that drags a carriage askew
    may seem to (a fifty-ninth author's 053: 578 of log evidence, and 591 across). All are then taken up."""
    candidate = tried.candidates[f.best]
    if candidate.effect != "backlash":
        return False
    take_up(space, tried, [*others, *pieces, f], and_look=False)
    values, covariance = by_its_own_form(space, candidate, f)
    along = along_its_axis(space.context, candidate)
    surely = abs(float(values[0])) > SURE * float(np.sqrt(covariance[0, 0]))
    return surely and runs_ahead(space.context, candidate, values * along)


def _against_physics(space: Workspace, tried: Tried, f: Found) -> bool:
    """Whether the form of a finding that is taken up has the sign that physics denies it, beyond doubt: no joint falls
    against its load."""
    candidate = tried.candidates[f.best]
    if candidate.way == 0:
        return False
    values, covariance = by_its_own_form(space, candidate, f)
    return bool(candidate.way * values[0] < -SURE * np.sqrt(covariance[0, 0]))


def _beside_a_riddle(tried: Tried, f: Found, others: list[Found]) -> bool:
    """Whether something without a name goes on in the same component of the same frame, or over a temperature beside a
    drift, half as large or larger and no ten times more quiet: then a name there stands for what nobody knows. A
    temperature's course is one over time, too: beside growth that had no name a drift was its rest (two recordings of
    the fortieth author, growth taken out; in none of seven authors' was a drift right there). So is beside something
    over a load a last link that gives way in all directions (a clearance of the joint before it, the forty-sixth's
    011)."""
    where = tried.candidates[f.best]
    for g in others:
        there = tried.candidates[g.best]
        large = g.size > RIDDLE * f.size and g.first > SHADOW * f.first
        warm = where.effect == "drift" and any("temp_" in name for name in there.covariates)
        slack = where.effect == "missing_compliance" and len(where.columns) == len(COMPONENTS)
        slack = slack and goes_with_a_load(there)
        if g.name[0] == "nameless" and (warm or slack or same_place(where, there)) and large:
            return True
    return False
