"""One page about a diagnosis: what was found and how sure, and the pictures that show where it sits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray

from ppshw.diagnosis import Diagnosis, serial
from ppshw.diagnosis.checks import ODD, check, sentence
from ppshw.diagnosis.found import Found
from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.locate import Channel, Map, gradients
from ppshw.diagnosis.parameters import is_of
from ppshw.diagnosis.replicas import Compared, of_space
from ppshw.diagnosis.visibility import NEVER, is_told_apart
from ppshw.diagnosis.wording import how_rare, listed, plan_options, stand_ins, to_separate
from ppshw.diagnosis.workspace import Workspace
from ppshw.errors import ReportError
from ppshw.quantities import called, value_of
from ppshw.report import residuals
from ppshw.report.picture import Picture
from ppshw.terms.shapes import Context, named_column
from ppshw.whole_file import write_text

Array = NDArray[np.float64]
VERDICTS = {
    "consistent": "The model describes this recording: nothing is missing beyond noise.",
    "missing_physics": "The model leaves something out, and what it is has names.",
    "unexplained": "The model leaves something out that no known effect explains.",
}
OF_THE_RECORDING = frozenset({"column_mistake", "outliers", "unsettled"})  # no physics that the model leaves out
ONLY_THESE = (
    "Some of this recording is wrong, as said below; the model describes the rest: nothing is missing beyond noise."
)
HARDLY = 1.01  # structure without a name that takes less of the residual than this has no picture, unless it is all
MOST_ROWS = 60  # of the table of what can be seen
FOLDED = ", within its period"


@dataclass(frozen=True)
class Shown:
    """One finding: what is said of it, its size with and without it, and its picture."""

    title: str
    said: dict[str, Any] | None
    without_mm: float
    with_mm: float
    rows: list[tuple[str, str]]
    picture: Picture


def write_diagnosis(
    diagnosis: Diagnosis, path: Path, warnings: Sequence[str] = (), now: datetime | None = None
) -> None:  # fmt: skip
    """Write the page, whole or not at all, with what is odd about the recording. Raises ReportError where it cannot be
    written."""
    text = render(diagnosis, now or datetime.now(UTC), warnings)
    write_text(path, text, ReportError)


def render(diagnosis: Diagnosis, now: datetime, warnings: Sequence[str] = ()) -> str:
    """The page as HTML that needs nothing else: style and pictures are inside. now: aware, said on the page as UTC."""
    answer, space = diagnosis.answer, diagnosis.space
    units = {f"q_{j.name}{part}": j.unit for j in space.machine.joints for part in ("", FOLDED)}
    compared = of_space(space, found=False)
    located = check(compared)[1]
    environment = Environment(
        loader=PackageLoader("ppshw.report", ""), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    return environment.get_template("diagnosis.html.j2").render(
        machine=space.machine,
        recording=Path(space.recording.source).name,
        sha256=space.recording.sha256,
        now=now,
        answer=answer,
        verdict=_verdict(answer),
        map=residuals.strength_map(located),
        located=_said(located),
        dependences=_dependences(compared, located, units),
        findings=_findings(diagnosis, located, units),
        others=[f for f in answer["findings"] if f["effect"] in ("outliers", "unsettled")],
        visible=sorted(answer["visibility"], key=lambda r: r["detectable_mm"])[:MOST_ROWS],
        checks=_checks(answer["checks"]),
        checks_picture=residuals.checks_picture(answer["checks"]["before"], answer["checks"]["after"]),
        said={when: sentence(answer["checks"][when]) for when in ("before", "after")},
        remembers=serial.sentence(answer),
        warnings=warnings,
        odd=ODD,
        how_rare=how_rare,
    )


def _verdict(answer: dict[str, Any]) -> str:
    if answer["verdict"] == "missing_physics" and {f["effect"] for f in answer["findings"]} <= OF_THE_RECORDING:
        return ONLY_THESE
    return VERDICTS[answer["verdict"]]


def _said(located: Map) -> str:
    """What the map says, in words."""
    (row, column), *_ = located.strongest(1)
    where = located.channels[column]
    strength = float(located.strength[row, column])
    if strength <= located.threshold:
        return (
            f"No dependence stands out of the noise. The strongest of {located.strength.size} looked at, "
            f"{where.frame} {where.component} over {located.covariates[row].label}, is one that noise alone reaches in "
            f"{located.p:.0%} of recordings."
        )
    return (
        f"The residual depends most on {located.covariates[row].label}, read as {where.frame} {where.component}: "
        f"{strength:.1f} standard deviations above what noise gives, where one recording in twenty reaches "
        f"{located.threshold:.1f} anywhere in the map. No effect has been named to find this."
    )


def _dependences(compared: Compared, located: Map, units: dict[str, str]) -> list[Picture]:
    """Over the two columns that it depends on most; over time; and over the travel of the joint that stands out."""
    strongest = located.strongest(2)
    drawn = []
    for row, column in strongest:
        reading = residuals.read(compared, located.channels, column)
        drawn.append(residuals.dependence(reading, located.covariates[row], compared.context, units))
    reading = residuals.read(compared, located.channels, strongest[0][1])
    names = {n for row, _ in strongest for n in located.covariates[row].names if len(located.covariates[row].names) < 2}
    frame = reading.channel.frame
    joint = frame if f"q_{frame}" in units else compared.recording.joint_names[0]
    for name in ("time", f"q_{joint}"):
        if name not in names:
            drawn.append(residuals.over(reading, name, np.asarray(named_column(compared.context, name)), units))
    return drawn


def _findings(diagnosis: Diagnosis, located: Map, units: dict[str, str]) -> list[Shown]:
    if not diagnosis.found:
        return []
    space = diagnosis.space
    compared = of_space(space)
    gradient = gradients(compared)
    whole = _rms(space)
    out = []
    sizes = [_rms(space, f, candidate) for f, candidate in diagnosis.found]
    unnamed = [size for (_, k), size in zip(diagnosis.found, sizes, strict=True) if k.effect == "nameless"]
    for (f, candidate), without in zip(diagnosis.found, sizes, strict=True):
        if candidate.effect == "nameless" and without < min(HARDLY * whole, max(unnamed)):
            continue
        displaced = _displaced(space, f, candidate)[space.fit]
        which = _channel(compared, gradient, located.channels, candidate, displaced)
        reading = residuals.read(compared, located.channels, which, displaced)
        white = (compared.root @ displaced[..., None])[..., 0]
        fitted = (white * gradient[:, :, which]).sum(axis=1) / np.maximum(reading.weights, 1e-30) * 1e6
        x, label = _abscissa(compared.context, candidate)
        named = candidate.effect != "nameless"
        said = next((a for a in diagnosis.answer["findings"] if named and is_of(a, candidate)), None)
        title = f"{candidate.effect.replace('_', ' ') if named else 'Structure without a name'}"
        title += f", {candidate.joint}" if candidate.joint else ""
        picture = residuals.over(
            reading, label, x, units, fitted, f"Partial residual and fitted curve, {reading.channel.frame} "
            f"{reading.channel.component}",
        )  # fmt: skip
        rows = _rows(diagnosis, said) if named else _rows_of_unnamed(diagnosis, candidate)
        out.append(Shown(title, said, without, whole, rows, picture))
    return out


def _displaced(space: Workspace, f: Found, candidate: Candidate) -> Array:
    """(N, 3T) what a finding does to the targets [m]."""
    _, values = space.coefficients()
    mine = f.columns(candidate)
    return np.asarray(space.taken[:, :, mine] @ values[mine])


def _rms(space: Workspace, f: Found | None = None, candidate: Candidate | None = None) -> float:
    """rms of readings of the fit visits [mm]; with a finding given, as it is when all but that one are fitted."""
    if f is not None and candidate is not None:
        keep = np.ones(len(space.taken_prior), dtype=bool)
        keep[f.columns(candidate)] = False
        space = space.keeping(keep)
    left = space.residual()[space.fit].reshape(-1, 3)
    return float(np.sqrt(np.nanmean(np.where(np.isfinite(left).all(axis=1), (left**2).sum(axis=1), np.nan))) * 1e3)


def _channel(
    compared: Compared, gradient: Array, channels: tuple[Channel, ...], candidate: Candidate, displaced: Array
) -> int:  # fmt: skip
    """The component that shows most of what a finding does."""
    first = candidate.columns[0]
    frame = first.frame if first.on == "frame" or first.function == "unexplained" else None
    allowed = residuals.components_of(channels, frame, candidate.component)
    if first.on == "points":  # of the distances between reflectors too
        allowed = list(range(len(channels)))
    white = (compared.root @ displaced[..., None])[..., 0]
    score = np.einsum("ni,nic->nc", white, gradient[:, :, allowed])
    size = (score**2 / np.maximum((gradient[:, :, allowed] ** 2).sum(axis=1), 1e-30)).sum(axis=0)
    return allowed[int(np.argmax(size))]


def _abscissa(c: Context, candidate: Candidate) -> tuple[Array, str]:
    if (period := candidate.shape.get("period")) is not None:  # folded: over a travel it is a cloud
        return named_column(c, candidate.covariate) % period, candidate.covariate + FOLDED
    for name in (candidate.covariate, *candidate.covariates):
        try:
            return np.asarray(named_column(c, name), dtype=float), name
        except (KeyError, ValueError):
            continue  # not every covariate of a finding is a column: a reflector
    return np.asarray(c.hours), "time"


def _rows(diagnosis: Diagnosis, said: dict[str, Any] | None) -> list[tuple[str, str]]:
    if said is None:
        return []
    rows = [("p, family-wise", how_rare(said["p_value"])), ("weight of the name", f"{said['weight']:.3f}")]
    rows += [(name.replace("_", " "), value_of(p)) for name, p in said["parameters"].items()][:8]
    others = [f"{_whose(a)} ({a['weight']:.3f})" for a in said["alternatives"]]
    rows.append(("could also be", ", ".join(others) or "nothing above 1 %"))
    close = [a for a in said["aliases"] if not is_told_apart(a)]
    far = [f"{_whose(a)} ({a['sqrt_lambda_apart']:.0f} σ apart)" for a in said["aliases"] if is_told_apart(a)]
    rows.append(("not to be told from", ", ".join(map(_whose, close)) or "nothing here"))
    rows += [("nearly like it", ", ".join(far))] if far else []
    if apart := to_separate(said):
        rows.append(("visits to tell them apart", f"ppshw plan --after … {plan_options(*apart)}"))
    seen = [r for r in diagnosis.answer["visibility"] if r["effect"] == said["effect"] and r["joint"] == said["joint"]]
    for r in seen[:1]:
        size = r["detectable_mm"]
        found = f"found from {size:.3f} mm rms on" if size < 1e3 * NEVER else "not found at any size"
        rows.append(("visible share", f"{100 * r['share']:.1f} %; {found}"))
    return rows


def _rows_of_unnamed(diagnosis: Diagnosis, candidate: Candidate) -> list[tuple[str, str]]:
    by = stand_ins(diagnosis.space.context, candidate)
    rows = [("depends on", listed(by))]
    columns = {column for column, _ in by}
    for c in diagnosis.answer.get("corrections", []):
        if columns & set(c["covariates"]):
            process = f"a Gaussian process of {' and '.join(c['length'])}"
            how = process if c["length"] else "it was; its waves fade beyond the end"
            where = " ".join(filter(None, (c["frame"], ", ".join(c["components"]))))
            rows.append(("carried as", f"{how}: {where}"))
    return rows if len(rows) > 1 else [*rows, ("carried", "not by a calibration")]


def _whose(name: dict[str, Any]) -> str:
    """An effect and its joint, as a finding's alternatives and aliases are given."""
    return called(name["effect"], name["joint"])


def _checks(checks: dict[str, list[dict[str, Any]]]) -> list[tuple[dict[str, Any], dict[str, Any] | None]]:
    after = {c["name"]: c for c in checks["after"]}
    return [(c, after.get(c["name"])) for c in checks["before"]]
