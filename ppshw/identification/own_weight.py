"""Does the machine's own weight bend it, and whose which joint? Machines differ in where their compliance sits, no file
says it, and recordings do.

Bearings and drives stand behind a joint's motion and carry the link: its weight bends them. A link that is rigid at its
joint and bends towards its end is bent by what lies beyond it alone, as paper eq. (15) may be read. Where weights are
balanced the payload alone bends anything. The fit is made as the first has it; beside the whole base model it is
estimated how far it would have to go towards each of the others. Where it may be one of those the fit is made that way
too, and is asked how far it would go back; the more sure of the two stands. docs/decisions/own-weight.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ppshw.identification.joint import Estimate, Progress, estimate
from ppshw.identification.start import to_base
from ppshw.identification.structure import joint_model
from ppshw.machine import BentBy, Machine
from ppshw.recording import Recording
from ppshw.terms import Situation

Array = NDArray[np.float64]
# Log odds of another way from which it is tried; by how much its own odds of going back must be less; how far back it
# may go. The first fit's compliances are learnt with the wrong statics: clean recordings of six machines of which the
# payload alone bends anything had odds of -0.4 to 298 for that, and of -160 to -6,000 for going back; those of 43
# machines of four authors whose links hang on their joints, or nearly, -13 and less (for the links beyond up to 11).
TRIED: dict[BentBy, float] = {"beyond": 10.0, "payload": -5.0}
SURE, NEAR = 20.0, 0.5
NOT_BENT = {
    "beyond": "of a link do not bend its own joint here, only those before it",
    "payload": "bend nothing here, the payload alone does",
}
FEWEST, MOST = 40, 1024  # visits that are asked
LITTLE = 1e-6  # what a column with its prior moves targets by, over their noise


def fitted(machine: Machine, sound: Recording, recording: Recording, progress: Progress | None = None) -> Estimate:
    """The joint estimate of a recording, its model laid over the travel of the sound visits, of a machine that is bent
    as the recording says."""
    found = estimate(joint_model(machine, sound), recording, progress=progress)
    other, odds = _likeliest(found, recording)
    if other is None:
        return found
    again = estimate(joint_model(replace(machine, bent_by=other), sound), recording, progress=progress)
    (back, std), = towards(again, recording, machine.bent_by)
    return again if odds - _odds(back, std) > SURE and abs(back) < NEAR else found


def _likeliest(found: Estimate, recording: Recording) -> tuple[BentBy | None, float]:
    """In which other way a machine may be bent by a recording, if any, and the log odds."""
    visits = int(recording.measured.sum())
    if visits < FEWEST or not any(j.mass > 0 and j.elastic for j in found.model.machine.joints):
        return None, 0.0
    ways = dict(zip(TRIED, towards(found, recording, *TRIED), strict=True))
    odds = {other: _odds(*way) for other, way in ways.items() if way[1] < np.inf}
    best = max((other for other in odds if odds[other] > TRIED[other]), key=lambda other: odds[other], default=None)
    return best, 0.0 if best is None else odds[best]


def _odds(share: float, std: float) -> float:
    """Log odds of a share 1 against 0."""
    return (2.0 * share - 1.0) / (2.0 * std**2)


def towards(found: Estimate, recording: Recording, *others: BentBy) -> list[tuple[float, float]]:
    """How far a recording would have its estimate go from the way in which it takes the machine as bent (0) to each of
    others (1), beside the whole base model, and the standard deviation (infinite where that takes all of it)."""
    visits = np.flatnonzero(recording.measured)
    visits = visits[:: -(-len(visits) // MOST)]
    recording, weights, model = recording.subset(visits), found.weights[visits], found.model
    situation, count = Situation.of(recording), len(visits)
    about = model.linearise(situation, found.theta)
    otherwise = [
        replace(model, machine=replace(model.machine, bent_by=other)).predict(situation, found.theta)
        for other in others
    ]
    gap = np.where(recording.seen[..., None], to_base(recording.points, found.measuring_in_base) - about.positions, 0.0)
    root = found.noise.whitener(about.levers, recording.seen) * np.sqrt(weights)[:, None, None]

    def white(columns: Array) -> Array:
        return (root @ columns.reshape(count, root.shape[1], -1)).reshape(count * root.shape[1], -1)

    prior = np.array([found.groups[p.group] * p.scale for p in model.parameters()])
    base = white(about.design) * prior
    moves = np.sqrt((base**2).mean(axis=0)) > LITTLE
    base, at = base[:, moves], (found.theta / np.where(prior > 0, prior, 1.0))[moves]
    ways = np.concatenate([white(each - about.positions) for each in otherwise], axis=1)
    data = white(gap)[:, 0] + base @ at
    # what of them no prior draw of the base model makes
    beyond = ways - base @ np.linalg.solve(base.T @ base + np.eye(base.shape[1]), base.T @ ways)
    alone, along = np.einsum("rk,rk->k", ways, beyond).tolist(), (beyond.T @ data).tolist()
    return [(b / a, a**-0.5) if a > 0.0 else (0.0, np.inf) for a, b in zip(alone, along, strict=True)]
