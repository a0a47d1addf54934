"""A rack of drives for every test of axes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from drivers.axis_config import AxisConfig
from tests.unit.axes.rack import Machine


@pytest.fixture
def build() -> Iterator[Callable[..., Machine]]:
    built: list[Machine] = []

    def make(*axes: AxisConfig, **drive: Any) -> Machine:
        built.append(Machine(*axes, **drive))
        return built[-1]

    yield make
    for machine in built:
        machine.close()


@pytest.fixture
def machine(build: Callable[..., Machine]) -> Machine:
    """Started, all axes at zero counts: slide 0 m, lift 0 m, slew 0.5 rad."""
    m = build()
    m.group.start()
    return m
