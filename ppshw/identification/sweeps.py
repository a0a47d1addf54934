"""What a recording of the paper's campaign consists of: home, sweeps of one joint, weight pairs   (sections 3.1, 4.1).

Found from setpoints and wrenches alone; the labels of the steps are not needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppshw.errors import IdentificationFailed
from ppshw.machine import Machine
from ppshw.recording import Recording

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
# Setpoints closer than this are one position [m, rad]. Setpoints of a campaign are equal to the last bit; encoder
# positions, where a file holds nothing else, scatter by some micrometres.
SAME_POSITION = 5e-5
# Loads differ when force or moment do by this share of the greatest in the recording, or by a kilogram a foot away
# where all are small: guesses, well above a sensor's noise.
OTHER_LOAD = 0.03
LEAST_LOAD = (10.0, 3.0)  # [N, N·m]
ADVICE = "the paper's method needs its campaign (`ppshw plan paper`); `--method joint` works on any recording"


@dataclass(frozen=True)
class Configuration:
    """All visits at one q; away: the joints that are not at home; loads: the visits of each load."""

    q: Array
    away: tuple[int, ...]
    visits: Indices
    loads: tuple[Indices, ...]

    @property
    def paired(self) -> bool:
        return len(self.loads) > 1


@dataclass(frozen=True)
class Sweeps:
    """home (n,); configurations."""

    home: Array
    configurations: tuple[Configuration, ...]

    def of_joint(self, joint: int) -> list[Configuration]:
        """Where this joint alone is away from home, by position."""
        found = [c for c in self.configurations if c.away == (joint,)]
        return sorted(found, key=lambda c: float(c.q[joint]))

    def knots(self, joint: int, paired: bool = False) -> tuple[float, ...]:
        """Sampled positions of a joint (under several loads), home included."""
        found = [float(c.q[joint]) for c in self.of_joint(joint) if c.paired or not paired]
        return tuple(sorted([float(self.home[joint]), *found]))


def find_sweeps(machine: Machine, recording: Recording) -> Sweeps:
    """Home is where most visits have each joint.

    Raises IdentificationFailed, saying what is missing: a visit at home, a sweep of a joint that moves, weight pairs.
    """
    q = recording.q_cmd
    labels = np.column_stack([_clusters(q[:, k], SAME_POSITION) for k in range(q.shape[1])])
    away = labels != [_most_common(labels[:, k], q[:, k]) for k in range(q.shape[1])]
    if away.any(axis=1).all():
        raise IdentificationFailed(f"{recording.source}: no visit with all joints at home together; {ADVICE}")
    which = np.unique(labels, axis=0, return_inverse=True)[1].reshape(-1)
    greatest = [float(np.abs(recording.wrench[:, part]).max()) for part in (slice(0, 3), slice(3, 6))]
    step = np.repeat(np.maximum(OTHER_LOAD * np.array(greatest), LEAST_LOAD), 3)
    found = []
    for label in range(which.max() + 1):
        visits = np.flatnonzero(which == label)
        moved = tuple(np.flatnonzero(away[visits[0]]).tolist())
        found.append(Configuration(q[visits].mean(axis=0), moved, visits, _loads(visits, recording.wrench, step)))
    home = next(c.q for c in found if not c.away)
    sweeps = Sweeps(home, tuple(found))
    _check(machine, recording, sweeps, away)
    return sweeps


def _check(machine: Machine, recording: Recording, sweeps: Sweeps, away: NDArray[np.bool_]) -> None:
    elastic = any(joint.elastic is not None for joint in machine.joints)
    if elastic and not any(c.paired for c in sweeps.configurations):
        why = "under two different loads" if recording.has_wrench else "under known loads (nothing in columns Fx … Mz)"
        raise IdentificationFailed(f"{recording.source}: no configuration was measured {why}; {ADVICE}")
    for k, joint in enumerate(machine.joints):
        if not away[:, k].any():
            continue
        if not sweeps.of_joint(k):
            raise IdentificationFailed(
                f"{recording.source}: {joint.name} was never moved alone, with the others at home; {ADVICE}"
            )
        if joint.elastic and joint.elastic.varies and len(sweeps.knots(k, paired=True)) < 2:
            raise IdentificationFailed(
                f"{recording.source}: the compliance of {joint.name} varies, but at no position of it were two "
                f"different loads measured; {ADVICE}"
            )


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


def _loads(visits: Indices, wrench: Array, step: Array) -> tuple[Indices, ...]:
    """Visits whose wrench is the same as the first's of their group."""
    groups: list[list[int]] = []
    for v in visits:
        for group in groups:
            if np.all(np.abs(wrench[v] - wrench[group[0]]) <= step):
                group.append(int(v))
                break
        else:
            groups.append([int(v)])
    return tuple(np.array(group) for group in groups)
