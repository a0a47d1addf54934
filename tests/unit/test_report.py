"""The verification's arithmetic by hand, and a page made from a simulated machine that was really identified."""

from __future__ import annotations

import base64
import csv
import hashlib
import json
import re
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.stats import chi2

from ppshw.calibration import Calibration, content_digest
from ppshw.cli import main
from ppshw.compensation import Bounds
from ppshw.compensation.inverse import solve_pose
from ppshw.errors import BadInput, RecordingError, ReportError
from ppshw.identification.joint import BELIEVED, SET_ASIDE, estimate
from ppshw.identification.structure import joint_model
from ppshw.kinematics import tip_poses
from ppshw.machine import Machine, load_machine
from ppshw.quantities import angle, distance, rounded, value_of
from ppshw.recording import Recording, columns_for, load_recording
from ppshw.recording_file import RecordingFile
from ppshw.report import build_report
from ppshw.report.contents import read_folder
from ppshw.report.numbers import compute, fit
from ppshw.report.page import headline
from ppshw.report.tables import facts, mm
from ppshw.verification import point_errors, repeatability, returns_of
from simulators.plant import Plant

NOW = datetime(2026, 3, 5, 12, 0, tzinfo=UTC)

# One slide along x, a quarter turn of the tool about z behind it; the tracker stands at (1, 2, 3), turned a quarter
# turn about z: what it calls x is the base's y, what it calls y is the base's −x.
SLIDE = """\
name: slide
gravity: [0, 0, -9.81]
joints:
  - {name: s, type: prismatic, origin: {xyz: [0, 0, 0], rpy: [0, 0, 0]}, axis: [1, 0, 0]}
tip:
  origin: {xyz: [0, 0, 0], rpy: [0, 0, 1.5707963267948966]}
  targets: {P1: [0, 0, 0]}
  points: {treatment: [0.2, 0, 0]}
tracker: {base: BASE}
"""
KNOWN = "{xyz: [1, 2, 3], rpy: [0, 0, 1.5707963267948966]}"


def slide(folder: Path, base: str = KNOWN) -> Machine:
    (folder / "machine.yaml").write_text(SLIDE.replace("BASE", base))
    return load_machine(folder / "machine.yaml")


def recording(folder: Path, machine: Machine, header: str, *rows: str) -> Recording:
    path = folder / "r.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    return load_recording(path, machine)


COLUMNS = "load,q_cmd_s,P1_x,P1_y,P1_z,treatment_x,treatment_y,treatment_z"


# Errors at the point -------------------------------------------------------------------------------------------------


def test_the_error_is_measured_minus_wanted_in_the_base_frame(tmp_path: Path) -> None:
    machine = slide(tmp_path)
    # wanted s = 0.5 puts the point at (0.5, 0.2, 0) of the base; it was seen at (0.501, 0.198, 0.003), which is
    # (−0.499, −1.802, −2.997) from the tracker's place, and along the tracker's own axes (−1.802, 0.499, −2.997)
    made = recording(tmp_path, machine, COLUMNS + ",cov_wanted_s", "a,0.4,,,,-1.802,0.499,-2.997,0.5")
    assert point_errors(made, machine, "treatment")[0] == pytest.approx([1e-3, -2e-3, 3e-3], abs=1e-12)


def test_without_wanted_columns_the_setpoints_were_wanted(tmp_path: Path) -> None:
    machine = slide(tmp_path)
    made = recording(tmp_path, machine, COLUMNS, "a,0.4,,,,-1.802,0.499,-2.997", "a,0.5,,,,,,")
    errors = point_errors(made, machine, "treatment")
    assert errors[0] == pytest.approx([101e-3, -2e-3, 3e-3], abs=1e-12)
    assert np.isnan(errors[1]).all()


def test_a_wanted_joint_value_left_empty_is_an_error(tmp_path: Path) -> None:
    machine = slide(tmp_path)
    made = recording(tmp_path, machine, COLUMNS + ",cov_wanted_s", "a,0,,,,0,0,0,0", "a,0,,,,0,0,0,")
    with pytest.raises(RecordingError, match=r"visit 2: column cov_wanted_s is empty"):
        point_errors(made, machine, "treatment")


def test_a_point_without_a_reflector_is_named(tmp_path: Path) -> None:
    machine = slide(tmp_path)
    made = recording(tmp_path, machine, "q_cmd_s,P1_x,P1_y,P1_z", "0,0,0,0")
    with pytest.raises(RecordingError, match="no column treatment_x"):
        point_errors(made, machine, "treatment")


def test_an_open_measuring_frame_is_taken_from_the_calibration_or_refused(tmp_path: Path) -> None:
    machine = slide(tmp_path, "estimate")
    made = recording(tmp_path, machine, COLUMNS, "a,0.5,,,,0.5,0.2,0.001")
    with pytest.raises(RecordingError, match=r"tracker\.base: estimate"):
        point_errors(made, machine, "treatment")
    placed = point_errors(made, machine, "treatment", np.eye(4))
    assert placed[0] == pytest.approx([0, 0, 1e-3], abs=1e-12)


