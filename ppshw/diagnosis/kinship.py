"""Which rivals without a name are, by the contract's own words, the very effect they would outdo.

"One joint's geometric error depends on another joint's position" holds for any function of the two. A name is not given
up because a function without one is more of the same: only because something else says as much.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.library import Candidate
from ppshw.kinematics import frames, travel
from ppshw.machine import WRENCH_COMPONENTS, Machine
from ppshw.terms import COMPONENTS
from ppshw.terms.shapes import Column
from ppshw.terms.shapes.context import ALONG

# A function of a link's own load that is finest where it changes sign may be clearance. It may say so much more than a
# stiffness that is no more than that: stiffness between two knees was 1.5 % behind (798 and 810), clearance called
# stiffness 4.1 % (24610).
AKIN = 0.98
# A gap may change with a temperature, a load, time or the time to settle, or let go sideways too, and is still one,
# if most of it is always there and in its own direction: 0.88 and 0.94 of what was said by gaps that closed as a nut
# warmed, 0.90 by one that tilts (two other authors' 10061, 10075, 8001).
ALWAYS = 0.85
# Of a base that moves with a temperature, beside growth of what only turns about its own axis: in all directions that
# says as much as growth along one of them, less what they cost (28.4 and 26.1; sealed 64009), and 12 % more where the
# tracker's scale goes with the air (65.4 and 73.2).
OTHER_WAYS = 0.9
# Of friction any function of the way since its joint turned back may say a little more, for no real one winds up as the
# library's: 2.1 % of loud Bouc-Wen friction (another author's 9207). Of play that has no name it says far more.
WOUND_UP = 0.97
SMOOTH = frozenset({"covariate", "load_legendre"})
OF_A_LOAD = frozenset({"nonlinear_stiffness", "clearance"})  # any function of a link's own load is one or the other
JUMPS = frozenset({"step", "hopping"})
FALLS = frozenset({"load_side", "load_side_held"})  # to one side or the other, at whichever joint that bears the load
READ = frozenset({"sensor_error", "weighed"})  # functions of what the force sensor read, or should have
SHIFTS = COMPONENTS[:3]
HARDLY_TURNS = 0.15  # rad: what grows by 10 µm goes 1.5 µm aside
ONE_AXIS = 1e-3  # m and rad by which two axes may be apart that are one


@dataclass(frozen=True)
class Unturned:
    """What points the same way in the base wherever the machine stands: frames behind no revolute joint, the base's
    first; shifts along an axis of any frame, (frame, component), and links, by the joint that they are behind, that no
    joint's travel turns by much: a turn about an axis leaves what points along it as it was. turns: of a first joint
    that turns about an axis of the base, through its origin, its (frame, component) and the base's, which are one."""

    frames: tuple[str, ...] = ()
    shifts: frozenset[tuple[str, str]] = frozenset()
    links: frozenset[int] = frozenset()
    turns: frozenset[tuple[str, str]] = frozenset()


