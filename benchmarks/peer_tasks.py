"""What every peer's script shares: read the task, time it, write the answer. In their environments: numpy only.

python peer_X.py TASK.npz ANSWER.json
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np


def microseconds(run: Callable[[Any], Any], poses: Any, rounds: int) -> list[float]:
    """Microseconds per pose of every round, one call of `run` per pose: none of the peers takes many at once.

    Processor time, as in figures.py; a first call does not count.
    """
    run(poses[0])
    out = []
    for _ in range(rounds):
        started = time.process_time()
        for q in poses:
            run(q)
        out.append((time.process_time() - started) / len(poses) * 1e6)
    return out


def main(tasks: dict[str, Callable[[Any], dict[str, Any]]]) -> None:
    """Run the task that the file names; numpy's answers become lists."""
    task = np.load(sys.argv[1])
    answer = tasks[str(task["task"])](task)
    with open(sys.argv[2], "w", encoding="utf-8") as file:
        json.dump(answer, file, default=lambda a: a.tolist())
