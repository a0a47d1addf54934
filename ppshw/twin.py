"""The twin of a recording: what the model says the same visits would have read, noise included.

Same poses, order, loads, times, temperatures and lost beams; only what the instrument read is simulated. The twin is
the calibration's own: it shares every term with it, and none with the simulated hardware of `simulators.plant`. What a
recording shows and replicas of its twin do not, the model does not know (`ppshw.diagnosis.checks`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from ppshw.calibration import Calibration
from ppshw.diagnosis.checks import Check, check
from ppshw.diagnosis.replicas import Compared, Single, Wrong, visits_of
from ppshw.errors import CalibrationError
from ppshw.evaluation import inside, laid_over, predicted
from ppshw.identification.joint import believed_to
from ppshw.identification.noise import half
from ppshw.identification.start import to_base
from ppshw.recording import Recording, Table
from ppshw.terms import Situation
from ppshw.terms.effect import Effect

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
CHUNK = 400  # visits laid out at once
LEAST_WITHIN = 20  # visits within what was identified, for checks of them alone
SILENT = 1e-8  # a parameter whose uncertainty moves no target by as much [m] is taken as sure


@dataclass(frozen=True)
class Twin:
    """points (N, T, 3) and extra_points name → (N, 3) in the measuring frame [m], nan where the beam was lost."""

    points: Array
    extra_points: dict[str, Array]


def simulate(calibration: Calibration, recording: Recording, seed: int = 0) -> Twin:
    """What the instrument would read at the visits of a recording if the calibration were the whole truth.

        p = p̂(q, W) + Σ effects + B u + e,    u ~ N(0, pose), common to a visit;    e ~ N(0, instrument²)

    Reflectors at points of interest share u with the targets of their visit. Noise that depends on settling time or
    load is not part of a calibration, and not of the twin.
    """
    rng = np.random.default_rng(seed)
    names = list(recording.extra_points)
    others = [calibration.machine.points[n] for n in names]
    context = laid_over(calibration, recording, others)
    count, size = len(recording), context.points.shape[1]
    ideal = predicted(calibration, recording, others)
    everything = np.ones((count, size), dtype=bool)
    covariance = calibration.noise.covariance(context.levers(), everything, np.ones(count))
    noise = (np.linalg.cholesky(covariance) @ rng.standard_normal((count, 3 * size, 1)))[..., 0]
    turn = calibration.measuring_in_base
    read = (ideal + noise.reshape(ideal.shape) - turn[:3, 3]) @ turn[:3, :3]
    targets = len(recording.target_names)
    points = np.where(recording.seen[..., None], read[:, :targets], np.nan)
    extra = {
        n: np.where(np.isfinite(recording.extra_points[n]), read[:, targets + k], np.nan) for k, n in enumerate(names)
    }
    return Twin(points, extra)


def twin_table(table: Table, recording: Recording, twin: Twin) -> Table:
    """The recording's own table with the twin's readings (to a nanometre) in place of the measured ones, none in rows
    that stand there twice."""
    header = [name.strip() for name in table.header]
    rows = [list(row) for row in table.rows]
    readings = dict(zip(recording.target_names, np.moveaxis(twin.points, 1, 0), strict=True)) | twin.extra_points
    for name, values in readings.items():
        for axis in range(3):
            if (column := f"{name}_{'xyz'[axis]}") in header:
                at = header.index(column)
                for row, value in zip(rows, values[:, axis], strict=True):
                    row[at] = f"{value:.9f}" if np.isfinite(value) else ""
    return replace(table, rows=tuple(map(tuple, rows)))


def compare(calibration: Calibration, recording: Recording, seed: int = 0) -> list[Check]:
    """The checks of a recording against replicas of its twin, the calibration as it stands: nothing is fitted.

    Of the very recording that it was identified from, it already took what it could; of any other it may be wrong by
    its own uncertainty. Both are in the replicas. Of another one those visits count that `comparable` says.
    """
    return check(compared(calibration, recording), seed)[0]


def comparable(calibration: Calibration, recording: Recording) -> Mask:
    """(N,) which visits the checks are of: with a reading, and of another recording than the calibration's own within
    what was identified, unless those are too few to say anything."""
    measured = recording.measured
    within = measured & inside(recording, calibration)
    return measured if _is_its_own(calibration, recording) or within.sum() < LEAST_WITHIN else within


def _is_its_own(calibration: Calibration, recording: Recording) -> bool:
    return recording.sha256 == calibration.provenance.get("recording_sha256")


def compared(calibration: Calibration, recording: Recording) -> Compared:
    """What a calibration leaves of the visits of a recording, and how its own replicas come about."""
    own, which = _is_its_own(calibration, recording), comparable(calibration, recording)
    context, there = visits_of(laid_over(calibration, recording), which), predicted(calibration, recording)[which]
    recording = recording.subset(which)
    count, seen = len(recording), recording.seen
    rows = np.repeat(seen, 3, axis=1)
    context = replace(context, jacobian=context.jacobian * rows[:, :, None, None])
    root = calibration.noise.whitener(context.levers(), seen)
    gap = to_base(recording.points, calibration.measuring_in_base) - there
    left = (root @ np.where(rows, gap.reshape(count, -1), 0.0)[..., None])[..., 0]
    design, active = _design(calibration, recording, root)
    if own:
        prior, values = _prior(calibration)[active], calibration.theta[active]
        if calibration.effects:
            free = [(c, v) for e in calibration.effects for c, v in zip(e.columns, e.values, strict=True)
                    if c.function != "instead"]  # fmt: skip
            columns = np.stack([c.evaluate(context) for c, _ in free], axis=2)
            design = np.concatenate([design, (root @ columns).reshape(len(design), -1).astype(np.float32)], axis=1)
            prior = np.concatenate([prior, *map(_allowed, calibration.effects)])
            values = np.concatenate([values, [v for _, v in free]])
        if calibration.strengths:  # the paper's method has no minimum to come to
            left = _to_the_end(left, design, values, prior, 3 * seen.sum(axis=1))
        wrong = _fitted(design, prior)
    else:
        wrong = _known(half(calibration.covariance[np.ix_(active, active)]).astype(np.float32))
    return Compared(left, root, rows, np.ones(count), design, wrong, context)


def _to_the_end(left: Array, design: Single, values: Array, prior: Array, freedom: Array) -> Array:
    """What the very minimum would leave (N, 3T): a fit stops where no coordinate moves by more than a fifth of its
    noise, which in directions that it takes nearly whole is more than any replica leaves (`travel` of 22 beside
    3.6)."""
    double = design.astype(float)
    weight = np.minimum(1.0, believed_to(freedom) / np.maximum((left**2).sum(axis=1), 1e-12))
    weighed = double * np.repeat(weight, left.shape[1])[:, None]
    hessian = weighed.T @ double + np.diag(1.0 / prior**2)
    step = cho_solve(cho_factor(hessian, lower=True), weighed.T @ left.ravel() - values / prior**2)
    return np.asarray(left - (double @ step).reshape(left.shape))


def _allowed(effect: Effect) -> Array:
    """(k,) prior standard deviations of an effect's coefficients: one for a Gaussian process, else as wide as what was
    found, since a calibration does not keep what an effect was allowed to be."""
    if effect.columns[0].function == "unexplained":
        return np.ones(sum(c.function == "unexplained" for c in effect.columns))
    return np.maximum(np.hypot(effect.values, effect.std), 1e-15)


def _known(turned: Single) -> Wrong:
    """Coefficients wrong by what the calibration says of itself, whatever the replica's noise. Effects are taken as
    sure: a calibration keeps no covariance of them."""
    return lambda noise, rng: rng.standard_normal((len(noise), turned.shape[1]), dtype=np.float32) @ turned.T


def _fitted(design: Single, prior: Array) -> Wrong:
    """Coefficients that were fitted to the replica itself: (DᵀD + Λ⁻¹)⁻¹ (Dᵀe − Λ^−½ z)."""
    double = design.astype(float)  # single precision would drown what the visits hardly determine
    factor = cho_factor(double.T @ double + np.diag(1.0 / prior**2), lower=True)

    def wrong(noise: Single, rng: np.random.Generator) -> Single:
        moment = np.asarray(noise @ design, dtype=float).T
        moment -= rng.standard_normal(moment.shape) / prior[:, None]
        return np.asarray(cho_solve(factor, moment).T, dtype=np.float32)

    return wrong


def _prior(calibration: Calibration) -> Array:
    """(p,) prior standard deviations as learnt; where none was (the paper's method), far beyond the posterior's."""
    std = np.sqrt(np.diag(calibration.covariance))
    if not calibration.strengths:
        return np.maximum(1e3 * std, 1e-15)
    parameters = calibration.model.parameters()
    unknown = sorted({p.group for p in parameters} - calibration.strengths.keys())
    if unknown:
        raise CalibrationError(
            f"the calibration has no prior strength for {len(unknown)} groups of its parameters, the first "
            f"'{unknown[0]}': an earlier ppshw wrote it; identify its recording again"
        )
    return np.maximum([calibration.strengths[p.group] * p.scale for p in parameters], 1e-15)


def _design(calibration: Calibration, recording: Recording, root: Array) -> tuple[Single, Mask]:
    """Whitened columns (N·3T, k) of the parameters that the calibration is unsure of, and which those are (p,)."""
    model, theta = calibration.model, calibration.theta
    std = np.sqrt(np.diag(calibration.covariance))
    parts, sizes = [], np.zeros(len(std))
    for at in range(0, len(recording), CHUNK):
        rows = np.arange(at, min(at + CHUNK, len(recording)))
        lin = model.linearise(Situation.of(recording.subset(rows)), theta)
        design = lin.design.reshape(len(rows), -1, len(std))
        sizes = np.maximum(sizes, np.abs(design).max(axis=(0, 1)) * std)
        parts.append((root[rows] @ design).astype(np.float32))
    active = sizes > SILENT
    white = np.concatenate(parts)[:, :, active]
    return white.reshape(-1, white.shape[2]), active
