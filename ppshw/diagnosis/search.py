"""Which effects are there: taken up one by one while anything stands out from noise, then each name put to the question
again beside the others."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from ppshw.diagnosis.evidence import HANDICAP, Name, Tried, corrected_residual, p_value
from ppshw.diagnosis.forms import near_forms
from ppshw.diagnosis.kinship import counts, of_its_kind
from ppshw.diagnosis.library import Candidate, within
from ppshw.diagnosis.workspace import Workspace
from ppshw.machine import WRENCH_COMPONENTS, Machine
from ppshw.terms.shapes import Column

Array = NDArray[np.float64]
# What counts as significant, family-wise: the first finding, and any beside it.
FIRST, FURTHER = 0.05, 0.02
MOST_FINDINGS, MOST_PIECES = 5, 8  # effects; what is taken up for them, where one acts in several directions
# No finding without real odds, however quiet the null: e² = 7 to 1 against nothing (of 40 clean recordings three
# reached e, none of them e²; seeds 60500 to 60539), e³ = 20 to 1 beside another finding.
LEAST_FIRST, LEAST_FURTHER = 2.0, 3.0
# Beside a large effect a small one is more likely what the large one's form leaves of it than another effect.
SAME_EFFECT = 0.5
# In another component, or at another joint, it is so only where hardly anything speaks against it: play in one drive
# makes none of another's friction play (backlash 239.5 where friction said 276.0, in a case of both), and clearance
# about one axis no stiffness about another clearance (430 and 446).
ELSEWHERE = 10.0
# Weights of names are tempered: forms of real machines differ from the library's by a share of what they explain, so
# evidence overstates, the more of it there is: E counts as E / (1 + max E / TEMPER). 100 to 300 made the true names of
# 48 findings in sealed cases likeliest (seeds 60700 to 60716, 62000 to 62023, 62800 to 62811).
TEMPER = 150.0
# However much a name is ahead of all others, what acts may be something that looks like it and has no name here: of 56
# names that were given more than 0.95 in a deck of sealed cases (seed 9) six were wrong.
OUTSIDE = 0.05
# When all is found, a name stands only if it is ahead of every rival without one: by e¹ by its own form, or by e⁶ with
# all that it may be like, which is nearly as free as its rivals are. Of 61 right names in sealed cases (seeds of 14 to
# 18) 58 are, and 37 of 59 wrong ones, most of whose right names had been taken out of the library.
AHEAD, ALL_AHEAD = 1.0, 6.0
# Of a loud effect a form with few parameters never says quite as much as functions that bend: a softening joint said
# 2,299.7 and nine bumps 2,301.1 (23058); wrong names in its deck of removed cases were 3.5 % and more behind.
NEARLY = 2e-3
# Near forms may make up for no more than this of what its own says: right names that stood by them were 0.4, 4 and 9 %
# behind a rival by their own form, wrong ones 4, 13 and 14 %.
FAR_BEHIND = 1.11
# In five sealed cases of strangers and none of known effects (seeds of 11 and 12) a name stood beside structure without
# one in the same component of the same frame; sizes were 0.75 to 1.8 times the name's.
RIDDLE = 0.5
# Play between rubber walls is taken up over two to eight gaps in sealed cases, as friction is in every fourth of the
# tilting joints, whose travel is short.
SOFT, MAY_BE_PLAY = 8.0, 0.7
PRIOR_SD = 3.0  # of a coefficient once taken up, in `Workspace.unit`s; of more than FEW the less
FEW = 6  # columns
NEAR_SD = 1.0  # of all near forms together, in units of the main form's size
# What is left beside a finding that spoke so many times louder, and sits in the same joint or acts by the same cause,
# is what the finding's form got wrong, not another effect.
# A short wave, though, is not what anything else's form leaves over the same joint: there a fifth of it. What has no
# name has no near forms either and leaves twice as much.
# What heat did while nobody measured, in a break, shows over time beside it, in any joint; what a wandering base leaves
# over hours shows as creep of a whole rail.
SHADOW, OF_A_WAVE, LEFT_OF_A_RIDDLE, ANYWHERE = 0.1, 0.2, 2.0, 0.1
AT_ONCE = 0.02  # of the recording's duration: moments that are one
# Names beside louder structure without one, in decks of three authors: 5 to 22 of log evidence were wrong in four
# cases, 92 and 102 right.
QUIET = 25.0
OF_A_LOAD = frozenset({"nonlinear_stiffness", "clearance"})
LOADS = frozenset({
    "nonlinear_stiffness", "clearance", "creep", "missing_compliance", "wrench_error", "moving_weight",
})  # fmt: skip
# Other names to begin with: so many effects, each with at least such a share of the best's log evidence, and structure
# without a name; another start wins by so much.
STARTS, LOUD, ANOTHER_START = 3, 0.25, 3.0
# By so much more for each effect more that it needs: a base that wandered was said to be one that drifts about one axis
# and whose first joint jumps, for 3.2 (another author's 6074).
EACH_MORE = 6.0
FEWER = 2  # findings less: then nothing counts against those without a name
FREE = 6  # columns of a form that may stand for two effects: a base that wanders in all directions
ROUNDS = 3  # of putting names to the question again


@dataclass
class Found:
    """best: the candidate that stands for the name; weights of all names; p family-wise when it was found;
    size: rms of its form at the reflectors [m], 0 before it was fitted; near: columns of near forms, with `more` of
    what its own left over; first: evidence when it was found; at: where its columns begin in the workspace;
    carried: whether a calibration is to have it; was: the candidate that stood for a name that was given up."""

    best: int
    name: Name
    p: float
    evidence: float
    weights: dict[Name, float] = field(default_factory=dict)
    size: float = 0.0
    near: tuple[Column, ...] = ()
    more: tuple[Column, ...] = ()
    first: float = 0.0
    at: int = 0
    carried: bool = True
    was: int | None = None

    def columns(self, candidate: Candidate) -> slice:
        """Where its columns are in the workspace, near forms among them; candidate: its best."""
        return slice(self.at, self.at + len(candidate.columns) + len(self.near))


def search(space: Workspace, tried: Tried, rng: np.random.Generator) -> list[Found]:
    """Findings in the order of their strength; the workspace has their columns taken up at its end.

    Where several effects act, what explains most at first may be a compromise between them. So when one finding was not
    enough, or its form is so free that it may stand for two, and it has a name, the search begins again with others,
    and the findings that explain the recording best count.
    """
    starts = _starts(tried)
    found = _greedy(space, tried, None, rng)
    named = any(f.name[0] != "nameless" for f in found)
    several = len(found) > 1 or any(f.more or len(tried.candidates[f.best].columns) >= FREE for f in found)
    if named and several:
        best, chosen = _explained(space, tried, found), None
        for start in starts:
            if _name(tried, start[0]) in [f.name for f in found]:
                continue
            instead = _greedy(space, tried, start, None)
            # its name was compared with the others already, where no two effects act or the others are the same
            if len(found) == len(instead) == 1 or _same_but_for_a_load(tried, found, instead):
                continue
            total = _explained(space, tried, instead)
            if len(instead) <= len(found) - FEWER:
                total += _against_riddles(instead)
            total -= EACH_MORE * max(0, _effects(instead) - _effects(found))
            if total > best + ANOTHER_START:
                best, chosen = total, start
        if chosen is not None:  # whose first finding may be too quiet by itself beside what the null makes of all of it
            found = _greedy(space, tried, chosen, rng) or found
        take_up(space, tried, found)
    _give_up(space, tried, found)
    _drop_what_riddles_leave(space, tried, found)
    _weigh(space, tried, found)
    return found


def _same_but_for_a_load(tried: Tried, found: Sequence[Found], instead: Sequence[Found]) -> bool:
    """Whether two sets of findings differ by no more than whether functions of a load are stiffness or clearance."""

    def what(f: Found) -> tuple[object, ...]:
        best = tried.candidates[f.best]
        of_a_load = f.name[0] in OF_A_LOAD
        return (of_a_load or f.name[0], best.frame, best.component, best.covariate)

    return sorted(map(str, map(what, found))) == sorted(map(str, map(what, instead)))


def _effects(found: Sequence[Found]) -> int:
    """How many effects findings are of: what has the same name and joint is one, in whatever directions it acts."""
    named = [f.name for f in found if f.name[0] != "nameless"]
    return len(set(named)) + len(found) - len(named)


def _give_up(space: Workspace, tried: Tried, found: list[Found]) -> None:
    """A name stands while no rival without one says as much in its place as the name does by its bare form, or nearly
    as much as with all its near forms: what any smooth function fits as well is something else. Of one effect that acts
    in several directions the loudest (when it was found) is asked, for all; where it stands the others do. What bears
    the name of one that was given up, for the same cause and saying no more, goes with it, and so does what the others
    then explain."""
    given_up: dict[tuple[str, str], float] = {}
    freely = tried.names.index(("nameless", None))
    stand: set[Name] = set()
    for _ in range(2):
        stand.clear()
        for f in sorted(found, key=lambda f: -f.first):
            cause = f.name[0], tried.candidates[f.best].covariate
            if f.name[0] == "nameless" or f.name in stand:
                continue
            pieces = [g for g in found if g.name == f.name and g is not f]
            others = [g for g in found if g is not f and g not in pieces]
            own, every, evidence = _by_itself(space, tried, f, others, pieces)
            rival, best = _other_than(tried, f, evidence, freely)
            with_all = every - ALL_AHEAD if pieces else min(every - ALL_AHEAD, FAR_BEHIND * own)
            least = max((1.0 + NEARLY) * own - AHEAD, with_all)
            behind = rival / HANDICAP > least
            if own <= given_up.get(cause, -math.inf) or behind or _beside_a_riddle(tried, f, others):
                given_up[cause] = max(own, given_up.get(cause, -math.inf))
                f.was, f.best, f.name, f.evidence, f.first = f.best, best, tried.names[freely], rival, rival
                f.size, f.more = 0.0, ()
            else:
                stand.add(f.name)
            take_up(space, tried, found)
        if not given_up:
            return
    for f in list(found):
        others = [g for g in found if g is not f]
        own, every = _by_itself(space, tried, f, others)[:2]
        if others and (own if f.name[0] == "nameless" else max(own, every)) < LEAST_FURTHER:
            found.remove(f)
    take_up(space, tried, found)


def _drop_what_riddles_leave(space: Workspace, tried: Tried, found: list[Found]) -> None:
    """What has no name is only known by functions that bend as they need, and leaves something anywhere: a name that
    speaks more quietly, and quietly by itself, is that. Loads, places and sides come in blocks of time: a name that
    goes with time alone may speak loudly and is that still if it is ten times more quiet."""
    riddles = [f for f in found if f.name[0] == "nameless"]
    named = [f for f in found if f.name[0] != "nameless"]
    if not riddles or not named:
        return

    def said(f: Found) -> float:
        return _by_itself(space, tried, f, [g for g in found if g is not f])[0]

    loudest = max(said(f) for f in riddles) / HANDICAP

    def least(f: Found) -> float:
        slow = tried.candidates[f.best].covariate == "time"
        return SHADOW * loudest if slow else min(loudest, QUIET)

    quiet = [f for f in named if said(f) < least(f)]
    found[:] = [f for f in found if f not in quiet]
    take_up(space, tried, found)


def _other_than(tried: Tried, f: Found, evidence: Array, freely: int) -> tuple[float, int]:
    """What rivals without a name say that are not by what they mean the finding's own effect, for the evidence (C,) of
    all candidates; and the strongest of them."""
    mine, machine = tried.candidates[f.best], tried.space.machine
    parallel, inside = _never_turned(machine), within(machine)
    others = np.array([
        j for j in np.flatnonzero(tried.name_of == freely)
        if not of_its_kind(mine, tried.candidates[j], parallel, inside, not OF_A_LOAD & tried.without)
    ])  # fmt: skip
    counted = np.array([counts(mine, tried.candidates[j]) for j in others])
    weighed = counted * evidence[others] + tried.log_share[others]
    said = float(logsumexp(weighed))
    return HANDICAP * said if said > 0 else said, int(others[np.argmax(weighed)])


def _never_turned(machine: Machine) -> list[str]:
    """Frames behind no revolute joint, whose axes stay parallel to the base's."""
    return [joint.name for joint in itertools.takewhile(lambda joint: joint.prismatic, machine.joints)]


