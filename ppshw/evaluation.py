"""What a model misses on a recording it has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.calibration import Calibration, Identified
from ppshw.errors import RecordingError
from ppshw.identification.plausible import far_off
from ppshw.identification.start import align, to_base
from ppshw.kinematics import point_jacobian, point_positions
from ppshw.machine import Machine
from ppshw.quantities import called, many
from ppshw.recording import Recording
from ppshw.terms import Situation
from ppshw.terms.effect import UNNAMED, is_beyond
from ppshw.terms.shapes import Column, Context
from ppshw.terms.unexplained import unexplained_at
from ppshw.transforms import fit_rigid
from ppshw.verification import QUANTILE

Array = NDArray[np.float64]
COURSES = ("clock", "clock_q")  # functions that run on with time
FADING = ("cosine", "beat_cos", "beat_sin")  # forms of them that are forgotten, or unknown, beyond the recording
SLACK = 0.02  # of what a column ran through where effects were measured: so far beyond it nothing is said


def residuals(recording: Recording, calibration: Calibration, refit_base: bool = False) -> Array:
    """Measured minus predicted targets: (N, T, 3) [m], base frame, nan where a target was lost.

    refit_base  the tracker was moved since: fit the measuring frame to this recording instead of the calibration's. It
                takes six numbers from the residuals, and an error of the whole machine hides in it.
    """
    there = predicted(calibration, recording)
    return np.asarray(to_base(recording.points, _frame(recording, calibration, there, refit_base)) - there)


def _frame(recording: Recording, calibration: Calibration, there: Array, refit_base: bool) -> Array:
    return _fitted_frame(recording, there) if refit_base else calibration.measuring_in_base


def predicted(calibration: Calibration, recording: Recording, others: Sequence[Array] = ()) -> Array:
    """(N, K, 3) where the targets and then other points are, by the calibration with its effects [m], base axes. A
    reflector that moved moves itself alone."""
    points = np.array([*calibration.model.targets(calibration.theta), *others])
    out = calibration.model.predict(Situation.of(recording), calibration.theta, points)
    if calibration.effects:
        whole, rows = calibration.continued(recording)
        context = laid_over(calibration, whole, others)
        moved = np.zeros((len(whole), out[0].size))
        for effect in calibration.effects:
            for column, value in zip(effect.columns, effect.values, strict=True):
                moved += value * column.evaluate(context)
        out += moved[rows].reshape(out.shape)
    return out


def laid_over(calibration: Calibration, recording: Recording, others: Sequence[Array] = ()) -> Context:
    """What shapes look at, for the targets and then for other points of the end effector (T + E in all): about the
    parameters that they were made with, which are not those beside which they are fitted."""
    model, theta = calibration.model, calibration.laid_at
    c = Context.of(model, theta, recording, calibration.measuring_in_base, dict(calibration.reference))
    if not len(others):
        return c
    more = np.einsum("nij,pj->npi", c.tips[:, :3, :3], np.array(others)) + c.tips[:, None, :3, 3]
    points = np.concatenate([c.points, more], axis=1)
    errors, _ = model.errors(Situation.of(recording), theta)
    jacobian = point_jacobian(c.chain, points, errors).reshape(len(recording), -1, model.machine.n + 1, 6)
    return replace(c, points=points, jacobian=jacobian)


def _fitted_frame(recording: Recording, predicted: Array) -> Array:
    seen = recording.seen
    if seen.sum() < 3:
        raise RecordingError(
            f"{recording.source}: {many(int(seen.sum()), 'reading')} cannot place the measuring frame, "
            "expected 3 or more"
        )
    return fit_rigid(recording.points[seen], predicted[seen])


def by_visit(errors: Array) -> Array:
    """(N,) rms of every visit's residuals (N, T, 3), nan where no target was found."""
    square = (errors**2).sum(axis=2)
    seen = np.isfinite(square)
    mean = np.where(seen, square, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    return np.where(seen.any(axis=1), np.sqrt(mean), np.nan)


def nominal_residuals(recording: Recording, machine: Machine, refit_base: bool = False) -> Array:
    """The same, (N, T, 3) [m], for the ideal machine. Where the measuring frame is unknown it is fitted to this very
    recording, and so are the targets if they are: figures that flatter."""
    frame, targets = _nominal_frame(recording, machine, refit_base)
    return np.asarray(to_base(recording.points, frame) - point_positions(machine, recording.q, targets))


def _nominal_frame(recording: Recording, machine: Machine, refit_base: bool) -> tuple[Array, Array]:
    frame = machine.tracker.base
    if frame is None or refit_base:
        return align(machine, recording, targets_free=not machine.tracker.targets_known)
    return frame, machine.target_array


def of_points(
    recording: Recording, machine: Machine, calibration: Calibration | None, refit_base: bool = False
) -> dict[str, dict[str, Any]]:
    """The same figures of every reflector at another point of the machine file that was measured, in the frames of the
    targets: what an accuracy is wanted for is often there."""
    names = [name for name, read in recording.extra_points.items() if np.isfinite(read).any()]
    if not names:
        return {}
    places = np.array([machine.points[name] for name in names])
    read = np.stack([recording.extra_points[name] for name in names], axis=1)
    frame = _nominal_frame(recording, machine, refit_base)[0]
    left = nominal = to_base(read, frame) - point_positions(machine, recording.q, places)
    if calibration is not None:
        there, count = predicted(calibration, recording, list(places)), len(recording.target_names)
        frame = _frame(recording, calibration, there[:, :count], refit_base)
        left = to_base(read, frame) - there[:, count:]
    return {
        name: {
            "readings": int(np.isfinite(read[:, k]).all(axis=1).sum()), **figures(left[:, k]),
            "nominal": figures(nominal[:, k]),
        }
        for k, name in enumerate(names)
    }  # fmt: skip


def figures(errors: Array) -> dict[str, float]:
    """Size of the Euclidean residual of every reading that there is.

    errors   (..., 3) [m], nan where a target was lost
    returns  rms, median, 95 %, 98.6 % (the paper's) and greatest   [mm]
    """
    size = np.linalg.norm(errors, axis=-1).ravel() * 1e3
    size = size[np.isfinite(size)]
    if not len(size):
        raise RecordingError("the recording holds no measured target")
    return {
        "rms_mm": float(np.sqrt((size**2).mean())),
        "median_mm": float(np.median(size)),
        "p95_mm": float(np.quantile(size, 0.95)),
        "p98_6_mm": float(np.quantile(size, QUANTILE)),
        "max_mm": float(size.max()),
    }


def evaluate(
    recording: Recording, machine: Machine, calibration: Calibration | None, refit_base: bool = False
) -> dict[str, Any]:
    """The contract's answer of `ppshw evaluate` (§3) of the visits with a reading, with readings and median beside it,
    the numbers of visits that no error of a machine explains, whether the calibration was identified from this very
    recording, and how many visits lie outside what it was identified from. Reflectors at other points of the machine
    file have figures of their own (`of_points`).

    Where it carries effects also how many visits are among its own, how many of its own this recording goes on from,
    how many are at temperatures that its effects were never measured at, and how many so long before or after that
    what runs on with time is not carried on to them, or what runs on where no time is known (`untimed`); where
    structure without a name, how many visits lie where nothing is known of it."""
    left = nominal_residuals(recording, machine, refit_base)
    nominal = figures(left)
    left = left if calibration is None else residuals(recording, calibration, refit_base)
    answer = {
        "visits": int(recording.measured.sum()), "readings": int(recording.seen.sum()),
        **figures(left), "nominal": nominal,
        "far_off": (np.flatnonzero(far_off(left).any(axis=1)) + 1).tolist(),
    }  # fmt: skip
    if points := of_points(recording, machine, calibration, refit_base):
        answer["points"] = points
    if calibration is not None:
        answer["identified_from_it"] = recording.sha256 == calibration.provenance.get("recording_sha256")
        answer["outside"] = outside(recording, calibration)
    if calibration is None or not calibration.effects:
        return answer
    whole, rows = calibration.continued(recording)
    answer["earlier_visits"] = len(whole) - len(recording)
    if not answer["identified_from_it"]:
        answer["fitted_visits"] = calibration.fitted(recording)
    answer["beyond"] = _beyond(recording, calibration)
    context = Context.of(calibration.model, calibration.laid_at, whole, calibration.measuring_in_base,
                         dict(calibration.reference))  # fmt: skip
    running = sorted({called(e.name, e.joint) for e in calibration.effects for c in e.columns if _runs_on(c)})
    if running and (held := int((context.clock != context.hours)[rows].sum())):
        answer["held_in_time"] = {"effects": running, "visits": held}
    timed = sorted({called(e.name, e.joint) for e in calibration.effects for c in e.columns if _goes_by_time(c)})
    if timed and not answer["identified_from_it"] and not np.isfinite(recording.time).all():
        answer["untimed"] = timed
    if any(e.name == UNNAMED for e in calibration.effects):
        answer["unexplained"] = [u.subset(rows).as_dict() for u in unexplained_at(calibration.effects, context)]
    return answer


def _runs_on(column: Column) -> bool:
    """Whether it goes on with time as it went, and does not fade as waves do."""
    return column.function == "clock" and column.args["form"] not in FADING


def _goes_by_time(column: Column) -> bool:
    """Whether it runs on with time, or changes at some moment of the recording that it was made from."""
    at_moments = any(column.args.get(name) is not None for name in ("visit_time", "times", "time"))
    return column.function in COURSES or at_moments or column.args.get("since", -1.0) >= 0.0


def inside(recording: Recording, calibration: Calibration) -> NDArray[np.bool_]:
    """(N,) which visits lie within what was identified, joints and loads."""
    out = [each.is_outside(values) for each, values in _identified(recording, calibration)]
    return np.asarray(~np.any(out, axis=0))


def outside(recording: Recording, calibration: Calibration) -> list[dict[str, Any]]:
    """Per joint and load component that goes beyond what was identified: that range, how many visits with a reading lie
    outside it, and the value farthest out. Those with most visits first."""
    seen = recording.measured
    out = []
    for each, values in _identified(recording, calibration):
        there = values[each.is_outside(values) & seen]
        if len(there):
            farthest = there[np.argmax(np.maximum(each.low - there, there - each.high))]
            out.append({"of": each.name, "unit": each.unit, "low": each.low, "high": each.high,
                        "visits": len(there), "farthest": float(farthest)})  # fmt: skip
    return sorted(out, key=lambda found: -found["visits"])


def _identified(recording: Recording, calibration: Calibration) -> list[tuple[Identified, Array]]:
    """What was identified of every joint and, where the recording tells it, component of the load, each with the values
    (N,) there."""
    found = list(zip(calibration.identified_joints(), recording.q.T, strict=True))
    if recording.has_wrench:
        found += zip(calibration.identified_loads(), recording.wrench.T, strict=True)
    return found


def _beyond(recording: Recording, calibration: Calibration) -> list[dict[str, Any]]:
    """Per place whose temperature moves an effect, and per column of its own (cov_) that does: its range while that was
    measured, and the visits beyond it."""
    moving = {place for effect in calibration.effects for place in effect.places}
    out: list[dict[str, Any]] = []
    for place, (low, high) in calibration.temperature_range.items():
        here = recording.temperatures.get(place, np.zeros(0))
        visits = int(is_beyond(here, low, high).sum())
        if place in moving and visits:
            out.append({"temperature": place, "low_C": low, "high_C": high, "visits": visits})
    known = {} if calibration.visits is None else calibration.visits.covariates
    for column in dict.fromkeys(name for effect in calibration.effects for name in effect.over):
        name = column.removeprefix("cov_")
        here, there = recording.covariates.get(name, np.zeros(0)), known.get(name, np.zeros(0))
        if not np.isfinite(there).any():
            continue
        low, high = float(np.nanmin(there)), float(np.nanmax(there))
        slack = SLACK * (high - low)
        visits = int(((here < low - slack) | (here > high + slack)).sum())
        if visits:
            out.append({"column": column, "low": low, "high": high, "visits": visits})
    return out
