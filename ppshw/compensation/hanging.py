"""What the sensor will read where a run goes next, by all that it has read of the load that hangs there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppshw.kinematics import frames
from ppshw.machine import Machine
from ppshw.statics import gravity_in_sensor, payload_at
from ppshw.terms.earlier import another_load
from ppshw.terms.history import payloads, weighs

Array = NDArray[np.float64]


class Hanging:
    """The readings of the load that a run has on now, since it was put on.

    One reading tells on which line the centre of mass lies, two in other attitudes where on it: of arms, which turn
    their loads over, setpoints by one were 0.31 mm off and at worst 1.7 where by the load's true weight 0.17 and 0.6
    were left (a reviewer's).
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._load = ""
        self._read: list[tuple[Array, Array]] = []  # the wrench and gravity in the sensor's axes, of each reading

    def at(self, load: str, wrench: Array, here: Array, there: Array) -> Array:
        """(6,) at joint values `there` (n,), of a load that reads `wrench` (6,) `here` (n,)."""
        gravity = gravity_in_sensor(self._machine, frames(self._machine, np.array([here, there])))
        another = load != self._load or (self._read and another_load(self._read[-1][0][None], wrench[None]))
        self._load, self._read = load, [*([] if another else self._read), (wrench, gravity[0])]
        if len(self._read) == 1:
            return payload_at(self._machine, wrench, here, there)
        wrenches, attitudes = map(np.array, zip(*self._read, strict=True))
        held = payloads(wrenches, (load,) * len(wrenches), attitudes)[:1]
        reads_here, reads_there = weighs(np.repeat(held, 2, axis=0), gravity)
        return np.asarray(reads_there + wrench - reads_here)  # what it reads beside that stays with the sensor
