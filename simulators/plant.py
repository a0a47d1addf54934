"""The truth behind all simulated hardware: one particular machine, its payload, and where its reflectors really are.

    T_i = T_{i−1} · origin_i · motion_i(q_i) · G_i(q_i) · U_i(q_i, load) · R_i

with exact finite displacements G (geometry), U (elasticity) and R (the random part of this arrival), per link in
its own frame. Model (17) can represent all of it to some micrometres, but shares no line of code with it. Dimensions,
Young's moduli, sections and amplitudes are our choices (simulators/truth.py says which); the paper gives only
what they add up to.

Known limitations
  - Loads are taken in the nominal, undeflected pose. A real machine that sags 8 mm and tilts 3 mrad carries its load
    elsewhere by as much, an elastic error of the second order (some 10 µm) that the paper neglects too. What the force
    sensor reads is beside a real one's by the first order, weight times tilt (6 N of 200 kg at 3 mrad).
  - Quasi-static: no vibration, no settling, no dynamics while moving.
  - Encoders are perfect; backlash, heat, creep and everything else beyond model (17) is absent. To add some, pass
    the generalized errors they cause as `eps_r`, which need not be random, or let the live plant carry an effect.
  - Temperatures drift, but nothing grows with them unless such an effect is carried.
  - `visible_targets` hides nothing: no line of sight, no acceptance angle of the reflectors.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from simulators import chain as kinematics
from simulators import truth
from simulators.chain import Array, Chain

STANDSTILL = 1e-6  # a joint that has moved less than this since the last arrival has not moved [m, rad]


@dataclass(frozen=True)
class Load:
    """A payload: mass_kg, and com (3,) its centre of mass in the force sensor frame [m]."""

    mass_kg: float
    com: Array


Loads = Load | Sequence[Load | None] | NDArray[np.float64] | None


class Plant:
    """One machine as it really is. The same file and seed give the same machine, to the last bit.

    Where joint values are taken: q (N, n) or (n,) [m, rad], true positions. Where a load is taken: None (nothing on the
    sensor), a Load, N of them, or wrenches (6,) or (N, 6) that the payload applies to it, sensor frame [N, N m].
    """

    def __init__(self, chain: Chain, seed: int = 0, repeatability: float | None = None) -> None:
        self.chain = chain
        self.seed = seed
        self.joint_names = tuple(joint.name for joint in chain.joints)
        self.lower = np.array([joint.lower for joint in chain.joints])
        self.upper = np.array([joint.upper for joint in chain.joints])
        claimed = truth.DEFAULT_REPEATABILITY if chain.repeatability is None else chain.repeatability
        self.repeatability = claimed if repeatability is None else repeatability
        self.position_sigma = chain.position_sigma
        self.truth = truth.draw_truth(chain, seed, self.repeatability)
        mounting = np.random.default_rng([seed, 1])
        self.measuring_in_base = _tracker_place(mounting) if chain.measuring is None else chain.measuring
        moved = mounting.normal(0.0, 0.0 if chain.targets_known else 1.5e-3, (len(chain.targets), 3))
        self.targets = {name: xyz + d for (name, xyz), d in zip(chain.targets.items(), moved, strict=True)}
        self.points = {"treatment": truth.treatment_point(chain), **chain.points}

    @classmethod
    def from_file(cls, path: str | Path, seed: int = 0, repeatability: float | None = None) -> Plant:
        """repeatability [m] overrides the machine file's; 0 makes a machine that always arrives at the same place."""
        return cls(kinematics.read_chain(path), seed, repeatability)

    def true_points(
        self, q: Array, load: Loads = None, eps_r: Array | None = None, names: Iterable[str] | None = None
    ) -> dict[str, Array]:
        """Where the named targets or points are, in the measuring frame: {name: (N, 3)} [m].

        eps_r  (N, n, 6) the random part of each arrival, from draw_repeatability; or any other error one likes to add
        names  of targets and points; by default the targets
        """
        return self._measured(self.true_tip(q, load, eps_r), names)

    def nominal_points(self, q: Array, names: Iterable[str] | None = None) -> dict[str, Array]:
        """The same, if the machine were perfect."""
        poses = kinematics.link_poses(self.chain, _rows(q))
        return self._measured(poses[:, -1] @ self.chain.tip, names)

    def true_tip(self, q: Array, load: Loads = None, eps_r: Array | None = None) -> Array:
        """(N, 4, 4) the end-effector frame in the base frame."""
        q = _rows(q)
        poses = kinematics.link_poses(
            self.chain, q, truth.geometric(self.truth.shapes, q), self.elastic_error(q, load), eps_r
        )
        return np.asarray(poses[:, -1] @ self.chain.tip)

    def elastic_error(self, q: Array, load: Loads = None) -> Array:
        """(N, n, 6) how each link bends, in its own frame."""
        q = _rows(q)
        return truth.elastic(self.chain, self.truth.springs, q, self.link_wrenches(q, load))

    def link_wrenches(self, q: Array, load: Loads = None) -> Array:
        """(N, n, 6) what each link carries at its origin, in its own frame, in the nominal pose."""
        poses = kinematics.link_poses(self.chain, _rows(q))
        return kinematics.link_wrenches(self.chain, poses, self.wrench(q, load))

    def wrench(self, q: Array, load: Loads) -> Array:
        """(N, 6) what the payload applies to the sensor, in the sensor frame of the nominal pose."""
        q = _rows(q)
        if load is None:
            return np.zeros((len(q), 6))
        if isinstance(load, np.ndarray):
            return np.broadcast_to(load, (len(q), 6)).astype(float)
        loads = [load] * len(q) if isinstance(load, Load) else list(load)
        if len(loads) != len(q):
            raise ValueError(f"{len(loads)} loads for {len(q)} poses")
        mass = np.array([0.0 if one is None else one.mass_kg for one in loads])
        com = np.array([np.zeros(3) if one is None else one.com for one in loads])
        last = kinematics.link_poses(self.chain, q)[:, -1]
        return kinematics.payload_wrench(self.chain, last, mass, com)

    def draw_repeatability(self, count: int, rng: np.random.Generator) -> Array:
        """(count, n, 6) eps_r of eq (26), one draw per arrival at a pose."""
        return self.truth.scatter * rng.normal(size=(count, len(self.joint_names), 6))

    def random_poses(self, count: int, rng: np.random.Generator) -> Array:
        return truth.random_poses(self.chain, count, rng)

    def random_loads(self, count: int, rng: np.random.Generator) -> list[Load]:
        """Payloads of 20 to 200 kg on a patient positioner, less on a light machine; centres of mass vary."""
        mass, com = truth.random_payloads(self.chain, count, rng)
        return [Load(float(m), c) for m, c in zip(mass, com, strict=True)]

    def _measured(self, tips: Array, names: Iterable[str] | None) -> dict[str, Array]:
        known = {**self.points, **self.targets}
        to_measuring = np.linalg.inv(self.measuring_in_base)
        chosen = list(self.targets) if names is None else list(names)
        return {name: (to_measuring @ tips @ np.append(known[name], 1.0))[:, :3] for name in chosen}


