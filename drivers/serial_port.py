"""Opening a serial line, and saying so when it is gone.

A port is what pyserial opens: `/dev/ttyUSB0` or `socket://10.0.0.7:4001`; or an object that is such a port.
"""

from __future__ import annotations

import contextlib
import errno
import time
from collections.abc import Iterator
from termios import error as TermiosError
from typing import cast

import serial
from serial.serialutil import SerialBase, SerialTimeoutException

from ppshw.errors import HardwareTimeout, LineLost

Port = str | SerialBase
QUIET_S, LONGEST_S = 0.05, 1.0  # real seconds without a byte that end a backlog; no backlog lasts longer
LINE_ERRORS = (serial.SerialException, OSError, TermiosError)


def port_name(port: Port) -> str:
    return port if isinstance(port, str) else str(port.port)


def open_port(device: str, port: Port, *, baudrate: int, timeout_s: float) -> serial.Serial:
    """Raises LineLost when there is no such port, or somebody else has it. timeout_s: real seconds."""
    try:
        if isinstance(port, str):
            exclusive = "://" not in port or None  # a lock, which URLs do not have
            return serial.serial_for_url(
                port, baudrate=baudrate, timeout=timeout_s, write_timeout=timeout_s, exclusive=exclusive
            )
        opened = cast(serial.Serial, port)  # every pyserial port has open(); its base class does not say so
        if not opened.is_open:
            opened.open()
        opened.timeout = timeout_s
        return opened
    except (*LINE_ERRORS, ValueError) as error:
        taken = getattr(error, "errno", None) in (errno.EAGAIN, errno.EBUSY)
        reason = "another program has it" if taken else str(error)
        raise LineLost(device, f"cannot open {port_name(port)}: {reason}") from error


@contextlib.contextmanager
def line(device: str, port: Port) -> Iterator[None]:
    """Turns what pyserial raises inside into an error that names the device and the port."""
    try:
        yield
    except SerialTimeoutException as error:
        raise HardwareTimeout(device, f"{port_name(port)} takes no more bytes: {error}") from error
    except LINE_ERRORS as error:
        raise LineLost(device, f"lost the port {port_name(port)}: {error}") from error


def drain(port: serial.Serial) -> None:
    """Read and forget until nothing has come for QUIET_S, LONGEST_S at most."""
    saved, port.timeout = port.timeout, QUIET_S
    deadline = time.monotonic() + LONGEST_S
    try:
        while port.read(256) and time.monotonic() < deadline:
            pass
    finally:
        port.timeout = saved
