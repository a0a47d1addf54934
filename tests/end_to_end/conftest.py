"""A rig per test: hardware simulated at wire level in this process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.end_to_end.rig import Rig


@pytest.fixture(autouse=True)
def no_pause_in_geocompy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its constructor sleeps a second, for instruments that wake up; these are awake."""
    monkeypatch.setattr("geocompy.geo.sleep", lambda seconds: None)


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    made = Rig(tmp_path)
    with made.hardware:
        yield made
