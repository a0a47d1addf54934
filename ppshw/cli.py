"""The command line: the composition root. One function per subcommand, nothing clever.

Exit codes: 0 success, 1 a failed run, 2 bad input. What went wrong is one line on stderr. Answers go to stdout, and
with --json nothing else does; prompts and progress go to stderr.
"""

from __future__ import annotations

import ppshw.process  # noqa: F401  # isort: skip  before numpy comes in with the rest

import argparse
import errno
import json
import logging
import math
import os
import re
import signal
import sqlite3
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ppshw import __version__
from ppshw.errors import BadInput, PpshwError
from ppshw.progress import Bar, folded
from ppshw.whole_file import written_whole

# What the system says of a path that the user gave; any other OSError is a run that failed.
_BAD_PATH = {errno.ENOENT, errno.EACCES, errno.EPERM, errno.EISDIR, errno.ENOTDIR, errno.EEXIST, errno.ENAMETOOLONG,
             errno.ELOOP, errno.EROFS, errno.EINVAL}  # fmt: skip


# What takes how long on a small computer, for bars of what reports nothing of itself: guesses, good to a factor of two.
REPORT_S, EVALUATED_PER_S, STEPWISE_PER_S, READ_PER_S = 4.0, 7000.0, 400.0, 5e6  # s, visits/s, visits/s, bytes/s
TWINNED_PER_S = 250.0
_NEGATIVE = re.compile(r"-[\d.][\d.eE+\-,; ]*")


