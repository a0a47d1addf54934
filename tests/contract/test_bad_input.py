"""Whatever is given and cannot be used: one line on stderr that says what, where and what was expected; exit code 2;
nothing written. One test per case, through the command line."""

# One case, one line, however long:
# ruff: noqa: E501
from __future__ import annotations

import json
import os
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ppshw.calibration import content_digest, load_calibration
from ppshw.cli.arguments import pairs
from ppshw.errors import BadInput
from ppshw.machine import load_machine
from ppshw.terms.effect import Effect
from ppshw.terms.shapes import Column
from tests.contract.desk import contents, one_line, ppshw, refused

Spoil = Callable[[Path], None]
PROGRAM = Path(sys.executable).with_name("ppshw")


def put(text: str) -> Spoil:
    return lambda path: path.write_text(text, encoding="utf-8") and None


def swap(old: str, new: str, count: int = 1) -> Spoil:
    def spoil(path: Path) -> None:
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new, count), encoding="utf-8")

    return spoil


def cut(share: float) -> Spoil:
    return lambda path: path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)]) and None


def fill(data: bytes) -> Spoil:
    return lambda path: path.write_bytes(data) and None


def folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


GARBAGE = bytes(range(256)) * 20
FILES: dict[str, tuple[Spoil, str]] = {
    "missing": (Path.unlink, "no such"),
    "empty": (fill(b""), "is empty"),
    "a folder": (folder, "a folder, expected a"),
    "binary garbage": (fill(GARBAGE), ""),
    "another encoding": (fill("name: größe".encode("latin-1")), "UTF-8"),
}


# --- machine files ---------------------------------------------------------------------------------------------------
ONE_JOINT = "  - {name: NAME, type: revolute, axis: [0, 0, 1]}\n"
MACHINES: dict[str, tuple[Spoil, str]] = {
    "a key is missing": (swap("gravity: [0, 0, -9.80665]\n", ""), "machine.yaml:1: missing key 'gravity'"),
    "a number as programmers write eight": (swap("P1: [0.3,", "P1: [010,"),
                                            "has 010, which YAML reads as 8, expected a plain number"),
    "a number as clocks write ninety": (swap("P1: [0.3,", "P1: [1:30,"), "has 1:30, which YAML reads as 90, expected a"),
    "a number in groups": (swap("P1: [0.3,", "P1: [1_000,"), "has 1_000, which YAML reads as 1000, expected a plain"),
    "a joint has no name": (swap("  - name: rail\n    type", "  - type"), ":4: missing key 'joints[0].name'"),
    "no targets": (swap("  targets: {P1: [0.3, 0, 0], P2: [-0.2, 0.2, 0], P3: [-0.2, -0.2, 0.05]}\n", ""),
                   "missing key 'tip.targets' (expected a mapping)"),
    "no target": (swap("{P1: [0.3, 0, 0], P2: [-0.2, 0.2, 0], P3: [-0.2, -0.2, 0.05]}", "{}"), "at least one target"),
    "an unknown key": (swap("mass: 120,", "mass: 120, colour: red,"), ":9: unknown key 'joints[0].link.colour' (known"),
    "an unknown key at the top": (swap("name: cell\n", "name: cell\nowner: me\n"), ":2: unknown key 'owner'"),
    "a text for a number": (swap("mass: 120", "mass: heavy"), "'joints[0].link.mass' has 'heavy', expected a number"),
    "a yes for a number": (swap("mass: 120", "mass: yes"), "has True, expected a number"),
    "a number for a text": (swap("name: cell", "name: 7"), "'name' is 7, expected a text"),
    "a date for a text": (swap("name: cell", "name: 2026-11-05"), "'name' is datetime.date(2026, 11, 5), expected a text"),
    "a list for a mapping": (swap("{mass: 120, com: [0, 0, 0.1]}", "[1, 2]"), "expected a mapping"),
    "a mapping for a list": (swap("[1, 0, 0]", "{x: 1}"), "'joints[0].axis' is {'x': 1}, expected 3 numbers"),
    "two numbers for three": (swap("xyz: [0, 0, 0.3]", "xyz: [0, 0.3]"), "is [0, 0.3], expected 3 numbers"),
    "nan": (swap("lower: -0.8", "lower: .nan"), "'joints[0].limits.lower' has nan, expected a finite number"),
    "nan as a word": (swap("lower: -0.8", "lower: nan"), "has nan, expected a finite number"),
    "infinity": (swap("upper: 0.8", "upper: .inf"), "has inf, expected a finite number"),
    "an absurd number": (swap("mass: 120", f"mass: 1{'0' * 400}"), "has a huge number, expected a finite number"),
    "a negative mass": (swap("mass: 120", "mass: -120"), "is -120, expected at least 0"),
    "a joint's name twice": (swap("name: turn", "name: rail"), ":11: joint name 'rail' is used twice"),
    "a target's name twice": (swap("P2: [-0.2, 0.2, 0]", "P1: [-0.2, 0.2, 0]"), "duplicate key 'tip.targets.P1'"),
    "a target that is a point": (swap("treatment:", "P1:"), "'P1' is both a target and a point"),
    "a target whose columns are a joint's": (
        put("name: g\ngravity: [0, 0, -9.8]\njoints: [{name: x, type: prismatic, axis: [1, 0, 0]}]\n"
            "tip: {targets: {q: [0, 0, 0]}}\n"), ":4: target 'q' and joint 'x' both have the column q_x in a recording"),
    "a point whose columns are a joint's": (
        put("name: g\ngravity: [0, 0, -9.8]\njoints: [{name: z, type: prismatic, axis: [1, 0, 0]}]\n"
            "tip:\n  targets: {P: [0, 0, 0]}\n  points: {approach: [0, 0, 1]}\n"),
        ":6: point 'approach' and joint 'z' both have the column approach_z in a recording"),
    "a joint whose encoder is another's setpoint": (
        swap("name: turn", "name: cmd_rail"), "joint 'cmd_rail' and joint 'rail' both have the column q_cmd_rail in a recording"),
    "a frame in degrees": (swap("origin: {xyz: [0, 0, 0.3], rpy: [0, 0, 0]}", "origin: {xyz: [0, 0, 0.3], rpy: [0, 0, 90]}"),
                           ":6: 'joints[0].origin.rpy': 90 rad is more than a turn; are these degrees?"),
    "a decimal comma": (swap("mass: 120,", "mass: 120,5,"), "unknown key 'joints[0].link.5' (known here: com, mass); a decimal comma?"),
    "a key twice": (swap("name: cell\n", "name: cell\nname: cell\n"), ":2: duplicate key 'name'"),
    "gravity in mm/s²": (swap("[0, 0, -9.80665]", "[0, 0, -9806.65]"), ":2: 'gravity' is 9806.65 long, expected at most 20 m/s²"),
    "a crooked axis": (swap("axis: [1, 0, 0]", "axis: [1, 1, 0]"), "has length 1.41421, expected a unit vector"),
    "no axis": (swap("axis: [1, 0, 0]", "axis: [0, 0, 0]"), "has length 0, expected a unit vector"),
    "an unknown type": (swap("type: prismatic", "type: linear"), "is 'linear', expected prismatic or revolute"),
    "limits the wrong way": (swap("lower: -0.8, upper: 0.8", "lower: 0.8, upper: -0.8"), "0.8 is not below"),
    "no speed": (swap("velocity: 0.2", "velocity: 0"), "'joints[0].limits.velocity' is 0, expected at least"),
    "an unknown load": (swap("[Fz, Mx, My]", "[Fz, Mq]"), "'joints[0].elastic.loads' has 'Mq', expected Fx, Fy"),
    "a load twice": (swap("[Fz, Mx, My]", "[Fz, Fz]"), "names 'Fz' twice"),
    "varies is no flag": (swap("varies: false", "varies: 0"), "is 0, expected true or false"),
    "no joints": (put("name: x\ngravity: [0, 0, -9.8]\njoints: []\ntip: {targets: {P: [0, 0, 0]}}\n"), "1 to 12"),
    "thirteen joints": (
        put("name: x\ngravity: [0, 0, -9.8]\njoints:\n" + "".join(ONE_JOINT.replace("NAME", f"j{k}") for k in range(13))
            + "tip: {targets: {P: [0, 0, 0]}}\n"), "'joints' has 13 entries, expected 1 to 12"),
    "a base that is neither": (swap("  position_sigma", "  base: guess\n  position_sigma"), "'tracker.base' is 'guess', expected xyz and rpy, or estimate"),
    "targets neither known nor not": (swap("  position_sigma", "  targets: maybe\n  position_sigma"), "known or estimate"),
    "no noise at all": (swap("2.0e-5", "0"), "'tracker.position_sigma' is 0"),
    "a list at the top": (put("- 1\n- 2\n"), "expected a mapping at the top"),
    "a word at the top": (put("machine\n"), "expected a mapping at the top"),
    "a tab": (swap("  - name: rail", "\t- name: rail"), "not valid YAML"),
    "an open bracket": (swap("[0, 0, -9.80665]", "[0, 0, -9.80665"), "not valid YAML"),
    "a snake that bites itself": (swap("[0, 0, -9.80665]", "&a [*a, 0, 0]"), "'gravity' has"),
    "brackets without end": (put("name: " + "[" * 5000), "not valid YAML (nested too deep)"),
    "two documents": (put("name: a\n---\nname: b\n"), "not valid YAML"),
    "cut off": (cut(0.6), ""),
    **FILES,
}  # fmt: skip


