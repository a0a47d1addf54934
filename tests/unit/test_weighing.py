"""The force sensor weighed against gravity, by its readings alone."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ppshw import diagnosis
from ppshw.diagnosis import standing
from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.found import Found
from ppshw.diagnosis.jumps import jumps_of_zeros
from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.library.by_instrument import LEAST_MISREAD, sensor_errors
from ppshw.diagnosis.library.by_instrument import weighed as what_it_reads
from ppshw.diagnosis.library.weighing import (
    Weighing,
    by_readings,
    reads_other,
    ruled_out,
    surely_misread,
    weigh,
)
from ppshw.diagnosis.nameless import nameless
from ppshw.diagnosis.parameters import numbers_of
from ppshw.diagnosis.sensor_words import _error, against_gravity, doubt, numbers_by_gravity
from ppshw.diagnosis.workspace import Workspace, prepare
from ppshw.kinematics import frames
from ppshw.recording import Recording
from ppshw.statics import gravity_in_sensor
from ppshw.terms.history import weighs
from ppshw.terms.shapes import Column, Context, named_column
from ppshw.terms.shapes.wrenches import gravity_at_sensor
from tests.unit.clean_case import clean_case
from tests.unit.search.by_hand import best_of, look, named

Array = NDArray[np.float64]
Reads = Callable[[Recording], Array]


@pytest.fixture(scope="module")
def space(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """An arm whose force sensor reads what hangs there."""
    machine, recording = clean_case(60534, "arm6", 200, 160, tmp_path_factory.mktemp("weighed"))
    return prepare(machine, recording, np.ones(len(recording), dtype=bool))


@pytest.fixture(scope="module")
def clean(space: Workspace) -> Context:
    return space.context


def reading(clean: Context, wrench: Array) -> Context:
    return replace(clean, recording=replace(clean.recording, wrench=wrench), reference={})


def weighed(c: Context) -> Weighing:
    found = weigh(c, list(sensor_errors(c)))
    assert found is not None
    return found


def test_a_sensor_that_reads_what_hangs_there_is_not_doubted(clean: Context) -> None:
    assert not reads_other(clean)
    assert weigh(clean, list(sensor_errors(clean))) is None
    assert doubt(clean) == ""


@pytest.mark.parametrize("as_built", [False, True])
def test_a_sound_sensor_is_not_doubted_in_whichever_pose_its_readings_hold(clean: Context, as_built: bool) -> None:
    """A link that bends by 6 mrad more turns gravity in the sensor by twice what is believed of one. A real one
    reads it so; readings that were worked out from masses hold in the pose as built, and simulated ones do."""
    r = clean.recording
    bends = np.zeros((len(r), clean.machine.n + 1, 6))
    bends[:, 2, 4] = 6e-3 * np.linalg.norm(r.wrench[:, :3], axis=1) / np.linalg.norm(r.wrench[:, :3], axis=1).max()
    chain, built = frames(clean.machine, r.q, bends), frames(clean.machine, r.q)
    mass = np.linalg.norm(r.wrench[:, :3], axis=1) / np.linalg.norm(clean.machine.gravity)
    held = np.column_stack([mass, 0.2 * mass, -0.1 * mass, 0.3 * mass])
    held = np.stack([held[np.array(r.load) == label].mean(axis=0) for label in r.load])
    read_in, other = (built, chain) if as_built else (chain, built)
    noise = np.random.default_rng(3).normal(size=(len(r), 6)) * [1.0, 1.0, 1.0, 0.3, 0.3, 0.3]
    wrench = weighs(held, gravity_in_sensor(clean.machine, read_in)) + noise
    bent = replace(reading(clean, wrench), chain=chain)
    away = wrench[:, :3] - mass[:, None] * gravity_in_sensor(clean.machine, other)
    assert np.abs(away).max() > 0.004 * np.abs(wrench[:, :3]).max()  # read in the other pose it would be doubted
    assert np.allclose(gravity_at_sensor(bent), gravity_in_sensor(clean.machine, read_in))
    assert not reads_other(bent)
    assert doubt(bent) == ""


def zero(r: Recording) -> Array:
    return r.wrench + np.array([0.0, 0.0, 40.0, 0.0, 0.0, 0.0])


def drift(r: Recording) -> Array:
    since = (r.time - r.time[0]) / 3600.0
    return r.wrench + since[:, None] * np.array([0.0, 12.0, 0.0, 0.0, 0.0, 0.0])


def gain(r: Recording) -> Array:
    return r.wrench * np.array([1.1, 1.0, 1.0, 1.0, 1.0, 1.0])


def leak(r: Recording) -> Array:
    out = r.wrench.copy()
    out[:, 0] += 0.05 * r.wrench[:, 2]  # into a moment, the payload could as well hang elsewhere and another force leak
    return out


def test_compliances_are_learnt_again_by_what_hangs_there_and_not_by_what_a_sensor_surely_misreads(
    space: Workspace,
) -> None:
    """Learnt with readings 49 N off they made up for the sensor's error, and what was left was a compliance that the
    file leaves out, of 0.94 (another author's 62010)."""
    since = (space.recording.time - space.recording.time[0]) / 3600.0
    read = space.recording.wrench + since[:, None] * np.array([30.0, 20.0, 25.0, 9.0, 7.0, 5.0])
    there = prepare(space.machine, replace(space.recording, wrench=read), space.fit)
    column = what_it_reads(there.context)
    assert column is not None
    tried = Tried(there, [Candidate("wrench_error", None, None, None, "load", (column,), way=1)], there.unit)
    clean = diagnosis._without(there, tried, [Found(0, ("wrench_error", None), 0.0, 9.0, read=True)])
    np.testing.assert_array_equal(clean.points, there.recording.points)  # nothing is taken off what the tracker read
    off = np.sqrt(((clean.wrench - space.recording.wrench) ** 2).mean(axis=0))
    was = np.sqrt(((read - space.recording.wrench) ** 2).mean(axis=0))
    assert (off < 0.5 * was).all()


@pytest.mark.parametrize(
    ("reads", "args", "value"),
    [
        (zero, {"component": 2}, 40.0),
        (drift, {"component": 1, "time": "linear"}, None),
        (gain, {"component": 0, "source": 0}, 0.1),
        (leak, {"component": 0, "source": 2}, 0.05),
    ],
)
def test_its_readings_alone_say_which_error_it_is(
    clean: Context, reads: Reads, args: dict[str, object], value: float | None
) -> None:
    c = reading(clean, reads(clean.recording))
    found = weighed(c)
    first = found.forms[0]
    assert found.one_form
    assert [column.args for column in first.form.columns] == [args]
    if value is not None:
        assert first.values[0] == pytest.approx(value, rel=0.01, abs=0.003)  # the base stands a few mrad askew


def test_what_another_gravity_may_be_is_no_sure_error_of_the_sensor(clean: Context) -> None:
    for reads in (zero, drift, gain, leak):
        assert surely_misread(reading(clean, reads(clean.recording))), reads.__name__
    assert not surely_misread(clean)
    turned = Rotation.from_rotvec([0.03, 0.02, 0.0]).apply(clean.machine.gravity)
    askew = replace(clean, machine=replace(clean.machine, gravity=turned))
    assert reads_other(askew)
    assert not surely_misread(askew)


def test_what_other_payloads_under_one_label_may_be_is_no_sure_error_of_the_sensor(tmp_path: Path) -> None:
    """On a positioner, which hardly tilts, they look like other zeros."""
    machine, recording = clean_case(60533, "pps", 140, 120, tmp_path)
    level = prepare(machine, recording, np.ones(len(recording), dtype=bool)).context
    stays = named_column(level, "mounting").astype(int)
    more = np.random.default_rng(4).uniform(0.0, 20.0, stays.max() + 1)[stays]  # kg
    held = more[:, None] * np.array([1.0, 0.3, 0.1, 0.2])
    others = reading(level, recording.wrench + weighs(held, gravity_at_sensor(level)))
    others = replace(others, recording=replace(others.recording, load=tuple(np.where(stays % 2, "patient", "other"))))
    assert reads_other(others)
    assert not surely_misread(others)


@pytest.mark.long
def test_what_readings_surely_show_is_found_whatever_deflections_say(space: Workspace) -> None:
    """Of a sensor whose Fx was 300 N off nothing was said, as the base model's compliances had made up for it."""
    there = replace(space, context=reading(space.context, leak(space.recording)))
    found, tried = look(there, ["wrench_error"], "j2")
    assert [(f.name, f.read) for f in found] == [(("wrench_error", None), True)]
    assert found[0].weights == {("wrench_error", None): pytest.approx(0.95), ("nameless", None): pytest.approx(0.05)}
    assert there.taken_prior.max() <= 1.0
    assert not look(space, ["wrench_error"], "j2")[0]
    assert best_of(tried, found[0]).columns[0].function == "weighed"


def test_a_channel_that_bends_nothing_is_found_where_readings_surely_show_its_error(space: Workspace) -> None:
    """My of a positioner's upright axes was 31 N m off and moved reflectors by 1.3 µm: there was a doubt and no finding
    (sealed 63000)."""
    stiff = replace(space.context, compliance=0.01 * space.context.compliance)
    there = replace(space, context=reading(stiff, leak(space.recording)))
    moved = Column("frames", "weighed", {}).evaluate(there.context)
    assert 0.0 < np.sqrt(3 * (moved**2).mean()) < LEAST_MISREAD
    found, _ = look(there, ["wrench_error"], "j2")
    assert [(f.name, f.read) for f in found] == [(("wrench_error", None), True)]
    little = reading(stiff, 0.25 * leak(space.recording) + 0.75 * space.recording.wrench)
    assert reads_other(little)
    assert not surely_misread(little)
    assert what_it_reads(little) is None


@pytest.mark.parametrize("sure", [True, False])
def test_an_error_of_the_sensor_that_readings_surely_show_is_not_given_up(
    space: Workspace, monkeypatch: pytest.MonkeyPatch, sure: bool
) -> None:
    """Any function of a load says as much of cross-talk that saturates, and is what is given in its place else."""
    sensor = next(sensor_errors(space.context))
    tried = Tried(space, [sensor, named(space, "nameless")[0]], 5e-5)
    name = ("wrench_error", None)
    monkeypatch.setattr(standing, "surely_reads_other", lambda *_: sure)
    monkeypatch.setattr(standing, "_asked", lambda *_: standing._Answer(9.0, 12.0, 1, False))
    found = [Found(0, name, 1e-9, 9.0, first=9.0)]
    standing.give_up(space, tried, found)
    assert [f.name for f in found] == [name if sure else ("nameless", None)]


@pytest.mark.long
def test_rivals_without_a_name_are_not_weighed_against_the_readings(
    space: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One was 70,000 times as likely then, and another's covariate a temperature that it does not go with."""
    warm = np.linspace(0.0, 1.0, len(space.recording)) ** 2
    read = space.recording.wrench + np.outer(warm, [30.0, 20.0, -25.0, 0.0, 0.0, 0.0])
    there = replace(space, context=reading(space.context, read))
    assert reads_other(there.context)
    monkeypatch.setattr(diagnosis, "search", lambda *_: [])
    tried, _ = diagnosis._look(there, frozenset(), 0, [], {}, [], lambda k: None)
    rivals = [k for k in tried.candidates if k.effect == "nameless"]
    most = diagnosis.COLUMNS_PER_VISIT * int(there.fit.sum())
    alone = [k for k in nameless(there.context, jumps_of_zeros(there)) if most >= len(k.columns)]
    assert [(k.share, k.covariate) for k in rivals] == [(k.share, k.covariate) for k in alone]
    assert {k.effect for k in tried.ruled_out} <= {"wrench_error"}


def test_several_numbers_are_not_told_by_readings_that_may_be_another_payload(clean: Context) -> None:
    """A leak of 0.05 was two of 0.0250 ± 0.0004 (a reviewer's)."""
    whole = max((k for k in sensor_errors(clean) if "source" in k.columns[0].args), key=lambda k: len(k.columns))
    assert len(whole.columns) > 6
    assert by_readings(reading(clean, leak(clean.recording)), whole) is None


def test_a_form_is_told_by_the_readings_where_it_is_all_that_they_show(clean: Context) -> None:
    """14.1 ± 1.1 N m were said of 12 by deflections, where the readings know 12.0 ± 0.1 (a reviewer's)."""
    of_fz, of_mx = (next(k for k in sensor_errors(clean) if [x.args for x in k.columns] == [{"component": n}])
                    for n in (2, 3))  # fmt: skip
    c = reading(clean, zero(clean.recording))
    told = by_readings(c, of_fz)
    assert told is not None
    assert told.values[0] == pytest.approx(40.0, rel=0.01)
    assert by_readings(c, of_mx) is None
    assert by_readings(clean, of_fz) is None


@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize(("axis", "degrees"), [(0, 10.0), (1, -4.0), (2, 25.0)])
def test_a_sensor_that_is_mounted_turned_says_by_how_much(
    clean: Context, noise: float, axis: int, degrees: float
) -> None:
    """A matrix of 36 numbers said a ten-thousandth more where the sensor had no noise."""
    r = clean.recording
    turn = Rotation.from_rotvec(np.radians(degrees) * np.eye(3)[axis]).inv()
    read = np.concatenate([turn.apply(r.wrench[:, :3]), turn.apply(r.wrench[:, 3:])], axis=1)
    c = reading(clean, read + np.random.default_rng(5).normal(0.0, noise, read.shape) * [1.0, 1.0, 1.0, 0.3, 0.3, 0.3])
    found = weighed(c)
    assert found.one_form
    assert [column.args.get("turned") for column in found.forms[0].form.columns] == [axis] * 2
    assert found.forms[0].values[0] == pytest.approx(np.sin(np.radians(degrees)), abs=2e-3)
    assert found.forms[0].values[1] == pytest.approx(1.0 - np.cos(np.radians(degrees)), abs=4e-3)
    said = re.search(r"as if it were mounted turned by (-?\d+\.\d)° about its ([xyz])$", against_gravity(c))
    assert said is not None
    assert float(said[1]) == pytest.approx(degrees, abs=0.15)  # the base stands a few mrad askew
    assert said[2] == "xyz"[axis]


def test_a_sensor_that_is_mounted_askew_says_about_which_axes(clean: Context) -> None:
    r = clean.recording
    turn = Rotation.from_rotvec([0.03, 0.0, -0.05]).inv()
    read = np.concatenate([turn.apply(r.wrench[:, :3]), turn.apply(r.wrench[:, 3:])], axis=1)
    noise = np.random.default_rng(5).normal(0.0, 1.0, read.shape) * [1.0, 1.0, 1.0, 0.3, 0.3, 0.3]
    first = weighed(reading(clean, read + noise)).forms[0]
    assert [column.args.get("turned") for column in first.form.columns] == [0, 1, 2]
    np.testing.assert_allclose(first.values, [0.03, 0.0, -0.05], atol=3e-3)


def test_a_zero_that_jumps_says_when(clean: Context) -> None:
    at, r = 90, clean.recording
    off = np.where(np.arange(len(r)) < at, 0.0, 8.0)
    c = reading(clean, r.wrench + off[:, None] * np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0]))
    first = weighed(c).forms[0].form
    assert (first.covariate, first.columns[0].args["time"]) == ("Mx", "step")
    apart = max(3 * float(np.diff(c.hours).max()), float(c.hours[-1]) / 30)
    assert abs(first.shape["time_h"] - c.hours[at]) < apart


