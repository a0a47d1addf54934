"""The numbers of a finding: what a metrologist would call it by, as far as it goes, and how surely."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.library import Candidate, library
from ppshw.diagnosis.library.sampled import called, own_component
from ppshw.diagnosis.parameters import is_of, numbers_of, spread_of
from ppshw.diagnosis.wording import sentence
from ppshw.diagnosis.workspace import Workspace, prepare
from ppshw.terms import COMPONENTS
from ppshw.terms.history import slip, weighs, wind_up
from ppshw.terms.shapes import Column, Context, named_column
from ppshw.terms.shapes.context import ALONG
from ppshw.terms.shapes.wrenches import by_payload, gravity_at_sensor, payloads_of
from tests.unit.clean_case import clean_case

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def space(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    machine, recording = clean_case(60541, "pps", 160, 160, tmp_path_factory.mktemp("clean"))
    return prepare(machine, recording, np.ones(len(recording), dtype=bool))


def test_a_drift_is_said_as_how_far_it_goes_each_way(space: Workspace) -> None:
    c = space.context
    wanders = next(k for k in library(c) if k.effect == "drift" and len(k.columns) == 12
                   and k.columns[0].args["form"] == "cosine" and k.columns[-1].component == 2)  # fmt: skip
    values = np.zeros(12)
    values[:4] = [5e-5, 0.0, 1e-5, 0.0]  # tx: half a wave and a whole one and a half over the time
    values[9] = -2e-5  # tz: one whole wave, so there and back
    x = c.hours / c.hours[-1]
    along_x = 5e-5 * np.cos(np.pi * x) + 1e-5 * np.cos(3 * np.pi * x)
    covariance = np.diag(np.linspace(1e-6, 2e-6, 12) ** 2)
    said = numbers_of(c, wanders, values, covariance)
    assert list(said) == ["change_tx", "change_ty", "change_tz"]
    assert said["change_tx"]["value"] == pytest.approx(along_x[-1] - along_x[0], rel=1e-9)
    assert said["change_tx"]["unit"] == "m"
    # of the first and the last visit only waves of odd order differ, by two each
    of_odd = 2 * np.sqrt(covariance[0, 0] + covariance[2, 2])
    assert said["change_tx"]["std"] == pytest.approx(of_odd, rel=1e-6)
    assert said["change_ty"]["value"] == 0.0
    assert abs(said["change_tz"]["value"]) == pytest.approx(4e-5, rel=1e-3)
    assert "moves slowly with time, by 0.120 mm along x, as if" in sentence(c, wanders, values, 1e-4)
    assert sentence(c, wanders, values, 1e-4, 4.9e-5).endswith(
        "(0.100 mm rms at the reflectors, of which a base calibration leaves 0.049 mm)."
    )
    assert "leaves" not in sentence(c, wanders, values, 1e-4, 5.1e-5)  # most of it shows


def test_a_drift_that_shifts_and_turns_says_both(space: Workspace) -> None:
    settles = next(
        k for k in library(space.context)
        if k.effect == "drift" and len(k.columns) == 6 and k.columns[0].args["form"] == "exponential"
    )  # fmt: skip
    values = np.array([0.0, 1e-4, 2e-5, 0.0, 0.0, -3e-5])
    said = numbers_of(space.context, settles, values, np.eye(6))
    assert list(said) == [f"change_{name}" for name in ("tx", "ty", "tz", "rx", "ry", "rz")] + ["tau_h"]
    assert said["change_rz"]["unit"] == "rad"
    assert said["change_rz"]["value"] < 0 < said["change_ty"]["value"]
    told = sentence(space.context, settles, values, 1e-4)
    assert " mm along y and by 0.030 mrad about z, as if" in told


def test_a_coupling_is_said_as_its_height_whatever_functions_make_it(space: Workspace) -> None:
    c = space.context
    couplings = [k for k in library(c) if k.effect == "cross_coupling" and k.joint == "lateral"]
    for size in (1, 36):
        coupling = next(k for k in couplings if len(k.columns) == size and k.covariate == "q_vertical")
        values = np.zeros(size)
        values[0] = 1e-4
        course = 1e-4 * coupling.columns[0].value(c)
        said = numbers_of(c, coupling, values, 1e-12 * np.eye(size))
        assert list(said) == ["peak_to_valley"]
        assert said["peak_to_valley"]["value"] == pytest.approx(np.ptp(course), rel=1e-12)
        assert said["peak_to_valley"]["std"] > 0
        unit = "mm" if str(coupling.component).startswith("t") else "mrad"
        told = sentence(c, coupling, values, 1e-4)
        assert f"as well, by {np.ptp(course) * 1e3:.3f} {unit} from peak to valley (" in told


def test_a_zero_that_wanders_is_said_as_how_far_it_goes_in_newtons(space: Workspace) -> None:
    wanders = next(
        k for k in library(space.context)
        if k.effect == "wrench_error" and len(k.columns) == 4 and k.columns[0].args.get("time") == "cosine"
        and k.columns[0].args["component"] == 1
    )  # fmt: skip
    said = numbers_of(space.context, wanders, np.array([3.0, 0.0, 0.0, 0.0]), np.eye(4))
    assert list(said) == ["Fy_zero_change"]
    assert (said["Fy_zero_change"]["value"], said["Fy_zero_change"]["unit"]) == (pytest.approx(-6.0), "N")


def test_a_scale_and_a_growth_are_said_with_their_size(space: Workspace) -> None:
    some = library(space.context)
    scale = next(k for k in some if k.effect == "tracker_scale" and [c.on for c in k.columns] == ["points"] * 2)
    said = sentence(space.context, scale, np.array([4.38e-5, -1.2e-6]), 1e-4)
    middle = np.mean(space.recording.temperatures[scale.columns[1].args["place"]])
    assert f"by a factor, by 43.8 ppm at {middle:.1f} °C and -1.2 ppm per kelvin of {scale.covariate} (" in said
    by_pressure = next(k for k in some if k.effect == "tracker_scale" and k.covariate == "cov_pressure")
    said = sentence(space.context, by_pressure, np.array([2.7e-7]), 1e-4)
    assert "by a factor, by 0.27 ppm per unit of cov_pressure (" in said
    beside = next(k for k in some if k.covariate == "cov_pressure" and [c.on for c in k.columns] == ["points"] * 2)
    middle = np.mean(named_column(space.context, "cov_pressure"))
    said = sentence(space.context, beside, np.array([4e-5, 2.7e-7]), 1e-4)
    assert f"by a factor, by 40 ppm at {middle:.5g} and 0.27 ppm per unit of cov_pressure (" in said
    grows = next(k for k in some if k.effect == "thermal_growth" and k.columns[0].function == "link_growth")
    assert " by 11.5 ppm per kelvin: its" in sentence(space.context, grows, np.array([1.15e-5]), 1e-4)
    shifts = next(k for k in some if k.effect == "thermal_growth" and k.component == "tx" and len(k.columns) == 1)
    assert " by 20 µm per kelvin: its" in sentence(space.context, shifts, np.array([2e-5]), 1e-4)
    rail = next(k for k in some if k.columns[-1].function == "temperature_q" and k.component == "tx")
    said = sentence(space.context, rail, np.array([-1.6e-6, 1.44e-5]), 1e-4)
    assert " by -16 µm per kelvin at one end of its travel, 12.8 at the other: its" in said
    any_way = next(k for k in some if k.effect == "thermal_growth" and len(k.columns) == 6)
    assert f"moves with {any_way.covariate}: its" in sentence(space.context, any_way, np.full(6, 1e-5), 1e-4)


def test_a_constant_scale_holds_where_its_numbers_say(space: Workspace) -> None:
    c = space.context
    scale = next(k for k in library(c) if k.effect == "tracker_scale" and [c.on for c in k.columns] == ["points"] * 2)
    said = {name: entry["value"] for name, entry in numbers_of(c, scale, np.array([4e-5, -2e-6]), np.eye(2)).items()}
    warm = space.recording.temperatures[scale.columns[1].args["place"]]
    longer = said["scale"] + said["scale_per_K"] * (warm - said["scale_holds_at"])
    plain = Column("points", "scale").value(c)
    laid = sum(v * column.value(c) for v, column in zip((4e-5, -2e-6), scale.columns, strict=True))
    np.testing.assert_allclose(laid, longer[:, None, None] * plain, atol=1e-12)
    alone = next(k for k in library(c) if k.effect == "tracker_scale" and len(k.columns) == 1)
    assert list(numbers_of(c, alone, np.array([4e-5]), np.eye(1))) == ["scale"]


def test_a_lag_is_of_either_side_and_a_gap_of_both() -> None:
    """What a joint lost is taken up evenly over twice the width, or but for a part of e⁻¹ over each."""
    turned, after = np.array([1, -1, -1, -1]), np.array([0.0, -0.1, -0.2, -0.5])
    np.testing.assert_allclose(slip(after, turned, 0.1), [1.0, 0.0, -1.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(wind_up(after, turned, 0.1), 2 * np.exp(after / 0.1) - 1.0, atol=1e-12)


def test_lost_motion_lag_and_gap_are_half_and_whole_of_what_the_sentence_says(space: Workspace) -> None:
    c, some = space.context, library(space.context)
    friction = next(k for k in some if k.effect == "friction_hysteresis" and len(k.columns) == 1)
    gap = next(k for k in some if k.effect == "backlash" and k.joint == friction.joint and len(k.columns) == 1)
    for candidate, name, size in ((friction, "lag", 5e-5), (gap, "gap", 1e-4)):
        assert numbers_of(c, candidate, np.array([-5e-5]), np.eye(1))[name]["value"] == pytest.approx(size)
        assert " by 0.100 m" in sentence(c, candidate, np.array([-5e-5]), 1e-4).replace("up to", "by")


def test_a_wave_s_phase_is_of_its_sine_where_the_joint_stands_at_zero(space: Workspace) -> None:
    c = space.context
    wave = Column("frame", "wave", {"joint": 1, "period": 0.01, "phase": "sin"}, 2, 1)
    columns = (wave, replace(wave, args={**wave.args, "phase": "cos"}))
    candidate = Candidate(
        "periodic_transmission", "vertical", "vertical", "ty", "q_vertical", columns, {"period": 0.01}
    )
    said = {
        name: entry["value"] for name, entry in numbers_of(c, candidate, np.array([3e-5, -4e-5]), np.eye(2)).items()
    }
    laid = 3e-5 * columns[0].value(c) - 4e-5 * columns[1].value(c)
    angle = 2 * np.pi * space.recording.q[:, 1] / said["period"] + said["phase"]
    np.testing.assert_allclose(laid, said["amplitude"] * np.sin(angle), atol=1e-15)


def test_a_share_of_creep_is_what_of_the_deflection_has_not_come_at_the_change(space: Workspace) -> None:
    c = space.context
    load, hours = space.recording.load, c.hours
    first = next(k for k in range(1, len(load)) if load[k] != load[k - 1])
    late = Column("frames", "creep", {"tau": 0.4, "form": "exponential", "frame": 3}).value(c)[first, 3]
    came = by_payload(c, payload_change(c, first))[first, 3]
    age = 0.5 * (hours[first] - hours[first - 1])
    np.testing.assert_allclose(late, -np.exp(-age / 0.4) * c.compliance[first, 3] @ came, rtol=1e-6, atol=1e-12)


def payload_change(c: Context, visit: int) -> Array:
    """(N, 6) at the sensor what the payload of a visit makes more than that of the visit before it."""
    held, g = payloads_of(c), gravity_at_sensor(c)
    return weighs((held[visit] - held[visit - 1])[None], g)


@pytest.mark.parametrize(
    ("only", "times", "said"),
    [
        ("forces", 1 / 9.80665, " read 0.102 times as large as they are, nearly as if in kilograms-force ("),
        ("forces", 0.9, "'s forces are read 0.9 times as large as they are ("),
        ("moments", 1e3, "'s moments are read 1e+03 times as large as they are, nearly as if in newton millimetres ("),
    ],
)
def test_forces_and_moments_in_other_units_are_said_to_be_that(
    space: Workspace, only: str, times: float, said: str
) -> None:
    gain = next(k for k in library(space.context) if k.columns[0].args.get("only") == only)
    values = np.array([1.0 - 1.0 / times])  # of what is read, too much
    assert said in sentence(space.context, gain, values, 1e-4)
    assert list(numbers_of(space.context, gain, values, np.eye(1))) == [f"gain_of_{only}"]


def test_a_sensor_that_is_mounted_turned_is_said_to_be_that(space: Workspace) -> None:
    turns = [k for k in library(space.context) if "turned" in k.columns[0].args]
    about_z = next(k for k in turns if k.columns[0].args["turned"] == 2)
    for angle, words in ((0.2, "11.5"), (2.0, "114.6"), (-2.5, "-143.2"), (np.pi, "180.0")):
        values = np.array([np.sin(angle), np.cos(angle) - 1.0])  # what is read is turned back
        said = sentence(space.context, about_z, values, 1e-4)
        assert f" reads as if it were mounted turned by {words}° about its z (" in said
        numbers = numbers_of(space.context, about_z, values, np.eye(2))
        assert list(numbers) == ["turned_z", "turned_z_versine"]
        assert numbers["turned_z"]["value"] == pytest.approx(np.sin(angle))
        assert numbers["turned_z_versine"]["value"] == pytest.approx(1.0 - np.cos(angle))
    askew = next(k for k in turns if len(k.columns) == 3)
    said = sentence(space.context, askew, np.array([0.02, 0.0, -0.05]), 1e-4)
    assert " turned by 1.1° about its x, 0.0° about its y and -2.9° about its z (" in said


@pytest.mark.parametrize(("axis", "times"), [([0, 0, -1.0], -1.0), ([0, 0.6, 0.8], 1.0), ([0, 0, 1.0], 1.0)])
def test_what_a_joint_does_is_said_along_its_own_axis(space: Workspace, axis: list[float], times: float) -> None:
    """A gap of 0.200 mm was -0.204 along an axis that points down; along an oblique one it was asked of the nearest of
    the frame's alone."""
    machine = space.machine
    k = next(j for j, joint in enumerate(machine.joints) if joint.prismatic and abs(joint.axis[2]) > 0.9)
    joint = machine.joints[k]
    turned = replace(machine, joints=tuple(
        replace(other, axis=np.array(axis)) if j == k else other for j, other in enumerate(machine.joints)
    ))  # fmt: skip
    c = replace(space.context, machine=turned)
    play, friction, jump = (
        next(x for x in library(c) if (x.effect, x.joint) == (effect, joint.name) and x.component == "tz")
        for effect in ("backlash", "friction_hysteresis", "zero_shift")
    )
    along = c.jacobian[:, :, k + 1, :3] @ (np.array(axis) * times)
    for form in (play, friction, jump):
        moved = form.columns[0].evaluate(c)
        assert moved == pytest.approx(form.columns[0].value(c)[:, None] * along, abs=1e-15)
    for form, name, factor in ((play, "gap", -2.0), (friction, "lag", -1.0), (jump, "step", 1.0)):
        values, covariance = np.zeros(len(form.columns)), np.eye(len(form.columns)) * 1e-12
        values[0] = -1e-4
        said = numbers_of(c, form, values, covariance)[name]
        assert said["value"] == pytest.approx(factor * times * -1e-4)
        assert said["std"] == pytest.approx(abs(factor * times) * 1e-6)
    half_a_gap = np.eye(len(play.columns))[0] * -1e-4
    said = sentence(c, play, half_a_gap, 1e-4)
    assert f"{'lags behind' if times > 0 else 'runs ahead'} by {0.2 * abs(times):.3f} mm" in said
    assert ("is a sign turned?" in said) == (times < 0)


