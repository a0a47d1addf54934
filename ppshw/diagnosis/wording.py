"""A finding in the contract's words: where it sits, how large it is, how sure it is, and a plain sentence."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.found import Found, by_its_own_form, moved_by
from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.library.jumps import ALL, ORDINALS
from ppshw.diagnosis.library.sampled import own_component
from ppshw.diagnosis.library.weighing import by_readings
from ppshw.diagnosis.nameless.rival import most_alike
from ppshw.diagnosis.parameter_names import rocks, shape_unit
from ppshw.diagnosis.parameters import along_its_axis, courses, numbers_of, runs_ahead, scale_holds_at
from ppshw.diagnosis.sensor_words import against_gravity, turned
from ppshw.diagnosis.visibility import NEVER, alias_words, aliases_of, is_told_apart
from ppshw.diagnosis.weights import as_well
from ppshw.diagnosis.workspace import Workspace
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.quantities import called, enumerated
from ppshw.terms import COMPONENTS
from ppshw.terms.shapes import Context, named_column
from ppshw.terms.shapes.reflectors import gravity_in_tip

Array = NDArray[np.float64]
LEAST_WEIGHT = 0.01
MUCH = 0.5  # of what a drift does along the axis where it goes farthest
# Of what was read, and by which its gain may be off: units of old.
UNITS = {
    "forces": (("kilograms-force", 1 / 9.80665), ("pounds-force", 1 / 4.44822), ("kilonewtons", 1e-3)),
    "moments": (("newton millimetres", 1e3), ("pound-feet", 1 / 1.35582), ("kilonewton metres", 1e-3)),
}
ABOUT = 0.2
NEARLY_TWICE = 0.2  # by which a component's error may differ from twice what it reads
HARDLY = 0.1  # of what the joint does whose zero jumped farthest
WEIGHT_TOLD = 0.1  # on the terminal
LITTLE_SHOWS = 0.5  # of an effect's size: where a base calibration leaves less, that is said
RAREST = 1e-12


def finding(space: Workspace, tried: Tried, found: Found, pieces: Sequence[Found] = ()) -> dict[str, Any]:
    """One finding of the contract's §4; `space` has all findings taken up. Parameters are of its first piece, its size
    is that of all."""
    candidate = tried.candidates[found.best]
    moved = np.sum([moved_by(space, tried.candidates[g.best], g) for g in (found, *pieces)], axis=0)
    rms, beyond = space.rms(moved), space.rms(space.beyond(moved))
    values, covariance = by_its_own_form(space, candidate, found)
    if found.pulled is not None:
        covariance = covariance + found.pulled @ found.pulled.T
    candidate = _by_its_thermometer(space.context, candidate, values)
    also = [what for what in found.also if what != f"go with {candidate.covariate}"]
    told = values, covariance
    if candidate.effect == "wrench_error" and (read := by_readings(space.context, candidate)) is not None:
        told = read.values, read.covariance
    weights = found.weights or {found.name: 1.0}
    alternatives = [
        {"effect": effect, "joint": joint, "weight": round(weight, 4)}
        for (effect, joint), weight in weights.items()
        if (effect, joint) != found.name and weight >= LEAST_WEIGHT
    ]
    either = as_well(space, tried, found)
    aliases = [] if candidate.effect == "nameless" else aliases_of(tried, found.name, found.best, values, either)
    return {
        "effect": candidate.effect,
        "joint": candidate.joint,
        "frame": candidate.frame,
        "component": candidate.component,
        "covariate": candidate.covariate,
        "region": _region(space, _where_it_acts(candidate)),
        "parameters": numbers_of(space.context, candidate, *told, found.spread),
        "p_value": found.p,
        "rms_mm": rms * 1e3,
        "beyond_base_mm": beyond * 1e3,
        "weight": round(weights.get(found.name, 0.0), 4),
        "alternatives": alternatives,
        "aliases": [alias.as_dict() for alias in aliases],
        "sentence": sentence(space.context, candidate, told[0], rms, beyond)
        + _and_in(tried, candidate, pieces)
        + (f" It may as well {' or '.join(also)}." if also else "")
        + alias_words(found.name, aliases),
    }


def _and_in(tried: Tried, candidate: Candidate, pieces: Sequence[Found]) -> str:
    """In which other directions of its frame an effect acts, in words."""
    theirs = dict.fromkeys(tried.candidates[g.best].component for g in pieces)
    ways = [f"{'about' if c[0] == 'r' else 'along'} {c[1]}" for c in theirs if c and c != candidate.component]
    return f" It acts {' and '.join(ways)} too." if candidate.component and ways else ""


def _by_its_thermometer(c: Context, candidate: Candidate, values: Array) -> Candidate:
    """Of growth by two thermometers the one by whose swing it moves more is its covariate: a floor's 0.7 K did half of
    what a column's 3 K did, at more per kelvin (a reviewer's)."""
    places = [column.args.get("place") for column in candidate.columns]
    if candidate.effect != "thermal_growth" or len(set(places)) < 2:
        return candidate
    swings = [float(np.std(column.value(c))) for column in candidate.columns]
    return replace(candidate, covariate=f"temp_{places[int(np.argmax(np.abs(values) * swings))]}_C")


def how_sure(said: Mapping[str, Any]) -> str:
    """For the terminal: the weight of a finding's name, the likeliest other, how surely there is something."""
    others = [
        f", {called(k['effect'], k['joint'])} {k['weight']:.2f}"
        for k in said["alternatives"][:1] if k["weight"] >= WEIGHT_TOLD
    ]  # fmt: skip
    return f"[weight {said['weight']:.2f}{''.join(others)}; p {how_rare(said['p_value'])}]"


