"""What a campaign measured: visits as arrays. The one language that the bench and the model side both speak.

A recording is a SQLite file while the campaign runs and a CSV for interchange; both hold the same table of texts, one
row per visit, so that import and export lose nothing. `load_recording` reads either and checks every value.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
import re
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from difflib import get_close_matches
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from ppshw.errors import RecordingError
from ppshw.machine import WRENCH_COMPONENTS, Machine
from ppshw.quantities import number
from ppshw.recording_file import RecordingFile, is_sqlite

Array = NDArray[np.float64]
# A setpoint may stand this far outside its limit before it counts: the text of a file has few decimals.
LIMIT_ROUNDING = 1e-6
STANDSTILL = 1e-5  # of a joint's travel: what is less is the encoder's noise
# No instrument says more than this in any of its units; beyond, it is a damaged cell whose square would overflow.
LARGEST = 1e9
LARGEST_WRENCH = 1e6  # a hundred tonnes on the sensor
COLDEST, WARMEST = -80.0, 300.0  # °C; beyond, a thermometer that is not there
SAID = 12  # visits by their numbers
AT_ONCE = 10  # visits that may be of one moment
LOAD_AGE = "load_age_s"
NEARLY_CALLED = 0.85  # of the letters of two columns' names
# A thermometer does not leap by so much, nor by so many times what it mostly changes from visit to visit, and is back
# after a visit or two; if it says so at more than this share of visits, the air did. Ours.
SPIKE_C, SPIKE, SPIKES, FEWEST_READ = 5.0, 20.0, 0.02, 10


@dataclass(frozen=True)
class Table:
    """The recording as text: header, rows, where each row stood (for messages); the machine's name where it is said,
    and how lines ended in the CSV that it came from."""

    source: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    machine_name: str = ""
    newline: str = "\n"

    def csv_text(self, newline: str = "\n") -> str:
        """The canonical CSV: commas, line feeds, quotes only where a cell needs them."""
        return "".join(",".join(map(_quoted, row)) + newline for row in (self.header, *self.rows))


@dataclass(frozen=True)
class Around:
    """What surrounds the machine when a setpoint is computed.

    time [s] since 1970, nan: unknown;  load: label of what lies on it;  temperatures: place → °C;  put_on [s] since
    1970: when that load was put on, nan: unknown;  lay_before (6,) [N, N·m]: what the sensor read before that
    """

    time: float = math.nan
    load: str = ""
    temperatures: Mapping[str, float] = field(default_factory=dict)
    put_on: float = math.nan
    lay_before: Array | None = None


@dataclass(frozen=True)
class Recording:
    """N visits of a machine of n joints with T targets.

    time         (N,)      seconds since 1970 UTC, nan where unknown
    step, load   (N,)      labels
    q, q_cmd     (N, n)    encoder positions and commanded setpoints            [m, rad]
    approach     (N, n)    −1, 0, 1: direction of each joint's last motion; without columns by the order of the visits
    settle_s     (N,)      time between end of motion and measurement, nan where unknown
    wrench       (N, 6)    payload on the sensor, sensor frame; 0 without columns   [N, N·m]
    points       (N, T, 3) measured targets in the measuring frame, nan where lost and in copies  [m]
    extra_points name → (N, 3) measured reflectors at points of interest (tip.points)   [m]
    temperatures place → (N,)  [°C], in empty cells between the others, nan where all are;  covariates name → (N,)
    spikes       place → visits at which its thermometer read what nothing there can have had, taken for empty cells
    silent       place → visits at which its thermometer said nothing, where it did at others
    sha256       of the canonical CSV text, the same for both forms
    copies       visits that read the same as an earlier one to the last digit, joints and targets and load: no
                 instrument repeats itself so, and a row that stands there twice is one reading
    load_age_s   (N,)      for how long its load had lain there at a visit, nan where unknown; None without the column
    misspelt     column that nothing reads → the one that it is nearly called, which is not there
    """

    joint_names: tuple[str, ...]
    target_names: tuple[str, ...]
    time: Array
    step: tuple[str, ...]
    load: tuple[str, ...]
    q: Array
    q_cmd: Array
    approach: NDArray[np.int64]
    settle_s: Array
    wrench: Array
    points: Array
    extra_points: dict[str, Array]
    temperatures: dict[str, Array]
    covariates: dict[str, Array]
    has_wrench: bool
    source: str
    sha256: str
    copies: tuple[int, ...] = ()
    spikes: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    silent: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    misspelt: Mapping[str, str] = field(default_factory=dict)
    load_age_s: Array | None = None

    def __len__(self) -> int:
        return len(self.q)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(N, T) whether a target was measured."""
        return np.asarray(np.isfinite(self.points).all(axis=2))

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(N,) whether a visit saw any target."""
        return np.asarray(self.seen.any(axis=1))

    def unread(self) -> list[str]:
        """A line for each column that nothing reads and that is nearly called like one that is not there."""
        return [
            f"column {name} is read by nothing: is it {meant}, which is not there?"
            for name, meant in self.misspelt.items()
        ]

    def subset(self, which: NDArray[np.int64] | NDArray[np.bool_]) -> Recording:
        """The visits that `which` (a mask or indices) selects."""
        rows = np.arange(len(self))[which]
        return replace(
            self,
            time=self.time[rows],
            step=tuple(self.step[k] for k in rows),
            load=tuple(self.load[k] for k in rows),
            q=self.q[rows],
            q_cmd=self.q_cmd[rows],
            approach=self.approach[rows],
            settle_s=self.settle_s[rows],
            wrench=self.wrench[rows],
            points=self.points[rows],
            extra_points={k: v[rows] for k, v in self.extra_points.items()},
            temperatures={k: v[rows] for k, v in self.temperatures.items()},
            covariates={k: v[rows] for k, v in self.covariates.items()},
            copies=tuple(np.flatnonzero(np.isin(rows, self.copies)).tolist()),
            spikes=_among(rows, self.spikes),
            silent=_among(rows, self.silent),
            load_age_s=None if self.load_age_s is None else self.load_age_s[rows],
        )

    def followed_by(self, then: Recording) -> Recording:
        """These visits and then those of another recording of the same machine; what only one of them has is nan in the
        other. What is said of the whole, its source for one, is this one's."""
        first, count = self, len(self)

        def both(a: Mapping[str, Array], b: Mapping[str, Array], *per_visit: int) -> dict[str, Array]:
            nan = [np.full((len(r), *per_visit), math.nan) for r in (first, then)]
            return {k: np.concatenate([a.get(k, nan[0]), b.get(k, nan[1])]) for k in {**a, **b}}

        ages = [np.full(len(r), math.nan) if r.load_age_s is None else r.load_age_s for r in (first, then)]
        return replace(
            first,
            time=np.concatenate([first.time, then.time]),
            step=first.step + then.step,
            load=first.load + then.load,
            q=np.concatenate([first.q, then.q]),
            q_cmd=np.concatenate([first.q_cmd, then.q_cmd]),
            approach=np.concatenate([first.approach, then.approach]),
            settle_s=np.concatenate([first.settle_s, then.settle_s]),
            wrench=np.concatenate([first.wrench, then.wrench]),
            points=np.concatenate([first.points, then.points]),
            extra_points=both(first.extra_points, then.extra_points, 3),
            temperatures=both(first.temperatures, then.temperatures),
            covariates=both(first.covariates, then.covariates),
            copies=first.copies + tuple(count + k for k in then.copies),
            spikes=_and_later(first.spikes, then.spikes, count),
            silent=_and_later(first.silent, then.silent, count),
            load_age_s=None if first.load_age_s is None and then.load_age_s is None else np.concatenate(ages),
        )