class _Parser(argparse.ArgumentParser):
    """Complaints in one line, like every other."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {' '.join(message.split())} (see {self.prog} --help)\n")


def _say(arguments: argparse.Namespace, answer: dict[str, Any], text: str) -> None:
    print(json.dumps(answer, indent=1) if arguments.json else text)


# --- files that are written whole or not at all ------------------------------------------------------------------
def _new_file(path: str, *inputs: str) -> Path:
    """Where an answer may go. Raises BadInput before anything is computed, not after."""
    out = Path(path)
    if not out.parent.is_dir():
        raise BadInput(f"{out}: the folder {out.parent} does not exist")
    if out.is_dir():
        raise BadInput(f"{out}: a folder, expected the name of a file to write")
    for given in inputs:
        if out.exists() and Path(given).exists() and out.samefile(given):
            raise BadInput(f"{out}: is what is read here, expected another file to write")
    return out


# --- recordings ------------------------------------------------------------------------------------------------
def import_(a: argparse.Namespace) -> None:
    """import: CSV → SQLite, nothing written unless every value is good."""
    from ppshw.recording import check_machine, parse_table, read_table
    from ppshw.recording_file import RecordingFile

    machine = _machine(a)
    out = _new_file(a.out, a.csv, machine.file)
    if out.exists():
        raise BadInput(f"{out}: exists already, expected a new file")
    with Bar() as bar, bar.expect("import", Path(a.csv).stat().st_size / READ_PER_S if Path(a.csv).is_file() else 0.0):
        table = read_table(a.csv)
        check_machine(table, machine)
        recording = parse_table(table, machine)
    meta = {
        "machine": Path(machine.file).read_text(encoding="utf-8"),
        "machine_name": machine.name,
        "machine_sha256": machine.sha256,
        "imported_from": Path(a.csv).name,
        "csv_newline": "CRLF" if table.newline == "\r\n" else "LF",
        "ppshw": __version__,
    }
    with written_whole(out) as partial, RecordingFile.create(partial, table.header, meta) as file:
        file.append_rows(table.rows)
    readings = int(recording.seen.sum())
    answer = {"visits": len(recording), "readings": readings, "sha256": recording.sha256, "out": a.out}
    _say(a, answer, f"{a.out}: {len(recording)} visits, {readings} readings")


def export(a: argparse.Namespace) -> None:
    """export: SQLite → CSV, the same cells in the same order."""
    from ppshw.recording import read_table
    from ppshw.recording_file import is_sqlite

    out = _new_file(a.csv, a.rec)
    if out.is_file() and is_sqlite(out):
        raise BadInput(f"{out}: is a recording already, expected the name of a CSV file to write")
    table = read_table(a.rec)
    with written_whole(out) as partial:
        partial.write_text(table.csv_text(table.newline), encoding="utf-8", newline="")
    _say(a, {"visits": len(table.rows), "out": a.csv}, f"{a.csv}: {len(table.rows)} visits")


# --- the model side ----------------------------------------------------------------------------------------------
def identify(a: argparse.Namespace) -> None:
    import time

    from ppshw.calibration import Calibration
    from ppshw.evaluation import figures, residuals
    from ppshw.identification import identify as run
    from ppshw.identification.ambiguity import ambiguities, summary
    from ppshw.recording import load_recording

    machine = _machine(a)
    out = _new_file(a.out, a.rec, machine.file)
    recording = load_recording(a.rec, machine)
    began = time.perf_counter()
    with Bar() as bar, bar.expect("identify", len(recording) / STEPWISE_PER_S if a.method == "paper" else 0.0):
        estimate = run(machine, recording, a.method, lambda k, n: bar("identify", k, n))
    ambiguous = [] if a.method == "paper" else ambiguities(estimate, recording)
    told = tuple(each.as_dict(machine) for each in ambiguous)
    calibration = replace(Calibration.of(estimate, recording, a.method), ambiguous=told)
    calibration.save(out)
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
    _say(a, answer, text)


def evaluate(a: argparse.Namespace) -> None:
    from ppshw.calibration import load_calibration
    from ppshw.evaluation import evaluate as run
    from ppshw.recording import load_recording

    machine = _machine(a)
    calibration = load_calibration(a.calibration, machine) if a.calibration else None
    recording = load_recording(a.rec, machine)
    with Bar() as bar, bar.expect("evaluate", len(recording) / EVALUATED_PER_S):
        answer = run(recording, machine, calibration, refit_base=a.refit_base)
    rows = [("nominal", answer["nominal"])] + ([("calibrated", answer)] if calibration else [])
    lines = [f"{answer['visits']} visits, {answer['readings']} readings [mm]", _FIGURE_HEAD]
    lines += [_figure_row(name, values) for name, values in rows]
    if answer.get("earlier_visits"):
        lines.append(f"goes on from {answer['earlier_visits']} visits that the calibration was made from")
    for u in answer.get("unexplained", ()):
        lines.append(f"corrected without a name over {' and '.join(u['covariates'])}, by which unsure to "
                     f"{u['std_mm']:.3f} mm rms; not at {u['visits_without']} visits, where there were no data")
    _say(a, answer, "\n".join(lines))


_FIGURE_HEAD = f"{'':16}{'median':>10}{'rms':>10}{'95 %':>10}{'98.6 %':>10}{'max':>10}"


def _figure_row(name: str, values: dict[str, Any]) -> str:
    keys = ("median_mm", "rms_mm", "p95_mm", "p98_6_mm", "max_mm")
    return f"{name:16}" + "".join(f"{values[k]:10.3f}" for k in keys)


def _numbers(words: Sequence[str], count: int, what: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """`count` numbers, given as one word or several, with spaces, commas or brackets around them."""
    text = " ".join(words).strip()
    try:
        values = np.array([float(w) for w in text.translate(_BETWEEN_NUMBERS).split()])
    except ValueError:
        raise BadInput(f"{what}: '{text}' holds something that is no number, expected {count} numbers") from None
    if len(values) != count or not (np.abs(values) < 1e9).all():
        raise BadInput(f"{what}: '{text}' holds {len(values)} values, expected {count} finite numbers")
    return values


_BETWEEN_NUMBERS = str.maketrans(",;[]()", "      ")


def _pairs(words: Sequence[str] | None, names: Sequence[str] | None, what: str) -> dict[str, float]:
    """NAME=NUMBER words; names None: any."""
    out = {}
    for word in words or ():
        name, _, text = word.strip().partition("=")
        if names is not None and name not in names:
            raise BadInput(f"{what}: no joint named '{name}', expected one of {', '.join(names)}")
        out[name] = float(_numbers([text], 1, f"{what} {name}")[0])
    return out


def _circumstances(a: argparse.Namespace, machine: Any) -> Any:
    """What is known of the move beyond its end and its load: effects that a diagnosis found may depend on it."""
    from ppshw.compensation import Circumstances
    from ppshw.recording import Around

    approach = np.zeros(machine.n, dtype=np.int64)
    for joint, sign in _pairs(a.approach, machine.joint_names, "--approach").items():
        if sign not in (-1.0, 1.0):
            raise BadInput(f"--approach {joint}: {sign:g}, expected +1 or -1")
        approach[machine.joint_names.index(joint)] = int(sign)
    start = None if a.start is None else _numbers(a.start, machine.n, "--from")
    around = Around(temperatures=_pairs(a.temperature, None, "--temperature"))
    return Circumstances(start, approach, around=around, loaded_for=a.loaded_for)


def _corrected(a: argparse.Namespace, given: Any = None) -> tuple[Any, dict[str, Any], str]:
    """What `compensate` and `move` share: the wanted pose, corrected.

    given  the circumstances, where the site has been asked; None: what the options say
    """
    from ppshw.calibration import load_calibration
    from ppshw.compensation import Bounds, Compensator
    from ppshw.transforms import from_xyz_rpy

    machine = _machine(a)
    compensator = Compensator(load_calibration(a.calibration, machine), Bounds(a.max_travel, a.max_angle))
    given = given or _circumstances(a, machine)
    payload = _numbers(a.wrench, 6, "--wrench")
    if a.point not in ("tip", *machine.points, *machine.targets):
        known = ", ".join(["tip", *machine.points, *machine.targets])
        raise BadInput(f"--point: no point named '{a.point}' in {machine.file}, expected one of {known}")
    if a.joints is not None:
        setpoints = compensator.for_joints(_numbers(a.joints, machine.n, "--joints"), payload, a.point, given)
    else:
        pose = _numbers(a.pose, 6, "--pose")
        near = given.start if a.near is None else _numbers(a.near, machine.n, "--near")
        setpoints = compensator.for_pose(from_xyz_rpy(pose[:3], pose[3:]), payload, a.point, near, given)
    names = machine.joint_names
    answer = {
        "setpoints": dict(zip(names, setpoints.corrected.tolist(), strict=True)),
        "nominal": dict(zip(names, setpoints.nominal.tolist(), strict=True)),
        "point": a.point,
        "predicted_error_mm": (setpoints.predicted_error * 1e3).tolist(),
        "std_mm": (setpoints.std * 1e3).tolist(),
        "compensated": [v.as_dict() for v in setpoints.effects if v.taken_out],
        "not_compensated": [v.as_dict() for v in setpoints.effects if not v.taken_out],
    }
    lines = [f"{'joint':16}{'nominal':>14}{'setpoint':>14}{'correction':>14}"]
    for k, joint in enumerate(machine.joints):
        nominal, corrected = setpoints.nominal[k], setpoints.corrected[k]
        lines.append(f"{joint.name:16}{nominal:14.6f}{corrected:14.6f}{corrected - nominal:+14.6f}  {joint.unit}")
    size = np.linalg.norm(setpoints.predicted_error) * 1e3
    std = np.linalg.norm(setpoints.std) * 1e3
    lines.append(f"{a.point}: {size:.3f} mm off without correction; the model is sure to {std:.3f} mm (1 sigma)")
    lines += [f"{'compensated' if v.taken_out else 'not compensated'}: {v.sentence()}" for v in setpoints.effects]
    return machine, answer, "\n".join(lines)


def compensate(a: argparse.Namespace) -> None:
    _, answer, text = _corrected(a)
    _say(a, answer, text)


def move(a: argparse.Namespace) -> None:
    from campaigns.plan import travel_time
    from campaigns.site import load_site, open_bench
    from ppshw.calibration import load_calibration

    machine, _, _ = _corrected(a)  # refuses before anything is switched on
    site = load_site(a.site)
    if site.machine.sha256 != machine.sha256:
        there = f"'{site.machine.name}' ({site.machine.file})"
        raise BadInput(f"{a.site}: machine {there} stands there, the calibration is for {machine.file}")
    with open_bench(site) as bench, Bar() as bar:
        bench.start_axes(a.reset_faults)
        here = bench.axes.positions()
        felt = bench.temperatures() if load_calibration(a.calibration, machine).effects else {}
        _, answer, text = _corrected(a, _found_there(a, site, here, felt))
        there = answer["setpoints"]
        longest = max(travel_time(j, abs(there[j.name] - here[j.name])) for j in machine.joints)
        with bar.expect("move", longest / site.speed):
            report = bench.axes.move(there)
    answer["reached"] = dict(report.positions)
    _say(a, answer, f"{text}\nreached: " + ", ".join(f"{j} {x:.6f}" for j, x in report.positions.items()))


def _found_there(a: argparse.Namespace, site: Any, here: dict[str, float], felt: dict[str, float]) -> Any:
    """The circumstances as the site has them; what an option says goes before it."""
    from dataclasses import replace

    given = _circumstances(a, site.machine)
    approach = np.where(given.approach != 0, given.approach, _final_approach(site))
    start = np.array([here[j] for j in site.machine.joint_names]) if given.start is None else given.start
    around = replace(given.around, temperatures={**felt, **given.around.temperatures})
    return replace(given, start=start, approach=approach, around=around)


def _final_approach(site: Any) -> Any:
    """(n,) the direction in which the site has an axis always end its moves, 0 where it does not."""
    sides = {axis.name: axis.approach_from for axis in site.axes}
    return np.array([-(sides[j] or 0) for j in site.machine.joint_names])


def report(a: argparse.Namespace) -> None:
    from ppshw.report import build_report

    with Bar() as bar, bar.expect("report", REPORT_S):
        page = build_report(Path(a.dir))
    _say(a, {"report": str(page)}, str(page))


def diagnose(a: argparse.Namespace) -> None:
    """diagnose: locate, name, model; the answer goes into the file that --json names, the sentences to the terminal."""
    from ppshw.diagnosis import diagnose as run
    from ppshw.diagnosis.checks import sentence
    from ppshw.diagnosis.library import NAMES
    from ppshw.diagnosis.modelled import extended
    from ppshw.diagnosis.wording import how_sure
    from ppshw.recording import load_recording

    without = frozenset(a.without)
    if not without <= set(NAMES):
        raise BadInput(f"--without {min(without - set(NAMES))}: no such effect, expected some of {', '.join(NAMES)}")
    machine = _machine(a)
    recording = load_recording(a.rec, machine)
    for out in (a.json, a.out, a.page):
        if out is not None:
            _new_file(out, a.rec, a.machine)
    with Bar() as bar:
        found = run(machine, recording, without=without, progress=lambda k, n: bar("diagnose", k, n))
    answer = found.answer
    if a.page is not None:
        from ppshw.report.diagnosis import write_diagnosis

        with Bar() as bar, bar.expect("page", REPORT_S):
            write_diagnosis(found, Path(a.page))
    if a.out is not None:
        extended(found.space, found.found).save(a.out)
    with written_whole(Path(a.json)) as partial:
        partial.write_text(json.dumps(answer, indent=1), encoding="utf-8")
    held = answer["held_out"]
    lines = [f"{answer['visits']} visits: {answer['verdict'].replace('_', ' ')}"]
    lines += [f"  {f['sentence']} {how_sure(f)}" for f in answer["findings"]]
    if answer["unexplained"] is not None:
        left = answer["unexplained"]
        history = f" ({left['history']})" if left["history"] else ""
        lines.append(f"  unexplained structure over {' and '.join(left['covariates'])}{history}")
    lines += [f"  {c['sentence']}" for c in answer["corrections"]]
    lines.append(f"held out: {held['rms_before_mm']:.3f} mm rms before, {held['rms_after_mm']:.3f} mm after; "
                 f"noise {answer['noise_floor_mm']:.3f} mm")  # fmt: skip
    lines.append(f"by the base model {sentence(answer['checks']['before'])}")
    if answer["findings"] or answer["unexplained"] is not None:
        lines.append(f"with what was found {sentence(answer['checks']['after'])}")
    lines += [f"page {a.page}"] if a.page else []
    print(folded(lines))


def twin(a: argparse.Namespace) -> None:
    """twin: the visits of a recording, simulated by a calibration; and whether the recording is like that."""
    from ppshw.calibration import load_calibration
    from ppshw.diagnosis.checks import sentence
    from ppshw.evaluation import figures, residuals
    from ppshw.recording import check_machine, parse_table, read_table
    from ppshw.twin import compare, simulate, twin_table

    machine = _machine(a)
    calibration = load_calibration(a.calibration, machine)
    out = _new_file(a.out, a.rec, machine.file, a.calibration)
    table = read_table(a.rec)
    check_machine(table, machine)
    recording = parse_table(table, machine)
    with Bar() as bar, bar.expect("twin", len(recording) / TWINNED_PER_S):
        made = twin_table(table, recording, simulate(calibration, recording, a.seed))
        checks = [c.as_dict() for c in compare(calibration, recording, a.seed)]
    with written_whole(out) as partial:
        partial.write_text(made.csv_text(table.newline), encoding="utf-8", newline="")
    twin = figures(residuals(parse_table(made, machine), calibration))
    answer = {"out": a.out, "visits": len(recording), "readings": int(recording.seen.sum()), "seed": a.seed,
              "recording": figures(residuals(recording, calibration)), "twin": twin, "checks": checks}  # fmt: skip
    lines = [f"{a.out}: {len(recording)} visits; residuals of the calibration [mm]", _FIGURE_HEAD]
    lines += [_figure_row(name, answer[name]) for name in ("recording", "twin")]
    _say(a, answer, folded([*lines, f"the recording is {sentence(checks)}"]))


def prove(a: argparse.Namespace) -> None:
    from ppshw.prove import deck, removed_deck, run_prove, sentences, short_deck

    cases = short_deck(a.seed) if a.short else deck(a.cases, a.seed) + removed_deck(a.removed, a.seed)
    with Bar() as bar:
        answer = run_prove(Path(a.out), cases, workers=a.workers, scheduler=a.scheduler, say=bar)
    _say(a, answer, f"{sentences(answer)}\npage {Path(a.out) / 'prove.html'}")
    if len(answer["lost"]) == answer["cases"]:
        raise PpshwError(f"{a.out}: every case was lost, the first: {next(iter(answer['lost'].values()))}")


def study(a: argparse.Namespace) -> None:
    from ppshw.studies.catalogue import STUDIES
    from ppshw.studies.engine import Cluster
    from ppshw.studies.study import run_study, table

    with Bar() as bar:
        answer = run_study(
            STUDIES[a.study], Path(a.out), a.seeds, a.short, Cluster(a.workers, a.scheduler),
            lambda done, total: bar(a.study, done, total),
        )  # fmt: skip
    lost = [f"lost: {key}: {why}" for key, why in answer["lost"].items()]
    _say(a, answer, "\n".join([table(answer["rows"]), *lost, f"page {Path(a.out) / a.study}.md"]))


# --- the bench side ----------------------------------------------------------------------------------------------
def plan(a: argparse.Namespace) -> None:
    """plan: a script's visits; or, with --visits, --accuracy or --after, the design of a new script."""
    from campaigns.plan import plan_campaign
    from campaigns.script import load_script

    machine = _machine(a)
    answer: dict[str, Any] = {}
    lines: list[str] = []
    asked = {f"--{k}": v for k, v in vars(a).items() if k in _OF_A_DESIGN and v is not None}
    if a.joint is not None and a.to_separate is None:
        raise BadInput("plan: --joint says where --to-separate looks, and there is none")
    if a.to_separate is not None:
        _separated(a, machine, answer)
        return
    if a.campaign is not None:
        if asked:
            raise BadInput(f"{next(iter(asked))}: designs a new campaign, and '{a.campaign}' is one already")
        found = plan_campaign(load_script(a.campaign), machine)
    else:
        designed, lines = _designed(a, machine, answer, asked)
        if designed is None:
            _say(a, answer, "\n".join(lines))
            return
        found = designed
    summary = found.summary()
    answer |= summary.as_dict()
    lines = [
        f"{found.script.name} on {machine.name}: {summary.visits} visits, {summary.readings} readings, "
        f"{summary.load_changes} load changes, about {_hours(summary.duration_s)}",
        *(f"  {step:28}{count:6} visits" for step, count in summary.steps.items()),
        *lines,
    ]
    if a.visibility or (a.campaign is not None and len(found.visits) <= _FORESEEN):
        from campaigns.foresight import foresee

        foresight = foresee(found)
        answer["visibility"], answer["assumed"] = foresight.rows, foresight.assumed
        lines += foresight.warnings() + (foresight.table() if a.visibility else [])
    if a.list:
        names = machine.joint_names
        answer["plan"] = [
            {"index": v.index, "step": v.step, "load": v.load, "setpoints": dict(zip(names, v.setpoints, strict=True))}
            for v in found.visits
        ]
        for v in found.visits:
            lines.append(f"{v.index:5} {v.step:20} {v.load:12} " + " ".join(f"{x:9.4f}" for x in v.setpoints))
    _say(a, answer, "\n".join(lines))


