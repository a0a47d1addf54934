"""The benchmarks run, and write where they should. How fast anything is stands in docs/figures.md; no test asks."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import figures, peers, visibility
from ppshw.kinematics import point_positions
from ppshw.machine import Machine, load_machine

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def ur5() -> Machine:
    return load_machine(ROOT / "machines/real/ur5.yaml")


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ("peers", ["| ppshw |", "µs per pose"]),
        ("identify", ["bare gelsd", "ms per visit"]),
        ("compensate", ["ordinary scheduling", "In bulk"]),
        ("coverage", ["`python -m benchmarks.coverage --short`, pps.yaml", "| 100 |", "log score"]),
        ("noise_forms", ["| pps | each its own |", "chosen"]),
        ("designed", ["| designed, 12 |", "noise alone"]),
        ("visibility", ["| backlash | play |", "By its own name, noise as identified"]),
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


def test_the_visibility_of_cases_none_of_which_is_looked_at_name_by_name_is_their_table() -> None:
    row = ["backlash", "play", "yaw", "backlash", "0.5", "0.5", "9.0", "9.0"]
    text = visibility.said([row], np.ones(1), np.ones(1), visibility.Counted([], [], [], [], []), 60, 1)
    assert "| backlash | play | yaw |" in text
    assert "(b)" not in text


def test_the_forward_solution_that_is_timed_is_of_the_reflector_as_the_peers_is(ur5: Machine) -> None:
    q = np.random.default_rng(1).uniform(-np.pi, np.pi, (4, ur5.n))
    runs = peers.solutions(ur5, q)
    positions = runs["forward"]()
    assert positions == pytest.approx(point_positions(ur5, q, ur5.target_array))
    step = np.zeros(ur5.n)
    step[2] = 1e-6
    moved = (point_positions(ur5, q + step, ur5.target_array) - positions) / 1e-6
    assert runs["joint_jacobian"]()[..., 2] == pytest.approx(moved, abs=1e-5)


def test_a_jacobian_that_took_less_than_the_forward_solution_in_it_is_measured_again_and_then_no_figure() -> None:
    slow = {"forward": [1.9], "joint_jacobian": [1.5], "error_jacobian": [2.3]}
    possible = {"forward": [1.2], "joint_jacobian": [1.6], "error_jacobian": [2.4]}
    rounds = iter([slow, possible])
    both = peers.plausible(lambda: next(rounds))
    assert both == {"forward": [1.2, 1.9], "joint_jacobian": [1.6, 1.5], "error_jacobian": [2.4, 2.3]}
    possible = {"forward": [1.2, 1.9], "joint_jacobian": [1.5, 1.6], "error_jacobian": [1.3]}
    assert peers.plausible(lambda: possible) == possible
    with pytest.raises(SystemExit, match=r"joint Jacobian 1\.1 µs per pose, the forward solution in it 1\.2: .* again"):
        peers.plausible(lambda: {**possible, "joint_jacobian": [1.4, 1.1]})
    with pytest.raises(SystemExit, match="error Jacobian"):
        peers.plausible(lambda: {**possible, "error_jacobian": [1.1]})


def test_a_peer_with_another_arm_is_refused_by_its_reflector_or_by_its_joints_axes(ur5: Machine) -> None:
    runs = peers.solutions(ur5, np.zeros((2, ur5.n)))
    tips, jacobians = runs["forward"]()[:, 0], runs["joint_jacobian"]()[:, 0]
    answer = {"tips": tips.tolist(), "jacobians": jacobians.tolist()}
    peers.same_arm("peer", answer, tips, jacobians)
    peers.same_arm("peer", {"tips": tips.tolist()}, tips, jacobians)  # robotkinecal has none
    with pytest.raises(RuntimeError, match="peer has another arm: its reflector is off by 2 mm"):
        peers.same_arm("peer", {"tips": (tips + 2e-3).tolist()}, tips, jacobians)
    with pytest.raises(RuntimeError, match=r"peer has another arm: its joint Jacobian is off by 0\.5 mm/rad"):
        peers.same_arm("peer", {**answer, "jacobians": (jacobians + 5e-4).tolist()}, tips, jacobians)


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
