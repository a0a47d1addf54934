"""A serial chain as the machine file describes it: exact kinematics and statics from first principles.

The simulators' own reading of contract §1; it shares nothing with the model that is tested against it. Every pose is a
4×4 matrix, every product exact, every moment a sum of r × m g over bodies in the base frame.

Known limitations: the file is trusted (checking it is the product's business: here a missing key is a plain
ValueError). Where `limits` are absent a revolute joint turns ±π and a prismatic one travels ±0.5 m (a guess).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

COMPONENTS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


@dataclass(frozen=True)
class Joint:
    """One joint and the body it moves.

    origin      (4, 4) joint frame in the previous link frame at q = 0
    axis        (3,) unit vector in the joint frame
    mass, com   the moved body [kg], its centre of mass in the frame after motion [m]
    acts        (6,) True where a component of the wrench bends this link; all False: rigid
    varies      the compliance depends on q
    """

    name: str
    prismatic: bool
    origin: Array
    axis: Array
    lower: float
    upper: float
    mass: float
    com: Array
    acts: NDArray[np.bool_]
    varies: bool


@dataclass(frozen=True)
class Chain:
    """A machine file, read.

    tip              (4, 4) end-effector frame in the last link frame
    sensor           (4, 4) force sensor in the last link frame
    targets, points  (3,) each, in the end-effector frame
    measuring        (4, 4) the tracker's frame in the base frame; None: nobody knows
    """

    name: str
    gravity: Array
    joints: tuple[Joint, ...]
    tip: Array
    targets: Mapping[str, Array]
    points: Mapping[str, Array]
    sensor: Array
    repeatability: float | None
    position_sigma: float
    measuring: Array | None
    targets_known: bool


def transform(xyz: ArrayLike, rpy: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """(4, 4) from a position and URDF's roll, pitch, yaw about the fixed X, Y, Z axes."""
    made = np.eye(4)
    made[:3, :3] = Rotation.from_euler("xyz", np.asarray(rpy, dtype=float)).as_matrix()
    made[:3, 3] = np.asarray(xyz, dtype=float)
    return made


def displacement(twist: Array) -> Array:
    """(N, 6) translation and rotation vector → (N, 4, 4): a finite rotation, not its linear part."""
    made = np.zeros((len(twist), 4, 4))
    made[:, :3, :3] = Rotation.from_rotvec(twist[:, 3:]).as_matrix()
    made[:, :3, 3] = twist[:, :3]
    made[:, 3, 3] = 1.0
    return made


def link_poses(chain: Chain, q: Array, *displaced: Array | None) -> Array:
    """Where every link frame is, in the base frame.

        T_i = T_{i−1} · origin_i · motion_i(q_i) · D_1 · D_2 …

    q          (N, n)     joint values [m, rad]
    displaced  (N, n, 6)  small displacements D of each link in its own frame, applied one after the other
    returns    (N, n, 4, 4)
    """
    poses = np.empty((*q.shape, 4, 4))
    here = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    for i, joint in enumerate(chain.joints):
        motion = np.zeros((len(q), 6))
        motion[:, 0 if joint.prismatic else 3 :][:, :3] = q[:, i, None] * joint.axis
        here = here @ joint.origin @ displacement(motion)
        for twist in displaced:
            if twist is not None:
                here = here @ displacement(twist[:, i])
        poses[:, i] = here
    return poses


def payload_wrench(chain: Chain, last: Array, mass: Array, com: Array) -> Array:
    """What a payload applies to the force sensor, in the sensor frame, at rest.

    last     (N, 4, 4)  last link in the base frame
    mass     (N,)       [kg];  com (N, 3) in the sensor frame [m]
    returns  (N, 6)     F = m Rᵀ g, M = com × F  [N, N m]
    """
    force = mass[:, None] * np.einsum("nba,b->na", (last @ chain.sensor)[:, :3, :3], chain.gravity)
    return np.concatenate([force, np.cross(com, force)], axis=1)