_FORESEEN = 1000  # visits up to which a plan says unasked what it is blind to: two seconds
_OF_A_DESIGN = ("visits", "accuracy", "after", "calibration", "loads", "load_cases", "point", "out")


def _designed(
    a: argparse.Namespace, machine: Any, answer: dict[str, Any], asked: dict[str, Any]
) -> tuple[Any, list[str]]:
    """A new campaign in --out, or None where nothing is left to measure; with what is to be said."""
    from campaigns.design.ask import Question
    from campaigns.design.ask import answer as design
    from campaigns.script import load_script
    from ppshw.calibration import load_calibration
    from ppshw.recording import load_recording

    if a.visits is None and a.accuracy is None and a.after is None:
        raise BadInput("plan: expected a campaign to expand, or --visits, --accuracy or --after to design one")
    if a.visits is not None and a.accuracy is not None:
        raise BadInput("plan: --visits and --accuracy cannot both be asked for")
    if a.after is not None and a.calibration is not None:
        raise BadInput("plan: --calibration is not needed with --after, which identifies the recording itself")
    if a.out is None:
        raise BadInput("plan: --out CAMPAIGN.yaml is missing: where the designed campaign goes")
    out = _new_file(a.out, machine.file, *(x for x in (a.after, a.calibration, a.loads) if x))
    words = " ".join(f"{key.replace('_', '-')} {Path(str(v)).name if key != '--accuracy' else f'{v * 1e3:g}mm'}"
                     for key, v in asked.items() if key != "--out")  # fmt: skip
    question = Question(
        machine, a.visits, a.accuracy,
        None if a.after is None else load_recording(a.after, machine),
        None if a.calibration is None else load_calibration(a.calibration, machine),
        None if a.loads is None else load_script(a.loads),
        a.load_cases, a.point, a.seed, out.stem, f"ppshw plan {words} --seed {a.seed}",
    )  # fmt: skip
    with Bar() as bar, written_whole(out, may_be_missing=True) as partial:
        found = design(question, partial, lambda stage: lambda k, n: bar(stage, k, n))
    answer.update(found.numbers, out=None if found.plan is None else a.out)
    return found.plan, [*found.lines, *([] if found.plan is None else [a.out])]


