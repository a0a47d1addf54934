"""The figures that the report states, computed from the recordings, and held against what the run itself printed."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.calibration import Calibration
from ppshw.errors import RecordingError
from ppshw.evaluation import by_visit, figures, residuals
from ppshw.identification.joint import SET_ASIDE, believed_to
from ppshw.kinematics import frames, joint_jacobian, point_positions
from ppshw.quantities import distance, many
from ppshw.recording import Recording
from ppshw.report.concealed import of_the_instrument
from ppshw.report.contents import RECORDINGS, Contents, Missing
from ppshw.terms import Situation
from ppshw.verification import Returns, point_errors, repeatability, returns_of, wanted_joints

Array = NDArray[np.float64]
CASES = {
    "verification_nominal": "uncompensated",
    "verification_base": "base",
    "verification_compensated": "compensated",
    "verification_extended": "extended",
}
FIGURES = ("median_mm", "p95_mm", "p98_6_mm", "max_mm")
# A run prints what it computed from the same recordings: a difference beyond rounding is worth a sentence.
ROUNDING_MM = 6e-4
LEAST_WAY = 0.02  # m per m or rad: a beam's 0.5 mm would take 25 mm or 25 mrad, about what a correction may be
WORTH_SAYING = 0.2  # share of what is left
CHUNK = 400  # visits linearised at once: some 30 MB of design


@dataclass(frozen=True)
class Numbers:
    """errors        case of CASES → (N, 3) at the point, base frame [m]
    accuracy      case → FIGURES with `visits`, from the recordings or else as the run printed them
    unseen        the compensated poses are known to be none of the identification's
    returns, repeatability  of repeatability.db; None without it
    notes         sentences about what does not fit together
    missing       of what is in the folder but cannot be used for its purpose
    """

    errors: dict[str, Array]
    accuracy: dict[str, dict[str, float]]
    unseen: bool
    returns: Returns | None
    repeatability: dict[str, Any] | None
    notes: tuple[str, ...]
    missing: tuple[Missing, ...]

    @property
    def best(self) -> str:
        """As `_best_of`; the plain one where nothing was compensated."""
        return _best_of(self.accuracy) or "compensated"

    @property
    def extended(self) -> bool:
        """Whether setpoints with what a diagnosis found were tried."""
        return "extended" in self.accuracy


def compute(contents: Contents) -> Numbers:
    """Every figure of the page, from the recordings; where there is none, as the run printed it.

    A verification or repeatability that cannot be used for its purpose goes into `missing`, what does not fit together
    into `notes`. Raises RecordingError where wanted joint values of the identification recording are incomplete.
    """
    machine, point, calibration = contents.machine, contents.point, contents.calibration
    frame, where = (None, None) if calibration is None else (calibration.measuring_in_base, calibration.point(point))
    errors: dict[str, Array] = {}
    accuracy: dict[str, dict[str, float]] = {}
    notes: list[str] = []
    missing: list[Missing] = []
    for stem, case in CASES.items():
        if recording := contents.recordings.get(stem):
            try:
                errors[case] = point_errors(recording, machine, point, frame, where)
                figures(errors[case])
            except RecordingError as why:
                errors.pop(case, None)
                missing.append(Missing(f"{stem}: {point}", str(why), RECORDINGS[stem]))
    poses = {case: _poses(contents.recordings[stem]) for stem, case in CASES.items() if case in errors}
    where_left = _where_no_joint_moves(contents, errors, poses, where)
    errors, compared = _of_the_same_poses(errors, poses)
    notes += [*where_left, *_broken_off(contents), *compared]
    for case in CASES.values():
        if case in errors:
            seen = int(np.isfinite(errors[case]).all(axis=1).sum())
            accuracy[case] = {**figures(errors[case]), "visits": seen}
        accuracy[case] = _against_result(contents, case, accuracy.get(case, {}), notes)
    returns, again = None, None
    if recording := contents.recordings.get("repeatability"):
        try:
            returns = returns_of(recording, machine, point, frame)
            again = repeatability(recording, machine, point, frame)
        except RecordingError as why:
            missing.append(Missing(f"repeatability: {point}", str(why), RECORDINGS["repeatability"]))
    again = _repeatability_against_result(contents, again, notes)
    notes += _doubts(contents)
    if contents.concealed is not None and (erring := of_the_instrument(contents.concealed)):
        notes.append(erring)
    campaign = contents.recordings.get("campaign")
    best = _best_of(poses)
    unseen = campaign is not None and best is not None and not set(poses[best]) & set(_poses(campaign))
    accuracy = {case: row for case, row in accuracy.items() if row}
    return Numbers(errors, accuracy, unseen, returns, again, tuple(notes), tuple(missing))


def _best_of(cases: Collection[str]) -> str | None:
    """The case that stands for compensation: with what a diagnosis found, where that was tried."""
    return next((case for case in ("extended", "compensated") if case in cases), None)


def _poses(recording: Recording) -> list[tuple[float, ...]]:
    """The wanted pose of every visit, to 1 µm and 1 µrad."""
    return [tuple(pose) for pose in np.round(wanted_joints(recording), 6).tolist()]


def _broken_off(contents: Contents) -> list[str]:
    """Which recordings hold fewer visits than their campaign."""
    said = [(source, source.meta.get("visits_planned", "")) for source in contents.sources]
    planned = [(source, int(number)) for source, number in said if number.isdecimal()]
    return [f"{s.name}: {s.visits} of {many(of, 'planned visit')} were measured." for s, of in planned if s.visits < of]


def _where_no_joint_moves(
    contents: Contents, errors: dict[str, Array], poses: dict[str, list[tuple[float, ...]]], where: Array | None
) -> list[str]:
    """How much of what compensation left no joint can take off: along directions that move the point by less than
    LEAST_WAY per metre or radian of any joint."""
    case = _best_of(errors)
    if case is None or where is None:
        return []
    machine, left = contents.machine, errors[case]
    q = np.array(poses[case])
    moves = joint_jacobian(machine, frames(machine, q), point_positions(machine, q, where[None]))[:, 0]  # (N, 3, n)
    ways, lengths, _ = np.linalg.svd(moves)
    open_ways = np.zeros((len(q), 3), dtype=bool)
    open_ways[:, : lengths.shape[1]] = lengths > LEAST_WAY
    closed = np.einsum("nij,ni->nj", ways, left) * ~open_ways
    if not (seen := np.isfinite(closed).all(axis=1)).any() or not (~open_ways[seen]).any():
        return []
    of_it, whole = (figures(each[seen])["p98_6_mm"] for each in (closed, left))
    if of_it < WORTH_SAYING * whole:
        return []
    return [
        f"Along directions in which no joint moves the point ‘{contents.point}’ the {case} verification leaves up to "
        f"{distance(1e-3 * of_it)} (98.6 %), of {distance(1e-3 * whole)} in all: no correction of these joints, and no "
        "diagnosis, takes that off."
    ]


def _of_the_same_poses(
    errors: dict[str, Array], poses: dict[str, list[tuple[float, ...]]]
) -> tuple[dict[str, Array], list[str]]:
    """The errors (N, 3) of each case at those poses where every case has one, and what is to be said of the comparison:
    what was broken off, or lost its beams, is better or worse by the poses that it lacks."""
    sets = {
        case: {pose for pose, error in zip(poses[case], each, strict=True) if np.isfinite(error).all()}
        for case, each in errors.items()
    }
    every: set[tuple[float, ...]] = set().union(*sets.values())
    common = every.intersection(*sets.values())
    if common == every:
        return errors, []
    if not common:
        return errors, ["The verification recordings were not made at the same wanted poses: compare them roughly."]
    kept = {case: each[[pose in common for pose in poses[case]]] for case, each in errors.items()}
    all_of = many(len(every), "wanted pose")
    return kept, [f"Compared are the {len(common)} of {all_of} at which every verification recording has a reading."]


def _against_result(contents: Contents, case: str, mine: dict[str, float], notes: list[str]) -> dict[str, float]:
    printed = contents.result.get(case)
    if not isinstance(printed, dict):
        return mine
    given = {k: float(printed[k]) for k in FIGURES if isinstance(printed.get(k), int | float)}
    if not mine:
        return given
    for key, value in given.items():
        if abs(value - mine[key]) > ROUNDING_MM:
            notes.append(
                f"{contents.result_name} says {case} {key} = {value:.4g}; the recording here gives {mine[key]:.4g}, "
                "which is what this page shows."
            )
    return mine


def _repeatability_against_result(
    contents: Contents, mine: dict[str, Any] | None, notes: list[str]
) -> dict[str, Any] | None:
    printed = contents.result.get("repeatability_mm")
    if not isinstance(printed, int | float):
        return mine
    if mine is None:
        return {"p98_6_mm": float(printed)}
    if abs(printed - mine["p98_6_mm"]) > ROUNDING_MM:
        notes.append(
            f"{contents.result_name} says repeatability_mm = {printed:.4g}; the recording here gives "
            f"{mine['p98_6_mm']:.4g}, which is what this page shows."
        )
    return mine


def _doubts(contents: Contents) -> list[str]:
    out = []
    calibration, campaign = contents.calibration, contents.recordings.get("campaign")
    if calibration is not None and campaign is not None:
        made_from = str(calibration.provenance.get("recording_sha256", ""))
        if made_from != campaign.sha256:
            out.append(
                f"The calibration was made from another recording ({made_from[:12] or 'unknown'}) than the "
                f"identification recording in this folder ({campaign.sha256[:12]}): the residual shown is that of "
                "visits the fit may never have seen."
            )
    diagnosed = (contents.diagnosis or {}).get("provenance")
    if isinstance(diagnosed, dict):
        if diagnosed.get("machine_sha256") != contents.machine.sha256:
            out.append("The diagnosis is of another machine file than the one in this folder.")
        elif (there := {r.sha256 for r in contents.recordings.values()}) and (
            diagnosed.get("recording_sha256") not in there
        ):
            out.append("The diagnosis is of another recording than those in this folder.")
    if contents.machine.tracker.base is None and any(stem in contents.recordings for stem in CASES):
        out.append(
            "The machine file leaves the measuring frame open; it was placed by the calibration. An error that the "
            "whole machine shares is part of that place, so the uncompensated figures flatter."
        )
    for source in contents.sources:
        made_for = source.meta.get("machine_sha256")
        if made_for and made_for != contents.machine.sha256:
            out.append(
                f"{source.name} was recorded with another machine file ({made_for[:12]}) than the one in this folder "
                f"({contents.machine.sha256[:12]})."
            )
    return out


@dataclass(frozen=True)
class Fit:
    """What the model leaves of the identification recording.

    errors   (N, T, 3) [m];  size_mm (N,) rms over a visit's targets;  outlier (N,)
    lost     (N,) visits with a target that was not found although the recording has its columns
    """

    errors: Array
    size_mm: Array
    outlier: NDArray[np.bool_]
    lost: NDArray[np.bool_]


def fit(recording: Recording, calibration: Calibration) -> Fit:
    """The residuals of the N visits of the identification recording, and which of them the estimate sets aside.

    recording  of the calibration's machine; visits that it was not made from are judged the same
    """
    errors = residuals(recording, calibration)
    seen = recording.seen
    measured = seen.any(axis=0)
    lost = np.asarray(~seen[:, measured].all(axis=1))
    return Fit(errors, by_visit(errors) * 1e3, _outliers(recording, calibration, errors), lost)


def _outliers(recording: Recording, calibration: Calibration, errors: Array) -> NDArray[np.bool_]:
    """½ r' (Σ + D C D')⁻¹ r > χ²: where the estimate sets aside, with noise Σ and the model's uncertainty D C D'."""
    out = np.zeros(len(recording), dtype=bool)
    for start in range(0, len(recording), CHUNK):
        rows = np.arange(start, min(start + CHUNK, len(recording)))
        part, seen = recording.subset(rows), recording.seen[rows]
        lin = calibration.model.linearise(Situation.of(part), calibration.theta)
        count, width = len(rows), 3 * seen.shape[1]
        mask = np.repeat(seen, 3, axis=1)
        design = lin.design.reshape(count, width, -1) * mask[..., None]
        covariance = calibration.noise.covariance(lin.levers, seen, np.ones(count))
        half = design.reshape(count * width, -1) @ calibration.covariance  # one product: batches of small ones are slow
        covariance += half.reshape(count, width, -1) @ np.swapaxes(design, 1, 2)
        residual = np.where(mask, errors[rows].reshape(count, width), 0.0)
        distance = np.einsum("ni,ni->n", residual, np.linalg.solve(covariance, residual[..., None])[..., 0])
        freedom = np.maximum(mask.sum(axis=1), 1)
        out[rows] = SET_ASIDE * distance >= believed_to(freedom)
    return out
