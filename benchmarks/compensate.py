"""Compensated setpoints: one after the other as a controller asks for them, and in bulk.

    python -m benchmarks.compensate [--short] [--realtime]

Bars: median ≤ 150 µs, worst of 10⁵ ≤ 1 ms, ≥ 2·10⁵ a second in bulk. `--realtime` measures a second time under the
first-in-first-out scheduler, as a motion controller would run (needs the right to; takes a core for some seconds).
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from benchmarks.figures import ROOT, flow, number, remarks, seconds, table, write
from ppshw.calibration import Calibration
from ppshw.compensation import Compensator
from ppshw.compensation.fast_setpoints import FastCompensator
from ppshw.identification import identify
from ppshw.machine import load_machine
from ppshw.recording import load_recording
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant

Array = NDArray[np.float64]
MACHINE = ROOT / "machines/pps.yaml"
# Wanted poses keep to this share of the identified range, so that no corrected setpoint is beyond a limit.
SHARE = 0.9


def calibrate(visits: int) -> Calibration:
    """An identified machine of the paper's kind, simulated; from few visits a small model, and soon."""
    machine = load_machine(MACHINE)
    with tempfile.TemporaryDirectory() as folder:
        csv = Path(folder) / "recording.csv"
        simulate_recording_csv(Plant.from_file(MACHINE, seed=1), csv, visits, np.random.default_rng(1), plan="mixed")
        recording = load_recording(csv, machine)
    return Calibration.of(identify(machine, recording), recording, "joint")


def one_by_one(fast: FastCompensator, q: Array, payload: Array) -> tuple[list[str], Array]:
    """A row of the table and the setpoints."""
    wall, cpu = np.empty(len(q), dtype=np.int64), np.empty(len(q), dtype=np.int64)
    out = np.empty_like(q)
    switched = resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw
    for k in range(len(q)):
        busy, started = time.thread_time_ns(), time.perf_counter_ns()
        out[k] = fast.setpoint(q[k], payload[k])
        wall[k], cpu[k] = time.perf_counter_ns() - started, time.thread_time_ns() - busy
    switched = resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw - switched
    us = wall / 1e3
    row = [
        number(float(np.median(us))), number(float(np.quantile(us, 0.999))), number(us.max()),
        number(cpu.max() / 1e3), str(int((us > 1000).sum())), str(switched),
    ]  # fmt: skip
    return row, out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--short", action="store_true", help="10³ setpoints of a small calibration; writes nothing")
    parser.add_argument("--realtime", action="store_true", help="a second time with a real-time priority")
    a = parser.parse_args()
    load = os.getloadavg()
    calibration = calibrate(12 if a.short else 669)
    made = seconds(lambda: FastCompensator(calibration), 1 if a.short else 5)
    fast, slow = FastCompensator(calibration), Compensator(calibration)
    count = 1_000 if a.short else 100_000
    rng = np.random.default_rng(2)
    q = calibration.joint_range.mean(axis=1) + SHARE * np.ptp(calibration.joint_range, axis=1) * rng.uniform(
        -0.5, 0.5, (count, calibration.machine.n)
    )
    payload = rng.uniform(calibration.payload_range[:, 0], calibration.payload_range[:, 1], (count, 6))
    inside = ~fast.setpoints(q, payload).refused
    q, payload = q[inside], payload[inside]

    row, corrected = one_by_one(fast, q, payload)
    rows = [["ordinary scheduling", *row]]
    if a.realtime:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
        try:
            rows.append(["real-time priority", *one_by_one(fast, q, payload)[0]])
        finally:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    bulk = seconds(lambda: fast.setpoints(q, payload), 1 if a.short else 15)
    few = min(3 if a.short else 60, len(q))
    plain = [seconds(lambda k=k: slow.for_joints(q[k], payload[k]), 1)[0] for k in range(few)]  # type: ignore[misc]
    off = np.array([slow.for_joints(q[k], payload[k]).corrected - corrected[k] for k in range(few)])
    header = ["wall µs per setpoint", "median", "99.9 %", "worst", "worst, processor time", "> 1 ms", "switched away"]
    first = flow(
        f"A calibration of `machines/pps.yaml` from {calibration.provenance['visits']} simulated visits; {len(q):,} "
        "setpoints at random poses under random loads, by `FastCompensator.setpoint`, in wall time: every one counts. "
        "`switched away`: how often the system gave the core to another process. Bars: median 150 µs, worst 1 ms."
    )
    second = flow(
        f"In bulk, `FastCompensator.setpoints`: {number(len(q) / min(bulk))} a second, median of {len(bulk)} rounds "
        f"{number(len(q) / float(np.median(bulk)))} (bar: 200,000). `Compensator.for_joints`, which also gives the "
        f"uncertainty: {np.median(plain) * 1e3:.3g} ms, {np.median(plain) / float(rows[0][1]) * 1e6:.0f} times; "
        f"over {few} poses the two differ by at most {np.abs(off).max() * 1e6:.2g} µm or µrad. Making a "
        f"`FastCompensator` takes {min(made):.2g} s, importing numba before it {_import_seconds():.2g} s, compiling "
        "once per computer about 5 s."
    )
    command = f"`python -m benchmarks.compensate{' --realtime' if a.realtime else ''}`"
    text = f"{command}\n\n{first}\n\n{table(header, rows)}\n\n{second}\n\n{remarks(load)}\n"
    print(text)
    if not a.short:
        write("compensate", text)


def _import_seconds() -> float:
    """numba's import in a fresh Python that has numpy already."""
    code = "import numpy, time; t = time.perf_counter(); import numba; print(time.perf_counter() - t)"
    return float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)


if __name__ == "__main__":
    main()
