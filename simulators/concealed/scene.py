"""The campaign on one machine, and what an effect may change of it before the instruments read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from simulators import chain as kinematics
from simulators.chain import Array, Chain, displacement
from simulators.concealed.campaign import Campaign
from simulators.plant import Plant

COMPONENTS = ("tx", "ty", "tz", "rx", "ry", "rz")


@dataclass(frozen=True)
class Change:
    """What an effect does, each in its place; None where it does nothing.

    eps       (N, n, 6)  displacement of every link, in its own frame, on top of the machine's own   [m, rad]
    base      (N, 6)     displacement of the whole machine seen from the tracker, base frame          [m, rad]
    stretch   (N,)       lengths from `station` come out longer by this factor minus one
    station   (3,)       where the tracker stands [m]
    on_tip    (N, T, 3)  displacement of the reflectors on the end effector, its frame                [m]
    readings  (N, T, 3)  added to what the tracker says                                               [m]
    wrench    (N, 6)     added to what the force sensor says                                          [N, N·m]
    """

    eps: Array | None = None
    base: Array | None = None
    stretch: Array | None = None
    station: Array | None = None
    on_tip: Array | None = None
    readings: Array | None = None
    wrench: Array | None = None


@dataclass(frozen=True)
class Concealed:
    """One effect, its size still open.

    scene       the campaign that it was drawn on: what it depends on and where it sits were chosen there
    effect      the contract's name (§4), or one of our own for what no term knows
    form        which of its forms, in words
    joint       the joint that a diagnosis should name; None where it belongs to none
    component   of that joint's frame, tx … rz, or None
    covariates  the columns that it depends on
    on          (scene, amplitude) → Change, on that campaign or on any other of the same plant
    parameters  amplitude → values that a person would want to know
    start       an amplitude to begin with
    also        other joints that would be a fair answer;  neighbours: other names that would be
    """

    scene: Scene
    effect: str
    form: str
    joint: str | None
    component: str | None
    covariates: tuple[str, ...]
    on: Callable[[Scene, float], Change]
    parameters: Callable[[float], dict[str, float]]
    start: float = 1e-4
    also: tuple[str, ...] = ()
    neighbours: tuple[str, ...] = ()
    target: str | None = None

    def change(self, amplitude: float) -> Change:
        """On the campaign that it was drawn on."""
        return self.on(self.scene, amplitude)

    def unit(self, parameter: str) -> str:
        """Of one of its `parameters`: m, rad, s, 1 and fractions of these."""
        if parameter.endswith("_s"):
            return "s"
        if parameter in ("exponent", "width", "count"):  # width: a share of the greatest load
            return "1"
        if parameter in ("relative", "scale"):
            return "1/K" if "temp_air_C" in self.covariates else "1"
        if parameter == "compliance":
            return "rad/(N m)"
        chain = self.scene.chain
        prismatic = any(joint.prismatic for joint in chain.joints if joint.name == self.joint)
        if parameter in ("way", "period"):  # along the joint's own travel
            return "m" if prismatic else "rad"
        unit = "rad" if (self.component or "t").startswith("r") else "m"
        if parameter == "per_kelvin":  # a rail grows by a share of its free length
            return "1/K" if prismatic and unit == "m" else f"{unit}/K"
        return unit


@dataclass(frozen=True)
class Scene:
    """A plant on its campaign: what effects look at.

    q         (N, n) where the joints are by their encoders [m, rad]
    poses     (N, n, 4, 4) nominal link frames
    wrench    (N, 6) the payload's, sensor frame;  carried (N, n, 6) what every link carries, its own frame
    payload   (N, n, 6) the payload's share of that
    scatter   (N, n, 6) eps_r: the random part of each arrival
    rigid     joints that the machine file takes for rigid
    """

    plant: Plant
    campaign: Campaign
    q: Array
    poses: Array
    wrench: Array
    carried: Array
    payload: Array
    scatter: Array
    rigid: tuple[str, ...] = ()
    targets: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @classmethod
    def of(
        cls, plant: Plant, campaign: Campaign, q: Array, rng: np.random.Generator, rigid: Sequence[str] = ()
    ) -> Scene:
        poses = kinematics.link_poses(plant.chain, q)
        wrench = kinematics.payload_wrench(plant.chain, poses[:, -1], campaign.mass, campaign.com)
        carried = kinematics.link_wrenches(plant.chain, poses, wrench)
        own = kinematics.link_wrenches(plant.chain, poses, np.zeros_like(wrench))
        return cls(
            plant, campaign, q, poses, wrench, carried, carried - own, plant.draw_repeatability(len(q), rng),
            tuple(rigid), np.array(list(plant.targets.values())),
        )  # fmt: skip

    def remembering(self, correlation: float) -> Scene:
        """The same, of a machine each of whose arrivals scatters partly as the one before did."""
        scatter = self.scatter.copy()
        for v in range(1, len(scatter)):
            scatter[v] = correlation * scatter[v - 1] + np.sqrt(1.0 - correlation**2) * scatter[v]
        return replace(self, scatter=scatter)

    def __len__(self) -> int:
        return len(self.q)

    @property
    def chain(self) -> Chain:
        return self.plant.chain

    def unit_position(self, k: int) -> Array:
        """(N,) joint k's position, −1 … 1 over its travel."""
        joint = self.chain.joints[k]
        return np.asarray((2 * self.q[:, k] - joint.lower - joint.upper) / (joint.upper - joint.lower))

    def travel(self, k: int) -> float:
        return self.chain.joints[k].upper - self.chain.joints[k].lower

    def own_freedom(self, k: int) -> tuple[Array, str]:
        """(6,) the joint's own motion as a twist in its frame, and the component's name."""
        joint = self.chain.joints[k]
        twist = np.zeros(6)
        twist[0 if joint.prismatic else 3 :][:3] = joint.axis
        return twist, COMPONENTS[int(np.argmax(np.abs(twist)))]

    def eps(self, k: int, values: Array) -> Array:
        """(N, 6) of link k → (N, n, 6) with all others at rest."""
        out = np.zeros((len(self), len(self.chain.joints), 6))
        out[:, k] = values
        return out

    def points(self, changes: Sequence[Change] = (), random: bool = True) -> Array:
        """(N, T, 3) where the tracker sees the reflectors, in the measuring frame, without its own noise [m]."""
        plant = self.plant
        eps = self.scatter * float(random) + sum(c.eps for c in changes if c.eps is not None)
        tips = plant.true_tip(self.q, self.wrench, eps)
        for c in changes:
            if c.base is not None:
                tips = displacement(c.base) @ tips
        on_tip = self.targets + sum((c.on_tip for c in changes if c.on_tip is not None), np.zeros((len(self), 1, 3)))
        seen = np.einsum("nij,ntj->nti", tips[:, :3, :3], on_tip) + tips[:, None, :3, 3]
        for c in changes:
            if c.stretch is not None:
                station = np.zeros(3) if c.station is None else c.station
                seen = seen + c.stretch[:, None, None] * (seen - station)
        for c in changes:
            if c.readings is not None:
                seen = seen + c.readings
        to_measuring = np.linalg.inv(plant.measuring_in_base)
        return np.asarray(seen @ to_measuring[:3, :3].T + to_measuring[:3, 3])

    def sensed(self, changes: Sequence[Change] = ()) -> Array:
        """(N, 6) what the force sensor says, without its noise [N, N·m]."""
        return self.wrench + sum((c.wrench for c in changes if c.wrench is not None), np.zeros((1, 6)))

    def field(self, change: Change) -> Array:
        """(N, T, 3) what this change alone moves, as far as a model that reads the recording's columns can tell [m].

        An error of the force sensor moves nothing; it makes the columns promise another sag than there is.
        """
        moved = self.points([change], random=False) - self.points(random=False)
        if change.wrench is None:
            return moved
        promised = self.plant.true_tip(self.q, self.sensed([change]), None)
        real = self.plant.true_tip(self.q, self.wrench, None)
        gap = np.einsum("nij,tj->nti", (real - promised)[:, :3, :3], self.targets) + (real - promised)[:, None, :3, 3]
        to_measuring = np.linalg.inv(self.plant.measuring_in_base)
        return np.asarray(moved + gap @ to_measuring[:3, :3].T)


def rms(vectors: Array) -> float:
    """Root mean square length of (..., 3)."""
    return float(np.sqrt((vectors**2).sum(axis=-1).mean()))
