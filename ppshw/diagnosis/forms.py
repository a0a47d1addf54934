"""What else a named effect may be like: forms near the library's, taken up beside it with a share of its size.

No machine has exactly the play or the creep of a textbook. What the library's form leaves of a large effect would be
found as a second effect, with a name that nothing bears; instead every finding brings its own freedom along: the same
joint and cause, other widths, lags, harmonics, moments, for some effects other components. The prior lets them be
a part of the main form.
"""

from __future__ import annotations

import itertools

import numpy as np

from ppshw.diagnosis.library import Candidate
from ppshw.diagnosis.library.by_heat_and_time import GOES_BACK_H
from ppshw.diagnosis.library.by_position import of_two
from ppshw.diagnosis.library.creep import ANY_WAY, CREEP_H
from ppshw.diagnosis.library.jumps import ALL, knocked_carrier
from ppshw.diagnosis.library.lost_motion import winds_up
from ppshw.diagnosis.library.sampled import LAGS_H, presses, tilts
from ppshw.terms.shapes import Column, Context

# Whose own form a column is that accompanies another's: where a class is left out, so are they.
OF_CLASS = {
    "approach": "backlash", "approach_q": "backlash",
    "load_q": "missing_compliance", "load_power": "nonlinear_stiffness",
    "load_side": "clearance", "load_side_held": "clearance",
}  # fmt: skip
# Relative to the load's spread: what tips over more slowly, or in proportion to its load up to a stop, is a stiffness.
WIDEST_SIDE, FARTHEST_STOP = 0.4, 0.75
MANY_WAVES = 8  # over a travel, of which one sees that they grow along it; few that do are any function (a dent)
STEPS = 12  # moments in the recording at which something may go on that began as a jump


def near_forms(c: Context, candidate: Candidate, without: frozenset[str] = frozenset()) -> tuple[Column, ...]:
    """Columns that a candidate's own may be accompanied by; none that it has itself, none of effects left out."""
    maker = _MAKERS.get(candidate.effect)
    if maker is None:
        return ()
    have = {k.key for k in candidate.columns}
    return tuple(k for k in maker(c, candidate) if k.key not in have and _class(c, k) not in without)


def _class(c: Context, column: Column) -> str | None:
    """The effect whose own form a column is, if it is one's."""
    if column.function in ("slipping", "winding"):
        way = float(column.args["width" if column.function == "slipping" else "way"])
        return "friction_hysteresis" if winds_up(c, int(column.args["joint"]), way) else "backlash"
    widest = FARTHEST_STOP if column.args.get("hard") else WIDEST_SIDE
    if column.function == "load_side" and column.args["width"] > widest:
        return "nonlinear_stiffness"
    return OF_CLASS.get(column.function)


def _on(candidate: Candidate, function: str, **args: object) -> Column:
    """A function on the frame and component of the candidate's first column."""
    first = candidate.columns[0]
    return Column("frame", function, args, first.frame, first.component)


def _lost_motion(c: Context, k: Candidate) -> list[Column]:
    joint, first = c.machine.joint_names.index(str(k.joint)), k.columns[0]
    low, high = float(c.recording.q[:, joint].min()), float(c.recording.q[:, joint].max())
    ways = (high - low) * np.array([0.005, 0.02, 0.05, 0.12, 0.3])
    past, rest = ({key: value for key, value in first.args.items() if key == name} for name in ("past", "rest_h"))
    slips = [_on(k, "slipping", joint=joint, width=float(way), **past) for way in ways]
    slips += [_on(k, "winding", joint=joint, way=float(way), **past, **rest) for way in ways]
    tilted = [_on(k, first.function, **first.args, tilted=by) for by in tilts(c, joint)]  # what a moment upon it adds
    tips = [Column("frame", "approach", {"joint": joint}, joint + 1, comp) for comp in range(6)]
    return [*slips, *tilted, *tips, _on(k, "approach_q", joint=joint), _on(k, "approach_q", joint=joint, power=2)]


