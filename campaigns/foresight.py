"""What a campaign will be able to show, before it is run: a would-be recording of the plan, the library laid over it.

The would-be recording has the plan's setpoints, approach directions, loads (by statics) and times; its machine is the
nominal one and nothing scatters. Prior strengths are those of typical machines, the noise is the stated repeatability.
What nobody knows beforehand is assumed and said: the air's temperature.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from textwrap import wrap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from campaigns.design.belief import Belief, typical_of
from campaigns.design.loads import wrench
from campaigns.plan import Plan
from campaigns.script import LoadCase
from ppshw.diagnosis.evidence import Name, Tried
from ppshw.diagnosis.library import library
from ppshw.diagnosis.visibility import NEVER, Sight, row, sights, thinned
from ppshw.diagnosis.workspace import Workspace, prepare
from ppshw.identification.joint import Estimate
from ppshw.kinematics import point_positions
from ppshw.machine import Machine
from ppshw.model import Model
from ppshw.recording import Recording
from ppshw.terms.elastic import Compliance
from ppshw.transforms import inverse

Array = NDArray[np.float64]
# The hall's air, where nobody has measured it: a slow swing and the air conditioning's. A guess: amplitude [K], hours.
SWINGS = ((1.0, 8.0), (0.2, 1.7))
ASSUMED = "one thermometer, air that swings by 2 K in 4 hours"
# What no campaign shows is asked of random poses with a load of its own at every visit, so many of them at least; the
# loads as far out and as heavy as the script's, or (a guess) this far [m] and this share of the machine's own weight.
AT_LEAST, FAR_OUT, HEAVY = 450, 0.3, 0.05
HOURS = 8.0  # that it takes at least: what a working day holds
# A typical form of which the base model leaves so much, and that many visits do not show, is hidden by the noise.
LEFT_OVER = 0.05
# A campaign is blind to an effect when it would miss it at so many times the stated repeatability.
BLIND_BEYOND = 2.0
MOST_LINES = 8
# What has a joint's name, and what has none; the rest depends on how the machine is built.
OF_EVERY_JOINT = (
    "backlash", "friction_hysteresis", "periodic_transmission", "cross_coupling", "zero_shift", "thermal_growth",
    "clearance",
)  # fmt: skip
OF_NO_JOINT = ("drift", "tracker_scale", "wrench_error", "creep", "target_moved")
TO_ADD = {
    "backlash": "approach from both sides",
    "friction_hysteresis": "approach from both sides, small reversals",
    "thermal_growth": "hours in which the temperature goes up and down",
    "drift": "a reference pose every 15 visits, over hours",
    "tracker_scale": "poses farther apart, or a tracker whose place is known",
    "periodic_transmission": "more positions of the joint, off any grid",
    "nonlinear_stiffness": "five loads or more, of very different moments",
    "clearance": "loads whose moment crosses zero",
    "cross_coupling": "random poses",
    "moving_weight": "poses that change the joints behind it together",
    "wrench_error": "loads of known, very different mass and centre",
    "creep": "load changes, and holds after them",
    "zero_shift": "a reference pose every 15 visits",
    "missing_compliance": "loads of very different moments",
    "target_moved": "a reference pose every 15 visits, three reflectors",
}


@dataclass(frozen=True)
class Foresight:
    """space, tried: the library over the would-be recording; rows of every name; unit: the stated repeatability, rms at
    the reflectors [m]; never: names that no campaign of this machine would show either; noisy: those of them that the
    noise hides, not the base model."""

    space: Workspace
    tried: Tried
    seen: tuple[Sight, ...]
    absent: tuple[Name, ...]
    unit: float
    never: frozenset[Name] = frozenset()
    noisy: frozenset[Name] = frozenset()

    @property
    def rows(self) -> list[dict[str, Any]]:
        """As `visibility` of `diagnose`, and what no size would show: share 0, detectable_mm null."""
        found = [row(sight) for sight in self.seen]
        found += [
            {"effect": effect, "joint": joint, "share": 0.0, "detectable_mm": None, "aliases": [],
             "share_range": [0.0, 0.0], "detectable_range_mm": None}
            for effect, joint in self.absent
        ]  # fmt: skip
        for entry in found:
            size = entry["detectable_mm"]
            if size is not None:
                ends = [x if x < 1e3 * NEVER else None for x in entry["detectable_range_mm"]]
                entry["detectable_range_mm"] = None if ends == [None, None] else ends
            if size is not None and size >= 1e3 * NEVER:
                entry["detectable_mm"] = size = None
            entry["blind"] = size is None or size > 1e3 * BLIND_BEYOND * self.unit
            entry["no_campaign"] = (entry["effect"], entry["joint"]) in self.never
        return found

    def warnings(self) -> list[str]:
        """The blind effects in plain words, at most MOST_LINES; the first line says what was assumed."""
        asked, hidden, taken = (dict[str, list[str | None]]() for _ in range(3))
        for entry in self.rows:
            if entry["blind"]:
                noisy = (entry["effect"], entry["joint"]) in self.noisy
                group = hidden if noisy else taken if entry["no_campaign"] else asked
                group.setdefault(entry["effect"], []).append(entry["joint"])
        beyond, said = f"{BLIND_BEYOND:g} × repeatability", f"({ASSUMED} assumed)"
        if asked:
            lines = [f"blind to what stays unseen at {beyond} {said}:"]
        elif hidden:
            lines = [f"what stays unseen at {beyond}, no campaign in such noise shows either {said}:"]
        else:
            lines = [f"sees every effect of {beyond} that a campaign can show {said}"]
        order = sorted(asked, key=lambda effect: (-len(asked[effect]), effect))
        most = MOST_LINES - 2 - bool(hidden) - bool(taken)
        for effect in order[:most]:
            lines.append(f"  {effect}{self._of(effect, asked[effect])}: add {TO_ADD[effect]}")
        if left := order[most:]:
            lines.append(f"  and {', '.join(left)} (--visibility lists all)")
        if hidden:
            lines.append(f"  the noise hides {self._list(hidden)}: many more visits, or a better instrument")
        if taken:
            lines.append(
                f"  no campaign on this machine shows typical {self._list(taken)}: constants and compliances take them"
            )
        return lines

    def _list(self, group: dict[str, list[str | None]]) -> str:
        return ", ".join(f"{effect}{self._of(effect, joints)}" for effect, joints in sorted(group.items()))

    def _of(self, effect: str, joints: Sequence[str | None]) -> str:
        every = [name[1] for name in [*(s.name for s in self.seen), *self.absent] if name[0] == effect]
        if every == [None]:
            return ""
        if len(joints) == len(every) > 1:
            return " of every joint"
        return f" of {', '.join('the base' if j is None else j for j in joints)}"

    def table(self) -> list[str]:
        """Every effect and joint, in lines of 80."""
        lines = [f"{'effect':22}{'joint':14}{'share':>8}{'detectable':>12}  not to be told from"]
        for entry in sorted(self.rows, key=lambda e: e["effect"]):
            size = entry["detectable_mm"]
            said = "never" if size is None else f"{size:.3f} mm"
            head = (
                f"{entry['effect']:22}{entry['joint'] or '-':14}{100 * entry['share']:7.1f}%{said:>12}"
                f"{'!' if entry['blind'] else ' '} "
            )
            aliases = wrap(", ".join(entry["aliases"]), max(22, 80 - len(head))) or [""]
            lines += [head + aliases[0], *(" " * len(head) + more for more in aliases[1:])]
        if any(entry["blind"] for entry in self.rows):
            lines.append(f"! stays unseen at {BLIND_BEYOND:g} × repeatability")
        return lines


def foresee(plan: Plan, most: int = 12) -> Foresight:
    """Lay the library over a plan. most: forms of each name that are tried."""
    recording = would_be(plan)
    space = laid_out(typical_of(plan.machine, recording, plan.machine.point(plan.machine.where_it_counts)), recording)
    found = foreseen(space, most)
    if not any(entry["blind"] for entry in found.rows):
        return found
    best = anything(plan)
    space = laid_out(typical_of(plan.machine, best, plan.machine.point(plan.machine.where_it_counts)), best)
    unseen = {(e["effect"], e["joint"]): e["share"] for e in foreseen(space, most).rows if e["blind"]}
    noisy = frozenset(name for name, share in unseen.items() if share > LEFT_OVER)
    return replace(found, never=frozenset(unseen), noisy=noisy)


def foreseen(space: Workspace, most: int = 12) -> Foresight:
    """The same of a workspace: a recording's, or a would-be one's."""
    candidates, weights = thinned(library(space.context), most)
    unit = space.base.noise.repeatability
    tried = Tried(space, candidates, unit)
    found = tuple(sights(tried, weights))
    absent = tuple(name for name in _expected(space.machine) if name not in {sight.name for sight in found})
    return Foresight(space, tried, found, absent, unit)


def would_be(plan: Plan) -> Recording:
    """The recording that a plan would become on the nominal machine, without noise."""
    machine, visits = plan.machine, plan.visits
    q = np.array([v.setpoints for v in visits])
    cases = [plan.loads[v.load] for v in visits]
    before = np.vstack([q[:1] if len(q) else q, q[:-1]])
    via = np.array([b if v.via is None else v.via for v, b in zip(visits, before, strict=True)])
    hours = np.cumsum(plan.durations) / 3600.0
    measured = np.array([[t in v.targets for t in machine.targets] for v in visits])
    return pretended(
        machine, [v.step for v in visits], cases, q, approaches(q, via), hours, plan.script.settle_s, measured
    )


def anything(plan: Plan) -> Recording:
    """What no campaign surpasses by much: poses anywhere in random order, at every visit another load, anywhere."""
    machine, count = plan.machine, max(len(plan.visits), AT_LEAST)
    rng = np.random.default_rng(plan.script.seed)
    low, high = machine.limits()
    q = rng.uniform(low, high, (count, machine.n))
    heaviest = max([case.mass for case in plan.script.loads], default=0.0)
    heaviest = heaviest or HEAVY * sum(joint.mass for joint in machine.joints)
    far = max([FAR_OUT, *(float(np.abs(case.com).max()) for case in plan.script.loads if case.mass)])
    cases = [
        LoadCase(str(k), float(rng.uniform(0.0, heaviest)), tuple(rng.uniform(-far, far, 3).tolist()))
        for k in range(count)
    ]
    hours = np.linspace(0.0, max(sum(plan.durations) / 3600.0, HOURS), count)
    everything = np.ones((count, len(machine.targets)), dtype=bool)
    before = np.vstack([q[:1], q[:-1]])
    return pretended(machine, ["any"] * count, cases, q, approaches(q, before), hours, plan.script.settle_s, everything)


def pretended(
    machine: Machine, step: Sequence[str], cases: Sequence[LoadCase], q: Array, approach: NDArray[np.int64],
    hours: Array, settle_s: float, measured: NDArray[np.bool_],
) -> Recording:  # fmt: skip
    """Visits as a recording of the nominal machine.

    cases (N,) what lies on at each visit; q, approach (N, n); hours (N,); measured (N, T)
    """
    frame = machine.tracker.frame
    points = point_positions(machine, q, machine.target_array)
    into = inverse(frame)
    points = points @ into[:3, :3].T + into[:3, 3]
    points = np.where(measured[..., None], points, np.nan)
    payload = wrench(machine, q, np.array([c.mass for c in cases]), np.array([c.com for c in cases]))
    return Recording(
        machine.joint_names, tuple(machine.targets), hours * 3600.0, tuple(step), tuple(c.name for c in cases), q, q,
        approach, np.full(len(q), settle_s), payload, points, {}, {"air": air(hours)}, {}, True, "plan", "",
    )  # fmt: skip


def air(hours: Array) -> Array:
    """(N,) assumed temperature [°C]."""
    return np.asarray(21.0 + sum(size * np.sin(2 * np.pi * hours / period) for size, period in SWINGS))


def laid_out(belief: Belief, recording: Recording) -> Workspace:
    """A recording about the belief's model, as if it had been identified."""
    parameters = belief.model.parameters()
    groups = {p.group: float(s / p.scale) for p, s in zip(parameters, belief.strengths, strict=True)}
    machine = belief.machine
    frame = machine.tracker.frame
    nothing = np.zeros((0, 0))
    theta = belief.theta + springs(belief.model, belief.strengths)
    believed = Estimate(belief.model, theta, nothing, groups, belief.noise, frame, np.ones(len(recording)))
    return prepare(machine, recording, np.ones(len(recording), dtype=bool), believed)


