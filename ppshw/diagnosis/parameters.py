"""A finding's numbers under their names, with units and standard deviations: few, and such as a machine has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.library.jumps import ORDINALS
from ppshw.diagnosis.library.sampled import own_component
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.terms import COMPONENTS
from ppshw.terms.shapes import Column, Context, named_column
from ppshw.terms.shapes.time_and_heat import clock

Array = NDArray[np.float64]
Entries = dict[str, dict[str, Any]]
# Effects of which each has a finding per cause: another reflector, another joint that a coupling goes with.
BY_CAUSE = frozenset({"target_moved", "cross_coupling"})
OF_THE_JOINT = frozenset({"backlash", "friction_hysteresis", "zero_shift"})  # what a joint does along its own axis
SAME_PERIOD = 0.05  # by which periods of one wave may differ, whose height changes along its joint's travel
MORE_BY_LOAD = "added_at_twice_the_load"  # of lost motion


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
        out = {"peak_to_valley": _entry(abs(height), its_std, _unit(candidate.component))}
    elif candidate.effect == "wrench_error" and candidate.columns[0].args.get("time") == "cosine":
        out = _wandering(c, candidate, values, covariance)
    elif candidate.effect == "periodic_transmission":
        out = _wave(candidate, values, covariance)
    else:
        out = _one_by_one(candidate, values, std)
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
    point the other way than the frame's nearest to it, or between two."""
    out = np.ones(len(candidate.columns))
    if candidate.effect not in OF_THE_JOINT or candidate.joint is None:
        return out
    joint = c.machine.joint_names.index(candidate.joint)
    own = own_component(c, joint)
    out[[column.component == own for column in candidate.columns]] = 1.0 / c.machine.joints[joint].axis[own % 3]
    return out


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
        and [k.function for k in mine.columns] == [k.function for k in other.columns]
        and [k.args.get("form") for k in mine.columns] == [k.args.get("form") for k in other.columns]
    )


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
        out[f"change_{COMPONENTS[k]}"] = _entry(change, std, _unit(COMPONENTS[k]))
    return out


def _wandering(c: Context, candidate: Candidate, values: Array, covariance: Array) -> Entries:
    """How far the zero of each of a sensor's channels goes, from one extreme to the later one."""
    out: Entries = {}
    for k in dict.fromkeys(column.args["component"] for column in candidate.columns):
        mine = [j for j, column in enumerate(candidate.columns) if column.args["component"] == k]
        waves = np.stack([clock(c, "cosine", candidate.columns[j].args["tau"]) for j in mine], axis=1)
        change, std = _peak_to_valley(waves, values[mine], covariance[np.ix_(mine, mine)])
        name = WRENCH_COMPONENTS[k]
        out[f"{name}_zero_change"] = _entry(change, std, _load_unit(name))
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


# --- what is said one by one ----------------------------------------------------------------------------------------
def _wave(candidate: Candidate, values: Array, covariance: Array) -> Entries:
    unit = _unit(candidate.component)
    amplitude = max(float(np.hypot(values[0], values[1])), 1e-30)
    along = values[:2] / amplitude
    across = np.array([-along[1], along[0]])
    spread = [float(np.sqrt(max(float(way @ covariance[:2, :2] @ way), 0.0))) for way in (along, across)]
    return {
        "amplitude": _entry(amplitude, spread[0], unit),
        "phase": _entry(np.arctan2(values[1], values[0]), spread[1] / amplitude, "rad"),
    }


def _unit(component: str | None) -> str:
    return "m" if (component or "").startswith("t") else "rad" if (component or "").startswith("r") else "1"


