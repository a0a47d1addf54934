"""What a table of texts means as arrays; the file it lives in while a campaign runs."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ppshw.errors import RecordingError, RunFailed
from ppshw.identification.plausible import doubts
from ppshw.machine import load_machine
from ppshw.recording import Recording, columns_for, load_recording, read_table
from ppshw.recording_file import RecordingFile
from tests.contract.desk import MACHINE


def read(folder: Path, *lines: str) -> Recording:
    (folder / "m.yaml").write_text(MACHINE, encoding="utf-8")
    (folder / "r.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return load_recording(folder / "r.csv", load_machine(folder / "m.yaml"))


def test_the_columns_are_the_contract_s_in_its_order(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text(MACHINE, encoding="utf-8")
    names = columns_for(load_machine(tmp_path / "m.yaml"), ["air"], ["treatment"], ["tilt"])
    assert " ".join(names) == (
        "time step load q_cmd_rail q_cmd_turn q_rail q_turn approach_rail approach_turn settle_s Fx Fy Fz Mx My Mz "
        "P1_x P1_y P1_z P2_x P2_y P2_z P3_x P3_y P3_z treatment_x treatment_y treatment_z temp_air_C cov_tilt"
    )


def test_the_least_columns_are_joints_and_one_target(tmp_path: Path) -> None:
    found = read(tmp_path, "q_rail,q_turn,P2_x,P2_y,P2_z", "0.1,0.2,1,2,3", "0.3,0.4,4,5,6")
    assert found.q.tolist() == found.q_cmd.tolist() == [[0.1, 0.2], [0.3, 0.4]]
    assert found.points[:, 1].tolist() == [[1, 2, 3], [4, 5, 6]]
    assert found.seen.tolist() == [[False, True, False]] * 2
    assert not found.has_wrench
    assert found.approach.tolist() == [[0, 0], [1, 1]]  # by the order of the visits
    assert not found.wrench.any()
    assert np.isnan(found.time).all()
    assert found.step == found.load == ("", "")


def test_an_accent_that_stands_behind_its_letter_is_the_same_name(tmp_path: Path) -> None:
    """As macOS writes names: a joint called brücke had no column q_brücke, which looks the same."""
    whole, apart = "br\u00fccke", "bru\u0308cke"
    for joint, column in ((whole, apart), (apart, whole)):
        (tmp_path / "m.yaml").write_text(MACHINE.replace("rail", joint), encoding="utf-8")
        (tmp_path / "r.csv").write_text(f"q_{column},q_turn,P2_x,P2_y,P2_z\n0.1,0.2,1,2,3\n", encoding="utf-8")
        found = load_recording(tmp_path / "r.csv", load_machine(tmp_path / "m.yaml"))
        assert found.joint_names == (whole, "turn")
        assert found.q.tolist() == [[0.1, 0.2]]


def test_a_copied_row_counts_once_at_points_of_interest_too(tmp_path: Path) -> None:
    head = "q_rail,q_turn,P1_x,P1_y,P1_z,treatment_x,treatment_y,treatment_z"
    row = "0.1,0.2,1.25,2.125,3.5,4.25,5.125,6.5"
    found = read(tmp_path, head, row, "0.3,0.4,4,5,6,7,8,9", row)
    assert found.copies == (2,)
    assert np.isfinite(found.extra_points["treatment"]).all(axis=1).tolist() == [True, True, False]


def test_optional_columns_that_are_misspelt_are_asked_about(tmp_path: Path) -> None:
    """Nobody was told that approach_trun, an optional column, was no column."""
    recording = read(
        tmp_path,
        "q_cmd_rail,q_rail,q_cmd_turn,approach_rail,approach_trun,SETTLE_S,fx,temp_air,Temperature,cov_aproach_turn,"
        "temp_motor_C,note,P1_x,P1_y,P1_z,P4_x",
        "0.1,0.1,0.2,1,-1,5,7,20,20,1,21,on,1,2,3,4",
    )
    assert recording.misspelt == {
        "approach_trun": "approach_turn", "SETTLE_S": "settle_s", "fx": "Fx", "temp_air": "temp_<place>_C",
        "Temperature": "temp_<place>_C",
    }  # fmt: skip
    assert read(
        tmp_path,
        "q_rail,q_turn,Fx [N],Fy (N),Fz_N,My [N m],P1_x,P1_y,P1_z,P2_x [mm],P2_y_m,P2 z,settle_s [s],temp_in_m",
        "0.1,0.2,1,2,3,4,1,2,3,4,5,6,7,8",
    ).misspelt == {
        "Fx [N]": "Fx", "Fy (N)": "Fy", "Fz_N": "Fz", "My [N m]": "My", "P2_x [mm]": "P2_x", "P2_y_m": "P2_y",
        "P2 z": "P2_z", "settle_s [s]": "settle_s", "temp_in_m": "temp_<place>_C",
    }  # fmt: skip
    said = doubts(load_machine(tmp_path / "m.yaml"), recording)
    assert "column approach_trun is read by nothing: is it approach_turn, which is not there?" in said
    assert read(tmp_path, ",".join(columns_for(load_machine(tmp_path / "m.yaml"))), *[",".join(
        ["2026-01-01T00:00:00Z", "s", "l", *["0"] * 7, *["0"] * 15]
    )]).misspelt == {}  # fmt: skip


def test_directions_that_are_all_0_are_those_of_the_moves_between_visits(tmp_path: Path) -> None:
    header = "q_rail,q_turn,approach_rail,approach_turn,P2_x,P2_y,P2_z"
    found = read(tmp_path, header, "0.1,0.2,0,0,1,2,3", "0.3,0.1,0,1,4,5,6")
    assert found.approach.tolist() == [[0, 0], [1, 1]]  # one was written down, and stands


def test_lines_of_nothing_but_spaces_are_no_visits(tmp_path: Path) -> None:
    found = read(tmp_path, "q_rail,q_turn,P2_x,P2_y,P2_z", "0.1,0.2,1,2,3", "", " \t", "0.3,0.4,4,5,6", "  ")
    assert found.q.tolist() == [[0.1, 0.2], [0.3, 0.4]]
    with pytest.raises(RecordingError, match=r"r\.csv:3: an empty row, commas only"):
        read(tmp_path, "q_rail,q_turn,P2_x,P2_y,P2_z", "0.1,0.2,1,2,3", " ,,,", "0.3,0.4,4,5,6")


def test_an_encoder_that_said_nothing_is_where_it_was_sent(tmp_path: Path) -> None:
    found = read(tmp_path, "q_cmd_rail,q_rail,q_cmd_turn,P1_x,P1_y,P1_z", "0.1,0.1001,0.2,0,0,0", "0.3,,0.4,0,0,0")
    assert found.q.tolist() == [[0.1001, 0.2], [0.3, 0.4]]
    assert found.q_cmd.tolist() == [[0.1, 0.2], [0.3, 0.4]]


def test_only_what_was_commanded_must_be_inside_the_limits(tmp_path: Path) -> None:
    """An encoder may read a hair beyond the limit that the axis was sent to; a file's last decimal may round up."""
    found = read(tmp_path, "q_cmd_rail,q_rail,q_turn,P1_x,P1_y,P1_z", "0.8000005,0.80002,0,0,0,0")
    assert found.q[0, 0] == 0.80002
    with pytest.raises(RecordingError, match=r"r\.csv:2: column q_cmd_rail: setpoint 0\.800002 is outside"):
        read(tmp_path, "q_cmd_rail,q_rail,q_turn,P1_x,P1_y,P1_z", "0.800002,0.8,0,0,0,0")
    found = read(tmp_path, "q_rail,q_cmd_turn,P1_x,P1_y,P1_z", "0.81,0,0,0,0")  # nobody says where it was sent
    assert found.q[0, 0] == found.q_cmd[0, 0] == 0.81
    with pytest.raises(RecordingError, match=r"r\.csv:3: column q_cmd_turn: setpoint -1\.6 is outside"):
        read(tmp_path, "q_rail,q_cmd_turn,P1_x,P1_y,P1_z", "0.81,0,0,0,0", "0.81,-1.6,0,0,0")


