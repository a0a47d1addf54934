"""The studies' engine: what a lost worker costs, and that no number depends on where or in which order it was made."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import study_jobs

from ppshw.errors import BadInput, RecordingError
from ppshw.studies import engine
from ppshw.studies.engine import Cluster, Job, run_jobs
from ppshw.studies.journal import Journal

HERE = Cluster(workers=0)
ROOT = Path(__file__).parents[2]


def jobs(count: int, **more: object) -> list[Job]:
    return [Job(f"seed{k}", {"seed": k, **more}) for k in range(count)]


def thrown(seed: int) -> dict[str, list[float]]:
    return {"thrown": np.random.default_rng(seed).normal(size=4).tolist()}


@contextmanager
def a_scheduler_elsewhere(folder: Path) -> Iterator[str]:
    """`dask scheduler` and one `dask worker`, as somebody would start them on a real cluster."""
    env = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{Path(__file__).parent}"}
    dask = [sys.executable, "-m", "dask"]
    processes = []
    try:
        scheduler = subprocess.Popen(
            [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--no-jupyter"],
            cwd=folder, env=env, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        processes.append(scheduler)
        assert scheduler.stderr is not None
        address = next(m[0] for line in scheduler.stderr if (m := re.search(r"tcp://127[\d.:]+", line)))
        worker = [*dask, "worker", address, "--nthreads", "1", "--no-dashboard", "--local-directory", str(folder)]
        processes.append(subprocess.Popen(worker, cwd=folder, env=env, stderr=subprocess.DEVNULL))
        yield address
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait(20)
            if process.stderr:
                process.stderr.close()


def test_numbers_are_the_same_in_this_process_on_a_local_cluster_and_on_a_scheduler_elsewhere(tmp_path: Path) -> None:
    here = run_jobs(study_jobs.dice, jobs(9), cluster=HERE)
    local = run_jobs(study_jobs.dice, jobs(9), cluster=Cluster(workers=2))
    with a_scheduler_elsewhere(tmp_path) as address:
        there = run_jobs(study_jobs.dice, jobs(9), cluster=Cluster(scheduler=address, batch=4))
    assert here.results == {f"seed{k}": thrown(k) for k in range(9)}
    assert json.dumps(here.results) == json.dumps(local.results) == json.dumps(there.results)
    assert here.lost == local.lost == there.lost == {}


def test_order_of_the_jobs_and_batches_change_nothing_but_the_order_of_the_answer() -> None:
    forward = run_jobs(study_jobs.dice, jobs(7), cluster=HERE)
    backward = run_jobs(study_jobs.dice, jobs(7)[::-1], cluster=Cluster(workers=2, batch=3))
    assert list(backward.results) == [f"seed{k}" for k in range(6, -1, -1)]
    assert backward.results == forward.results


def test_workers_share_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHON_CPU_COUNT", "7")
    found = run_jobs(study_jobs.says_its_cores, jobs(2), cluster=Cluster(workers=2))
    assert [one["cores"] for one in found.results.values()] == [3, 3]


def test_a_worker_lost_in_the_middle_costs_no_result(tmp_path: Path) -> None:
    found = run_jobs(study_jobs.falls_over_once, jobs(8, marks=str(tmp_path)), cluster=Cluster(workers=2))
    assert (tmp_path / "fell").exists()
    assert found.lost == {}
    assert found.results == {f"seed{k}": thrown(k) for k in range(8)}


def test_workers_that_dask_gave_up_are_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a computer with too much to do a worker may take longer to come back than dask has patience: here none."""
    monkeypatch.setattr(engine, "LOST_WORKER_S", "1ms")
    monkeypatch.setattr(engine, "NO_WORKERS_S", 100.0)
    found = run_jobs(study_jobs.falls_over_once, jobs(5, marks=str(tmp_path)), cluster=Cluster(workers=1))
    assert found.results == {f"seed{k}": thrown(k) for k in range(5)}


def test_a_job_that_keeps_killing_its_workers_is_lost_alone(tmp_path: Path) -> None:
    """Two jobs share its batch, and others wait at its worker; none of them is blamed."""
    journal = tmp_path / "results.jsonl"
    found = run_jobs(study_jobs.always_falls_over, jobs(6), journal, Cluster(workers=2, batch=3))
    assert found.lost == {"seed3": "its workers died, one after the other"}
    assert list(found.results) == ["seed0", "seed1", "seed2", "seed4", "seed5"]
    assert len(journal.read_text().splitlines()) == 5


@pytest.mark.parametrize("workers", [0, 1])
def test_a_complaint_is_that_jobs_result_and_the_others_go_on(workers: int) -> None:
    found = run_jobs(study_jobs.complains, [j for j in jobs(4) if j.key != "seed2"], cluster=Cluster(workers))
    assert found.lost == {"seed1": "no visit has a target"}
    assert list(found.results) == ["seed0", "seed3"]


