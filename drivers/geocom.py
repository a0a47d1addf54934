"""A Leica total station or tracker over GeoCOM ASCII, by way of `geocompy`.

Axes of the tracker's frame: z along the standing axis, upwards; y where the horizontal circle reads zero; x to the
right of y. Leica counts Hz clockwise seen from above, and V from the zenith:

    x = d sin V sin Hz,   y = d sin V cos Hz,   z = d cos V

Where that frame stands in the base frame is the machine file's business (tracker.base), not this file's.

The atmosphere is applied here and only here: start() sets the instrument's own correction to 0 ppm and reads back that
the total (atmospheric and geometric) is 0, and set_atmosphere() looks again.

What geocompy 1.0.0 does that one must know:
- floats it *sends* have at most 6 decimals. Only the pointing angles and the search window are sent, so pointing is
  quantised to 1 µrad, which does not matter: what is measured comes from the reply, and replies are parsed in full.
  Replies carry as many decimals as RPC 107 says, so start() sets 15 and reads it back.
- it swallows every exception of the line and returns a code; `_Line` keeps the exception, so the cause can be told.
- after a timeout the late answer would be taken for the next one; the input is emptied before every request.
- without checksums a flipped bit in a digit passes; with them it does not, so they are on unless switched off.
- its constructor sleeps 1 s, once per connection.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from geocompy.communication import SerialConnection
from geocompy.geo import GeoCom
from geocompy.geo.gcdata import Prism, Program
from geocompy.geo.gctypes import GeoComCode, GeoComResponse
from serial.serialutil import SerialException, SerialTimeoutException

from drivers.atmosphere import correction_ppm, implausible
from drivers.ports import Array, Atmosphere, Clock, DeviceInfo, Shot
from drivers.serial_port import LINE_ERRORS, Port, drain, open_port, port_name
from ppshw.errors import (
    BeamLost,
    ConfigurationMismatch,
    HardwareError,
    HardwareTimeout,
    IdentityMismatch,
    InstrumentFault,
    LineLost,
    ProtocolError,
)

T = TypeVar("T")

# comRC codes, and what geocompy says of an answer it cannot use, lie here (COM subsystem).
COM_CODES = range(3072, 3328)
NO_TARGET = {GeoComCode.AUT_NO_TARGET, GeoComCode.TMC_DIST_ERROR, GeoComCode.TMC_ANGLE_OK, GeoComCode.TMC_SIGNAL_ERROR}
PRECISION = 15
_REPLY = re.compile(r"^%R1P,(\d+),(\d+)(?:,(\d+))?:(\d+)")


class _Line(SerialConnection):
    """geocompy's connection, remembering why an exchange failed."""

    failure: Exception | None = None

    def exchange(self, cmd: str) -> str:
        self.failure = None
        try:
            self._port.reset_input_buffer()
            return super().exchange(cmd)
        except Exception as error:
            self.failure = error
            raise


