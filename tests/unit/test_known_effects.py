"""What a diagnosis found, in the setpoints: taken out where it can be known beforehand, said where it cannot.

The effects are written down by hand, the machine that has them is the plant, which shares no code with the model.
"""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from numpy.typing import NDArray

from ppshw.calibration import Calibration, load_calibration
from ppshw.cli import main
from ppshw.compensation import Circumstances, Compensator, Corrections, Setpoints
from ppshw.compensation import compensator as compensator_module
from ppshw.compensation.known_effects import KnownEffects
from ppshw.compensation.past import Moment, Past
from ppshw.errors import CalibrationError, CompensationRefused
from ppshw.evaluation import evaluate
from ppshw.identification import identify
from ppshw.machine import load_machine
from ppshw.recording import Around, Recording, load_recording
from ppshw.terms import Situation
from ppshw.terms.effect import Effect, instrument_error
from ppshw.terms.history import hours_since_change
from ppshw.terms.shapes import Column, Context
from ppshw.terms.shapes.context import ALONG
from ppshw.terms.shapes.covariates import loads_came
from ppshw.terms.shapes.creep import OLDEST_LOAD_H
from simulators.offline import simulate_recording_csv
from simulators.plant import Load, Plant

Array = NDArray[np.float64]
PPS = Path(__file__).parents[2] / "machines/pps.yaml"
POSE = np.array([0.1, -0.05, 0.5, 0.3, 0.01, -0.01])
UP = np.array([0, 0.1, 0, 0, 0, 0])
BELOW, ABOVE = POSE - UP, POSE + UP
LOAD = Load(100.0, np.array([0.05, 0.1, 0.3]))
VERTICAL, TY = 1, 1
GAP = 3e-4
HOURS = 8.0
BEYOND = "rail is beyond the 19.0 to 25.0 °C at which it was measured; carried on as it was"


@cache
def base() -> tuple[Plant, Calibration]:
    """A machine that always arrives at the same place, measured without noise."""
    plant, machine = Plant.from_file(PPS, seed=11, repeatability=0.0), load_machine(PPS)
    with TemporaryDirectory() as folder:
        csv = simulate_recording_csv(
            plant, Path(folder) / "r.csv", 260, np.random.default_rng(1), "mixed", visits_per_load=5,
            measurement_noise=False,
        )  # fmt: skip
        recording = load_recording(csv, machine)
    return plant, Calibration.of(identify(machine, recording), recording, "joint")


def knowing(name: str, joint: str | None, column: Column, value: float) -> Compensator:
    effect = Effect(name, joint, (column,), (value,), (0.05 * abs(value),), "by hand")
    reference = {"start": 1.7e9, "hours": HOURS, "mean.rail": 22.0}
    return Compensator(replace(base()[1], effects=(effect,), reference=reference))


def lost_motion() -> Compensator:
    """vertical stays behind by half the gap on the side that it comes from."""
    column = Column("frame", "approach", {"joint": VERTICAL}, VERTICAL + 1, TY)
    return knowing("backlash", "vertical", column, -GAP / 2)


def miss(setpoints: Array, eps: float = 0.0, joint: int = VERTICAL, component: int = TY) -> Array:
    """How far the plant's treatment point is from the ideal one's at POSE, the joint displaced by eps [m]."""
    plant, _ = base()
    wrong = np.zeros((1, 6, 6))
    wrong[0, joint, component] = eps
    real = plant.true_points(setpoints, LOAD, wrong, ["treatment"])["treatment"][0]
    return np.asarray(real - plant.nominal_points(POSE, ["treatment"])["treatment"][0])


def payload() -> Array:
    return base()[0].wrench(POSE, LOAD)[0]


def asked(compensator: Compensator, **known: object) -> Setpoints:
    return compensator.for_joints(POSE, payload(), "treatment", Circumstances(**known))  # type: ignore[arg-type]


# --- what can be known ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("start", "side"), [(BELOW, 1), (ABOVE, -1)])
def test_lost_motion_is_taken_out_by_the_direction_of_approach(start: Array, side: int) -> None:
    found = asked(lost_motion(), start=start)
    assert found.approach[VERTICAL] == side
    assert np.linalg.norm(miss(found.corrected, -side * GAP / 2)) < 5e-5
    plain = asked(Compensator(base()[1]), start=start)
    assert np.linalg.norm(miss(plain.corrected, -side * GAP / 2)) > 1e-4
    assert [(v.taken_out, v.sentence()) for v in found.effects] == [(True, "backlash of vertical")]


@pytest.mark.parametrize(("since", "lost"), [(0.6, 3.0), (1.4, 1.0)])
def test_a_gap_that_came_loose_while_it_was_measured_is_taken_out_as_it_was_at_the_end(
    since: float, lost: float
) -> None:
    wide, plain = 3.0, lost_motion().calibration
    (effect,) = plain.effects
    looser = replace(effect.columns[0], args={**effect.columns[0].args, "since": since * HOURS})
    values = (effect.values[0], effect.values[0] * (wide - 1.0))
    effect = replace(effect, columns=(effect.columns[0], looser), values=values, std=(1e-6, 1e-6))
    found = asked(Compensator(replace(plain, effects=(effect,))), start=BELOW)
    assert np.linalg.norm(miss(found.corrected, -lost * GAP / 2)) < 5e-5
    assert [(v.taken_out, v.sentence()) for v in found.effects] == [(True, "backlash of vertical")]


def test_the_direction_may_be_given_without_the_start() -> None:
    both = [asked(lost_motion(), approach=np.array([0, s, 0, 0, 0, 0])) for s in (-1, 1)]
    assert both[1].corrected[VERTICAL] - both[0].corrected[VERTICAL] == pytest.approx(GAP, rel=1e-3)
    # the error that the plant would have without correction is predicted with the gap in it
    change = both[1].predicted_error - both[0].predicted_error
    np.testing.assert_allclose(change, [0, -GAP, 0], atol=0.02 * GAP)
    assert np.linalg.norm(both[0].std) > np.linalg.norm(asked(Compensator(base()[1])).std)


@pytest.mark.parametrize(("name", "function", "args"), [
    ("backlash", "approach", {"joint": VERTICAL}), ("zero_shift", "clock", {"form": "linear", "tau": 1.0}),
])  # fmt: skip
def test_what_a_joint_does_along_its_own_axis_is_taken_out_along_it(
    name: str, function: str, args: dict[str, object]
) -> None:
    """As where an axis is none of its frame's; this one is both."""
    by_frame, by_axis = (
        asked(knowing(name, "vertical", Column("frame", function, args, VERTICAL + 1, component), 1e-4), start=BELOW)
        for component in (TY, ALONG)
    )
    np.testing.assert_allclose(by_axis.corrected, by_frame.corrected, atol=1e-12)
    np.testing.assert_allclose(by_axis.std, by_frame.std, rtol=1e-9)
    plain = asked(Compensator(base()[1]), start=BELOW)
    assert by_axis.std[1] > 1.001 * plain.std[1]


@pytest.mark.parametrize(("name", "function", "args"), [
    ("backlash", "approach", {"joint": VERTICAL}), ("drift", "clock", {"form": "linear", "tau": 1.0}),
])  # fmt: skip
def test_along_an_oblique_axis_is_along_both_of_its_frame_s(name: str, function: str, args: dict[str, object]) -> None:
    calibration, axis = base()[1], np.array([0.0, 0.6, 0.8])
    joints = list(calibration.machine.joints)
    joints[VERTICAL] = replace(joints[VERTICAL], axis=axis)
    model = replace(calibration.model, machine=replace(calibration.machine, joints=tuple(joints)))
    found = []
    for parts in ({ALONG: 1e-4}, {1: 0.6e-4, 2: 0.8e-4}):
        columns = tuple(Column("frame", function, args, VERTICAL + 1, component) for component in parts)
        effect = Effect(name, "vertical", columns, tuple(parts.values()), (0.0,) * len(parts), "by hand")
        reference = {"start": 1.7e9, "hours": HOURS}
        known = Compensator(replace(calibration, model=model, effects=(effect,), reference=reference))
        found.append(asked(known, start=BELOW))
    np.testing.assert_allclose(found[0].corrected, found[1].corrected, atol=1e-12)
    np.testing.assert_allclose(found[0].std, found[1].std, rtol=1e-9)
    plain = asked(Compensator(replace(calibration, model=model)), start=BELOW)
    assert np.abs(found[0].corrected - plain.corrected).max() > 1e-5


