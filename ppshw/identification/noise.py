"""What scatters: the machine's pose repeatability, common to all targets of a visit, and the instrument's own noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Noise:
    """pose (6, 6) covariance of the end effector's displacement about its origin, base axes [m², m·rad, rad²];
    instrument: standard deviation per coordinate [m]."""

    pose: Array
    instrument: float

    def covariance(self, levers: Array, seen: NDArray[np.bool_], weights: Array) -> Array:
        """Covariance of one visit's coordinates, for every visit.

        levers   (N, T, 3, 6)
        seen     (N, T)       lost targets get unit variance and no correlation
        weights  (N,)         a visit of weight w counts as w visits
        returns  (N, 3T, 3T)  [m²]
        """
        count, size = seen.shape
        b = levers.reshape(count, 3 * size, 6)
        out = b @ self.pose @ np.swapaxes(b, 1, 2) + self.instrument**2 * np.eye(3 * size)
        out = out / weights[:, None, None]
        rows = np.repeat(seen, 3, axis=1)
        out = out * (rows[:, :, None] & rows[:, None, :])
        lost = ~rows
        k = np.arange(3 * size)
        out[:, k, k] += lost
        return np.asarray(out)


def pose_rank(target_count: int) -> int:
    """How many of the six displacement components a visit's targets determine: 3 with one target, 6 with three."""
    return 3 if target_count < 3 else 6
