"""`ppshw plan --to-separate A,B`: visits that would tell two effects apart, given what was measured or planned.

With X the base model's design, V = R + X Λ Xᵀ and Z_B the forms of B with a prior Λ_B, a field f of A has

    λ = S_ff − S_fB (S_BB + Λ_B⁻¹)⁻¹ S_Bf,      S = Fᵀ V⁻¹ F,  F = [f, Z_B]

left that neither B nor the base model can mimic. Both ways round: A taken for B, B for A. Where a recording shows one
of them, f is A as it is found there, and Z_B are the forms of B that fit it best: these two are to be told apart. Else
f moves the reflectors by the repeatability, rms over a recording that has every candidate in it, and the middling form
of A speaks for it.

Visits come in blocks (`blocks`), chosen greedily for the gain per minute, or per visit where visits are short. A block
adds rᵀ C⁻¹ r to S, with r its columns less what the base model predicts of them and C = I + x P xᵀ the prediction's
covariance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from campaigns.design.belief import Belief, learnt, typical
from campaigns.design.blocks import Block, blocks
from campaigns.design.designer import loads_for
from campaigns.design.loads import measured_with
from campaigns.design.write import joints_text, load_text, word
from campaigns.foresight import approaches, pretended, springs, would_be
from campaigns.plan import Plan
from campaigns.script import EMPTY, LoadCase
from ppshw import __version__
from ppshw.diagnosis.evidence import Name, Tried
from ppshw.diagnosis.library import Candidate, library
from ppshw.diagnosis.visibility import thinned
from ppshw.diagnosis.workspace import caution_of, prepare
from ppshw.errors import CampaignError
from ppshw.identification import identify
from ppshw.identification.joint import Estimate
from ppshw.machine import Machine
from ppshw.recording import Recording
from ppshw.terms import Situation
from ppshw.terms.shapes import Column, Context, Key

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
# Names are told apart from this √λ on: nine of ten, with what a name pays for its forms (docs/diagnosis-method.md §7).
ENOUGH = 6.0
FORMS, MANY = 8, 60  # of each name, to choose visits by; to say how much alike two names may be
SHOWN = 3.0  # of log evidence, from which on a recording shows an effect
HELP = 0.3  # by which √λ must grow at least, or the visits are of no help
NEEDLESS = 0.02  # of all that is gained: a block that adds less is left out
TAIL = 12  # visits before a block that its history is computed from
AMPLITUDE = 3.0  # of the other effect, in units of the repeatability
MOST_VISITS = 30
AS_FOUND, AT_UNIT = "as found", "at 1 × repeatability"


@dataclass(frozen=True)
class Wanted:
    """effects: two names of the contract's table; joint: only there, None: every joint that has both; so_far: a
    recording, or a plan; visits: at most so many more; loads: what can be put on, None: what so_far has, and parts of
    it; estimate: of the recording."""

    machine: Machine
    effects: tuple[str, str]
    joint: str | None
    so_far: Recording | Plan
    visits: int | None
    seed: int
    name: str
    asked: str
    loads: tuple[LoadCase, ...] | None = None
    estimate: Estimate | None = None


@dataclass(frozen=True)
class Separation:
    """rows: per pair, √λ before and after, each effect taken for the other, of the form found or the middling one, and
    before of the form that is most alike; text: the script; blocks: in its order, none where all are told apart already
    (or nothing helps) and there is no script; of: whose √λ it is, in words."""

    rows: list[dict[str, Any]]
    blocks: tuple[Block, ...]
    text: str
    of: str

    def why_none(self) -> str:
        """Why there are no blocks."""
        if all(r["before"] >= ENOUGH for r in self.rows):
            nearest = min(r["nearest"] for r in self.rows)
            alike = f"; the forms most alike stay so (√λ {nearest:.1f})" if nearest < ENOUGH else ""
            which = "they" if self.of == AS_FOUND else "middling forms"
            return f"{which} are told apart already (√λ of {ENOUGH:g} is enough){alike}: nothing written"
        return "not told apart, and none of the visits tried would help (as many as --visits allows): nothing written"

    def lines(self) -> list[str]:
        out = []
        for r in self.rows:
            out.append(
                f"{_taken_for(r)}: √λ {r['before']:.1f} before, {r['after']:.1f} after, {self.of}"
                f"{'' if r['after'] >= ENOUGH else ' (not enough)'}"
            )
        told: dict[str, int] = {}
        for block in self.blocks:
            told[block.what] = told.get(block.what, 0) + len(block.q)
        out += [f"  {what}: {count} visits" for what, count in told.items()]
        if self.blocks and any(r["after"] < ENOUGH for r in self.rows):
            out.append("more visits (--visits) go farther where that is not enough")
        return out


def separate(wanted: Wanted, progress: Progress | None = None) -> Separation:
    """Choose the visits. Raises CampaignError when an effect is unknown or has no form here."""
    machine = wanted.machine
    recording, belief, cases, unit = _so_far(wanted)
    shown = {} if isinstance(wanted.so_far, Plan) else _shown(wanted, recording)
    asked = {wanted.joint} if wanted.joint else {joint for _, joint in shown if joint} or set(machine.joint_names)
    which = [k for k, name in enumerate(machine.joint_names) if name in asked]
    offered = blocks(machine, cases, which, wanted.seed, in_parts=wanted.loads is None)
    whole = _followed_by(recording, offered, machine)
    theta = belief.theta + springs(belief.model, belief.strengths)
    now, rich = (Context.of(belief.model, theta, r, machine.tracker.frame) for r in (recording, whole))
    columns, pairs = _columns(now, rich, wanted, FORMS, shown)
    laid = _Laid.at_repeatability(belief, theta, rich, columns, unit)
    pairs = [pair.of_size(laid.scale) for pair in pairs]
    state = laid.state(recording)
    if shown:
        nearest = [pair.strength(state.s) for pair in pairs]
    else:
        every, all_pairs = _columns(now, rich, wanted, MANY)
        with_many = _Laid.at_repeatability(belief, theta, rich, every, unit).state(recording)
        nearest = [pair.strengths(with_many.s).min() for pair in all_pairs]
    before = state.copy()
    tail = recording.subset(np.arange(max(0, len(recording) - TAIL), len(recording)))
    rows = []
    for k, block in enumerate(offered):
        x, f = laid.rows(_followed_by(tail, [block], machine), len(block.q))
        rows.append((x, f))
        if progress:
            progress(k, len(offered))
    chosen = _chosen(state, offered, rows, pairs, wanted.visits or MOST_VISITS, machine)
    picked = tuple(sorted((offered[k] for k in chosen), key=lambda b: b.case.name))
    after = laid.state(_followed_by(recording, picked, machine)) if picked else before
    table = [
        {"effect": pair.of[0], "joint": pair.of[1], "for": pair.by[0], "for_joint": pair.by[1],
         "before": pair.strength(before.s), "after": pair.strength(after.s), "nearest": float(least)}
        for pair, least in zip(pairs, nearest, strict=True)
    ]  # fmt: skip
    of = AS_FOUND if shown else AT_UNIT
    return Separation(table, picked, _script(wanted, picked, table, of), of)


# --- what is known so far -------------------------------------------------------------------------------------------
def _so_far(wanted: Wanted) -> tuple[Recording, Belief, list[LoadCase], float]:
    """The visits made or planned, what is believed, loads that may be put on (empty first), the repeatability [m]."""
    machine, known = wanted.machine, wanted.so_far
    point = machine.point(machine.where_it_counts)
    if isinstance(known, Plan):
        recording = would_be(known)
        belief = typical(machine, len(recording), point)
        cases = list(known.script.loads)
    else:
        recording = known.subset(known.measured)
        found = wanted.estimate or identify(machine, recording)
        belief = learnt(found.model.machine, len(recording), found.groups, found.noise, recording.source)
        cases = measured_with(recording, machine) or list(loads_for(machine, point, None, None)[1])
    cases = list(wanted.loads or cases)
    unit = belief.noise.repeatability
    return recording, belief, [EMPTY, *(c for c in cases if c.mass > 0)], unit


def _followed_by(recording: Recording, more: Sequence[Block], machine: Machine) -> Recording:
    """A recording and then blocks of visits, in its own columns; thermometers go on from what they read last as the air
    does, columns of other kinds stay at it."""
    q = np.concatenate([block.q for block in more])
    cases = [block.case for block in more for _ in block.q]
    last = recording.time[-1]
    hang = [recording.load[-1], *(block.case.name for block in more[:-1])]
    hours = (
        np.cumsum(np.concatenate([block.seconds(machine, on) for block, on in zip(more, hang, strict=True)])) / 3600.0
    )
    via = np.vstack([recording.q[-1:], q[:-1]])
    signs = approaches(q, via)
    for k in range(len(signs)):  # what has not moved yet keeps the direction it had
        signs[k] = np.where(signs[k] == 0, recording.approach[-1], signs[k])
    seen = np.ones((len(q), len(machine.targets)), dtype=bool)
    new = pretended(machine, ["separate"] * len(q), cases, q, signs, hours, 5.0, seen)
    later = hours * 3600.0 + (0.0 if math.isnan(last) else last)
    air = new.temperatures["air"] - new.temperatures["air"][0]
    return recording.followed_by(
        replace(
            new,
            time=np.full(len(q), np.nan) if math.isnan(last) else later,
            temperatures={place: read[-1] + air for place, read in recording.temperatures.items()},
            covariates={name: np.full(len(q), read[-1]) for name, read in recording.covariates.items()},
        )
    )


# --- what competes --------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Pair:
    """of, by: names; forms (F, K) coefficients of `of`'s forms at 1 × repeatability, or of the one that was found in
    metres and radians; rivals (K,) columns of `by`."""

    of: Name
    by: Name
    forms: Array
    rivals: NDArray[np.int64]
    found: bool = False

    def of_size(self, scale: Array) -> _Pair:
        """The same with all coefficients for columns that are so large (K,)."""
        return replace(self, forms=self.forms / np.where(scale > 0, scale, np.inf)) if self.found else self

    def strength(self, s: Array) -> float:
        """√λ of the middling form: one that is easily told apart shall not speak for the others."""
        return float(np.sqrt(np.median(self.strengths(s) ** 2)))

    def strengths(self, s: Array) -> Array:
        """(F,) √λ of every form."""
        cross = self.forms @ s[:, self.rivals]
        amplitude = AMPLITUDE * max(1.0, float(np.linalg.norm(self.forms, axis=1).max()))
        inner = s[np.ix_(self.rivals, self.rivals)] + np.eye(len(self.rivals)) / amplitude**2
        left = np.einsum("fk,kl,fl->f", self.forms, s, self.forms)
        left -= np.einsum("fb,bf->f", cross, np.linalg.solve(inner, cross.T))
        return np.asarray(np.sqrt(np.maximum(left, 0.0)))


def _shown(wanted: Wanted, recording: Recording) -> dict[Name, list[tuple[Candidate, Array]]]:
    """The forms of each name that fit a recording best, the best first, with their coefficients [m, rad]: of the pair
    of names that it shows most of; none where it shows neither effect, or has no form of one of them."""
    space = prepare(wanted.machine, recording, np.ones(len(recording), dtype=bool))
    mine = [k for k in library(space.context) if k.effect in wanted.effects]
    if wanted.joint is not None:
        mine = [k for k in mine if k.joint in (wanted.joint, None)]
    if {k.effect for k in mine} != set(wanted.effects):
        return {}
    tried = Tried(space, mine, space.unit)
    said = tried.said()[0] + tried.log_share
    if said.max() < SHOWN:
        return {}
    effect, joint = tried.name(int(np.argmax(said)))
    out: dict[Name, list[tuple[Candidate, Array]]] = {}
    for k in np.argsort(-said):
        name = tried.name(int(k))
        met = name == (effect, joint) or (name[0] != effect and (name[1] == joint or None in (name[1], joint)))
        if met and len(forms := out.setdefault(name, [])) < FORMS:
            forms.append((tried.candidates[k], tried.fitted(int(k))))
    return out if len({effect for effect, _ in out}) == 2 else {}


def _columns(
    now: Context,
    rich: Context,
    wanted: Wanted,
    most: int,
    shown: Mapping[Name, Sequence[tuple[Candidate, Array]]] = MappingProxyType({}),
) -> tuple[list[Column], list[_Pair]]:
    """Columns of at most so many forms of each name, each column once, and the pairs of names to be told apart.

    now, rich  the visits until now, in which what happened at some moment happened; with all that may be measured,
               which shows forms that nothing asked for until now
    shown      the forms that were found, if any: these compete
    """
    forms = {name: [k for k, _ in best] for name, best in shown.items()} or _middling(now, rich, wanted, most)
    a, b = wanted.effects
    met = [
        (one, two) for one in forms if one[0] == a for two in forms if two[0] == b
        if one[1] == two[1] or one[1] is None or two[1] is None
    ]  # fmt: skip
    if wanted.joint is not None:
        met = [(one, two) for one, two in met if {one[1], two[1]} <= {wanted.joint, None}]
    if not met:
        raise CampaignError(f"--to-separate: {a} and {b} share no joint{_of(wanted.joint)}")
    columns: list[Column] = []
    at: dict[Key, int] = {}
    for name in {name for pair in met for name in pair}:
        for k in forms[name]:
            for column in k.columns:
                if column.key not in at:
                    at[column.key] = len(columns)
                    columns.append(column)
    pairs = []
    for one, two in met:
        for of, by in ((one, two), (two, one)):
            rivals = sorted({at[c.key] for k in forms[by] for c in k.columns})
            speak = (
                shown[of][:1] if shown else [(k, np.full(len(k.columns), len(k.columns) ** -0.5)) for k in forms[of]]
            )
            each = np.zeros((len(speak), len(columns)))
            for row, (k, coefficients) in zip(each, speak, strict=True):
                row[[at[c.key] for c in k.columns]] = coefficients
            pairs.append(_Pair(of, by, each, np.array(rivals), bool(shown)))
    return columns, pairs


def _middling(now: Context, rich: Context, wanted: Wanted, most: int) -> dict[Name, list[Candidate]]:
    """At most so many forms of each name, drawn evenly; now, rich as in `_columns`.

    Raises CampaignError where an effect has none.
    """
    every = [k for k in library(rich) if not _at_a_moment(k)] + [k for k in library(now) if _at_a_moment(k)]
    forms: dict[Name, list[Candidate]] = {}
    for effect in wanted.effects:
        mine = [k for k in every if k.effect == effect]
        if not mine:
            known = sorted({k.effect for k in every})
            raise CampaignError(
                f"--to-separate: '{effect}' has no form that these visits could show (there are: {', '.join(known)})"
            )
        for k in thinned(mine, most)[0]:
            forms.setdefault((effect, k.joint), []).append(k)
    return forms


def _at_a_moment(candidate: Candidate) -> bool:
    return any("time_h" in name for name in candidate.shape)


def _rms(displacement: Array, recording: Recording) -> float:
    return float(np.sqrt((displacement**2).sum() / max(int(recording.seen.sum()), 1)))


# --- information ----------------------------------------------------------------------------------------------------
@dataclass
class _State:
    """p (P, P) posterior covariance of the base model's parameters, prior of unit size; h (P, K) XᵀR⁻¹F; s (K, K)."""

    p: Array
    h: Array
    s: Array

    def copy(self) -> _State:
        return _State(self.p.copy(), self.h.copy(), self.s.copy())

    def gain(self, x: Array, f: Array) -> Array:
        """(K, K) what rows x (m, P), f (m, K) add to s."""
        r, whole, _ = self._new(x, f)
        return np.asarray(r.T @ np.linalg.solve(whole, r))

    def take(self, x: Array, f: Array) -> None:
        r, whole, xp = self._new(x, f)
        self.s = self.s + r.T @ np.linalg.solve(whole, r)
        self.h = self.h + x.T @ f
        self.p = self.p - xp.T @ np.linalg.solve(whole, xp)

    def _new(self, x: Array, f: Array) -> tuple[Array, Array, Array]:
        xp = x @ self.p
        return f - xp @ self.h, np.eye(len(x)) + xp @ x.T, xp


