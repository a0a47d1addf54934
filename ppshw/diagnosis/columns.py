"""Columns with the wrong sign or the wrong unit, looked for before anything else: the ideal machine is right to a few
centimetres, a payload hangs down, and a mistake of a whole column is not to be explained by physics.

A payload's moments fit its forces with either sign, as a load on the other side; which it is the machine says, that
gives way to them. What cannot be told: a single moment's sign where the sensor stays level; the scale of all forces
and moments, which is another load.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.evidence import LEAST_P
from ppshw.evaluation import by_visit
from ppshw.identification.joint import Estimate, estimate
from ppshw.identification.own_weight import fitted
from ppshw.identification.plausible import LOADED_N, LOADED_NM, is_another_machine, misfit, without_gross_errors
from ppshw.identification.start import to_base
from ppshw.identification.structure import joint_model
from ppshw.kinematics import frames, point_positions
from ppshw.machine import WRENCH_COMPONENTS, Machine
from ppshw.recording import Recording, listed
from ppshw.statics import gravity_in_sensor
from ppshw.terms import Situation
from ppshw.terms.history import payloads, weighs
from ppshw.transforms import fit_rigid

Array = NDArray[np.float64]
# A mistake is said when one column's correction takes the misfit to less than this share of what it was, and the misfit
# was gross: for positions in metres, for wrenches as a share of the wrench itself.
BETTER = 0.2
# Of a joint's sign, and of two that are exchanged: no joint's own error is a slope of -2 or another's position, and
# tilts of short travel move little.
BETTER_SIGN = 0.5
GROSS_M = 0.01
SIGN_M = 1e-3  # of a joint's sign
MANY, MEANS_M = 10, 0.05  # visits; how far the reflectors' means may be off for anything to be said of exchanges
GROSS_WRENCH = 0.3
# A payload's centre of mass is not this far from the sensor: forces in kilonewtons beside N·m put it a thousand times
# as far as it is, and so do newtons beside moments in N·mm. Which, the forces say: half a tonne is 5 kN, a kilogram
# 10 N; between nobody can tell.
LEVER_M = 20.0
MOST_KN, LEAST_N = 5.0, 10.0
ASKEW = np.pi / 4  # a payload's weight does not point this far from gravity, whatever a sensor's zero adds [rad]
# With the moments' right sign the base model, identified from half of so many visits in blocks, leaves less of the
# other half: in 34 recordings of another author the other one left 1.02 to 6.3 times as much, in 29 of them 1.04 and
# more. (Of the visits that it was identified from it may leave less with the wrong one: 0.89 times as much beside a
# zero that jumped.) How much less it must leave for the given sign to be wrong, and by how many standard errors; and
# for two signs to be told apart at all.
ASKED, IN_A_ROW, REVERSED, SURE, TOLD = 400, 15, 1.04, 3.0, 1.01
BLOCKS = 5  # of the visits of a load, where there are not many
FIRST_ROUNDS = 3  # of the estimates that ask for the sign first; where it may be wrong, others go on to the end
FEWEST = 10  # visits of which a standard error says something
FARTHEST = 0.9  # share of the visits, the others counting as these
TO, PLURAL = " … ", {"has": "have", "is": "are"}
SIGN = {-1.0: "has the opposite sign"}
LENGTHS = {**SIGN, 1e-3: "is in millimetres, expected metres", 1e3: "is in kilometres, expected metres"}
ANGLES = {**SIGN, float(np.pi / 180): "is in degrees, expected radians"}
FORCES, MOMENTS = (0, 1, 2), (3, 4, 5)
KILO = "is in kilonewtons, expected newtons"
TOO = " (the moments too, if they go with the forces)"  # where nobody asked, or the visits do not tell
AXES = ((0, 1), (0, 2), (1, 2))


@dataclass(frozen=True)
class Mistake:
    """column times factor is what it should have been, None: columns are exchanged; what is wrong, said of one column;
    misfit before and after the correction [m], or shares of the wrench; how columns without a factor were set right."""

    column: str
    factor: float | None
    what: str
    before: float
    after: float
    done: str = "taken the other way round"

    def finding(self) -> dict[str, Any]:
        """In the contract's form (§4), under a name of its own."""
        factor = {} if self.factor is None else {"factor": {"value": self.factor, "std": 0.0, "unit": "1"}}
        were = "they were" if self.several else "it was"
        how = f"{were} {self.done}" if self.factor is None else f"{were} taken times {self.factor:g}"
        return {
            "effect": "column_mistake", "joint": None, "frame": None, "component": None, "covariate": self.column,
            "region": None, "parameters": factor,
            "p_value": LEAST_P, "rms_mm": None, "weight": 1.0, "alternatives": [], "aliases": [],
            "sentence": f"{self.said}; {how}.",
        }  # fmt: skip

    @property
    def asked(self) -> float:
        """To what share of the misfit a correction must take it."""
        return BETTER_SIGN if self.factor in (-1.0, None) and self.column.startswith("q_") else BETTER

    @property
    def said(self) -> str:
        """What is wrong, of one column or of several."""
        if not self.several:
            return f"the column {self.column} {self.what}"
        verb, what = self.what.split(" ", 1)
        return f"the columns {self.column} {PLURAL[verb]} {what}"

    @property
    def several(self) -> bool:
        return self.factor is None or TO in self.column