def _by_itself(
    space: Workspace, tried: Tried, f: Found, others: list[Found], pieces: Sequence[Found] = ()
) -> tuple[float, float, Array]:
    """What a finding says beside the others, by its bare form; with all near forms, less what it took over from other
    names, and with further pieces of the same effect; the log evidence of all candidates beside the others. The others
    are then taken up."""
    take_up(space, tried, [*others, replace(f, more=(), size=0.0) if f.more else f, *pieces], and_look=False)
    whole = space.log_evidence()
    take_up(space, tried, others)
    evidence, names = _names(tried)
    return float(names[tried.names.index(f.name)]), whole - space.log_evidence(), evidence


def _beside_a_riddle(tried: Tried, f: Found, others: list[Found]) -> bool:
    """Whether something without a name goes on in the same component of the same frame, half as large or larger and no
    ten times more quiet: then a name there stands for what nobody knows."""
    where = tried.candidates[f.best]
    for g in others:
        there = tried.candidates[g.best]
        large = g.size > RIDDLE * f.size and g.first > SHADOW * f.first
        if g.name[0] == "nameless" and _same_place(where, there) and large:
            return True
    return False


def _starts(tried: Tried) -> list[tuple[int, float]]:
    """Candidates to begin with, and their names' evidence: the best of each of the effects that speak loudest."""
    evidence, names = _names(tried)
    order = [j for j in np.argsort(-names) if names[j] > max(LEAST_FIRST, LOUD * names.max())]
    effects: dict[str, int] = {}
    for j in order:
        effects.setdefault(tried.names[j][0], int(j))
    chosen = list(effects.values())[:STARTS]
    chosen += [j for j in effects.values() if j not in chosen and tried.names[j][0] == "nameless"]
    return [(_strongest(tried, evidence, j), float(names[j])) for j in chosen]


