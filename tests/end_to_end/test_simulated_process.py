"""Simulated hardware in a process of its own, opened like real hardware: slcan, serial lines, an operator."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from campaigns.plan import plan_campaign
from campaigns.runner import Progress, RunResult, run_campaign
from campaigns.script import load_script
from campaigns.site import load_site, open_bench
from ppshw.errors import HardwareError
from ppshw.recording import load_recording
from tests.end_to_end.rig import ROOT

SCRIPT = """\
name: short
settle_s: 1
loads: [{name: empty, mass: 0}, {name: box, mass: 100, com: [0, 0.1, 0.3]}]
steps: [{step: any, kind: random, count: 4, margin: 0.3, within: {lateral: [-0.3, 0.3], vertical: [-0.1, 0.1]}}]
"""
SERVE = "import sys; from simulators.serve import serve; serve(sys.argv[1], sys.argv[2], seed=4, speed=40)"


@contextmanager
def hardware_process(folder: Path) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-c", SERVE, str(ROOT / "machines/pps.yaml"), str(folder / "site.yaml")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        assert process.stdout is not None
        assert "is ready" in process.stdout.readline()
        yield process
    finally:
        process.terminate()
        process.wait(timeout=20)


def run(folder: Path, interrupt: subprocess.Popen[str] | None = None) -> RunResult:
    (folder / "short.yaml").write_text(SCRIPT, encoding="utf-8")
    site = load_site(folder / "site.yaml")
    plan = plan_campaign(load_script(folder / "short.yaml"), site.machine)

    def progress(p: Progress) -> None:
        if interrupt is not None and p.done == 1:
            interrupt.kill()
            interrupt.wait()

    with open_bench(site) as bench:
        return run_campaign(plan, bench, folder / "short.db", site.make_operator(), progress=progress)


def test_a_campaign_runs_on_hardware_in_another_process(tmp_path: Path) -> None:
    with hardware_process(tmp_path):
        result = run(tmp_path)
        assert (result.measured, result.done) == (4, 4)
        site = load_site(tmp_path / "site.yaml")
        recording = load_recording(tmp_path / "short.db", site.machine)
        weight = np.linalg.norm(recording.wrench[:, :3], axis=1)
        np.testing.assert_allclose(weight, [0, 0, 980.665, 980.665], atol=2.0)  # the operator's line put it on
        assert recording.seen.all()


def test_when_the_adapter_is_gone_the_error_says_so_and_the_visits_stay(tmp_path: Path) -> None:
    began = time.monotonic()
    with hardware_process(tmp_path) as process, pytest.raises(HardwareError, match="CAN slcan socket://127") as caught:
        run(tmp_path, interrupt=process)
    assert "\n" not in str(caught.value)
    assert time.monotonic() - began < 30
    with hardware_process(tmp_path):
        result = run(tmp_path)
        assert (result.measured, result.done) == (3, 4)