def column_mistakes(machine: Machine, recording: Recording) -> tuple[Recording, list[Mistake]]:
    """The recording with its columns set right, and what was wrong with them; one mistake after the other.

    Whether moments have the sign of their forces is asked of the base model, which takes some seconds. Raises
    RecordingError where the recording can be none of this machine's even so.
    """
    recording, found = plain_mistakes(machine, recording)
    sound, _ = without_gross_errors(machine, recording)
    if not _has(recording, MOMENTS) or not _loaded(recording, MOMENTS, LOADED_NM):
        return recording, found
    forces = next((m for m in found if m.column == _named(FORCES) and m.factor == -1.0), None)
    first = _roughly if forces is None else _plainly  # the moments' sign goes by the forces' unless it is told apart
    _, (given, other), sure = _by_either_sign(sound, lambda r: _left(machine, r, first))
    if sure:  # other weights than those that bend the machine may look so too
        _, (given, other), sure = _by_either_sign(sound, lambda r: _left(machine, r, fitted))
    if forces is None and sure:  # how a load that a half never saw bends the machine is a guess where there are few
        _, (seen_given, seen_other), _ = _by_either_sign(sound, lambda r: _left(machine, r, first, _of_each_load))
        sure = bool(seen_given > seen_other)
    if forces is None and sure:
        alone, less = min(((k, _turned(machine, sound, k)) for k in MOMENTS), key=lambda pair: pair[1])
        columns, after = ((alone,), less) if TOLD * less < other else (MOMENTS, float(other))
        found.append(Mistake(_named(columns), -1.0, SIGN[-1.0], float(given), after))
        return _times(recording, columns, -1.0), found
    if forces is None:
        return recording, found
    turned = other < TOLD * given  # a sensor mounted the other way round turns all six
    what = SIGN[-1.0] + (TOO if turned and given <= TOLD * other else "")
    found[found.index(forces)] = replace(forces, column=_named(range(6) if turned else FORCES), what=what)
    return (_times(recording, MOMENTS, -1.0) if turned else recording), found


def plain_mistakes(machine: Machine, recording: Recording) -> tuple[Recording, list[Mistake]]:
    """The same by what needs no fit: the sign of all moments together is not asked for, and said to be open where the
    forces have the opposite one. What leaves the recording none of this machine's is no correction."""
    recording, found = _a_row_off(machine, recording)
    recording, exchanged = _exchanged_at_times(machine, recording)
    found += exchanged
    given, before = recording, list(found)
    for look in (_positions, _wrenches, _wrench_units):
        for _ in range(3):
            tried = list(look(machine, recording))
            best = min(tried, key=lambda pair: pair[0].after + _askew(machine, pair[1]), default=None)
            if best is None or best[0].after > best[0].asked * best[0].before:
                break
            mistake, recording = best
            found.append(mistake)
        if look is _positions and found and is_another_machine(machine, recording):  # of some rows only, or of more
            recording, found = given, list(before)
    return recording, found


def doubts_of_gravity(machine: Machine, recording: Recording) -> list[str]:
    """A line where what hangs there does not pull along the machine file's gravity, at the middle one of the visits
    with a load; up or down is a matter of sign. Nobody can tell which of the two to set right."""
    if not _has(recording, FORCES) or not _loaded(recording, FORCES, LOADED_N):
        return []
    g, force = gravity_in_sensor(machine, frames(machine, recording.q)), recording.wrench[:, :3]
    size = np.linalg.norm(force, axis=1)
    loaded = size > max(LOADED_N, 0.3 * size.max())
    along = np.abs((force * g).sum(axis=1)[loaded]) / np.maximum(size * np.linalg.norm(g, axis=1), 1e-30)[loaded]
    away = float(np.arccos(np.clip(np.median(along), 0.0, 1.0)))
    if not g.any() or away < ASKEW:
        return []
    return [
        f"forces of loaded visits point {np.degrees(away):.0f}° away from gravity: is gravity in {machine.file} wrong, "
        "or are the axes of force_sensor?"
    ]


