"""Script + machine → Plan: every visit in its order, checked against every limit before anything moves.

A plan is a function of the script's text and the machine file alone, so that a run that is taken up again finds the
same visit under the same index.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from campaigns.script import (
    LoadCase,
    PosesStep,
    RandomStep,
    ReversalsStep,
    Script,
    Step,
    SweepStep,
    not_on_any_machine,
)
from drivers.axis_config import trapezoid_time
from ppshw import kinematics
from ppshw.errors import CampaignError
from ppshw.machine import Joint, Machine
from ppshw.recording import LIMIT_ROUNDING

Array = NDArray[np.float64]

# Where the machine file gives no speed the duration is counted with these; guesses of a careful creep [m/s or rad/s].
VELOCITY_GUESS = 0.05
ACCELERATION_GUESS = 0.05
# A pose that is asked for twice in a row is left in between, this share of every joint's travel at most:
# standing still is no repeat.
STEP_ASIDE = 0.08
# Least and greatest move between two reversals, shares of a joint's travel: friction turns within about so much.
LEAST_BACK, MOST_BACK = 0.004, 0.2


@dataclass(frozen=True)
class Visit:
    """One pose under one load.

    setpoints  (n,) in the machine's joint order
    via        a pose to pass through first, None: straight from the visit before
    where      file:line of the step
    """

    index: int
    step: str
    load: str
    setpoints: tuple[float, ...]
    targets: tuple[str, ...]
    via: tuple[float, ...] | None
    where: str

    @property
    def number(self) -> int:
        """As people are told it, from 1."""
        return self.index + 1


@dataclass(frozen=True)
class Summary:
    visits: int
    readings: int
    load_changes: int
    duration_s: float
    steps: Mapping[str, int]
    loads: Mapping[str, int]

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class Plan:
    """digest: of everything that a resumed run must share with the run before."""

    script: Script
    machine: Machine
    visits: tuple[Visit, ...]
    durations: tuple[float, ...]
    digest: str

    @property
    def loads(self) -> dict[str, LoadCase]:
        return {case.name: case for case in self.script.loads}

    @property
    def extra_targets(self) -> tuple[str, ...]:
        """Reflectors at points of interest that some visit asks for."""
        return tuple(p for p in self.machine.points if any(p in visit.targets for visit in self.visits))

    def seconds_left(self, done: Iterable[int] = ()) -> float:
        """Machine time of the visits that are not done."""
        finished = set(done)
        return sum(t for visit, t in zip(self.visits, self.durations, strict=True) if visit.index not in finished)

    def summary(self) -> Summary:
        loads = [visit.load for visit in self.visits]
        return Summary(
            visits=len(self.visits),
            readings=sum(len(visit.targets) for visit in self.visits),
            load_changes=sum(a != b for a, b in itertools.pairwise(loads)),
            duration_s=sum(self.durations),
            steps=_counts(visit.step for visit in self.visits),
            loads=_counts(loads),
        )


def plan_campaign(script: Script, machine: Machine) -> Plan:
    """Expand, order and check. Raises CampaignError naming file, line, joint, value and limits."""
    for joint in machine.joints:
        if joint.limits is None:
            raise CampaignError(
                f"{script.file}: joint {joint.name} has no limits in {machine.file}; without limits nothing is moved"
            )
    _check_joints(script.home, machine, f"{script.file}: home")
    home = _home(script, machine)
    visits = [v for k, step in enumerate(script.steps) for v in _expand(step, k, script, machine, home)]
    visits = _ordered(visits, script)
    visits = _with_references(visits, script, machine, home)
    visits = [replace(visit, index=k) for k, visit in enumerate(visits)]
    for visit in visits:
        _check_limits(visit, machine)
        _check_targets(visit, machine)
    visits = _stepping_aside(visits, script, machine)
    durations = _durations(visits, script, machine, home)
    return Plan(script, machine, tuple(visits), durations, _digest(visits, script, machine))


# --- expansion -----------------------------------------------------------------------------------------------
def _expand(step: Step, number: int, script: Script, machine: Machine, home: Array) -> list[Visit]:
    rng = np.random.default_rng([script.seed, number])
    if isinstance(step, PosesStep):
        poses = [(_at(home, pose.q, machine, pose.where), pose.load, pose.where) for pose in step.poses]
    elif isinstance(step, SweepStep):
        poses = [(q, None, step.where) for q in _sweep(step, machine, home)]
    elif isinstance(step, ReversalsStep):
        poses = [(q, None, step.where) for q in _reversals(step, machine, rng)]
    elif isinstance(step, RandomStep):
        drawn = _random(step, machine, rng)
        given = [step.loads[k % len(step.loads)] if step.deal else None for k in range(len(drawn))]
        poses = [(q, load, step.where) for q, load in zip(drawn, given, strict=True)]
    else:
        raise AssertionError(f"unknown step {step!r}")
    targets = step.targets or tuple(machine.targets)
    out: list[Visit] = []
    for load in dict.fromkeys([*step.loads, *(load for _, load, _ in poses if load)]):
        mine = [(q, where) for q, own, where in poses if (own or load) == load and (own or load in step.loads)]
        for _ in range(step.repeat):  # in rounds over the poses: a pose is left before it is visited again
            order = rng.permutation(len(mine)) if step.shuffle else range(len(mine))
            out += [Visit(0, step.name, load, tuple(mine[k][0].tolist()), targets, None, mine[k][1]) for k in order]
    return out


def _sweep(step: SweepStep, machine: Machine, home: Array) -> list[Array]:
    k = _joint_index(step.joint, machine, step.where)
    lower, upper = (float(limit[k]) for limit in machine.limits())
    inset = step.margin * (upper - lower)
    values = np.array(step.positions)
    if not step.positions:
        first = lower + inset if step.first is None else step.first
        last = upper - inset if step.last is None else step.last
        values = np.linspace(first, last, step.count)
    if step.direction == "down":
        values = values[::-1]
    elif step.direction == "both":
        values = np.concatenate([values, values[::-1]])
    poses = []
    for value in values:
        q = _at(home, step.at, machine, step.where)
        q[k] = value
        poses.append(q)
    return poses


def _reversals(step: ReversalsStep, machine: Machine, rng: np.random.Generator) -> list[Array]:
    """Joint by joint: somewhere, then there and back in moves of every size, in random order, off any grid."""
    low, high = machine.limits()
    poses = []
    for k in [_joint_index(name, machine, step.where) for name in step.joints] or range(machine.n):
        start = rng.uniform(0.05, 0.95, machine.n)
        start[k] = rng.uniform(0.35, 0.65)
        moves = rng.permutation(np.geomspace(LEAST_BACK, MOST_BACK, step.count - 1))
        moves[::2] *= -1.0
        for at in start[k] + np.concatenate([[0.0], np.cumsum(moves)]):
            share = start.copy()
            share[k] = np.clip(at, 0.01, 0.99)
            poses.append(low + share * (high - low))
    return poses


def _random(step: RandomStep, machine: Machine, rng: np.random.Generator) -> Array:
    """(count, n) uniform in the joints' ranges; with a volume, drawn again until the point is inside."""
    low, high = machine.limits()
    inset = step.margin * (high - low)
    low, high = low + inset, high - inset
    for joint, (a, b) in step.within.items():
        k = _joint_index(joint, machine, step.where)
        low[k], high[k] = max(low[k], a), min(high[k], b)
        if low[k] > high[k]:
            raise CampaignError(f"{step.where}: step {step.name}: joint {joint}: {a:g} … {b:g} lies outside the limits")
    if step.volume is None:
        return rng.uniform(low, high, size=(step.count, machine.n))
    found = np.empty((0, machine.n))
    point = machine.point(step.volume.point)
    for _ in range(200):
        q = rng.uniform(low, high, size=(step.count, machine.n))
        where = kinematics.point_positions(machine, q, point[None, :])[:, 0]
        inside = np.all((where >= step.volume.low) & (where <= step.volume.high), axis=1)
        found = np.concatenate([found, q[inside]])
        if len(found) >= step.count:
            return found[: step.count]
    raise CampaignError(
        f"{step.where}: step {step.name}: only {len(found)} of {step.count} poses found with {step.volume.point} "
        f"inside the volume after {200 * step.count} draws"
    )


