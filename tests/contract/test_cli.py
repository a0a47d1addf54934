"""The commands as the contract has them: what they answer, in which form, and that interchange loses nothing."""

from __future__ import annotations

import argparse
import contextlib
import csv
import errno
import io
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ppshw import __version__, cli
from ppshw.kinematics import point_positions
from ppshw.machine import load_machine
from ppshw.recording import Table, load_recording, read_table
from ppshw.recording_file import RecordingFile, only_writer
from ppshw.whole_file import write_text, written_whole
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant
from tests.contract.desk import MACHINE, ROOT, Said, contents, ppshw, refused

PROGRAM = Path(sys.executable).with_name("ppshw")
DATA = Path(os.environ.get("PPSHW_DATA", ROOT.parent / "shared" / "data"))
COMMANDS = ["demo", "simulate", "check", "station", "plan", "run", "import", "export", "identify", "evaluate",
            "compensate", "move", "report", "diagnose"]  # fmt: skip
FIGURES = {"rms_mm", "median_mm", "p95_mm", "p98_6_mm", "max_mm"}


def answer(*words: str | Path) -> dict[str, Any]:
    """Of a command that went well: stdout is one JSON object and stderr is silent."""
    said = ppshw(*words, "--json")
    assert (said.code, said.err) == (0, "")

    def no_such_number(name: str) -> float:
        raise AssertionError(f"{name} is no JSON")

    found = json.loads(said.out, parse_constant=no_such_number)
    assert isinstance(found, dict)
    return found


# --- every command ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command: str) -> None:
    said = ppshw(command, "--help")
    assert (said.code, said.err) == (0, "")
    assert said.out.startswith(f"usage: ppshw {command}")
    assert "--json" in said.out