def _explained(space: Workspace, tried: Tried, found: list[Found]) -> float:
    """Log evidence of all findings together, as taken up, less what each has to bring and what counts against those
    without a name."""
    cost = sum(LEAST_FURTHER - float(tried.log_share[f.best]) for f in found)
    return space.log_evidence() - cost - _against_riddles(found)


def _against_riddles(found: list[Found]) -> float:
    """What counts against findings without a name: their functions bend as they need."""
    return sum((1 / HANDICAP - 1) * f.first for f in found if f.name[0] == "nameless")


def _greedy(
    space: Workspace,
    tried: Tried,
    start: tuple[int, float] | None,
    rng: np.random.Generator | None,
) -> list[Found]:
    """Findings one after the other while anything stands out.

    start  candidate to begin with and its name's evidence; None: the best
    rng    of the null; None: evidence alone decides, and p is nan
    """
    found: list[Found] = []
    take_up(space, tried, found)
    for tries in range(MOST_PIECES):
        if tries >= MOST_FINDINGS + len(found) - _effects(found):
            break
        best, evidence = start if start and not found else _best(tried, found)
        if evidence < (LEAST_FURTHER if found else LEAST_FIRST):
            break
        p = math.nan if rng is None else p_value(evidence, tried.null(corrected_residual(space), rng))
        if p > (FURTHER if found else FIRST):
            break
        caster = _caster(tried, best, evidence, found)
        if caster is not None:
            caster.more += tried.candidates[best].columns
            caster.size = 0.0
        else:
            found.append(Found(best, _name(tried, best), p, evidence, first=evidence))
        take_up(space, tried, found)
        _reconsider(space, tried, found)
    return found


