"""Whether a load hangs still while it is weighed: the spread of a reading against what is usual in its run; and whether
its readings are any."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from drivers.ports import WrenchReading
from ppshw.errors import InstrumentFault
from ppshw.machine import WRENCH_COMPONENTS

Array = NDArray[np.float64]
# A reading sways where a channel's spread is so many times the run's median, which at least so many readings tell and
# the last so many say; less than the floor [N, N·m] is no sway. Noise alone changes a spread over 32 frames by an
# eighth (rms). Ours.
TIMES, LEAST, LAST = 10.0, 3, 50
FLOOR = np.array([0.1, 0.1, 0.1, 0.01, 0.01, 0.01])


class Steadiness:
    """Knows the calm readings of one run."""

    def __init__(self) -> None:
        self._calm: deque[Array] = deque(maxlen=LAST)
        self._frozen: Array | None = None  # the last visit's reading, where it had no spread at all

    def require_alive(self, name: str, reading: WrenchReading) -> None:
        """Once a visit. Raises InstrumentFault of a sensor that says, in every frame of two visits, the very same:
        strain gauges have noise."""
        frozen = reading.wrench if reading.samples > 1 and not reading.spread.any() else None
        if frozen is not None and self._frozen is not None and np.array_equal(frozen, self._frozen):
            raise InstrumentFault(name, "reads the very same in every frame of this visit and of the one before")
        self._frozen = frozen

    def sway(self, reading: WrenchReading) -> str | None:
        """What sways, in words; None, and the reading is one more that says what is usual, where nothing does."""
        usual = np.maximum(np.median(self._calm, axis=0), FLOOR) if len(self._calm) >= LEAST else np.full(6, np.inf)
        ratio = reading.spread / usual
        worst = int(ratio.argmax())
        if ratio[worst] <= TIMES:
            self._calm.append(reading.spread)
            return None
        unit = "N" if worst < 3 else "N m"
        return f"{WRENCH_COMPONENTS[worst]} by {reading.spread[worst]:.2g} {unit}, usually {usual[worst]:.2g} {unit}"
