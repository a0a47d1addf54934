"""From a recording to a calibration: the paper's stepwise method and the joint estimate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppshw.errors import IdentificationFailed
from ppshw.identification.joint import Estimate, Progress, believable
from ppshw.identification.own_weight import fitted
from ppshw.identification.paper import identify_paper
from ppshw.identification.plausible import without_gross_errors
from ppshw.machine import Machine
from ppshw.recording import Recording

METHODS = ("joint", "paper")
# A visit with a gross reading is hardly believed, whatever its other readings say.
GROSS_WEIGHT = 1e-3


def identify(
    machine: Machine, recording: Recording, method: str = "joint", progress: Progress | None = None
) -> Estimate:
    """Identify model (17) by one of METHODS. Raises IdentificationFailed when the recording does not allow it, and
    RecordingError when it can be none of this machine."""
    kept, gross = without_gross_errors(machine, recording)
    try:
        if method == "paper":
            found: Estimate = identify_paper(machine, kept)
        else:
            sound = kept.subset(~gross & kept.measured)  # a damaged encoder cell is no travel
            found = fitted(machine, sound, kept, progress)
    except np.linalg.LinAlgError as exc:
        raise IdentificationFailed(f"{recording.source}: does not determine the model ({exc})") from None
    weights = np.where(gross, np.minimum(found.weights, GROSS_WEIGHT), found.weights)
    if not len(believable(weights)):
        raise IdentificationFailed(f"{recording.source}: no visit is like the others, expected most of them to be")
    return replace(found, weights=weights)