def _separated(a: argparse.Namespace, machine: Any, answer: dict[str, Any]) -> None:
    """--to-separate A,B: the visits that tell two effects apart, after a recording or a planned campaign."""
    from campaigns.design.separate import Wanted, separate
    from campaigns.plan import plan_campaign
    from campaigns.script import load_script
    from ppshw.recording import load_recording

    effects = tuple(a.to_separate.split(","))
    if len(effects) != 2 or effects[0] == effects[1]:
        raise BadInput(f"--to-separate {a.to_separate}: expected two different effects and a comma between them")
    if (a.campaign is None) == (a.after is None):
        raise BadInput("plan: --to-separate needs what there is so far: a campaign, or --after REC")
    for given in ("accuracy", "calibration", "loads", "load_cases", "point"):
        if getattr(a, given) is not None:
            raise BadInput(f"plan: --{given.replace('_', '-')} has no meaning with --to-separate")
    if a.joint is not None and a.joint not in machine.joint_names:
        raise BadInput(f"--joint {a.joint}: no such joint (there are: {', '.join(machine.joint_names)})")
    if a.out is None:
        raise BadInput("plan: --out CAMPAIGN.yaml is missing: where the visits go")
    out = _new_file(a.out, machine.file, *([a.after] if a.after else []))
    so_far = plan_campaign(load_script(a.campaign), machine) if a.after is None else load_recording(a.after, machine)
    words = f"ppshw plan --to-separate {a.to_separate}" + (f" --joint {a.joint}" if a.joint else "")
    words += f" {'' if a.after is None else '--after '}{Path(a.after or a.campaign).name} --seed {a.seed}"
    with Bar() as bar:
        found = separate(
            Wanted(machine, (effects[0], effects[1]), a.joint, so_far, a.visits, a.seed, out.stem, words),
            lambda k, n: bar("candidates", k, n),
        )
    visits = sum(len(block.q) for block in found.blocks)
    answer.update(separation=found.rows, visits=visits, duration_s=found.seconds, out=a.out if visits else None)
    if not visits:
        _say(a, answer, "\n".join([*found.lines(), "told apart already, or by no visits tried: nothing written"]))
        return
    with written_whole(out, may_be_missing=True) as partial:
        partial.write_text(found.text, encoding="utf-8")
    plan_campaign(load_script(out), machine)
    _say(a, answer, "\n".join([*found.lines(), f"{visits} visits, about {_hours(found.seconds)}", a.out]))