def link_wrenches(chain: Chain, poses: Array, sensor_wrench: Array) -> Array:
    """What every link carries at its frame's origin, in its own frame: the payload and bodies i … n, i included.

    poses          (N, n, 4, 4) from link_poses
    sensor_wrench  (N, 6) in the sensor frame
    returns        (N, n, 6)
    """
    n = len(chain.joints)
    sensor = poses[:, -1] @ chain.sensor
    force = np.einsum("nab,nb->na", sensor[:, :3, :3], sensor_wrench[:, :3])
    moment = np.einsum("nab,nb->na", sensor[:, :3, :3], sensor_wrench[:, 3:])
    moment += np.cross(sensor[:, :3, 3], force)  # about the base origin from here on
    carried = np.empty((len(poses), n, 6))
    for i in reversed(range(n)):
        joint, pose = chain.joints[i], poses[:, i]
        weight = joint.mass * chain.gravity
        force = force + weight
        moment = moment + np.cross(pose[:, :3, :3] @ joint.com + pose[:, :3, 3], weight)
        about_origin = moment - np.cross(pose[:, :3, 3], force)
        carried[:, i, :3] = np.einsum("nba,nb->na", pose[:, :3, :3], force)
        carried[:, i, 3:] = np.einsum("nba,nb->na", pose[:, :3, :3], about_origin)
    return carried


def read_chain(path: str | Path) -> Chain:
    """Read a machine file (contract §1)."""
    try:
        raw = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
        return _chain(raw)
    except (KeyError, TypeError) as problem:
        raise ValueError(f"{path}: not a machine file: {problem!r}") from problem


def _chain(raw: Mapping[str, Any]) -> Chain:
    tip, tracker = raw["tip"], raw.get("tracker") or {}
    base = tracker.get("base") or {"xyz": [0, 0, 0]}
    repeatability = (raw.get("repeatability") or {}).get("position")
    return Chain(
        name=str(raw["name"]),
        gravity=_vector(raw["gravity"]),
        joints=tuple(_joint(entry) for entry in raw["joints"]),
        tip=_origin(tip.get("origin")),
        targets={str(k): _vector(v) for k, v in tip["targets"].items()},
        points={str(k): _vector(v) for k, v in (tip.get("points") or {}).items()},
        sensor=_origin((raw.get("force_sensor") or {}).get("origin")),
        repeatability=None if repeatability is None else float(repeatability),
        position_sigma=float(tracker.get("position_sigma", 0.0)),
        measuring=None if base == "estimate" else _origin(base),
        targets_known=tracker.get("targets", "known") == "known",
    )


def _joint(raw: Mapping[str, Any]) -> Joint:
    prismatic = {"prismatic": True, "revolute": False}[raw["type"]]
    reach = 0.5 if prismatic else np.pi
    limits, link, elastic = (raw.get(key) or {} for key in ("limits", "link", "elastic"))
    axis = _vector(raw["axis"])
    return Joint(
        name=str(raw["name"]),
        prismatic=prismatic,
        origin=_origin(raw.get("origin")),
        axis=axis / np.linalg.norm(axis),
        lower=float(limits.get("lower", -reach)),
        upper=float(limits.get("upper", reach)),
        mass=float(link.get("mass", 0.0)),
        com=_vector(link.get("com", (0.0, 0.0, 0.0))),
        acts=np.array([name in (elastic.get("loads") or ()) for name in COMPONENTS]),
        varies=bool(elastic.get("varies", False)),
    )


def _origin(raw: Mapping[str, Any] | None) -> Array:
    raw = raw or {}
    return transform(raw.get("xyz", (0.0, 0.0, 0.0)), raw.get("rpy", (0.0, 0.0, 0.0)))


def _vector(raw: Sequence[float]) -> Array:
    vector = np.array([float(x) for x in raw])
    if vector.shape != (3,):
        raise TypeError(f"three numbers expected, not {raw!r}")
    return vector