def _caster(tried: Tried, best: int, evidence: float, found: list[Found]) -> Found | None:
    """The finding whose shadow a candidate is, if it is one."""
    candidate = tried.candidates[best]
    for f in found:
        other = tried.candidates[f.best]
        if candidate.effect == other.effect == "target_moved" and candidate.covariate == other.covariate:
            return f  # a reflector that moves now and again
        same_joint = other.joint is not None and (
            candidate.joint == other.joint or f"_{other.joint}" in candidate.covariate
        )
        by_load = other.effect in LOADS and (candidate.effect in LOADS or candidate.covariate in WRENCH_COMPONENTS)
        same_cause = candidate.covariate == other.covariate or _at_once(tried, candidate, other)
        alike = candidate.effect == other.effect and candidate.covariate == other.covariate
        if by_load and not same_joint and not alike and _left_there(tried, other) < SAME_EFFECT * evidence:
            by_load = same_cause = False
        riddle = other.effect == "nameless" and _of_a_riddle(candidate, other)
        # what a base that wanders leaves may by chance go with a temperature
        wanders = other.effect == "drift" and candidate.frame == "base" and "temp_" in candidate.covariate
        heat = other.effect == "thermal_growth" and candidate.covariate == "time"
        by_rail = other.effect == "drift" and candidate.frame in _never_turned(tried.space.machine)
        slowly = heat or (by_rail and candidate.effect == "creep" and candidate.component is None)
        wave = candidate.effect == "periodic_transmission" != other.effect
        least = SHADOW * f.first * (OF_A_WAVE if wave else LEFT_OF_A_RIDDLE if riddle else 1.0)
        if (same_joint or by_load or same_cause or riddle or wanders) and evidence < least:
            return f
        if slowly and evidence < ANYWHERE * least:
            return f
    return None


