"""A finding in the contract's words: parameters with units, where it sits, how large it is, and a plain sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.found import Found, by_its_own_form, coefficients
from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.library.jumps import ORDINALS
from ppshw.diagnosis.nameless.rival import most_alike
from ppshw.diagnosis.visibility import alias_words, aliases_of
from ppshw.diagnosis.workspace import Workspace
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.terms import COMPONENTS
from ppshw.terms.shapes import Context, named_column

Array = NDArray[np.float64]
MORE_BY_LOAD = "added_at_twice_the_load"  # of lost motion
LEAST_WEIGHT = 0.01
WEIGHT_TOLD = 0.1  # on the terminal
LEAST_P = 1e-12


def finding(space: Workspace, tried: Tried, found: Found) -> dict[str, Any]:
    """One finding of the contract's §4; `space` has all findings taken up."""
    candidate = tried.candidates[found.best]
    rms = coefficients(space, candidate, found)[2]
    values, std = by_its_own_form(space, candidate, found)
    parameters = parameters_of(candidate, values, std)
    weights = found.weights or {found.name: 1.0}
    alternatives = [
        {"effect": effect, "joint": joint, "weight": round(weight, 4)}
        for (effect, joint), weight in weights.items()
        if (effect, joint) != found.name and weight >= LEAST_WEIGHT
    ]
    aliases = [] if candidate.effect == "nameless" else aliases_of(tried, found.name, found.best, values)
    return {
        "effect": candidate.effect,
        "joint": candidate.joint,
        "frame": candidate.frame,
        "component": candidate.component,
        "covariate": candidate.covariate,
        "region": _region(space, candidate.covariate),
        "parameters": parameters,
        "p_value": found.p,
        "rms_mm": rms * 1e3,
        "weight": round(weights.get(found.name, 0.0), 4),
        "alternatives": alternatives,
        "aliases": [{"effect": effect, "joint": joint} for effect, joint in aliases],
        "sentence": sentence(candidate, values, rms) + alias_words(found.name, aliases),
    }


def how_sure(said: Mapping[str, Any]) -> str:
    """For the terminal: the weight of a finding's name, the likeliest other, how surely there is something."""
    others = [
        f", {k['effect'].replace('nameless', 'no name')}{' of ' + k['joint'] if k['joint'] else ''} {k['weight']:.2f}"
        for k in said["alternatives"][:1] if k["weight"] >= WEIGHT_TOLD
    ]  # fmt: skip
    return f"[weight {said['weight']:.2f}{''.join(others)}; p {how_rare(said['p_value'])}]"


def how_rare(p: float) -> str:
    """A probability for the eye: nobody knows noise well enough to tell smaller ones apart."""
    return f"{p:.1g}" if p >= LEAST_P else f"< {LEAST_P:.0e}"


def column_of(covariate: str) -> tuple[str, str]:
    """The recording's column that a covariate is made of, and what of its history, where it is not the value itself."""
    if covariate.startswith("previous_"):
        column, how = column_of(covariate.removeprefix("previous_"))
        before = "of the pose before" if column.startswith("q_") else "at the visit before"
        return column, ", ".join(filter(None, (how, before)))
    if covariate.startswith("on_"):
        frame, load = covariate.removeprefix("on_").rsplit("_", 1)
        return load, f"on {frame}"
    if covariate.startswith("move_"):
        return f"q_{covariate.removeprefix('move_')}", "length and direction of the last move"
    if covariate.startswith("way_"):
        return f"q_{covariate.removeprefix('way_')}", "way since it turned back"
    if covariate.startswith("stay_"):
        return f"q_{covariate.removeprefix('stay_')}", "anew with every move"
    if covariate.startswith("pace_"):
        return f"q_{covariate.removeprefix('pace_')}", "how much it was moved"
    if covariate.startswith("late_"):
        tau, late = covariate.removeprefix("late_").split("_", 1)
        column, how = column_of(late)
        return column, ", ".join(filter(None, (how, f"lagging by {tau} h")))
    if covariate == "former_load":
        return "load", "of the load before"
    if covariate == "pause":
        return "time", "since the visit before"
    if covariate == "since_load_change":
        return "time", "since the load was changed"
    return covariate, ""