def doubts_of_moments(recording: Recording, left: Callable[[Recording], Array]) -> list[str]:
    """A line where a calibration leaves less of the recording with its moments' signs turned.

    left  what the calibration leaves of every visit of a recording (V,) [m], nan of one without a reading
    """
    if not _has(recording, MOMENTS) or not _loaded(recording, MOMENTS, LOADED_NM):
        return []
    if recording.measured.sum() < FEWEST:
        return []
    (given, other), _, sure = _by_either_sign(recording, left)
    if not sure:
        return []
    return [f"the columns {_named(MOMENTS)} seem to have the opposite sign to those of the recording that the "
            f"calibration was made from: it leaves {1e3 * given:.3f} mm rms, with the signs turned "
            f"{1e3 * other:.3f}"]  # fmt: skip


def _by_either_sign(recording: Recording, left: Callable[[Recording], Array]) -> tuple[Array, Array, bool]:
    """What is left of a recording as it is and with its moments' signs turned, rms (2,) [m] of all visits and with the
    farthest as far as the others, and whether the latter is surely less."""
    both = np.stack([left(r) for r in (recording, _times(recording, MOMENTS, -1.0))])
    both = both[:, np.isfinite(both).all(axis=0)]
    if not both.size:
        return np.zeros(2), np.zeros(2), False
    near = np.minimum(both, np.quantile(both.min(axis=0), FARTHEST))
    all_visits, most = (np.sqrt((each**2).mean(axis=1)) for each in (both, near))
    more = near[0] ** 2 - near[1] ** 2
    sure = more.mean() > SURE * more.std() / np.sqrt(len(more))
    return all_visits, most, bool(most[0] > REVERSED * most[1] and sure)


def _turned(machine: Machine, recording: Recording, column: int) -> float:
    """What is left with the sign of one column turned alone, rms [m] with the farthest as far as the others."""
    left = _left(machine, _times(recording, (column,), -1.0), fitted)
    left = left[np.isfinite(left)]
    return float(np.sqrt((np.minimum(left, np.quantile(left, FARTHEST)) ** 2).mean()))


def _positions(machine: Machine, recording: Recording) -> Iterator[tuple[Mistake, Recording]]:
    if not recording.seen.any():  # other points alone
        return
    before = misfit(machine, recording)
    if before < SIGN_M:
        return
    for k, joint in enumerate(machine.joints):
        units = SIGN if before < GROSS_M else LENGTHS if joint.prismatic else ANGLES
        for factor, what in units.items():
            yield _tried(machine, _scaled(recording, [k], factor), f"q_{joint.name}", factor, what, before)
    for one, other in itertools.combinations(range(machine.n), 2):
        if machine.joints[one].prismatic == machine.joints[other].prismatic:
            q = recording.q.copy()
            q[:, [one, other]] = q[:, [other, one]]
            names = [f"q_{machine.joint_names[k]}" for k in (one, other)]
            yield _tried(machine, replace(recording, q=q), " and ".join(names), None, "is exchanged", before)
    if before < GROSS_M:
        return
    names = [f"{name}_{axis}" for name in recording.target_names for axis in "xyz"]
    for factor, what in LENGTHS.items():
        changed = replace(recording, points=factor * recording.points)
        yield _tried(machine, changed, _from_to(names), factor, what, before)
    turning = [k for k, joint in enumerate(machine.joints) if not joint.prismatic]
    if len(turning) > 1:
        names, degrees = [f"q_{machine.joint_names[k]}" for k in turning], float(np.pi / 180)
        changed = _scaled(recording, turning, degrees)
        yield _tried(machine, changed, _from_to(names), degrees, ANGLES[degrees], before)
    for t, name in enumerate(recording.target_names):
        for a, axis in enumerate("xyz"):
            for factor, what in LENGTHS.items():
                points = recording.points.copy()
                points[:, t, a] *= factor
                yield _tried(machine, replace(recording, points=points), f"{name}_{axis}", factor, what, before)
        for factor in (1e-3, 1e3):
            points = recording.points.copy()
            points[:, t] *= factor
            column, changed = _from_to([f"{name}_{axis}" for axis in "xyz"]), replace(recording, points=points)
            yield _tried(machine, changed, column, factor, LENGTHS[factor], before)
    for column, points in _exchanged(recording):
        yield _tried(machine, replace(recording, points=points), column, None, "is exchanged", before)


