"""Cross-validation: which visits are held out together, and what a model fitted to the others misses on them.

Shuffled folds ask how well the model interpolates between neighbours. Blocks hold out visits that were measured one
after the other, so that neither a slow drift nor a pose's next neighbour helps; stations hold out a region whole.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppshw.evaluation import figures
from ppshw.machine import Machine
from ppshw.recording import Recording

Array = NDArray[np.float64]
Labels = NDArray[np.int64]
Residuals = Callable[[Recording], Array]  # a recording → measured minus predicted, (N, T, 3) [m], base frame
Fit = Callable[[Machine, Recording], Residuals]
BLOCK = 10
FOLDS = 5


def shuffled(visits: int) -> Labels:
    """(N,) fold of every visit, dealt like cards."""
    dealt = np.arange(visits) % FOLDS
    return np.asarray(np.random.default_rng(0).permutation(dealt), dtype=np.int64)


def blocks(visits: int) -> Labels:
    """(N,) contiguous blocks of ten visits, dealt to the folds in turn."""
    return np.asarray(np.arange(visits) // BLOCK % FOLDS, dtype=np.int64)


def grouped(labels: Sequence[str]) -> Labels:
    """(N,) visits of one label stay together; labels are dealt to the folds in the order of first appearance."""
    first = list(dict.fromkeys(labels))
    return np.array([first.index(label) % FOLDS for label in labels], dtype=np.int64)


@dataclass(frozen=True)
class Score:
    """residuals (N, T, 3) [m], nan where nothing was held out; seconds of one fit, mean over folds, by the clock and
    of the processor, 0 where not timed."""

    residuals: Array
    seconds: float = 0.0
    cpu_seconds: float = 0.0

    def figures(self) -> dict[str, float]:
        """`evaluation.figures`, with the mean that publishers prefer   [mm]."""
        size = np.linalg.norm(self.residuals, axis=-1)
        held = np.isfinite(size)
        mean = float(size[held].mean() * 1e3)
        return {**figures(self.residuals), "mean_mm": mean, "readings": float(held.sum())}


def cross_validate(machine: Machine, recording: Recording, fit: Fit, folds: Labels, at_most: int = FOLDS) -> Score:
    """Every visit's residual under a model that has seen none of its fold, frame and targets included.

    at_most  hold out only so many of the folds, for a quick look
    """
    out = np.full(recording.points.shape, np.nan)
    held = np.unique(folds)[:at_most]
    began, busy = time.perf_counter(), time.process_time()
    for fold in held:
        missing = fit(machine, recording.subset(folds != fold))
        out[folds == fold] = missing(recording.subset(folds == fold))
    return Score(out, (time.perf_counter() - began) / len(held), (time.process_time() - busy) / len(held))
