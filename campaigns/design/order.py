"""The order of the visits: shortest travel, with the reference pose between every so many of them.

All visits under one load are made together, and between two reference visits lie as many others as the script says. So
the visits of one load are rounds from the reference pose and back to it, of given sizes: a vehicle routing problem with
unit demands. PyVRP solves it (Wouda, Lan & Kool 2024, PyVRP: a high-performance VRP solver package); bound.py says how
far from the best its answer can be. A round may be driven either way: the way is chosen so that joints are approached
from both sides.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pyvrp import Model, Route, Solution
from pyvrp.stop import MaxIterations

from campaigns.design.bound import lower_bound
from campaigns.plan import travel
from ppshw.machine import Machine

Array = NDArray[np.float64]
TICKS = 1000  # PyVRP counts in whole numbers: milliseconds, well below its penalties for a round that is too full
# A fixed number of iterations, not of seconds: the same seed gives the same order on a slow computer.
ITERATIONS_PER_VISIT, LEAST_ITERATIONS = 60, 1000


@dataclass(frozen=True)
class Rounds:
    """Rounds of one load: indices of its visits in their order; seconds of travel, and no order needs less."""

    rounds: tuple[tuple[int, ...], ...]
    seconds: float
    bound: float


def shortest_rounds(machine: Machine, reference: Array, q: Array, sizes: Sequence[int], seed: int) -> Rounds:
    """Visits q (N, n) of one load as rounds from `reference` (n,) of these sizes (in all N), the last one last."""
    between, out = travel(machine.joints, q[:, None], q[None]), travel(machine.joints, q, reference)
    found = _solve(between, out, sizes, seed, max(LEAST_ITERATIONS, ITERATIONS_PER_VISIT * len(q)))
    found = _both_ways(found, q, reference)
    last = next(k for k, r in enumerate(found) if len(r) == sizes[-1])
    found.append(found.pop(last))
    seconds = sum(length(between, out, r) for r in found)
    return Rounds(tuple(tuple(r) for r in found), seconds, lower_bound(between, out, sizes, seconds))


def length(between: Array, out: Array, visits: Sequence[int]) -> float:
    """Seconds of one round; between (N, N), out (N,) from the reference."""
    inner = sum(between[a, b] for a, b in itertools.pairwise(visits))
    return float(out[visits[0]] + inner + out[visits[-1]])


def _solve(between: Array, out: Array, sizes: Sequence[int], seed: int, iterations: int) -> list[list[int]]:
    if len(out) == 1:
        return [[0]]
    ticks = np.round(TICKS * np.block([[np.zeros((1, 1)), out[None]], [out[:, None], between]])).astype(int)
    model = Model()
    places = [model.add_location(0, 0) for _ in ticks]
    model.add_depot(places[0])
    for place in places[1:]:
        model.add_client(place, delivery=[1])
    kinds = list(Counter(sizes).items())
    for size, count in kinds:
        model.add_vehicle_type(count, capacity=[size])
    for i, here in enumerate(places):
        for j, there in enumerate(places):
            if i != j:
                model.add_edge(here, there, distance=int(ticks[i, j]))
    # Rounds that are all full leave little room to move: start from some, so that the best is never without its sizes.
    data = model.data()
    ends = np.cumsum(sizes).tolist()
    kind = {size: k for k, (size, _) in enumerate(kinds)}
    start = [Route(data, list(range(end - size, end)), kind[size]) for size, end in zip(sizes, ends, strict=True)]
    found = model.solve(
        stop=MaxIterations(iterations), seed=seed, display=False, collect_stats=False,
        initial_solution=Solution(data, start),
    )  # fmt: skip
    return [[stop.idx for stop in route if stop.is_client()] for route in found.best.routes()]


def _both_ways(rounds: list[list[int]], q: Array, reference: Array) -> list[list[int]]:
    """Turn rounds round until every joint is approached from below as often as from above, all over its travel."""
    scale = np.maximum(np.ptp(q, axis=0), 1e-9)

    def tally(visits: list[int]) -> Array:
        came = np.sign(q[visits] - np.vstack([reference[None], q[visits[:-1]]]))
        where = (q[visits] - reference) / scale
        return np.concatenate([came.sum(axis=0), 2.0 * (came * where).sum(axis=0)])

    tallies = [(tally(r), tally(r[::-1])) for r in rounds]
    way = [0] * len(rounds)
    total = np.sum([t[0] for t in tallies], axis=0)
    better = True
    while better:
        better = False
        for k, both in enumerate(tallies):
            turned = total - both[way[k]] + both[1 - way[k]]
            if turned @ turned < total @ total - 1e-9:
                total, way[k], better = turned, 1 - way[k], True
    return [r[::-1] if w else r for r, w in zip(rounds, way, strict=True)]
