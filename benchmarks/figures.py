"""What the commands share: repeated timing, remarks on the machine, and the tables in docs/figures.md."""

from __future__ import annotations

import os
import platform
import statistics
import textwrap
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).parents[1]
FIGURES = ROOT / "docs/figures.md"
BEGIN, END = "<!-- speed:begin -->", "<!-- speed:end -->"
PARTS = ("peers", "identify", "compensate")
INTRODUCTION = """## Speed

Each table is one run of the command above it: its ratios hold for that run, whatever the machine. One thread
throughout. Times are processor time, which for one thread is the wall time of a machine that has nothing else to do
(this one was shared), except where wall time is said. The least of several rounds counts, since a busy neighbour only
ever adds (cache and memory are shared too); the median stands behind it in brackets.
"""


def seconds(run: Callable[[], object], rounds: int) -> list[float]:
    """Processor time of every round: with one thread the wall time of a machine that has nothing else to do."""
    out = []
    for _ in range(rounds):
        started = time.process_time()
        run()
        out.append(time.process_time() - started)
    return out


def span(values: Sequence[float], unit: str = "") -> str:
    """The least, and the median where there are several: `0.22 (0.25)`."""
    if len(values) == 1:
        return f"{number(values[0])}{unit}"
    return f"{number(min(values))} ({number(statistics.median(values))}){unit}"


def number(value: float) -> str:
    """Three digits, no exponent between a thousandth and a million."""
    return f"{value:.3g}" if value < 1000 else f"{value:,.0f}"


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def flow(text: str) -> str:
    """A paragraph in lines of the file's width."""
    return textwrap.fill(text, 120, break_long_words=False, break_on_hyphens=False)


def remarks(load_before: tuple[float, float, float]) -> str:
    """When, on what, and how busy it was: a load above 0 before the start is other people's work."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    cpu = next((line.split(":", 1)[1].strip() for line in lines if "model name" in line), platform.processor())
    return flow(
        f"{datetime.now(UTC):%Y-%m-%d}, {cpu}, {os.cpu_count()} cores, Python {platform.python_version()}; "
        f"load average {load_before[0]:.1f} before the run, {os.getloadavg()[0]:.1f} after."
    )


def write(part: str, text: str, path: Path = FIGURES) -> None:
    """Replace one command's part of the section and leave the rest of the file alone."""
    whole = path.read_text(encoding="utf-8") if path.is_file() else "# Figures\n"
    if BEGIN not in whole:
        parts = "\n".join(f"{_mark(p, 'begin')}\n{_mark(p, 'end')}\n" for p in PARTS)
        whole = f"{whole.rstrip()}\n\n{BEGIN}\n{INTRODUCTION}\n{parts}\n{END}\n"
    begin, end = _mark(part, "begin"), _mark(part, "end")
    before, rest = whole.split(begin, 1)
    after = rest.split(end, 1)[1]
    path.write_text(f"{before}{begin}\n{text.strip()}\n{end}{after}", encoding="utf-8")


def _mark(part: str, edge: str) -> str:
    return f"<!-- speed:{part}:{edge} -->"