class GeoComTracker:
    """Implements ports.Tracker.

    port             what pyserial opens, or an open pyserial port
    serial_number    refuse any other instrument
    prism            geocompy's name of the reflector: ROUND, MINI, TAPE, THREESIXTY, USER1, …
    wavelength_um    carrier of the distance meter, and
    reference_index  the group index its distances assume; defaults: Leica TPS1200+ to TS60, 658 nm red laser (general
                     knowledge; the manual of the instrument at hand says)
    search_rad       full width of the window searched when the target is not in the field of view at once
    gate_m           a point further than this from the expected one is another target
    timeout_s        real seconds an answer may take; target recognition takes a few
    """

    def __init__(
        self,
        port: Port,
        clock: Clock,
        *,
        name: str = "tracker",
        serial_number: int | None = None,
        baudrate: int = 115200,
        prism: str = "ROUND",
        wavelength_um: float = 0.658,
        reference_index: float = 1.000286338,
        search_rad: float = 0.0175,
        gate_m: float = 0.05,
        timeout_s: float = 15.0,
        checksum: bool = True,
    ) -> None:
        if prism not in Prism.__members__:
            raise ValueError(f"no prism '{prism}'; there are {', '.join(Prism.__members__)}")
        self.name = name
        self._port, self._clock = port, clock
        self._serial_number, self._baudrate, self._prism = serial_number, baudrate, Prism[prism]
        self._wavelength_um, self._reference_index = wavelength_um, reference_index
        self._search_rad, self._gate_m, self._timeout_s = search_rad, gate_m, timeout_s
        self._checksum = checksum
        self._line: _Line | None = None
        self._geo: GeoCom | None = None
        self._started = False
        self._atmosphere: tuple[Atmosphere, float] | None = None
        self._prism_m: float | None = None  # the constant of the prism that was set

    # --- the port

    def check(self) -> DeviceInfo:
        self._connect()
        model, serial_number, firmware = self._identity()
        inside = self._ask(lambda geo: geo.csv.get_internal_temperature())
        ppm, prism_m = self._distance_correction()
        return DeviceInfo(
            device=self.name,
            model=model,
            serial=str(serial_number),
            firmware=firmware,
            status=f"inside {inside:.1f} °C, own distance correction {ppm:g} ppm, prism {1e3 * prism_m:.1f} mm",
        )

    def start(self) -> None:
        self._connect()
        self._identity()
        self._tell(lambda geo: geo.com.set_double_precision(PRECISION))
        self._tell(lambda geo: geo.aus.switch_user_atr(True))
        self._tell(lambda geo: geo.bap.set_prism_type(self._prism))
        self._tell(lambda geo: geo.tmc.set_atmospheric_correction_ppm(0.0))
        self._prism_m = None
        self._require_settings()
        self._started = True

    def set_atmosphere(self, atmosphere: Atmosphere) -> None:
        """The air from now on. It is applied on the host. The instrument is asked whether it is still set as at the
        start: anybody can set another prism at its panel."""
        if fault := implausible(atmosphere):
            raise InstrumentFault(self.name, f"no air to correct with: {fault}")
        if self._started:
            self._require_settings()
        self._atmosphere = (atmosphere, self._clock.now())

    def measure(self, target: str, expected: Array) -> Shot:
        if not self._started:
            raise LineLost(self.name, f"{port_name(self._port)} is not set up; start the tracker first")
        if self._atmosphere is None:
            raise InstrumentFault(self.name, "no atmosphere has been set, so no distance can be corrected")
        if not np.all(np.isfinite(expected)) or not np.any(expected):
            raise InstrumentFault(self.name, f"cannot point at {target}: it is expected at {expected}")
        hz, v = direction(expected)
        self._tell(lambda geo: geo.aut.turn_to(hz, v), target)
        self._tell(lambda geo: geo.aut.fine_adjust(self._search_rad, self._search_rad), target)
        seen_hz, seen_v, slope, _ = self._ask(lambda geo: geo.bap.measure_distance_angle(Program.DISTANCE), target)
        return self._shot(target, expected, float(seen_hz), float(seen_v), slope)

    def close(self) -> None:
        self._started, self._geo = False, None
        if self._line is not None:
            self._line.close()
            self._line = None

    # --- what a measurement means

    def _shot(self, target: str, expected: Array, hz: float, v: float, slope: float) -> Shot:
        assert self._atmosphere is not None
        air, since = self._atmosphere
        ppm = correction_ppm(air, self._wavelength_um, self._reference_index)
        xyz = to_xyz(hz, v, slope * (1.0 + 1e-6 * ppm))
        away = float(np.linalg.norm(xyz - expected))
        if not away <= self._gate_m:
            raise InstrumentFault(
                self.name,
                f"measured something {1e3 * away:.1f} mm from where {target} is expected "
                f"(gate {1e3 * self._gate_m:g} mm): locked on another target?",
            )
        return Shot(
            target=target,
            xyz=xyz,
            raw={"hz_rad": hz, "v_rad": v, "slope_m": slope},
            ppm=ppm,
            atmosphere=air,
            extra={"prism": self._prism.name, "atmosphere_age_s": f"{self._clock.now() - since:.1f}"},
        )

    def _identity(self) -> tuple[str, int, str]:
        model = self._ask(lambda geo: geo.csv.get_instrument_name())
        number = self._ask(lambda geo: geo.csv.get_serial_number())
        firmware = ".".join(str(part) for part in self._ask(lambda geo: geo.csv.get_firmware_version()))
        if self._serial_number is not None and number != self._serial_number:
            raise IdentityMismatch(
                self.name,
                f"{model} number {number} on {port_name(self._port)}, the site file says {self._serial_number}",
            )
        return model, number, firmware

    def _distance_correction(self) -> tuple[float, float]:
        return self._ask(lambda geo: geo.tmc.get_distance_correction())

    def _require_settings(self) -> None:
        self._verify("decimals", PRECISION, lambda geo: geo.com.get_double_precision())
        self._verify("target recognition", True, lambda geo: geo.aus.get_user_atr_state())
        self._verify("prism", self._prism, lambda geo: geo.bap.get_prism_type())
        ppm, prism_m = self._distance_correction()
        if ppm != 0.0:
            raise ConfigurationMismatch(
                self.name, f"corrects distances by {ppm:g} ppm itself; it must be 0, the host corrects them"
            )
        if self._prism_m not in (None, prism_m):
            was, now = 1e3 * self._prism_m, 1e3 * prism_m
            raise ConfigurationMismatch(self.name, f"its prism constant is {now:.2f} mm now, {was:.2f} mm at the start")
        self._prism_m = prism_m

    # --- the line

    def _connect(self) -> None:
        if self._geo is not None:
            return
        port = open_port(self.name, self._port, baudrate=self._baudrate, timeout_s=self._timeout_s)
        self._line = _Line(port)
        try:
            self._geo = GeoCom(self._line, attempts=1, checksum=self._checksum)
        except ConnectionRefusedError:
            failure = self._line.failure
            self.close()
            raise self._line_error(failure, "the null command") from failure

    def _verify(self, what: str, wanted: T, read: Callable[[GeoCom], GeoComResponse[T]]) -> None:
        got = self._ask(read)
        if got != wanted:
            raise ConfigurationMismatch(self.name, f"{what}: set to {_said(wanted)}, reads {_said(got)}")

    def _tell(self, call: Callable[[GeoCom], GeoComResponse[None]], target: str = "") -> None:
        self._exchange(call, target)

    def _ask(self, call: Callable[[GeoCom], GeoComResponse[T]], target: str = "") -> T:
        response = self._exchange(call, target)
        if response.params is None:
            self._resynchronise()
            raise ProtocolError(self.name, f"{response.rpcname}: an answer without values, {response.response!r}")
        return response.params

    def _exchange(self, call: Callable[[GeoCom], GeoComResponse[T]], target: str) -> GeoComResponse[T]:
        """One request and its answer. Whatever is wrong is raised; a later call finds the line in step again."""
        if self._geo is None or self._line is None:
            raise LineLost(self.name, f"{port_name(self._port)} is not open; start the tracker first")
        response = call(self._geo)
        if self._line.failure is not None:
            failure = self._line.failure
            self._resynchronise()
            raise self._line_error(failure, response.rpcname) from failure
        code, said = self._code(response)
        if code in COM_CODES:
            self._resynchronise()
            raise ProtocolError(
                self.name, f"{response.rpcname}: {said}, sent {response.cmd!r}, received {response.response[:80]!r}"
            )
        if self._checksum and response.response.partition(":")[0].count(",") < 3:
            raise ProtocolError(self.name, "answers without checksum; set `checksum: false` if it cannot do better")
        if target and code in NO_TARGET:
            raise BeamLost(self.name, f"no target found at {target} ({response.rpcname} {said})")
        if code != GeoComCode.OK:
            raise InstrumentFault(self.name, f"{response.rpcname}{f' at {target}' if target else ''}: {said}")
        return response

    @staticmethod
    def _code(response: GeoComResponse[T]) -> tuple[int, str]:
        """The return code that counts. geocompy turns codes it does not know into 1 and values it did not expect into
        "cannot decode"; the instrument's own code is in the text."""
        code = response.error
        header = _REPLY.match(response.response)
        if header and code in {GeoComCode.COM_CANT_DECODE, GeoComCode.UNDEFINED}:
            for number in (int(header[1]), int(header[4])):
                if number:
                    known = number in GeoComCode.__members__.values()
                    return number, f"code {number}" + (f" {GeoComCode(number).name}" if known else "")
        return int(code), f"code {int(code)} {code.name}"

    def _line_error(self, failure: Exception | None, what: str) -> HardwareError:
        where = port_name(self._port)
        if isinstance(failure, (TimeoutError, SerialTimeoutException)):
            return HardwareTimeout(self.name, f"no answer to {what} within {self._timeout_s:g} s on {where}")
        if isinstance(failure, (SerialException, *LINE_ERRORS)):
            return LineLost(self.name, f"lost the port {where}: {failure}")
        return ProtocolError(self.name, f"no GeoCOM answer to {what} on {where}: {failure or 'refused'}")

    def _resynchronise(self) -> None:
        """Forget what is on the line, or the line itself when it is gone: then start() has to be called again."""
        if self._line is None:
            return
        try:
            self._line.reset()
            drain(self._line._port)
        except LINE_ERRORS:
            self.close()


def _said(value: object) -> object:
    return value.name if isinstance(value, Prism) else value


def direction(xyz: Array) -> tuple[float, float]:
    """(Hz, V) [rad] that look at a point (3,) of the tracker's frame."""
    x, y, z = (float(c) for c in xyz)
    return math.atan2(x, y) % math.tau, math.atan2(math.hypot(x, y), z)


def to_xyz(hz: float, v: float, distance: float) -> Array:
    """(3,) [m] in the tracker's frame; the equations at the top of this file."""
    across = distance * math.sin(v)
    return np.array([across * math.sin(hz), across * math.cos(hz), distance * math.cos(v)])
