"""The SQLite file that a campaign writes: visits, raw shots, events, and what the run was made with.

A visit, its shots and its place in the campaign are one transaction: a kill at any instruction costs at most the visit
in progress. Cells are kept as the texts they came as, so that a CSV goes in and comes out the same.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

from ppshw.errors import RecordingError, RunFailed
from ppshw.file_lock import locked
from ppshw.whole_file import written_whole

FORMAT = "ppshw recording 1"
_OF_THE_DISK = (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR)
_SCHEMA = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE shots (visit INTEGER NOT NULL REFERENCES visits(visit), target TEXT NOT NULL, data TEXT NOT NULL);
CREATE TABLE events (time TEXT NOT NULL, kind TEXT NOT NULL, text TEXT NOT NULL, data TEXT NOT NULL);
"""


def is_sqlite(path: Path) -> bool:
    """Whether a file begins like an SQLite database, whatever it is called. Raises OSError where it cannot be read."""
    with path.open("rb") as file:
        return file.read(16) == b"SQLite format 3\x00"


@contextmanager
def only_writer(path: Path | str) -> Iterator[None]:
    """Nobody else runs into the same recording meanwhile. Raises RecordingError at once when somebody does.

    A lock on `<path>.lock` beside it: the recording itself may not be there yet, and SQLite's own locks are held for
    one transaction only.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise RecordingError(f"{path}: the folder {path.parent} does not exist")
    lock = path.with_name(path.name + ".lock")
    try:
        handle = locked(lock)
    except BlockingIOError:
        raise RecordingError(f"{path}: another run is writing it; wait for its end or choose a new file") from None
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(handle)


class RecordingFile:
    """An open recording. Use as a context manager."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self._db = connection

    @classmethod
    def create(
        cls, path: Path | str, columns: Sequence[str], meta: Mapping[str, str], rows: Iterable[Sequence[str]] = ()
    ) -> RecordingFile:
        """A new recording, there in one step with these rows (an import). Raises RecordingError when the file exists
        already or cannot be one, RunFailed when the disk takes it no more."""
        path = Path(path)
        if path.exists():
            raise RecordingError(f"{path}: exists already, expected a new file")
        if not path.parent.is_dir():
            raise RecordingError(f"{path}: the folder {path.parent} does not exist")
        if twice := [name for k, name in enumerate(columns) if name in columns[:k]]:
            raise RecordingError(f"{path}: column {twice[0]} is there twice, expected every name once")
        try:
            with written_whole(path) as partial:
                _create(partial, columns, meta, rows)
        except sqlite3.Error as exc:  # no right to write there, more columns than SQLite has; or no room
            kind = RunFailed if getattr(exc, "sqlite_errorcode", 0) & 0xFF in _OF_THE_DISK else RecordingError
            raise kind(f"{path}: cannot be made ({exc})") from None
        return cls.open(path)

    @classmethod
    def open(cls, path: Path | str, readonly: bool = False) -> RecordingFile:
        """An existing recording. Raises RecordingError when it is none or is damaged."""
        path = Path(path)
        if not path.is_file():
            raise RecordingError(f"{path}: no such recording")
        # A journal beside it is half a visit of a run that was killed; SQLite must write to take it back.
        journal = path.with_name(path.name + "-journal").exists()
        mode = "ro" if readonly and not journal else "rw"
        db: sqlite3.Connection | None = None
        try:
            db = sqlite3.connect(f"{path.resolve().as_uri()}?mode={mode}", uri=True, isolation_level=None)
            file = cls(path, db)
            found = file.meta().get("format")
            damage = db.execute("PRAGMA quick_check").fetchone()[0]
        except sqlite3.Error as exc:
            if db is not None:
                db.close()
            raise RecordingError(f"{path}: not a recording, or cut off ({exc})") from None
        if found != FORMAT or damage != "ok":
            db.close()
            raise RecordingError(f"{path}: expected '{FORMAT}', found {found!r} ({damage})")
        return file

    def __enter__(self) -> RecordingFile:
        return self

    def __exit__(self, *exc: type[BaseException] | BaseException | TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file; every visit is in it already."""
        self._db.close()

    def meta(self) -> dict[str, str]:
        """What the run was made with, as texts by name."""
        return dict(self._db.execute("SELECT key, value FROM meta"))

    def columns(self) -> tuple[str, ...]:
        """The names of the columns, in the order of the CSV. Raises RecordingError where the file is damaged."""
        try:
            names = json.loads(self.meta()["columns"])
        except (KeyError, TypeError, ValueError):
            names = None
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise RecordingError(f"{self.path}: damaged: it does not say the names of its columns")
        return tuple(names)

    def table(self) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
        """Header and rows as text, in the order they were measured. Raises RecordingError where the file is damaged."""
        try:
            header = self.columns()
            names = ", ".join(_sql_names(header))
            there = {_quoted(row[1]) for row in self._db.execute("PRAGMA table_info(visits)")}
            if lacking := set(_sql_names(header)) - there:
                raise ValueError(f"no column {', '.join(sorted(lacking))}")  # SQLite would take the name for a text
            rows = tuple(self._db.execute(f"SELECT {names} FROM visits ORDER BY visit"))
        except (sqlite3.Error, ValueError) as exc:
            raise RecordingError(f"{self.path}: damaged: {exc}") from None
        for k, row in enumerate(rows):
            if not all(isinstance(cell, str) for cell in row):
                raise RecordingError(f"{self.path}: damaged: visit {k + 1} has a cell that is no text")
        return header, rows

    def append(
        self,
        cells: Mapping[str, str],
        plan_index: int | None = None,
        shots: Iterable[tuple[str, Mapping[str, Any]]] = (),
        again: bool = False,
    ) -> int:
        """Commit one visit with its raw shots; returns its number. Columns not given stay empty.

        again  in place of the visit of that plan index that is there (the operator's redo)
        Raises RunFailed where it cannot be written, as a second visit of a plan index.
        """
        header = self.columns()
        unknown = set(cells) - set(header)
        if unknown:
            raise RecordingError(f"{self.path}: the recording has no column {', '.join(sorted(unknown))}")
        names = ", ".join(_sql_names(header))
        marks = ", ".join("?" * (len(header) + 1))
        with self._writing():
            if again:
                self._forget(plan_index)
            cursor = self._db.execute(
                f"INSERT INTO visits (plan_index, {names}) VALUES ({marks})",
                [plan_index, *(cells.get(c, "") for c in header)],
            )
            visit = int(cursor.lastrowid or 0)
            self._db.executemany(
                "INSERT INTO shots VALUES (?, ?, ?)", [(visit, target, json.dumps(data)) for target, data in shots]
            )
        return visit

    def _forget(self, plan_index: int | None) -> None:
        mine = "SELECT visit FROM visits WHERE plan_index = ?"
        self._db.execute(f"DELETE FROM shots WHERE visit IN ({mine})", [plan_index])
        self._db.execute("DELETE FROM visits WHERE plan_index = ?", [plan_index])

    def measured_at(self) -> dict[int, str]:
        """Plan index → when it was measured, as the visit's `time` says it; none where the recording has no times."""
        if "time" not in self.columns():
            return {}
        return dict(self._db.execute("SELECT plan_index, time FROM visits WHERE plan_index IS NOT NULL"))

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            with _transaction(self._db):
                yield
        except sqlite3.Error as exc:
            raise RunFailed(f"{self.path}: cannot be written ({exc}); what was in it before is there") from exc

    def done(self) -> set[int]:
        """Plan indices that are measured."""
        return {k for (k,) in self._db.execute("SELECT plan_index FROM visits WHERE plan_index IS NOT NULL")}

    def log(self, time: str, kind: str, text: str, data: Mapping[str, Any] | None = None) -> None:
        """Add an event: a prompt and its answer, a baseline reading, a fault, a start or a stop."""
        with self._writing():
            self._db.execute("INSERT INTO events VALUES (?, ?, ?, ?)", [time, kind, text, json.dumps(data or {})])

    def events(self) -> list[tuple[str, str, str, dict[str, Any]]]:
        """The event log in its order: (time in ISO 8601 UTC, kind, text, data)."""
        rows = self._db.execute("SELECT time, kind, text, data FROM events ORDER BY rowid")
        return [(t, k, x, self._said("an event", d)) for t, k, x, d in rows]

    def shots(self, visit: int) -> list[tuple[str, dict[str, Any]]]:
        """The raw shots of a visit, counted from 1, in their order: (target, or `wrench`, and what the device said)."""
        rows = self._db.execute("SELECT target, data FROM shots WHERE visit = ? ORDER BY rowid", [visit])
        return [(t, self._said(f"a shot of visit {visit}", d)) for t, d in rows]

    def _said(self, what: str, text: str) -> dict[str, Any]:
        """Raises RecordingError where the file is damaged."""
        try:
            said = json.loads(text)
        except (TypeError, ValueError):
            said = None
        if not isinstance(said, dict):
            raise RecordingError(f"{self.path}: damaged: {what} says {text!r:.40}, expected an object of JSON")
        return said


def _create(path: Path, columns: Sequence[str], meta: Mapping[str, str], rows: Iterable[Sequence[str]]) -> None:
    """Closed when done: SQLite names its journal after the file, so that an open one must not be moved."""
    path.unlink(missing_ok=True)  # of a process before, killed, that had our number
    with closing(sqlite3.connect(path, isolation_level=None)) as db, _transaction(db):
        for statement in _SCHEMA.split(";"):
            db.execute(statement)
        cells = ", ".join(f"{name} TEXT NOT NULL" for name in _sql_names(columns))
        db.execute(f"CREATE TABLE visits (visit INTEGER PRIMARY KEY, plan_index INTEGER UNIQUE, {cells})")
        everything = {"format": FORMAT, "columns": json.dumps(list(columns)), **meta}
        db.executemany("INSERT INTO meta VALUES (?, ?)", list(everything.items()))
        names, marks = ", ".join(_sql_names(columns)), ", ".join("?" * len(columns))
        db.executemany(f"INSERT INTO visits ({names}) VALUES ({marks})", rows)


class _transaction:
    """BEGIN IMMEDIATE … COMMIT, or ROLLBACK when anything goes wrong inside or with COMMIT itself. SQLite takes back by
    itself what a full disk has cut short, and has nothing to roll back then. A Ctrl-C that comes between BEGIN and what
    it is for leaves it open: the next one takes it back."""

    def __init__(self, db: sqlite3.Connection) -> None:
        self._db = db

    def __enter__(self) -> None:
        if self._db.in_transaction:
            self._db.execute("ROLLBACK")
        self._db.execute("BEGIN IMMEDIATE")

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        try:
            if kind is None:
                self._db.execute("COMMIT")
        finally:
            if self._db.in_transaction:
                self._db.execute("ROLLBACK")


def _sql_names(columns: Sequence[str]) -> list[str]:
    """The columns' names in SQL: quoted, and numbered where SQLite, deaf to capitals, would take two for one."""
    taken = {"visit", "plan_index"}
    out = []
    for k, column in enumerate(columns):
        name = column
        while name.lower() in taken:
            name += f"#{k}"
        taken.add(name.lower())
        out.append(_quoted(name))
    return out


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'
