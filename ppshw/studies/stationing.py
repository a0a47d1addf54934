"""A calibration from one recording, used in another: the machine has been moved, so its base is found anew.

The protocol of Kindle et al. (2025) for the Hilti recordings: a station is one column height and one branch of the
arm's inverse kinematics. The measuring frame, six numbers, is fitted to the station's stationing poses, everything else
stays as identified, and the station's evaluation poses are scored.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ppshw.calibration import Calibration
from ppshw.errors import RecordingError
from ppshw.identification.joint import estimate
from ppshw.identification.start import to_base
from ppshw.identification.structure import joint_model
from ppshw.machine import Machine
from ppshw.model import Model
from ppshw.recording import Recording
from ppshw.terms import Situation
from ppshw.transforms import fit_rigid

Array = NDArray[np.float64]
GRAVITY = 9.80665
# Gravity turns with the frame and the frame with gravity's sag: 20 mrad settle to below a microradian in three rounds.
ROUNDS = 3


def tilted(model: Model, measuring_in_base: Array) -> Model:
    """The same model on a base that leans: a total station is levelled, so its z says where up is."""
    return replace(model, machine=leaning(model.machine, measuring_in_base))


def leaning(machine: Machine, measuring_in_base: Array) -> Machine:
    """The machine with gravity along −z of measuring_in_base (4, 4), where a levelled instrument stands."""
    return replace(machine, gravity=-GRAVITY * measuring_in_base[:3, 2])


def identify_leaning(machine: Machine, recording: Recording) -> Calibration:
    """Joint estimate, twice: with the machine file's gravity, then with the one that the fitted frame shows."""
    for _ in range(2):
        found = estimate(joint_model(machine, recording), recording)
        machine = leaning(machine, found.measuring_in_base)
    return Calibration.of(found, recording, "joint")


def across(model: Model, theta: Array, recording: Recording, follow_gravity: bool) -> Array:
    """Evaluation poses of every station that has stationing poses.

    follow_gravity  turn gravity with the refitted base; otherwise it stays as the model has it
    returns         (N, T, 3) [m], nan for poses that are not scored
    """
    station = np.array([label.partition(":")[0] for label in recording.step])
    phase = np.array([label.partition(":")[2] for label in recording.step])
    if "stationing" not in phase or "evaluation" not in phase:
        raise RecordingError(f"{recording.source}: no steps named …:stationing and …:evaluation")
    out = np.full(recording.points.shape, np.nan)
    for name in np.unique(station):
        known = recording.subset((station == name) & (phase == "stationing"))
        scored = (station == name) & (phase == "evaluation")
        if known.seen.sum() >= 3 and scored.any():
            frame, local = refit(model, theta, known, follow_gravity)
            there = recording.subset(scored)
            out[scored] = to_base(there.points, frame) - local.predict(Situation.of(there), theta)
    return out


def refit(model: Model, theta: Array, recording: Recording, follow_gravity: bool) -> tuple[Array, Model]:
    """The measuring frame in the base that fits these visits best, (4, 4), and the model as it stands there."""
    visits, which = np.nonzero(recording.seen)
    for _ in range(ROUNDS if follow_gravity else 1):
        expected = model.predict(Situation.of(recording), theta)
        frame = fit_rigid(recording.points[visits, which], expected[visits, which])
        if follow_gravity:
            model = tilted(model, frame)
    return frame, model