@dataclass
class _Laid:
    """Rows of visits: the base model's columns in units of their priors, and the effects' at 1 × repeatability."""

    belief: Belief
    theta: Array
    frame: Array
    reference: dict[str, float]
    columns: Sequence[Column]
    scale: Array

    @classmethod
    def at_repeatability(
        cls, belief: Belief, theta: Array, rich: Context, columns: Sequence[Column], unit: float
    ) -> _Laid:
        """Every column as large as the repeatability `unit` [m], rms over the recording of a context."""
        sizes = np.array([_rms(c.evaluate(rich), rich.recording) for c in columns])
        scale = np.where(sizes > 1e-15, unit / np.maximum(sizes, 1e-15), 0.0)
        return cls(belief, theta, rich.measuring_in_base, rich.reference, columns, scale)

    def state(self, recording: Recording) -> _State:
        x, f = self.rows(recording, len(recording))
        p = np.asarray(np.linalg.inv(np.eye(x.shape[1]) + x.T @ x), dtype=np.float64)
        h = x.T @ f
        return _State(p, h, np.asarray(f.T @ f - h.T @ p @ h))

    def rows(self, recording: Recording, last: int) -> tuple[Array, Array]:
        """White rows (m, P) and (m, K) of the last visits of a recording."""
        context = Context.of(self.belief.model, self.theta, recording, self.frame, dict(self.reference))
        f = np.stack([c.evaluate(context) for c in self.columns], axis=2)[-last:] * self.scale
        lin = self.belief.model.linearise(Situation.of(recording.subset(np.arange(len(recording))[-last:])), self.theta)
        seen = recording.seen[-last:]
        root = np.linalg.inv(np.linalg.cholesky(self.belief.noise.covariance(lin.levers, seen, np.ones(last))))
        rows = np.repeat(seen, 3, axis=1)
        root = root * (rows[:, :, None] & rows[:, None, :])
        strengths = self.belief.strengths
        x = lin.design.reshape(last, rows.shape[1], -1) * caution_of(self.belief.model, strengths) * strengths
        x, f = root @ x, root @ f
        return x.reshape(-1, x.shape[2]), f.reshape(-1, f.shape[2])