@pytest.mark.parametrize(("visits", "known"), [(10, True), (11, False)])
def test_a_day_alone_says_when_no_visit_was(tmp_path: Path, visits: int, known: bool) -> None:
    """What goes on with time had no course then, and a zero's jump was structure over its joint's position (a
    reviewer's); without the column visits are counted."""
    rows = [f"2024-05-01,0.1,{0.01 * k},1,2,{k}" for k in range(visits)]
    assert np.isfinite(read(tmp_path, "time,q_rail,q_turn,P1_x,P1_y,P1_z", *rows).time).all() == known
    assert np.isfinite(
        read(tmp_path, "time,q_rail,q_turn,P1_x,P1_y,P1_z", *rows[:-1], rows[-1].replace("-01", "-02")).time
    ).all()


def test_time_is_utc_whatever_way_it_is_written(tmp_path: Path) -> None:
    written = ["2026-03-02T06:00:00Z", "2026-03-02 06:00:01", "2026-03-02T08:00:02+02:00", "2026-03-02T06:00:02.000Z"]
    found = read(tmp_path, "time,q_rail,q_turn,P1_x,P1_y,P1_z", *(f"{t},0,0,0,0,0" for t in written))
    start = datetime(2026, 3, 2, 6, tzinfo=UTC).timestamp()
    assert (found.time - start).tolist() == [0, 1, 2, 2]  # two visits in one second are no step back
    empty = read(tmp_path, "time,q_rail,q_turn,P1_x,P1_y,P1_z", ",0,0,0,0,0", ",0,0,0,0,1")
    assert np.isnan(empty.time).all()  # a column without a single time is none


