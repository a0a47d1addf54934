"""What any simulated recording has alike: the instruments' noise, its columns, the side that joints came from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from simulators.chain import COMPONENTS, Array

FORCE_SIGMA = np.repeat([1.0, 0.3], 3)  # force sensor [N], [N m]; a guess for a sensor that takes 200 kg
ENCODER_SIGMA = 1.0e-7


def header(
    joints: Sequence[str], targets: Iterable[str], places: Iterable[str], others: Iterable[str] = ()
) -> list[str]:
    """The contract's columns (§2) of a recording with temperatures and columns of its own."""
    out = ["time", "step", "load"]
    out += [f"{kind}{name}" for kind in ("q_cmd_", "q_", "approach_") for name in joints]
    out += ["settle_s", *COMPONENTS, *(f"{target}_{axis}" for target in targets for axis in "xyz")]
    return out + [f"temp_{place}_C" for place in places] + [f"cov_{name}" for name in others]


def last_motion(moved: Array) -> NDArray[np.int64]:
    """(N, n) direction of each joint's last motion, −1 or 1, or 0 while it has not moved yet.

    moved  (N, n) since the visit before
    """
    out = np.zeros(moved.shape, dtype=np.int64)
    last = np.zeros(moved.shape[1], dtype=np.int64)
    for k, step in enumerate(moved):
        last = np.where(step == 0.0, last, np.sign(step)).astype(np.int64)
        out[k] = last
    return out
