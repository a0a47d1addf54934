"""Before any fit: is this a recording of this machine at all, and which readings cannot be errors of a machine?

A beam that caught another reflector, a slipped decimal point, millimetres for metres: such readings are no noise, and a
least-squares start dragged along by them is found by no weighting afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ppshw.errors import IdentificationFailed, RecordingError
from ppshw.identification.start import align, to_base
from ppshw.kinematics import frames, joint_jacobian, point_positions, tip_poses
from ppshw.machine import RADIUS_986, Machine
from ppshw.machine import doubts as doubts_of_file
from ppshw.quantities import distance, many
from ppshw.recording import Recording, listed
from ppshw.statics import gravity_in_sensor
from ppshw.terms.history import payloads, unseen_moment, weighs
from ppshw.transforms import fit_rigid

Array = NDArray[np.float64]
# A machine that misses a tenth of its working space, and more than 0.1 m, at the median is another machine or in other
# units; a reading off by 20 times the median and more than 50 mm is no error of a machine. Both are our judgement.
ANOTHER_MACHINE, ANOTHER_MACHINE_M = 0.1, 0.1
GROSS, GROSS_M = 20.0, 0.05
COMPUTED_M = 1e-8  # no machine is so near to its ideal, and no tracker would say so
# What a sensor may read with nothing on it, by its zero and its noise, says nothing of signs and units: ours, 2 kg and
# those a quarter of a metre off.
LOADED_N, LOADED_NM = 20.0, 5.0
KELVIN_C, FAHRENHEIT_C = 200.0, 45.0  # no machine is measured so warm, and in no air so warm
# A wrench off by 20 times the median of its load label, and by more than that, is misread: single rows of many, or the
# label is of several loads.
SINGLE, OF_A_LABEL = 0.02, 10  # share of a label's visits, one at least; fewer visits cannot tell
# Noise at the reflectors of 110 recordings with all their columns was 0.9 to 4.1 times the stated repeatability's rms.
NOISIER = 6.0
SCATTERED = 2.0  # times what the machine file says of the instrument
MIXED = 0.8  # of what weights middling differ by, that labels leave
# Links follow the air within half an hour to four hours.
SILENT_H, VISITS_PER_HOUR = 0.5, 40.0
ROUNDS = 20
BLOCK = 4096
# A servo errs by far less than a hundredth of a travel; a row too late it is where it was sent, to a fifth of that.
# Ours.
ELSEWHERE, BY_A_ROW = 0.01, 0.2
ENOUGH_TO_SAY = 500  # visits that say how far a joint moves reflectors
# Visits, readings that do not change, and reflectors that moved: of an instrument that froze; what is left by setpoints
# in place of an encoder that did.
MOVED_VISITS, FROZEN_M, MOVED_M, IF_FROZEN = 5, 1e-7, 0.01, 0.3
AT_REST_M = 5e-5  # that a servo at rest may move the reflectors, of a beam's 0.5 mm


def without_gross_errors(machine: Machine, recording: Recording) -> tuple[Recording, NDArray[np.bool_]]:
    """The recording with gross readings, and all of a visit with a misread wrench, taken for lost, and (N,) which
    visits had one.

    Raises RecordingError when not single readings but most of them, or most of one reflector's, are far from where the
    ideal machine has them, or exactly there.
    """
    refuse_frozen(machine, recording)
    kept = recording
    for _ in range(ROUNDS):
        off, ideal = _missed(machine, recording, kept)
        size = np.linalg.norm(off, axis=2)
        median = float(np.nanmedian(np.where(kept.seen, size, np.nan)))
        gross = recording.seen & _gross(size, median)
        if (gross == (recording.seen & ~kept.seen)).all():
            break
        kept = replace(recording, points=np.where(gross[..., None], np.nan, recording.points))
    if median < COMPUTED_M:
        raise RecordingError(
            f"{recording.source}: half of the targets are within {1e9 * COMPUTED_M:.0f} nm of where the ideal "
            f"'{machine.name}' has them: computed, expected readings of a machine"
        )
    if _another_machine(median, ideal):
        placed = machine.tracker.base is not None
        or_open = ", or is `tracker.base: estimate` wanted there" if placed else ""
        raise RecordingError(
            f"{recording.source}: half of the targets are more than {distance(median)} from where '{machine.name}' "
            "should have them; is it this machine, are they in metres, and in the measuring frame of the machine file"
            f"{or_open}?"
        )
    _refuse_mostly_gross(machine, recording, gross, off)
    gross |= misread(machine, recording)[:, None] & recording.seen
    return replace(kept, points=np.where(gross[..., None], np.nan, recording.points)), np.asarray(gross.any(axis=1))


def refuse_frozen(machine: Machine, recording: Recording) -> None:
    """Raise RecordingError where an instrument or an encoder read the same all the time while the machine moved: no
    unit of a column makes that good."""
    visits = int(recording.measured.sum())
    if visits < MOVED_VISITS:
        return
    part = recording.subset(recording.measured)
    read = part.points[:, part.seen.any(axis=0)]
    still = float(np.max(np.nanmax(read, axis=0) - np.nanmin(read, axis=0)))
    some = part.subset(np.unique(np.linspace(0, visits - 1, ENOUGH_TO_SAY).astype(np.int64)))
    moved = float(np.ptp(point_positions(machine, some.q, machine.target_array), axis=0).max())
    if still < FROZEN_M < MOVED_M < moved:
        raise RecordingError(
            f"{recording.source}: every reflector was read at the same place at all {visits} visits, while the joints "
            f"moved them by up to {moved:.3g} m: expected readings that change (an instrument that froze?)"
        )
    for k, joint in enumerate(machine.joints):
        if np.ptp(part.q[:, k]) or np.ptp(part.q_cmd[:, k]) <= 0.0:
            continue
        q = some.q.copy()
        q[:, k] = some.q_cmd[:, k]
        if misfit(machine, replace(some, q=q)) < IF_FROZEN * misfit(machine, some):
            raise RecordingError(
                f"{recording.source}: q_{joint.name} is {part.q[0, k]:.6g} {joint.unit} at all {visits} visits, while "
                f"its setpoints go from {part.q_cmd[:, k].min():.6g} to {part.q_cmd[:, k].max():.6g} and the "
                "reflectors with them: expected positions that change (an encoder that froze?)"
            )


def _refuse_mostly_gross(machine: Machine, recording: Recording, gross: NDArray[np.bool_], off: Array) -> None:
    """Raise RecordingError where half of the visits have a gross reading (N, T), off by (N, T, 3) [m] in the base's
    axes, and name the reflectors that are so at half of theirs."""
    seen, visits = recording.seen, recording.measured
    if not gross.any() or 2 * gross.any(axis=1).sum() < visits.sum():
        return
    turn = tip_poses(machine, recording.q)[:, :3, :3]
    said = []
    for t, name in enumerate(recording.target_names):
        mine = gross[:, t]
        if mine.any() and 2 * mine.sum() >= seen[:, t].sum():
            x, y, z = 1e3 * np.median(np.einsum("nji,nj->ni", turn[mine], off[mine, t]), axis=0)
            said.append(
                f"reflector '{name}' is {distance(float(np.median(np.linalg.norm(off[mine, t], axis=1))))} from where "
                f"the machine file has it, at {mine.sum()} of {seen[:, t].sum()} visits (in the end effector's axes "
                f"by {x:+.0f}, {y:+.0f}, {z:+.0f} mm): are its place there and the unit of its columns right?"
            )
    far = f"{gross.any(axis=1).sum()} of {visits.sum()} visits have a reading far from where the machine has the others"
    raise RecordingError(f"{recording.source}: {'; '.join(said) or far}")


def misread(machine: Machine, recording: Recording) -> NDArray[np.bool_]:
    """(N,) at which visits the wrench is not what the other visits of the load label read, if it hangs there rigidly.

    Before any fit, because such a row draws the compliances to itself and is fitted well.
    """
    out = np.zeros(len(recording), dtype=bool)
    if not recording.has_wrench:
        return out
    gravity = gravity_in_sensor(machine, frames(machine, recording.q))
    labels = np.array(recording.load)
    for label in set(recording.load) - {""}:
        mine = np.flatnonzero(labels == label)
        if len(mine) < OF_A_LABEL:
            continue
        wrong = _unlike_the_others(recording.wrench[mine], gravity[mine])
        if wrong.sum() <= max(1, SINGLE * len(mine)):
            out[mine] = wrong
    return out


def _unlike_the_others(wrench: Array, gravity: Array) -> NDArray[np.bool_]:
    """(K,) which wrenches (K, 6) are far from those of the rigid payload that the others say. How high its centre of
    mass is only visits at other tilts say: what a height may do to a moment is no reason."""
    wrong = np.zeros(len(wrench), dtype=bool)
    for _ in range(ROUNDS):
        held = payloads(wrench[~wrong], ("",) * int((~wrong).sum()), gravity[~wrong])[:1]
        unseen = unseen_moment(gravity[~wrong])
        before, wrong = wrong, np.zeros(len(wrench), dtype=bool)
        beside = wrench - weighs(held, gravity)
        if len(unseen):
            by_height = np.cross(unseen, gravity)
            by_height /= np.maximum(np.linalg.norm(by_height, axis=1, keepdims=True), 1e-12)
            beside[:, 3:] -= (beside[:, 3:] * by_height).sum(axis=1, keepdims=True) * by_height
        for rest, least in ((beside[:, :3], LOADED_N), (beside[:, 3:], LOADED_NM)):
            size = np.linalg.norm(rest, axis=1)
            wrong |= size > max(least, GROSS * float(np.median(size)))
        if (wrong == before).all() or wrong.mean() > SINGLE + 1 / len(wrench):
            break
    return wrong


def _silent_for_long(recording: Recording) -> list[str]:
    """Of every thermometer that said nothing for longer than what lags behind it can be carried over."""
    out = []
    for place, visits in recording.silent.items():
        rows = np.array(visits)
        run = max(np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1), key=len)
        first, last = recording.time[run[[0, -1]]]
        hours = (last - first) / 3600.0 if math.isfinite(last - first) else len(run) / VISITS_PER_HOUR
        if hours > SILENT_H:
            at = f"{len(rows)} of {many(len(recording), 'visit')}, from visit {run[0] + 1} on for {hours:.1f} h"
            out.append(f"temp_{place}_C is empty at {at}: what goes with it may be said to go with another thermometer")
    return out


def doubts(machine: Machine, recording: Recording) -> list[str]:
    """What is odd about a recording, or its machine's file, that can be used even so, each in a line."""
    said = [f"{machine.file}: {line}" for line in doubts_of_file(machine)]
    if recording.copies:
        said.append(
            f"{many(len(recording.copies), 'visit')} read the same as an earlier one to the last digit "
            f"({listed(recording.copies)}): are these rows copies?"
        )
    said += recording.unread()
    said += [
        f"temp_{place}_C leaps at {many(len(visits), 'visit')} ({listed(visits)}) and is back at once: "
        "taken for empty there"
        for place, visits in recording.spikes.items()
    ]
    said += _silent_for_long(recording)
    said += [
        f"temp_{place}_C is empty at every visit: nothing can be told to go with it"
        for place, values in recording.temperatures.items()
        if not np.isfinite(values).any()
    ]
    for place, values in recording.temperatures.items():
        middle = float(np.nanmedian(values)) if np.isfinite(values).any() else 0.0
        if middle > KELVIN_C:
            said.append(f"temp_{place}_C reads {middle:.0f} °C; are these kelvin?")
        elif place == "air" and middle > FAHRENHEIT_C:
            said.append(f"temp_{place}_C reads {middle:.0f} °C; is that degrees Fahrenheit?")
    if len(rows := np.flatnonzero(misread(machine, recording))):
        loads = ", ".join(dict.fromkeys(f"'{recording.load[k]}'" for k in rows))
        said.append(
            f"the wrench read at {many(len(rows), 'visit')} ({listed(rows)}) is not that of the load "
            f"{loads} at its other visits"
        )
    said += [line for line in (_hardly_loaded(recording), _mixed_labels(recording), _settled_before(recording)) if line]
    said += _where_it_was_not_sent(machine, recording)
    said += [
        f"{joint} rests {far} from where it was sent: what is fitted goes by q_{joint}, and a setpoint is as far off"
        for joint, far in rests_off(machine, recording).items()
    ]
    if loads := loads_not_measured(recording):
        same = "the columns Fx … Mz read the same at every visit"
        silent = same if recording.has_wrench else "nothing in columns Fx … Mz"
        said.append(
            f"{silent}, though loads change ({loads}): what they do to the machine cannot be told from its errors"
        )
    elif reads_the_same(recording):
        said.append(
            "the columns Fx … Mz read the same at every visit, to the last digit: does the force sensor measure? "
            "A load that was changed looks like a zero that jumped"
        )
    return said


