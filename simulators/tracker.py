"""A simulated total station / laser tracker that speaks Leica GeoCOM ASCII.

It looks at a world of reflectors from its own frame: z along the standing axis, y where the horizontal circle reads
zero, Hz clockwise seen from above, V from the zenith. What it shows is what a real one shows: angles after automatic
target recognition, and a slope distance that is right only in its reference air.

    d_shown = d · n(air) / n_reference · (1 + ppm·1e-6)

The air's index comes from the closed formula of the IAG (1999 resolution 3; Rüeger), not from Ciddor's equations.

Faults, besides those of the line: lose_beam(target | None for all), find_beam(), wrong_transaction(), hold_reply()
and release_reply(), hold_ppm (a setting that does not stick).

Known limitations: turning and measuring take no time; one face; no tilt compensator; the nearest reflector in the field
of view is taken even when two are there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simulators.serial_line import Clock, SerialDevice

Array = NDArray[np.float64]

OK, INVALID_PARAMETER, NOT_IMPLEMENTED = 0, 2, 5
DISTANCE_ERROR, NO_TARGET, NOT_ENABLED = 1292, 8710, 8714
COM_CANT_DECODE = 3072 + 1  # the instrument could not read the request
COM_BAD_CHECKSUM = 3101

REFERENCE_INDEX = 1.000286338  # 658 nm, 12 °C, 1013.25 hPa, 60 %: what the maker's manual says of its red laser
CARRIER_UM = 0.658


class TrackerWorld(Protocol):
    def visible_targets(self) -> Mapping[str, Array]:
        """Where the reflectors truly are, (3,) each [m], in the tracker's frame; hidden ones are left out."""


def calm_air() -> tuple[float, float, float]:
    """Temperature [°C], pressure [hPa], relative humidity [%]."""
    return 20.0, 1013.25, 50.0


def air_index(temperature_c: float, pressure_hpa: float, humidity_pct: float, wavelength_um: float) -> float:
    """Group index from the IAG closed formula, said to be good to 1 ppm.

    N_g = 287.6155 + 4.88660/λ² + 0.06800/λ⁴;  N = N_g (273.15/1013.25) p/T − 11.27 e/T

    e: Magnus formula over water, 6.112 hPa exp(17.62 t/(243.12 + t)).
    """
    kelvin = temperature_c + 273.15
    vapour = humidity_pct / 100 * 6.112 * math.exp(17.62 * temperature_c / (243.12 + temperature_c))
    group = 287.6155 + 4.88660 / wavelength_um**2 + 0.06800 / wavelength_um**4
    return 1.0 + 1e-6 * (group * 273.15 / 1013.25 * pressure_hpa / kelvin - 11.27 * vapour / kelvin)


