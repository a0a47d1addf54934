"""A folder → report.html: one page that needs nothing else, written whole or not at all."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from ppshw.diagnosis import serial
from ppshw.diagnosis.checks import sentence
from ppshw.errors import ReportError
from ppshw.quantities import many
from ppshw.report import figures, functions, tables
from ppshw.report.contents import Contents, read_folder
from ppshw.report.numbers import Fit, Numbers, compute, fit
from ppshw.report.picture import BEFORE, Picture
from ppshw.report.tables import mm, timed
from ppshw.whole_file import write_text

NAME = "report.html"
# What a run's own figures file may say beside the contract's keys is shown as it stands; these are in the table.
SHOWN = ("uncompensated", "base", "compensated", "extended", "repeatability_mm", "visits", "readings", "seconds")


@dataclass(frozen=True)
class Section:
    """A heading, a sentence below it, and pictures side by side; `narrow` ones stand three in a row."""

    title: str
    text: str
    pictures: list[Picture]
    narrow: bool = False


def build_report(folder: Path | str, now: datetime | None = None) -> Path:
    """Write folder/report.html from what the folder holds and return its path.

    Raises ReportError when there is nothing to report on, other BadInput when a file in the folder is broken.
    """
    folder = Path(folder)
    contents = read_folder(folder)
    text = render(contents, now or datetime.now(UTC))
    path = folder / NAME
    write_text(path, text, ReportError)
    return path


def render(contents: Contents, now: datetime) -> str:
    """The report as HTML that needs nothing else: style and pictures are inside. now: aware, said on the page as UTC.

    Raises BadInput where a recording does not go with the calibration.
    """
    numbers = compute(contents)
    campaign, calibration = contents.recordings.get("campaign"), contents.calibration
    left = None
    if campaign is not None and calibration is not None and campaign.seen.any():
        left = fit(campaign, calibration)
    environment = Environment(
        loader=PackageLoader("ppshw.report", ""), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    drawn, quiet = ([], []) if calibration is None else functions.pictures(calibration)
    constants, unclear = ([], 0) if calibration is None else functions.constant_compliances(calibration)
    return environment.get_template("page.html.j2").render(
        machine=contents.machine,
        point=contents.point,
        now=now,
        measured=_measured_span(contents),
        sites=sorted({source.meta["site_name"] for source in contents.sources if "site_name" in source.meta}),
        headline=headline(contents, numbers),
        diagnosis=_diagnosed(contents),
        accuracy=numbers.accuracy,
        rows=tables.ROWS,
        used=tables.measurements(contents),
        facts=tables.facts(contents, numbers, left),
        repeatability=numbers.repeatability,
        notes=numbers.notes,
        missing=(*contents.missing, *numbers.missing),
        sections=_sections(contents, numbers, left),
        functions=drawn,
        quiet=quiet,
        constants=constants,
        unclear=unclear,
        joints=tables.joint_ranges(contents),
        payload=tables.payload_ranges(contents),
        temperatures=tables.temperature_ranges(contents),
        sources=contents.sources,
        devices=tables.devices(contents),
        provenance=tables.provenance(contents),
        extra=[(k, tables.plain(v)) for k, v in contents.result.items() if k not in SHOWN and not isinstance(v, dict)],
        result_name=contents.result_name,
    )


def headline(contents: Contents, numbers: Numbers) -> str:
    """One sentence with the numbers that matter, of those that there are."""
    before, after = numbers.accuracy.get("uncompensated"), numbers.accuracy.get(numbers.best)
    base = numbers.accuracy.get("base") or (numbers.accuracy.get("compensated", {}) if numbers.extended else {})
    again = numbers.repeatability
    end = f", with a repeatability of {mm(again['p98_6_mm'])}." if again else "."
    at = f"at the point ‘{contents.point}’"
    if before and after and "p98_6_mm" in before and "p98_6_mm" in after:
        factor = before["p98_6_mm"] / after["p98_6_mm"] if after["p98_6_mm"] > 0 else math.inf
        visits = f" on {after['visits']:.0f} configurations" if "visits" in after else ""
        on = f"{visits} that the identification did not use" if visits and numbers.unseen else visits
        with_it = ", with what the diagnosis found" if numbers.extended else ""
        alone, worse = "", ""
        if "p98_6_mm" in base:
            alone = f" ({mm(base['p98_6_mm'])} with the base calibration alone)"
            if base["p98_6_mm"] < after["p98_6_mm"]:
                worse = " With what the diagnosis found it is worse: use the base calibration."
        if factor < 1.0:
            return (
                f"Compensation makes it worse: 98.6 % of the errors {at} are within {mm(before['p98_6_mm'])} without "
                f"and within {mm(after['p98_6_mm'])} with it{with_it}{alone}{on}{end}{worse}"
            )
        times = f"{factor:.0f}" if factor >= 10 else f"{factor:.1f}"
        return (
            f"Compensation brings 98.6 % of the errors {at} from within {mm(before['p98_6_mm'])} to within "
            f"{mm(after['p98_6_mm'])}{with_it}{alone}, a factor of {times}{on}{end}{worse}"
        )
    one = after or before
    if one and "p98_6_mm" in one:
        how = "With" if after else "Without"
        return f"{how} compensation, 98.6 % of the errors {at} are within {mm(one['p98_6_mm'])}{end}"
    if again:
        return f"The machine comes back {at} within {mm(again['p98_6_mm'])} (98.6 % of the visits)."
    if contents.calibration is not None:
        made = contents.calibration.provenance
        return f"Calibrated from {many(made.get('visits_used', 0), 'visit')}; nothing here has verified it {at} yet."
    return f"Nothing has been identified or verified {at} yet."


def _diagnosed(contents: Contents) -> list[str]:
    """What a diagnosis in the folder says, in sentences; empty without one."""
    answer = contents.diagnosis
    if answer is None:
        return []
    held, checks = answer["held_out"], answer.get("checks")
    out = [f"Verdict: {str(answer['verdict']).replace('_', ' ')}."]
    out += [f"{f['sentence'][0].upper()}{f['sentence'][1:]}" for f in answer["findings"]]
    if left := answer.get("unexplained"):
        out.append(f"Structure over {' and '.join(left['covariates'])} is left that no known effect explains.")
    out += [f"{c['sentence'][0].upper()}{c['sentence'][1:]}" for c in answer.get("corrections", ())]
    out.append(
        f"On visits that the fit never saw, readings miss by {mm(held['rms_before_mm'])} rms before and "
        f"{mm(held['rms_after_mm'])} after; noise alone makes {mm(answer['noise_floor_mm'])}."
    )
    if remembers := serial.sentence(answer):
        out.append(f"{remembers[0].upper()}{remembers[1:]}.")
    if checks:
        out.append(f"By the base model the recording is {sentence(checks['before'])}.")
        if answer["findings"] or left:
            out.append(f"With what was found it is {sentence(checks['after'])}.")
    return out


def _sections(contents: Contents, numbers: Numbers, left: Fit | None) -> list[Section]:
    before, after = numbers.errors.get("uncompensated"), numbers.errors.get(numbers.best)
    out: list[Section] = []
    if before is not None or after is not None:
        marks = "with findings" if numbers.extended else "compensated"
        planes = [figures.error_plane(before, after, contents.point, p, False, marks) for p in ((0, 1), (1, 2))]
        if after is not None:
            planes += [figures.error_plane(None, after, contents.point, p, True, marks) for p in ((0, 1), (1, 2))]
        out.append(Section(
            f"Errors at ‘{contents.point}’",
            "Measured minus wanted position of the point, in the base frame, one mark per visit "
            "(the paper’s figure 10; its specification is a radius of 0.5 mm).",
            planes,
        ))  # fmt: skip
        spread = []
        if after is not None:
            spread.append(figures.radial_distribution(after, f"Distribution of the residual errors, {marks}", "visits"))
        if before is not None:
            spread.append(figures.radial_distribution(
                before, "Distribution of the errors without compensation", "visits", BEFORE, limit=False
            ))  # fmt: skip
        out.append(Section(
            "How the errors are distributed", "The length of the error vector (the paper’s figures 11 and 14).", spread
        ))  # fmt: skip
    if numbers.returns is not None and numbers.repeatability is not None:
        sigma = numbers.repeatability["sigma_mm"]
        out.append(Section(
            "Repeatability", _repeatability_text(numbers.repeatability),
            [figures.axis_distribution(numbers.returns.deviation, k, sigma[k]) for k in range(3)], True,
        ))  # fmt: skip
    campaign = contents.recordings.get("campaign")
    if campaign is not None and left is not None:
        out.append(Section(
            "The identification recording", "What the model leaves of the visits that it was identified from.",
            [figures.residual_course(campaign.time, left.size_mm, left.outlier, left.lost),
             figures.radial_distribution(left.errors, "Residual of every reading", "readings", limit=False)],
        ))  # fmt: skip
    if campaign is not None:
        out.append(Section(
            "Coverage of the joints", "Where the visits of the identification recording stood; dashed: the limits.",
            [figures.coverage(j, campaign.q[:, k]) for k, j in enumerate(contents.machine.joints)], True,
        ))  # fmt: skip
    return out


def _repeatability_text(again: dict[str, Any]) -> str:
    return (
        f"{many(again['visits'], 'visit')} of {again['poses']} poses and loads, each about the mean of its own "
        f"(the paper’s figure 13). 98.6 % of the visits come back within {mm(again['p98_6_mm'])} of it: that is what "
        f"this page calls repeatability, our definition, with deviations widened by √(n/(n−1)) for the mean’s own "
        f"share. ISO 9283’s RP = mean + 3σ of the distance, averaged over the poses, is {mm(again['rp_iso9283_mm'])}. "
        f"The tracker’s noise is part of both."
    )


def _measured_span(contents: Contents) -> str:
    timed_ones = [r.time for r in contents.recordings.values() if timed(r)]
    times = [t for time in timed_ones for t in (time.min(), time.max())]
    if not times:
        return ""
    first, last = (datetime.fromtimestamp(float(t), UTC).date().isoformat() for t in (min(times), max(times)))
    return first if first == last else f"{first} to {last}"
