"""Jobs for the tests of the studies' engine; in a module of their own, since workers import them by name."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from ppshw.errors import IdentificationFailed
from ppshw.process import cores


def dice(seed: int, throws: int = 4) -> dict[str, Any]:
    """As a study's job: what it says depends on its seed alone."""
    return {"thrown": np.random.default_rng(seed).normal(size=throws).tolist()}


def says_its_cores(seed: int) -> dict[str, Any]:
    return {"seed": seed, "cores": cores()}


def slow_dice(seed: int, seconds: float) -> dict[str, Any]:
    time.sleep(seconds)
    return dice(seed)


def falls_over_once(seed: int, marks: str) -> dict[str, Any]:
    """Takes its worker with it the first time seed 3 comes by, as a machine that is switched off would."""
    mark = Path(marks) / "fell"
    if seed == 3 and not mark.exists():
        mark.touch()
        os._exit(9)
    return dice(seed)


def always_falls_over(seed: int) -> dict[str, Any]:
    if seed == 3:
        os._exit(9)
    return dice(seed)


def complains(seed: int) -> dict[str, Any]:
    if seed == 1:
        raise IdentificationFailed("no visit has a target")
    if seed == 2:
        return {"share": 1 / (seed - 2)}
    return dice(seed)


def counts(seed: int, marks: str) -> dict[str, Any]:
    """Leaves a mark per call."""
    with (Path(marks) / f"called{seed}").open("a") as file:
        file.write("x")
    return dice(seed)