@pytest.mark.parametrize("command", [*COMMANDS, "twin", "prove", "study"])
def test_help_fits_a_terminal_and_says_values_as_they_are_given(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    text = ppshw(command, "--help").out
    assert max(map(len, text.splitlines())) <= 80
    assert not re.search(r"\[[^\[\]]*\.\.\.\]", text)


def test_report_s_help_and_the_readme_name_every_file_that_it_reads() -> None:
    from ppshw.report import contents as c

    said = ppshw("report", "--help").out
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    row = next(line for line in readme.splitlines() if "`ppshw report`" in line)
    for name in (c.MACHINE, c.CALIBRATION, c.RESULT, c.CONCEALED, c.EXTENDED, c.DIAGNOSIS,
                 *(f"{stem}.db" for stem in c.RECORDINGS)):  # fmt: skip
        assert name in said
        assert f"`{name}`" in row


def test_help_lists_every_command_and_the_version_is_the_package_s() -> None:
    said = ppshw("--help")
    for command in COMMANDS:
        assert re.search(rf"^    {command}\b", said.out, re.MULTILINE)
    assert ppshw("--version") == Said(0, f"ppshw {__version__}\n", "")


# --- interchange -----------------------------------------------------------------------------------------------------
def test_a_canonical_csv_goes_in_and_comes_out_the_same(desk: Path) -> None:
    came = answer("export", desk / "good.db", desk / "out.csv")
    assert (desk / "out.csv").read_bytes() == (desk / "good.csv").read_bytes()
    assert came == {"visits": 90, "out": str(desk / "out.csv")}
    came = answer("import", desk / "out.csv", "--machine", desk / "machine.yaml", "--out", desk / "again.db")
    assert (came["visits"], came["readings"]) == (90, 270)
    machine = load_machine(desk / "machine.yaml")
    assert load_recording(desk / "again.db", machine).sha256 == load_recording(desk / "good.csv", machine).sha256


def test_row_numbers_in_a_first_column_without_a_name_are_kept(desk: Path) -> None:
    lines = (desk / "good.csv").read_text(encoding="utf-8").splitlines()
    numbered = ["," + lines[0], *(f"{k},{line}" for k, line in enumerate(lines[1:]))]
    (desk / "good.csv").write_text("\n".join(numbered) + "\n", encoding="utf-8")
    answer("import", desk / "good.csv", "--machine", desk / "machine.yaml", "--out", desk / "again.db")
    answer("export", desk / "again.db", desk / "out.csv")
    assert (desk / "out.csv").read_bytes() == (desk / "good.csv").read_bytes()


@pytest.mark.parametrize("words", [["--json"], ["--json", "-"]])
def test_a_diagnosis_prints_its_answer_where_no_file_is_named(desk: Path, words: list[str]) -> None:
    before = contents(desk)
    said = ppshw("diagnose", desk / "good.csv", "--machine", desk / "machine.yaml", *words)
    assert (said.code, json.loads(said.out)["visits"]) == (0, 90)
    assert contents(desk) == before


ODD = ('q_cmd_rail,q_cmd_turn,P1_x,P1_y,P1_z,P2_x,P2_y,P2_z,'
       '"note, free",größe_µ,Q_CMD_RAIL,visit,plan_index,empty,cov_tilt\n'
       '0.1,0.2,0.80,0.10,0.6,0.31,0.29,0.60,"a, b","He said ""no""",7,1,x,,1e-3\n'
       '0.10,-0.2,,,,0.1,0.1,0.6,"two\nlines",Ω≈ç√ 漢字 🙂,8,2,,,\n'
       '+.1,-2e-1,0.8,0.1,0.6,,,,"carriage\rreturn", padded ,9,3,"\r\n",,0\n')  # fmt: skip


def test_quotes_umlauts_empty_cells_and_columns_that_nobody_knows_survive(desk: Path) -> None:
    (desk / "odd.csv").write_text(ODD, encoding="utf-8", newline="")
    answer("import", desk / "odd.csv", "--machine", desk / "machine.yaml", "--out", desk / "odd.db")
    answer("export", desk / "odd.db", desk / "back.csv")
    assert (desk / "back.csv").read_bytes() == ODD.encode()
    answer("import", desk / "back.csv", "--machine", desk / "machine.yaml", "--out", desk / "back.db")
    assert read_table(desk / "back.db").rows == read_table(desk / "odd.db").rows


def test_lines_end_as_they_came_and_needless_quotes_go(desk: Path) -> None:
    good = (desk / "good.csv").read_bytes().replace(b"\n", b"\r\n")
    (desk / "windows.csv").write_bytes(b"\xef\xbb\xbf" + good.replace(b"random", b'"random"'))
    answer("import", desk / "windows.csv", "--machine", desk / "machine.yaml", "--out", desk / "windows.db")
    answer("export", desk / "windows.db", desk / "out.csv")
    assert (desk / "out.csv").read_bytes() == good
    machine = load_machine(desk / "machine.yaml")  # and it is the same recording
    assert load_recording(desk / "windows.db", machine).sha256 == load_recording(desk / "good.csv", machine).sha256


@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    names=st.lists(st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), min_size=1, max_size=8)
                   .filter(lambda s: s.strip()), min_size=1, max_size=4, unique_by=str.strip),
    data=st.data(),
)  # fmt: skip
def test_whatever_is_in_a_recording_comes_back_from_csv(tmp_path: Path, names: list[str], data: st.DataObject) -> None:
    cell = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=8)
    header = ("q", *(n for n in names if n.strip() != "q"))
    rows = [("0", *(data.draw(cell) for _ in header[1:])) for _ in range(3)]
    for old in ("a.db", "a.csv"):
        (tmp_path / old).unlink(missing_ok=True)
    RecordingFile.create(tmp_path / "a.db", header, {}, rows).close()
    assert ppshw("export", tmp_path / "a.db", tmp_path / "a.csv").code == 0
    text = (tmp_path / "a.csv").read_bytes().decode()
    table = read_table(tmp_path / "a.csv")
    assert (table.header, table.rows) == (header, tuple(rows))
    assert table.csv_text() == text
    assert list(csv.reader(io.StringIO(text, newline=""))) == [list(header), *map(list, rows)]  # as others read it


def test_the_canonical_csv_quotes_only_what_needs_it() -> None:
    table = Table("", ("a", "b c"), (('say "x"', "1,5"), ("", " ä")), (1, 2))
    assert table.csv_text() == 'a,b c\n"say ""x""","1,5"\n, ä\n'