def _among(rows: NDArray[np.int64], visits: Mapping[str, tuple[int, ...]]) -> dict[str, tuple[int, ...]]:
    """Where visits that something is said of are among these rows."""
    return {k: tuple(np.flatnonzero(np.isin(rows, v)).tolist()) for k, v in visits.items()}


def _and_later(
    first: Mapping[str, tuple[int, ...]], then: Mapping[str, tuple[int, ...]], count: int
) -> dict[str, tuple[int, ...]]:
    """Visits that something is said of, of `count` visits and of those that follow."""
    return {k: first.get(k, ()) + tuple(count + at for at in then.get(k, ())) for k in {**first, **then}}


def columns_for(
    machine: Machine, places: Sequence[str] = (), extra_points: Sequence[str] = (), covariates: Sequence[str] = ()
) -> list[str]:
    """The contract's columns, in its order, for a recording of this machine."""
    joints = machine.joint_names
    out = ["time", "step", "load"]
    out += [f"q_cmd_{j}" for j in joints] + [f"q_{j}" for j in joints] + [f"approach_{j}" for j in joints]
    out += ["settle_s", *WRENCH_COMPONENTS]
    out += [f"{t}_{axis}" for t in (*machine.targets, *extra_points) for axis in "xyz"]
    out += [f"temp_{p}_C" for p in places] + [f"cov_{c}" for c in covariates]
    return out


