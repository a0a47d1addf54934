"""The force sensor weighed against gravity: what it reads beside what rigid payloads weigh, and which error of it that
is. It is known from the readings alone, whether or not the machine is soft enough to show it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from ppshw.diagnosis.library.candidate import Candidate
from ppshw.diagnosis.library.sampled import temperature_places
from ppshw.recording import Recording
from ppshw.statics import sensor_axes
from ppshw.terms.history import beside_payloads, payloads, weighs
from ppshw.terms.shapes import Column, Context, named_column
from ppshw.terms.shapes.sensor import misread
from ppshw.terms.shapes.wrenches import (
    beside_the_payload,
    chain_as_read,
    gravity_at_sensor,
    payloads_of,
    weighed_often,
)

Array = NDArray[np.float64]
# Beside rigid payloads sensors read 0.1 to 1.4 N and 0.1 to 0.5 N m, as noise, in 180 recordings of three authors, and
# where they erred 0.6 to 49 N and 1.4 to 50 N m.
GOES_WITH = 0.5  # of the mean square of what a channel reads too much
OF_ALL = 0.003  # of the largest force or moment: a base that stands 3 mrad askew makes as much of gravity
# Of the same, for what a recording shows of the sensor by its readings alone: of 24 recordings of ten authors with such
# an error 22 read 0.014 and more, of 120 with nothing missing and 41 with other effects none more than 0.004.
MUCH = 0.01
FEWER = 8  # times as many visits as changes of the load, for a zero at each to be asked for
ALL_OF_IT = 0.1  # of the mean square that a form leaves of what it is all of
MOST_FORMS = 4
AGAIN = 4  # that what hangs there is weighed without what the sensor reads too much
LEAST_MORE = 10.0  # of log evidence, for one form more
HARDLY, OF_MANY, SURELY = 2e-5, 5e-5, 4.0  # m, rms at the reflectors; standard deviations of what the readings say
LEAST_FREE = 40  # visits more than what their readings may go with
NO_LESS = 1e-6  # of the largest force or moment, as noise
# Than what all that is read beside makes: a form that is all of it, per number of a few that the readings know.
LIKELIER, FEW = 10.0, 3
NEARLY = 1e-3  # of the log evidence, by which fewer numbers may say less: some sensors have hardly any noise
PART, VISITS = 64, 512  # columns and visits at a time
MANY = 6  # numbers of a form: a zero or a gain of every channel
OF_ANY_MATRIX = 5  # gains of the forces and of the moments, and where it sits: another payload reads so, too
SMALLEST = 1e-9  # of what a column makes that no payload takes


@dataclass(frozen=True)
class Misreading:
    """A form of the sensor's error with what the readings say of its columns: values (k,) and covariance (k, k)."""

    form: Candidate
    values: Array
    covariance: Array


@dataclass(frozen=True)
class Weighing:
    """wrong (6,) which channels read other than rigid payloads weigh, by how much, rms [N, N·m]; forms: the first one
    by what it says alone, others beside it; one_form: whether the first is all of it."""

    wrong: NDArray[np.bool_]
    by: Array
    forms: tuple[Misreading, ...]
    one_form: bool


def reads_other(c: Context) -> bool:
    """Whether most of what some channel reads beside rigid payloads is always there, or goes with how often the load
    was changed, with what it and the others read, with temperatures or slowly with time, as no noise does."""
    return c.recording.has_wrench and bool(_wrong(c)[0].any())


def surely_misread(c: Context) -> bool:
    """Whether some channel reads other than any payloads weigh, by much: be there another one under its label after
    each change of the load, and point gravity wherever the forces have it."""
    r = c.recording
    if not reads_other(c) or not c.machine.gravity.any():
        return False
    stays = named_column(c, "mounting").astype(int)
    loads = tuple(f"{label} {stay}" if label else "" for label, stay in zip(r.load, stays, strict=True))
    anew = replace(c, recording=replace(r, load=loads))
    for _ in range(AGAIN):
        anew = replace(anew, machine=replace(c.machine, gravity=_gravity_as_read(anew)))
    most = _largest(r)
    both = [is_wrong & (by > MUCH * most) for is_wrong, by, _ in map(_wrong, (c, anew))]
    return bool((both[0] & both[1]).any())


