"""What is wrong with one particular machine: its imperfections, drawn from a seed and dimensioned to a known error.

The paper (eq 26) adds three: geometric errors as "simple mathematical functions such as sin", elastic ones by
beam theory, and a random part. The numbers are our choices, not the paper's. They are dimensioned the way a maker
would, backwards from the result: the 98.6 % quantile of the uncompensated error at the treatment point is
ERROR_PER_SPAN of the workspace, which makes 7–10 mm on the patient positioner (paper: 7 to 8 mm measured, about
10 mm simulated), the geometric part about a third of it and the elastic the largest, all links turning by about
as much. The random part is scaled to the repeatability in the machine file, by the same 98.6 % quantile.

Known limitations: one joint's errors depend on that joint alone and elasticity is linear, on purpose: nothing here is
beyond model (17). No error of the base, since it could not be told from the first joint's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from simulators.beams import LinkBeam, box
from simulators.chain import Array, Chain, Joint, link_poses, link_wrenches, payload_wrench

QUANTILE = 0.986  # the paper's figure for every accuracy it states
ERROR_PER_SPAN = 2.0e-3  # of the longest side of the box that the treatment point reaches; ours
ERROR_SPREAD = 0.05  # machines of one kind differ by this much either way
GEOMETRIC_SHARE = (0.28, 0.38)
SAMPLES = 1500
DEFAULT_REPEATABILITY = 1.4e-4  # the paper's, for a machine file that says nothing
WAVES = 3

Springs = tuple[LinkBeam | None, ...]


@dataclass(frozen=True)
class JointShape:
    """Geometric error of one joint: constant, slope and a few long waves for each of its six components.

    constant, slope  (6,)        slope over half of the travel [m, rad]
    amplitude        (6, WAVES)  [m, rad];  wavelength in units of q;  phase [rad]
    """

    middle: float
    half_travel: float
    constant: Array
    slope: Array
    amplitude: Array
    wavelength: Array
    phase: Array

    def at(self, q: Array) -> Array:
        """(N,) → (N, 6)"""
        u = (q - self.middle) / self.half_travel
        waves = np.sin(2 * np.pi * (q - self.middle)[:, None, None] / self.wavelength + self.phase)
        return np.asarray(self.constant + u[:, None] * self.slope + np.sum(self.amplitude * waves, axis=2), dtype=float)

    def scaled(self, factor: float) -> JointShape:
        return replace(
            self,
            constant=self.constant * factor,
            slope=self.slope * factor,
            amplitude=self.amplitude * factor,
        )


@dataclass(frozen=True)
class Truth:
    """shapes, springs per joint; scatter (n, 6) one standard deviation of the random part [m, rad]."""

    shapes: tuple[JointShape, ...]
    springs: Springs
    scatter: Array


def geometric(shapes: tuple[JointShape, ...], q: Array) -> Array:
    """(N, n) → (N, n, 6)"""
    return np.stack([shape.at(q[:, i]) for i, shape in enumerate(shapes)], axis=1)


def elastic(chain: Chain, springs: Springs, q: Array, wrenches: Array) -> Array:
    """C_i(q_i) times what the machine file lets act on link i: (N, n), (N, n, 6) → (N, n, 6)"""
    bent = np.zeros_like(wrenches)
    for i, (joint, spring) in enumerate(zip(chain.joints, springs, strict=True)):
        if spring is not None:
            bent[:, i] = np.einsum("nab,nb->na", spring.compliance(q[:, i]), wrenches[:, i] * joint.acts)
    return bent


def treatment_point(chain: Chain) -> Array:
    """(3,) in the end-effector frame: the point `treatment`, or the middle of the reflectors where there is none."""
    middle = np.mean(list(chain.targets.values()), axis=0)
    return np.asarray(chain.points.get("treatment", middle), dtype=float)


def rated_payload(chain: Chain) -> float:
    """Heaviest payload [kg]: the paper's 200 kg, less for a light machine (guess: 0.14 of its own moving mass)."""
    own = sum(joint.mass for joint in chain.joints)
    return min(200.0, 0.14 * own) if own else 200.0


def random_poses(chain: Chain, count: int, rng: np.random.Generator) -> Array:
    """(count, n) anywhere within the limits."""
    lower = [joint.lower for joint in chain.joints]
    upper = [joint.upper for joint in chain.joints]
    return rng.uniform(lower, upper, (count, len(chain.joints)))


