"""From a number of visits, or an accuracy, to a campaign: everything of this folder together."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from campaigns.design.belief import Belief, white_rows
from campaigns.design.choose import Chooser, Chosen, inside, situation
from campaigns.design.information import Posterior, Work, quantile, visible, work_of
from campaigns.design.loads import LoadRange, extremes, matters, range_of, telling_cases, usual_range
from campaigns.design.order import shortest_rounds
from campaigns.script import EMPTY, LoadCase
from ppshw.errors import CampaignError
from ppshw.machine import Machine

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
# The reference pose comes back before every 15th visit or so, and once more at the end.
ROUND, LEAST_ROUND = 15, 7
# Four loads that are not in a plane (nothing, and three whose force and two moments differ) show all that weight does;
# a fifth costs ten minutes and gained less than 1 % (docs/design.md §4).
LOAD_CASES = 4
LEAST, MOST = 10, 2000
# Exchange after the greedy choice: this many rounds, fewer in large campaigns, where it gains little and takes long.
EXCHANGES, MANY = 2, 300
# Candidates of the first look, which says what can be seen at all and how many visits each load deserves.
FIRST_LOOK = 1200
# How much shorter a campaign gets by exchange: where the search for an accuracy starts from the greedy choice.
GAINED_BY_EXCHANGE = 0.92
MORE = 1.06


@dataclass(frozen=True)
class Request:
    """What is asked of a design.

    point     its name; where accuracy counts
    work      the loads it counts under
    cases     what may be put on, in the order of the campaign;  few: how many of them at most
    seed      of everything random
    measured  (p, p) information Wᵀ W of visits that were made before, in the belief's z; None: none were
    """

    belief: Belief
    point: str
    work: LoadRange
    cases: tuple[LoadCase, ...]
    few: int
    seed: int
    measured: Array | None = None

    @property
    def machine(self) -> Machine:
        return self.belief.machine


@dataclass(frozen=True)
class Design:
    """q (N, n) in the order of the visits without references, load (N,) index of the case; every: reference before
    each so many; accuracy: 98.6 % at the point over the work, model alone and with noise, noise alone [m]."""

    request: Request
    reference: Array
    q: Array
    load: NDArray[np.int64]
    every: int
    before: tuple[float, float]
    accuracy: tuple[float, float]
    floor: float
    travel_s: float
    bound_s: float

    @property
    def visits(self) -> int:
        return len(self.q) + math.ceil(len(self.q) / self.every) + 1


def loads_for(
    machine: Machine, point: Array, given: Sequence[LoadCase] | None, few: int | None
) -> tuple[LoadRange, tuple[LoadCase, ...]]:
    """What the machine carries in its work, and the cases to measure.

    given  load cases that are there to be put on, which then also span the work; None: the usual range, and its corners
    few    the most telling ones of them; None: all of them
    """
    if not matters(machine):
        return LoadRange((0.0, 0.0), (0.0,) * 3, (0.0,) * 3), (EMPTY,)
    work = usual_range(machine, point) if given is None else range_of(given)
    offered = extremes(work) if given is None else list(given)
    return work, tuple(telling_cases(machine, work, offered, few or len(offered)))


def rounds_for(visits: int, loads: int) -> int:
    """Between reference visits: ROUND visits or so, and a round for every load where that leaves it LEAST_ROUND."""
    return max(1, round(visits / ROUND), min(loads, visits // LEAST_ROUND))


class Designer:
    """Everything that one request needs once: what can be seen, what accuracy means, what is known already."""

    def __init__(self, request: Request) -> None:
        self.request = request
        machine = request.machine
        low, high = machine.limits()
        self.reference = inside(machine, (low + high)[None] / 2)[0]
        rng = np.random.default_rng(0)
        q = low + rng.beta(0.5, 0.5, (FIRST_LOOK, machine.n)) * (high - low)
        load = np.arange(FIRST_LOOK, dtype=np.int64) % len(request.cases)
        belief = request.belief
        self._basis = visible(white_rows(belief, situation(machine, q, load, request.cases)))
        self._work: Work = work_of(belief, machine.point(request.point), request.work)
        self.floor = quantile(self._work.noise)

    def posterior(self) -> Posterior:
        """What is known before the first visit of this campaign."""
        found = Posterior(self._work, self._basis)
        if self.request.measured is not None:
            found.add_information(self._basis.T @ self.request.measured @ self._basis)
        return found

    def chooser(self) -> Chooser:
        return Chooser(self.request.belief, self._basis, self.request.cases, self.request.seed)

    def design(self, visits: int, progress: Progress | None = None) -> Design:
        """The best campaign of that many visits, references counted."""
        if not LEAST <= visits <= MOST:
            raise CampaignError(f"--visits {visits}: a design has {LEAST} to {MOST} visits, references counted")
        rounds = self._rounds(visits)
        new = visits - rounds - 1
        every = math.ceil(new / rounds)
        sizes = [every] * (new // every) + ([new % every] if new % every else [])
        exchanges = EXCHANGES if visits <= MANY else 1
        counter = _Counter(progress, new * (2 + exchanges))
        posterior = self.posterior()
        before = posterior.accuracy()
        chooser = self.chooser()
        shares = chooser.greedy(posterior, new, tick=counter.tick, candidates=FIRST_LOOK)
        wanted = np.bincount(shares.load, minlength=len(self.request.cases))
        owned = _share_out(sizes, wanted, min(self.request.few, rounds))
        posterior = self.posterior()
        posterior.add_all(self._references(chooser, owned))
        quota = np.array([sum(mine) for mine in owned])
        chosen = chooser.greedy(posterior, new, quota, counter.tick)
        for _ in range(exchanges):
            chooser.exchange(posterior, chosen, counter.tick)
        return self._in_order(chosen, owned, every, before, posterior.accuracy())

    def design_for(self, accuracy: float, progress: Progress | None = None) -> Design:
        """The shortest campaign, within some visits, whose 98.6 % with noise is no more than `accuracy` [m].

        Raises CampaignError when noise alone is more, or MOST visits do not suffice.
        """
        visits = max(LEAST, math.ceil(GAINED_BY_EXCHANGE * self.visits_for(accuracy)))
        while True:
            found = self.design(visits, progress)
            if found.accuracy[1] <= accuracy:
                return found
            visits = math.ceil(visits * MORE)
            if visits > MOST:
                raise CampaignError(self._too_fine(accuracy, found.accuracy[1]))

    def visits_for(self, accuracy: float) -> int:
        """How many visits a greedy choice needs, references counted; 0 when enough is known already."""
        if accuracy <= self.floor:
            raise CampaignError(
                f"--accuracy {accuracy * 1e3:.3g} mm: the machine's repeatability and the tracker's noise alone leave "
                f"{self.floor * 1e3:.3f} mm at 98.6 %; no number of visits goes below"
            )
        posterior, chooser = self.posterior(), self.chooser()
        if posterior.accuracy()[1] <= accuracy:
            return 0
        made, reached = 0, math.inf
        for made, reached in self._greedy_accuracies(posterior, chooser):
            if reached <= accuracy:
                return made + self._rounds(made) + 1
        raise CampaignError(self._too_fine(accuracy, reached))

    def _rounds(self, visits: int) -> int:
        return rounds_for(visits, min(self.request.few, len(self.request.cases)))

    def _greedy_accuracies(self, posterior: Posterior, chooser: Chooser) -> Iterator[tuple[int, float]]:
        made = 0
        while made < MOST * ROUND // (ROUND + 1):
            batch = max(5, made // 10)
            chooser.greedy(posterior, batch, candidates=FIRST_LOOK)
            made += batch
            yield made, posterior.accuracy()[1]

    def _too_fine(self, accuracy: float, reached: float) -> str:
        return (
            f"--accuracy {accuracy * 1e3:.3g} mm: {MOST} visits would reach {reached * 1e3:.3f} mm "
            f"(noise alone {self.floor * 1e3:.3f} mm); a campaign that long is not designed"
        )

    def _references(self, chooser: Chooser, owned: Sequence[Sequence[int]]) -> Array:
        load = [k for k, mine in enumerate(owned) for _ in mine]
        load.append(load[-1])  # the closing one
        return chooser.rows_of(np.repeat(self.reference[None], len(load), axis=0), np.array(load, dtype=np.int64))

    def _in_order(
        self, chosen: Chosen, owned: Sequence[Sequence[int]], every: int, before: tuple[float, float],
        accuracy: tuple[float, float],
    ) -> Design:  # fmt: skip
        order: list[int] = []
        seconds = bound = 0.0
        for load, sizes in enumerate(owned):
            mine = np.flatnonzero(chosen.load == load)
            if not len(mine):
                continue
            found = shortest_rounds(self.request.machine, self.reference, chosen.q[mine], sizes, self.request.seed)
            order += [int(mine[k]) for r in found.rounds for k in r]
            seconds, bound = seconds + found.seconds, bound + found.bound
        return Design(
            self.request, self.reference, chosen.q[order], chosen.load[order], every, before, accuracy, self.floor,
            seconds, bound,
        )  # fmt: skip


def _share_out(sizes: Sequence[int], wanted: NDArray[np.int64], few: int) -> list[list[int]]:
    """Whole rounds to the `few` loads wanted most, as near to the wanted visits as they come.

    The smaller last round goes to the last of them; each gets one round before any gets two.
    """
    kept = np.sort(np.argsort(-wanted, kind="stable")[: min(few, len(sizes))])
    owned: list[list[int]] = [[] for _ in wanted]
    owned[kept[-1]].append(sizes[-1])
    for size in sizes[:-1]:
        missing = [wanted[k] - sum(owned[k]) if owned[k] else math.inf for k in kept]
        owned[kept[int(np.argmax(missing))]].append(size)
    for mine in owned:
        mine.sort(reverse=True)
    return owned


class _Counter:
    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def tick(self) -> None:
        self._done += 1
        if self._progress:
            self._progress(min(self._done, self._total), self._total)
