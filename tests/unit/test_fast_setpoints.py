"""Compiled setpoints: the same corrections and refusals as Compensator's, and one by hand."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ppshw.calibration import Calibration
from ppshw.compensation import Bounds, Compensator
from ppshw.compensation.fast_setpoints import FastCompensator
from ppshw.errors import CalibrationError, CompensationRefused
from ppshw.identification.noise import Noise
from ppshw.machine import Machine, load_machine
from ppshw.model import Model
from ppshw.terms import FrameTerm, Parameter, Situation
from ppshw.terms.basis import Basis, Constant, Interpolated, Polynomial, Smooth
from ppshw.terms.effect import Effect
from ppshw.terms.elastic import Compliance, pattern
from ppshw.terms.geometric import Geometric
from ppshw.terms.own_motion import OwnMotion
from ppshw.terms.shapes import Column

Array = NDArray[np.float64]
MACHINES = Path(__file__).parents[2] / "machines"
PPS, ARM = load_machine(MACHINES / "pps.yaml"), load_machine(MACHINES / "arm6.yaml")
# A patient of 100 kg whose weight stands 0.6 m along the couch, and room around it.
PAYLOAD = np.array([0.0, -980.0, 0.0, 590.0, 0.0, 30.0])
ROOM = np.array([60.0, 400.0, 60.0, 300.0, 20.0, 200.0])
LOADS = np.stack([PAYLOAD - ROOM, PAYLOAD + ROOM], axis=1)
WIDE = Bounds(travel=0.2, angle=0.2)
KINDS = ["smooth", "interpolated"]


def calibration(machine: Machine, kind: str, seed: int = 1) -> Calibration:
    """Millimetres of error and tenths of mrad of bending, drawn at random: much like an assembled machine."""
    low, high = machine.limits()
    low, high = np.maximum(low, -2.5) * 0.95, np.minimum(high, 2.5) * 0.95
    rng = np.random.default_rng(seed)

    def basis(k: int, size: int) -> Basis:
        centre, half = (low[k] + high[k]) / 2, (high[k] - low[k]) / 2
        if kind == "interpolated":
            inner = np.sort(rng.uniform(low[k], high[k], size))
            return Interpolated((float(low[k]), *inner.tolist(), float(high[k])))
        return Smooth(centre, half, size) if size > 3 else Polynomial(centre, half, size)

    terms: list[FrameTerm] = [Geometric(0, Constant())]
    for k, joint in enumerate(machine.joints):
        terms.append(Geometric(k + 1, basis(k, 9)))
        if kind == "smooth" and k % 2:
            d = np.concatenate([joint.axis * joint.prismatic, joint.axis * (not joint.prismatic)])
            terms.append(OwnMotion(k + 1, tuple(d.tolist()), (low[k] + high[k]) / 2, (high[k] - low[k]) / 2, 10, 40))
        if joint.elastic is not None:
            shape = basis(k, 3) if joint.elastic.varies else Constant()
            terms.append(Compliance(k + 1, pattern(joint.elastic), tuple(joint.elastic.load_indices), shape))
    model = Model(machine, tuple(terms))
    size = {"geometric": {"m": 5e-4, "rad": 1e-4}, "compliance": {"m/N": 2e-7, "rad/N": 1e-7, "rad/(N m)": 1e-7}}
    size["own_motion"] = {"m": 1e-5, "rad": 1e-5}
    kinds = [t.kind for t in terms for _ in t.parameters(machine.frame_names)]
    theta = np.array([rng.normal(scale=size[kind][p.unit]) for kind, p in zip(kinds, model.parameters(), strict=True)])
    return Calibration(
        model, theta, np.zeros((len(theta),) * 2), Noise(np.eye(6) * 1e-9, 2e-5), np.eye(4),
        np.stack([low, high], axis=1), LOADS, {}, {},
    )  # fmt: skip


def wanted(c: Calibration, count: int, share: float) -> tuple[Array, Array]:
    """Joint values over a share of the range (an arm's on one side of its singular poses) and loads."""
    rng = np.random.default_rng(2)
    middle, half = c.joint_range.mean(axis=1), np.ptp(c.joint_range, axis=1) / 2
    if c.machine is not PPS:
        middle, half = middle + 0.4 * half, 0.3 * half
    return middle + rng.uniform(-share, share, (count, len(half))) * half, rng.uniform(*c.payload_range.T, (count, 6))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("machine", [PPS, ARM, replace(ARM, bent_by="beyond"), replace(ARM, bent_by="payload")],
                         ids=["pps", "arm6", "arm6, links beyond", "arm6, balanced"])  # fmt: skip
def test_it_corrects_as_the_compensator_does_to_a_micrometre(machine: Machine, kind: str) -> None:
    c = calibration(machine, kind)
    slow, fast = Compensator(c, WIDE), FastCompensator(c, WIDE)
    q, payload = wanted(c, 12, 0.6)
    bulk = fast.setpoints(q, payload)
    assert not bulk.refused.any()
    for k in range(len(q)):
        expected = slow.for_joints(q[k], payload[k]).corrected
        assert np.abs(expected - q[k]).max() > 1e-4
        np.testing.assert_allclose(fast.setpoint(q[k], payload[k]), expected, rtol=0, atol=5e-7)
        np.testing.assert_array_equal(bulk.corrected[k], fast.setpoint(q[k], payload[k]))


@pytest.mark.parametrize("kind", KINDS)
def test_the_corrected_machine_stands_where_the_ideal_one_would(kind: str) -> None:
    c = calibration(PPS, kind)
    q, payload = wanted(c, 200, 0.6)
    corrected = FastCompensator(c, WIDE).setpoints(q, payload).corrected
    point = PPS.point("treatment")[None]
    ideal = replace(c.model, terms=()).predict(Situation(q, payload), np.zeros(0), point)
    real = c.model.predict(Situation(corrected, payload), c.theta, point)
    assert np.abs(c.model.predict(Situation(q, payload), c.theta, point) - ideal).max() > 5e-3
    assert np.abs(real - ideal).max() < 5e-7


def test_a_rail_that_reads_a_millimetre_long_is_sent_a_millimetre_back() -> None:
    c = calibration(PPS, "smooth")
    names = [p.name for p in c.model.parameters()]
    theta = np.zeros(len(names))
    theta[names.index("lateral.tx[0]")] = 1e-3
    corrected = FastCompensator(replace(c, theta=theta)).setpoint(np.full(6, 0.01), PAYLOAD)
    np.testing.assert_allclose(corrected, [0.009, 0.01, 0.01, 0.01, 0.01, 0.01], rtol=0, atol=1e-9)


NUMBER = re.compile(r"-?[0-9]+\.?[0-9]*(?:e-?[0-9]+)?")


def numbers(reason: str | None) -> list[float]:
    return [float(n) for n in NUMBER.findall(str(reason))]


def refusal_of(correct: Callable[[], Array]) -> str | None:
    try:
        correct()
    except CompensationRefused as refusal:
        return str(refusal)
    return None


def test_it_refuses_what_the_compensator_refuses_in_the_same_words() -> None:
    c = calibration(PPS, "smooth")
    bounds = Bounds(travel=0.006, angle=0.004)
    slow, fast = Compensator(c, bounds), FastCompensator(c, bounds)
    q, payload = wanted(c, 60, share=1.04)
    payload[::7, 1] -= 500.0
    q[5, 2], payload[6, 3] = np.nan, np.inf
    bulk = fast.setpoints(q, payload)
    assert 10 < bulk.refused.sum() < 55
    for k in range(len(q)):
        expected = refusal_of(lambda k=k: slow.for_joints(q[k], payload[k]).corrected)
        assert bulk.refused[k] == (expected is not None) == np.isnan(bulk.corrected[k]).all()
        assert bulk.reason(k) == refusal_of(lambda k=k: fast.setpoint(q[k], payload[k]))
        assert NUMBER.sub("", str(bulk.reason(k))) == NUMBER.sub("", str(expected))
        assert numbers(bulk.reason(k)) == pytest.approx(numbers(expected), abs=2e-6, rel=1e-5, nan_ok=True)
    reasons = " ".join(str(bulk.reason(k)) for k in range(len(q)))
    for word in ("joint", "load Fy", "would be corrected by"):
        assert word in reasons


def test_an_arm_with_two_joints_about_one_axis_is_none_for_it() -> None:
    """Its errors turn the tip about an axis that no joint has: the compensator puts the position right."""
    twice = replace(ARM.joints[5], axis=ARM.joints[4].axis, origin=np.eye(4))
    c = calibration(replace(ARM, joints=(*ARM.joints[:5], twice)), "smooth")
    with pytest.raises(CalibrationError, match="move its end effector in 5 ways, compiled setpoints need all six"):
        FastCompensator(c)


class CrossTalk:
    """An effect that the tables cannot hold: an error behind the second joint that follows the first."""

    kind, frame = "cross_talk", 2

    def parameters(self, frame_names: tuple[str, ...]) -> list[Parameter]:
        return [Parameter("cross", "m", "cross", 1.0, 1e-3)]

    def regressors(self, situation: Situation, wrenches: Array) -> Array:
        out = np.zeros((len(situation), 6, 1))
        out[:, 0, 0] = situation.q[:, 0]
        return out

    def as_dict(self) -> dict[str, str]:
        return {}


def test_an_effect_of_another_kind_is_told_not_lost() -> None:
    c = calibration(PPS, "smooth")
    model = replace(c.model, terms=(*c.model.terms, CrossTalk()))
    with pytest.raises(CalibrationError, match="errors behind 'vertical' do not depend on the joint's position"):
        FastCompensator(replace(c, model=model, theta=np.append(c.theta, 1e-3)))


def test_numbers_of_another_machine_are_refused() -> None:
    fast = FastCompensator(calibration(PPS, "smooth"))
    with pytest.raises(CompensationRefused, match="5 joint values and 6 load components given, expected 6 and 6"):
        fast.setpoint(np.zeros(5), PAYLOAD)


def test_a_calibration_with_effects_is_refused_unless_its_base_model_alone_is_asked_for() -> None:
    jump = Column("frame", "step", {"visit_time": 1.0}, 1, 0)
    found = Effect("zero_shift", PPS.joint_names[0], (jump,), (1e-3,), (1e-5,), "its zero jumped")
    more = replace(calibration(PPS, "smooth"), effects=(found,))
    with pytest.raises(CalibrationError, match=re.escape("(zero_shift), without which this base model is worse")):
        FastCompensator(more)
    assert FastCompensator(more, WIDE, leave_out=True).left_out == ("its zero jumped",)


@pytest.mark.parametrize(("wanted", "payload"), [((6,), (6,)), ((2, 6), (3,)), ((2, 6), (3, 6)), ((2, 5), (6,))])
def test_arrays_of_other_shapes_are_refused(wanted: tuple[int, ...], payload: tuple[int, ...]) -> None:
    with pytest.raises(CompensationRefused, match="expected"):
        FastCompensator(calibration(PPS, "smooth")).setpoints(np.zeros(wanted), np.zeros(payload))
