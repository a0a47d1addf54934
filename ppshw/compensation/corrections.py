"""A run's setpoints, each corrected with what went before it."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.compensation.compensator import Circumstances, Compensator, Setpoints
from ppshw.compensation.hanging import Hanging
from ppshw.compensation.known_effects import Verdict
from ppshw.compensation.past import Moment, Past, approach_of
from ppshw.errors import CompensationRefused
from ppshw.recording import Around, Recording
from ppshw.terms.earlier import SAME_S, another_load, continued, goes_on

Array = NDArray[np.float64]
# An axis that stands this near to where it was sent last leaves from there, whatever its encoder rounds [m, rad].
AT_REST = 1e-4


class Corrections:
    """Corrected setpoints of one run, each with the moves before it as its past: for a campaign.

    after           what the machine did before this run, for effects that look back
    so_far          the visits of this run that there are already, where it goes on with it. Where nobody says what went
                    before (after), these, or the visits that the calibration was made from, are what the machine did
                    last if it goes on soon after them (`earlier.goes_on`)
    run_up          (n,) the last way of axes that the site has come from one side always, signed, 0 elsewhere [m, rad]
    point           what fewer than six joints bring to its place; by default the machine's `where_it_counts`
    left            (2,) the most that any of them left of the end-effector frame's position and orientation [m, rad]
    position_first  as the compensator's
    at_odds         joints that were, at any of the setpoints (`Setpoints.at_odds`)
    """

    def __init__(
        self, compensator: Compensator, after: Recording | None = None, run_up: Array | None = None,
        so_far: Recording | None = None, point: str | None = None,
    ) -> None:  # fmt: skip
        self._compensator, self._run_up = compensator, run_up
        self.point = point or compensator.machine.where_it_counts
        self._past = Past()
        earlier = compensator.calibration.visits if after is None else after
        self._visits = earlier if so_far is None else continued(earlier, so_far)[0]
        self._loads: set[str] = set()  # that this run has met
        self._hanging = Hanging(compensator.machine)
        self._ended = -math.inf  # when visits ended that effects look back to [s since 1970]
        if self._visits is not None and compensator.known is not None and compensator.known.looks_back:
            self._ended = float(np.max(self._visits.time, initial=-math.inf))
        if after is not None and self._visits is not None and compensator.known is not None:
            self._past = compensator.known.past_of(self._visits)
        self._said: dict[tuple[str, str | None, str], tuple[Verdict, int]] = {}
        self.position_first, self.left = compensator.position_first, np.zeros(2)
        self.at_odds: list[str] = []

    @property
    def said(self) -> list[tuple[Verdict, int]]:
        """What became of every effect, each reason for itself, and at how many of the setpoints until now."""
        return list(self._said.values())

    def as_dicts(self, taken_out: bool) -> list[dict[str, Any]]:
        """The same for an answer: of those that were taken out, or of those that were not."""
        return [{**v.as_dict(), "visits": n} for v, n in self.said if v.taken_out == taken_out]

    def refuse_before(self, time: float) -> None:
        """Raises CompensationRefused where effects look back, and a setpoint at `time` [s since 1970] comes before
        visits that they look back to."""
        if time < self._ended - SAME_S:
            now, ended = (datetime.fromtimestamp(t, UTC).isoformat(timespec="seconds") for t in (time, self._ended))
            raise CompensationRefused(
                f"the clock says {now}, the visits that came before it go on until {ended}: creep, "
                "lags and the like need what went before; expected this computer's clock and the recording's times to "
                "agree (times without an offset are taken as UTC)"
            )

    def __call__(self, wanted: Array, wrench: Array, here: Array, around: Around) -> Array:
        """(n,) corrected setpoints of `wanted` (n,), from the wrench (6,) as read `here` (n,)."""
        payload = self._hanging.at(around.load, wrench, here, wanted)
        known = self._compensator.known
        if known is None:
            return self._corrected(wanted, payload, Circumstances()).corrected
        self.refuse_before(around.time)
        if self._visits is not None and not self._past.moments and goes_on(self._visits, around.time):
            self._past = known.past_of(self._visits)
        if around.load not in self._loads:
            self._past = _told_apart(self._past, around.load, wrench)
            self._loads.add(around.load)
        age = around.time - around.put_on
        if not self._past.moments and age >= 0 and around.lay_before is not None:
            came = np.zeros(len(here), dtype=np.int64)
            stands = Moment(here, came, wrench, around.time, around.load, around.temperatures)
            self._past = known.loaded_for(stands, age, lay_before=around.lay_before)
        last = self._past.moments[-1] if self._past.moments else None
        if last is not None and last.load != around.load and last.time < around.put_on <= around.time:
            came = approach_of(last.q, here, last.approach)  # the one lay there until the other was put on
            until = replace(last, time=around.put_on - 0.1, run_up=None)
            last = Moment(here, came, wrench, around.put_on + 0.1, around.load)
            self._past = known.remember(self._past, until, last)
        if last is None or np.abs(here - last.q).max() > AT_REST:  # it was moved by somebody else
            approach = np.zeros(len(here), dtype=np.int64) if last is None else approach_of(last.q, here, last.approach)
            last = Moment(here, approach, wrench, around.time, around.load, around.temperatures)
            self._past = known.remember(self._past, last)
        given = Circumstances(last.q, None, self._run_up, last.approach, around, past=self._past)
        found = self._corrected(wanted, payload, given)
        at = around.time, around.load, around.temperatures
        now = Moment(found.corrected, found.approach, payload, *at, self._run_up)
        self._past = known.remember(self._past, now)
        for verdict in found.effects:
            key = verdict.effect.name, verdict.effect.joint, verdict.why
            self._said[key] = verdict, self._said.get(key, (verdict, 0))[1] + 1
        return found.corrected

    def _corrected(self, wanted: Array, payload: Array, given: Circumstances) -> Setpoints:
        found = self._compensator.for_joints(wanted, payload, self.point, given)
        self.left = np.maximum(self.left, np.linalg.norm(found.left.reshape(2, 3), axis=1))
        self.at_odds += [joint for joint in found.at_odds if joint not in self.at_odds]
        return found


def _told_apart(past: Past, load: str, wrench: Array) -> Past:
    """A past in which another load than the one that reads `wrench` (6,) has another label."""
    there = np.array([m.payload for m in past.moments if m.load == load])
    if not len(there) or not another_load(there, wrench[None]):
        return past
    moments = (replace(m, load=f"earlier {load}") if m.load == load else m for m in past.moments)
    return replace(past, moments=tuple(moments))
