"""What the converters share: a published text table read strictly, and the contract's CSV written whole or not at all.

Numbers stay decimal from text to text, so that a change of unit by a power of ten loses nothing.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

from ppshw.errors import RecordingError
from ppshw.whole_file import write_text


@dataclass(frozen=True)
class SourceTable:
    """A published table: header, rows of text, and the line each row stood on. `comma`: decimals are written 1,5."""

    source: Path
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    comma: bool

    def __len__(self) -> int:
        return len(self.rows)

    def texts(self, column: str) -> list[str]:
        k = self.header.index(column)
        return [row[k] for row in self.rows]

    def numbers(self, column: str, power: int = 0) -> list[Decimal]:
        """The column's finite numbers times 10**power. Raises RecordingError with file, line and column."""
        return [
            self._number(text, line, column).scaleb(power)
            for text, line in zip(self.texts(column), self.lines, strict=True)
        ]

    def _number(self, text: str, line: int, column: str) -> Decimal:
        try:
            value = Decimal(text.replace(",", ".") if self.comma else text)
        except InvalidOperation:
            value = Decimal("nan")
        if not value.is_finite():
            raise RecordingError(f"{self.source}:{line}: column {column}: {text!r} is not a number")
        return value


def read_table(source: Path, delimiter: str, wanted: Sequence[str], comma: bool = False) -> SourceTable:
    """A table whose header is exactly `wanted`; a column more would be dropped in silence, so that is an error too."""
    reader = csv.reader(io.StringIO(read_text(source), newline=""), delimiter=delimiter, strict=True)
    rows: list[tuple[str, ...]] = []
    lines: list[int] = []
    try:
        header = tuple(name.strip() for name in next(reader, []))
        for column in (*wanted, *header):
            if column not in header or column not in wanted:
                what = "is missing" if column in wanted else "is unknown"
                raise RecordingError(f"{source}:1: column {column!r} {what}; is this the published file?")
        for row in reader:
            if len(row) != len(header):
                raise RecordingError(
                    f"{source}:{reader.line_num}: {len(row)} cells, the header has {len(header)}; is the file cut off?"
                )
            rows.append(tuple(cell.strip() for cell in row))
            lines.append(reader.line_num)
    except csv.Error as exc:
        raise RecordingError(f"{source}:{reader.line_num}: not valid CSV ({exc})") from None
    if not rows:
        raise RecordingError(f"{source}: a header but no visit")
    return SourceTable(source, header, tuple(rows), tuple(lines), comma)


def read_text(source: Path) -> str:
    try:
        return source.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as exc:
        raise RecordingError(f"{source}: not UTF-8 text ({exc.reason})") from None
    except OSError as exc:
        raise RecordingError(f"{source}: {exc.strerror or exc}") from None


def write_csv(out_csv: Path, columns: Mapping[str, Sequence[str]]) -> int:
    """Write one row per visit; returns their number. Replaces the file in one step, so it is never half there."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    rows = list(zip(*columns.values(), strict=True))
    writer.writerows(rows)
    write_text(out_csv, text.getvalue(), RecordingError)
    return len(rows)


def plain(values: Sequence[Decimal]) -> list[str]:
    """Decimals as text without exponents."""
    return [format(value, "f") for value in values]


def shortest(values: Sequence[float]) -> list[str]:
    """Floats as the shortest text that reads back as the same number."""
    return [repr(float(value)) for value in values]