def _quoted(cell: str) -> str:
    # csv.writer leaves a lone carriage return bare, which csv.reader then takes for the end of the row
    return '"' + cell.replace('"', '""') + '"' if any(c in cell for c in '",\r\n') else cell


def read_table(path: Path | str) -> Table:
    """The texts of a recording, either form. Raises RecordingError on a missing, empty or broken file."""
    path = Path(path)
    if not path.is_file():
        raise RecordingError(f"{path}: {'a folder, expected a recording' if path.is_dir() else 'no such recording'}")
    if path.stat().st_size == 0:
        raise RecordingError(f"{path}: the file is empty")
    if is_sqlite(path):
        with RecordingFile.open(path, readonly=True) as file:
            header, rows = file.table()
            meta = file.meta()
        if not rows:
            raise RecordingError(f"{path}: the recording holds no visit yet")
        newline = "\r\n" if meta.get("csv_newline") == "CRLF" else "\n"
        return Table(str(path), header, rows, tuple(range(1, len(rows) + 1)), meta.get("machine_name", ""), newline)
    return _read_csv(path)


def load_recording(path: Path | str, machine: Machine, lost_at_all: bool = False) -> Recording:
    """Read and check a recording. Raises RecordingError naming file, line and column.

    lost_at_all  the beam may have been lost at every visit: for what the machine did, whatever was seen of it
    """
    table = read_table(path)
    check_machine(table, machine)
    return parse_table(table, machine, lost_at_all)


def check_machine(table: Table, machine: Machine) -> None:
    """Raise where the recording says that it is of another machine. The machine's file may well have changed since."""
    if table.machine_name not in ("", machine.name):
        raise RecordingError(f"{table.source}: measured on machine '{table.machine_name}', not on '{machine.name}'")


def parse_table(table: Table, machine: Machine, lost_at_all: bool = False) -> Recording:
    """Check every value of a table against the machine. Raises RecordingError; see `load_recording`."""
    cells = _Cells(table)
    q, q_cmd = _positions(cells, machine)
    points, extra_points = _points(cells, machine, lost_at_all)
    wrench, has_wrench = _wrench(cells)
    copies = _copies(np.concatenate([q, q_cmd, wrench, points.reshape(len(q), -1)], axis=1), points)
    for each in (points, *extra_points.values()):
        each[copies] = math.nan
    temperatures, spikes, silent = _temperatures(cells)
    unknown = np.full(len(cells), math.nan)
    return Recording(
        joint_names=machine.joint_names,
        target_names=tuple(machine.targets),
        time=_times(cells),
        step=cells.texts("step"),
        load=cells.texts("load"),
        q=q,
        q_cmd=q_cmd,
        approach=_approach(cells, machine, q_cmd),
        settle_s=cells.duration("settle_s") if "settle_s" in cells else unknown,
        wrench=wrench,
        points=points,
        extra_points=extra_points,
        temperatures=temperatures,
        covariates={n[4:]: cells.numbers(n, fallback=unknown) for n in cells.names if n.startswith("cov_")},
        has_wrench=has_wrench,
        source=table.source,
        sha256=hashlib.sha256(table.csv_text().encode()).hexdigest(),
        copies=tuple(copies.tolist()),
        spikes=spikes,
        silent=silent,
        misspelt=_misspelt(cells.names, machine),
        load_age_s=cells.duration(LOAD_AGE) if LOAD_AGE in cells else None,
    )


