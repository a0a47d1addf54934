"""The report's tables: what was measured, where the calibration is valid, what everything was made with."""

from __future__ import annotations

import json
import math
import platform
from importlib.metadata import version
from typing import Any

import numpy as np

from ppshw import __version__
from ppshw.calibration import MOST_POSITIONS
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.quantities import many
from ppshw.recording import Recording
from ppshw.report import concealed
from ppshw.report.contents import Contents
from ppshw.report.numbers import Fit, Numbers

NAMES = {
    "campaign": "Identification",
    "verification_nominal": "Verification, uncompensated",
    "verification_base": "Verification, base calibration",
    "verification_compensated": "Verification, compensated",
    "verification_extended": "Verification, with findings",
    "repeatability": "Repeatability",
}
# Rows of the table of errors: of all others the case is the name.
ROWS = {"base": "base calibration", "extended": "with findings"}
# What a recording says of how it was made: key in the file → words.
META = {
    "versions": "Versions",
    "campaign_sha256": "Campaign script",
    "setpoints": "Setpoints",
    "site_name": "Site",
    "site_sha256": "Site file",
}


def mm(value: float) -> str:
    """A length given in mm, with its unit, that does not break over a line: two decimals from 1 mm on, else three."""
    digits = 2 if value >= 1 else 3
    return f"{value:.{digits}f}\N{NO-BREAK SPACE}mm"


def measurements(contents: Contents) -> list[tuple[str, ...]]:
    """Per recording: name, visits, readings, and the time between its first and last visit."""
    out: list[tuple[str, ...]] = []
    for stem, recording in contents.recordings.items():
        extra = [np.isfinite(p).all(axis=1).sum() for p in recording.extra_points.values()]
        readings = int(recording.seen.sum()) + int(sum(extra))
        span = float(np.ptp(recording.time)) if timed(recording) else 0.0
        out.append((NAMES[stem], str(len(recording)), str(readings), duration(span) if span > 0 else "–"))
    if contents.calibration is not None and "campaign" not in contents.recordings:
        made = contents.calibration.provenance
        out.insert(0, ("Identification", str(made.get("visits_used", "–")), str(made.get("readings", "–")), "–"))
    return out


def facts(contents: Contents, numbers: Numbers, left: Fit | None) -> list[tuple[str, str]]:
    """Rows of what else is worth a line: repeatability, outliers, what the run says of itself."""
    out: list[tuple[str, str]] = []
    again, result, claimed = numbers.repeatability, contents.result, contents.machine.repeatability
    if again:
        text = f"{mm(again['p98_6_mm'])} (98.6 %)"
        text += f"; ISO 9283 RP {mm(again['rp_iso9283_mm'])}" if "rp_iso9283_mm" in again else ""
        text += f"; the maker claims {mm(claimed * 1e3)}" if claimed else ""
        out.append(("Repeatability", text))
    if left is not None:
        out.append(
            ("Outliers", f"{int(left.outlier.sum())} of {many(len(left.outlier), 'visit')} of the identification")
        )
    counts = [f"{plain(result[k])} {k}" for k in ("visits", "readings") if k in result]
    if counts and "campaign" not in contents.recordings:
        out.append(("Measurements", f"{', '.join(counts)}, as {contents.result_name} says"))
    if contents.concealed is not None:
        out += concealed.facts(contents.concealed)
    if isinstance(result.get("seconds"), int | float):
        out.append(("Run time", duration(float(result["seconds"]))))
    return out


def joint_ranges(contents: Contents) -> list[dict[str, str]]:
    """Per joint, in the machine's order: name, and as text in m, or rad and degrees, `valid` (where the calibration was
    identified), `limits` (of the machine file) and `positions` (how many were sampled). Empty without a calibration.
    """
    if contents.calibration is None:
        return []
    out = []
    for k, joint in enumerate(contents.machine.joints):
        low, high = contents.calibration.joint_range[k]
        limits = "–" if joint.limits is None else _range(joint.limits.lower, joint.limits.upper, joint.prismatic)
        out.append({
            "name": joint.name, "valid": _range(low, high, joint.prismatic), "limits": limits,
            "positions": _positions(contents, k, joint.name),
        })  # fmt: skip
    return out


