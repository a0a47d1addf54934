"""A measuring campaign as a site would drive it: what was commanded, under which load, when, how warm it was.

Random poses; sweeps of one joint, up or down, some of them there and back, of any width; the reference pose again and
again; a load at a time for 12 to 29 visits, one in five of them empty, their centres of mass on both sides of the
sensor; 60 to 110 s a visit and some minutes more to change a load. The air swings, the first joint's rail follows it
and warms up as it is driven; humidity and pressure of the air are recorded as well. Numbers are our guesses at what a
night at such a machine looks like.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simulators import truth
from simulators.chain import Array, Chain
from simulators.recorded import last_motion

LOAD_CHANGE_S = 240.0
EMPTY_SHARE = 0.2
REFERENCE_EVERY = 15
RAIL_LAG_S = 3600.0


@dataclass(frozen=True)
class Campaign:
    """N visits.

    step, load   (N,) labels
    commanded    (N, n) [m, rad];  before (N, n): where each joint came from
    approach     (N, n) −1, 0, 1
    time         (N,) [s] since the first motion;  settle (N,) [s]
    mass, com    (N,) [kg], (N, 3) in the sensor frame [m]
    temperature  place → (N,) [°C];  other: name → (N,) whatever else a site records
    """

    step: list[str]
    load: list[str]
    commanded: Array
    before: Array
    approach: NDArray[np.int64]
    time: Array
    settle: Array
    mass: Array
    com: Array
    temperature: dict[str, Array]
    other: dict[str, Array] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.commanded)


def draw_campaign(chain: Chain, visits: int, rng: np.random.Generator) -> Campaign:
    pose_rng, load_rng, time_rng, heat_rng, air_rng = rng.spawn(5)
    step, commanded = _poses(chain, visits, pose_rng)
    home = np.clip(0.0, [j.lower for j in chain.joints], [j.upper for j in chain.joints])
    before = np.vstack([home, commanded[:-1]])
    number, mass, com = _loads(chain, visits, load_rng)
    time = np.cumsum(time_rng.uniform(60.0, 110.0, visits) + LOAD_CHANGE_S * (np.diff(number, prepend=0) > 0))
    driven = np.abs(commanded - before)[:, 0] / (chain.joints[0].upper - chain.joints[0].lower)
    return Campaign(
        step=step,
        load=[f"L{k}" for k in number],
        commanded=commanded,
        before=before,
        approach=last_motion(commanded - before),
        time=time,
        settle=np.round(time_rng.uniform(2.0, 12.0, visits), 2),
        mass=mass,
        com=com,
        temperature=_temperatures(time, driven, heat_rng),
        other=_air(time, air_rng),
    )


def _poses(chain: Chain, visits: int, rng: np.random.Generator) -> tuple[list[str], Array]:
    steps: list[str] = []
    poses: list[Array] = []
    since_reference = 0
    while len(poses) < visits:
        if since_reference >= REFERENCE_EVERY * rng.uniform(0.6, 1.4):
            label, batch = "reference", np.zeros((1, len(chain.joints)))
            batch = np.clip(batch, [j.lower for j in chain.joints], [j.upper for j in chain.joints])
            since_reference = 0
        elif rng.random() < 0.35 and poses:
            label, batch = _sweep(chain, poses[-1], rng)
        else:
            label, batch = "random", truth.random_poses(chain, int(rng.integers(1, 6)), rng)
        steps += [label] * len(batch)
        poses += list(np.round(batch, 8))
        since_reference += len(batch)
    return steps[:visits], np.array(poses[:visits])


def _sweep(chain: Chain, through: Array, rng: np.random.Generator) -> tuple[str, Array]:
    """One joint alone from anywhere to anywhere in 4 to 8 even steps; every third time back, in other steps."""
    k = int(rng.integers(len(chain.joints)))
    joint = chain.joints[k]
    start, end = rng.uniform(joint.lower, joint.upper, 2)
    values = np.linspace(start, end, int(rng.integers(4, 9)))
    if rng.random() < 1 / 3:
        values = np.concatenate([values, np.linspace(end, start, int(rng.integers(5, 8)))[1:]])
    batch = np.repeat(through[None], len(values), axis=0)
    batch[:, k] = values
    return f"sweep:{joint.name}", batch


def _loads(chain: Chain, visits: int, rng: np.random.Generator) -> tuple[NDArray[np.int64], Array, Array]:
    """Number of the load, its mass and centre of mass at every visit. Loads lie from behind the sensor to beyond the
    treatment point and to both sides, so that moments cross zero."""
    in_link = (chain.tip @ np.append(truth.treatment_point(chain), 1.0))[:3]
    along = chain.sensor[:3, :3].T @ (in_link - chain.sensor[:3, 3])
    sideways = 0.14 * float(np.linalg.norm(along))
    rated = truth.rated_payload(chain)
    number: list[int] = []
    masses: list[float] = []
    centres: list[Array] = []
    while len(number) < visits:
        empty = rng.random() < EMPTY_SHARE and len(masses) > 0
        masses.append(0.0 if empty else float(rng.uniform(0.1, 1.0)) * rated)
        centres.append(rng.uniform(-0.15, 0.9) * along + rng.uniform(-sideways, sideways, 3))
        number += [len(masses) - 1] * int(rng.integers(12, 30))
    which = np.array(number[:visits])
    return which, np.array(masses)[which], np.array(centres)[which]


def _temperatures(time: Array, driven: Array, rng: np.random.Generator) -> dict[str, Array]:
    """Air: the day and the air conditioning, up and down. Rail: the air an hour behind, and 0.4 K per full travel."""
    day, cycle = rng.uniform(0.5, 1.5), rng.uniform(0.1, 0.3)
    day_s, cycle_s, phase = (
        rng.uniform(5, 12) * 3600,
        rng.uniform(1.2, 2.2) * 3600,
        rng.uniform(0, 2 * np.pi, 2),
    )
    middle = rng.uniform(20.0, 22.5)

    def air(t: Array) -> Array:
        wave = day * np.sin(2 * np.pi * t / day_s + phase[0]) + cycle * np.sin(2 * np.pi * t / cycle_s + phase[1])
        return np.asarray(middle + wave)

    warmth, warmed, last = 0.0, np.zeros(len(time)), 0.0
    for k, (now, way) in enumerate(zip(time, driven, strict=True)):
        warmth = warmth * np.exp(-(now - last) / RAIL_LAG_S) + 0.4 * way
        warmed[k], last = warmth, now
    return {"air": air(time), "rail": air(time - RAIL_LAG_S) + warmed}


def _air(time: Array, rng: np.random.Generator) -> dict[str, Array]:
    """Relative humidity [%]: drier and damper over some hours, and with whoever opens the door. Pressure [hPa]: the
    weather, which goes one way for most of a night."""
    hours = time / 3600.0
    damp = rng.uniform(3, 8) * np.cos(2 * np.pi * hours / rng.uniform(4, 9) + rng.uniform(0, 2 * np.pi))
    doors = rng.uniform(0, hours[-1], 12)
    puff = np.exp(-np.maximum(hours[:, None] - doors, 0.0) / 0.3) * (hours[:, None] >= doors)
    weather = rng.normal() * 1.5 * hours / 10 + rng.uniform(0.2, 0.8) * np.sin(hours / rng.uniform(1, 2))
    return {"humidity": 45 + damp + puff @ rng.uniform(1, 4, len(doors)), "pressure": 1009 + weather}