@pytest.mark.parametrize(("tilt", "own"), [(0.0, 2), (1e-3, 2), (3e-3, ALONG)])
def test_an_axis_within_a_milliradian_of_its_frame_s_is_along_it(space: Workspace, tilt: float, own: int) -> None:
    k = next(j for j, joint in enumerate(space.machine.joints) if joint.prismatic)
    axis = np.array([0.0, np.sin(tilt), -np.cos(tilt)])
    joints = list(space.machine.joints)
    joints[k] = replace(joints[k], axis=axis)
    c = replace(space.context, machine=replace(space.machine, joints=tuple(joints)))
    assert own_component(c, k) == own
    assert called(c, k + 1, own) == "tz"
    expected = [0, 0, 1.0, 0, 0, 0] if own == 2 else [*axis, 0, 0, 0]
    assert c.direction(k + 1, own) == pytest.approx(expected)


def test_a_straight_drift_has_no_time_constant(space: Workspace) -> None:
    straight = [k for k in library(space.context) if k.effect == "drift" and k.columns[0].args.get("form") == "linear"]
    assert straight
    assert all("tau_h" not in k.shape for k in straight)


def test_a_period_comes_with_how_surely_it_is_known(space: Workspace) -> None:
    """The louder a wave, the surer its period, down to the grid it is sought on; the truth is within it."""
    joint = space.machine.joint_names.index("lateral")
    period = float(np.ptp(space.recording.q[:, joint])) / 10.37
    pair = [
        Column("frame", "wave", {"joint": joint, "period": period, "phase": p}, joint + 1, 0) for p in ("sin", "cos")
    ]
    field = pair[0].evaluate(space.context) + pair[1].evaluate(space.context)
    field *= space.unit / np.sqrt((field**2).sum() / space.recording.seen.sum())
    said = {}
    for size in (1.0, 5.0):
        loud = replace(space, data=space.data + size * field)
        candidates = [k for k in library(loud.context) if k.effect == "periodic_transmission" and k.joint == "lateral"]
        tried = Tried(loud, candidates, loud.unit)
        evidence = tried.said()[0]
        best = tried.strongest(evidence, 0)
        said[size] = spread_of(tried, best, evidence)["period"]
        assert abs(candidates[best].shape["period"] - period) < 3 * said[size]
    assert 0 < said[5.0] <= said[1.0]
    assert said[1.0] < 0.1 * period


