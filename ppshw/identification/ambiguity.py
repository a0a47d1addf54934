"""Which combinations of parameters a recording cannot tell apart, and which visits would.

The question is asked of constants, slopes, compliances and targets, with the prior of an engineer who has seen nothing
yet (the terms' `start`), not with what was learnt: a strength learnt to be nothing answers no question. In units of
that prior S, with information I = S XᵀR⁻¹X S, a column whose part beyond all others is less than 1 is hardly known
better after the recording than before (pivoted Cholesky, LAPACK dpstrf). It then moves the targets like a combination
of others. docs/derivations.md §5.5.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, lapack

from ppshw.identification.joint import Estimate, believable, lines
from ppshw.identification.visits import Linearisation
from ppshw.kinematics import frames
from ppshw.machine import WRENCH_COMPONENTS, Machine
from ppshw.quantities import enumerated
from ppshw.recording import Recording
from ppshw.statics import gravity_in_sensor
from ppshw.terms import Situation
from ppshw.terms.history import payloads, weighs

Array = NDArray[np.float64]
Index = NDArray[np.int64]
# Visits that the question is asked of, at most, spread over the recording.
ASKED = 1024
MOST_SAID = 3  # parameters of which a person is told what to measure
# Shares of a combination below this part of the largest are left out of the words.
SMALL = 0.2
# Information in one visit, in units of the prior's, from which on visits of that kind are worth their time.
WORTH = 0.1
# Keeps shares of nearly equal columns small; in units of the prior's information.
RIDGE = 1e-3
# What is tried at least of a weight, and of how far beside the sensor it hangs   [N, m].
LEAST_WEIGHT, BESIDE = 200.0, 0.5


_Moves = tuple[tuple[tuple[int, float], ...], str]


@dataclass(frozen=True)
class Visit:
    """One that would tell: q (n,), payload (6,) on the sensor; words; gain: information about the combination in units
    of the prior's."""

    q: Array
    payload: Array
    words: str
    gain: float


@dataclass(frozen=True)
class Ambiguity:
    """A parameter that moves the targets like others do.

    like   the others with their shares, per unit of the parameter, greatest effect first; empty: nothing shows it
    share  standard deviation after the recording over that before it, all others being free
    visit  that would separate them; None: no visit does, and no prediction needs it
    ground the base's name among the frames
    """

    parameter: str
    like: tuple[tuple[str, float], ...]
    share: float
    visit: Visit | None
    ground: str = "base"

    @property
    def sentence(self) -> str:
        what = _spoken(self.parameter, self.ground)
        # of a function's waves all sound alike
        spoken = list(dict.fromkeys(_spoken(name, self.ground) for name, _ in self.like))
        others = ["other parts of itself" if words == what else words for words in spoken[:3]]
        if len(spoken) > 3:
            others.append(f"{len(spoken) - 3} more")
        said = f"{what}, with {enumerated(others)}" if others else f"{what}, which nothing showed"
        return f"{said}: {'no visit separates them' if self.visit is None else 'would show with ' + self.visit.words}"

    def as_dict(self, machine: Machine) -> dict[str, Any]:
        visit = self.visit and {
            "pose": dict(zip(machine.joint_names, self.visit.q.tolist(), strict=True)),
            "wrench": dict(zip(WRENCH_COMPONENTS, self.visit.payload.tolist(), strict=True)),
            "words": self.visit.words, "gain": self.visit.gain,
        }  # fmt: skip
        return {
            "parameter": self.parameter, "like": dict(self.like), "share": self.share,
            "visit": visit, "sentence": self.sentence,
        }  # fmt: skip


