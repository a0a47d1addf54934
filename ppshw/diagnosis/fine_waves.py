"""Waves of short periods that a residual shows: those too many to try each as a candidate.

Screws of millimetres on axes of metres, racks, magnetic scales and bearings make hundreds to thousands of waves over a
travel, along it or across. What the base model leaves is a smooth function's no longer, so the score of a wave is that
of its two phases on the residual alone, and all periods are asked at once (a periodogram; Scargle 1982). The best of
every joint's component becomes a candidate; what it is worth counts all that it was chosen from: `library` gives it
their share.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.library.by_position import ACROSS_TRIED, FineWave, half_waves_tried
from ppshw.diagnosis.library.sampled import own_component, waving_joints
from ppshw.diagnosis.workspace import Workspace

Array = NDArray[np.float64]
# Shortest periods: scales of 2 mm, and what a strain wave gear of 320:1 errs by once a turn. No more half waves than
# this over a travel.
LINEAR, ROTARY, MOST = 0.002, np.pi / 160, 8000
BETWEEN = np.arange(-0.5, 0.51, 0.1)  # half waves beside one that was asked
QUIET = 8.0  # log likelihood of a wave that is not worth a candidate, beside its share
NEARLY = 0.5  # of log likelihood: of waves that say as much, as on a grid of setpoints, the longest
BLOCK = 256  # periods at a time


def fine_waves(space: Workspace) -> list[FineWave]:
    """The best of every waving joint in every component, beside what the workspace has taken up."""
    c, found = space.context, []
    left = space.left().reshape(-1, space.rows)
    for k, _ in waving_joints(c):
        joint, own = c.machine.joints[k], own_component(c, k)
        q, span = c.recording.q[space.fit, k], float(np.ptp(c.recording.q[:, k]))
        last = min(int(2 * span / (LINEAR if joint.prismatic else ROTARY)), MOST)
        components = dict.fromkeys([*range(6), own])
        white = {b: np.einsum("nij,nj->ni", space.root[space.fit], c.moved(k + 1, b)[space.fit]) for b in components}
        scores = np.stack([(w * left).sum(axis=1) for w in white.values()])
        weights = np.array([(w**2).sum() for w in white.values()])
        half_waves = np.arange(ACROSS_TRIED + 1, last + 1.0)
        if not len(half_waves):
            continue
        said = _said(q / span, half_waves, scores, weights)
        for b, its_scores, weight, its in zip(components, scores, weights, said, strict=True):
            asked = half_waves > (half_waves_tried(c, k)[-1] if b == own else ACROSS_TRIED)
            if not asked.any():
                continue
            best = float(half_waves[asked][np.argmax(its[asked] > its[asked].max() - NEARLY)])
            near = best + BETWEEN
            there = _said(q / span, near, its_scores[None], np.array([weight]))[0]
            if there.max() > QUIET:
                period = 2 * span / float(near[np.argmax(there)])
                found.append(FineWave(k, b, period, int(asked.sum()) + len(BETWEEN)))
    return found


def _said(u: Array, half_waves: Array, scores: Array, weights: Array) -> Array:
    """(C, W) log likelihood that a wave of both phases gains, over positions u (F,) in travels, for visits' scores
    (C, F) and weights (C,)."""
    out = np.empty((len(scores), len(half_waves)))
    for at in range(0, len(half_waves), BLOCK):
        part = slice(at, at + BLOCK)
        turned = np.exp(1j * np.pi * half_waves[part, None] * u)
        out[:, part] = np.abs(scores @ turned.T) ** 2
    return np.asarray(out / np.maximum(weights, 1e-300)[:, None])