def _left_there(tried: Tried, other: Candidate) -> float:
    """Log evidence of the best function of the load that a finding bears, at its own place: what its form leaves of it
    is one. Infinite for what acts at no single place."""
    if other.joint is None:
        return math.inf
    evidence, _ = _names(tried)
    there = [
        j for j, k in enumerate(tried.candidates)
        if k.effect == "nameless" and k.frame == other.frame and other.component in (None, k.component)
        and k.covariates[0].startswith("on_")
    ]  # fmt: skip
    return max((float(evidence[j]) for j in there), default=math.inf)


def _at_once(tried: Tried, one: Candidate, other: Candidate) -> bool:
    """Whether both happen at a moment, and at the same: what was knocked is displaced, not lost."""
    if "time_h" not in one.shape or "time_h" not in other.shape:
        return False
    return abs(one.shape["time_h"] - other.shape["time_h"]) < AT_ONCE * float(np.ptp(tried.space.context.hours))


def _of_a_riddle(candidate: Candidate, other: Candidate) -> bool:
    """What a function without a name leaves: something in the same component, over the same columns, by a load where it
    goes with one, and over time where it goes with a temperature, lags, or a reflector wanders."""
    loads = any(name.rsplit("_", 1)[-1] in WRENCH_COMPONENTS for name in other.covariates)
    over = any(candidate.covariate in name for name in other.covariates)
    slow = any(name.startswith(("late_", "temp_")) for name in other.covariates)
    slow = slow or any(column.function == "target_shift" for column in other.columns)
    by_load = loads and (candidate.effect in LOADS or candidate.covariate in WRENCH_COMPONENTS)
    return _same_place(candidate, other) or over or by_load or (slow and candidate.covariate == "time")


def _same_place(one: Candidate, other: Candidate) -> bool:
    """Whether both move the same component of the same frame; what is at no frame is nowhere."""
    return one.component is not None and (one.frame, one.component) == (other.frame, other.component)


def _name(tried: Tried, candidate: int) -> Name:
    return tried.names[int(tried.name_of[candidate])]


def _best(tried: Tried, found: Sequence[Found] = ()) -> tuple[int, float]:
    """The best candidate of the best name of the likeliest effect, and the name's evidence.

    found  what a form left of these goes to the same effect, if that explains most of it; but what happened at another
           moment is something else, and in another component what is far behind
    """
    evidence, names = _names(tried)
    chosen = tried.likeliest(names)
    for j in np.argsort(-names):
        if names[j] <= SAME_EFFECT * names[chosen]:
            break
        again = tried.candidates[_strongest(tried, evidence, int(j))]
        near = names[j] > names[chosen] - ELSEWHERE
        if any(
            _of_same_effect(tried, again, other) and (near or _at_its_place(again, other))
            for other in (tried.candidates[f.best] for f in found)
        ):
            chosen = int(j)
            break
    return _strongest(tried, evidence, chosen), float(names[chosen])


