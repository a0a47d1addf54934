"""How far a point of the end effector is from where it was wanted, and how well the machine comes back to it.

A verification recording measures a reflector at the point itself and says, in its columns cov_wanted_<joint>, which
joint values were wanted; q_cmd is what was commanded for that, corrected or not. A recording without those columns was
run as planned: there, what was commanded is what was wanted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.errors import RecordingError
from ppshw.identification.start import to_base
from ppshw.kinematics import point_positions
from ppshw.machine import Machine
from ppshw.recording import Recording

Array = NDArray[np.float64]
# The quantile that the paper states every accuracy by, and we the repeatability.
QUANTILE = 0.986
# Wanted joint values that agree to this many decimals [m, rad] are one pose; a recording holds nine.
POSE_DECIMALS = 7


@dataclass(frozen=True)
class Returns:
    """Visits of poses that were visited more than once under one load.

    deviation  (K, 3) of each visit from the mean of its group, times √(n/(n−1))   [m]
    group      (K,)   which group a visit belongs to, 0 … G−1
    radius     (K,)   plain distance from the group's mean                          [m]
    """

    deviation: Array
    group: NDArray[np.int64]
    radius: Array

    @property
    def groups(self) -> int:
        return int(self.group.max()) + 1 if len(self.group) else 0


def wanted_joints(recording: Recording) -> Array:
    """(N, n) the joint values that the ideal machine should have stood at [m, rad]."""
    names = [f"wanted_{j}" for j in recording.joint_names]
    given = [n for n in names if n in recording.covariates]
    if not given:
        return recording.q_cmd
    if len(given) < len(names):
        lacking = ", ".join(f"cov_{n}" for n in names if n not in given)
        raise RecordingError(f"{recording.source}: column {lacking} is missing while others of cov_wanted_ are given")
    wanted = np.column_stack([recording.covariates[n] for n in names])
    for row, k in np.argwhere(~np.isfinite(wanted))[:1]:
        raise RecordingError(f"{recording.source}: visit {row + 1}: column cov_{names[k]} is empty")
    return wanted


def measured_point(recording: Recording, machine: Machine, point: str) -> Array:
    """(N, 3) a reflector at a target or another point of the machine file, measuring frame, nan where lost [m]."""
    if point in recording.extra_points:
        return recording.extra_points[point]
    machine.point(point)  # complains of a name that the machine file does not have
    if point not in recording.target_names:
        raise RecordingError(f"{recording.source}: no column {point}_x: no reflector was measured at '{point}'")
    return np.asarray(recording.points[:, recording.target_names.index(point)])


def point_errors(
    recording: Recording, machine: Machine, point: str, measuring_in_base: Array | None = None,
    where: Array | None = None,
) -> Array:  # fmt: skip
    """Measured minus wanted at a point of the end effector.

    measuring_in_base  (4, 4) where the instrument stands; needed when the machine file says `base: estimate`, then
                       that of the calibration. An error of the whole machine hides in it: figures that flatter.
    where              (3,) where the point sits on the end effector; needed for a target when the machine file says
                       `targets: estimate`, then `Calibration.point`                                            [m]
    returns            (N, 3) base frame, nan where the reflector was lost   [m]
    """
    if where is None and not machine.tracker.targets_known and point in machine.targets:
        raise RecordingError(
            f"{recording.source}: the machine file leaves open where the target '{point}' sits (tracker.targets: "
            "estimate) and there is no calibration that knows"
        )
    frame = machine.tracker.base if machine.tracker.base is not None else measuring_in_base
    if frame is None:
        raise RecordingError(
            f"{recording.source}: the machine file leaves the measuring frame open (tracker.base: estimate) "
            "and there is no calibration that places it"
        )
    measured = to_base(measured_point(recording, machine, point), frame)
    place = machine.point(point) if where is None else where
    ideal = point_positions(machine, wanted_joints(recording), place[None])[:, 0]
    return np.asarray(measured - ideal)


def returns_of(recording: Recording, machine: Machine, point: str, measuring_in_base: Array | None = None) -> Returns:
    """Group visits by wanted pose and load; lost readings and poses visited once do not count.

    Deviations are measured − wanted, less the group's mean, so that a compensated recording, whose setpoints follow
    the measured load, counts as returning to one pose. Raises RecordingError when no pose was visited twice.

    measuring_in_base  (4, 4) as in `point_errors`
    """
    # where a point sits moves all visits of a pose alike
    errors = point_errors(recording, machine, point, measuring_in_base, machine.point(point))
    wanted = np.round(wanted_joints(recording), POSE_DECIMALS)
    keys = [(load, *pose) for load, pose in zip(recording.load, wanted.tolist(), strict=True)]
    members: dict[tuple[Any, ...], list[int]] = {}
    for k in np.flatnonzero(np.isfinite(errors).all(axis=1)).tolist():
        members.setdefault(keys[k], []).append(k)
    repeated = [rows for rows in members.values() if len(rows) > 1]
    if not repeated:
        raise RecordingError(f"{recording.source}: no pose was visited twice under the same load")
    deviation, group, radius = [], [], []
    for g, rows in enumerate(repeated):
        off = errors[rows] - errors[rows].mean(axis=0)
        deviation.append(off * np.sqrt(len(rows) / (len(rows) - 1)))
        radius.append(np.linalg.norm(off, axis=1))
        group.append(np.full(len(rows), g))
    return Returns(np.concatenate(deviation), np.concatenate(group), np.concatenate(radius))


def repeatability(
    recording: Recording, machine: Machine, point: str, measuring_in_base: Array | None = None
) -> dict[str, Any]:
    """How well the machine comes back to a pose.

    p98_6_mm          98.6 % quantile of the radial deviation of a visit from the mean of its pose and load, deviations
                      widened by √(n/(n−1)) for the mean's own share; what a run prints as repeatability_mm. Our
                      definition: the paper states 0.14 mm without saying how; its accuracies are 98.6 % figures. The
                      tracker's noise is in it.
    sigma_mm          per axis of the base frame: √(Σ deviation² / visits), unbiased by the same factor
    rp_iso9283_mm     ISO 9283's RP = l̄ + 3 S_l with l the plain distance from the barycentre, S_l over n − 1; mean
                      over the poses (the standard wants 30 cycles at 5 poses; n is here what the recording has)
    poses, visits     how many poses were visited more than once, and how many visits those are
    """
    back = returns_of(recording, machine, point, measuring_in_base)
    radial = np.linalg.norm(back.deviation, axis=1)
    rp = []
    for g in range(back.groups):
        lengths = back.radius[back.group == g]
        rp.append(lengths.mean() + 3 * lengths.std(ddof=1))
    return {
        "p98_6_mm": float(np.quantile(radial, QUANTILE)) * 1e3,
        "sigma_mm": (np.sqrt((back.deviation**2).mean(axis=0)) * 1e3).tolist(),
        "rp_iso9283_mm": float(np.mean(rp)) * 1e3,
        "poses": back.groups,
        "visits": len(radial),
    }