def _one_by_one(candidate: Candidate, values: Array, std: Array) -> Entries:
    unit = _unit(candidate.component)
    names = [f"c{k + 1}" for k in range(len(values))]
    factors = np.ones(len(values))
    units = [unit] * len(values)
    if candidate.effect == "backlash":
        names[0], factors[0] = "gap", -2.0  # the axis stays half the gap behind on either side
        names[1:], factors[1:] = ["drag", "wear"][: len(names) - 1], -2.0  # of the gap, at the ends of the travel
        if rocks(candidate):
            across = COMPONENTS[candidate.columns[-1].component]
            names[1], units[1] = (f"sideways_{across}", "m") if across.startswith("t") else (f"rocking_{across}", "rad")
            factors[1] = -2.0
        if "pressed" in candidate.columns[-1].args:
            names[1], factors[1] = MORE_BY_LOAD, -2.0
    elif candidate.effect == "tracker_scale":
        grows = ["place" in column.args or "name" in column.args for column in candidate.columns]
        moves = [column.on == "frame" for column in candidate.columns]
        kelvin = any("place" in column.args for column in candidate.columns)
        per = "K" if kelvin else f"unit of {candidate.covariate}"
        axes = iter("xyz")
        names = [f"shift_{next(axes)}" if m else f"scale_per_{'K' if kelvin else 'unit'}" if g else "scale"
                 for m, g in zip(moves, grows, strict=True)]  # fmt: skip
        shifted = "m/K" if kelvin else f"m per standard deviation of {candidate.covariate}"
        units = [shifted if m else f"1/{per}" if g else "1" for m, g in zip(moves, grows, strict=True)]
    elif candidate.effect == "thermal_growth" and len(values) == len(COMPONENTS):
        names = [f"{component}_per_kelvin" for component in COMPONENTS]
        units = ["m/K" if component.startswith("t") else "rad/K" for component in COMPONENTS]
    elif candidate.effect == "thermal_growth":
        names = ["per_kelvin" + "_and_half_travel" * (c.function == "temperature_q") for c in candidate.columns]
        if len(set(names)) < len(names):  # two thermometers
            names = [f"{name}_{c.args['place']}" for name, c in zip(names, candidate.columns, strict=True)]
        units = ["1/K" if candidate.component is None else f"{unit}/K"] * len(values)
    elif candidate.effect == "friction_hysteresis":
        names, factors = ["lag", MORE_BY_LOAD][: len(values)], -factors  # a joint that lags stays behind
    elif candidate.effect == "zero_shift":
        back = candidate.columns[-1].function == "settling"
        names = ["step", "lost_again"] if back else [f"{word}step" for word in ORDINALS[: len(values)]]
    elif candidate.effect == "target_moved":
        whens = ORDINALS[: len(values) // 3]
        names, units = [f"{word}d{axis}" for word in whens for axis in "xyz"], ["m"] * len(values)
    elif candidate.effect == "moving_weight":
        names, units = _weight(candidate, unit)
    elif candidate.effect == "nonlinear_stiffness" and "load_width" in candidate.shape:
        names = ["half_slack"]
    elif candidate.effect in ("missing_compliance", "nonlinear_stiffness"):
        names = [f"compliance{k + 1 if len(values) > 1 else ''}" for k in range(len(values))]
        of_a_bearing = candidate.columns[0].function == "bearing"
        units = [_per_load("rad" if of_a_bearing else unit, candidate.covariate)] * len(values)
        if candidate.covariate == "load":  # in all directions, each by its own
            ways = [(COMPONENTS[c.component], WRENCH_COMPONENTS[c.args["component"]]) for c in candidate.columns]
            names = [f"compliance_{component}_by_{load}" for component, load in ways]
            units = [_per_load(_unit(component), load) for component, load in ways]
    elif candidate.columns[0].function == "weighed":
        names, units = ["share_of_what_no_payload_weighs"], ["1"]
    elif candidate.effect == "wrench_error":
        names = [misread_name(column.args, again=len(values) > 1) for column in candidate.columns]
        units = [misread_unit(column.args) for column in candidate.columns]
    elif candidate.effect == "clearance":
        names = ["half_gap", "half_difference"][: len(values)]
    elif candidate.effect == "creep" and candidate.component is None and candidate.columns[0].function == "creeping":
        ways = [(COMPONENTS[c.component], WRENCH_COMPONENTS[c.args["component"]]) for c in candidate.columns]
        one = len({load for _, load in ways}) == 1
        names, factors = [f"compliance_{comp}{'' if one else f'_by_{load}'}" for comp, load in ways], -factors
        units = [_per_load(_unit(comp), load) for comp, load in ways]
    elif candidate.effect == "creep":
        load = WRENCH_COMPONENTS[candidate.columns[0].component]
        whole = candidate.columns[0].function == "creep"  # a share of the deflection of a link, or of all of them
        name, of = ("share", "1") if whole else ("compliance", _per_load(unit, load))
        factors = factors if whole else -factors  # what is laid is what has not come yet
        second = f"slow_{name}" if "slow_tau_h" in candidate.shape else f"{name}_at_first"
        names, units = [name, second][: len(values)], [of] * len(values)
    return {
        name: _entry(v * f, s * abs(f), u) for name, v, s, f, u in zip(names, values, std, factors, units, strict=True)
    }


def rocks(candidate: Candidate) -> str:
    """About which axis a carriage rocks as it turns back, or along which it moves besides, for the sentence; empty
    where it does not."""
    across = [COMPONENTS[k.component] for k in candidate.columns if COMPONENTS[k.component] != candidate.component]
    if not across:
        return ""
    return f" and {'rocks' if across[0].startswith('r') else 'moves sideways'} ({across[0]})"


def misread_name(args: Mapping[str, Any], again: bool) -> str:
    """Which channel is off, and with what it goes: its own reading or another's, time (once, or again and again), or a
    temperature."""
    of, source = args["component"], args.get("source", -1)
    kelvin = f"_per_kelvin_{args['place']}_{args['tau']:g}_h" if "place" in args else ""
    hourly = "_per_hour" * (args.get("time") == "linear")
    if "turned" in args:
        return f"turned_{'xyz'[args['turned']]}" + "_versine" * (args.get("times") == 2)
    if of < 0:
        return "gain" + (f"_of_{args['only']}" if "only" in args else kelvin or hourly)
    name = WRENCH_COMPONENTS[of] + (f"_by_{WRENCH_COMPONENTS[source]}" if source >= 0 else "")
    if args.get("bent"):
        return f"{name}_{args['bent']}"
    if args.get("time") == "step":
        return f"{name}_zero_step" + f"_after_{args['tau']:.4f}_h" * again
    return name + (kelvin or "_zero" * (source < 0) + hourly)


def misread_unit(args: Mapping[str, Any]) -> str:
    """Unit of what a force sensor reads too much: a load, per hour or kelvin; a share of a reading, per load where it
    grows with it."""
    of, source = args["component"], args.get("source", -1)
    if "turned" in args:
        return "1" if args.get("times") == 2 else "rad"
    if "place" in args and (of < 0 or source == of):
        return "1/K"
    if of < 0:
        return "1/h" if args.get("time") == "linear" else "1"
    unit, by = _load_unit(WRENCH_COMPONENTS[of]), _load_unit(WRENCH_COMPONENTS[source])
    if source < 0:
        return f"{unit}/K" if "place" in args else f"{unit}/h" if args.get("time") == "linear" else unit
    if args.get("bent") and args["bent"] != "sided":
        return _per_load("1", WRENCH_COMPONENTS[source])
    return "1" if unit == by else _per_load(unit, WRENCH_COMPONENTS[source])


def _weight(candidate: Candidate, unit: str) -> tuple[list[str], list[str]]:
    if candidate.columns[0].function == "own_bend":
        return ["own_weight_share"], ["1"]
    if candidate.joint is None:
        return [f"compliance_{COMPONENTS[column.component]}" for column in candidate.columns], ["rad/(N m)"] * len(
            candidate.columns
        )
    if candidate.columns[0].function != "body_weight":
        return ["compliance"], [f"{unit}/(N m)"]
    names, units = [], []
    for args in (column.args for column in candidate.columns):
        mass, grows = args["what"] == "mass", args.get("grows", 0)
        name = "mass" if mass else f"shifted_mass_{args['what']}"
        names.append(name + ("", "_with_travel", "_with_travel_squared")[grows])
        units.append("kg" if mass else "kg m")
    return names, units


def shape_unit(c: Context, name: str, candidate: Candidate) -> str:
    if name.endswith(("load_width", "knee_load", "falls_at")):
        return _load_unit(candidate.covariate)
    if name in ("width", "past", "period", "at"):  # of the joint's own way, whichever component errs
        return c.machine.joints[c.machine.joint_names.index(str(candidate.joint))].unit
    return "h" if name.endswith("_h") else "1"


def _load_unit(covariate: str) -> str:
    return "N" if covariate.startswith("F") else "N m"


def _per_load(unit: str, covariate: str) -> str:
    return f"{unit}/N" if covariate.startswith("F") else f"{unit}/(N m)"