def stand_ins(c: Context, candidate: Candidate) -> list[tuple[str, str]]:
    """The columns by which something without a name is said, and what of them: those it is a function of; where these
    are none of the recording's, as with how the instrument sees a reflector, the positions it changes with most."""
    if str(candidate.columns[0].args.get("form")).startswith("beat_"):
        return [("time", f"in waves of {120 * c.hours[-1] / candidate.columns[0].args['tau']:.3g} min")]
    if candidate.covariates:
        return [column_of(name) for name in candidate.covariates]
    if candidate.covariate in c.recording.target_names:
        return [("time", f"of reflector {candidate.covariate}")]
    nearest = most_alike(c, named_column(c, candidate.covariate))[:2]
    said = f"for the {candidate.covariate} from the instrument"
    if candidate.covariate == "incidence":
        target = int(candidate.columns[0].args["target"])
        which = f"reflector {c.recording.target_names[target]}" if target >= 0 else "the reflectors"
        said = f"for how aslant the beam falls into {which}"
    return [(name, said) for name in nearest]


def history_of(said: Sequence[tuple[str, str]]) -> str | None:
    """What of their history columns are taken for, each thing once; None where all are taken as they are."""
    return ", ".join(dict.fromkeys(part for _, how in said if how for part in how.split(", "))) or None


def _unit(candidate: Candidate) -> str:
    component = candidate.component or ""
    return "m" if component.startswith("t") else "rad" if component.startswith("r") else "1"


def parameters_of(candidate: Candidate, values: Array, std: Array) -> dict[str, dict[str, Any]]:
    """Values (k,) and standard deviations (k,) of a candidate's k columns under their names, with units."""
    unit = _unit(candidate)
    names = [f"c{k + 1}" for k in range(len(values))]
    factors = np.ones(len(values))
    units = [unit] * len(values)
    if candidate.effect == "backlash":
        names[0], factors[0] = "gap", -2.0  # the axis stays half the gap behind on either side
        names[1:] = ["drag", "wear"][: len(names) - 1]
        if _rocks(candidate):
            across = COMPONENTS[candidate.columns[-1].component]
            names[1], factors[1], units[1] = f"rocking_{across}", -2.0, "m" if across.startswith("t") else "rad"
        if "pressed" in candidate.columns[-1].args:
            names[1], factors[1] = MORE_BY_LOAD, -2.0
    elif candidate.effect == "periodic_transmission":
        amplitude = float(np.hypot(values[0], values[1]))
        spread = float(np.hypot(values[0] * std[0], values[1] * std[1]) / max(amplitude, 1e-30))
        return {
            "amplitude": {"value": amplitude, "std": spread, "unit": unit},
            "phase": {"value": float(np.arctan2(values[1], values[0])), "std": spread / max(amplitude, 1e-30),
                      "unit": "rad"},
            "period": {"value": candidate.shape["period"], "std": None, "unit": unit},
        }  # fmt: skip
    elif candidate.effect == "tracker_scale":
        grows = ["place" in column.args for column in candidate.columns]
        moves = [column.on == "frame" for column in candidate.columns]
        axes = iter("xyz")
        names = [f"shift_{next(axes)}" if m else "scale_per_K" if g else "scale"
                 for m, g in zip(moves, grows, strict=True)]  # fmt: skip
        units = ["m/K" if m else "1/K" if g else "1" for m, g in zip(moves, grows, strict=True)]
    elif candidate.effect == "thermal_growth" and len(values) == len(COMPONENTS):
        names = [f"{component}_per_kelvin" for component in COMPONENTS]
        units = ["m/K" if component.startswith("t") else "rad/K" for component in COMPONENTS]
    elif candidate.effect == "thermal_growth":
        names = ["per_kelvin", "per_kelvin_and_half_travel"][: len(names)]
        units = ["1/K" if candidate.component is None else f"{unit}/K"] * len(values)
    elif candidate.effect == "friction_hysteresis":
        names = ["lag", MORE_BY_LOAD][: len(values)]
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
        units = [_per_load(unit, candidate.covariate)] * len(values)
    elif candidate.effect == "wrench_error":
        names = [_misread_name(column.args, again=len(values) > 1) for column in candidate.columns]
        units = [_misread(column.args) for column in candidate.columns]
    elif candidate.effect == "clearance":
        names = ["half_gap", "half_difference"][: len(values)]
    elif candidate.effect == "creep" and len(values) == len(COMPONENTS):
        load = WRENCH_COMPONENTS[candidate.columns[0].args["component"]]
        names = [f"compliance_{component}" for component in COMPONENTS]
        units = [_per_load("m" if component.startswith("t") else "rad", load) for component in COMPONENTS]
    elif candidate.effect == "creep":
        load = WRENCH_COMPONENTS[candidate.columns[0].component]
        name, of = ("share", "1") if candidate.joint is None else ("compliance", _per_load(unit, load))
        second = f"slow_{name}" if "slow_tau_h" in candidate.shape else f"{name}_at_first"
        names, units = [name, second][: len(values)], [of] * len(values)
    out: dict[str, dict[str, Any]] = {
        name: {"value": float(v * f), "std": float(s * abs(f)), "unit": u}
        for name, v, s, f, u in zip(names, values, std, factors, units, strict=True)
    }
    for name, value in candidate.shape.items():
        out[name] = {"value": value, "std": None, "unit": _shape_unit(name, unit, candidate.covariate)}
    return out


