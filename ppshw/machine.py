"""Machine file → Machine. The file's form is fixed by the contract; see docs/machine-file.md.

Joints run from base to tip and mean what they mean in URDF. A file is read strictly: unknown keys, wrong types,
duplicate names and axes that are no unit vectors are errors that name file, line and key.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ppshw.errors import MachineFileError
from ppshw.strict_yaml import Section, read_yaml
from ppshw.transforms import from_xyz_rpy

Array = NDArray[np.float64]
BentBy = Literal["own", "beyond", "payload"]
# A maker's repeatability is taken as the 98.6 % radius of a round normal scatter in three directions: 3.27 sigma.
RADIUS_986 = 3.27
STRONGEST = 20.0  # m/s² of gravity: twice the Earth's is no machine's, but millimetres
SAME_PLACE_M = 1e-3  # of two reflectors, which have half an inch across
AXIS_ROUNDED = 1e-3  # an axis may be written with three decimals
# What stands in a machine file beyond these was meant in other units: ours. Turns of a joint; lengths and scatter [m];
# gravity [m/s²]; how far a body's centre is from its frame, if that is beyond the machine's reach [m]; masses.
MOST_TURNS, MOST_LONG, COARSE_M = 6.0, 100.0, 5e-3
EARTH_G, LEAST_FAR_M, HEAVY_KG = (9.5, 10.1), 5.0, 1e5
WRENCH_COMPONENTS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


@dataclass(frozen=True)
class Limits:
    """lower, upper [m or rad]; velocity [m/s or rad/s]; acceleration [m/s² or rad/s²]; None where not given."""

    lower: float
    upper: float
    velocity: float | None
    acceleration: float | None


@dataclass(frozen=True)
class Elastic:
    """Which wrench components act on a link, and whether its compliance depends on the joint's own position."""

    loads: tuple[str, ...]
    varies: bool

    @property
    def load_indices(self) -> list[int]:
        return [WRENCH_COMPONENTS.index(name) for name in self.loads]


@dataclass(frozen=True)
class Joint:
    """origin  (4, 4) joint frame in the previous link frame at q = 0; axis (3,) unit vector in the joint frame.
    mass [kg] and com (3,) [m] of the body this joint moves, in the joint frame after motion."""

    name: str
    prismatic: bool
    origin: Array
    axis: Array
    limits: Limits | None
    mass: float
    com: Array
    elastic: Elastic | None

    @property
    def unit(self) -> str:
        return "m" if self.prismatic else "rad"


@dataclass(frozen=True)
class TrackerModel:
    """position_sigma [m] per coordinate; base (4, 4) measuring frame in the base frame, None: to be estimated;
    targets_known: are the target positions trusted or only a start."""

    position_sigma: float
    base: Array | None
    targets_known: bool

    @property
    def frame(self) -> Array:
        """(4, 4) measuring frame in the base frame; the base frame itself where the file leaves it open."""
        return np.eye(4) if self.base is None else self.base