def test_where_reflectors_sit_is_taken_from_the_calibration_or_refused_where_the_file_leaves_it_open(
    tmp_path: Path,
) -> None:
    machine = slide(tmp_path)
    machine = replace(machine, tracker=replace(machine.tracker, targets_known=False, base=np.eye(4)))
    # 3 mm along the end effector's x, which is the base's y; the machine stands 0.1 mm too far
    made = recording(tmp_path, machine, "q_cmd_s,P1_x,P1_y,P1_z", "0.5,0.5001,0.003,0")
    with pytest.raises(RecordingError, match=r"where the target 'P1' sits \(tracker\.targets: estimate\)"):
        point_errors(made, machine, "P1")
    errors = point_errors(made, machine, "P1", where=np.array([3e-3, 0.0, 0.0]))
    assert errors[0] == pytest.approx([1e-4, 0, 0], abs=1e-12)


# Repeatability -------------------------------------------------------------------------------------------------------


def test_repeatability_of_two_visits_by_hand(tmp_path: Path) -> None:
    machine = slide(tmp_path, "{}")
    # ±0.1 mm about the mean: standard deviation over n − 1 is 0.1·√2 mm; both are 0.1 mm off, so RP = 0.1 + 3·0
    rows = ["a,0,,,,0.0001,0.2,0", "a,0,,,,-0.0001,0.2,0"]
    again = repeatability(recording(tmp_path, machine, COLUMNS, *rows), machine, "treatment")
    assert again["sigma_mm"] == pytest.approx([0.1 * 2**0.5, 0, 0], abs=1e-9)
    assert again["p98_6_mm"] == pytest.approx(0.1 * 2**0.5)
    assert again["rp_iso9283_mm"] == pytest.approx(0.1)
    assert (again["poses"], again["visits"]) == (1, 2)


def test_iso_9283_by_hand_for_distances_of_one_two_and_three(tmp_path: Path) -> None:
    machine = slide(tmp_path, "{}")
    # y about 0.2: −3, 0, 0, 3 tenths of a mm along z: distances 3, 0, 0, 3 → mean 1.5, S over n − 1 = √3
    rows = [f"a,0,,,,0,0.2,{z}" for z in ("-0.0003", "0", "0", "0.0003")]
    again = repeatability(recording(tmp_path, machine, COLUMNS, *rows), machine, "treatment")
    assert again["rp_iso9283_mm"] == pytest.approx(0.1 * (1.5 + 3 * 3**0.5))


def test_poses_and_loads_are_not_mixed_and_single_visits_do_not_count(tmp_path: Path) -> None:
    machine = slide(tmp_path, "{}")
    rows = ["a,0,,,,0,0.2,0", "b,0,,,,0.005,0.2,0", "a,0.1,,,,0.1,0.2,0", "a,0,,,,0,0.2,0", "b,0,,,,0.005,0.2,0",
            "a,0.3,,,,0.3,0.2,0"]  # fmt: skip
    again = repeatability(recording(tmp_path, machine, COLUMNS, *rows), machine, "treatment")
    assert (again["poses"], again["visits"]) == (2, 4)
    assert again["p98_6_mm"] == pytest.approx(0, abs=1e-9)
    with pytest.raises(RecordingError, match="no pose was visited twice"):
        repeatability(recording(tmp_path, machine, COLUMNS, *rows[:3]), machine, "treatment")


def test_a_compensated_machine_returns_to_what_was_wanted_not_to_what_was_commanded(tmp_path: Path) -> None:
    machine = slide(tmp_path, "{}")
    rows = [f"a,{0.5 + k * 1e-5},,,,0.5,0.2,0,0.5" for k in range(5)]
    back = returns_of(recording(tmp_path, machine, COLUMNS + ",cov_wanted_s", *rows), machine, "treatment")
    assert back.groups == 1


def test_few_visits_per_pose_do_not_flatter_the_scatter(tmp_path: Path) -> None:
    machine = slide(tmp_path, "{}")
    rng = np.random.default_rng(4)
    rows = [f"a,{pose / 1000},,,,{pose / 1000 + x:.9f},{0.2 + y:.9f},{z:.9f}"
            for pose in range(400) for x, y, z in rng.normal(0, 5e-5, (3, 3))]  # fmt: skip
    again = repeatability(recording(tmp_path, machine, COLUMNS, *rows), machine, "treatment")
    assert again["sigma_mm"] == pytest.approx([0.05, 0.05, 0.05], rel=0.05)


# The page ------------------------------------------------------------------------------------------------------------

CELL = """\
name: cell
gravity: [0, 0, -9.81]
joints:
  - name: rail
    type: prismatic
    axis: [1, 0, 0]
    limits: {lower: -1, upper: 1}
    link: {mass: 300, com: [0, 0, 0.2]}
    elastic: {loads: [Fz, Mx, My], varies: true}
  - name: turn
    type: revolute
    origin: {xyz: [0, 0, 0.5], rpy: [0, 0, 0]}
    axis: [0, 0, 1]
    limits: {lower: -1.5, upper: 1.5}
    link: {mass: 100, com: [0, 0, 0.1]}
    elastic: {loads: [Fz, Mx, My], varies: false}
tip:
  origin: {xyz: [0.3, 0, 0.2], rpy: [0, 0, 0]}
  targets: {P1: [0, 0.01, 0.3], P2: [-0.26, 0.01, -0.15], P3: [0.26, 0.01, -0.15]}
  points: {treatment: [0.5, 0, 0.2]}
repeatability: {position: 1.0e-4}
tracker: {position_sigma: 2.0e-5, base: {xyz: [0, 0, 0]}}
"""