def test_a_thermometer_s_broken_cells_are_empty_ones(tmp_path: Path) -> None:
    """Three of 480 cells at 85 and 0 °C let setpoints be driven by any temperature up to that (a reviewer's)."""
    warm = 20.0 + 0.02 * np.arange(200) + (np.arange(200) > 120) * 8.0  # a night between
    read_there = warm.copy()
    read_there[[0, 40, 41, 150]] = 85.0, 85.0, 85.0, 0.0
    rows = [f"{0.001 * k},0.2,1,2,{k},{t:.2f}" for k, t in enumerate(read_there)]
    found = read(tmp_path, "q_rail,q_turn,P2_x,P2_y,P2_z,temp_air_C", *rows)
    assert found.spikes == {"air": (0, 40, 41, 150)}
    np.testing.assert_allclose(found.temperatures["air"], warm, atol=0.07)
    assert found.subset(np.arange(41, 200)).spikes == {"air": (0, 109)}
    assert doubts(load_machine(tmp_path / "m.yaml"), found)[0].startswith("temp_air_C leaps at 4 visits (1, 41, 42, 15")


def test_a_thermometer_that_said_nothing_for_long_is_asked_about(tmp_path: Path) -> None:
    """Empty at half of the visits, growth with it was said to go with the air (a reviewer's)."""
    told = [f"{20 + 0.01 * k:.2f}" for k in range(200)]
    told[20:80], told[150] = [""] * 60, ""
    at = [(datetime(2026, 3, 2, tzinfo=UTC) + timedelta(seconds=60 * k)).isoformat() for k in range(200)]
    columns = "time,q_rail,q_turn,P2_x,P2_y,P2_z,temp_air_C"
    rows = [f"{at[k]},{0.001 * k},0.2,1,2,{k},{told[k]}" for k in range(200)]
    found = read(tmp_path, columns, *rows)
    assert found.silent == {"air": (*range(20, 80), 150)}
    assert found.spikes == {}
    said = [line for line in doubts(load_machine(tmp_path / "m.yaml"), found) if "empty" in line]
    assert [line.split(":")[0] for line in said] == [
        "temp_air_C is empty at 61 of 200 visits, from visit 21 on for 1.0 h"
    ]
    now_and_then = found.subset(np.delete(np.arange(200), np.arange(22, 80)))
    assert now_and_then.silent == {"air": (20, 21, 92)}
    assert not [line for line in doubts(load_machine(tmp_path / "m.yaml"), now_and_then) if "empty" in line]
    never = read(tmp_path, columns, *(row.rsplit(",", 1)[0] + "," for row in rows))
    assert never.silent == {}


def test_a_thermometer_that_never_said_anything_is_asked_about(tmp_path: Path) -> None:
    rows = [f"{0.01 * k},0.2,{k},2,3,,21.5" for k in range(20)]
    found = read(tmp_path, "q_rail,q_turn,P2_x,P2_y,P2_z,temp_air_C,temp_rail_C", *rows)
    said = [line for line in doubts(load_machine(tmp_path / "m.yaml"), found) if "temp_" in line]
    assert said == ["temp_air_C is empty at every visit: nothing can be told to go with it"]


def test_a_thermometer_that_leaps_again_and_again_is_believed(tmp_path: Path) -> None:
    warm = np.random.default_rng(1).permutation(np.linspace(18.0, 40.0, 100))  # visits that are not in order
    rows = [f"{0.001 * k},0.2,1,2,{k},{t:.2f}" for k, t in enumerate(warm)]
    found = read(tmp_path, "q_rail,q_turn,P2_x,P2_y,P2_z,temp_air_C", *rows)
    assert found.spikes == {}
    np.testing.assert_allclose(found.temperatures["air"], warm, atol=0.01)