def test_a_bug_in_one_job_is_named_and_costs_that_job() -> None:
    found = run_jobs(study_jobs.complains, jobs(4), cluster=Cluster(1))
    assert found.lost["seed2"] == "internal error: ZeroDivisionError: division by zero"
    assert list(found.results) == ["seed0", "seed3"]


def test_the_same_call_again_computes_only_what_is_missing(tmp_path: Path) -> None:
    journal = tmp_path / "results.jsonl"
    first = run_jobs(study_jobs.counts, jobs(3, marks=str(tmp_path)), journal, HERE)
    whole = journal.read_text()
    kept = whole.splitlines(keepends=True)[:2]
    journal.write_text(whole[:-20])  # killed while it wrote its last line
    again = run_jobs(study_jobs.counts, jobs(5, marks=str(tmp_path)), journal, HERE)
    assert [len((tmp_path / f"called{k}").read_text()) for k in range(5)] == [1, 1, 2, 1, 1]
    # the two whole lines stand, the torn one is written anew (it may have taken another time), two are added
    lines = journal.read_text().splitlines(keepends=True)
    assert lines[:2] == kept
    assert [json.loads(line)["key"] for line in lines[2:]] == ["seed2", "seed3", "seed4"]
    assert {k: again.results[k] for k in first.results} == first.results
    assert list(again.results) == [f"seed{k}" for k in range(5)]


def test_what_a_killed_study_had_finished_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SIGKILL in the middle: what was finished is in the journal, and the next call takes it from there."""
    journal = tmp_path / "results.jsonl"
    code = (
        "import study_jobs; from pathlib import Path; from ppshw.studies import journal;"
        "from ppshw.studies.engine import *;"
        "journal.code = lambda: 'of this test';"  # so that nobody edits it in between
        "run_jobs(study_jobs.slow_dice, [Job(f'seed{k}', {'seed': k, 'seconds': 0.02 if k < 3 else 60.0}) "
        f"for k in range(4)], Path({str(journal)!r}), Cluster(workers=0))"
    )
    monkeypatch.setattr("ppshw.studies.journal.code", lambda: "of this test")
    env = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{Path(__file__).parent}"}
    process = subprocess.Popen([sys.executable, "-c", code], env=env, cwd=tmp_path)
    while not journal.exists() or journal.read_text().count("\n") < 3:
        assert process.poll() is None
    process.kill()
    process.wait()
    found = run_jobs(
        study_jobs.slow_dice, [Job(f"seed{k}", {"seed": k, "seconds": 0.02}) for k in range(3)], journal, HERE
    )
    assert found.results == {f"seed{k}": thrown(k) for k in range(3)}


def test_a_journal_of_other_arguments_another_function_or_other_code_is_refused(tmp_path: Path) -> None:
    journal = tmp_path / "results.jsonl"
    run_jobs(study_jobs.dice, jobs(2, throws=4), journal, HERE)
    with pytest.raises(BadInput, match=r"'seed0' was made with arguments .*'throws': 4.*'throws': 5"):
        run_jobs(study_jobs.dice, jobs(2, throws=5), journal, HERE)
    with pytest.raises(BadInput, match="made with function study_jobs:dice, here it is study_jobs:complains"):
        run_jobs(study_jobs.complains, jobs(2, throws=4), journal, HERE)
    journal.write_text(journal.read_text().replace('"code": "', '"code": "0.0.9 '))
    with pytest.raises(BadInput, match=r"'seed0' was made with code 0\.0\.9 .*; expected another folder"):
        run_jobs(study_jobs.dice, jobs(2, throws=4), journal, HERE)
    journal.write_text("throws, 4\n")
    with pytest.raises(BadInput, match=r"results.jsonl:1: no line of a study's journal"):
        run_jobs(study_jobs.dice, jobs(2), journal, HERE)


@pytest.mark.parametrize("content", [b"my notes", b"\xff\xfe\n", b"mine\nand mine"])
def test_a_file_that_is_no_journal_is_refused_and_stays_as_it_is(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "results.jsonl"
    path.write_bytes(content)
    with pytest.raises(BadInput, match=r"results\.jsonl.* journal, expected another folder"), Journal.opened(path, "f"):
        pass
    assert path.read_bytes() == content


def test_two_studies_do_not_write_one_journal(tmp_path: Path) -> None:
    def meanwhile(done: int, total: int) -> None:
        run_jobs(study_jobs.dice, jobs(1), tmp_path / "results.jsonl", HERE)

    with pytest.raises(RecordingError, match="another run is writing it"):
        run_jobs(study_jobs.dice, jobs(2), tmp_path / "results.jsonl", HERE, say=meanwhile)


def test_a_scheduler_that_is_not_there_is_said_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "CONNECT_S", 0.5)
    with pytest.raises(BadInput, match=r"tcp://127\.0\.0\.1:9: no scheduler answers there"):
        run_jobs(study_jobs.dice, jobs(1), cluster=Cluster(scheduler="tcp://127.0.0.1:9"))