def test_what_weighing_says_is_told_with_the_channel_and_its_numbers(clean: Context) -> None:
    c = reading(clean, zero(clean.recording))
    assert " rms, Fz_zero 40 ± " in against_gravity(c)
    assert doubt(c).startswith("the force sensor reads other than what hangs there weighs, ")
    gains = against_gravity(reading(clean, gain(clean.recording)))
    assert gains.endswith("Fx_by_Fx 0.0992 ± 0.00085")  # a share has no unit
    found = weighed(reading(clean, gain(clean.recording)))
    first = replace(found.forms[0], covariance=np.array([[0.01**2]]))  # whose last digit is one
    assert _error(replace(found, forms=(first, *found.forms[1:]))).endswith("Fx_by_Fx 0.0992 ± 0.01")


def test_a_channel_that_reads_another_is_said_to_be_off_not_those_in_which_it_shows(clean: Context) -> None:
    """A payload takes most of what Mx reads of Fz, and leaves the rest to Mz: "reads Mz by 5.7 N m" (a reviewer's)."""
    r, leak = clean.recording, np.zeros((len(clean.recording), 6))
    leak[:, 3] = 0.04 * r.wrench[:, 2]
    c = reading(clean, r.wrench + leak)
    said = re.match(r"Mx by (\S+) N m rms, Mx_by_Fz 0\.0\d+ ± \S+ N m/N$", against_gravity(c))
    assert said
    assert float(said[1]) == pytest.approx(np.sqrt(np.mean(leak[:, 3] ** 2)), rel=0.03)
    (number,) = numbers_by_gravity(c)
    assert (number.name, number.unit) == ("Mx_by_Fz", "N m/N")
    assert number.value == pytest.approx(0.04, abs=max(4 * number.std, 1e-4))
    assert numbers_by_gravity(clean) == []
    column = what_it_reads(c)
    assert column is not None
    whole = Candidate("wrench_error", None, None, None, "Fz", (column,))
    told = numbers_of(c, whole, np.ones(1), np.eye(1))["Mx_by_Fz"]
    assert told == {"value": number.value, "std": number.std, "unit": number.unit}


