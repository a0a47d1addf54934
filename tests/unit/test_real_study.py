"""The study of real recordings: what it holds out, how it moves from floor to floor, and the fine waves of a gear."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ppshw.calibration import Calibration, load_calibration
from ppshw.converters import hilti
from ppshw.evaluation import residuals
from ppshw.identification.joint import estimate
from ppshw.identification.structure import joint_model
from ppshw.machine import Machine, load_machine
from ppshw.recording import Recording, load_recording
from ppshw.studies.folds import Score, blocks, cross_validate, grouped, shuffled
from ppshw.studies.measured_tilt import MeasuredTilt
from ppshw.studies.real import main, nominal
from ppshw.studies.real_tables import Check, Row, markdown
from ppshw.studies.stationing import across, leaning, refit
from ppshw.terms import Situation
from ppshw.terms.basis import Constant
from ppshw.transforms import from_xyz_rpy, inverse, rotation_vector

Array = NDArray[np.float64]
ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("PPSHW_DATA", ROOT.parent / "shared" / "data"))

TWO_LINKS = """
name: two_links
gravity: [0, 0, -9.80665]
joints:
  - {name: shoulder, type: revolute, axis: [0, 0, 1]}
  - {name: elbow, type: revolute, origin: {xyz: [0.6, 0, 0]}, axis: [0, 0, 1]}