def test_a_period_is_a_way_of_its_joint_whichever_component_errs(space: Workspace) -> None:
    units = {}
    for joint, component in (("longitudinal", "rx"), ("longitudinal", "tz"), ("yaw", "tx")):
        k = space.machine.joint_names.index(joint)
        wave = [
            Column("frame", "wave", {"joint": k, "period": 0.1, "phase": p}, k + 1, COMPONENTS.index(component))
            for p in ("sin", "cos")
        ]
        one = Candidate("periodic_transmission", joint, joint, component, f"q_{joint}", tuple(wave), {"period": 0.1})
        said = numbers_of(space.context, one, np.array([3e-5, 4e-5]), 1e-12 * np.eye(2), {"period": 2e-3})
        assert said["amplitude"]["value"] == pytest.approx(5e-5)
        assert said["period"]["std"] == 2e-3
        units[joint, component] = (said["amplitude"]["unit"], said["period"]["unit"])
    assert list(units.values()) == [("rad", "m"), ("m", "m"), ("m", "rad")]


def test_what_the_library_has_one_value_of_has_no_spread(space: Workspace) -> None:
    one = Candidate("zero_shift", "lateral", "lateral", "tx", "time",
                    (Column("frame", "step", {"visit_time": 1.0}, 1, 0),), {"time_h": 1.0})  # fmt: skip
    tried = Tried(space, [one], space.unit)
    assert spread_of(tried, 0, tried.said()[0]) == {}