def test_a_name_with_an_equals_sign_is_a_name() -> None:
    assert pairs(['a=b"c=-2', "x=3"], ["x", 'a=b"c'], "--approach", "joint") == {'a=b"c': -2.0, "x": 3.0}
    for word, said in (("x", "no value, expected x=NUMBER"), ("y=1", "no joint named 'y'")):
        with pytest.raises(BadInput, match=said):
            pairs([word], ["x"], "--approach", "joint")


@pytest.mark.parametrize("case", MACHINES)
def test_a_machine_file_that_cannot_be_used(desk: Path, case: str) -> None:
    spoil, expected = MACHINES[case]
    spoil(desk / "machine.yaml")
    line = refused(desk, "import", desk / "good.csv", "--machine", desk / "machine.yaml", "--out", desk / "new.db")
    assert f"{desk / 'machine.yaml'}" in line
    assert expected in line


# --- recordings ------------------------------------------------------------------------------------------------------
def cell(line: int, column: str, value: str) -> Spoil:
    """Another value in one cell; the header is line 1."""

    def spoil(path: Path) -> None:
        rows = [row.split(",") for row in path.read_text(encoding="utf-8").splitlines()]
        rows[line - 1][rows[0].index(column)] = value
        path.write_text("\n".join(",".join(row) for row in rows) + "\n", encoding="utf-8")

    return spoil


def column(name: str, value: str | None) -> Spoil:
    """Another value in all of a column, or the column gone."""

    def spoil(path: Path) -> None:
        rows = [row.split(",") for row in path.read_text(encoding="utf-8").splitlines()]
        for k in [k for k, found in enumerate(rows[0]) if found.startswith(name)][::-1]:
            for row in rows[1 if value is not None else 0 :]:
                row[k : k + 1] = [] if value is None else [value]
        path.write_text("\n".join(",".join(row) for row in rows) + "\n", encoding="utf-8")

    return spoil


def both(first: Spoil, second: Spoil) -> Spoil:
    def spoil(path: Path) -> None:
        first(path)
        second(path)

    return spoil


RECORDINGS: dict[str, tuple[Spoil, str]] = {
    "a joint without column": (both(column("q_cmd_turn", None), column("q_turn", None)), "no column q_turn or q_cmd_turn"),
    "a misspelt position": (swap(",q_turn,", ",q_trun,"), "column q_trun is of no joint of machine 'cell', expected q_turn"),
    "a setpoint's misspelt prefix": (
        swap("q_cmd_turn,", "q_comd_turn,"), "column q_comd_turn is of no joint of machine 'cell', expected q_cmd_turn",
    ),
    "a misspelt setpoint": (swap("q_cmd_turn,", "q_cmd_tunr,"), "column q_cmd_tunr is of no joint of machine 'cell', expected"),
    "no target": (column("P", None), "no column for any target of the machine, expected e.g. P1_x"),
    "a coordinate without column": (column("P2_y", None), "column P2_y is missing"),
    "half a wrench": (column("My", None), "column My is missing"),
    "nan": (cell(5, "q_rail", "nan"), ":5: column q_rail: 'nan' is no finite number"),
    "infinity": (cell(5, "P3_z", "-inf"), ":5: column P3_z: '-inf' is no finite number"),
    "an absurd number": (cell(9, "Fx", "1e300"), ":9: column Fx: '1e300' is no finite number below 1e+06"),
    "a word": (cell(7, "P1_x", "lost"), ":7: column P1_x: 'lost' is not a number"),
    "a number that only Python reads": (cell(7, "Fz", "1_0"), ":7: column Fz: '1_0' is not a number"),
    "a reading that no tracker gives": (cell(9, "P2_x", "-1e10"), ":9: column P2_x: '-1e10' is no finite number below 1e+09"),
    "no setpoint": (cell(4, "q_cmd_rail", ""), ":4: column q_cmd_rail: empty, expected a number"),
    "no load": (cell(4, "Mz", ""), ":4: column Mz: empty, expected a number"),
    "half a target": (cell(8, "P2_z", ""), ":8: column P2_z: empty while other coordinates of P2 are given"),
    "a setpoint beyond its limit": (cell(12, "q_cmd_rail", "0.81"),
                                    ":12: column q_cmd_rail: setpoint 0.81 is outside the limits -0.8 … 0.8"),
    "time backwards": (cell(20, "time", "2026-03-02T06:00:00Z"), ":20: column time: 2026-03-02T06:00:00Z is"),
    "a time that is none": (cell(3, "time", "yesterday"), ":3: column time: 'yesterday' is not an ISO 8601 time"),
    "a month 13": (cell(3, "time", "2026-13-02T06:00:00Z"), ":3: column time:"),
    "no time": (cell(3, "time", ""), ":3: column time: empty, expected an ISO 8601 time"),
    "an approach from nowhere": (cell(6, "approach_turn", "2"), ":6: column approach_turn: 2, expected -1, 0 or 1"),
    "a temperature in words": (cell(6, "temp_air_C", "warm"), ":6: column temp_air_C: 'warm' is not a number"),
    "a thermometer that is not there": (cell(6, "temp_air_C", "-999"),
                                        ":6: column temp_air_C: -999 is no temperature, expected -80 … 300 °C"),
    "a beam that was lost, in words": (cell(5, "P3_z", "NaN"),
                                       ":5: column P3_z: 'NaN' is no finite number below 1e+09, or an empty cell where there"),
    "moments in newton millimetres": (cell(9, "Mx", "1200000"), ":9: column Mx: '1200000' is no finite number below 1e+06 N m"),
    "a column twice": (swap("q_cmd_turn", "q_cmd_rail"), ":1: column 5 is twice here: q_cmd_rail"),
    "a column without name": (swap("settle_s", ""), ":1: column 10 is without a name"),
    "a row cut off": (cut(0.512), "cells, the header has 27; is the file cut off?"),
    "semicolons between columns": (swap(",", ";", -1), ":1: columns are separated by ';', expected ','"),
    "semicolons, and every cell in quotes": (
        lambda p: put("\n".join('"' + row.replace(",", '";"') + '"' for row in p.read_text().splitlines()))(p),
        ":1: columns are separated by ';', expected ','",
    ),
    "an empty line at the top": (lambda p: put("\n" + p.read_text())(p), ":1: an empty line, expected the names of the columns"),
    "empty lines only": (put("\n\n"), ":1: an empty line, expected the names of the columns"),
    "a word of a spreadsheet at the top": (lambda p: put("sep=,\n" + p.read_text())(p), ":1: 'sep=,', expected the names of the columns"),
    "a row of commas": (lambda p: put(p.read_text() + "," * 26 + "\n")(p), ": an empty row, commas only"),
    "a row too long": (cell(9, "load", "a,b"), ":9: 28 cells, the header has 27; are its decimals commas?"),
    "a quote that never ends": (cell(9, "load", '"a'), "not valid CSV"),
    "a quote in the middle": (cell(9, "load", '"a"b'), ":9: not valid CSV"),
    "a zero byte": (cell(9, "load", "\0"), ":9: a zero byte, expected text"),
    "only a header": (lambda p: put(p.read_text().split("\n")[0] + "\n")(p), "a header but no visit"),
    "a point's column missing": (swap("P3_x,P3_y,P3_z", "treatment_y,treatment_z,cov_x"), "treatment_x is missing"),
    "a time before the end of the motion": (cell(9, "settle_s", "-3"), ":9: column settle_s: -3 s, expected a time of 0"),
    "all targets lost": (column("P", ""), "not one target was measured: every cell of P1, P2, P3 is empty"),
    "another machine's": (swap("_turn", "_yaw", 99), "is this a recording of machine 'cell'?"),
    **FILES,
}  # fmt: skip


