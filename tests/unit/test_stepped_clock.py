"""Waiting for a message on stepped time: real time first, machine time after."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from simulators.clock import SteppedClock


class _StoodStill(threading.Condition):
    """A machine that stood still in the first wait: the time is gone when it wakes, and nobody else has run."""

    def __init__(self, standstill_s: float, when_it_goes_on: Callable[[], None]) -> None:
        super().__init__()
        self._standstill: float | None = standstill_s
        self._when_it_goes_on = when_it_goes_on

    def wait(self, timeout: float | None = None) -> bool:
        if self._standstill is not None:
            time.sleep(self._standstill)
            self._standstill = None
            self._when_it_goes_on()
            return False
        return super().wait(timeout)


def test_a_machine_that_stood_still_does_not_cost_the_answer_its_grace() -> None:
    clock = SteppedClock(grace=0.5)
    answered: list[bool] = []

    def answer() -> None:
        with arrival:
            answered.append(True)
            arrival.notify_all()

    arrival = _StoodStill(0.6, when_it_goes_on=threading.Timer(0.05, answer).start)
    with arrival:
        assert clock.wait_for(arrival, lambda: bool(answered), timeout=0.5)
    assert clock.now() == 0.0


def test_machine_time_runs_out_where_nobody_answers() -> None:
    clock = SteppedClock(grace=0.05)
    arrival = threading.Condition()
    with arrival:
        assert not clock.wait_for(arrival, lambda: False, timeout=0.5)
    assert clock.now() == 0.5