def _thermal(c: Context, k: Candidate) -> list[Column]:
    """Later or sooner in part, which adds nothing where temperatures are steady: what a lag of hours does in a
    recording of hours is little and unsure, and made 135 ppm per kelvin 222 where nobody knew what a thermometer had
    read before (a reviewer's)."""
    args = k.columns[0].args
    if k.joint is None:
        return [Column("frames", "link_growth", {**args, "joint": joint}) for joint in range(c.machine.n)]
    joint = c.machine.joint_names.index(k.joint)
    than = float(args["tau"])
    others = [{"tau": tau, "than": than} for tau in LAGS_H if tau != than]
    if k.columns[0].function == "link_growth":
        return [Column("frames", "link_growth", {**args, **late}) for late in others]
    others = [late for late in others if late["tau"] != LAGS_H[-1]]
    if len(k.columns) == 6:
        return [
            Column("frame", "temperature", {**args, **late}, each.frame, each.component)
            for each in k.columns for late in others
        ]  # fmt: skip
    places = dict.fromkeys(column.args["place"] for column in k.columns)  # where one side is warmer than the other: two
    lagging = [{"place": place, **late} for place in places for late in others]
    along = [{"place": place, "tau": than} for place in places]
    return [
        *(_on(k, "temperature", **late) for late in lagging),
        *(_on(k, "temperature_q", **late, joint=joint) for late in along + lagging),
    ]


def _drift(c: Context, k: Candidate) -> list[Column]:
    """Any course in time; and what happened at once, at the same moment for good, or to go back as it may."""
    jumps: list[Column] = []
    if k.columns[0].function == "settling" or k.columns[0].args.get("form") == "step":
        courses: list[tuple[str, dict[str, object]]] = [("clock", {"form": "step", "tau": k.shape["time_h"]})]
        courses += [("settling", {"visit_time": k.shape["time_h"], "tau": tau}) for tau in GOES_BACK_H]
        jumps = [Column("frame", *course, 0, comp) for course in courses for comp in range(6)]
    return jumps + [
        Column("frame", "clock", {"form": "cosine", "tau": order}, 0, comp)
        for order in range(1, 9)
        for comp in range(6)
    ]


def _periodic(c: Context, k: Candidate) -> list[Column]:
    joint, period = k.columns[0].args["joint"], k.columns[0].args["period"]
    phases = ("sin", "cos")
    out = [_on(k, "wave", joint=joint, period=period / n, phase=phase) for n in (2, 3, 4) for phase in phases]
    by_load = itertools.product(presses(c, joint), phases)  # teeth give way
    across = itertools.product(range(6), phases)  # what turns eccentrically wobbles
    args, frame = {"joint": joint, "period": period}, k.columns[0].frame
    out += [Column("frame", "wave", {**args, "phase": phase}, frame, comp) for comp, phase in across]
    travel = float(np.ptp(c.recording.q[:, joint]))
    if MANY_WAVES * 2 * period < travel:  # a harmonic drive errs weakly once where it errs twice (another's 63071)
        out += [_on(k, "wave", joint=joint, period=2 * period, phase=phase) for phase in phases]
    if MANY_WAVES * period < travel:  # and wears along its travel
        out += [_on(k, "wave_q", **args, phase=phase, by=joint) for phase in phases]
    return out + [_on(k, "wave", joint=joint, period=period, phase=phase, pressed=by) for by, phase in by_load]


def _by_load(c: Context, k: Candidate) -> list[Column]:
    frame, component = k.columns[0].args["frame"], k.columns[0].args["component"]
    about = k.columns[0].args.get("offset", 0.0)
    out = [_on(k, "load_power", frame=frame, component=component, exponent=e) for e in (0.67, 1.5, 2.0, 3.0)]
    out += [
        _on(k, "load_side", frame=frame, component=component, width=w, offset=about + o)
        for w in (0.05, 0.2, 0.5) for o in (0.0, -0.4, 0.4)
    ]  # fmt: skip
    # a link that bends shifts and turns what it carries
    out += [Column("frame", first.function, first.args, first.frame, comp) for first in k.columns for comp in range(6)]
    out += [_on(k, "load_side_held", frame=frame, component=component, width=w) for w in (0.1, 0.25, 0.5)]
    if k.joint is not None:  # more at one end of the travel
        joint = c.machine.joint_names.index(k.joint)
        out.append(_on(k, "load_q", frame=frame, component=component, joint=joint))
    return out