def _hours(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{minutes} min"


def run(a: argparse.Namespace) -> None:
    from campaigns.plan import plan_campaign
    from campaigns.runner import run_campaign
    from campaigns.script import load_script
    from campaigns.site import load_site, open_bench
    from ppshw.recording_file import only_writer

    site = load_site(a.site)
    found = plan_campaign(load_script(a.campaign), site.machine)
    correct, label = _setpoint_map(a, site)
    out = _new_file(a.out, a.site, site.machine.file)
    with only_writer(out), open_bench(site) as bench, Bar() as bar:
        result = run_campaign(
            found, bench, out, site.make_operator(),
            setpoint_map=correct, map_label=label, reset_faults=a.reset_faults,
            progress=lambda p: bar("visits", p.done, p.total, p.seconds_left / site.speed),
        )  # fmt: skip
    answer = {"out": str(result.out), "measured": result.measured, "done": result.done, "planned": len(found.visits),
              "skipped": result.skipped, "lost_beams": result.lost_beams}  # fmt: skip
    _say(a, answer, f"{result.out}: {result.measured} visits measured now, {result.done} of {len(found.visits)} in all")


def _setpoint_map(a: argparse.Namespace, site: Any) -> tuple[Callable[..., Any] | None, str]:
    """Compensated setpoints for a whole campaign, when a calibration is given."""
    if a.calibration is None:
        return None, "as planned"
    from ppshw.calibration import load_calibration
    from ppshw.compensation import Compensator

    calibration = load_calibration(a.calibration, site.machine)
    compensator = Compensator(calibration)
    label = calibration.provenance["recording_sha256"] + (" with effects" if calibration.effects else "")
    return compensator.setpoint_map(final_approach=_final_approach(site)), label


def check(a: argparse.Namespace) -> None:
    from campaigns.site import load_site, open_bench

    site = load_site(a.site)
    with open_bench(site) as bench:
        devices = bench.check()
    answer = {"site": site.name, "devices": [vars(d) for d in devices]}
    lines = [f"{d.device:16}{d.model:24}{d.serial:12}{d.firmware:10}{d.status}" for d in devices]
    _say(a, answer, "\n".join(lines))


def simulate(a: argparse.Namespace) -> None:
    from simulators.serve import serve

    machine, site = _machine(a), _new_file(a.site_out, a.machine)

    def announce(path: Path) -> None:
        print(json.dumps({"site": str(path)}), flush=True)

    ready = announce if a.json else None
    serve(machine.file, site, seed=a.seed, speed=a.speed, force_protocol=a.force_sensor, ready=ready)


def demo(a: argparse.Namespace) -> None:
    from ppshw.demo import run_demo

    if a.conceal is not None:
        return _demo_concealed(a)
    with Bar() as bar:
        answer = run_demo(Path(a.out), a.seed, Path(_machine(a).file), a.method, bar)
    scatter = answer["repeatability"]
    text = "\n".join(
        [
            f"at the treatment point, {answer['verification_visits']} configurations that no fit has seen [mm]",
            _FIGURE_HEAD,
            _figure_row("uncompensated", answer["uncompensated"]),
            _figure_row("compensated", answer["compensated"]),
            f"measurements      {answer['visits']} visits, {answer['readings']} reflector readings",
            f"repeatability     {answer['repeatability_mm']:.3f} mm at 98.6 % ({scatter['visits']} visits)",
            f"time              {answer['seconds']:.0f} s for {answer['machine_hours']:.0f} h of machine time; "
            f"identification {answer['identify_seconds']:.1f} s",
            f"page              {Path(a.out) / 'report.html'}",
        ]
    )
    return _say(a, answer, text)


def _demo_concealed(a: argparse.Namespace) -> None:
    from ppshw.demo_concealed import run_concealed, sentences, table_rows

    def announce(seal: str) -> None:
        print(f"seal {seal}", file=sys.stderr, flush=True)

    with Bar() as bar:
        answer = run_concealed(Path(a.out), a.conceal, a.seed, Path(_machine(a).file), bar, announce)
    rows = [_figure_row(name, values) for name, values in table_rows(answer).items()]
    _say(a, answer, "\n".join(sentences(answer, [_FIGURE_HEAD, *rows])))


# --- arguments -----------------------------------------------------------------------------------------------------
def _machine(a: argparse.Namespace) -> Any:
    """The machine file of that path, or the one of that name that comes with ppshw."""
    from ppshw.machine import load_machine, shipped_machines

    named = shipped_machines() / f"{a.machine}.yaml"
    return load_machine(named if not Path(a.machine).exists() and named.is_file() else a.machine)


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < math.inf:
        raise ValueError
    return value


def _seed(text: str) -> int:
    value = int(text)
    if value < 0:
        raise ValueError
    return value


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise ValueError
    return value


def _length(text: str) -> float:
    """A length with its unit (mm, um, µm, m), or metres."""
    found = _LENGTH.fullmatch(text.strip())
    if found is None:
        raise ValueError
    return _positive(found[1]) * {"mm": 1e-3, "um": 1e-6, "µm": 1e-6, "m": 1.0, "": 1.0}[found[2]]


_LENGTH = re.compile(r"([0-9.eE+-]+?) *(mm|um|µm|m|)")
_length.__name__ = "length such as 0.25mm"
_positive.__name__, _seed.__name__ = "positive number", "seed (0, 1, 2, …)"  # what argparse calls them
_count.__name__ = "number of 1 or more"


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="ppshw", description="Measure, identify and take out the errors of a large manipulator.")
    parser.add_argument("--version", action="version", version=f"ppshw {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)

    def add(name: str, function: Callable[[argparse.Namespace], None], about: str) -> argparse.ArgumentParser:
        found = commands.add_parser(name, help=about, description=f"{about[0].upper()}{about[1:]}.")
        found.add_argument("--json", action="store_true", help="print the answer as JSON")
        found.set_defaults(function=function)
        return found

    def machine(p: argparse.ArgumentParser) -> None:
        p.add_argument("--machine", required=True, metavar="M", help="machine file, or pps or arm6, which come with it")

    p = add("demo", demo, "the main job on simulated hardware, from campaign to compensated verification")
    p.add_argument("--out", default="demo-out", metavar="DIR", help="where results go (default: demo-out)")
    p.add_argument("--seed", type=_seed, default=1, help="seed of the simulated machine (default: 1)")
    p.add_argument("--machine", default="pps", metavar="M", help="machine file (default: pps, the positioner)")
    p.add_argument("--method", choices=("joint", "paper"), default="joint", help="identification (default: joint)")
    p.add_argument("--conceal", type=_seed, metavar="SEED",
                   help="instead: the machine hides an effect that this seed picks, to be found, named and taken out")

    p = add("simulate", simulate, "simulated hardware as a process of its own, on endpoints that open like real ones")
    machine(p)
    p.add_argument("--site-out", required=True, metavar="S", help="site file to write, for check and run")
    p.add_argument("--seed", type=_seed, default=1, help="seed of the simulated machine (default: 1)")
    p.add_argument("--speed", type=_positive, default=1.0, help="how much faster than real time (default: 1)")
    p.add_argument("--force-sensor", choices=("bota", "gsv8"), default="bota")

    p = add("check", check, "connect to each device of a site and say who and how it is; moves nothing")
    p.add_argument("--site", required=True, metavar="S", help="site file")

    p = add("plan", plan, "expand a campaign, check it against limits, say how many visits and how long; or design one")
    p.add_argument("campaign", nargs="?", help="campaign script (a file, or the name of one that comes with ppshw)")
    machine(p)
    p.add_argument("--list", action="store_true", help="list every visit")
    p.add_argument("--visibility", action="store_true", help="for every effect and joint what the campaign would show")
    p.add_argument("--to-separate", metavar="A,B", help="visits that tell two effects apart, after this or --after")
    p.add_argument("--joint", metavar="J", help="with --to-separate: at this joint only (default: at every joint)")
    g = p.add_argument_group("design of a new campaign: what to measure for the least error at a point")
    g.add_argument("--visits", type=_count, metavar="N", help="of that many visits, reference visits counted")
    g.add_argument("--accuracy", type=_length, metavar="X", help="with this predicted 98.6 %%, noise included: 0.25mm")
    g.add_argument("--after", metavar="REC", help="go on after this recording: what to measure next, when to stop")
    g.add_argument("--out", metavar="CAMPAIGN.yaml", help="the script to write")
    g.add_argument("--calibration", metavar="CAL.json", help="believe the prior strengths and the noise learnt there")
    g.add_argument("--loads", metavar="SCRIPT", help="only load cases of this script (default: 20 to 200 kg, or less)")
    g.add_argument("--load-cases", type=_count, metavar="K", help="how many loads to put on (default: 4)")
    g.add_argument("--point", help="where accuracy counts (default: treatment, or the tip)")
    g.add_argument("--seed", type=_seed, default=1, help="of everything random (default: 1)")

    p = add("run", run, "run a campaign; the same command again goes on where it stopped")
    p.add_argument("campaign", help="campaign script (a file, or the name of one that comes with ppshw)")
    p.add_argument("--site", required=True, metavar="S", help="site file")
    p.add_argument("--out", required=True, metavar="REC.db", help="the recording; goes on with one that is begun")
    p.add_argument("--calibration", metavar="CAL.json", help="drive compensated setpoints")
    _reset_faults(p)

    p = add("import", import_, "interchange CSV → recording, lossless")
    p.add_argument("csv", metavar="CSV")
    machine(p)
    p.add_argument("--out", required=True, metavar="REC.db", help="a new file")

    p = add("export", export, "recording → interchange CSV, lossless")
    p.add_argument("rec", metavar="REC.db")
    p.add_argument("csv", metavar="CSV")

    p = add("identify", identify, "a recording → a calibration with its uncertainty")
    p.add_argument("rec", metavar="REC", help="recording, .db or .csv")
    machine(p)
    p.add_argument("--out", required=True, metavar="CAL.json")
    p.add_argument("--method", choices=("joint", "paper"), default="joint",
                   help="joint: all visits at once; paper: stepwise, needs the paper's campaign")  # fmt: skip

    p = add("evaluate", evaluate, "what the model misses on a recording it has not seen")
    p.add_argument("rec", metavar="REC", help="recording, .db or .csv")
    machine(p)
    p.add_argument("--calibration", metavar="CAL.json", help="without: the ideal machine only")
    p.add_argument("--refit-base", action="store_true",
                   help="the tracker was moved since the calibration: fit the measuring frame to this recording first "
                   "(default: the frame of the calibration, or of the machine file)")  # fmt: skip

    for name, function, about in (
        ("compensate", compensate, "wanted pose and load → corrected joint setpoints; moves nothing"),
        ("move", move, "the same as compensate, and drives the axes there"),
    ):
        p = add(name, function, about)
        machine(p)
        p.add_argument("--calibration", required=True, metavar="CAL.json")
        wanted = p.add_mutually_exclusive_group(required=True)
        wanted.add_argument("--pose", nargs="+", metavar="X Y Z ROLL PITCH YAW",
                            help="of the point, in the base frame [m, rad]")  # fmt: skip
        wanted.add_argument("--joints", nargs="+", metavar="Q1 … QN",
                            help="instead: the pose that the ideal machine has there [m, rad]")  # fmt: skip
        p.add_argument("--wrench", nargs="+", default=["0 0 0 0 0 0"], metavar="FX FY FZ MX MY MZ",
                       help="payload on the sensor at that pose, sensor frame [N, N m] (default: none)")  # fmt: skip
        p.add_argument("--point", default="tip", help="tip, or a point or target of the machine file (default: tip)")
        p.add_argument("--near", nargs="+", metavar="Q1 … QN",
                       help="of several ways to reach the pose, the one nearest to this")  # fmt: skip
        p.add_argument("--max-travel", type=_positive, default=0.03, metavar="M",
                       help="most that a prismatic joint may be corrected (default: 0.03)")  # fmt: skip
        p.add_argument("--max-angle", type=_positive, default=0.03, metavar="RAD",
                       help="most that a revolute joint may be corrected (default: 0.03)")  # fmt: skip
        p.add_argument("--from", dest="start", nargs="+", metavar="Q1 … QN",
                       help="joint values that the move starts from: they tell the directions of approach")  # fmt: skip
        p.add_argument("--approach", nargs="+", metavar="JOINT=+1", help="direction of a joint's final motion")
        p.add_argument("--temperature", nargs="+", metavar="PLACE=21.5",
                       help="of a place, by the recording's name for it [°C]")  # fmt: skip
        p.add_argument("--loaded-for", type=_positive, metavar="S", help="how long the load has been on [s]")
        if name == "move":
            p.add_argument("--site", required=True, metavar="S", help="site file")
            _reset_faults(p)

    p = add("report", report, "one self-contained HTML page of what a folder holds")
    p.add_argument("dir", metavar="DIR")

    about = "locate, name and model what the model leaves unexplained in a recording"
    p = commands.add_parser("diagnose", help=about, description=f"{about[0].upper()}{about[1:]}.")
    p.set_defaults(function=diagnose)
    p.add_argument("rec", metavar="REC", help="recording, .db or .csv")
    machine(p)
    p.add_argument("--json", required=True, metavar="OUT.json", help="the answer")
    p.add_argument("--out", metavar="CAL.json", help="a calibration with what was found modelled")
    p.add_argument("--page", metavar="OUT.html", help="a page with pictures: where it sits, what was found, how sure")
    p.add_argument("--without", nargs="+", default=[], metavar="NAME", help="effects that are not to be thought of")

    p = add("twin", twin, "what a calibration says the visits of a recording would have read, and whether they did")
    p.add_argument("rec", metavar="REC", help="recording, .db or .csv")
    machine(p)
    p.add_argument("--calibration", required=True, metavar="CAL.json", help="with its effects, if it has any")
    p.add_argument("--out", required=True, metavar="TWIN.csv", help="the recording with simulated readings")
    p.add_argument("--seed", type=_seed, default=0, help="of its noise (default: 0)")

    p = add("prove", prove, "how often is a diagnosis right: concealed cases, sealed, diagnosed, opened, scored")
    p.add_argument("--out", required=True, metavar="DIR")
    p.add_argument("--cases", type=_count, default=108, metavar="N", help="default: 108, the whole deck once")
    p.add_argument("--seed", type=_seed, default=1)
    p.add_argument("--removed", type=_seed, default=0, metavar="N",
                   help="N more whose effect's name is taken out of the library (default: 0)")  # fmt: skip
    p.add_argument("--short", action="store_true", help="a dozen short campaigns instead")
    _cluster(p)

    p = add("study", study, "the paper's studies over many simulated machines: a table and a picture each")
    p.add_argument("study", metavar="STUDY", choices=_STUDIES, help=", ".join(_STUDIES))
    p.add_argument("--out", required=True, metavar="DIR", help="goes on with what an earlier call left there")
    p.add_argument("--seeds", type=_count, metavar="N", help="machines (default: 20; residuals: 100; with --short: 1)")
    p.add_argument("--short", action="store_true", help="small and quick, to see that it runs")
    _cluster(p)
    return parser


# Names of ppshw.studies.catalogue, which takes long to import.
_STUDIES = ("accuracy-repeatability", "accuracy-visits", "residuals", "directions")


def _cluster(p: argparse.ArgumentParser) -> None:
    """Where the jobs of a study run: ppshw.studies.engine."""
    p.add_argument("--workers", type=_seed, default=2, metavar="N",
                   help="processes at a time on this computer (default: 2; 0: this one, without dask)")  # fmt: skip
    p.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="a running dask scheduler instead of processes here")


