"""Whose weights bend a joint: statics by hand, and what a recording of a simulated arm says of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from ppshw.calibration import Calibration, content_digest, load_calibration
from ppshw.diagnosis import diagnose
from ppshw.errors import CalibrationError
from ppshw.evaluation import residuals
from ppshw.identification import identify, own_weight
from ppshw.identification.joint import Estimate
from ppshw.identification.noise import Noise
from ppshw.identification.own_weight import log_evidences
from ppshw.identification.start import to_base
from ppshw.identification.structure import joint_model
from ppshw.kinematics import frames
from ppshw.machine import BentBy, Machine, load_machine
from ppshw.recording import Recording, load_recording
from ppshw.statics import link_wrenches
from ppshw.terms import Situation
from simulators import chain as kinematics
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant

Array = NDArray[np.float64]
Measured = tuple[Machine, Recording, BentBy]
ARM = load_machine(Path(__file__).parents[2] / "machines/arm6.yaml")
HEAVY = 2.0  # times the file's, on the same springs


class Rooted(Plant):
    """Its links are stiff at their joints and bend at their ends, by what lies beyond them."""

    def link_wrenches(self, q: Array, load: Any = None) -> Array:
        out = super().link_wrenches(q, load)
        for i, joint in enumerate(self.chain.joints):
            turn = kinematics.link_poses(self.chain, np.atleast_2d(q))[:, i, :3, :3]
            weight = joint.mass * np.einsum("nba,b->na", turn, self.chain.gravity)
            out[:, i] -= np.concatenate([weight, np.cross(joint.com, weight)], axis=1)
        return out


class Balanced(Plant):
    """Counterweights bear its links: the payload alone bends it."""

    def link_wrenches(self, q: Array, load: Any = None) -> Array:
        return np.asarray(super().link_wrenches(q, load) - super().link_wrenches(q, None))


PLANTS: dict[BentBy, type[Plant]] = {"own": Plant, "beyond": Rooted, "payload": Balanced}


@pytest.fixture(scope="module", params=["own", "beyond", "payload"])
def measured(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Measured:
    folder = tmp_path_factory.mktemp(request.param)
    light = Path(ARM.file).read_text(encoding="utf-8").replace("[Fx, Fy, Fz, Mx, My, Mz]", "[Mx, My, Mz]")
    heavy = light
    for joint in ARM.joints:
        heavy = heavy.replace(f"mass: {joint.mass:g},", f"mass: {HEAVY * joint.mass:g},")
    for name, text in (("light", light), ("m", heavy)):
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    machine = load_machine(folder / "m.yaml")
    assert [j.mass for j in machine.joints] == pytest.approx([HEAVY * j.mass for j in ARM.joints])
    plant = PLANTS[request.param].from_file(folder / "light.yaml", seed=5)
    plant.chain = kinematics.read_chain(folder / "m.yaml")
    csv = simulate_recording_csv(plant, folder / "r.csv", 100, np.random.default_rng(1), "mixed", interleave=True)
    return machine, load_recording(csv, machine), request.param


def test_a_link_that_does_not_hang_carries_what_lies_beyond_it() -> None:
    rng = np.random.default_rng(2)
    q, payload = rng.uniform(-1, 1, (3, 6)), rng.normal(size=(3, 6))
    chain = frames(ARM, q)
    ways: tuple[BentBy, ...] = ("own", "beyond", "payload")
    hangs, rooted, balanced = (link_wrenches(replace(ARM, bent_by=way), chain, payload) for way in ways)
    for i, joint in enumerate(ARM.joints, start=1):
        weight = joint.mass * np.einsum("nji,j->ni", chain[:, i, :3, :3], ARM.gravity)
        own = np.concatenate([weight, np.cross(joint.com, weight)], axis=1)
        np.testing.assert_allclose(hangs[:, i] - rooted[:, i], own, atol=1e-9)
    np.testing.assert_allclose(hangs[:, 0], rooted[:, 0], atol=1e-9)
    weightless = replace(ARM, joints=tuple(replace(joint, mass=0.0) for joint in ARM.joints))
    np.testing.assert_array_equal(balanced, link_wrenches(weightless, chain, payload))


def test_a_recording_says_whose_weights_bend_a_joint(measured: Measured, tmp_path: Path) -> None:
    machine, recording, bent_by = measured
    found = identify(machine, recording)
    assert found.model.machine.bent_by == bent_by
    calibration = Calibration.of(found, recording, "joint")
    calibration.save(tmp_path / "cal.json")
    back = load_calibration(tmp_path / "cal.json", machine)
    assert back.machine.bent_by == bent_by
    np.testing.assert_array_equal(residuals(recording, back), residuals(recording, calibration))
    data = json.loads((tmp_path / "cal.json").read_text(encoding="utf-8"))
    data["bent_by"] = 3
    (tmp_path / "cal.json").write_text(json.dumps({**data, "content_sha256": content_digest(data)}), encoding="utf-8")
    with pytest.raises(CalibrationError, match="damaged: 'bent_by' is 3, expected one of own, beyond, payload"):
        load_calibration(tmp_path / "cal.json", machine)


@pytest.mark.long
@pytest.mark.parametrize("measured", ["beyond", "payload"], indirect=True)  # "own": as in every other recording here
def test_nothing_is_missing_however_a_machine_s_own_weights_bend_it(measured: Measured) -> None:
    machine, recording, bent_by = measured
    found = diagnose(machine, recording)
    assert found.answer["verdict"] == "consistent"
    assert found.space.machine.bent_by == bent_by


def test_the_likelihood_of_two_fits_is_that_of_the_normal_distribution_of_all_their_readings(tmp_path: Path) -> None:
    """The whole covariance of a dozen visits laid out, two readings lost; two fits with other strengths and noise."""
    csv = simulate_recording_csv(Plant.from_file(ARM.file, seed=5), tmp_path / "r.csv", 12, np.random.default_rng(1))
    recording = load_recording(csv, ARM)
    recording.points[3, 1] = recording.points[7, 0] = np.nan
    model, rng = joint_model(ARM, recording, waves=2), np.random.default_rng(2)
    parameters = model.parameters()
    frame, rows = ARM.tracker.base, np.repeat(recording.seen, 3, axis=1).ravel()
    assert frame is not None
    fits, expected = [], []
    for times, noise in ((1.0, Noise(np.diag([4e-9, 2e-9, 1e-9, 4e-10, 3e-10, 2e-10]), 2e-5)),
                         (0.2, Noise(np.eye(6) * 1e-8, 5e-5))):  # fmt: skip
        groups = {p.group: times * p.start for p in parameters}
        prior = np.array([groups[p.group] * p.scale for p in parameters])
        theta = 0.1 * prior * rng.normal(size=len(prior))
        fits.append(Estimate(model, theta, np.diag(prior**2), groups, noise, frame, np.ones(12)))
        linear = model.linearise(Situation.of(recording), theta)
        design = linear.design.reshape(len(rows), -1)[rows]
        data = (to_base(recording.points, frame) - linear.positions).ravel()[rows] + design @ theta
        scatter = block_diag(*noise.covariance(linear.levers, recording.seen, np.ones(12)))[np.ix_(rows, rows)]
        expected.append(multivariate_normal(cov=scatter + (design * prior**2) @ design.T).logpdf(data))
    said = log_evidences(fits, recording)
    assert said[0] - said[1] == pytest.approx(expected[0] - expected[1], rel=1e-6)


@pytest.mark.parametrize(
    ("asked", "whole", "way", "fits"),
    [
        ({"own": 10.0, "payload": 12.9, "beyond": 19.9}, None, "own", 1),  # neither is ahead by what it must be
        ({"own": 10.0, "payload": 13.1, "beyond": 19.9}, (100.0, 103.1), "payload", 2),
        ({"own": 10.0, "payload": 13.1, "beyond": 19.9}, (100.0, 102.9), "own", 2),  # a whole fit that is no likelier
        ({"own": 10.0, "payload": 14.0, "beyond": 21.5}, (100.0, 110.1), "beyond", 2),
        ({"own": 10.0, "payload": 14.0, "beyond": 21.5}, (100.0, 109.9), "own", 2),
    ],
)
def test_another_way_stands_only_where_its_whole_fit_is_likelier_too(
    monkeypatch: pytest.MonkeyPatch,
    asked: dict[BentBy, float],
    whole: tuple[float, float] | None,
    way: BentBy,
    fits: int,
) -> None:
    made: list[BentBy] = []

    def fit(machine: Machine, recording: Recording, progress: object = None) -> SimpleNamespace:
        made.append(machine.bent_by)
        return SimpleNamespace(bent_by=machine.bent_by, weights=np.ones(60))

    monkeypatch.setattr(own_weight, "joint_model", lambda machine, _: machine)
    monkeypatch.setattr(own_weight, "_own_weights_vary", lambda *_: True)
    monkeypatch.setattr(own_weight, "estimate", fit)
    monkeypatch.setattr(own_weight, "_moved_evidence", lambda found, which, *_: asked[which])
    monkeypatch.setattr(own_weight, "log_evidences", lambda *_: list(whole or ()))
    found = own_weight.fitted(replace(ARM, bent_by="own"), None, SimpleNamespace(q=None))  # type: ignore[arg-type]
    assert found.bent_by == way  # type: ignore[attr-defined]
    assert len(made) == fits


@pytest.mark.parametrize(
    ("prismatic", "askew", "elastic", "asked"),
    [
        (False, 0.0, True, False),  # about the vertical
        (False, 0.5, True, True),
        (True, 0.5, True, False),  # however a rail stands, it carries always the same
        (False, 0.5, False, False),
    ],
)
def test_own_weights_that_are_always_the_same_are_not_asked_about(
    prismatic: bool, askew: float, elastic: bool, asked: bool
) -> None:
    """A rail's chance offset said that its weights bend nothing."""
    axis = np.array([np.sin(askew), 0.0, np.cos(askew)])
    bends = ARM.joints[0].elastic if elastic else None
    joint = replace(
        ARM.joints[0], prismatic=prismatic, axis=axis, mass=50.0, com=np.array([0.2, 0.1, 0.3]), elastic=bends
    )
    poses = np.linspace(-0.5, 0.5, 9)[:, None]
    assert own_weight._own_weights_vary(replace(ARM, joints=(joint,)), poses) == asked
