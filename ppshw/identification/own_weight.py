"""Does a link's own weight bend its own joint? Machines differ in where their compliance sits, no file says it, and
recordings do.

Bearings and drives stand behind a joint's motion and carry the link: its weight bends them. A link that is rigid at its
joint and bends towards its end is bent by what lies beyond it alone, as paper eq. (15) may be read. The share κ of
their own weight that links are bent by is estimated beside the whole base model; a machine is taken as the second where
κ is near 0 and surely not 1. docs/decisions/own-weight.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ppshw.identification.joint import Estimate
from ppshw.identification.start import to_base
from ppshw.recording import Recording
from ppshw.terms import Situation

Array = NDArray[np.float64]
# Log odds of κ = 0 against 1 that are enough, and how far from 0 it may be: compliances were learnt with the wrong
# statics, so it is off by more than its uncertainty. Of six machines of two authors whose links do not hang on their
# joints five said −0.5 to 0.1 ± 0.1 with odds of 25 to 106, one 0.3 ± 0.15 with 8; of those that do, eleven of five
# authors, none spoke for 0.
SURE, NEAR = 10.0, 0.5
NOT_HUNG = "of a link do not bend its own joint here, only those before it"
FEWEST, MOST = 40, 1024  # visits that are asked
LITTLE = 1e-6  # what a column with its prior moves targets by, over their noise


def links_hang(found: Estimate, recording: Recording) -> bool:
    """Whether a machine is to be taken as one whose links hang on their joints, as its estimate took it: not where the
    recording, that of the estimate, is sure of the contrary."""
    visits = np.flatnonzero(recording.measured)
    if len(visits) < FEWEST or not any(j.mass > 0 and j.elastic for j in found.model.machine.joints):
        return True
    share, std = share_of_own_weight(found, recording, visits[:: -(-len(visits) // MOST)])
    odds = (1.0 - 2.0 * share) / (2.0 * std**2)
    return not (odds > SURE and abs(share) < NEAR)


def share_of_own_weight(found: Estimate, recording: Recording, visits: NDArray[np.int64]) -> tuple[float, float]:
    """κ and its standard deviation (infinite where the base model takes all of it), for an estimate of a machine that
    hangs."""
    recording, weights, model = recording.subset(visits), found.weights[visits], found.model
    situation, count = Situation.of(recording), len(visits)
    about = model.linearise(situation, found.theta)
    otherwise = replace(model, machine=replace(model.machine, hangs=False)).predict(situation, found.theta)
    gap = np.where(recording.seen[..., None], to_base(recording.points, found.measuring_in_base) - about.positions, 0.0)
    root = found.noise.whitener(about.levers, recording.seen) * np.sqrt(weights)[:, None, None]

    def white(columns: Array) -> Array:
        return (root @ columns.reshape(count, root.shape[1], -1)).reshape(count * root.shape[1], -1)

    prior = np.array([found.groups[p.group] * p.scale for p in model.parameters()])
    base = white(about.design) * prior
    moves = np.sqrt((base**2).mean(axis=0)) > LITTLE
    base, at = base[:, moves], (found.theta / np.where(prior > 0, prior, 1.0))[moves]
    own = white(about.positions - otherwise)[:, 0]
    data = white(gap)[:, 0] + base @ at
    # what of it no prior draw of the base model makes
    beyond = own - base @ np.linalg.solve(base.T @ base + np.eye(base.shape[1]), base.T @ own)
    alone = float(own @ beyond)
    if not alone > 0.0:
        return 1.0, np.inf
    return 1.0 + float(beyond @ data) / alone, alone**-0.5
