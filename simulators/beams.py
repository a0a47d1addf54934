"""How a link bends: cantilevers of prismatic section on a springy root, by beam theory.

A link is a straight Timoshenko beam (bending, shear, stretch, torsion) whose root sits in a flexible guide carriage or
bearing. The compliance is given in the link's frame at its origin, symmetric, and depends on the link's own q alone:

  reaching    a prismatic joint with `varies: true`: the beam slides out of its guide, L(q) = L₀ + q, and ends at O_i;
              its root is the guide, a length L behind
  turning     a revolute joint with `varies: true`: the beam leads up to O_i and stays with the link before, so that
              seen from the link's frame it turns with q
  carrying    every other: the root is at O_i, and the beam leads on to the next joint, turning with the link

Vectors of six are translation then rotation, force then moment.

Known limitations: all that a link carries, its own weight too, is taken as one wrench through the beam's end, as
eq (15) does; a distributed weight would bend it a little less. No buckling, no second-order theory (P–Δ).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from simulators.chain import Array

SHEAR_FACTOR = 5 / 6  # rectangular section (Timoshenko); a thin box has less, well inside our freedom of choice
POISSON = 0.3


@dataclass(frozen=True)
class Section:
    """Stiffnesses of a beam's section; x runs along the beam.

    ea   stretch   E A [N];     ga  shear  κ G A [N]
    eiy, eiz  bending about y and z  E I [N m²];    gj  torsion  G J [N m²]
    """

    ea: float
    ga: float
    eiy: float
    eiz: float
    gj: float


def box(width: float, height: float, wall: float, youngs: float) -> Section:
    """A closed rectangular box, `width` along y, `height` along z [m], Young's modulus [Pa]; torsion after Bredt."""
    inner_width, inner_height = width - 2 * wall, height - 2 * wall
    area = width * height - inner_width * inner_height
    shear_modulus = youngs / (2 * (1 + POISSON))
    mid_width, mid_height = width - wall, height - wall
    torsion = 2 * wall * (mid_width * mid_height) ** 2 / (mid_width + mid_height)
    return Section(
        ea=youngs * area,
        ga=SHEAR_FACTOR * shear_modulus * area,
        eiy=youngs * (width * height**3 - inner_width * inner_height**3) / 12,
        eiz=youngs * (height * width**3 - inner_height * inner_width**3) / 12,
        gj=shear_modulus * torsion,
    )


def cantilever(section: Section, length: Array) -> Array:
    """Free-end compliance of a cantilever that runs along +x from its clamped root.

        δ = F L³/(3 E I) + F L/(κ G A) + M L²/(2 E I),   θ = F L²/(2 E I) + M L/(E I)

    length (N,) [m] → (N, 6, 6) [m/N, rad/(N m), …]. Gere & Timoshenko, Mechanics of Materials.
    """
    c = np.zeros((len(length), 6, 6))
    c[:, 0, 0] = length / section.ea
    c[:, 1, 1] = length**3 / (3 * section.eiz) + length / section.ga
    c[:, 2, 2] = length**3 / (3 * section.eiy) + length / section.ga
    c[:, 3, 3] = length / section.gj
    c[:, 4, 4] = length / section.eiy
    c[:, 5, 5] = length / section.eiz
    c[:, 1, 5] = c[:, 5, 1] = length**2 / (2 * section.eiz)
    c[:, 2, 4] = c[:, 4, 2] = -(length**2) / (2 * section.eiy)  # a push along z turns the end about −y
    return c


def seen_from(compliance: Array, point: Array) -> Array:
    """Compliance known at `point`, for wrenches and displacements taken at the frame's origin: X C Xᵀ.

    compliance (N, 6, 6) at `point` (N, 3); displacement at the origin is δ + p × θ, moment at the point M − p × F.
    """
    x = np.zeros((len(point), 6, 6))
    x[:, range(6), range(6)] = 1.0
    x[:, :3, 3:] = np.cross(point[:, None, :], np.eye(3)).transpose(0, 2, 1)
    return x @ compliance @ x.transpose(0, 2, 1)


def turned(compliance: Array, rotation: Array) -> Array:
    """Compliance in other axes; rotation (…, 3, 3) holds the old axes as columns in the new ones."""
    both = np.zeros((*rotation.shape[:-2], 6, 6))
    both[..., :3, :3] = both[..., 3:, 3:] = rotation
    return both @ compliance @ np.swapaxes(both, -1, -2)


def along(direction: Array) -> Array:
    """(3, 3) axes of a beam in this direction: x along it, y and z anywhere across, but always the same."""
    x = direction / np.linalg.norm(direction)
    helper = np.eye(3)[2 - int(np.argmin(np.abs(x[::-1])))]  # so that a beam along the frame's x has its axes
    y = np.cross(helper, x)
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


@dataclass(frozen=True)
class LinkBeam:
    """One link's elasticity.

    kind       "reaching" | "turning" | "carrying", see above
    direction  (3,) root to end; in the joint frame for "turning", in the link's frame otherwise
    length     L, or L₀ for "reaching" [m]
    root       (6,) compliance of the guide or bearing at the beam's root, in beam axes [m/N, rad/(N m)]
    softness   factor on the whole compliance: 1 for the section as given
    """

    kind: str
    direction: Array
    length: float
    axis: Array
    section: Section
    root: Array
    softness: float = 1.0

    def compliance(self, q: Array) -> Array:
        """(N,) joint values → (N, 6, 6), symmetric, at O_i in F_i."""
        length = self.length + (q if self.kind == "reaching" else np.zeros_like(q))
        if np.any(length <= 0):
            raise ValueError(f"beam: free length {length.min():g} m is not positive")
        x = self.direction / np.linalg.norm(self.direction)
        axes = along(x)
        end = turned(cantilever(self.section, length), axes)
        root = np.broadcast_to(turned(np.diag(self.root), axes), end.shape)
        here, there = np.zeros((len(q), 3)), length[:, None] * x
        if self.kind == "carrying":
            return self.softness * (root + seen_from(end, there))
        at_frame = self.softness * (end + seen_from(root, here - there))
        if self.kind == "turning":
            return turned(at_frame, Rotation.from_rotvec(-q[:, None] * self.axis).as_matrix())
        return at_frame