def reads_the_same(recording: Recording) -> bool:
    """Whether a force sensor is read that says the same of every visit, and not nothing."""
    measured = recording.has_wrench and recording.wrench.any()
    return len(recording) > 1 and bool(measured) and wrench_never_changes(recording)


def _hardly_loaded(recording: Recording) -> str:
    """That no force ever came to what a sensor may read with nothing on it, though loads change."""
    loads, largest = set(recording.load) - {""}, float(np.linalg.norm(recording.wrench[:, :3], axis=1).max(initial=0.0))
    if len(loads) < 2 or not 0.0 < largest < LOADED_N:
        return ""
    return (
        f"no force is larger than {largest:.3g} N, though loads change ({_some(loads)}): are Fx … Mz kilonewtons and "
        "kilonewton metres?"
    )


def _mixed_labels(recording: Recording) -> str:
    """That weights differ within load labels as they do between any visits: whatever hung there, no label says it."""
    weight, labels = np.linalg.norm(recording.wrench[:, :3], axis=1), np.array(recording.load)
    loads = [load for load in set(recording.load) - {""} if (labels == load).sum() >= OF_A_LABEL]
    if len(loads) < 2 or not recording.has_wrench:
        return ""
    some = weight[np.isin(labels, loads)]
    within = np.concatenate([weight[labels == load] - np.median(weight[labels == load]) for load in loads])
    apart = float(np.median(np.abs(some - np.median(some))))
    if apart < LOADED_N or np.median(np.abs(within)) < MIXED * apart:
        return ""
    return (
        "the weight that the force sensor reads differs as much under one load label as between them "
        f"({_some(loads)}): do the labels belong to these rows?"
    )