def _scaled(recording: Recording, joints: Sequence[int], factor: float) -> Recording:
    q = recording.q.copy()
    q[:, joints] *= factor
    return replace(recording, q=q)


def _exchanged_at_times(machine: Machine, recording: Recording) -> tuple[Recording, list[Mistake]]:
    """Two reflectors that are exchanged at many visits: by where the ideal machine has them, once the instrument is
    laid by the reflectors' means, which no exchange changes. At a few it is a matter of those visits."""
    whole, count = recording.seen.all(axis=1), len(recording.target_names)
    if count < 2 or whole.sum() < MANY:
        return recording, []
    ideal = point_positions(machine, recording.q, machine.target_array)
    laid = fit_rigid(recording.points[whole].mean(axis=1), ideal[whole].mean(axis=1))
    points = recording.points @ laid[:3, :3].T + laid[:3, 3]
    if np.median(np.linalg.norm((points - ideal)[whole].mean(axis=1), axis=1)) > MEANS_M:  # something else is wrong
        return recording, []

    def missed(order: Sequence[int]) -> Array:
        return _missed(points[:, order], ideal)

    pairs = list(itertools.combinations(range(count), 2))
    given = missed(list(range(count)))
    others = np.array([missed([b if k == a else a if k == b else k for k in range(count)]) for a, b in pairs])
    mended, found = recording.points.copy(), []
    for (a, b), after in zip(pairs, others, strict=True):
        here = (after < BETTER * given) & (after <= others.min(axis=0)) & (given > GROSS_M)
        if here.sum() < MANY or here[recording.measured].all():
            continue
        mended[np.ix_(here, [a, b])] = mended[np.ix_(here, [b, a])]
        what = f"is exchanged in {here.sum()} visits ({listed(np.flatnonzero(here).tolist())})"
        was, left = (float(np.sqrt((each[here] ** 2).mean())) for each in (given, after))
        found.append(Mistake(f"{recording.target_names[a]} and {recording.target_names[b]}", None, what, was, left))
    return (replace(recording, points=mended), found) if found else (recording, [])


def _a_row_off(machine: Machine, recording: Recording) -> tuple[Recording, list[Mistake]]:
    """All reflectors a row late or early from some visit on, as where a row was lost: by where the ideal machine has
    them, once the instrument is laid by the first third of the visits."""
    count = len(recording)
    if count < 2 * MANY or not recording.seen.any():
        return recording, []
    ideal = point_positions(machine, recording.q, machine.target_array)

    def missed(points: Array) -> Array:
        return _missed(points @ laid[:3, :3].T + laid[:3, 3], ideal)

    sound = recording.seen & (np.arange(count) < count / 3)[:, None]
    for _ in range(2):  # by the first visits, then by all that are right
        if not sound.any():
            return recording, []
        laid = fit_rigid(recording.points[sound], ideal[sound])
        given = missed(recording.points)
        sound = recording.seen & (given < MEANS_M)[:, None]
    for rows in (1, -1):
        points = np.full_like(recording.points, np.nan)
        into, of = (slice(rows, None), slice(None, -rows)) if rows > 0 else (slice(None, rows), slice(-rows, None))
        points[into] = recording.points[of]
        gain = np.cumsum((given - missed(points))[::-1])[::-1]  # by shifting all visits from each on
        first = int(np.argmax(gain))
        here = np.arange(count) >= first
        told = here & np.isfinite(points).any(axis=(1, 2)) & recording.measured
        if told.sum() < MANY or first < MANY:
            continue
        before, after = (float(np.sqrt((each[told] ** 2).mean())) for each in (given, missed(points)))
        if before < MEANS_M or after > BETTER * before:
            continue
        names = [f"{name}_{axis}" for name in recording.target_names for axis in "xyz"]
        what = f"is a row {'early' if rows > 0 else 'late'} from visit {first + 1} on"
        if rows > 0:
            points[first] = np.nan  # what stands before it is that visit's own
        mended = replace(recording, points=np.where(here[:, None, None], points, recording.points))
        return mended, [Mistake(_from_to(names), None, what, before, after, "moved back")]
    return recording, []


