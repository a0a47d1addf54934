"""Scatter that grows with a load or a move, and what only looks like it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ppshw.diagnosis import diagnose, scatter
from ppshw.diagnosis.checks import before_and_after
from ppshw.diagnosis.library.sampled import nearest_component
from ppshw.diagnosis.replicas import of_space
from ppshw.diagnosis.scatter import scatter_of, scatter_without_a_name
from ppshw.diagnosis.workspace import Workspace, prepare
from tests.unit.clean_case import clean_case


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    machine, recording = clean_case(60533, "pps", 240, 180, tmp_path_factory.mktemp("clean"))
    return prepare(machine, recording, np.ones(len(recording), dtype=bool))


def _noisier(space: Workspace, more: np.ndarray) -> Workspace:
    """The same recording with (N, 3T) added to its readings [m]."""
    return replace(space, data=space.data + more)


def _load(space: Workspace) -> np.ndarray:
    load = np.linalg.norm(space.recording.wrench[:, :3], axis=1)
    return np.asarray(load / load.max())


def _swinging(
    clean: Workspace, arms: np.ndarray, size: np.ndarray, rms: float, rng: np.random.Generator
) -> Workspace:  # fmt: skip
    """What moves the reflectors by `arms` (N, 3T) swings in proportion to `size` (N,); rms at the reflectors [m]."""
    swing = arms * (size * rng.normal(size=len(arms)))[:, None]
    return _noisier(clean, swing * rms / np.sqrt((swing**2).sum() / clean.recording.seen.sum()))


def test_what_swings_under_load_is_calmed_in_its_own_direction_alone(clean: Workspace) -> None:
    rng = np.random.default_rng(5)
    frame = clean.machine.frame_names.index("longitudinal")
    arms = clean.context.jacobian[:, :, frame, 3]
    shaken = _swinging(clean, arms, _load(clean), 6e-5, rng)
    assert scatter_of(clean, 0) is None
    found = scatter_of(shaken, 0)
    assert found is not None
    said = found.finding
    assert (said["effect"], said["joint"], said["covariate"]) == ("unsettled", "longitudinal", "load")
    assert 4e-2 < said["rms_mm"] < 2e-1  # 0.06 mm were put in, most of it where the load is heavy
    assert (said["frame"], said["component"]) == ("longitudinal", "rx")
    assert "; longitudinal swings, in rx: noise" in said["sentence"]
    # one direction of every visit counts less, the more the heavier the load; the others alike everywhere
    lengths = np.linalg.eigvalsh(found.calming)
    assert np.ptp(lengths[:, 1:]) < 1e-9
    assert lengths[0, 1] == pytest.approx(1.0, abs=0.1)
    ratio = lengths[:, 0] / lengths[:, 1]
    assert np.corrcoef(ratio, _load(clean))[0, 1] < -0.8
    assert ratio[_load(clean) > 0.9].mean() < 0.5
    assert ratio[_load(clean) < 0.15].mean() > 0.8
    calm = replace(shaken, root=found.calming @ shaken.root, calming=found.calming)
    after = scatter_of(calm, 0)
    assert after is not None
    assert np.allclose(after.calming, found.calming, rtol=0.2, atol=0.05)  # of the whole scatter, not of what is left
    # what the base model alone leaves is compared with even noise, and is not like it
    assert np.allclose(of_space(calm, found=False).root, of_space(shaken).root)
    checks = {when: {c["name"]: c["p"] for c in made} for when, made in before_and_after(calm).items()}
    assert checks["before"]["scatter_load"] <= 0.005 < checks["after"]["scatter_load"]


def test_a_joint_is_named_where_no_other_one_nor_the_base_swings_so(clean: Workspace) -> None:
    """What shifts along the first rail may be that rail or whatever stands on it: a drive is likelier. A base that
    rocks about that rail is as likely as the rail's own carriage."""
    own, base = (
        _swinging(clean, clean.context.jacobian[:, :, frame, k], _load(clean), 1.2e-4, np.random.default_rng(5))
        for frame, k in ((1, nearest_component(clean.context, 0)), (0, 3))
    )
    along, rocks = (scatter_of(space, 0, any_way=True) for space in (own, base))
    assert along is not None
    assert along.finding["joint"] == along.finding["frame"] == clean.machine.joint_names[0]
    assert rocks is not None
    assert rocks.finding["joint"] is None
    said = rocks.finding["frame"], rocks.finding["component"]
    assert f"it swings most nearly as {said[0]} {said[1]} would: noise" in rocks.finding["sentence"]


