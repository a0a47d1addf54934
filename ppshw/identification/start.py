"""Where to start: the measuring frame and the targets, when the machine file does not know them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppshw.errors import IdentificationFailed
from ppshw.kinematics import tip_poses
from ppshw.machine import Machine
from ppshw.quantities import many
from ppshw.recording import Recording
from ppshw.transforms import fit_rigid, inverse

Array = NDArray[np.float64]
BLOCK = 4096


def align(machine: Machine, recording: Recording, targets_free: bool) -> tuple[Array, Array]:
    """The measuring frame in the base and the targets on the end effector that fit the ideal machine best.

    Alternates two closed forms: the frame by Kabsch's fit over all visits and targets, the targets as the mean of what
    each visit says of them. Twenty rounds bring a start that is metres and radians away to micrometres.

    returns  (4, 4) measuring frame in the base frame, (T, 3) targets in the end-effector frame [m]
    """
    q = recording.q
    tips = np.concatenate([tip_poses(machine, q[at : at + BLOCK]) for at in range(0, len(q), BLOCK)])
    seen = recording.seen
    if seen.sum() < 3:
        raise IdentificationFailed(
            f"{recording.source}: {many(int(seen.sum()), 'reading')} cannot place the measuring frame, "
            "expected 3 or more"
        )
    visits, which = np.nonzero(seen)
    measured = recording.points[visits, which]
    targets = machine.target_array.copy()
    frame = np.eye(4)
    for _ in range(200 if targets_free else 1):
        ideal = np.einsum("nij,nj->ni", tips[visits, :3, :3], targets[which]) + tips[visits, :3, 3]
        frame = fit_rigid(measured, ideal)
        if not targets_free:
            break
        base_points = measured @ frame[:3, :3].T + frame[:3, 3]
        local = np.einsum("nji,nj->ni", tips[visits, :3, :3], base_points - tips[visits, :3, 3])
        new = np.array(
            [local[which == t].mean(axis=0) if (which == t).any() else targets[t] for t in range(len(targets))]
        )
        if np.abs(new - targets).max() < 1e-7:
            break
        targets = new
    return frame, targets


def to_base(points: Array, measuring_in_base: Array) -> Array:
    """(N, T, 3) in the measuring frame → the base frame."""
    return np.asarray(points @ measuring_in_base[:3, :3].T + measuring_in_base[:3, 3])


def fold(measuring_in_base: Array, base_error: Array) -> Array:
    """Take a small displacement E_0 (4, 4) of the whole machine into the measuring frame instead."""
    return np.asarray(inverse(base_error) @ measuring_in_base)
