"""Simulated force/torque sensors: a Bota-style stream and a GSV-8 amplifier, as bytes.

The world says what wrench the payload applies; a sensor adds Gaussian noise from its own generator.

A stream is a function of the clock: `rate` frames a second fall due. In-process, what falls due between two visits of
the host carries the wrench of the *earlier* visit, the worst case for a host that reads old frames; a host that goes on
listening gets the next frames at once, with time stamps of this moment, a microsecond apart: no time passes while it
listens. On a line with a thread the frames are those of the moment, some milliseconds late, and at most BURST of them
at a time.

Faults, besides those of the line: overrange(), invalid(), raw(), hang() (a Bota: one frame again and again), recover(),
refuse (a command letter or code).

Known limitations: no filter delay, no temperature drift, no creep; settings other than the frame rate are accepted and
have no effect.
"""

from __future__ import annotations

import re
import struct
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simulators.serial_line import BUFFER, Clock, SerialDevice

Array = NDArray[np.float64]
BURST = 32


class ForceWorld(Protocol):
    def wrench(self) -> Array:
        """(6,) what the payload applies to the sensor now, in the sensor frame [N, N·m]."""


class _Sensor(SerialDevice):
    """force_sigma [N], moment_sigma [N·m]: standard deviation of one frame."""

    frame_length = 0

    def __init__(
        self,
        world: ForceWorld,
        clock: Clock,
        *,
        seed: int = 0,
        force_sigma: float = 0.5,
        moment_sigma: float = 0.2,
        rate: float = 100.0,
    ) -> None:
        super().__init__(seed)
        self._world, self._clock, self._rate = world, clock, rate
        self._sigma = np.array([force_sigma] * 3 + [moment_sigma] * 3)
        self._rng = np.random.default_rng([seed, 0xF0])
        self._status = 0
        self._told_until = clock.now()
        self._wrench_then = np.zeros(6)
        self._start_stream()

    def _start_stream(self) -> None:
        self.streaming = True
        self._told_until = self._clock.now()
        self._wrench_then = np.asarray(self._world.wrench(), dtype=float)

    def _stop_stream(self) -> None:
        self.streaming = False

    def _fall_due(self) -> None:
        if not self.streaming:
            return
        count = int((self._clock.now() - self._told_until) * self._rate)
        if count <= 0:
            return
        self._told_until += count / self._rate
        wrench_now = np.asarray(self._world.wrench(), dtype=float)
        wrench = wrench_now if self.carried else self._wrench_then
        # More than a port's buffer holds is lost anyway, and simulated time may run faster than any line.
        kept = min(count, BURST if self.carried else BUFFER // self.frame_length)
        noise = self._rng.normal(0.0, self._sigma, (kept, 6))
        for i in range(kept):
            self._say(self._frame(wrench + noise[i], self._told_until - (kept - 1 - i) / self._rate))
        self._wrench_then = wrench_now

    def _go_on(self) -> None:
        if not self.streaming:
            return
        wrench = np.asarray(self._world.wrench(), dtype=float)
        for _ in range(8):
            self._told_until += 1.0 / self._rate
            self._say(self._frame(wrench + self._rng.normal(0.0, self._sigma), self._told_until))
        self._wrench_then = wrench

    def _frame(self, wrench: Array, seconds: float) -> bytes:
        raise NotImplementedError


class SimulatedBota(_Sensor):
    """Streams from power-up; `C` … `R` configures it. Answers are `r,0,<letter>,<code>`."""

    frame_length = 37

    def __init__(
        self,
        world: ForceWorld,
        clock: Clock,
        *,
        seed: int = 0,
        force_sigma: float = 0.5,
        moment_sigma: float = 0.2,
        rate: float = 100.0,
    ) -> None:
        self._heard = ""
        self.refuse = ""
        self.temperature_c = 31.0
        self._stamp = 0  # µs
        self._hung: bytes | None = None
        super().__init__(world, clock, seed=seed, force_sigma=force_sigma, moment_sigma=moment_sigma, rate=rate)

    def overrange(self) -> None:
        self._status |= 2

    def invalid(self) -> None:
        self._status |= 4

    def raw(self) -> None:
        self._status |= 8

    def hang(self) -> None:
        self._hung = self._frame(np.asarray(self._world.wrench(), dtype=float), self._clock.now())

    def recover(self) -> None:
        self._status, self._hung = 0, None

    def _frame(self, wrench: Array, seconds: float) -> bytes:
        if self._hung is not None:
            return self._hung
        self._stamp = max(self._stamp + 1, int(min(seconds, self._clock.now()) * 1e6))
        body = struct.pack("<H6fIf", self._status, *wrench, self._stamp % 2**32, self.temperature_c)
        return b"\xaa" + body + struct.pack("<H", crc_x25(body))

    def _hear(self, data: bytes) -> None:
        """Commands have no terminator: each is complete as soon as it matches."""
        self._heard += data.decode("ascii", "replace")
        while found := re.match(r"(C|R)|(c),\d,\d,\d,\d|(f),(\d+),\d,\d,\d", self._heard):
            self._heard = self._heard[found.end() :]
            letter = found[1] or found[2] or found[3]
            if letter == "C":
                self._stop_stream()
            if letter in self.refuse:
                self._say(f"r,0,{letter},1".encode())
                continue
            if letter == "f":
                self._rate = 51200.0 / int(found[4])
            self._say(f"r,0,{letter},0".encode())
            if letter == "R":
                self._start_stream()
        self._heard = self._heard[-32:]


class SimulatedGsv8(_Sensor):
    """Streams from power-up until command 0x23; answers AA 50+n code … 85."""

    frame_length = 28

    def __init__(
        self,
        world: ForceWorld,
        clock: Clock,
        *,
        seed: int = 0,
        force_sigma: float = 0.5,
        moment_sigma: float = 0.2,
        rate: float = 50.0,
        serial_number: int = 17330042,
    ) -> None:
        self._heard = bytearray()
        self._serial_number = serial_number
        self.refuse: set[int] = set()
        super().__init__(world, clock, seed=seed, force_sigma=force_sigma, moment_sigma=moment_sigma, rate=rate)

    def overrange(self) -> None:
        self._status |= 1

    def six_axis_error(self) -> None:
        self._status |= 2

    def recover(self) -> None:
        self._status = 0

    def _frame(self, wrench: Array, seconds: float) -> bytes:
        return bytes([0xAA, 0x15, 0x30 | self._status]) + struct.pack(">6f", *wrench) + b"\x85"

    def _hear(self, data: bytes) -> None:
        self._heard += data
        while (start := self._heard.find(0xAA)) >= 0:
            del self._heard[:start]
            if len(self._heard) < 2:
                return
            length = 4 + (self._heard[1] & 0x0F)
            if len(self._heard) < length:
                return
            if self._heard[1] & 0xF0 == 0x90 and self._heard[length - 1] == 0x85:
                self._obey(self._heard[2])
                del self._heard[:length]
            else:
                del self._heard[:1]
        self._heard.clear()

    def _obey(self, command: int) -> None:
        if command in self.refuse or command not in {0x1F, 0x23, 0x24, 0x2B, 0x3B}:
            self._answer(0x40)
            return
        if command == 0x23:
            self._stop_stream()
        self._answer(
            0,
            {0x1F: struct.pack(">I", self._serial_number), 0x2B: struct.pack(">HH", 1, 42)}.get(command, b""),
        )
        if command == 0x24:
            self._start_stream()
        if command == 0x3B:
            now = np.asarray(self._world.wrench(), dtype=float) + self._rng.normal(0.0, self._sigma)
            self._say(self._frame(now, self._clock.now()))

    def _answer(self, code: int, payload: bytes = b"") -> None:
        self._say(bytes([0xAA, 0x50 | len(payload), code]) + payload + b"\x85")


def _x25_table() -> list[int]:
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
        table.append(crc)
    return table


_X25 = _x25_table()


def crc_x25(data: bytes) -> int:
    """CRC-16/X-25 (ITU-T X.25: polynomial 0x1021 reflected, start and final complement)."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _X25[(crc ^ byte) & 0xFF]
    return crc ^ 0xFFFF