def test_other_zeros_after_every_change_of_the_load_are_that(clean: Context) -> None:
    labels = np.array(clean.recording.load)
    stays = np.concatenate([[0], np.cumsum(labels[1:] != labels[:-1])])
    zeros = np.random.default_rng(3).normal(0.0, [30.0, 30.0, 30.0, 6.0, 6.0, 6.0], (stays.max() + 1, 6))
    c = reading(clean, clean.recording.wrench + zeros[stays])
    assert weighed(c).forms[0].form.covariate == "since_load_change"
    assert against_gravity(c).endswith("other zeros after every change of the load")


def test_errors_that_its_readings_leave_no_room_for_are_not_asked_for(clean: Context) -> None:
    """A zero that wandered by as much as creep had left said more than creep by its form (another author's 35019)."""
    forms = list(sensor_errors(clean))
    out = {id(k) for k in ruled_out(clean, forms)}
    kept = [k for k in forms if id(k) not in out]
    wandering = [k for k in forms if k.covariate == "time" and k.columns[0].args["component"] >= 0]
    assert wandering
    assert not {id(k) for k in wandering} - out
    alone = [k.columns[0].args for k in kept if len(k.columns) == 1]
    assert alone
    assert all(args["component"] < 0 for args in alone)  # all channels' gain alike, which no payload weighs