def test_moments_are_a_grid_and_loads_are_not(space: Workspace) -> None:
    """A zero that hops is laid at several moments together; lags that go with two loads have numbers of two units."""
    hours = space.context.hours
    hops = [
        Candidate("zero_shift", "lateral", "lateral", "tx", "time",
                  (Column("frame", "hopping", {"times": moments}, 1, 0),), {"time_h": moments[0]})
        for moments in itertools.combinations(np.quantile(hours, [0.2, 0.3, 0.6]).tolist(), 2)
    ]  # fmt: skip
    tried = Tried(space, hops, space.unit)
    assert spread_of(tried, 0, np.zeros(len(hops)))["time_h"] > 0.0
    lags = [
        Candidate("friction_hysteresis", "lateral", "lateral", "tx", "move_lateral",
                  (Column("frame", "slipping", {"joint": 0, "width": width, **by}, 1, 0),), {"width": width})
        for width, by in ((0.1, {"tilted": 3}), (0.2, {"tilted": 5}), (0.3, {"pressed": -1}))
    ]  # fmt: skip
    tried = Tried(space, lags, space.unit)
    assert spread_of(tried, 0, np.zeros(len(lags))) == {}


def test_a_number_off_a_grid_is_as_sure_as_its_neighbours_let_it_be(space: Workspace) -> None:
    widths, shares = (0.1, 0.3, 0.4), (1.0, 1.0, 0.25)
    lags = [
        Candidate("friction_hysteresis", "lateral", "lateral", "tx", "move_lateral",
                  (Column("frame", "slipping", {"joint": 0, "width": width}, 1, 0),), {"width": width}, share)
        for width, share in zip(widths, shares, strict=True)
    ]  # fmt: skip
    tried = Tried(space, lags, space.unit)
    cells = (0.2, 0.15, 0.1)  # of the middle one from halfway to halfway; at an end the whole way to the next
    for k, cell in enumerate(cells):
        alone = np.where(np.arange(3) == k, 0.0, -1e3)
        assert spread_of(tried, k, alone)["width"] == pytest.approx(cell / np.sqrt(12.0))
    # the last one's prior share is a quarter of either other's: weights of 4, 4 and 1 ninths, or of 4 and 1 fifths
    away = np.sqrt((4 * 0.2**2 + 1 * 0.1**2) / 9 + 0.15**2 / 12)
    assert spread_of(tried, 1, np.zeros(3))["width"] == pytest.approx(away)
    without_the_first = np.sqrt(0.1**2 / 5 + 0.15**2 / 12)
    assert spread_of(tried, 1, np.array([-1e3, 0.0, 0.0]))["width"] == pytest.approx(without_the_first)