def of_its_kind(
    named: Candidate,
    rival: Candidate,
    unturned: Unturned = Unturned(),
    inside: tuple[str, ...] = (),
    both_of_a_load: bool = False,
) -> bool:
    """Whether a rival without a name would bear the name's, by what the name means (contract, §4).

    unturned  what never turns against the base: a shift of it is the base's, too
    inside    how columns end that are temperatures within the machine, which move no base: there a slow clock
    """
    here = (named.frame, named.component) == (rival.frame, rival.component)
    over = set(rival.covariates) or {rival.covariate}
    match named.effect:
        case "cross_coupling":
            return over == set(named.covariates)
        case "drift":
            return rival.frame == named.frame and all(name == "time" or name.endswith(inside) for name in over)
        case "backlash":  # from which side its joint came, and nothing else; it may rock as it turns back
            return here and rival.covariates == (named.covariate,)
        case "friction_hysteresis":  # what winds up over whichever ways (sealed 81071 lost its name to that)
            return here and all(column.function == "winding" for column in rival.columns)
        case "zero_shift":
            there = here or (_alike(named, rival, unturned) and named.component == rival.component)
            there = there or {(k.frame, k.component) for k in (named, rival)} <= unturned.turns
            return there and all(column.function in JUMPS for column in rival.columns)
        case "thermal_growth":
            plain = {name.split("_", 2)[2] if name.startswith("late_") else name for name in over}
            if named.joint is None:  # every link grows
                return named.covariate in plain and all(k == named.covariate or k.startswith("q_") for k in plain)
            if _warms_the_base(named, rival, unturned):
                return named.frame in unturned.frames or not all(map(_moves_the_base, rival.columns))
            there = rival.frame == named.frame or _alike(named, rival, unturned)
            heat = plain - {f"q_{named.joint}"}  # by another thermometer it is growth, too (another author's 64068)
            return there and bool(heat) and all(k == named.covariate or k.startswith("temp_") for k in heat)
        case "tracker_scale":  # about wherever the instrument stands
            scales = [column for column in rival.columns if column.function == "scale"]
            return bool(scales) and all(column in scales or _moves_the_base(column) for column in rival.columns)
        case "periodic_transmission":  # a band of waves over its own position, its own among them
            return here and over == {named.covariate} and all(column.function == "wave" for column in rival.columns)
        case "target_moved":
            return over == {named.covariate}
        case "creep":
            return any(name.startswith("late_") and "_on_" in name for name in over)
        case "nonlinear_stiffness" if both_of_a_load:
            return _of_its_load(named, rival)
        case "clearance":
            falls = all(column.function in FALLS for column in rival.columns)
            return falls or (both_of_a_load and _of_its_load(named, rival))
        case "nonlinear_stiffness":
            return _of_its_load(named, rival) and all(column.function in SMOOTH for column in rival.columns)
        case "missing_compliance":  # that changes along its joint's travel, by waves
            return here and all(column.function == "load_wave" for column in rival.columns)
        case "moving_weight":
            return all(column.function == "own_weight" for column in rival.columns)
        case "wrench_error":
            # in proportion to another reading, which is cross-talk (sealed 43027); not by a function of it that bends
            leaks = [c for c in rival.columns if c.function == "sensor_off" and c.args["count"] == 1]
            leaked = over <= set(WRENCH_COMPONENTS) and len(leaks) == len(rival.columns)
            return leaked or all(column.function in READ for column in rival.columns)
    return False


def that_hold(name: tuple[str, str | None], last: str) -> list[tuple[str, str | None]]:
    """Names under which a joint's jump is one of several, and which therefore show all that it does: of all zeros, or
    of what is behind the last joint. They are behind it by what the others cost."""
    if name[0] != "zero_shift" or name[1] is None:
        return []
    return [("zero_shift", None), *[("target_moved", None)] * (name[1] == last)]


def counts(named: Candidate, rival: Candidate, unturned: Unturned = Unturned()) -> float:
    """The share of a rival's evidence that counts against a name."""
    if named.effect == "thermal_growth" and _warms_the_base(named, rival, unturned):
        return OTHER_WAYS
    if named.effect == "nonlinear_stiffness" and _of_its_load(named, rival):
        return AKIN
    here = (named.frame, named.component) == (rival.frame, rival.component)
    if named.effect == "friction_hysteresis":
        return WOUND_UP if here and winds_up(named, rival) else 1.0
    if named.effect != "backlash" or rival.covariates[:1] != (named.covariate,):
        return 1.0
    beside = [COMPONENTS[column.component] for column in named.columns[1:] if column.component != ALONG]
    if len(rival.covariates) == 1 and rival.component in beside:
        return 1.0  # what rocks sideways alone is a cable
    as_friction = any(name.startswith("way_") for name in rival.covariates)
    return 1.0 if here and (as_friction or len(rival.covariates) == 1) else ALWAYS


def winds_up(named: Candidate, rival: Candidate) -> bool:
    """Whether a rival is any function of the way since the joint of a finding turned back, at whichever frame."""
    return rival.covariates == (f"approach_{named.joint}", f"way_{named.joint}")


def stranger_than(named: Candidate, rival: Candidate) -> bool:
    """Whether a rival that says the same would be the odder story: beside growth with a temperature, compliance that
    changes with it. Under a load that hardly changes, as own weight is, both are one function, and quiet growth lost
    its name to that (41009, 42086, two other authors' 030 and 053, by 0.1 to 2.5 of log evidence)."""
    softens = any(column.function in ("load_warm", "softened") for column in rival.columns)
    return named.effect == "thermal_growth" and softens and named.covariate in rival.covariates


