"""Answers: as text or JSON, rows of figures, files to write; and how long a bar is told that something takes."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ppshw.errors import BadInput, IdentificationFailed, RecordingError
from ppshw.quantities import many
from ppshw.recording_file import is_sqlite
from ppshw.whole_file import is_no_file, written_whole

# What takes how long on a small computer, for bars of what reports nothing of itself: guesses, good to a factor of two.
REPORT_S, EVALUATED_PER_S, STEPWISE_PER_S, READ_PER_S = 4.0, 7000.0, 400.0, 5e6  # s, visits/s, visits/s, bytes/s
TWINNED_PER_S = 250.0
Kind = Literal["json", "csv", "page", "campaign", "site"]
SAID_OF: dict[Kind, str] = {
    "json": "JSON", "csv": "table of visits", "page": "HTML page", "campaign": "campaign", "site": "site file",
}  # fmt: skip
SAID = 3  # joints and loads outside what was identified


def say(arguments: argparse.Namespace, answer: dict[str, Any], text: str) -> None:
    put(json.dumps(answer, indent=1) if arguments.json else text)


def put(text: str) -> None:
    """Onto standard output, all of it. An OSError says what could not be written."""
    try:
        print(text, flush=True)
    except OSError as exc:
        exc.filename = "standard output"
        raise


def warn(source: str, warnings: Sequence[str]) -> None:
    """What is odd about a file that a command goes on with: beside the answer, which may be JSON."""
    for warning in warnings:
        print(f"warning: {source}: {warning}", file=sys.stderr)


def doubts_about(machine: Any, recording: Any, calibration: Any = None, refit_base: bool = False) -> list[str]:
    """What is odd about a recording before anything is fitted to it, each in a line.

    calibration  of which it is another recording, if there is one;  refit_base as of `evaluation.residuals`
    """
    from ppshw.diagnosis.columns import doubts_of_gravity, doubts_of_moments
    from ppshw.evaluation import by_visit, residuals
    from ppshw.identification.plausible import LOADED_N, LOADED_NM, doubts

    more = []
    if calibration is not None:
        heaviest = np.abs(calibration.payload_range).reshape(2, 6).max(axis=1)  # force, moment
        if heaviest[1] > LOADED_NM:  # else moments had no sign
            more = doubts_of_moments(recording, lambda r: by_visit(residuals(r, calibration, refit_base)))
        if not recording.has_wrench and (heaviest > [LOADED_N, LOADED_NM]).any():
            more.append(
                f"no columns Fx … Mz, though the calibration knows loads of up to {heaviest[0]:.0f} N and "
                f"{heaviest[1]:.0f} N m: taken as no load, which is right of an empty machine alone"
            )
    return doubts(machine, recording) + doubts_of_gravity(machine, recording) + more


def as_they_stand(mistakes: Sequence[Any]) -> list[str]:
    """Warnings of columns that seem wrong, where a command goes on with them."""
    stands = {True: "they stand: set them", False: "it stands: set it"}
    return [f"{m.said}; taken as {stands[m.several]} right" for m in mistakes]


@contextmanager
def columns_named(machine: Any, recording: Any) -> Iterator[None]:
    """Where a recording is refused, which columns with the wrong sign or unit, or exchanged, would explain it."""
    try:
        yield
    except (RecordingError, IdentificationFailed) as exc:
        from ppshw.diagnosis.columns import plain_mistakes

        mistakes = plain_mistakes(machine, recording)[1]
        raise (type(exc)(f"{exc} (see: {mistakes[0].said})") if mistakes else exc) from None


FIGURE_HEAD = f"{'':16}{'median':>10}{'rms':>10}{'95 %':>10}{'98.6 %':>10}{'max':>10}"


def outside_in_words(found: Sequence[dict[str, Any]]) -> str:
    """Of `evaluation.outside`, at least one, which joints and loads and how far; --json has all."""
    said = [
        f"{o['of']} at {many(o['visits'], 'visit')} ({o['farthest']:.4g} {o['unit']}, "
        f"identified {o['low']:.4g} … {o['high']:.4g})"
        for o in found[:SAID]
    ]
    more = f" and {len(found) - SAID} more" if len(found) > SAID else ""
    return f"outside what was identified: {', '.join(said)}{more}"


def figure_row(name: str, values: dict[str, Any]) -> str:
    keys = ("median_mm", "rms_mm", "p95_mm", "p98_6_mm", "max_mm")
    return f"{name:16}" + "".join(f"{values[k]:10.3f}" for k in keys)


def new_file(kind: Kind, path: str | Path, *inputs: str | Path) -> Path:
    """Where an answer may go: a new file, or over an earlier one of its kind; not over a recording, which may be hours
    of measuring. Raises BadInput, or the system's OSError, before anything is computed, not after."""
    out = _place(path, *inputs)
    if not out.is_file() or is_no_file(out) or (there := _kind_of(out)) in ("nothing", kind):
        return out
    if there == "recording":
        raise BadInput(f"{out}: is a recording already, expected another file to write")
    raise BadInput(f"{out}: exists already and is no {SAID_OF[kind]}, expected another file to write")


def _kind_of(file: Path) -> str:
    """What a file seems to be, by its beginning."""
    if is_sqlite(file):
        return "recording"
    with file.open("rb") as stream:
        text = stream.read(1 << 16).decode("utf-8", "replace").lstrip("\ufeff \t\r\n")
    if not text:
        return "nothing"
    if text[0] in "{<":
        return "json" if text[0] == "{" else "page"
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    if lines and re.search(r'(^|,)"?q_\w', lines[0]):
        return "csv"
    top = {line.split(":")[0] for line in lines if re.match(r"\w+:", line)}
    return "campaign" if "steps" in top else "site" if {"axes", "tracker"} <= top else "other"


def _place(path: str | Path, *inputs: str | Path) -> Path:
    """A file that can be written and is none of what is read."""
    out = Path(path)
    if not out.parent.is_dir():
        raise BadInput(f"{out}: the folder {out.parent} does not exist")
    if out.is_dir():
        raise BadInput(f"{out}: a folder, expected the name of a file to write")
    for given in inputs:
        if out.exists() and Path(given).exists() and out.samefile(given):
            raise BadInput(f"{out}: is what is read here, expected another file to write")
    with written_whole(out, may_be_missing=True) as partial:  # an OSError where nothing can be written there
        partial.touch()
        partial.unlink()
    return out


def new_recording(path: str, *inputs: str) -> Path:
    """Where a recording may go, or go on. Raises BadInput like `new_file`."""
    out = _place(path, *inputs)
    if out.suffix.lower() == ".csv":
        raise BadInput(f"{out}: a recording is a database, expected a name in .db; export makes a CSV of it")
    return out


def new_files(paths: Sequence[tuple[Kind, str]], *inputs: str) -> None:
    """Where several answers may go, each into a file of its own. Raises BadInput like `new_file`."""
    taken: set[Path] = set()
    for kind, path in paths:
        place = new_file(kind, path, *inputs).resolve()
        if place in taken:
            raise BadInput(f"{path}: two answers would go there, expected a file for each")
        taken.add(place)
