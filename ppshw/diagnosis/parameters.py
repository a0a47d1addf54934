"""A finding's numbers under their names, with units and standard deviations: few, and such as a machine has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.found import LOST_MOTION
from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.library.sampled import own_component
from ppshw.diagnosis.parameter_names import load_unit, shape_unit, told_of, unit_of
from ppshw.diagnosis.sensor_words import numbers_by_gravity
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.terms import COMPONENTS
from ppshw.terms.shapes import Column, Context, named_column
from ppshw.terms.shapes.context import ALONG
from ppshw.terms.shapes.time_and_heat import clock

Array = NDArray[np.float64]
Entries = dict[str, dict[str, Any]]
# Effects of which each has a finding per cause: another reflector, another joint that a coupling goes with.
BY_CAUSE = frozenset({"target_moved", "cross_coupling"})
OF_THE_JOINT = frozenset({"backlash", "friction_hysteresis", "zero_shift"})  # what a joint does along its own axis
SAME_PERIOD = 0.05  # by which periods of one wave may differ, whose height changes along its joint's travel


def numbers_of(
    c: Context, candidate: Candidate, values: Array, covariance: Array, spread: Mapping[str, float] | None = None
) -> Entries:
    """Values (k,) of a candidate's k columns with their covariance (k, k), and its nonlinear parameters, under their
    names, with units.

    Functions that bend as they need have coefficients that mean nothing one by one: they are said as what they do, a
    drift as how far it goes along and about each axis, a coupling as its height from peak to valley.

    spread  standard deviations of the nonlinear parameters, as in `spread_of`
    """
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    along = along_its_axis(c, candidate)
    values, std = values * along, std * np.abs(along)
    if candidate.effect == "drift":
        out = _drift(c, candidate, values, covariance)
    elif candidate.effect == "cross_coupling":
        height, its_std = _peak_to_valley(courses(c, candidate.columns), values, covariance)
        out = {"peak_to_valley": _entry(abs(height), its_std, unit_of(candidate.component))}
    elif candidate.effect == "wrench_error" and candidate.columns[0].args.get("time") == "cosine":
        out = _wandering(c, candidate, values, covariance)
    elif candidate.effect == "periodic_transmission":
        out = _wave(candidate, values, covariance)
    else:
        out = {
            told.name: _entry(v * told.factor, s * abs(told.factor), told.unit)
            for told, v, s in zip(told_of(candidate), values, std, strict=True)
        }
    if candidate.columns[0].function == "weighed":
        out |= {number.name: _entry(number.value, number.std, number.unit) for number in numbers_by_gravity(c)}
    if (middle := scale_holds_at(c, candidate)) is not None:
        per = "°C" if "place" in candidate.columns[1].args else f"unit of {candidate.covariate}"
        out["scale_holds_at"] = _entry(middle, None, per)
    for name, value in candidate.shape.items():
        unit = shape_unit(c, name, candidate)
        out[name] = _entry(value, (spread or {}).get(name), unit)
    return out


def scale_holds_at(c: Context, candidate: Candidate) -> float | None:
    """At which temperature, or value of another column, a constant scale beside one that goes with it holds: at the
    recording's mean. None where there is no such pair."""
    if candidate.effect != "tracker_scale" or len(candidate.columns) < 2 or candidate.columns[0].args:
        return None
    grows = candidate.columns[1].args
    if "place" in grows:
        return c.frozen(f"mean.{grows['place']}", float(np.mean(c.recording.temperatures[grows["place"]])))
    return c.frozen(f"mean of {grows['name']}", float(np.nanmean(named_column(c, grows["name"]))))


def along_its_axis(c: Context, candidate: Candidate) -> Array:
    """(k,) by what a candidate's coefficients are multiplied to be along its joint's own axis, or about it: that may
    point the other way than the frame's."""
    out = np.ones(len(candidate.columns))
    if candidate.effect not in OF_THE_JOINT:
        return out
    of = None if candidate.joint is None else c.machine.joint_names.index(candidate.joint)
    for k, column in enumerate(candidate.columns):
        joint = column.frame - 1 if of is None else of
        if column.component == (own := own_component(c, joint)) != ALONG:
            out[k] = np.sign(c.machine.own_ways[joint, own])
    return out