def may_be_pulled(c: Context) -> bool:
    """Whether all that is read beside payloads may be what else pulls at each load the same way in space, as a weight
    over a pulley does (of a fifty-fourth author's arms): no error of the sensor's."""
    beside, turned = beside_the_payload(c).copy(), _base_axes_at_sensor(c)
    levers = np.stack([np.cross(lever, way) for lever in np.eye(3) for way in turned], axis=2)  # (N, 3, 9)
    for label in set(c.recording.load):
        mine = np.array(c.recording.load) == label
        for part, ways in ((slice(0, 3), np.stack(turned, axis=2)), (slice(3, 6), levers)):
            columns, read = ways[mine].reshape(-1, ways.shape[2]), beside[mine, part].ravel()
            left = read - columns @ np.linalg.lstsq(columns, read, rcond=1e-6)[0]
            beside[mine, part] = left.reshape(-1, 3)
    is_wrong, by, _ = _wrong(c, beside)
    return not (is_wrong & (by > MUCH * _largest(c.recording))).any()


def _base_axes_at_sensor(c: Context) -> list[Array]:
    """Three (N, 3): the base's axes as the sensor has them."""
    return list(np.swapaxes(sensor_axes(c.machine, chain_as_read(c)), 0, 1))


def _largest(r: Recording) -> Array:
    """(6,) of every channel the largest force or moment that any read [N, N·m]."""
    return np.repeat(np.abs(r.wrench).reshape(len(r), 2, 3).max(axis=(0, 2)), 3)


def _gravity_as_read(c: Context) -> Array:
    """(3,) in the base, where what hangs there is pulled to by the forces; as strong as the machine file has it."""
    size, mass = float(np.linalg.norm(c.machine.gravity)), payloads_of(c)[:, 0] * weighed_often(c)
    pulls = (mass[:, None, None] * np.stack(_base_axes_at_sensor(c), axis=2)).reshape(-1, 3)
    found = np.linalg.lstsq(pulls, c.recording.wrench[:, :3].ravel(), rcond=1e-6)[0]
    strength = float(np.linalg.norm(found))
    return np.asarray(size * found / strength) if strength > 0.0 else c.machine.gravity


def as_weighed(c: Context, candidates: Sequence[Candidate]) -> list[Candidate]:
    """The candidates without those that the readings leave no room for. Where the sensor reads other than rigid
    payloads weigh, all that it reads so goes with what the form goes with that says most of it; and that form is the
    likelier one, if it is all of it."""
    impossible = {id(k) for k in ruled_out(c, candidates)}
    kept = [k for k in candidates if id(k) not in impossible]
    whole = [k for k in kept if k.columns[0].function == "weighed"]
    if whole and (weighing := weigh(c, kept)) is not None:
        first = weighing.forms[0].form
        for k in whole:
            k.covariate = first.covariate
        if weighing.one_form:
            numbers = len(first.columns)
            first.share = LIKELIER ** (numbers if numbers <= FEW else 1) * whole[0].share
    return kept


def weigh(c: Context, candidates: Sequence[Candidate]) -> Weighing | None:
    """Which of the sensor's errors among the candidates what it reads beside rigid payloads is; None where it reads
    what they weigh."""
    forms = [k for k in candidates if all(column.function == "sensor_error" for column in k.columns)]
    if not forms:
        return None
    wrong, by, noise = _wrong(c)
    if not wrong.any():
        return None
    beside = (beside_the_payload(c) / noise).ravel()
    columns, at = _each_once(forms)
    fields = _made(c, columns, payloads_of(c), noise)[1]
    used: list[int] = []
    chosen: list[Candidate] = []
    left_by_first = 1.0
    for _ in range(MOST_FORMS):
        others = fields[:, used]
        rest = beside - others @ np.linalg.lstsq(others, beside, rcond=None)[0] if used else beside
        free = fields - others @ np.linalg.lstsq(others, fields, rcond=None)[0] if used else fields
        gram, goes = free.T @ free, free.T @ rest
        more = np.array([_evidence(gram, goes, at[k], len(c.recording)) for k in range(len(forms))])
        more += np.log([k.share for k in forms])
        best = _fewest(more, at)
        if more[best] < LEAST_MORE:
            break
        used += at[best]
        chosen.append(forms[best])
        if len(chosen) == 1:
            left = rest - fields[:, used] @ np.linalg.lstsq(fields[:, used], rest, rcond=1e-9)[0]
            left_by_first = float((left**2).sum() - len(left)) / max(float((rest**2).sum() - len(left)), 1e-9)
            if left_by_first < ALL_OF_IT:
                break
    return Weighing(wrong, by, _fitted(c, chosen, noise), left_by_first < ALL_OF_IT) if chosen else None


