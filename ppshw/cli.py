"""The command line: the composition root. One function per subcommand, nothing clever.

Exit codes: 0 success, 1 a failed run, 2 bad input. What went wrong is one line on stderr.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from tqdm import tqdm

from ppshw import __version__
from ppshw.errors import BadInput, PpshwError


class _Parser(argparse.ArgumentParser):
    """Complaints in one line, like every other."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


class _Bar:
    """A progress bar with time left for whatever takes longer than a second; quiet when nobody watches."""

    def __init__(self) -> None:
        self._bar: Any = None
        self._name = ""

    def __call__(self, name: str, done: int, total: int) -> None:
        if name != self._name:
            self.close()
            self._name = name
            self._bar = tqdm(total=total, desc=name.replace("_", " "), delay=1, disable=None, leave=False, ncols=79)
        self._bar.update(done - self._bar.n)

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None


def _say(arguments: argparse.Namespace, answer: dict[str, Any], text: str) -> None:
    print(json.dumps(answer, indent=1) if arguments.json else text)


# --- recordings ------------------------------------------------------------------------------------------------
def import_(a: argparse.Namespace) -> None:
    """import: CSV → SQLite, nothing written unless every value is good."""
    from ppshw.machine import load_machine
    from ppshw.recording import parse_table, read_table
    from ppshw.recording_file import RecordingFile

    machine = load_machine(a.machine)
    table = read_table(a.csv)
    recording = parse_table(table, machine)
    partial = Path(f"{a.out}.part")
    if Path(a.out).exists():
        raise BadInput(f"{a.out}: exists already, expected a new file")
    partial.unlink(missing_ok=True)
    meta = {
        "machine": Path(machine.file).read_text(encoding="utf-8"),
        "machine_name": machine.name,
        "machine_sha256": machine.sha256,
        "imported_from": Path(a.csv).name,
        "ppshw": __version__,
    }
    with RecordingFile.create(partial, table.header, meta) as file:
        file.append_rows(table.rows)
    os.replace(partial, a.out)
    readings = int(recording.seen.sum())
    answer = {"visits": len(recording), "readings": readings, "sha256": recording.sha256, "out": a.out}
    _say(a, answer, f"{a.out}: {len(recording)} visits, {readings} readings")


def export(a: argparse.Namespace) -> None:
    """export: SQLite → CSV, the same cells in the same order."""
    from ppshw.recording import read_table

    table = read_table(a.rec)
    _write_whole(Path(a.csv), table.csv_text())
    _say(a, {"visits": len(table.rows), "out": a.csv}, f"{a.csv}: {len(table.rows)} visits")


def _write_whole(path: Path, text: str) -> None:
    partial = path.with_name(path.name + ".part")
    partial.write_text(text, encoding="utf-8", newline="")
    os.replace(partial, path)


# --- the model side ----------------------------------------------------------------------------------------------
def identify(a: argparse.Namespace) -> None:
    import time

    from ppshw.calibration import Calibration
    from ppshw.evaluation import figures, residuals
    from ppshw.identification import identify as run
    from ppshw.machine import load_machine
    from ppshw.recording import load_recording

    machine = load_machine(a.machine)
    recording = load_recording(a.rec, machine)
    began = time.perf_counter()
    bar = _Bar()
    estimate = run(machine, recording, a.method, lambda k, n: bar("identify", k, n))
    bar.close()
    calibration = Calibration.of(estimate, recording, a.method)
    calibration.save(a.out)
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
        "outliers": calibration.provenance["visits_down_weighted"],
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
    _say(a, answer, text)


def evaluate(a: argparse.Namespace) -> None:
    from ppshw.calibration import load_calibration
    from ppshw.evaluation import evaluate as run
    from ppshw.machine import load_machine
    from ppshw.recording import load_recording

    machine = load_machine(a.machine)
    calibration = load_calibration(a.calibration, machine) if a.calibration else None
    answer = run(load_recording(a.rec, machine), machine, calibration)
    rows = [("nominal", answer["nominal"])] + ([("calibrated", answer)] if calibration else [])
    lines = [f"{answer['visits']} visits, {answer['readings']} readings [mm]", _FIGURE_HEAD]
    _say(a, answer, "\n".join([*lines, *(_figure_row(name, values) for name, values in rows)]))


