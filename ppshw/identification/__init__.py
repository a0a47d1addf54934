"""From a recording to a calibration: the paper's stepwise method and the joint estimate."""

from __future__ import annotations

from ppshw.identification.joint import Estimate, Progress, estimate
from ppshw.identification.paper import identify_paper
from ppshw.identification.structure import joint_model
from ppshw.machine import Machine
from ppshw.recording import Recording

METHODS = ("joint", "paper")


def identify(
    machine: Machine, recording: Recording, method: str = "joint", progress: Progress | None = None
) -> Estimate:
    """Identify model (17) by one of METHODS. Raises IdentificationFailed when the recording does not allow it."""
    if method == "paper":
        return identify_paper(machine, recording)
    return estimate(joint_model(machine, recording), recording, progress=progress)
