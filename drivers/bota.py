"""A Bota-style force/torque sensor that streams binary frames (460800 8N1).

    AA | u16 status | 6 × f32 | u32 timestamp | f32 °C | u16 CRC16-X25       little-endian, 37 bytes

The CRC covers the 34 bytes between. After a bad CRC one byte is dropped, not the frame: an AA inside the data must not
cost the frame that begins in its shadow. Status bits: 0 overrun, 1 overrange, 2 invalid, 3 raw (uncalibrated). The time
stamp counts microseconds and begins anew after 71 minutes.

The sensor offers no serial number in this protocol, so check() can only say that it streams, and what.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from fastcrc.crc16 import ibm_sdlc as crc16_x25

from drivers.force_torque import Calibration, SerialStream
from drivers.ports import Clock, DeviceInfo, WrenchReading
from drivers.serial_port import Port
from ppshw.errors import HardwareTimeout, InstrumentFault, ProtocolError, SensorOverrange

HEADER = 0xAA
FRAME_LENGTH = 37
OVERRUN, OVERRANGE, INVALID, RAW = 1, 2, 4, 8
SAMPLE_CLOCK_HZ = 51200.0  # frames come at this rate divided by the length of the sinc filter
ADAPTER_LATENCY_S = 0.016  # a USB adapter may hold bytes this long, so that a flush does not reach them
_PAYLOAD = struct.Struct("<H6fIf")
_CRC = struct.Struct("<H")


@dataclass(frozen=True)
class BotaFrame:
    status: int
    wrench: tuple[float, ...]  # as sent: N, N·m
    timestamp: int
    temperature_c: float


class BotaParser:
    """Finds frames in whatever comes over the line; `dropped` counts the bytes that belonged to none."""

    frame_length = FRAME_LENGTH

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.dropped = 0

    def feed(self, data: bytes) -> list[BotaFrame]:
        buffer = self._buffer
        buffer += data
        frames: list[BotaFrame] = []
        at = 0
        while True:
            found = buffer.find(HEADER, at)
            self.dropped += (found if found >= 0 else len(buffer)) - at
            at = found if found >= 0 else len(buffer)
            if at + FRAME_LENGTH > len(buffer):
                break
            payload = bytes(buffer[at + 1 : at + 35])
            if crc16_x25(payload) == _CRC.unpack_from(buffer, at + 35)[0]:
                status, *wrench, timestamp, temperature = _PAYLOAD.unpack(payload)
                frames.append(BotaFrame(status, tuple(wrench), timestamp, temperature))
                at += FRAME_LENGTH
            else:
                at += 1
                self.dropped += 1
        del buffer[:at]
        return frames


class _Pace:
    """Whether frames come as they are measured. A backlog comes faster, by its time stamps: its frames are older than
    those after it by as much, and whoever wants what is measured now begins anew with each that has caught up.

    slack_s   what a line may bunch its frames
    """

    def __init__(self, name: str, clock: Clock, slack_s: float) -> None:
        self._name, self._clock, self._slack = name, clock, slack_s
        self._last: int | None = None
        self._measured = 0.0  # s of the sensor's time since the first frame
        self._lead = -math.inf

    def begins_anew(self, frame: BotaFrame) -> bool:
        """Raises InstrumentFault where the time stamp does not go on."""
        if self._last is not None:
            step = (frame.timestamp - self._last) % 2**32
            if not 0 < step < 2**31:
                stamps = f"time stamp {frame.timestamp} µs after {self._last} µs"
                raise InstrumentFault(self._name, f"{stamps}: it repeats a frame, or has restarted")
            self._measured += step * 1e-6
        self._last = frame.timestamp
        lead = self._measured - self._clock.now()
        if lead <= self._lead + self._slack:
            return False
        self._lead = lead
        return True


class BotaSensor:
    """Implements ports.ForceSensor.

    samples      frames in one reading, and their median is the reading
    sinc_length  of the sensor's filter: 512 gives 100 frames a second
    zero         (6,) what it reads without payload [N, N·m], subtracted
    matrix       (6, 6) applied to what the sensor sends
    """

    def __init__(
        self,
        port: Port,
        clock: Clock,
        *,
        name: str = "force sensor",
        samples: int = 32,
        sinc_length: int = 512,
        zero: Sequence[float] | None = None,
        matrix: Sequence[Sequence[float]] | None = None,
        baudrate: int = 460800,
        timeout_s: float = 2.0,
    ) -> None:
        self.name = name
        self._clock, self._samples, self._sinc_length = clock, samples, sinc_length
        self._rate = SAMPLE_CLOCK_HZ / sinc_length
        self._calibration = Calibration(zero, matrix)
        self._stream = SerialStream(name, port, baudrate, timeout_s)

    def check(self) -> DeviceInfo:
        self._stream.open()
        frame = self._fresh_frames(1)[-1]
        forces = ", ".join(f"{value:.1f}" for value in frame.wrench[:3])
        return DeviceInfo(
            device=self.name,
            model="Bota-style serial sensor",
            serial="not told",
            firmware="not told",
            status=f"streams, status 0x{frame.status:04X}, {frame.temperature_c:.1f} °C, F = {forces} N",
        )

    def start(self) -> None:
        """Temperature compensation off, calibration on, binary, 460800; filter; stream."""
        self._stream.open()
        self._command("C")
        self._command("c,0,1,0,4")
        self._command(f"f,{self._sinc_length},0,0,1")
        self._command("R")

    def read(self) -> WrenchReading:
        frames = self._fresh_frames(self._samples)
        self._raise_for_status(frames)
        good = [frame for frame in frames if not frame.status & OVERRUN]
        if 2 * len(good) < len(frames):
            raise InstrumentFault(self.name, f"{len(frames) - len(good)} of {len(frames)} frames report an overrun")
        values = np.array([frame.wrench for frame in good])
        if not np.all(np.isfinite(values)):
            raise InstrumentFault(self.name, "sends values that are no numbers")
        temperature = float(np.median([frame.temperature_c for frame in good]))
        return self._calibration.reading(self.name, values, temperature if math.isfinite(temperature) else None)

    def close(self) -> None:
        self._stream.close()

    def _fresh_frames(self, count: int) -> list[BotaFrame]:
        """Frames measured after this call: the line is flushed, a backlog that a network still delivers is dropped, and
        what an adapter may have held is skipped."""
        self._stream.flush()
        held = math.ceil(ADAPTER_LATENCY_S * self._rate) + 1
        live = _Pace(self.name, self._clock, held / self._rate)
        wanted = held + count
        return self._stream.collect(BotaParser(), wanted, wanted / self._rate, FRAME_LENGTH, live.begins_anew)[held:]

    def _raise_for_status(self, frames: Sequence[BotaFrame]) -> None:
        def said(bit: int) -> int:
            return sum(1 for frame in frames if frame.status & bit)

        if n := said(OVERRANGE):
            peak = max((max(map(abs, f.wrench[:3])) for f in frames if f.status & OVERRANGE), default=math.nan)
            raise SensorOverrange(self.name, f"overrange in {n} of {len(frames)} frames, up to {peak:.0f} N")
        if n := said(INVALID):
            raise InstrumentFault(self.name, f"{n} of {len(frames)} frames are marked invalid")
        if n := said(RAW):
            raise InstrumentFault(self.name, f"{n} of {len(frames)} frames are raw counts: its calibration is off")

    def _command(self, command: str) -> None:
        """Send a configuration command and wait for `r,0,<letter>,<code>`; code 0 is success."""
        letter = command[0]
        self._stream.write(command.encode())
        answer = f"r,0,{letter},".encode()
        heard = self._stream.read_until(answer)
        if not heard:
            raise HardwareTimeout(self.name, f"no answer to '{command}' within {self._stream.timeout_s:g} s")
        if not heard.endswith(answer):
            raise ProtocolError(self.name, f"no answer to '{command}' among {len(heard)} bytes")
        code = self._stream.read(1)
        if not re.fullmatch(rb"\d", code):
            raise ProtocolError(self.name, f"'{command}' answered with {code!r} instead of a code")
        if code != b"0":
            raise InstrumentFault(self.name, f"refuses '{command}' with code {code.decode()}")
