"""Identification: seconds and memory, beside a bare least-squares of the same matrix, and their growth with the visits.

    python -m benchmarks.identify [--short] [--visits 1000 10000 100000] [--memory GIB]

Bars: 700 visits within 2 s and within 3 × the bare least-squares; 10⁵ visits with memory that does not grow with visits
and time that grows linearly. Every measurement is a process of its own, so that its peak memory is its own; it may take
`--memory` GiB and says so when that is not enough.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from benchmarks.figures import ROOT, flow, number, remarks, seconds, span, table, write
from ppshw.identification import identify
from ppshw.identification.noise import Noise
from ppshw.identification.strengths import Groups, learn
from ppshw.identification.structure import joint_model
from ppshw.identification.visits import Linearisation
from ppshw.machine import Machine, load_machine
from ppshw.recording import Recording
from ppshw.terms import Situation
from simulators.plant import Plant

Array = NDArray[np.float64]
MACHINE = ROOT / "machines/pps.yaml"
LOADS, BATCH = 8, 2_000
ARRAYS = ("q", "wrench", "points")


def simulate(visits: int, out: Path) -> None:
    """Random poses under random loads as arrays in a file: no CSV, whose reading would count as memory."""
    plant, rng = Plant.from_file(MACHINE, seed=1), np.random.default_rng(1)
    cases = plant.random_loads(LOADS, rng)
    parts: dict[str, list[Array]] = {name: [] for name in ARRAYS}
    for start in range(0, visits, BATCH):
        count = min(BATCH, visits - start)
        q = plant.random_poses(count, rng)
        loads = [cases[k] for k in rng.integers(0, LOADS, count)]
        points = plant.true_points(q, loads, plant.draw_repeatability(count, rng))
        parts["q"].append(q)
        parts["wrench"].append(plant.wrench(q, loads))
        parts["points"].append(np.stack(list(points.values()), axis=1))
    arrays = {name: np.concatenate(part) for name, part in parts.items()}
    arrays["points"] += plant.position_sigma * rng.normal(size=arrays["points"].shape)
    np.savez(out, q=arrays["q"], wrench=arrays["wrench"], points=arrays["points"])


def recording(machine: Machine, path: Path) -> Recording:
    with np.load(path) as file:
        q, wrench, points = (file[name] for name in ARRAYS)
    unknown = np.full(len(q), np.nan)
    return Recording(
        machine.joint_names, tuple(machine.targets), unknown, ("",) * len(q), ("",) * len(q), q, q,
        np.zeros(q.shape, dtype=np.int64), unknown, wrench, points, {}, {}, {}, True, str(path), "",
    )  # fmt: skip


def measure(path: Path, task: str, rounds: int) -> dict[str, Any]:
    """In the child: what one task takes. Peak memory is above what imports and data take before it starts."""
    machine = load_machine(MACHINE)
    visits = recording(machine, path)
    matrix = bare_matrix(machine, visits) if task == "bare" else (np.zeros((0, 0)), np.zeros(0))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if task == "bare":
        out: dict[str, Any] = {name: seconds(solve, rounds) for name, solve in solvers(*matrix).items()}
    elif task == "once":
        out = {"seconds": seconds(lambda: once(machine, visits), rounds)}
    else:
        out = {"seconds": seconds(lambda: identify(machine, visits), rounds)}
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    parameters = len(joint_model(machine, visits).parameters())
    return {**out, "mib": (after - before) / 1024, "parameters": parameters, "visits": len(visits)}


def once(machine: Machine, visits: Recording) -> None:
    """One solution with strengths and noise known: linearised, whitened, solved, with its covariance."""
    model = joint_model(machine, visits)
    parameters = model.parameters()
    groups, everything = Groups.among(parameters), np.ones(len(parameters), dtype=bool)
    linear = Linearisation(model, visits, np.zeros(len(parameters)), np.eye(4), np.arange(len(visits)))
    noise = Noise(np.diag([2e-9] * 3 + [2e-10] * 3), 2e-5)
    gram, moment, _ = linear.normal_equations(noise, np.ones(len(visits)), everything)
    learn(gram, moment, groups, everything, groups.start**2, 0)[1].covariance(groups, everything)


def bare_matrix(machine: Machine, visits: Recording) -> tuple[Array, Array]:
    """The design matrix of the first linearisation and the data it is to explain: (9 N, p), (9 N,)."""
    model = joint_model(machine, visits)
    lin = model.linearise(Situation.of(visits), np.zeros(len(model.parameters())))
    return lin.design.reshape(-1, lin.design.shape[-1]), (visits.points - lin.positions).ravel()


def solvers(x: Array, y: Array) -> dict[str, Any]:
    """LAPACK's ways to the same solution. The normal equations need a ridge: without priors X has not full rank."""

    def normal() -> Array:
        gram = x.T @ x
        gram[np.diag_indices_from(gram)] += 1e-9 * np.trace(gram) / len(gram)
        return np.asarray(linalg.cho_solve(linalg.cho_factor(gram), x.T @ y))

    return {
        "gelsd (singular values)": lambda: linalg.lstsq(x, y, lapack_driver="gelsd"),
        "gelsy (pivoted QR)": lambda: linalg.lstsq(x, y, lapack_driver="gelsy"),
        "plain QR": lambda: linalg.qr(np.column_stack([x, y]), mode="r", overwrite_a=True),
        "normal equations (Cholesky)": normal,
    }


