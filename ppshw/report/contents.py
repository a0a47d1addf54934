"""What a folder holds of one machine's calibration, read and checked; what is not there is listed, not guessed.

A file that is there but broken is an error: a report that leaves it out in silence would look like a good one.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ppshw.calibration import Calibration, load_calibration
from ppshw.errors import ReportError
from ppshw.machine import Machine, load_machine
from ppshw.quantities import many
from ppshw.recording import Recording, load_recording
from ppshw.recording_file import RecordingFile, is_sqlite
from ppshw.report import concealed
from ppshw.whole_file import file_hash

MACHINE, CALIBRATION = "machine.yaml", "calibration.json"
RESULT = "demo.json"
CONCEALED = "concealed.json"  # of a demo with a concealed effect, in the place of demo.json
EXTENDED = "extended.json"
DIAGNOSIS = "diagnosis.json"
RECORDINGS = {
    "campaign": "the residual of the identification recording and the coverage of the joints",
    "verification_nominal": "errors without compensation",
    "verification_compensated": "errors with compensation",
    "verification_base": "errors with the base calibration alone",
    "verification_extended": "errors with what a diagnosis found taken out as well",
    "repeatability": "how well the machine comes back to a pose",
}
# A folder holds the one, or the other two, where compensation was tried without and with what a diagnosis found.
PLAIN, IN_TWO = ("verification_compensated",), ("verification_base", "verification_extended")


@dataclass(frozen=True)
class Source:
    """A file that the report was made from, for its provenance; visits: of a recording."""

    name: str
    sha256: str
    about: str
    visits: int = 0
    meta: dict[str, str] = field(default_factory=dict)
    devices: tuple[dict[str, str], ...] = ()


@dataclass(frozen=True)
class Missing:
    """A file that is not there, or holds no visit yet, and what cannot be shown for it."""

    name: str
    why: str
    shows: str


@dataclass(frozen=True)
class Contents:
    """Everything usable in a folder.

    point      the point of the end effector that accuracy is stated at
    result     figures that the run printed, by the page's names
    concealed  all that a demo with a concealed effect answered
    """

    folder: Path
    machine: Machine
    point: str
    calibration: Calibration | None
    recordings: dict[str, Recording]
    result: dict[str, Any]
    result_name: str
    concealed: dict[str, Any] | None
    diagnosis: dict[str, Any] | None
    sources: tuple[Source, ...]
    missing: tuple[Missing, ...]


def read_folder(folder: Path) -> Contents:
    """Read what there is. Raises ReportError when that is nothing, other BadInput when a file is broken."""
    if not folder.is_dir():
        what = "a file, expected the folder that a calibration was made in" if folder.exists() else "no such folder"
        raise ReportError(f"{folder}: {what}")
    if not (folder / MACHINE).is_file():
        raise ReportError(f"{folder}: holds no {MACHINE}, expected a folder that a calibration was made in")
    machine = load_machine(folder / MACHINE)
    sources = [Source(MACHINE, machine.sha256, f"machine '{machine.name}', {many(machine.n, 'joint')}")]
    missing: list[Missing] = []
    calibration = _calibration(folder, machine, sources, missing)
    recordings: dict[str, Recording] = {}
    paths = {stem: _recording_path(folder, stem, calibration) for stem in RECORDINGS}
    unasked = PLAIN if any(paths[stem] for stem in IN_TWO) else IN_TWO
    if paths["verification_extended"] and paths["verification_compensated"] and not paths["verification_base"]:
        unasked = ("verification_base",)  # that is what is called compensated then
    for stem, shows in RECORDINGS.items():
        path = paths[stem]
        if path is None and stem in unasked:
            continue
        if path is None:
            missing.append(Missing(f"{stem}.db", "not in the folder", shows))
        elif _is_empty(path):
            missing.append(Missing(path.name, "holds no visit yet", shows))
        else:
            recordings[stem] = load_recording(path, machine)
            sources.append(_recording_source(path, recordings[stem]))
    result, result_name, answered = _result(folder, sources)
    diagnosis = _diagnosis(folder, sources)
    if calibration is None and not recordings and not result and not diagnosis:
        names = ", ".join([CALIBRATION, *(f"{stem}.db" for stem in RECORDINGS), RESULT, DIAGNOSIS])
        raise ReportError(f"{folder}: nothing to report on beside {MACHINE}, expected any of {names}")
    point = _point(machine, recordings)
    return Contents(
        folder, machine, point, calibration, recordings, result, result_name, answered, diagnosis, tuple(sources),
        tuple(missing),
    )  # fmt: skip


def _calibration(folder: Path, machine: Machine, sources: list[Source], missing: list[Missing]) -> Calibration | None:
    path = folder / CALIBRATION
    if not path.exists():
        missing.append(Missing(CALIBRATION, "not in the folder", "the identified functions and where they are valid"))
        return None
    calibration = load_calibration(path, machine)
    about = f"calibration, method '{calibration.provenance.get('method', 'unknown')}'"
    sources.append(Source(CALIBRATION, file_hash(path), about))
    if (more := folder / EXTENDED).is_file():
        found = ", ".join(effect.name for effect in load_calibration(more, machine).effects)
        sources.append(Source(EXTENDED, file_hash(more), f"calibration with what was found: {found or 'nothing'}"))
    return calibration


def _recording_path(folder: Path, stem: str, calibration: Calibration | None) -> Path | None:
    """stem.db or stem.csv; the identification recording may also have the name that the calibration knows it by."""
    names = [f"{stem}.db", f"{stem}.csv"]
    if stem == "campaign" and calibration is not None and "recording" in calibration.provenance:
        names.append(Path(str(calibration.provenance["recording"])).name)
    return next((folder / name for name in names if (folder / name).is_file()), None)


def _is_empty(path: Path) -> bool:
    """A campaign that has only begun: its file is whole, but without a visit."""
    if path.stat().st_size == 0 or not is_sqlite(path):
        return False
    with RecordingFile.open(path, readonly=True) as file:
        return not file.table()[1]


def _recording_source(path: Path, recording: Recording) -> Source:
    about = many(len(recording), "visit")
    if not is_sqlite(path):
        return Source(path.name, recording.sha256, about, len(recording))
    with RecordingFile.open(path, readonly=True) as file:
        meta, events = file.meta(), file.events()
    devices: dict[str, dict[str, str]] = {}
    for _, kind, _, data in events:
        if kind == "start":
            devices |= {str(d.get("device")): {k: str(v) for k, v in d.items()} for d in data.get("devices", [])}
    if name := meta.get("campaign_name"):
        about += f" of campaign '{name}'"
    return Source(path.name, recording.sha256, about, len(recording), meta, tuple(devices.values()))


def _result(folder: Path, sources: list[Source]) -> tuple[dict[str, Any], str, dict[str, Any] | None]:
    """Figures that the run printed, their file, and all of the file where it is of a demo with a concealed effect."""
    path = folder / RESULT
    if not path.is_file() and (folder / CONCEALED).is_file():
        path = folder / CONCEALED
    if not path.is_file():
        return {}, "", None
    found = _json(path)
    if not isinstance(found, dict):
        raise ReportError(f"{path}: expected an object with the run's figures, found {type(found).__name__}")
    answer = found if path.name == CONCEALED else None
    if answer is not None:
        try:
            found = concealed.result_of(answer)
            for words in (concealed.facts, concealed.of_the_instrument):  # once before it is believed
                words(answer)
        except (KeyError, TypeError, ValueError, AttributeError) as exc:
            raise ReportError(f"{path}: no answer of a demo with a concealed effect: {_what_is_wrong(exc)}") from None
    sources.append(Source(path.name, file_hash(path), "figures that the run printed"))
    return found, path.name, answer


def _json(path: Path) -> Any:
    """Raises ReportError where it is none; NaN and what is too large for a number are no JSON either."""
    try:
        return json.loads(path.read_text(encoding="utf-8"), parse_constant=_finite, parse_float=_finite)
    except (ValueError, RecursionError) as exc:
        raise ReportError(f"{path}: not valid JSON, or cut off ({exc})") from None


def _finite(text: str) -> float:
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{text} is no finite number")
    return value


def _what_is_wrong(exc: Exception) -> str:
    return f"'{exc.args[0]}' is missing" if isinstance(exc, KeyError) else str(exc)


VERDICTS = ("consistent", "missing_physics", "unexplained")


def _diagnosis(folder: Path, sources: list[Source]) -> dict[str, Any] | None:
    """What a diagnosis in the folder answered, None without one. Raises ReportError where it is broken."""
    path = folder / DIAGNOSIS
    if not path.is_file():
        return None
    found = _json(path)
    lacking = {"verdict", "findings", "held_out", "noise_floor_mm"} - set(found if isinstance(found, dict) else ())
    if lacking:
        raise ReportError(f"{path}: no answer of a diagnosis, without {', '.join(sorted(lacking))}")
    try:
        _look_at(found)
    except (KeyError, TypeError, ValueError, AttributeError) as exc:
        raise ReportError(f"{path}: no answer of a diagnosis: {_what_is_wrong(exc)}") from None
    sources.append(Source(path.name, file_hash(path), "what a diagnosis answered"))
    return dict(found)


def _look_at(answer: dict[str, Any]) -> None:
    """What the page takes from an answer, once before it is believed."""
    if answer["verdict"] not in VERDICTS:
        raise ValueError(f"verdict {answer['verdict']!r:.40}, expected {', '.join(VERDICTS)}")
    for part, kind, said in (
        (answer["held_out"], dict, "an object"), (answer["findings"], list, "a list"),
        (answer.get("corrections", []), list, "a list"), (answer.get("unexplained") or {}, dict, "an object"),
        ((answer.get("unexplained") or {"covariates": []})["covariates"], list, "a list"),
    ):  # fmt: skip
        if not isinstance(part, kind):
            raise ValueError(f"{part!r:.40} where {said} is expected")
    numbers = [answer["noise_floor_mm"], answer.get("serial_correlation", 0.0)]
    numbers += [answer["held_out"][f"rms_{when}_mm"] for when in ("before", "after")]
    texts = [item["sentence"] for item in (*answer["findings"], *answer.get("corrections", ()))]
    if left := answer.get("unexplained"):
        texts += left["covariates"]
    if checks := answer.get("checks"):
        made = [*checks["before"], *checks["after"]]
        numbers += [c["p"] for c in made]
        texts += [c["about"] for c in made]
        texts += [c["where"] for c in made if c["where"]]
    if strange := [x for x in numbers if not isinstance(x, (int, float)) or isinstance(x, bool)]:
        raise ValueError(f"{strange[0]!r:.40} where a number is expected")
    if strange := [x for x in texts if not isinstance(x, str) or not x]:
        raise ValueError(f"{strange[0]!r:.40} where a text is expected")


def _point(machine: Machine, recordings: dict[str, Recording]) -> str:
    """The treatment point; on a machine without one the first point, else the first target, that was measured."""
    if "treatment" in machine.points:
        return "treatment"
    checks = [recordings[k] for k in (*IN_TWO, *PLAIN, "verification_nominal") if k in recordings]
    candidates = [*machine.points, *machine.targets]
    return next((p for p in candidates for r in checks if p in _measured(r)), candidates[0])


def _measured(recording: Recording) -> Iterator[str]:
    yield from (name for name, readings in recording.extra_points.items() if np.isfinite(readings).any())
    yield from (name for name, seen in zip(recording.target_names, recording.seen.T, strict=True) if seen.any())
