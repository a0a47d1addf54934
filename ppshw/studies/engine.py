"""One pure function over many jobs, on dask.distributed: a local cluster, or the scheduler of a real one.

    outcome = run_jobs(function, jobs, journal=out / "results.jsonl", workers=4)

`function` takes a job's arguments and returns what JSON can hold; it must be importable by name where the workers are,
and depend on its arguments alone (its seed among them). So the numbers are the same on any cluster and in any order.
A result is in the journal as soon as it is there, and the same call again computes only what is missing.

A worker that dies costs the job it was at, which is done again elsewhere. dask blames every job that was waiting at a
dead worker, so what it gives up is done once more alone; a job that kills its workers even then is listed as lost.
"""

from __future__ import annotations

import queue
import re
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from ppshw.errors import BadInput, PpshwError
from ppshw.process import cores
from ppshw.studies.journal import Journal

Json = dict[str, Any]
Function = Callable[..., Json]
Say = Callable[[int, int], None]
# A job may take this many workers with it, on a local cluster, before it is suspected; then once more alone.
ALLOWED_FAILURES = 1
# Batches that lie ready at the scheduler per thread, so that none waits for this process.
AHEAD = 3
ADDRESS = re.compile(r"([a-z]+://)?[^\s/]+:\d{1,5}")
NO_WORKERS_S = 300.0
CONNECT_S = 20.0
LOOK_AROUND_S = 2.0
# dask gives a worker of ours up that is not back so long after it died, and then we ask for another.
LOST_WORKER_S = 30


@dataclass(frozen=True)
class Job:
    """key: unique in a study; arguments: what the function is called with, JSON."""

    key: str
    arguments: Json


@dataclass(frozen=True)
class Outcome:
    """results, lost: by key, in the order of the jobs; lost says why. seconds: what each result took where it ran."""

    results: dict[str, Json]
    lost: dict[str, str]
    seconds: dict[str, float]


@dataclass(frozen=True)
class Cluster:
    """Where jobs run.

    workers    processes with one thread each on this computer; 0: none, all in this process, without dask
    scheduler  address of a running scheduler (tcp://host:8786) instead; its workers need the same ppshw, and for jobs
               that write files the same folders
    batch      jobs in one message to a worker: for jobs that take less than some 50 ms
    Raises BadInput for what is no such address.
    """

    workers: int = 2
    scheduler: str | None = None
    batch: int = 1

    def __post_init__(self) -> None:
        if self.scheduler is not None and not ADDRESS.fullmatch(self.scheduler):
            raise BadInput(f"{self.scheduler}: no scheduler's address, expected one like tcp://host:8786")


def run_jobs(
    function: Function,
    jobs: Sequence[Job],
    journal: Path | None = None,
    cluster: Cluster | None = None,
    say: Say | None = None,
) -> Outcome:
    """Run what has no result yet; returns all results.

    Raises BadInput when the journal is another study's or dask is missing, PpshwError when the cluster is gone.
    """
    cluster = cluster or Cluster()
    if len({job.key for job in jobs}) < len(jobs):
        raise BadInput("two jobs of one name, expected each once")
    results: dict[str, Json] = {}
    lost: dict[str, str] = {}
    seconds: dict[str, float] = {}
    with Journal.opened(journal, name_of(function)) as kept:
        for job in jobs:
            known = kept.result(job.key, job.arguments)
            if known is not None:
                results[job.key], seconds[job.key] = known
        missing = [job for job in jobs if job.key not in results]
        begun = len(results)
        for done, (job, answer) in enumerate(_carried_out(function, missing, cluster), start=1):
            if answer.result is None:
                lost[job.key] = answer.trouble
            else:
                results[job.key] = kept.add(job.key, job.arguments, answer.result, answer.seconds)
                seconds[job.key] = answer.seconds
            if say:
                say(begun + done, len(jobs))
    order = [job.key for job in jobs]
    return Outcome(
        {k: results[k] for k in order if k in results},
        {k: lost[k] for k in order if k in lost},
        {k: seconds[k] for k in order if k in results},
    )


def name_of(function: Function) -> str:
    while isinstance(function, partial):
        function = function.func
    return f"{function.__module__}:{function.__qualname__}"


@dataclass(frozen=True)
class Answer:
    """A job's result, or None and what went wrong; and the seconds it took."""

    result: Json | None
    trouble: str
    seconds: float


def _carried_out(function: Function, jobs: Sequence[Job], cluster: Cluster) -> Iterator[tuple[Job, Answer]]:
    """Jobs as they are finished."""
    if not jobs:
        return
    if cluster.workers == 0 and cluster.scheduler is None:
        for job in jobs:
            yield job, _answer(function, job.arguments)
        return
    with _client(cluster, len(jobs)) as (client, wanted):
        size = cluster.batch
        suspects: list[Job] = []
        batches = [list(jobs[k : k + size]) for k in range(0, len(jobs), size)]
        for batch, answers in _rolling(client, wanted, function, batches, AHEAD):
            if isinstance(answers, str):
                suspects += batch
            else:
                yield from zip(batch, answers, strict=True)
        for batch, answers in _rolling(client, wanted, function, [[job] for job in suspects], 0):
            yield batch[0], Answer(None, answers, 0.0) if isinstance(answers, str) else answers[0]


