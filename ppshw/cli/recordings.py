"""Recordings and the interchange CSV: import, export."""

from __future__ import annotations

import argparse
from pathlib import Path

from ppshw import __version__
from ppshw.cli.answers import READ_PER_S, new_file, new_recording, say, warn
from ppshw.cli.arguments import machine_of
from ppshw.errors import BadInput
from ppshw.progress import Bar
from ppshw.quantities import many
from ppshw.whole_file import written_whole


def import_(a: argparse.Namespace) -> None:
    """import: CSV → SQLite, nothing written unless every value is good."""
    from ppshw.recording import check_machine, parse_table, read_table
    from ppshw.recording_file import RecordingFile

    machine = machine_of(a)
    out = new_recording(a.out, a.csv, machine.file)
    if out.exists():
        raise BadInput(f"{out}: exists already, expected a new file")
    with Bar() as bar, bar.expect("import", Path(a.csv).stat().st_size / READ_PER_S if Path(a.csv).is_file() else 0.0):
        table = read_table(a.csv)
        check_machine(table, machine)
        recording = parse_table(table, machine)
    meta = {
        "machine": Path(machine.file).read_text(encoding="utf-8"),
        "machine_name": machine.name,
        "machine_sha256": machine.sha256,
        "imported_from": Path(a.csv).name,
        "csv_newline": "CRLF" if table.newline == "\r\n" else "LF",
        "ppshw": __version__,
    }
    RecordingFile.create(out, table.header, meta, table.rows).close()
    warn(a.csv, recording.unread())
    readings = int(recording.seen.sum())
    answer = {"visits": len(recording), "readings": readings, "sha256": recording.sha256, "out": a.out}
    say(a, answer, f"{a.out}: {many(len(recording), 'visit')}, {many(readings, 'reading')}")


def export(a: argparse.Namespace) -> None:
    """export: SQLite → CSV, the same cells in the same order."""
    from ppshw.recording import read_table

    out = new_file("csv", a.csv, a.rec)
    table = read_table(a.rec)
    with written_whole(out) as partial:
        partial.write_text(table.csv_text(table.newline), encoding="utf-8", newline="")
    say(a, {"visits": len(table.rows), "out": a.csv}, f"{a.csv}: {many(len(table.rows), 'visit')}")
