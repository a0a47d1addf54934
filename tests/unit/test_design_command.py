"""`ppshw plan` as a designer: what is asked wrongly is answered in one line, exit code 2, and nothing is written."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from campaigns.design import choose, designer
from ppshw.calibration import content_digest
from ppshw.cli import main
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant
from tests.unit.small_campaign import SLIDE

MACHINE = (
    f"name: rail\n{SLIDE}"
    + """\
tip: {targets: {P1: [0.2, 0, 0], P2: [0, 0.2, 0], P3: [0, -0.2, 0]}}
"""
)
LOADS = """\
name: weights
loads: [{name: empty, mass: 0}, {name: disc, mass: 40, com: [0, 0, 0.1]}]
steps: [{step: any, kind: random, count: 2}]
"""


def run(words: str) -> int:
    return main(words.split())


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a machine, weights and a recording."""
    monkeypatch.setattr(choose, "CANDIDATES", 120)
    monkeypatch.setattr(choose, "EXCHANGED", 60)
    monkeypatch.setattr(designer, "FIRST_LOOK", 80)
    (tmp_path / "m.yaml").write_text(MACHINE, encoding="utf-8")
    (tmp_path / "weights.yaml").write_text(LOADS, encoding="utf-8")
    plant = Plant.from_file(tmp_path / "m.yaml", seed=3)
    simulate_recording_csv(plant, tmp_path / "rec.csv", 20, np.random.default_rng(1), loads=2, visits_per_load=10)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_designed_measured_identified_and_gone_on_with(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("plan --visits 20 --machine m.yaml --loads weights.yaml --out new.yaml --json") == 0
    first = json.loads(capsys.readouterr().out)
    assert (first["visits"], first["out"]) == (20, "new.yaml")
    assert set(first["loads"]) == {"empty", "disc"}
    assert "ppshw plan --visits 20 --loads weights.yaml --seed 1" in (desk / "new.yaml").read_text().splitlines()[0]
    assert run("plan new.yaml --machine m.yaml --json") == 0
    assert json.loads(capsys.readouterr().out)["duration_s"] == first["duration_s"]
    assert run("identify rec.csv --machine m.yaml --out cal.json") == 0
    assert run("plan --visits 20 --machine m.yaml --calibration cal.json --out b.yaml") == 0
    assert "what calibration" in (desk / "b.yaml").read_text(encoding="utf-8")
    capsys.readouterr()
    assert run("plan --after rec.csv --accuracy 50mm --machine m.yaml --out c.yaml") == 0
    assert "enough: 50 mm is reached; stop" in capsys.readouterr().out
    assert not (desk / "c.yaml").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("", "expected a campaign to expand, or --visits, --accuracy or --after"),
        ("--visits 20", "--out CAMPAIGN.yaml is missing"),
        ("--visits 20 --accuracy 1mm --out a.yaml", "cannot both be asked for"),
        ("weights.yaml --visits 20", "--visits: designs a new campaign, and 'weights.yaml' is one already"),
        ("--visits 3 --out a.yaml", "--visits 3: a design has 10 to 2000 visits"),
        ("--accuracy 0.1um --out a.yaml", "noise alone leave 0.1"),
        ("--visits 20 --out m.yaml", "m.yaml: is what is read here"),
        ("--visits 20 --point nose --out a.yaml", "no point named 'nose'"),
        ("--visits 20 --loads nowhere.yaml --out a.yaml", "nowhere.yaml"),
        ("--after rec.csv --calibration x --out a.yaml", "--calibration is not needed with --after"),
    ],
)
def test_what_is_asked_wrongly_is_answered_in_one_line(
    desk: Path, capsys: pytest.CaptureFixture[str], words: str, said: str
) -> None:
    assert main(["plan", *words.split(), "--machine", "m.yaml"]) == 2
    complaint = capsys.readouterr().err
    assert said in complaint
    assert complaint.count("\n") == 1
    assert not (desk / "a.yaml").exists()
    assert not list(desk.glob("*.part"))