# --- order ---------------------------------------------------------------------------------------------------
def _ordered(visits: list[Visit], script: Script) -> list[Visit]:
    """Few load changes: all visits of one load together, loads in the script's order. Stable within a load."""
    if script.order == "as_written":
        return visits
    rank = {case.name: k for k, case in enumerate(script.loads)}
    return sorted(visits, key=lambda visit: rank.get(visit.load, 0))


def _with_references(visits: list[Visit], script: Script, machine: Machine, home: Array) -> list[Visit]:
    if script.reference is None:
        return visits
    q = tuple(_at(home, script.reference.q, machine, script.reference.where).tolist())
    targets = tuple(machine.targets)
    out: list[Visit] = []
    for k, visit in enumerate(visits):
        if k % script.reference.every == 0:
            out.append(Visit(0, "reference", visit.load, q, targets, None, script.reference.where))
        out.append(visit)
    if script.reference.closing and visits:
        out.append(Visit(0, "reference", visits[-1].load, q, targets, None, script.reference.where))
    return out


def _stepping_aside(visits: list[Visit], script: Script, machine: Machine) -> list[Visit]:
    rng = np.random.default_rng([script.seed, 999_999])
    lower, upper = machine.limits()
    out = visits[:1]
    for before, visit in itertools.pairwise(visits):
        aside = rng.uniform(-STEP_ASIDE, STEP_ASIDE, machine.n) * (upper - lower)
        if np.allclose(visit.setpoints, before.setpoints, rtol=0.0, atol=LIMIT_ROUNDING):
            via = np.clip(np.array(visit.setpoints) + aside, lower, upper)
            visit = replace(visit, via=tuple(via.tolist()))  # noqa: PLW2901
        out.append(visit)
    return out


