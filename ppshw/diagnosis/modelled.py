"""What was found joins the calibration: the base model's parameters refitted beside the effects, and the effects."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np

from ppshw.calibration import Calibration
from ppshw.diagnosis.carried import a_matter_of_time
from ppshw.diagnosis.gaussian_process import in_words
from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.search import Found, coefficients, modelled
from ppshw.diagnosis.wording import sentence
from ppshw.diagnosis.workspace import Workspace
from ppshw.terms.effect import UNNAMED, Effect


def extended(space: Workspace, found: list[tuple[Found, Candidate]]) -> Calibration:
    """The calibration with every finding modelled. Structure without a name is marked as such: a Gaussian process over
    the columns that it depends on, nothing where the recording saw nothing of them; predictions have it, no axis is
    driven by it."""
    space = _without_the_rest(space, found)
    base, _ = space.coefficients()
    theta = np.zeros(len(space.active))
    theta[space.active] = base
    effects = []
    for f, candidate in found:
        if not f.carried:
            continue
        columns, values, std = modelled(space, candidate, f)
        own, _, rms = coefficients(space, candidate, f)
        numbers = tuple(values.tolist()), tuple(std.tolist())
        name = UNNAMED if candidate.effect == "nameless" else candidate.effect
        said = sentence(candidate, own, rms)
        if columns[0].function == "unexplained":
            said += f" It is carried without a name, as {in_words(columns, space.machine)}."
        effects.append(Effect(name, candidate.joint, columns, *numbers, said))
    recording = space.recording.subset(space.fit)
    calibration = Calibration.of(replace(space.base, theta=theta), recording, "joint")
    return replace(calibration, effects=tuple(effects), reference=dict(space.context.reference))



def _without_the_rest(space: Workspace, found: list[tuple[Found, Candidate]]) -> Workspace:
    """Fitted without structure that a calibration does not have, or its share would be missing from predictions. What
    goes with time stays in the fit: it is no part of the machine as it will be found."""
    taken = space.taken.copy()
    for f, candidate in found:
        if not f.carried and not a_matter_of_time(space.context, candidate.covariates):
            taken[:, :, f.at : f.at + len(candidate.columns) + len(f.near)] = 0.0
    space = copy(space)
    space.take_up(taken, space.taken_prior)
    return space