def _chosen(
    state: _State, offered: Sequence[Block], rows: Sequence[tuple[Array, Array]], pairs: Sequence[_Pair], most: int,
    machine: Machine,
) -> list[int]:  # fmt: skip
    """Blocks in the order they are taken: for the most gain per minute where that tells all apart within `most` visits;
    else for the most per visit, of which there are too few, where that comes farther. None that hardly help."""
    sizes = np.array([float(len(block.q)) for block in offered])
    minutes = np.array([block.seconds(machine).sum() / 60.0 for block in offered])
    found = _greedy(state, rows, pairs, minutes, sizes, most)
    if not _all_told(pairs, _with(state, rows, found).s):
        found = max(
            found, _greedy(state, rows, pairs, sizes, sizes, most),
            key=lambda chosen: _worth(pairs, _with(state, rows, chosen).s),
        )  # fmt: skip
    after = _with(state, rows, found).s
    for k in list(reversed(found)):  # cheap ones are taken early that later ones make needless
        without = _with(state, rows, [j for j in found if j != k]).s
        gained = _worth(pairs, after) - _worth(pairs, state.s)
        if _worth(pairs, after) - _worth(pairs, without) < NEEDLESS * gained:
            found, after = [j for j in found if j != k], without
    lacking = [pair for pair in pairs if pair.strength(state.s) < ENOUGH]
    return found if any(pair.strength(after) > pair.strength(state.s) + HELP for pair in lacking) else []