def _settled_before(recording: Recording) -> str:
    """That a joint has stood still for longer than it is since the visit before, in which it moved."""
    since, settled = np.diff(recording.time), recording.settle_s[1:]
    told = np.isfinite(since) & np.isfinite(settled) & (np.diff(recording.q, axis=0) != 0).any(axis=1)
    longer = told & (settled > since)
    if told.sum() < OF_A_LABEL or longer.sum() <= told.sum() / 2:
        return ""
    return (
        f"settle_s is longer than the time since the visit before at {longer.sum()} of "
        f"{many(int(told.sum()), 'visit')} after a move: are these milliseconds?"
    )


def _some(loads: Collection[str]) -> str:
    """The first three of load labels."""
    return ", ".join(sorted(loads)[:3]) + (" …" if len(loads) > 3 else "")


def _where_it_was_not_sent(machine: Machine, recording: Recording) -> list[str]:
    """A line for each joint that stood elsewhere than where it was sent at half of the visits, by a good part of its
    travel: a damaged cell is no such."""
    out = []
    for k, joint in enumerate(machine.joints):
        q, sent = recording.q[:, k], recording.q_cmd[:, k]
        off = float(np.median(np.abs(q - sent)))
        if not np.ptp(sent) or not off > ELSEWHERE * float(np.ptp(sent)):  # of one place nobody can say what is far
            continue
        said = f"half of q_{joint.name} is {off:.4g} {joint.unit} or more from q_cmd_{joint.name}"
        late = {rows: float(np.median(np.abs(np.roll(q, -rows) - sent))) for rows in (1, -1)}
        rows = min(late, key=lambda n: late[n])
        how = "late" if rows > 0 else "early"
        said += f": is it one row {how}?" if late[rows] < BY_A_ROW * off else ": do these columns belong together?"
        out.append(said)
    return out


