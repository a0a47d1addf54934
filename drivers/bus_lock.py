"""One program to a CAN bus. Two would configure, move and switch off the same drives, and on a serial adapter each
would hear half of the answers; python-can lets both in.

Whoever opens a bus holds a lock on a file in the system's folder for temporary files, which the system drops with the
process, however that ends. Which bus it is, is told by python-can's own arguments: two names for one adapter are two
buses, except for links to one device. `virtual` buses exist inside one process and are not locked; nor is any on
Windows, where adapters are opened by one program only.
"""

from __future__ import annotations

import contextlib
import os
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ppshw.errors import BusLost

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

# by which python-can's interfaces say which adapter they mean; bitrate and the like say how it is used
WHICH = ("channel", "host", "port", "serial", "unique_hardware_id", "device_id", "device", "index", "bus", "address")


class BusLock:
    """Held from its making until release(). Raises BusLost when another program holds it."""

    def __init__(self, name: str, can: Mapping[str, Any]) -> None:
        self._path = lock_file(can)
        self._handle: int | None = None
        if fcntl is None or can.get("interface") == "virtual":
            return
        try:
            self._handle = _lock(self._path)
        except BlockingIOError:
            raise BusLost(name, "another program has it; wait until that has ended") from None
        except OSError as error:
            raise BusLost(name, f"cannot be locked: {error}") from error

    def release(self) -> None:
        handle, self._handle = self._handle, None
        if handle is not None:
            with contextlib.suppress(OSError):  # another user's
                self._path.unlink()
            os.close(handle)


def lock_file(can: Mapping[str, Any]) -> Path:
    words = [str(can.get("interface"))]
    for key in WHICH:
        if key in can:
            word = str(can[key])
            if word.startswith("/"):  # a device, perhaps by one of udev's links, perhaps with slcan's @baudrate
                word = os.path.realpath(word.partition("@")[0])
            words.append(word)
    return Path(tempfile.gettempdir(), re.sub(r"[^\w.-]+", "_", "-".join(["ppshw", *words, "can.lock"])))


def _lock(path: Path) -> int:
    """A handle that holds the lock. Raises BlockingIOError when somebody else does."""
    while True:
        handle = _open(path)
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


def _open(path: Path) -> int:
    """For reading, which is enough for a lock: the file may be another user's."""
    try:
        return os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    except FileNotFoundError:
        return os.open(path, os.O_RDONLY | os.O_CREAT | os.O_NOFOLLOW, 0o644)
