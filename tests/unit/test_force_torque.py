"""Force sensor drivers against simulated sensors over an in-process line, and their parsers against anything."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.bota import BotaParser, BotaSensor
from drivers.gsv8 import Gsv8Sensor, GsvParser
from ppshw.errors import HardwareTimeout, InstrumentFault, LineLost, ProtocolError, SensorOverrange
from simulators.clock import SteppedClock
from simulators.force_torque import SimulatedBota, SimulatedGsv8, crc_x25
from simulators.serial_line import LoopbackPort

Array = NDArray[np.float64]
# A patient of 80 kg whose mass sits 0.4 m off the sensor: N and N·m.
PATIENT = np.array([12.0, -784.5, 3.0, 313.8, 1.5, -20.0])


@dataclass
class Couch:
    load: Array = field(default_factory=PATIENT.copy)

    def wrench(self) -> Array:
        return self.load


@pytest.fixture
def couch() -> Couch:
    return Couch()


@pytest.fixture
def clock() -> SteppedClock:
    return SteppedClock()


@pytest.fixture
def bota_device(couch: Couch, clock: SteppedClock) -> SimulatedBota:
    return SimulatedBota(couch, clock, seed=1)


@pytest.fixture
def bota(bota_device: SimulatedBota, clock: SteppedClock) -> BotaSensor:
    sensor = BotaSensor(LoopbackPort(bota_device), clock, timeout_s=0.1)
    sensor.start()
    return sensor


@pytest.fixture
def gsv_device(couch: Couch, clock: SteppedClock) -> SimulatedGsv8:
    return SimulatedGsv8(couch, clock, seed=1)


@pytest.fixture
def gsv(gsv_device: SimulatedGsv8, clock: SteppedClock) -> Gsv8Sensor:
    sensor = Gsv8Sensor(LoopbackPort(gsv_device), clock, timeout_s=0.1)
    sensor.start()
    return sensor


@pytest.fixture(params=["bota", "gsv"])
def sensor(request: pytest.FixtureRequest) -> BotaSensor | Gsv8Sensor:
    return request.getfixturevalue(request.param)


@pytest.fixture
def device(
    sensor: BotaSensor | Gsv8Sensor, bota_device: SimulatedBota, gsv_device: SimulatedGsv8
) -> SimulatedBota | SimulatedGsv8:
    return bota_device if isinstance(sensor, BotaSensor) else gsv_device


# --- both sensors


def test_a_reading_is_the_median_of_32_frames_and_their_spread(sensor: BotaSensor | Gsv8Sensor) -> None:
    reading = sensor.read()
    # Simulated noise of 0.5 N and 0.2 N·m; the median of 32 scatters by 1.25/√32 = 0.22 of that.
    sigma = np.array([0.5] * 3 + [0.2] * 3)
    assert reading.samples == 32
    assert np.all(np.abs(reading.wrench - PATIENT) < 4 * 0.22 * sigma)
    assert np.all((reading.spread > 0.6 * sigma) & (reading.spread < 1.5 * sigma))


def test_a_change_of_load_shows_in_the_next_reading_and_not_after_it(
    sensor: BotaSensor | Gsv8Sensor, couch: Couch, clock: SteppedClock
) -> None:
    """Frames of the old load pile up while the machine moves; none of them may be read."""
    sensor.read()
    clock.sleep(20.0)
    couch.load = np.array([0.0, -1962.0, 0.0, 0.0, 0.0, 0.0])
    assert sensor.read().wrench[1] == pytest.approx(-1962.0, abs=1.0)


def test_overrange_is_not_a_reading(sensor: BotaSensor | Gsv8Sensor, device: SimulatedBota | SimulatedGsv8) -> None:
    device.overrange()
    with pytest.raises(SensorOverrange, match=r"force sensor: .*over.* in 32 of 32 frames"):
        sensor.read()
    device.recover()
    assert sensor.read().samples == 32


def test_a_silent_sensor_times_out(sensor: BotaSensor | Gsv8Sensor, device: SimulatedBota | SimulatedGsv8) -> None:
    device.go_silent()
    with pytest.raises(HardwareTimeout, match="force sensor: nothing heard on loopback within"):
        sensor.read()
    device.speak()
    assert sensor.read().wrench[1] == pytest.approx(PATIENT[1], abs=1.0)


def test_only_garbage_is_a_protocol_error(
    sensor: BotaSensor | Gsv8Sensor, device: SimulatedBota | SimulatedGsv8
) -> None:
    device.garble(100_000)
    with pytest.raises(ProtocolError, match=r"force sensor: .* bytes"):
        sensor.read()
    device.garble(0)
    assert sensor.read().wrench[1] == pytest.approx(PATIENT[1], abs=1.0)


def test_a_pulled_plug_names_the_port(sensor: BotaSensor | Gsv8Sensor, device: SimulatedBota | SimulatedGsv8) -> None:
    device.unplug()
    with pytest.raises(LineLost, match="force sensor: lost the port loopback"):
        sensor.read()
    device.plug()
    assert sensor.read().samples == 32


def test_a_burst_of_noise_costs_frames_but_not_the_reading(
    sensor: BotaSensor | Gsv8Sensor, device: SimulatedBota | SimulatedGsv8
) -> None:
    sensor.read()
    original, said = device._frame, []

    def with_noise(wrench: Array, seconds: float) -> bytes:
        said.append(seconds)
        return (b"\xaa\x15\x30" if len(said) % 4 == 0 else b"") + original(wrench, seconds)

    device._frame = with_noise  # type: ignore[method-assign]
    assert sensor.read().wrench == pytest.approx(PATIENT, abs=1.0)


def test_a_port_that_is_not_there_is_named(clock: SteppedClock) -> None:
    for kind in (BotaSensor, Gsv8Sensor):
        with pytest.raises(LineLost, match="force sensor: cannot open /dev/tty-nowhere"):
            kind("/dev/tty-nowhere", clock).start()


def test_a_sensor_that_was_not_started_says_so(clock: SteppedClock, bota_device: SimulatedBota) -> None:
    with pytest.raises(LineLost, match="start the sensor first"):
        BotaSensor(LoopbackPort(bota_device), clock).read()


def test_zero_and_matrix_make_newtons(couch: Couch, clock: SteppedClock) -> None:
    """A table of 41 N that is not payload, and a sensor mounted upside down (half a turn about x)."""
    couch.load = np.array([0.0, 200.0, -41.0, 0.0, 0.0, 7.0])
    turned = np.diag([1.0, -1, -1, 1, -1, -1]).tolist()
    for kind, device in ((BotaSensor, SimulatedBota), (Gsv8Sensor, SimulatedGsv8)):
        quiet = device(couch, clock, force_sigma=0.0, moment_sigma=0.0)
        sensor = kind(LoopbackPort(quiet), clock, zero=[0, 0, 41.0, 0, 0, 0], matrix=turned)
        sensor.start()
        assert sensor.read().wrench == pytest.approx([0, -200, 0, 0, 0, -7], abs=1e-4)


def test_what_no_payload_weighs_is_a_fault(couch: Couch, clock: SteppedClock) -> None:
    for kind, device in ((BotaSensor, SimulatedBota), (Gsv8Sensor, SimulatedGsv8)):
        couch.load = np.array([0.0, 0.0, -600.0, 0.0, 0.0, 0.0])
        sensor = kind(LoopbackPort(device(couch, clock)), clock, matrix=(1e4 * np.eye(6)).tolist())
        sensor.start()
        with pytest.raises(InstrumentFault, match=r"reads 6.*e\+06 N or N m, expected at most 1e\+06"):
            sensor.read()


def test_a_matrix_of_the_wrong_shape_is_refused(clock: SteppedClock) -> None:
    with pytest.raises(ValueError, match=r"matrix \(6, 6\)"):
        BotaSensor("/dev/null", clock, matrix=[[1, 0], [0, 1]])


# --- Bota-style


def test_bota_tells_its_temperature(bota: BotaSensor, bota_device: SimulatedBota) -> None:
    bota_device.temperature_c = 36.5
    assert bota.read().temperature_c == pytest.approx(36.5)
    assert "36.5 °C" in bota.check().status


def test_bota_frames_marked_invalid_or_raw_are_a_fault(bota: BotaSensor, bota_device: SimulatedBota) -> None:
    bota_device.invalid()
    with pytest.raises(InstrumentFault, match="32 of 32 frames are marked invalid"):
        bota.read()
    bota_device.recover()
    bota_device.raw()
    with pytest.raises(InstrumentFault, match="its calibration is off"):
        bota.read()


def test_a_bota_that_hangs_is_a_fault_and_no_load(bota: BotaSensor, bota_device: SimulatedBota) -> None:
    bota_device.hang()
    with pytest.raises(InstrumentFault, match=r"force sensor: time stamp \d+ µs after \d+ µs: it repeats a frame"):
        bota.read()
    with pytest.raises(InstrumentFault, match="it repeats a frame"):
        bota.check()
    bota_device.recover()
    assert bota.read().samples == 32


def test_a_time_stamp_that_begins_anew_after_71_minutes_is_no_fault(
    bota: BotaSensor, clock: SteppedClock, couch: Couch
) -> None:
    clock.sleep(2**32 / 1e6 - clock.now() - 0.1)
    for _ in range(20):
        assert bota.read().wrench == pytest.approx(PATIENT, abs=1.0)
        clock.sleep(0.01)


def test_a_bota_that_refuses_its_configuration_says_which_command(
    bota_device: SimulatedBota, clock: SteppedClock
) -> None:
    bota_device.refuse = "f"
    with pytest.raises(InstrumentFault, match="refuses 'f,512,0,0,1' with code 1"):
        BotaSensor(LoopbackPort(bota_device), clock).start()


def test_a_silent_bota_does_not_start(bota_device: SimulatedBota, clock: SteppedClock) -> None:
    bota_device.go_silent()
    with pytest.raises(HardwareTimeout, match="force sensor: no answer to 'C' within"):
        BotaSensor(LoopbackPort(bota_device), clock, timeout_s=0.05).start()


def test_the_filter_length_sets_the_frame_rate(couch: Couch, clock: SteppedClock) -> None:
    device = SimulatedBota(couch, clock)
    port = LoopbackPort(device)
    BotaSensor(port, clock, sinc_length=128).start()
    port.reset_input_buffer()
    clock.sleep(0.1)
    assert len(BotaParser().feed(port.read(port.in_waiting))) == 40  # 51200/128 = 400 a second


def test_bota_checksum_is_crc_16_x_25() -> None:
    assert crc_x25(b"123456789") == 0x906E  # check value of the CRC catalogue


def test_a_bota_frame_written_by_hand_is_read() -> None:
    """Little-endian: status 0, Fx = 1.0 (3F800000), Fy … Mz = 0, time stamp 258, 25.0 °C (41C80000)."""
    body = bytes.fromhex("00000000803f" + 5 * "00000000" + "020100000000c841")
    frame = BotaParser().feed(b"\xaa" + body + struct.pack("<H", crc_x25(body)))[0]
    assert frame.wrench == (1.0, 0, 0, 0, 0, 0)
    assert (frame.status, frame.timestamp, frame.temperature_c) == (0, 258, 25.0)


def bota_bytes(wrench: Array) -> bytes:
    body = struct.pack("<H6fIf", 0, *wrench, 0, 25.0)
    return b"\xaa" + body + struct.pack("<H", crc_x25(body))


noise = st.one_of(st.binary(max_size=80), st.lists(st.just(0xAA), max_size=40).map(bytes))


@settings(max_examples=200, deadline=None, derandomize=True)
@given(gaps=st.lists(noise, min_size=1, max_size=8), cut=st.integers(1, 60))
def test_whatever_comes_between_bota_frames_every_frame_is_found_and_no_other(gaps: list[bytes], cut: int) -> None:
    wanted = [tuple(np.float32([k, -k, 0.5 * k, 7, 8, 9]).tolist()) for k in range(1, len(gaps) + 1)]
    stream = b"".join(gap + bota_bytes(np.array(w)) for gap, w in zip(gaps, wanted, strict=True))
    parser = BotaParser()
    # The closing zeros let the parser give up on a false beginning just before the last frame.
    pieces = [stream[i : i + cut] for i in range(0, len(stream), cut)] + [bytes(40)]
    found = [frame.wrench for piece in pieces for frame in parser.feed(piece)]
    assert found == wanted
    assert parser.dropped == sum(map(len, gaps)) + 40 - len(parser._buffer)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.integers(0, 10 * 37 * 8 - 1)), min_size=1, max_size=6))
def test_flipped_bits_cost_bota_frames_but_never_make_a_wrong_one(flips: list[tuple[int]]) -> None:
    truth = np.float32([11, -22, 33, -44, 55, -66])
    stream = bytearray(bota_bytes(truth) * 10)
    for (bit,) in flips:
        stream[bit // 8] ^= 1 << bit % 8
    found = BotaParser().feed(bytes(stream) + bytes(37))
    assert len(found) >= 10 - len(flips)
    assert all(frame.wrench == tuple(truth.tolist()) for frame in found)


# --- GSV-8


def test_gsv8_says_who_it_is(gsv: Gsv8Sensor) -> None:
    info = gsv.check()
    assert (info.model, info.serial, info.firmware) == ("GSV-8", "17330042", "1.42")


def test_a_gsv8_frame_written_by_hand_is_read() -> None:
    """Big-endian, status 30 (float32): 1.0, −2.0, 0, 0, 0, 100.0."""
    frame = GsvParser().feed(bytes.fromhex("aa15303f800000c0000000" + 3 * "00000000" + "42c8000085"))[0]
    assert frame.values == (1.0, -2.0, 0.0, 0.0, 0.0, 100.0)


def test_gsv8_streams_only_while_it_is_read(gsv: Gsv8Sensor, gsv_device: SimulatedGsv8) -> None:
    gsv.read()
    assert not gsv_device.streaming


def test_a_gsv8_that_was_left_streaming_is_read_all_the_same(
    gsv: Gsv8Sensor, gsv_device: SimulatedGsv8, couch: Couch, clock: SteppedClock
) -> None:
    gsv_device._start_stream()
    clock.sleep(5.0)
    couch.load = np.array([0.0, -1000.0, 0, 0, 0, 0])
    assert gsv.read().wrench[1] == pytest.approx(-1000.0, abs=1.0)


def test_a_six_axis_error_is_overrange(gsv: Gsv8Sensor, gsv_device: SimulatedGsv8) -> None:
    gsv_device.six_axis_error()
    with pytest.raises(SensorOverrange, match="six-axis limit exceeded in 32 of 32 frames"):
        gsv.read()


def test_a_gsv8_that_refuses_a_command_says_so(gsv: Gsv8Sensor, gsv_device: SimulatedGsv8) -> None:
    gsv_device.refuse.add(0x24)
    with pytest.raises(InstrumentFault, match="refuses command 0x24 with code 0x40"):
        gsv.read()


def test_a_gsv8_that_goes_on_answering_and_says_no_values_is_not_waited_for_for_ever(
    gsv: Gsv8Sensor, gsv_device: SimulatedGsv8
) -> None:
    gsv_device._frame = lambda wrench, time: bytes([0xAA, 0x50, 0x00, 0x85])  # type: ignore[method-assign]
    with pytest.raises(ProtocolError, match="answers, but only 0 of 32 values"):
        gsv.read()


def spoil_gsv(device: SimulatedGsv8, every: int, wrench: Array) -> None:
    """Every so many frames carries another wrench, as after a flipped bit: nothing in the frame tells."""
    original, count = device._frame, iter(range(10_000))
    device._frame = lambda w, t: original(wrench if next(count) % every == 0 else w, t)  # type: ignore[method-assign]


@pytest.mark.parametrize("wrong", [3.0e4, 900.0, float("nan"), float("inf")])
def test_a_wrong_frame_among_eight_is_left_out(gsv: Gsv8Sensor, gsv_device: SimulatedGsv8, wrong: float) -> None:
    spoil_gsv(gsv_device, 8, np.array([wrong, *PATIENT[1:]]))
    reading = gsv.read()
    assert reading.samples == 28
    assert reading.wrench == pytest.approx(PATIENT, abs=0.5)
    assert reading.spread[0] < 1.0  # 315 N if the outliers of 900 N were in it


def test_when_most_frames_are_beyond_the_range_there_is_no_reading(
    gsv: Gsv8Sensor, gsv_device: SimulatedGsv8, couch: Couch
) -> None:
    couch.load = np.array([0, 0, 5e4, 0, 0, 0.0])
    with pytest.raises(ProtocolError, match="only 0 of 32 frames are plausible"):
        gsv.read()


def test_one_flag_in_32_is_a_flipped_bit_not_an_overload(gsv: Gsv8Sensor, gsv_device: SimulatedGsv8) -> None:
    original, count = gsv_device._frame, iter(range(1000))

    def once(wrench: Array, seconds: float) -> bytes:
        frame = bytearray(original(wrench, seconds))
        frame[2] |= next(count) == 5
        return bytes(frame)

    gsv_device._frame = once  # type: ignore[method-assign]
    assert gsv.read().wrench == pytest.approx(PATIENT, abs=0.5)


def test_one_flipped_bit_in_ten_thousand_moves_no_reading(gsv: Gsv8Sensor, gsv_device: SimulatedGsv8) -> None:
    gsv_device.bit_errors(1e-4)
    read = 0
    for _ in range(40):
        try:
            reading = gsv.read()
        except (ProtocolError, HardwareTimeout, InstrumentFault):
            continue
        read += 1
        assert reading.wrench == pytest.approx(PATIENT, abs=0.6)
    assert read > 30
