"""An ME-Messsysteme GSV-8 amplifier with a six-axis sensor.

    AA | 0x10 | (n−1) | status | n × f32 | 85      measured values, big-endian; six channels: AA 15 … 85, 28 bytes
    AA | 0x90 + len   | command  | parameters | 85 request
    AA | 0x50 + len   | code     | parameters | 85 answer; code 0: done

Status bits: 0 input overload, 1 six-axis error, 4–6 the type of the values (3: float32). There is no checksum: most
single-bit errors look like valid frames. So values outside the sensor's range are dropped, then values far from the
median, and what is left has to be the greater part.

The stream runs only while a reading is taken, so nothing old can lie in a buffer: what comes before the answer to
"start" is thrown away.

Guesses: the serial number is a big-endian u32, the firmware pairs of bytes; both are only shown.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.force_torque import Calibration, SerialStream
from drivers.ports import Array, Clock, DeviceInfo, WrenchReading
from drivers.serial_port import Port
from ppshw.errors import HardwareError, InstrumentFault, ProtocolError, SensorOverrange

PREFIX, SUFFIX = 0xAA, 0x85
VALUES = 0x15
FRAME_LENGTH = 28
OVERLOAD, SIX_AXIS_ERROR = 1, 2
TYPE_MASK, FLOAT32 = 0x70, 0x30
SERIAL_NUMBER, STOP, START, FIRMWARE = 0x1F, 0x23, 0x24, 0x2B
MOST_SKIPPED = 1000  # frames of the other kind, while values or an answer are waited for
_VALUES = struct.Struct(">6f")


@dataclass(frozen=True)
class GsvFrame:
    """A measured-value frame (values: six floats) or an answer (code, payload)."""

    code: int  # status of values, return code of an answer
    values: tuple[float, ...] | None
    payload: bytes = b""


class GsvParser:
    """Frames by their prefix, length and suffix; on a misfit one byte is dropped."""

    frame_length = FRAME_LENGTH

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[GsvFrame]:
        buffer = self._buffer
        buffer += data
        frames: list[GsvFrame] = []
        while True:
            start = buffer.find(PREFIX)
            skip = start if start >= 0 else len(buffer)
            del buffer[:skip]
            if len(buffer) < 2:
                return frames
            kind = buffer[1]
            length = FRAME_LENGTH if kind == VALUES else 4 + (kind & 0x0F) if kind & 0xF0 == 0x50 else 0
            if length > len(buffer):
                return frames
            if length and buffer[length - 1] == SUFFIX and (kind != VALUES or buffer[2] & TYPE_MASK == FLOAT32):
                values = _VALUES.unpack_from(buffer, 3) if kind == VALUES else None
                frames.append(GsvFrame(buffer[2], values, bytes(buffer[3 : length - 1])))
                del buffer[:length]
            else:
                del buffer[:1]


class Gsv8Sensor:
    """Implements ports.ForceSensor.

    samples          frames in one reading
    force_limit      [N] and moment_limit [N·m]: no value beyond is believed
    rate             frames a second, as configured in the amplifier; only for how long a reading may take
    zero, matrix     as in drivers/force_torque.py
    """

    def __init__(
        self,
        port: Port,
        clock: Clock,
        *,
        name: str = "force sensor",
        samples: int = 32,
        force_limit: float = 2.0e4,
        moment_limit: float = 5.0e3,
        rate: float = 50.0,
        zero: Sequence[float] | None = None,
        matrix: Sequence[Sequence[float]] | None = None,
        baudrate: int = 115200,
        timeout_s: float = 2.0,
    ) -> None:
        self.name = name
        self._clock, self._samples, self._rate = clock, samples, rate
        self._limit = np.array([force_limit] * 3 + [moment_limit] * 3)
        self._calibration = Calibration(zero, matrix)
        self._stream = SerialStream(name, port, baudrate, timeout_s)

    def check(self) -> DeviceInfo:
        self._stream.open()
        self._command(STOP)
        number = int.from_bytes(self._command(SERIAL_NUMBER), "big")
        version = self._command(FIRMWARE)
        firmware = ".".join(str(int.from_bytes(version[i : i + 2], "big")) for i in range(0, len(version), 2))
        return DeviceInfo(self.name, "GSV-8", f"{number:08d}", firmware, "answers, stream stopped")

    def start(self) -> None:
        self._stream.open()
        self._command(STOP)

    def read(self) -> WrenchReading:
        self._stream.flush()
        self._command(START)
        try:
            frames = self._measured(self._samples)
        except HardwareError:
            with contextlib.suppress(HardwareError):  # the first error is the one to tell
                self._stream.write(_request(STOP))
            raise
        self._command(STOP)
        self._raise_for_status(frames)
        return self._calibration.reading(self.name, self._plausible(np.array([frame.values for frame in frames])))

    def close(self) -> None:
        self._stream.close()

    def _measured(self, count: int) -> list[GsvFrame]:
        parser, frames, skipped = GsvParser(), list[GsvFrame](), 0
        while len(frames) < count:
            missing = count - len(frames)
            came = self._stream.collect(parser, missing, missing / self._rate)
            frames += (values := [frame for frame in came if frame.values is not None])
            skipped += len(came) - len(values)
            if skipped > MOST_SKIPPED:
                raise ProtocolError(self.name, f"{skipped} answers, but only {len(frames)} of {count} values")
        return frames

    def _raise_for_status(self, frames: Sequence[GsvFrame]) -> None:
        """One flagged frame among many may be a flipped bit; more than a tenth is the sensor speaking."""
        for bit, what in ((OVERLOAD, "input overload"), (SIX_AXIS_ERROR, "six-axis limit exceeded")):
            n = sum(1 for frame in frames if frame.code & bit)
            if n > len(frames) // 10:
                raise SensorOverrange(self.name, f"{what} in {n} of {len(frames)} frames")

    def _plausible(self, values: Array) -> Array:
        """The frames (n, 6) that can be true: inside the range, and within 12 robust deviations of the median."""
        inside = values[np.all(np.isfinite(values) & (np.abs(values) <= self._limit), axis=1)]
        kept = inside
        if len(inside):
            off = np.abs(inside - np.median(inside, axis=0))
            # The floor lets a quiet, coarsely quantised channel change by its last digit.
            reach = np.maximum(12 * 1.4826 * np.median(off, axis=0), 1e-4 * self._limit)
            kept = inside[np.all(off <= reach, axis=1)]
        if 2 * len(kept) <= len(values):
            raise ProtocolError(self.name, f"only {len(kept)} of {len(values)} frames are plausible")
        return kept

    def _command(self, code: int) -> bytes:
        """Send a command, skip the measured values that come before its answer, return the answer's parameters."""
        self._stream.write(_request(code))
        parser = GsvParser()
        skipped = 0
        while True:
            frame = self._stream.collect(parser, 1, at_once=1)[0]
            if frame.values is None:
                break
            skipped += 1
            if skipped > MOST_SKIPPED:
                raise ProtocolError(self.name, f"command 0x{code:02X}: {skipped} values, but no answer")
        if frame.code != 0:
            raise InstrumentFault(self.name, f"refuses command 0x{code:02X} with code 0x{frame.code:02X}")
        return frame.payload


def _request(command: int) -> bytes:
    return bytes([PREFIX, 0x90, command, SUFFIX])
