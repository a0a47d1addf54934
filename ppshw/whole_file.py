"""Files that are written whole or not at all: beside their place first, then moved there in one step; and their
hash. What is no file (a pipe, /dev/stdout) stays what it is and gets what was written when it is whole."""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import gettempdir

from ppshw.errors import BadInput

# What is wrong with the place that was given, not with the disk.
BAD_PATH = {errno.ENOENT, errno.EACCES, errno.EPERM, errno.EISDIR, errno.ENOTDIR, errno.EEXIST, errno.ENAMETOOLONG,
            errno.ELOOP, errno.EROFS, errno.EINVAL}  # fmt: skip


@contextmanager
def written_whole(path: Path, may_be_missing: bool = False) -> Iterator[Path]:
    """A file beside `path` to write to; it takes its place when all went well, and is gone when not.

    may_be_missing  nothing written is nothing wrong
    """
    passed_on = is_no_file(path)
    place = Path(gettempdir()) / path.name if passed_on else path.resolve() if path.is_symlink() else path
    partial = place.with_name(f"{place.name}.{os.getpid()}.part")
    try:
        yield partial
        if partial.exists() or not may_be_missing:
            if passed_on:
                with path.open("ab") as stream:
                    stream.write(partial.read_bytes())
            else:
                os.replace(partial, place)
    except OSError as exc:
        if str(exc.filename or partial) == str(partial):  # a full disk names no file at all
            exc.filename = str(path)
        raise
    finally:
        with suppress(OSError):  # of what could not be written the first error says why
            partial.unlink(missing_ok=True)


def is_no_file(path: Path) -> bool:
    """Whether nothing may take the place of what is there: a device, a pipe, or what a process has open."""
    where = path.absolute().parts[1:3]
    in_use = where[:1] == ("proc",) or where in (("dev", "stdout"), ("dev", "stderr"), ("dev", "fd"))
    return path.exists() and (in_use or not (path.is_file() or path.is_dir()))


def write_text(path: Path, text: str, error: type[BadInput] = BadInput) -> None:
    """Write a text. Raises `error` with one line where the place cannot be written to, OSError where writing failed (a
    full disk); what was there before stays."""
    try:
        with written_whole(path) as partial:
            partial.write_text(text, encoding="utf-8")
    except OSError as exc:
        if exc.errno not in BAD_PATH:
            raise
        raise error(f"{path}: cannot be written ({exc.strerror or exc})") from None


def file_hash(path: Path | str) -> str:
    """SHA-256 of what a file holds, as `sha256sum` prints it."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()
