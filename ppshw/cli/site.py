"""The bench side, at a site: run, check."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from ppshw.cli.answers import new_file, say
from ppshw.cli.setpoints import final_approach
from ppshw.progress import Bar


def run(a: argparse.Namespace) -> None:
    from campaigns.plan import plan_campaign
    from campaigns.runner import run_campaign
    from campaigns.script import load_script
    from campaigns.site import check_moves, load_site, open_bench
    from ppshw.recording_file import only_writer

    site = load_site(a.site)
    found = plan_campaign(load_script(a.campaign), site.machine)
    check_moves(found, site)
    correct, label = _setpoint_map(a, site)
    out = new_file(a.out, a.site, site.machine.file)
    with only_writer(out), open_bench(site) as bench, Bar() as bar:
        result = run_campaign(
            found, bench, out, site.make_operator(),
            setpoint_map=correct, map_label=label, reset_faults=a.reset_faults,
            progress=lambda p: bar("visits", p.done, p.total, p.seconds_left / site.speed),
        )  # fmt: skip
    answer = {"out": str(result.out), "measured": result.measured, "done": result.done, "planned": len(found.visits),
              "skipped": result.skipped, "lost_beams": result.lost_beams}  # fmt: skip
    say(a, answer, f"{result.out}: {result.measured} visits measured now, {result.done} of {len(found.visits)} in all")


def _setpoint_map(a: argparse.Namespace, site: Any) -> tuple[Callable[..., Any] | None, str]:
    """Compensated setpoints for a whole campaign, when a calibration is given."""
    if a.calibration is None:
        return None, "as planned"
    from ppshw.calibration import load_calibration
    from ppshw.compensation import Compensator

    calibration = load_calibration(a.calibration, site.machine)
    compensator = Compensator(calibration)
    label = calibration.provenance["recording_sha256"] + (" with effects" if calibration.effects else "")
    return compensator.setpoint_map(final_approach=final_approach(site)), label


def check(a: argparse.Namespace) -> None:
    from campaigns.site import load_site, open_bench

    site = load_site(a.site)
    with open_bench(site) as bench:
        devices = bench.check()
    answer = {"site": site.name, "devices": [vars(d) for d in devices]}
    lines = [f"{d.device:16}{d.model:24}{d.serial:12}{d.firmware:10}{d.status}" for d in devices]
    say(a, answer, "\n".join(lines))
