"""What a positioner measured, with a displacement put in by hand, and the search for it among some candidates."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.evidence import Tried
from ppshw.diagnosis.found import Found
from ppshw.diagnosis.library import Candidate, library
from ppshw.diagnosis.library.sampled import own_component
from ppshw.diagnosis.nameless import nameless
from ppshw.diagnosis.search import search
from ppshw.diagnosis.workspace import Workspace
from ppshw.terms.shapes import Column

Array = NDArray[np.float64]
NAME = "pitch"  # whose travel is short


def on_joint(space: Workspace, function: str, **args: object) -> Column:
    k = space.machine.joint_names.index(NAME)
    return Column("frame", function, {"joint": k, **args}, k + 1, own_component(space.context, k))


def travel_of(space: Workspace) -> float:
    return float(np.ptp(space.recording.q[:, space.machine.joint_names.index(NAME)]))


def moved_by(space: Workspace, column: Column, times: float) -> Workspace:
    """The same recording of a machine whose joint does this as well, so many repeatabilities rms at the reflectors."""
    return having_read(space, space.data + of_size(space, column.evaluate(space.context), times))


def moved_along(space: Workspace, name: str, course: Array, times: float) -> Workspace:
    """The same recording of a machine whose joint errs by a course (N,) in its own direction, so many repeatabilities
    rms at the reflectors."""
    k = space.machine.joint_names.index(name)
    moved = space.context.jacobian[:, :, k + 1, own_component(space.context, k)] * course[:, None]
    return having_read(space, space.data + of_size(space, moved, times))


def having_read(space: Workspace, data: Array) -> Workspace:
    """The same machine, visits and noise with other readings (N, 3T): what knows nothing of them is worked out once."""
    _ = space.directions
    other = copy(space)
    other.data, other.y = data, other.whiten(data[..., None])[:, 0]
    other.forget()
    return other


def of_size(space: Workspace, moved: Array, times: float) -> Array:
    """A displacement (N, 3T) made so many repeatabilities rms at the reflectors."""
    return np.asarray(moved * (times * 5e-5 / np.sqrt((moved**2).sum() / space.recording.seen.sum())))


_CANDIDATES: dict[int, list[Candidate]] = {}  # of a context, which all workspaces of a recording share


def named(space: Workspace, *effects: str) -> list[Candidate]:
    """Candidates of some effects, or without a name."""
    every = _CANDIDATES.setdefault(id(space.context), [])
    every += [] if every else library(space.context) + nameless(space.context)
    return [k for k in every if k.effect in effects]


def creep_and_riddles(space: Workspace) -> list[Candidate]:
    """Of one joint's own component: few, for what only asks who is who."""
    creeping = [k for k in named(space, "creep") if k.joint == NAME and k.component]
    place = creeping[0].frame, creeping[0].component
    return creeping + [k for k in named(space, "nameless") if (k.frame, k.component) == place]


def look(
    space: Workspace, effects: Sequence[str], about: str = "", without: Collection[str] = ()
) -> tuple[list[Found], Tried]:
    """about: a joint that rivals without a name sit at or speak of; all of them by default. without: taken out of the
    library by whoever asks."""
    rivals = [k for k in named(space, "nameless") if k.frame == about or any(about in name for name in k.covariates)]
    some = named(space, *effects) + rivals
    tried = Tried(space, some, 5e-5, frozenset(without))
    return search(space, tried, np.random.default_rng(0)), tried


def best_of(tried: Tried, found: Found) -> Candidate:
    return tried.candidates[found.best]
