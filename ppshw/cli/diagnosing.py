"""What a recording shows beside its model, and pages about it: diagnose, twin, report."""

from __future__ import annotations

import argparse
import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np

from ppshw.cli.answers import (
    FIGURE_HEAD,
    REPORT_S,
    TWINNED_PER_S,
    Kind,
    as_they_stand,
    columns_named,
    doubts_about,
    figure_row,
    new_file,
    new_files,
    outside_in_words,
    put,
    say,
    warn,
)
from ppshw.cli.arguments import machine_of
from ppshw.errors import BadInput
from ppshw.progress import Bar, folded
from ppshw.quantities import called, many
from ppshw.whole_file import written_whole


def report(a: argparse.Namespace) -> None:
    from ppshw.report import build_report
    from ppshw.report.page import NAME

    if Path(a.dir).is_dir():
        new_file("page", Path(a.dir) / NAME)
    with Bar() as bar, bar.expect("report", REPORT_S):
        page = build_report(Path(a.dir))
    say(a, {"report": str(page)}, str(page))


def diagnose(a: argparse.Namespace) -> None:
    """diagnose: locate, name, model; sentences to the terminal, the answer into the file that --json names."""
    from ppshw.diagnosis import diagnose as run
    from ppshw.diagnosis.library import NAMES
    from ppshw.diagnosis.modelled import extended
    from ppshw.recording import load_recording

    without = frozenset(a.without)
    if not without <= set(NAMES):
        raise BadInput(f"--without {min(without - set(NAMES))}: no such effect, expected some of {', '.join(NAMES)}")
    machine = machine_of(a)
    recording = load_recording(a.rec, machine)
    asked: list[tuple[Kind, str | None]] = [("json", a.json), ("json", a.out), ("page", a.page)]
    new_files([(kind, out) for kind, out in asked if out is not None and out != "-"], a.rec, machine.file)
    before = _doubts_before(machine, recording)
    warn(a.rec, before)
    with Bar() as bar:
        found = run(machine, recording, without=without, progress=lambda k, n: bar("diagnose", k, n))
    after = _doubts_after(machine, found)
    warn(a.rec, after)
    warnings = before + after
    answer = {**found.answer, "warnings": warnings}
    if a.page is not None:
        from ppshw.report.diagnosis import write_diagnosis

        with Bar() as bar, bar.expect("page", REPORT_S):
            write_diagnosis(found, Path(a.page), warnings)
    if a.out is not None:
        extended(found.space, found.found, answer["findings"]).save(a.out)
    text = json.dumps(answer, indent=1)
    if a.json == "-":
        put(text)
        return
    if a.json is not None:
        with written_whole(Path(a.json)) as partial:
            partial.write_text(text, encoding="utf-8")
    lines = _sentences(answer, found.space.machine.bent_by) + ([f"page {a.page}"] if a.page else [])
    put("\n".join([folded(lines), *_what_to_measure(a, answer["findings"])]))


def _doubts_before(machine: Any, recording: Any) -> list[str]:
    """What is odd about a recording before anything is looked for, each in a line."""
    from ppshw.identification.plausible import reads_the_same

    out = doubts_about(machine, recording)
    if not np.isfinite(recording.time).all():
        out.append("no column time that tells visits apart: what goes with time is said in hours at 40 visits an hour")
    if recording.has_wrench and not any(recording.load) and not reads_the_same(recording):
        out.append("no column load: when one was changed is known by what the force sensor read alone")
    if not recording.has_wrench and not any(recording.load):
        out.append("no column load and no wrench: a load that was changed looks like a zero that jumped")
    return out


def _doubts_after(machine: Any, found: Any) -> list[str]:
    """What a diagnosis gives reason to doubt beside what it found, each in a line."""
    from ppshw.diagnosis.search import MOST_FINDINGS
    from ppshw.diagnosis.sensor_words import doubt as doubt_of_sensor
    from ppshw.identification.plausible import noisier_than_stated

    out = []
    if len({(candidate.effect, candidate.joint) for _, candidate in found.found}) >= MOST_FINDINGS:
        out.append(f"the search ended at {MOST_FINDINGS} effects: there may be more")
    of_sensor = any(f["effect"] == "wrench_error" for f in found.answer["findings"])
    if not of_sensor and (said := doubt_of_sensor(found.space.context)):
        out.append(said)
    if doubt := noisier_than_stated(machine, found.answer["noise_floor_mm"], "noise"):
        out.append(doubt)
    if (off := found.space.reflectors_off) is not None:
        out.append(
            f"reflectors are some {1e3 * off:.2f} mm (rms, each coordinate) from where the machine file has them, by "
            "the distances between them: measure them again, or say targets: estimate"
        )
    return out