def rests_off(machine: Machine, recording: Recording) -> dict[str, str]:
    """Per joint that stands off where it was sent to, by what moves the reflectors by 50 µm and more: how far, at half
    of the visits. Of one that stands elsewhere by a good part of its travel `doubts` says more."""
    out = {}
    some = np.unique(np.linspace(0, len(recording) - 1, ENOUGH_TO_SAY).astype(np.int64))
    q = recording.q[some]
    moves = joint_jacobian(machine, frames(machine, q), point_positions(machine, q, machine.target_array))
    levers = np.linalg.norm(moves, axis=2).max(axis=1)  # (N, n) of the reflector that a joint moves farthest
    for k, joint in enumerate(machine.joints):
        sent = recording.q_cmd[:, k]
        low, middle, high = np.quantile(recording.q[:, k] - sent, (0.25, 0.5, 0.75))
        off = np.abs(recording.q[:, k] - sent)
        far = float(np.median(off))
        if np.median(off[some] * levers[:, k]) > AT_REST_M and far <= ELSEWHERE * float(np.ptp(sent)):
            unit = "mm" if joint.prismatic else "mrad"
            out[joint.name] = f"{1e3 * middle:+.3f} {unit} (half of the visits {1e3 * low:+.3f} to {1e3 * high:+.3f})"
    return out