@pytest.mark.parametrize("lateral", [-0.05, 0.05])
def test_a_joint_that_runs_ahead_is_left_where_it_stands_rather_than_sent_past_its_gap(lateral: float) -> None:
    """Either side's setpoint of a joint that is to stay where it is asks for the other side; it was sent a whole gap
    the wrong way, and nothing said so."""
    plant, _ = base()
    column = Column("frame", "approach", {"joint": VERTICAL}, VERTICAL + 1, TY)
    compensator = knowing("backlash", "vertical", column, GAP / 2)
    stands = asked(compensator, start=BELOW)
    assert stands.at_odds == ()
    wanted = POSE + np.array([lateral, 0, 0, 0, 0, 0])
    given = Circumstances(start=stands.corrected, before=stands.approach)
    found = compensator.for_joints(wanted, payload(), "treatment", given)
    moved = found.corrected[VERTICAL] - stands.corrected[VERTICAL]
    assert abs(moved) < 5e-5
    wrong = np.zeros((1, 6, 6))
    wrong[0, VERTICAL, TY] = (1 if moved >= 0 else -1) * GAP / 2
    real = plant.true_points(found.corrected, LOAD, wrong, ["treatment"])["treatment"][0]
    off = np.linalg.norm(real - plant.nominal_points(wanted, ["treatment"])["treatment"][0])
    assert off < 7e-5
    assert np.linalg.norm(found.left[:3]) < 5e-5
    assert found.at_odds == (("vertical",) if moved == 0 else ())


def test_where_the_direction_is_unknown_the_middle_is_taken_and_said() -> None:
    found = asked(lost_motion())
    np.testing.assert_allclose(found.corrected, asked(Compensator(base()[1])).corrected, atol=1e-9)
    assert found.effects[0].taken_out is False
    assert "from which side the joint comes is not known" in found.effects[0].why


@pytest.mark.parametrize("function", [("slipping", "width"), ("winding", "way")])
def test_the_middle_is_taken_also_of_lost_motion_that_is_taken_up_over_less_than_a_correction(
    function: tuple[str, str],
) -> None:
    """The correction of millimetres was walked as if the joint had gone that way: a side was taken, as if known."""
    column = Column("frame", function[0], {"joint": VERTICAL, function[1]: 1e-4}, VERTICAL + 1, TY)
    compensator = knowing("backlash", "vertical", column, -GAP / 2)
    found = asked(compensator)
    assert abs(found.corrected - POSE)[VERTICAL] > 5e-4
    sides = [asked(compensator, approach=np.array([0, s, 0, 0, 0, 0])).corrected for s in (-1, 1)]
    assert sides[1][VERTICAL] - sides[0][VERTICAL] == pytest.approx(GAP, rel=1e-2)
    np.testing.assert_allclose(found.corrected, np.mean(sides, axis=0), atol=1e-6)
    known = asked(compensator, approach=np.array([0, 1, 0, 0, 0, 0]))
    assert found.std[1] ** 2 == pytest.approx(known.std[1] ** 2 + (GAP / 2) ** 2, rel=0.05)


def test_a_campaign_knows_where_every_move_starts() -> None:
    """Up, up, down, and once more without moving: the joint keeps the side that it came from."""
    move = Corrections(lost_motion())
    around = Around(1.7e9, "box")
    poses = [BELOW, POSE, ABOVE, POSE]
    here = BELOW - UP
    said = []
    for wanted in poses:
        here = move(wanted, payload(), here, around)
        said.append(here)
    assert said[1][VERTICAL] - said[3][VERTICAL] == pytest.approx(GAP, rel=1e-3)
    assert np.linalg.norm(miss(said[1], -GAP / 2)) < 5e-5
    assert np.linalg.norm(miss(said[3], GAP / 2)) < 5e-5
    again = move(POSE, payload(), here, around)
    np.testing.assert_allclose(again, said[3], atol=1e-6)  # the reading of the load is of another pose


def test_a_campaign_says_how_often_it_took_an_effect_out_and_why_not() -> None:
    column = Column("frame", "temperature", {"place": "rail", "tau": 0.0}, VERTICAL + 1, TY)
    compensator = knowing("thermal_growth", "vertical", column, 8e-5)
    move = Corrections(Compensator(replace(compensator.calibration, temperature_range={"rail": (19.0, 25.0)})))
    for rail in ({"rail": 20.0}, {}, {"rail": 30.0}, {"rail": 31.0}, {"rail": 22.0}):
        move(POSE, payload(), POSE, Around(1.7e9, "box", rail))
    unknown = "the temperature of rail is not known; taken as its mean while measured"
    assert [(v.taken_out, v.why, n) for v, n in move.said] == [(True, "", 2), (False, unknown, 1), (True, BEYOND, 2)]


def test_an_axis_that_always_ends_its_moves_upwards_has_one_direction() -> None:
    move = Corrections(lost_motion(), run_up=np.array([0, 0.01, 0, 0, 0, 0]))
    around = Around(1.7e9, "box")
    from_above = move(POSE, payload(), ABOVE, around)
    assert np.linalg.norm(miss(from_above, -GAP / 2)) < 5e-5


WAY, WOUND = 0.02, 3e-4


def friction() -> Compensator:
    """vertical winds up over 20 mm of way."""
    args = {"joint": VERTICAL, "width": WAY}
    return knowing("friction_hysteresis", "vertical", Column("frame", "slipping", args, VERTICAL + 1, TY), -WOUND)


@pytest.mark.parametrize(("way", "wound"), [(0.1, 1.0), (WAY, 1.0), (WAY / 2, 0.5), (-WAY / 4, -0.25)])
def test_friction_winds_up_with_the_way_from_where_a_move_starts(way: float, wound: float) -> None:
    """0.4 mm were taken out after a move of 0.1 mm that turned back. How the joint came to where it starts nobody said:
    as if from the middle, and unsure by either side."""
    start = POSE - [0.0, way, 0.0, 0.0, 0.0, 0.0]
    compensator = friction()
    found = asked(compensator, start=start)
    assert np.linalg.norm(miss(found.corrected, -wound * WOUND)) < 6e-5
    side = int(np.sign(way))
    sides = [asked(compensator, start=start, before=np.full(6, s)) for s in (-side, side)]
    last = [max(-1.0, min(1.0, s + way / WAY)) for s in (-side, side)]
    for one, at in zip(sides, last, strict=True):
        assert np.linalg.norm(miss(one.corrected, -at * WOUND)) < 6e-5
    plain = along_y(compensator, start=start, before=np.full(6, side))
    either = 0.5 * abs(last[1] - last[0]) * WOUND
    assert along_y(compensator, start=start) == pytest.approx(np.hypot(plain, either), rel=0.05)
    assert not found.effects[0].why


def test_friction_from_a_side_that_nobody_says_makes_unsure_by_either() -> None:
    plain = along_y(friction(), approach=np.array([0, 1, 0, 0, 0, 0]))
    assert along_y(friction()) == pytest.approx(np.hypot(plain, WOUND), rel=0.05)


def test_how_far_a_joint_has_gone_where_nobody_says_is_said_to_be_unknown() -> None:
    found = asked(friction(), approach=np.array([0, 1, 0, 0, 0, 0]))
    assert np.linalg.norm(miss(found.corrected, -WOUND)) < 6e-5
    assert "how far the joint has gone since it turned back is not known; taken as far" in found.effects[0].why


@pytest.mark.parametrize("start", [BELOW, ABOVE])
def test_friction_of_an_axis_with_a_run_up_winds_up_over_that(start: Array) -> None:
    """0.35 mm, of 0.23 without correction, where it was taken as far, however short the run-up."""
    for short in (0.005, 0.05):
        move = Corrections(friction(), run_up=np.array([0, short, 0, 0, 0, 0]))
        here = move(start - UP, payload(), start - UP, Around())
        here = move(start, payload(), here, Around())
        there = move(POSE, payload(), here, Around())
        wound = min(1.0, (1.0 if start is BELOW else -1.0) + short / WAY)
        assert np.linalg.norm(miss(there, -wound * WOUND)) < 6e-5


def test_growth_is_taken_out_by_the_temperature_of_its_place() -> None:
    column = Column("frame", "temperature", {"place": "rail", "tau": 0.0}, VERTICAL + 1, TY)
    compensator = knowing("thermal_growth", "vertical", column, 8e-5)
    warm = asked(compensator, around=Around(temperatures={"rail": 24.5, "air": 20.0}))
    assert np.linalg.norm(miss(warm.corrected, 8e-5 * 2.5)) < 5e-5
    assert warm.effects[0].taken_out
    unknown = asked(compensator, around=Around(temperatures={"air": 20.0}))
    np.testing.assert_allclose(unknown.corrected, asked(Compensator(base()[1])).corrected, atol=1e-9)
    assert unknown.effects[0].why == "the temperature of rail is not known; taken as its mean while measured"