def _missed(points: Array, ideal: Array) -> Array:
    """(N,) mean distance of a visit's readings (N, T, 3) from where the ideal machine has them [m], 0 without any."""
    off = np.linalg.norm(points - ideal, axis=2)
    return np.asarray(np.nansum(off, axis=1) / np.maximum(np.isfinite(off).sum(axis=1), 1))


def _exchanged(recording: Recording) -> Iterator[tuple[str, Array]]:
    """Two reflectors, or two coordinates of one or of all of them, exchanged throughout: which, and the readings as
    they should have been."""
    for one, other in itertools.combinations(range(len(recording.target_names)), 2):
        points = recording.points.copy()
        points[:, [one, other]] = points[:, [other, one]]
        yield f"{recording.target_names[one]} and {recording.target_names[other]}", points
    for t, name in enumerate(recording.target_names):
        for a, b in AXES:
            points = recording.points.copy()
            points[:, t, [a, b]] = points[:, t, [b, a]]
            yield f"{name}_{'xyz'[a]} and {'xyz'[b]}", points
    names = recording.target_names
    for a, b in AXES:
        points = recording.points.copy()
        points[..., [a, b]] = points[..., [b, a]]
        yield f"{_from_to([f'{name}_' + 'xyz'[a] for name in names])} and {'xyz'[b]}", points


def _askew(machine: Machine, recording: Recording) -> float:
    """A hundredth of the middle distance [m] to the ideal machine where the instrument is said to stand: what is
    mirrored is set right by several corrections, one of which leaves it there. 0 where nobody says."""
    if machine.tracker.base is None:
        return 0.0
    ideal = point_positions(machine, recording.q, machine.target_array)
    return 0.01 * float(np.nanmedian(np.linalg.norm(to_base(recording.points, machine.tracker.base) - ideal, axis=2)))


def _tried(
    machine: Machine, changed: Recording, column: str, factor: float | None, what: str, before: float
) -> tuple[Mistake, Recording]:
    return Mistake(column, factor, what, before, misfit(machine, changed)), changed


def _wrenches(machine: Machine, recording: Recording) -> Iterator[tuple[Mistake, Recording]]:
    loaded = _loaded(recording, FORCES, LOADED_N) or _loaded(recording, MOMENTS, LOADED_NM)
    if not _has(recording, range(6)) or not loaded:
        return
    g = gravity_in_sensor(machine, frames(machine, recording.q))
    before = _unlike_a_payload(recording, recording.wrench, g)
    if before < GROSS_WRENCH:
        return
    for columns in (FORCES, *((k,) for k in range(6))):
        changed = _times(recording, columns, -1.0)
        after = _unlike_a_payload(recording, changed.wrench, g)
        what = SIGN[-1.0] + (TOO if columns == FORCES and _loaded(recording, MOMENTS, LOADED_NM) else "")
        yield Mistake(_named(columns), -1.0, what, before, after), changed
    for k in FORCES:
        changed = _times(recording, (k,), 1e3)
        yield Mistake(WRENCH_COMPONENTS[k], 1e3, KILO, before, _unlike_a_payload(recording, changed.wrench, g)), changed
    for three, (first, second) in itertools.product((FORCES, MOMENTS), AXES):
        wrench, a, b = recording.wrench.copy(), three[first], three[second]
        wrench[:, [a, b]] = wrench[:, [b, a]]
        after = _unlike_a_payload(recording, wrench, g)
        column = f"{WRENCH_COMPONENTS[a]} and {WRENCH_COMPONENTS[b]}"
        yield Mistake(column, None, "is exchanged", before, after), replace(recording, wrench=wrench)


def _wrench_units(machine: Machine, recording: Recording) -> Iterator[tuple[Mistake, Recording]]:
    """Forces in kilonewtons or moments in newton millimetres; by how far off the payloads' centres of mass would be.
    That is said of the whole force: the part along gravity is small where the machine file has another gravity."""
    if not _has(recording, FORCES) or not _loaded(recording, MOMENTS, LOADED_NM):
        return
    g = gravity_in_sensor(machine, frames(machine, recording.q))
    held = payloads(recording.wrench, recording.load, g)
    size = np.linalg.norm(recording.wrench[:, MOMENTS], axis=1)
    heavy = size > 0.1 * size.max()
    force = np.linalg.norm(recording.wrench[heavy, :3], axis=1)
    weights = np.linalg.norm(held[heavy, 1:], axis=1) * np.linalg.norm(g[heavy], axis=1)
    lever, hangs = float(np.median(weights / np.maximum(force, 1e-30))), float(np.median(force))
    if lever <= LEVER_M:
        return
    far = f"(loads would hang {lever:.0f} m off the sensor)"
    if hangs < MOST_KN:
        what = f"{KILO} {far}"
        yield Mistake(_named(FORCES), 1e3, what, lever, 1e-3 * lever), _times(recording, FORCES, 1e3)
    elif hangs > LEAST_N:
        what = f"is in newton millimetres, expected newton metres {far}"
        yield Mistake(_named(MOMENTS), 1e-3, what, lever, 1e-3 * lever), _times(recording, MOMENTS, 1e-3)