def random_payloads(chain: Chain, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Masses (count,) from a tenth of the rated payload up (20 … 200 kg) and centres of mass (count, 3), sensor frame.

    A load lies about halfway from the sensor to the treatment point: legs and couch on the near side (guess).
    """
    rated = rated_payload(chain)
    in_link = (chain.tip @ np.append(treatment_point(chain), 1.0))[:3]
    in_sensor = chain.sensor[:3, :3].T @ (in_link - chain.sensor[:3, 3])
    spread = max(0.05, 0.2 * float(np.linalg.norm(in_sensor)))
    mass = rng.uniform(0.1 * rated, rated, count)
    return mass, 0.5 * in_sensor + rng.uniform(-spread, spread, (count, 3))


def draw_truth(chain: Chain, seed: int, repeatability: float) -> Truth:
    """Draw the imperfections of machine number `seed` and dimension them; the same seed gives the same machine."""
    shape_rng, beam_rng, sample_rng, scatter_rng = np.random.default_rng(seed).spawn(4)
    q = random_poses(chain, SAMPLES, sample_rng)
    mass, com = random_payloads(chain, SAMPLES, sample_rng)
    poses = link_poses(chain, q)
    point = _point(chain, poses)
    wrenches = link_wrenches(chain, poses, payload_wrench(chain, poses[:, -1], mass, com))
    span = max(float(np.ptp(point, axis=0).max()), 0.1)

    wanted = ERROR_PER_SPAN * span * shape_rng.uniform(1 - ERROR_SPREAD, 1 + ERROR_SPREAD)
    raw_shapes = tuple(_draw_shape(joint, shape_rng) for joint in chain.joints)
    by_shape = _moves_point(poses, point, geometric(raw_shapes, q)).sum(axis=1)
    factor = wanted * shape_rng.uniform(*GEOMETRIC_SHARE) / _size(by_shape)
    springs = _draw_springs(chain, beam_rng)
    springs = _dimension(
        springs,
        _moves_point(poses, point, elastic(chain, springs, q, wrenches)),
        by_shape * factor,
        np.linalg.norm(point[:, None, :] - poses[..., :3, 3], axis=2).mean(axis=0),
        wanted,
        beam_rng,
    )
    return Truth(
        shapes=tuple(shape.scaled(factor) for shape in raw_shapes),
        springs=springs,
        scatter=_scatter(poses, point, span, repeatability, scatter_rng),
    )


def _point(chain: Chain, poses: Array) -> Array:
    """(N, 3) the treatment point in the base frame."""
    at_tip = chain.tip @ np.append(treatment_point(chain), 1.0)
    return np.asarray((poses[:, -1] @ at_tip)[:, :3], dtype=float)


def _moves_point(poses: Array, point: Array, twists: Array) -> Array:
    """First order, for dimensioning only: what each link's small twist does to the point: (N, n, 6) → (N, n, 3)."""
    turn = poses[..., :3, :3]
    shift = np.einsum("njab,njb->nja", turn, twists[..., :3])
    rotation = np.einsum("njab,njb->nja", turn, twists[..., 3:])
    moved: Array = shift + np.cross(rotation, point[:, None, :] - poses[..., :3, 3])
    return moved


def _size(vectors: Array) -> float:
    return float(np.quantile(np.linalg.norm(vectors, axis=-1), QUANTILE))


def _draw_shape(joint: Joint, rng: np.random.Generator) -> JointShape:
    """Straightness of tenths of a millimetre, angles of tenths of a milliradian; short travels bend less."""
    travel = joint.upper - joint.lower
    long = travel / (1.0 if joint.prismatic else np.pi / 2)
    unit = np.repeat([2.0e-4, 1.5e-4], 3) * np.clip(np.sqrt(long), 0.25, 1.3)
    waves = np.arange(WAVES) < rng.integers(1, WAVES + 1, (6, 1))  # one to three of them
    return JointShape(
        middle=(joint.lower + joint.upper) / 2,
        half_travel=travel / 2,
        constant=unit * rng.normal(0.0, 1.0, 6),
        slope=unit * rng.normal(0.0, 0.7, 6),
        amplitude=unit[:, None] * rng.uniform(0.2, 0.9, (6, WAVES)) * waves,
        wavelength=travel * rng.uniform(0.6, 2.5, (6, WAVES)),
        phase=rng.uniform(0.0, 2 * np.pi, (6, WAVES)),
    )


def _draw_springs(chain: Chain, rng: np.random.Generator) -> Springs:
    """A beam for every link that the machine file calls elastic, of steel or aluminium, on a springy root."""
    springs: list[LinkBeam | None] = []
    for i, joint in enumerate(chain.joints):
        following = chain.joints[i + 1].origin if i + 1 < len(chain.joints) else chain.tip
        draw = rng.uniform(0.0, 1.0, 12)  # always as many, so that one link's entry does not reshape the others
        springs.append(_draw_beam(joint, following, draw) if joint.acts.any() else None)
    return tuple(springs)


def _draw_beam(joint: Joint, following: Array, draw: Array) -> LinkBeam:
    kind, direction, length = "carrying", following[:3, 3], 0.0
    longest = 0.0
    if joint.varies:
        leading = joint.origin[:3, :3].T @ joint.origin[:3, 3]
        kind, direction = ("reaching", joint.axis) if joint.prismatic else ("turning", leading)
    if kind == "reaching":
        travel = joint.upper - joint.lower
        length = max(abs(float(leading @ joint.axis)), 0.2 * travel - joint.lower, 0.1 - joint.lower)
        longest = length + joint.upper
    else:
        if np.linalg.norm(direction) < 0.02:  # the next joint sits on top of this one: a hub along the axis
            direction = joint.axis
        longest = length = max(float(np.linalg.norm(direction)), 0.1)
    youngs = (2.1e11 if draw[0] < 0.7 else 7.0e10) * (0.97 + 0.06 * draw[1])
    height = max(0.08, longest * (0.12 + 0.08 * draw[2]))
    section = box(height * (0.7 + 0.6 * draw[3]), height, height * (0.04 + 0.04 * draw[4]), youngs)
    # the guide or bearing: each of its freedoms gives way by a fraction of what the beam does
    beam = np.repeat([longest**3 / (3 * section.eiy), longest / section.eiy], 3)
    return LinkBeam(kind, direction, length, joint.axis, section, beam * (0.1 + 0.5 * draw[5:11]))


def _dimension(
    springs: Springs,
    moved: Array,
    by_shape: Array,
    lever: Array,
    wanted: float,
    rng: np.random.Generator,
) -> Springs:
    """Make each link as soft as its share of the sag asks for, then all of them until the whole error is `wanted`.

    moved     (N, n, 3)  what each link's bending does to the point
    by_shape  (N, 3)     what geometry does to it
    lever     (n,)       how far the point is from each joint: a link's share grows with it, sliding beams count twice
    """
    raw = np.array([_size(moved[:, i]) for i in range(len(springs))])
    if not raw.any():
        return springs
    share = lever * rng.uniform(0.5, 1.5, len(springs))
    share *= [2.0 if spring is not None and spring.kind == "reaching" else 1.0 for spring in springs]
    factor = np.divide(share, raw, out=np.zeros_like(raw), where=raw > 0)
    middle = np.exp(np.mean(np.log(factor[factor > 0])))
    factor = np.clip(factor, middle / 30, middle * 30)  # a link that hardly bends is not made of rubber
    sag = np.einsum("nja,j->na", moved, factor)

    def excess(s: float) -> float:
        return _size(by_shape + s * sag) - wanted

    overall = float(_root(excess, 4 * wanted / _size(sag)))
    return tuple(
        None if spring is None else replace(spring, softness=float(f) * overall)
        for spring, f in zip(springs, factor, strict=True)
    )


def _root(function: Callable[[float], float], upper: float) -> float:
    return float(brentq(function, 0.0, upper, xtol=1e-9 * upper, rtol=1e-10))


def _scatter(poses: Array, point: Array, span: float, repeatability: float, rng: np.random.Generator) -> Array:
    """(n, 6) standard deviations: all joints alike, an angle worth as much as a shift at half of the span.

    Scaled so that the 98.6 % quantile of the radial deviation at the treatment point, over random configurations, is
    the repeatability.
    """
    sigma = np.broadcast_to(np.repeat([1.0, 2.0 / span], 3), (poses.shape[1], 6))
    many = np.concatenate(
        [_moves_point(poses, point, sigma * rng.normal(size=(*poses.shape[:2], 6))).sum(axis=1) for _ in range(20)]
    )
    return sigma * (repeatability / _size(many))