def _misread_name(args: Mapping[str, Any], again: bool) -> str:
    """Which channel is off, and with what it goes: its own reading or another's, time (once, or again and again), or a
    temperature."""
    of, source = args["component"], args.get("source", -1)
    kelvin = f"_per_kelvin_{args['place']}_{args['tau']:g}_h" if "place" in args else ""
    hourly = "_per_hour" * (args.get("time") == "linear")
    if of < 0:
        return "gain" + (kelvin or hourly)
    name = WRENCH_COMPONENTS[of] + (f"_by_{WRENCH_COMPONENTS[source]}" if source >= 0 else "")
    if args.get("bent"):
        return f"{name}_{args['bent']}"
    if args.get("time") == "cosine":
        return f"{name}_zero_wave_{args['tau']:g}"
    if args.get("time") == "step":
        return f"{name}_zero_step" + f"_after_{args['tau']:.4f}_h" * again
    return name + (kelvin or "_zero" * (source < 0) + hourly)


def _misread(args: Mapping[str, Any]) -> str:
    """Unit of what a force sensor reads too little: a load, per hour or kelvin; a share of a reading, per load where it
    grows with it."""
    of, source = args["component"], args.get("source", -1)
    if "place" in args and (of < 0 or source == of):
        return "1/K"
    if of < 0:
        return "1/h" if args.get("time") == "linear" else "1"
    unit, by = _load_unit(WRENCH_COMPONENTS[of]), _load_unit(WRENCH_COMPONENTS[source])
    if source < 0:
        return f"{unit}/K" if "place" in args else f"{unit}/h" if args.get("time") == "linear" else unit
    if args.get("bent"):
        return _per_load("1", WRENCH_COMPONENTS[source])
    return "1" if unit == by else _per_load(unit, WRENCH_COMPONENTS[source])


def _weight(candidate: Candidate, unit: str) -> tuple[list[str], list[str]]:
    if candidate.columns[0].function != "body_weight":
        return ["compliance"], [f"{unit}/(N m)"]
    names, units = [], []
    for args in (column.args for column in candidate.columns):
        mass, grows = args["what"] == "mass", args.get("grows", 0)
        name = "mass" if mass else f"shifted_mass_{args['what']}"
        names.append(name + ("", "_with_travel", "_with_travel_squared")[grows])
        units.append("kg" if mass else "kg m")
    return names, units


def _shape_unit(name: str, unit: str, covariate: str) -> str:
    if name.endswith(("load_width", "knee_load")):
        return _load_unit(covariate)
    return "h" if name.endswith("_h") else unit if name in ("width", "past") else "1"


def _load_unit(covariate: str) -> str:
    return "N" if covariate.startswith("F") else "N m"


def _per_load(unit: str, covariate: str) -> str:
    return f"{unit}/N" if covariate.startswith("F") else f"{unit}/(N m)"


def _region(space: Workspace, covariate: str) -> list[float] | None:
    try:
        values = named_column(space.context, covariate)
    except (KeyError, ValueError):
        return None
    if not np.isfinite(values).any():
        return None
    return [float(np.nanmin(values)), float(np.nanmax(values))]


