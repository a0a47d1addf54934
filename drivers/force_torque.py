"""What every force/torque sensor on a serial line shares: collecting frames in time, and the median of them.

Sensor-specific: drivers/bota.py, drivers/gsv8.py. A sensor's numbers become a wrench by

    w = M f − w₀                                                                       [N, N·m]

    f    (6,)    what the frame says
    M    (6, 6)  calibration matrix; identity when the sensor applies its own
    w₀   (6,)    what it reads without payload, in SI units; what counts as payload: docs/site.md
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

import numpy as np
import serial

from drivers.ports import Array, WrenchReading
from drivers.serial_port import Port, line, open_port, port_name
from ppshw.errors import HardwareTimeout, InstrumentFault, LineLost, ProtocolError
from ppshw.recording import LARGEST_WRENCH

Frame_co = TypeVar("Frame_co", covariant=True)
Frame = TypeVar("Frame")

# A line that carries this many times the bytes that were needed, and still not the frames, carries garbage.
GARBAGE = 4


class Parser(Protocol[Frame_co]):
    """Bytes in, whole frames out; keeps what is incomplete."""

    frame_length: int

    def feed(self, data: bytes) -> Sequence[Frame_co]: ...


class SerialStream:
    """An open line that frames come from."""

    def __init__(self, name: str, port: Port, baudrate: int, timeout_s: float) -> None:
        self.name = name
        self.timeout_s = timeout_s
        self._where, self._baudrate = port, baudrate
        self._port: serial.Serial | None = None

    def open(self) -> None:
        if self._port is None:
            self._port = open_port(self.name, self._where, baudrate=self._baudrate, timeout_s=self.timeout_s)

    def close(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    def write(self, data: bytes) -> None:
        with line(self.name, self._where):
            self.port.write(data)

    def read_until(self, expected: bytes) -> bytes:
        """Up to and including `expected`, or what came until the timeout."""
        with line(self.name, self._where):
            self.port.timeout = self.timeout_s
            return bytes(self.port.read_until(expected))

    def read(self, size: int) -> bytes:
        with line(self.name, self._where):
            self.port.timeout = self.timeout_s
            return bytes(self.port.read(size))

    def flush(self) -> None:
        """Throw away what has piled up since the last reading, also what a network is still delivering.

        A live stream leaves gaps between its frames, a backlog does not.
        """
        with line(self.name, self._where):
            for _ in range(50):
                self.port.reset_input_buffer()
                time.sleep(0.0005)
                if not self.port.in_waiting:
                    return

    def collect(
        self,
        parser: Parser[Frame],
        wanted: int,
        expected_s: float = 0.0,
        at_once: int | None = None,
        begins: Callable[[Frame], bool] = lambda frame: False,
    ) -> list[Frame]:
        """The next `wanted` frames; they may take `expected_s` and the timeout, in real seconds.

        at_once  read no more than this many bytes at a time, for frames of unknown length that nothing may follow
        begins   asked of each frame as it comes: whether to begin with this one, and to forget those before it
        """
        limit = self.timeout_s + expected_s
        deadline = time.monotonic() + limit
        frames: list[Frame] = []
        heard = 0
        while len(frames) < wanted:
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise self._shortfall(len(frames), wanted, heard, f"within {limit:g} s")
            if heard > GARBAGE * (wanted + 1) * parser.frame_length:
                raise ProtocolError(self.name, f"{heard} bytes held only {len(frames)} of {wanted} frames")
            with line(self.name, self._where):
                self.port.timeout = left
                data = self.port.read(at_once or (wanted - len(frames)) * parser.frame_length)
            heard += len(data)
            for frame in parser.feed(data):
                if begins(frame):
                    frames, heard = [], 0
                frames.append(frame)
        return frames[:wanted]

    def _shortfall(self, got: int, wanted: int, heard: int, when: str) -> HardwareTimeout | ProtocolError:
        where = port_name(self._where)
        if heard == 0:
            return HardwareTimeout(self.name, f"nothing heard on {where} {when}")
        if got == 0:
            return ProtocolError(self.name, f"{heard} bytes on {where}, not one valid frame {when}")
        return HardwareTimeout(self.name, f"only {got} of {wanted} frames on {where} {when}")

    @property
    def port(self) -> serial.Serial:
        if self._port is None:
            raise LineLost(self.name, f"{port_name(self._where)} is not open; start the sensor first")
        return self._port


class Calibration:
    """w = M f − w₀, see above. zero: (6,) [N, N·m]; matrix: (6, 6)."""

    def __init__(self, zero: Sequence[float] | None, matrix: Sequence[Sequence[float]] | None) -> None:
        self.zero = np.zeros(6) if zero is None else np.asarray(zero, dtype=float)
        self.matrix = np.eye(6) if matrix is None else np.asarray(matrix, dtype=float)
        if self.zero.shape != (6,) or self.matrix.shape != (6, 6):
            raise ValueError(f"zero must be (6,), matrix (6, 6), not {self.zero.shape} and {self.matrix.shape}")

    def reading(self, name: str, values: Array, temperature_c: float | None = None) -> WrenchReading:
        """Median and standard deviation over (n, 6) frames of the sensor of this name. Raises InstrumentFault for what
        no payload weighs and no command would read back."""
        wrenches = values @ self.matrix.T - self.zero
        if not (largest := float(np.abs(wrenches).max())) <= LARGEST_WRENCH:
            raise InstrumentFault(
                name, f"reads {largest:.3g} N or N m, expected at most {LARGEST_WRENCH:g} ('matrix' in the site file?)"
            )
        spread = wrenches.std(axis=0, ddof=1) if len(wrenches) > 1 else np.zeros(6)
        return WrenchReading(np.median(wrenches, axis=0), spread, len(wrenches), temperature_c)