@pytest.mark.parametrize(("rail", "said"), [
    (25.05, ""), (25.2, BEYOND),
    (18.95, ""), (18.0, BEYOND),
])  # fmt: skip
def test_growth_at_a_temperature_that_it_was_not_measured_at_is_carried_on_and_said(rail: float, said: str) -> None:
    column = Column("frame", "temperature", {"place": "rail", "tau": 0.0}, VERTICAL + 1, TY)
    compensator = knowing("thermal_growth", "vertical", column, 8e-5)
    compensator = Compensator(replace(compensator.calibration, temperature_range={"rail": (19.0, 25.0)}))
    found = asked(compensator, around=Around(temperatures={"rail": rail}))
    assert (found.effects[0].taken_out, found.effects[0].why) == (True, said)
    plain = asked(Compensator(base()[1])).corrected
    assert plain[VERTICAL] - found.corrected[VERTICAL] == pytest.approx(8e-5 * (rail - 22.0), rel=0.02)


@pytest.mark.parametrize("rail", [294.0, 12.9, -127.0])
def test_a_thermometer_that_reads_far_from_where_growth_was_measured_moves_no_axis(rail: float) -> None:
    """In kelvin, or broken: 16 mm were driven into the axes."""
    column = Column("frame", "temperature", {"place": "rail", "tau": 0.0}, VERTICAL + 1, TY)
    grown = knowing("thermal_growth", "vertical", column, 8e-5)
    compensator = Compensator(replace(grown.calibration, temperature_range={"rail": (19.0, 25.0), "air": (18.0, 20.0)}))
    said = r"of rail .* too far from the 19.0 to 25.0 °C .* expected 13.0 … 31.0"
    with pytest.raises(CompensationRefused, match=said):
        asked(compensator, around=Around(1.7e9, "box", {"rail": rail, "air": 294.0}))
    asked(compensator, around=Around(1.7e9, "box", {"rail": 13.0, "air": 294.0}))  # nothing goes with the air


def test_evaluate_counts_visits_at_temperatures_that_no_effect_was_measured_at(tmp_path: Path) -> None:
    plant, _ = base()
    csv = simulate_recording_csv(plant, tmp_path / "r.csv", 9, np.random.default_rng(2), "mixed")
    temperatures = {"rail": np.linspace(18.0, 26.0, 9), "air": np.full(9, 40.0)}
    recording = replace(load_recording(csv, load_machine(PPS)), temperatures=temperatures)
    column = Column("frame", "temperature", {"place": "rail", "tau": 0.0}, VERTICAL + 1, TY)
    calibration = knowing("thermal_growth", "vertical", column, 8e-5).calibration
    wide = replace(calibration, temperature_range={"rail": (18.05, 25.95)})
    assert evaluate(recording, calibration.machine, wide)["beyond"] == []
    narrow = replace(calibration, temperature_range={"rail": (19.5, 24.0), "air": (20.0, 21.0)})
    said = evaluate(recording, calibration.machine, narrow)["beyond"]
    assert said == [{"temperature": "rail", "low_C": 19.5, "high_C": 24.0, "visits": 4}]


def test_evaluate_counts_visits_where_a_column_is_what_no_effect_was_measured_at(tmp_path: Path) -> None:
    """A scale by the air's pressure was carried on to 25 hPa less without a word: 4.9 mm (a reviewer's)."""
    plant, _ = base()
    csv = simulate_recording_csv(plant, tmp_path / "r.csv", 9, np.random.default_rng(2), "mixed")
    recording = load_recording(csv, load_machine(PPS))
    then = replace(recording, covariates={"pressure": np.linspace(1007.6, 1009.2, 9), "oil": np.zeros(9)})
    column = Column("points", "scale", {"name": "cov_pressure"})
    calibration = replace(knowing("tracker_scale", None, column, 6e-5).calibration, visits=then)
    assert evaluate(then, calibration.machine, calibration)["beyond"] == []
    now = replace(then, covariates={"pressure": np.linspace(1008.0, 1010.0, 9), "oil": np.ones(9)})
    said = evaluate(now, calibration.machine, calibration)["beyond"]
    assert said == [{"column": "cov_pressure", "low": 1007.6, "high": 1009.2, "visits": 4}]


def test_growth_that_lags_follows_what_the_thermometers_said_before() -> None:
    """After a jump of 2 K a lag of an hour has taken in 1 − 1/e of it an hour later (readings every two minutes)."""
    column = Column("frame", "temperature", {"place": "rail", "tau": 1.0}, VERTICAL + 1, TY)
    move = Corrections(knowing("thermal_growth", "vertical", column, 1e-4))
    here, said = BELOW, []
    for k in range(32):
        rail = 22.0 if k == 0 else 24.0
        here = move(POSE, payload(), here, Around(1.7e9 + 120.0 * k, "box", {"rail": rail}))
        said.append(here[VERTICAL])
    # between two readings the temperature goes straight on
    assert said[0] - said[31] == pytest.approx(1e-4 * 2.0 * (1 - np.exp(-1.0)), rel=0.02)


def test_a_wave_of_the_screw_is_taken_out_where_the_joint_really_goes() -> None:
    column = Column("frame", "wave", {"joint": VERTICAL, "period": 0.008, "phase": "sin"}, VERTICAL + 1, TY)
    found = asked(knowing("periodic_transmission", "vertical", column, 1e-4))
    there = 1e-4 * float(np.sin(2 * np.pi * found.corrected[VERTICAL] / 0.008))
    assert abs(there) > 1e-5
    assert np.linalg.norm(miss(found.corrected, there)) < 5e-5


@pytest.mark.parametrize("slope", [0.9, 1.4])
def test_a_wave_as_steep_as_the_joint_s_own_way_is_taken_out(slope: float) -> None:
    """Half of the poses were refused as out of reach, of a screw whose error is as steep as its way."""
    size, period = 1e-4, 2 * np.pi * 1e-4 / slope
    column = Column("frame", "wave", {"joint": VERTICAL, "period": period, "phase": "sin"}, VERTICAL + 1, TY)
    compensator = knowing("periodic_transmission", "vertical", column, size)
    for down in np.linspace(0.0, period, 7):
        wanted = POSE - down * UP / UP.max()
        found = compensator.for_joints(wanted, payload(), "treatment")
        there = size * float(np.sin(2 * np.pi * found.corrected[VERTICAL] / period))
        predicted = miss(found.corrected, there)
        predicted[TY] += float(down)
        assert np.linalg.norm(predicted) < 5e-5


@pytest.mark.parametrize(("of", "compliance"), [(3, -2e-8), (-1, -1e-8)])  # of a moment; of the weight
def test_creep_is_taken_out_where_the_age_of_the_load_is_known(of: int, compliance: float) -> None:
    """Half of the sag of one link that comes late has come after ln 2 time constants."""
    args = {"frame": VERTICAL + 1, "component": of, "tau": 1.0, "form": "exponential"}
    compensator = knowing("creep", "vertical", Column("frame", "creeping", args, VERTICAL + 1, 3), compliance)
    plain = asked(Compensator(base()[1])).corrected
    ages = (1.0, 3600 * np.log(2), None, 1800.0)
    fresh, half, nobody, half_an_hour = (asked(compensator, loaded_for=s) for s in ages)
    missing = [np.abs(found.corrected - plain).max() for found in (fresh, half)]
    assert missing[0] > 1e-6
    assert missing[1] == pytest.approx(missing[0] / 2, rel=0.01)
    np.testing.assert_allclose(nobody.corrected, half_an_hour.corrected, atol=1e-9)
    assert fresh.effects[0].taken_out
    assert "when the load was changed is not known; taken as 30 min ago" in nobody.effects[0].why