def test_what_swings_little_in_one_direction_is_told_where_one_looks_in_any(clean: Workspace) -> None:
    """Too little of the whole to show there; and a link that rings after long moves that nobody waited for."""
    rng = np.random.default_rng(7)
    frame = clean.machine.frame_names.index("longitudinal")
    shaken = _swinging(clean, clean.context.jacobian[:, :, frame, 3], _load(clean), 2.5e-5, rng)
    assert scatter_of(clean, 0, any_way=True) is None
    assert scatter_of(shaken, 0) is None
    found = scatter_of(shaken, 0, any_way=True)
    assert found is not None
    assert found.finding["covariate"] == "load"
    assert found.finding["parameters"]["scatter_ratio"]["value"] > 1.2

    yaw = clean.machine.joint_names.index("yaw")
    moved = np.concatenate([[0.0], np.abs(np.diff(clean.recording.q[:, yaw]))])
    waited = moved * np.exp(-clean.recording.settle_s / 3.0)
    rings = _swinging(clean, clean.context.jacobian[:, :, yaw + 1, 4], waited, 3e-5, rng)
    found = scatter_of(rings, 0, any_way=True)
    assert found is not None
    assert found.finding["covariate"] in ("move_yaw", "move length")


@pytest.mark.long
def test_what_goes_with_two_joints_last_moves_is_no_scatter_though_it_looks_so(tmp_path: Path) -> None:
    machine, recording = clean_case(60533, "pps", 120, 100, tmp_path)
    clean = prepare(machine, recording, np.ones(len(recording), dtype=bool))
    lateral, yaw = (clean.machine.joint_names.index(name) for name in ("lateral", "yaw"))
    moved = np.diff(clean.recording.q, axis=0, prepend=clean.recording.q[:1])
    both = moved[:, lateral] * moved[:, yaw]
    twist = clean.context.jacobian[:, :, lateral + 1, 3] * both[:, None]
    twist *= 4e-4 / np.sqrt((twist**2).sum() / clean.recording.seen.sum())
    turned = clean.base.measuring_in_base[:3, :3]
    points = clean.recording.points + twist.reshape(clean.recording.points.shape) @ turned
    recording = replace(clean.recording, points=points)
    assert scatter_of(prepare(clean.machine, recording, clean.fit), 0) is not None
    answer = diagnose(clean.machine, recording).answer
    assert (answer["verdict"], answer["findings"]) == ("unexplained", [])
    assert set(answer["unexplained"]["covariates"]) == {"q_lateral", "q_yaw"}


def test_noise_that_grows_in_all_directions_is_calmed_in_all(clean: Workspace) -> None:
    rng = np.random.default_rng(6)
    white = rng.normal(size=clean.data.shape) * 3.0 * _load(clean)[:, None]
    found = scatter_of(_noisier(clean, np.linalg.solve(clean.root, white[..., None])[..., 0]), 0)
    assert found is not None
    assert found.finding["frame"] is None
    sizes = found.calming[:, 0, 0]
    assert np.allclose(found.calming, sizes[:, None, None] * np.eye(clean.rows))
    assert np.corrcoef(np.log(sizes), _load(clean))[0, 1] < -0.9


def test_what_is_off_at_one_place_of_a_joint_s_travel_is_no_scatter(clean: Workspace) -> None:
    """Moves to that place are longer than others, as those to any one place far from the middle are."""
    q = clean.recording.q[:, clean.machine.joint_names.index("yaw")]
    visits = np.flatnonzero(q > np.quantile(q, 0.93))
    off = np.random.default_rng(9).normal(size=(len(visits), 1, 3))
    points = clean.recording.points.copy()
    points[visits] += 1.2e-4 * off
    there = prepare(clean.machine, replace(clean.recording, points=points), clean.fit)
    alone = scatter._may_scatter(there, nameless=False)
    assert max(np.corrcoef(size, q > np.quantile(q, 0.93))[0, 1] for size in alone.values()) > 0.2
    assert scatter_of(there, 0, any_way=True) is None