def child(path: Path, task: str, rounds: int, memory: float) -> dict[str, Any] | None:
    """Measure in a process of its own, and say so; None when `memory` GiB was not enough."""
    print(f"{task}, {path.stem} visits …", file=sys.stderr, flush=True)
    command = [sys.executable, "-m", "benchmarks.identify", "--child", task, str(path), str(rounds), str(memory)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    if done.returncode != 0:
        if "MemoryError" in done.stderr:
            return None
        raise RuntimeError(f"{task} of {path}: {done.stderr.strip().splitlines()[-1]}")
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return answer


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--short", action="store_true", help="few visits, one round; writes nothing")
    parser.add_argument("--visits", type=int, nargs="+", default=[1_000, 10_000, 100_000], help="for the growth")
    parser.add_argument("--memory", type=float, default=4.0, help="GiB that a measurement may take")
    parser.add_argument("--child", nargs=4, help=argparse.SUPPRESS)
    a = parser.parse_args()
    if a.child:
        task, path, rounds, memory = a.child
        limit = int(float(memory) * 2**30)
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        print(json.dumps(measure(Path(path), task, int(rounds))))
        return
    load, started = os.getloadavg(), time.perf_counter()
    one, growth, rounds = (5, [5], 1) if a.short else (700, a.visits, 3)
    with tempfile.TemporaryDirectory() as folder:
        text = "`python -m benchmarks.identify`\n\n" + beside_lapack(Path(folder), one, rounds, a.memory)
        text += "\n" + with_visits(Path(folder), growth, a.memory)
    text += f"\n{remarks(load)} {time.perf_counter() - started:.0f} s.\n"
    print(text)
    if not a.short:
        write("identify", text)


def beside_lapack(folder: Path, visits: int, rounds: int, memory: float) -> str:
    simulate(visits, folder / f"{visits}.npz")
    path = folder / f"{visits}.npz"
    own, single, bare = (child(path, task, rounds, memory) for task in ("identify", "once", "bare"))
    if own is None or single is None or bare is None:
        return f"{visits} visits do not fit into {memory:g} GiB.\n"
    rows = [
        ["`identify`: prior strengths, noise and relinearisation included", span(own["seconds"], " s"), ""],
        ["one solution with covariance, strengths and noise known", span(single["seconds"], " s"), ""],
    ]
    least, alone = min(own["seconds"]), min(single["seconds"])
    for name, times in bare.items():
        if isinstance(times, list):
            ratios = f"{number(least / min(times))}; {number(alone / min(times))}"
            rows.append([f"bare {name}", span(times, " s"), ratios])
    text = flow(
        f"{visits} visits of `machines/pps.yaml`, three targets: a matrix of {9 * visits:,} × {own['parameters']}; "
        f"peak memory of `identify` {own['mib']:.0f} MiB above data and imports. Bars: 2 s and 3 × the bare solution."
    )
    return f"{text}\n\n{table(['least (median)', 'time', 'identify; one solution takes × this'], rows)}\n"


def with_visits(folder: Path, counts: list[int], memory: float) -> str:
    rows = []
    for count in counts:
        path = folder / f"{count}.npz"
        simulate(count, path)
        found = child(path, "identify", 1, memory)
        path.unlink()
        if found is None:
            rows.append([f"{count:,}", *["–"] * 3, f"more than {memory:g} GiB in all"])
            continue
        rows.append([
            f"{count:,}", str(found["parameters"]), number(found["seconds"][0]),
            number(found["seconds"][0] / count * 1e3), f"{found['mib']:.0f} MiB",
        ])  # fmt: skip
    text = flow(
        f"Growth, one round each; a measurement may take {memory:g} GiB. With many visits the model gets finer "
        "functions, so more parameters; beyond 4,096 strengths and noise are learnt from so many, and all pass twice. "
        "The recording itself, as arrays, is not counted."
    )
    header = ["visits", "parameters", "identify, s", "ms per visit", "peak memory above data"]
    return f"{text}\n\n{table(header, rows)}\n"


if __name__ == "__main__":
    main()
