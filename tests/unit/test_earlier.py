"""A later recording goes on from the visits that a calibration was made from, and begins anew where nobody knows."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from numpy.typing import NDArray

from ppshw.calibration import Calibration, content_digest, load_calibration
from ppshw.cli import main
from ppshw.compensation import Compensator, Corrections
from ppshw.errors import CalibrationError
from ppshw.evaluation import evaluate, residuals
from ppshw.identification import identify
from ppshw.machine import load_machine
from ppshw.recording import Around, Recording, load_recording, read_table
from ppshw.terms import earlier
from ppshw.terms.effect import Effect
from ppshw.terms.shapes import Column, Context
from ppshw.terms.shapes.context import UNTIMED
from ppshw.terms.shapes.time_and_heat import clock
from ppshw.twin import simulate
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant

Array = NDArray[np.float64]
PPS = Path(__file__).parents[2] / "machines/pps.yaml"
FRAME, RX = 2, 3
VISITS, FIRST = 120, 80
HOUR, DAY = 3600.0, 86400.0


@cache
def whole() -> Recording:
    """A recording whose loads change every five visits, whose rails warm up and which counts its visits."""
    plant, machine = Plant.from_file(PPS, seed=12, repeatability=0.0), load_machine(PPS)
    with TemporaryDirectory() as folder:
        csv = simulate_recording_csv(
            plant, Path(folder) / "r.csv", VISITS, np.random.default_rng(2), "mixed", visits_per_load=5,
            measurement_noise=False,
        )  # fmt: skip
        recording = load_recording(csv, machine)
    return replace(
        recording, temperatures={"rail": np.linspace(20.0, 26.0, VISITS)}, covariates={"n": np.arange(VISITS * 1.0)},
        time=1.7e9 + 90.0 * np.arange(VISITS),
    )  # fmt: skip


@cache
def base() -> Calibration:
    return Calibration.of(identify(load_machine(PPS), whole()), whole(), "joint")


def remembering(visits: Recording | None) -> Calibration:
    """Creep of an hour, growth an hour behind the rails, and friction: each remembers another way."""
    columns = (
        Column("frame", "creeping", {"frame": FRAME, "component": RX, "tau": 1.0, "form": "exponential"}, FRAME, RX),
        Column("frame", "temperature", {"place": "rail", "tau": 1.0}, FRAME, 1),
        Column("frame", "slipping", {"joint": FRAME - 1, "width": 0.3}, FRAME, 1),
    )
    effect = Effect("creep", "vertical", columns, (3e-7, 1e-4, 1e-4), (1e-9, 1e-7, 1e-7), "by hand")
    reference = {"start": float(whole().time[0]), "hours": 3.0, "mean.rail": 23.0}
    provenance = {**base().provenance, "recording_sha256": "of what it was made from"}
    return replace(base(), effects=(effect,), reference=reference, visits=visits, provenance=provenance)


def later() -> Recording:
    return whole().subset(np.arange(VISITS) >= FIRST)


def rms(a: Array) -> float:
    return float(np.sqrt(np.nanmean(a**2)))


@pytest.mark.long
def test_what_follows_at_once_is_predicted_as_if_both_were_one() -> None:
    together = residuals(whole(), remembering(None))[FIRST:]
    alone = residuals(later(), remembering(None))
    np.testing.assert_allclose(
        residuals(later(), remembering(whole().subset(np.arange(VISITS) < FIRST))), together, atol=1e-12
    )
    assert rms(alone - together) > 2e-5


def test_effects_are_of_the_compliances_that_they_were_found_with(tmp_path: Path) -> None:
    """A diagnosis finds the base model's parameters once more beside its effects: what creeps is a share of what links
    gave way by before. Creep of a boom that was found 2.6 times as stiff then made predictions worse than no creep."""
    column = Column("frames", "creep", {"tau": 1.0, "form": "exponential", "frame": FRAME})
    found = replace(base(), effects=(Effect("creep", "vertical", (column,), (0.5,), (0.01,), "by hand"),))
    others = replace(found, theta=3.0 * base().theta)
    replace(others, laid=base().theta).save(tmp_path / "cal.json")
    laid = load_calibration(tmp_path / "cal.json", load_machine(PPS))
    moved = [residuals(whole(), replace(c, effects=())) - residuals(whole(), c) for c in (found, laid, others)]
    np.testing.assert_allclose(moved[1], moved[0], atol=1e-12)
    assert rms(moved[0]) > 1e-6
    assert rms(moved[2] - moved[0]) > 0.5 * rms(moved[0])


def test_blocks_out_of_the_middle_know_what_was_before_and_between() -> None:
    out = np.isin(np.arange(VISITS) // 10, (3, 7))
    found = residuals(whole().subset(out), remembering(whole().subset(~out)))
    np.testing.assert_allclose(found, residuals(whole(), remembering(None))[out], atol=1e-12)


@pytest.mark.parametrize("change", ["long after", "no times", "out of order", "its own", "before all"])
def test_it_begins_anew(change: str) -> None:
    recording, calibration = later(), remembering(whole().subset(np.arange(VISITS) < FIRST))
    if change == "long after":
        recording = replace(recording, time=recording.time + 2 * HOUR)
    elif change == "no times":
        recording = untimed(recording)
    elif change == "out of order":
        recording = recording.subset(np.arange(len(recording))[::-1])
    elif change == "its own":
        calibration = remembering(later())  # an exported copy, say
    else:
        calibration = remembering(replace(later(), time=later().time + HOUR))
    np.testing.assert_array_equal(residuals(recording, calibration), residuals(recording, remembering(None)))


def untimed(recording: Recording) -> Recording:
    return replace(recording, time=np.full(len(recording), np.nan))


@pytest.mark.parametrize(
    "visits", [slice(FIRST, None), slice(0, 40), slice(30, FIRST), slice(0, None), slice(60, None)]
)
def test_without_times_in_either_a_recording_has_its_place_among_the_visits_or_follows_at_once(visits: slice) -> None:
    """Visits are counted then: 120 later ones of a machine that drifts were predicted as if they were its first, by
    0.31 mm where the base calibration was 0.20 off (a reviewer's), though they were said to follow at once."""
    drift = Column("frame", "clock", {"form": "linear"}, 0, 0)
    steady = Effect("drift", None, (drift,), (1e-4,), (1e-6,), "by hand")
    first, own = untimed(whole().subset(np.arange(VISITS) < FIRST)), np.arange(VISITS)[visits]
    alone = remembering(None)
    calibration = replace(alone, effects=(*alone.effects, steady), reference={"start": UNTIMED, "hours": 1.975,
                                                                              "mean.rail": 23.0})  # fmt: skip
    found = residuals(untimed(whole()).subset(own), replace(calibration, visits=first))
    together = residuals(untimed(whole()), calibration)
    # what later visits read of their loads is not known to it: by 0.02 nm
    np.testing.assert_allclose(found, together[own], atol=1e-9)
    assert replace(calibration, visits=first).fitted(untimed(whole()).subset(own)) == (own < FIRST).sum()


def test_without_times_a_pose_that_comes_back_is_no_visit_of_before() -> None:
    first, again = untimed(whole().subset(np.arange(VISITS) < FIRST)), [*range(20, 22), *range(FIRST, VISITS)]
    joined, rows = earlier.continued(first, untimed(whole()).subset(np.array(again)))
    assert len(joined) == FIRST + len(again)
    assert rows.sum() == len(again)
    assert rows[FIRST:].all()


def test_a_pause_as_long_as_the_recording_had_itself_is_no_end() -> None:
    first, recording = whole().subset(np.arange(VISITS) < FIRST), replace(later(), time=later().time + 2 * HOUR)
    slept = replace(first, time=first.time - 3 * HOUR * (np.arange(FIRST) < 20))
    assert not earlier.goes_on(first, float(recording.time[0]))
    assert earlier.goes_on(slept, float(recording.time[0]))
    assert earlier.continued(slept, recording)[1].sum() == VISITS - FIRST
    assert not earlier.goes_on(first, float(first.time[0]) - HOUR)


def running_on() -> Calibration:
    """Made from 2 hours of visits, beside a base that ran 0.1 mm an hour, and half a millimetre that died away within
    0.2 hours from the first visit on; and creep of what hung there then."""
    first = whole().subset(np.arange(VISITS) < FIRST)
    creeping = {"frame": FRAME, "component": RX, "tau": 0.1}
    columns = (
        Column("frame", "clock", {"form": "linear"}, 0, 1),
        Column("frame", "clock", {"form": "exponential", "tau": 0.2}, 0, 1),
        Column("frame", "creeping", {**creeping, "form": "first"}, FRAME, RX),
        Column("frame", "creeping", {**creeping, "form": "began"}, FRAME, RX),
    )
    drift = Effect("drift", None, columns, (1e-4, 5e-4, 1e-9, 1e-9), (1e-6,) * 4, "by hand")
    reference = {"start": float(first.time[0]), "hours": 2.0}
    provenance = {**base().provenance, "recording_sha256": "of what it was made from"}
    return replace(base(), effects=(drift,), reference=reference, visits=first, provenance=provenance)


@pytest.mark.parametrize(("hours", "expected"), [
    (-50.0, 0.0), (-1.5, 0.0), (-0.5, 0.5e-4), (1.5, 6.5e-4), (3.5, 8.5e-4), (30.0, 7e-4),
])  # fmt: skip
def test_what_runs_on_with_time_is_not_carried_on_to_where_nobody_knows(hours: float, expected: float) -> None:
    """Long before the start as at the start, long after the end as at the end, else for as long as it was seen to run.
    A first visit an hour before the start was predicted 58 m off, by e^(t/tau)."""
    then = replace(later().subset(np.array([30])), time=whole().time[:1] + hours * HOUR)
    if hours == 3.5:  # goes on from what came an hour before, as the calibration's own did
        found = running_on()
        assert found.visits is not None
        times = np.append(found.visits.time[:-1], whole().time[0] + 2.9 * HOUR)
        calibration = replace(found, visits=replace(found.visits, time=times))
    else:
        calibration = running_on()
    moved = residuals(then, replace(calibration, effects=())) - residuals(then, calibration)
    along = moved[0].mean(axis=0)
    assert np.linalg.norm(along) == pytest.approx(expected, abs=2e-5)
    answer = evaluate(then, base().machine, calibration)
    assert ("held_in_time" in answer) == (hours in (-50.0, -1.5, 30.0))


def test_what_fades_is_held_nowhere() -> None:
    then = replace(later().subset(np.array([30])), time=whole().time[:1] + 30.0 * HOUR)
    wave = Column("frame", "clock", {"form": "cosine", "tau": 2}, 0, 0)
    for columns, held in (((wave,), False), ((wave, replace(wave, args={"form": "linear"})), True)):
        drift = Effect("drift", None, columns, (1e-4,) * len(columns), (1e-6,) * len(columns), "by hand")
        assert ("held_in_time" in evaluate(then, base().machine, replace(running_on(), effects=(drift,)))) == held


def test_a_turn_that_was_seen_for_half_an_hour_is_carried_on_for_another() -> None:
    """What a drift's waves left of the last 38 minutes ran on for four hours: 0.43 mm, 0.09 without (sealed 56076)."""
    visits = later().subset(np.arange(6))
    hours = np.array([0.5, 1.4, 1.5, 2.0, 2.3, 3.5])
    first = replace(visits, time=whole().time[0] + hours * HOUR)
    frozen = {"start": float(whole().time[0]), "hours": 2.0}
    c = Context.of(base().model, base().theta, first, base().measuring_in_base, frozen)
    np.testing.assert_allclose(clock(c, "ramp", 1.5), [0.0, 0.0, 0.0, 0.5, 0.8, 1.0], atol=1e-9)
    np.testing.assert_allclose(clock(c, "until", 1.5), [0.5, 1.4, 1.5, 1.5, 1.5, 1.5], atol=1e-9)


def test_what_wandered_is_forgotten_as_fast_as_it_changed() -> None:
    """Held where it was at the end, a base that wandered made 150 later visits 0.165 mm of 0.126 (sealed 60040)."""
    radian = 2.0 / (3.0 * np.pi)  # of three half waves over two hours
    hours = np.array([-radian, 0.0, 2.0 / 3.0, 2.0, 2.0 + radian, 2.0 + 2.0 * radian])
    visits = replace(later().subset(np.arange(6)), time=whole().time[0] + hours * HOUR)
    frozen = {"start": float(whole().time[0]), "hours": 2.0}
    c = Context.of(base().model, base().theta, visits, base().measuring_in_base, frozen)
    once, twice = 0.36787944, 0.13533528  # 1/e, 1/e²
    np.testing.assert_allclose(clock(c, "cosine", 3), [once, 1.0, -1.0, -1.0, -once, -twice], atol=1e-7)
    # a recording that begins more than an hour later, where other courses are held: it came back at its full size
    a_day = replace(later().subset(np.arange(3)), time=whole().time[0] + (2.0 + np.array([1.05, 1.5, 24.0])) * HOUR)
    c = Context.of(base().model, base().theta, a_day, base().measuring_in_base, dict(frozen))
    assert set(clock(c, "linear")) == {2.0}
    np.testing.assert_allclose(clock(c, "cosine", 3), -np.exp(-np.array([1.05, 1.5, 24.0]) / radian), atol=1e-7)


def test_what_runs_on_is_said_to_where_no_time_is_known() -> None:
    nobody_knows = untimed(later().subset(np.array([30])))
    assert evaluate(nobody_knows, base().machine, running_on())["untimed"] == ["drift"]
    assert "untimed" not in evaluate(later().subset(np.array([30])), base().machine, running_on())


def test_a_jump_at_some_moment_is_said_to_where_no_time_is_known() -> None:
    nobody_knows = untimed(later().subset(np.array([30])))
    jump = Effect(
        "zero_shift", "yaw", (Column("frame", "step", {"visit_time": 1.2}, 4, 5),), (1e-4,), (1e-6,), "by hand"
    )
    steady = Effect("backlash", "yaw", (Column("frame", "approach", {"joint": 3}, 4, 5),), (1e-5,), (1e-6,), "by hand")
    there = Effect("target_moved", None, (Column("points", "target_shift", {"target": 0, "axis": 0, "since": -1.0}),),
                   (1e-5,), (1e-6,), "by hand")  # fmt: skip
    calibration = replace(running_on(), effects=(jump, steady, there))
    assert evaluate(nobody_knows, base().machine, calibration)["untimed"] == ["zero shift of yaw"]


def test_another_load_under_a_label_stays_another() -> None:
    first = whole().subset(np.arange(VISITS) < FIRST)
    recording = replace(later(), load=(first.load[-1],) * (VISITS - FIRST))
    heavy = replace(recording, wrench=recording.wrench * 0 + np.array([0, 0, -3000.0, 0, 0, 0]))
    joined, rows = earlier.continued(first, heavy)
    assert f"earlier {first.load[-1]}" in joined.load
    assert joined.load[-1] == first.load[-1]
    assert rows.sum() == len(heavy)
    same = replace(first, load=("box",) * FIRST, wrench=first.wrench * 0 + 100.0)
    on = replace(recording, load=("box",) * len(recording), wrench=recording.wrench * 0 + 101.0)
    assert set(earlier.continued(same, on)[0].load) == {"box"}


def test_a_column_that_one_of_them_lacks_is_unknown_there() -> None:
    first = replace(whole().subset(np.arange(VISITS) < FIRST), covariates={})
    joined, rows = earlier.continued(first, later())
    np.testing.assert_array_equal(joined.covariates["n"][rows], later().covariates["n"])
    assert np.isnan(joined.covariates["n"][~rows]).all()


@pytest.mark.parametrize("who", ["earlier", "later", "both"])
def test_ages_of_loads_go_on_whoever_has_them(who: str) -> None:
    """A campaign's database has them, a table made by hand may not: either was indexed beyond its end."""
    first, then = whole().subset(np.arange(VISITS) < FIRST), later()
    if who != "later":
        first = replace(first, load_age_s=np.arange(1.0, FIRST + 1))
    if who != "earlier":
        then = replace(
            then,
            load_age_s=np.arange(500.0, 500.0 + len(then)),
            copies=(3,),
            spikes={"rail": (5,)},
            silent={"air": (6,)},
        )
    joined, rows = earlier.continued(first, then)
    assert joined.load_age_s is not None
    for part, mine in ((first, ~rows), (then, rows)):
        ages = np.full(len(part), np.nan) if part.load_age_s is None else part.load_age_s
        np.testing.assert_array_equal(joined.load_age_s[mine], ages)
    if who != "earlier":
        assert (joined.copies, joined.spikes) == ((FIRST + 3,), {"rail": (FIRST + 5,)})
        assert joined.silent == {"air": (FIRST + 6,)}
    assert np.isfinite(residuals(then, remembering(first))).any()


def test_a_joined_recording_has_every_column_of_all_its_visits() -> None:
    ages = np.arange(1.0, VISITS + 1)
    aged = replace(whole(), load_age_s=ages)
    joined, _ = earlier.continued(aged.subset(np.arange(VISITS) < FIRST), aged.subset(np.arange(VISITS) >= FIRST))
    for field in fields(Recording):
        before, after = getattr(aged, field.name), getattr(joined, field.name)
        if hasattr(before, "__len__") and len(before) == VISITS:
            assert len(after) == VISITS, field.name


def test_a_calibration_keeps_its_visits_through_its_file(tmp_path: Path) -> None:
    before = whole().subset(np.arange(VISITS) < FIRST)
    calibration = remembering(replace(before, load_age_s=np.arange(1.0, FIRST + 1)))
    calibration.save(tmp_path / "cal.json")
    again = load_calibration(tmp_path / "cal.json", load_machine(PPS))
    np.testing.assert_array_equal(residuals(later(), again), residuals(later(), calibration))
    assert again.visits is not None
    assert calibration.visits is not None
    assert again.visits.load == calibration.visits.load
    assert again.visits.load_age_s is not None
    np.testing.assert_array_equal(again.visits.load_age_s, calibration.visits.load_age_s)
    assert again.visits.has_wrench
    assert not again.visits.seen.any()  # readings are not kept
    data = json.loads((tmp_path / "cal.json").read_text())
    for spoil, said in (
        ({"count": 7}, "cannot reshape"), ({"load": ["box"]}, "1 loads for 80 visits"), ({"data": "AAAA"}, "damaged"),
    ):  # fmt: skip
        spoilt = {**data, "visits": {**data["visits"], **spoil}}
        spoilt["content_sha256"] = content_digest(spoilt)
        (tmp_path / "bad.json").write_text(json.dumps(spoilt))
        with pytest.raises(CalibrationError, match=said):
            load_calibration(tmp_path / "bad.json", load_machine(PPS))


def test_the_command_says_that_a_recording_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant = Plant.from_file(PPS, seed=12, repeatability=0.0)
    csv = simulate_recording_csv(plant, tmp_path / "r.csv", 40, np.random.default_rng(3), "mixed", visits_per_load=5)
    table = read_table(csv)
    start = load_recording(csv, load_machine(PPS)).time[0]
    first = whole().subset(np.arange(VISITS) < FIRST)
    remembering(replace(first, time=first.time - first.time[-1] + start - 60.0)).save(tmp_path / "soon.json")
    remembering(replace(first, time=first.time - first.time[-1] + start - DAY)).save(tmp_path / "long_ago.json")
    assert len(table.rows) == 40
    common = ["evaluate", str(csv), "--machine", str(PPS), "--calibration"]
    assert main([*common, str(tmp_path / "soon.json")]) == 0
    assert "goes on from 80 visits" in capsys.readouterr().out
    assert main([*common, str(tmp_path / "long_ago.json"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["earlier_visits"] == 0


def test_visits_that_the_calibration_was_made_from_are_counted() -> None:
    calibration = remembering(whole().subset(np.arange(VISITS) < FIRST))
    answer = evaluate(whole().subset(np.arange(VISITS) >= FIRST - 7), base().machine, calibration)
    assert (answer["fitted_visits"], answer["earlier_visits"]) == (7, FIRST - 7)


def test_a_twin_goes_on_as_well() -> None:
    together = simulate(remembering(None), whole(), seed=4).points[FIRST:]
    visits = whole().subset(np.arange(VISITS) < FIRST)
    mine = [simulate(remembering(v), later(), seed=4).points for v in (visits, None)]
    # other draws of the noise, so what they have in common is compared: their difference is the memory's
    plain = [simulate(replace(remembering(None), effects=()), r, seed=4).points for r in (whole(), later())]
    np.testing.assert_allclose(mine[0] - plain[1], together - plain[0][FIRST:], atol=1e-9)
    assert rms(mine[1] - mine[0]) > 2e-5


def test_setpoints_soon_after_know_what_the_machine_did() -> None:
    visits = whole().subset(np.arange(VISITS) < FIRST)
    end, q, payload = float(visits.time[-1]), visits.q[-1], visits.wrench[-1]
    wanted = q + np.array([0, 0.05, 0, 0, 0, 0])

    def corrected(kept: Recording | None, after: Recording | None, pause: float) -> Array:
        move = Corrections(Compensator(remembering(kept)), after=after)
        return move(wanted, payload, q, Around(end + pause, visits.load[-1], {"rail": 24.0}))

    told, known, nothing = corrected(None, visits, 60.0), corrected(visits, None, 60.0), corrected(None, None, 60.0)
    np.testing.assert_array_equal(known, told)
    assert np.abs(known - nothing).max() > 2e-6
    np.testing.assert_array_equal(corrected(visits, None, DAY), corrected(None, None, DAY))
