"""The bench side, at a site: run, check, station."""

from __future__ import annotations

import argparse
import math
import textwrap
from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path
from shutil import get_terminal_size
from typing import Any

from ppshw.cli.answers import new_recording, say, warn
from ppshw.cli.arguments import joint_values, machine_of, named_numbers
from ppshw.cli.setpoints import check_point, run_up, why_it_stays
from ppshw.errors import BadInput, HardwareError
from ppshw.file_lock import require_a_system_that_locks
from ppshw.progress import Bar, folded
from ppshw.quantities import many
from ppshw.whole_file import file_hash

NARROWEST = 16  # letters of a column that is wrapped
ANGLES = {"gon": math.pi / 200, "deg": math.pi / 180, "rad": 1.0}
FARTHEST = 1000.0  # m that a slope distance may be, before it looks like millimetres


def run(a: argparse.Namespace) -> None:
    require_a_system_that_locks()
    from campaigns.plan import plan_campaign
    from campaigns.runner import run_campaign
    from campaigns.script import load_script
    from campaigns.site import check_moves, load_site, open_bench
    from ppshw.recording_file import only_writer

    site = load_site(a.site)
    found = plan_campaign(load_script(a.campaign), site.machine)
    check_moves(found, site)
    correct, label, warnings = _setpoint_map(a, site, found)
    out = new_recording(a.out, a.site, site.machine.file)
    with only_writer(out), open_bench(site) as bench, Bar() as bar:
        result = run_campaign(
            found, bench, out, site.make_operator(),
            setpoint_map=correct, map_label=label, reset_faults=a.reset_faults,
            progress=lambda p: bar("visits", p.done, p.total, p.seconds_left / site.speed),
        )  # fmt: skip
    answer = {"out": str(result.out), "measured": result.measured, "done": result.done, "planned": len(found.visits),
              "skipped": result.skipped, "lost_beams": result.lost_beams}  # fmt: skip
    lines = [
        f"{result.out}: {many(result.measured, 'visit')} measured now, {result.done} of {len(found.visits)} in all"
    ]
    if correct is not None:
        answer |= {"compensated": correct.as_dicts(True), "not_compensated": correct.as_dicts(False)}
        answer["warnings"] = warnings
        lines += [f"{v.heading()}, {many(n, 'visit')}: {v.sentence()}" for v, n in correct.said]
        if (correct.position_first or correct.at_odds) and result.measured:
            off, turned = (correct.left * 1e3).tolist()
            answer |= {"most_left_mm": off, "most_left_mrad": turned}
            answer |= {"at_odds": correct.at_odds} if correct.at_odds else {}
            few = "the joints" if correct.position_first else None
            left = f"at most {off:.3f} mm and {turned:.3f} mrad stay"
            lines.append(f"{correct.point}: {left}, {why_it_stays(correct.at_odds, few)}")
    say(a, answer, folded(lines))


def _setpoint_map(a: argparse.Namespace, site: Any, plan: Any) -> tuple[Any, str, list[str]]:
    """Compensated setpoints for a whole campaign, when a calibration is given; refused here where they would be; and
    warnings of that calibration."""
    if a.calibration is None:
        for option in ("point", "after"):
            if getattr(a, option) is not None:
                raise BadInput(f"--{option}: has no meaning without --calibration")
        return None, "as planned", []
    if a.point is not None:
        check_point(a.point, site.machine)
    from campaigns.corrected import corrected_plan
    from campaigns.site import check_moves
    from ppshw.calibration import load_calibration
    from ppshw.compensation import Compensator, Corrections
    from ppshw.recording import load_recording

    compensator = Compensator(calibration := load_calibration(a.calibration, site.machine))
    last_way = run_up(site)
    warnings = calibration.doubts() + calibration.other_sides(last_way)
    if a.point is not None and not compensator.position_first:
        warnings.append("--point: these joints put the whole end-effector frame right, it changes nothing")
    if site.make_force_sensor is None and any(load.mass > 0 for load in plan.loads.values()):
        warnings.append("no force sensor at this site: setpoints are for what the script's loads weigh")
    warn(a.calibration, warnings)
    after = None if a.after is None else load_recording(a.after, site.machine)
    correct = Corrections(compensator, after, last_way, _so_far(Path(a.out), site.machine), a.point)
    correct.refuse_before(site.clock().utc().timestamp())
    with Bar() as bar:
        foreseen = corrected_plan(plan, compensator, last_way, correct.point, lambda k, n: bar("setpoints", k, n))
    check_moves(foreseen, site)
    return correct, file_hash(a.calibration), warnings


