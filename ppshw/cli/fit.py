"""A model's fit to a recording: identify, evaluate."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np

from ppshw.cli.answers import EVALUATED_PER_S, FIGURE_HEAD, STEPWISE_PER_S, figure_row, new_file, say
from ppshw.cli.arguments import machine_of
from ppshw.progress import Bar, folded


def identify(a: argparse.Namespace) -> None:
    import time

    from ppshw.calibration import Calibration
    from ppshw.diagnosis.columns import plain_mistakes
    from ppshw.evaluation import figures, residuals
    from ppshw.identification import identify as run
    from ppshw.identification.ambiguity import ambiguities, summary
    from ppshw.recording import load_recording

    machine = machine_of(a)
    out = new_file(a.out, a.rec, machine.file)
    recording = load_recording(a.rec, machine)
    began = time.perf_counter()
    with Bar() as bar, bar.expect("identify", len(recording) / STEPWISE_PER_S if a.method == "paper" else 0.0):
        estimate = run(machine, recording, a.method, lambda k, n: bar("identify", k, n))
    ambiguous = [] if a.method == "paper" else ambiguities(estimate, recording)
    told = tuple(each.as_dict(machine) for each in ambiguous)
    calibration = replace(Calibration.of(estimate, recording, a.method), ambiguous=told)
    calibration.save(out)
    for mistake in plain_mistakes(machine, recording)[1]:
        print(f"warning: {a.rec}: column {mistake.column} {mistake.what}; taken as it stands: set it right",
              file=sys.stderr)  # fmt: skip
    fit = figures(residuals(recording, calibration))
    spread = np.sqrt(np.diag(calibration.noise.pose))
    answer = {
        "visits": len(recording),
        "readings": int(recording.seen.sum()),
        "parameters": len(calibration.theta),
        "method": a.method,
        "fit": fit,
        "pose_sigma_mm": (spread[:3] * 1e3).tolist(),
        "pose_sigma_mrad": (spread[3:] * 1e3).tolist(),
        "instrument_sigma_mm": calibration.noise.instrument * 1e3,
        "noise": "end effector" if calibration.noise.joints is None else "joints",
        "outliers": calibration.provenance["visits_down_weighted"],
        "ambiguous": list(told),
        "seconds": round(time.perf_counter() - began, 2),
        "out": str(a.out),
    }
    text = (
        f"{a.out}: {answer['parameters']} parameters from {answer['visits']} visits ({answer['readings']} readings) "
        f"in {answer['seconds']:.1f} s\n"
        f"  residual of the fit  {fit['rms_mm']:.3f} mm rms, {fit['p98_6_mm']:.3f} mm at 98.6 %\n"
        f"  pose repeatability   {np.linalg.norm(spread[:3]) * 1e3:.3f} mm, "
        f"{np.linalg.norm(spread[3:]) * 1e3:.3f} mrad (1 sigma, 3-D)\n"
        f"  instrument           {calibration.noise.instrument * 1e3:.3f} mm per coordinate\n"
        f"  visits set aside     {answer['outliers']}"
    )
    if a.method != "paper":
        text += f"\n  not told apart       {summary(ambiguous)}"
    say(a, answer, folded(text.splitlines()))


def evaluate(a: argparse.Namespace) -> None:
    from ppshw.calibration import load_calibration
    from ppshw.evaluation import evaluate as run
    from ppshw.identification.plausible import refuse_another_machine
    from ppshw.recording import load_recording

    machine = machine_of(a)
    calibration = load_calibration(a.calibration, machine) if a.calibration else None
    recording = load_recording(a.rec, machine)
    refuse_another_machine(machine, recording)
    with Bar() as bar, bar.expect("evaluate", len(recording) / EVALUATED_PER_S):
        answer = run(recording, machine, calibration, refit_base=a.refit_base)
    rows = [("nominal", answer["nominal"])] + ([("calibrated", answer)] if calibration else [])
    lines = [f"{answer['visits']} visits, {answer['readings']} readings [mm]", FIGURE_HEAD]
    lines += [figure_row(name, values) for name, values in rows]
    if answer.get("earlier_visits"):
        lines.append(f"goes on from {answer['earlier_visits']} visits that the calibration was made from")
    for b in answer.get("beyond", ()):
        lines.append(f"{b['visits']} visits with {b['temperature']} beyond the {b['low_C']:.1f} to "
                     f"{b['high_C']:.1f} °C at which effects were measured; carried on there")
    for u in answer.get("unexplained", ()):
        lines.append(f"corrected without a name over {' and '.join(u['covariates'])}, by which unsure to "
                     f"{u['std_mm']:.3f} mm rms; not at {u['visits_without']} visits, where there were no data")
    say(a, answer, folded(lines))