def write_recording(
    path: Path, machine: Machine, plant: Plant, wanted: np.ndarray, commanded: np.ndarray, rng: np.random.Generator,
    names: list[str],
) -> None:  # fmt: skip
    """A recording as the runner writes one: a database when the name ends so, else a CSV."""
    count = len(wanted)
    loads = plant.random_loads(6, rng)
    carried = [loads[k % 6] for k in range(count)]
    points = plant.true_points(commanded, carried, plant.draw_repeatability(count, rng), names)
    seen = {name: p + 2e-5 * rng.normal(size=p.shape) for name, p in points.items()}
    wrench = plant.wrench(commanded, carried)
    header = columns_for(machine, [], [n for n in names if n not in machine.targets],
                         [f"wanted_{j}" for j in machine.joint_names])  # fmt: skip
    rows = []
    for k in range(count):
        time = (datetime(2026, 3, 4, 6, tzinfo=UTC) + timedelta(seconds=90 * k)).isoformat()
        q = [f"{x:.9f}" for x in commanded[k]]
        xyz = [f"{x:.9f}" for n in names for x in seen[n][k]]
        rows.append([time, "s", f"L{k % 6}", *q, *q, *["1"] * len(q), "5", *(f"{x:.5f}" for x in wrench[k]), *xyz,
                     *(f"{x:.9f}" for x in wanted[k])])  # fmt: skip
    if path.suffix == ".db":
        meta = {"versions": json.dumps({"numpy": "2"}), "campaign_name": "<b>c"}
        RecordingFile.create(path, header, meta, rows).close()
        return
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])


def make_folder(folder: Path) -> None:
    """A campaign of 90 visits, identified; verification with and without compensation (of a cell whose two joints can
    correct but a part); repeatability."""
    (folder / "machine.yaml").write_text(CELL)
    machine, plant = load_machine(folder / "machine.yaml"), Plant.from_file(folder / "machine.yaml", seed=3)
    rng = np.random.default_rng(8)
    q = np.round(plant.random_poses(90, rng), 8)
    write_recording(folder / "campaign.csv", machine, plant, q, q, rng, list(machine.targets))
    campaign = load_recording(folder / "campaign.csv", machine)
    estimated = estimate(joint_model(machine, campaign, waves=4), campaign, rounds=5)
    calibration = Calibration.of(estimated, campaign, "joint", NOW)
    calibration.save(folder / "calibration.json")
    names = [*machine.targets, "treatment"]
    wanted = np.round(0.9 * plant.random_poses(40, rng), 8)
    scatter = np.random.default_rng(21)
    write_recording(folder / "verification_nominal.db", machine, plant, wanted, wanted, scatter, names)
    loads = plant.random_loads(6, np.random.default_rng(21))
    wrench = plant.wrench(wanted, [loads[k % 6] for k in range(40)])
    corrected, _ = solve_pose(machine, tip_poses(machine, wanted), wanted, calibration, wrench)
    write_recording(folder / "verification_compensated.db", machine, plant, wanted, corrected,
                    np.random.default_rng(21), names)  # fmt: skip
    poses = np.tile(wanted[:6], (8, 1))
    write_recording(folder / "repeatability.db", machine, plant, poses, poses, rng, names)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    make_folder(folder)
    build_report(folder, NOW)
    return folder


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "copy"
    shutil.copytree(made, folder)
    return folder