def _positions(cells: _Cells, machine: Machine) -> tuple[Array, Array]:
    """Where the joints were and where they were sent, (N, n) each: either stands for the other where it is missing."""
    joints = machine.joint_names
    for j in joints:
        if f"q_{j}" not in cells and f"q_cmd_{j}" not in cells:
            raise RecordingError(
                f"{cells.source}: no column q_{j} or q_cmd_{j}; is this a recording of machine '{machine.name}'?"
            )
    for prefix in ("q_", "q_cmd_"):
        _check_spelling(cells, machine, prefix)
    q_cmd = np.column_stack([cells.numbers(f"q_cmd_{j}" if f"q_cmd_{j}" in cells else f"q_{j}") for j in joints])
    q = np.column_stack([
        cells.numbers(f"q_{j}", fallback=q_cmd[:, k]) if f"q_{j}" in cells else q_cmd[:, k]
        for k, j in enumerate(joints)
    ])  # fmt: skip
    _check_limits(cells, machine, q_cmd)
    return q, q_cmd


def _points(cells: _Cells, machine: Machine, lost_at_all: bool) -> tuple[Array, dict[str, Array]]:
    """Readings of the machine's targets (N, T, 3), and of its other points (N, 3) each, nan where the beam was lost."""
    points = np.stack([cells.point(t) for t in machine.targets], axis=1)
    if not any(f"{t}_x" in cells for t in machine.targets):
        first = next(iter(machine.targets))
        raise RecordingError(f"{cells.source}: no column for any target of the machine, expected e.g. {first}_x")
    extra_points = {p: cells.point(p) for p in machine.points if any(f"{p}_{axis}" in cells for axis in "xyz")}
    if not lost_at_all and not any(np.isfinite(p).any() for p in (points, *extra_points.values())):
        names = ", ".join(machine.targets)
        raise RecordingError(f"{cells.source}: not one target was measured: every cell of {names} is empty")
    return points, extra_points


def _times(cells: _Cells) -> Array:
    """(N,) seconds since 1970; nan where nobody knows them: a day alone, the same at many visits, orders nothing (a
    zero's jump was structure over its joint's position)."""
    unknown = np.full(len(cells), math.nan)
    if "time" not in cells or not any(cells.raw("time")):
        return unknown
    times = cells.times("time")
    return unknown if len(times) > AT_ONCE and np.ptp(times) == 0.0 else times


def _wrench(cells: _Cells) -> tuple[Array, bool]:
    """What the force sensor read (N, 6), 0 without one: a bench that has none leaves all cells of the columns empty."""
    if not any(any(cells.raw(c)) for c in WRENCH_COMPONENTS if c in cells):
        return np.zeros((len(cells), 6)), False
    wrench = np.column_stack([
        cells.numbers(c, largest=LARGEST_WRENCH, unit=" N" if k < 3 else " N m")
        for k, c in enumerate(WRENCH_COMPONENTS)
    ])  # fmt: skip
    return wrench, True


def _approach(cells: _Cells, machine: Machine, q_cmd: Array) -> NDArray[np.int64]:
    """(N, n) the sides that joints came from: as written down, or where a column says nothing by the moves."""
    approach = directions(q_cmd)
    for k, j in enumerate(machine.joint_names):
        if f"approach_{j}" in cells and (said := cells.approach(f"approach_{j}")).any():  # all 0: nobody wrote it down
            approach[:, k] = said
    return approach


def _temperatures(cells: _Cells) -> tuple[dict[str, Array], dict[str, tuple[int, ...]], dict[str, tuple[int, ...]]]:
    """Temperatures (N,) of every place without broken cells and gaps, the visits at which cells were broken, and those
    at which they were empty, where not all are."""
    read = {n[5:-2]: cells.temperature(n) for n in cells.names if n.startswith("temp_") and n.endswith("_C")}
    spikes = {place: told for place, values in read.items() if len(told := _spikes(values))}
    silent = {
        place: at for place, values in read.items() if 0 < len(at := np.flatnonzero(np.isnan(values))) < len(values)
    }
    for place, visits in spikes.items():
        read[place][visits] = math.nan
    without = {place: _between(values) for place, values in read.items()}
    broken, empty = ({place: tuple(visits.tolist()) for place, visits in each.items()} for each in (spikes, silent))
    return without, broken, empty


