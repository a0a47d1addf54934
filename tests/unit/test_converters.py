"""Converters and machine files for real machines: against the publishers' geometry and the data themselves.

Kinematics here are written a second time, from the URDF and from the DH tables; nothing of ppshw.kinematics is used.
Without the recordings (../shared/data, or wherever PPSHW_DATA says) what needs them is skipped.
"""

from __future__ import annotations

import math
import os
import sqlite3
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ppshw.converters import hilti, ur5, ur10
from ppshw.converters.__main__ import main
from ppshw.errors import RecordingError
from ppshw.machine import Machine, load_machine
from ppshw.recording import Recording, load_recording

Array = NDArray[np.float64]
ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("PPSHW_DATA", ROOT.parent / "shared" / "data"))
REAL = ROOT / "machines" / "real"

RIGHT = math.pi / 2
# Universal Robots' published tables: d, a, α per joint, classic DH.
DH = {
    "ur10": [(0.1273, 0, RIGHT), (0, -0.612, 0), (0, -0.5723, 0), (0.163941, 0, RIGHT), (0.1157, 0, -RIGHT),
             (0.0922, 0, 0)],
    "ur5": [(0.089159, 0, RIGHT), (0, -0.425, 0), (0, -0.39225, 0), (0.10915, 0, RIGHT), (0.09465, 0, -RIGHT),
            (0.0823, 0, 0)],
}  # fmt: skip


def raw(*parts: str) -> Path:
    path = DATA.joinpath(*parts)
    if not path.is_file():
        pytest.skip(f"no recordings of real machines: {path} is absent (set PPSHW_DATA to where they are)")
    return path


def machine(name: str) -> Machine:
    return load_machine(REAL / f"{name}.yaml")


# --- kinematics, written again --------------------------------------------------------------------------------


