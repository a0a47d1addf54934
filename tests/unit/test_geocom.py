"""The tracker driver against a simulated total station that speaks GeoCOM over an in-process line."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import geocompy.geo
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.geocom import GeoComTracker
from drivers.ports import Atmosphere
from ppshw.errors import (
    BeamLost,
    ConfigurationMismatch,
    HardwareError,
    HardwareTimeout,
    IdentityMismatch,
    InstrumentFault,
    LineLost,
    ProtocolError,
)
from simulators.clock import SteppedClock
from simulators.serial_line import LoopbackPort
from simulators.tracker import SimulatedTracker, air_index, crc_arc

Array = NDArray[np.float64]
ROOM = Atmosphere(20.0, 1013.25, 50.0)


@dataclasses.dataclass
class Room:
    """Three reflectors some metres from the tracker, and the air between."""

    targets: dict[str, Array] = dataclasses.field(
        default_factory=lambda: {
            "P1": np.array([1.0, 4.0, 0.5]),
            "P2": np.array([0.6, 4.0, 0.5]),
            "P3": np.array([-0.2, 5.7, -1.6]),
        }
    )
    air: tuple[float, float, float] = (20.0, 1013.25, 50.0)

    def visible_targets(self) -> dict[str, Array]:
        return self.targets


@pytest.fixture(autouse=True)
def _no_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    """geocompy waits 1 s after its first exchange; nothing here needs that."""
    monkeypatch.setattr(geocompy.geo, "sleep", lambda seconds: None)


@pytest.fixture
def room() -> Room:
    return Room()


@pytest.fixture
def station(room: Room) -> SimulatedTracker:
    return SimulatedTracker(room, SteppedClock(), position_sigma=0.0, air=lambda: room.air)


@pytest.fixture
def tracker(station: SimulatedTracker) -> GeoComTracker:
    tracker = GeoComTracker(LoopbackPort(station), SteppedClock(), timeout_s=0.1)
    tracker.start()
    tracker.set_atmosphere(ROOM)
    return tracker


# --- what a shot says


@pytest.mark.parametrize(
    "xyz", [(0.3, 6.0, 0.1), (-4.0, -3.0, 2.0), (5.0, -1.0, -3.0), (-1e-3, 1.2, 0.4), (0.02, -0.01, 2.0)]
)
def test_a_reflector_is_found_where_it_is_to_a_few_micrometres(
    tracker: GeoComTracker, room: Room, xyz: tuple[float, float, float]
) -> None:
    """The wire must not round: what is left at 6 m is the disagreement of two formulas for air, below 0.3 ppm."""
    room.targets = {"P1": np.array(xyz)}
    shot = tracker.measure("P1", np.array(xyz) + np.array([0.004, -0.003, 0.002]))
    assert np.linalg.norm(shot.xyz - xyz) < 2e-6


@pytest.mark.parametrize(
    ("xyz", "hz_deg", "v_deg"),
    [((0, 3, 0), 0, 90), ((3, 0, 0), 90, 90), ((0, -3, 0), 180, 90), ((-3, 0, 0), 270, 90), ((2, 2, 8**0.5), 45, 45)],
)
def test_hz_turns_clockwise_from_y_and_v_comes_down_from_z(
    tracker: GeoComTracker, room: Room, xyz: tuple[float, float, float], hz_deg: float, v_deg: float
) -> None:
    room.targets = {"P1": np.array(xyz, dtype=float)}
    raw = tracker.measure("P1", np.array(xyz, dtype=float)).raw
    assert math.degrees(raw["hz_rad"]) == pytest.approx(hz_deg, abs=1e-9)
    assert math.degrees(raw["v_rad"]) == pytest.approx(v_deg, abs=1e-9)


def test_raw_keeps_the_distance_as_shown_and_ppm_says_what_was_added(tracker: GeoComTracker, room: Room) -> None:
    room.targets = {"P1": np.array([0.0, 6.0, 0.0])}
    shot = tracker.measure("P1", room.targets["P1"])
    assert shot.xyz[1] == pytest.approx(shot.raw["slope_m"] * (1 + shot.ppm * 1e-6), abs=1e-12)
    # Leica's formula for its 658 nm laser, by hand: 286.338 − 0.29535·1013.25/(1 + 20/273.15) + 0.45 for the vapour
    assert shot.ppm == pytest.approx(7.9, abs=0.5)
    assert shot.atmosphere == ROOM


@pytest.mark.parametrize("air", [(32.0, 935.0, 80.0), (8.0, 1038.0, 20.0)])
def test_other_air_does_not_move_the_point_when_the_host_is_told(
    tracker: GeoComTracker, room: Room, air: tuple[float, float, float]
) -> None:
    room.air = air
    tracker.set_atmosphere(Atmosphere(*air))
    shot = tracker.measure("P3", room.targets["P3"])
    assert np.linalg.norm(shot.xyz - room.targets["P3"]) < 3e-6


def test_ten_degrees_nobody_told_cost_ten_ppm(tracker: GeoComTracker, room: Room) -> None:
    """The surveyor's rule: 1 ppm for 1 °C."""
    room.targets = {"P1": np.array([0.0, 6.0, 0.0])}
    room.air = (30.0, 1013.25, 50.0)
    shot = tracker.measure("P1", room.targets["P1"])
    assert 1e6 * (shot.xyz[1] / 6.0 - 1) == pytest.approx(-9.5, abs=1.0)