def _spikes(values: Array) -> NDArray[np.int64]:
    """Visits at which a thermometer reads far from the middle one of five in a row that said anything, where these are
    few: a broken cell. What leaps again and again, as where visits are not in the order of time, is left."""
    told = np.flatnonzero(np.isfinite(values))
    if len(told) < FEWEST_READ:
        return told[:0]
    read = values[told]
    around = np.lib.stride_tricks.sliding_window_view(np.pad(read, 2, mode="reflect"), 5)
    off = np.abs(read - np.median(around, axis=1))
    far = off > max(SPIKE_C, SPIKE * float(np.median(np.abs(np.diff(read)))))
    return told[far] if far.mean() <= SPIKES else told[:0]


def _between(values: Array) -> Array:
    """Empty cells of a thermometer that says nothing now and then: between what it says before and after."""
    told = np.flatnonzero(np.isfinite(values))
    return np.asarray(np.interp(np.arange(len(values)), told, values[told])) if len(told) else values


def _copies(rows: Array, points: Array) -> NDArray[np.int64]:
    """Which rows are an earlier one once more, of those with a reading in `points`."""
    first = np.unique(np.where(np.isnan(rows), np.inf, rows), axis=0, return_index=True)[1]
    again = np.ones(len(rows), dtype=bool)
    again[first] = False
    return np.flatnonzero(again & np.asarray(np.isfinite(points).all(axis=2)).any(axis=1))


def listed(visits: Iterable[int]) -> str:
    """Numbers of visits, of indices: the first is visit 1; the first dozen of many."""
    numbers = [str(v + 1) for v in visits]
    return ", ".join(numbers[:SAID]) + (" …" if len(numbers) > SAID else "")


def directions(q: Array) -> NDArray[np.int64]:
    """(N, n) of each joint's last motion, −1, 0, 1, where moves go straight from visit to visit; 0 until it moves."""
    steps = np.diff(q, axis=0, prepend=q[:1])
    signs = np.where(np.abs(steps) > STANDSTILL * np.ptp(q, axis=0), np.sign(steps), 0.0)
    moved = np.where(signs != 0, np.arange(len(q))[:, None], 0)
    return np.take_along_axis(signs, np.maximum.accumulate(moved, axis=0), axis=0).astype(np.int64)


def _check_spelling(cells: _Cells, machine: Machine, prefix: str) -> None:
    """A misspelt position would silently be taken from the setpoint, and the other way round."""
    missing = [f"{prefix}{j}" for j in machine.joint_names if f"{prefix}{j}" not in cells]
    known = {f"{p}{j}" for p in ("q_", "q_cmd_") for j in machine.joint_names}
    strange = [name for name in cells.names if name.startswith("q_") and name not in known]
    if prefix == "q_" or len(missing) == machine.n:  # no setpoints at all are nobody's slip
        strange = [name for name in strange if name.startswith("q_cmd_") == (prefix == "q_cmd_")]
    if missing and strange:
        raise RecordingError(
            f"{cells.source}: column {strange[0]} is of no joint of machine '{machine.name}', expected {missing[0]}"
        )


def _misspelt(names: Sequence[str], machine: Machine) -> dict[str, str]:
    """Columns that nobody reads and that are nearly called like one that is not there, with a unit behind it perhaps,
    or begin as thermometers do: they are optional, so that what they say would be left out in silence."""
    known = [*columns_for(machine, extra_points=tuple(machine.points)), LOAD_AGE]
    absent = {name.casefold(): name for name in known if name not in names}
    out = {}
    for name in names:
        if name in known or name.startswith("cov_") or (name.startswith("temp_") and name.endswith("_C")):
            continue
        plain = _IN_BRACKETS.sub("", name).strip().casefold().replace(" ", "_")
        exact = [each for each in (plain, _A_UNIT.sub("", plain)) if each in absent]
        if near := exact or get_close_matches(plain, absent, n=1, cutoff=NEARLY_CALLED):
            out[name] = absent[near[0]]
        elif name.casefold().startswith("temp"):
            out[name] = "temp_<place>_C"
    return out