def test_temperatures_covariates_and_points_of_interest_have_their_names(tmp_path: Path) -> None:
    found = read(tmp_path, "q_rail,q_turn,P1_x,P1_y,P1_z,treatment_x,treatment_y,treatment_z,temp_hall_C,cov_tilt,who",
                 "0,0,0,0,0,1,2,3,21.5,1e-4,Ann", "0,0,0,0,0,,,,,,Bob")  # fmt: skip
    assert found.temperatures["hall"][0] == 21.5
    assert found.temperatures["hall"][1] == 21.5  # an empty cell: as before
    assert found.covariates["tilt"][0] == 1e-4
    assert found.extra_points["treatment"][0].tolist() == [1, 2, 3]
    assert np.isnan(found.extra_points["treatment"][1]).all()


def test_a_part_of_a_recording_is_a_recording(tmp_path: Path) -> None:
    rows = (f"s{k},{k / 10},0,{k},0,0,{20 + k}" for k in range(5))
    found = read(tmp_path, "step,q_rail,q_turn,P1_x,P1_y,P1_z,temp_air_C", *rows)
    for which in (np.array([3, 1]), np.array([False, True, False, True, False])):
        part = found.subset(which)
        order = np.arange(5)[which]
        assert part.step == tuple(f"s{k}" for k in order)
        assert part.points[:, 0, 0].tolist() == order.tolist()
        assert part.temperatures["air"].tolist() == (20 + order).tolist()
        assert len(part) == 2


def test_what_a_machine_did_is_read_though_every_beam_was_lost(tmp_path: Path) -> None:
    """A corrected run of which the first visits all lost their beam could not go on (a reviewer's)."""
    lines = ("q_rail,q_turn,P1_x,P1_y,P1_z", "0.1,0.2,,,", "0.3,0.4,,,")
    with pytest.raises(RecordingError, match="not one target was measured"):
        read(tmp_path, *lines)
    found = load_recording(tmp_path / "r.csv", load_machine(tmp_path / "m.yaml"), lost_at_all=True)
    assert found.q.tolist() == [[0.1, 0.2], [0.3, 0.4]]
    assert not found.measured.any()


# --- the file --------------------------------------------------------------------------------------------------------
def test_a_visit_is_committed_with_its_shots_or_not_at_all(tmp_path: Path) -> None:
    with RecordingFile.create(tmp_path / "r.db", ["load", "q"], {"machine_name": "m"}) as file:
        assert file.append({"load": "box", "q": "0.5"}, 7, [("P1", {"ppm": 2.5}), ("P2", {})]) == 1
        with pytest.raises(RecordingError, match="has no column z"):
            file.append({"z": "1"}, 8)
        with pytest.raises(RunFailed, match=r"r\.db: cannot be written .*UNIQUE"):  # a place is measured once
            file.append({"q": "0.6"}, 7, [("P1", {})])
        assert file.table() == (("load", "q"), (("box", "0.5"),))
        assert file.shots(1) == [("P1", {"ppm": 2.5}), ("P2", {})]
        assert file.done() == {7}
        again = file.append({"q": "0.7"}, 7, [("P3", {})], again=True)  # unless it is asked to be
        assert (file.done(), file.shots(again), file.table()[1]) == ({7}, [("P3", {})], (("", "0.7"),))


class _Interrupted:
    """A connection whose first BEGIN is followed by the operator's Ctrl-C."""

    def __init__(self, db: sqlite3.Connection) -> None:
        self._db, self._begun = db, False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._db, name)

    def execute(self, statement: str, *values: Any) -> sqlite3.Cursor:
        cursor = self._db.execute(statement, *values)
        if statement.startswith("BEGIN") and not self._begun:
            self._begun = True
            raise KeyboardInterrupt
        return cursor