def _answer(function: Function, arguments: Json) -> Answer:
    """Anything but a complaint of ours is a bug."""
    began = time.perf_counter()
    try:
        result = function(**arguments)
    except PpshwError as problem:
        return Answer(None, str(problem), time.perf_counter() - began)
    return Answer(result, "", round(time.perf_counter() - began, 3))


def _on_worker(function: Function, batch: Sequence[Json]) -> list[Answer]:
    out: list[Answer] = []
    for arguments in batch:
        try:
            out.append(_answer(function, arguments))
        except Exception as bug:  # listed as lost by name; one job's bug is no reason to lose the others
            out.append(Answer(None, f"internal error: {type(bug).__name__}: {bug}", 0.0))
    return out


def _rolling(
    client: Any, wanted: int, function: Function, batches: Iterable[list[Job]], ahead: int
) -> Iterator[tuple[list[Job], list[Answer] | str]]:
    """Hand out batches, never more than `ahead` per thread at a time (0: one by one), so that neither this process nor
    the scheduler ever holds a study's million; yields each with its answers, or the reason why dask gave it up.

    wanted  workers of a cluster of our own, which we keep alive; 0: it is somebody else's
    """
    killed = import_module("distributed").KilledWorker
    waiting = iter(batches)
    inside: dict[Any, list[Job]] = {}
    done: queue.Queue[Any] = queue.Queue()
    most, exhausted = 1, False
    looked, alive = -1e9, time.monotonic()
    while inside or not exhausted:
        now = time.monotonic()
        if now - looked > LOOK_AROUND_S:
            threads, looked = sum(client.nthreads().values()), now
            most = max(1, ahead * threads)
            if threads < wanted:  # one that died while it was being started is not restarted by its nanny
                client.cluster.scale(wanted)
            alive = now if threads else alive
            if now - alive > NO_WORKERS_S:
                raise PpshwError(f"{client.scheduler.address}: no workers for {NO_WORKERS_S:g} s; "
                                 "the same command again goes on from here")  # fmt: skip
        while not exhausted and len(inside) < most:
            batch = next(waiting, None)
            if batch is None:
                exhausted = True
                break
            future = client.submit(_on_worker, function, [job.arguments for job in batch], pure=False)
            inside[future] = batch
            future.add_done_callback(done.put)
        if not inside:
            break
        try:
            future = done.get(timeout=LOOK_AROUND_S)
        except queue.Empty:
            continue
        answers = _settled(future, function, killed)
        if answers is None:  # its worker died before the result was fetched: it is done again, and waited for again
            future.add_done_callback(done.put)
        else:
            yield inside.pop(future), answers


def _settled(future: Any, function: Function, killed: type[Exception]) -> list[Answer] | str | None:
    """A finished future's answers, or why dask gave it up; None: it is not finished any more."""
    if future.status == "finished":
        try:
            answers: list[Answer] = future.result(timeout=LOOK_AROUND_S)
        except TimeoutError:
            return None
        return answers
    if future.status == "error" and isinstance(future.exception(), killed):
        return "its workers died, one after the other"
    if future.status == "error":
        raise PpshwError(f"workers cannot run {name_of(function)}: {future.exception()}")
    if future.status == "cancelled":
        raise PpshwError("the scheduler is gone; the same command again goes on from here")
    return None


@contextmanager
def _client(cluster: Cluster, jobs: int) -> Iterator[tuple[Any, int]]:
    """A connection to the scheduler, or a cluster of processes of our own that ends with it, and how many they are."""
    try:
        dask, distributed = import_module("dask"), import_module("distributed")
    except ImportError as missing:
        raise BadInput(
            f"module {missing.name} is missing: pip install 'ppshw[studies]', or --workers 0 for one process without it"
        ) from None
    settings = {
        "logging": {"distributed": "critical"},
        "distributed.scheduler.allowed-failures": ALLOWED_FAILURES,
        "distributed.deploy.lost-worker-timeout": LOST_WORKER_S,
        "distributed.comm.timeouts": {"connect": "120s", "tcp": "120s"},  # a busy computer is no lost connection
    }
    if cluster.scheduler is not None:
        try:
            client = distributed.Client(cluster.scheduler, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as problem:
            raise BadInput(f"{cluster.scheduler}: no scheduler answers there ({problem})") from None
        with client:
            yield client, 0
        return
    count = min(cluster.workers, jobs)
    share = {"PYTHON_CPU_COUNT": str(max(1, cores() // max(1, count)))}
    with (
        dask.config.set(settings),
        distributed.LocalCluster(n_workers=count, threads_per_worker=1, processes=True, env=share,
                                 dashboard_address="127.0.0.1:0", silence_logs="CRITICAL") as local,
        distributed.Client(local, set_as_default=False) as client,
    ):  # fmt: skip
        yield client, count
