"""ΔX of every visit, from three or more targets   (paper eq. 8)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppshw.errors import IdentificationFailed
from ppshw.identification.start import align, to_base
from ppshw.kinematics import tip_poses
from ppshw.machine import Machine
from ppshw.recording import Recording
from ppshw.transforms import fit_rigid, inverse, rotation_vector, skew, spans_a_frame

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PoseErrors:
    """Of the V visits with a full pose:

    machine     with the targets as they are on the end effector
    frame       (4, 4) measuring frame in the base
    used        (N,) which visits of the recording these are
    tips        (V, 4, 4) ideal end-effector frames A_T^i in the base
    errors      (V, 6) ΔX in the end-effector frame                          [m, rad]
    spread      (6, 6) what a unit variance of the instrument makes of ΔX, mean over the visits
    instrument  standard deviation per coordinate, from what the rigid fit leaves    [m]
    """

    machine: Machine
    frame: Array
    used: NDArray[np.bool_]
    tips: Array
    errors: Array
    spread: Array
    instrument: float


def pose_errors(machine: Machine, recording: Recording) -> PoseErrors:
    """E_T = (A_T^i)⁻¹ A_T^r, A_T^r by a rigid fit of the targets. Raises IdentificationFailed without a full pose, and
    where targets are to be found beside a tracker whose place is known: a rigid fit cannot tell their mean place from
    what the machine does at every pose alike."""
    frame = machine.tracker.base
    if frame is not None and not machine.tracker.targets_known:
        raise IdentificationFailed(
            f"{machine.file}: 'targets: estimate' beside a tracker whose place is known takes `--method joint`"
        )
    if frame is None:
        frame, targets = align(machine, recording, targets_free=not machine.tracker.targets_known)
        machine = machine.with_targets(dict(zip(machine.targets, targets, strict=True)))
    seen = recording.seen
    full = np.array([spans_a_frame(machine.target_array[row]) for row in seen])
    if not full.any():
        raise IdentificationFailed(
            f"{recording.source}: no visit shows three targets that are not on a line, so there is no pose; "
            "`--method joint` works with a single target"
        )
    visits, seen = recording.subset(full), seen[full]
    measured = to_base(visits.points, frame)
    tips = tip_poses(machine, visits.q)
    errors = np.empty((len(visits), 6))
    spread = np.zeros((6, 6))
    square, freedom = 0.0, 0
    for pattern in np.unique(seen, axis=0):
        rows = np.flatnonzero((seen == pattern).all(axis=1))
        targets = machine.target_array[pattern]
        real = fit_rigid(np.broadcast_to(targets, (len(rows), *targets.shape)), measured[rows][:, pattern])
        step = inverse(tips[rows]) @ real
        errors[rows, :3], errors[rows, 3:] = step[:, :3, 3], rotation_vector(step[:, :3, :3])
        left = measured[rows][:, pattern] - (np.einsum("nij,tj->nti", real[:, :3, :3], targets) + real[:, None, :3, 3])
        square, freedom = square + float((left**2).sum()), freedom + len(rows) * (targets.size - 6)
        levers = np.concatenate([np.broadcast_to(np.eye(3), (len(targets), 3, 3)), -skew(targets)], axis=2)
        levers = levers.reshape(-1, 6)
        spread += len(rows) / len(visits) * np.linalg.inv(levers.T @ levers)
    return PoseErrors(machine, frame, full, tips, errors, spread, math.sqrt(square / freedom))