def runs_ahead(c: Context, candidate: Candidate, along: Array) -> bool:
    """Whether what joint and drive lose to each other carries the joint on, which no drive does: of what goes along its
    own way. along (k,): the coefficients, by `along_its_axis`."""
    if candidate.effect not in LOST_MOTION or candidate.joint is None:
        return False
    own = own_component(c, c.machine.joint_names.index(candidate.joint))
    return bool(candidate.columns[0].component == own and lost_by(candidate, along) > 0)


def lost_by(candidate: Candidate, values: Array) -> float:
    """What joint and drive lose to each other, of coefficients (k,): where it is more or less from some moment on,
    whichever is more."""
    first = float(values[0])
    later = first + sum(float(v) for v, column in zip(values, candidate.columns, strict=True) if "since" in column.args)
    return max(first, later, key=abs)


def of_one_wave(one: float | None, other: float | None) -> bool:
    """Whether two periods are nearly the same, or one of them none."""
    return one is None or other is None or abs(other / one - 1.0) < SAME_PERIOD


def is_of(said: Mapping[str, Any], candidate: Candidate) -> bool:
    """Whether a finding as answered is of a candidate's effect: of its name, its joint, its cause where each has one of
    its own, and of waves of its period."""
    named = (said["effect"], said["joint"]) == (candidate.effect, candidate.joint)
    cause = candidate.effect not in BY_CAUSE or said["covariate"] == candidate.covariate
    period = said["parameters"].get("period", {}).get("value")
    return named and cause and of_one_wave(period, candidate.shape.get("period"))


def spread_of(tried: Tried, best: int, evidence: Array) -> dict[str, float]:
    """Standard deviations of a candidate's nonlinear parameters about its own, over forms that differ in nothing else.

    They stand on a grid, of which each point speaks for what is nearest to it; where the library has one value alone
    there is none.

    evidence  (C,) log evidence of all candidates
    """
    mine = tried.candidates[best]
    if not mine.shape:
        return {}
    kin = _kin(tried, best)
    said = evidence[kin] + tried.log_share[kin]
    weights = np.exp(said - said.max())
    weights /= weights.sum()
    out = {}
    for name, value in mine.shape.items():
        grid = np.array([tried.candidates[j].shape[name] for j in kin])
        points = np.unique(grid)
        if len(points) > 1:
            at = int(np.argmin(np.abs(points - value)))
            below, above = points[max(at - 1, 0)], points[min(at + 1, len(points) - 1)]
            cell = (above - below) / (2.0 if 0 < at < len(points) - 1 else 1.0)
            out[name] = float(np.sqrt(weights @ (grid - value) ** 2 + cell**2 / 12.0))
    return out


def pulled_along(tried: Tried, best: int, spread: Mapping[str, float]) -> Array:
    """(k, s) by how much a candidate's coefficients change as each of its s nonlinear parameters does by its standard
    deviation: a lag of 0.120 mm that winds up over a width between two of the grid was 0.131 +- 0.002 otherwise.

    tried  with the others taken up;  spread  as in `spread_of`
    """
    mine = tried.candidates[best]
    if not spread:
        return np.zeros((len(mine.columns), 0))
    own, family, out = tried.fitted(best), [(j, tried.candidates[j]) for j in _kin(tried, best)], []
    for name, std in spread.items():
        along = [
            (abs(k.shape[name] - mine.shape[name]), j) for j, k in family
            if k.shape == {**mine.shape, name: k.shape[name]}
        ]  # fmt: skip
        if steps := [one for one in along if one[0] > 0]:
            step, nearest = min(steps)
            out.append((tried.fitted(nearest) - own) * std / step)
    return np.array(out).reshape(-1, len(own)).T