def _reset_faults(p: argparse.ArgumentParser) -> None:
    p.add_argument("--reset-faults", action="store_true",
                   help="acknowledge the drives' faults first: somebody has seen to the cause")  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    if argv is None:
        argv = sys.argv[1:]
        _as_a_program()
    # a leading space keeps argparse from taking -1e-3 or -0.1,2 for an option
    arguments = _parser().parse_args([f" {word}" if _NEGATIVE.fullmatch(word) else word for word in argv])
    try:
        arguments.function(arguments)
        sys.stdout.flush()
    except PpshwError as error:
        return _complain(str(error), error.exit_code)
    except KeyboardInterrupt:
        return _complain("stopped", 1)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        message = f"{error.filename or 'file'}: {error.strerror or error}"
        return _complain(message, 2 if error.errno in _BAD_PATH else 1)
    except sqlite3.Error as error:
        return _complain(f"recording: {error}", 1)
    except Exception as error:
        if os.environ.get("PPSHW_DEBUG"):
            raise
        return _complain(f"internal error: {type(error).__name__}: {error} (PPSHW_DEBUG=1 shows where)", 1)
    return 0


def _as_a_program() -> None:
    """What concerns the whole process: a polite kill stops the axes like Ctrl-C; stderr is for our one line alone."""
    for name in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.default_int_handler)
    if not os.environ.get("PPSHW_DEBUG"):
        logging.captureWarnings(True)
        logging.getLogger().addHandler(logging.NullHandler())  # else Python prints the drivers' warnings itself
    with suppress(AttributeError):  # a terminal without our letters must not end in a traceback
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]


def _complain(message: str, code: int) -> int:
    print(f"ppshw: {' '.join(message.split())}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
