"""Finer functions of one position than the base model has, and any of two and of three."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ppshw.diagnosis.library.by_position import FINELY_TWO, FineWave, fine, of_two
from ppshw.diagnosis.library.candidate import Candidate
from ppshw.diagnosis.library.sampled import moving_joints, own_component
from ppshw.diagnosis.nameless.rival import half_waves, rival, smooth_pair
from ppshw.terms.shapes import Column, Context

OCTAVES = (3, 6, 12)  # waves over a joint's travel, from these to twice as many, that nobody names
IN_ITS_DIRECTION = (24, 48)  # and in the joint's own direction
DENTS = (0.05, 0.1)  # widths relative to half the travel

SPLICES = 63  # places of a travel where a step is sought


def finely(c: Context, waves: Sequence[FineWave] = ()) -> Iterator[Candidate]:
    """A function of one position finer than the base model's, octave by octave, and waves finer than these."""
    for k, name in moving_joints(c):
        finer = [(own_component(c, k), least) for least in IN_ITS_DIRECTION]
        for comp, least in [*itertools.product(range(6), OCTAVES), *finer]:
            yield rival(c, k + 1, comp, (f"q_{name}",), half_waves(c, k, comp, range(2 * least, 4 * least, 2)))
    for wave in fine(c, waves):
        yield replace(wave, effect="nameless", joint=None, covariates=(wave.covariate,), shape={})


def dents(c: Context) -> Iterator[Candidate]:
    """At one place of the travel alone: a track that was hit, a tooth, an entry of a table."""
    for (k, name), comp, width in itertools.product(moving_joints(c), range(6), DENTS):
        for at in np.arange(-1.0 + width, 1.0, 1.5 * width):
            yield rival(c, k + 1, comp, (f"q_{name}",), [
                Column("frame", "dent", {"joint": k, "at": float(at), "width": width, "order": j}, k + 1, comp)
                for j in range(3)
            ])  # fmt: skip


def splices(c: Context) -> Iterator[Candidate]:
    """A step at one place of the travel, as where one rail follows another."""
    for (k, name), comp in itertools.product(moving_joints(c), range(6)):
        for at in np.linspace(-1.0, 1.0, SPLICES + 2)[1:-1]:
            yield rival(c, k + 1, comp, (f"q_{name}",), (
                Column("frame", "splice", {"joint": k, "at": float(at)}, k + 1, comp),
            ))  # fmt: skip


def of_two_positions(c: Context) -> Iterator[Candidate]:
    """Where one of the two joints stands, by any smooth function of both; by a finer one of its own that goes in
    proportion to the other."""
    for (k, one), (m, other) in itertools.combinations(moving_joints(c), 2):
        for frame, comp in itertools.product((k + 1, m + 1), range(6)):
            if frame != c.machine.n:  # the tip's are in by_columns
                yield smooth_pair(c, frame, comp, f"q_{one}", f"q_{other}")
    for (k, one), (m, other) in itertools.permutations(moving_joints(c), 2):
        for comp in range(6):
            names = (f"q_{one}", f"q_{other}")
            yield rival(c, k + 1, comp, names, [
                Column("frame", *of_two(k, i, m, 1), k + 1, comp) for i in range(7)
            ])  # fmt: skip
            yield rival(c, k + 1, comp, names, [
                Column("frame", *of_two(k, i, m, j), k + 1, comp) for i, j in FINELY_TWO
            ])  # fmt: skip
            for least in OCTAVES[:2]:
                in_proportion = half_waves(c, k, comp, range(2 * least, 4 * least, 2), "wave_q", by=m)
                yield rival(c, k + 1, comp, names, in_proportion)


def of_three_positions(c: Context) -> Iterator[Candidate]:
    for three in itertools.combinations([k for k, _ in moving_joints(c)], 3):
        names = tuple(f"q_{c.machine.joint_names[k]}" for k in three)
        for frame, comp in itertools.product((k + 1 for k in three), range(6)):
            product = Column("frame", "product", {"joints": three}, frame, comp)
            yield rival(c, frame, comp, names, (product,))
