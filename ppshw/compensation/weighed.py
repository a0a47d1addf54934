"""What hung at the force sensor while effects were measured, and what it reads of a load beside what that weighed."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ppshw.kinematics import frames
from ppshw.machine import Machine
from ppshw.recording import Recording
from ppshw.statics import gravity_in_sensor
from ppshw.terms.history import payloads, weighs

Array = NDArray[np.float64]
ANOTHER_LOAD = 2.0  # times as far as the sensor ever read beside a load: another one under its label (a judgement)
A_LITTLE = 0.01  # of the largest force or moment: what a setpoint's pose turns


class Weighed:
    """The loads of a calibration's visits."""

    def __init__(self, machine: Machine, visits: Recording) -> None:
        self._machine, self._visits = machine, visits

    def loads(self, q: Array) -> Array:
        """(L, 6) what the sensor would read of each of them at a pose."""
        return weighs(np.unique(self._held, axis=0), self._gravity(q[None]))

    def beside(self, load: str, q: Array, reading: Array) -> Array | None:
        """(6,) what the sensor reads of a load beside what it weighed while effects were measured; None of one that
        nobody knows, or that by its reading is another one of that label."""
        visits = self._visits
        if not load or load not in visits.load:
            return None
        held = self._held[visits.load.index(load)]
        beside = reading - weighs(held[None], self._gravity(q[None]))[0]
        most = np.repeat(np.abs(visits.wrench).max(axis=0).reshape(2, 3).max(axis=1), 3)
        far = ANOTHER_LOAD * np.abs(self._read_beside).max(axis=0) + A_LITTLE * most
        return beside if (np.abs(beside) < far).all() else None

    def usual(self) -> Array:
        """(6,) what it reads beside the loads, rms over the visits."""
        return np.asarray(np.sqrt((self._read_beside**2).mean(axis=0)))

    def _gravity(self, q: Array) -> Array:
        return gravity_in_sensor(self._machine, frames(self._machine, q))

    @cached_property
    def _held(self) -> Array:
        """(N, 4) the payloads of the visits."""
        return payloads(self._visits.wrench, self._visits.load, self._gravity(self._visits.q))

    @cached_property
    def _read_beside(self) -> Array:
        """(N, 6)"""
        return np.asarray(self._visits.wrench - weighs(self._held, self._gravity(self._visits.q)))
