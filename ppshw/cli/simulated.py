"""Simulated hardware: simulate, demo."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from ppshw.cli.answers import FIGURE_HEAD, figure_row, new_file, put, say
from ppshw.cli.arguments import machine_of
from ppshw.errors import BadInput
from ppshw.file_lock import require_a_system_that_locks
from ppshw.progress import Bar

if TYPE_CHECKING:
    from ppshw.machine import Machine


def simulate(a: argparse.Namespace) -> None:
    require_a_system_that_locks()
    from simulators.scaled_clock import SPEEDS
    from simulators.serve import is_ours, serve

    machine = machine_of(a)
    _refuse_what_no_site_moves(machine)
    if not SPEEDS[0] <= a.speed <= SPEEDS[1]:
        raise BadInput(f"--speed {a.speed:g}: expected {SPEEDS[0]:g} to {SPEEDS[1]:g}")
    site = new_file("site", a.site_out, machine.file)
    if site.is_file() and not is_ours(site):
        raise BadInput(f"{site}: exists already and is no site file of simulated hardware, expected a new file")

    def announce(path: Path) -> None:
        put(json.dumps({"site": str(path)}))

    ready = announce if a.json else None
    serve(machine.file, site, seed=a.seed, speed=a.speed, force_protocol=a.force_sensor, ready=ready)


def _refuse_what_no_site_moves(machine: Machine) -> None:
    for joint in machine.joints:
        given = {} if joint.limits is None else vars(joint.limits)
        if lacking := [key for key in ("lower", "upper", "velocity", "acceleration") if given.get(key) is None]:
            raise BadInput(
                f"{machine.file}: joint {joint.name} has no {', '.join(lacking)}, expected limits: without them "
                "nothing is moved"
            )


def demo(a: argparse.Namespace) -> None:
    require_a_system_that_locks()
    from ppshw.demo import run_demo

    if a.conceal is not None:
        return _demo_concealed(a)
    with Bar() as bar:
        answer = run_demo(Path(a.out), a.seed, Path(machine_of(a).file), a.method, bar)
    scatter = answer["repeatability"]
    text = "\n".join(
        [
            f"at the treatment point, {answer['verification_visits']} configurations that no fit has seen [mm]",
            FIGURE_HEAD,
            figure_row("uncompensated", answer["uncompensated"]),
            figure_row("compensated", answer["compensated"]),
            f"measurements      {answer['visits']} visits, {answer['readings']} reflector readings",
            f"repeatability     {answer['repeatability_mm']:.3f} mm at 98.6 % ({scatter['visits']} visits)",
            f"time              {answer['seconds']:.0f} s for {answer['machine_hours']:.0f} h of machine time; "
            f"identification {answer['identify_seconds']:.1f} s",
            f"page              {Path(a.out) / 'report.html'}",
        ]
    )
    return say(a, answer, text)


def _demo_concealed(a: argparse.Namespace) -> None:
    from ppshw.demo_concealed import run_concealed, sentences, table_rows

    if a.method != "joint":
        raise BadInput(f"--method {a.method}: has no meaning with --conceal, which does not run the paper's campaign")

    def announce(seal: str) -> None:
        print(f"seal {seal}", file=sys.stderr, flush=True)

    with Bar() as bar:
        answer = run_concealed(Path(a.out), a.conceal, a.seed, Path(machine_of(a).file), bar, announce)
    rows = [figure_row(name, values) for name, values in table_rows(answer).items()]
    say(a, answer, "\n".join(sentences(answer, [FIGURE_HEAD, *rows])))