def _kin(tried: Tried, best: int) -> NDArray[np.int64]:
    """A candidate and those of its name that differ from it in nonlinear parameters alone, of one wave."""
    mine, namesakes = tried.candidates[best], np.flatnonzero(tried.name_of == tried.name_of[best])
    return np.array([
        j for j in namesakes
        if _differs_in_shape_alone(mine, tried.candidates[j])
        and of_one_wave(mine.shape.get("period"), tried.candidates[j].shape.get("period"))
    ])  # fmt: skip


def _differs_in_shape_alone(mine: Candidate, other: Candidate) -> bool:
    """Of two with one name."""
    return (
        (mine.frame, mine.component, mine.covariate) == (other.frame, other.component, other.covariate)
        and mine.shape.keys() == other.shape.keys()
        and [_kind(k) for k in mine.columns] == [_kind(k) for k in other.columns]
    )


def _kind(column: Column) -> tuple[str, dict[str, Any]]:
    """What a column is but for numbers and moments that stand on a grid: its function, and by which load, channel, …"""
    return column.function, {name: value for name, value in column.args.items() if isinstance(value, int | str)}


def _entry(value: float, std: float | None, unit: str) -> dict[str, Any]:
    return {"value": float(value), "std": None if std is None else float(std), "unit": unit}


# --- what bends as it needs -----------------------------------------------------------------------------------------
def _drift(c: Context, candidate: Candidate, values: Array, covariance: Array) -> Entries:
    """How far the base goes along and about each of its axes: from one extreme to the later one."""
    out: Entries = {}
    for k in dict.fromkeys(column.component for column in candidate.columns):
        mine = [j for j, column in enumerate(candidate.columns) if column.component == k]
        there = courses(c, [candidate.columns[j] for j in mine])
        change, std = _peak_to_valley(there, values[mine], covariance[np.ix_(mine, mine)])
        out[f"change_{COMPONENTS[k]}"] = _entry(change, std, unit_of(COMPONENTS[k]))
    return out


def _wandering(c: Context, candidate: Candidate, values: Array, covariance: Array) -> Entries:
    """How far the zero of each of a sensor's channels goes, from one extreme to the later one."""
    out: Entries = {}
    for k in dict.fromkeys(column.args["component"] for column in candidate.columns):
        mine = [j for j, column in enumerate(candidate.columns) if column.args["component"] == k]
        waves = np.stack([clock(c, "cosine", candidate.columns[j].args["tau"]) for j in mine], axis=1)
        change, std = _peak_to_valley(waves, values[mine], covariance[np.ix_(mine, mine)])
        name = WRENCH_COMPONENTS[k]
        out[f"{name}_zero_change"] = _entry(change, std, load_unit(name))
    return out


def courses(c: Context, columns: Sequence[Column]) -> Array:
    """(N, k) the functions of k columns on a frame."""
    return np.stack([column.value(c) for column in columns], axis=1)


def _peak_to_valley(functions: Array, values: Array, covariance: Array) -> tuple[float, float]:
    """The later extreme less the earlier one of what k functions (N, k) make together, and its standard deviation."""
    course = functions @ values
    first, last = sorted((int(np.argmin(course)), int(np.argmax(course))))
    apart = functions[last] - functions[first]
    return float(apart @ values), float(np.sqrt(max(apart @ covariance @ apart, 0.0)))


def _wave(candidate: Candidate, values: Array, covariance: Array) -> Entries:
    unit = unit_of(candidate.component)
    amplitude = max(float(np.hypot(values[0], values[1])), 1e-30)
    along = values[:2] / amplitude
    across = np.array([-along[1], along[0]])
    spread = [float(np.sqrt(max(float(way @ covariance[:2, :2] @ way), 0.0))) for way in (along, across)]
    return {
        "amplitude": _entry(amplitude, spread[0], unit),
        "phase": _entry(np.arctan2(values[1], values[0]), spread[1] / amplitude, "rad"),
    }