@pytest.mark.parametrize("case", RECORDINGS)
def test_a_csv_recording_that_cannot_be_used(desk: Path, case: str) -> None:
    spoil, expected = RECORDINGS[case]
    spoil(desk / "good.csv")
    rec, machine = desk / "good.csv", ["--machine", desk / "machine.yaml"]
    for words in (
        ["import", rec, *machine, "--out", desk / "new.db"],
        ["identify", rec, *machine, "--out", desk / "new.json"],
        ["evaluate", rec, *machine, "--calibration", desk / "cal.json", "--json"],
    ):
        line = refused(desk, *words)
        assert str(rec) in line
        assert expected in line


def times(factor: float, *columns: str) -> Spoil:
    """Whole columns of a recording in another unit, or of the other sign."""

    def spoil(path: Path) -> None:
        header, *rows = (line.split(",") for line in path.read_text(encoding="utf-8").splitlines())
        for row in rows:
            for k in (header.index(name) for name in columns):
                row[k] = repr(factor * float(row[k]))
        path.write_text("".join(",".join(row) + "\n" for row in (header, *rows)), encoding="utf-8")

    return spoil


REFLECTORS = [f"P{k}_{axis}" for k in (1, 2, 3) for axis in "xyz"]


def test_a_recording_in_millimetres_is_judged_by_no_command(desk: Path) -> None:
    times(1000.0, *REFLECTORS)(desk / "good.csv")
    rec, given = desk / "good.csv", ["--machine", desk / "machine.yaml", "--calibration", desk / "cal.json"]
    for words in (["evaluate", rec, *given], ["twin", rec, *given, "--out", desk / "twin.csv", "--seed", "1"],
                  ["identify", rec, *given[:2], "--out", desk / "new.json"]):  # fmt: skip
        line = refused(desk, *words)
        assert str(rec) in line
        assert "are they in metres" in line


def test_an_instrument_that_was_moved_is_no_other_machine(desk: Path) -> None:
    machine, cal = desk / "machine.yaml", desk / "cal.json"
    times(1.0, *REFLECTORS)(desk / "good.csv")  # as it was, every number written anew
    rows = [line.split(",") for line in (desk / "good.csv").read_text(encoding="utf-8").splitlines()]
    for row in rows[1:]:
        for k in (rows[0].index(f"P{k}_x") for k in (1, 2, 3)):
            row[k] = repr(float(row[k]) + 50.0)
    (desk / "moved.csv").write_text("".join(",".join(row) + "\n" for row in rows), encoding="utf-8")
    for words in ([], ["--refit-base"]):
        said = ppshw("evaluate", desk / "moved.csv", "--machine", machine, "--calibration", cal, "--json", *words)
        assert said.code == 0
        assert (json.loads(said.out)["rms_mm"] < 1.0) == bool(words)


def test_identify_warns_of_forces_that_lift_their_payload_and_goes_on(desk: Path) -> None:
    said = ppshw("identify", desk / "good.csv", "--machine", desk / "machine.yaml", "--out", desk / "as_is.json")
    assert (said.code, said.err) == (0, "")
    times(-1.0, "Fx", "Fy", "Fz")(desk / "good.csv")
    said = ppshw("identify", desk / "good.csv", "--machine", desk / "machine.yaml", "--out", desk / "new.json")
    assert said.code == 0
    assert said.err == (f"warning: {desk / 'good.csv'}: the columns Fx … Fz have the opposite sign; taken as they stand: "
                        "set them right\n")  # fmt: skip
    said = ppshw("evaluate", desk / "good.csv", "--machine", desk / "machine.yaml", "--json")
    assert said.code == 0
    assert json.loads(said.out)["warnings"] == ["the columns Fx … Fz have the opposite sign (the moments too, if they go "
                                                "with the forces); taken as they stand: set them right"]  # fmt: skip


@pytest.mark.parametrize("columns", ["Fx Fy Fz Mx My Mz", "Mx My Mz"])
def test_identify_names_the_moments_whose_sign_is_wrong(desk: Path, columns: str) -> None:
    names = columns.split()
    times(-1.0, *names)(desk / "good.csv")
    said = ppshw(
        "identify", desk / "good.csv", "--machine", desk / "machine.yaml", "--out", desk / "new.json", "--json"
    )
    assert said.code == 0
    assert json.loads(said.out)["warnings"] == [f"the columns {names[0]} … {names[-1]} have the opposite sign; taken as "
                                                "they stand: set them right"]  # fmt: skip


def test_evaluate_and_twin_warn_of_moments_of_the_other_sign_than_the_calibration_had(desk: Path) -> None:
    given = ["--machine", desk / "machine.yaml", "--calibration", desk / "cal.json", "--json"]
    asked = (["evaluate", desk / "good.csv", *given], ["twin", desk / "good.csv", *given, "--out", desk / "twin.csv"])
    assert [json.loads(ppshw(*words).out)["warnings"] for words in asked] == [[], []]
    times(-1.0, "Mx", "My", "Mz")(desk / "good.csv")
    for words in asked:
        said = ppshw(*words)
        assert said.code == 0
        (warning,) = json.loads(said.out)["warnings"]
        assert said.err == f"warning: {desk / 'good.csv'}: {warning}\n"
        assert warning.startswith("the columns Mx … Mz seem to have the opposite sign to those of the recording that the "
                                  "calibration was made from: it leaves ")  # fmt: skip


def test_evaluate_and_twin_warn_of_a_direction_that_is_turned_round(desk: Path) -> None:
    given = ["--machine", desk / "machine.yaml", "--calibration", desk / "cal.json", "--json"]
    times(-1, "approach_rail")(desk / "good.csv")
    for words in (
        ["evaluate", desk / "good.csv", *given],
        ["twin", desk / "good.csv", *given, "--out", desk / "t.csv"],
    ):
        said = ppshw(*words)
        assert said.code == 0
        assert json.loads(said.out)["warnings"] == ["the column approach_rail has the opposite sign; taken as it stands: "
                                                    "set it right"]  # fmt: skip


def test_moments_have_no_other_sign_than_those_of_a_recording_without_any(desk: Path) -> None:
    content = json.loads((desk / "cal.json").read_text())
    content["valid"]["payload"] |= {name: [0.0, 0.0] for name in ("Mx", "My", "Mz")}
    content["content_sha256"] = content_digest(content)
    (desk / "none.json").write_text(json.dumps(content))
    times(-1.0, "Mx", "My", "Mz")(desk / "good.csv")
    given = ["--machine", desk / "machine.yaml", "--calibration", desk / "none.json", "--json"]
    for words in (["evaluate", desk / "good.csv"], ["twin", desk / "good.csv", "--out", desk / "twin.csv"]):
        assert json.loads(ppshw(*words, *given).out)["warnings"] == []


@pytest.mark.parametrize("command", ["evaluate", "twin"])
def test_a_recording_of_another_point_alone_is_none_to_judge_a_calibration_by(desk: Path, command: str) -> None:
    header, *rows = (line.split(",") for line in (desk / "good.csv").read_text(encoding="utf-8").splitlines())
    readings = [k for k, name in enumerate(header) if name[:2] in ("P1", "P2", "P3")]
    moved = [
        ["" if k in readings else cell for k, cell in enumerate(row)] + [row[k] for k in readings[:3]] for row in rows
    ]
    rows = [[*header, "treatment_x", "treatment_y", "treatment_z"], *moved]
    (desk / "point.csv").write_text("\n".join(map(",".join, rows)) + "\n", encoding="utf-8")
    out = ["--out", desk / "twin.csv"] if command == "twin" else []
    said = refused(desk, command, desk / "point.csv", "--machine", desk / "machine.yaml", "--calibration",
                   desk / "cal.json", *out)  # fmt: skip
    assert "the recording holds no measured target" in said