class SimulatedTracker(SerialDevice):
    """position_sigma [m] per coordinate; field_of_view: half angle of the target recognition [rad]."""

    def __init__(
        self,
        world: TrackerWorld,
        clock: Clock,
        *,
        seed: int = 0,
        position_sigma: float = 2.0e-5,
        field_of_view: float = math.radians(0.5),
        air: Callable[[], tuple[float, float, float]] = calm_air,
        serial_number: int = 886001,
    ) -> None:
        super().__init__(seed)
        self._world, self._clock, self._air = world, clock, air
        self._rng = np.random.default_rng([seed, 0x7AC])
        self._sigma, self._field_of_view, self._serial_number = position_sigma, field_of_view, serial_number
        self._line = bytearray()
        self._pointing = (0.0, math.pi / 2)
        self._locked: str | None = None
        self._atr = False
        self._prism = 0
        self._lost: set[str | None] = set()
        self._trid_shift, self._hold_reply = 0, False
        self._held = b""
        self.precision = 15
        self.ppm = 0.0
        self.hold_ppm = False
        self.shots = 0
        self._rpcs: dict[int, Callable[[list[str]], tuple[int, list[str]]]] = {
            0: lambda p: (OK, []),
            107: self._set_precision,
            108: lambda p: (OK, [str(self.precision)]),
            110: lambda p: (OK, ["1", "20", "0"]),
            2126: lambda p: (OK, [self._number(self.ppm), self._number(0.0)]),
            2148: self._set_ppm,
            2151: lambda p: (OK, [self._number(self.ppm)]),
            5003: lambda p: (OK, [str(self._serial_number)]),
            5004: lambda p: (OK, ['"Simulated TS"']),
            5011: lambda p: (OK, [self._number(self._air()[0] + 8.0)]),
            5034: lambda p: (OK, ["8", "10", "0"]),
            9027: self._turn_to,
            9037: self._fine_adjust,
            17008: self._set_prism,
            17009: lambda p: (OK, [str(self._prism)]),
            17017: self._measure,
            18005: self._switch_atr,
            18006: lambda p: (OK, [str(int(self._atr))]),
        }

    # --- faults

    def lose_beam(self, target: str | None = None) -> None:
        """Something stands in front of one target, or of all."""
        self._lost.add(target)

    def find_beam(self) -> None:
        self._lost.clear()

    def wrong_transaction(self) -> None:
        """The next reply carries another request's number."""
        self._trid_shift = 1

    def hold_reply(self) -> None:
        """The next reply is not sent until release_reply()."""
        self._hold_reply = True

    def release_reply(self) -> None:
        self._say(self._held)
        self._held = b""

    # --- the wire

    def _hear(self, data: bytes) -> None:
        self._line += data
        while (end := self._line.find(b"\r\n")) >= 0:
            request = bytes(self._line[:end]).strip()
            del self._line[: end + 2]
            if request:
                self._reply(request)

    def _reply(self, request: bytes) -> None:
        trid, comment, with_crc = 0, COM_CANT_DECODE, False
        body = f":{NOT_IMPLEMENTED}"
        try:
            head, _, tail = request.decode("ascii").partition(":")
            magic, *fields = head.split(",")
            if magic != "%R1Q":
                raise ValueError(magic)
            rpc, trid = int(fields[0]), int(fields[1])
            with_crc, comment = len(fields) > 2, OK
            if with_crc and int(fields[2]) != crc_arc(f"%R1Q,{rpc},{trid}:{tail}".encode()):
                comment = COM_BAD_CHECKSUM
            elif rpc in self._rpcs:
                code, values = self._rpcs[rpc](tail.split(",") if tail else [])
                body = ":" + ",".join([str(code), *values])
        except (ValueError, IndexError, UnicodeDecodeError):
            comment = COM_CANT_DECODE
        trid += self._trid_shift
        self._trid_shift = 0
        start = f"%R1P,{comment},{trid}"
        crc = f",{crc_arc((start + body).encode())}" if with_crc else ""
        reply = f"{start}{crc}{body}\r\n".encode()
        if self._hold_reply:
            self._hold_reply, self._held = False, reply
            return
        self._say(reply)

    def _number(self, value: float) -> str:
        return f"{value:.{self.precision}f}".rstrip("0").rstrip(".") or "0"

    # --- what it does

    def _set_precision(self, p: list[str]) -> tuple[int, list[str]]:
        digits = int(p[0])
        if not 0 <= digits <= 15:
            return INVALID_PARAMETER, []
        self.precision = digits
        return OK, []

    def _set_ppm(self, p: list[str]) -> tuple[int, list[str]]:
        if not self.hold_ppm:
            self.ppm = float(p[0])
        return OK, []

    def _set_prism(self, p: list[str]) -> tuple[int, list[str]]:
        if not 0 <= int(p[0]) <= 9:
            return INVALID_PARAMETER, []
        self._prism = int(p[0])
        return OK, []

    def _switch_atr(self, p: list[str]) -> tuple[int, list[str]]:
        self._atr = p[0] == "1"
        return OK, []

    def _turn_to(self, p: list[str]) -> tuple[int, list[str]]:
        hz, v = float(p[0]), float(p[1])
        if not (math.isfinite(hz) and 0.0 <= v <= math.pi):
            return INVALID_PARAMETER, []
        self._pointing, self._locked = (hz, v), None
        return OK, []

    def _visible(self) -> Mapping[str, Array]:
        if None in self._lost:
            return {}
        return {name: xyz for name, xyz in self._world.visible_targets().items() if name not in self._lost}

    def _fine_adjust(self, p: list[str]) -> tuple[int, list[str]]:
        """Lock on to the reflector nearest to where the telescope points, within the field or the search window."""
        if not self._atr:
            return NOT_ENABLED, []
        reach = max(self._field_of_view, float(p[0]) / 2, float(p[1]) / 2)
        hz, v = self._pointing
        axis = np.array([math.sin(v) * math.sin(hz), math.sin(v) * math.cos(hz), math.cos(v)])
        off = {name: _angle_between(axis, xyz) for name, xyz in self._visible().items()}
        self._locked = min(off, key=lambda name: off[name], default=None)
        if self._locked is None or off[self._locked] > reach:
            self._locked = None
            return NO_TARGET, []
        return OK, []

    def _measure(self, p: list[str]) -> tuple[int, list[str]]:
        target = self._visible().get(self._locked) if self._locked else None
        if target is None:
            hz, v = self._pointing
            return DISTANCE_ERROR, [self._number(hz), self._number(v), "0", p[0]]
        self.shots += 1
        x, y, z = np.asarray(target, dtype=float) + self._rng.normal(0.0, self._sigma, 3)
        distance = math.sqrt(x * x + y * y + z * z)
        hz, v = math.atan2(x, y) % math.tau, math.atan2(math.hypot(x, y), z)
        self._pointing = (hz, v)
        shown = distance * air_index(*self._air(), CARRIER_UM) / REFERENCE_INDEX * (1.0 + 1e-6 * self.ppm)
        return OK, [self._number(hz), self._number(v), self._number(shown), p[0]]


def _angle_between(unit: Array, vector: Array) -> float:
    return math.atan2(float(np.linalg.norm(np.cross(unit, vector))), float(np.dot(unit, vector)))


def _arc_table() -> list[int]:
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
        table.append(crc)
    return table


_ARC = _arc_table()


def crc_arc(data: bytes) -> int:
    """CRC-16/ARC (polynomial 0x8005 reflected, start 0), the checksum GeoCOM lines may carry."""
    crc = 0
    for byte in data:
        crc = crc >> 8 ^ _ARC[(crc ^ byte) & 0xFF]
    return crc