# --- checks --------------------------------------------------------------------------------------------------
def check_setpoints(setpoints: Sequence[float], machine: Machine, who: str) -> None:
    """Raise CampaignError for a setpoint that is no number or beyond a limit."""
    for joint, value in zip(machine.joints, setpoints, strict=True):
        if joint.limits is None:
            raise CampaignError(f"{who}: joint {joint.name} has no limits in {machine.file}")
        low, high = joint.limits.lower, joint.limits.upper
        if not low - LIMIT_ROUNDING <= value <= high + LIMIT_ROUNDING:
            raise CampaignError(
                f"{who}: joint {joint.name} at {value:g} {joint.unit} is outside its limits {low:g} … {high:g}"
            )


def _check_limits(visit: Visit, machine: Machine) -> None:
    check_setpoints(visit.setpoints, machine, f"{visit.where}: step {visit.step}")


def _check_targets(visit: Visit, machine: Machine) -> None:
    for target in visit.targets:
        if target not in machine.targets and target not in machine.points:
            known = ", ".join([*machine.targets, *machine.points])
            raise CampaignError(
                f"{visit.where}: step {visit.step}: no target '{target}' (there are: {known})"
                f"{not_on_any_machine(visit.where)}"
            )


def _check_joints(names: Iterable[str], machine: Machine, where: str) -> None:
    for name in names:
        _joint_index(name, machine, where)


def _joint_index(name: str, machine: Machine, where: str) -> int:
    if name not in machine.joint_names:
        known = ", ".join(machine.joint_names)
        raise CampaignError(f"{where}: no joint '{name}' (there are: {known}){not_on_any_machine(where)}")
    return machine.joint_names.index(name)


def _home(script: Script, machine: Machine) -> Array:
    """The script's home, else 0 clipped into the limits less the script's margin."""
    lower, upper = machine.limits()
    inset = script.home_margin * (upper - lower)
    return _at(np.clip(np.zeros(machine.n), lower + inset, upper - inset), script.home, machine, f"{script.file}: home")


def _at(home: Array, q: Mapping[str, float], machine: Machine, where: str) -> Array:
    out = home.copy()
    for joint, value in q.items():
        out[_joint_index(joint, machine, where)] = value
    return out


# --- how long ------------------------------------------------------------------------------------------------
def travel(joints: Sequence[Joint], a: ArrayLike, b: ArrayLike) -> Array:
    """Seconds from positions a (..., n) to b (..., n) [m, rad] of n joints: all start together, the slowest decides.

    From rest to rest, as fast as the machine file allows: what a site makes slower is not known here.
    """
    v = np.array([(j.limits and j.limits.velocity) or VELOCITY_GUESS for j in joints])
    rate = np.array([(j.limits and j.limits.acceleration) or ACCELERATION_GUESS for j in joints])
    return np.asarray(trapezoid_time(np.subtract(b, a), v, rate).max(axis=-1))


def travel_time(joint: Joint, distance: float) -> float:
    """Of one joint alone.  [s]"""
    return float(travel((joint,), (0.0,), (distance,)))


def _durations(visits: Sequence[Visit], script: Script, machine: Machine, home: Array) -> tuple[float, ...]:
    if not visits:
        return ()
    there = np.array([v.setpoints for v in visits])
    here = np.vstack([home, there[:-1]])
    between = np.array([v.via or tuple(a) for v, a in zip(visits, here.tolist(), strict=True)])
    seconds = travel(machine.joints, here, between) + travel(machine.joints, between, there)
    seconds += script.settle_s + script.measure_s * np.array([len(v.targets) for v in visits])
    changed = np.array([b.load != a.load for a, b in zip((visits[0], *visits), visits, strict=False)])
    return tuple((seconds + script.load_change_s * changed).tolist())


def _digest(visits: Sequence[Visit], script: Script, machine: Machine) -> str:
    rows = [[v.step, v.load, v.setpoints, v.targets, v.via] for v in visits]
    loads = [[case.name, case.mass, case.com] for case in script.loads]
    return hashlib.sha256(json.dumps([rows, loads, script.settle_s, machine.sha256]).encode()).hexdigest()


def _counts(names: Iterable[str]) -> dict[str, int]:
    out: dict[str, int] = {}
    for name in names:
        out[name] = out.get(name, 0) + 1
    return out