def unexplained(left: Mapping[str, Any]) -> str:
    """For the terminal: structure without a name, where it goes on, how large and how sure."""
    history = f" ({left['history']})" if left["history"] else ""
    where = " ".join(filter(None, (left["frame"], left["component"])))
    size = f"; {left['rms_mm']:.3f} mm rms at the reflectors" if left["rms_mm"] is not None else ""
    return (f"something without a name goes on over {' and '.join(left['covariates'])}{history}"
            f"{', read as ' + where if where else ''}{size} [p {how_rare(left['p_value'])}]")  # fmt: skip


def to_separate(said: Mapping[str, Any]) -> tuple[str, str, str | None] | None:
    """Of a finding: its effect, another one that it may well be, and the joint where both are (None: at several), as
    `ppshw plan --to-separate` takes them; None where nothing is left to separate: forms that are told apart already, or
    that no recording tells apart (`as_well`)."""
    known = {(k["effect"], k["joint"]): k.get("never_told_apart") or is_told_apart(k) for k in said["aliases"]}
    likely = [k for k in said["alternatives"] if k["weight"] >= WEIGHT_TOLD]
    for rival in (*likely, *said["aliases"]):
        if not known.get((rival["effect"], rival["joint"])) and rival["effect"] not in ("nameless", said["effect"]):
            same = rival["joint"] in (None, said["joint"])
            return said["effect"], rival["effect"], said["joint"] if same else None
    return None


def would_have_shown(visibility: Sequence[Mapping[str, Any]]) -> str | None:
    """For the terminal, where nothing was found: from which size on nine of ten such recordings show the effect that
    shows best, and the one that shows worst."""
    ordered = sorted(visibility, key=lambda r: r["detectable_mm"])
    seen = [r for r in ordered if r["detectable_mm"] < 1e3 * NEVER]
    if not seen:
        return None
    best, worst = (f"{called(r['effect'], r['joint'])} from {r['detectable_mm']:.3f} mm" for r in (seen[0], seen[-1]))
    never = "" if len(seen) == len(ordered) else f", and {len(ordered) - len(seen)} of {len(ordered)} at no size"
    return f"nine of ten such recordings would show {best} rms on, {worst} on{never}"


def plan_options(one: str, other: str, joint: str | None) -> str:
    """What `ppshw plan` is to be told, to write the visits that separate two effects."""
    return f"--to-separate {one},{other}" + (f" --joint {shlex.quote(joint)}" if joint else "")