def test_a_load_that_is_swapped_for_another_creeps_by_their_difference_and_unsurely_where_nobody_says() -> None:
    """Taken to have been put on an empty machine: 0.113 mm off where std_mm was 0.040 (a reviewer's)."""
    kind = creeping_over_half_an_hour()
    compensator = Compensator(replace(kind.calibration, visits=measured()))
    lay = (None, *(share * payload() for share in (0.0, 0.5, 1.0)))
    nobody, nothing, half, same = (asked(compensator, loaded_for=600.0, lay_before=before) for before in lay)
    plain = asked(Compensator(base()[1]))
    np.testing.assert_allclose(nobody.corrected, nothing.corrected, atol=1e-12)
    whole = nothing.corrected - plain.corrected
    np.testing.assert_allclose(half.corrected - plain.corrected, 0.5 * whole, atol=2e-7)
    np.testing.assert_allclose(same.corrected, plain.corrected, atol=2e-7)
    assert "what lay there before is not known; taken as nothing" in nobody.effects[0].why
    assert (nobody.effects[0].taken_out, nothing.effects[0].why) == (True, "")
    # of what the loads of the recording would leave
    left = nothing.predicted_error[1] - same.predicted_error[1]
    assert 0.2 * abs(left) < np.sqrt(nobody.std[1] ** 2 - nothing.std[1] ** 2) < 1.0 * abs(left)
    bare = asked(kind, loaded_for=600.0)  # of a calibration that keeps no loads: nothing, or as much
    assert np.sqrt(bare.std[1] ** 2 - nothing.std[1] ** 2) == pytest.approx(0.5 * abs(left), rel=0.05)


def test_a_pose_that_cannot_be_had_on_either_side_of_where_a_joint_starts_is_had_as_nearly_as_it_can() -> None:
    """Another joint moves, this one ends a little beside where it stands: a reviewer's run ended there, with a reason
    that was none (0.02 mm were left in an ordinary pose)."""
    column = Column("frame", "slipping", {"joint": VERTICAL, "width": 0.01}, VERTICAL + 1, TY)
    compensator = knowing("friction_hysteresis", "vertical", column, -GAP / 2)
    start = POSE - np.array([0, 0, 0, 0.2, 0, 0])
    start[VERTICAL] = asked(Compensator(base()[1])).corrected[VERTICAL] + GAP / 4
    found = asked(compensator, start=start, approach=np.array([0, 1, 0, 1, 0, 0]))
    assert found.at_odds == ("vertical",)
    assert np.linalg.norm(found.left) < 0.6 * GAP / 2
    clear = start - np.array([0, GAP, 0, 0, 0, 0])
    assert asked(compensator, start=clear, approach=np.array([0, 1, 0, 1, 0, 0])).at_odds == ()


@pytest.mark.parametrize(("beside", "left"), [(0.0, 2e-3), (1e-4, 5e-4)])
def test_what_is_left_by_more_than_any_gap_or_by_no_joint_that_turns_is_refused(
    beside: float, left: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = POSE.copy()
    start[VERTICAL] += beside
    monkeypatch.setattr(compensator_module, "solve_pose", lambda *_: (POSE[None], np.full((1, 6), left)))
    with pytest.raises(CompensationRefused, match="no corrected setpoint was found"):
        asked(lost_motion(), start=start, approach=np.array([0, 1, 0, 0, 0, 0]))
    monkeypatch.setattr(compensator_module, "solve_pose", lambda *_: (POSE[None], np.full((1, 6), 5e-4)))
    assert asked(lost_motion(), start=POSE, approach=np.array([0, 1, 0, 0, 0, 0])).at_odds == ("vertical",)


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_a_load_of_which_nobody_says_since_when_may_have_followed_any_other(share: float) -> None:
    """With nothing on it, 90 kg taken off seven minutes before: 0.60 mm off where std_mm was 0.047, and 0.30 where its
    age was given (a reviewer's)."""
    compensator = Compensator(replace(creeping_over_half_an_hour().calibration, visits=measured()))
    known = ({"loaded_for": 600.0, "lay_before": np.zeros(6)}, {"loaded_for": 600.0}, {})
    given = [Circumstances(**each) for each in known]  # type: ignore[arg-type]
    sure, after_any, least = (
        compensator.for_joints(POSE, share * payload(), "treatment", each).std[1] for each in given
    )
    assert sure < 0.1 * after_any
    assert least > 0.8 * after_any  # it may also have lain there for long


def test_what_lay_there_before_is_turned_to_where_the_move_starts_as_the_load_is() -> None:
    """Its moments stayed with the sensor's axes of where the move goes to: setpoints 1.18 mm off where std_mm was 0.06
    (a reviewer's arm)."""
    compensator = creeping_over_half_an_hour()
    plain = asked(Compensator(base()[1])).corrected
    turned = POSE + np.array([0, 0, 0, 0, 0.1, -0.1])
    assert np.abs(asked(compensator, loaded_for=600.0, start=turned).corrected - plain).max() > 1e-6
    same = asked(compensator, loaded_for=600.0, start=turned, lay_before=payload())
    np.testing.assert_allclose(same.corrected, plain, atol=2e-7)


def test_creep_is_taken_as_it_was_when_a_load_had_lain_there_for_the_longest() -> None:
    """Forms that agree as far as they were seen go far apart beyond: 0.67 mm off after six hours, where loads had been
    changed every 12 minutes."""
    args = {"frame": VERTICAL + 1, "component": 3, "tau": 0.1, "form": "last"}
    compensator = knowing("creep", "vertical", Column("frame", "creeping", args, VERTICAL + 1, 3), -2e-8)
    assert compensator.known is not None
    compensator.known._reference[OLDEST_LOAD_H] = 0.5
    young, oldest, older = (asked(compensator, loaded_for=s) for s in (600.0, 1800.0, 7200.0))
    np.testing.assert_allclose(older.corrected, oldest.corrected, atol=1e-8)
    assert np.abs(young.corrected - oldest.corrected).max() > 1e-6
    assert "longer than any did while it was measured (30 min)" in older.effects[0].why
    assert older.effects[0].taken_out
    assert "longer than any" not in young.effects[0].why


@pytest.mark.parametrize("form", ["exponential", "log", "wrench", "total"])
def test_a_calibration_keeps_for_how_long_its_loads_lay_there_whichever_form_its_creep_has(form: str) -> None:
    """Of those by the wrench on a link it did not, and nothing was said of a load older than any (a reviewer's)."""
    calibration, recording = base()[1], measured()
    column = Column("frame", "creeping", {"frame": 2, "component": 3, "tau": 0.4, "form": form}, 2, 3)
    reference: dict[str, float] = {}
    context = Context.of(calibration.model, calibration.theta, recording, calibration.measuring_in_base, reference)
    column.evaluate(context)
    ages = hours_since_change(recording.load, context.hours, loads_came(context))
    assert context.reference[OLDEST_LOAD_H] == pytest.approx(ages.max())


def test_a_load_that_lay_there_for_long_makes_the_next_one_no_older() -> None:
    """A load of four hours, where none had lain there for longer than half an hour, left the next one 0.7 mm off."""
    args = {"frame": VERTICAL + 1, "component": 3, "tau": 0.1, "form": "last"}
    ends = []
    for reference in ({OLDEST_LOAD_H: 0.5}, {}):
        compensator = knowing("creep", "vertical", Column("frame", "creeping", args, VERTICAL + 1, 3), -2e-8)
        assert compensator.known is not None
        compensator.known._reference |= reference
        move, here = Corrections(compensator), BELOW
        for hours, label in ((0.0, "box"), (4.0, "box"), (4.2, "more"), (4.4, "more")):
            times = 1.5 if label == "more" else 1.0
            here = move(ABOVE if hours == 4.0 else POSE, times * payload(), here, Around(1.7e9 + 3600 * hours, label))
        ends.append(here)
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)
    assert np.abs(ends[0] - asked(Compensator(base()[1])).corrected).max() > 1e-6


def test_creep_that_a_run_brings_along_is_that_of_the_age_of_its_load() -> None:
    """The whole late share counts, not its change since the run began: the base model holds what was long there."""
    args = {"frame": VERTICAL + 1, "component": 3, "tau": 1.0, "form": "log"}
    compensator = knowing("creep", "vertical", Column("frame", "creeping", args, VERTICAL + 1, 3), -2e-8)
    move = Corrections(compensator)
    here = move(BELOW, payload(), BELOW, Around(1.7e9, "box"))
    there = move(POSE, payload(), here, Around(1.7e9 + 5400.0, "box"))
    # put on half an hour before the run, as nobody says otherwise, and an hour and a half into it: two hours
    asked_for = asked(compensator, loaded_for=7200.0).corrected
    np.testing.assert_allclose(there, asked_for, atol=5e-7)  # the load is weighed at two poses
    assert np.abs(there - asked(Compensator(base()[1])).corrected).max() > 1e-6


