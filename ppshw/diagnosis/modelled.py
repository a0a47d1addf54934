"""What was found joins the calibration: the base model's parameters refitted beside the effects, and the effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppshw.calibration import Calibration
from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.search import Found, coefficients, modelled
from ppshw.diagnosis.wording import sentence
from ppshw.diagnosis.workspace import Workspace
from ppshw.terms.effect import Effect


def extended(space: Workspace, found: list[tuple[Found, Candidate]]) -> Calibration:
    """The calibration with every named finding modelled; structure without a name may not be relied on: left out."""
    base, _ = space.coefficients()
    theta = np.zeros(len(space.active))
    theta[space.active] = base
    effects = []
    for f, candidate in found:
        if candidate.effect == "nameless":
            continue
        columns, values, std = modelled(space, candidate, f)
        own, _, rms = coefficients(space, candidate, f)
        numbers = tuple(values.tolist()), tuple(std.tolist())
        effects.append(Effect(candidate.effect, candidate.joint, columns, *numbers, sentence(candidate, own, rms)))
    recording = space.recording.subset(space.fit)
    calibration = Calibration.of(replace(space.base, theta=theta), recording, "joint")
    return replace(calibration, effects=tuple(effects), reference=dict(space.context.reference))