@dataclass(frozen=True)
class Machine:
    """A serial chain of n joints with a tip, targets on it and what is known of its load path.

    gravity (3,) in the base frame [m/s²]; tip_in_link (4, 4) end-effector frame in the last link frame; targets and
    points: name → (3,) in the end-effector frame [m]; sensor_in_link (4, 4) force sensor in the last link frame.
    bent_by: whose weights bend a joint beside the payload: its "own" and farther links', those of links "beyond" it, or
    none ("payload"). No file says so, a recording may (`identification.own_weight`).
    sha256  of what the file says of the chain, its loads, its reflectors and where they are measured from, however it
            is written (`_digest`)
    """

    name: str
    gravity: Array
    joints: tuple[Joint, ...]
    tip_in_link: Array
    targets: dict[str, Array]
    points: dict[str, Array]
    sensor_in_link: Array
    repeatability: float | None
    tracker: TrackerModel
    file: str
    sha256: str
    bent_by: BentBy = "own"

    @property
    def n(self) -> int:
        return len(self.joints)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(j.name for j in self.joints)

    @cached_property
    def frame_names(self) -> tuple[str, ...]:
        """Frames F_0 … F_n: the base, then one per joint (which may be called "base" too)."""
        return next(k for k in ("base", "ground", "floor") if k not in self.joint_names), *self.joint_names

    @property
    def target_array(self) -> Array:
        """(T, 3) target positions in the end-effector frame, in the file's order."""
        return np.array(list(self.targets.values()))

    def point(self, name: str) -> Array:
        """A named point in the end-effector frame: a target, another point of interest, or the `tip` itself where the
        file calls nothing else so."""
        if name in self.points:
            return self.points[name]
        if name in self.targets:
            return self.targets[name]
        if name == "tip":
            return np.zeros(3)
        known = ", ".join(["tip", *self.points, *self.targets])
        raise MachineFileError(f"{self.file}: no point named '{name}' (there are: {known})")

    @property
    def own_ways(self) -> Array:
        """(n, 6) the generalized errors, in its frame, that every joint's own motion is."""
        nothing = np.zeros(3)
        return np.array(
            [np.append(j.axis, nothing) if j.prismatic else np.append(nothing, j.axis) for j in self.joints]
        )

    @property
    def up(self) -> Array:
        """(3,) against gravity; where a file says that there is none, the base frame's z."""
        size = float(np.linalg.norm(self.gravity))
        return -self.gravity / size if size > 0.0 else np.array([0.0, 0.0, 1.0])

    @property
    def where_it_counts(self) -> str:
        """The point at which accuracy is asked for unless somebody says otherwise: `treatment`, else the first point of
        the file, or the tip."""
        return "treatment" if "treatment" in self.points else next(iter(self.points), "tip")

    def limits(self) -> tuple[Array, Array]:
        """(n,) lower and upper; infinite where the file gives none."""
        lower = [j.limits.lower if j.limits else -math.inf for j in self.joints]
        upper = [j.limits.upper if j.limits else math.inf for j in self.joints]
        return np.array(lower), np.array(upper)

    def with_targets(self, targets: dict[str, Array]) -> Machine:
        return replace(self, targets=targets)


def shipped_machines() -> Path:
    """The folder of the machine files that come with ppshw: in the checkout, or inside the installed package."""
    here = Path(__file__).resolve().parent
    return found if (found := here / "machines").is_dir() else here.parent / "machines"


def load_machine(path: Path | str) -> Machine:
    """Read and check a machine file. Raises MachineFileError: one line with file, line, key and what was expected."""
    top = read_yaml(path, MachineFileError)
    name = top.text("name")
    gravity = top.vector("gravity", 3)
    if (size := float(np.linalg.norm(gravity))) > STRONGEST:
        top.fail(f"'gravity' is {size:g} long, expected at most {STRONGEST:g} m/s² (9.81 on Earth)", "gravity")
    joints = _joints(top)
    tip = top.need("tip")
    tip_in_link = _origin(tip)
    targets = _named_points(tip, "targets")
    if not targets:
        tip.fail(f"'{tip.path('targets')}' is empty, expected at least one target", "targets")
    for (one, there), (other, here) in itertools.combinations(targets.items(), 2):
        if np.linalg.norm(there - here) < SAME_PLACE_M:
            tip.fail(f"'{one}' and '{other}' are at the same place, expected reflectors beside each other", "targets")
    points = _named_points(tip, "points", optional=True)
    for twin in set(points) & set(targets):
        tip.fail(f"'{twin}' is both a target and a point", "points")
    tip.done()
    _refuse_shared_columns(top, tip, joints, targets, points)
    sensor_in_link = np.eye(4)
    if (sensor := top.section("force_sensor", optional=True)) is not None:
        sensor_in_link = _origin(sensor)
        sensor.done()
    repeatability = None
    if (section := top.section("repeatability", optional=True)) is not None:
        repeatability = section.number("position", low=0.0)
        section.done()
    tracker = _tracker(top)
    top.done()
    machine = Machine(
        name, gravity, joints, tip_in_link, targets, points, sensor_in_link, repeatability, tracker, str(path), ""
    )  # fmt: skip
    return replace(machine, sha256=_digest(machine))