def test_a_finding_is_told_by_its_name_joint_cause_and_period() -> None:
    def one(effect: str, covariate: str, period: float | None = None) -> Candidate:
        shape = {} if period is None else {"period": period}
        return Candidate(effect, "yaw", "yaw", "ry", covariate, (), shape)

    def said(effect: str, covariate: str, **parameters: float) -> dict[str, object]:
        values = {name: {"value": value} for name, value in parameters.items()}
        return {"effect": effect, "joint": "yaw", "covariate": covariate, "parameters": values}

    assert is_of(said("cross_coupling", "q_roll"), one("cross_coupling", "q_roll"))
    assert not is_of(said("cross_coupling", "q_roll"), one("cross_coupling", "q_pitch"))
    assert is_of(said("clearance", "Mx"), one("clearance", "Mz"))  # another load of the same bearing
    assert not is_of(said("clearance", "Mx"), one("nonlinear_stiffness", "Mx"))
    assert not is_of({**said("clearance", "Mx"), "joint": "roll"}, one("clearance", "Mx"))
    assert is_of(said("periodic_transmission", "q_yaw", period=0.1), one("periodic_transmission", "q_yaw", 0.1001))
    assert not is_of(said("periodic_transmission", "q_yaw", period=0.1), one("periodic_transmission", "q_yaw", 0.2))


