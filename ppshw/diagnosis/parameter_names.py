"""Under which name, in which unit and by which factor each of a candidate's coefficients is said."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.library.jumps import ALL, ORDINALS
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.terms import COMPONENTS
from ppshw.terms.shapes import Column, Context
from ppshw.terms.shapes.context import ALONG

MORE_BY_LOAD = "added_at_twice_the_load"  # of lost motion


class Told(NamedTuple):
    """factor  times the coefficient is what is said"""

    name: str
    unit: str
    factor: float = 1.0


def told_of(candidate: Candidate) -> list[Told]:
    """One for each of a candidate's columns."""
    return OF_EFFECT.get(candidate.effect, _plainly)(candidate)


def _plainly(candidate: Candidate) -> list[Told]:
    return [Told(f"c{k + 1}", unit_of(candidate.component)) for k in range(len(candidate.columns))]


# --- a joint --------------------------------------------------------------------------------------------------------
def _backlash(candidate: Candidate) -> list[Told]:
    unit, last = unit_of(candidate.component), candidate.columns[-1]
    names = [(name, unit) for name in ("gap", "drag", "wear")[: len(candidate.columns)]]
    if "since" in last.args:
        names[1] = "gap_added_later", unit
    if across := _sideways(candidate):
        names[1] = across
    if more := _by_its_load(last, unit):
        names[1] = more
    return [Told(name, its, -2.0) for name, its in names]  # the axis stays half the gap behind on either side


def _sideways(candidate: Candidate) -> tuple[str, str] | None:
    """Name and unit of how far a carriage goes sideways or rocks as it turns back; None where it does not."""
    if not rocks(candidate):
        return None
    across = COMPONENTS[candidate.columns[-1].component]
    return (f"sideways_{across}", "m") if across.startswith("t") else (f"rocking_{across}", "rad")


def rocks(candidate: Candidate) -> str:
    """About which axis a carriage rocks as it turns back, or along which it moves besides, for the sentence; empty
    where it does not."""
    frames = [k.component for k in candidate.columns if k.component != ALONG]
    across = [COMPONENTS[component] for component in frames if COMPONENTS[component] != candidate.component]
    if not across:
        return ""
    return f" and {'rocks' if across[0].startswith('r') else 'moves sideways'} ({across[0]})"


def _friction(candidate: Candidate) -> list[Told]:
    unit = unit_of(candidate.component)
    more = [_sideways(candidate) or _by_its_load(column, unit) for column in candidate.columns[1:]]
    return [Told(*said, -1.0) for said in (("lag", unit), *more) if said]  # a joint that lags stays behind


def _by_its_load(column: Column, unit: str) -> tuple[str, str] | None:
    """Name and unit of what goes with the loads upon a joint of what it loses."""
    if "tilted" in column.args:
        load = WRENCH_COMPONENTS[column.args["tilted"]]
        return f"added_by_{load}", per_load(unit, load)
    return (MORE_BY_LOAD, unit) if "pressed" in column.args else None


def _jump(candidate: Candidate) -> list[Told]:
    if candidate.joint is None:  # joints by their place in the chain
        return [Told(f"step_of_joint_{k.frame}", unit_of(COMPONENTS[k.component])) for k in candidate.columns]
    unit = unit_of(candidate.component)
    if candidate.columns[-1].function == "settling":
        return [Told("step", unit), Told("lost_again", unit)]
    return [Told(f"{word}step", unit) for word in ORDINALS[: len(candidate.columns)]]


# --- what is warm ---------------------------------------------------------------------------------------------------
def _growth(candidate: Candidate) -> list[Told]:
    if len(candidate.columns) == len(COMPONENTS):
        return [Told(f"{component}_per_kelvin", f"{unit_of(component)}/K") for component in COMPONENTS]
    unit = "1/K" if candidate.component is None else f"{unit_of(candidate.component)}/K"
    names = ["per_kelvin" + "_and_half_travel" * (c.function == "temperature_q") for c in candidate.columns]
    if len(set(names)) < len(names):  # two thermometers
        names = [f"{name}_{c.args['place']}" for name, c in zip(names, candidate.columns, strict=True)]
    return [Told(name, unit) for name in names]


