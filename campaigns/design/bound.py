"""No order of the visits can be shorter than this.

Two relaxations of the rounds through all visits, both by Lagrange multipliers on "every visit exactly once"; the larger
bound counts:

    walks   rounds of exactly the right sizes, that may pass a visit more than once (not there and straight back). A
            dynamic programme prices them (Christofides, Mingozzi & Toth 1981, "q-routes"). Tight with many rounds.
    trees   a closed tour through all visits and the reference, once per round, whatever the rounds' sizes, relaxed to a
            1-tree (Held & Karp 1970, 1971). Tight with one round.

Multipliers climb by Polyak's subgradient step towards the length of an order that is known; every value on the way is
a valid bound. docs/design.md §3.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
STEPS = 600
PATIENCE, SMALLER = 15, 0.7
FAR = 1e6  # between two visits of the reference: no round is empty [s]


def lower_bound(between: Array, out: Array, sizes: Sequence[int], known: float) -> float:
    """Least travel of rounds of these sizes [s].

    between (N, N) and out (N,) from the reference [s], symmetric; known: the length of some order [s]
    """
    closed = between.copy()
    np.fill_diagonal(closed, np.inf)
    walks = _climb(lambda price: _walks(closed, out, Counter(sizes), price), len(out), known)
    count = len(sizes)
    tour = np.full((len(out) + count,) * 2, FAR)
    tour[count:, :count], tour[:count, count:], tour[count:, count:] = out[:, None], out[None], between
    trees = _climb(lambda price: _one_tree(tour, price), len(tour), known) if len(tour) > 2 else 0.0
    return min(known, max(walks, trees))


def _climb(dual: Callable[[Array], tuple[float, Array]], size: int, known: float) -> float:
    """The largest value found of a concave dual function: prices (size,) → value, subgradient (size,)."""
    price, best, best_price = np.zeros(size), -np.inf, np.zeros(size)
    step, waited = 1.0, 0
    for _ in range(STEPS):
        value, slope = dual(price)
        if value > best:
            best, best_price, waited = value, price.copy(), 0
        else:
            waited += 1
            if waited >= PATIENCE:
                step, waited, price = step * SMALLER, 0, best_price.copy()
        square = float(slope @ slope)
        if square == 0 or known - best < 1e-6 * known:
            break
        price = price + step * max(known - value, 1e-6 * known) / square * slope
    return best


def _walks(between: Array, out: Array, sizes: Counter[int], price: Array) -> tuple[float, Array]:
    """Cheapest rounds when passing visit i earns price[i], and all prices paid back."""
    value, passed = float(price.sum()), np.zeros(len(price))
    layers = _layers(between, out, price, max(sizes))
    for size, count in sizes.items():
        total, visits = _trace(layers, out, size)
        value += count * total
        np.add.at(passed, visits, count)
    return value, 1.0 - passed


def _layers(between: Array, out: Array, price: Array, longest: int) -> list[tuple[Array, Array, Indices, Indices]]:
    """Per number of visits so far: cost of the cheapest walk to each visit, of the cheapest that comes from another
    visit than that one, and where both come from (−1: the reference)."""
    n = len(out)
    everyone = np.arange(n)
    step = between - price[None]
    first, second = out - price, np.full(n, np.inf)
    came, other = np.full(n, -1), np.full(n, -1)
    layers = [(first, second, came, other)]
    for _ in range(longest - 1):
        cost = first[:, None] + step
        back = came >= 0  # to where the cheapest walk came from, only the second cheapest may go on
        cost[everyone[back], came[back]] = second[back] + step[everyone[back], came[back]]
        came = cost.argmin(axis=0)
        first = cost[came, everyone]
        cost[came, everyone] = np.inf
        other = cost.argmin(axis=0)
        second = cost[other, everyone]
        layers.append((first, second, came, other))
    return layers


def _trace(layers: list[tuple[Array, Array, Indices, Indices]], out: Array, size: int) -> tuple[float, Indices]:
    """The cheapest round of `size` visits: its cost and its visits, last one first."""
    ends = layers[size - 1][0] + out
    at = int(np.argmin(ends))
    visits, cheapest = [at], True
    for k in range(size - 1, 0, -1):
        _, _, came, other = layers[k]
        before = int(came[at] if cheapest else other[at])
        cheapest = bool(layers[k - 1][2][before] != at)
        at = before
        visits.append(at)
    return float(ends.min()), np.array(visits)


def _one_tree(between: Array, price: Array) -> tuple[float, Array]:
    """Cheapest 1-tree (the last node is the special one) with node prices, less twice the prices; degrees less two."""
    cost = between + price[:, None] + price[None]
    n = len(cost) - 1
    degree = np.zeros(n + 1)
    outside = np.ones(n, dtype=bool)
    outside[0] = False
    nearest, parent = cost[0, :n].copy(), np.zeros(n, dtype=int)
    weight = 0.0
    for _ in range(n - 1):  # Prim
        j = int(np.argmin(np.where(outside, nearest, np.inf)))
        weight += float(nearest[j])
        degree[j] += 1
        degree[parent[j]] += 1
        outside[j] = False
        closer = outside & (cost[j, :n] < nearest)
        nearest[closer], parent[closer] = cost[j, :n][closer], j
    two = np.argsort(cost[n, :n])[:2]
    weight += float(cost[n, two].sum())
    degree[two] += 1
    degree[n] += 2
    return weight - 2.0 * float(price.sum()), degree - 2.0