class Page(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.words += data

    def images(self) -> list[dict[str, str | None]]:
        return [attrs for tag, attrs in self.tags if tag == "img"]


def page(folder: Path) -> Page:
    return Page((folder / "report.html").read_text(encoding="utf-8"))


def test_the_page_needs_nothing_from_anywhere(made: Path) -> None:
    text = (made / "report.html").read_text(encoding="utf-8")
    seen = page(made)
    assert not {tag for tag, _ in seen.tags} & {"script", "link", "iframe", "object", "base"}
    for _, attrs in seen.tags:
        assert str(attrs.get("src", "data:")).startswith("data:")
        assert "href" not in attrs
    assert not re.search(r"url\(|@import|@font-face", text)
    pictures = [base64.b64decode(str(i["src"]).split(",", 1)[1]).decode() for i in seen.images()]
    assert len(pictures) > 15
    for svg in pictures:
        for element in ElementTree.fromstring(svg).iter():
            for name, value in element.attrib.items():
                assert not name.endswith("href") or value.startswith(("#", "data:"))
    assert len(text) < 3_000_000


def test_every_picture_says_in_words_what_it_shows(made: Path) -> None:
    alts = [str(image.get("alt") or "") for image in page(made).images()]
    assert all(len(alt) > 30 for alt in alts)
    assert len(set(alts)) == len(alts)
    captions = [tag for tag, _ in page(made).tags if tag == "figcaption"]
    assert len(captions) == len(alts)


def test_the_page_states_the_figures_that_a_plain_calculation_gives(made: Path) -> None:
    # P(treatment) of the ideal cell, by hand: (q1, 0, 0.5) + Rz(q2) ((0.3, 0, 0.2) + (0.5, 0, 0.2))
    stated = {}
    for case in ("nominal", "compensated"):
        with RecordingFile.open(made / f"verification_{case}.db", readonly=True) as file:
            header, rows = file.table()
        values = {h: np.array([row[k] for row in rows]) for k, h in enumerate(header)}
        q1, q2 = (values[f"cov_wanted_{j}"].astype(float) for j in ("rail", "turn"))
        ideal = np.stack([q1 + 0.8 * np.cos(q2), 0.8 * np.sin(q2), np.full(40, 0.9)], axis=1)
        real = np.stack([values[f"treatment_{c}"].astype(float) for c in "xyz"], axis=1)
        size = np.sort(np.linalg.norm(real - ideal, axis=1)) * 1e3
        stated[case] = (np.median(size), size[-1])
    assert stated["compensated"][0] < 0.95 * stated["nominal"][0]  # or the figures below would prove little
    words = page(made).words
    for median, largest in stated.values():
        assert f"{median:.3f}" in words
        assert f"{largest:.3f}" in words
    assert "on 40 configurations that the identification did not use" in words
    assert "48 visits of 6 poses and loads" in words  # poses 0 … 5 carry loads 0 … 5: six groups of eight
    assert "Not in this report" not in words


def test_a_reflector_that_nobody_measured_is_not_the_point_of_a_machine_without_one(copy: Path) -> None:
    without = (copy / "machine.yaml").read_text().replace("treatment", "elsewhere")
    (copy / "machine.yaml").write_text(without)
    for name in ("calibration.json", "campaign.csv", "repeatability.db"):
        (copy / name).unlink()
    machine = load_machine(copy / "machine.yaml")
    for file in copy.glob("verification_*.db"):
        with RecordingFile.open(file, readonly=True) as recording:
            header, rows = recording.table()
        kept = [k for k, name in enumerate(header) if not name.startswith(("P1_", "treatment_"))]
        file.unlink()
        lines = [",".join(row[k] for k in kept) for row in (header, *rows)]
        file.with_suffix(".csv").write_text("\n".join(lines) + "\n")
    assert list(machine.targets)[:2] == ["P1", "P2"]
    assert read_folder(copy).point == "P2"


def test_a_campaign_that_measured_points_of_interest_alone_leaves_no_residuals_to_show(copy: Path) -> None:
    header, *rows = (line.split(",") for line in (copy / "campaign.csv").read_text().splitlines())
    names = {"P1_x": "treatment_x", "P1_y": "treatment_y", "P1_z": "treatment_z"}
    lost = [k for k, name in enumerate(header) if name.startswith(("P2_", "P3_"))]
    rows = [["" if k in lost else cell for k, cell in enumerate(row)] for row in rows]
    lines = [",".join(row) for row in ([names.get(name, name) for name in header], *rows)]
    (copy / "campaign.csv").write_text("\n".join(lines) + "\n")
    build_report(copy, NOW)
    words = page(copy).words
    assert "Coverage of the joints" in words
    assert "The identification recording" not in words


def test_hashes_of_the_files_are_on_the_page(made: Path) -> None:
    words = page(made).words
    contents = read_folder(made)
    for source in contents.sources:
        assert source.sha256 in words
    assert "2026-03-05 12:00 UTC" in words
    assert "<b>c" in words  # what a file says is text, never markup
    assert hashlib.sha256((made / "calibration.json").read_bytes()).hexdigest() in words
    assert hashlib.sha256((made / "machine.yaml").read_bytes()).hexdigest() not in words
    assert "of the machine file: of what it says" in words


def test_what_the_page_says_of_outliers_and_of_setpoints_outside_is_what_is_done(made: Path) -> None:
    words = (made / "report.html").read_text(encoding="utf-8")
    assert "less than one visit in a million" in words
    assert chi2.sf(chi2.ppf(BELIEVED, 3) / SET_ASIDE, 3) < 1e-6  # of one reflector; less of more
    assert (Bounds().joints, Bounds().loads) == (1 / 20, 1 / 10)
    assert "a twentieth of a joint’s and a tenth of a load’s" in words


def test_the_same_folder_gives_the_same_page(copy: Path) -> None:
    before = (copy / "report.html").read_bytes()
    build_report(copy, NOW)
    assert (copy / "report.html").read_bytes() == before


def test_a_spoiled_visit_is_marked_and_a_lost_target_too(copy: Path) -> None:
    rows = list(csv.reader((copy / "campaign.csv").open()))
    column = rows[0].index("P2_y")
    rows[18][column] = str(float(rows[18][column]) + 2e-3)  # 2 mm, far beyond 0.1 mm of scatter
    rows[31][column - 1 : column + 2] = ["", "", ""]
    with (copy / "campaign.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    contents = read_folder(copy)
    assert contents.calibration is not None
    left = fit(contents.recordings["campaign"], contents.calibration)
    assert left.outlier[17]
    assert left.outlier.sum() <= 3
    assert np.flatnonzero(left.lost).tolist() == [30]
    assert any("was made from another recording" in note for note in compute(contents).notes)


@pytest.mark.parametrize(("of", "said"), [
    ({"machine_sha256": "another"}, "The diagnosis is of another machine file"),
    ({"recording_sha256": "another"}, "The diagnosis is of another recording"),
    ({}, ""),
])  # fmt: skip
def test_a_diagnosis_of_another_machine_or_recording_is_said_to_be_one(
    copy: Path, of: dict[str, str], said: str
) -> None:
    contents = read_folder(copy)
    mine = {"machine_sha256": contents.machine.sha256, "recording_sha256": contents.recordings["campaign"].sha256}
    (copy / "diagnosis.json").write_text(answer(provenance={**mine, **of}), encoding="utf-8")
    notes = [note for note in compute(read_folder(copy)).notes if note.startswith("The diagnosis is of")]
    assert notes == [note for note in notes if said and note.startswith(said)]
    assert len(notes) == bool(said)


def test_what_lies_where_no_joint_moves_the_point_is_said_to_stay(copy: Path) -> None:
    """Two joints of a cell: a diagnosis cannot help; the page had said only that 7.14 mm are left (a reviewer's)."""
    numbers = compute(read_folder(copy))
    (said,) = (note for note in numbers.notes if "no joint moves" in note)
    assert said.startswith(
        "Along directions in which no joint moves the point ‘treatment’ the compensated verification"
    )
    left = float(re.search(r"leaves up to ([\d.]+) mm", said)[1])  # type: ignore[index]
    # the rail goes along x and the turntable about z: nothing lifts the point
    lifted = 1e3 * np.quantile(np.abs(numbers.errors["compensated"][:, 2]), 0.986)
    assert lifted - 0.01 < left <= numbers.accuracy["compensated"]["p98_6_mm"] + 0.01
    assert left == pytest.approx(lifted, rel=0.02)


def test_a_correction_that_made_it_worse_is_called_that(copy: Path) -> None:
    one, other = (copy / f"verification_{which}.db" for which in ("nominal", "compensated"))
    one.rename(copy / "aside.db")
    other.rename(one)
    (copy / "aside.db").rename(other)
    contents = read_folder(copy)
    said = headline(contents, compute(contents))
    assert said.startswith("Compensation makes it worse: 98.6 % of the errors at the point ‘treatment’ are within ")
    assert "factor" not in said


def test_figures_that_the_run_printed_are_held_against_the_recordings(copy: Path) -> None:
    mine = compute(read_folder(copy)).accuracy
    printed = {**mine, "compensated": {**mine["compensated"], "max_mm": 0.001}, "visits": 170, "seconds": 31.4}
    (copy / "demo.json").write_text(json.dumps(printed))
    notes = compute(read_folder(copy)).notes
    notes = [note for note in notes if note.startswith("demo.json")]
    assert len(notes) == 1
    assert notes[0].startswith("demo.json says compensated max_mm = 0.001; the recording here gives")
    contents = read_folder(copy)
    assert ("Run time", "31\N{NO-BREAK SPACE}s") in facts(contents, compute(contents), None)


HIDDEN = {
    "seal": "5ea1", "conceal": 4, "seed": 1, "visits": 90, "verification_visits": 40, "diagnose_seconds": 20.0,
    "machine_hours": 9.5, "seconds": 70.0, "named": True, "joint_right": False, "false_findings": 2,
    "truth": {"effect": "backlash", "joint": "rail", "target": None, "form": "play", "parameters": {"gap": 2.519e-4},
              "units": {"gap": "m"}, "rms_mm": 0.126, "repeatability_rms_mm": 0.063},
    "taken_out": [{"effect": "backlash", "joint": "rail", "visits": 40, "why": None}],
    "not_compensated": [{"effect": "drift", "joint": None, "visits": 40, "why": "it cannot be known"}],
    "instrument_corrected": {"base": {"p98_6_mm": 0.3}, "extended": {"p98_6_mm": 0.2}},
}  # fmt: skip


def concealing(folder: Path) -> None:
    """The folder as a demo with a concealed effect leaves one: three verifications, and no repeatability."""
    (folder / "verification_compensated.db").rename(folder / "verification_extended.db")
    shutil.copy(folder / "verification_nominal.db", folder / "verification_base.db")
    shutil.copy(folder / "calibration.json", folder / "extended.json")
    (folder / "repeatability.db").unlink()
    mine = compute(read_folder(folder)).accuracy
    rows = {"nominal": mine["uncompensated"], "base": mine["base"], "extended": mine["extended"]}
    (folder / "concealed.json").write_text(json.dumps({**HIDDEN, **rows}))


def test_where_a_calibration_and_its_diagnosis_were_both_tried_the_page_says_which_is_which(copy: Path) -> None:
    """The headline and the crosses were of the second, under the name of the first."""
    shutil.copy(copy / "verification_nominal.db", copy / "verification_extended.db")
    contents = read_folder(copy)
    numbers = compute(contents)
    base, extended = (mm(numbers.accuracy[case]["p98_6_mm"]) for case in ("compensated", "extended"))
    said = headline(contents, numbers)
    assert f"to within {extended}, with what the diagnosis found ({base} with the base calibration alone)" in said
    assert said.endswith("With what the diagnosis found it is worse: use the base calibration.")  # none was corrected
    build_report(copy, NOW)
    assert "Distribution of the residual errors, with findings" in (copy / "report.html").read_text(encoding="utf-8")


def test_what_a_demo_with_a_concealed_effect_left_is_all_on_the_page(copy: Path) -> None:
    before = compute(read_folder(copy)).accuracy
    concealing(copy)
    build_report(copy, NOW)
    contents = read_folder(copy)
    numbers = compute(contents)
    assert numbers.accuracy["extended"] == before["compensated"]
    assert numbers.accuracy["base"] == before["uncompensated"]
    assert numbers.unseen
    assert [m.name for m in contents.missing] == ["repeatability.db"]
    words = " ".join(page(copy).words.split())
    for said in (
        "base calibration", "with findings", "mm with the base calibration alone), a factor of",
        "backlash of rail (play): gap 0.2519 mm; 0.126 mm rms at the reflectors",
        "effect named: yes; joint right: no; other findings: 2", "compensated, 40 visits: backlash of rail",
        "not compensated, 40 visits: drift: it cannot be known", "Verification, with findings",
        "within 0.300 mm with the base calibration and 0.200 mm with the findings", "extended.json",
    ):  # fmt: skip
        assert said in words
    assert not any("concealed.json says" in note for note in numbers.notes)


def test_a_concealed_demo_s_answer_that_lacks_something_is_refused(copy: Path) -> None:
    concealing(copy)
    whole = json.loads((copy / "concealed.json").read_text())
    for key in ("truth", "base", "taken_out", "instrument_corrected"):
        rest = {k: v for k, v in whole.items() if k != key}
        (copy / "concealed.json").write_text(json.dumps(rest))
        with pytest.raises(ReportError, match=f"concealed.json: no answer of a demo .*'{key}' is missing"):
            read_folder(copy)


def test_a_run_that_left_only_its_figures_is_reported_from_them(tmp_path: Path) -> None:
    slide(tmp_path)
    four = {"median_mm": 4.0, "p95_mm": 7.0, "p98_6_mm": 8.0, "max_mm": 9.0}
    small = {"median_mm": 0.1, "p95_mm": 0.3, "p98_6_mm": 0.4, "max_mm": 0.5}
    result = {"uncompensated": four, "compensated": small, "repeatability_mm": 0.14, "note": "<script>1</script>"}
    (tmp_path / "demo.json").write_text(json.dumps(result))
    build_report(tmp_path, NOW)
    seen = page(tmp_path)
    assert "from within 8.00\N{NO-BREAK SPACE}mm to within 0.400\N{NO-BREAK SPACE}mm, a factor of 20" in seen.words
    assert "script" not in {tag for tag, _ in seen.tags}


def test_verification_at_poses_that_the_fit_knows_is_not_called_unseen(copy: Path) -> None:
    shutil.copy(copy / "verification_nominal.db", copy / "campaign.db")  # a database goes before the CSV
    contents = read_folder(copy)
    numbers = compute(contents)
    assert not numbers.unseen
    assert "did not use" not in headline(contents, numbers)


def test_verifications_at_different_poses_are_not_compared_in_silence(copy: Path) -> None:
    assert not any("wanted pose" in note for note in compute(read_folder(copy)).notes)
    shutil.copy(copy / "repeatability.db", copy / "verification_compensated.db")
    header, rows = _taken_out(copy / "verification_nominal.db")
    for row in rows:
        row[header.index("cov_wanted_turn")] = str(float(row[header.index("cov_wanted_turn")]) + 0.01)
    (copy / "verification_nominal.csv").write_text("\n".join(map(",".join, [header, *rows])) + "\n")
    assert any("same wanted poses" in note for note in compute(read_folder(copy)).notes)


def test_a_verification_that_was_broken_off_is_compared_at_the_poses_that_it_has(copy: Path) -> None:
    """Six of 36 were a factor of 60 better than all of those without, where 31 is right (a reviewer's)."""
    before = read_folder(copy)
    of_all = point_errors(before.recordings["verification_nominal"], before.machine, before.point)
    header, rows = _taken_out(copy / "verification_compensated.db")
    (copy / "verification_compensated.csv").write_text("\n".join(map(",".join, [header, *rows[:6]])) + "\n")
    found = compute(read_folder(copy))
    assert {case: len(errors) for case, errors in found.errors.items()} == {"uncompensated": 6, "compensated": 6}
    assert found.accuracy["uncompensated"]["visits"] == 6
    assert found.accuracy["uncompensated"]["max_mm"] == pytest.approx(1e3 * np.linalg.norm(of_all[:6], axis=1).max())
    said = "Compared are the {} of 40 wanted poses at which every verification recording has a reading."
    assert said.format(6) in found.notes
    first, others = _taken_out(copy / "verification_nominal.db")  # which skipped one of the six
    (copy / "verification_nominal.csv").write_text("\n".join(map(",".join, [first, *others[1:]])) + "\n")
    assert said.format(5) in compute(read_folder(copy)).notes


def test_a_verification_that_lost_its_beams_is_compared_where_it_has_readings(copy: Path) -> None:
    header, rows = _taken_out(copy / "verification_compensated.db")
    for row in rows[6:]:
        for k, name in enumerate(header):
            if name.startswith("treatment_"):
                row[k] = ""
    (copy / "verification_compensated.csv").write_text("\n".join(map(",".join, [header, *rows])) + "\n")
    found = compute(read_folder(copy))
    assert found.accuracy["uncompensated"]["visits"] == found.accuracy["compensated"]["visits"] == 6
    assert any(note.startswith("Compared are the 6 of 40 wanted poses") for note in found.notes)


def test_how_many_of_its_visits_a_recording_has_is_said(copy: Path) -> None:
    with closing(sqlite3.connect(copy / "verification_compensated.db")) as db, db:
        db.execute("INSERT OR REPLACE INTO meta VALUES ('visits_planned', '52')")
    assert "verification_compensated.db: 40 of 52 planned visits were measured." in compute(read_folder(copy)).notes
    with closing(sqlite3.connect(copy / "verification_compensated.db")) as db, db:
        db.execute("INSERT OR REPLACE INTO meta VALUES ('visits_planned', 'many')")
    assert not any("planned" in note for note in compute(read_folder(copy)).notes)


def test_beside_an_extended_calibration_the_compensated_run_is_the_base_calibration_s(copy: Path) -> None:
    shutil.copy(copy / "verification_compensated.db", copy / "verification_extended.db")
    contents = read_folder(copy)
    assert not any(missing.name.startswith("verification_base") for missing in contents.missing)
    assert "with the base calibration alone" in headline(contents, compute(contents))


def _taken_out(file: Path) -> tuple[list[str], list[list[str]]]:
    """The table of a recording, which is then gone."""
    with RecordingFile.open(file, readonly=True) as recording:
        header, rows = recording.table()
    file.unlink()
    return list(header), [list(row) for row in rows]


def test_a_campaign_that_has_just_begun_is_said_to_hold_no_visit(copy: Path) -> None:
    (copy / "verification_compensated.db").unlink()
    RecordingFile.create(copy / "verification_compensated.db", ["q_cmd_rail", "q_cmd_turn", "P1_x"], {}).close()
    contents = read_folder(copy)
    assert [(m.name, m.why) for m in contents.missing] == [("verification_compensated.db", "holds no visit yet")]
    assert headline(contents, compute(contents)).startswith("Without compensation, 98.6 % of the errors")


def test_a_calibration_alone_makes_a_page_that_lists_what_is_missing(copy: Path) -> None:
    for name in ("campaign.csv", "verification_nominal.db", "verification_compensated.db", "repeatability.db"):
        (copy / name).unlink()
    build_report(copy, NOW)
    words = page(copy).words
    assert "Calibrated from 90 visits; nothing here has verified it" in words
    assert "Geometric errors of rail: displacements" in words
    assert words.count("not in the folder") == 4
    assert "verification_nominal.db: not in the folder. It would show errors without compensation." in words


def test_an_unknown_measuring_frame_is_placed_by_the_calibration(copy: Path) -> None:
    before = compute(read_folder(copy)).errors["compensated"]
    (copy / "machine.yaml").write_text(CELL.replace("{xyz: [0, 0, 0]}", "estimate"))
    data = json.loads((copy / "calibration.json").read_text())
    data["provenance"]["machine_sha256"] = load_machine(copy / "machine.yaml").sha256
    data["measuring_in_base"][0][3] = 0.0025
    data["content_sha256"] = content_digest(data)
    (copy / "calibration.json").write_text(json.dumps(data))
    numbers = compute(read_folder(copy))
    assert numbers.errors["compensated"] - before == pytest.approx(np.tile([0.0025, 0, 0], (40, 1)), abs=1e-12)
    assert any("leaves the measuring frame open" in note for note in numbers.notes)
    (copy / "calibration.json").unlink()
    missing = compute(read_folder(copy)).missing
    assert any("there is no calibration that places it" in m.why for m in missing)


def answer(**other: Any) -> str:
    """What a diagnosis answered, one thing other than it is."""
    held = {"rms_before_mm": 0.1, "rms_after_mm": 0.1}
    return json.dumps({"verdict": "consistent", "findings": [], "held_out": held, "noise_floor_mm": 0.1, **other})


def test_what_is_no_page_is_not_replaced_by_one(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (copy / "report.html").write_text("my notes")
    assert main(["report", str(copy)]) == 2
    assert "report.html: exists already and is no HTML page" in capsys.readouterr().err
    assert (copy / "report.html").read_text() == "my notes"


@pytest.mark.parametrize(
    ("name", "text", "wanted"),
    [
        ("calibration.json", '{"format": "ppshw cal', "not valid JSON, or cut off"),
        ("demo.json", "[1]", "expected an object"),
        ("demo.json", '{"seconds": NaN}', r"demo\.json: not valid JSON, or cut off \(NaN is no finite number\)"),
        ("demo.json", '{"seconds": 1e400}', "1e400 is no finite number"),
        ("demo.json", "[" * 100_000, "not valid JSON, or cut off"),
        ("diagnosis.json", "[1]", "no answer of a diagnosis, without findings"),
        ("diagnosis.json", answer(findings=[{"effect": "drift"}]), "no answer of a diagnosis: 'sentence' is missing"),
        ("diagnosis.json", answer(findings=[{"sentence": ""}]), "'' where a text is expected"),
        ("diagnosis.json", answer(findings="none"), "'none' where a list is expected"),
        ("diagnosis.json", answer(held_out=None), "None where an object is expected"),
        ("diagnosis.json", answer(verdict=None), "verdict None, expected consistent, missing_physics, unexplained"),
        ("diagnosis.json", answer(noise_floor_mm=True), "True where a number is expected"),
        ("diagnosis.json", answer(unexplained={"covariates": "abc"}), "'abc' where a list is expected"),
        ("diagnosis.json", answer(corrections=[{"sentence": 7}]), "7 where a text is expected"),
        ("diagnosis.json", answer(held_out={"rms_before_mm": 0.1}), "'rms_after_mm' is missing"),
        ("diagnosis.json", answer(noise_floor_mm="small"), "'small' where a number is expected"),
        ("diagnosis.json", answer(serial_correlation="half"), "'half' where a number is expected"),
        ("diagnosis.json", answer(unexplained={"p_value": 0}), "'covariates' is missing"),
        ("diagnosis.json", answer(checks={"before": []}), "'after' is missing"),
        ("repeatability.db", "SQLite format 3\x00 and no more", "not a recording"),
        ("campaign.csv", "q_cmd_rail\n0,1\n", "2 cells"),
    ],
)
def test_a_broken_file_is_refused_and_the_page_before_it_stays(copy: Path, name: str, text: str, wanted: str) -> None:
    before = (copy / "report.html").read_bytes()
    (copy / name).write_text(text)
    with pytest.raises(BadInput, match=wanted) as caught:
        build_report(copy, NOW)
    assert "\n" not in str(caught.value)
    assert name in str(caught.value)
    assert (copy / "report.html").read_bytes() == before
    assert not list(copy.glob("*.part"))


def test_versions_that_nobody_can_read_are_shown_as_they_stand(copy: Path) -> None:
    with sqlite3.connect(copy / "repeatability.db") as db:
        db.execute("UPDATE meta SET value = 'NaN' WHERE key = 'versions'")
    db.close()
    build_report(copy, NOW)
    assert "Versions, repeatability.dbNaN" in page(copy).words


def test_an_event_in_shreds_is_said_to_be(copy: Path) -> None:
    with sqlite3.connect(copy / "repeatability.db") as db:
        db.execute("INSERT INTO events VALUES ('2026-03-04T06:00:00+00:00', 'start', 'started', '[')")
    db.close()
    with pytest.raises(BadInput, match=r"repeatability\.db: damaged: an event says '\[', expected an object of JSON"):
        build_report(copy, NOW)


def test_a_folder_with_nothing_to_report_on_says_what_was_expected(tmp_path: Path) -> None:
    with pytest.raises(ReportError, match=r"no such folder"):
        build_report(tmp_path / "nowhere")
    with pytest.raises(ReportError, match=r"holds no machine\.yaml"):
        build_report(tmp_path)
    slide(tmp_path)
    with pytest.raises(ReportError, match=r"nothing to report on beside machine\.yaml, expected any of"):
        build_report(tmp_path)
    assert not (tmp_path / "report.html").exists()


def test_a_diagnosis_alone_is_something_to_report_on(tmp_path: Path) -> None:
    folder = tmp_path / "alone"
    folder.mkdir()
    slide(folder)
    answer = {"verdict": "consistent", "findings": [], "unexplained": None, "visits": 60, "noise_floor_mm": 0.1,
              "held_out": {"rms_before_mm": 0.12, "rms_after_mm": 0.12}}  # fmt: skip
    (folder / "diagnosis.json").write_text(json.dumps(answer), encoding="utf-8")
    build_report(folder, NOW)
    assert "Verdict: consistent" in page(folder).words


@pytest.mark.parametrize(("value", "std", "unit", "shown"), [
    (2.496e-4, 4.5e-6, "m", "0.2496 ± 0.0045 mm"), (-3.21e-5, 1.2e-6, "m", "−32.1 ± 1.2 µm"),
    (1.5e-3, 2e-4, "rad", "1.50 ± 0.20 mrad"), (8.1e-6, 4e-7, "m/K", "8.10 ± 0.40 µm/K"), (0.0, None, "m", "0 mm"),
    (12.3456, 0.5, "kg", "12.35 ± 0.50 kg"), (0.66, None, "1", "0.66"), (2.5e-9, 1.1e-10, "1/K", "2.5e−09 ± 1e−10 1/K"),
])  # fmt: skip
def test_a_parameter_is_shown_in_the_field_s_units_to_what_is_known(
    value: float, std: float | None, unit: str, shown: str
) -> None:
    assert value_of({"value": value, "std": std, "unit": unit}) == shown


def test_large_and_small_numbers_are_printed_without_an_exponent() -> None:
    assert [rounded(x) for x in (2617.3, 2.29e6, 999.6, 12.34, 0.1)] == ["2620", "2290000", "1000", "12.3", "0.1"]
    assert [rounded(x) for x in (5e-5, 0.0)] == ["0.00005", "0"]
    assert [distance(x) for x in (2617.3, 0.9996, 0.0123)] == ["2620 m", "1000 mm", "12.3 mm"]
    assert [distance(x) for x in (5e-8, 2.2e-16, 0.0)] == ["0.00005 mm", "0 mm", "0 mm"]
    assert [angle(x) for x in (1.2, 0.2, 7.15e-4, 2e-16)] == ["1.2 rad", "200 mrad", "0.715 mrad", "0 mrad"]