@pytest.mark.parametrize("text", ["0.25", "0.25 parsec", "-1mm", "0mm", "mm", "1e-4mmm"])
def test_a_length_without_sense_is_refused(desk: Path, capsys: pytest.CaptureFixture[str], text: str) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["plan", f"--accuracy={text}", "--machine", "m.yaml", "--out", "a.yaml"])
    assert stop.value.code == 2
    assert "length such as 0.25mm" in capsys.readouterr().err


def test_a_recording_that_identify_doubts_or_refuses_is_doubted_and_refused(
    desk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Readings a row late were 35 mm at 98.6 %, and a campaign after them; of few visits nothing was said (a
    reviewer's)."""
    assert run("plan --after rec.csv --accuracy 50mm --machine m.yaml --out c.yaml --json") == 0
    few, now = "visits: 20, expected 40 or more", json.loads(capsys.readouterr().out)
    assert any(few in line for line in now["warnings"])
    rows = [line.split(",") for line in (desk / "rec.csv").read_text(encoding="utf-8").splitlines()]
    at = [k for k, name in enumerate(rows[0]) if name[:2] in ("P1", "P2", "P3")]
    for row, other in zip(rows[1:], [r[:] for r in rows[:0:-1]], strict=True):  # of another visit each
        for k in at:
            row[k] = other[k]
    (desk / "late.csv").write_text("\n".join(map(",".join, rows)) + "\n", encoding="utf-8")
    said = []
    for words in (
        "identify late.csv --machine m.yaml --out cal.json",
        "plan --after late.csv --visits 5 --machine m.yaml --out d.yaml",
        "plan --after late.csv --to-separate backlash,friction_hysteresis --machine m.yaml --out d.yaml",
    ):
        assert run(words) == 2
        said.append(capsys.readouterr().err)
    assert said[0] == said[1] == said[2]
    assert not (desk / "d.yaml").exists()


def test_visits_that_separate_put_on_what_there_is_and_take_as_long_as_their_script_says(
    desk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A third of a load that nobody can divide was asked for, and 600 s charged for every block under one load."""
    words = "plan weights.yaml --machine m.yaml --to-separate clearance,missing_compliance"
    assert run(f"{words} --loads weights.yaml --out d.yaml --json") == 0
    said = json.loads(capsys.readouterr().out)
    assert run("plan d.yaml --machine m.yaml --json") == 0
    plan = json.loads(capsys.readouterr().out)
    assert said["duration_s"] == plan["duration_s"]
    assert set(plan["loads"]) <= {"empty", "disc"}
    assert run(f"{words} --out e.yaml") == 0
    assert "disc-0." in (desk / "e.yaml").read_text(encoding="utf-8")


def test_loads_that_nothing_tells_of_are_said_to_be_supposed(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """75 kg turned up in a campaign after a recording without a wrench (a reviewer's)."""
    rows = [row.split(",") for row in (desk / "rec.csv").read_text(encoding="utf-8").splitlines()]
    kept = [k for k, name in enumerate(rows[0]) if name not in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")]
    (desk / "bare.csv").write_text("".join(",".join(row[k] for k in kept) + "\n" for row in rows), encoding="utf-8")
    words = "plan --machine m.yaml --to-separate clearance,missing_compliance --visits 12 --out"
    said = []
    for more in ("d.yaml --after bare.csv", "e.yaml --after bare.csv --loads weights.yaml"):
        assert run(f"{words} {more}") == 0
        out = capsys.readouterr().out
        assert any(f"mass: {kg}" in (desk / more[:6]).read_text(encoding="utf-8") for kg in range(1, 10))
        said.append("loads are supposed" in out)
    assert said == [True, False]


def test_a_calibration_without_strengths_is_said_to_have_none(desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("identify rec.csv --machine m.yaml --out cal.json") == 0
    data = json.loads((desk / "cal.json").read_text(encoding="utf-8"))
    del data["strengths"]
    data["content_sha256"] = content_digest(data)
    (desk / "cal.json").write_text(json.dumps(data), encoding="utf-8")
    capsys.readouterr()
    assert run("plan --visits 20 --machine m.yaml --calibration cal.json --out b.yaml") == 2
    assert "identify the recording again" in capsys.readouterr().err