def creeping_over_half_an_hour() -> Compensator:
    args = {"frame": VERTICAL + 1, "component": 3, "tau": 0.5, "form": "exponential"}
    return knowing("creep", "vertical", Column("frame", "creeping", args, VERTICAL + 1, 3), -2e-8)


def test_setpoints_before_the_end_of_what_effects_look_back_to_are_refused() -> None:
    """A computer's clock that had been set back by half an hour left creep of a gantry 36 mm off, and said nothing."""
    ended = float(measured().time[-1])
    for kind, refused in ((creeping_over_half_an_hour(), True), (lost_motion(), False)):
        compensator = Compensator(replace(kind.calibration, visits=measured()))
        for late in (-1800.0, 60.0):
            move = Corrections(compensator)
            if refused and late < 0:
                with pytest.raises(CompensationRefused, match=r"the clock says .*\+00:00, the visits .* go on until"):
                    move(POSE, payload(), BELOW, Around(ended + late, "box"))
                with pytest.raises(CompensationRefused, match="expected this computer's clock"):
                    move.refuse_before(ended + late)
            else:
                move.refuse_before(ended + late)
                move(POSE, payload(), BELOW, Around(ended + late, "box"))


def test_what_stands_beside_a_gaussian_process_in_place_of_an_effect_drives_no_axis() -> None:
    """A calibration of both was an internal error in every setpoint."""
    _, calibration = base()
    inner = Column("frame", "approach", {"joint": VERTICAL}, VERTICAL + 1, TY)
    for on, frame, component in (("frame", VERTICAL + 1, TY), ("frames", 0, 0)):
        args = {"column": inner.as_dict(), "regions": []}
        beside = Effect("unexplained", None, (Column(on, "instead", args, frame, component),), (1e-3,), (1e-5,), "")
        compensator = Compensator(replace(calibration, effects=(beside,), reference={"start": 1.7e9, "hours": HOURS}))
        found = asked(compensator, start=BELOW)
        np.testing.assert_allclose(found.corrected, asked(Compensator(calibration)).corrected, atol=1e-12)


def test_a_run_knows_what_a_load_weighs_where_it_goes_from_its_second_attitude_on() -> None:
    """An arm that turns its load over was 1.70 mm off at worst by what was read last, by its true weight 0.60 (a
    reviewer's)."""
    plant, calibration = base()
    run, exact = Corrections(Compensator(calibration)), Compensator(calibration)
    tilted = [POSE + np.array([0, 0, 0, 0, roll, pitch]) for roll, pitch in ((0.03, 0.0), (-0.05, 0.03), (0.02, 0.05))]
    off = []
    for here, wanted in pairwise(tilted):
        found = run(wanted, plant.wrench(here, LOAD)[0], here, Around(1.7e9, "box", {}, 1.7e9))
        wanted_by = exact.for_joints(wanted, plant.wrench(wanted, LOAD)[0], run.point)
        off.append(np.abs(found - wanted_by.corrected).max())
    assert off[0] > 1e-5
    assert off[1] < 1e-7


@pytest.mark.parametrize("lay_before", [0.0, 0.5])
def test_creep_of_a_run_s_first_load_is_by_when_it_was_put_on_and_what_lay_there_before(lay_before: float) -> None:
    compensator = creeping_over_half_an_hour()
    at = Around(1.7e9, "box", {}, 1.7e9 - 600.0, lay_before * payload())
    move = Corrections(compensator)
    there = move(POSE, payload(), POSE, at)
    said = "what lay there before is taken to have lain there for long" if lay_before else ""
    assert [verdict.why for verdict, _ in move.said] == [said]
    plain = asked(Compensator(base()[1])).corrected
    # superposed: what is still to come of the load that was added, of a load that lay there for long nothing
    missing = (1.0 - lay_before) * (asked(compensator, loaded_for=600.0).corrected - plain)
    np.testing.assert_allclose(there - plain, missing, atol=2e-7)
    assert np.abs(missing).max() > 1e-6


@pytest.mark.parametrize("pause_h", [0.1, 2.0])
def test_creep_of_a_run_s_later_load_is_by_when_that_was_put_on(pause_h: float) -> None:
    """It was taken to have been put on halfway between two visits, also after a pause of two hours."""
    compensator = creeping_over_half_an_hour()
    move, began, age = Corrections(compensator), 1.7e9, 120.0
    here = move(POSE, payload(), POSE, Around(began, "box", {}, began - 4 * 3600.0, np.zeros(6)))
    now = began + 3600.0 * pause_h + age
    there = move(POSE, 1.5 * payload(), here, Around(now, "more", {}, now - age, payload()))
    plain = compensator.for_joints(POSE, 1.5 * payload(), "treatment", Circumstances(loaded_for=1e5)).corrected
    lay = asked(compensator, loaded_for=4 * 3600.0 + now - began, lay_before=np.zeros(6)).corrected
    box = asked(Compensator(base()[1])).corrected
    more = asked(compensator, loaded_for=age, lay_before=np.zeros(6)).corrected - box  # of one box, put on now
    np.testing.assert_allclose(there - plain, 0.5 * more + (lay - box), atol=5e-7)
    assert np.abs(more).max() > 5e-6


def test_another_load_under_the_label_of_one_that_lay_there_before_is_another_load() -> None:
    """0.43 mm off, of 0.02, where the run's first load had the label of the calibration recording's last."""
    ends = []
    for label in ("box", "another"):
        compensator = creeping_over_half_an_hour()
        one = replace(measured().subset(np.arange(3)), load=("box",) * 3, time=1.7e9 + 60.0 * np.arange(3))
        move, here = Corrections(compensator, after=one), POSE
        heavier = 1.5 * payload()
        ends.append(move(POSE, heavier, here, Around(1.7e9 + 600.0, label)))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-12)


def test_a_run_that_goes_on_knows_its_own_visits() -> None:
    moves = [(BELOW, 0.0, "a"), (POSE, 300.0, "a"), (ABOVE, 900.0, "b"), (POSE, 1200.0, "b")]
    compensator = creeping_over_half_an_hour()

    def run(some: list[tuple[Array, float, str]], correct: Corrections, here: Array) -> list[Array]:
        out = []
        for wanted, seconds, load in some:
            here = correct(wanted, (0.6 if load == "a" else 1.0) * payload(), here, Around(1.7e9 + seconds, load))
            out.append(here)
        return out

    def visited(ends: list[Array]) -> Recording:
        n = len(ends)
        return replace(
            measured().subset(np.arange(n)), q=np.array(ends), time=1.7e9 + np.array([s for _, s, _ in moves[:n]]),
            load=tuple(load for *_, load in moves[:n]), temperatures={},
            wrench=np.outer([0.6 if load == "a" else 1.0 for *_, load in moves[:n]], payload()),
        )  # fmt: skip

    whole = [BELOW, *run(moves[1:], Corrections(compensator, so_far=visited([BELOW])), BELOW)]
    gone_on = run(moves[3:], Corrections(compensator, so_far=visited(whole[:3])), whole[2])
    by_another = Corrections(compensator, after=visited(whole[:2]), so_far=visited(whole[:3]).subset([2]))
    np.testing.assert_allclose(run(moves[3:], by_another, whole[2])[0], gone_on[0], atol=1e-9)
    forgotten = run(moves[3:], Corrections(compensator), whole[2])
    assert np.abs(gone_on[0] - whole[3]).max() < 0.1 * np.abs(forgotten[0] - whole[3]).max()


# --- what cannot ------------------------------------------------------------------------------------------------------
def test_a_drift_is_left_as_it_was_on_average_and_said() -> None:
    column = Column("frame", "clock", {"form": "linear", "tau": 1.0}, 0, TY)
    compensator = knowing("drift", None, column, 1e-5)
    early, late = (asked(compensator, around=Around(1.7e9 + t)) for t in (0.0, 3600 * 50.0))
    np.testing.assert_allclose(early.corrected, late.corrected, atol=1e-12)
    plain = asked(Compensator(base()[1])).corrected
    assert plain[VERTICAL] - late.corrected[VERTICAL] == pytest.approx(1e-5 * HOURS / 2, rel=1e-3)
    assert late.effects[0].taken_out is False
    assert "how far it has gone since it was measured cannot be known" in late.effects[0].why


def along_y(compensator: Compensator, **known: object) -> float:
    """[m] by how much more unsure the effect makes where the point stands, than the base model is."""
    return float(np.sqrt(asked(compensator, **known).std[1] ** 2 - asked(Compensator(base()[1])).std[1] ** 2))


