"""Simulated time that is stepped by whoever waits, so that a campaign of hours runs in seconds.

A motion is a function of time: a caller that sleeps 20 s of machine time finds the axes 20 s further at once. Messages
still cross their wires in real time, between real threads; only waiting for motion costs nothing.

Known limitations: one thread does the sleeping (the campaign's); callbacks run in that thread.
"""

from __future__ import annotations

import heapq
import itertools
import threading
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

START = datetime(2026, 3, 2, 6, 0, tzinfo=UTC)
SLICES = 10


class SteppedClock:
    """`sleep` moves the time on; `every` and `at` run callbacks as it passes.

    grace   real seconds that a wait for a message is given before machine time moves on, in slices, so that a machine
            that stood still for a while still lets the one who answers run
    """

    def __init__(self, start: datetime = START, grace: float = 0.25) -> None:
        self._start = start
        self._now = 0.0
        self.grace = grace
        self._lock = threading.RLock()
        self._ticket = itertools.count()
        self._due: list[tuple[float, int, float | None, Callable[[], None]]] = []

    def now(self) -> float:
        return self._now

    def utc(self) -> datetime:
        return self._start + timedelta(seconds=self._now)

    def at(self, when: float, callback: Callable[[], None]) -> None:
        """Run callback() once, when the time reaches `when`."""
        with self._lock:
            heapq.heappush(self._due, (when, next(self._ticket), None, callback))

    def every(self, period: float, callback: Callable[[], None]) -> None:
        """Run callback() every `period` seconds, for good."""
        with self._lock:
            heapq.heappush(self._due, (self._now + period, next(self._ticket), period, callback))

    def sleep(self, seconds: float) -> None:
        self._advance_to(self._now + max(0.0, seconds))

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout: float) -> bool:
        """Real time first (a message may be on its way), then machine time step by step until the timeout."""
        deadline = self._now + max(0.0, timeout)
        if self._wait_in_slices(condition, predicate):
            return True
        while self._now < deadline:
            condition.release()
            try:
                self._advance_to(min(deadline, self._next_due(deadline)))
            finally:
                condition.acquire()
            if condition.wait_for(predicate, self.grace / SLICES):
                return True
        return self._wait_in_slices(condition, predicate)

    def _wait_in_slices(self, condition: threading.Condition, predicate: Callable[[], bool]) -> bool:
        return any(condition.wait_for(predicate, self.grace / SLICES) for _ in range(SLICES))

    def _next_due(self, default: float) -> float:
        with self._lock:
            return self._due[0][0] if self._due else default

    def _advance_to(self, when: float) -> None:
        with self._lock:
            while self._due and self._due[0][0] <= when:
                due, ticket, period, callback = heapq.heappop(self._due)
                self._now = max(self._now, due)
                if period is not None:
                    heapq.heappush(self._due, (due + period, ticket, period, callback))
                callback()
            self._now = max(self._now, when)
