"""What the program's process takes of the computer; import this before numpy. A user's own settings are kept.

**One linear-algebra thread.** Measured on two cores, identification of 700 visits: 3.4 s with one thread or two, at
half the processor time with one; and with another program on the same cores two threads wait for each other (45 s were
seen).

**Freed memory is kept.** A diagnosis makes arrays of tens of megabytes by the thousand. glibc gives each back to the
system and asks for it again, and the system clears it every time: 17 of 75 s of a long one's processor time, 4 of 62
where it is kept, with the same peak of 1.6 GB. Where there is no glibc nothing is done.

**As many cores as there are for it** (`cores`), for a diagnosis' products of matrices. Where processes share the
computer, as a study's workers do, each is told its part: threads that wait for each other cost a tenth more.
"""

import ctypes
import os

# From glibc's <malloc.h>, and how much may lie unused before it is given back (mallopt takes an int).
_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4
_KEPT_BYTES = 1_000_000_000
_OF_THE_USER = ("MALLOC_MMAP_MAX_", "MALLOC_TRIM_THRESHOLD_", "GLIBC_TUNABLES", "LD_PRELOAD")


def _keep_memory() -> None:
    if any(name in os.environ for name in _OF_THE_USER):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if os.name == "posix" else None
    if mallopt:
        mallopt(_M_MMAP_MAX, 0)
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)


def cores() -> int:
    """How many the process may use at a time: those that it is confined to, or what PYTHON_CPU_COUNT says, which Python
    itself heeds from 3.13 on."""
    said = os.environ.get("PYTHON_CPU_COUNT", "")
    if said.isdecimal() and int(said) > 0:
        return int(said)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
_keep_memory()