# --- instruments ----------------------------------------------------------------------------------------------------
def _scale(candidate: Candidate) -> list[Told]:
    def told() -> Iterator[Told]:
        axes = iter("xyz")
        kelvin = any("place" in column.args for column in candidate.columns)
        for column in candidate.columns:
            if column.on == "frame":
                per = "m/K" if kelvin else f"m per standard deviation of {candidate.covariate}"
                yield Told(f"shift_{next(axes)}", per)
            elif "place" in column.args or "name" in column.args:
                per = "K" if kelvin else f"unit of {candidate.covariate}"
                yield Told(f"scale_per_{'K' if kelvin else 'unit'}", f"1/{per}")
            else:
                yield Told("scale", "1")

    return list(told())


def _reflector(candidate: Candidate) -> list[Told]:
    if candidate.covariate == ALL:
        return [Told(f"d{axis}", "m") for axis in "xyz"] + [Told(f"turned_{axis}", "rad") for axis in "xyz"]
    return [Told(f"{word}d{axis}", "m") for word in ORDINALS[: len(candidate.columns) // 3] for axis in "xyz"]


def _misread(candidate: Candidate) -> list[Told]:
    if candidate.columns[0].function == "weighed":
        return [Told("share_of_what_no_payload_weighs", "1")]
    again = len(candidate.columns) > 1
    return [
        # of a turn what is read is turned back: by deflections its versine comes less than nothing (`misread`)
        Told(
            misread_name(column.args, again), misread_unit(column.args), -1.0 if column.args.get("times") == 2 else 1.0
        )
        for column in candidate.columns
    ]


def misread_name(args: Mapping[str, Any], again: bool) -> str:
    """Which channel is off, and with what it goes: its own reading or another's, time (once, or again and again), or a
    temperature."""
    of, source = args["component"], args.get("source", -1)
    kelvin = f"_per_kelvin_{args['place']}_{args['tau']:g}_h" if "place" in args else ""
    hourly = "_per_hour" * (args.get("time") == "linear")
    if "turned" in args:
        return f"turned_{'xyz'[args['turned']]}" + "_versine" * (args.get("times") == 2)
    if "about" in args:
        return f"moments_about_{'xyz'[args['about']]}"
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
    if "about" in args:
        return "m"
    if "place" in args and (of < 0 or source == of):
        return "1/K"
    if of < 0:
        return "1/h" if args.get("time") == "linear" else "1"
    unit, by = load_unit(WRENCH_COMPONENTS[of]), load_unit(WRENCH_COMPONENTS[source])
    if source < 0:
        return f"{unit}/K" if "place" in args else f"{unit}/h" if args.get("time") == "linear" else unit
    if args.get("bent") and args["bent"] != "sided":
        return per_load("1", WRENCH_COMPONENTS[source])
    return "1" if unit == by else per_load(unit, WRENCH_COMPONENTS[source])


# --- what bears loads -----------------------------------------------------------------------------------------------
def _clearance(candidate: Candidate) -> list[Told]:
    unit = unit_of(candidate.component)
    return [Told(name, unit) for name in ("half_gap", "half_difference")[: len(candidate.columns)]]


def _compliance(candidate: Candidate) -> list[Told]:
    if "load_width" in candidate.shape and candidate.effect == "nonlinear_stiffness":
        slack = Told("half_slack", unit_of(candidate.component))
        in_proportion = Told("compliance", per_load(unit_of(candidate.component), candidate.covariate))
        return [slack, in_proportion][: len(candidate.columns)]
    if candidate.component is None and candidate.columns[0].function == "load":  # in all directions
        return [Told(f"compliance_{way}_by_{load}", per_load(unit_of(way), load)) for way, load in _ways(candidate)]
    of_a_bearing = candidate.columns[0].function == "bearing"
    unit = per_load("rad" if of_a_bearing else unit_of(candidate.component), candidate.covariate)
    several = len(candidate.columns) > 1
    return [Told(f"compliance{k + 1 if several else ''}", unit) for k in range(len(candidate.columns))]


def _creep(candidate: Candidate) -> list[Told]:
    """What is laid is what has not come yet; but of a share of the deflection of a link, or of all of them."""
    function = candidate.columns[0].function
    if candidate.component is None and function == "creeping":
        ways = _ways(candidate)
        several = len({load for _, load in ways}) > 1
        return [
            Told(f"compliance_{way}" + f"_by_{load}" * several, per_load(unit_of(way), load), -1.0)
            for way, load in ways
        ]
    by_weight = candidate.columns[0].args.get("component", 0) < 0
    load = WRENCH_COMPONENTS[0 if by_weight else candidate.columns[0].component]  # a force
    name, unit, factor = "share", "1", 1.0
    if by_weight:
        name, unit, factor = "compliance_by_weight", per_load(unit_of(candidate.component), load), -1.0
    elif function != "creep":
        name, unit, factor = "compliance", per_load(unit_of(candidate.component), load), -1.0
    second = f"slow_{name}" if "slow_tau_h" in candidate.shape else f"{name}_at_first"
    return [Told(n, unit, factor) for n in (name, second)[: len(candidate.columns)]]


def _ways(candidate: Candidate) -> list[tuple[str, str]]:
    """In which component each column acts, and by which load."""
    return [(COMPONENTS[c.component], WRENCH_COMPONENTS[c.args["component"]]) for c in candidate.columns]


def _weight(candidate: Candidate) -> list[Told]:
    function = candidate.columns[0].function
    if function == "own_bend":
        return [Told("own_weight_share", "1")]
    if candidate.joint is None:
        return [Told(f"compliance_{COMPONENTS[column.component]}", "rad/(N m)") for column in candidate.columns]
    if function == "hanging":  # of 1 N
        return [Told("bend_per_metre_of_lever", f"{unit_of(candidate.component)}/m")]
    if function != "body_weight":
        return [Told("compliance", f"{unit_of(candidate.component)}/(N m)")]
    told = []
    for args in (column.args for column in candidate.columns):
        mass, grows = args["what"] == "mass", args.get("grows", 0)
        name = "mass" if mass else f"shifted_mass_{args['what']}"
        told.append(Told(name + ("", "_with_travel", "_with_travel_squared")[grows], "kg" if mass else "kg m"))
    return told


OF_EFFECT: Mapping[str, Callable[[Candidate], list[Told]]] = {
    "backlash": _backlash,
    "friction_hysteresis": _friction,
    "zero_shift": _jump,
    "thermal_growth": _growth,
    "tracker_scale": _scale,
    "target_moved": _reflector,
    "wrench_error": _misread,
    "clearance": _clearance,
    "nonlinear_stiffness": _compliance,
    "missing_compliance": _compliance,
    "creep": _creep,
    "moving_weight": _weight,
}


# --- units ----------------------------------------------------------------------------------------------------------
def unit_of(component: str | None) -> str:
    return "m" if (component or "").startswith("t") else "rad" if (component or "").startswith("r") else "1"


def shape_unit(c: Context, name: str, candidate: Candidate) -> str:
    if name.endswith(("load_width", "knee_load", "falls_at")):
        return load_unit(candidate.covariate)
    if name in ("width", "past", "period", "at"):  # of the joint's own way, whichever component errs
        return c.machine.joints[c.machine.joint_names.index(str(candidate.joint))].unit
    return "h" if name.endswith("_h") else "1"


def load_unit(covariate: str) -> str:
    return "N" if covariate.startswith("F") else "N m"


def per_load(unit: str, covariate: str) -> str:
    return f"{unit}/N" if covariate.startswith("F") else f"{unit}/(N m)"
