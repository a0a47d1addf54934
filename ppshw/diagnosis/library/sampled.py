"""Where and when a recording can show anything: joints that move, loads that vary, temperatures, moments."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ppshw.identification.plausible import LOADED_N, LOADED_NM
from ppshw.machine import Machine
from ppshw.terms import COMPONENTS
from ppshw.terms.shapes import Column, Context
from ppshw.terms.shapes.context import ALONG

AIR = "air"  # the place of a thermometer that hangs in it
LAGS_H = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)  # behind a thermometer
STRAIGHT = 1 - 1e-6  # of its unit vector: an axis within a milliradian of its frame's is along it
FORCES_MOMENTS = (slice(0, 3), slice(3, 6))
VARIES = 0.05  # of its largest value: a load that varies less is constant
FEW_PLACES = 12  # at which a joint stood: through so many any wave goes (a judgement)
MOMENTS = 40  # at which something may have happened, where trying every moment would take too long


def own_component(c: Context, k: int) -> int:
    """The component of its frame in which joint k moves; `ALONG` where its axis is oblique to all of the frame's."""
    oblique = np.abs(c.machine.joints[k].axis).max() < STRAIGHT
    return ALONG if oblique else nearest_component(c, k)


def nearest_component(c: Context, k: int) -> int:
    """The component of its frame that is nearest to where joint k moves."""
    axis = np.abs(c.machine.joints[k].axis)
    return int(np.argmax(axis)) + (0 if c.machine.joints[k].prismatic else 3)


def called(c: Context, frame: int, component: int) -> str:
    """What a component of a frame is called; along an oblique axis what is nearest to it."""
    return COMPONENTS[nearest_component(c, frame - 1) if component == ALONG else component]


def moving_joints(c: Context) -> Iterator[tuple[int, str]]:
    for k, name in enumerate(c.machine.joint_names):
        if np.ptp(c.recording.q[:, k]) > 0:
            yield k, name


def waving_joints(c: Context) -> Iterator[tuple[int, str]]:
    """Joints that stood at enough places of their travel to tell one wave from another."""
    for k, name in moving_joints(c):
        q = c.recording.q[:, k]
        if len(np.unique(np.round((q - q.min()) / np.ptp(q), 3))) > FEW_PLACES:
            yield k, name


def came_from_both_sides(c: Context, k: int) -> bool:
    return {-1, 1} <= set(c.recording.approach[:, k].tolist())


def loads_on(c: Context, frame: int) -> list[int]:
    """Wrench components that really vary on a frame, beside its largest load, or beside what the sensor's readings vary
    by where own weights are many times that (158 N m of payloads beside 7,800 of links; a sixty-fourth author's 008):
    a constant load says nothing."""
    w = c.wrenches[:, frame]
    size = np.abs(w).max(axis=0)
    read = np.ptp(c.recording.wrench, axis=0) if c.recording.has_wrench else np.zeros(6)
    reference = [min(float(size[part].max()), float(read[part].max()) or np.inf) for part in FORCES_MOMENTS]
    return [k for k in range(6) if np.ptp(w[:, k]) > VARIES * max(reference[k // 3], 1e-9)]


def presses(c: Context, k: int) -> list[int]:
    """By which loads that really vary lost motion of joint k and its teeth may go: the force upon it (-1), or what its
    drive holds (a component)."""
    own, force = nearest_component(c, k), np.linalg.norm(c.wrenches[:, k + 1, :3], axis=1)
    out = [-1] if np.ptp(force) > VARIES * force.max() else []
    return [*out, own] if own in loads_on(c, k + 1) else out


def tilts(c: Context, k: int) -> list[int]:
    """By which moments upon it that really vary what joint k loses may go one way or the other."""
    return [load for load in loads_on(c, k + 1) if load >= 3]


def elastic_frames(c: Context) -> Iterator[tuple[int, str, list[int]]]:
    """Frames of links that the machine file lets bend, their joints, and the loads that bend them and vary there."""
    for k, joint in enumerate(c.machine.joints):
        if joint.elastic is not None:
            known = joint.elastic.load_indices
            yield k + 1, joint.name, [b for b in loads_on(c, k + 1) if b in known]


def read_channels(c: Context) -> list[int]:
    """Channels of the force sensor that vary, where anything ever hung there: with nothing on it nothing goes with it
    (a moving weight was a moment that it read, of 0.5 N m, times a smooth function of a position; a reviewer's)."""
    r = c.recording
    if not r.has_wrench:
        return []
    force, moment = np.abs(r.wrench[:, :3]).max(initial=0.0), np.abs(r.wrench[:, 3:]).max(initial=0.0)
    if len(set(r.load)) < 2 and force < LOADED_N and moment < LOADED_NM:
        return []
    return [k for k in range(6) if np.ptp(r.wrench[:, k]) > 0]


def temperature_places(c: Context) -> list[str]:
    """Temperatures without gaps that change at all."""
    return [p for p, t in c.recording.temperatures.items() if np.isfinite(t).all() and np.ptp(t) >= 1e-3]


def nobody_knows(c: Context) -> list[str]:
    """Columns beyond the contract's own, of which nothing is known but their names: without gaps, and that change."""
    r = c.recording
    return [f"cov_{k}" for k, v in r.covariates.items() if np.isfinite(v).all() and np.ptp(v) > 0]


def within(machine: Machine) -> tuple[str, ...]:
    """How columns of temperatures end that are of joints beyond the first: what warms there does not move the base."""
    return tuple(f"temp_{name}_C" for name in machine.joint_names[1:])


def moments_between(c: Context, most: int) -> list[float]:
    """Moments between visits, evenly, some way from both ends [h]."""
    count = len(c.hours)
    return [float(t) for t in (0.5 * (c.hours[1:] + c.hours[:-1]))[8 : count - 8 : max(1, count // most)]]


def moments_about(c: Context, about: Sequence[float]) -> list[float]:
    """Forty moments, and all between two visits that are as near to one of `about` as its neighbours are."""
    grid, every = np.array(moments_between(c, MOMENTS)), np.array(moments_between(c, len(c.hours)))
    if not len(grid) or not len(about):
        return [float(t) for t in grid]
    away = np.min(np.abs(every[:, None] - np.array(about)), axis=1)
    return sorted({*map(float, grid), *map(float, every[away <= 1.01 * np.diff(grid).max()])})


def that_act(c: Context, columns: Sequence[Column], hardly: float = 1e-6) -> tuple[Column, ...]:
    """Those that do more than such a part of what the largest does: a channel that reads nothing, an axis that stays
    plumb do not."""
    size = [float(np.abs(column.value(c)).max()) for column in columns]
    return tuple(column for column, most in zip(columns, size, strict=True) if most > hardly * max(size))