def test_which_side_a_joint_comes_from_makes_unsure_by_half_the_gap_where_nobody_knows() -> None:
    assert along_y(lost_motion()) == pytest.approx(GAP / 2, rel=0.01)
    assert along_y(lost_motion(), start=BELOW) == pytest.approx(0.05 * GAP / 2, rel=0.01)


def test_a_gap_that_was_measured_from_below_alone_makes_unsure_only_from_above() -> None:
    """From below it is a shift of the joint, of which the base model has the less the larger the gap is: their sum is
    known whatever each of them is. From above they are apart by the whole gap, twice what its half is unsure by."""
    gap = lost_motion().calibration.effects[0]
    parameters = [p.name for p in base()[1].model.parameters()]
    shift = np.array([[float(name == "vertical.ty[0]") for name in parameters]])
    assert shift.sum() == 1.0
    known = Compensator(replace(lost_motion().calibration, effects=(replace(gap, mimicked=shift),)))
    plain = asked(Compensator(base()[1])).std
    np.testing.assert_allclose(asked(known, start=BELOW).std, plain, rtol=1e-3)
    assert along_y(known, start=ABOVE) == pytest.approx(2 * gap.std[0], rel=0.01)


def test_a_temperature_that_nobody_knows_makes_unsure_by_what_it_ran_through() -> None:
    """Evenly between 19 and 25 °C, in three steps: a standard deviation of 6 √(2/27) K."""
    column = Column("frame", "temperature", {"place": "rail", "tau": 0.0}, VERTICAL + 1, TY)
    compensator = knowing("thermal_growth", "vertical", column, 8e-5)
    compensator = Compensator(replace(compensator.calibration, temperature_range={"rail": (19.0, 25.0)}))
    assert along_y(compensator) == pytest.approx(8e-5 * 6.0 * np.sqrt(2 / 27), rel=0.01)
    assert along_y(compensator, around=Around(temperatures={"rail": 22.0})) < 1e-9


def test_a_temperature_that_nobody_knows_makes_no_surer_than_one_that_is_known() -> None:
    """Of growth that may as well be none: by its 80 µm per kelvin, at any of the temperatures that there were."""
    column = Column("frame", "temperature", {"place": "rail", "tau": 0.0}, VERTICAL + 1, TY)
    effect = Effect("thermal_growth", "vertical", (column,), (0.0,), (8e-5,), "by hand")
    known = replace(base()[1], effects=(effect,), reference={"start": 1.7e9, "hours": HOURS, "mean.rail": 22.0})
    compensator = Compensator(replace(known, temperature_range={"rail": (19.0, 25.0)}))
    felt = [along_y(compensator, around=Around(temperatures={"rail": rail})) for rail in (20.0, 24.0)]
    assert felt == pytest.approx([1.6e-4, 1.6e-4], rel=0.01)
    assert along_y(compensator) == pytest.approx(8e-5 * 6.0 * np.sqrt(2 / 27), rel=0.01)


def late_growth(**of: object) -> Compensator:
    """vertical grows with the rail's temperature an hour ago, by 10 µm per kelvin, hardly unsure."""
    column = Column("frame", "temperature", {"place": "rail", "tau": 1.0}, VERTICAL + 1, TY)
    effect = Effect("thermal_growth", "vertical", (column,), (1e-5,), (1e-12,), "by hand")
    reference = {"start": 1.7e9, "hours": HOURS, "mean.rail": 22.0}
    return Compensator(replace(base()[1], effects=(effect,), reference=reference, **of))  # type: ignore[arg-type]


def test_what_a_thermometer_read_an_hour_ago_makes_unsure_where_nobody_knows() -> None:
    """A reviewer's growth that lags: 0.032 mm were said of errors of 0.051, and nothing of its past."""
    anywhere = late_growth(visits=None, temperature_range={"rail": (19.0, 25.0)})
    warmer = Around(temperatures={"rail": 24.0})
    assert along_y(anywhere, around=warmer) == pytest.approx(1e-5 * 6.0 / np.sqrt(12.0), rel=0.01)
    assert asked(anywhere, around=warmer).effects[0].why == "lags rail by 1 h: taken as steady before it was read"
    visits = measured()
    hours = (visits.time - visits.time[0]) / 3600.0
    rose = replace(visits, temperatures={"rail": 20.0 + 3.0 * hours})  # by 3 K an hour, and behind by as much
    behind = 3.0 * (1.0 - np.exp(-hours))
    known = late_growth(visits=rose, temperature_range={"rail": (20.0, 40.0)})
    assert along_y(known, around=warmer) == pytest.approx(1e-5 * np.sqrt((behind**2).mean()), rel=0.02)


def test_what_comes_later_in_part_is_no_more_where_temperatures_are_steady() -> None:
    """A reviewer's growth of 135 ppm per kelvin was taken out as 222: its near forms, of lags of hours, were added
    where nobody knew what the thermometer had read before, and one of them was said to be the lag."""
    grows = Column("frame", "temperature", {"place": "rail", "tau": 0.0}, VERTICAL + 1, TY)
    later = Column("frame", "temperature", {"place": "rail", "tau": 2.0, "than": 0.0}, VERTICAL + 1, TY)
    effect = Effect("thermal_growth", "vertical", (grows, later), (1e-5, 6e-6), (1e-12, 1e-12), "by hand")
    reference = {"start": 1.7e9, "hours": HOURS, "mean.rail": 22.0}
    known = replace(base()[1], effects=(effect,), reference=reference, visits=None)
    compensator = Compensator(replace(known, temperature_range={"rail": (19.0, 25.0)}))
    found = asked(compensator, around=Around(temperatures={"rail": 24.0}))
    before = asked(Compensator(replace(known, effects=(), reference={})))
    assert found.predicted_error[1] - before.predicted_error[1] == pytest.approx(2e-5, rel=0.01)
    assert found.effects[0].why == ""


def test_what_a_thermometer_read_since_an_hour_ago_is_known_where_the_program_saw_it() -> None:
    anywhere = late_growth(visits=None, temperature_range={"rail": (19.0, 25.0)})
    assert anywhere.known is not None
    now = 1.7e9 + 3600.0 * HOURS
    here = Around(time=now, load="A", temperatures={"rail": 24.0})
    stood = Moment(BELOW, np.zeros(6, dtype=np.int64), payload(), now - 5400.0, "A", {"rail": 21.0})
    past = anywhere.known.remember(Past(known=True), stood)
    found = asked(anywhere, around=here, past=past)
    assert found.effects[0].why == ""
    lag = 24.0 - 2.0 * (1.0 - np.exp(-1.5))  # it rose by 2 K an hour, for an hour and a half
    before = asked(Compensator(replace(base()[1], effects=(), reference={})), around=here)
    assert found.predicted_error[1] - before.predicted_error[1] == pytest.approx(1e-5 * (lag - 22.0), rel=0.05)
    lately = replace(stood, time=now - 1200.0)
    assert (
        "taken as steady"
        in asked(anywhere, around=here, past=anywhere.known.remember(Past(known=True), lately)).effects[0].why
    )


def test_forms_of_which_only_the_sum_is_known_make_no_more_unsure_than_their_sum() -> None:
    """Growth in two forms: each alone known to a fifth of its size, together to a fiftieth, as errors that cancel."""
    steady = Column("frame", "temperature", {"place": "rail", "tau": 0.0}, VERTICAL + 1, TY)
    late = replace(steady, args={"place": "rail", "tau": 1.0})
    size, rho = 1e-5, -0.995
    std = 0.2 * size
    both = Effect("thermal_growth", "vertical", (steady, late), (size, size), (std, std), "by hand")
    related = replace(both, correlation=((1.0, rho), (rho, 1.0)))
    assert np.allclose(related.spread.T @ related.spread, std**2 * np.array([[1.0, rho], [rho, 1.0]]))
    assert Effect.from_dict(json.loads(json.dumps(related.as_dict()))) == related
    reference, warmer = {"start": 1.7e9, "hours": HOURS, "mean.rail": 22.0}, Around(temperatures={"rail": 26.0})
    of_both = replace(base()[1], reference=reference, visits=None, temperature_range={})  # it stood there all the time
    more = [along_y(Compensator(replace(of_both, effects=(effect,))), around=warmer) for effect in (both, related)]
    assert more[0] == pytest.approx(4.0 * std * np.sqrt(2.0), rel=0.05)
    assert more[1] == pytest.approx(4.0 * std * np.sqrt(2.0 + 2.0 * rho), rel=0.05)