_IN_BRACKETS = re.compile(r"[\s_]*[\[({][^\])}]*[\])}]\s*$")  # Fx [N]
_A_UNIT = re.compile(r"_(?:[mµu]?m|k?n|n_?m{1,2}|m?rad|deg|m?s|c)$")  # P1_x_mm


def _check_limits(cells: _Cells, machine: Machine, q_cmd: Array) -> None:
    """Of what was commanded only: where an encoder's word stands for it, the axis was there already."""
    lower, upper = machine.limits()
    names = [f"q_cmd_{j}" for j in machine.joint_names]
    outside = (q_cmd < lower - LIMIT_ROUNDING) | (q_cmd > upper + LIMIT_ROUNDING)
    for row, k in np.argwhere(outside & [name in cells for name in names])[:1]:
        value = f"{q_cmd[row, k]:g}"
        cells.fail(int(row), names[k], f"setpoint {value} is outside the limits {lower[k]:g} … {upper[k]:g}")


class _Cells:
    """Column access with checks; every complaint names file, line and column."""

    def __init__(self, table: Table) -> None:
        self._table = table
        # an accent may be a letter's own or stand behind it, as macOS writes it: the same name
        self.names = [unicodedata.normalize("NFC", name.strip()) for name in table.header]
        self._index = {name: k for k, name in enumerate(self.names)}

    def __contains__(self, name: str) -> bool:
        return name in self._index

    def __len__(self) -> int:
        return len(self._table.rows)

    @property
    def source(self) -> str:
        return self._table.source

    def fail(self, row: int, column: str, message: str) -> NoReturn:
        table = self._table
        raise RecordingError(f"{table.source}:{table.lines[row]}: column {column}: {message}")

    def raw(self, name: str) -> list[str]:
        if name not in self._index:
            raise RecordingError(f"{self._table.source}: column {name} is missing")
        k = self._index[name]
        return [row[k].strip() for row in self._table.rows]

    def numbers(self, name: str, fallback: Array | None = None, largest: float = LARGEST, unit: str = "") -> Array:
        """Finite numbers; an empty cell takes `fallback` where that is given, else is an error."""
        out = np.empty(len(self._table.rows))
        for row, text in enumerate(self.raw(name)):
            if not text and fallback is not None:
                out[row] = fallback[row]
                continue
            out[row] = self._convert(row, name, text, number, "a number")
            if not abs(out[row]) <= largest:
                may_be_empty = "" if fallback is None else ", or an empty cell where there is none"
                self.fail(row, name, f"'{text}' is no finite number below {largest:g}{unit}{may_be_empty}")
        return out

    def duration(self, name: str) -> Array:
        """[s], nan where a cell is empty."""
        out = self.numbers(name, fallback=np.full(len(self), math.nan))
        for row in np.flatnonzero(out < 0.0)[:1]:
            self.fail(int(row), name, f"{out[row]:g} s, expected a time of 0 or more")
        return out

    def temperature(self, name: str) -> Array:
        """[°C], nan where a cell is empty."""
        out = self.numbers(name, fallback=np.full(len(self._table.rows), math.nan))
        for row in np.flatnonzero((out < COLDEST) | (out > WARMEST))[:1]:
            expected = f"{COLDEST:g} … {WARMEST:g} °C, or an empty cell where nothing was read"
            self.fail(int(row), name, f"{out[row]:g} is no temperature, expected {expected}")
        return out

    def point(self, name: str) -> Array:
        """(N, 3), nan where the three cells are empty or the columns are absent."""
        columns = [f"{name}_{axis}" for axis in "xyz"]
        present = [c in self for c in columns]
        if not any(present):
            return np.full((len(self._table.rows), 3), math.nan)
        nothing = np.full(len(self._table.rows), math.nan)
        out = np.column_stack([self.numbers(c, fallback=nothing) for c in columns])
        missing = np.isnan(out)
        for row in np.flatnonzero(missing.any(axis=1) & ~missing.all(axis=1))[:1]:
            column = columns[int(np.argmax(missing[row]))]
            self.fail(int(row), column, f"empty while other coordinates of {name} are given")
        return out

    def approach(self, name: str) -> NDArray[np.int64]:
        values = self.numbers(name, fallback=np.zeros(len(self._table.rows)))
        for row in np.flatnonzero(~np.isin(values, (-1.0, 0.0, 1.0)))[:1]:
            self.fail(int(row), name, f"{values[row]:g}, expected -1, 0 or 1")
        return values.astype(np.int64)

    def texts(self, name: str) -> tuple[str, ...]:
        return tuple(self.raw(name)) if name in self else ("",) * len(self._table.rows)

    def times(self, name: str) -> Array:
        out = np.empty(len(self._table.rows))
        for row, text in enumerate(self.raw(name)):
            out[row] = self._convert(row, name, text, _seconds, "an ISO 8601 time")
            if row and out[row] < out[row - 1]:
                self.fail(row, name, f"{text} is {out[row - 1] - out[row]:g} s before the visit above it")
        return out

    def _convert(self, row: int, name: str, text: str, convert: Callable[[str], float], wanted: str) -> float:
        try:
            return convert(text)
        except (ValueError, OverflowError):
            shown = text if len(text) <= 40 else text[:37] + "..."
            self.fail(row, name, f"{shown!r} is not {wanted}" if text else f"empty, expected {wanted}")


