"""Sealed cases from a generator that shares nothing with the diagnosis: nothing missing is said to be nothing, a drive
that loses motion is named, and what was found makes visits better that no fit has seen. Scores over many cases:
`ppshw prove`, docs/prove.md."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from ppshw.cli import main
from simulators.concealed.case import make_case

VISITS, FIT = 130, 90


def _diagnosed(tmp_path: Path, effect: str) -> tuple[Path, dict[str, Any], dict[str, Any]]:
    case, sealed = tmp_path / "case", tmp_path / "sealed"
    make_case(5, "pps", effect, 2.0, case, sealed, visits=VISITS, fit=FIT)
    answer = tmp_path / "answer.json"
    arguments = [str(case / "recording.csv"), "--machine", str(case / "machine.yaml")]
    assert main(["diagnose", *arguments, "--json", str(answer), "--out", str(tmp_path / "cal.json")]) == 0
    truth = json.loads((sealed / "truth.json").read_text())
    return case, json.loads(answer.read_text()), truth


def _rms(case: Path, calibration: Path, capsys: pytest.CaptureFixture[str]) -> float:
    capsys.readouterr()
    given = [str(case / "held_out.csv"), "--machine", str(case / "machine.yaml"), "--calibration", str(calibration)]
    assert main(["evaluate", *given, "--json"]) == 0
    return float(json.loads(capsys.readouterr().out)["rms_mm"])


def test_nothing_missing_is_said_to_be_nothing(tmp_path: Path) -> None:
    _, answer, _ = _diagnosed(tmp_path, "null")
    assert answer["verdict"] == "consistent"
    assert answer["findings"] == []
    assert answer["unexplained"] is None
    assert answer["visits"] == FIT
    shares = [row["share"] for row in answer["visibility"]]
    assert min(shares) >= 0.0
    assert max(shares) <= 1.0


def test_lost_motion_is_named_and_unseen_visits_get_better(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case, answer, truth = _diagnosed(tmp_path, "backlash")
    assert answer["verdict"] == "missing_physics"
    first = answer["findings"][0]
    assert first["effect"] == "backlash"
    assert first["joint"] == truth["effects"][0]["joint"]
    assert first["p_value"] < 1e-3
    assert 0 < first["weight"] <= 1
    rms_mm = truth["effects"][0]["rms_mm"]
    assert 0.2 * rms_mm < first["beyond_base_mm"] < first["rms_mm"] < 2 * rms_mm
    assert answer["held_out"]["rms_after_mm"] < answer["held_out"]["rms_before_mm"]
    arguments = [str(case / "recording.csv"), "--machine", str(case / "machine.yaml")]
    assert main(["identify", *arguments, "--out", str(tmp_path / "base.json")]) == 0
    before, after = _rms(case, tmp_path / "base.json", capsys), _rms(case, tmp_path / "cal.json", capsys)
    assert after < 0.9 * before


def test_a_recording_too_short_to_tell_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case = tmp_path / "case"
    make_case(5, "pps", "null", 1.0, case, tmp_path / "sealed", visits=40, fit=30)
    given = [str(case / "recording.csv"), "--machine", str(case / "machine.yaml")]
    assert main(["diagnose", *given, "--json", str(tmp_path / "a.json")]) == 2
    error = capsys.readouterr().err
    assert "visits with a target: 30, expected 40 or more" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "a.json").exists()