def _plainly(machine: Machine, sound: Recording, recording: Recording) -> Estimate:
    return estimate(joint_model(machine, sound), recording)


def _roughly(machine: Machine, sound: Recording, recording: Recording) -> Estimate:
    return estimate(joint_model(machine, sound), recording, rounds=FIRST_ROUNDS)


def _in_blocks(load: Sequence[str]) -> NDArray[np.bool_]:
    """(N,) one of two halves of the visits: blocks, dealt in turn."""
    return np.asarray(np.arange(len(load)) // IN_A_ROW % 2 == 0)


def _of_each_load(load: Sequence[str]) -> NDArray[np.bool_]:
    """The same with blocks of the visits of each load, so that both halves have all loads."""
    labels = np.array(load)
    out = np.zeros(len(labels), dtype=bool)
    for label in set(load):
        mine = np.flatnonzero(labels == label)
        length = max(1, min(IN_A_ROW, len(mine) // BLOCKS))
        out[mine] = np.arange(len(mine)) // length % 2 == 0
    return out


def _left(
    machine: Machine,
    recording: Recording,
    fit_to: Callable[[Machine, Recording, Recording], Estimate] = _plainly,
    halves: Callable[[Sequence[str]], NDArray[np.bool_]] = _in_blocks,
) -> Array:
    """(V,) rms [m] of what the base model of half of the visits leaves of every visit of the others."""
    some = recording.subset(np.linspace(0, len(recording) - 1, min(ASKED, len(recording))).astype(int))
    fit = halves(some.load)
    base, others = fit_to(machine, some, some.subset(fit)), some.subset(~fit)
    missed = to_base(others.points, base.measuring_in_base) - base.model.predict(Situation.of(others), base.theta)
    return by_visit(missed)


def _has(recording: Recording, columns: Sequence[int]) -> bool:
    """Whether these components of the wrench were read."""
    read = recording.wrench[:, list(columns)]
    return bool(recording.has_wrench and np.isfinite(read).all() and read.any())


def _loaded(recording: Recording, columns: Sequence[int], least: float) -> bool:
    """Whether forces or moments are ever those of a load, and no sensor's zero [N, N·m]."""
    return bool(recording.has_wrench and np.linalg.norm(recording.wrench[:, list(columns)], axis=1).max() > least)


def _times(recording: Recording, columns: Sequence[int], factor: float) -> Recording:
    wrench = recording.wrench.copy()
    wrench[:, list(columns)] *= factor
    return replace(recording, wrench=wrench)


def _named(columns: Sequence[int]) -> str:
    return _from_to([WRENCH_COMPONENTS[k] for k in columns])


def _from_to(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{names[0]}{TO}{names[-1]}"


def _unlike_a_payload(recording: Recording, wrench: Array, g: Array) -> float:
    """Share of the wrenches that no rigid payload under gravity explains: force and moment each count half. Without
    labels every visit may have one of its own: a force is its weight then, a moment across it."""
    if any(recording.load):
        held = payloads(wrench, recording.load, g)
        held[:, 0] = np.maximum(held[:, 0], 0.0)  # nothing weighs less than nothing
        beside = wrench - weighs(held, g)
    else:
        along = np.einsum("ncx,nx->nc", wrench.reshape(-1, 2, 3), g) / np.maximum((g**2).sum(axis=1), 1e-30)[:, None]
        weight, turns = np.maximum(along[:, :1], 0.0) * g, along[:, 1:] * g
        beside = np.concatenate([wrench[:, :3] - weight, turns], axis=1)
    shares = [
        float((beside[:, some] ** 2).sum() / max(float((wrench[:, some] ** 2).sum()), 1e-30))
        for some in (slice(0, 3), slice(3, 6))
    ]
    return float(np.sqrt(np.mean(shares)))