def sentence(candidate: Candidate, values: Array, rms: float) -> str:
    joint, size = candidate.joint, f"{rms * 1e3:.3f} mm rms at the reflectors"
    rotary = (candidate.component or "t").startswith("r")
    unit = "mrad" if rotary else "mm"
    amount = f"{2 * abs(values[0]) * 1e3:.3f} {unit}{_pressed(candidate, values, unit)}"
    if candidate.effect == "target_moved":
        return f"reflector {candidate.covariate} {_moved(candidate, values)}."
    texts = {
        "backlash": f"{joint} lags behind by {amount}{_rocks(candidate)} whenever it turns back: lost motion in its "
        f"drive ({size}).",
        "friction_hysteresis": f"{joint} lags by an amount that grows with the travel since it turned back, up to "
        f"{amount}: friction before sliding ({size}).",
        "thermal_growth": f"{joint} moves with {candidate.covariate}: its link grows or bends with heat ({size}).",
        "drift": f"everything moves slowly with time, as if the base or the tracker did ({size}).",
        "tracker_scale": f"all distances from the tracker are wrong by a factor ({size}).",
        "periodic_transmission": f"{joint} is off by a wave of period {candidate.shape.get('period', 0):.5g} along its "
        f"own travel: a screw, a gear or an encoder ({size}).",
        "nonlinear_stiffness": f"{joint} does not give way in proportion to {candidate.covariate} ({size}).",
        "clearance": f"{joint} falls to one side or the other as {candidate.covariate} changes sign: play ({size}).",
        "cross_coupling": f"{joint}'s own error depends on {candidate.covariate} as well ({size}).",
        "moving_weight": f"the machine is bent by more weight at {joint} than its file says{_hose(candidate)} "
        f"({size}).",
        "wrench_error": f"the force sensor's {_channels(candidate)} in gain, cross-talk or zero"
        + (f" from {candidate.shape['time_h']:.2f} h on" if "time_h" in candidate.shape else "") + f" ({size}).",
        "creep": f"deflection goes on after {_change(candidate)}{'' if joint is None else f' at {joint}'} ({size}).",
        "zero_shift": f"{joint}'s zero {_jumps(candidate, values, unit)} ({size}).",
        "missing_compliance": f"{joint or 'the base'} gives way under {candidate.covariate}, which its file leaves out "
        f"({size}).",
        "nameless": f"something depends on {_plainly(candidate)} that no known effect explains ({size}).",
    }
    return texts[candidate.effect]


def _jumps(candidate: Candidate, values: Array, unit: str) -> str:
    """How far a zero jumped, and when: once, again and again, or there and back."""
    if "hops" in candidate.shape:
        apart = f"{abs(values[0]) * 1e3:.3f} {unit}"
        first, count = candidate.shape["time_h"], candidate.shape["hops"]
        return f"hops between two values {apart} apart, {count:.0f} times, first after {first:.2f} h"
    steps = [v for v, column in zip(values, candidate.columns, strict=True) if column.function == "step"]
    moments = [candidate.shape[f"{word}time_h"] for word in ORDINALS if f"{word}time_h" in candidate.shape]
    said = [f"{v * 1e3:+.3f} {unit} after {t:.2f} h" for v, t in zip(steps, moments, strict=False)]
    return f"jumped by {said[0].lstrip('+-') if len(said) == 1 else ' and '.join(said)}"


def _pressed(candidate: Candidate, values: Array, unit: str) -> str:
    """What lost motion is under twice the mean load, where it goes with the load: taken up, or pressed into more."""
    more = [v for v, column in zip(values, candidate.columns, strict=True) if "pressed" in column.args]
    return f" ({2 * abs(values[0] + more[0]) * 1e3:.3f} {unit} at twice its mean load)" if more else ""


def _rocks(candidate: Candidate) -> str:
    across = [column.component for column in candidate.columns if COMPONENTS[column.component] != candidate.component]
    return f" and rocks ({COMPONENTS[across[0]]})" if across else ""


def _hose(candidate: Candidate) -> str:
    by = [column.args["by"] for column in candidate.columns if "by" in column.args]
    return f", which {str(candidate.covariate).removeprefix('q_')} moves" if by else ""


def _moved(candidate: Candidate, values: Array) -> str:
    """Since when a reflector is elsewhere, and how far: once, or again and again."""
    moments = [candidate.shape[f"{word}time_h"] for word in ORDINALS if f"{word}time_h" in candidate.shape]
    far = [1e3 * float(np.linalg.norm(shift)) for shift in values.reshape(-1, 3)]
    if len(moments) > 1:
        said = [f"{mm:.3f} mm after {t:.2f} h" for mm, t in zip(far, moments, strict=True)]
        return f"moved by {' and '.join(said)}"
    how = "slides away from where" if "tau_h" in candidate.shape else "is not where"
    when = "".join(f" from {t:.2f} h on" for t in moments)
    return f"{how} the machine file says{when}, by {far[0]:.3f} mm"


def _channels(candidate: Candidate) -> str:
    one = candidate.covariate in WRENCH_COMPONENTS
    return f"{candidate.covariate} is off" if one else f"channels are off, with the {candidate.covariate},"


def _change(candidate: Candidate) -> str:
    by_moves = candidate.columns[0].args.get("form") in ("wrench", "total")
    return "whatever changes the moment, moves too," if by_moves else "a load change"


def _plainly(candidate: Candidate) -> str:
    return listed([column_of(name) for name in candidate.covariates]) or candidate.covariate


def listed(said: Sequence[tuple[str, str]]) -> str:
    """Columns and their history as in `column_of`: "a, b (of the pose before) and c"."""
    words = [f"{column} ({how})" if how else column for column, how in said]
    return " and ".join(word for word in (", ".join(words[:-1]), *words[-1:]) if word)