def how_rare(p: float) -> str:
    """A probability for the eye: nobody knows noise well enough to tell smaller ones apart."""
    return f"{p:.1g}" if p >= RAREST else f"< {RAREST:.0e}"


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
    if covariate.startswith("rest_"):
        return f"q_{covariate.removeprefix('rest_')}", "how far from its setpoint it came to rest"
    if covariate.startswith("late_"):
        tau, late = covariate.removeprefix("late_").split("_", 1)
        column, how = column_of(late)
        return column, ", ".join(filter(None, (how, f"lagging by {tau} h")))
    if covariate == "mounting":
        return "load", "anew whenever it was changed"
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
        of = f"of reflector {candidate.covariate}"
        if candidate.columns[0].function == "turned_shift":
            i, j = np.unravel_index(np.argmax(c.tips[:, :3, :3].std(axis=0)), (3, 3))
            return [(name, f"{of}, as it is turned") for name in most_alike(c, c.tips[:, i, j])[:2]]
        if (axis := candidate.columns[0].args.get("plumb")) is None:
            return [("time", of)]
        return [(name, f"{of}, as it is turned over") for name in most_alike(c, gravity_in_tip(c)[:, axis])[:2]]
    nearest = most_alike(c, named_column(c, candidate.covariate))[:2]
    said = f"for the {candidate.covariate} from the instrument"
    if candidate.columns[0].function == "range_wave":
        said += f", in waves of {candidate.columns[0].args['period']:.3g} m"
    if candidate.covariate == "incidence":
        target = int(candidate.columns[0].args["target"])
        which = f"reflector {c.recording.target_names[target]}" if target >= 0 else "the reflectors"
        said = f"for how aslant the beam falls into {which}"
    return [(name, said) for name in nearest]


def history_of(said: Sequence[tuple[str, str]]) -> str | None:
    """What of their history columns are taken for, each thing once; None where all are taken as they are."""
    return ", ".join(dict.fromkeys(part for _, how in said if how for part in how.split(", "))) or None


def _where_it_acts(candidate: Candidate) -> str:
    """The column whose range is a finding's region: of a load the one on its frame, not the sensor's channel; of the
    direction of a joint's motion its travel."""
    if candidate.frame is not None and candidate.covariate in WRENCH_COMPONENTS:
        return f"on_{candidate.frame}_{candidate.covariate}"
    return re.sub("^approach_", "q_", candidate.covariate)


def _region(space: Workspace, covariate: str) -> list[float] | None:
    try:
        values = named_column(space.context, covariate)
    except (KeyError, ValueError):
        return None
    if not np.isfinite(values).any():
        return None
    return [float(np.nanmin(values)), float(np.nanmax(values))]


