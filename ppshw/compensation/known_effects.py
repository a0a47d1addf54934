"""Effects that a diagnosis found, as far as they can be known when a setpoint is computed.

A recording knows afterwards how every visit came about. A setpoint must be computed before: the direction of approach
is known from where the move starts, temperatures from thermometers, what has been loaded and driven so far from the
past; how far a drift has gone since nobody looked is not. What belongs to the instrument is no error of the machine and
must not be driven into it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ppshw.compensation.needs import (
    BEFORE_IT,
    BY_CLOCK_ALONE,
    FROM_APPROACH,
    FROM_WAY,
    as_left,
    by_clock,
    joints_of,
    looks_back,
)
from ppshw.compensation.past import Moment, Past, Signs, approach_of
from ppshw.compensation.weighed import Weighed
from ppshw.errors import CompensationRefused
from ppshw.kinematics import frames
from ppshw.machine import Machine
from ppshw.model import Model
from ppshw.quantities import called
from ppshw.recording import Recording
from ppshw.statics import link_wrenches, payload_at
from ppshw.terms import Situation
from ppshw.terms.earlier import SAME_LOAD_N
from ppshw.terms.effect import UNNAMED, Effect, is_beyond
from ppshw.terms.history import changed_at, hours_since_change, lagged
from ppshw.terms.shapes import Column, Context
from ppshw.terms.shapes.context import compliances
from ppshw.terms.shapes.covariates import bump
from ppshw.terms.shapes.creep import OLDEST_LOAD_H
from ppshw.terms.shapes.wrenches import expected_by

Array = NDArray[np.float64]
SAME = 5e-3  # [m, rad]
GRID = 33  # moments over which a drift is averaged
EVENLY = (1 / 6, 1 / 2, 5 / 6)  # of a temperature's range, where it may be anything in it
FARTHER_K = 5.0  # that a thermometer may read beyond where effects were measured, or by as much as it ran through there
AT_ONCE_S = 0.1  # between what changes all at once and what was before it
UNSAID_H = 0.5  # a load that nobody says the age of is taken to lie there for so long (a guess)


@dataclass(frozen=True)
class Verdict:
    """Whether an effect is taken out of the setpoints, and why not, or how far."""

    effect: Effect
    taken_out: bool
    why: str

    def heading(self) -> str:
        return "compensated" if self.taken_out else "not compensated"

    def sentence(self) -> str:
        return f"{called(self.effect.name, self.effect.joint)}{': ' if self.why else ''}{self.why}"

    def as_dict(self) -> dict[str, str | None]:
        return {"effect": self.effect.name, "joint": self.effect.joint, "why": self.why or None}


class KnownEffects:
    """The effects of one calibration at the moment that a setpoint is computed."""

    def __init__(
        self, effects: Sequence[Effect], model: Model, theta: Array, reference: Mapping[str, float],
        measuring_in_base: Array, temperature_range: Mapping[str, tuple[float, float]] | None = None,
        visits: Recording | None = None,
    ) -> None:  # fmt: skip
        self.effects = tuple(effects)
        self._visits = visits
        self._weighed_then = None if visits is None else Weighed(model.machine, visits)
        self._seen_between = dict(temperature_range or {})
        self._model, self._theta = model, theta
        self._reference, self._measuring = dict(reference), measuring_in_base
        columns = [c for e in effects for c in e.columns]
        self.looks_back = any(looks_back(c) for c in columns)
        # (n,) by the side come from
        self.sided = np.isin(np.arange(model.machine.n), joints_of(columns, FROM_APPROACH))
        self._creeps = any(e.name == "creep" for e in effects)
        # only those ask for the links' compliances
        self._bends = any(c.on == "frames" and c.function not in ("unexplained", "instead") for c in columns)
        self._compliance_at: tuple[Array, Array] | None = None
        self._courses: dict[tuple[object, ...], Array] = {}
        self._late: dict[tuple[str, float], float] = {}

    @property
    def machine(self) -> Machine:
        return self._model.machine

    # --- what can be known ---------------------------------------------------------------------------------
    def verdicts(self, now: Moment, past: Past) -> list[Verdict]:
        """One per effect and joint and reason: an effect may be carried in several pieces."""
        found: dict[tuple[str, str | None, str], Verdict] = {}
        for effect in self.effects:
            taken_out, why = self._verdict(effect, now, past)
            found.setdefault((effect.name, effect.joint, why), Verdict(effect, taken_out, why))
        return list(found.values())

    def _verdict(self, effect: Effect, now: Moment, past: Past) -> tuple[bool, str]:
        if effect.name == UNNAMED:
            places = [place for place in self._seen_between if f"temp_{place}_C" in effect.unnamed_over]
            why = "nothing says that it stays: no axis is driven by it, nor by what it would change"
            return False, "; ".join([why, *self._beyond(places, now, "how large it is there nothing says")])
        if any(c.function == "carrier_shift" for c in effect.columns):
            return False, "taken for the reflectors': where the last link slipped instead, the tip is off by as much"
        if effect.of_instrument:
            return False, "an error of the instrument, not of the machine; its readings keep it"
        if any(c.function == "weighed" for c in effect.columns):
            if self._beside(now.load, now.q, now.payload) is None:
                return False, "what this load weighs no attitude but this one says; taken as the sensor reads it"
            return True, f"'{now.load}' weighs what it weighed while it was measured"
        if any(c.function == "hopping" for c in effect.columns):
            return True, "as at the recording's end; it hops, and where it is now cannot be known"
        if as_left(effect):
            again = "homed" if effect.name == "zero_shift" else "tared"
            return True, f"as at the recording's end; whether it was {again} since cannot be known"
        if any(by_clock(c) for c in effect.columns):
            return False, "how far it has gone since it was measured cannot be known; taken as it was on average"
        if effect.name == "creep" and not past.known:
            return False, f"when the load was changed is not known; taken as {60 * UNSAID_H:.0f} min ago"
        for column in effect.columns:
            joint = column.args.get("joint")
            if column.function in FROM_APPROACH and now.approach[int(joint or 0)] == 0:
                return False, "from which side the joint comes is not known; taken between the two"
            place = column.args.get("place")
            if place and place not in now.temperatures:
                return False, f"the temperature of {place} is not known; taken as its mean while measured"
        reserve = []
        winds = effect.name == "friction_hysteresis" and now.run_up is None
        if winds and any(all(m.q[j] == now.q[j] for m in past.moments) for j in joints_of(effect.columns, FROM_WAY)):
            reserve.append("how far the joint has gone since it turned back is not known; taken as far")
        if effect.name == "creep" and past.on_nothing:
            reserve.append("what lay there before is not known; taken as nothing")
        if effect.name == "creep" and past.lay_long:
            reserve.append("what lay there before is taken to have lain there for long")
        oldest = self._reference.get(OLDEST_LOAD_H, math.inf)
        if effect.name == "creep" and self._load_age_h([*past.moments, now]) > oldest:
            reserve.append(
                f"the load has lain there for longer than any did while it was measured ({60 * oldest:.0f} min); "
                "taken as then"
            )
        whole = [c for c in effect.columns if "than" not in c.args]  # what comes later in part is in how unsure it is
        steady = self._taken_as_steady(whole, now, past)
        reserve += [f"lags {place} by {lag:g} h: taken as steady before it was read" for place, lag in steady.items()]
        reserve += self._beyond(effect.places, now, "carried on as it was")
        return True, "; ".join(reserve)

    def _beyond(self, places: Sequence[str], now: Moment, what: str) -> list[str]:
        """A line for each of these thermometers that stands where it never stood while effects were measured."""
        return [
            f"{place} is beyond the {low:.1f} to {high:.1f} °C at which it was measured; {what}"
            for place, (low, high) in self._seen_between.items()
            if place in places and place in now.temperatures
            and is_beyond(np.asarray(now.temperatures[place]), low, high)
        ]  # fmt: skip

    def refuse_far(self, now: Moment) -> None:
        """Raises CompensationRefused where a thermometer that setpoints go by reads far from where it was measured."""
        felt = {place for e in self.effects if not e.of_instrument for place in e.places}
        for place in sorted(felt & now.temperatures.keys() & self._seen_between.keys()):
            low, high = self._seen_between[place]
            reads, more = now.temperatures[place], max(FARTHER_K, high - low)
            if not low - more <= reads <= high + more:
                raise CompensationRefused(
                    f"temperature of {place} {reads:g} °C is too far from the {low:.1f} to {high:.1f} °C at which "
                    f"effects were measured, expected {low - more:.1f} … {high + more:.1f}"
                )

    # --- what they do --------------------------------------------------------------------------------------
    def errors(self, now: Moment, past: Past, base: Array, wrenches: Array) -> Array:
        """Generalized errors of all that is a matter of the machine: (1, n+1, 6) [m, rad].

        base, wrenches  (1, n+1, 6) of the base model at `now`
        What is not known there is taken where the base model has it: on average.
        """
        out = np.zeros_like(base)
        contexts = self._contexts(now, past, base, wrenches)
        for effect in self.effects:
            for column, value in zip(effect.columns, effect.values, strict=True):
                self._add(out, effect, column, value, contexts)
        return out

    def unsure(self, now: Moment, past: Past, base: Array, wrenches: Array) -> tuple[Array, Array]:
        """What the effects may do besides as their values are not known better: (k, n+1, 6) [m, rad], and what the base
        model's parameters would have less in each case (k, p). The sum of the squares of a displacement by both is the
        variance that this brings to it. Of a Gaussian process nothing is used: the whole of it stays unsure, per
        component."""
        contexts = self._contexts(now, past, base, wrenches)
        out, instead = [np.zeros((0, *base.shape[1:]))], [np.zeros((0, len(self._theta)))]
        for effect in self.effects:
            first = effect.columns[0]
            if first.function == "unexplained":
                ways = np.array([self._on_frame(first, size) for size in np.diag(first.args["amplitude"])])
                out.append(ways)
                instead.append(np.zeros((len(ways), len(self._theta))))
                continue
            out.append(np.tensordot(effect.spread, self._units(effect, contexts), axes=1))
            instead.append(effect.spread @ effect.mimicked_by(len(self._theta)))
        return np.concatenate(out), np.concatenate(instead)

    def unknown(self, now: Moment, past: Past, base: Array, wrenches: Array) -> Array:
        """What else the effects may do by what is not known at `now`: (k, n+1, 6) [m, rad], the sum of whose squares is
        the variance that this brings to any displacement.

        From which side a joint comes is either, a temperature anything that was measured, a load as old as any, each
        with how unsure the values are there; what goes by the clock is where it was at any moment of the recording, and
        may be farther off since.
        """
        context = self._contexts(now, past, base, wrenches)[0]
        out = self._at_any_moment(context) + self._as_misread(now, context)
        for ways in self._ways(now, past):
            contexts = [self._contexts(then, before, base, wrenches) for then, before in ways]
            whole = np.zeros((len(ways), *base.shape[1:]))
            for effect in self.effects:
                units = np.stack([self._units(effect, each) for each in contexts])
                apart = (units - units.mean(axis=0)) / np.sqrt(len(ways))
                whole += np.tensordot(apart, np.array(effect.values), axes=(1, 0))
                out += list(np.tensordot(effect.spread, apart, axes=(1, 1))) if apart.any() else []
            out.append(whole)
        return np.concatenate(out) if out else np.zeros((0, *base.shape[1:]))

    def _ways(self, now: Moment, past: Past) -> Iterator[list[tuple[Moment, Past]]]:
        """Of each thing that effects ask for and nobody knows, what it may as well be."""
        columns = [c for e in self.effects if not e.of_instrument for c in e.columns]
        for joint in (j for j in joints_of(columns, FROM_APPROACH) if now.approach[j] == 0):
            yield [(_come_from(now, joint, side), _all_come_from(past, joint, side)) for side in (-1, 1)]
        places = {str(c.args["place"]) for c in columns if c.args.get("place")}
        for place in sorted(places - set(now.temperatures)):
            low, high = self._seen_between.get(place, (math.nan, math.nan))
            if math.isfinite(high - low):
                felt = [{**now.temperatures, place: low + share * (high - low)} for share in EVENLY]
                yield [(replace(now, temperatures=each), past) for each in felt]
        for place, lag in self._taken_as_steady(columns, now, past).items():
            by = math.sqrt(1.5) * self._late_by(place, lag)
            was = [now.temperatures[place] + side * by for side in (-1.0, 0.0, 1.0)]
            yield [(now, self._was(now, past, place, celsius)) for celsius in was]
        first = past.moments[0] if past.moments else now
        for joint in (j for j in joints_of(columns, FROM_WAY) if now.approach[j] and not first.approach[j]):
            yield [(now, _all_come_from(past, joint, side)) for side in (-1, 1)]
        if self._creeps and (past.on_nothing or not past.known):
            start = None if past.standing else first.q
            hours = self._reference.get("hours", 0.0)
            ages = [3600.0 * age for age in (0.0, min(UNSAID_H, hours), hours)]
            if past.known:
                ages = [self._times([now])[0] - past.moments[-1].time]
            yield [
                (now, self.loaded_for(now, age, start, first.approach, lay))
                for age in ages
                for lay in (np.zeros(6), *self._loads(now))
            ]

    def _taken_as_steady(self, columns: Iterable[Column], now: Moment, past: Past) -> dict[str, float]:
        """Of thermometers that columns follow late and that read something now: by how much [h] at most, where nobody
        knows what they read so long ago."""
        late: dict[str, float] = {}
        for column in columns:
            place, lag = str(column.args.get("place", "")), float(column.args.get("tau", 0.0))
            if lag > 0.0 and place in now.temperatures:
                late[place] = max(lag, late.get(place, 0.0))
        if not late:
            return {}
        times = self._times([*past.moments, now])
        since = {
            place: next((t for t, m in zip(times, past.moments, strict=False) if place in m.temperatures), times[-1])
            for place in late
        }
        return {place: lag for place, lag in late.items() if times[-1] - since[place] < 3600.0 * lag}

    def _was(self, now: Moment, past: Past, place: str, celsius: float) -> Past:
        """The past, had a thermometer read this until it was read first."""
        times = self._times([*past.moments, now])
        first = next((k for k, m in enumerate(past.moments) if place in m.temperatures), len(past.moments))
        before = [replace(m, temperatures={**m.temperatures, place: celsius}) for m in past.moments[:first]]
        there = [*before[-1:], *past.moments[:1], now][0]
        said = {**there.temperatures, place: celsius}
        until = replace(there, time=float(times[first]) - AT_ONCE_S, temperatures=said, run_up=None)
        nothing = replace(past, moments=(), wrenches=None, chain=None, compliance=None)
        return self.remember(nothing, *before, until, *past.moments[first:])

    def _late_by(self, place: str, lag: float) -> float:
        """What a thermometer differs by from itself so late, rms over the calibration's visits [K]; where it keeps none
        what is as likely to be anywhere in its range."""
        low, high = self._seen_between.get(place, (0.0, 0.0))
        if self._visits is None or place not in self._visits.temperatures:
            return (high - low) / math.sqrt(12.0)
        if (place, lag) not in self._late:
            read = self._visits.temperatures[place]
            behind = lagged(read, self._visits.time / 3600.0, lag) - read
            self._late[place, lag] = float(np.sqrt((behind**2).mean()))
        late = self._late[place, lag]
        return late if math.isfinite(late) else (high - low) / math.sqrt(12.0)

    def _loads(self, now: Moment) -> list[Array]:
        """What each of the loads that hung there while effects were measured would read at a moment, (6,) each; of a
        calibration that keeps none the same as does."""
        then = self._weighed_then
        if then is None or self._visits is None or not self._visits.has_wrench:
            return [now.payload]
        return list(then.loads(now.q))

    def _at_any_moment(self, context: Context) -> list[Array]:
        """Deviations of what goes by the clock from its mean over the recording, per moment."""
        each = np.zeros((GRID, self.machine.n + 1, 6))
        for effect in self.effects:
            for column, value in zip(effect.columns, effect.values, strict=True):
                stays = as_left(effect) and column.function != "hopping"
                follows = by_clock(column) or column.args.get("name") == "time"
                if effect.of_instrument or not follows or stays or column.args.get("form") in BEFORE_IT:
                    continue
                for k, size in enumerate(self._over_time(column, context)):
                    _add_to(each[k], column, value * size, context)
        return [(each - each.mean(axis=0)) / np.sqrt(GRID)] if each.any() else []

    def _over_time(self, column: Column, context: Context) -> Array:
        """(GRID, …) the column's function at moments over the recording, were the context's last visit there; of what
        is a matter of the clock alone worked out once."""
        key = column.function, str(sorted(column.args.items()))
        if key in self._courses:
            return self._courses[key]
        moments = np.linspace(0.0, self._reference.get("hours", 0.0), GRID)
        values = np.array([column.value(replace(context, hours=np.full_like(context.hours, h)))[-1] for h in moments])
        if column.function in BY_CLOCK_ALONE:
            self._courses[key] = values
        return values

    def _add(
        self, out: Array, effect: Effect, column: Column, value: float, contexts: tuple[Context, Context]
    ) -> None:  # fmt: skip
        if effect.of_instrument or column.args.get("form") in BEFORE_IT:
            return
        size = self._now(effect, column, contexts[column.function in FROM_WAY])
        _add_to(out[0], column, value * size, contexts[0])

    def _units(self, effect: Effect, contexts: tuple[Context, Context]) -> Array:
        """(k, n+1, 6) what each column of an effect does, of size one."""
        units = np.zeros((len(effect.columns), self.machine.n + 1, 6))
        for k, column in enumerate(effect.columns):
            self._add(units[k : k + 1], effect, column, 1.0, contexts)
        return units

    def _now(self, effect: Effect, column: Column, context: Context) -> Array:
        """The column's function at the last moment of the context; what only a clock knows at a moment known before:
        a zero as it was left, anything else on average over the recording."""
        if column.function in ("covariate", "covariate_pair"):
            return np.asarray(_mean_bump(column))
        if column.function == "weighed":
            return self._weighed(context)
        if column.function in ("unexplained", "instead"):  # without them the base model stands as it is
            return np.zeros(() if column.on == "frame" else (self.machine.n + 1, 6))
        if not by_clock(column):
            return np.asarray(column.value(context)[-1])
        values = self._over_time(column, context)
        return values[-1] if as_left(effect) else np.asarray(values.mean(axis=0))

    def _weighed(self, context: Context) -> Array:
        """(n+1, 6) what is wrongly expected of a load that reads otherwise than it weighed while it was measured."""
        r = context.recording
        beside = self._beside(r.load[-1], r.q[-1], r.wrench[-1])
        if beside is None:
            return np.zeros((self.machine.n + 1, 6))
        return np.asarray(-expected_by(context, _at_last(context, beside))[-1])

    def _as_misread(self, now: Moment, context: Context) -> list[Array]:
        """What a load that nobody weighed may make wrongly expected, (6, n+1, 6): by every channel as far as it read
        beside those that were."""
        of_sensor = next((e for e in self.effects if e.columns[0].function == "weighed"), None)
        then = self._weighed_then
        if of_sensor is None or then is None or then.beside(now.load, now.q, now.payload) is not None:
            return []
        each = (expected_by(context, _at_last(context, one))[-1] for one in np.diag(then.usual()))
        return [of_sensor.values[0] * np.stack(list(each))]

    def _beside(self, load: str, q: Array, reading: Array) -> Array | None:
        """As `Weighed.beside`; None too of a calibration that keeps no visits."""
        return None if self._weighed_then is None else self._weighed_then.beside(load, q, reading)

    def _on_frame(self, column: Column, values: Sequence[float]) -> Array:
        """(n+1, 6) with a value for each component that a Gaussian process moves."""
        out = np.zeros((self.machine.n + 1, 6))
        out[column.args["frame"], column.args["components"]] = values
        return out

    def _contexts(self, now: Moment, past: Past, base: Array, wrenches: Array) -> tuple[Context, Context]:
        """What columns see, and what those see that ask for the way since a joint turned back: directions that nobody
        sees to are those of the way itself there, which a setpoint in hand may have turned."""
        machine, here = self.machine, Situation(now.q[None], now.payload[None])
        chain = frames(machine, here.q, base)
        compliance = self._compliance(here)
        before = past.before(now.q)
        ways = now.ways(before[-1].q if before else now.q)
        moments = [*before, *ways]
        wrenches, chain, compliance = (np.repeat(a, len(ways), axis=0) for a in (wrenches, chain, compliance))
        wrenches, chain, compliance = past.followed_by(wrenches, chain, compliance)
        reference = dict(self._reference)
        start = reference.get("start", 0.0)
        time = self._times(moments)
        if self._creeps and not past.recorded:  # a load that nobody saw put on was put on an empty machine
            moments = [replace(moments[0], payload=np.zeros(6), load="before"), *moments]
            put_on = max(time[-1] - 3600.0 * reference.get("hours", math.inf), time[0] - 3600.0 * UNSAID_H)
            time = np.concatenate([[min(2 * put_on - time[0], time[0])], time])
            chain, compliance = (np.concatenate([a[:1], a]) for a in (chain, compliance))
            wrenches = np.concatenate([link_wrenches(machine, chain[:1], np.zeros((1, 6))), wrenches])
        empty, recording = np.zeros((len(moments), 0)), self._as_recording(moments, time)
        context = Context(
            machine, recording, empty, wrenches, empty, empty, chain, compliance,
            self._measuring, (time - start) / 3600.0, reference,
        )  # fmt: skip
        straight = approach_of(moments[-2].q, now.q, now.approach) if len(moments) > 1 else now.approach
        seen_to = np.zeros(machine.n) if now.seen_to is None else now.seen_to
        straight = np.where(seen_to != 0, now.approach, straight)
        if np.array_equal(straight, now.approach):
            return context, context
        turned = replace(recording, approach=np.concatenate([recording.approach[:-1], straight[None]]))
        return context, replace(context, recording=turned)

    def _compliance(self, here: Situation) -> Array:
        """(M, n+1, 6, 6) of every frame. It changes by less than a hundredth within SAME: a correction in hand is
        computed with that of where it began."""
        if not self._bends:
            return np.zeros((len(here), self.machine.n + 1, 6, 6))
        if len(here) > 1:
            return compliances(self._model, self._theta, here)
        if self._compliance_at is None or np.abs(self._compliance_at[0] - here.q).max() > SAME:
            self._compliance_at = here.q, compliances(self._model, self._theta, here)
        return self._compliance_at[1]

    def _load_age_h(self, moments: Sequence[Moment]) -> float:
        """For how long the load of the last moment has lain there [h], as far back as they go."""
        loads, hours = tuple(m.load for m in moments), self._times(moments) / 3600.0
        return float(hours_since_change(loads, hours, changed_at(loads, hours, None))[-1])

    def _times(self, moments: Sequence[Moment]) -> Array:
        """Where nobody says the time it is the end of the recording."""
        end = self._reference.get("start", 0.0) + 3600.0 * self._reference.get("hours", 0.0)
        now = moments[-1].time if math.isfinite(moments[-1].time) else end
        return np.array([m.time if math.isfinite(m.time) else now for m in moments])

    def _as_recording(self, moments: Sequence[Moment], time: Array) -> Recording:
        machine, count = self.machine, len(moments)
        temperatures = {}
        for place in {p for e in self.effects for p in e.places}:
            mean = self._reference.get(f"mean.{place}", 0.0)
            now = moments[-1].temperatures.get(place, mean)
            known = place in moments[-1].temperatures
            temperatures[place] = np.array([m.temperatures.get(place, now) if known else mean for m in moments])
        return Recording(
            machine.joint_names, tuple(machine.targets), time, ("",) * count, tuple(m.load for m in moments),
            np.array([m.q for m in moments]), np.array([m.q for m in moments]),
            np.array([m.approach for m in moments]), np.full(count, math.nan), np.array([m.payload for m in moments]),
            np.full((count, len(machine.targets), 3), math.nan), {}, temperatures, {}, True, "setpoints", "",
        )  # fmt: skip

    # --- the past ------------------------------------------------------------------------------------------
    def remember(self, past: Past, *moments: Moment) -> Past:
        """The past with these moments behind it; only the last one where no effect looks further back, and nothing from
        further back than the recording was long, as nobody has seen what an effect does then."""
        if not moments:
            return past
        befores = [*past.moments[-1:], *moments]  # where each came from; of the first nobody knows more
        befores = befores if past.moments else [moments[0], *moments]
        moments = tuple(w for m, before in zip(moments, befores, strict=False) for w in m.ways(before.q))
        here = Situation(np.array([m.q for m in moments]), np.array([m.payload for m in moments]))
        errors, wrenches = self._model.errors(here, self._theta)
        chain = frames(self.machine, here.q, errors)
        compliance = self._compliance(here)
        changed = any(a.load != b.load for a, b in pairwise(past.moments[-1:] + moments))
        if not self.looks_back:
            known = past.known or changed
            return Past(moments[-1:], wrenches[-1:], chain[-1:], compliance[-1:], known, past.recorded)
        wrenches, chain, compliance = past.followed_by(wrenches, chain, compliance)
        everything = (*past.moments, *moments)
        since = moments[-1].time - 3600.0 * self._reference.get("hours", math.inf)
        late = next((k for k, m in enumerate(everything) if not m.time < since), len(everything) - 1)
        known = past.known or changed
        lay_long = past.lay_long and not late
        return Past(everything[late:], wrenches[late:], chain[late:], compliance[late:], known, past.recorded, lay_long)

    def past_of(self, recording: Recording) -> Past:
        """A recording as the past of what is to come on the same machine, its loads under the same labels. What hung
        there at its first visit had hung there for long, as a fit has it."""
        moments = [
            Moment(
                recording.q[k], recording.approach[k], recording.wrench[k], float(recording.time[k]),
                recording.load[k],
                {p: float(t[k]) for p, t in recording.temperatures.items() if math.isfinite(t[k])},
            )
            for k in range(len(recording))
        ]  # fmt: skip
        return self.remember(Past(recorded=True), *moments)

    def loaded_for(
        self, now: Moment, seconds: float | None, start: Array | None = None, before: Signs | None = None,
        lay_before: Array | None = None,
    ) -> Past:  # fmt: skip
        """A past that only says for how long the load has been on (None: nobody knows), where the move starts from,
        from which sides its joints came there (0: either), and what the sensor would read at `now` of what had lain
        there before the load for long (None: nothing)."""
        if start is not None:
            lay_before = None if lay_before is None else payload_at(self.machine, lay_before, now.q, start)
            payload = payload_at(self.machine, now.payload, now.q, start)
            approach = np.zeros(self.machine.n, dtype=np.int64) if before is None else before
            now = replace(now, q=start, payload=payload, approach=approach, run_up=None)
        age = 3600.0 * UNSAID_H if seconds is None else seconds
        age = min(age, 3600.0 * self._reference.get("hours", math.inf))
        at = self._times([now])[0]
        lay = np.zeros(6) if lay_before is None else lay_before
        now = replace(now, temperatures={})  # nobody says what thermometers read then
        empty = replace(now, payload=lay, load="before", time=at - age - AT_ONCE_S)
        put_on = replace(now, time=at - age + AT_ONCE_S)
        past = self.remember(Past(), empty, put_on)
        known, said = seconds is not None, lay_before is not None
        lay_long = bool(np.linalg.norm(lay[:3]) > SAME_LOAD_N)
        return replace(
            past, known=known, recorded=said, lay_long=lay_long, standing=start is None, on_nothing=known and not said
        )


def _come_from(moment: Moment, joint: int, side: int) -> Moment:
    """The same where it is not known from which side a joint came, had it come from this one."""
    approach = moment.approach.copy()
    approach[joint] = approach[joint] or side
    return replace(moment, approach=approach)


def _all_come_from(past: Past, joint: int, side: int) -> Past:
    return replace(past, moments=tuple(_come_from(moment, joint, side) for moment in past.moments))


def _mean_bump(column: Column) -> float:
    """What a bump over the ranks of a column (or of two) is on average over the recording, where ranks are even."""
    count, ranks = int(column.args.get("count", 1)), np.linspace(0.0, 1.0, 10 * GRID)
    if count < 2:
        return 0.0
    knots = [int(column.args[k]) for k in ("knot", "a", "b") if k in column.args]
    return float(np.prod([bump(ranks, k, count).mean() for k in knots]))


def _at_last(context: Context, wrench: Array) -> Array:
    """(N, 6) a wrench (6,) at the last moment alone."""
    out = np.zeros_like(context.recording.wrench)
    out[-1] = wrench
    return out


def _add_to(errors: Array, column: Column, size: Array, c: Context) -> None:
    """Adds to generalized errors (n+1, 6) what a column is whose function comes to a size."""
    if column.on == "frame":
        errors[column.frame] += size * c.direction(column.frame, column.component)
    else:
        errors += size
