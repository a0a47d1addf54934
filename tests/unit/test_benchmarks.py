"""The benchmarks run, and write where they should. How fast anything is stands in docs/figures.md; no test asks."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import figures, peers

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ("peers", ["| ppshw |", "µs per pose"]),
        ("identify", ["bare gelsd", "ms per visit"]),
        ("compensate", ["ordinary scheduling", "In bulk"]),
        ("coverage", ["| 100 |", "log score"]),
        ("noise_forms", ["| pps | each its own |", "chosen"]),
        ("designed", ["| designed, 12 |", "noise alone"]),
    ],
)
def test_each_short_benchmark_prints_its_table_and_writes_nothing(command: str, expected: list[str]) -> None:
    before = figures.FIGURES.read_bytes() if figures.FIGURES.is_file() else None
    done = subprocess.run(
        [sys.executable, "-m", f"benchmarks.{command}", "--short"],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=240,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for words in expected:
        assert words in done.stdout
    assert (figures.FIGURES.read_bytes() if figures.FIGURES.is_file() else None) == before


def test_without_the_measured_arm_the_calibration_is_left_out_and_said_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["peers", "--short", "--data", str(tmp_path)])
    monkeypatch.setattr(peers, "PEERS", {})
    peers.main()
    assert f"No calibration: {tmp_path}/grid.csv is not there." in capsys.readouterr().out


def test_a_command_replaces_its_own_table_and_leaves_the_rest_of_the_file(tmp_path: Path) -> None:
    page = tmp_path / "figures.md"
    page.write_text("# Figures\n\n## Accuracy\n\nby others\n", encoding="utf-8")
    figures.write("identify", "first", page)
    figures.write("peers", "peers", page)
    page.write_text(page.read_text() + "\n## Later\n\nalso by others\n", encoding="utf-8")
    figures.write("identify", "second", page)
    text = page.read_text()
    assert "by others" in text
    assert text.endswith("## Later\n\nalso by others\n")
    assert "first" not in text
    assert text.count("## Speed") == 1
    assert text.index("speed:begin") < text.index("peers\n") < text.index("second") < text.index("speed:end")


@pytest.mark.parametrize(
    ("value", "text"), [(0.2234, "0.223"), (12.34, "12.3"), (123456.0, "123,456"), (1000.0, "1,000")]
)
def test_numbers_have_three_digits_and_no_exponent(value: float, text: str) -> None:
    assert figures.number(value) == text
