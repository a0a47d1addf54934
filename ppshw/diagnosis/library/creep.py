"""Creep: of the whole machine, of a link, in one direction or in all, from what hung there before or from nothing."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from ppshw.diagnosis.library.candidate import Candidate
from ppshw.diagnosis.library.sampled import elastic_frames, loads_on
from ppshw.terms import COMPONENTS
from ppshw.terms.shapes import Column, Context

CREEP_H = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
SLOWER = 3  # steps of that grid from a fast creep to the slow one beside it: eight times
MUCH, MOST_ELEMENTS = 0.03, 18  # of a link's compliance: beside the largest, and how many
ANY_WAY = ("exponential", "log", "total")  # ways to creep in all directions under one component of the load
NOBODY_SAYS = {""}  # which load it is
FOLLOWS = ("wrench", "total")  # what acts, whatever it is called
ALONG = ("exponential", "log", "wrench", "total")
# Share of a creep of every link alike, beside a link's: forty creeps of eleven authors were all of one link (three were
# every link's, one by 2.9 of log evidence), which makes it 1.2 % and each of six links 16 % (Jeffreys 1946).
OF_ALL_LINKS = 0.07
OF_THE_RIGID = 0.3  # share of a link's creep that the file has rigid, as of one that it lets bend
BY_WEIGHT = ("exponential", "log")  # of what hangs there, whatever its moment in the pose: under what bears it alike


def creeping(c: Context, finely: bool = False) -> Iterator[Candidate]:
    """finely: something creeps here, and its slow part may be four or sixteen times as slow as its fast one."""
    labels = set(c.recording.load)
    if len(labels) < 2 and labels != NOBODY_SAYS:
        return
    forms: tuple[tuple[str, float], ...] = (
        ("exponential", 1.0), ("log", 1.0), ("last", 0.5), ("wrench", 0.5), ("total", 0.5)
    )  # fmt: skip
    if labels == NOBODY_SAYS:  # when a load came its weight tells as well
        forms = tuple(form for form in forms if form[0] in FOLLOWS)
    if not c.recording.has_wrench:  # the machine's own weight is all that is known
        forms = forms[-1:]
    # alone, or beside one that creeps on where it has come to rest, as in load cells
    rates: list[tuple[float, ...]] = [(tau,) for tau in CREEP_H]
    for slower in (SLOWER - 1, SLOWER, SLOWER + 1) if finely else (SLOWER,):
        rates += zip(CREEP_H, CREEP_H[slower:], strict=False)
    ways = [
        (form, half, taus) for taus in rates for form, half in forms if form not in ("log", "last") or len(taus) == 1
    ]  # fmt: skip
    for form, half, taus in ways:
        shape = dict(zip(("tau_h", "slow_tau_h"), taus, strict=False))
        whole = tuple(Column("frames", "creep", {"tau": tau, "form": form}) for tau in taus)
        yield Candidate("creep", None, None, None, "since_load_change", whole, shape, OF_ALL_LINKS * half)
        for frame, name, acting in elastic_frames(c):
            link = tuple(Column("frames", "creep", {"tau": tau, "form": form, "frame": frame}) for tau in taus)
            yield Candidate("creep", name, name, None, "since_load_change", link, shape, half)
            for b in acting:
                where = {"frame": frame, "component": b, "form": form}
                columns = tuple(Column("frame", "creeping", {**where, "tau": tau}, frame, b) for tau in taus)
                yield Candidate(
                    "creep", name, name, COMPONENTS[b], "since_load_change", columns, shape,
                    half if b > 2 else 0.3 * half,
                )  # fmt: skip
                if len(taus) == 1 and form in ANY_WAY:  # that load bends and stretches it in other directions too
                    where |= {"tau": taus[0]}
                    any_way = tuple(Column("frame", "creeping", where, frame, comp) for comp in range(6))
                    yield Candidate("creep", name, name, None, "since_load_change", any_way, shape, 0.2 * half)
            if len(taus) == 1 and form in BY_WEIGHT:
                of = {"frame": frame, "component": -1, "form": form, "tau": taus[0]}
                for comp in range(6):
                    heavy = (Column("frame", "creeping", of, frame, comp),)
                    yield Candidate(
                        "creep", name, name, COMPONENTS[comp], "since_load_change", heavy, shape, 0.1 * half
                    )
            if len(taus) == 1 and form in ALONG and len(acting) > 1:  # along all its loads, each by a share of its own
                of = {"frame": frame, "form": form, "tau": taus[0]}
                along = tuple(Column("frame", "creeping", {**of, "component": b}, frame, b) for b in acting)
                yield Candidate("creep", name, name, None, "since_load_change", along, shape, half)
            if len(taus) == 1 and form in ANY_WAY and len(elements := much_of_it(c, frame, acting)) > 1:
                of = {"frame": frame, "form": form, "tau": taus[0]}
                free = tuple(Column("frame", "creeping", {**of, "component": b}, frame, comp) for comp, b in elements)
                yield Candidate("creep", name, name, None, "since_load_change", free, shape, half)


def creeping_though_rigid(c: Context) -> Iterator[Candidate]:
    """Links that the machine file has rigid, which give way only as a load stays: pads, and resin of a couch top."""
    if len(set(c.recording.load)) < 2 or not c.recording.has_wrench:
        return
    for k, joint in enumerate(c.machine.joints):
        for b in loads_on(c, k + 1) if joint.elastic is None else ():
            for tau, form in itertools.product(CREEP_H, ANY_WAY):
                late = Column("frame", "creeping", {"frame": k + 1, "component": b, "form": form, "tau": tau}, k + 1, b)
                where = ("creep", joint.name, joint.name, COMPONENTS[b], "since_load_change")
                yield Candidate(*where, (late,), {"tau_h": tau}, OF_THE_RIGID if b > 2 else 0.3 * OF_THE_RIGID)


def much_of_it(c: Context, frame: int, acting: Sequence[int]) -> list[tuple[int, int]]:
    """The elements of a link's compliance, displacement by load, that make much of its deflection, each of which creeps
    by a share of its own: what is known of a link of which each element is free is too little to have one for all."""
    gives = np.abs(c.compliance[:, frame]).mean(axis=0) * c.wrenches[:, frame].std(axis=0)
    size = gives * np.sqrt((c.jacobian[:, :, frame] ** 2).sum(axis=1).mean(axis=0))[:, None]
    order = np.dstack(np.unravel_index(np.argsort(-size, axis=None), size.shape))[0].tolist()
    large = [(comp, b) for comp, b in order if b in acting and size[comp, b] > MUCH * size.max()]
    return sorted(large[:MOST_ELEMENTS])


def creeping_from_nothing(c: Context) -> Iterator[Candidate]:
    """Links that creep where nothing had hung there before the recording, or something else."""
    if len(set(c.recording.load)) < 2:
        return
    began = [("total", "began")] + [("exponential", "first")] * c.recording.has_wrench
    for forms, tau, (frame, name, acting) in itertools.product(began, CREEP_H, list(elastic_frames(c))):
        for b in acting:
            args = {"frame": frame, "component": b, "tau": tau}
            both = tuple(Column("frame", "creeping", {**args, "form": form}, frame, b) for form in forms)
            yield Candidate("creep", name, name, COMPONENTS[b], "since_load_change", both, {"tau_h": tau}, 0.3)
