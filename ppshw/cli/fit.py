"""A model's fit to a recording: identify, evaluate."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ppshw.cli.answers import (
    EVALUATED_PER_S,
    FIGURE_HEAD,
    STEPWISE_PER_S,
    as_they_stand,
    columns_named,
    doubts_about,
    figure_row,
    new_file,
    outside_in_words,
    say,
    warn,
)
from ppshw.cli.arguments import machine_of
from ppshw.progress import Bar, folded
from ppshw.quantities import many

if TYPE_CHECKING:
    from ppshw.calibration import Calibration
    from ppshw.identification.joint import Estimate, Progress
    from ppshw.machine import Machine
    from ppshw.recording import Recording

FEW = 40  # visits
MANY_ASIDE = 0.1  # share of the visits: single ones are not so many
NO_BETTER = 1.05  # times what the ideal machine leaves; a fit that leaves more has failed


def identify(a: argparse.Namespace) -> None:
    import time

    from ppshw.identification.ambiguity import ambiguities, summary
    from ppshw.identification.noise import pose_rank
    from ppshw.recording import load_recording

    machine = machine_of(a)
    out = new_file("json", a.out, a.rec, machine.file)
    recording = load_recording(a.rec, machine)
    began = time.perf_counter()
    with Bar() as bar, bar.expect("identify", len(recording) / STEPWISE_PER_S if a.method == "paper" else 0.0):
        estimate, calibration, fit, warnings = fitted(
            a.rec, machine, recording, a.method, lambda k, n: bar("identify", k, n)
        )
    ambiguous = [] if a.method == "paper" else ambiguities(estimate, recording)
    told = [each.as_dict(machine) for each in ambiguous]
    calibration = replace(calibration, ambiguous=tuple(told))
    calibration.save(out)
    warn(a.rec, warnings)
    spread = np.sqrt(np.diag(calibration.noise.pose))
    set_aside = _set_aside(recording, estimate)
    answer = {
        "visits": int(recording.measured.sum()),
        "readings": int(recording.seen.sum()),
        "parameters": len(calibration.theta),
        "method": a.method,
        "fit": fit,
        "pose_sigma_mm": (spread[:3] * 1e3).tolist(),
        "pose_sigma_mrad": (spread[3:] * 1e3).tolist() if pose_rank(recording.seen) == 6 else None,
        "instrument_sigma_mm": calibration.noise.instrument * 1e3,
        "noise": "end effector" if calibration.noise.parts is None else "joints",
        "outliers": len(set_aside),
        "set_aside": [int(v) + 1 for v in set_aside],
        "warnings": warnings,
        "ambiguous": told,
        "bent_by": calibration.machine.bent_by,
        "seconds": round(time.perf_counter() - began, 2),
        "out": str(a.out),
    }
    say(a, answer, folded(_identified(answer, summary(ambiguous))))


def fitted(
    source: str | Path, machine: Machine, recording: Recording, method: str, progress: Progress
) -> tuple[Estimate, Calibration, dict[str, float], list[str]]:
    """The estimate of a recording, its calibration, what it leaves, and what there is to ask about. Raises
    IdentificationFailed where it leaves more than the ideal machine does."""
    from ppshw.calibration import Calibration
    from ppshw.identification import identify as run
    from ppshw.identification.joint import believable

    with columns_named(machine, recording):
        estimate = run(machine, recording, method, progress)
        calibration = Calibration.of(estimate, recording, method)
        fit = _figures_of_the_fit(source, machine, recording.subset(believable(estimate.weights)), calibration)
    return estimate, calibration, fit, _warnings(machine, recording, estimate, calibration, fit)


def _set_aside(recording: Recording, estimate: Estimate) -> NDArray[np.int64]:
    """Visits that were measured and that the fit does not believe, from 0."""
    from ppshw.identification.joint import believable

    return np.setdiff1d(np.flatnonzero(recording.measured), believable(estimate.weights))


def _figures_of_the_fit(
    name: str | Path, machine: Machine, believed: Recording, calibration: Calibration
) -> dict[str, float]:
    """Refused where the fit leaves more than the ideal machine does."""
    from ppshw.errors import IdentificationFailed
    from ppshw.evaluation import figures, nominal_residuals, residuals

    fit = figures(residuals(believed, calibration))
    ideal = figures(nominal_residuals(believed, machine))
    if fit["rms_mm"] > NO_BETTER * ideal["rms_mm"]:
        raise IdentificationFailed(
            f"{name}: the fit leaves {fit['rms_mm']:.3f} mm rms where the ideal machine leaves "
            f"{ideal['rms_mm']:.3f} mm: nothing was written"
        )
    return fit


def _warnings(
    machine: Machine, recording: Recording, estimate: Estimate, calibration: Calibration, fit: Mapping[str, float]
) -> list[str]:
    """What a recording and the fit to it give to ask about."""
    from ppshw.diagnosis.columns import column_mistakes, plain_mistakes
    from ppshw.diagnosis.sensor_words import doubt as doubt_of_sensor
    from ppshw.identification.joint import believable
    from ppshw.identification.plausible import apart_from_each_other, noisier_than_stated
    from ppshw.identification.strengths import held_back
    from ppshw.terms.shapes import Context

    believed = recording.subset(believable(estimate.weights))
    warnings = doubts_about(machine, recording)
    visits, aside = int(recording.measured.sum()), len(_set_aside(recording, estimate))
    if visits < FEW:
        warnings.append(f"visits: {visits}, expected {FEW} or more to tell how a machine errs from how it repeats")
    if aside > MANY_ASIDE * visits:
        warnings.append(
            f"{aside} of {visits} visits are unlike the others, and were set aside: are all of one state of "
            "the machine and the instrument?"
        )
        warnings += as_they_stand(plain_mistakes(machine, recording)[1])
    looked = column_mistakes if len(believed) >= FEW else plain_mistakes  # the moments' sign asks a fit to half of them
    warnings += [w for w in as_they_stand(looked(machine, believed)[1]) if w not in warnings]
    doubts = (
        doubt_of_sensor(Context.of(estimate.model, estimate.theta, believed, estimate.measuring_in_base)),
        noisier_than_stated(machine, fit["rms_mm"], "a residual"),
        apart_from_each_other(machine, calibration.noise.instrument),
    )
    warnings += [doubt for doubt in doubts if doubt]
    return warnings + held_back(estimate.model.parameters(), estimate.groups)


def _identified(answer: Mapping[str, Any], not_told_apart: Sequence[str]) -> list[str]:
    """The answer in words."""
    from ppshw.identification.own_weight import NOT_BENT
    from ppshw.recording import listed

    aside = [v - 1 for v in answer["set_aside"]]
    turned, claimed = "", " (not told from the scatter of the pose: fewer than three reflectors)"
    if answer["pose_sigma_mrad"] is not None:
        turned, claimed = f", {np.linalg.norm(answer['pose_sigma_mrad']):.3f} mrad", ""
    lines = [
        f"{answer['out']}: {answer['parameters']} parameters from {many(answer['visits'], 'visit')} "
        f"({many(answer['readings'], 'reading')}) in {answer['seconds']:.1f} s",
        f"  residual of the fit  {answer['fit']['rms_mm']:.3f} mm rms, {answer['fit']['p98_6_mm']:.3f} mm at 98.6 %",
        f"  pose repeatability   {np.linalg.norm(answer['pose_sigma_mm']):.3f} mm{turned} (1 sigma, 3-D)",
        f"  instrument           {answer['instrument_sigma_mm']:.3f} mm per coordinate{claimed}",
        f"  visits set aside     {len(aside)}{': ' if aside else ''}{listed(aside)}",
    ]
    if (how := NOT_BENT.get(answer["bent_by"])) is not None:
        lines.append(f"  own weights          {how}")
    if answer["method"] != "paper":
        lines += [f"  not told apart       {not_told_apart[0]}", *(f"    {each}" for each in not_told_apart[1:])]
    return lines


def evaluate(a: argparse.Namespace) -> None:
    from ppshw.calibration import load_calibration
    from ppshw.diagnosis.columns import plain_mistakes
    from ppshw.evaluation import evaluate as run
    from ppshw.identification.plausible import refuse_another_machine
    from ppshw.recording import load_recording

    machine = machine_of(a)
    calibration = load_calibration(a.calibration, machine) if a.calibration else None
    recording = load_recording(a.rec, machine)
    with columns_named(machine, recording):
        refuse_another_machine(machine, recording)
    warnings = doubts_about(machine, recording, calibration, a.refit_base)
    warnings += as_they_stand(plain_mistakes(machine, recording)[1])
    warn(a.rec, warnings)
    with Bar() as bar, bar.expect("evaluate", len(recording) / EVALUATED_PER_S):
        answer = {**run(recording, machine, calibration, refit_base=a.refit_base), "warnings": warnings}
    say(a, answer, folded(_evaluated(answer)))


def _evaluated(answer: Mapping[str, Any]) -> list[str]:
    """The answer in words."""
    from ppshw.diagnosis.wording import column_of
    from ppshw.diagnosis.wording import listed as columns_listed
    from ppshw.recording import listed

    rows = [("nominal", answer["nominal"])] + ([("calibrated", answer)] if "identified_from_it" in answer else [])
    lines = [f"{many(answer['visits'], 'visit')}, {many(answer['readings'], 'reading')} [mm]", FIGURE_HEAD]
    lines += [figure_row(name, values) for name, values in rows]
    for name, point in answer.get("points", {}).items():
        lines.append(f"at {name}, {many(point['readings'], 'reading')}, which are in no figure above")
        lines += [figure_row(of, point["nominal"] if of == "nominal" else point) for of, _ in rows]
    if answer["far_off"]:
        off = [v - 1 for v in answer["far_off"]]
        lines.append(f"{many(len(off), 'visit')} with a reading that no error of a machine explains, in the figures "
                     f"all the same: {listed(off)}")  # fmt: skip
    if answer.get("identified_from_it"):
        lines.append("the calibration was identified from this very recording: not what it is worth on others")
    if fitted := answer.get("fitted_visits"):
        lines.append(f"{fitted} of the visits are among those that the calibration was made from")
    if answer.get("earlier_visits"):
        lines.append(f"goes on from {many(answer['earlier_visits'], 'visit')} that the calibration was made from")
    if outside := answer.get("outside"):
        lines.append(f"{outside_in_words(outside)}, carried on there")
    for b in answer.get("beyond", ()):
        what, there = (
            (b["temperature"], f"{b['low_C']:.1f} to {b['high_C']:.1f} °C") if "temperature" in b
            else (b["column"], f"{b['low']:.6g} to {b['high']:.6g}")
        )  # fmt: skip
        lines.append(
            f"{many(b['visits'], 'visit')} with {what} beyond the {there} at which effects were measured; carried on "
            "there"
        )
    if held := answer.get("held_in_time"):
        lines.append(f"{many(held['visits'], 'visit')} so long before or after the calibration's own that nobody knows "
                     f"how far {' and '.join(held['effects'])} went: taken as at its start or end")  # fmt: skip
    if untimed := answer.get("untimed"):
        lines.append(f"no column time that tells visits apart: {' and '.join(untimed)} taken as if these visits had "
                     "followed at once on the calibration's own")  # fmt: skip
    for u in answer.get("unexplained", ()):
        over = columns_listed([column_of(name) for name in u["covariates"]])
        if u["visits_without"] == answer["visits"]:
            lines.append(f"structure over {over} is corrected at no visit: there were no data like any of these")
            continue
        lines.append(f"corrected without a name over {over}, by which unsure to {u['std_mm']:.3f} mm rms")
        if u["visits_without"]:
            lines[-1] += f"; not at {many(u['visits_without'], 'visit')}, where there were no data"
    return lines