def test_an_interrupt_between_begin_and_a_visit_leaves_the_recording_open_to_what_is_logged_next(
    tmp_path: Path,
) -> None:
    """Found by a run under load that was told to end: its event log lacked that it had been stopped."""
    with RecordingFile.create(tmp_path / "r.db", ["cmd_a", "approach_a", "sphere_x"], {}) as file:
        file.append({"cmd_a": "1"}, plan_index=0)
        file._db = _Interrupted(file._db)  # type: ignore[assignment]
        with pytest.raises(KeyboardInterrupt) as interrupted:
            file.append({"cmd_a": "2"}, plan_index=1)
        file.log("2026-01-01T00:00:00.000+00:00", "stopped", "interrupted")
        assert interrupted.value is not None  # alive meanwhile, with all that it holds, as where it is handled
    with RecordingFile.open(tmp_path / "r.db") as file:
        assert [kind for _, kind, _, _ in file.events()] == ["stopped"]
        assert file.done() == {0}


def test_a_full_disk_is_named_and_costs_nothing_that_was_there(tmp_path: Path) -> None:
    with RecordingFile.create(tmp_path / "r.db", ["q"], {}) as file:
        file.append({"q": "1"}, 0)
        file._db.execute(f"PRAGMA max_page_count = {file._db.execute('PRAGMA page_count').fetchone()[0]}")
        with pytest.raises(RunFailed, match=r"r\.db: cannot be written \(database or disk is full\)"):
            file.append({"q": "x" * 50_000}, 0, again=True)
        assert file.table()[1] == (("1",),)


def test_a_file_is_never_made_over_another(tmp_path: Path) -> None:
    (tmp_path / "r.db").write_text("mine")
    with pytest.raises(RecordingError, match=r"r\.db: exists already"):
        RecordingFile.create(tmp_path / "r.db", ["q"], {})
    with pytest.raises(RecordingError, match=r"the folder .*nowhere does not exist"):
        RecordingFile.create(tmp_path / "nowhere" / "r.db", ["q"], {})
    with pytest.raises(RecordingError, match=r"wide\.db: cannot be made \(too many columns"):
        RecordingFile.create(tmp_path / "wide.db", [f"c{k}" for k in range(3000)], {})
    with pytest.raises(RecordingError, match=r"twice\.db: column q_x is there twice, expected every name once"):
        RecordingFile.create(tmp_path / "twice.db", ["q_x", "load", "q_x"], {})


DIE = """\
import os, sqlite3, sys
db = sqlite3.connect(sys.argv[1], isolation_level=None)
db.execute("PRAGMA cache_size = 1")
db.execute("BEGIN IMMEDIATE")
db.executemany("INSERT INTO visits (q) VALUES (?)", [("x" * 5000,)] * 50)  # spills into the file before the commit
os._exit(1)
"""


def test_half_a_visit_of_a_killed_run_is_taken_back_by_whoever_reads_next(tmp_path: Path) -> None:
    with RecordingFile.create(tmp_path / "r.db", ["q"], {}) as file:
        file.append({"q": "1"}, 0)
    subprocess.run([sys.executable, "-c", DIE, str(tmp_path / "r.db")], check=False)
    assert (tmp_path / "r.db-journal").exists()
    assert read_table(tmp_path / "r.db").rows == (("1",),)


def test_reading_does_not_disturb_who_writes(tmp_path: Path) -> None:
    with RecordingFile.create(tmp_path / "r.db", ["q"], {}) as file:
        for k in range(3):
            file.append({"q": str(k)}, k)
            assert len(read_table(tmp_path / "r.db").rows) == k + 1


@pytest.mark.parametrize("statement", range(6))
def test_a_kill_while_a_recording_is_made_leaves_none(tmp_path: Path, statement: int) -> None:
    """The process dies at the n-th statement; the same command afterwards makes the recording."""
    die = MADE.format(path=str(tmp_path / "r.db"), statement=statement)
    assert subprocess.run([sys.executable, "-c", die], check=False).returncode == 9
    assert not (tmp_path / "r.db").exists()
    with RecordingFile.create(tmp_path / "r.db", ["q"], {}) as file:
        file.append({"q": "1"}, 0)
    assert read_table(tmp_path / "r.db").rows == (("1",),)


MADE = """\
import itertools, os, sqlite3
from ppshw.recording_file import RecordingFile
count = itertools.count()
def traced(sql):
    if next(count) == {statement}:
        os._exit(9)
connect = sqlite3.connect
def connected(*given, **options):
    db = connect(*given, **options)
    db.set_trace_callback(traced)
    return db
sqlite3.connect = connected
RecordingFile.create({path!r}, ["q"], {{}})
"""


def test_a_recording_that_cannot_be_made_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"r\.db: cannot be made"):
        RecordingFile.create(tmp_path / "r.db", [f"c{k}" for k in range(5000)], {})
    assert list(tmp_path.iterdir()) == []
