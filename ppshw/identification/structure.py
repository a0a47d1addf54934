"""Which terms a machine file and a recording call for   (model 17)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppshw.machine import Joint, Machine
from ppshw.model import Model
from ppshw.recording import Recording
from ppshw.terms import FrameTerm
from ppshw.terms.basis import Basis, Constant, Polynomial, Smooth
from ppshw.terms.elastic import Compliance, pattern
from ppshw.terms.geometric import Geometric
from ppshw.terms.own_motion import OwnMotion
from ppshw.terms.target import TargetOffset

Array = NDArray[np.float64]
# Sines per function, at most: with 16 the shortest wave is a seventh of the travel.
MOST_WAVES = 16
COMPLIANCE_DEGREE = 3
# A joint's motion along its own freedom gets shorter waves too where visits abound: one for 16 visits, 128 at most.
# From how many visits on is our choice: a campaign like the paper's (669) hardly resolves a gear, and with 1,000 of the
# UR5 (docs/figures.md) a tenth less residual would cost twice the time.
OWN_FROM_VISITS = 1100
VISITS_PER_OWN_WAVE = 16
MOST_OWN_WAVES = 128


def joint_model(machine: Machine, recording: Recording, waves: int = MOST_WAVES) -> Model:
    """Model (17) with smooth functions of one variable: base, one geometric and one elastic term per joint.

    With many visits also what repeats many times along a joint's travel, in its own motion alone; `waves` = 0 asks for
    straight lines and gets none of it.
    """
    terms: list[FrameTerm] = [Geometric(0, Constant())]
    for k in range(machine.n):
        terms.append(Geometric(k + 1, smooth_basis(recording.q[:, k], waves)))
    for k, joint in enumerate(machine.joints):
        own = own_motion(joint, k + 1, recording.q[:, k], waves)
        if own is not None:
            terms.append(own)
    for k, joint in enumerate(machine.joints):
        if joint.elastic is not None:
            basis = compliance_basis(joint, recording.q[:, k])
            terms.append(Compliance(k + 1, pattern(joint.elastic), tuple(joint.elastic.load_indices), basis))
    target = None if machine.tracker.targets_known else TargetOffset(tuple(machine.targets))
    return Model(machine, tuple(terms), target)


def distinct_positions(q: Array) -> int:
    """How many positions of a joint the visits really sample, a hundredth of the range counting as one."""
    span = float(np.ptp(q))
    return 1 if span == 0 else len(np.unique(np.round((q - q.min()) / span * 100)))


def smooth_basis(q: Array, waves: int) -> Basis:
    """Over the travel that was sampled; never more freedom than distinct positions."""
    distinct = distinct_positions(q)
    if distinct < 2:
        return Constant()
    low, high = float(q.min()), float(q.max())
    return Smooth((low + high) / 2, (high - low) / 2, max(0, min(waves, distinct - 2)))


def own_motion(joint: Joint, frame: int, q: Array, waves: int) -> OwnMotion | None:
    """Waves shorter than `waves` along the joint's own freedom; None where the visits do not sample them.

    Two different positions per half wave are the least (Nyquist), a fiftieth of the shortest half wave counting as one.
    """
    low, high = float(q.min()), float(q.max())
    if waves == 0 or len(q) < OWN_FROM_VISITS or low == high:
        return None
    distinct = len(np.unique(np.round((q - low) / (high - low) * 50 * MOST_OWN_WAVES)))
    last = min(MOST_OWN_WAVES, len(q) // VISITS_PER_OWN_WAVE, distinct // 2)
    if last <= waves:
        return None
    nothing, axis = (0.0, 0.0, 0.0), tuple(float(a) for a in joint.axis)
    direction = axis + nothing if joint.prismatic else nothing + axis
    return OwnMotion(frame, direction, (low + high) / 2, (high - low) / 2, waves + 1, last)


def compliance_basis(joint: Joint, q: Array) -> Basis:
    """A constant, or, where the file says that it varies, a polynomial over q (N,) [m, rad], the joint's positions at
    the visits; never more freedom than distinct positions."""
    distinct = distinct_positions(q)
    if joint.elastic is None or not joint.elastic.varies or distinct < 2:
        return Constant()
    low, high = float(q.min()), float(q.max())
    return Polynomial((low + high) / 2, (high - low) / 2, min(COMPLIANCE_DEGREE, distinct - 1))
