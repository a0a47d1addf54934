"""The main job on simulated hardware: campaign → recording → calibration → compensated verification → report.

Everything goes through the real drivers and their wires; only the devices behind the wires are simulated, and time is
stepped, so that hours of motion take seconds. Results are measured by the simulated tracker, never read from the truth.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from campaigns.operator import AutomaticOperator
from campaigns.plan import plan_campaign
from campaigns.runner import SetpointMap, run_campaign
from campaigns.script import LoadCase, load_script
from campaigns.site import Site, load_site, open_bench
from ppshw.calibration import Calibration
from ppshw.compensation import Compensator, Corrections
from ppshw.errors import BadInput
from ppshw.evaluation import figures
from ppshw.identification import identify
from ppshw.machine import Machine, load_machine
from ppshw.recording import Around, Recording, load_recording
from ppshw.recording_file import only_writer
from ppshw.report import build_report
from ppshw.verification import point_errors, repeatability
from ppshw.whole_file import file_hash, write_text
from simulators.clock import SteppedClock
from simulators.hardware import SimulatedHardware

Array = NDArray[np.float64]
Say = Callable[[str, int, int], None]
POINT = "treatment"
MARK = ".ppshw-demo"  # this folder's recordings are a demo's and may be replaced
CAMPAIGNS = {
    "campaign": "paper",
    "repeatability": "repeatability",
    "verification_nominal": "verification",
    "verification_compensated": "verification",
}
# What a demo leaves, this one and the one with a concealed effect (ppshw/demo_concealed.py)
LEFT = (*CAMPAIGNS, "diagnosis", "verification_base", "verification_extended")
ANSWERS = ("calibration.json", "extended.json", "diagnosis.json", "seal.sha256", "truth.json", "demo.json",
           "concealed.json", "report.html")  # fmt: skip


def run_demo(
    out: Path, seed: int, machine_file: Path, method: str, say: Say, campaigns: dict[str, str] | None = None
) -> dict[str, Any]:
    """Run the main job into the folder `out`; returns the contract's answer (§3).

    campaigns  recording → script, by default the paper's; the tests run short ones
    """
    started = time.perf_counter()
    campaigns = campaigns or CAMPAIGNS
    machine = load_machine(machine_file)
    if POINT not in machine.points:
        raise BadInput(f"{machine_file}: the demo needs a point named '{POINT}' in tip.points")
    for name in campaigns.values():  # refuse before anything is written
        plan_campaign(load_script(name), machine)
    with fresh_folder(out, machine_file) as machine_copy:
        machine = load_machine(machine_copy)
        clock = SteppedClock()
        with SimulatedHardware(machine_copy, clock, out, seed=seed) as hardware:
            site = load_site(hardware.write_site(out / "site.yaml"))
            bench = SimulatedSite(out, machine, site, hardware, clock, say)

            def measure(name: str, setpoint_map: SetpointMap | None = None, label: str = "as planned") -> Recording:
                return bench.measure(name, campaigns[name], setpoint_map, label)

            recording = measure("campaign")
            scatter = repeatability(measure("repeatability"), machine, POINT)
            before = point_errors(measure("verification_nominal", as_wanted, "nominal"), machine, POINT)
            identified = time.perf_counter()
            estimate = identify(machine, recording, method, lambda k, n: say("identify", k, n))
            identify_s = time.perf_counter() - identified
            calibration = Calibration.of(estimate, recording, method)
            calibration.save(out / "calibration.json")
            corrected, label = Corrections(Compensator(calibration)), file_hash(out / "calibration.json")
            after = point_errors(measure("verification_compensated", corrected, label), machine, POINT)
        answer = {
            "uncompensated": figures(before),
            "compensated": figures(after),
            "repeatability_mm": scatter["p98_6_mm"],
            "repeatability": scatter,
            "visits": len(recording),
            "readings": int(recording.seen.sum()),
            "verification_visits": len(after),
            "loads": len(set(recording.load)),
            "method": method,
            "seed": seed,
            "identify_seconds": round(identify_s, 2),
            "machine_hours": round(clock.now() / 3600, 1),
            "seconds": round(time.perf_counter() - started, 1),
        }
        write_text(out / "demo.json", json.dumps(answer, indent=1))
        say("report", 0, 1)
        build_report(out)
        say("report", 1, 1)
        return answer


@dataclass(frozen=True)
class SimulatedSite:
    """A machine on simulated hardware, whose campaigns are recorded in a folder.

    load_changes_take_time  as the script says, without which creep would not show
    """

    out: Path
    machine: Machine
    site: Site
    hardware: SimulatedHardware
    clock: SteppedClock
    say: Say
    load_changes_take_time: bool = False

    def measure(
        self, name: str, script: str, setpoint_map: SetpointMap | None = None, label: str = "as planned"
    ) -> Recording:
        """Run a script's campaign through the drivers into the recording `name`."""
        plan = plan_campaign(load_script(script), self.machine)
        pause = plan.script.load_change_s / 2 if self.load_changes_take_time else 0.0

        def put_on(load: LoadCase) -> None:
            self.clock.sleep(pause)
            self.hardware.put_on(load.mass, load.com)
            self.clock.sleep(pause)

        with open_bench(self.site, self.clock, self.hardware.ports) as bench:
            run_campaign(
                plan, bench, self.out / f"{name}.db", AutomaticOperator(put_on, "simulated"),
                setpoint_map=setpoint_map, map_label=label, progress=lambda p: self.say(name, p.done, p.total),
            )  # fmt: skip
        return load_recording(self.out / f"{name}.db", self.machine)


@contextmanager
def fresh_folder(out: Path, machine_file: Path) -> Iterator[Path]:
    """The folder without what an earlier demo left there. One that was no demo's is refused if anything is in it.

    Yields the machine file's copy in it; no other demo may use the folder meanwhile.
    """
    if out.exists() and not out.is_dir():
        raise BadInput(f"{out}: exists and is no folder, expected a folder for the results")
    if out.exists() and not (out / MARK).exists() and (there := sorted(path.name for path in out.iterdir())):
        more = f" and {len(there) - 1} more" if there[1:] else ""
        raise BadInput(f"{out}: holds {there[0]}{more}, which no demo made; expected a new or an empty folder")
    out.mkdir(parents=True, exist_ok=True)
    ours = [*(f"{c}.db" for c in LEFT), *(f"{c}.db-journal" for c in LEFT), *ANSWERS]
    with only_writer(out / "demo"):
        (out / MARK).write_text("made by ppshw demo; the next one with this --out replaces it\n", encoding="utf-8")
        for name in ours:
            (out / name).unlink(missing_ok=True)
        copy = out / "machine.yaml"
        if not (copy.exists() and copy.samefile(machine_file)):
            shutil.copyfile(machine_file, copy)
        yield copy


def as_wanted(wanted: Array, wrench: Array, here: Array, around: Around) -> Array:
    """A `SetpointMap` that corrects nothing: wanted, here, and returned (n,) [m, rad]; wrench (6,) [N, N·m]."""
    return wanted