def test_noise_is_20_micrometres_in_every_direction(room: Room) -> None:
    station = SimulatedTracker(room, SteppedClock(), seed=3, position_sigma=2e-5)
    tracker = GeoComTracker(LoopbackPort(station), SteppedClock())
    tracker.start()
    tracker.set_atmosphere(ROOM)
    p3 = room.targets["P3"]
    off = np.array([tracker.measure("P3", p3).xyz - p3 for _ in range(400)])
    assert off.std(axis=0) == pytest.approx(np.full(3, 2e-5), rel=0.15)
    assert np.abs(off.mean(axis=0)).max() < 4e-6


def test_the_age_of_the_atmosphere_goes_with_the_shot(station: SimulatedTracker, room: Room) -> None:
    clock = SteppedClock()
    tracker = GeoComTracker(LoopbackPort(station), clock)
    tracker.start()
    tracker.set_atmosphere(ROOM)
    clock.sleep(90)
    assert tracker.measure("P1", room.targets["P1"]).extra["atmosphere_age_s"] == "90.0"


# --- finding the target


def test_a_beam_that_is_interrupted_is_lost(tracker: GeoComTracker, station: SimulatedTracker, room: Room) -> None:
    station.lose_beam("P1")
    room.targets.pop("P2")  # or the neighbour would be found
    with pytest.raises(BeamLost, match=r"tracker: no target found at P1 .*8710 AUT_NO_TARGET"):
        tracker.measure("P1", room.targets["P1"])
    station.find_beam()
    assert tracker.measure("P1", room.targets["P1"]).target == "P1"


def test_a_beam_interrupted_after_locking_is_lost_too(
    tracker: GeoComTracker, station: SimulatedTracker, room: Room
) -> None:
    original = station._rpcs[17017]

    def somebody_walks_in(p: list[str]) -> tuple[int, list[str]]:
        station.lose_beam()
        return original(p)

    station._rpcs[17017] = somebody_walks_in
    with pytest.raises(BeamLost, match=r"no target found at P1 .*1292 TMC_DIST_ERROR"):
        tracker.measure("P1", room.targets["P1"])


def test_pointing_5_degrees_off_finds_nothing(tracker: GeoComTracker, room: Room) -> None:
    room.targets = {"P1": np.array([0.0, 4.0, 0.0])}
    with pytest.raises(BeamLost, match="no target found at P1"):
        tracker.measure("P1", np.array([0.35, 4.0, 0.0]))


def test_the_neighbour_in_view_is_not_taken_for_the_target(
    tracker: GeoComTracker, station: SimulatedTracker, room: Room
) -> None:
    p1 = room.targets["P1"]
    room.targets["P2"] = p1 * 0.95  # in the same line of sight, 207 mm nearer
    station.lose_beam("P1")
    with pytest.raises(InstrumentFault, match=r"something 207\.. mm from where P1 is expected .*gate 50 mm"):
        tracker.measure("P1", p1)


def test_the_nearer_of_two_reflectors_in_view_is_locked(tracker: GeoComTracker, room: Room) -> None:
    room.targets["P2"] = room.targets["P1"] + [0.06, 0.0, 0.0]
    for name in ("P1", "P2"):
        shot = tracker.measure(name, room.targets[name] + [0.002, 0.0, 0.002])
        assert np.linalg.norm(shot.xyz - room.targets[name]) < 2e-6


# --- the instrument


def test_check_says_who_it_is_and_moves_nothing(station: SimulatedTracker) -> None:
    info = GeoComTracker(LoopbackPort(station), SteppedClock()).check()
    assert (info.model, info.serial, info.firmware) == ("Simulated TS", "886001", "8.10.0")
    assert station.shots == 0