def sides_seen(recording: Recording) -> dict[str, int]:
    """Per joint that came from one side alone, wherever that is told: the direction in which it came, −1 or 1."""
    out = {}
    for k, name in enumerate(recording.joint_names):
        told = recording.approach[:, k][recording.approach[:, k] != 0]
        if len(told) >= OF_A_LABEL and np.ptp(told) == 0:
            out[name] = int(told[0])
    return out


def loads_not_measured(recording: Recording) -> str:
    """The first three labels of loads that changed without a word of the wrench: no columns, or a sensor that always
    read the same. Empty where it did say."""
    loads = set(recording.load) - {""}
    return _some(loads) if len(loads) > 1 and wrench_never_changes(recording) else ""


def wrench_never_changes(recording: Recording) -> bool:
    """Whether nothing tells of a change of the wrench: no columns, or the same in them at every visit."""
    return bool((recording.wrench == recording.wrench[:1]).all())


def noisier_than_stated(machine: Machine, rms_mm: float, what: str) -> str:
    """That what is left at the reflectors is many times what the machine file's repeatability comes to, if it is: loads
    that no wrench tells of were 1.7 mm of noise, and the recording consistent."""
    stated = 1e3 * (machine.repeatability or 0.0) * 3**0.5 / RADIUS_986
    if not 0.0 < NOISIER * stated < rms_mm:
        return ""
    return (
        f"{what} of {rms_mm:.3g} mm rms is {rms_mm / stated:.0f} times that of the file's repeatability: what looks "
        "like noise may be something that no column here tells of"
    )