def _at_its_place(one: Candidate, other: Candidate) -> bool:
    """Whether both are of the same joint and its same component; what moves several or sits in no joint is anywhere."""
    anywhere = one.joint is None or None in (one.component, other.component)
    return one.joint == other.joint and (anywhere or _same_place(one, other))


def _of_same_effect(tried: Tried, one: Candidate, other: Candidate) -> bool:
    """Of the same name, and at the same moment what happened at one; without a name only what a riddle leaves."""
    if one.effect == "nameless":
        return other.effect == "nameless" and _of_a_riddle(one, other)
    moments = "time_h" in one.shape and "time_h" in other.shape
    return one.effect == other.effect and (not moments or _at_once(tried, one, other))


def _strongest(tried: Tried, evidence: Array, name: int) -> int:
    """The best candidate of the name at this index, for the evidence (C,) of all."""
    return int(np.argmax(np.where(tried.name_of == name, evidence + tried.log_share, -np.inf)))


def _names(tried: Tried) -> tuple[Array, Array]:
    """Log evidence of all candidates (C,) and of all names."""
    evidence = tried.evidence(tried.scores()[None])
    return evidence[0], tried.by_name(evidence)[0]


def coefficients(space: Workspace, candidate: Candidate, found: Found) -> tuple[Array, Array, float]:
    """Coefficients of the finding's own form, their standard deviations, and the rms of all its forms [m]."""
    _, values = space.coefficients()
    main, every = slice(found.at, found.at + len(candidate.columns)), found.columns(candidate)
    std = np.sqrt(np.maximum(np.diag(space.middle), 0.0))[main]
    return values[main], std, _rms(space, space.taken[:, :, every] @ values[every])


def by_its_own_form(space: Workspace, candidate: Candidate, found: Found) -> tuple[Array, Array]:
    """Coefficients of the finding's own form and their standard deviations, as if it had no near forms: what a gap or a
    jump is. Beside near forms, which can be the same or its opposite, they say little."""
    keep = np.ones(len(space.taken_prior), dtype=bool)
    keep[found.columns(candidate)] = False
    keep[found.at : found.at + len(candidate.columns)] = True
    return coefficients(space.keeping(keep), candidate, replace(found, near=()))[:2]


def modelled(space: Workspace, candidate: Candidate, found: Found) -> tuple[tuple[Column, ...], Array, Array]:
    """All columns of a finding, near forms among them, with values and standard deviations."""
    _, values = space.coefficients()
    here = found.columns(candidate)
    std = np.sqrt(np.maximum(np.diag(space.middle), 0.0))
    return (*candidate.columns, *found.near), values[here], std[here]


def _rms(space: Workspace, displacement: Array) -> float:
    return float(np.sqrt((displacement**2).sum() / max(int(space.recording.seen.sum()), 1)))


def take_up(space: Workspace, tried: Tried, found: list[Found], and_look: bool = True) -> None:
    """The workspace with exactly these findings, and with what else each of them may be like.

    and_look  candidates are to be looked at beside them; False, which is quick, for what they explain together
    """
    for f in found:
        if f.size == 0.0:
            _measure(space, tried, f, [g for g in found if g is not f and g.size > 0.0])
    _lay(space, tried, found)
    if and_look:
        tried.update([c.key for f in found for c in (*tried.candidates[f.best].columns, *f.near)])


def _measure(space: Workspace, tried: Tried, f: Found, others: list[Found]) -> None:
    """The size of a finding's own form, alone beside the others; its near forms scale with it."""
    candidate = tried.candidates[f.best]
    f.near = ()
    _lay(space, tried, [*others, f])
    f.size = coefficients(space, candidate, f)[2]
    near = (*near_forms(space.context, candidate, tried.without), *f.more)
    f.near = tuple({c.key: c for c in near}.values())


