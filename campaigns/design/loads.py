"""What the machine carries in its work, and the few load cases that show most of how it gives way under it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from campaigns.script import EMPTY, LoadCase
from ppshw.kinematics import frames, tip_poses
from ppshw.machine import Machine
from ppshw.recording import Recording
from ppshw.statics import gravity_in_sensor
from ppshw.terms.history import payloads
from ppshw.transforms import inverse

Array = NDArray[np.float64]
# Patients of 20 to 200 kg (the paper); a light machine carries less, by our guess this share of its own moving mass.
PAYLOAD_KG, SHARE_OF_OWN_MASS = (20.0, 200.0), 0.14
# A load's centre lies about halfway to the point of interest, and anywhere in a box of this half width, as a share of
# that distance, at least 5 cm; a guess where no load cases are given.
SPREAD, LEAST_SPREAD = 0.2, 0.05
# Test loads are a little over the heaviest, so that nothing in the range is an extrapolation.
OVER = 1.02
# Loads are compared by what they do to the sensor at this many poses, against 5 % of the largest as noise.
POSES, CASE_NOISE = 40, 0.05
MOST_CHOICES = 5000  # of load cases that are all tried
LIGHTEST_KG = 1.0  # what a sensor reads less of is an empty machine


@dataclass(frozen=True)
class LoadRange:
    """mass low … high [kg]; low, high (3,) corners of the box of its centre, end-effector frame [m]."""

    mass: tuple[float, float]
    low: tuple[float, ...]
    high: tuple[float, ...]

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """(count,) masses and (count, 3) centres, uniform."""
        return rng.uniform(*self.mass, count), rng.uniform(self.low, self.high, (count, 3))


def usual_range(machine: Machine, point: Array) -> LoadRange:
    """What loads are taken to be where nobody says; point (3,) of interest, end-effector frame [m]."""
    own = sum(joint.mass for joint in machine.joints)
    share = min(1.0, SHARE_OF_OWN_MASS * own / PAYLOAD_KG[1]) if own else 1.0
    middle, half = 0.5 * point, np.full(3, max(LEAST_SPREAD, SPREAD * float(np.linalg.norm(point))))
    up = int(np.argmax(np.abs(_gravity_at_mid_travel(machine))))  # nothing lies as far below the table as above it
    half[up] = max(LEAST_SPREAD, min(half[up], abs(middle[up])))
    return LoadRange(
        (PAYLOAD_KG[0] * share, PAYLOAD_KG[1] * share), tuple((middle - half).tolist()), tuple((middle + half).tolist())
    )


def _gravity_at_mid_travel(machine: Machine) -> Array:
    """(3,) in the end-effector frame."""
    low, high = machine.limits()
    tip = tip_poses(machine, (low + high)[None] / 2)[0]
    return np.asarray(tip[:3, :3].T @ machine.gravity)


def range_of(cases: Sequence[LoadCase]) -> LoadRange:
    """The range that load cases span; the empty machine counts as the least mass, its centre as none."""
    loaded = [case for case in cases if case.mass > 0]
    if not loaded:
        return LoadRange((0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    centres = np.array([case.com for case in loaded])
    masses = [case.mass for case in cases]
    return LoadRange((min(masses), max(masses)), tuple(centres.min(axis=0)), tuple(centres.max(axis=0)))


def matters(machine: Machine) -> bool:
    """Whether a payload changes anything: some link gives way, and there is weight."""
    return any(joint.elastic is not None for joint in machine.joints) and bool(np.any(machine.gravity))


def extremes(given: LoadRange) -> list[LoadCase]:
    """Empty, the heaviest load in every corner of the box and in its middle: candidates."""
    heavy = float(np.ceil(np.round(given.mass[1] * OVER, 6)))
    low, high = np.array(given.low), np.array(given.high)
    middle, half = (low + high) / 2, (high - low) / 2
    corners = [np.zeros(3), *(np.array(signs) for signs in itertools.product((-1.0, 1.0), repeat=3))]
    places = {tuple(np.round(middle + half * c, 3).tolist()) for c in corners}
    return [EMPTY, *(LoadCase("", heavy, place) for place in sorted(places))] if heavy > 0 else [EMPTY]


def telling_cases(machine: Machine, given: LoadRange, candidates: Sequence[LoadCase], count: int) -> list[LoadCase]:
    """The `count` candidates from which the deflection under any load of the range is interpolated best.

    Deflection is linear in the wrench, so a load is a vector: what it does to the sensor at some poses. Of all choices
    of `count` cases (one by one where they are too many), the one with the least mean variance over the range
    (I-optimal, linear kernel) is taken.
    """
    rng = np.random.default_rng(0)
    low, high = machine.limits()
    q = rng.uniform(low, high, (POSES, machine.n))
    masses, centres = given.draw(60, rng)
    wanted = np.array([wrench(machine, q, m, c).ravel() for m, c in zip(masses, centres, strict=True)])
    offered = np.array([wrench(machine, q, case.mass, np.array(case.com)).ravel() for case in candidates])
    both = np.concatenate([offered, wanted]).reshape(-1, POSES, 6)
    for part in (slice(0, 3), slice(3, 6)):  # forces and moments in their own units, each against its largest
        both[..., part] /= max(float(np.linalg.norm(both[..., part], axis=2).max()), 1e-12)
    rows = both.reshape(len(both), -1) / np.sqrt(POSES)
    kernel = 1.0 + rows @ rows.T
    n = len(candidates)
    if count >= n:
        return _named(candidates)

    def left(some: tuple[int, ...]) -> float:
        k = kernel[np.ix_(some, some)] + CASE_NOISE**2 * np.eye(len(some))
        cross = kernel[np.ix_(some, range(n, len(kernel)))]
        return float(-np.einsum("ij,ij->", cross, np.linalg.solve(k, cross)))

    if math.comb(n, count) <= MOST_CHOICES:
        chosen = min(itertools.combinations(range(n), count), key=left)
    else:  # one by one
        chosen = ()
        for _ in range(count):
            chosen = min(((*chosen, k) for k in range(n) if k not in chosen), key=left)
    return _named([candidates[k] for k in chosen])


def _named(cases: Sequence[LoadCase]) -> list[LoadCase]:
    """Lightest first; cases without a name are called by mass and centre (cm), the same in every campaign."""
    ordered = sorted(cases, key=lambda case: (case.mass, case.com))
    return [case if case.name else LoadCase(_name(case), case.mass, case.com) for case in ordered]


def _name(case: LoadCase) -> str:
    x, y, z = (f"{100 * c + 0.0:.0f}" for c in case.com)
    return f"{case.mass:g}kg_x{x}_y{y}_z{z}"


def measured_with(recording: Recording, machine: Machine) -> list[LoadCase]:
    """The loads that a recording was made with, under their labels, by what the force sensor read: to a tenth of a
    kilogram and a millimetre, of rigid payloads that hang still, beside what it read under the label of the empty
    machine; what no pose shows of a centre is that of the end-effector frame. None where it has no labels, or no
    wrench."""
    if not recording.has_wrench:
        return []
    tip = inverse(machine.sensor_in_link) @ machine.tip_in_link
    force, moment = recording.wrench[:, :3], recording.wrench[:, 3:]
    there = np.concatenate([force, moment - np.cross(tip[:3, 3], force)], axis=1).reshape(-1, 2, 3) @ tip[:3, :3]
    gravity = gravity_in_sensor(machine, frames(machine, recording.q)) @ tip[:3, :3]
    found = payloads(there.reshape(-1, 6), recording.load, gravity)
    of = {label: found[recording.load.index(label)] for label in dict.fromkeys(recording.load)}
    for_good, out = of.pop(EMPTY.name, np.zeros(4)), []
    for label, held in of.items():
        mass, *first = (held - for_good).tolist()
        if label and mass >= LIGHTEST_KG:
            out.append(LoadCase(label, round(mass, 1), tuple(np.round(np.array(first) / mass, 3).tolist())))
    return out


def wrench(machine: Machine, q: Array, mass: Array | float, centre: Array) -> Array:
    """What a mass hanging still does to the force sensor: F = m Rᵀ g, M = r × F.

    q (N, n); mass scalar or (N,) [kg]; centre (3,) or (N, 3) in the end-effector frame [m]
    returns (N, 6) in the sensor frame [N, N·m]
    """
    sensor = frames(machine, q)[:, -1] @ machine.sensor_in_link
    to_sensor = inverse(machine.sensor_in_link) @ machine.tip_in_link
    arm = np.broadcast_to(np.asarray(centre) @ to_sensor[:3, :3].T + to_sensor[:3, 3], (len(q), 3))
    down = np.einsum("nji,j->ni", sensor[:, :3, :3], machine.gravity)
    force = np.broadcast_to(np.asarray(mass, dtype=float), (len(q),))[:, None] * down
    return np.concatenate([force, np.cross(arm, force)], axis=1)