class Clock(Protocol):
    def now(self) -> float: ...


class Carried(Protocol):
    """One thing more that the live machine does, with a memory of its own: simulators/concealed/live.py."""

    def seen(
        self, now: float, q: Array, load: Load | None, deviation: Array, names: tuple[str, ...]
    ) -> dict[str, Array]: ...

    def sensed(self, now: float, q: Array, load: Load | None) -> Array: ...

    def loaded(self, now: float, q: Array, load: Load | None) -> None: ...


class LivePlant:
    """The plant now: what the instruments see while the simulated drives move it. Safe to ask from any thread.

    joint_source  gives the true joint values (n,) of this moment
    fitted        the reflectors mounted; by default those of the machine file, without the point `treatment`
    carries       an effect that the machine has beyond its own truth, if any

    Every arrival has one random deviation: it stays while the machine stands still and is drawn anew once any joint
    has moved by more than STANDSTILL. Instruments add their own noise.
    """

    def __init__(
        self,
        plant: Plant,
        joint_source: Callable[[], Array],
        clock: Clock,
        rng: np.random.Generator | None = None,
        fitted: Sequence[str] | None = None,
        carries: Carried | None = None,
    ) -> None:
        self.plant = plant
        self._carries = carries
        self._joints = joint_source
        self._clock = clock
        self._rng = np.random.default_rng([plant.seed, 2]) if rng is None else rng
        self._lock = threading.Lock()
        self._load: Load | None = None
        self._arrived_at: Array | None = None
        self._deviation = np.zeros((1, len(plant.joint_names), 6))
        self._fitted: tuple[str, ...] = ()
        self.fit(tuple(plant.targets) if fitted is None else fitted)

    def fit(self, names: Sequence[str]) -> None:
        """Mount these reflectors and no others."""
        for name in names:
            if name not in self.plant.targets and name not in self.plant.points:
                raise ValueError(f"{self.plant.chain.name}: no place for a reflector called {name}")
        with self._lock:
            self._fitted = tuple(names)

    def set_load(self, load: Load | None) -> None:
        with self._lock:
            self._load = load
            if self._carries is not None:
                self._carries.loaded(self._clock.now(), np.array(self._joints(), dtype=float), load)

    def moment(self) -> int:
        """At the same moment and pose everything looks the same. Whole seconds where an effect is carried."""
        return 0 if self._carries is None else int(self._clock.now())

    @property
    def load(self) -> Load | None:
        return self._load

    @property
    def fitted(self) -> tuple[str, ...]:
        return self._fitted

    def visible_targets(self) -> dict[str, Array]:
        """{name: (3,)} where the mounted reflectors are now, in the tracker's frame [m]."""
        with self._lock:
            q = np.array(self._joints(), dtype=float)
            if self._arrived_at is None or np.max(np.abs(q - self._arrived_at)) > STANDSTILL:
                self._arrived_at = q
                self._deviation = self.plant.draw_repeatability(1, self._rng)
            if self._carries is not None:
                return self._carries.seen(self._clock.now(), q, self._load, self._deviation, self._fitted)
            seen = self.plant.true_points(q, self._load, self._deviation, self._fitted)
            return {name: xyz[0] for name, xyz in seen.items()}

    def wrench(self) -> Array:
        """(6,) what the payload applies to the force sensor now, in the sensor frame [N, N m]."""
        with self._lock:
            q = np.array(self._joints(), dtype=float)
            if self._carries is not None:
                return self._carries.sensed(self._clock.now(), q, self._load)
            wrench: Array = self.plant.wrench(q, self._load)[0]
            return wrench

    def temperatures(self) -> dict[str, float]:
        return temperatures(self._clock.now())


def temperatures(seconds: float) -> dict[str, float]:
    """Air swings slowly round 21 °C; the rails warm up by 2 K in the first hours and follow the air an hour behind."""

    def air(t: float) -> float:
        return 21.0 + 0.6 * math.sin(2 * math.pi * t / 21600.0) + 0.15 * math.sin(2 * math.pi * t / 5400.0 + 1)

    return {"air": air(seconds), "rail": air(seconds - 3600.0) + 2.0 * -math.expm1(-seconds / 7200.0)}


def _rows(q: Array) -> Array:
    return np.atleast_2d(np.asarray(q, dtype=float))


def _tracker_place(rng: np.random.Generator) -> Array:
    """(4, 4) the measuring frame in the base frame, for `base: estimate`: 3 to 6 m away, turned any way."""
    away = rng.normal(size=3)
    place = np.eye(4)
    place[:3, :3] = Rotation.from_rotvec(rng.uniform(0.3, np.pi) * _unit(rng.normal(size=3))).as_matrix()
    place[:3, 3] = rng.uniform(3.0, 6.0) * _unit(away)
    return place


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector), dtype=np.float64)