def _greedy(
    state: _State, rows: Sequence[tuple[Array, Array]], pairs: Sequence[_Pair], cost: Array, sizes: Array, most: int
) -> list[int]:
    """The most gain for its cost, block after block, until all are told apart or `most` visits are reached."""
    state, chosen = state.copy(), list[int]()
    while not _all_told(pairs, state.s):
        now, best, gain = _worth(pairs, state.s), -1, 0.0
        for k, (x, f) in enumerate(rows):
            if k in chosen or sizes[chosen].sum() + sizes[k] > most:
                continue
            more = (_worth(pairs, state.s + state.gain(x, f)) - now) / cost[k]
            if more > gain:
                best, gain = k, more
        if best < 0:
            break
        state.take(*rows[best])
        chosen.append(best)
    return chosen


def _with(state: _State, rows: Sequence[tuple[Array, Array]], chosen: Sequence[int]) -> _State:
    out = state.copy()
    for k in chosen:
        out.take(*rows[k])
    return out


def _all_told(pairs: Sequence[_Pair], s: Array) -> bool:
    return min(pair.strength(s) for pair in pairs) >= ENOUGH


def _worth(pairs: Sequence[_Pair], s: Array) -> float:
    """What is told apart already counts no more, what is hard counts most."""
    return float(sum(np.log1p(min(1.0, pair.strength(s) ** 2 / ENOUGH**2)) for pair in pairs))


