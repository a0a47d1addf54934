"""What a run writes into its recording beside numbers, and what it reads there when it goes on.

Cells of a visit's row, raw readings, whose run it is, and which visits nothing is to be done for any more.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from campaigns.bench import Bench
from campaigns.plan import Plan
from drivers.ports import DeviceInfo, Shot, WrenchReading
from ppshw.errors import RecordingError
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.recording_file import RecordingFile

Array = NDArray[np.float64]
NOT_ON = "load not on"  # the event of a load that was said to be on, and does not weigh what it should
LIBRARIES = ("ppshw", "numpy", "scipy", "python-can", "canopen", "geocompy", "pyserial")


def joint_cells(
    joints: tuple[str, ...], commanded: Array, q: Mapping[str, float], approach: Mapping[str, int]
) -> dict[str, str]:
    out = {f"q_cmd_{j}": f"{x:.9f}" for j, x in zip(joints, commanded.tolist(), strict=True)}
    out |= {f"q_{j}": f"{q[j]:.9f}" for j in joints}
    out |= {f"approach_{j}": str(approach[j]) for j in joints}
    return out


def wrench_cells(reading: WrenchReading) -> dict[str, str]:
    out = {c: f"{x:.6f}" for c, x in zip(WRENCH_COMPONENTS, reading.wrench.tolist(), strict=True)}
    if reading.temperature_c is not None:
        out["temp_force_sensor_C"] = f"{reading.temperature_c:.4f}"
    return out


def raw(shot: Shot) -> dict[str, Any]:
    return {
        "xyz": shot.xyz.tolist(), "raw": dict(shot.raw), "ppm": shot.ppm,
        "atmosphere": asdict(shot.atmosphere), "extra": dict(shot.extra),
    }  # fmt: skip


def raw_wrench(reading: WrenchReading) -> dict[str, Any]:
    return {"wrench": reading.wrench.tolist(), "spread": reading.spread.tolist(), "samples": reading.samples}


def identity(plan: Plan, setpoints: str) -> dict[str, str]:
    """What a resumed run must share with the run before."""
    return {
        "machine_sha256": plan.machine.sha256, "campaign_sha256": plan.script.sha256, "plan_sha256": plan.digest,
        "setpoints": setpoints,
    }  # fmt: skip


def origin(plan: Plan) -> dict[str, str]:
    versions = {library: version(library) for library in LIBRARIES} | {"python": platform.python_version()}
    return {
        "machine": Path(plan.machine.file).read_text(encoding="utf-8"),
        "machine_name": plan.machine.name,
        "campaign": plan.script.text,
        "campaign_name": plan.script.name,
        "visits_planned": str(len(plan.visits)),
        "versions": json.dumps(versions),
    }


def start_note(devices: list[DeviceInfo], bench: Bench) -> dict[str, Any]:
    found = [{k: v for k, v in asdict(device).items() if k != "problem"} for device in devices]
    return {"devices": found, "homed": list(bench.homed), "site_sha256": bench.notes.get("site_sha256", "")}


def refuse_another_run(file: RecordingFile, wanted: Mapping[str, str]) -> None:
    found = file.meta()
    names = {"machine_sha256": "machine file", "campaign_sha256": "campaign script", "plan_sha256": "plan",
             "setpoints": "setpoint correction"}  # fmt: skip
    for key, name in names.items():
        if found.get(key) != wanted[key]:
            was = found.get(key, "unknown")[:12]
            raise RecordingError(
                f"{file.path}: was begun with another {name} ({was}, now {wanted[key][:12]}); "
                "choose a new file, or go on with what it was begun with"
            )


def finished(file: RecordingFile) -> set[int]:
    """Plan indices that nothing is to be done for any more."""
    return (file.done() - to_redo(file)) | skipped(file)


def to_redo(file: RecordingFile) -> set[int]:
    """Plan indices of visits that somebody wanted measured again, and that were neither that nor skipped, since."""
    measured, asked = file.measured_at(), dict[int, str]()
    for time, kind, _, data in file.events():
        if kind == "redo":
            asked[int(data["visit"])] = time
        elif kind == "skip":
            asked.pop(int(data["visit"]), None)
    return {visit for visit, time in asked.items() if measured.get(visit, time) < time}


def skipped(file: RecordingFile) -> set[int]:
    """Plan indices that were left out; of a visit that was only not measured again there is what was measured."""
    return {int(data["visit"]) for _, kind, _, data in file.events() if kind == "skip"} - file.done()


def exchanged(file: RecordingFile, devices: Sequence[DeviceInfo]) -> str:
    """Devices with another serial number than at the recording's last start, in words; empty where there are none."""
    starts = [data for _, kind, _, data in file.events() if kind == "start"]
    before = {d["device"]: d["serial"] for d in starts[-1]["devices"]} if starts else {}
    others = [(d, was) for d in devices if (was := before.get(d.device)) and d.serial and d.serial != was]
    return ", ".join(f"{d.device} has number {d.serial}, had {was}" for d, was in others)


def last_visit(file: RecordingFile) -> dict[str, str]:
    """Column → cell; empty ones where nothing was measured yet."""
    header, rows = file.table()
    return dict(zip(header, rows[-1], strict=True)) if rows else dict.fromkeys(header, "")


def put_on_since(file: RecordingFile, load: str) -> tuple[float, Array | None] | None:
    """When a load was put on that no visit was measured under since, and lies there still [s since 1970], and what the
    force sensor read before that (6,); None where the log knows of no such change."""
    last, since, read, before = last_visit(file), None, None, None
    lies = last["load"]
    for time, kind, _, data in file.events():
        if kind == "baseline":
            read = np.array(data["wrench"], dtype=float)
        elif kind == "load change" and time > last["time"] and data["name"] != lies:  # else a resumed run asked again
            asked, answered = (datetime.fromisoformat(t).timestamp() for t in (data["asked"], time))
            lies, since, before = data["name"], 0.5 * (asked + answered), read
        elif kind == NOT_ON and time > last["time"]:
            lies, since = "", None  # whatever lies there
    return (since, before) if since is not None and lies == load else None