def test_what_a_form_leaves_where_its_effect_is_largest_is_no_scatter(clean: Workspace) -> None:
    """A cable that drags its joint by the last move, more the farther out another joint is, and each time by a third
    more or less."""
    rng = np.random.default_rng(11)
    yaw = clean.machine.joint_names.index("yaw")
    moved = np.diff(clean.recording.q[:, yaw], prepend=clean.recording.q[0, yaw])
    out = clean.recording.q[:, clean.machine.joint_names.index("lateral")]
    drags = clean.context.jacobian[:, :, yaw + 1, 3] * (moved * (out - out.min()))[:, None]
    drags *= 3e-4 / np.sqrt((drags**2).sum() / clean.recording.seen.sum())
    there = _noisier(clean, drags * (1.0 + rng.normal(size=(len(drags), 1)) / 3.0))
    there.take_up(drags[..., None], np.array([10.0]))
    assert there.coefficients()[1] == pytest.approx([1.0], abs=0.1)
    assert scatter_of(there, 0, any_way=True) is None
    unknown = _noisier(clean, there.data - drags - clean.data)
    found = scatter_of(unknown, 0, any_way=True)
    assert found is not None
    assert found.finding["covariate"] == "move_yaw"


def test_how_much_more_it_scatters_is_measured(clean: Workspace) -> None:
    """In readings, of the fifths of the visits at both ends: a factor was said whose 2.1 was 5.5 of the poses (a
    reviewer's). What is left of 160 visits holds less: the base model takes some of it, and more of the noisy ones."""
    rng = np.random.default_rng(8)
    grows = 5.0 * _load(clean)
    swings = np.linalg.solve(clean.root, (rng.normal(size=clean.data.shape) * grows[:, None])[..., None])[..., 0]
    found = scatter_of(_noisier(clean, swings), 0)
    assert found is not None
    told = found.finding["parameters"]["scatter_ratio"]
    order = np.argsort(_load(clean))
    fifth = len(order) // 5
    expected = np.sqrt((1.0 + grows[order[-fifth:]] ** 2).mean() / (1.0 + grows[order[:fifth]] ** 2).mean())
    assert expected > 3.0
    assert 0.65 * expected < told["value"] < expected + 2.0 * told["std"]
    assert 0.03 * told["value"] < told["std"] < 0.2 * told["value"]  # 32 visits of nine coordinates at each end
    assert "mm rms in the fifth of the visits where" in found.finding["sentence"]


def test_beside_other_findings_scatter_must_nearly_double(clean: Workspace) -> None:
    """A bump that a coupling's form left where long moves end was scatter of a factor of 1.3."""
    rng = np.random.default_rng(7)
    white = rng.normal(size=clean.data.shape) * _load(clean)[:, None]
    swings = np.linalg.solve(clean.root, white[..., None])[..., 0]
    little, much = _noisier(clean, swings), _noisier(clean, 3.0 * swings)
    found = scatter_of(little, 0, any_way=True)
    assert found is not None
    assert 1.2 < found.finding["parameters"]["scatter_ratio"]["value"] < scatter.BESIDE
    assert scatter_of(little, 0, any_way=True, beside=True) is None
    assert scatter_of(much, 0, any_way=True, beside=True) is not None


def test_scatter_without_its_name_is_unexplained_over_the_column_it_goes_with(clean: Workspace) -> None:
    rng = np.random.default_rng(6)
    white = rng.normal(size=clean.data.shape) * 3.0 * _load(clean)[:, None]
    noisy = _noisier(clean, np.linalg.solve(clean.root, white[..., None])[..., 0])
    found = scatter_of(noisy, 0, nameless=True)
    assert found is not None
    said = scatter_without_a_name(noisy, found)
    assert (said["covariates"], said["history"], said["component"]) == (["Fy"], "scatter, not a bias", None)
    assert said["p_value"] <= 0.001
    assert said["rms_mm"] > scatter_without_a_name(clean, found)["rms_mm"]
    assert len(scatter._may_scatter(noisy, nameless=True)) < len(scatter._may_scatter(noisy, nameless=False))