def of_a_load(finding: Candidate) -> int | None:
    """The component of the wrench that a finding gives way to out of proportion, by a name or without one."""
    covariate, over = finding.covariate, {name.removeprefix("previous_") for name in finding.covariates}
    if finding.effect == "nameless" and len(over) == 1 and min(over).startswith("on_"):
        covariate = min(over).rsplit("_", 1)[1]
    elif finding.effect not in OF_A_LOAD:
        return None
    return WRENCH_COMPONENTS.index(covariate) if covariate in WRENCH_COMPONENTS else None


def _of_its_load(named: Candidate, rival: Candidate) -> bool:
    """Whether a rival is a function of the very load that the name goes with, at the very place, out of proportion."""
    here = (named.frame, named.component) == (rival.frame, rival.component)
    in_proportion = all(column.function == "load" for column in rival.columns)
    return here and not in_proportion and rival.covariates == (f"on_{named.frame}_{named.covariate}",)


def _alike(named: Candidate, rival: Candidate, unturned: Unturned) -> bool:
    """Whether both are shifts, of frames that never turn against the base."""
    shifts = not any((k.component or "").startswith("r") for k in (named, rival))
    return shifts and {rival.frame, named.frame} <= set(unturned.frames)


def _moves_the_base(column: Column) -> bool:
    return column.on == "frame" and column.frame == 0


def _warms_the_base(named: Candidate, rival: Candidate, unturned: Unturned) -> bool:
    """Whether growth shifts along what never turns, and a rival moves the base, beside anything, by whichever
    thermometer: that would be growth, too."""
    heat = set(rival.covariates or (rival.covariate or "",)) - {f"q_{named.joint}"}
    by_heat = bool(heat) and all("temp_" in name for name in heat)
    return by_heat and only_shifts(named, unturned) and any(map(_moves_the_base, rival.columns))


def only_shifts(named: Candidate, unturned: Unturned) -> bool:
    """Whether growth does nothing but shift along what never turns: what the base may do as well."""
    links = [column.args["joint"] for column in named.columns if column.function == "link_growth"]
    if links:
        return set(links) <= unturned.links
    return (named.frame, named.component) in unturned.shifts


def never_turned(machine: Machine) -> Unturned:
    """What points the same way wherever a machine stands, over its travel (half a turn either way without limits)."""
    lower, upper = travel(machine)
    middle = frames(machine, (lower + upper)[None] / 2)[0, :, :3, :3]
    rails = itertools.takewhile(lambda joint: joint.prismatic, machine.joints)
    swings = np.stack([
        middle[k + 1] @ joint.axis * (0.0 if joint.prismatic else (upper[k] - lower[k]) / 2)
        for k, joint in enumerate(machine.joints)
    ])  # fmt: skip

    def stays(frame: int, way: NDArray[np.float64]) -> bool:
        aside = np.cross(swings[:frame], middle[frame] @ way)
        return bool(np.linalg.norm(aside, axis=-1).sum() <= HARDLY_TURNS * np.linalg.norm(way))

    links = [*(joint.origin for joint in machine.joints[1:]), machine.tip_in_link]
    return Unturned(
        (machine.frame_names[0], *(joint.name for joint in rails)),
        frozenset(
            (name, component)
            for frame, name in enumerate(machine.frame_names)
            for component, way in zip(SHIFTS, np.eye(3), strict=True)
            if stays(frame, way)
        ),
        frozenset(k for k, link in enumerate(links) if stays(k + 1, link[:3, 3])),
        _turns_of_the_base(machine),
    )


def _turns_of_the_base(machine: Machine) -> frozenset[tuple[str, str]]:
    """A first joint's (frame, component) and the base's, where it turns about one of the base's axes."""
    first = machine.joints[0]
    way, at = first.origin[:3, :3] @ first.axis, first.origin[:3, 3]
    of_base, own = int(np.argmax(np.abs(way))), int(np.argmax(np.abs(first.axis)))
    aside = float(np.linalg.norm(at - (at @ way) * way))
    askew = [1.0 - float(np.abs(v).max()) for v in (way, first.axis)]
    if first.prismatic or aside > ONE_AXIS or max(askew) > ONE_AXIS**2:
        return frozenset()
    base, frame = machine.frame_names[:2]
    return frozenset({(base, COMPONENTS[3 + of_base]), (frame, COMPONENTS[3 + own])})