def test_another_instrument_is_refused(station: SimulatedTracker) -> None:
    tracker = GeoComTracker(LoopbackPort(station), SteppedClock(), serial_number=886002)
    with pytest.raises(IdentityMismatch, match="number 886001 on loopback, the site file says 886002"):
        tracker.start()


def test_an_instrument_left_with_its_own_correction_does_not_correct_twice(
    station: SimulatedTracker, tracker: GeoComTracker, room: Room
) -> None:
    station.ppm = 25.0
    tracker.start()
    assert np.linalg.norm(tracker.measure("P3", room.targets["P3"]).xyz - room.targets["P3"]) < 2e-6


def test_a_correction_that_cannot_be_switched_off_stops_the_start(station: SimulatedTracker) -> None:
    station.ppm, station.hold_ppm = 25.0, True
    with pytest.raises(ConfigurationMismatch, match="tracker: corrects distances by 25 ppm itself"):
        GeoComTracker(LoopbackPort(station), SteppedClock()).start()


def test_a_correction_dialled_in_on_the_panel_is_noticed_with_the_next_air(
    tracker: GeoComTracker, station: SimulatedTracker
) -> None:
    station.ppm = 3.0
    with pytest.raises(ConfigurationMismatch, match="3 ppm"):
        tracker.set_atmosphere(ROOM)


def test_an_instrument_set_to_three_decimals_is_set_to_fifteen(station: SimulatedTracker, room: Room) -> None:
    station.precision = 3  # replies would be rounded to 1 mm and 1 mrad
    tracker = GeoComTracker(LoopbackPort(station), SteppedClock())
    tracker.start()
    tracker.set_atmosphere(ROOM)
    assert np.linalg.norm(tracker.measure("P3", room.targets["P3"]).xyz - room.targets["P3"]) < 2e-6


def test_what_the_instrument_refuses_is_said_with_its_code(
    tracker: GeoComTracker, station: SimulatedTracker, room: Room
) -> None:
    station._atr = False  # somebody switched it off on the panel
    with pytest.raises(InstrumentFault, match="AUT_FineAdjust at P1: code 8714 AUT_NOT_ENABLED"):
        tracker.measure("P1", room.targets["P1"])


@pytest.mark.parametrize(
    ("rpc", "answer", "said"),
    [
        (17009, ["1"], "prism: set to ROUND, reads MINI"),
        (2126, ["0.0", "0.0175"], r"its prism constant is 17\.50 mm now, 0\.00 mm at the start"),
        (2126, ["3.5", "0.0"], r"corrects distances by 3\.5 ppm itself"),
        (18006, ["0"], "target recognition: set to True, reads False"),
        (108, ["4"], "decimals: set to 15, reads 4"),
    ],
)
def test_what_somebody_sets_otherwise_at_the_panel_is_noticed_before_the_next_shot(
    tracker: GeoComTracker, station: SimulatedTracker, rpc: int, answer: list[str], said: str
) -> None:
    tracker.set_atmosphere(ROOM)
    station._rpcs[rpc] = lambda p: (0, answer)
    with pytest.raises(ConfigurationMismatch, match=f"tracker: {said}"):
        tracker.set_atmosphere(ROOM)


def test_a_prism_nobody_makes_is_refused_with_those_there_are() -> None:
    with pytest.raises(ValueError, match="no prism 'SQUARE'; there are ROUND, MINI, TAPE"):
        GeoComTracker("/dev/null", SteppedClock(), prism="SQUARE")


def test_without_air_there_is_no_measurement(station: SimulatedTracker, room: Room) -> None:
    tracker = GeoComTracker(LoopbackPort(station), SteppedClock())
    tracker.start()
    with pytest.raises(InstrumentFault, match="no atmosphere has been set"):
        tracker.measure("P1", room.targets["P1"])
    with pytest.raises(InstrumentFault, match="temperature nan"):
        tracker.set_atmosphere(Atmosphere(math.nan, 1013.0, 50.0))


# --- the line


def wrong_transaction(station: SimulatedTracker) -> None:
    station.wrong_transaction()


def garbage(station: SimulatedTracker) -> None:
    station.garble(12)


def garbage_that_ends_a_line(station: SimulatedTracker) -> None:
    station._say(b"\xaa%R1P\r\n")
    station.garble(3)


def silence(station: SimulatedTracker) -> None:
    station.go_silent()