def _sentences(answer: dict[str, Any], bent_by: str) -> list[str]:
    """What is printed of an answer."""
    from ppshw.diagnosis import serial
    from ppshw.diagnosis.checks import sentence
    from ppshw.diagnosis.wording import how_sure, unexplained, would_have_shown
    from ppshw.identification.own_weight import NOT_BENT

    held = answer["held_out"]
    lines = [f"{answer['visits']} visits: {answer['verdict'].replace('_', ' ')}"]
    lines += [f"  {f['sentence']} {how_sure(f)}" for f in answer["findings"]]
    if answer["unexplained"] is not None:
        lines.append(f"  {unexplained(answer['unexplained'])}")
    lines += [f"  {c['sentence']}" for c in answer["corrections"]]
    lines.append(f"held out: {held['rms_before_mm']:.3f} mm rms before, {held['rms_after_mm']:.3f} mm after; "
                 f"noise {answer['noise_floor_mm']:.3f} mm")  # fmt: skip
    if answer["verdict"] == "consistent" and (seen := would_have_shown(answer["visibility"])):
        lines.append(seen)
    if (how := NOT_BENT.get(bent_by)) is not None:
        lines.append(f"own weights {how}")
    if remembers := serial.sentence(answer):
        lines.append(remembers)
    lines.append(f"by the base model {sentence(answer['checks']['before'])}")
    if answer["findings"] or answer["unexplained"] is not None:
        lines.append(f"with what was found {sentence(answer['checks']['after'])}")
    return lines


def _what_to_measure(a: argparse.Namespace, findings: list[dict[str, Any]]) -> list[str]:
    """The commands that write visits by which findings would be told from what they may well be; to be copied."""
    from ppshw.diagnosis.wording import plan_options, to_separate

    lines: list[str] = []
    for one, other, joint in dict.fromkeys(filter(None, map(to_separate, findings))):
        at = f" at {joint}" if joint else ""
        lines += [
            folded([f"visits that may tell {called(one)} from {called(other)}{at}; where none can, it says so:"]),
            f"  ppshw plan --after {shlex.quote(a.rec)} --machine {shlex.quote(a.machine)} \\",
            f"    {plan_options(one, other, joint)} --out next.yaml",
        ]
    return lines


def twin(a: argparse.Namespace) -> None:
    """twin: the visits of a recording, simulated by a calibration; and whether the recording is like that."""
    from ppshw.calibration import load_calibration
    from ppshw.diagnosis.checks import sentence
    from ppshw.diagnosis.columns import plain_mistakes
    from ppshw.evaluation import figures, outside, residuals
    from ppshw.identification.plausible import refuse_another_machine
    from ppshw.recording import check_machine, parse_table, read_table
    from ppshw.twin import comparable, compare, simulate, twin_table

    machine = machine_of(a)
    calibration = load_calibration(a.calibration, machine)
    out = new_file("csv", a.out, a.rec, machine.file, a.calibration)
    table = read_table(a.rec)
    check_machine(table, machine)
    recording = parse_table(table, machine)
    with columns_named(machine, recording):
        refuse_another_machine(machine, recording)
    recorded = figures(residuals(recording, calibration))
    warnings = doubts_about(machine, recording, calibration) + as_they_stand(plain_mistakes(machine, recording)[1])
    warn(a.rec, warnings)
    with Bar() as bar, bar.expect("twin", len(recording) / TWINNED_PER_S):
        made = twin_table(table, recording, simulate(calibration, recording, a.seed))
        checks = [c.as_dict() for c in compare(calibration, recording, a.seed)]
    with written_whole(out) as partial:
        partial.write_text(made.csv_text(table.newline), encoding="utf-8", newline="")
    twin = figures(residuals(parse_table(made, machine), calibration))
    beyond, judged = outside(recording, calibration), int(comparable(calibration, recording).sum())
    answer = {"out": a.out, "visits": len(recording), "readings": int(recording.seen.sum()), "seed": a.seed,
              "recording": recorded, "twin": twin, "checks": checks, "compared": judged, "outside": beyond,
              "warnings": warnings}  # fmt: skip
    lines = [f"{a.out}: {many(len(recording), 'visit')}; residuals of the calibration [mm]", FIGURE_HEAD]
    lines += [figure_row(name, answer[name]) for name in ("recording", "twin")]
    if beyond:
        left_out = int(recording.measured.sum()) - judged
        how = "such visits are in no check" if left_out else "they are in the checks all the same"
        lines.append(f"{outside_in_words(beyond)}; {how}")
    say(a, answer, folded([*lines, f"the recording is {sentence(checks)}"]))