def ambiguities(estimate: Estimate, recording: Recording) -> list[Ambiguity]:
    """What the visits behind an estimate cannot tell apart; first what visits would, by how much they would."""
    model = estimate.model
    parameters = model.parameters()
    asked = lines(model)
    used = believable(estimate.weights)
    which = used if len(used) <= ASKED else used[np.linspace(0, len(used) - 1, ASKED).astype(int)]
    linear = Linearisation(model, recording, estimate.theta, estimate.measuring_in_base, which)
    weights = np.full(len(which), len(used) / len(which))
    gram, _, _ = linear.normal_equations(estimate.noise, weights, asked)
    names = [p.name for p, a in zip(parameters, asked, strict=True) if a]
    start = np.array([p.start * p.scale for p, a in zip(parameters, asked, strict=True) if a])
    information = start[:, None] * gram * start
    elastic = np.array([".C[" in name for name in names])
    redundant = _redundant(information, [np.flatnonzero(~elastic), np.flatnonzero(elastic)])
    visits, words = _candidates(model.machine, recording.subset(used))
    seen = _visible(estimate, visits, asked) * start  # (C, K, p) per unit of the prior
    out = []
    for parameter, kept, shares, beyond in redundant:
        direction = np.zeros(len(start))
        direction[parameter] = 1.0
        direction[kept] = -shares
        gain = ((seen @ direction) ** 2).sum(axis=1) / (direction**2).sum()
        order = np.argsort(-np.abs(shares))
        least = SMALL * max(np.abs(shares).max(initial=0.0), SMALL)
        like = [(names[kept[j]], float(shares[j] * start[kept[j]] / start[parameter])) for j in order
                if abs(shares[j]) > least]  # fmt: skip
        best = _simplest(gain)
        visit = None if best is None else Visit(visits.q[best], visits.payload[best], words[best], float(gain[best]))
        share = float(np.sqrt(1.0 / (1.0 + max(beyond, 0.0))))
        out.append(Ambiguity(names[parameter], tuple(like), share, visit, model.machine.frame_names[0]))
    return sorted(out, key=lambda a: -(a.visit.gain if a.visit else 0.0))


def _redundant(information: Array, stages: list[Index]) -> list[tuple[int, Index, Array, float]]:
    """Columns whose part beyond others is less than their prior, said by those of the same stage or an earlier one.

    returns  per column: its index, the columns that are kept, its shares in them, and the information beyond them
    """
    kept = np.zeros(0, dtype=np.int64)
    out: list[tuple[int, Index, Array, float]] = []
    for stage in stages:
        if not len(stage):
            continue
        left = information[np.ix_(stage, stage)] - _explained(information, kept, stage)[1]
        _, order, rank, _ = lapack.dpstrf(left, tol=1.0, lower=1)
        rest = stage[order[rank:] - 1]
        kept = np.concatenate([kept, stage[order[:rank] - 1]])
        shares, explained = _explained(information, kept, rest)
        beyond = np.diag(information)[rest] - np.diag(explained)
        out += [(int(c), kept, shares[:, k], float(beyond[k])) for k, c in enumerate(rest)]
    return out


def _explained(information: Array, kept: Index, columns: Index) -> tuple[Array, Array]:
    """Shares (kept, columns) in the kept columns, and the part (columns, columns) of the information they explain."""
    if not len(kept):
        return np.zeros((0, len(columns))), np.zeros((len(columns), len(columns)))
    across = information[np.ix_(kept, columns)]
    inner = information[np.ix_(kept, kept)] + RIDGE * np.eye(len(kept))
    shares = cho_solve(cho_factor(inner, lower=True), across)
    return shares, across.T @ shares


def summary(found: list[Ambiguity]) -> list[str]:
    """For a person: how many, and a line each of what to measure for those that a visit would tell."""
    if not found:
        return ["the recording tells all of them apart"]
    open_ones = [a for a in found if a.visit is not None]
    always = len(found) - len(open_ones)
    said = f"{len(found)} parameters move the targets like others do; {always} of them at any visit"
    return [said, *(a.sentence for a in open_ones[:MOST_SAID])]


def _simplest(gain: Array) -> int | None:
    """Candidates come simple ones first: the first one that tells half as much as the best."""
    if gain.max() < WORTH:
        return None
    return int(np.argmax(gain >= 0.5 * gain.max()))


def _visible(estimate: Estimate, visits: Situation, asked: NDArray[np.bool_]) -> Array:
    """(C, 3T, p) whitened design of candidate visits at which every target is seen."""
    linear = estimate.model.linearise(visits, estimate.theta)
    count, targets = len(visits), linear.positions.shape[1]
    seen = np.ones((count, targets), dtype=bool)
    root = estimate.noise.whitener(linear.levers, seen)
    return np.asarray(root @ linear.design.reshape(count, 3 * targets, -1)[:, :, asked])


