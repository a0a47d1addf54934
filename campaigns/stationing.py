"""Where a tracker stands, from what it read of three or more reflectors in one position of the machine (free
stationing): roughly, to point it by. The identification finds its place anew from all visits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from drivers.geocom import to_xyz
from ppshw.errors import BadInput
from ppshw.kinematics import point_positions
from ppshw.machine import Machine
from ppshw.transforms import fit_rigid

Array = NDArray[np.float64]
FEWEST = 3
# Reading, mounting and the machine's own bending leave millimetres; reflectors in another order, decimetres.
MOST_LEFT = 0.02  # m
NARROWEST = 0.02  # m rms that reflectors must lie off any line, or they say nothing of the turn about it
MOST_TILTED = np.deg2rad(2.0)  # of a standing axis that was levelled: else something is wrong
MOST_PERMUTED = 5  # reflectors whose orders are all tried: 120


@dataclass(frozen=True)
class Station:
    """pose (4, 4) of the measuring frame in the base frame; left: distance of every reflector from where the ideal
    machine has it [m]; tilt of the standing axis from upright [rad]; what is odd about it, each in a line."""

    pose: Array
    left: dict[str, float]
    tilt: float
    warnings: list[str]


def station(machine: Machine, q: Array, read: Mapping[str, tuple[float, float, float]]) -> Station:
    """The least-squares place of the tracker (Kabsch 1976), as if the machine were ideal at joint values q (n,).

    read  reflector of the machine file → horizontal circle, vertical circle from the zenith [rad], slope distance [m]
    Raises BadInput for fewer than three, for reflectors on a line, and for readings that do not fit them.
    """
    names = list(read)
    if len(names) < FEWEST:
        raise BadInput(f"readings of {len(names)} reflectors, expected {FEWEST} or more")
    ideal = point_positions(machine, q[None], np.array([machine.targets[name] for name in names]))[0]
    seen = np.array([to_xyz(*read[name]) for name in names])
    for points, whose in ((ideal, "the machine file"), (seen, "the readings")):
        off_the_line = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(points))
        if off_the_line < NARROWEST:
            raise BadInput(
                f"{', '.join(names)}: by {whose} within {1e3 * off_the_line:.0f} mm of one line, which says nothing "
                "of the turn about it: read another reflector"
            )
    pose, left, tilt = _placed(machine, seen, ideal)
    fits, upright = left.max() <= MOST_LEFT, tilt <= MOST_TILTED
    others = [names[k] for k in _another_order(machine, seen, ideal)]
    warnings = []
    if others and not (fits and upright):
        raise BadInput(f"what was read as {', '.join(others)} fits as {', '.join(names)}: are they exchanged?")
    if not fits:
        raise BadInput(
            f"{names[int(np.argmax(left))]}: {1e3 * left.max():.0f} mm from where it should be: is a reading wrong, or "
            "do the joints stand elsewhere?"
        )
    if others:
        warnings.append(
            f"{', '.join(others)} would fit as {', '.join(names)} as well: make sure which reflector is which"
        )
    if not upright:
        warnings.append(
            f"the standing axis comes out {np.rad2deg(tilt):.1f}° from upright: is the tracker levelled, and do the "
            "joints stand there?"
        )
    return Station(pose, dict(zip(names, left.tolist(), strict=True)), tilt, warnings)


def _placed(machine: Machine, seen: Array, ideal: Array) -> tuple[Array, Array, float]:
    """Pose, what is left at every reflector [m], tilt of the standing axis [rad]."""
    pose = fit_rigid(seen, ideal)
    left = np.linalg.norm(seen @ pose[:3, :3].T + pose[:3, 3] - ideal, axis=1)
    return pose, left, float(np.arccos(np.clip(pose[:3, 2] @ machine.up, -1.0, 1.0)))


def _another_order(machine: Machine, seen: Array, ideal: Array) -> tuple[int, ...]:
    """The best other order in which the readings fit a tracker that stands upright; empty where there is none."""
    if len(seen) > MOST_PERMUTED:
        return ()
    found = {}
    for order in list(permutations(range(len(seen))))[1:]:
        _, left, tilt = _placed(machine, seen[list(order)], ideal)
        if left.max() <= MOST_LEFT and tilt <= MOST_TILTED:
            found[order] = float(left.max())
    return min(found, key=lambda order: found[order], default=())
