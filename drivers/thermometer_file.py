"""Temperatures that a site's own logger keeps writing to a small JSON file; any logger can be made to.

    {"time": "2026-03-02T06:00:00+00:00", "temperatures_C": {"air": 21.3, "rail": 22.0}}

The file must be replaced in one piece (write another, rename it), and an old one is refused: a stale temperature looks
exactly like a stable one. So is one from the future, which would not grow old for long.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from drivers.ports import Clock, DeviceInfo
from ppshw.errors import HardwareTimeout, InstrumentFault, ProtocolError

COLDEST_C, HOTTEST_C = -40.0, 85.0  # beyond that it is a broken wire, not a hall
AHEAD_S = 60.0  # s by which the logger's clock may be ahead of ours


class FileThermometer:
    """Implements ports.Thermometer."""

    def __init__(self, path: Path, clock: Clock, *, name: str = "thermometers", max_age_s: float = 300.0) -> None:
        self.name = name
        self._path, self._clock, self._max_age_s = path, clock, max_age_s

    def check(self) -> DeviceInfo:
        age, values = self._read()
        felt = ", ".join(f"{place} {value:.2f} °C" for place, value in values.items())
        return DeviceInfo(self.name, f"file {self._path.name}", "", "", f"{max(0.0, age):.0f} s old, {felt}")

    def read(self) -> Mapping[str, float]:
        return self._read()[1]

    def _read(self) -> tuple[float, dict[str, float]]:
        """How old the file is [s], and what it says."""
        try:
            said = json.loads(self._path.read_text(encoding="utf-8"))
            written = datetime.fromisoformat(said["time"])
            values = {str(place): float(value) for place, value in said["temperatures_C"].items()}
        except OSError as error:
            raise InstrumentFault(self.name, f"{self._path} cannot be read: {error.strerror}") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ProtocolError(self.name, f"{self._path} is not what it should be: {error}") from error
        written = written if written.tzinfo else written.replace(tzinfo=UTC)
        age = (self._clock.utc() - written).total_seconds()
        if age > self._max_age_s:
            raise HardwareTimeout(self.name, f"{self._path} is {age:.0f} s old, allowed {self._max_age_s:g} s")
        if age < -AHEAD_S:
            ahead = f"{-age:.0f} s ahead of our clock (does the logger write local time without its offset from UTC?)"
            raise InstrumentFault(self.name, f"{self._path} is {ahead}")
        for place, value in values.items():
            if not (math.isfinite(value) and COLDEST_C <= value <= HOTTEST_C):
                raise InstrumentFault(self.name, f"{place} reads {value:g} °C")
        return age, values