def _seconds(text: str) -> float:
    stamp = datetime.fromisoformat(text)
    return (stamp if stamp.tzinfo else stamp.replace(tzinfo=UTC)).timestamp()


def _no_header(text: str) -> str:
    """Why the first line of a table is no header as it should be; empty where it may be one."""
    first = next(iter(text.splitlines()), "").strip()
    if not first:
        return "an empty line, expected the names of the columns"
    if first.startswith("sep="):  # which some spreadsheets take as their own
        return f"{first!r}, expected the names of the columns"
    if "," not in first and (separator := next((c for c in ";\t|" if c in first), "")):
        return f"columns are separated by {separator!r}, expected ',' (and decimal points)"
    return ""


def _read_csv(path: Path) -> Table:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            text = file.read()
    except UnicodeDecodeError as exc:
        raise RecordingError(f"{path}: neither a SQLite recording nor UTF-8 text ({exc.reason})") from None
    if (nul := text.find("\0")) >= 0:
        line = text.count("\n", 0, nul) + 1
        raise RecordingError(f"{path}:{line}: a zero byte, expected text; is the file damaged?")
    if wrong := _no_header(text):
        raise RecordingError(f"{path}:1: {wrong}")
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    rows: list[tuple[str, ...]] = []
    lines: list[int] = []
    try:
        header = tuple(next(reader, ()))
        for row in reader:
            if len(row) <= 1 and not "".join(row).strip():  # a blank line, spaces or none
                continue
            if not any(cell.strip() for cell in row):
                raise RecordingError(f"{path}:{reader.line_num}: an empty row, commas only, no visit")
            if len(row) != len(header):
                why = "is the file cut off?" if len(row) < len(header) else "are its decimals commas?"
                raise RecordingError(f"{path}:{reader.line_num}: {len(row)} cells, the header has {len(header)}; {why}")
            rows.append(tuple(row))
            lines.append(reader.line_num)
    except csv.Error as exc:
        raise RecordingError(f"{path}:{reader.line_num}: not valid CSV ({exc})") from None
    for k, name in enumerate(names := [column.strip() for column in header]):
        if not name and k == 0:  # row numbers, as programs for tables write them
            continue
        if not name or name in names[:k]:
            raise RecordingError(f"{path}:1: column {k + 1} is {'twice here: ' + name if name else 'without a name'}")
    if not rows:
        raise RecordingError(f"{path}: a header but no visit")
    newline = "\r\n" if text.partition("\n")[0].endswith("\r") else "\n"
    return Table(str(path), header, tuple(rows), tuple(lines), newline=newline)
