"""One form of one effect, as columns that are laid over a recording."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from ppshw.terms.shapes import Column


@dataclass
class Candidate:
    """effect: the contract's name, or "nameless"; joint, frame, component, covariate: where it sits;
    columns: what it adds; shape: its nonlinear parameters; share: prior weight; covariates: of what has no name;
    way: the sign that physics gives its first coefficient, 0 where it gives none; led: its other columns are nothing
    without the first."""

    effect: str
    joint: str | None
    frame: str | None
    component: str | None
    covariate: str
    columns: tuple[Column, ...]
    shape: dict[str, float] = field(default_factory=dict)
    share: float = 1.0
    covariates: tuple[str, ...] = ()
    way: int = 0
    led: bool = False


@contextmanager
def all_kept() -> Iterator[None]:
    """Makes some 100,000 small objects, none of which is looked at for garbage meanwhile, again and again."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()
