"""How a simulated device is put on a serial endpoint that a driver opens like a real one.

    LoopbackPort(device)        a pyserial port inside this process, for tests and fast-forward campaigns
    TcpLine(device).url         socket://127.0.0.1:PORT, for a process of its own
    PtyLine(device).url         /dev/pts/N, configured exactly like a USB adapter

A device is bytes in, bytes out. On a TCP or pty line a thread carries them and a streaming device is paced by its
clock. In-process there is no thread: the device is asked when the host listens, and a streaming device goes on talking
for as long as the host wants, so that reading 32 frames costs no waiting.

Known limitations: baud rates are not simulated (bytes arrive at once); a TCP line takes one host at a time; bytes that
a host leaves unread longer than the buffers hold are lost, as on a UART.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import time
import tty
from typing import Any, Protocol

import numpy as np
import serial

BUFFER = 4096  # bytes an operating system keeps for a serial port that nobody reads


class Clock(Protocol):
    def now(self) -> float: ...


class Device(Protocol):
    """What sits at the far end of the line."""

    plugged: bool
    streaming: bool
    carried: bool  # by a thread that looks every few milliseconds, not by the host itself

    def receive(self, data: bytes) -> None:
        """Bytes from the host."""

    def due(self) -> bytes:
        """What has been put on the line by now and was not taken before."""

    def more(self) -> bytes:
        """What comes next if the host goes on listening; asked by an in-process line, which does not wait."""


class SerialDevice:
    """What every simulated device shares: the output buffer, and the troubles a line can have.

    Faults: garble(n), bit_errors(rate), go_silent(), speak(), unplug(), plug().
    """

    streaming = False
    carried = False

    def __init__(self, seed: int = 0) -> None:
        self.plugged = True
        self._out = bytearray()
        self._silent = False
        self._garble_left = 0
        self._bit_error_rate = 0.0
        self._line_noise = np.random.default_rng([seed, 0x11E])
        self._lock = threading.RLock()

    def garble(self, count: int) -> None:
        """The next `count` bytes the host receives are random."""
        self._garble_left = count

    def bit_errors(self, rate: float) -> None:
        """Every bit towards the host is flipped with this probability."""
        self._bit_error_rate = rate

    def go_silent(self) -> None:
        """Hears nothing and says nothing, but stays plugged in."""
        self._silent = True
        self._out.clear()

    def speak(self) -> None:
        self._silent = False

    def unplug(self) -> None:
        self.plugged = False
        self._out.clear()

    def plug(self) -> None:
        self.plugged = True

    def receive(self, data: bytes) -> None:
        if self._silent or not self.plugged:
            return
        with self._lock:
            self._hear(data)

    def due(self) -> bytes:
        with self._lock:
            if not self._silent:
                self._fall_due()
            sent = bytes(self._out)
            self._out.clear()
        return sent

    def more(self) -> bytes:
        if self._silent:
            return b""
        with self._lock:
            self._go_on()
        return self.due()

    def _hear(self, data: bytes) -> None:
        raise NotImplementedError

    def _fall_due(self) -> None:
        """Put on the line what time has brought; only devices that stream have anything to do."""

    def _go_on(self) -> None:
        """Put the next frame on the line although its time has not come."""

    def _say(self, data: bytes) -> None:
        self._out += self._trouble(data)
        if len(self._out) > BUFFER:
            del self._out[BUFFER:]  # a full UART buffer drops what comes last

    def _trouble(self, data: bytes) -> bytes:
        if self._garble_left:
            n = min(self._garble_left, len(data))
            self._garble_left -= n
            data = self._line_noise.bytes(n) + data[n:]
        if self._bit_error_rate:
            flips = self._line_noise.random(8 * len(data)) < self._bit_error_rate
            data = bytes(np.frombuffer(data, np.uint8) ^ np.packbits(flips))
        return data


class LoopbackPort(serial.SerialBase):
    """A pyserial port whose cable ends at a device in this process. Timeouts are real seconds."""

    def __init__(self, device: Device, **settings: Any) -> None:
        self._device = device
        self._inbox = bytearray()
        super().__init__(None, **settings)
        self.port = "loopback"
        self.open()

    def open(self) -> None:
        if not self._device.plugged:
            raise serial.SerialException("could not open port loopback: no such device")
        self.is_open = True

    def close(self) -> None:
        self.is_open = False
        self._inbox.clear()

    def _reconfigure_port(self) -> None:
        """Nothing to configure."""

    @property
    def in_waiting(self) -> int:
        self._inbox += self._live().due()
        return len(self._inbox)

    def write(self, data: Any) -> int:
        self._live().receive(bytes(data))
        return len(data)

    def read(self, size: int = 1) -> bytes:
        deadline: float | None = None
        while len(self._inbox) < size:
            device = self._live()
            arrived = device.due() or device.more()
            if arrived:
                self._inbox += arrived
                continue
            if deadline is None:
                deadline = time.monotonic() + (1e9 if self.timeout is None else self.timeout)
            if time.monotonic() >= deadline:
                break
            time.sleep(0.001)
        taken = bytes(self._inbox[:size])
        del self._inbox[:size]
        return taken

    def reset_input_buffer(self) -> None:
        self._live().due()
        self._inbox.clear()

    def reset_output_buffer(self) -> None:
        """Everything written has arrived already."""

    def _live(self) -> Device:
        if not self.is_open:
            raise serial.PortNotOpenError()
        if not self._device.plugged:
            raise serial.SerialException("device disconnected")
        return self._device


class _Carrier:
    """The thread between a device and a file descriptor."""

    def __init__(self, device: Device, name: str) -> None:
        self._device = device
        device.carried = True
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def __enter__(self) -> _Carrier:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        self._stop.set()
        self._thread.join(timeout=5)

    def _run(self) -> None:
        raise NotImplementedError

    def _held_back(self, said: bytes) -> bytes:
        """What of it goes on its way now."""
        return said

    def _carry(self, fd: int) -> None:
        """Until the host hangs up, the device is unplugged, or the line is closed."""
        while self._device.plugged and not self._stop.is_set():
            readable, _, _ = select.select([fd], [], [], 0.005 if self._device.streaming else 0.05)
            if readable:
                heard = os.read(fd, 4096)
                if not heard:
                    return
                self._device.receive(heard)
            said = self._held_back(self._device.due())
            if said:
                with contextlib.suppress(BlockingIOError):  # the host does not listen: lost, as on a UART
                    os.write(fd, said)


class TcpLine(_Carrier):
    """A serial-to-Ethernet server with the device behind it; `port` 0 takes a free one.

    Fault: hold() keeps what the device says, the oldest BUFFER bytes of it, until let_go().
    """

    def __init__(self, device: Device, port: int = 0, host: str = "127.0.0.1") -> None:
        super().__init__(device, f"tcp-line-{port}")
        self._holds = False
        self._backlog = b""
        self._listener = socket.create_server((host, port))
        self._listener.settimeout(0.05)
        self.url = f"socket://{host}:{self._listener.getsockname()[1]}"
        self._thread.start()

    def hold(self) -> None:
        self._holds = True

    def let_go(self) -> None:
        self._holds = False

    def _held_back(self, said: bytes) -> bytes:
        kept = (self._backlog + said)[:BUFFER] if self._holds or self._backlog else said
        self._backlog = kept if self._holds else b""
        return b"" if self._holds else kept

    def close(self) -> None:
        super().close()
        self._listener.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                connection, _ = self._listener.accept()
            except TimeoutError:
                continue
            with connection:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
                connection.setblocking(False)
                if not self._device.plugged:
                    self._stop.wait(0.01)
                    continue
                self._device.due()  # what was said before anybody listened is gone
                with contextlib.suppress(ConnectionError):
                    self._carry(connection.fileno())


class PtyLine(_Carrier):
    """A pseudo-terminal: the host opens `url` like /dev/ttyUSB0. Unplugging takes the terminal away for good."""

    def __init__(self, device: Device) -> None:
        super().__init__(device, "pty-line")
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self.url = os.ttyname(slave)
        self._slave: int | None = slave  # kept open, or the master hangs up whenever no host is there
        self._thread.start()

    def close(self) -> None:
        super().close()

    def _run(self) -> None:
        try:
            with contextlib.suppress(OSError):
                self._carry(self._master)
        finally:
            if self._slave is not None:
                os.close(self._slave)
                self._slave = None
            os.close(self._master)