def _positions(contents: Contents, k: int, joint: str) -> str:
    """How many positions were sampled. A calibration lists up to MOST_POSITIONS and gives the ends of more."""
    assert contents.calibration is not None
    campaign = contents.recordings.get("campaign")
    if campaign is not None and campaign.sha256 == contents.calibration.provenance.get("recording_sha256"):
        return str(len(np.unique(np.round(campaign.q[:, k], 4))))
    listed = len(contents.calibration.sampled.get(joint, []))
    return str(listed) if listed != 2 else f"2, or more than {MOST_POSITIONS}"


def payload_ranges(contents: Contents) -> list[tuple[str, str]]:
    """Per component of the wrench on the sensor, sensor frame: its name and from where to where it was identified, in N
    or N m. Empty without a calibration.
    """
    if contents.calibration is None:
        return []
    units = ["N"] * 3 + ["N m"] * 3
    return [
        (name, f"{low:.1f} … {high:.1f} {unit}".replace("-", "−"))
        for name, unit, (low, high) in zip(WRENCH_COMPONENTS, units, contents.calibration.payload_range, strict=True)
    ]


def temperature_ranges(contents: Contents) -> list[tuple[str, str]]:
    """Per place: its name and from where to where it was while measured, in °C. Empty without a calibration."""
    if contents.calibration is None:
        return []
    return [(place, f"{low:.1f} … {high:.1f} °C".replace("-", "−"))
            for place, (low, high) in contents.calibration.temperature_range.items()]  # fmt: skip


def provenance(contents: Contents) -> list[tuple[str, str]]:
    """What made which file; what several files share is said once."""
    libraries = ", ".join(f"{n} {version(n)}" for n in ("numpy", "scipy", "matplotlib", "jinja2"))
    out = [("This report", f"ppshw {__version__}, Python {platform.python_version()}, {libraries}")]
    if contents.calibration is not None:
        made = contents.calibration.provenance
        said = [f"{k.replace('_', ' ')} {v}" for k, v in made.items() if "sha256" not in k]
        out.append(("Calibration", ", ".join(said)))
        out.append(("Calibration, from recording", str(made.get("recording_sha256", "unknown"))))
        noise = contents.calibration.noise
        pose = np.sqrt(np.diag(noise.pose)[:3]) * 1e3
        out.append((
            "Noise it found",
            f"instrument σ {noise.instrument * 1e3:.3f} mm per coordinate; end effector’s scatter about its origin "
            f"σ {pose[0]:.3f}, {pose[1]:.3f}, {pose[2]:.3f} mm along x, y, z",
        ))  # fmt: skip
    shared: dict[tuple[str, str], list[str]] = {}
    for source in contents.sources:
        for key in META:
            if key in source.meta:
                shared.setdefault((key, source.meta[key]), []).append(source.name)
    for (key, value), names in shared.items():
        out.append((f"{META[key]}, {', '.join(names)}", _versions(value) if key == "versions" else value))
    return out


def _versions(text: str) -> str:
    """As a run wrote them, an object of JSON; whatever else stands there as it stands."""
    try:
        return ", ".join(f"{library} {version}" for library, version in json.loads(text).items())
    except (ValueError, AttributeError):
        return text


def devices(contents: Contents) -> list[dict[str, str]]:
    """Every instrument and drive once, as it named itself when a campaign started."""
    found: dict[tuple[str, ...], dict[str, str]] = {}
    for source in contents.sources:
        for device in source.devices:
            row = {key: device.get(key, "") for key in ("device", "model", "serial", "firmware")}
            found.setdefault(tuple(row.values()), row)
    return list(found.values())


def timed(recording: Recording) -> bool:
    """Whether every visit has a time."""
    return bool(np.isfinite(recording.time).all())


def duration(seconds: float) -> str:
    """A time for the eye, that does not break over a line: seconds below two minutes, then minutes, then hours."""
    minutes = round(seconds / 60)
    text = f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"
    if seconds < 120:
        text = f"{seconds:.0f} s"
    return text.replace(" ", "\N{NO-BREAK SPACE}")


def plain(value: Any) -> str:
    """A value of a JSON file as text: texts as they are, the rest as JSON."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _range(low: float, high: float, prismatic: bool) -> str:
    if prismatic:
        return f"{low:.4f} … {high:.4f} m".replace("-", "−")
    return f"{low:.4f} … {high:.4f} rad ({math.degrees(low):.2f}° … {math.degrees(high):.2f}°)".replace("-", "−")
