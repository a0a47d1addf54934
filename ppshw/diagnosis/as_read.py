"""What the force sensor reads beside rigid payloads: whether it misreads, or that acts on the machine. The readings
know how large it is, deflections which of the two it is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppshw.diagnosis.evidence import LEAST_P, Tried
from ppshw.diagnosis.found import Found, by_its_own_form, take_up
from ppshw.diagnosis.library.weighing import may_be_pulled, surely_misread
from ppshw.diagnosis.workspace import Workspace

MISREAD, SURELY = 0.5, 3.0  # share of what no payload weighs that a sensor misreads; standard deviations
# Of what really acts: of forces along the flange's own axes, a third of some arms' loads, −0.006 ± 0.003 and
# 0.009 ± 0.008 in two clean recordings (a fifty-eighth author's).
HARDLY = 0.1


def surely_reads_other(space: Workspace, tried: Tried, others: Sequence[Found]) -> bool:
    """Whether the readings surely show an error of the sensor, and deflections do not deny it. The others are then
    taken up."""
    return surely_misread(space.context) and not acts(space, tried, others)


def as_weighed_alone(tried: Tried) -> int | None:
    """The candidate that is all that the sensor reads beside rigid payloads; None where there is none."""
    whole = (k for k, c in enumerate(tried.candidates) if c.columns[0].function == "weighed")
    return next((k for k in whole if np.isfinite(tried.log_share[k])), None)


def as_read(tried: Tried, best: int) -> Found:
    """That candidate as a finding, what is beside it taken up."""
    first = float(tried.said()[0][best])
    return Found(best, tried.name(best), LEAST_P, first, first=first, read=True)


def acts(space: Workspace, tried: Tried, others: Sequence[Found]) -> bool:
    """Whether deflections surely say that what is read beside payloads pulls at the machine: where something besides
    gravity may pull so (in two clean recordings of another author's 0.003 ± 0.07 and −0.31 ± 0.25 of it were misread),
    or hardly anything of it can be misread. The others are then taken up."""
    if (best := as_weighed_alone(tried)) is None:
        return False
    take_up(space, tried, list(others))
    read = as_read(tried, best)
    take_up(space, tried, [*others, read])
    values, covariance = by_its_own_form(space, tried.candidates[best], read)
    take_up(space, tried, list(others))
    share, std = float(values[0]), float(np.sqrt(covariance[0, 0]))
    denied = share < MISREAD and 1.0 - share > SURELY * std
    return denied and (abs(share) + SURELY * std < HARDLY or may_be_pulled(space.context))
