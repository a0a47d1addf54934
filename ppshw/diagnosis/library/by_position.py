"""What goes with joints' positions: periodic errors of a transmission, coupling of one joint to another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.library.candidate import Candidate
from ppshw.diagnosis.library.sampled import called, moving_joints, own_component, waving_joints
from ppshw.terms import COMPONENTS
from ppshw.terms.shapes import Column, Context

# Shortest periods: a screw of 5 mm a turn; a strain wave gear of 160:1, which errs twice a turn of its generator.
SCREW, GEAR, MOST_PERIODS = 0.005, np.pi / 160, 900
FINER = (-0.8, -0.6, -0.4, -0.2, 0.2, 0.4, 0.6, 0.8)  # half waves more over the travel, about a wave that was found
LEAST_PERIODS = 160  # half waves over the travel that are tried of every joint
ACROSS_TRIED = 48  # half waves over the travel up to which bands are tried across a joint's own direction
# Weight of waves that are finer than is tried of every joint, along its travel and in each component across.
FINE_ALONG, FINE_ACROSS = 0.3, 0.1
ABOUT_FINE = (-0.2, -0.1, 0.0, 0.1, 0.2)  # half waves more over the travel, about one of these
LUMPS = (3, 4, 5, 6, 8, 10)  # half waves over one joint's travel that go in proportion to another's position
# Half waves over two joints' travels, nine of both together: five of one where there are four of the other.
STRAIGHT = 3  # up to this order both together polynomials, beyond it cosines of as many half waves
FINELY_TWO = tuple((i, j) for i in range(1, 9) for j in range(1, 10 - i))


@dataclass(frozen=True)
class FineWave:
    """Of joint k's position in one component of its frame, finer than is tried of every joint; tried: of how many it is
    the best."""

    joint: int
    component: int
    period: float
    tried: int


def of_two(a: int, i: int, b: int, j: int) -> tuple[str, dict[str, int]]:
    """Function and arguments of two joints' positions: polynomials of low order, waves of higher."""
    if i + j <= STRAIGHT:
        return "pair", {"a": a, "power_a": i, "b": b, "power_b": j}
    return "pair_waves", {"a": a, "half_a": i, "b": b, "half_b": j}


def periodic(c: Context, about: Sequence[tuple[str, float]]) -> Iterator[Candidate]:
    for k, name in waving_joints(c):
        span = float(np.ptp(c.recording.q[:, k]))
        half_waves = half_waves_tried(c, k)
        near = [2 * span / period + np.array(FINER) for joint_name, period in about if joint_name == name]
        periods = 2 * span / np.unique(np.round(np.concatenate([half_waves, *near]), 3))
        own = own_component(c, k)
        yield from _single_waves(c, k, own, list(map(float, periods)))


def half_waves_tried(c: Context, k: int) -> NDArray[np.float64]:
    """Of joint k in its own direction, rising."""
    shortest, span = SCREW if c.machine.joints[k].prismatic else GEAR, float(np.ptp(c.recording.q[:, k]))
    return np.arange(6.0, int(np.clip(2 * span / shortest, LEAST_PERIODS, MOST_PERIODS)) + 1)


def fine(c: Context, waves: Sequence[FineWave]) -> Iterator[Candidate]:
    """Those that the residual shows most of, of all that it was asked for, and what is next to each, by which its
    period is known."""
    for wave in waves:
        own = own_component(c, wave.joint) == wave.component
        twice = 2 * float(np.ptp(c.recording.q[:, wave.joint]))
        periods = [twice / (twice / wave.period + more) for more in ABOUT_FINE]
        for candidate in _single_waves(c, wave.joint, wave.component, periods):
            candidate.share *= (FINE_ALONG if own else FINE_ACROSS) / wave.tried
            yield candidate


def periodic_across(c: Context, bands: Sequence[Candidate]) -> Iterator[Candidate]:
    """A bent screw or shaft turns the carriage about: single waves out of bands of them."""
    for band in bands:
        frequencies = sorted({1 / column.args["period"] for column in band.columns})
        if len(frequencies) == 1:  # a fine wave without its name, which its residual lays anew
            continue
        step = (frequencies[-1] - frequencies[0]) / (len(frequencies) - 1) / 4
        tried = np.arange(frequencies[0] - 2 * step, frequencies[-1] + 3 * step, step)
        first = band.columns[0]
        yield from _single_waves(c, first.args["joint"], first.component, list(map(float, 1 / tried[tried > 0])))


def _single_waves(c: Context, k: int, component: int, periods: Sequence[float]) -> Iterator[Candidate]:
    """Of joint k's position, in one component of its frame; shares alike."""
    name = c.machine.joint_names[k]
    for period in periods:
        args = {"joint": k, "period": period}
        pair = tuple(Column("frame", "wave", {**args, "phase": p}, k + 1, component) for p in ("sin", "cos"))
        yield Candidate(
            "periodic_transmission", name, name, called(c, k + 1, component), f"q_{name}", pair, {"period": period},
            share=1.0 / len(periods),
        )  # fmt: skip


def coupling(c: Context) -> Iterator[Candidate]:
    for a, name in moving_joints(c):
        for b, other in moving_joints(c):
            if a == b:
                continue
            for comp in range(6):
                for half_waves in LUMPS:
                    args = {"joint": a, "period": 2 * float(np.ptp(c.recording.q[:, a])) / half_waves, "by": b}
                    pair = tuple(Column("frame", "wave_q", {**args, "phase": p}, a + 1, comp) for p in ("sin", "cos"))
                    yield Candidate(
                        "cross_coupling", name, name, COMPONENTS[comp], f"q_{other}", pair, {}, 0.5 / len(LUMPS),
                        (f"q_{name}", f"q_{other}"),
                    )  # fmt: skip
                for powers, share in (
                    (FINELY_TWO, 0.3),
                    (((1, 1),), 1.0), (((0, 1), (1, 1)), 0.5), (((0, 1), (0, 2)), 0.5),
                    (((1, 1), (1, 2), (2, 1), (2, 2)), 0.5), (((0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3)), 0.3),
                    (((0, 1), (1, 1), (2, 1), (3, 1)), 0.3), (tuple((i, 1) for i in range(7)), 0.3),
                ):  # fmt: skip
                    columns = tuple(Column("frame", *of_two(a, i, b, j), a + 1, comp) for i, j in powers)
                    yield Candidate(
                        "cross_coupling", name, name, COMPONENTS[comp], f"q_{other}", columns, {}, share,
                        (f"q_{name}", f"q_{other}"),
                    )  # fmt: skip