@pytest.mark.parametrize("rows", [[[1.0]], [[1.0, 0.0]]])
def test_a_correlation_of_another_size_is_refused(rows: list[list[float]]) -> None:
    column = Column("frame", "approach", {"joint": VERTICAL}, VERTICAL + 1, TY)
    effect = Effect("backlash", "vertical", (column, column), (1.0, 1.0), (1.0, 1.0), "by hand")
    with pytest.raises(ValueError, match="correlation of backlash is not of 2 by 2"):
        Effect.from_dict({**effect.as_dict(), "correlation": rows})


def test_what_the_base_model_would_take_of_effects_must_be_of_its_parameters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    column = Column("frame", "approach", {"joint": VERTICAL}, VERTICAL + 1, TY)
    effect = Effect("backlash", "vertical", (column, column), (1e-4, 1e-4), (1e-5, 1e-5), "by hand")
    for_one = replace(effect, mimicked=np.zeros((1, 7)))
    with pytest.raises(ValueError, match="mimicked of backlash is not of 2 rows"):
        Effect.from_dict(for_one.as_dict())
    of_another = replace(base()[1], effects=(replace(effect, mimicked=np.zeros((2, 7))),))
    with pytest.raises(CalibrationError, match=r"not written.*: 'mimicked' of backlash is for 7 parameters, expected"):
        of_another.save(tmp_path / "other.json")
    with monkeypatch.context() as unguarded:
        unguarded.setattr("ppshw.calibration._unfit", lambda _: "")
        of_another.save(tmp_path / "other.json")
    with pytest.raises(CalibrationError, match=r"damaged: 'mimicked' of backlash is for 7 parameters, expected \d+$"):
        load_calibration(tmp_path / "other.json", load_machine(PPS))


def test_a_drift_makes_unsure_by_how_far_it_went() -> None:
    """Linear over eight hours: its standard deviation is 8 / √12."""
    column = Column("frame", "clock", {"form": "linear", "tau": 1.0}, 0, TY)
    found = along_y(knowing("drift", None, column, 1e-5))
    itself = 0.05 * 1e-5 * HOURS / 2  # that of its coefficient, at the mean
    assert found == pytest.approx(np.hypot(1e-5 * HOURS / np.sqrt(12), itself), rel=0.05)


@pytest.mark.parametrize("known", [{}, {"loaded_for": 60.0, "lay_before": np.zeros(6)}])
def test_how_long_a_load_has_hung_there_makes_unsure_where_nobody_knows(known: dict[str, object]) -> None:
    args = {"frame": VERTICAL + 1, "component": 3, "tau": 1.0, "form": "exponential"}
    compensator = knowing("creep", "vertical", Column("frame", "creeping", args, VERTICAL + 1, 3), -2e-8)
    fresh, old = (asked(compensator, loaded_for=age).predicted_error[1] for age in (0.0, 3e4))
    whole = abs(fresh - old)
    assert whole > 1e-6
    if known:
        assert along_y(compensator, **known) < 0.06 * whole
    else:
        assert 0.3 * whole < along_y(compensator) < 0.5 * whole


def test_an_error_of_the_instrument_is_not_driven_into_the_machine() -> None:
    found = asked(knowing("tracker_scale", None, Column("points", "scale"), 1e-4))
    np.testing.assert_allclose(found.corrected, asked(Compensator(base()[1])).corrected, atol=1e-9)
    assert "an error of the instrument, not of the machine" in found.effects[0].why


def test_reflectors_that_were_knocked_as_one_body_may_be_the_last_link_and_it_says_so() -> None:
    found = asked(
        knowing("target_moved", None, Column("points", "carrier_shift", {"axis": 1, "turn": True, "since": 0.1}), 3e-4)
    )
    np.testing.assert_allclose(found.corrected, asked(Compensator(base()[1])).corrected, atol=1e-9)
    assert not found.effects[0].taken_out
    assert "where the last link slipped instead, the tip is off by as much" in found.effects[0].why


def test_a_point_is_read_farther_off_along_its_beam_and_not_where_a_reflector_moved_to() -> None:
    """A tenth of a per mille of four metres. Another point stays where it is when a reflector slips in its nest."""
    calibration, recording = base()[1], measured()
    beam = np.random.default_rng(3).normal(size=(len(recording), 3))
    beam /= np.linalg.norm(beam, axis=1, keepdims=True)
    points = calibration.measuring_in_base[:3, 3] + 4.0 * beam
    scale = Effect("tracker_scale", None, (Column("points", "scale"),), (1e-4,), (1e-6,), "by hand")
    slipped = Column("points", "target_shift", {"target": 0, "axis": 1})
    knocked = Column("points", "carrier_shift", {"axis": 0, "turn": False, "since": 0.5})
    moved = Effect("target_moved", None, (slipped, knocked), (5e-4, 3e-4), (1e-6, 1e-6), "by hand")
    frame = calibration.measuring_in_base
    found = instrument_error([scale, moved], calibration.model, calibration.theta, recording, frame, {}, points)
    np.testing.assert_allclose(found, 4e-4 * beam, atol=1e-12)


@pytest.mark.parametrize(
    ("scale", "function", "shift"),
    [
        ({"place": "rail"}, "temperature", {"place": "rail", "tau": 0.0}),
        ({"name": "cov_pressure"}, "covariate", {"name": "cov_pressure"}),
    ],
)
def test_nor_is_where_a_scale_that_is_about_another_place_shifts_all(
    scale: dict[str, object], function: str, shift: dict[str, object]
) -> None:
    grows = Column("points", "scale", scale)
    shifts = tuple(Column("frame", function, shift, 0, comp) for comp in range(3))
    values = (2e-6, 2e-5, 0.0, 3e-5)
    effect = Effect("tracker_scale", None, (grows, *shifts), values, (1e-7,) * 4, "by hand")
    reference = {"start": 1.7e9, "hours": HOURS, "mean.rail": 22.0}
    plain = asked(Compensator(base()[1]))
    warm = Around(temperatures={"rail": 26.0})
    found = asked(Compensator(replace(base()[1], effects=(effect,), reference=reference)), around=warm)
    np.testing.assert_allclose(found.corrected, plain.corrected, atol=1e-9)
    np.testing.assert_allclose(found.std, plain.std, rtol=1e-6)
    assert not found.effects[0].taken_out


@cache
def measured() -> Recording:
    with TemporaryDirectory() as folder:
        csv = simulate_recording_csv(
            base()[0], Path(folder) / "r.csv", 120, np.random.default_rng(1), "mixed", visits_per_load=5,
            measurement_noise=False,
        )  # fmt: skip
        return load_recording(csv, load_machine(PPS))


@pytest.mark.parametrize(("form", "tau"), [("exponential", 0.1), ("exponential", 1.6), ("log", 0.1), ("log", 1.6),
                                            ("wrench", 0.4), ("total", 1.6), ("last", 0.1)])  # fmt: skip
def test_creep_after_a_known_past_is_what_the_calibration_itself_predicts(form: str, tau: float) -> None:
    calibration, recording = base()[1], measured()
    column = Column("frame", "creeping", {"frame": 2, "component": 3, "tau": tau, "form": form}, 2, 3)
    span = float(recording.time[-1] - recording.time[0]) / 3600
    effect = Effect("creep", "vertical", (column,), (-2e-8,), (1e-9,), "by hand")
    reference = {"start": float(recording.time[0]), "hours": span}
    whole = Context.of(calibration.model, calibration.theta, recording, calibration.measuring_in_base, dict(reference))
    known = Compensator(replace(calibration, effects=(effect,), reference=reference)).known
    assert known is not None
    for k in (60, 63, 119):
        past = known.past_of(recording.subset(np.arange(k)))
        time, load = float(recording.time[k]), recording.load[k]
        now = Moment(recording.q[k], recording.approach[k], recording.wrench[k], time, load)
        situation = Situation(recording.q[k : k + 1], recording.wrench[k : k + 1])
        errors = known.errors(now, past, *calibration.model.errors(situation, calibration.theta))
        fitted = -2e-8 * column.value(whole)
        assert errors[0, 2, 3] == pytest.approx(fitted[k], rel=0.02, abs=0.02 * np.abs(fitted).max())


@pytest.mark.parametrize("timed", [True, False])
def test_where_only_one_of_two_recordings_has_times_the_later_one_goes_on_from_the_end(timed: bool) -> None:
    calibration, recording = base()[1], measured()
    untimed = replace(recording, time=np.full(len(recording), np.nan))
    reference = {"start": 0.0 if timed else float(recording.time[0]), "hours": HOURS}
    later = recording if timed else untimed
    hours = Context.of(calibration.model, calibration.theta, later, calibration.measuring_in_base, reference).hours
    assert hours[0] == HOURS
    assert 0 < hours[-1] - HOURS < 48