def sentence(c: Context, candidate: Candidate, values: Array, rms: float, beyond: float | None = None) -> str:
    """Values (k,) of a candidate's own columns, the rms of all it may be like, and of that what a base calibration does
    not take [m]."""
    values = values * along_its_axis(c, candidate)
    joint, size = candidate.joint, f"{rms * 1e3:.3f} mm rms at the reflectors"
    if beyond is not None and beyond < LITTLE_SHOWS * rms:
        size += f", of which a base calibration leaves {beyond * 1e3:.3f} mm"
    rotary = (candidate.component or "t").startswith("r")
    unit = "mrad" if rotary else "mm"
    amount = f"{2 * abs(values[0]) * 1e3:.3f} {unit}{_by_its_load(candidate, values, unit)}"
    ahead = ", which lags: is a sign turned?" if runs_ahead(c, candidate, values) else ""
    if candidate.effect == "target_moved":
        if candidate.covariate == ALL:
            return _knocked(candidate, values)
        return f"reflector {candidate.covariate} {_moved(candidate, values)}."
    texts = {
        "backlash": f"{joint} {'runs ahead' if ahead else 'lags behind'} by {amount}{rocks(candidate)} whenever it "
        f"turns back: lost motion in its drive{ahead} ({size}).",
        "friction_hysteresis": f"{joint} {'runs ahead' if ahead else 'lags'}{rocks(candidate)} by an amount that grows "
        f"with the travel since it turned back, up to {amount}{_lets_go(candidate)}: friction before sliding{ahead} "
        f"({size}).",
        "thermal_growth": f"every link grows with {candidate.covariate}{_per_kelvin(candidate, values)} ({size})."
        if joint is None
        else f"{joint} moves with {candidate.covariate}{_per_kelvin(candidate, values)}: its link grows or bends with "
        f"heat ({size}).",
        "drift": f"everything moves{_when(candidate)}, {_far(c, candidate, values)}as if the base or the tracker did "
        f"({size}).",
        "tracker_scale": f"all distances from the tracker are wrong by a factor{_parts(c, candidate, values)} "
        f"({size}).",
        "periodic_transmission": f"{joint} {_in_a_wave(c, candidate)} ({size}).",
        "nonlinear_stiffness": f"{joint} does not give way in proportion to the {candidate.covariate} on it ({size}).",
        "clearance": f"{joint} falls to one side or the other as the {candidate.covariate} on it changes sign: "
        f"play ({size}).",
        "cross_coupling": f"{joint}'s own error depends on {candidate.covariate} as well, "
        f"{_high(c, candidate, values, unit)}({size}).",
        "moving_weight": f"the floor or the base tilts as the machine's own weight moves over it ({size})."
        if joint is None
        else f"the machine is bent by more weight at {joint} than its file says{_hose(candidate)} ({size}).",
        "wrench_error": f"the force sensor{_misreads(candidate, values)} ({size})" + _weighing(c, candidate),
        "creep": f"deflection goes on after {_change(candidate)}{'' if joint is None else f' at {joint}'} ({size}).",
        "zero_shift": f"{_homed_anew(c, candidate, values)} ({size})."
        if joint is None
        else f"{joint}'s zero {_jumps(candidate, values, unit)} ({size}).",
        "missing_compliance": f"{joint or 'the base'} gives way under {candidate.covariate}"
        f"{_along_its_travel(c, candidate)}, which its file leaves out ({size}).",
        "nameless": f"something depends on {_plainly(candidate)} that no known effect explains ({size}).",
    }
    return texts[candidate.effect]


def _lets_go(candidate: Candidate) -> str:
    rest = candidate.shape.get("rest_h")
    return "" if rest is None else f", and lets go of it in {60 * rest:.0f} min of rest"


def _along_its_travel(c: Context, candidate: Candidate) -> str:
    """Of a compliance whether it is one that changes along its joint's travel."""
    function = candidate.columns[0].function
    if function == "load_near":
        return f" more about {candidate.shape['at']:.3g} {shape_unit(c, 'at', candidate)} than elsewhere on its travel"
    if function == "load_wave":
        return f" in waves of {candidate.shape['period']:.3g} m along its travel, as a rail between its posts does"
    if function == "bearing":
        return " and the other moment more in one direction of its housing than across it"
    return (
        " otherwise at one end of its travel than at the other (varies)" if function in ("load_q", "load_turn") else ""
    )


def _in_a_wave(c: Context, candidate: Candidate) -> str:
    if candidate.effect != "periodic_transmission":
        return ""
    wave = f"wave of period {candidate.shape['period']:.5g} {shape_unit(c, 'period', candidate)}"
    first = candidate.columns[0]
    if first.component == own_component(c, first.args["joint"]):
        return f"is off by a {wave} along its own travel: a screw, a gear or an encoder"
    return (
        f"moves in {candidate.component} by a {wave}, across its own travel: a screw that is bent, a rail or a bearing"
    )


def _per_kelvin(candidate: Candidate, values: Array) -> str:
    """Of what grows along itself or moves in one component, by how much; along a travel at either end of it."""
    if candidate.effect != "thermal_growth":
        return ""
    first = candidate.columns[0]
    if first.function == "link_growth":
        return f" by {values[0] * 1e6:.3g} ppm per kelvin"
    if candidate.component is None or len({column.args["place"] for column in candidate.columns}) > 1:
        return ""
    unit = f"{'µrad' if candidate.component.startswith('r') else 'µm'} per kelvin"
    if "core_lag_h" in candidate.shape:
        return f" by {values[0] * 1e6:.3g} {unit} above what it was over the last {candidate.shape['core_lag_h']:g} h"
    along = sum(v for v, column in zip(values, candidate.columns, strict=True) if column.function == "temperature_q")
    if along:
        one, other = (f"{v * 1e6:.3g}" for v in (values[0] - along, values[0] + along))
        return f" by {one} {unit} at one end of its travel, {other} at the other"
    return f" by {values[0] * 1e6:.3g} {unit}"


