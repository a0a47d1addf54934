"""What a terminal is shown: text folded to its width, and a progress bar with time left where something takes longer
than a second; the bar on stderr, quiet when nobody watches."""

from __future__ import annotations

import textwrap
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from tqdm import tqdm

WIDTH = 79
COLUMNS = 80
_COUNTED = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}]"
_FORETOLD = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} [{elapsed}<LEFT]"
_TIMED = "{desc}: {percentage:3.0f}%|{bar}| [{elapsed}<{remaining}]"


def folded(lines: Sequence[str]) -> str:
    """Lines no wider than a terminal of 80 columns; what goes on is indented further than its beginning."""
    return "\n".join(
        textwrap.fill(line, COLUMNS, subsequent_indent=" " * (len(line) - len(line.lstrip()) + 2),
                      break_on_hyphens=False, break_long_words=False)
        for line in lines
    )  # fmt: skip


class Bar:
    """One bar at a time. Use as a context manager, so that an error finds the line clear."""

    def __init__(self) -> None:
        self._bar: Any = None
        self._name = ""

    def __enter__(self) -> Bar:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def __call__(self, name: str, done: int, total: int, seconds_left: float | None = None) -> None:
        """`done` of `total` of what is called `name`; a new name begins a new bar.

        seconds_left  where somebody knows better than by how fast it went so far (a plan that knows its load changes)
        """
        if name != self._name:
            self._open(name, total, _COUNTED if seconds_left is None else _FORETOLD)
        if seconds_left is not None:
            self._bar.bar_format = _FORETOLD.replace("LEFT", tqdm.format_interval(seconds_left))
        self._bar.update(done - self._bar.n)

    @contextmanager
    def expect(self, name: str, seconds: float) -> Iterator[None]:
        """Something that reports nothing of itself but should take about so long."""
        if seconds < 1.0:
            yield
            return
        self._open(name, seconds, _TIMED, seconds)
        try:
            yield
        finally:
            self.close()

    def close(self) -> None:
        if self._bar is not None:
            self._over.set()
            if self._ticking.is_alive():
                self._ticking.join()
            self._bar.close()
        self._bar, self._name = None, ""

    def _open(self, name: str, total: float, form: str, seconds: float | None = None) -> None:
        self.close()
        self._name = name
        self._bar = tqdm(
            total=total, desc=name.replace("_", " "), bar_format=form, delay=1, disable=None, leave=False, ncols=WIDTH
        )
        self._over = threading.Event()
        self._ticking = threading.Thread(target=_tick, args=(self._bar, self._over, seconds), daemon=True)
        if not self._bar.disable:
            self._ticking.start()


def _tick(bar: Any, over: threading.Event, seconds: float | None) -> None:
    """Keep the clock on the bar going, and the bar too where time is all that is known."""
    began = time.monotonic()
    while not over.wait(0.25):
        passed = time.monotonic() - began
        if seconds is not None:
            bar.n = min(seconds, passed)
        if passed > 1.0:
            bar.refresh()