# --- the script -----------------------------------------------------------------------------------------------------
def _script(wanted: Wanted, picked: Sequence[Block], table: Sequence[dict[str, Any]], of: str) -> str:
    """An ordinary campaign; every block is a step, as the visits' order is what matters."""
    machine = wanted.machine
    loads = {block.case.name: block.case for block in picked}
    lines = [
        f"# Chosen by {wanted.asked}, version {__version__}, seed {wanted.seed}.",
        f"# Machine '{machine.name}', file {machine.sha256[:12]}. Visits that tell {wanted.effects[0]} and",
        f"# {wanted.effects[1]} apart; expected √λ {of}, before and after:",
        *(f"#   {_taken_for(r)}: {r['before']:.1f}, {r['after']:.1f}" for r in table),
        f"name: {word(wanted.name)}",
        f"about: {sum(len(b.q) for b in picked)} visits in blocks that are measured in the order they are written",
        f"seed: {wanted.seed}",
        "order: as_written",
        "loads:",
        *(f"  - {load_text(case)}" for case in loads.values()),
        "steps:",
    ]
    for k, block in enumerate(picked, 1):
        lines += [
            f"  - step: block_{k}  # {block.what}",
            "    kind: poses",
            f"    loads: [{word(block.case.name)}]",
            "    poses:",
            *(f"      - {{q: {joints_text(machine.joint_names, q)}}}" for q in block.q),
        ]
    return "\n".join(lines) + "\n"


def _taken_for(r: dict[str, Any]) -> str:
    same = r["joint"] == r["for_joint"]
    return f"{r['effect']}{_of(r['joint'])} taken for {r['for']}{'' if same else _of(r['for_joint'])}"


def _of(joint: str | None) -> str:
    return "" if joint is None else f" of {joint}"
