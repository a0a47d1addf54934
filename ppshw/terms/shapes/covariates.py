"""A recording's columns by their names, what is made of them, and smooth functions of any of these: (N,).

A column is in its own unit (m, rad, N, N·m, °C, s, but time in h); a smooth function of it is a pure number.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppshw.machine import WRENCH_COMPONENTS
from ppshw.recording import STANDSTILL
from ppshw.terms.history import changed_at, former, hours_since_change, lagged, way_since_reversal
from ppshw.terms.shapes.context import Context
from ppshw.terms.shapes.sight import incidence, rays_to, seen_at
from ppshw.terms.shapes.wrenches import payloads_of

Array = NDArray[np.float64]
LEAST_H = 1e-4  # between two visits
QUANTILES = 41  # that the ranks of a column are kept by


def loads_came(c: Context) -> Array:
    """(N,) [h] when the load of each visit came: see `changed_at`."""
    return c.once(("loads came",), lambda: changed_at(c.recording.load, c.hours, c.recording.load_age_s))


OF_A_JOINT = ("q_", "move_", "way_", "stay_", "pace_", "rest_", "approach_")


def named_column(c: Context, name: str) -> Array:
    """A column by its contract name: q_<joint>, time, temp_<place>_C, settle_s, Fx … Mz, cov_<name>; or what is made of
    one: on_<frame>_<Fx … Mz> (what acts on that frame), move_<joint> (from the visit before), way_<joint> (since it
    turned back), stay_<joint> (how often it has moved until then), pace_<joint> (way a joint went since the visit
    before, per hour), rest_<joint> (how far from its setpoint it came to rest), reach (from the base to the last
    frame), azimuth, elevation and distance (of the reflectors from the instrument, the first from its mean), incidence
    (of the beam along that axis of the end effector where it changes most), pause (since the visit before, h), load and
    former_load (mass of this payload and of the one before, kg), mounting (how often the load was changed until then),
    previous_<column> (at the visit before), late_<hours>_<column> (first-order lag)."""
    r, joints = c.recording, c.machine.joint_names
    if name.startswith("q_"):
        return np.asarray(r.q[:, joints.index(name[2:])])
    if name.startswith("previous_"):
        values = named_column(c, name[9:])
        return np.concatenate([values[:1], values[:-1]])
    if name.startswith("on_"):
        frame, load = name[3:].rsplit("_", 1)
        return np.asarray(c.wrenches[:, c.machine.frame_names.index(frame), WRENCH_COMPONENTS.index(load)])
    if name.startswith("move_"):
        q = r.q[:, joints.index(name[5:])]
        return np.concatenate([[0.0], np.diff(q)])
    if name.startswith("stay_"):
        q = r.q[:, joints.index(name[5:])]
        return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q)) > STANDSTILL * float(np.ptp(q)))])
    if name.startswith("pace_"):
        gone = np.abs(np.diff(r.q[:, joints.index(name[5:])]))
        return np.concatenate([[0.0], gone / np.maximum(np.diff(c.hours), LEAST_H)])
    if name.startswith("rest_"):
        k = joints.index(name[5:])
        return np.asarray(r.q[:, k] - r.q_cmd[:, k])
    if name in ("azimuth", "elevation"):
        at = seen_at(c, name)[0].mean(axis=1)
        return np.asarray(np.angle(np.exp(1j * at) / np.exp(1j * at).mean()))
    if name == "incidence":
        seen = incidence(c)[1].mean(axis=1)
        return np.asarray(seen[:, int(np.argmax(seen.std(axis=0)))])
    if name == "distance":
        return np.asarray(np.linalg.norm(rays_to(c), axis=2).mean(axis=1))
    if name == "reach":
        return np.asarray(np.linalg.norm(c.chain[:, -1, :3, 3] - c.chain[:, 0, :3, 3], axis=1))
    if name.startswith("way_"):
        k = joints.index(name[4:])
        return way_since_reversal(r.q[:, k], r.approach[:, k])
    if name.startswith("approach_"):
        return np.asarray(r.approach[:, joints.index(name[9:])], dtype=float)
    if name.startswith("temp_"):
        return np.asarray(r.temperatures[name[5:-2]])
    if name == "time":
        return np.asarray(c.hours)
    if name == "pause":
        pauses = np.round(np.diff(c.hours), 7)  # a clock's own rounding is no change of pace
        return np.concatenate([[np.median(pauses) if len(pauses) else 0.0], pauses])
    if name == "since_load_change":
        return hours_since_change(r.load, c.hours, loads_came(c))
    if name == "mounting":
        return np.concatenate([[0.0], np.cumsum(np.array(r.load[1:]) != np.array(r.load[:-1]))])
    if name in ("load", "former_load"):
        mass = payloads_of(c)[:, 0]
        return mass if name == "load" else former(mass, r.load)
    if name == "settle_s":
        return np.asarray(r.settle_s)
    if name.startswith("cov_"):
        return np.asarray(r.covariates[name[4:]])
    if name.startswith("late_"):
        tau, late = name[5:].split("_", 1)
        return lagged(named_column(c, late), c.hours, float(tau))
    return np.asarray(r.wrench[:, WRENCH_COMPONENTS.index(name)])


def bare(name: str) -> str:
    """The column that a lagged one, or one of the visit before, is made of."""
    while name.startswith(("previous_", "late_")):
        name = name[9:] if name.startswith("previous_") else name[5:].split("_", 1)[1]
    return name


def whose(name: str) -> str | None:
    """The joint, frame or thermometer that a column is of; None where it is of none."""
    name = bare(name)
    if name.startswith(OF_A_JOINT):
        return name.split("_", 1)[1]
    if name.startswith("on_"):
        return name[3:].rsplit("_", 1)[0]
    return name[5:-2] if name.startswith("temp_") else None


def speaks_of(name: str, column: str) -> bool:
    """Whether a column is another one, or is made of it, or is that load on a frame."""
    plain = bare(name)
    on_a_frame = plain.startswith("on_") and plain.rsplit("_", 1)[1] == column
    return column in (name, plain) or on_a_frame or (plain, column) == ("former_load", "load")


def columns_at(c: Context, names: tuple[str, ...]) -> Array:
    """(N, d) columns by name; nan where this recording does not have one."""
    out = np.full((len(c.recording), len(names)), np.nan)
    for k, name in enumerate(names):
        try:
            out[:, k] = named_column(c, name)
        except KeyError:
            continue
    return out


def covariate(c: Context, name: str, knot: int = 0, count: int = 1, evenly: bool = False) -> Array:
    """A smooth function of any column: the knot-th of `count` Gaussian bumps over its ranks in the recording that it
    was made from, or evenly over its values, nothing beyond what was seen there (but of time); count 1: the column."""
    if count == 1:
        return c.once(("standard", name), lambda: _standard(c, name)[1])
    seen, at = c.once(("evenly" if evenly else "ranks", name), lambda: _ranks(c, name, 2 if evenly else QUANTILES))
    return np.asarray(seen * bump(at, knot, count))


def covariate_pair(
    c: Context, first: str, second: str, a: int, b: int, count: int, in_proportion: bool = False
) -> Array:  # fmt: skip
    """A smooth function of two columns: bump `a` of the first, or the first itself, times bump `b` of the second."""
    return covariate(c, first, a, 1 if in_proportion else count) * covariate(c, second, b, count)


def bump(at: Array, knot: int, count: int) -> Array:
    """The knot-th of `count` Gaussian bumps, evenly over 0 … 1."""
    return np.asarray(np.exp(-0.5 * ((at * (count - 1) - knot) / 1.2) ** 2))


def above_mean(c: Context, name: str) -> Array:
    """A column, in its unit, less its mean in the recording that it was made from; 0 where it is empty."""
    return c.once(("above mean", name), lambda: _standard(c, name)[0])


def _standard(c: Context, name: str) -> tuple[Array, Array]:
    """(N,) a column less its mean, and in units of its spread; 0 where it does not vary."""
    values = named_column(c, name)
    middle = c.frozen(f"mean of {name}", float(np.nanmean(values)))
    values = np.nan_to_num(values - middle)
    spread = c.frozen(f"spread of {name}", float(values.std()))
    return values, values / spread if spread else np.zeros(len(values))


def _ranks(c: Context, name: str, count: int) -> Array:
    """(2, N) whether a column is within what was seen, and its rank 0 … 1 there, straight between `count` quantiles: of
    two its place between least and greatest. Nothing of one that does not vary. What went on with time is held where it
    was when nobody looked any more."""
    values, _ = _standard(c, name)
    if not c.frozen(f"spread of {name}", 0.0):
        return np.zeros((2, len(values)))
    places = np.linspace(0.0, 1.0, count)
    quantiles = [
        c.frozen(f"quantile {p * (QUANTILES - 1):.0f} of {name}", q)
        for p, q in zip(places, np.quantile(values, places).tolist(), strict=True)
    ]
    seen = (values >= quantiles[0]) & (values <= quantiles[-1]) | (name == "time")
    return np.stack([seen, np.interp(values, quantiles, places)])
