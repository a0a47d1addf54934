"""Corrected setpoints: compensate, move."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ppshw.cli.answers import say, warn
from ppshw.cli.arguments import joint_values, machine_of, numbers, pairs
from ppshw.errors import BadInput
from ppshw.file_lock import require_a_system_that_locks
from ppshw.progress import Bar, folded
from ppshw.quantities import many

NO_LOAD = ["0 0 0 0 0 0"]  # where --wrench is not given
MOST_TURNED = 2 * np.pi  # an angle of a pose [rad], before it looks like degrees


def _circumstances(a: argparse.Namespace, calibration: Any) -> Any:
    """What is known of the move beyond its end and its load: effects that a diagnosis found may depend on it."""
    from ppshw.compensation import Circumstances
    from ppshw.recording import Around

    machine = calibration.machine
    approach = np.zeros(machine.n, dtype=np.int64)
    for joint, sign in pairs(a.approach, machine.joint_names, "--approach", "joint").items():
        if sign not in (-1.0, 1.0):
            raise BadInput(f"--approach {joint}: {sign:g}, expected +1 or -1")
        approach[machine.joint_names.index(joint)] = int(sign)
    start = None if a.start is None else joint_values(a.start, machine, "--from")
    around = Around(temperatures=_temperatures(a, calibration))
    if a.lay_before is not None and a.loaded_for is None:
        raise BadInput("--lay-before: has no meaning without --loaded-for")
    before = None if a.lay_before is None else numbers(a.lay_before, 6, "--lay-before")
    return Circumstances(start, approach, around=around, loaded_for=a.loaded_for, lay_before=before)


def _temperatures(a: argparse.Namespace, calibration: Any) -> dict[str, float]:
    """Places and what --temperature says of them [°C]."""
    from ppshw.recording import COLDEST, WARMEST

    thermometers = list(calibration.temperature_range)
    found = pairs(a.temperature, thermometers, "--temperature", "thermometer of the calibration")
    for place, degrees in found.items():
        if not COLDEST <= degrees <= WARMEST:
            raise BadInput(f"--temperature {place}: {degrees:g} °C, expected {COLDEST:g} … {WARMEST:g} °C")
    return found


def _compensator(a: argparse.Namespace) -> tuple[Any, list[str]]:
    """What corrects setpoints by the calibration, and warnings: of what it was made from, and of options that it
    has no use for."""
    from ppshw.calibration import load_calibration
    from ppshw.compensation import Compensator
    from ppshw.machine import doubts

    machine = machine_of(a)
    calibration = load_calibration(a.calibration, machine)
    warnings = doubts(machine) + calibration.doubts()
    if a.loaded_for is not None and not any(effect.name == "creep" for effect in calibration.effects):
        warnings.append("--loaded-for: no effect here goes with the age of a load, it changes nothing")
    felt = {place for effect in calibration.effects for place in effect.places}
    unnamed = {name for effect in calibration.effects for name in effect.unnamed_over}
    for place in sorted(_temperatures(a, calibration).keys() - felt):
        if f"temp_{place}_C" in unnamed:
            warnings.append(f"--temperature {place}: what goes with it has no name, and no axis is driven by it")
        else:
            warnings.append(f"--temperature {place}: no effect here goes with it, it changes nothing")
    return Compensator(calibration, _bounds(a)), warnings


def _bounds(a: argparse.Namespace) -> Any:
    from ppshw.compensation import Bounds

    bounds = Bounds(a.max_travel, a.max_angle)
    return bounds if a.max_beyond is None else replace(bounds, joints=a.max_beyond, loads=a.max_beyond)


def check_point(name: str, machine: Any) -> None:
    """Raises BadInput where the machine file has no such point."""
    if name not in ("tip", *machine.points, *machine.targets):
        known = ", ".join(["tip", *machine.points, *machine.targets])
        raise BadInput(f"--point: no point named '{name}' in {machine.file}, expected one of {known}")


def _corrected(
    a: argparse.Namespace, compensator: Any, given: Any, warnings: list[str] | None = None
) -> tuple[dict[str, Any], str]:
    """The wanted pose, corrected under the circumstances given; `warnings` takes what is odd about them."""
    from ppshw.transforms import from_xyz_rpy

    machine = compensator.machine
    payload = numbers(a.wrench, 6, "--wrench")
    check_point(a.point, machine)
    if a.joints is not None and a.near is not None:
        raise BadInput("--near: chooses among the ways to reach a pose, and --joints says which one already")
    if a.joints is not None:
        setpoints = compensator.for_joints(numbers(a.joints, machine.n, "--joints"), payload, a.point, given)
    else:
        pose = numbers(a.pose, 6, "--pose")
        if (widest := np.abs(pose[3:]).max()) > MOST_TURNED:
            raise BadInput(f"--pose: an angle of {widest:g} rad is more than a turn; are these degrees?")
        near = given.start if a.near is None else numbers(a.near, machine.n, "--near")
        setpoints = compensator.for_pose(from_xyz_rpy(pose[:3], pose[3:]), payload, a.point, near, given)
    if warnings is not None:
        warnings += compensator.calibration.other_sides(setpoints.approach)
        outside = compensator.calibration.outside(setpoints.nominal, payload)
        warnings += [f"{each}: with std_mm as at its end, carried on there" for each in outside]
    names = machine.joint_names
    answer = {
        "setpoints": dict(zip(names, setpoints.corrected.tolist(), strict=True)),
        "nominal": dict(zip(names, setpoints.nominal.tolist(), strict=True)),
        "point": a.point,
        "predicted_error_mm": (setpoints.predicted_error * 1e3).tolist(),
        "std_mm": (setpoints.std * 1e3).tolist(),
        "compensated": [v.as_dict() for v in setpoints.effects if v.taken_out],
        "not_compensated": [v.as_dict() for v in setpoints.effects if not v.taken_out],
    }
    lines = [f"{'joint':16}{'nominal':>14}{'setpoint':>14}{'correction':>14}"]
    for k, joint in enumerate(machine.joints):
        nominal, corrected = setpoints.nominal[k], setpoints.corrected[k]
        lines.append(f"{joint.name:16}{nominal:14.6f}{corrected:14.6f}{corrected - nominal:+14.6f}  {joint.unit}")
    size = np.linalg.norm(setpoints.predicted_error) * 1e3
    std = np.linalg.norm(setpoints.std) * 1e3
    lines.append(f"{a.point}: {size:.3f} mm off without correction; predicted to {std:.3f} mm (1 sigma, 3-D)")
    if compensator.position_first or setpoints.at_odds:
        off, turned = setpoints.left[:3] * 1e3, setpoints.left[3:] * 1e3
        answer |= {"left_mm": off.tolist(), "left_mrad": turned.tolist()}
        answer |= {"at_odds": list(setpoints.at_odds)} if setpoints.at_odds else {}
        few = many(machine.n, "joint") if compensator.position_first else None
        left = f"{np.linalg.norm(off):.3f} mm and {np.linalg.norm(turned):.3f} mrad stay"
        lines.append(f"{a.point}: {left}, {why_it_stays(setpoints.at_odds, few)}")
    if a.wrench is NO_LOAD:
        lines.append("for no load: --wrench says what lies on the sensor")
    lines += [f"{v.heading()}: {v.sentence()}" for v in setpoints.effects]
    return answer, folded(lines)


def why_it_stays(at_odds: Sequence[str], joints: str | None) -> str:
    """In words, why setpoints leave something of a pose: joints at odds with themselves, too few of them (`joints`, how
    many), or both."""
    why = [f"as either side's setpoint of {', '.join(at_odds)} brings it there from the other side"] if at_odds else []
    return ", and ".join([*why, *([f"which {joints} cannot put right"] if joints else [])])


def compensate(a: argparse.Namespace) -> None:
    if a.site is not None:
        move(a)
        return
    if a.reset_faults:
        raise BadInput("--reset-faults: no drive is spoken to without --site")
    compensator, warnings = _compensator(a)
    answer, text = _corrected(a, compensator, _circumstances(a, compensator.calibration), warnings)
    warn(a.calibration, warnings)
    say(a, {**answer, "warnings": warnings}, text)


def move(a: argparse.Namespace) -> None:
    require_a_system_that_locks()
    from campaigns.plan import travel_time
    from campaigns.site import load_site, open_bench

    compensator, warnings = _compensator(a)
    machine, given = compensator.machine, _circumstances(a, compensator.calibration)
    _corrected(a, compensator, given)  # refuses before anything is switched on
    warn(a.calibration, warnings)
    site = load_site(a.site)
    if site.machine.sha256 != machine.sha256:
        there = f"'{site.machine.name}' ({site.machine.file})"
        raise BadInput(f"{a.site}: machine {there} stands there, the calibration is for {machine.file}")
    with open_bench(site) as bench, Bar() as bar:
        felt = bench.temperatures() if compensator.calibration.effects else {}
        bench.start_axes(a.reset_faults)
        here = bench.axes.positions()
        seen: list[str] = []
        answer, text = _corrected(a, compensator, _found_there(given, site, here, felt), seen)
        warn(a.calibration, seen)
        there = answer["setpoints"]
        longest = max(travel_time(j, abs(there[j.name] - here[j.name])) for j in machine.joints)
        with bar.expect("move", longest / site.speed):
            report = bench.axes.move(there)
    answer |= {"warnings": warnings + seen, "reached": dict(report.positions)}
    reached = folded(["reached: " + ", ".join(f"{j} {x:.6f}" for j, x in report.positions.items())])
    say(a, answer, f"{text}\n{reached}")


def _found_there(given: Any, site: Any, here: dict[str, float], felt: dict[str, float]) -> Any:
    """The circumstances as the site has them; what an option says goes before it."""
    start = np.array([here[j] for j in site.machine.joint_names]) if given.start is None else given.start
    around = replace(given.around, temperatures={**felt, **given.around.temperatures})
    return replace(given, start=start, run_up=run_up(site), around=around)


def run_up(site: Any) -> Any:
    """(n,) the last way of axes that the site has come from one side always, signed, 0 elsewhere [m, rad]."""
    ways = {axis.name: -(axis.approach_from or 0) * axis.approach_distance for axis in site.axes}
    return np.array([ways[j] for j in site.machine.joint_names])