def test_no_axis_is_driven_by_what_has_no_name() -> None:
    """It is left as it was on average, as the base model would have had it."""
    bump = Column("frame", "covariate", {"name": "q_lateral", "knot": 2, "count": 5}, VERTICAL + 1, TY)
    found = asked(knowing("unexplained", None, bump, 1e-4))
    # a bump of width 0.3 of the ranks in their middle: 0.3 √(2π) erf(0.5/(0.3 √2)) = 0.680 on average
    plain = asked(Compensator(base()[1])).corrected
    assert plain[VERTICAL] - found.corrected[VERTICAL] == pytest.approx(0.680 * 1e-4, rel=0.01)
    assert "no axis is driven by it" in found.effects[0].why


@pytest.mark.parametrize(("air", "said"), [(21.0, False), (30.0, True)])
def test_where_structure_over_a_temperature_was_never_measured_nothing_says_how_large_it_is(
    air: float, said: bool
) -> None:
    where = {"names": ["temp_air_C"], "amplitude": [1e-4], "frame": VERTICAL + 1, "components": [TY]}
    effect = Effect("unexplained", None, (Column("frames", "unexplained", where, VERTICAL + 1),), (0.0,), (1.0,), "")
    known = KnownEffects([effect], base()[1].model, base()[1].theta, {}, np.eye(4), {"air": (19.0, 25.0)})
    moment = Moment(POSE, np.zeros(6, dtype=int), payload(), temperatures={"air": air})
    why = known.verdicts(moment, Past())[0].why
    assert why.startswith("nothing says that it stays")
    assert why.endswith("; air is beyond the 19.0 to 25.0 °C at which it was measured; how large it is there nothing "
                        "says") == said  # fmt: skip


def test_a_shifted_zero_is_taken_as_it_was_left() -> None:
    column = Column("frame", "step", {"visit_time": 3.0}, VERTICAL + 1, TY)
    found = asked(knowing("zero_shift", "vertical", column, 2e-4), around=Around(1.7e9))
    assert np.linalg.norm(miss(found.corrected, 2e-4)) < 5e-5
    assert "whether it was homed since cannot be known" in found.effects[0].why


def test_a_force_sensor_whose_zero_jumped_reads_as_it_was_left() -> None:
    """It was taken as it had been on average, half of it where it jumped in the middle."""
    ends = []
    for jumped in (0.5, 6.0):
        args = {"component": 1, "time": "step", "tau": jumped}
        found = asked(knowing("wrench_error", None, Column("frames", "sensor_error", args), 200.0))
        assert (found.effects[0].taken_out, found.effects[0].why) == (
            True, "as at the recording's end; whether it was tared since cannot be known",
        )  # fmt: skip
        ends.append(found.corrected)
    np.testing.assert_array_equal(ends[0], ends[1])
    assert np.abs(ends[0] - asked(Compensator(base()[1])).corrected).max() > 1e-5


@pytest.mark.parametrize(("times", "left"), [([0.5, 2.0, 3.0], 2e-4), ([0.5, 2.0], 0.0)])
def test_a_zero_that_hops_is_taken_as_it_was_left_and_nobody_knows_where_it_is(times: list[float], left: float) -> None:
    column = Column("frame", "hopping", {"times": times}, VERTICAL + 1, TY)
    compensator = knowing("zero_shift", "vertical", column, 2e-4)
    found = asked(compensator, around=Around(1.7e9))
    assert np.linalg.norm(miss(found.corrected, left)) < 5e-5
    assert "it hops, and where it is now cannot be known" in found.effects[0].why


# --- the command ------------------------------------------------------------------------------------------------------
def test_the_command_says_what_stays_of_a_joint_that_runs_ahead(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    column = Column("frame", "approach", {"joint": VERTICAL}, VERTICAL + 1, TY)
    compensator = knowing("backlash", "vertical", column, GAP / 2)
    compensator.calibration.save(tmp_path / "cal.json")
    start = asked(compensator, start=BELOW).corrected + np.array([0, 1e-5, 0, 0, 0, 0])
    words = ["compensate", "--machine", str(PPS), "--calibration", str(tmp_path / "cal.json"), "--joints",
             *map(str, POSE), "--wrench", *map(str, payload()), "--from", *map(str, start)]  # fmt: skip
    assert main(words) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "mrad stay, as either side's setpoint of vertical brings it there from the other side" in said
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["setpoints"]["vertical"] == start[VERTICAL]
    assert found["at_odds"] == ["vertical"]
    assert 0.1 < np.linalg.norm(found["left_mm"]) < 0.2  # half the gap: nobody says which side it stands on


def test_the_command_takes_the_start_and_says_what_it_did(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lost_motion().calibration.save(tmp_path / "cal.json")
    common = ["compensate", "--machine", str(PPS), "--calibration", str(tmp_path / "cal.json"), "--joints",
              *map(str, POSE), "--wrench", *map(str, payload()), "--json"]  # fmt: skip

    def said(*words: str) -> dict[str, object]:
        assert main([*common, *words]) == 0
        return dict(json.loads(capsys.readouterr().out))

    from_below, upwards, unknown = said("--from", *map(str, BELOW)), said("--approach", "vertical=+1"), said()
    assert from_below == upwards
    assert from_below["compensated"] == [{"effect": "backlash", "joint": "vertical", "why": None}]
    assert unknown["compensated"] == []
    left = unknown["not_compensated"]
    assert isinstance(left, list)
    assert left[0]["why"].startswith("from which side")
    assert main([*common, "--approach", "vertical=2"]) == 2
    assert "--approach vertical: 2, expected +1 or -1" in capsys.readouterr().err


# --- a force sensor that misreads -------------------------------------------------------------------------------------
ZERO = np.array([0, 0, 0, 150.0, 0, 0])  # N, N m


def misread(value: float = 1.0) -> Compensator:
    """The sensor reads ZERO too much or too little, as it did while 'box' was measured."""
    plant, calibration = base()
    q = np.random.default_rng(5).uniform(*calibration.machine.limits(), (60, 6))
    wrench = np.concatenate([plant.wrench(one, LOAD) for one in q])
    wrench += np.where(np.arange(len(q)) % 2 == 0, 1.0, -1.0)[:, None] * ZERO
    count = len(q)
    visits = Recording(
        calibration.machine.joint_names, tuple(calibration.machine.targets), np.full(count, np.nan), ("",) * count,
        ("box",) * count, q, q, np.zeros(q.shape, dtype=np.int64), np.full(count, np.nan), wrench,
        np.full((count, len(calibration.machine.targets), 3), np.nan), {}, {}, {}, True, "", "",
    )  # fmt: skip
    effect = Effect("wrench_error", None, (Column("frames", "weighed", {}),), (value,), (0.05,), "by hand")
    reference = {"start": 1.7e9, "hours": HOURS}
    return Compensator(replace(calibration, effects=(effect,), reference=reference, visits=visits))


def of_load(compensator: Compensator, label: str, reading: Array) -> Setpoints:
    return compensator.for_joints(POSE, reading, "treatment", Circumstances(around=Around(load=label)))


def test_a_load_that_was_measured_weighs_what_it_weighed_whatever_the_sensor_reads() -> None:
    right = asked(Compensator(base()[1])).corrected
    plain = of_load(Compensator(base()[1]), "box", payload() + ZERO).corrected
    found = of_load(misread(), "box", payload() + ZERO)
    assert np.abs(found.corrected - right).max() < 0.1 * np.abs(plain - right).max()
    assert np.abs(plain - right).max() > 2e-6
    (told,) = found.effects
    assert (told.taken_out, told.why) == (True, "'box' weighs what it weighed while it was measured")


@pytest.mark.parametrize(("label", "more"), [("patient", 1.0), ("box", 1.5)])
def test_a_load_that_nobody_weighed_is_as_the_sensor_reads_and_std_holds_what_it_may_misread(
    label: str, more: float
) -> None:
    reading = more * payload() + ZERO
    found = of_load(misread(), label, reading)
    plain = of_load(Compensator(base()[1]), label, reading)
    np.testing.assert_allclose(found.corrected, plain.corrected, atol=1e-12)
    assert not found.effects[0].taken_out
    assert np.linalg.norm(found.std) > np.linalg.norm(plain.std)
    known = of_load(misread(), "box", payload() + ZERO)
    assert np.linalg.norm(found.std) > np.linalg.norm(known.std)