def _parts(c: Context, candidate: Candidate, values: Array) -> str:
    """A scale's parts per million, once and per kelvin, or per unit of another column."""
    if candidate.effect != "tracker_scale":
        return ""
    middle, of = scale_holds_at(c, candidate), candidate.covariate
    per = {"place": f" per kelvin of {of}", "name": f" per unit of {of}"}
    at = "" if middle is None else f" at {middle:.1f} °C" if str(of).startswith("temp_") else f" at {middle:.5g}"
    said = [
        f"{v * 1e6:.3g} ppm" + next((text for arg, text in per.items() if arg in column.args), at)
        for v, column in zip(values, candidate.columns, strict=True) if column.on == "points"
    ]  # fmt: skip
    when = f" from {candidate.shape['time_h']:.2f} h on" if "time_h" in candidate.shape else ""
    return f", by {' and '.join(said)}{when}"


def _far(c: Context, candidate: Candidate, values: Array) -> str:
    """How far a drift goes, along the axes and about the axes where it goes farthest, or at least half as far."""
    if candidate.effect != "drift":
        return ""
    each = courses(c, candidate.columns) * values
    moves = np.array([column.component for column in candidate.columns])
    went = {COMPONENTS[k]: float(np.ptp(each[:, moves == k].sum(axis=1))) for k in dict.fromkeys(moves.tolist())}
    said = []
    for kind, how, unit in (("t", "along", "mm"), ("r", "about", "mrad")):
        of = [name for name in went if name.startswith(kind)]
        most = max((went[name] for name in of), default=0.0)
        said += [f"by {went[name] * 1e3:.3f} {unit} {how} {name[1]}" for name in of if went[name] > MUCH * most]
    return f"{' and '.join(said)}, "


def _when(candidate: Candidate) -> str:
    """How a drift goes on: slowly, or at once; for good, or to go back."""
    back = candidate.columns[0].function == "settling"
    if back or candidate.columns[0].args.get("form") == "step":
        goes_back = f" and back again within hours (by 1/e in about {candidate.shape['tau_h']:g} h)" if back else ""
        return f" at once after {candidate.shape['time_h']:.2f} h{goes_back}"
    return " slowly with time"


def _weighing(c: Context, candidate: Candidate) -> str:
    """What weighing says besides of a sensor's error."""
    said = against_gravity(c) if candidate.effect == "wrench_error" else ""
    return f"; against gravity it reads {said}." if said else "."


def _misreads(candidate: Candidate, values: Array) -> str:
    """What a force sensor does wrong."""
    if candidate.effect != "wrench_error":
        return ""
    args = candidate.columns[0].args
    if candidate.columns[0].function == "weighed":
        return " reads other than what hangs there weighs in every attitude"
    if "turned" in args:
        return f" reads as if it were mounted {turned(candidate.columns, values)}"
    if "about" in args:
        axes = ["xyz"[k.args["about"]] for k in candidate.columns]
        off = [f"{1e3 * v:+.0f} mm along its {axis}" for v, axis in zip(values, axes, strict=True)]
        return f"'s moments are about a point {enumerated(off)} from the origin in its machine file"
    if "only" in args:
        times = 1.0 / (1.0 - values[0]) if values[0] < 1.0 else np.inf
        units = [f", nearly as if in {name}" for name, of_it in UNITS[args["only"]] if abs(times / of_it - 1.0) < ABOUT]
        return f"'s {args['only']} are read {times:.3g} times as large as they are{''.join(units)}"
    when = f" from {candidate.shape['time_h']:.2f} h on" if "time_h" in candidate.shape else ""
    by_itself = args.get("source", -1) == args.get("component")
    twice = ", nearly as if its sign were turned" if by_itself and abs(values[0] - 2.0) < NEARLY_TWICE else ""
    return f"'s {_channels(candidate)} in gain, cross-talk or zero{when}{twice}"