def _digest(machine: Machine) -> str:
    """SHA-256 of all that a calibration rests on: not limits, nor points of interest, nor what the maker claims."""

    def numbers(values: Array) -> Any:
        return (values + 0.0).tolist()  # without a sign of zero

    tracker = machine.tracker
    says = {
        "name": machine.name, "gravity": numbers(machine.gravity),
        "joints": [
            [j.name, j.prismatic, numbers(j.origin), numbers(j.axis), j.mass, numbers(j.com),
             j.elastic and [j.elastic.loads, j.elastic.varies]]
            for j in machine.joints
        ],
        "tip": numbers(machine.tip_in_link), "force_sensor": numbers(machine.sensor_in_link),
        "targets": [[name, numbers(at)] for name, at in machine.targets.items()],
        "tracker": [tracker.position_sigma, tracker.base if tracker.base is None else numbers(tracker.base),
                    tracker.targets_known],
    }  # fmt: skip
    return hashlib.sha256(json.dumps(says).encode()).hexdigest()


def doubts(machine: Machine) -> list[str]:
    """What is odd about a machine that can be used even so, each in a line: an axis with a slip ring does turn on."""
    said = []
    for joint in machine.joints:
        if joint.prismatic or joint.limits is None:
            continue
        low, high = joint.limits.lower, joint.limits.upper
        if (turns := (high - low) / (2 * math.pi)) > MOST_TURNS:
            said.append(f"joint '{joint.name}': {low:g} … {high:g} rad is {turns:.1f} turns; are these degrees?")
    said += [f"{what} of {size:g} m; are these millimetres?" for what, size in _lengths(machine) if size > MOST_LONG]
    if "tip" in {**machine.points, **machine.targets}:
        said.append("a point is called 'tip': --point tip, and no --point, mean that point, not the end-effector frame")
    g = float(np.linalg.norm(machine.gravity))
    if g and not EARTH_G[0] <= g <= EARTH_G[1]:
        said.append(f"gravity is {g:.3g} m/s², expected {EARTH_G[0]} to {EARTH_G[1]}")
    chain = [*(j.origin for j in machine.joints), machine.tip_in_link]
    far = sum(float(np.linalg.norm(place[:3, 3])) for place in chain)
    far += sum(max(abs(j.limits.lower), abs(j.limits.upper)) for j in machine.joints if j.prismatic and j.limits)
    centres = [(f"com of joint '{joint.name}'", joint.com) for joint in machine.joints]
    for what, place in [*centres, ("the origin of force_sensor", machine.sensor_in_link[:3, 3])]:
        if (away := float(np.linalg.norm(place))) > max(far, LEAST_FAR_M):
            said.append(
                f"{what} is {away:.3g} m off its frame, the whole machine reaches {far:.3g} m: are these millimetres?"
            )
    heavy = [joint for joint in machine.joints if joint.mass > HEAVY_KG]
    said += [f"mass of joint '{joint.name}' is {joint.mass:.3g} kg: are these grams?" for joint in heavy]
    sigmas = (("repeatability", machine.repeatability or 0.0), ("position_sigma", machine.tracker.position_sigma))
    return said + [f"{what} is {size:.3g} m: are these millimetres?" for what, size in sigmas if size > COARSE_M]


def _lengths(machine: Machine) -> Iterator[tuple[str, float]]:
    """What a machine file gives in metres."""
    for joint in machine.joints:
        yield f"joint '{joint.name}': an origin", float(np.abs(joint.origin[:3, 3]).max())
        if joint.prismatic and joint.limits is not None:
            yield f"joint '{joint.name}': a travel", joint.limits.upper - joint.limits.lower
    for name, place in {**machine.targets, **machine.points}.items():
        yield f"tip: a place of '{name}'", float(np.abs(place).max())


def _joints(top: Section) -> tuple[Joint, ...]:
    sections = top.sections("joints")
    if not 1 <= len(sections) <= 12:
        top.fail(f"'joints' has {len(sections)} entries, expected 1 to 12", "joints")
    joints: list[Joint] = []
    for section in sections:
        joint = _joint(section)
        if joint.name in [j.name for j in joints]:
            section.fail(f"joint name '{joint.name}' is used twice", "name")
        joints.append(joint)
    return tuple(joints)


