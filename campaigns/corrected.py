"""A plan as a calibration would correct it, worked out before the run: what is beyond a limit is refused while nothing
has moved and nothing is written.

During the run the wrench is measured; beforehand it is what the script's loads weigh, and what is bolted on besides is
not known. So a load is taken no farther than where the calibration was identified: beyond that the run itself refuses,
and here what is FAR beyond, before anybody has put it on.
Temperatures and ages of loads are not known either: effects that ask for them are taken in the middle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from campaigns.design.loads import wrench
from campaigns.plan import Plan, Visit
from ppshw.compensation import Circumstances, Compensator
from ppshw.errors import CampaignError, CompensationRefused
from ppshw.machine import WRENCH_COMPONENTS

Array = NDArray[np.float64]
FAR = 1.0  # times the widest range of the forces, or of the moments, that was identified; a choice


def corrected_plan(
    plan: Plan,
    compensator: Compensator,
    run_up: Array | None = None,
    point: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Plan:
    """The same visits at the setpoints that they will be corrected to, as far as these can be known.

    run_up  (n,) the last way of axes that the site has come from one side always, signed, 0 elsewhere [m, rad]
    point   what fewer than six joints bring to its place; by default the machine's `where_it_counts`
    Raises CampaignError naming the step, the visit and why its correction would be refused.
    """
    low, high = compensator.calibration.payload_range.T
    visits: list[Visit] = []
    for visit in plan.visits:
        wanted, load = np.array(visit.setpoints), plan.loads[visit.load]
        weighs = wrench(plan.machine, wanted[None], load.mass, np.array(load.com))[0]
        if far := _far_outside(weighs, low, high):
            raise CampaignError(f"{visit.where}: step {visit.step}, visit {visit.number}: load '{load.name}': {far}")
        payload = np.clip(weighs, low, high)
        before = visit.via or (visits[-1].setpoints if visits else None)
        given = Circumstances(None if before is None else np.array(before), run_up=run_up)
        try:
            found = compensator.for_joints(wanted, payload, point or plan.machine.where_it_counts, given)
        except CompensationRefused as refused:
            raise CampaignError(f"{visit.where}: step {visit.step}, visit {visit.number}: {refused}") from None
        visits.append(replace(visit, setpoints=tuple(found.corrected.tolist())))
        if progress is not None:
            progress(len(visits), len(plan.visits))
    return replace(plan, visits=tuple(visits))


def _far_outside(wrench: Array, low: Array, high: Array) -> str:
    """What of a wrench (6,) is far outside what was identified, the farthest; empty where nothing is."""
    widest = np.repeat((high - low).reshape(2, 3).max(axis=1), 3)
    beyond = np.maximum(low - wrench, wrench - high) / np.maximum(widest, 1e-9)
    k = int(np.argmax(beyond))
    if beyond[k] <= FAR:
        return ""
    unit = "N" if k < 3 else "N m"
    return (
        f"{WRENCH_COMPONENTS[k]} = {wrench[k]:.6g} {unit} is far outside what was identified, {low[k]:.6g} … "
        f"{high[k]:.6g}"
    )
