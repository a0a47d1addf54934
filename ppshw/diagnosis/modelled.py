"""What was found joins the calibration: the base model's parameters refitted beside the effects, and the effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppshw.calibration import Calibration
from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.search import Found, coefficients, modelled
from ppshw.diagnosis.wording import sentence
from ppshw.diagnosis.workspace import Workspace
from ppshw.terms.effect import UNNAMED, Effect


def extended(space: Workspace, found: list[tuple[Found, Candidate]]) -> Calibration:
    """The calibration with every finding modelled. Structure without a name is marked as such: a smooth correction over
    the columns that it depends on, nothing beyond what the recording saw of them; predictions have it, no axis is
    driven by it."""
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
        effects.append(Effect(name, candidate.joint, columns, *numbers, sentence(candidate, own, rms)))
    recording = space.recording.subset(space.fit)
    calibration = Calibration.of(replace(space.base, theta=theta), recording, "joint")
    return replace(calibration, effects=tuple(effects), reference=dict(space.context.reference))

