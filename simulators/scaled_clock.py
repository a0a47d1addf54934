"""Time that runs by itself, `speed` times as fast as the clock on the wall; for hardware in a process of its own.

Known limitations: callbacks come a few real milliseconds late, which at speed 100 is a few tenths of a machine second.
"""

from __future__ import annotations

import heapq
import itertools
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime

SPEEDS = 1e-3, 1e5  # that a site file may say


class ScaledClock:
    """`at` and `every` run callbacks in a thread of this clock, until close().

    epoch  seconds since 1970 at which machine time and real time agree; with the same epoch and speed all read the same
    """

    def __init__(self, speed: float = 1.0, epoch: float | None = None) -> None:
        real = time.time()
        self.speed = speed
        self.epoch = real if epoch is None else epoch
        self._zero = time.monotonic() - (real - self.epoch)
        self._ticket = itertools.count()
        self._due: list[tuple[float, int, float | None, Callable[[], None]]] = []
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="scaled-clock", daemon=True)
        self._thread.start()

    def now(self) -> float:
        return (time.monotonic() - self._zero) * self.speed

    def utc(self) -> datetime:
        return datetime.fromtimestamp(self.epoch + self.now(), UTC)

    def sleep(self, seconds: float) -> None:
        time.sleep(max(0.0, seconds) / self.speed)

    def at(self, when: float, callback: Callable[[], None]) -> None:
        self._push(when, None, callback)

    def every(self, period: float, callback: Callable[[], None]) -> None:
        self._push(self.now() + period, period, callback)

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join(timeout=5)

    def _push(self, when: float, period: float | None, callback: Callable[[], None]) -> None:
        with self._changed:
            heapq.heappush(self._due, (when, next(self._ticket), period, callback))
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                if self._closed:
                    return
                wait = (self._due[0][0] - self.now()) / self.speed if self._due else None
                if wait is None or wait > 0:
                    self._changed.wait(wait)
                    continue
                when, _, period, callback = heapq.heappop(self._due)
            callback()
            if period is not None:
                self._push(max(when + period, self.now()), period, callback)
