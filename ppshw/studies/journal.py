"""What a study has finished, one JSON line per job, so that the same command again goes on where it stopped.

    {"code": "0.1.0 3f2a…", "function": "module:name", "key": …, "arguments": {…}, "seconds": 1.2, "result": {…}}

A line is there whole or not at all: what a killed process left of its last line is cut off. Results of different code
are not mixed: `code` is the version and a hash of our source files.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any

from ppshw import __version__
from ppshw.errors import BadInput
from ppshw.recording_file import only_writer

Json = dict[str, Any]


@cache
def code() -> str:
    """The version, and a hash of the sources that make results."""
    digest = hashlib.sha256()
    for package in ("ppshw", "campaigns", "simulators"):
        spec = find_spec(package)
        for folder in (spec.submodule_search_locations or []) if spec else []:
            for file in sorted(Path(folder).rglob("*.py")):
                digest.update(file.read_bytes())
    return f"{__version__} {digest.hexdigest()[:12]}"


class Journal:
    def __init__(self, path: Path | None, function: str, lines: dict[str, Json], file: IO[str] | None) -> None:
        self._path, self._function, self._lines, self._file = path, function, lines, file

    @classmethod
    @contextmanager
    def opened(cls, path: Path | None, function: str) -> Iterator[Journal]:
        """For this process alone. None: remembers nothing. Raises BadInput on a file that is no journal."""
        if path is None:
            yield cls(None, function, {}, None)
            return
        with only_writer(path):
            lines = _read(path) if path.exists() else {}
            with path.open("a", encoding="utf-8") as file:
                yield cls(path, function, lines, file)

    def result(self, key: str, arguments: Json) -> tuple[Json, float] | None:
        """What the job gave when it was done, and in how many seconds; None: not yet.

        Raises BadInput when that was another job.
        """
        line = self._lines.get(key)
        if line is None:
            return None
        mine = {"code": code(), "function": self._function, "arguments": json.loads(json.dumps(arguments))}
        for what, expected in mine.items():
            if line[what] != expected:
                raise BadInput(
                    f"{self._path}: '{key}' was made with {what} {line[what]}, here it is {expected}; "
                    "expected another folder"
                )
        return line["result"], line["seconds"]

    def add(self, key: str, arguments: Json, result: Json, seconds: float) -> Json:
        """Write it down; returns it as it will be read again."""
        line = {
            "code": code(), "function": self._function, "key": key, "arguments": arguments,
            "seconds": seconds, "result": result,
        }  # fmt: skip
        text = json.dumps(line)
        if self._file is not None:
            self._file.write(text + "\n")
            self._file.flush()
        again: Json = json.loads(text)["result"]
        return again


def _read(path: Path) -> dict[str, Json]:
    """Every line; one that was cut off by a kill is taken away. A file that is no journal is left as it is."""
    whole = path.read_bytes()
    end = whole.rfind(b"\n") + 1
    if end < len(whole) and not whole[end:].startswith(b"{"):
        raise BadInput(f"{path}: no study's journal, expected another folder")
    out: dict[str, Json] = {}
    for number, text in enumerate(whole[:end].splitlines(), start=1):
        try:
            line = json.loads(text)
            out[line["key"]] = {k: line[k] for k in ("code", "function", "arguments", "seconds", "result")}
        except (ValueError, KeyError, TypeError):
            raise BadInput(f"{path}:{number}: no line of a study's journal, expected another folder") from None
    if end < len(whole):
        with path.open("r+b") as file:
            file.truncate(end)
    return out
