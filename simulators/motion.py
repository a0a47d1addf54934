"""Where a simulated axis is: position as a function of time, so that nothing has to be integrated or waited for.

A motion is a chain of pieces of constant acceleration. The planner takes any start velocity, so a target may change
under way and a quick stop may come at any moment.

Known limitations: no jerk limit, no resonance; a drive's lag is added where the motion is read (simulators/drive.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Piece:
    """From `start` [s] on: p = position + velocity·t + acceleration·t²/2, t = time − start."""

    start: float
    position: float
    velocity: float
    acceleration: float

    def at(self, time: float) -> tuple[float, float]:
        t = time - self.start
        return (
            self.position + self.velocity * t + 0.5 * self.acceleration * t * t,
            self.velocity + self.acceleration * t,
        )


@dataclass(frozen=True)
class Motion:
    """Pieces in order of time; the last one is at rest. Before the first piece the axis stands where that begins."""

    pieces: tuple[Piece, ...]

    @property
    def start(self) -> float:
        return self.pieces[0].start

    @property
    def end(self) -> float:
        """When the axis comes to rest."""
        return self.pieces[-1].start

    @property
    def target(self) -> float:
        return self.pieces[-1].position

    def at(self, time: float) -> tuple[float, float]:
        """Position and velocity at `time`."""
        for piece in reversed(self.pieces):
            if time >= piece.start:
                return piece.at(time)
        return self.pieces[0].position, 0.0

    def position(self, time: float) -> float:
        return self.at(time)[0]

    def velocity(self, time: float) -> float:
        return self.at(time)[1]


def at_rest(position: float, time: float = 0.0) -> Motion:
    return Motion((Piece(time, position, 0.0, 0.0),))


def move(
    start: float,
    position: float,
    target: float,
    velocity: float,
    acceleration: float,
    deceleration: float | None = None,
    initial_velocity: float = 0.0,
) -> Motion:
    """Trapezoid (or triangle) from `position` at time `start` to rest at `target`.

    An axis that already moves brakes first if it moves the wrong way, too fast, or too close to its new target.
    """
    if velocity <= 0 or acceleration <= 0:
        raise ValueError(f"velocity {velocity:g} and acceleration {acceleration:g} must be positive")
    chain = _Chain(start, position, initial_velocity)
    braking = deceleration or acceleration
    stops_at = position + initial_velocity * abs(initial_velocity) / (2 * braking)
    if (stops_at - position) * (target - stops_at) < 0:  # runs past the target, or away from it
        chain.change_velocity(0.0, braking)
    sense = math.copysign(1.0, target - chain.position)
    if sense * chain.velocity > velocity:
        chain.change_velocity(sense * velocity, braking)
    remaining = sense * (target - chain.position)
    # v_peak from: (v_peak² − v²)/2a + v_peak²/2d = remaining
    peak_squared = (2 * remaining + chain.velocity**2 / acceleration) / (1 / acceleration + 1 / braking)
    peak = min(velocity, math.sqrt(max(0.0, peak_squared)))
    chain.change_velocity(sense * peak, acceleration)
    cruise = sense * (target - chain.position) - peak**2 / (2 * braking)
    if peak > 0:
        chain.cruise(max(0.0, cruise) / peak)
    chain.change_velocity(0.0, braking)
    return chain.rest_at(target)


def stop(start: float, position: float, initial_velocity: float, deceleration: float) -> Motion:
    """Brake to rest as fast as `deceleration` allows."""
    chain = _Chain(start, position, initial_velocity)
    chain.change_velocity(0.0, deceleration)
    return chain.rest_at(chain.position)


class _Chain:
    """Pieces under construction: time, position and velocity at the end of the last one."""

    def __init__(self, time: float, position: float, velocity: float) -> None:
        self.time, self.position, self.velocity = time, position, velocity
        self._pieces: list[Piece] = []

    def change_velocity(self, wanted: float, acceleration: float) -> None:
        duration = abs(wanted - self.velocity) / acceleration
        self._append(math.copysign(acceleration, wanted - self.velocity), duration)
        self.velocity = wanted

    def cruise(self, duration: float) -> None:
        self._append(0.0, duration)

    def rest_at(self, target: float) -> Motion:
        return Motion((*self._pieces, Piece(self.time, target, 0.0, 0.0)))

    def _append(self, acceleration: float, duration: float) -> None:
        if duration <= 0:
            return
        piece = Piece(self.time, self.position, self.velocity, acceleration)
        self._pieces.append(piece)
        self.time += duration
        self.position, self.velocity = piece.at(self.time)