def _lay(space: Workspace, tried: Tried, found: list[Found]) -> None:
    if not found:
        space.forget()
        return
    laid: list[tuple[Array, Array, Array]] = []
    prior: list[float] = []
    for f in found:
        f.at = len(laid)
        candidate = tried.candidates[f.best]
        laid += [tried.value(c) for c in candidate.columns]
        many = min(1.0, FEW / len(candidate.columns))
        prior += (many * PRIOR_SD * tried.unit / tried.scale[tried.index[f.best]]).tolist()
        for column in f.near:
            laid.append(tried.value(column))
            # what wanders does so with half the amplitude at twice the pace, like a random walk
            pace = float(column.args["tau"]) if "cosine" in (column.args.get("form"), column.args.get("time")) else 1.0
            prior.append(NEAR_SD * f.size / np.sqrt(len(f.near)) / pace / max(_rms(space, laid[-1][0]), 1e-30))
    raw, white, absorbed = (np.stack(each, axis=-1) for each in zip(*laid, strict=True))
    space.take_up(raw, np.maximum(prior, 1e-30), (white, absorbed))


def _reconsider(space: Workspace, tried: Tried, found: list[Found]) -> None:
    """Each finding once more, given the others: a better form or name may take its place, and what the others explain
    as well is dropped; until nothing changes. Of all sets on the way the one that explains most is left."""
    if len(found) < 2:
        return
    most, chosen = _explained(space, tried, found), [replace(f) for f in found]
    for _ in range(ROUNDS):
        changed = False
        for f in list(found):
            others = [g for g in found if g is not f]
            take_up(space, tried, others)
            best, evidence = _best(tried)
            if max([evidence, *(g.first for g in others)]) < SHADOW * f.first:
                continue  # what quiet ones may be like besides their own forms took it from the loud one
            f.evidence = evidence
            if f.evidence < LEAST_FURTHER:
                found.remove(f)
            elif best != f.best:
                f.best, f.name, f.size, f.first = best, _name(tried, best), 0.0, f.evidence
            else:
                continue
            changed = True
            take_up(space, tried, found, and_look=False)
            total = _explained(space, tried, found)
            if total > most:
                most, chosen = total, [replace(f) for f in found]
        if not changed:
            break
    if [f.best for f in chosen] != [f.best for f in found]:
        found[:] = chosen
    take_up(space, tried, found)


def _weigh(space: Workspace, tried: Tried, found: list[Found]) -> None:
    """Posterior weights of the names for every finding, given the others; at least OUTSIDE for no name at all.

    A name that was preferred for what it explains with all its near forms, though another's bare form says more, is as
    much ahead of that one as the two sets are apart.
    """
    whole = _explained(space, tried, found)
    for f in found:
        others = [g for g in found if g is not f]
        take_up(space, tried, others)
        every, evidence = _names(tried)
        top, own = int(np.argmax(evidence)), tried.names.index(f.name)
        if top != own:
            best = _strongest(tried, every, top)
            rival = Found(best, tried.names[top], math.nan, float(evidence[top]), first=f.first)
            take_up(space, tried, [*others, rival], and_look=False)
            evidence[own] = evidence[top] + whole - _explained(space, tried, [*others, rival])
        tempered = evidence / (1 + max(evidence.max(), 0.0) / TEMPER)
        weights = np.exp(tempered - logsumexp(tempered))
        if f.name[0] != "nameless":
            weights = weights * (1 - OUTSIDE) + OUTSIDE * np.array([name[0] == "nameless" for name in tried.names])
        f.weights = {tried.names[j]: float(weights[j]) for j in np.argsort(-weights)[:6]}
    take_up(space, tried, found)
    for f in found:
        _soft_walls(space, tried, f)


def _soft_walls(space: Workspace, tried: Tried, f: Found) -> None:
    """A joint that loses a large part of its way after it turned back may as well have play between soft walls as
    friction that winds it up: no form tells the two apart, only how much is lost, and that not surely."""
    candidate = tried.candidates[f.best]
    play = ("backlash", candidate.joint)
    if candidate.effect != "friction_hysteresis" or play not in tried.names:
        return
    lag, std, _ = coefficients(space, candidate, f)
    lost = 2.0 * (abs(float(lag[0])) + float(std[0]))
    if candidate.shape["width"] < SOFT * lost:
        f.weights[play] = max(f.weights.get(play, 0.0), MAY_BE_PLAY * f.weights[f.name])
        total = sum(f.weights.values())
        f.weights = {name: w / total for name, w in sorted(f.weights.items(), key=lambda item: -item[1])}