def _candidates(machine: Machine, known: Recording) -> tuple[Situation, list[str]]:
    """Visits to choose from, simple ones first: one joint elsewhere, another load, both, two joints elsewhere.

    Loads are weights that hang where they are put, so that their force points down whatever the pose.
    """
    middle = np.median(known.q, axis=0)
    lower, upper = machine.limits()
    lower = np.where(np.isfinite(lower), lower, known.q.min(axis=0))
    upper = np.where(np.isfinite(upper), upper, known.q.max(axis=0))
    moves: list[_Moves] = []
    for k, joint in enumerate(machine.joints):
        unit = "m" if joint.prismatic else "rad"
        moves += [(((k, end),), f"{joint.name} at {end:.3g} {unit}") for end in (lower[k], upper[k])]
    stay: list[_Moves] = [((), "")]
    pairs = [((*a, *b), f"{one} and {two}") for (a, one), (b, two) in itertools.combinations(moves, 2)
             if a[0][0] != b[0][0]]  # fmt: skip
    weight = max(float(np.linalg.norm(known.wrench[:, :3], axis=1).max()), LEAST_WEIGHT)
    arm = max(BESIDE, float(np.abs(known.wrench[:, 3:]).max()) / weight)
    arms = [np.zeros(3), *(sign * arm * axis for axis in np.eye(3) for sign in (1.0, -1.0))]
    mass = weight / max(float(np.linalg.norm(machine.gravity)), 1e-9)
    loads = [np.zeros(4), *(mass * np.append(1.0, arm) for arm in arms)]  # as of `payloads`
    plans: list[tuple[_Moves, Array | None]] = [(place, None) for place in moves]
    plans += [(place, load) for place in (*stay, *moves) for load in loads]
    plans += [(place, None) for place in pairs]
    q = np.array([middle] * len(plans))
    for row, ((changes, _), _) in enumerate(plans):
        for k, end in changes:
            q[row, k] = end
    usual = np.median(payloads(known.wrench, known.load, _gravity(machine, known.q)), axis=0)
    held = np.array([usual if load is None else load for _, load in plans])
    payload = weighs(held, _gravity(machine, q))
    words = [" under ".join(w for w in (place[1], "" if load is None else _load_words(wrench)) if w)
             for (place, load), wrench in zip(plans, payload, strict=True)]  # fmt: skip
    return Situation(q, payload), words


def _gravity(machine: Machine, q: Array) -> Array:
    """(C, 3) in the sensor's frame [m/s²], of joint values (C, n)."""
    return gravity_in_sensor(machine, frames(machine, q))


def _load_words(wrench: Array) -> str:
    if not wrench.any():
        return "no load"
    weight, k = float(np.linalg.norm(wrench[:3])), int(np.argmax(np.abs(wrench[3:])))
    moment = float(wrench[3 + k])
    where = f"with moment about {'xyz'[k]} ({_short(moment)} N·m)" if abs(moment) > 0.05 * weight else "over the sensor"
    return f"a load of {_short(weight)} N {where}"


def _short(value: float) -> str:
    """Three digits, and no power of ten in what a machine carries."""
    return f"{float(f'{value:.3g}'):g}"


NAME = re.compile(r"(?P<frame>.+)\.(?:(?P<component>[tr][xyz])|C\[(?P<a>\w+),(?P<b>\w+)\])\[(?P<index>\d+)\]")


def _spoken(name: str, ground: str) -> str:
    """`vertical.ty[0]` → ty of frame vertical."""
    match = NAME.fullmatch(name)
    if match is None:
        target, _, axis = name.removeprefix("target.").rpartition(".")
        return f"{axis} of target {target}" if name.startswith("target.") else name
    what = match["component"] or f"{match['a']} per {match['b']}"
    which = int(match["index"])
    change = "" if which == 0 else "the slope of " if match["component"] else "how its position changes "
    frame = "the base" if match["frame"] == ground else f"frame {match['frame']}"
    return f"{change}{what} of {frame}"
