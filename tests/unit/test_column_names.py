"""Whose a column is, by its whole name: a joint y is in no q_yaw, and a rotary axis C in no temp_air_C."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from ppshw.diagnosis.found import Found
from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.shadows import caster_of, of_a_riddle
from ppshw.machine import load_machine
from ppshw.terms.shapes import Column
from ppshw.terms.shapes.covariates import speaks_of, whose
from tests.contract.desk import ROOT


@pytest.mark.parametrize(
    ("name", "joint"),
    [
        ("q_y", "y"), ("q_yaw", "yaw"), ("approach_tilt_a", "tilt_a"), ("late_0.5_pace_y", "y"),
        ("on_tilt_a_Mx", "tilt_a"),
        ("previous_on_y_Fz", "y"), ("late_2_temp_arm_1_C", "arm_1"), ("temp_air_C", "air"), ("time", None),
        ("Mx", None),
        ("since_load_change", None), ("previous_q_y", "y"), ("cov_q_y", None),
    ],
)  # fmt: skip
def test_a_column_is_of_the_joint_that_its_whole_name_says(name: str, joint: str | None) -> None:
    assert whose(name) == joint


@pytest.mark.parametrize(
    ("name", "column", "does"),
    [
        ("q_yaw", "q_yaw", True), ("q_yaw", "q_y", False), ("q_j10", "q_j1", False), ("previous_q_yaw", "q_yaw", True),
        ("late_0.5_temp_air_C", "temp_air_C", True), ("temp_air_C", "C", False), ("on_arm_Mx", "Mx", True),
        ("late_0.4_on_arm_Mx", "Mx", True), ("on_arm_Mx", "My", False), ("former_load", "load", True),
    ],
)  # fmt: skip
def test_a_column_speaks_of_what_it_is_made_of(name: str, column: str, does: bool) -> None:
    assert speaks_of(name, column) is does


@pytest.mark.parametrize(("joint", "beside"), [("yaw", True), ("ya", False), ("y", False), ("j10", False)])
def test_a_shadow_does_not_depend_on_how_joints_are_called(joint: str, beside: bool) -> None:
    """A coupling over q_yaw beside play of a joint that is, or only begins, as that one."""
    machine = load_machine(ROOT / "machines/arm6.yaml")

    def candidate(effect: str, of: str | None, frame: str, component: str, covariate: str) -> Candidate:
        column = Column("frame", "wave", {"joint": 0}, 1, 0)
        return Candidate(effect, of, frame, component, covariate, (column,), covariates=(covariate,))

    play = candidate("backlash", joint, joint, "rz", f"approach_{joint}")
    coupling = candidate("cross_coupling", "b", "b", "tx", "q_yaw")
    left = candidate("nameless", None, joint, "rz", f"approach_{joint}")
    said = np.array([0.0, 0.0, 1e3]), None
    tried = SimpleNamespace(
        candidates=[play, coupling, left], space=SimpleNamespace(machine=machine), said=lambda: said
    )
    found = Found(0, ("backlash", joint), 0.0, 1000.0, first=1000.0)
    assert (caster_of(tried, 1, 50.0, [found]) is found) is beside  # type: ignore[arg-type]
    assert of_a_riddle(candidate("periodic_transmission", joint, joint, "rz", f"q_{joint}"), coupling) is beside


def test_a_reflector_called_as_a_unit_is_no_temperature() -> None:
    reflector = Candidate("target_moved", None, None, None, "C", (), covariates=())
    riddle = Candidate("nameless", None, "b", "tx", "temp_air_C", (), covariates=("temp_air_C",))
    assert not of_a_riddle(reflector, riddle)