def _so_far(out: Path, machine: Any) -> Any:
    """The visits of a run that goes on; None of one that begins."""
    from ppshw.recording import load_recording
    from ppshw.recording_file import RecordingFile, is_sqlite

    if not out.is_file() or not is_sqlite(out):
        return None
    with RecordingFile.open(out, readonly=True) as file:
        begun = bool(file.done())
    return load_recording(out, machine, lost_at_all=True) if begun else None


def check(a: argparse.Namespace) -> None:
    require_a_system_that_locks()
    from campaigns.site import load_site, open_bench

    site = load_site(a.site)
    with open_bench(site) as bench:
        devices = bench.look()
        answer = {"site": site.name, "devices": [vars(d) for d in devices]}
        rows = [(d.device, d.model, d.serial, d.firmware, d.status or f"PROBLEM: {d.problem}") for d in devices]
        say(a, answer, _columns(rows, get_terminal_size().columns))
    if wrong := [d for d in devices if d.problem]:
        more = f" ({len(wrong) - 1} more of {len(devices)} devices have a problem)" if wrong[1:] else ""
        raise HardwareError(wrong[0].device, wrong[0].problem + more)


def station(a: argparse.Namespace) -> None:
    """station: what the site file's `tracker.pose` needs."""
    from scipy.spatial.transform import Rotation

    from campaigns.stationing import station as stationed

    machine = machine_of(a)
    q = joint_values(a.joints, machine, "--joints")
    read = {}
    for name, values in named_numbers(a.read, list(machine.targets), "--read", "target", "HZ,V,DISTANCE").items():
        hz, v, distance = float(values[0]) * ANGLES[a.angles], float(values[1]) * ANGLES[a.angles], float(values[2])
        if not 0.0 < v < math.pi:
            raise BadInput(
                f"--read {name}: vertical circle {values[1]:g} {a.angles}, expected 0 … {math.pi / ANGLES[a.angles]:g} "
                f"from the zenith, in the first face (--angles is {a.angles})"
            )
        if not 0.0 < distance < FARTHEST:
            raise BadInput(f"--read {name}: slope distance {distance:g} m, expected 0 … {FARTHEST:g} m")
        read[name] = (hz, v, distance)
    found = stationed(machine, q, read)
    xyz, rpy = found.pose[:3, 3], Rotation.from_matrix(found.pose[:3, :3]).as_euler("xyz")
    tilt = math.degrees(found.tilt)
    warn("station", found.warnings)
    answer = {
        "pose": {"xyz": xyz.tolist(), "rpy": rpy.tolist()},
        "left_mm": {name: 1e3 * left for name, left in found.left.items()}, "tilt_deg": tilt,
        "warnings": found.warnings,
    }  # fmt: skip
    at, turned = (", ".join(f"{x:.4f}" for x in each) for each in (xyz, rpy))
    lines = [
        f"pose: {{xyz: [{at}], rpy: [{turned}]}}",
        f"left: {', '.join(f'{name} {1e3 * left:.1f} mm' for name, left in found.left.items())}; the standing axis "
        f"{tilt:.2f}° from upright",
    ]
    say(a, answer, folded(lines))


def _columns(rows: Sequence[Sequence[str]], room: int) -> str:
    """Columns as wide as what is in them, two spaces between; the widest are wrapped where the room is not enough."""
    filled = [column for column in zip(*rows, strict=True) if any(column)]
    widths = [max(map(len, column)) for column in filled]
    while sum(widths) + 2 * (len(widths) - 1) > room and max(widths) > NARROWEST:
        widths[widths.index(max(widths))] -= 1
    lines = []
    for row in zip(*filled, strict=True):
        cells = [textwrap.wrap(cell, width, break_on_hyphens=False) for cell, width in zip(row, widths, strict=True)]
        for parts in zip_longest(*cells, fillvalue=""):
            lines.append("  ".join(part.ljust(width) for part, width in zip(parts, widths, strict=True)).rstrip())
    return "\n".join(lines)