def apart_from_each_other(machine: Machine, instrument: float) -> str:
    """That reflectors of one visit scatter against each other by many times what the file says of the instrument
    (`instrument` [m], one coordinate, as identified), if they do: 0.067 mm beside 0.015 where one of four had been
    knocked by 0.36 mm."""
    stated = machine.tracker.position_sigma
    if len(machine.targets) < 2 or instrument < SCATTERED * stated:
        return ""
    where = "one may not sit where the machine file has it" if machine.tracker.targets_known else "one may have moved"
    return (
        f"reflectors scatter against each other by {1e3 * instrument:.3f} mm per coordinate, where the machine file "
        f"says {1e3 * stated:.3f} of the instrument: {where}, or the instrument errs; diagnose tells which"
    )


def far_off(errors: Array) -> NDArray[np.bool_]:
    """(N, T) whether a reading, off by `errors` (N, T, 3) [m], nan where lost, is none that a machine's errors explain:
    beside the others, and by more than 50 mm."""
    size = np.linalg.norm(errors, axis=2)
    return _gross(size, float(np.nanmedian(size)))


def _gross(size: Array, median: float) -> NDArray[np.bool_]:
    """Whether readings are so far off [m] beside the middle one that no machine errs like that."""
    return np.asarray(size > max(GROSS_M, GROSS * median))


def refuse_another_machine(machine: Machine, recording: Recording) -> None:
    """Raise RecordingError where half of the readings are far from the ideal machine wherever it is put: another
    machine, or in other units. Where the instrument stands does not count, as it may have been moved."""
    if is_another_machine(machine, recording):
        raise RecordingError(
            f"{recording.source}: half of the targets are more than {distance(misfit(machine, recording))} from where "
            f"'{machine.name}' has them, wherever it is put; is it this machine, and are they in metres?"
        )


def is_another_machine(machine: Machine, recording: Recording) -> bool:
    """Whether half of the readings are too far from the ideal machine, wherever it is put, to be its own."""
    if not recording.seen.any():
        return False
    size, ideal = _missed_anywhere(machine, recording)
    return _another_machine(float(np.median(size)), ideal)


def misfit(machine: Machine, recording: Recording) -> float:
    """Middle distance [m] between what was measured and the ideal machine, laid upon each other as rigid bodies."""
    return float(np.median(_missed_anywhere(machine, recording)[0]))


def _another_machine(middle: float, ideal: Array) -> bool:
    """Whether half of the readings being so far off [m] is too much, for targets that move over `ideal` (…, 3)."""
    spread = float(np.sqrt(ideal.reshape(-1, 3).var(axis=0).sum()))
    return middle > max(ANOTHER_MACHINE_M, ANOTHER_MACHINE * spread)


def _missed_anywhere(machine: Machine, recording: Recording) -> tuple[Array, Array]:
    """How far each reading is from the ideal machine (R,) [m], one laid upon the other as a rigid body; (R, 3) the
    ideal."""
    ideal = point_positions(machine, recording.q, machine.target_array)[recording.seen]
    measured = recording.points[recording.seen]
    laid = fit_rigid(measured, ideal)
    return np.linalg.norm(measured @ laid[:3, :3].T + laid[:3, 3] - ideal, axis=1), ideal


def _missed(machine: Machine, recording: Recording, kept: Recording) -> tuple[Array, Array]:
    """(N, T, 3) each reading less the ideal machine's [m], the frame placed by `kept`; (N, T, 3) the ideal."""
    frame, targets = machine.tracker.base, machine.target_array
    if not kept.seen.any():
        raise IdentificationFailed(f"{recording.source}: no target was measured")
    if frame is None:
        frame, targets = align(machine, kept, targets_free=not machine.tracker.targets_known)
    # a chain of frames is a hundred times a reading: of long recordings never all at once
    parts = [point_positions(machine, recording.q[at : at + BLOCK], targets) for at in range(0, len(recording), BLOCK)]
    ideal = np.concatenate(parts)
    return to_base(recording.points, frame) - ideal, ideal
