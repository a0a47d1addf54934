"""Trouble in the middle of a campaign: the axes stop, the error names device and cause, the same command goes on.

Every case strikes after the fifth visit. Afterwards the cause is seen to, the drives' faults are acknowledged, and the
run that is taken up again completes: every visit once, in order.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.geocom import GeoComTracker
from drivers.ports import Shot
from ppshw.errors import (
    BeamLost,
    BusLost,
    DriveFault,
    FollowingError,
    HardwareError,
    HardwareTimeout,
    HeartbeatLost,
    LineLost,
    SensorOverrange,
)
from ppshw.recording import load_recording
from ppshw.recording_file import RecordingFile
from simulators.drive import Power
from simulators.faults import Fault, repair
from tests.end_to_end.rig import Rig

CASES: dict[str, tuple[str, str, Any, type[HardwareError], str]] = {
    "a drive trips": ("yaw", "trip", 0x8611, DriveFault, r"yaw: drive fault 0x8611, following error"),
    "a motor sticks": ("longitudinal", "stick", None, FollowingError, r"longitudinal: following error at "),
    "a drive falls silent": ("vertical", "go_silent", None, HeartbeatLost, r"vertical: no .*\(node 2\)"),
    "a drive is unplugged": ("pitch", "unplug", None, HeartbeatLost, r"pitch: no .*\(node 6\)"),
    "the bus falls silent": ("bus", "go_silent", None, BusLost, r"CAN virtual .*: silent: nothing from lateral, "),
    "a beam is broken": ("tracker", "lose_beam", "P2", BeamLost, r"tracker: no target found at P2"),
    "the tracker speaks garbage": ("tracker", "garble", 4000, HardwareError, r"tracker: "),
    "the tracker is unplugged": ("tracker", "unplug", None, LineLost, r"tracker: lost the port loopback"),
    "the force sensor speaks garbage": ("force_sensor", "garble", 10**5, HardwareError, r"force sensor: .* only 0 of"),
    "the force sensor is overloaded": ("force_sensor", "overrange", None, SensorOverrange, r"force sensor: "),
    "the force sensor is silent": ("force_sensor", "go_silent", None, HardwareTimeout, r"force sensor: nothing heard"),
}
GRACE = {"the bus falls silent": 0.15}  # of real seconds each of the answers that cannot come is waited for


@pytest.mark.parametrize("case", CASES)
def test_a_campaign_survives_when(case: str, rig: Rig) -> None:
    device, action, value, error, text = CASES[case]
    rig.clock.grace = GRACE.get(case, rig.clock.grace)
    with pytest.raises(error, match=text) as caught:
        rig.run(Fault(device, action, value, after_visit=5))
    assert "\n" not in str(caught.value)
    assert_stopped(rig)
    with RecordingFile.open(rig.out) as file:
        assert file.done() == {0, 1, 2, 3, 4}
        (fault,) = [(text, data) for _, kind, text, data in file.events() if kind == "fault"]
    assert fault[1]["visit"] == 5
    unheard = {axis.name for axis in rig.site.axes if not rig.hardware.rack.drives[axis.node_id].online}
    assert set(fault[1]["unstopped"]) == unheard
    if unheard:  # nobody could tell them, and whoever stands there must know
        assert str(caught.value).startswith(f"{fault[0]}; ")
        assert "could NOT be told to stop, and may move or hold power: press the emergency stop" in str(caught.value)
    else:
        assert fault[0] == str(caught.value)

    repair(rig.hardware)
    result = rig.run(reset_faults=True)
    assert (result.measured, result.done) == (7, 12)
    recording = load_recording(rig.out, rig.site.machine)
    np.testing.assert_allclose(recording.q_cmd, [v.setpoints for v in rig.plan.visits], atol=1e-9)
    assert recording.seen.all()


def test_a_drive_that_tripped_is_not_enabled_again_unasked(rig: Rig) -> None:
    with pytest.raises(DriveFault):
        rig.run(Fault("yaw", "trip", 0x8611, after_visit=5))
    with pytest.raises(DriveFault, match="yaw: drive fault 0x8611"):
        rig.run()
    assert_stopped(rig)
    assert rig.hardware.drive("yaw").power is Power.FAULT


def test_a_fault_in_the_middle_of_a_motion_stops_every_axis_short_of_its_target(rig: Rig) -> None:
    # 2 s after the start the lateral axis is still on its way to its first position
    with pytest.raises(DriveFault, match="roll: drive fault 0x2310"):
        rig.run(Fault("roll", "trip", 0x2310, at_s=2.0))
    assert_stopped(rig)
    first = rig.plan.visits[0].setpoints[0]
    there = rig.hardware.joint_values()[0]
    assert abs(there) > 0.05  # it had left home
    assert abs(there - first) > 0.05  # and never arrived


@pytest.mark.parametrize("shot", [15, 17])  # three a visit: the first and the last one of visit 5
def test_an_axis_that_loses_its_power_while_the_tracker_measures_spoils_the_visit(
    rig: Rig, shot: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure, shots = GeoComTracker.measure, itertools.count()

    def lose_power_meanwhile(tracker: GeoComTracker, target: str, expected: NDArray[np.float64]) -> Shot:
        if next(shots) == shot:
            rig.hardware.drive("vertical").lose_power()
        return measure(tracker, target, expected)

    monkeypatch.setattr(GeoComTracker, "measure", lose_power_meanwhile)
    with pytest.raises(DriveFault, match="vertical: is SWITCH ON DISABLED"):
        rig.run()
    assert_stopped(rig)
    with RecordingFile.open(rig.out) as file:
        assert file.done() == {0, 1, 2, 3, 4}
    result = rig.run()
    assert (result.measured, result.done) == (7, 12)


def assert_stopped(rig: Rig) -> None:
    """No drive is enabled; braking from 0.1 m/s at 0.5 m/s² takes 0.2 s, and then nothing moves any more."""
    rig.clock.sleep(0.3)
    before = rig.hardware.joint_values()
    rig.clock.sleep(60.0)
    np.testing.assert_array_equal(rig.hardware.joint_values(), before)
    for drive in rig.hardware.rack.drives.values():
        assert not drive.online or drive.power is not Power.OPERATION_ENABLED
