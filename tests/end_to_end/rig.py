"""Simulated hardware at wire level, and a small campaign to run on it."""

from __future__ import annotations

from pathlib import Path

from campaigns.operator import AutomaticOperator
from campaigns.plan import Plan, plan_campaign
from campaigns.runner import RunResult, run_campaign
from campaigns.script import load_script
from campaigns.site import Site, load_site, open_bench
from simulators.clock import SteppedClock
from simulators.faults import Fault, FaultSchedule
from simulators.hardware import SimulatedHardware

ROOT = Path(__file__).parents[2]
SCRIPT = """\
name: small
settle_s: 3
loads: [{name: empty, mass: 0}, {name: box, mass: 120, com: [0.05, 0.15, 0.4]}]
steps:
  - {step: sweep, kind: sweep, joint: lateral, count: 4, loads: [empty, box]}
  - {step: any, kind: random, count: 4, margin: 0.05}
"""


class Rig:
    """A simulated positioner in this process, its site file, and a campaign of twelve visits."""

    def __init__(
        self,
        folder: Path,
        script: str = SCRIPT,
        force_protocol: str = "bota",
        machine_file: Path = ROOT / "machines/pps.yaml",
    ) -> None:
        self.folder = folder
        self.out = folder / "small.db"
        self.clock = SteppedClock(grace=0.5)
        self.hardware = SimulatedHardware(machine_file, self.clock, folder, seed=3, force_protocol=force_protocol)
        self.site: Site = load_site(self.hardware.write_site(folder / "site.yaml"))
        (folder / "small.yaml").write_text(script, encoding="utf-8")
        self.plan: Plan = plan_campaign(load_script(folder / "small.yaml"), self.site.machine)
        self.operator = AutomaticOperator(lambda load: self.hardware.put_on(load.mass, load.com))

    def run(self, *faults: Fault, reset_faults: bool = False) -> RunResult:
        schedule = FaultSchedule(self.hardware, faults)
        with open_bench(self.site, self.clock, self.hardware.ports) as bench:
            return run_campaign(
                self.plan, bench, self.out, self.operator, reset_faults=reset_faults,
                progress=lambda p: schedule.visit_done(p.done),
            )  # fmt: skip
