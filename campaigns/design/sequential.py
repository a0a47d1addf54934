"""After a recording: what is known now, whether it is enough, what to measure next.

What an estimate learnt of a recording, prior strengths and noise replace the guesses, and its visits, laid out over the
joints' whole travel, are what is known. The next visits are then designed as the first ones were.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from campaigns.design.belief import Belief, learnt, white_rows
from ppshw.identification.joint import Estimate
from ppshw.quantities import many
from ppshw.recording import Recording
from ppshw.terms import Situation

Array = NDArray[np.float64]
BLOCK = 512


@dataclass(frozen=True)
class Known:
    """information (p, p) of the visits made, in the belief's z."""

    belief: Belief
    information: Array


def known_from(recording: Recording, estimate: Estimate, more: int) -> Known:
    """What the estimate of a recording says; `more` visits are to come (how fine the model may become)."""
    made, measured = len(recording), int(recording.measured.sum())
    origin = (
        f"what {many(measured, 'visit')} ({recording.source.rsplit('/', 1)[-1]}, {recording.sha256[:12]}) have shown"
    )
    belief = learnt(estimate.model.machine, made + more, estimate.groups, estimate.noise, origin)
    size = len(belief.strengths)
    information = np.zeros((size, size))
    for start in range(0, made, BLOCK):
        some = np.arange(start, min(start + BLOCK, made))
        some = some[estimate.weights[some] > 0]  # visits without any target say nothing
        if len(some):
            part = recording.subset(some)
            rows = white_rows(belief, Situation.of(part), weights=estimate.weights[some], seen=part.seen)
            flat = rows.reshape(-1, size)
            information += flat.T @ flat
    return Known(belief, information)