def _high(c: Context, candidate: Candidate, values: Array, unit: str) -> str:
    if candidate.effect != "cross_coupling":
        return ""
    height = float(np.ptp(courses(c, candidate.columns) @ values))
    return f"by {height * 1e3:.3f} {unit} from peak to valley "


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


def _homed_anew(c: Context, candidate: Candidate, values: Array) -> str:
    """How far each joint's zero jumped where several did at once; those that moved the reflectors hardly beside the
    others are not told."""
    if candidate.effect != "zero_shift":
        return ""
    far = np.array([np.linalg.norm(k.evaluate(c)) for k in candidate.columns]) * np.abs(values)
    told = [j for j in range(len(values)) if far[j] > HARDLY * far.max()]
    joints = [c.machine.joints[candidate.columns[j].frame - 1] for j in told]
    said = [
        f"{joint.name} by {values[j] * 1e3:+.3f} {'mm' if joint.prismatic else 'mrad'}"
        for j, joint in zip(told, joints, strict=True)
    ]
    which = "all joints" if len(told) == len(values) else enumerated([joint.name for joint in joints])
    when = f"at once after {candidate.shape['time_h']:.2f} h"
    return f"the zeros of {which} jumped {when}, as where they are homed anew: {enumerated(said)}"


def _by_its_load(candidate: Candidate, values: Array, unit: str) -> str:
    """What lost motion is under another load, where it goes with the load: taken up, or pressed into more; or later,
    where something came loose."""
    last, more = candidate.columns[-1], values[-1]
    if "since" in last.args:
        return f" ({2 * abs(values[0] + more) * 1e3:.3f} {unit} from {last.args['since']:.2f} h on)"
    if "pressed" in last.args:
        if (values[0] + more) * values[0] < 0.0:  # taken up before: by a straight line less than nothing beyond
            return f" (nothing from {1.0 - values[0] / more:.2f} times its mean load on)"
        return f" ({2 * abs(values[0] + more) * 1e3:.3f} {unit} at twice its mean load)"
    if "tilted" in last.args:
        way, load = "more" if more * values[0] > 0 else "less", WRENCH_COMPONENTS[last.args["tilted"]]
        return f" ({2 * abs(more) * 1e5:.3f} {unit} {way} per 100 N m of {load} upon it)"
    return ""


def _hose(candidate: Candidate) -> str:
    by = [column.args["by"] for column in candidate.columns if "by" in column.args]
    return f", which {str(candidate.covariate).removeprefix('q_')} moves" if by else ""


def _knocked(candidate: Candidate, values: Array) -> str:
    """Since when all reflectors are elsewhere as one body, and how far."""
    far, turned = (1e3 * float(np.linalg.norm(way)) for way in values.reshape(2, 3))
    return (
        f"all reflectors are elsewhere from {candidate.shape['time_h']:.2f} h on, as one body, by {far:.3f} mm and "
        f"{turned:.3f} mrad: what carries them was knocked, and no setpoint is corrected for it; or the last link "
        "slipped where it is bolted on, which looks the same."
    )


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
    if candidate.covariate in WRENCH_COMPONENTS:
        return f"{candidate.covariate} is off"
    anew = candidate.covariate == "since_load_change"
    return f"channels are off, {'anew after every change of the load' if anew else f'with the {candidate.covariate}'},"


def _change(candidate: Candidate) -> str:
    by_moves = candidate.columns[0].args.get("form") in ("wrench", "total")
    return "whatever changes the moment, moves too," if by_moves else "a load change"


def _plainly(candidate: Candidate) -> str:
    return listed([column_of(name) for name in candidate.covariates]) or candidate.covariate


def listed(said: Sequence[tuple[str, str]]) -> str:
    """Columns and their history as in `column_of`: "a, b (of the pose before) and c"."""
    words = [f"{column} ({how})" if how else column for column, how in said]
    return enumerated(words)
