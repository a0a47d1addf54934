"""What the program's process takes of the computer."""

import os
import subprocess
import sys

import pytest

from ppshw.process import cores

FAULTS_OF_ARRAYS = """
import resource
{first}
import numpy as np
np.ones(5_000_000)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    np.ones(5_000_000)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(first: str) -> int:
    """Pages that the system had to hand out anew for twenty arrays of 40 MB, one after the other."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MALLOC_", "GLIBC_"))}
    # Pages of 4 kB, or they come 512 at a time and few of either are counted.
    environment["NUMPY_MADVISE_HUGEPAGE"] = "0"
    done = subprocess.run(
        [sys.executable, "-c", FAULTS_OF_ARRAYS.format(first=first)],
        capture_output=True, text=True, check=True, env=environment,
    )  # fmt: skip
    return int(done.stdout)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc's malloc")
def test_freed_memory_is_kept_for_the_next_large_array() -> None:
    without = faults("")
    kept = faults("import ppshw.process")
    assert kept < without / 10


@pytest.mark.parametrize(("said", "found"), [("3", 3), ("0", None), ("-1", None), ("default", None), ("", None)])
def test_no_more_cores_than_there_are_for_the_process(
    monkeypatch: pytest.MonkeyPatch, said: str, found: int | None
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 5}, raising=False)
    monkeypatch.setenv("PYTHON_CPU_COUNT", said)
    assert cores() == (found or 2)
