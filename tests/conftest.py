"""For all tests: the process as the program has it (two workers share two cores), and the right four packages."""

from __future__ import annotations

import ppshw.process  # isort: skip  before numpy is there

from pathlib import Path

import campaigns
import drivers
import ppshw
import simulators


def pytest_configure() -> None:
    """Their names are general: another package called `drivers` must not be tested in place of ours."""
    packages = (ppshw, drivers, campaigns, simulators)
    homes = {package.__name__: Path(str(package.__file__)).parents[1] for package in packages}
    if len(set(homes.values())) != 1:
        raise RuntimeError(f"these should be siblings: {homes}; install ppshw into an environment of its own")