def pose(rotation: Array, xyz: Any) -> Array:
    out = np.zeros((*rotation.shape[:-2], 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = rotation, xyz, 1.0
    return out


def along(prismatic: bool, axis: Array, q: Array) -> Array:
    """(n, 4, 4) motion of a joint by q (n,)."""
    if prismatic:
        return pose(np.broadcast_to(np.eye(3), (len(q), 3, 3)), q[:, None] * axis)
    return pose(Rotation.from_rotvec(q[:, None] * axis).as_matrix(), 0.0)


def machine_frames(m: Machine, q: Array) -> list[Array]:
    """The joint frames after motion and the tip, n + 1 times (N, 4, 4)."""
    out, frame = [], np.broadcast_to(np.eye(4), (len(q), 4, 4))
    for k, j in enumerate(m.joints):
        frame = frame @ j.origin @ along(j.prismatic, j.axis, q[:, k])
        out.append(frame)
    return [*out, frame @ m.tip_in_link]


def dh_flange(table: list[tuple[float, float, float]], q: Array) -> Array:
    """Rz(θ) Tz(d) Tx(a) Rx(α), the textbook product."""
    frame = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    for k, (d, a, alpha) in enumerate(table):
        turn = pose(Rotation.from_euler("z", q[:, [k]]).as_matrix(), [0, 0, d])
        frame = frame @ turn @ pose(Rotation.from_euler("x", alpha).as_matrix(), [a, 0, 0])
    return frame


def urdf_link(path: Path, link: str, q: dict[str, Array]) -> Array:
    """Pose of a URDF link in the root frame, mimic joints included; q by joint name, each (N,)."""
    joints = {j.find("child").get("link"): j for j in ET.parse(path).getroot().findall("joint")}  # type: ignore[union-attr]
    chain = []
    while link in joints:
        chain.append(joints[link])
        link = joints[link].find("parent").get("link")  # type: ignore[union-attr, assignment]
    n = len(next(iter(q.values())))
    frame = np.broadcast_to(np.eye(4), (n, 4, 4))
    for j in reversed(chain):
        origin = j.find("origin")
        xyz, rpy = (np.array([float(v) for v in origin.get(key).split()]) for key in ("xyz", "rpy"))  # type: ignore[union-attr]
        frame = frame @ pose(Rotation.from_euler("xyz", rpy).as_matrix(), xyz)
        if j.get("type") == "fixed":
            continue
        mimic = j.find("mimic")
        if mimic is None:
            value = q[str(j.get("name"))]
        else:
            value = float(mimic.get("multiplier")) * q[str(mimic.get("joint"))] + float(mimic.get("offset"))  # type: ignore[arg-type]
        axis = np.array([float(v) for v in j.find("axis").get("xyz").split()])  # type: ignore[union-attr]
        frame = frame @ along(j.get("type") == "prismatic", axis, value)
    return frame


def refit(tip: Array, measured: Array, target: Array) -> tuple[Array, Array]:
    """Base pose and target offset by least squares: residuals (N, 3) [mm]; x = rotation, translation, target."""
    start = tip[:, :3, :3] @ target + tip[:, :3, 3]
    turn, _ = Rotation.align_vectors(measured - measured.mean(0), start - start.mean(0))
    x0 = np.r_[turn.as_rotvec(), measured.mean(0) - turn.apply(start.mean(0)), target]

    def residual(x: Array) -> Array:
        points = tip[:, :3, :3] @ x[6:] + tip[:, :3, 3]
        return np.asarray(1e3 * (Rotation.from_rotvec(x[:3]).apply(points) + x[3:6] - measured)).ravel()

    found = least_squares(residual, x0)
    return found.fun.reshape(-1, 3), found.x


def rms(residuals: Array) -> float:
    return float(np.sqrt((residuals**2).sum(axis=1).mean()))


def nominal_rms(rec: Recording, m: Machine) -> float:
    return rms(refit(machine_frames(m, rec.q)[-1], rec.points[:, 0], m.target_array[0])[0])


# --- machine files --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ur10", "ur10_pose", "ur5"])
def test_a_universal_robot_stands_where_its_dh_table_says(name: str) -> None:
    q = np.random.default_rng(3).uniform(-math.pi, math.pi, (50, 6))
    ours = machine_frames(machine(name), q)[-1]
    assert np.abs(ours - dh_flange(DH[name.removesuffix("_pose")], q)).max() < 1e-12


def test_ur10_links_weigh_where_the_maker_says() -> None:
    # Published in the DH frame at the link's far end: the upper arm's centre is 0.38 m back from the elbow.
    m = machine("ur10")
    wrist = (0, 0.007, 0.018)
    published = [(0.021, 0, 0.027), (0.38, 0, 0.158), (0.24, 0, 0.068), wrist, wrist, (0, 0, -0.026)]
    for joint, (d, a, alpha), com in zip(m.joints, DH["ur10"], published, strict=True):
        in_joint = Rotation.from_euler("x", alpha).apply(com) + np.array([a, 0, d])
        assert joint.com == pytest.approx(in_joint, abs=1e-12)
    assert sum(j.mass for j in m.joints) == pytest.approx(28.435)


def test_both_ur10_files_are_one_machine_but_for_the_virtual_targets() -> None:
    one, three = machine("ur10"), machine("ur10_pose")
    for a, b in zip(one.joints, three.joints, strict=True):
        assert (a.name, a.mass, a.elastic, a.limits) == (b.name, b.mass, b.elastic, b.limits)
    assert list(three.targets) == ["tmac", "tmac_ex", "tmac_ey"]


def test_ur5_agrees_with_its_urdf() -> None:
    path = raw("ur5", "ur5_nominal.urdf")
    m = machine("ur5")
    q = np.random.default_rng(4).uniform(-math.pi, math.pi, (50, 6))
    named = {f"{name}_joint": q[:, k] for k, name in enumerate(m.joint_names)}
    tip = machine_frames(m, q)[-1]
    reflector = tip[:, :3, :3] @ m.targets["smr"] + tip[:, :3, 3]
    assert np.abs(reflector - urdf_link(path, "ee_link", named)[:, :3, 3]).max() < 1e-9
    bodies = inertials(path)
    for k, joint in enumerate(m.joints, start=1):
        assert (joint.mass, *joint.com) == pytest.approx(bodies[f"l{k}"])


def test_hilti_agrees_with_its_urdf_for_points_and_for_weight() -> None:
    path = raw("hilti", "trailblazer.urdf")
    m = machine("hilti")
    rng = np.random.default_rng(5)
    q = np.column_stack([rng.uniform(1.48, 3.972, 50), rng.uniform(-2.5, 2.5, (50, 6))])
    named = dict(zip(["column_prismatic_joint", *(f"dsr_joint{k}" for k in range(1, 7))], q.T, strict=True))
    frames = machine_frames(m, q)
    for name, place in [*m.targets.items(), *m.points.items()]:
        ours = frames[-1][:, :3, :3] @ place + frames[-1][:, :3, 3]
        link = {"prism": "prism", "drill": "drill_tip"}[name]
        assert np.abs(ours - urdf_link(path, link, named)[:, :3, 3]).max() < 1e-9
    assert np.abs(frames[0] - urdf_link(path, "column_tip", named)).max() < 1e-9  # over the two mimic joints

    # The moving bodies' first moment about the column's foot, mimic joints and all, is what a tilted base would feel.
    moving = ["column_middle", "column_top", "column_tip_mount", *(f"dsr_link{k}" for k in range(1, 7)), "dsr_base_0",
              "tool_link"]  # fmt: skip
    bodies = inertials(path)
    foot = np.array([0.5, 0, 0.14])
    theirs = sum(
        bodies[b][0] * (urdf_link(path, b, named) @ np.r_[bodies[b][1:], 1.0] - np.r_[foot, 1.0])[:, :3] for b in moving
    )
    ours = sum(
        j.mass * (frame[:, :3, :3] @ j.com + frame[:, :3, 3] - foot) for j, frame in zip(m.joints, frames, strict=False)
    )
    assert np.abs(ours - theirs).max() < 1e-3  # kg·m of about 150, the file's rounding
    assert sum(j.mass for j in m.joints) == pytest.approx(sum(bodies[b][0] for b in moving) - 16.2 / 2)


def inertials(path: Path) -> dict[str, tuple[float, ...]]:
    """Link name → mass and centre of mass."""
    out = {}
    for link in ET.parse(path).getroot().findall("link"):
        if (found := link.find("inertial")) is not None:
            mass, origin = found.find("mass"), found.find("origin")
            assert mass is not None
            assert origin is not None
            out[str(link.get("name"))] = (float(mass.get("value", "")), *map(float, origin.get("xyz", "").split()))
    return out


# --- the recordings -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "name", "visits", "expected"),
    [
        # visits and nominal 3-D RMS [mm] as stated beside the data; pallet and orthogonal_wood: our own fit of the raw
        # files through the URDF, before these converters existed
        ("hilti/flat.yaml", "hilti", 444, 9.01),
        ("hilti/pallet.yaml", "hilti", 440, 9.33),
        ("hilti/orthogonal_wood.yaml", "hilti", 440, 9.06),
        ("ur10/series_b.csv", "ur10", 1495, 1.085),
        ("ur10/series_c.csv", "ur10", 2773, 0.99),
        ("ur5/grid.csv", "ur5", 1000, 0.701),
    ],
)
def test_the_nominal_machine_misses_as_much_as_published(
    tmp_path: Path, source: str, name: str, visits: int, expected: float
) -> None:
    out = tmp_path / "out.csv"
    converter = {"hilti": hilti, "ur10": ur10, "ur5": ur5}[name]
    assert converter.convert(raw(*source.split("/")), out) == visits
    rec = load_recording(out, machine(name))
    assert len(rec) == visits
    assert rec.seen.all()
    assert nominal_rms(rec, machine(name)) == pytest.approx(expected, abs=0.006)


def test_hilti_rows_follow_the_clock_and_know_their_station(tmp_path: Path) -> None:
    hilti.convert(raw("hilti", "flat.yaml"), tmp_path / "out.csv")
    rec = load_recording(tmp_path / "out.csv", machine("hilti"))  # refuses a time that runs backwards
    assert rec.time[-1] - rec.time[0] == pytest.approx(4403.82, abs=0.01)
    assert len(set(rec.step)) == 25  # 5 heights × (2 branches with two phases + 1 with evaluation only)
    assert rec.step[0] == "h1.98_b7:stationing"
    heights = np.array([float(label[1:5]) for label in rec.step])
    assert np.abs(rec.q[:, 0] - heights).max() < 0.008


def test_the_column_leans_under_the_arm_and_more_the_taller_it_stands(tmp_path: Path) -> None:
    # Signs of the tilt angles: weight ahead (+x) turns the column's tip about +y, weight to the left (+y) about -x.
    hilti.convert(raw("hilti", "flat.yaml"), tmp_path / "out.csv")
    m = machine("hilti")
    rec = load_recording(tmp_path / "out.csv", m)
    frames = machine_frames(m, rec.q)
    bodies = zip(m.joints, frames, strict=False)
    moment = 9.80665 * np.sum(
        [j.mass * (frame[:, :3, :3] @ j.com + frame[:, :3, 3] - frames[0][:, :3, 3]) for j, frame in bodies], axis=0
    )
    for angle, direction, sign in [("y", 0, 1), ("x", 1, -1)]:
        lean = rec.covariates[f"tilt_tip_{angle}"] - rec.covariates[f"tilt_base_{angle}"]
        compliance = []
        for height in (1.98, 3.87):
            here = np.abs(rec.q[:, 0] - height) < 0.01
            assert sign * np.corrcoef(moment[here, direction], lean[here])[0, 1] > 0.92
            compliance.append(sign * np.polyfit(moment[here, direction], lean[here], 1)[0])
        assert 4e-6 < compliance[0] < 1e-5  # rad/(N·m)
        assert 3 < compliance[1] / compliance[0] < 5


def test_a_tilted_base_shows_in_its_sensor_as_in_the_total_station(tmp_path: Path) -> None:
    m = machine("hilti")
    lean = {}
    for name in ("flat", "orthogonal_wood"):
        hilti.convert(raw("hilti", f"{name}.yaml"), tmp_path / "out.csv")
        rec = load_recording(tmp_path / "out.csv", m)
        _, x = refit(machine_frames(m, rec.q)[-1], rec.points[:, 0], m.target_array[0])
        up = Rotation.from_rotvec(x[:3]).inv().apply([0, 0, 1])  # the total station is levelled
        lean[name] = (-up[0], rec.covariates["tilt_base_y"].mean())
    optical, inertial = (lean["orthogonal_wood"][k] - lean["flat"][k] for k in (0, 1))
    assert optical == pytest.approx(-0.0197, abs=2e-4)  # backward: about -y
    assert inertial == pytest.approx(optical, abs=1e-3)


def test_the_tmac_turns_with_the_flange(tmp_path: Path) -> None:
    # With the wrong Euler convention the virtual targets would miss by tens of millimetres, not like the origin does.
    ur10.convert(raw("ur10", "series_b.csv"), tmp_path / "out.csv", with_orientation=True)
    m = machine("ur10_pose")
    rec = load_recording(tmp_path / "out.csv", m)
    tip = machine_frames(m, rec.q)[-1]
    for k in (1, 2):
        residuals, x = refit(tip, rec.points[:, k], m.target_array[k])
        assert rms(residuals) < 1.3
        assert x[6:] == pytest.approx(m.target_array[k], abs=1e-3)
    sides = rec.points[:, 1] - rec.points[:, 0], rec.points[:, 2] - rec.points[:, 0]
    assert np.linalg.norm(sides[0], axis=1) == pytest.approx(0.1, abs=1e-9)
    assert np.abs((sides[0] * sides[1]).sum(axis=1)).max() < 1e-9


def test_stale_readings_are_said_and_kept(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert ur10.convert(raw("ur10", "series_b.csv"), tmp_path / "out.csv") == 1495
    assert [r.getMessage().split(":")[1] for r in caplog.records] == ["534", "1065"]


@pytest.mark.parametrize(("sign", "sags"), [(1, True), (-1, False)])
def test_the_ur5_sags_only_with_the_sign_of_the_difference_that_we_chose(tmp_path: Path, sign: int, sags: bool) -> None:
    ur5.convert(raw("ur5", "grid.csv"), tmp_path / "out.csv")
    m = machine("ur5")
    rec = load_recording(tmp_path / "out.csv", m)
    lines = (tmp_path / "out.csv").read_text().splitlines()
    columns = [lines[0].split(",").index(f"goal_{a}") for a in "xyz"]
    goal = np.array([[float(line.split(",")[k]) for k in columns] for line in lines[1:]])
    measured = goal + sign * (rec.points[:, 0] - goal)
    compliance, std = shoulder_compliance(m, rec.q, measured)
    assert (compliance > 10 * std) == sags
    assert abs(compliance) == pytest.approx(3.2e-5, rel=0.1)  # rad/(N·m)


def shoulder_compliance(m: Machine, q: Array, measured: Array) -> tuple[float, float]:
    """Wind-up of shoulder_lift per own-weight torque beside six constant errors in every frame; value, std.

    measured − nominal = Σ_k [R_k, −R_k (r_k×)] ε_k + c τ (z × r),   τ = z · Σ (p_b − o) × m_b g,   linear in ε and c
    """
    frames = machine_frames(m, q)
    _, x = refit(frames[-1], measured, m.target_array[0])
    at_base = Rotation.from_rotvec(x[:3]).inv().apply(measured - x[3:6])
    point = frames[-1][:, :3, :3] @ x[6:] + frames[-1][:, :3, 3]
    blocks = []
    for frame in [np.broadcast_to(np.eye(4), frames[0].shape), *frames]:
        turn = np.cross(np.swapaxes(frame[:, :3, :3], 1, 2), (point - frame[:, :3, 3])[:, None, :])
        blocks += [frame[:, :3, :3], np.swapaxes(turn, 1, 2)]
    origin, axis = frames[1][:, :3, 3], frames[1][:, :3, 2]
    weight = sum(
        np.cross(frame[:, :3, :3] @ j.com + frame[:, :3, 3] - origin, j.mass * m.gravity)
        for j, frame in list(zip(m.joints, frames, strict=False))[1:]
    )
    torque = (axis * weight).sum(axis=1)
    blocks.append((torque[:, None] * np.cross(axis, point - origin))[:, :, None])
    a = np.concatenate(blocks, axis=2).reshape(3 * len(q), -1)
    scale = np.linalg.norm(a, axis=0)
    b = (at_base - point).ravel()
    u, s, vt = np.linalg.svd(a / scale, full_matrices=False)
    keep = s > 1e-7 * s[0]
    solution = (vt[keep].T / s[keep]) @ (u[:, keep].T @ b)
    sigma = np.linalg.norm(b - a / scale @ solution) / math.sqrt(len(b) - keep.sum())
    spread = sigma * np.linalg.norm(vt[keep, -1] / s[keep])
    return float(solution[-1] / scale[-1]), float(spread / scale[-1])


# --- small files written here, so that these run without the recordings ------------------------------------------

HILTI_ENTRY = """
        - id: {id}
          time: {time}
          upside_down: false
          doosan_cmd: [0.4, 0.0, 0.5]
          joint_states: [2.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
          prism_position: {prism}
          tilt_sensor_base_accel: [-0.0980665, 0.0, 9.80616]
          tilt_sensor_column_accel: [0.0, 0.0980665, 9.80616]"""


def hilti_file(path: Path, prism: str = "[1.0, 2.0, 3.0]") -> Path:
    head = f"joint_names: [column_prismatic_joint, {', '.join(f'dsr_joint{k}' for k in range(1, 7))}]"
    entries = [HILTI_ENTRY.format(id=k, time=t, prism=prism) for k, t in ((0, 1700000010.25), (1, 1700000000.5))]
    path.write_text(
        f"{head}\ncolumn_heights:\n  2.0:\n    solution_spaces:\n      7:\n"
        f"        stationing_measurements:{entries[0]}\n"
        f"        evaluation_measurements:{entries[1]}\n"
    )
    return path


def ur10_row(**other: str) -> list[str]:
    cells = dict.fromkeys(ur10._COLUMNS, "0")
    cells |= {"Timestamp": "2,02011E+13", "elbow_joint": "-1,5"}
    cells |= {"measurement_x": "383,76294", "measurement_std_x": "0,031674"}
    return list((cells | other).values())


def ur10_file(path: Path, *rows: list[str]) -> Path:
    path.write_text("\r\n".join(";".join(r) for r in ([*ur10._COLUMNS], *rows)) + "\r\n")
    return path


def test_hilti_visits_are_ordered_by_time_and_tilts_are_angles(tmp_path: Path) -> None:
    assert hilti.convert(hilti_file(tmp_path / "in.yaml"), tmp_path / "out.csv") == 2
    rec = load_recording(tmp_path / "out.csv", machine("hilti"))
    assert rec.step == ("h2.0_b7:evaluation", "h2.0_b7:stationing")
    assert rec.time == pytest.approx([1700000000.5, 1700000010.25], abs=1e-6)
    # A hundredth of g along -x is a turn about +y, along +y a turn about +x.
    assert rec.covariates["tilt_base_y"] == pytest.approx(0.01, abs=1e-6)
    assert rec.covariates["tilt_tip_x"] == pytest.approx(0.01, abs=1e-6)
    assert rec.covariates["tilt_base_x"] == pytest.approx(0.0)


def test_ur10_units_and_decimal_commas(tmp_path: Path) -> None:
    second = ur10_row(measurement_temperature="21,5", measurement_y="-2,78E-02")
    source = ur10_file(tmp_path / "in.csv", ur10_row(), second)
    ur10.convert(source, tmp_path / "out.csv")
    rec = load_recording(tmp_path / "out.csv", machine("ur10"))
    assert rec.points[:, 0].tolist() == [[0.38376294, 0, 0], [0.38376294, -2.78e-05, 0]]
    assert rec.q[0].tolist() == [0, 0, -1.5, 0, 0, 0]
    assert rec.temperatures["air"].tolist() == [0, 21.5]
    assert rec.covariates["std_x"].tolist() == [0.031674e-3, 0.031674e-3]
    assert np.isnan(rec.time).all()


def test_ur5_measured_is_target_plus_difference(tmp_path: Path) -> None:
    source = tmp_path / "in.csv"
    source.write_text(",".join(ur5._COLUMNS) + "\n0,-430.5,10,20,-2.25,0.5,1,90,-45,180,0,0,30\n")
    ur5.convert(source, tmp_path / "out.csv")
    rec = load_recording(tmp_path / "out.csv", machine("ur5"))
    assert rec.points[0, 0].tolist() == [-0.43275, 0.0105, 0.021]
    assert rec.q_cmd[0] == pytest.approx([RIGHT, -RIGHT / 2, math.pi, 0, 0, math.pi / 6], abs=1e-15)


def test_bad_input_is_one_line_and_leaves_nothing_behind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cases = {
        "hilti": (hilti_file(tmp_path / "a.yaml", prism="[1.0, .nan, 3.0]"),
                  "height 2.0, solution space 7, stationing_measurements, id 0: 'prism_position' is"),
        "ur10": (ur10_file(tmp_path / "b.csv", ur10_row(), ur10_row(measurement_z="12;5")), "b.csv:3: 27 cells"),
        "ur5": (tmp_path / "absent.csv", "absent.csv: No such file"),
    }  # fmt: skip
    for name, (source, message) in cases.items():
        assert main([name, str(source), str(tmp_path / "out.csv")]) == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
    assert not (tmp_path / "out.csv").exists()
    assert not list(tmp_path.glob("*.part"))


def test_neither_the_published_file_nor_a_recording_is_written_over(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = ur10_file(tmp_path / "in.csv", ur10_row())
    recording = tmp_path / "r.db"
    with sqlite3.connect(recording) as database:
        database.execute("create table visits (k)")
    kept = source.read_bytes(), recording.read_bytes()
    assert main(["ur10", str(source), str(source)]) == 2
    assert capsys.readouterr().err == f"{source}: is what is read here, expected another file to write\n"
    assert main(["ur10", str(source), str(recording)]) == 2
    assert capsys.readouterr().err == f"{recording}: is a recording already, expected another file to write\n"
    assert (source.read_bytes(), recording.read_bytes()) == kept
    assert main(["ur10", str(source), str(tmp_path / "nowhere" / "out.csv")]) == 2
    assert "nowhere does not exist\n" in capsys.readouterr().err


def test_a_cell_that_is_no_number_is_named_by_line_and_column(tmp_path: Path) -> None:
    source = ur10_file(tmp_path / "in.csv", ur10_row(), ur10_row(elbow_joint="n/a"))
    with pytest.raises(RecordingError, match=r"in\.csv:3: column elbow_joint: 'n/a' is not a number"):
        ur10.convert(source, tmp_path / "out.csv")


def test_another_file_than_the_published_one_is_refused(tmp_path: Path) -> None:
    source = tmp_path / "in.csv"
    source.write_text("step_order,x_t,comment\n0,1,2\n")
    with pytest.raises(RecordingError, match=r"in\.csv:1: column 'y_t' is missing"):
        ur5.convert(source, tmp_path / "out.csv")
    source.write_text("joint_names: [a, b]\n")
    with pytest.raises(RecordingError, match="joint_names are"):
        hilti.convert(source, tmp_path / "out.csv")


def test_the_command_line_says_how_many_visits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = ur10_file(tmp_path / "in.csv", ur10_row())
    assert main(["ur10", "--with-orientation", str(source), str(tmp_path / "out.csv")]) == 0
    assert capsys.readouterr().out.strip().endswith("out.csv: 1 visits")
    rec = load_recording(tmp_path / "out.csv", machine("ur10_pose"))
    assert rec.points[0, 1] - rec.points[0, 0] == pytest.approx([0.1, 0, 0])
    assert rec.points[0, 2] - rec.points[0, 0] == pytest.approx([0, 0.1, 0])
