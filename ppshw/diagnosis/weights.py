"""How sure a name is, beside the others: posterior weights of all names for every finding."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from ppshw.diagnosis.evidence import HANDICAP, Name, Tried
from ppshw.diagnosis.found import Found, coefficients, explained, is_both, pieces_of, take_up
from ppshw.diagnosis.kinship import OF_A_LOAD, never_turned, that_hold, winds_up
from ppshw.diagnosis.parameters import pulled_along, spread_of
from ppshw.diagnosis.workspace import Workspace

Array = NDArray[np.float64]
# Weights of names are tempered: forms of real machines differ from the library's by a share of what they explain, so
# evidence overstates, the more of it there is: E counts as E / (1 + max E / TEMPER). 100 to 300 made the true names of
# 48 findings in sealed cases likeliest (seeds 60700 to 60716, 62000 to 62023, 62800 to 62811); with 150 weights of 0.5
# to 0.7 were right in 19 of 21.
TEMPER = 300.0
# However much a name is ahead of all others, what acts may be something that looks like it and has no name here: of 56
# names that were given more than 0.95 in a deck of sealed cases (seed 9) six were wrong.
OUTSIDE = 0.05
NAMELESS: Name = ("nameless", None)
MOST_NAMES = 5  # that are told besides
# Play between rubber walls is taken up over two to eight gaps in sealed cases, as friction is in every fourth of the
# tilting joints, whose travel is short. What was taken up over half a per cent of a travel, or over one, was called
# friction with 0.77 to 0.95 in two plays of the twenty-ninth author's and two of the fifty-second's; the shortest
# friction of ten authors and of six sealed decks, where it was found, took 0.65 %.
SOFT, BRIEF = 8.0, 0.012
# How likely what a finding may as well be is, beside it: of one jump of a rail, which a base's can be, 0.30 to 0.65.
# Growth beside a scale was a scale about another place with 0.95 in two of a reviewer's three recordings of both.
MAY_BE = {"backlash": 0.7, "drift": 0.45, "clearance": 0.7, "nonlinear_stiffness": 0.7, "thermal_growth": 0.7}
# Relative to the load's spread, widths over which what falls little by little, with its load, is a joint that falls or
# one that gives way softly at first, about where the library draws the line (0.3 and 0.6): of two other authors' one
# was a fall, at 0.29, and one stiffness, at 0.30.
EITHER = (0.25, 0.65)
# Where another's bare form says more, what all near forms say is little to go by: of two reflectors one that was moved
# was a scale with 0.95, which the other's form said as well (another author's 31029).
BY_NEAR_FORMS = math.log(4.0)
ALSO_BY = 3.0  # of log evidence: 20 to 1
# Grids are sought down to a 4,000th of a travel, some at a time; positions within a twentieth turn this much alike.
FINEST_GRID, GRIDS, ON_A_GRID = 4000, 256, 0.95


def weigh(space: Workspace, tried: Tried, found: list[Found]) -> None:
    """Posterior weights of the names for every finding, given those of other names; at least OUTSIDE for no name at
    all.

    A name that was preferred for what it explains with all its near forms, though another's bare form says more, is as
    much ahead of that one as the two sets are apart, but by no more than BY_NEAR_FORMS.
    """
    whole = explained(space, tried, found)
    besides: dict[Name, Name] = {}
    for f in found:
        if f.read:
            f.weights = {f.name: 1.0 - OUTSIDE, NAMELESS: OUTSIDE}
            continue
        pieces = pieces_of(f, found)
        others = [g for g in found if g is not f and g not in pieces]
        take_up(space, tried, [*others, *pieces])  # beside its further pieces a form is known best
        f.spread = spread_of(tried, f.best, tried.said()[0])
        f.pulled = pulled_along(tried, f.best, f.spread)
        if pieces:
            take_up(space, tried, others)
        every, names = tried.said()
        f.also = _also(tried, f, every)
        if (grown := _grown(space, tried, f, others, float(every[f.best]))) is not None:
            f.also = (*f.also, f"be a scale about where the file has the instrument and growth of {grown[1]}, which "
                      "setpoints would be corrected for")  # fmt: skip
            besides[f.name] = grown
        evidence = names.copy()
        if any(is_both(f, g) for g in others):
            evidence[tried.names.index(NAMELESS)] = _but_winding_up(tried, f, every)
        top, own = int(np.argmax(evidence)), tried.names.index(f.name)
        if top != own:
            best = tried.strongest(every, top)
            rival = Found(best, tried.names[top], math.nan, float(evidence[top]), first=f.first)
            take_up(space, tried, [*others, rival], and_look=False)
            evidence[own] = evidence[top] + whole - explained(space, tried, [*others, rival])
        tempered = evidence / (1 + max(evidence.max(), 0.0) / TEMPER)
        tempered[own] = min(tempered[own], tempered[top] + BY_NEAR_FORMS) if top != own else tempered[own]
        wider = that_hold(f.name, space.machine.joint_names[-1]) if top == own else []
        for j in [tried.names.index(name) for name in wider if name in tried.names]:
            tempered[j] = tempered[own] + evidence[j] - evidence[own]  # no machine's form is nearer to these
        weights = np.exp(tempered - logsumexp(tempered))
        if f.name[0] != "nameless":
            weights = weights * (1 - OUTSIDE) + OUTSIDE * np.array([name[0] == "nameless" for name in tried.names])
        kept = [j for j in np.argsort(-weights).tolist() if tried.names[j] != NAMELESS][:MOST_NAMES]
        f.weights = {tried.names[j]: float(weights[j]) for j in (*kept, tried.names.index(NAMELESS))}
    take_up(space, tried, found)
    for f in found:
        alone = not any(is_both(f, g) for g in found)
        if alone and (other := besides.get(f.name) or as_well(space, tried, f)) is not None:
            f.weights[other] = max(f.weights.get(other, 0.0), MAY_BE[other[0]] * f.weights[f.name])
            free = f.weights.pop(NAMELESS)
            total = sum(f.weights.values())
            f.weights = {name: w * (1.0 - free) / total for name, w in f.weights.items()} | {NAMELESS: free}
        f.weights = dict(sorted(f.weights.items(), key=lambda item: -item[1]))


def _also(tried: Tried, f: Found, every: Array) -> tuple[str, ...]:
    """What else a finding may as well do, in words, for the evidence (C,) of all candidates: go with another
    thermometer, or have another period, by more than a wave over the travel, that the visits' places hardly tell from
    its own."""
    own, said = tried.candidates[f.best], dict[str | float, float]()
    if f.name == NAMELESS:
        return ()
    mine = np.flatnonzero(tried.name_of == tried.names.index(f.name))
    for j in mine:
        candidate = tried.candidates[j]
        what = candidate.shape.get("period") or candidate.covariate
        said[what] = max(said.get(what, -math.inf), float(every[j] + tried.log_share[j]))
    period = own.shape.get("period")
    least = said[period or own.covariate] - ALSO_BY
    if period is None:
        heat = (c for c in said if str(c).startswith("temp_") and c != own.covariate)
        return tuple(f"go with {c}" for c in heat if said[c] > least)
    k = tried.space.machine.joint_names.index(str(own.joint))
    travel = float(np.ptp(tried.space.recording.q[:, k]))
    others = [p for p in said if isinstance(p, float) and abs(travel / p - travel / period) > 1.0 and said[p] > least]
    unit = tried.space.machine.joints[k].unit
    known = [f"have a period of {p:.3g} {unit}" for p in sorted(others, key=lambda p: -said[p])[:1]]
    if (grid := grid_of(tried.space.recording.q[:, k])) is not None:
        alias = 1.0 / (1.0 / period + 1.0 / grid)
        known.append(f"have a period of {alias:.3g} {unit}, as all its positions are {grid:.3g} {unit} apart: where "
                     "else it goes no recording says")  # fmt: skip
    return tuple(known)


def grid_of(q: Array) -> float | None:
    """How far apart positions (N,) stand that are all on a grid, within a twentieth of it; None where they are on none
    that is coarser than a 4,000th of their travel. Of waves over such a grid nobody can tell which period they have."""
    span = float(np.ptp(q))
    turns = np.arange(2, FINEST_GRID + 1)  # both ends of the travel are on it
    for at in range(0, len(turns), GRIDS):
        some = turns[at : at + GRIDS, None] / span
        there = np.abs(np.exp(2j * np.pi * some * (q - q.min())).mean(axis=1)) > ON_A_GRID
        if there.any():
            return float(1.0 / some[np.argmax(there), 0])
    return None


def _grown(space: Workspace, tried: Tried, f: Found, others: list[Found], said: float) -> Name | None:
    """The growth that a scale about another place than the instrument's (said: its log evidence) may be, beside a scale
    about that: all that shifts with the same temperature is the base, or the machine. The others are taken up."""
    mine = tried.candidates[f.best]
    if mine.effect != "tracker_scale" or not mine.led or not mine.covariate.startswith("temp_"):
        return None
    alike = [k for k, c in enumerate(tried.candidates) if c.columns == mine.columns[:1] and c.effect == mine.effect]
    grows = [k for k, name in enumerate(tried.names) if name[0] == "thermal_growth"]
    if not alike or not grows:
        return None
    first = float(tried.said()[0][alike[0]])
    take_up(space, tried, [*others, Found(alike[0], f.name, f.p, first, first=first)])
    names = tried.said()[1]
    take_up(space, tried, others)
    growth = max(grows, key=lambda k: float(names[k]))
    together = first + tried.log_share[alike[0]] + float(names[growth])
    return tried.names[growth] if together > said + tried.log_share[f.best] - ALSO_BY else None


def _but_winding_up(tried: Tried, f: Found, every: Array) -> float:
    """What those without a name say, for the evidence (C,) of all candidates, but for any function of the way since a
    finding's joint turned back: of a joint that has play and friction such a one stood against both (`give_up`), and
    beside either says what the other does."""
    mine = tried.candidates[f.best]
    freely = tried.name_of == tried.names.index(NAMELESS)
    others = [j for j in np.flatnonzero(freely) if not winds_up(mine, tried.candidates[j])]
    said = float(logsumexp(every[others] + tried.log_share[others]))
    return HANDICAP * said if said > 0 else said


def as_well(space: Workspace, tried: Tried, f: Found) -> Name | None:
    """What a finding may as well be, whatever is measured with the machine.

    Friction play between soft walls: of a joint that loses a large part of its way after it turned back, or takes up
    what it lost over a very small part of its travel. No form tells the two apart, only how much is lost, and that not
    surely. A joint that falls to its other side a stiffness, and the other way round, where it does so softly. A jump
    of a rail that nothing before it turns one of the base, or of a first joint that turns about an axis of the base,
    which only fixed monuments tell.
    """
    candidate = tried.candidates[f.best]
    if candidate.effect == "zero_shift":
        unturned = never_turned(space.machine)
        of_base = candidate.joint in unturned.frames[1:] or (candidate.frame, candidate.component) in unturned.turns
        return ("drift", None) if of_base and ("drift", None) in tried.names else None
    if candidate.effect in OF_A_LOAD:
        first, sibling = candidate.columns[0], (next(iter(OF_A_LOAD - {candidate.effect})), candidate.joint)
        softly = first.function == "load_side" and not first.args.get("hard") and candidate.way >= 0
        either = softly and EITHER[0] <= first.args["width"] <= EITHER[1]
        return sibling if either and sibling in tried.names else None
    play = ("backlash", candidate.joint)
    if candidate.effect != "friction_hysteresis" or play not in tried.names:
        return None
    lag, covariance, _ = coefficients(space, candidate, f)
    lost = 2.0 * (abs(float(lag[0])) + float(np.sqrt(max(covariance[0, 0], 0.0))))
    travel = float(np.ptp(space.context.recording.q[:, space.machine.joint_names.index(str(candidate.joint))]))
    return play if candidate.shape["width"] < max(SOFT * lost, BRIEF * travel * (1 + 1e-9)) else None