# --- identify, evaluate ----------------------------------------------------------------------------------------------
def test_identify_and_evaluate_answer_the_same_for_both_forms(desk: Path) -> None:
    found = {}
    for form in ("csv", "db"):
        machine = ["--machine", desk / "machine.yaml"]
        said = answer("identify", desk / f"good.{form}", *machine, "--out", desk / f"{form}.json")
        assert set(said["fit"]) == FIGURES
        assert (said["visits"], said["readings"], said["method"]) == (90, 270, "joint")
        judged = answer("evaluate", desk / f"good.{form}", *machine, "--calibration", desk / f"{form}.json")
        more = {"nominal", "far_off", "identified_from_it", "outside", "warnings"}
        assert set(judged) == {"visits", "readings", *more, *FIGURES}
        assert judged["identified_from_it"]
        assert judged["far_off"] == judged["outside"] == judged["warnings"] == []
        assert set(judged["nominal"]) == FIGURES
        found[form] = judged
    assert found["csv"] == found["db"]
    assert found["csv"]["rms_mm"] < 0.1
    assert found["csv"]["nominal"]["rms_mm"] > 1.0


def test_of_a_single_reflector_that_was_read_no_turns_are_said(desk: Path) -> None:
    """Though the machine file has three."""
    table = list(csv.DictReader((desk / "good.csv").open(encoding="utf-8")))
    names = [name for name in table[0] if name[:2] not in ("P2", "P3")]
    with (desk / "one.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, names, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(table)
    words = ["identify", desk / "one.csv", "--machine", desk / "machine.yaml", "--out", desk / "one.json"]
    said = ppshw(*words)
    assert said.code == 0
    assert "mrad" not in said.out
    assert "(not told from the scatter of the pose: fewer than three reflectors)" in " ".join(said.out.split())
    assert json.loads(ppshw(*words, "--json").out)["pose_sigma_mrad"] is None
    given = [
        "--machine",
        desk / "machine.yaml",
        "--calibration",
        desk / "one.json",
        "--joints",
        "0.1 0.2",
        "--wrench",
        "0 0 -120 0 30 0",
    ]
    assert "P1 is the only reflector that was read: how the end effector turns" in ppshw("compensate", *given).err


def test_evaluate_says_which_visits_lie_outside_what_was_identified(desk: Path) -> None:
    """Identified with the lighter two of four loads and left of 0.3 m, judged on all."""
    header, *rows = (line.split(",") for line in (desk / "good.csv").read_text(encoding="utf-8").splitlines())
    weight = {r[header.index("load")]: -float(r[header.index("Fz")]) for r in rows}
    light, heavy = sorted(weight, key=weight.__getitem__)[:2], sorted(weight, key=weight.__getitem__)[2:]
    rail = {id(r): float(r[header.index("q_rail")]) for r in rows}
    few = [r for r in rows if rail[id(r)] < 0.3 and r[header.index("load")] in light]
    (desk / "few.csv").write_text("\n".join(map(",".join, (header, *few))) + "\n", encoding="utf-8")
    machine = ["--machine", desk / "machine.yaml"]
    assert ppshw("identify", desk / "few.csv", *machine, "--out", desk / "few.json").code == 0
    judged = ["evaluate", desk / "good.csv", *machine, "--calibration", desk / "few.json"]
    found = answer(*judged)["outside"]
    assert [o["visits"] for o in found] == sorted((o["visits"] for o in found), reverse=True)
    by_name = {o["of"]: o for o in found}
    assert by_name["Fz"]["visits"] == sum(r[header.index("load")] in heavy for r in rows)
    first, last = min(rail[id(r)] for r in few), max(rail[id(r)] for r in few)
    slack = 0.02 * (last - first)  # what `compensate` lets pass as well
    assert by_name["rail"]["visits"] == sum(not first - slack < q < last + slack for q in rail.values())
    assert by_name["rail"]["farthest"] == max(rail.values())
    assert (by_name["Fz"]["unit"], by_name["rail"]["unit"]) == ("N", "m")
    assert f"Fz at {by_name['Fz']['visits']} visits" in " ".join(ppshw(*judged).out.split())
    twin = ["twin", desk / "good.csv", *machine, "--calibration", desk / "few.json", "--out", desk / "twin.csv"]
    assert answer(*twin)["outside"] == found
    assert "such visits are in no check" in " ".join(ppshw(*twin).out.split())


def test_a_recording_without_wrench_is_no_recording_of_no_load(desk: Path) -> None:
    """2.1 mm were said of a calibration good to 0.2, without a word."""
    rows = [line.split(",") for line in (desk / "good.csv").read_text(encoding="utf-8").splitlines()]
    keep = [k for k, name in enumerate(rows[0]) if name not in ("Fx", "Fy", "Fz", "Mx", "My", "Mz", "load")]
    (desk / "silent.csv").write_text("\n".join(",".join(row[k] for k in keep) for row in rows) + "\n", encoding="utf-8")
    judged = ["evaluate", desk / "silent.csv", "--machine", desk / "machine.yaml", "--calibration", desk / "cal.json"]
    found = json.loads(ppshw(*judged, "--json").out)
    assert not [o for o in found["outside"] if o["unit"] in ("N", "N m")]
    (warning,) = found["warnings"]
    assert re.match(r"no columns Fx … Mz, though the calibration knows loads of up to \d+ N and \d+ N m", warning)


def test_without_a_calibration_evaluate_judges_the_ideal_machine(desk: Path) -> None:
    found = answer("evaluate", desk / "good.csv", "--machine", desk / "machine.yaml")
    assert {k: found[k] for k in FIGURES} == found["nominal"]


def test_evaluate_by_hand(tmp_path: Path) -> None:
    # rail 0.3 m up, turn 0.2 m above, tip 0.2 along x and 0.1 up: at rail 0.1, turn 0 P1 should be at (0.6, 0, 0.6)
    (tmp_path / "m.yaml").write_text(MACHINE, encoding="utf-8")
    (tmp_path / "r.csv").write_text("q_cmd_rail,q_cmd_turn,P1_x,P1_y,P1_z,P2_x,P2_y,P2_z\n"
                                    "0.1,0,0.603,0.004,0.6,0.1,0.2,0.6\n0.1,0,0.6,0,0.588,,,\n")  # fmt: skip
    found = answer("evaluate", tmp_path / "r.csv", "--machine", tmp_path / "m.yaml")
    # 5 mm, 0 mm, 12 mm: rms √(169/3), median 5, and the quantiles between 5 and 12 by straight lines
    wanted = {"rms_mm": (169 / 3) ** 0.5, "median_mm": 5, "p95_mm": 11.3, "p98_6_mm": 11.804, "max_mm": 12}
    assert {k: found[k] for k in FIGURES} == pytest.approx(wanted)
    assert (found["visits"], found["readings"]) == (2, 3)


def test_a_tracker_that_was_moved_is_found_again_on_request(desk: Path) -> None:
    """Turned by 0.3 rad about z and 2 m away: hopeless in the calibration's frame, as good as before when refitted."""
    rows = [row.split(",") for row in (desk / "good.csv").read_text().splitlines()]
    turn = np.array([[np.cos(0.3), np.sin(0.3), 0], [-np.sin(0.3), np.cos(0.3), 0], [0, 0, 1]])
    for row in rows[1:]:
        for target in ("P1", "P2", "P3"):
            k = rows[0].index(f"{target}_x")
            row[k : k + 3] = [repr(x) for x in (turn @ (np.array(row[k : k + 3], float) - [2, 0, 0])).tolist()]
    (desk / "moved.csv").write_text("\n".join(map(",".join, rows)) + "\n")
    given_ = ["--machine", desk / "machine.yaml", "--calibration", desk / "cal.json"]
    here = answer("evaluate", desk / "good.csv", *given_, "--refit-base")
    there = answer("evaluate", desk / "moved.csv", *given_, "--refit-base")
    lost = answer("evaluate", desk / "moved.csv", *given_)
    assert lost["rms_mm"] > 1000
    assert there["rms_mm"] == pytest.approx(here["rms_mm"], rel=1e-6)
    assert there["nominal"]["rms_mm"] == pytest.approx(here["nominal"]["rms_mm"], rel=1e-6)
    assert here["rms_mm"] == pytest.approx(answer("evaluate", desk / "good.csv", *given_)["rms_mm"], rel=0.05)


@pytest.mark.parametrize("name", ["pps", "arm6"])
def test_the_example_machines_are_identified_and_judged_in_both_forms(name: str, tmp_path: Path) -> None:
    """Noise alone: repeatability of 0.14 mm at 98.6 %. A plain ridge over all visits leaves 1.3 × that (its README)."""
    data = DATA / "example" / name
    if not data.is_dir():
        pytest.skip(f"no example recordings: {data} is absent (set PPSHW_DATA to where they are)")
    machine = ["--machine", data / "machine.yaml"]
    for part in ("train", "test"):
        answer("import", data / f"{part}.csv", *machine, "--out", tmp_path / f"{part}.db")
        answer("export", tmp_path / f"{part}.db", tmp_path / f"{part}.csv")
        assert (tmp_path / f"{part}.csv").read_bytes() == (data / f"{part}.csv").read_bytes()
    made = answer("identify", tmp_path / "train.db", *machine, "--out", tmp_path / "cal.json")
    assert (made["visits"], made["readings"]) == (300, 900)
    judged = [answer("evaluate", path, *machine, "--calibration", tmp_path / "cal.json")
              for path in (tmp_path / "test.db", data / "test.csv")]  # fmt: skip
    assert judged[0] == judged[1]
    assert judged[0]["p98_6_mm"] < 1.5 * 0.14
    assert judged[0]["nominal"]["p98_6_mm"] > 3


# --- plan, compensate ------------------------------------------------------------------------------------------------
def test_a_plan_is_listed_with_every_setpoint(desk: Path) -> None:
    found = answer("plan", desk / "little.yaml", "--machine", desk / "machine.yaml", "--list")
    assert (found["visits"], found["readings"], found["load_changes"]) == (10, 30, 1)
    assert found["steps"] == {"sweep": 5, "any": 3, "poses": 2}
    assert [v["setpoints"]["rail"] for v in found["plan"][:5]] == pytest.approx([-0.8, -0.4, 0, 0.4, 0.8])
    assert len(found["plan"]) == 10
    assert [v["index"] for v in found["plan"]] == list(range(10))
    rows = ppshw("plan", desk / "little.yaml", "--machine", desk / "machine.yaml", "--list").out.splitlines()[-10:]
    assert [int(row.split()[0]) for row in rows] == list(range(1, 11))  # for people, as a run's screen and log count


def test_plan_asks_whether_limits_of_many_turns_are_degrees(desk: Path) -> None:
    """And goes on, since an axis on a slip ring does turn on."""
    text = (desk / "machine.yaml").read_text(encoding="utf-8")
    assert "lower: -1.5, upper: 1.5" in text
    words = ["plan", desk / "little.yaml", "--machine", desk / "degrees.yaml", "--json"]
    for turn, warnings in (
        (12.56637, []),  # what many wrists turn
        (90, ["joint 'turn': -90 … 90 rad is 28.6 turns; are these degrees?"]),
    ):
        wide = text.replace("lower: -1.5, upper: 1.5", f"lower: -{turn}, upper: {turn}")
        (desk / "degrees.yaml").write_text(wide, encoding="utf-8")
        said = ppshw(*words)
        assert (said.code, json.loads(said.out)["warnings"]) == (0, warnings)
        assert said.err == "".join(f"warning: {desk / 'degrees.yaml'}: {w}\n" for w in warnings)


def test_answers_in_words_fit_a_terminal(desk: Path, tmp_path: Path) -> None:
    machine = ["--machine", desk / "machine.yaml"]
    for words in (
        ["plan", "quick", "--machine", "pps", "--visibility"],
        ["plan", "quick", "--machine", "pps", "--list"],
        ["identify", desk / "good.csv", *machine, "--out", tmp_path / "c.json"],
        ["evaluate", desk / "good.csv", *machine, "--calibration", desk / "cal.json"],
    ):
        said = ppshw(*words)
        assert said.code == 0, said.err
        lines = [line for line in said.out.splitlines() if str(tmp_path) not in line]
        assert max(map(len, lines)) <= 80, words


def test_campaigns_and_machines_that_come_with_it_have_names() -> None:
    """And the paper's on the positioner: see who stops reading, below."""
    assert answer("plan", "quick", "--machine", "arm6")["visits"] == 10


@pytest.fixture(scope="module")
def compensate(tmp_path_factory: pytest.TempPathFactory) -> list[str | Path]:
    """The command up to what is wanted: the positioner, under a patient of 100 kg."""
    folder = tmp_path_factory.mktemp("positioner")
    plant = Plant.from_file(ROOT / "machines/pps.yaml", seed=5)
    simulate_recording_csv(plant, folder / "r.csv", 120, np.random.default_rng(5), "mixed", loads=6, visits_per_load=6)
    answer("identify", folder / "r.csv", "--machine", "pps", "--out", folder / "cal.json")
    weight = 100 * 9.80665  # gravity is -y, the load 0.3 m out along z
    wrench = ["--wrench", 0, -weight, 0, 0.3 * weight, 0, 0]
    return ["compensate", "--machine", "pps", "--calibration", folder / "cal.json", *map(str, wrench)]


WAYS = [["0.1", "-.2e0", "0.5", "-1e-1", "0", "0"], ["0.1 -0.2 0.5 -0.1 0 0"], ["0.1,-0.2,0.5,-0.1,0,0"],
        ["[0.1, -0.2, 0.5, -0.1, 0, 0]"]]  # fmt: skip


@pytest.mark.parametrize("way", WAYS)
def test_numbers_may_be_written_in_any_common_way(compensate: list[str | Path], way: list[str]) -> None:
    found = answer(*compensate, "--joints", *way)
    assert list(found["nominal"].values()) == [0.1, -0.2, 0.5, -0.1, 0, 0]
    assert set(found) >= {"setpoints", "nominal", "point", "predicted_error_mm", "std_mm"}
    assert list(found["setpoints"]) == ["lateral", "vertical", "longitudinal", "yaw", "roll", "pitch"]
    assert list(found["setpoints"].values()) == pytest.approx([0.1, -0.2, 0.5, -0.1, 0, 0], abs=0.01)


def test_a_pose_and_the_joints_that_make_it_ask_for_the_same(compensate: list[str | Path]) -> None:
    # with all turns at zero the treatment point of the file stands at the sum of its offsets
    by_joints = answer(*compensate, "--joints", "0.1 -0.2 0.5 0 0 0", "--point", "treatment")
    machine = load_machine(ROOT / "machines/pps.yaml")
    at = point_positions(machine, np.array([[0.1, -0.2, 0.5, 0, 0, 0]]), machine.point("treatment")[None])[0, 0]
    by_pose = answer(*compensate, "--pose", *map(repr, at.tolist()), "0", "0", "0", "--point", "treatment")
    assert by_pose["setpoints"] == pytest.approx(by_joints["setpoints"], abs=1e-6)
    assert by_pose["point"] == "treatment"


def test_compensate_prints_a_table_for_people(compensate: list[str | Path]) -> None:
    said = ppshw(*compensate, "--joints", "0.1 0.2 0.5 0 0 0", "--point", "treatment")
    assert (said.code, said.err) == (0, "")
    lines = said.out.splitlines()
    assert [line.split()[0] for line in lines] == ["joint", *load_machine(ROOT / "machines/pps.yaml").joint_names,
                                                   "treatment:"]  # fmt: skip
    assert max(map(len, lines)) <= 80


def test_what_two_joints_cannot_put_right_is_said(tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text(MACHINE, encoding="utf-8")
    simulate_recording_csv(Plant.from_file(tmp_path / "cell.yaml", seed=5), tmp_path / "r.csv", 80)
    answer("identify", tmp_path / "r.csv", "--machine", tmp_path / "cell.yaml", "--out", tmp_path / "cal.json")
    loads = json.loads((tmp_path / "cal.json").read_text(encoding="utf-8"))["valid"]["payload"].values()
    words = ["compensate", "--machine", tmp_path / "cell.yaml", "--calibration", tmp_path / "cal.json",
             "--wrench", *(str((low + high) / 2) for low, high in loads),
             "--joints", "0.1 0.4", "--point", "treatment"]  # fmt: skip
    found = answer(*words)
    left = [float(np.linalg.norm(found[key])) for key in ("left_mm", "left_mrad")]
    assert 0.05 < left[0] < np.linalg.norm(found["predicted_error_mm"])
    stays = f"treatment: {left[0]:.3f} mm and {left[1]:.3f} mrad stay, which 2 joints cannot put right"
    assert stays in ppshw(*words).out
    line = refused(tmp_path, *words[:5], "--pose", "0 0 0.6 0.3 0 0")
    assert re.search(r"the nearest joint values miss it by \S+ mm and 300 mrad$", line.strip())


def test_the_age_of_a_load_that_nothing_goes_with_is_warned_of(compensate: list[str | Path]) -> None:
    said = ppshw(*compensate, "--joints", "0.1 0.2 0.5 0 0 0", "--loaded-for", "7200", "--json")
    warning = "--loaded-for: no effect here goes with the age of a load, it changes nothing"
    assert (said.code, said.err) == (0, f"warning: {compensate[4]}: {warning}\n")
    assert json.loads(said.out)["warnings"] == [warning]


def test_a_temperature_that_nothing_goes_with_is_warned_of(compensate: list[str | Path]) -> None:
    said = ppshw(*compensate, "--joints", "0.1 0.2 0.5 0 0 0", "--temperature", "air=30", "--json")
    assert said.code == 0
    assert json.loads(said.out)["warnings"] == ["--temperature air: no effect here goes with it, it changes nothing"]


def test_compensate_refuses_in_one_line(tmp_path: Path, compensate: list[str | Path]) -> None:
    assert "joint 'yaw' at 2 rad is outside" in refused(tmp_path, *compensate, "--joints", "0 0 0.5 2 0 0")
    assert re.search(r"the pose needs joint '\w+' \S+ (m|rad) beyond its limits",
                     refused(tmp_path, *compensate, "--pose", "0 0 9 0 0 0"))  # fmt: skip
    heavy = [*compensate[:5], "--joints", "0 0 0.5 0 0 0", "--wrench", "0 -9000 0 0 0 0"]
    assert "load Fy = -9000 N is outside what was identified" in refused(tmp_path, *heavy)
    bold = ppshw(*heavy, "--max-beyond", "9", "--json")
    assert bold.code == 0
    (warning,) = [w for w in json.loads(bold.out)["warnings"] if "Fy" in w]
    assert warning.endswith("carried on there")
    assert "load Fy = -9000 N is outside what was identified" in refused(tmp_path, *heavy, "--max-beyond", "0")
    timid = [*compensate, "--joints", "0.1 0.2 0.5 0.3 0 0", "--max-travel", "1e-6"]
    assert re.search(r"joint '\w+' would be corrected by \S+ m, the bound is 1e-06", refused(tmp_path, *timid))


# --- one run at a time -----------------------------------------------------------------------------------------------
def test_two_runs_into_one_recording_are_refused_before_anything_moves(desk: Path) -> None:
    with only_writer(desk / "new.db"):
        words = ["run", desk / "little.yaml", "--site", desk / "site.yaml", "--out", desk / "new.db"]
        assert "new.db: another run is writing it" in refused(desk, *words)
        with only_writer(desk / "other.db"):  # another recording in the same folder is nobody's business
            pass
    assert not list(desk.glob("*.lock"))
    with only_writer(desk / "new.db"):
        pass


def test_the_lock_of_a_run_that_was_killed_is_gone_with_it(desk: Path) -> None:
    hold = ("import sys, time; from ppshw.recording_file import only_writer\n"
            "with only_writer(sys.argv[1]): print('held', flush=True); time.sleep(60)")  # fmt: skip
    child = subprocess.Popen([sys.executable, "-c", hold, str(desk / "new.db")], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "held\n"
    with pytest.raises(Exception, match="another run is writing it"), only_writer(desk / "new.db"):
        pass
    child.kill()
    child.wait()
    with only_writer(desk / "new.db"):
        assert (desk / "new.db.lock").exists()
    assert not (desk / "new.db.lock").exists()


# --- the program -----------------------------------------------------------------------------------------------------
def test_a_library_s_warning_does_not_reach_the_terminal() -> None:
    """Python prints warnings of loggers that nobody configured; stderr is for our one line alone."""
    code = ("import sys, logging, warnings\nfrom ppshw.cli import main, parser\n"
            "def noisy(a): logging.getLogger('canopen').warning('overrun'); warnings.warn('old')\n"
            "parser.check = noisy; sys.argv = ['ppshw', 'check', '--site', 's']; sys.exit(main())")  # fmt: skip
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_a_terminal_without_our_letters_is_no_reason_to_fail(desk: Path) -> None:
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "LC_ALL": "C"}
    words = ["import", "good.csv", "--machine", "machine.yaml", "--out", "größe.db"]
    done = subprocess.run([PROGRAM, *words], cwd=desk, env=environment, capture_output=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b": 90 visits, 270 readings" in done.stdout


def test_whoever_reads_may_stop_reading(desk: Path) -> None:
    command = f"'{PROGRAM}' plan paper --machine pps --list | head -n 1"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.startswith("paper on pps: 669 visits")
    assert done.stderr == ""


def test_an_answer_goes_behind_what_standard_output_holds_already(desk: Path) -> None:
    (desk / "notes.txt").write_text("measured on Monday\n", encoding="utf-8")
    command = f"'{PROGRAM}' export good.db /dev/stdout >> notes.txt"
    done = subprocess.run(["bash", "-c", command], cwd=desk, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    text = (desk / "notes.txt").read_text(encoding="utf-8")
    assert text.startswith("measured on Monday\n")
    assert (desk / "good.csv").read_text(encoding="utf-8") in text


def test_a_command_that_nobody_can_be_told_of_on_its_way_has_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run whose stderr goes into a pipe that died: it was stopped before its end."""

    def tell(arguments: argparse.Namespace) -> None:
        raise BrokenPipeError

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", lambda *_: argparse.Namespace(function=tell))
    assert cli.main(["run"]) == 1


def test_an_answer_that_nobody_wants_is_no_failure(desk: Path) -> None:
    command = f"'{PROGRAM}' evaluate good.csv --machine machine.yaml >&-"
    done = subprocess.run(["bash", "-c", command], cwd=desk, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_standard_output_that_is_full_is_called_so(desk: Path) -> None:
    command = f"'{PROGRAM}' evaluate good.csv --machine machine.yaml >/dev/full"
    done = subprocess.run(["bash", "-c", command], cwd=desk, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (1, "ppshw: standard output: No space left on device\n")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no folder that nobody can write to")
@pytest.mark.parametrize("words", [["export", "good.db"], ["import", "good.csv", "--machine", "machine.yaml", "--out"]])
def test_a_file_that_cannot_be_written_is_named_as_it_was_asked_for(desk: Path, words: list[str]) -> None:
    words = [str(PROGRAM), *words, "/proc/new"]
    said = subprocess.run(words, cwd=desk, capture_output=True, text=True, timeout=60, check=False)
    assert (said.returncode, said.stderr) == (2, "ppshw: /proc/new: No such file or directory\n")


def test_what_is_no_file_is_written_to_and_a_link_is_followed(tmp_path: Path) -> None:
    """As root a rename takes the place of /dev/stdout itself."""
    pipe, link, there = tmp_path / "pipe", tmp_path / "link.json", tmp_path / "there.json"
    os.mkfifo(pipe)
    link.symlink_to(there)
    with subprocess.Popen(["cat", pipe], stdout=subprocess.PIPE) as reader:
        write_text(pipe, "whole\n")
        assert reader.communicate(timeout=20)[0] == b"whole\n"
    for text in ("first", "second"):
        write_text(link, text)
        assert there.read_text(encoding="utf-8") == text
    assert pipe.is_fifo()
    assert link.is_symlink()
    assert set(contents(tmp_path)) == {"pipe", "link.json", "there.json"}
    command = "from pathlib import Path; from ppshw.whole_file import write_text; write_text(Path('/dev/stdout'), 'x')"
    out = tmp_path / "out"
    with out.open("wb") as stream:
        subprocess.run([sys.executable, "-c", command], stdout=stream, check=True, timeout=60)
    assert out.read_bytes() == b"x"
    assert Path("/dev/stdout").is_symlink()


@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="no files in memory")
def test_a_file_in_memory_is_a_file_and_is_written_anew() -> None:
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        for text in ("first", "second"):
            write_text(Path(folder) / "answer.json", text)
        assert (Path(folder) / "answer.json").read_text(encoding="utf-8") == "second"


def test_a_full_disk_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No space left") as caught, written_whole(tmp_path / "new.csv"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert caught.value.filename == str(tmp_path / "new.csv")


def test_ctrl_c_ends_a_simulation_that_a_script_started_beside_itself(desk: Path) -> None:
    """A shell without job control has what it starts with & ignore Ctrl-C."""
    command = f"'{PROGRAM}' simulate --machine machine.yaml --site-out sim.yaml --json & wait"
    with subprocess.Popen(["bash", "-c", command], cwd=desk, stdout=subprocess.PIPE, start_new_session=True) as shell:
        assert shell.stdout is not None
        assert shell.stdout.readline()
        os.killpg(shell.pid, signal.SIGINT)
        try:
            assert shell.communicate(timeout=20)[0] == b""  # which waits for the last that holds the pipe
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(shell.pid, signal.SIGKILL)


def test_an_answer_leaves_no_other_file_than_the_one_asked_for(desk: Path) -> None:
    before = set(contents(desk))
    answer("identify", desk / "good.csv", "--machine", desk / "machine.yaml", "--out", desk / "new.json")
    assert set(contents(desk)) - before == {"new.json"}