def _joint(section: Section) -> Joint:
    name = section.text("name")
    kind = section.text("type", choices=("prismatic", "revolute"))
    origin = _origin(section)
    axis = section.vector("axis", 3)
    length = float(np.linalg.norm(axis))
    if abs(length - 1.0) > AXIS_ROUNDED:
        section.fail(f"'{section.path('axis')}' has length {length:g}, expected a unit vector", "axis")
    limits = _limits(section)
    mass, com = 0.0, np.zeros(3)
    if (link := section.section("link", optional=True)) is not None:
        mass, com = link.number("mass", low=0.0), link.vector("com", 3, default=(0, 0, 0))
        link.done()
    elastic = None
    if (found := section.section("elastic", optional=True)) is not None:
        elastic = Elastic(tuple(found.texts("loads", choices=WRENCH_COMPONENTS)), found.flag("varies", default=False))
        found.done()
    section.done()
    return Joint(name, kind == "prismatic", origin, axis / length, limits, mass, com, elastic)


def _limits(section: Section) -> Limits | None:
    found = section.section("limits", optional=True)
    if found is None:
        return None
    lower, upper = found.number("lower"), found.number("upper")
    if not lower < upper:
        found.fail(f"'{found.path('lower')}' {lower:g} is not below '{found.path('upper')}' {upper:g}", "lower")
    speeds = [found.number(key, default=None, low=1e-9) for key in ("velocity", "acceleration")]
    found.done()
    return Limits(lower, upper, *speeds)


def _origin(section: Section) -> Array:
    found = section.section("origin", optional=True)
    return np.eye(4) if found is None else _placement(found)


def _placement(found: Section) -> Array:
    turned = found.vector("rpy", 3, default=(0, 0, 0))
    if (widest := float(np.abs(turned).max())) > 2 * math.pi:
        found.fail(f"'{found.path('rpy')}': {widest:g} rad is more than a turn; are these degrees?", "rpy")
    out = from_xyz_rpy(found.vector("xyz", 3, default=(0, 0, 0)), turned)
    found.done()
    return out


def _named_points(tip: Section, key: str, optional: bool = False) -> dict[str, Array]:
    found = tip.section(key, optional=optional)
    if found is None:
        return {}
    out = {name: found.vector(name, 3) for name in found.keys()}  # noqa: SIM118
    found.done()
    return out


def _refuse_shared_columns(
    top: Section, tip: Section, joints: tuple[Joint, ...], targets: dict[str, Array], points: dict[str, Array]
) -> None:
    """A reflector `q` on a joint `x`, or joints `x` and `cmd_x`: of two columns of one name in a recording
    (`recording.columns_for`) the second would be written over the first."""
    owners: dict[str, str] = {}

    def claim(owner: str, columns: list[str], section: Section, key: str) -> None:
        for column in columns:
            if column in owners:
                section.fail(f"{owner} and {owners[column]} both have the column {column} in a recording, "
                             "expected another name for one of them", key)  # fmt: skip
            owners[column] = owner

    for name in (j.name for j in joints):
        claim(f"joint '{name}'", [f"{prefix}_{name}" for prefix in ("q_cmd", "q", "approach")], top, "joints")
    for kind, names in (("target", targets), ("point", points)):
        for name in names:
            claim(f"{kind} '{name}'", [f"{name}_{axis}" for axis in "xyz"], tip, f"{kind}s")


def _tracker(top: Section) -> TrackerModel:
    section = top.section("tracker", optional=True)
    if section is None:
        return TrackerModel(2.0e-5, np.eye(4), True)
    sigma = section.number("position_sigma", default=2.0e-5, low=1e-9)
    said = section.plain("base", default=None)
    if isinstance(said, str) and said != "estimate":
        section.fail(f"'{section.path('base')}' is '{said}', expected xyz and rpy, or estimate", "base")
    base = np.eye(4) if said is None else None if said == "estimate" else _placement(section.need("base"))
    known = section.text("targets", default="known", choices=("known", "estimate")) == "known"
    section.done()
    return TrackerModel(sigma, base, known)
