"""A lock between programs, kept on a file that is there only while somebody holds it.

The system drops it with the process, however that ends.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from ppshw.errors import BadInput


def require_a_system_that_locks() -> None:
    """Raises BadInput on Windows, which has neither the locks nor the signals by which axes are kept to one program."""
    if sys.platform == "win32":
        raise BadInput("machines are driven from Linux (or macOS), not from Windows")


def locked(path: Path) -> int:
    """A handle that holds the lock on a file, made if it is not there.

    Raises BlockingIOError when somebody else does, OSError when it cannot be made or opened.
    """
    import fcntl  # not on Windows, where no machine is driven from

    while True:
        handle = _opened(path)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.stat(path), os.fstat(handle)):
                return handle
        except FileNotFoundError:
            pass
        except OSError:
            os.close(handle)
            raise
        os.close(handle)  # the one before removed the file between our opening and locking it: once more


def _opened(path: Path) -> int:
    """For reading, which is enough for a lock: the file may be another user's."""
    try:
        return os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    except FileNotFoundError:
        handle = os.open(path, os.O_RDONLY | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        if os.fstat(handle).st_uid == os.geteuid():
            os.fchmod(handle, 0o644)  # else a file that was left behind would keep others out, by this one's umask
        return handle
