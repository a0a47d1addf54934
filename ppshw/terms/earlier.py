"""The visits that a calibration was made from, as what a later recording goes on from.

Creep, friction and lagging temperatures remember. A recording that begins where the calibration's own ended is
predicted as if both were one; one that begins long after begins anew, since nobody knows what went between.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.machine import WRENCH_COMPONENTS, Machine
from ppshw.packed import packed, unpacked
from ppshw.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
# A pause after which nothing is known of what went before, unless the earlier visits had longer ones [s]; a choice.
PAUSE_S = 3600.0
SAME_S = 1e-3  # visits at the same moment are the same visit
IN_A_ROW = 3  # visits without times, at poses of earlier ones one after the other: the same visits
SAME_POSE = 1e-4  # that two recordings of one visit may round a joint's place apart [m, rad]
SAME_LOAD_N = 5.0  # and a tenth of it: forces under one label that differ by more are of two loads


def goes_on(earlier: Recording, first: float) -> bool:
    """Whether a visit at the time `first` [s] comes so soon after the earlier ones that it goes on from them."""
    before = earlier.time[earlier.time < first - SAME_S]
    if not len(before):
        return False
    longest = float(np.diff(earlier.time).max()) if len(earlier) > 1 else 0.0
    return first - float(before.max()) <= max(PAUSE_S, longest)


def known_from_to(end: float, hours: Array) -> tuple[float, float]:
    """Between which hours a course in time is carried on, for visits at `hours` (N,) since the start of a recording
    that ended at `end` [h]: for as long again as it lasted where they go on from it, or lead up to it, else to its end
    and its start."""
    if not len(hours):
        return 0.0, end
    pause = PAUSE_S / 3600.0
    return -end if hours[-1] >= -pause else 0.0, 2.0 * end if hours[0] <= end + pause else end


def shared(earlier: Recording, recording: Recording) -> Mask:
    """Which of the earlier visits are a recording's too, by their times (in order) and poses; where neither has times,
    the run of visits at whose poses, one after the other, it stands or begins."""
    out = np.zeros(len(earlier), dtype=bool)
    if not len(recording) or not len(earlier):
        return out
    if _untimed(earlier) and _untimed(recording):
        for at in range(len(earlier)):
            count = min(len(recording), len(earlier) - at)
            if count < min(IN_A_ROW, len(earlier)):
                break
            if np.abs(earlier.q[at : at + count] - recording.q[:count]).max() <= SAME_POSE:
                out[at : at + count] = True
                break
        return out
    time = recording.time
    if not (np.isfinite(time).all() and np.isfinite(earlier.time).all()):
        return out
    after = np.searchsorted(time, earlier.time)
    either = np.stack([np.minimum(after, len(time) - 1), np.maximum(after - 1, 0)])
    when = np.abs(earlier.time - time[either]) <= SAME_S
    where = np.abs(earlier.q - recording.q[either]).max(axis=2) <= SAME_POSE
    return np.asarray((when & where).any(axis=0))


def continued(earlier: Recording | None, recording: Recording) -> tuple[Recording, Mask]:
    """A recording with the earlier visits among its own, by time (those after it say what its loads weigh), and which
    rows are its own.

    It stands alone where a time of one of the two alone is unknown, where its visits are not in order, or where it
    begins long after. Without any times it has its place among the earlier visits, or follows them at once.
    """
    own = np.ones(len(recording), dtype=bool)
    if earlier is None or not len(recording) or not len(earlier):
        return recording, own
    if _untimed(earlier) and _untimed(recording):
        mine = shared(earlier, recording)
        begins = int(np.argmax(mine)) if mine.any() else len(earlier)
        when = np.concatenate([np.flatnonzero(~mine), begins + np.arange(len(recording)) / len(recording)])
        return _among(earlier.subset(~mine), recording, when)
    time = recording.time
    if not (np.isfinite(time).all() and np.isfinite(earlier.time).all()) or (np.diff(time) < 0).any():
        return recording, own
    useful = ~shared(earlier, recording)
    if not goes_on(earlier, float(time[0])):
        useful &= earlier.time > time[0]
    if not (useful & (earlier.time < time[-1])).any():
        return recording, own
    earlier = earlier.subset(useful)
    return _among(earlier, recording, np.concatenate([earlier.time, time]))


def _among(earlier: Recording, recording: Recording, when: Array) -> tuple[Recording, Mask]:
    """Both in the order of `when`, the earlier ones' and the recording's; and which rows are the recording's."""
    order = np.argsort(when, kind="stable")
    rows = np.arange(len(when)) >= len(earlier)
    return _joined(_told_apart(earlier, recording), recording).subset(order), rows[order]