def springs(model: Model, strengths: Array) -> Array:
    """(p,) a machine that gives way as typical ones do, in the elements on the diagonal: what deflects by its own
    weight, creeps or answers to a wrong wrench must deflect at all."""
    theta, at = np.zeros(len(strengths)), 0
    for term in model.terms:
        size = len(term.parameters(model.machine.frame_names))
        if isinstance(term, Compliance) and term.elements:
            each = size // len(term.elements)
            for k, (a, b) in enumerate(term.elements):
                if a == b:
                    theta[at + k * each] = strengths[at + k * each]
        at += size
    return theta


def approaches(q: Array, via: Array) -> NDArray[np.int64]:
    """Direction of each joint's last motion; 0 before it has moved."""
    out = np.zeros(q.shape, dtype=np.int64)
    last = np.zeros(q.shape[1])
    here = via[0] if len(via) else last
    for k in range(len(q)):
        for there in (via[k], q[k]):
            moved = np.sign(there - here)
            last = np.where(moved == 0.0, last, moved)
            here = there
        out[k] = last
    return out


def _expected(machine: Machine) -> Iterable[Name]:
    """What a machine may have wrong with it, whatever a campaign shows."""
    for effect in OF_EVERY_JOINT:
        yield from ((effect, name) for name in machine.joint_names)
    yield from (("nonlinear_stiffness", j.name) for j in machine.joints if j.elastic is not None)
    yield from ((effect, None) for effect in OF_NO_JOINT if effect != "target_moved" or len(machine.targets) > 1)