tip: {origin: {xyz: [0.5, 0, 0]}, targets: {ball: [0, 0, 0]}}
tracker: {position_sigma: 2.0e-5}
"""


def two_links(folder: Path) -> Machine:
    path = folder / "two_links.yaml"
    path.write_text(TWO_LINKS, encoding="utf-8")
    return load_machine(path)


def geared_elbow(machine: Machine, folder: Path, visits: int, seed: int) -> Recording:
    """The planar arm by its two sines; the elbow is off by 300 µrad, 18 times per revolution; the tracker by 20 µm."""
    rng = np.random.default_rng(seed)
    q = rng.uniform([-1.5, -2.0], [1.5, 2.0], (visits, 2))
    elbow = q.sum(axis=1) + 300e-6 * np.sin(18 * q[:, 1])
    xyz = np.zeros((visits, 3))
    xyz[:, 0] = 0.6 * np.cos(q[:, 0]) + 0.5 * np.cos(elbow)
    xyz[:, 1] = 0.6 * np.sin(q[:, 0]) + 0.5 * np.sin(elbow)
    xyz += 2e-5 * rng.normal(size=xyz.shape)
    path = folder / f"geared{seed}.csv"
    rows = [",".join(repr(float(v)) for v in row) for row in np.hstack([q, xyz])]
    path.write_text("\n".join(["q_shoulder,q_elbow,ball_x,ball_y,ball_z", *rows]) + "\n", encoding="utf-8")
    return load_recording(path, machine)


def rms(errors: Array) -> float:
    return float(np.sqrt((errors**2).sum(axis=-1).mean()))


def test_a_gear_that_errs_18_times_per_revolution_is_taken_out_and_the_file_keeps_it(tmp_path: Path) -> None:
    machine = two_links(tmp_path)
    known, unseen = geared_elbow(machine, tmp_path, 1200, 1), geared_elbow(machine, tmp_path, 200, 2)
    nothing = rms(unseen.points - nominal_points(unseen.q))
    calibration = Calibration.of(estimate(joint_model(machine, known), known), known, "joint")
    left = residuals(unseen, calibration)
    noise = 2e-5 * np.sqrt(3)
    assert nothing == pytest.approx(np.hypot(0.5 * 300e-6 / np.sqrt(2), noise), rel=0.1)
    assert rms(left) < 1.25 * noise
    calibration.save(tmp_path / "cal.json")
    again = residuals(unseen, load_calibration(tmp_path / "cal.json", machine))
    np.testing.assert_allclose(again, left, atol=1e-12)


def nominal_points(q: Array) -> Array:
    both = q.sum(axis=1)
    x = 0.6 * np.cos(q[:, 0]) + 0.5 * np.cos(both)
    y = 0.6 * np.sin(q[:, 0]) + 0.5 * np.sin(both)
    return np.stack([x, y, np.zeros_like(x)], axis=1)[:, None]


def test_fine_waves_are_asked_for_only_where_visits_abound(tmp_path: Path) -> None:
    machine = two_links(tmp_path)
    few, many = geared_elbow(machine, tmp_path, 669, 3), geared_elbow(machine, tmp_path, 1200, 4)
    assert [t.kind for t in joint_model(machine, few).terms].count("own_motion") == 0
    own = [t for t in joint_model(machine, many).terms if t.kind == "own_motion"]
    assert [t.frame for t in own] == [1, 2]
    # 1,200 visits, 16 for each wave: waves 17 … 75
    assert [len(t.parameters(machine.frame_names)) for t in own] == [59, 59]


def test_blocks_of_ten_visits_go_to_the_folds_in_turn() -> None:
    folds = blocks(115)
    assert folds[[0, 9, 10, 49, 50, 114]].tolist() == [0, 0, 1, 4, 0, 1]


def test_shuffled_folds_are_of_one_size_and_the_same_every_time() -> None:
    folds = shuffled(103)
    assert sorted(np.bincount(folds).tolist()) == [20, 20, 21, 21, 21]
    assert (folds == shuffled(103)).all()
    assert (folds != np.sort(folds)).any()


def test_a_station_is_held_out_whole() -> None:
    assert grouped(["a", "a", "b", "a", "c", "b"]).tolist() == [0, 0, 1, 0, 2, 1]


def test_no_model_sees_what_it_is_scored_on(tmp_path: Path) -> None:
    machine = two_links(tmp_path)
    recording = geared_elbow(machine, tmp_path, 60, 5)
    seen: list[set[float]] = []

    def fit(_: Machine, known: Recording):  # type: ignore[no-untyped-def]
        seen.append(set(known.q[:, 0]))

        def score(held: Recording) -> Array:
            assert not seen[-1] & set(held.q[:, 0])
            return held.points

        return score

    score = cross_validate(machine, recording, fit, blocks(60))
    np.testing.assert_array_equal(score.residuals, recording.points)
    assert [len(s) for s in seen] == [40, 50, 50, 50, 50]


def test_the_mean_is_the_mean_of_lengths() -> None:
    figures = Score(np.array([[[3e-3, 4e-3, 0.0]], [[0.0, 0.0, 1e-3]], [[np.nan] * 3]])).figures()
    assert figures["mean_mm"] == pytest.approx(3.0)
    assert figures["readings"] == 2


def test_a_leaning_base_is_found_with_the_sag_that_leaning_brings() -> None:
    """The column sags by 3e-5 rad per N·m; the machine stands turned and 30 mrad off level somewhere in the room."""
    machine = load_machine(ROOT / "machines" / "real" / "hilti.yaml")
    rng = np.random.default_rng(0)
    q = np.column_stack([np.full(12, 3.2), rng.uniform(-1.0, 1.0, (12, 6))])
    recording = hilti_like(machine, q)
    model = joint_model(machine, recording, waves=0)
    theta = np.zeros(len(model.parameters()))
    for k, parameter in enumerate(model.parameters()):
        if parameter.name in ("column.C[rx,Mx][0]", "column.C[ry,My][0]"):
            theta[k] = 3e-5
    truth = inverse(from_xyz_rpy(np.array([4.0, -2.0, 0.3]), np.array([0.02, -0.022, 1.1])))
    there = model.__class__(leaning(machine, truth), model.terms, model.target_offset)
    points = there.predict(Situation.of(recording), theta)
    stood = inverse(truth)
    measured = points @ stood[:3, :3].T + stood[:3, 3]
    moved = hilti_like(machine, q, measured)
    frame, _ = refit(model, theta, moved, follow_gravity=True)
    assert np.linalg.norm(rotation_vector(frame[:3, :3] @ truth[:3, :3].T)) < 1e-6
    assert np.abs(frame[:3, 3] - truth[:3, 3]).max() < 5e-6
    level, _ = refit(model, theta, moved, follow_gravity=False)
    assert np.linalg.norm(rotation_vector(level[:3, :3] @ truth[:3, :3].T)) > 1e-5


def hilti_like(machine: Machine, q: Array, points: Array | None = None) -> Recording:
    n = len(q)
    nothing: dict[str, Array] = {}
    return Recording(
        machine.joint_names, ("prism",), np.full(n, np.nan), ("h3.2_b0:stationing",) * n, ("",) * n, q, q,
        np.zeros(q.shape, dtype=np.int64), np.full(n, np.nan), np.zeros((n, 6)),
        np.zeros((n, 1, 3)) if points is None else points, nothing, nothing, nothing, False, "made up", "",
    )  # fmt: skip


def test_a_tilt_counts_from_its_mean_and_turns_what_it_should(tmp_path: Path) -> None:
    recording = geared_elbow(two_links(tmp_path), tmp_path, 3, 6)
    recording.covariates.update(a=np.array([1e-3, 2e-3, 3e-3]), b=np.zeros(3))
    term = MeasuredTilt.of(0, ("a", "b"), ("", ""), Constant(), recording)
    names = [p.name for p in term.parameters(("base", "shoulder", "elbow"))]
    design = term.regressors(Situation.of(recording), np.zeros((3, 3, 6)))
    np.testing.assert_allclose(design[:, 3, names.index("base.rx/a[0]")], [-1e-3, 0.0, 1e-3], atol=1e-15)
    assert not design[:, [0, 1, 2, 4, 5], names.index("base.rx/a[0]")].any()


def test_without_recordings_the_study_says_which_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--data", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    complaint = capsys.readouterr().err.strip()
    assert "flat.yaml: no such recording" in complaint
    assert "\n" not in complaint
    assert not (tmp_path / "out").exists()


def test_the_table_says_what_was_missed() -> None:
    figures = {"rms_mm": 0.15, "mean_mm": 0.14, "p95_mm": 0.2, "max_mm": 0.3, "readings": 9.0}
    text = markdown([Row("ur10 C", "joint", "blocks", figures, 1.0, 1.0)], [Check("C", 0.49, 0.12, 0.15)], False)
    assert "| ur10 C | joint | blocks | 9 | 0.1500 | 0.1400 | 0.2000 | 0.3000 | 1.0 | 0.112 |" in text
    assert "| C | 0.49 | 0.12 | 0.150 | least only |" in text


def test_hilti_from_floor_to_floor_within_2_3_mm_with_straight_lines_alone(tmp_path: Path) -> None:
    """Kindle et al.'s protocol; 2.3 mm is what was asked for, 8 mm what the ideal machine leaves (docs/figures.md)."""
    source = DATA / "hilti"
    if not source.is_dir():
        pytest.skip(f"no recordings of real machines: {source} is absent (set PPSHW_DATA to where they are)")
    machine = load_machine(ROOT / "machines" / "real" / "hilti.yaml")
    found = {}
    for name in ("flat", "orthogonal_wood"):
        hilti.convert(source / f"{name}.yaml", tmp_path / f"{name}.csv")
        found[name] = load_recording(tmp_path / f"{name}.csv", machine)
    fitted = estimate(joint_model(machine, found["flat"], waves=0), found["flat"])
    score = Score(across(fitted.model, fitted.theta, found["orthogonal_wood"], follow_gravity=False))
    assert score.figures()["readings"] == 319
    assert score.figures()["mean_mm"] < 2.3
    ideal = nominal(machine, found["flat"])(found["flat"])
    assert rms(ideal[:, 0]) * 1e3 == pytest.approx(9.01, abs=0.05)  # ../shared/data/README.md
