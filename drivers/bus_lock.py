"""One program to a CAN bus. Two would configure, move and switch off the same drives, and on a serial adapter each
would hear half of the answers; python-can lets both in.

Whoever opens a bus holds a lock on a file in /tmp, whatever the user's own folder for temporary files is. Which bus it
is, is told by python-can's own arguments: two names for one adapter are two buses, except for links to one device.
`virtual` buses exist inside one process and are not locked.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ppshw.errors import BusLost, BusTaken
from ppshw.file_lock import locked

# by which python-can's interfaces say which adapter they mean; bitrate and the like say how it is used
WHICH = ("channel", "host", "port", "serial", "unique_hardware_id", "device_id", "device", "index", "bus", "address")


class BusLock:
    """Held from its making until release(). Raises BusTaken when another program holds it."""

    def __init__(self, name: str, can: Mapping[str, Any]) -> None:
        self._path = lock_file(can)
        self._handle: int | None = None
        if can.get("interface") == "virtual":
            return
        try:
            self._handle = locked(self._path)
        except BlockingIOError:
            raise BusTaken(name, "another program has it; wait until that has ended") from None
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
    return Path("/tmp", re.sub(r"[^\w.-]+", "_", "-".join(["ppshw", *words, "can.lock"])))