def test_a_few_visits_do_not_tell_the_sign_of_moments(desk: Path) -> None:
    """Of one visit what is left has no spread, and any difference would be sure."""
    times(-1.0, "Mx", "My", "Mz")(desk / "good.csv")
    lines = (desk / "good.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    given = ["--machine", desk / "machine.yaml", "--calibration", desk / "cal.json", "--json"]
    for count, warnings in ((9, 0), (len(lines) - 1, 1)):
        (desk / "few.csv").write_text("".join(lines[: 1 + count]), encoding="utf-8")
        assert len(json.loads(ppshw("evaluate", desk / "few.csv", *given).out)["warnings"]) == warnings


def test_a_recording_that_is_none_of_the_machine_s_is_told_which_columns_are_exchanged(desk: Path) -> None:
    header, *rows = (desk / "good.csv").read_text(encoding="utf-8").splitlines()
    header = header.replace("P1_", "?_").replace("P2_", "P1_").replace("?_", "P2_")
    (desk / "good.csv").write_text("\n".join([header, *rows]), encoding="utf-8")
    rec, given = desk / "good.csv", ["--machine", desk / "machine.yaml", "--calibration", desk / "cal.json"]
    for words in (["identify", rec, *given[:2], "--out", desk / "new.json"], ["evaluate", rec, *given],
                  ["twin", rec, *given, "--out", desk / "twin.csv"]):  # fmt: skip
        assert "(see: the columns P1 and P2 are exchanged)" in refused(desk, *words)


def test_rows_that_stand_there_twice_and_loads_without_a_wrench_are_warned_of(desk: Path) -> None:
    header, *rows = (desk / "good.csv").read_text(encoding="utf-8").splitlines()
    (desk / "good.csv").write_text("\n".join([header, *(row for row in rows for _ in range(2))]), encoding="utf-8")
    common = [desk / "good.csv", "--machine", desk / "machine.yaml"]
    said = ppshw("identify", *common, "--out", desk / "new.json", "--json")
    assert said.code == 0
    judged = json.loads(ppshw("evaluate", *common, "--json").out)
    used = json.loads(said.out)
    assert (used["visits"], used["readings"]) == (judged["visits"], judged["readings"]) == (len(rows), 3 * len(rows))
    assert f"{len(rows)} visits read the same as an earlier one to the last digit (2, 4, 6" in said.err
    twin = ppshw("twin", *common, "--calibration", desk / "new.json", "--out", desk / "twin.csv", "--json")
    assert json.loads(twin.out)["readings"] == 3 * len(rows)
    assert all(check["p"] > 0.02 for check in json.loads(twin.out)["checks"])
    wrench = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
    times(0.0, *wrench)(desk / "good.csv")
    said = ppshw("evaluate", *common, "--json")
    assert "the columns Fx … Mz read the same at every visit, though loads change (" in said.err
    whole = (desk / "good.csv").read_text(encoding="utf-8")
    rows = [line.split(",") for line in whole.splitlines()]
    for row in rows[1:]:  # as a bench without a force sensor records
        for name in wrench:
            row[rows[0].index(name)] = ""
    (desk / "good.csv").write_text("\n".join(map(",".join, rows)) + "\n", encoding="utf-8")
    empty = ppshw("evaluate", *common, "--json")
    (desk / "good.csv").write_text(whole, encoding="utf-8")
    for name in wrench:
        column(name, None)(desk / "good.csv")
    said = ppshw("evaluate", *common, "--json")
    assert (empty.out, empty.err) == (said.out, said.err)
    assert "nothing in columns Fx … Mz, though loads change (" in said.err
    assert len(json.loads(said.out)["warnings"]) == 2


def test_a_sensor_that_always_reads_the_same_is_warned_of_without_labels_too(desk: Path) -> None:
    column("load", None)(desk / "good.csv")
    words = ["evaluate", desk / "good.csv", "--machine", desk / "machine.yaml"]
    assert "read the same" not in ppshw(*words).err
    rows = [line.split(",") for line in (desk / "good.csv").read_text(encoding="utf-8").splitlines()]
    for name in ("Fx", "Fy", "Fz", "Mx", "My", "Mz"):
        for row in rows[2:]:
            row[rows[0].index(name)] = rows[1][rows[0].index(name)]
    (desk / "good.csv").write_text("\n".join(map(",".join, rows)) + "\n", encoding="utf-8")
    assert (
        "Fx … Mz read the same at every visit, to the last digit: does the force sensor measure?" in ppshw(*words).err
    )


@pytest.mark.parametrize(
    ("effect", "column", "name"),
    [
        ("thermal_growth", Column("frame", "temperature", {"place": "shed", "tau": 0.5}, 1, 0), "temp_shed_C"),
        ("tracker_scale", Column("points", "scale", {"name": "cov_hPa"}), "cov_hPa"),
    ],
)
def test_a_recording_without_a_column_that_an_effect_goes_by_is_refused(
    desk: Path, effect: str, column: Column, name: str
) -> None:
    calibration = load_calibration(desk / "cal.json", load_machine(desk / "machine.yaml"))
    grows = Effect(effect, None, (column,), (1e-5,), (1e-6,), "by hand")
    reference = {"start": 0.0, "hours": 2.0, "mean.shed": 21.0}
    replace(calibration, effects=(grows,), reference=reference).save(desk / "warm.json")
    given = [desk / "good.csv", "--machine", desk / "machine.yaml", "--calibration", desk / "warm.json"]
    for words in (["evaluate", *given], ["twin", *given, "--out", desk / "twin.csv"]):
        assert f"good.csv: column {name} is missing or empty, by which an effect of the" in refused(desk, *words)


def test_a_calibration_from_loads_that_nobody_measured_says_so_where_it_moves_axes(desk: Path) -> None:
    machine = ["--machine", desk / "machine.yaml"]
    ask = [
        "compensate",
        *machine,
        "--joints",
        "0",
        "0",
        "--wrench",
        "0",
        "0",
        "0",
        "0",
        "0",
        "0",
        "--json",
        "--calibration",
    ]
    header, *rows = (line.split(",") for line in (desk / "good.csv").read_text(encoding="utf-8").splitlines())
    for name in ("Fx", "Fy", "Fz", "Mx", "My", "Mz"):
        column(name, None)(desk / "good.csv")
    assert ppshw("identify", desk / "good.csv", *machine, "--out", desk / "new.json").code == 0
    said = ppshw(*ask, desk / "new.json")
    loads = ", ".join(sorted({row[header.index("load")] for row in rows})[:3]) + " …"
    warning = (f"its recording had loads ({loads}) and no wrench of them: a setpoint is for an average of them, and its "
               "std_mm knows nothing of what they do")  # fmt: skip
    assert (said.code, said.err) == (0, f"warning: {desk / 'new.json'}: {warning}\n")
    assert json.loads(said.out)["warnings"] == [warning]
    said = ppshw("run", desk / "little.yaml", "--site", desk / "site.yaml", "--out", desk / "new.db", "--calibration",
                 desk / "new.json")  # fmt: skip
    assert f"warning: {desk / 'new.json'}: {warning}\n" in said.err
    column("load", "empty")(desk / "good.csv")  # one load all the time, as far as anybody knows
    assert ppshw("identify", desk / "good.csv", *machine, "--out", desk / "new.json").code == 0
    assert ppshw(*ask, desk / "new.json").err == ""


def test_a_fit_that_leaves_more_than_the_ideal_machine_is_not_written(
    desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No recording at hand makes one: what counts as no better is turned down to nothing."""
    monkeypatch.setattr("ppshw.cli.fit.NO_BETTER", 0.0)
    said = ppshw("identify", desk / "good.csv", "--machine", desk / "machine.yaml", "--out", desk / "new.json")
    assert said.code == 1
    assert "mm rms where the ideal machine leaves" in said.err
    assert not (desk / "new.json").exists()


def test_few_visits_are_warned_of(desk: Path) -> None:
    lines = (desk / "good.csv").read_text(encoding="utf-8").splitlines()
    for count in (39, 40):
        (desk / "good.csv").write_text("\n".join(lines[: 1 + count]), encoding="utf-8")
        said = ppshw("identify", desk / "good.csv", "--machine", desk / "machine.yaml", "--out", desk / "new.json")
        assert said.code == 0
        assert ("visits: 39, expected 40 or more" in said.err) is (count == 39)


def sql(*statements: str) -> Spoil:
    def spoil(path: Path) -> None:
        db = sqlite3.connect(path)
        for statement in statements:
            db.execute(statement)
        db.commit()
        db.close()

    return spoil


def another_database(path: Path) -> None:
    path.unlink()
    sql("CREATE TABLE contacts (name TEXT)", "INSERT INTO contacts VALUES ('Ann')")(path)


DATABASES: dict[str, tuple[Spoil, str]] = {
    "cut off": (cut(0.5), "not a recording, or cut off"),
    "cut off in its header": (cut(0.001), ""),
    "garbage behind the header": (fill(b"SQLite format 3\0" + GARBAGE), "not a recording, or cut off"),
    "another database": (another_database, "not a recording"),
    "another format": (sql("UPDATE meta SET value = 'x 2' WHERE key = 'format'"), "expected 'ppshw recording 1', found 'x 2'"),
    "no columns": (sql("DELETE FROM meta WHERE key = 'columns'"), "damaged: it does not say the names of its columns"),
    "columns in shreds": (sql("UPDATE meta SET value = '[\"q' WHERE key = 'columns'"), "damaged"),
    "columns that are not there": (sql("UPDATE meta SET value = '[\"z\"]' WHERE key = 'columns'"), "damaged"),
    "columns of numbers": (sql("UPDATE meta SET value = '[1, 2]' WHERE key = 'columns'"), "damaged"),
    "a cell of bytes": (sql("UPDATE visits SET load = x'ff00' WHERE visit = 3"), "visit 3 has a cell that is no text"),
    "a cell in no encoding": (sql("UPDATE visits SET load = CAST(x'ff41' AS TEXT) WHERE visit = 3"), "damaged"),
    "no visit": (sql("DELETE FROM visits"), "the recording holds no visit yet"),
    "a word for a number": (sql("UPDATE visits SET q_rail = 'x' WHERE visit = 4"), ":4: column q_rail: 'x' is not a number"),
    "beyond a limit": (sql("UPDATE visits SET q_cmd_turn = '1.6' WHERE visit = 4"), "outside the limits -1.5 … 1.5"),
    "another machine's": (sql("UPDATE meta SET value = 'couch' WHERE key = 'machine_name'"),
                          "measured on machine 'couch', not on 'cell'"),
    "missing": FILES["missing"],
    "empty": FILES["empty"],
    "a folder": FILES["a folder"],
}  # fmt: skip


@pytest.mark.parametrize("case", DATABASES)
def test_a_recording_that_cannot_be_used(desk: Path, case: str) -> None:
    spoil, expected = DATABASES[case]
    spoil(desk / "good.db")
    rec, machine = desk / "good.db", ["--machine", desk / "machine.yaml"]
    for words in (
        ["identify", rec, *machine, "--out", desk / "new.json"],
        ["evaluate", rec, *machine, "--json"],
    ):
        line = refused(desk, *words)
        assert str(rec) in line
        assert expected in line


@pytest.mark.parametrize("case", ["cut off", "another database", "no visit", "missing", "empty", "a folder"])
def test_nothing_is_exported_from_a_broken_recording(desk: Path, case: str) -> None:
    DATABASES[case][0](desk / "good.db")
    assert str(desk / "good.db") in refused(desk, "export", desk / "good.db", desk / "new.csv")


# --- campaigns -------------------------------------------------------------------------------------------------------
CAMPAIGNS: dict[str, tuple[Spoil, str]] = {
    "a key is missing": (swap("name: little\n", ""), ":1: missing key 'name'"),
    "no steps": (swap("steps:", "stops:"), "'st"),
    "an unknown key": (swap("seed: 3", "sede: 3"), ":2: unknown key 'sede'"),
    "an unknown key in a step": (swap("count: 5", "count: 5, speed: 9"), ":8: unknown key 'steps[0].speed'"),
    "a wrong type": (swap("settle_s: 1", "settle_s: long"), "'settle_s' has 'long', expected a number"),
    "half a count": (swap("count: 5", "count: 5.5"), "'steps[0].count' is 5.5, expected a whole number"),
    "nan": (swap("settle_s: 1", "settle_s: .nan"), ":3: 'settle_s' has nan, expected a finite number"),
    "a negative time": (swap("settle_s: 1", "settle_s: -1"), "'settle_s' is -1"),
    "nothing to measure": (swap("count: 5", "count: 0"), "'steps[0].count' is 0"),
    "a load's name twice": (swap("name: box", "name: empty"), "empty"),
    "an unknown load": (swap("loads: [empty]", "loads: [full]"), ":8: 'steps[0].loads' has 'full', expected empty, box"),
    "a step without loads": (swap("loads: [empty]", "loads: []"), ":8: 'steps[0].loads' is empty, expected at least one load"),
    "a pose under a load that is several": (
        both(swap("mass: 60, com: [0, 0, 0.2]", "random: 3, mass: [5, 9], com: {x: [0, 0], y: [0, 0], z: [0, 0.1]}"),
             swap("poses: [{q: {rail: 0.2, turn: 0.5}}]", "poses: [{q: {rail: 0.2}, load: box}]")),
        ":10: 'steps[2].poses[0].load' stands for 3 load cases, expected one load"),
    "a random load that is called like another": (
        swap("{name: box, mass: 60, com: [0, 0, 0.2]}",
             "{name: box-1, mass: 5}\n  - {name: box, random: 3, mass: [5, 9], com: {x: [0, 0], y: [0, 0], z: [0, 0.1]}}"),
        ":7: load 'box-1' is defined twice"),
    "loads that may weigh less than nothing": (
        swap("mass: 60, com: [0, 0, 0.2]", "random: 3, mass: [-5, 9], com: {x: [0, 0], y: [0, 0], z: [0, 0.1]}"),
        ":6: 'loads[1].mass' must lie between 0 and 100000 kg"),
    "a load in milligrams": (swap("mass: 60", "mass: 6e7"), ":6: 'loads[1].mass' is 6e+07, expected between 0 and 100000"),
    "an unknown joint": (swap("joint: rail", "joint: lift"), "no joint 'lift' (there are: rail, turn)"),
    "an unknown target": (swap("count: 3", "count: 3, targets: [P9]"), "no target 'P9' (there are: P1, P2, P3, treatment)"),
    "an unknown kind": (swap("kind: random", "kind: wild"), "is 'wild', expected poses or sweep or random"),
    "a joint out of limits": (swap("rail: 0.2, turn: 0.5", "rail: 0.2, turn: 1.51"),
                              ":10: step poses: joint turn at 1.51 rad is outside its limits -1.5 … 1.5"),
    "a sweep out of limits": (swap("count: 5", "count: 5, from: -0.9"), "joint rail at -0.9 m is outside its limits"),
    "home out of limits": (swap("seed: 3", "home: {turn: 1.6}"), "joint turn at 1.6 rad is outside its limits -1.5 … 1.5"),
    "a nan in a pose": (swap("rail: 0.2", "rail: .nan"), "has nan, expected a finite number"),
    "cut off": (cut(0.8), ""),
    **FILES,
}  # fmt: skip


@pytest.mark.parametrize("case", CAMPAIGNS)
def test_a_campaign_that_cannot_be_run(desk: Path, case: str) -> None:
    spoil, expected = CAMPAIGNS[case]
    spoil(desk / "little.yaml")
    line = refused(desk, "plan", desk / "little.yaml", "--machine", desk / "machine.yaml", "--json")
    assert str(desk / "little.yaml") in line
    assert expected in line
    assert line == refused(desk, "run", desk / "little.yaml", "--site", desk / "site.yaml", "--out", desk / "new.db")


def test_a_machine_without_limits_is_not_moved(desk: Path) -> None:
    swap("    limits: {lower: -1.5, upper: 1.5, velocity: 0.5, acceleration: 1.0}\n", "")(desk / "machine.yaml")
    line = refused(desk, "plan", desk / "little.yaml", "--machine", desk / "machine.yaml")
    assert "joint turn has no limits" in line


# --- sites -----------------------------------------------------------------------------------------------------------
SITES: dict[str, tuple[Spoil, str]] = {
    "a key is missing": (swap("name: desk\n", ""), ":1: missing key 'name'"),
    "an axis is missing": (swap("  turn: {node: 2, counts_per_unit: 2.0e6}\n", ""), "missing key 'axes.turn'"),
    "an axis too many": (swap("  turn: {", "  tilt: {node: 9, counts_per_unit: 1}\n  turn: {"), "unknown key 'axes.tilt'"),
    "an unknown key": (swap("node: 1,", "node: 1, colour: red,"), ":7: unknown key 'axes.rail.colour'"),
    "a wrong type": (swap("node: 1,", "node: one,"), "'axes.rail.node' is 'one', expected a whole number"),
    "nan": (swap("1.0e6", ".nan"), "'axes.rail.counts_per_unit' has nan, expected a finite number"),
    "one node for two axes": (swap("node: 2", "node: 1"), "node 1 is given to two axes"),
    "faster than the machine": (swap("velocity: 0.1", "velocity: 0.3"), "is 0.3, the machine file allows 0.2"),
    "a direction of 0": (swap("node: 2,", "node: 2, direction: 0,"), "direction"),
    "no bus": (swap("  bus: {interface: virtual, channel: desk}\n", ""), "missing key 'can.bus'"),
    "an unknown protocol": (swap("protocol: geocom", "protocol: emscon"), "'tracker.protocol' is 'emscon', expected geocom"),
    "no port": (swap("  port: socket://127.0.0.1:9\n", ""), "missing key 'tracker.port'"),
    "air on another planet": (swap("pressure_hPa: 1005", "pressure_hPa: 6"), "is 6, expected between 500 and 1100"),
    "cut off": (cut(0.5), ""),
    **FILES,
}  # fmt: skip


@pytest.mark.parametrize("case", SITES)
def test_a_site_that_cannot_be_opened(desk: Path, case: str) -> None:
    spoil, expected = SITES[case]
    spoil(desk / "site.yaml")
    line = refused(desk, "check", "--site", desk / "site.yaml", "--json")
    assert str(desk / "site.yaml") in line
    assert expected in line
    assert line == refused(desk, "run", desk / "little.yaml", "--site", desk / "site.yaml", "--out", desk / "new.db")


def test_a_visit_whose_final_approach_begins_beyond_a_limit_is_refused_before_anything_is_opened(desk: Path) -> None:
    swap("velocity: 0.1", "approach_from: below, approach_distance: 0.05")(desk / "site.yaml")
    swap("poses: [{q: {rail: 0.2, turn: 0.5}}]", "poses: [{q: {rail: -0.79}}]")(desk / "little.yaml")
    words = ["run", desk / "little.yaml", "--site", desk / "site.yaml", "--out", desk / "new.db"]
    line = refused(desk, *words)
    assert f"{desk / 'little.yaml'}:8: step sweep: the final approach to rail = -0.8 begins beyond its limits: " in line
    assert "setpoint -0.85 m is below the limit -0.8" in line
    swap("count: 5, loads", "count: 5, margin: 0.1, loads")(desk / "little.yaml")
    line = refused(desk, *words)
    assert f"{desk / 'little.yaml'}:10: step poses: the final approach to rail = -0.79 begins beyond" in line


@pytest.mark.parametrize(
    ("bus", "lacks"),
    [
        ("{interface: socketcand, channel: can0}", "CAN socketcand can0: 'can.bus' of the site file lacks host, port"),
        ("{interface: slcan}", "CAN slcan ?: 'can.bus' of the site file lacks channel"),
        ("{channel: desk}", "CAN ? desk: 'can.bus' of the site file lacks interface"),
        (
            "{interface: virtual, channel: [1]}",
            "CAN virtual [1]: 'can.bus' of the site file cannot be used: unhashable",
        ),
    ],
)
def test_a_bus_that_is_described_badly(desk: Path, bus: str, lacks: str) -> None:
    swap("{interface: virtual, channel: desk}", bus)(desk / "site.yaml")
    assert lacks in refused(desk, "check", "--site", desk / "site.yaml")


def test_an_adapter_whose_makers_library_is_not_there_has_its_row(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """python-can's kvaser then says NameError, which is no error of ours."""

    def connect(*_: Any, **__: Any) -> None:
        raise NameError("name 'canGetNumberOfChannels' is not defined")

    monkeypatch.setattr("can.Bus", connect)
    swap("{interface: virtual, channel: desk}", "{interface: kvaser, channel: 0}")(desk / "site.yaml")
    said = ppshw("check", "--site", desk / "site.yaml")
    assert said.code == 1
    assert one_line(said.err)
    cause = "CAN kvaser 0: cannot be opened: NameError: name 'canGetNumberOfChannels' is not defined"
    assert said.err.startswith(f"ppshw: {cause}")
    assert said.out.startswith("CAN kvaser 0")


def test_machines_are_not_driven_from_windows(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ppshw.file_lock.sys.platform", "win32")
    for words in (["check"], ["run", "little.yaml", "--out", "x.db"]):
        assert "machines are driven from Linux (or macOS), not" in refused(desk, *words, "--site", desk / "site.yaml")


def test_a_site_whose_machine_file_is_missing_names_that_file(desk: Path) -> None:
    swap("machine: machine.yaml", "machine: other.yaml")(desk / "site.yaml")
    assert f"{desk / 'other.yaml'}: no such file" in refused(desk, "check", "--site", desk / "site.yaml")
    swap("machine: other.yaml", 'machine: "\\0"')(desk / "site.yaml")
    assert "'machine' is '\\x00', expected a text" in refused(desk, "check", "--site", desk / "site.yaml")


# --- calibrations ----------------------------------------------------------------------------------------------------
def edit(change: Callable[[dict[str, Any]], Any], sign: bool = True) -> Spoil:
    """Change what the file says; signed, as if it had been written so."""

    def spoil(path: Path) -> None:
        data = json.loads(path.read_text(encoding="utf-8"))
        change(data)
        if sign:
            data["content_sha256"] = content_digest(data)
        path.write_text(json.dumps(data), encoding="utf-8")

    return spoil


CALIBRATIONS: dict[str, tuple[Spoil, str]] = {
    "cut off": (cut(0.7), "not valid JSON, or cut off"),
    "not JSON": (put("format: ppshw"), "not valid JSON"),
    "a list": (put("[1, 2]"), "expected format 'ppshw calibration 1', found 'list'"),
    "another format": (edit(lambda d: d.update(format="x")), "expected format 'ppshw calibration 1', found 'x'"),
    "another machine's": (edit(lambda d: d["provenance"].update(machine_name="couch", machine_sha256="0" * 64)),
                          "made for machine 'couch' (file 000000000000), not for 'cell'"),
    "an edited value": (edit(lambda d: d["terms"][0]["parameters"][0].update(value=0.5), sign=False), "edited by hand?"),
    "no provenance": (edit(lambda d: d.pop("provenance")), "damaged: 'provenance' is missing"),
    "no terms": (edit(lambda d: d.pop("terms")), "damaged: 'terms' is missing"),
    "an unknown term": (edit(lambda d: d["terms"][0].update(kind="magic")), "damaged: unknown term 'magic'"),
    "a parameter short": (edit(lambda d: d["terms"][0]["parameters"].pop()), "damaged:"),
    "a value in words": (edit(lambda d: d["terms"][0]["parameters"][0].update(value="much")), "damaged:"),
    "nan": (edit(lambda d: d["terms"][0]["parameters"][0].update(value=float("nan"))), "not finite numbers"),
    "an absurd value": (edit(lambda d: d["terms"][0]["parameters"][0].update(value=1e300)), "terms holds values that are not finite numbers below 1e+09"),
    "an effect whose correlation is nan": (edit(lambda d: d["effects"].append(
        {"effect": "backlash", "joint": "rail", "sentence": "", "values": [1e-4, 1e-4], "std": [1e-5, 1e-5], "columns": [
            {"on": "frame", "function": "approach", "args": {"joint": 0}, "frame": 1, "component": 0}] * 2,
         "correlation": [[1.0, float("nan")], [float("nan"), 1.0]]})),
        "effects.backlash holds values that are not finite numbers"),
    "a reflector in two coordinates": (edit(lambda d: d["targets"]["P1"].pop()), "damaged:"),
    "a frame that no number holds": (edit(lambda d: d["measuring_in_base"][0].__setitem__(3, 10**400)), "damaged:"),
    "an instrument without noise": (edit(lambda d: d["noise"].update(instrument=0)), "noise.instrument is no standard deviation"),
    "nan for a strength": (edit(lambda d: d["strengths"].update({next(iter(d["strengths"])): float("nan")})),
                           "strengths holds values that are not finite numbers"),
    "nan for a limit": (edit(lambda d: d["valid"]["joints"].update(rail=[float("nan"), 1.0])), "not finite numbers"),
    "no covariance": (edit(lambda d: d["covariance"].update(data="")), "damaged:"),
    "covariance in shreds": (edit(lambda d: d["covariance"].update(data="eJwDAAAAAAE=AAAA")), "damaged:"),
    "a joint without range": (edit(lambda d: d["valid"]["joints"].pop("rail")), "damaged: 'rail' is missing"),
    "a frame of three rows": (edit(lambda d: d["measuring_in_base"].pop()), "damaged:"),
    "no frame at all": (edit(lambda d: d.update(measuring_in_base=[[0.0] * 4] * 4)), "measuring_in_base"),
    **FILES,
}  # fmt: skip


@pytest.mark.parametrize("case", CALIBRATIONS)
def test_a_calibration_that_cannot_be_used(desk: Path, case: str) -> None:
    spoil, expected = CALIBRATIONS[case]
    spoil(desk / "cal.json")
    given = ["--machine", desk / "machine.yaml", "--calibration", desk / "cal.json"]
    for words in (
        ["evaluate", desk / "good.csv", *given, "--json"],
        ["compensate", *given, "--joints", "0 0"],
        ["run", desk / "little.yaml", "--site", desk / "site.yaml", "--out", desk / "new.db", *given[2:]],
        ["move", *given, "--joints", "0 0", "--site", desk / "site.yaml"],
    ):
        line = refused(desk, *words)
        assert str(desk / "cal.json") in line
        assert expected in line


# --- what is asked for -----------------------------------------------------------------------------------------------
ASKED: dict[str, tuple[str, str]] = {
    "no command": ("", "the following arguments are required: COMMAND"),
    "an unknown command": ("dance", "invalid choice: 'dance'"),
    "an unknown option": ("plan little.yaml --machine machine.yaml --quickly", "unrecognized arguments: --quickly"),
    "no machine": ("plan little.yaml", "arguments are required: --machine"),
    "a campaign that is neither file nor name": ("plan waltz --machine machine.yaml", "waltz"),
    "a pose of five": ("compensate CAL --pose 1 2 3 4 5", "--pose: '1 2 3 4 5' holds 5 values, expected 6 finite numbers"),
    "a joint value with an underscore": ("compensate CAL --joints 0_1 0.2", "--joints: '0_1 0.2' holds something that is no number"),
    "a pose in words": ("compensate CAL --pose here", "--pose: 'here' holds something that is no number, expected 6"),
    "a nan in a pose": ("compensate CAL --pose 0 0 0 0 0 nan", "--pose: value 6 of 6, nan, is no finite number below 1e+09"),
    "a wrench of two": ("compensate CAL --joints 0 0 --wrench 1 2", "--wrench: '1 2' holds 2 values, expected 6"),
    "three joints of two": ("compensate CAL --joints 0,0,0", "--joints: '0,0,0' holds 3 values, expected 2"),
    "near three of two": ("compensate CAL --pose 0 0 0 0 0 0 --near 1 2 3", "--near: '1 2 3' holds 3 values, expected 2"),
    "pose and joints": ("compensate CAL --pose 0 --joints 0", "not allowed with argument --pose"),
    "neither pose nor joints": ("compensate CAL", "one of the arguments --pose --joints is required"),
    "an unknown point": ("compensate CAL --joints 0 0 --point nose",
                         "--point: no point named 'nose' in machine.yaml, expected one of tip, treatment, P1, P2, P3"),
    "a negative bound": ("compensate CAL --joints 0 0 --max-travel -1", "argument --max-travel: invalid positive number"),
    "a bound of nan": ("compensate CAL --joints 0 0 --max-angle nan", "argument --max-angle: invalid positive number"),
    "a seed for what is no chance": ("plan little.yaml --machine machine.yaml --seed 7",
                                     "--seed: designs a new campaign, and 'little.yaml' is one already"),
    "a list of what is not planned yet": ("plan little.yaml --machine machine.yaml --to-separate a,b --out x --list",
                                          "plan: --list has no meaning with --to-separate"),
    "visibility of what is not planned yet": ("plan little.yaml --machine machine.yaml --to-separate a,b --out x --visibility",
                                              "plan: --visibility has no meaning with --to-separate"),
    "the paper's method on another campaign": ("demo --out d --conceal 3 --method paper", "--method paper: has no meaning with"),
    "a short deck of many cases": ("prove --out d --short --cases 20", "prove: --short is a dozen cases of its own"),
    "a start beyond the limits": ("compensate CAL --joints 0 0 --from 9 0", "--from rail: 9 m is outside its limits -0.8 … 0.8"),
    "a thermometer that nobody read": ("compensate CAL --joints 0 0 --temperature nowhere=20",
                                       "--temperature: no thermometer of the calibration named 'nowhere', expected one of"),
    "near joints that are given": ("compensate CAL --joints 0 0 --near 0 0", "--near: chooses among the ways to reach a pose"),
    "a seed in words": ("demo --out d --seed luck", "argument --seed: invalid seed"),
    "a negative seed": ("demo --out d --seed -1", "argument --seed: invalid seed"),
    "a machine without treatment": ("demo --out d --machine plain.yaml", "plain.yaml: the demo needs a point named 'treatment'"),
    "a demo on another machine": ("demo --out d --machine machine.yaml", "no joint 'lateral' (there are: rail, turn)"),
    "a demo into a file": ("demo --out good.csv", "good.csv: exists and is no folder"),
    "a demo over recordings": ("demo --out .", "more, which no demo made; expected a new or an empty folder"),
    "a speed of nothing": ("simulate --machine machine.yaml --site-out s.yaml --speed 0", "--speed: invalid positive number"),
    "a speed beyond a clock's": ("simulate --machine machine.yaml --site-out s.yaml --speed 1e9", "--speed 1e+09: expected 0.001 to 100000"),
    "simulated hardware of a joint that no site may move": ("simulate --machine still.yaml --site-out s.yaml",
                                                            "still.yaml: joint turn has no lower, upper, velocity, acceleration, expected"),
    "simulated hardware of a joint whose speed nobody says": ("simulate --machine slow.yaml --site-out s.yaml",
                                                              "slow.yaml: joint rail has no velocity, expected limits: without them"),
    "a site file nowhere": ("simulate --machine machine.yaml --site-out no/s.yaml", "no/s.yaml: the folder no does not exist"),
    "simulated hardware over a real site": ("simulate --machine machine.yaml --site-out site.yaml",
                                            "site.yaml: exists already and is no site file of simulated hardware, expected a new file"),
    "simulated hardware over a list": ("simulate --machine machine.yaml --site-out list.yaml", "list.yaml: exists already and is no site file"),
    "simulated hardware over what is no YAML": ("simulate --machine machine.yaml --site-out cut.yaml", "cut.yaml: exists already and is no site file"),
    "a recording nowhere": ("import good.csv --machine machine.yaml --out no/new.db", "the folder no does not exist"),
    "a table nowhere": ("export good.db no/new.csv", "no/new.csv: the folder no does not exist"),
    "a calibration nowhere": ("identify good.csv --machine machine.yaml --out no/c.json", "the folder no does not exist"),
    "a run nowhere": ("run little.yaml --site site.yaml --out no/new.db", "no/new.db: the folder no does not exist"),
    "a run whose corrections are refused": ("run little.yaml --site site.yaml --out new.db --calibration cal.json",
                                            "little.yaml:8: step sweep, visit 1: corrected setpoint of joint 'rail' -0.801097 m is beyond its limits"),
    "an import over a file": ("import good.csv --machine machine.yaml --out good.db", "good.db: exists already"),
    "an import onto itself": ("import good.csv --machine machine.yaml --out good.csv", "good.csv: is what is read here"),
    "an export onto itself": ("export good.db good.db", "good.db: is what is read here"),
    "an export over a recording": ("export good.db campaign.db", "campaign.db: is a recording already"),
    "an export into a folder": ("export good.db .", "a folder, expected the name of a file"),
    "a calibration over another recording": ("identify good.csv --machine machine.yaml --out campaign.db",
                                             "campaign.db: is a recording already, expected another file to write"),
    "an answer over another recording": ("diagnose good.csv --machine machine.yaml --json campaign.db", "campaign.db: is a recording already"),
    "a page over another recording": ("diagnose good.csv --machine machine.yaml --json x --page campaign.db", "campaign.db: is a recording already"),
    "a twin over another recording": ("twin good.csv --machine machine.yaml --calibration cal.json --out campaign.db",
                                      "campaign.db: is a recording already"),
    "a plan over a recording": ("plan --visits 20 --machine machine.yaml --out campaign.db", "campaign.db: is a recording already"),
    "a calibration over a table": ("identify good.db --machine machine.yaml --out good.csv",
                                   "good.csv: exists already and is no JSON, expected another file to write"),
    "a table over a machine file": ("export good.db machine.yaml", "machine.yaml: exists already and is no table of visits"),
    "a table over a calibration": ("export good.db cal.json", "cal.json: exists already and is no table of visits"),
    "a page over a table": ("diagnose good.db --machine machine.yaml --json x --page good.csv", "good.csv: exists already and is no HTML page"),
    "a plan over a site file": ("plan --visits 20 --machine machine.yaml --out site.yaml", "site.yaml: exists already and is no campaign"),
    "an answer over a campaign": ("diagnose good.db --machine machine.yaml --json little.yaml", "little.yaml: exists already and is no JSON"),
    "a calibration over its recording": ("identify good.csv --machine machine.yaml --out good.csv", "is what is read here"),
    "a calibration over its machine": ("identify good.csv --machine machine.yaml --out machine.yaml", "is what is read here"),
    "a calibration into a folder": ("identify good.csv --machine machine.yaml --out .", "a folder, expected the name"),
    "two answers into one file": ("diagnose good.csv --machine machine.yaml --json x --out x", "x: two answers would go there"),
    "a page over its answer": ("diagnose good.csv --machine machine.yaml --json x --page ./x", "x: two answers would go there"),
    "an import into a table": ("import good.csv --machine machine.yaml --out new.csv", "new.csv: a recording is a database"),
    "a pose in degrees": ("compensate CAL --pose 0.1 0 0.7 0 30 0 --wrench 0 0 0 0 0 0", "--pose: an angle of 30 rad is more than a"),
    "faults of no drive": ("compensate CAL --joints 0 0 --wrench 0 0 0 0 0 0 --reset-faults",
                           "--reset-faults: no drive is spoken to without --site"),
    "an answer over its recording": ("diagnose good.csv --machine machine.yaml --json good.csv", "good.csv: is what is read here"),
    "visits over what they add to": ("plan little.yaml --machine machine.yaml --to-separate backlash,creep --out little.yaml",
                                     "little.yaml: is what is read here"),
    "a run into a table": ("run little.yaml --site site.yaml --out good.csv", "good.csv: a recording is a database, expected"),
    "a run into another campaign": ("run little.yaml --site site.yaml --out good.db", "good.db: was begun with another"),
    "a report of a recording": ("report good.db", "good.db: a file, expected the folder that a calibration was made in"),
    "a machine of no name": ("plan little.yaml --machine nope", "nope: no such file, and no machine of that name (there are: arm6, pps)"),
    "a report of nothing": ("report no", "no: no such folder"),
    "a paper's method without its campaign": ("identify good.csv --machine machine.yaml --method p --out c", "invalid choice"),
}  # fmt: skip


@pytest.mark.parametrize("case", ASKED)
def test_a_command_that_cannot_be_carried_out(desk: Path, case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    command, expected = ASKED[case]
    monkeypatch.chdir(desk)
    shutil.copyfile("good.db", "campaign.db")
    shutil.copyfile("machine.yaml", "plain.yaml")
    put("- 1\n")(desk / "list.yaml")
    put("name: [\n")(desk / "cut.yaml")
    swap("  points: {treatment: [0.4, 0, 0.1]}\n", "")(desk / "plain.yaml")
    for name, old, new in (
        ("still.yaml", "    limits: {lower: -1.5, upper: 1.5, velocity: 0.5, acceleration: 1.0}\n", ""),
        ("slow.yaml", "velocity: 0.2, ", ""),
    ):
        shutil.copyfile("machine.yaml", name)
        swap(old, new)(desk / name)
    words = command.replace("CAL", "--machine machine.yaml --calibration cal.json").split()
    assert expected in refused(desk, *words)


def test_a_name_in_no_encoding_is_refused_before_anything_is_computed(desk: Path) -> None:
    """It would go into a recording, a calibration and pages, which could not be written in the end."""
    name = desk / os.fsdecode(b"caf\xe9.csv")
    shutil.copyfile(desk / "good.csv", name)
    line = refused(desk, "import", name, "--machine", desk / "machine.yaml", "--out", desk / "new.db")
    assert "a name that is no UTF-8 text" in line


def test_a_failed_import_leaves_no_part_behind(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    connect = sqlite3.connect

    def small(*given: Any, **options: Any) -> sqlite3.Connection:
        db = connect(*given, **options)
        db.execute("PRAGMA max_page_count = 5")
        return db

    monkeypatch.setattr("sqlite3.connect", small)
    words = ["import", desk / "good.csv", "--machine", desk / "machine.yaml", "--out", desk / "new.db"]
    assert f"{desk / 'new.db'}: cannot be made (database or disk is full)" in refused(desk, *words, code=1)


# --- the program itself ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (
            "evaluate good.csv --machine no.yaml",
            "ppshw: no.yaml: no such file, and no machine of that name (there are: arm6, pps)\n",
        ),
        (
            "identify bad.csv --machine machine.yaml --out c.json",
            "bad.csv:12: column q_cmd_rail: setpoint 0.81 is outside",
        ),
    ],
)
def test_the_program_says_one_line_and_nothing_of_its_insides(desk: Path, words: str, expected: str) -> None:
    shutil.copyfile(desk / "good.csv", desk / "bad.csv")
    RECORDINGS["a setpoint beyond its limit"][0](desk / "bad.csv")
    before = contents(desk)
    done = subprocess.run([PROGRAM, *words.split()], cwd=desk, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert one_line(done.stderr)
    assert expected in done.stderr
    assert contents(desk) == before


def test_check_has_a_row_for_every_device_whatever_is_wrong(desk: Path) -> None:
    """Nothing answers at this site: two drives, a tracker and a force sensor."""
    before = contents(desk)
    said = ppshw("check", "--site", desk / "site.yaml", "--json")
    assert said.code == 1
    devices = json.loads(said.out)["devices"]
    assert [device["device"] for device in devices] == ["rail", "turn", "tracker", "force sensor"]
    assert all(device["problem"] for device in devices)
    words = [PROGRAM, "check", "--site", "site.yaml"]
    done = subprocess.run(words, cwd=desk, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert one_line(done.stderr)
    assert "rail: no SDO answer on vendor 0x1018:01 within 0.3 s (3 more of 4 devices have a problem)" in done.stderr
    rows = done.stdout.splitlines()
    assert max(map(len, rows)) <= 80
    begins = [row.split("  ")[0] for row in rows if not row.startswith(" ")]
    assert begins == ["rail", "turn", "tracker", "force sensor"]
    assert contents(desk) == before