def test_a_whole_matrix_is_asked_for_where_readings_show_more_of_it_than_another_payload(clean: Context) -> None:
    """It took the missing compliance of a last link, with cross-talk of 0.7 N/(N m) that no reading showed."""

    def asked(c: Context) -> bool:
        forms = list(sensor_errors(c))
        out = {id(k) for k in ruled_out(c, forms)}
        whole = [k for k in forms if len(k.columns) == 36 and "source" in k.columns[0].args]
        return id(whole[0]) not in out

    assert not asked(clean)
    crossed = clean.recording.wrench @ (np.eye(6) + 0.05 * np.random.default_rng(3).normal(size=(6, 6)))
    assert asked(reading(clean, crossed))
    # other gains of forces and moments, and a sensor that sits elsewhere, weigh another payload
    elsewhere = clean.recording.wrench * ([1.05] * 3 + [0.9] * 3)
    elsewhere[:, 3:] += np.cross([0.02, -0.01, 0.03], elsewhere[:, :3])
    assert not asked(reading(clean, elsewhere))


def test_errors_that_its_readings_show_or_cannot_show_are_asked_for(clean: Context) -> None:
    c = reading(clean, drift(clean.recording))
    forms = list(sensor_errors(c))
    out = {id(k) for k in ruled_out(c, forms)}
    drifts = [k for k in forms if [x.args for x in k.columns] == [{"component": 1, "time": "linear"}]]
    assert len(drifts) == 1
    assert id(drifts[0]) not in out
    unlabelled = replace(clean, recording=replace(clean.recording, load=("",) * len(clean.recording)))
    assert ruled_out(unlabelled, list(sensor_errors(unlabelled))) == []