def _coupling(c: Context, k: Candidate) -> list[Column]:
    a, b = (c.machine.joint_names.index(name.removeprefix("q_")) for name in k.covariates)
    # up to the sixth order, and waves of one joint times the other's position
    powers = [(i, j) for i in range(9) for j in range(1, 9) if i + j <= 6 or min(i, j) <= 1]
    found = [of_two(a, i, b, j) for i, j in powers]
    return [_on(k, function, **args) for function, args in found]


def _creep(c: Context, k: Candidate) -> list[Column]:
    first = k.columns[0]
    if k.component is None and first.function == "creeping":  # of one load, or of several
        one = len({each.args["component"] for each in k.columns}) == 1
        forms = (*ANY_WAY, "first") if one else (first.args["form"],)
        out = [
            Column(each.on, each.function, {**each.args, "tau": tau, "form": form}, each.frame, each.component)
            for each in k.columns for tau in CREEP_H[::3] for form in forms
        ]  # fmt: skip
        if any(each.component != each.args["component"] for each in k.columns):
            return out
        along = [(each.function, each.args, each.frame) for each in k.columns]  # what bends shifts what it carries, too
        return out + [Column("frame", *of, comp) for of in along for comp in range(6)]
    by_weight = first.args.get("component", 0) < 0  # which no move changes
    forms = ("exponential", "log", "last", "first", *(() if by_weight else ("wrench", "total", "began")))
    return [
        Column(first.on, first.function, {**first.args, "tau": tau, "form": form}, first.frame, first.component)
        for tau in CREEP_H for form in forms
    ]  # fmt: skip


def _zero_shift(c: Context, k: Candidate) -> list[Column]:
    if k.joint is None:
        return []
    args = k.columns[0].args
    moment = float(args["times"][0] if "times" in args else args["visit_time"])
    step = float(c.hours[-1]) / STEPS
    later = [_on(k, "step", visit_time=step * j) for j in range(1, STEPS)]
    return [*later, *(_on(k, "settling", visit_time=moment, tau=tau) for tau in (0.5, 2.0))]


def _target(c: Context, k: Candidate) -> list[Column]:
    """From later moments on; what moved at a moment stood before it where the machine file has it (where it was let
    stand a tenth of a millimetre off besides, the end effector turned with it)."""
    step, first = float(c.hours[-1]) / STEPS, k.columns[0].args
    if k.covariate == ALL:
        return [column for j in range(1, STEPS) for column in knocked_carrier(step * j)]
    always = () if float(first.get("since", -1.0)) >= 0.0 else (-1.0,)
    return [
        Column("points", "target_shift", {"target": first["target"], "axis": a, "since": since})
        for since in (*always, *(step * j for j in range(1, STEPS))) for a in range(3)
    ]  # fmt: skip


def _wrench(c: Context, k: Candidate) -> list[Column]:
    args = k.columns[0].args
    if k.columns[0].function == "weighed":
        return []
    if args.get("time") == "cosine":
        return [
            Column("frames", "sensor_error", {"component": comp, "time": "cosine", "tau": order})
            for order in range(1, 9) for comp in range(6)
        ]  # fmt: skip
    if args.get("source") == args["component"] and "place" not in args:
        own = {"component": args["component"], "source": args["component"]}
        return [Column("frames", "sensor_error", {**own, "bent": bent}) for bent in ("odd", "even", "sided")]
    if "place" not in args:
        return []
    of_gain = args["component"] < 0 or "source" in args
    others = [
        Column("frames", "sensor_error", {**args, "component": comp, **({"source": comp} if of_gain else {})})
        for comp in range(6)
    ]
    return [*others, *(Column("frames", "sensor_error", {**args, "tau": tau}) for tau in LAGS_H)]


_MAKERS = {
    "backlash": _lost_motion,
    "friction_hysteresis": _lost_motion,
    "thermal_growth": _thermal,
    "drift": _drift,
    "periodic_transmission": _periodic,
    "nonlinear_stiffness": _by_load,
    "clearance": _by_load,
    "cross_coupling": _coupling,
    "creep": _creep,
    "zero_shift": _zero_shift,
    "target_moved": _target,
    "wrench_error": _wrench,
}