def by_readings(c: Context, form: Candidate) -> Misreading | None:
    """A form of the sensor's error as its readings have it, where it is all that they show beside rigid payloads;
    deflections tell less of it, and what compliances the base model has. Of one column: what several make together may
    be another payload."""
    found = weigh(c, [form]) if len(form.columns) == 1 else None
    return found.forms[0] if found is not None and found.one_form else None


def _fewest(more: Array, at: Sequence[Sequence[int]]) -> int:
    """Which form says most, or nearly as much with fewest numbers."""
    enough = np.flatnonzero(more >= more.max() - NEARLY * abs(float(more.max())))
    return min(enough.tolist(), key=lambda k: (len(at[k]), -more[k]))


def ruled_out(c: Context, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Those of the sensor's errors that its readings leave hardly any room for: as large as they may be beside rigid
    payloads, they would move no reflector by HARDLY, or, with many numbers of which none shows, by OF_MANY. None where
    too little was weighed."""
    forms = [k for k in candidates if all(column.function == "sensor_error" for column in k.columns)]
    if not forms or not weighed_often(c).any():
        return []
    wrong, _, noise = _wrong(c)
    if not noise.any():
        return []
    columns, at = _each_once(forms)
    gram, says, moves = _squares(c, columns, noise)
    of_many = HARDLY if wrong.any() else OF_MANY
    return [
        form for form, mine in zip(forms, at, strict=True)
        if _most(gram, says, moves, mine) < (of_many if len(mine) > MANY else HARDLY)
    ]  # fmt: skip


def _squares(c: Context, columns: Sequence[Column], noise: Array) -> tuple[Array, Array, Array]:
    """Of k columns what the readings see of them, (k, k) and with what is read beside rigid payloads (k,), in units of
    the noise; and the mean square of what they do to the reflectors (k, k) [m²]. Part by part: of 10,000 visits all of
    it would be 1.4 GB."""
    count, size = len(c.recording), len(columns)
    made = np.empty((size, count, 6), dtype=np.float32)
    fields = np.empty((size, count, 6), dtype=np.float32)
    for first in range(0, size, PART):
        part = slice(first, first + PART)
        made[part], beside = _made(c, columns[part], payloads_of(c), noise)
        fields[part] = beside.T.reshape(-1, count, 6)
    by_unit = np.array([Column("frames", "sensor_error", {"component": k}).evaluate(c) for k in range(6)])
    read, there = beside_the_payload(c) / noise, weighed_often(c)
    gram, says, moves = np.zeros((size, size)), np.zeros(size), np.zeros((size, size))
    for first in range(0, count, VISITS):
        some = slice(first, first + VISITS)
        seen = fields[:, some].reshape(size, -1).astype(float)
        gram += seen @ seen.T
        says += seen @ read[some].ravel()
        mine = there[some]
        far = np.einsum("knc,cnt->knt", made[:, some][:, mine].astype(float), by_unit[:, some][:, mine])
        far = far.reshape(size, -1)
        moves += far @ far.T
    return gram, says, 3.0 / (int(there.sum()) * by_unit.shape[2]) * moves


def _most(gram: Array, says: Array, moves: Array, at: Sequence[int]) -> float:
    """How far columns `at` may move the reflectors by what the readings say of them, rms [m]. What they cannot say
    moves them without end; but of a whole matrix no more than that of any, which has forms of its own."""
    lengths, turn = np.linalg.eigh(gram[np.ix_(at, at)])
    move = moves[np.ix_(at, at)]
    silent = lengths < SMALLEST * max(float(lengths[-1]), 1.0)
    unsaid = np.einsum("ij,ik,kj->j", turn, move, turn)[silent].sum() > SMALLEST**2
    if unsaid and not (len(at) > MANY and silent.sum() <= OF_ANY_MATRIX):
        return np.inf
    lengths, turn = lengths[~silent], turn[:, ~silent]
    covariance = (turn / lengths) @ turn.T
    values = covariance @ says[at]
    return float(np.sqrt(values @ move @ values + SURELY**2 * (move * covariance).sum()))


def _wrong(c: Context, beside: Array | None = None) -> tuple[NDArray[np.bool_], Array, Array]:
    """Of every channel (6,) whether it reads other than rigid payloads weigh, by how much and with which noise, rms [N,
    N·m]; with none where too few visits say so. beside (N, 6): what it reads beside them, or beside more."""
    r, beside = c.recording, beside_the_payload(c) if beside is None else beside
    every = _goes_with(c)
    free = len(r) - int(np.linalg.matrix_rank(every))
    if free < max(LEAST_FREE, len(r) / 2):
        return np.zeros(6, dtype=bool), np.zeros(6), np.zeros(6)
    most = _largest(r)
    left = beside - every @ np.linalg.lstsq(every, beside, rcond=1e-9)[0]
    noise, whole = (left**2).sum(axis=0) / free, (beside**2).mean(axis=0)
    wrong = np.maximum(whole - noise, 0.0)
    is_wrong = (wrong > GOES_WITH * whole) & (wrong > (OF_ALL * most) ** 2)
    return is_wrong, np.sqrt(wrong), np.maximum(np.sqrt(noise), NO_LESS * np.maximum(most, 1e-9))


def _goes_with(c: Context) -> Array:
    """(N, k) what a sensor's error may go with, a constant with it."""
    r, count = c.recording, len(c.recording)
    whole = max(float(np.ptp(c.hours)), 1e-9)
    hangs = weighs(payloads_of(c), gravity_at_sensor(c))  # not what is read, of which noise would be a part
    stays = named_column(c, "mounting")
    mounted = np.equal.outer(stays, np.unique(stays)) if stays.max() < count / FEWER else np.ones((count, 1))
    with_what = [
        *(hangs / np.maximum(np.abs(hangs).max(axis=0), 1e-9)).T,
        *(r.temperatures[place] - r.temperatures[place].mean() for place in temperature_places(c)),
        *(np.cos(np.pi * k * (c.hours - c.hours[0]) / whole) for k in range(1, 5)),
    ]
    return np.concatenate([mounted.astype(float), np.stack(with_what, axis=1)], axis=1)


def _each_once(forms: Sequence[Candidate]) -> tuple[list[Column], list[list[int]]]:
    """All columns of the forms, and which of them each form has."""
    columns: dict[str, Column] = {}
    keys = [[json.dumps(column.args, sort_keys=True) for column in form.columns] for form in forms]
    for form, mine in zip(forms, keys, strict=True):
        columns.update(zip(mine, form.columns, strict=True))
    where = {key: k for k, key in enumerate(columns)}
    return list(columns.values()), [[where[key] for key in mine] for mine in keys]


def _evidence(gram: Array, goes: Array, at: Sequence[int], count: int) -> float:
    """Log evidence of columns `at` by the Bayesian information criterion (Schwarz 1978)."""
    mine = gram[np.ix_(at, at)]
    if float(np.diag(mine).min()) < SMALLEST:
        return -np.inf
    mine = mine + np.diag(SMALLEST * np.diag(mine))
    said = goes[at] @ cho_solve(cho_factor(mine), goes[at])
    return float(0.5 * said - 0.5 * len(at) * np.log(count))


def _fitted(c: Context, forms: Sequence[Candidate], noise: Array) -> tuple[Misreading, ...]:
    """The forms together, each with its own columns; what hangs there is weighed anew without what they say."""
    gravity, load, wrench = gravity_at_sensor(c), c.recording.load, c.recording.wrench
    columns = [column for form in forms for column in form.columns]
    beside, held = beside_the_payload(c), payloads_of(c)
    for _ in range(AGAIN):
        made, fields = _made(c, columns, held, noise)
        values = np.asarray(np.linalg.lstsq(fields, (beside / noise).ravel(), rcond=1e-9)[0])
        held = payloads(wrench - np.einsum("k,knb->nb", values, made), load, gravity)
    left = (beside / noise).ravel() - fields @ values
    covariance = np.asarray(float((left**2).mean()) * np.linalg.pinv(fields.T @ fields))
    ends = np.cumsum([len(form.columns) for form in forms])
    parts = [slice(end - len(form.columns), end) for form, end in zip(forms, ends, strict=True)]
    return tuple(Misreading(form, values[p], covariance[p, p]) for form, p in zip(forms, parts, strict=True))


def _made(c: Context, columns: Sequence[Column], held: Array, noise: Array) -> tuple[Array, Array]:
    """(k, N, 6) what columns make a sensor read that bears payloads (N, 4), and (6 N, k) what of that is beside rigid
    ones, in units of the noise (6,). Gains are of what hangs there: what was read besides would be all of itself."""
    gravity, load = gravity_at_sensor(c), c.recording.load
    there = replace(c, recording=replace(c.recording, wrench=weighs(held, gravity)))
    made = np.array([misread(there, **column.args) for column in columns])
    beside = beside_payloads(made, load, gravity) * weighed_often(c)[:, None] / noise
    return made, beside.reshape(len(columns), -1).T