def test_the_phase_of_a_wave_is_as_unsure_as_it_may_turn(space: Workspace) -> None:
    wave = next(k for k in library(space.context) if k.effect == "periodic_transmission" and len(k.columns) == 2)
    said = numbers_of(space.context, wave, np.array([1e-4, 0.0]), np.diag([1e-6, 5e-6]) ** 2)
    assert said["amplitude"]["std"] == pytest.approx(1e-6)
    assert said["phase"]["std"] == pytest.approx(0.05)


def test_names_and_units_say_what_each_number_is(space: Workspace) -> None:
    def said(name: str, columns: tuple[Column, ...], component: str | None, covariate: str) -> Mapping[str, object]:
        candidate = Candidate(name, "vertical", "vertical", component, covariate, columns, {})
        numbers = numbers_of(space.context, candidate, np.ones(len(columns)), np.eye(len(columns)))
        return {key: (entry["value"], entry["unit"]) for key, entry in numbers.items()}

    def by(function: str, moves: int, **args: object) -> Column:
        return Column("frame", function, args, 2, moves)

    sided = Column("frames", "sensor_error", {"component": 2, "source": 2, "bent": "sided"})
    assert said("wrench_error", (sided,), None, "Fz") == {"Fz_by_Fz_sided": (1.0, "1")}
    loads = (by("load", 1, frame=2, component=1), by("load", 3, frame=2, component=3))
    assert said("missing_compliance", loads, None, "load") == {
        "compliance_ty_by_Fy": (1.0, "m/N"), "compliance_rx_by_Mx": (1.0, "rad/(N m)"),
    }  # fmt: skip
    creeps = (Column("frames", "creep", {"tau": 0.1, "form": "log", "frame": 2}),)
    assert said("creep", creeps, None, "since_load_change") == {"share": (1.0, "1")}
    bends = (by("creeping", 3, frame=2, component=3, tau=0.1, form="log"),)
    assert said("creep", bends, "rx", "since_load_change") == {"compliance": (-1.0, "rad/(N m)")}
    hangs = (by("hanging", 3, frame=2, component=3, joint=2),)  # of 1 N: its weight times what bends there
    assert said("moving_weight", hangs, "rx", "q_yaw") == {"bend_per_metre_of_lever": (1.0, "rad/m")}
    warm = tuple(by("temperature", 1, place=place, tau=0.0) for place in ("rail", "hall"))
    assert said("thermal_growth", warm, "ty", "temp_rail_C") == {
        "per_kelvin_rail": (1.0, "m/K"), "per_kelvin_hall": (1.0, "m/K"),
    }  # fmt: skip
    gap = (by("approach", 1, joint=1), by("approach_q", 1, joint=1))
    assert said("backlash", gap, "ty", "approach_vertical") == {"gap": (-2.0, "m"), "drag": (-2.0, "m")}
