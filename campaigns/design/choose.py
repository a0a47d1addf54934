"""Which visits: greedy choice, then exchange, until nothing is gained.

Candidates are random poses that like the ends of the travel (where lever arms are long and functions are held), under
every load case. The visits of one load are made together, so each load has its quota.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from campaigns.design.belief import Belief, white_rows
from campaigns.design.information import Pool, Posterior, Step
from campaigns.design.loads import wrench
from campaigns.script import LoadCase
from ppshw.machine import Machine
from ppshw.terms import Situation

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Tick = Callable[[], None]
CANDIDATES, EXCHANGED = 2400, 1000
# Of a candidate's joints, this share stands at an end of its travel; the rest like the ends (arcsine).
AT_AN_END = 0.25
# Setpoints are whole tenths of a millimetre or milliradian, so that a script is short and the same on every computer.
DECIMALS = 4


@dataclass
class Chosen:
    """Visits in no order: q (N, n) [m, rad], load (N,) index of the load case, rows (N, k, r) what they teach."""

    q: Array
    load: Indices
    rows: Array


def situation(machine: Machine, q: Array, load: Indices, cases: Sequence[LoadCase]) -> Situation:
    """Visits at q (N, n) [m, rad], each under the load case that load (N,) is the index of."""
    mass, centre = np.array([c.mass for c in cases]), np.array([c.com for c in cases])
    return Situation(q, wrench(machine, q, mass[load], centre[load]))


def inside(machine: Machine, q: Array) -> Array:
    """Rounded to DECIMALS, and never beyond a limit by that."""
    low, high = machine.limits()
    unit = 10.0**DECIMALS
    return np.asarray(np.clip(np.round(q, DECIMALS), np.ceil(low * unit) / unit, np.floor(high * unit) / unit))


class Chooser:
    def __init__(self, belief: Belief, basis: Array, cases: Sequence[LoadCase], seed: int) -> None:
        self._belief, self._basis, self._cases = belief, basis, cases
        self._rng = np.random.default_rng([seed, 4711])

    def rows_of(self, q: Array, load: Indices) -> Array:
        """(N, k, r) what visits teach."""
        return white_rows(self._belief, situation(self._belief.machine, q, load, self._cases), self._basis)

    def greedy(
        self, posterior: Posterior, total: int, quota: Indices | None = None, tick: Tick | None = None,
        candidates: int | None = None,
    ) -> Chosen:  # fmt: skip
        """One visit after the other, each the best one there is, at most `quota` (L,) of each load.

        `posterior` knows the visits afterwards.
        """
        q, load = self._candidates(candidates or CANDIDATES)
        pool = Pool(self.rows_of(q, load), posterior)
        free, taken = np.ones(len(q), dtype=bool), []
        left = np.full(len(self._cases), total) if quota is None else quota.copy()
        for _ in range(total):
            best = int(np.argmax(np.where(free & (left[load] > 0), pool.gains(), -np.inf)))
            free[best], left[load[best]] = False, left[load[best]] - 1
            taken.append(best)
            _take(posterior, pool, posterior.step(pool.rows[best]))
            if tick:
                tick()
        return Chosen(q[taken], load[taken], pool.rows[taken])

    def exchange(self, posterior: Posterior, chosen: Chosen, tick: Tick | None = None) -> None:
        """Every visit in turn is taken out, and the best of itself and new candidates of its load is made instead."""
        for case in np.unique(chosen.load):
            mine = np.flatnonzero(chosen.load == case)
            q, load = self._candidates(EXCHANGED, case, chosen.q[mine])
            pool = Pool(self.rows_of(q, load), posterior)
            free = np.ones(len(q), dtype=bool)
            for k in self._rng.permutation(mine):
                _take(posterior, pool, posterior.step(chosen.rows[k], made=False))
                offers = np.where(free, pool.gains(), -np.inf)
                best = int(np.argmax(offers))
                if offers[best] > Pool(chosen.rows[k][None], posterior).gains()[0]:
                    free[best] = False
                    chosen.q[k], chosen.rows[k] = q[best], pool.rows[best]
                _take(posterior, pool, posterior.step(chosen.rows[k]))
                if tick:
                    tick()

    def _candidates(self, count: int, only: int | None = None, near: Array | None = None) -> tuple[Array, Indices]:
        """Poses and load indices, of one load or all in turn; half are poses `near` with a joint or two moved."""
        machine, rng = self._belief.machine, self._rng
        low, high = machine.limits()
        ends = rng.random((count, machine.n)) < AT_AN_END
        u = np.where(ends, rng.integers(0, 2, ends.shape), rng.beta(0.5, 0.5, ends.shape))
        q = low + u * (high - low)
        load = np.arange(count, dtype=np.int64) % len(self._cases)
        if only is not None:
            load[:] = only
        if near is not None:
            half = count // 2
            moved = rng.random((half, machine.n)) < 1.5 / machine.n
            q[:half] = np.where(moved, q[:half], near[rng.integers(0, len(near), half)])
        return inside(machine, q), load


def _take(posterior: Posterior, pool: Pool, step: Step) -> None:
    pool.follow(step)
    posterior.take(step)
