"""What is no error of a machine: found before any fit, named, and not allowed to spoil the rest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ppshw.calibration import Calibration
from ppshw.errors import IdentificationFailed, RecordingError
from ppshw.evaluation import figures, residuals
from ppshw.identification import identify
from ppshw.identification.plausible import without_gross_errors
from ppshw.machine import Machine, load_machine
from ppshw.recording import Recording, load_recording
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant
from tests.contract.desk import MACHINE

FRAMES = {"the tracker's place is known": "", "nobody placed the tracker": "  base: estimate\n  targets: estimate\n"}


@pytest.fixture(params=FRAMES)
def measured(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Machine, Recording]:
    (tmp_path / "m.yaml").write_text(MACHINE + FRAMES[request.param], encoding="utf-8")
    machine, plant = load_machine(tmp_path / "m.yaml"), Plant.from_file(tmp_path / "m.yaml", seed=2)
    csv = simulate_recording_csv(plant, tmp_path / "r.csv", 90, np.random.default_rng(4), "mixed", loads=4)
    return machine, load_recording(csv, machine)


def test_a_good_recording_is_left_alone(measured: tuple[Machine, Recording]) -> None:
    machine, recording = measured
    kept, gross = without_gross_errors(machine, recording)
    assert not gross.any()
    np.testing.assert_array_equal(kept.points, recording.points)


@pytest.mark.parametrize("metres", [0.2, 20.0, 1e8])
def test_a_gross_reading_spoils_nothing_but_its_own_visit(measured: tuple[Machine, Recording], metres: float) -> None:
    """A beam on another reflector, a slipped point, a flipped bit: from centimetres to the moon."""
    machine, recording = measured
    points = recording.points.copy()
    points[4, 0, 0] += metres
    points[60, 2, 1] -= metres
    found = identify(machine, replace(recording, points=points))
    assert np.flatnonzero(found.weights < 0.5).tolist() == [4, 60]
    calibration = Calibration.of(found, recording, "joint")
    assert calibration.provenance["visits_down_weighted"] == 2
    assert figures(residuals(recording, calibration))["p98_6_mm"] < 0.2  # of the readings as they should have been


def test_millimetres_for_metres_are_another_machine(measured: tuple[Machine, Recording]) -> None:
    machine, recording = measured
    with pytest.raises(RecordingError, match=r"half of the targets .* \d+ m from where 'cell' should") as said:
        identify(machine, replace(recording, points=1e3 * recording.points))
    nobody_wrote_estimate = machine.tracker.base is not None
    assert ("or is `tracker.base: estimate` wanted there?" in str(said.value)) == nobody_wrote_estimate


def test_a_machine_that_never_moved_is_another_machine(measured: tuple[Machine, Recording]) -> None:
    machine, recording = measured
    stood = np.broadcast_to(recording.points[0], recording.points.shape)
    with pytest.raises(RecordingError, match="is it this machine, are they in metres"):
        identify(machine, replace(recording, points=stood))


def test_what_cannot_be_determined_is_said(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text(MACHINE + FRAMES["nobody placed the tracker"], encoding="utf-8")
    machine, plant = load_machine(tmp_path / "m.yaml"), Plant.from_file(tmp_path / "m.yaml", seed=2)
    recording = load_recording(simulate_recording_csv(plant, tmp_path / "r.csv", 4), machine)
    with pytest.raises(IdentificationFailed, match="no target was measured"):
        identify(machine, replace(recording, points=np.full_like(recording.points, np.nan)))
    one = recording.points.copy()
    one[1:] = np.nan
    one[0, 1:] = np.nan
    with pytest.raises(IdentificationFailed, match="1 readings do not place the measuring frame"):
        identify(machine, replace(recording, points=one))