_FIGURE_HEAD = f"{'':16}{'median':>10}{'rms':>10}{'95 %':>10}{'98.6 %':>10}{'max':>10}"


def _figure_row(name: str, values: dict[str, Any]) -> str:
    keys = ("median_mm", "rms_mm", "p95_mm", "p98_6_mm", "max_mm")
    return f"{name:16}" + "".join(f"{values[k]:10.3f}" for k in keys)


def _numbers(text: str, count: int, what: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    words = text.replace(",", " ").split()
    try:
        values = np.array([float(w) for w in words])
    except ValueError:
        raise BadInput(f"{what}: '{text}' holds something that is no number, expected {count} numbers") from None
    if len(values) != count or not np.isfinite(values).all():
        raise BadInput(f"{what}: '{text}' holds {len(values)} values, expected {count} finite numbers")
    return values


def _corrected(a: argparse.Namespace) -> tuple[Any, dict[str, Any], str]:
    """What `compensate` and `move` share: the wanted pose, corrected."""
    from ppshw.calibration import load_calibration
    from ppshw.compensation import Bounds, Compensator
    from ppshw.machine import load_machine
    from ppshw.transforms import from_xyz_rpy

    machine = load_machine(a.machine)
    compensator = Compensator(load_calibration(a.calibration, machine), Bounds(a.max_travel, a.max_angle))
    payload = _numbers(a.wrench, 6, "--wrench")
    if a.point not in ("tip", *machine.points, *machine.targets):
        raise BadInput(f"--point: no point named '{a.point}' in {a.machine}")
    if a.joints is not None:
        setpoints = compensator.for_joints(_numbers(a.joints, machine.n, "--joints"), payload, a.point)
    else:
        pose = _numbers(a.pose, 6, "--pose")
        near = None if a.near is None else _numbers(a.near, machine.n, "--near")
        setpoints = compensator.for_pose(from_xyz_rpy(pose[:3], pose[3:]), payload, a.point, near)
    names = machine.joint_names
    answer = {
        "setpoints": dict(zip(names, setpoints.corrected.tolist(), strict=True)),
        "nominal": dict(zip(names, setpoints.nominal.tolist(), strict=True)),
        "point": a.point,
        "predicted_error_mm": (setpoints.predicted_error * 1e3).tolist(),
        "std_mm": (setpoints.std * 1e3).tolist(),
        "warnings": [],
    }
    lines = [f"{'joint':16}{'nominal':>14}{'setpoint':>14}{'correction':>14}"]
    for k, joint in enumerate(machine.joints):
        nominal, corrected = setpoints.nominal[k], setpoints.corrected[k]
        lines.append(f"{joint.name:16}{nominal:14.6f}{corrected:14.6f}{corrected - nominal:+14.6f}  {joint.unit}")
    size = np.linalg.norm(setpoints.predicted_error) * 1e3
    std = np.linalg.norm(setpoints.std) * 1e3
    lines.append(f"{a.point}: {size:.3f} mm off without correction; the model is sure to {std:.3f} mm (1 sigma)")
    return machine, answer, "\n".join(lines)


def compensate(a: argparse.Namespace) -> None:
    _, answer, text = _corrected(a)
    _say(a, answer, text)


def move(a: argparse.Namespace) -> None:
    from campaigns.site import load_site, open_bench

    machine, answer, text = _corrected(a)
    site = load_site(a.site, machine)
    with open_bench(site) as bench:
        bench.axes.check()
        bench.axes.start()
        report = bench.axes.move(answer["setpoints"])
    answer["reached"] = dict(report.positions)
    _say(a, answer, f"{text}\nreached: " + ", ".join(f"{j} {x:.6f}" for j, x in report.positions.items()))


def report(a: argparse.Namespace) -> None:
    from ppshw.report import build_report

    page = build_report(Path(a.dir))
    _say(a, {"report": str(page)}, str(page))


# --- the bench side ----------------------------------------------------------------------------------------------
def plan(a: argparse.Namespace) -> None:
    from campaigns.plan import plan_campaign
    from campaigns.script import load_script
    from ppshw.machine import load_machine

    machine = load_machine(a.machine)
    found = plan_campaign(load_script(a.campaign), machine)
    summary = found.summary()
    answer: dict[str, Any] = summary.as_dict()
    lines = [
        f"{found.script.name} on {machine.name}: {summary.visits} visits, {summary.readings} readings, "
        f"{summary.load_changes} load changes, about {_hours(summary.duration_s)}",
        *(f"  {step:28}{count:6} visits" for step, count in summary.steps.items()),
    ]
    if a.list:
        names = machine.joint_names
        answer["plan"] = [
            {"index": v.index, "step": v.step, "load": v.load, "setpoints": dict(zip(names, v.setpoints, strict=True))}
            for v in found.visits
        ]
        for v in found.visits:
            lines.append(f"{v.index:5} {v.step:20} {v.load:12} " + " ".join(f"{x:9.4f}" for x in v.setpoints))
    _say(a, answer, "\n".join(lines))


def _hours(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{minutes} min"


def run(a: argparse.Namespace) -> None:
    from campaigns.plan import plan_campaign
    from campaigns.runner import run_campaign
    from campaigns.script import load_script
    from campaigns.site import load_site, open_bench

    site = load_site(a.site)
    found = plan_campaign(load_script(a.campaign), site.machine)
    correct, label = _setpoint_map(a, site.machine)
    bar = _Bar()
    with open_bench(site) as bench:
        result = run_campaign(
            found, bench, Path(a.out), site.make_operator(),
            setpoint_map=correct, map_label=label, progress=lambda p: bar("visits", p.done, p.total),
        )  # fmt: skip
    bar.close()
    answer = {"out": str(result.out), "measured": result.measured, "done": result.done, "planned": len(found.visits),
              "skipped": result.skipped, "lost_beams": result.lost_beams}  # fmt: skip
    _say(a, answer, f"{result.out}: {result.measured} visits measured now, {result.done} of {len(found.visits)} in all")


def _setpoint_map(a: argparse.Namespace, machine: Any) -> tuple[Callable[..., Any] | None, str]:
    """Compensated setpoints for a whole campaign, when a calibration is given."""
    if a.calibration is None:
        return None, "as planned"
    from ppshw.calibration import load_calibration
    from ppshw.compensation import Compensator

    calibration = load_calibration(a.calibration, machine)
    return Compensator(calibration).setpoint_map(), calibration.provenance["recording_sha256"]


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

    serve(a.machine, a.site_out, seed=a.seed, speed=a.speed, force_protocol=a.force_sensor)


def demo(a: argparse.Namespace) -> None:
    from ppshw.demo import run_demo

    bar = _Bar()
    answer = run_demo(Path(a.out), a.seed, Path(a.machine), a.method, bar)
    bar.close()
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
    _say(a, answer, text)


# --- arguments -----------------------------------------------------------------------------------------------------
def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="ppshw", description="Measure, identify and take out the errors of a large manipulator.")
    parser.add_argument("--version", action="version", version=f"ppshw {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)

    def add(name: str, function: Callable[[argparse.Namespace], None], about: str) -> argparse.ArgumentParser:
        found = commands.add_parser(name, help=about, description=about)
        found.add_argument("--json", action="store_true", help="print the answer as JSON")
        found.set_defaults(function=function)
        return found

    def machine(p: argparse.ArgumentParser) -> None:
        p.add_argument("--machine", required=True, metavar="M", help="machine file")

    p = add("demo", demo, "the main job on simulated hardware, from campaign to compensated verification")
    p.add_argument("--out", default="demo-out", metavar="DIR", help="where results go (default: demo-out)")
    p.add_argument("--seed", type=int, default=1, help="seed of the simulated machine (default: 1)")
    p.add_argument("--machine", default=str(default_machine()), metavar="M", help="default: the positioner")
    p.add_argument("--method", choices=("joint", "paper"), default="joint", help="identification (default: joint)")

    p = add("simulate", simulate, "simulated hardware as a process of its own, on endpoints that open like real ones")
    machine(p)
    p.add_argument("--site-out", required=True, metavar="S", help="site file to write, for check and run")
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--speed", type=float, default=1.0, help="how much faster than real time (default: 1)")
    p.add_argument("--force-sensor", choices=("bota", "gsv8"), default="bota")

    p = add("check", check, "connect to each device of a site and say who and how it is; moves nothing")
    p.add_argument("--site", required=True, metavar="S", help="site file")

    p = add("plan", plan, "expand a campaign, check it against limits, say how many visits and how long")
    p.add_argument("campaign", help="campaign script (a file, or the name of one that comes with ppshw)")
    machine(p)
    p.add_argument("--list", action="store_true", help="list every visit")

    p = add("run", run, "run a campaign; the same command again goes on where it stopped")
    p.add_argument("campaign", help="campaign script (a file, or the name of one that comes with ppshw)")
    p.add_argument("--site", required=True, metavar="S", help="site file")
    p.add_argument("--out", required=True, metavar="REC.db", help="the recording")
    p.add_argument("--calibration", metavar="CAL.json", help="drive compensated setpoints")

    p = add("import", import_, "interchange CSV → recording, lossless")
    p.add_argument("csv", metavar="CSV")
    machine(p)
    p.add_argument("--out", required=True, metavar="REC.db")

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
    p.add_argument("--calibration", metavar="CAL.json")

    for name, function, about in (
        ("compensate", compensate, "wanted pose and load → corrected joint setpoints; moves nothing"),
        ("move", move, "the same, and drives the axes there"),
    ):
        p = add(name, function, about)
        machine(p)
        p.add_argument("--calibration", required=True, metavar="CAL.json")
        wanted = p.add_mutually_exclusive_group(required=True)
        wanted.add_argument("--pose", metavar="'X Y Z R P Y'", help="of the point, in the base frame [m, rad]")
        wanted.add_argument("--joints", metavar="'Q1 … QN'", help="the pose the ideal machine has there [m, rad]")
        p.add_argument("--wrench", default="0 0 0 0 0 0", metavar="'FX … MZ'", help="payload on the sensor [N, N m]")
        p.add_argument("--point", default="tip", help="tip, or a point or target of the machine file (default: tip)")
        p.add_argument("--near", metavar="'Q1 … QN'", help="of several ways to reach the pose, the one nearest to this")
        p.add_argument("--max-travel", type=float, default=0.03, metavar="M", help="most it may correct (default 0.03)")
        p.add_argument("--max-angle", type=float, default=0.03, metavar="RAD", help="most it may correct (default 0.03)")
        if name == "move":
            p.add_argument("--site", required=True, metavar="S", help="site file")

    p = add("report", report, "one self-contained HTML page of what a folder holds")
    p.add_argument("dir", metavar="DIR")
    return parser


def default_machine() -> Path:
    """The positioner's machine file: in the checkout, or as it was installed."""
    return Path(__file__).resolve().parents[1] / "machines" / "pps.yaml"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    arguments = _parser().parse_args(argv)
    try:
        arguments.function(arguments)
    except PpshwError as error:
        return _complain(str(error), error.exit_code)
    except KeyboardInterrupt:
        return _complain("stopped", 1)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        return _complain(f"{error.filename or 'file'}: {error.strerror or error}", 2)
    except Exception as error:
        if os.environ.get("PPSHW_DEBUG"):
            raise
        return _complain(f"internal error: {type(error).__name__}: {error} (PPSHW_DEBUG=1 shows where)", 1)
    return 0


def _complain(message: str, code: int) -> int:
    print(f"ppshw: {' '.join(message.split())}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
