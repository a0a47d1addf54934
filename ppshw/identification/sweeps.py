"""What a recording of the paper's campaign consists of: home, sweeps of one joint, weight pairs   (sections 3.1, 4.1).

Found from setpoints and wrenches alone; the labels of the steps are not needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppshw.errors import IdentificationFailed
from ppshw.recording import Recording

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
# Setpoints closer than this are one position [m, rad]. Setpoints of a campaign are equal to the last bit; encoder
# positions, where a file holds nothing else, scatter by some micrometres.
SAME_POSITION = 5e-5
# Two loads differ when force or moment do by this share of the greatest in the recording: well above the sensor's noise.
OTHER_LOAD = 0.03
ADVICE = "the paper's method needs its campaign (`ppshw plan paper`); `--method joint` works on any recording"


@dataclass(frozen=True)
class Configuration:
    """All visits at one q; `away`: the joints that are not at home; paired: under different loads."""

    q: Array
    away: tuple[int, ...]
    visits: Indices
    paired: bool


@dataclass(frozen=True)
class Sweeps:
    """home (n,); configurations in the order of the first visit."""

    home: Array
    configurations: tuple[Configuration, ...]

    def of_joint(self, joint: int) -> list[Configuration]:
        """Where this joint alone is away from home, by position."""
        found = [c for c in self.configurations if c.away == (joint,)]
        return sorted(found, key=lambda c: float(c.q[joint]))

    def knots(self, joint: int, paired: bool = False) -> tuple[float, ...]:
        """Sampled positions of a joint (with weight pairs), home included."""
        found = [float(c.q[joint]) for c in self.of_joint(joint) if c.paired or not paired]
        return tuple(sorted([float(self.home[joint]), *found]))


def find_sweeps(recording: Recording, same_position: float = SAME_POSITION) -> Sweeps:
    """Home is where most visits have each joint.

    Raises IdentificationFailed where home was never visited or where a joint that moves was never moved alone.
    """
    q = recording.q_cmd
    labels = np.column_stack([_clusters(q[:, k], same_position) for k in range(q.shape[1])])
    home_labels = np.array([_most_common(labels[:, k], q[:, k]) for k in range(q.shape[1])])
    away = labels != home_labels
    if away.any(axis=1).all():
        raise IdentificationFailed(f"{recording.source}: no visit with all joints at home together; {ADVICE}")
    _, first, which = np.unique(labels, axis=0, return_index=True, return_inverse=True)
    which = which.reshape(-1)
    wrench_scale = [np.abs(recording.wrench[:, part]).max() for part in (slice(0, 3), slice(3, 6))]
    found = []
    for label in np.argsort(first):
        visits = np.flatnonzero(which == label)
        moved = tuple(np.flatnonzero(away[visits[0]]).tolist())
        spread = np.ptp(recording.wrench[visits], axis=0)
        paired = any(
            scale > 0 and spread[part].max() > OTHER_LOAD * scale
            for part, scale in zip((slice(0, 3), slice(3, 6)), wrench_scale, strict=True)
        )
        found.append(Configuration(q[visits].mean(axis=0), moved, visits, paired))
    home = next(c.q for c in found if not c.away)
    sweeps = Sweeps(home, tuple(found))
    for k, name in enumerate(recording.joint_names):
        if away[:, k].any() and not sweeps.of_joint(k):
            raise IdentificationFailed(
                f"{recording.source}: {name} was never moved alone, with the others at home; {ADVICE}"
            )
    return sweeps


def _clusters(x: Array, tolerance: float) -> Indices:
    """A number per value, equal for values that hang together by gaps below the tolerance."""
    order = np.argsort(x, kind="stable")
    out = np.empty(len(x), dtype=np.int64)
    out[order] = np.concatenate([[0], np.cumsum(np.diff(x[order]) > tolerance)])
    return out


def _most_common(labels: Indices, x: Array) -> int:
    """The most frequent label; of equals the one nearest to zero."""
    counts = np.bincount(labels)
    best = np.flatnonzero(counts == counts.max())
    nearest = [np.abs(x[labels == label]).min() for label in best]
    return int(best[int(np.argmin(nearest))])
