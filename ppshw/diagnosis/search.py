"""Which effects are there: taken up one by one while anything stands out from noise, then each name put to the question
again beside the others."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from ppshw.diagnosis.as_read import as_read, as_weighed_alone, surely_reads_other
from ppshw.diagnosis.evidence import (
    FIRST,
    FURTHER,
    LEAST_FIRST,
    LEAST_FURTHER,
    MORE,
    Name,
    Tried,
    corrected_residual,
    p_value,
)
from ppshw.diagnosis.found import Found, against_riddles, explained, pieces_of, take_up
from ppshw.diagnosis.kinship import OF_A_LOAD
from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.serial import drop_what_noise_may_be
from ppshw.diagnosis.shadows import SAME_EFFECT, SHADOW, at_once, caster_of, of_a_riddle, same_place
from ppshw.diagnosis.standing import drop_what_others_explain, drop_what_riddles_leave, give_up
from ppshw.diagnosis.weights import weigh
from ppshw.diagnosis.workspace import Workspace

# Effects; what is taken up for them, where one acts in several directions. Play in all six joints of an arm is six;
# what has no name leaves something anywhere, and is followed less far.
MOST_FINDINGS, MOST_PIECES = 8, 12
MOST_BESIDE_RIDDLES, PIECES_BESIDE_RIDDLES = 5, 8
# In another component, or at another joint, it is so only where hardly anything speaks against it: play in one drive
# makes none of another's friction play (backlash 239.5 where friction said 276.0, in a case of both), and clearance
# about one axis no stiffness about another clearance (430 and 446).
ELSEWHERE = 10.0
# Other names to begin with: so many effects, each with at least such a share of the best's log evidence, so many other
# joints of the loudest, and structure without a name; another start wins by so much.
STARTS, JOINTS, LOUD, ANOTHER_START = 3, 3, 0.25, 3.0
# By so much more for each effect more that it needs: a base that wandered was said to be one that drifts about one axis
# and whose first joint jumps, for 3.2 (another author's 6074).
EACH_MORE = 6.0
FEWER = 2  # findings less: then nothing counts against those without a name
FREE = 6  # columns of a form that may stand for two effects: a base that wanders in all directions
ROUNDS = 3  # of putting names to the question again


def search(space: Workspace, tried: Tried, rng: np.random.Generator, earlier: Collection[Name] = ()) -> list[Found]:
    """Findings in the order of their strength; the workspace has their columns taken up at its end.

    Where several effects act, what explains most at first may be a compromise between them. So when one finding was not
    enough, or its form is so free that it may stand for two, and it has a name, the search begins again with others,
    and the findings that explain the recording best count; so do those of the names that an earlier look gave (two
    links that grew were a tracker's scale with 0.95 once noise had been learnt beside them: 2,336 and, by both, 2,416).

    earlier  these names
    """
    starts = _starts(tried)
    found = _greedy(space, tried, None, rng)
    named = any(f.name[0] != "nameless" for f in found)
    several = len(found) > 1 or any(f.more or len(tried.candidates[f.best].columns) >= FREE for f in found)
    if named and several:
        best = before = _worth(space, tried, found, found)
        chosen = None
        for start in starts:
            if tried.name(start[0]) in [f.name for f in found]:
                continue
            instead = _greedy(space, tried, start, None)
            # its name was compared with the others already, where no two effects act or the others are the same
            if len(found) == len(instead) == 1 or _same_but_for_a_load(tried, found, instead):
                continue
            total = _worth(space, tried, instead, found)
            if total > best + ANOTHER_START:
                best, chosen = total, start
        if chosen is not None:  # what stands out from the null may be less of it, or nothing
            instead = _greedy(space, tried, chosen, rng)
            if instead and _worth(space, tried, instead, found) > before + ANOTHER_START:
                found = instead
        take_up(space, tried, found)
    if named and any(name not in [f.name for f in found] for name in earlier):
        before = _worth(space, tried, found, found)
        instead = _of_names(space, tried, earlier, rng)
        if instead and _worth(space, tried, instead, found) > before + ANOTHER_START:
            found = instead
        take_up(space, tried, found)
    _as_shadows(space, tried, found)
    give_up(space, tried, found)
    drop_what_riddles_leave(space, tried, found)
    drop_what_noise_may_be(space, tried, found, rng)
    _add_what_is_read(space, tried, found)
    _in_one(space, tried, found)
    weigh(space, tried, found)
    return found


def _as_shadows(space: Workspace, tried: Tried, found: list[Found]) -> None:
    """What was found before a louder one of the same effect, or before growth where it goes with time, and is the
    shadow of that, goes to it: where a search began elsewhere how warm a link had been was a jump of the next joint's
    zero (70 of log evidence beside growth, which says 9,687 alone), creep of one link that of two (35 and 66, of 902;
    another author's 55058 and 55053)."""

    def said(f: Found, others: list[Found]) -> float:
        take_up(space, tried, others)
        return float(tried.said()[1][tried.names.index(f.name)])

    for f in sorted(found, key=lambda f: f.first):
        others = [g for g in found if g is not f]
        alone = [replace(g, first=said(g, [h for h in others if h is not g])) for g in others]
        beside = said(f, others)
        late = tried.candidates[f.best].covariate == "time"
        some = [g for g in alone if g.name[0] == f.name[0] or (late and g.name[0] == "thermal_growth")]
        caster = caster_of(tried, f.best, beside, some)
        if caster is not None and beside < SHADOW * caster.first:
            g = others[alone.index(caster)]
            take_up(space, tried, [h for h in others if h is not g])
            evidence, names = tried.said()
            j = tried.names.index(g.name)
            g.best, g.evidence, g.first = tried.strongest(evidence, j), float(names[j]), float(names[j])
            g.more, g.size = (*g.more, *tried.candidates[f.best].columns), 0.0
            found.remove(f)
    take_up(space, tried, found)


def _add_what_is_read(space: Workspace, tried: Tried, found: list[Found]) -> None:
    """The force sensor's error, where its readings surely show one that moves reflectors and nothing else was found of
    it: deflections may tell little of an error that the base model's compliances were learnt with (of a few hundred
    newtons another author's 49049 had √λ 4.7 left). What it explains is no other finding."""
    best = as_weighed_alone(tried)
    if best is None or tried.name(best) in [f.name for f in found] or not surely_reads_other(space, tried, found):
        return
    found.append(as_read(tried, best))
    take_up(space, tried, found)
    drop_what_others_explain(space, tried, found)


def _in_one(space: Workspace, tried: Tried, found: list[Found]) -> None:
    """A name that explains more in place of all directions of an effect takes its place: names were compared with each
    of them (creep of two directions at one joint was that of another, of weight 0.95)."""
    for f in [g for g in found if g.name[0] != "nameless"]:
        pieces = pieces_of(f, found) if f in found else []
        if not pieces:
            continue
        whole = explained(space, tried, found)
        others = [g for g in found if g is not f and g not in pieces]
        take_up(space, tried, others)
        best, evidence = _best(tried)
        rival = Found(best, tried.name(best), f.p, evidence, first=evidence)
        take_up(space, tried, instead := [*others, rival], and_look=False)
        if rival.name[0] != "nameless" and explained(space, tried, instead) > whole + ANOTHER_START:
            found[:] = instead
        take_up(space, tried, found)


def _of_names(space: Workspace, tried: Tried, names: Collection[Name], rng: np.random.Generator) -> list[Found]:
    """Findings of exactly these names, each by its best candidate beside the others; none where one says too little."""
    found: list[Found] = []
    for _ in range(2):
        for name in dict.fromkeys(names):
            others = [f for f in found if f.name != name]
            take_up(space, tried, others)
            evidence, said = tried.said()
            if name not in tried.names or said[own := tried.names.index(name)] < LEAST_FURTHER:
                return []
            first = float(said[own])
            p = p_value(first, tried.null(corrected_residual(space), rng, first))
            found = [*others, Found(tried.strongest(evidence, own), name, p, first, first=first)]
    take_up(space, tried, found)
    return [] if any(f.p > FURTHER for f in found) else found


def _worth(space: Workspace, tried: Tried, instead: list[Found], found: Sequence[Found]) -> float:
    """Log evidence of a set of findings, which is taken up, beside another that the search had before; half of it by
    their bare forms: near forms of one joint's growth follow that of the joints on either side of it, its own hardly
    does."""
    total = 0.5 * explained(space, tried, instead)
    take_up(space, tried, bare := [replace(f, near=(), more=()) for f in instead], and_look=False)
    total += 0.5 * explained(space, tried, bare)
    if len(instead) <= len(found) - FEWER:
        total += against_riddles(instead)
    return total - EACH_MORE * max(0, _effects(instead) - _effects(found))


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


def _starts(tried: Tried) -> list[tuple[int, float]]:
    """Candidates to begin with, and their names' evidence: the best of each of the effects that speak loudest, and of
    the loudest's other joints."""
    evidence, names = tried.said()
    order = [j for j in np.argsort(-names) if names[j] > max(LEAST_FIRST, LOUD * names.max())]
    effects: dict[str, int] = {}
    for j in order:
        effects.setdefault(tried.names[j][0], int(j))
    loudest = next(iter(effects), "nameless")
    chosen = list(effects.values())[:STARTS]
    if loudest != "nameless":
        chosen += [int(j) for j in order if tried.names[j][0] == loudest][1 : 1 + JOINTS]
    chosen += [j for j in effects.values() if j not in chosen and tried.names[j][0] == "nameless"]
    return [(tried.strongest(evidence, j), float(names[j])) for j in chosen]


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
        riddle = any(f.name[0] == "nameless" for f in found)
        most, pieces = (MOST_BESIDE_RIDDLES, PIECES_BESIDE_RIDDLES) if riddle else (MOST_FINDINGS, MOST_PIECES)
        if tries >= min(pieces, most + len(found) - _effects(found)):
            break
        best, evidence = start if start and not found else _best(tried, found)
        if evidence < (LEAST_FURTHER if found else LEAST_FIRST):
            break
        p = math.nan if rng is None else p_value(evidence, tried.null(corrected_residual(space), rng, evidence))
        again = tried.name(best) in [f.name for f in found]
        if p > (MORE if again else FURTHER if found else FIRST):
            break
        caster = caster_of(tried, best, evidence, found)
        if caster is not None:
            caster.more += tried.candidates[best].columns
            caster.size = 0.0
        else:
            found.append(Found(best, tried.name(best), p, evidence, first=evidence))
        take_up(space, tried, found)
        _reconsider(space, tried, found)
    return found


def _best(tried: Tried, found: Sequence[Found] = ()) -> tuple[int, float]:
    """The best candidate of the best name of the likeliest effect, and the name's evidence.

    found  what a form left of these goes to the same effect, if that explains most of it; but what happened at another
           moment is something else, and in another component what is far behind
    """
    evidence, names = tried.said()
    chosen = tried.likeliest(names)
    for j in np.argsort(-names):
        if names[j] <= SAME_EFFECT * names[chosen]:
            break
        again = tried.candidates[tried.strongest(evidence, int(j))]
        near = names[j] > names[chosen] - ELSEWHERE
        if any(
            _of_same_effect(tried, again, other) and (near or _at_its_place(again, other))
            for other in (tried.candidates[f.best] for f in found)
        ):
            chosen = int(j)
            break
    return tried.strongest(evidence, chosen), float(names[chosen])


def _at_its_place(one: Candidate, other: Candidate) -> bool:
    """Whether both are of the same joint and its same component; what moves several or sits in no joint is anywhere."""
    anywhere = one.joint is None or None in (one.component, other.component)
    return one.joint == other.joint and (anywhere or same_place(one, other))


def _of_same_effect(tried: Tried, one: Candidate, other: Candidate) -> bool:
    """Of the same name, and at the same moment what happened at one; without a name only what a riddle leaves."""
    if one.effect == "nameless":
        return other.effect == "nameless" and of_a_riddle(one, other)
    moments = "time_h" in one.shape and "time_h" in other.shape
    return one.effect == other.effect and (not moments or at_once(tried, one, other))


def _reconsider(space: Workspace, tried: Tried, found: list[Found]) -> None:
    """Each finding once more, given the others: a better form or name may take its place, and what the others explain
    as well is dropped; until nothing changes. Of all sets on the way the one that explains most is left."""
    if len(found) < 2:
        return
    most, chosen = explained(space, tried, found), [replace(f) for f in found]
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
                f.best, f.name, f.size, f.first = best, tried.name(best), 0.0, f.evidence
            else:
                continue
            changed = True
            take_up(space, tried, found, and_look=False)
            total = explained(space, tried, found)
            if total > most:
                most, chosen = total, [replace(f) for f in found]
        if not changed:
            break
    if [f.best for f in chosen] != [f.best for f in found]:
        found[:] = chosen
    take_up(space, tried, found)