def _untimed(recording: Recording) -> bool:
    return not np.isfinite(recording.time).any()


def another_load(one: Array, other: Array) -> bool:
    """Whether readings (N, 6) and (M, 6) under one label are of two loads, by their forces."""
    forces = [float(np.linalg.norm(wrench[:, :3], axis=1).mean()) for wrench in (one, other)]
    return abs(forces[0] - forces[1]) > SAME_LOAD_N + 0.1 * max(forces)


def _told_apart(earlier: Recording, recording: Recording) -> Recording:
    """The earlier visits with a load's label changed where the later ones have another load under it."""
    others = set()
    for label in set(earlier.load) & set(recording.load):
        if another_load(*(r.wrench[np.array(r.load) == label] for r in (earlier, recording))):
            others.add(label)
    return replace(earlier, load=tuple(f"earlier {label}" if label in others else label for label in earlier.load))


def _joined(first: Recording, then: Recording) -> Recording:
    """One after the other, of the first all but its readings; what is said of the whole is the second one's."""
    unread = replace(first, points=np.full((len(first), *then.points.shape[1:]), math.nan), extra_points={})
    whole = unread.followed_by(then)
    return replace(whole, has_wrench=then.has_wrench, source=then.source, sha256=then.sha256, misspelt=then.misspelt)


# --- in a calibration's file --------------------------------------------------------------------------------------
def as_dict(earlier: Recording) -> dict[str, Any]:
    """Everything but the readings, packed."""
    columns = {"time": earlier.time, "settle_s": earlier.settle_s}
    for k, joint in enumerate(earlier.joint_names):
        columns |= {f"q_{joint}": earlier.q[:, k], f"q_cmd_{joint}": earlier.q_cmd[:, k],
                    f"approach_{joint}": earlier.approach[:, k].astype(float)}  # fmt: skip
    columns |= {name: earlier.wrench[:, k] for k, name in enumerate(WRENCH_COMPONENTS)}
    columns |= {f"temp_{place}_C": values for place, values in earlier.temperatures.items()}
    columns |= {f"cov_{name}": values for name, values in earlier.covariates.items()}
    columns |= {} if earlier.load_age_s is None else {"load_age_s": earlier.load_age_s}
    table = packed(np.array(list(columns.values())))
    return {
        "count": len(earlier), "load": list(earlier.load), "columns": list(columns),
        "has_wrench": earlier.has_wrench,
        "encoding": f"column after column, {table['encoding']}", "data": table["data"],
    }  # fmt: skip


def from_dict(data: dict[str, Any], machine: Machine, source: str, sha256: str) -> Recording:
    """What `as_dict` wrote. Raises KeyError, TypeError, ValueError or zlib.error where it is damaged."""
    count, names = int(data["count"]), [str(name) for name in data["columns"]]
    values = unpacked({"shape": [len(names), count], "data": data["data"]})
    columns = dict(zip(names, values, strict=True))
    if len(data["load"]) != count:
        raise ValueError(f"visits: {len(data['load'])} loads for {count} visits")
    joints = machine.joint_names
    q, q_cmd, approach = (
        np.stack([columns[f"{prefix}_{j}"] for j in joints], axis=1) for prefix in ("q", "q_cmd", "approach")
    )
    wrench = np.stack([columns[c] for c in WRENCH_COMPONENTS], axis=1)
    for name, found in {"q": q, "q_cmd": q_cmd, "approach": approach, "wrench": wrench}.items():
        if not np.isfinite(found).all():
            raise ValueError(f"visits: {name} holds values that are no numbers")
    return Recording(
        joints, tuple(machine.targets), columns["time"], ("",) * count, tuple(map(str, data["load"])), q, q_cmd,
        approach.astype(np.int64), columns["settle_s"], wrench,
        np.full((count, len(machine.targets), 3), math.nan), {},
        {n[5:-2]: v for n, v in columns.items() if n.startswith("temp_")},
        {n[4:]: v for n, v in columns.items() if n.startswith("cov_")},
        bool(data["has_wrench"]), source, sha256, load_age_s=columns.get("load_age_s"),
    )  # fmt: skip
