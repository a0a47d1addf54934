"""Files that are written whole or not at all: beside their place first, then moved there in one step; and their
hash."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ppshw.errors import BadInput


@contextmanager
def written_whole(path: Path, may_be_missing: bool = False) -> Iterator[Path]:
    """A file beside `path` to write to; it takes its place when all went well, and is gone when not.

    may_be_missing  nothing written is nothing wrong
    """
    partial = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        yield partial
        if partial.exists() or not may_be_missing:
            os.replace(partial, path)
    except OSError as exc:
        if str(exc.filename or partial) == str(partial):  # a full disk names no file at all
            exc.filename = str(path)
        raise
    finally:
        partial.unlink(missing_ok=True)


def write_text(path: Path, text: str, error: type[BadInput] = BadInput) -> None:
    """Write a text. Raises `error` with one line where the file cannot be written; what was there before stays."""
    try:
        with written_whole(path) as partial:
            partial.write_text(text, encoding="utf-8")
    except OSError as exc:
        raise error(f"{path}: cannot be written ({exc.strerror or exc})") from None


def file_hash(path: Path | str) -> str:
    """SHA-256 of what a file holds, as `sha256sum` prints it."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()