@pytest.mark.parametrize(
    ("trouble", "error", "said"),
    [
        (wrong_transaction, ProtocolError, "COM_TR_ID_MISMATCH"),
        (garbage, ProtocolError, "tracker: .*AUT_MakePositioning"),
        (garbage_that_ends_a_line, ProtocolError, "tracker: .*AUT_MakePositioning"),
        (silence, HardwareTimeout, "no answer to AUT_MakePositioning within 0.1 s on loopback"),
    ],
)
def test_trouble_on_the_line_is_told_once_and_then_over(
    tracker: GeoComTracker,
    station: SimulatedTracker,
    room: Room,
    trouble: Callable[[SimulatedTracker], None],
    error: type[HardwareError],
    said: str,
) -> None:
    trouble(station)
    with pytest.raises(error, match=said):
        tracker.measure("P1", room.targets["P1"])
    station.speak()
    shot = tracker.measure("P1", room.targets["P1"])
    assert np.linalg.norm(shot.xyz - room.targets["P1"]) < 2e-6


def test_an_answer_that_comes_too_late_is_not_taken_for_the_next_one(
    tracker: GeoComTracker, station: SimulatedTracker, room: Room
) -> None:
    station.hold_reply()
    with pytest.raises(HardwareTimeout, match="no answer to AUT_MakePositioning"):
        tracker.measure("P1", room.targets["P1"])
    station.release_reply()
    assert np.linalg.norm(tracker.measure("P2", room.targets["P2"]).xyz - room.targets["P2"]) < 2e-6


def test_nothing_is_asked_again_behind_the_operators_back(
    tracker: GeoComTracker, station: SimulatedTracker, room: Room
) -> None:
    before = station.shots
    for _ in range(2):
        tracker._tell(lambda geo: geo.com.nullprocess())
    original = station._rpcs[17017]

    def spoil(p: list[str]) -> tuple[int, list[str]]:
        station.wrong_transaction()
        return original(p)

    station._rpcs[17017] = spoil
    with pytest.raises(ProtocolError):
        tracker.measure("P1", room.targets["P1"])
    assert station.shots == before + 1


def test_flipped_bits_never_become_a_position(tracker: GeoComTracker, station: SimulatedTracker, room: Room) -> None:
    """One bit in 500: about every second answer is damaged. The checksum stops each of them."""
    station.bit_errors(1 / 500)
    good, errors = 0, 0
    for _ in range(60):
        try:
            shot = tracker.measure("P1", room.targets["P1"])
        except (ProtocolError, HardwareTimeout):
            errors += 1
        else:
            good += 1
            assert np.linalg.norm(shot.xyz - room.targets["P1"]) < 2e-6
    assert errors > 10
    assert good > 0


def test_a_pulled_plug_names_the_port_and_needs_a_new_start(
    tracker: GeoComTracker, station: SimulatedTracker, room: Room
) -> None:
    station.unplug()
    with pytest.raises(LineLost, match="tracker: lost the port loopback: device disconnected"):
        tracker.measure("P1", room.targets["P1"])
    with pytest.raises(LineLost, match="start the tracker first"):
        tracker.measure("P1", room.targets["P1"])
    with pytest.raises(LineLost, match="tracker: cannot open loopback"):
        tracker.start()
    station.plug()
    tracker.start()
    assert tracker.measure("P1", room.targets["P1"]).target == "P1"


def test_a_port_that_is_not_there_is_named() -> None:
    tracker = GeoComTracker("/dev/tty-nowhere", SteppedClock())
    with pytest.raises(LineLost, match="tracker: cannot open /dev/tty-nowhere"):
        tracker.check()


def test_a_device_that_does_not_speak_geocom_is_told_apart_from_a_silent_one(station: SimulatedTracker) -> None:
    tracker = GeoComTracker(LoopbackPort(station), SteppedClock(), timeout_s=0.05)
    station.go_silent()
    with pytest.raises(HardwareTimeout, match="no answer to the null command"):
        tracker.check()
    station.speak()
    station.garble(10_000)
    with pytest.raises((ProtocolError, HardwareTimeout), match="null command"):
        tracker.check()


# --- the simulator itself


def test_simulated_air_slows_light_as_the_maker_says() -> None:
    # TPS1200 manual: a carrier of 670 nm has the group index 1.0002859 at 12 °C, 1013.25 mbar, 60 %.
    assert air_index(12.0, 1013.25, 60.0, 0.670) == pytest.approx(1.0002859, abs=4e-7)


def test_line_checksum_is_crc_16_arc() -> None:
    assert crc_arc(b"123456789") == 0xBB3D  # check value of the CRC catalogue
