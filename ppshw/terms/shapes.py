"""The functions of covariates and history that effects are made of, by name, so that a calibration can carry them.

A column says where it acts and how: on one component of one frame times a function (N,) of the visits; on all frames at
once (N, n+1, 6); or on the measured points themselves (N, T, 3). `FUNCTIONS` lists them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.kinematics import frames, point_jacobian
from ppshw.machine import WRENCH_COMPONENTS, Machine
from ppshw.model import Model
from ppshw.recording import Recording
from ppshw.statics import link_wrenches
from ppshw.terms import Situation
from ppshw.terms.elastic import Compliance
from ppshw.terms.gaussian_process import Region
from ppshw.terms.history import (
    STANDSTILL,
    followed,
    former,
    hours_since,
    hours_since_change,
    lagged,
    load_memory,
    payloads,
    side_held,
    slip,
    way_since_reversal,
    wind_up,
)  # fmt: skip

Array = NDArray[np.float64]
LEAST_H = 1e-4  # between two visits
QUANTILES = 41  # that the ranks of a column are kept by
FunctionOfVisits = Callable[..., Array]
What = tuple[str, tuple[tuple[str, object], ...]]
Key = tuple[str, What, int, int]


@dataclass(frozen=True)
class Context:
    """Everything a shape may look at, for N visits.

    jacobian (N, 3T, n+1, 6), wrenches (N, n+1, 6), points (N, T, 3) in the base, tips (N, 4, 4): from the base model
    chain (N, n+1, 4, 4) frames in the base; compliance (N, n+1, 6, 6) of every frame as calibrated, zero where rigid
    measuring_in_base (4, 4) where the instrument stands; hours (N,) since the start; reference: see `of`;
    model: the base model, where there is one at hand; memo: see `once`
    """

    machine: Machine
    recording: Recording
    jacobian: Array
    wrenches: Array
    points: Array
    tips: Array
    chain: Array
    compliance: Array
    measuring_in_base: Array
    hours: Array
    reference: dict[str, float]
    model: Model | None = None
    memo: dict[tuple[object, ...], Array] = field(default_factory=dict, init=False, repr=False, compare=False)

    @classmethod
    def of(
        cls, model: Model, theta: Array, recording: Recording, measuring_in_base: Array,
        reference: dict[str, float] | None = None,
    ) -> Context:  # fmt: skip
        """For the visits of a recording, about a model's parameters.

        reference  what a calibration froze of the recording that it was made from (means, ranges, the start of time);
                   None: this recording is that one
        """
        situation = Situation.of(recording)
        errors, wrenches = model.errors(situation, theta)
        chain = frames(model.machine, situation.q, errors)
        tips = chain[:, -1] @ model.machine.tip_in_link
        targets = model.targets(theta)
        points = np.einsum("nij,pj->npi", tips[:, :3, :3], targets) + tips[:, None, :3, 3]
        jacobian = point_jacobian(chain, points, errors).reshape(len(recording), -1, model.machine.n + 1, 6)
        reference = {} if reference is None else reference
        first = float(recording.time[0])
        start = reference.setdefault("start", first if np.isfinite(first) else 0.0)
        return cls(
            model.machine, recording, jacobian, wrenches, points, tips, chain, compliances(model, theta, situation),
            measuring_in_base, hours_since(start, recording.time), reference, model,
        )  # fmt: skip

    def frozen(self, key: str, value: float) -> float:
        """A figure of the recording a calibration was made from; `value` where this is that recording."""
        return self.reference.setdefault(key, float(value))

    def once(self, key: tuple[object, ...], make: Callable[[], Array]) -> Array:
        """What many columns look at, worked out once and not to be written to."""
        if key not in self.memo:
            self.memo[key] = make()
            self.memo[key].flags.writeable = False
        return self.memo[key]

    def u(self, joint: int) -> Array:
        """Joint position scaled to −1 … 1 over what was sampled."""
        q = self.recording.q[:, joint]
        low, high = self.frozen(f"low.{joint}", q.min()), self.frozen(f"high.{joint}", q.max())
        return np.asarray((q - (low + high) / 2) / max((high - low) / 2, 1e-9))

    def legendre(self, joint: int, power: int) -> Array:
        """Legendre polynomial of a joint's position, −1 … 1 over what was sampled."""

        def make() -> Array:
            return np.asarray(np.polynomial.Legendre.basis(power)(self.u(joint)), dtype=float)

        return self.once(("legendre", joint, power), make)


def compliances(model: Model, theta: Array, situation: Situation) -> Array:
    """(N, n+1, 6, 6) of every frame as calibrated, from the response to unit loads."""
    joints = model.machine.n
    out = np.zeros((len(situation), joints + 1, 6, 6))
    at = 0
    for term in model.terms:
        size = len(term.parameters(model.machine.frame_names))
        if isinstance(term, Compliance):
            for b in range(6):
                unit = np.zeros((len(situation), joints + 1, 6))
                unit[:, term.frame, b] = 1.0
                out[:, term.frame, :, b] += term.regressors(situation, unit) @ theta[at : at + size]
        at += size
    return out


@dataclass(frozen=True)
class Column:
    """on: "frame" | "frames" | "points"; frame, component where on a frame; function and its arguments."""

    on: str
    function: str
    args: dict[str, Any] = field(default_factory=dict)
    frame: int = 0
    component: int = 0

    @property
    def what(self) -> What:
        """What tells its function from another: arguments stand in a dictionary, which does not hash."""
        return self.function, tuple(sorted(self.args.items()))

    @property
    def key(self) -> Key:
        """What tells it from another column."""
        return self.on, self.what, self.frame, self.component

    def value(self, c: Context) -> Array:
        """The function alone: (N,) on a frame, (N, n+1, 6) on frames, (N, T, 3) on points."""
        return FUNCTIONS[self.function](c, **self.args)

    def evaluate(self, c: Context) -> Array:
        """(N, 3T) displacement of the targets per unit of the column's coefficient, base axes."""
        value = self.value(c)
        if self.on == "frame":
            return np.asarray(c.jacobian[:, :, self.frame, self.component] * value[:, None])
        if self.on == "frames":
            return np.asarray(np.einsum("nifk,nfk->ni", c.jacobian, value))
        return np.asarray(value.reshape(len(value), -1))

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Column:
        if data["function"] not in FUNCTIONS:
            raise ValueError(f"unknown function '{data['function']}'")
        return cls(data["on"], data["function"], dict(data["args"]), int(data["frame"]), int(data["component"]))

    def as_dict(self) -> dict[str, Any]:
        return {
            "on": self.on, "function": self.function, "args": self.args, "frame": self.frame,
            "component": self.component,
        }  # fmt: skip


def bump(at: Array, knot: int, count: int) -> Array:
    """The knot-th of `count` Gaussian bumps, evenly over 0 … 1."""
    return np.asarray(np.exp(-0.5 * ((at * (count - 1) - knot) / 1.2) ** 2))


# --- on one component of one frame: (N,) -----------------------------------------------------------------------
def approach(c: Context, joint: int) -> Array:
    return c.recording.approach[:, joint].astype(float)


def approach_q(c: Context, joint: int, power: int = 1) -> Array:
    return c.recording.approach[:, joint] * c.u(joint) ** power


def reversal(c: Context, joint: int, knot: int, count: int) -> Array:
    """The side a joint came from times a smooth function of the way since it turned back: the knot-th of `count` bumps
    over its ranks, as `covariate`."""
    return approach(c, joint) * covariate(c, f"way_{c.machine.joint_names[joint]}", knot, count)


def turning(c: Context, joint: int, knot: int, count: int) -> Array:
    """As `reversal`, finest where the joint has just turned back: bumps over the root of the way since."""
    q = c.recording.q[:, joint]
    way = way_since_reversal(q, c.recording.approach[:, joint])
    far = max(c.frozen(f"high.{joint}", q.max()) - c.frozen(f"low.{joint}", q.min()), 1e-9)
    at = np.sqrt(np.minimum(way / far, 1.0))
    return approach(c, joint) * bump(at, knot, count)


def slipping(c: Context, joint: int, width: float, pressed: int | None = None, past: float = math.inf) -> Array:
    """Evenly taken up; with `pressed` what is more of it where the joint is loaded more than on average; `past` how far
    it went past where it came to from the other side."""
    lag = slip(c.recording.q[:, joint], c.recording.approach[:, joint], width, past)
    return lag if pressed is None else lag * _pressed(c, joint, pressed)


def winding(c: Context, joint: int, way: float, pressed: int | None = None, past: float = math.inf) -> Array:
    """Ever more slowly; `pressed` and `past` as in `slipping`."""
    lag = wind_up(c.recording.q[:, joint], c.recording.approach[:, joint], way, past)
    return lag if pressed is None else lag * _pressed(c, joint, pressed)


def _pressed(c: Context, joint: int, component: int) -> Array:
    """By what share a joint's load is above its mean: the force upon it (-1), or what its drive holds (a component),
    either way. Friction goes with it (Coulomb)."""
    w = c.wrenches[:, joint + 1]
    load = np.linalg.norm(w[:, :3], axis=1) if component < 0 else np.abs(w[:, component])
    return np.asarray(load / max(c.frozen(f"pressed.{joint}.{component}", float(load.mean())), 1e-9) - 1.0)


def temperature(c: Context, place: str, tau: float) -> Array:
    values = c.recording.temperatures[place]
    mean = c.frozen(f"mean.{place}", float(np.mean(values)))
    return c.once(("temperature", place, tau), lambda: lagged(values, c.hours, tau) - mean)


def temperature_q(c: Context, place: str, tau: float, joint: int) -> Array:
    return temperature(c, place, tau) * c.u(joint)


def link_growth(c: Context, place: str, tau: float, joint: int) -> Array:
    """(N, n+1, 6) the link behind a joint longer by a metre per metre and kelvin, towards the next joint or the tip."""
    machine = c.machine
    after = machine.joints[joint + 1].origin if joint + 1 < machine.n else machine.tip_in_link
    out = np.zeros((len(c.hours), machine.n + 1, 6))
    out[:, joint + 1, :3] = temperature(c, place, tau)[:, None] * after[:3, 3]
    return out


def clock(c: Context, form: str, tau: float = 1.0) -> Array:
    """Time since the start: "linear" [h], "exponential" 1 − e^(−t/τ), "log" ln(1 + t/τ), "cosine" the τ-th over the
    recording, "step" 1 and "ramp" t − τ from τ on."""
    t = c.hours
    match form:
        case "linear":
            return t
        case "exponential":
            return np.asarray(1.0 - np.exp(-t / tau))
        case "log":
            return np.asarray(np.log1p(t / tau))
        case "step":
            return step(c, tau)
        case "ramp":
            return np.maximum(t - tau, 0.0)
        case "cosine":  # what wanders without a law stays where it was last seen
            whole = max(c.frozen("hours", float(t[-1])), 1e-9)
            return np.asarray(np.cos(np.pi * tau * np.clip(t / whole, 0.0, 1.0)))
    raise ValueError(f"unknown course in time '{form}'")


def clock_q(c: Context, order: int, joint: int) -> Array:
    """A wave in time, the `order`-th half wave over the recording, times a joint's position."""
    return clock(c, "cosine", order) * c.u(joint)


def step(c: Context, visit_time: float) -> Array:
    """1 from a moment on (hours since the start)."""
    return np.asarray((c.hours >= visit_time).astype(float))


def hopping(c: Context, times: Sequence[float]) -> Array:
    """0 and 1 by turns: another one from each of these moments on (hours since the start, rising)."""
    return np.asarray((np.searchsorted(times, c.hours, side="right") % 2).astype(float))


def seated(c: Context, joint: int, stay: int) -> Array:
    """1 while a joint stays where its `stay`-th move took it, see the column stay_<joint>."""
    return np.asarray((named_column(c, f"stay_{c.machine.joint_names[joint]}") == stay).astype(float))


def settling(c: Context, visit_time: float, tau: float) -> Array:
    """e^(−(t − t₀)/τ) from a moment t₀ on: what a step loses again."""
    late = c.hours - visit_time
    return np.asarray(np.where(late >= 0, np.exp(-np.maximum(late, 0.0) / tau), 0.0))


def wave(c: Context, joint: int, period: float, phase: str) -> Array:
    angle = 2 * np.pi * c.recording.q[:, joint] / period
    return np.asarray(np.sin(angle) if phase == "sin" else np.cos(angle))


def wave_q(c: Context, joint: int, period: float, phase: str, by: int) -> Array:
    """A wave along one joint's travel times another's position."""
    return wave(c, joint, period, phase) * c.u(by)


def load(c: Context, frame: int, component: int) -> Array:
    return np.asarray(c.wrenches[:, frame, component])


def load_q(c: Context, frame: int, component: int, joint: int, degree: int = 1) -> Array:
    return np.asarray(c.wrenches[:, frame, component] * c.u(joint) ** degree)


def load_turn(c: Context, frame: int, component: int, joint: int, order: int, phase: str) -> Array:
    """A component of the wrench on a frame times sine or cosine of `order` times a joint's angle: what gives way more
    in some directions than in others."""
    angle = order * c.recording.q[:, joint]
    return np.asarray(c.wrenches[:, frame, component] * (np.sin(angle) if phase == "sin" else np.cos(angle)))


def _spread(c: Context, frame: int, component: int, of: str = "") -> float:
    """Standard deviation of a component of the wrench on a frame, or of what `load_of` takes of it."""
    key = f"spread.{frame}.{component}{'.' if of else ''}{of}"
    return max(c.frozen(key, float(load_of(c, frame, component, of).std())), 1e-9)


def _most(c: Context, frame: int, component: int) -> float:
    return max(c.frozen(f"most.{frame}.{component}", float(np.abs(c.wrenches[:, frame, component]).max())), 1e-9)


def load_power(c: Context, frame: int, component: int, exponent: float) -> Array:
    w = c.wrenches[:, frame, component]
    return np.asarray(np.sign(w) * np.abs(w) ** exponent / _most(c, frame, component) ** (exponent - 1))


def load_knee(c: Context, frame: int, component: int, at: float, width: float) -> Array:
    """How far a component of the wrench on a frame is above `at`, rounded over `width` (both N or N m): what is stiffer
    on one side of a load than on the other."""
    above = c.wrenches[:, frame, component] - at
    return np.asarray(0.5 * (above + np.hypot(above, width)))


def load_beyond(c: Context, frame: int, component: int, at: float, width: float) -> Array:
    """How far a component of the wrench on a frame is beyond `at` to either side, rounded over `width` (both N or N m):
    what is softer once a preload is lost."""
    w = c.wrenches[:, frame, component]
    above, below = w - at, -w - at
    return np.asarray(0.5 * (above + np.hypot(above, width)) - 0.5 * (below + np.hypot(below, width)))


def load_side(
    c: Context, frame: int, component: int, width: float, offset: float = 0.0, of: str = "", either: bool = False
) -> Array:  # fmt: skip
    """Which side a joint falls to: −1 … 1, saturating; width and offset relative to that load's spread.

    of      "payload": by what the payload does to it alone, as if its own weight were balanced
    either  how far from the middle, to whichever side: 0 … 1; beside the former, a gap that is wider on one side
    """
    side = np.tanh((load_of(c, frame, component, of) / _spread(c, frame, component, of) - offset) / width)
    return np.asarray(np.abs(side) if either else side)


def load_of(c: Context, frame: int, component: int, of: str = "") -> Array:
    """A component of the wrench on a frame; of "payload": without what the machine's own bodies do."""
    w = c.wrenches[:, frame, component]
    return np.asarray(w - own_weight(c, frame, component)) if of == "payload" else w


def load_side_held(c: Context, frame: int, component: int, width: float) -> Array:
    """Which side a joint lies on that stays until the load pushes it over: −1 or 1; width relative to the spread."""
    w = c.wrenches[:, frame, component]
    return side_held(w, width * _spread(c, frame, component))


def load_bump(c: Context, frame: int, component: int, knot: int, count: int) -> Array:
    """A smooth function of a component of the wrench on a frame, finest where it changes sign: the knot-th of `count`
    Gaussian bumps over ± the root of its size."""
    w = c.wrenches[:, frame, component]
    at = np.sign(w) * np.sqrt(np.minimum(np.abs(w) / _most(c, frame, component), 1.0))
    return bump((at + 1.0) / 2.0, knot, count)


def load_slip(c: Context, frame: int, component: int, width: float) -> Array:
    """A slipping spring (`slip`) driven by a component of the wrench on a frame, width relative to the load's spread:
    any hysteresis of a load is a sum of such, unless it depends on how fast the load changes."""
    w = c.wrenches[:, frame, component]
    began = np.zeros(len(w), dtype=np.int64)  # a load comes from the side that it goes to
    began[:1] = np.sign(w[:1])
    return slip(w, began, width * _spread(c, frame, component))


def load_warm(c: Context, frame: int, component: int, place: str, tau: float, width: float = 0.0) -> Array:
    """A component of the wrench on a frame, relative to its spread, or which side the joint falls to by it (width as in
    `load_side`), times a temperature lagged by tau hours: what gives way differently as it warms."""
    w = c.wrenches[:, frame, component]
    spread = _spread(c, frame, component)
    pushed = load_side(c, frame, component, width) if width else w / spread
    return np.asarray(pushed * temperature(c, place, tau))


def creeping(c: Context, frame: int, component: int, tau: float, form: str) -> Array:
    """A component of the wrench on a frame that has not come yet; forms: see `_late`."""
    return np.asarray(_late(c, tau, form)[:, frame, component])


def load_legendre(c: Context, frame: int, component: int, order: int) -> Array:
    """Legendre polynomial of a component of the wrench on a frame, −1 … 1 over what was seen: what ranks
    (`covariate`) resolve badly at the ends."""
    w = c.wrenches[:, frame, component]
    low, high = c.frozen(f"least.{frame}.{component}", w.min()), c.frozen(f"greatest.{frame}.{component}", w.max())
    scaled = np.clip((w - (low + high) / 2) / max((high - low) / 2, 1e-9), -1.0, 1.0)
    return np.asarray(np.polynomial.legendre.legval(scaled, [0.0] * order + [1.0]))


def own_weight(c: Context, frame: int, component: int) -> Array:
    """A component of the wrench on a frame by the machine's own bodies alone."""
    return np.asarray(_own(c)[:, frame, component])


def hanging(c: Context, frame: int, component: int, joint: int) -> Array:
    """Moment on a frame by a weight of 1 N that hangs at joint `joint` and grows with its travel (a cable chain)."""
    arm = c.chain[:, joint + 1, :3, 3] - c.chain[:, frame, :3, 3]
    g = np.asarray(c.machine.gravity) / max(float(np.linalg.norm(c.machine.gravity)), 1e-9)
    force = (0.5 + 0.5 * c.u(joint))[:, None] * g
    return np.asarray(_turned(c.chain[:, frame], force, np.cross(arm, force))[:, component])


def pair(c: Context, a: int, power_a: int, b: int, power_b: int) -> Array:
    """Legendre polynomials of two joints, multiplied."""
    return c.legendre(a, power_a) * c.legendre(b, power_b)


def product(c: Context, joints: Sequence[int]) -> Array:
    """Positions of several joints, −1 … 1 each, multiplied."""
    return np.asarray(np.prod([c.u(k) for k in joints], axis=0))


def covariate(c: Context, name: str, knot: int = 0, count: int = 1) -> Array:
    """A smooth function of any column: the knot-th of `count` Gaussian bumps over its ranks in the recording that it
    was made from, nothing beyond what was seen there (but of time); count 1: the column."""
    if count == 1:
        return c.once(("standard", name), lambda: _standard(c, name)[1])
    seen, rank = c.once(("ranks", name), lambda: _ranks(c, name))
    return np.asarray(seen * bump(rank, knot, count))


def _standard(c: Context, name: str) -> tuple[Array, Array]:
    """(N,) a column less its mean, and in units of its spread; 0 where it does not vary."""
    values = named_column(c, name)
    middle = c.frozen(f"mean of {name}", float(np.nanmean(values)))
    values = np.nan_to_num(values - middle)
    spread = c.frozen(f"spread of {name}", float(values.std()))
    return values, values / spread if spread else np.zeros(len(values))


def _ranks(c: Context, name: str) -> Array:
    """(2, N) whether a column is within what was seen, and its rank 0 … 1 there; nothing of one that does not vary.
    What went on with time is held where it was when nobody looked any more."""
    values, _ = _standard(c, name)
    if not c.frozen(f"spread of {name}", 0.0):
        return np.zeros((2, len(values)))
    places = np.linspace(0.0, 1.0, QUANTILES)
    quantiles = [
        c.frozen(f"quantile {k} of {name}", q) for k, q in enumerate(np.quantile(values, places).tolist())
    ]
    seen = (values >= quantiles[0]) & (values <= quantiles[-1]) | (name == "time")
    return np.stack([seen, np.interp(values, quantiles, places)])


def covariate_pair(c: Context, first: str, second: str, a: int, b: int, count: int) -> Array:
    return covariate(c, first, a, count) * covariate(c, second, b, count)


def named_column(c: Context, name: str) -> Array:
    """A column by its contract name: q_<joint>, time, temp_<place>_C, settle_s, Fx … Mz, cov_<name>; or what is made of
    one: on_<frame>_<Fx … Mz> (what acts on that frame), move_<joint> (from the visit before), way_<joint> (since it
    turned back), stay_<joint> (how often it has moved until then), pace_<joint> (way a joint went since the visit
    before, per hour), reach (from the base to the last frame), azimuth, elevation and distance (of the reflectors from
    the instrument, the first from its mean), incidence (of the beam along that axis of the end effector where it
    changes most), pause (since the visit before, h), load and former_load (mass of this payload and of the one before,
    kg),
    previous_<column> (at the visit before), late_<hours>_<column> (first-order lag)."""
    r, joints = c.recording, c.machine.joint_names
    if name.startswith("q_"):
        return np.asarray(r.q[:, joints.index(name[2:])])
    if name.startswith("previous_"):
        values = named_column(c, name[9:])
        return np.concatenate([values[:1], values[:-1]])
    if name.startswith("on_"):
        frame, load = name[3:].rsplit("_", 1)
        return np.asarray(c.wrenches[:, c.machine.frame_names.index(frame), WRENCH_COMPONENTS.index(load)])
    if name.startswith("move_"):
        q = r.q[:, joints.index(name[5:])]
        return np.concatenate([[0.0], np.diff(q)])
    if name.startswith("stay_"):
        q = r.q[:, joints.index(name[5:])]
        return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q)) > STANDSTILL * float(np.ptp(q)))])
    if name.startswith("pace_"):
        gone = np.abs(np.diff(r.q[:, joints.index(name[5:])]))
        return np.concatenate([[0.0], gone / np.maximum(np.diff(c.hours), LEAST_H)])
    if name in ("azimuth", "elevation"):
        at = _seen_at(c, name)[0].mean(axis=1)
        return np.asarray(np.angle(np.exp(1j * at) / np.exp(1j * at).mean()))
    if name == "incidence":
        seen = _incidence(c)[1].mean(axis=1)
        return np.asarray(seen[:, int(np.argmax(seen.std(axis=0)))])
    if name == "distance":
        return np.asarray(np.linalg.norm(c.points - c.measuring_in_base[:3, 3], axis=2).mean(axis=1))
    if name == "reach":
        return np.asarray(np.linalg.norm(c.chain[:, -1, :3, 3] - c.chain[:, 0, :3, 3], axis=1))
    if name.startswith("way_"):
        k = joints.index(name[4:])
        return way_since_reversal(r.q[:, k], r.approach[:, k])
    if name.startswith("approach_"):
        return np.asarray(r.approach[:, joints.index(name[9:])], dtype=float)
    if name.startswith("temp_"):
        return np.asarray(r.temperatures[name[5:-2]])
    if name == "time":
        return np.asarray(c.hours)
    if name == "pause":
        pauses = np.round(np.diff(c.hours), 7)  # a clock's own rounding is no change of pace
        return np.concatenate([[np.median(pauses) if len(pauses) else 0.0], pauses])
    if name == "since_load_change":
        return hours_since_change(r.load, c.hours)
    if name in ("load", "former_load"):
        mass = _payloads(c)[:, 0]
        return mass if name == "load" else former(mass, r.load)
    if name == "settle_s":
        return np.asarray(r.settle_s)
    if name.startswith("cov_"):
        return np.asarray(r.covariates[name[4:]])
    if name.startswith("late_"):
        tau, late = name[5:].split("_", 1)
        return lagged(named_column(c, late), c.hours, float(tau))
    return np.asarray(r.wrench[:, WRENCH_COMPONENTS.index(name)])


# --- on all frames: (N, n+1, 6) ---------------------------------------------------------------------------------
def creep(c: Context, tau: float, form: str, frame: int = -1) -> Array:
    """What is still missing of every link's deflection after load changes, or of one frame's."""
    missing = -_deflection(c, _late(c, tau, form))
    if frame >= 0:
        missing[:, np.arange(missing.shape[1]) != frame] = 0.0
    return missing


def _late(c: Context, tau: float, form: str) -> Array:
    """(N, n+1, 6) of every link's wrench that it does not follow yet.

    form  "wrench": of the payload's, "total": of the machine's own weight too, a first-order lag of the wrench on the
          link, which every move changes; "began": what that adds had nothing acted there before the calibration's
          recording; else of former changes of load alone, as they act in the pose of now: see `load_memory`
    """

    def late() -> Array:
        if form == "began":
            return np.asarray(c.wrenches[:1] * np.exp(-c.hours / tau)[:, None, None])
        if form in ("wrench", "total"):
            whole = c.wrenches - _own(c) if form == "wrench" else c.wrenches
            return np.asarray(whole - followed(whole, c.hours, tau))
        g = _gravity(c)
        held = load_memory(_payloads(c), c.recording.load, c.hours, tau, form)
        return _by_payload(c, np.concatenate([held[:, :1] * g, np.cross(held[:, 1:], g)], axis=1))

    return c.once(("late", tau, form), late)


def _payloads(c: Context) -> Array:
    return c.once(("payloads",), lambda: payloads(c.recording.wrench, c.recording.load, _gravity(c)))


def _gravity(c: Context) -> Array:
    """(N, 3) in the sensor frame [m/s²]."""
    sensor = c.chain[:, -1] @ c.machine.sensor_in_link
    return np.asarray(np.einsum("nji,j->ni", sensor[:, :3, :3], c.machine.gravity))


def _own(c: Context) -> Array:
    return c.once(("own",), lambda: link_wrenches(c.machine, c.chain, np.zeros((len(c.chain), 6))))


def _by_payload(c: Context, wrench: Array) -> Array:
    """(N, n+1, 6) on every frame by a wrench (N, 6) at the sensor alone."""
    return np.asarray(np.einsum("nfab,nb->nfa", _reaching(c), wrench))


def _reaching(c: Context) -> Array:
    """(N, n+1, 6, 6) what acts on every frame by a unit of every component at the sensor."""

    def reaching() -> Array:
        sensor = (c.chain[:, -1] @ c.machine.sensor_in_link)[:, None]
        into = np.swapaxes(c.chain[..., :3, :3], 2, 3)
        out = np.zeros((*c.chain.shape[:2], 6, 6))
        out[..., :3, :3] = out[..., 3:, 3:] = into @ sensor[..., :3, :3]
        arm = sensor[..., :3, 3] - c.chain[..., :3, 3]
        turns = np.cross(arm[:, :, None], np.swapaxes(sensor[..., :3, :3], 2, 3))  # arm × each axis of the sensor
        out[..., 3:, :3] = into @ np.swapaxes(turns, 2, 3)
        return out

    return c.once(("reaching",), reaching)


def _deflection(c: Context, wrenches: Array) -> Array:
    return np.asarray(np.einsum("nfab,nfb->nfa", c.compliance, wrenches))


def _expected(c: Context, wrench: Array) -> Array:
    """(N, n+1, 6) deflection of every frame that a wrench (N, 6) at the sensor would make."""
    given = c.once(("given",), lambda: np.asarray(c.compliance @ _reaching(c)))
    return np.asarray(np.einsum("nfab,nb->nfa", given, wrench))


def body_weight(c: Context, joint: int, what: str, grows: int = 0, by: int | None = None) -> Array:
    """Deflection by 1 kg more on a joint's body ("mass"), or by 1 kg·m of shifted mass ("x", "y", "z").

    grows  what hangs there goes with that power of a joint's position, −1 … 1 over its travel: a cable chain
    by     of another joint's than its own: a hose that the other one pulls along
    """
    out = np.zeros_like(c.wrenches)
    g = c.machine.gravity
    pose = c.chain[:, joint + 1]
    com = c.machine.joints[joint].com
    for i in range(1, joint + 2):
        frame = c.chain[:, i]
        if what == "mass":
            force = np.broadcast_to(g, (len(out), 3))
            arm = np.einsum("nij,j->ni", pose[:, :3, :3], com) + pose[:, :3, 3] - frame[:, :3, 3]
            moment = np.cross(arm, force)
        else:
            force = np.zeros((len(out), 3))
            axis = pose[:, :3, "xyz".index(what)]
            moment = np.cross(axis, np.broadcast_to(g, (len(out), 3)))
        out[:, i] = np.einsum("nab,nb->na", c.compliance[:, i], _turned(frame, force, moment))
    return np.asarray(out * (c.u(joint if by is None else by) ** grows)[:, None, None]) if grows else out


def sensor_error(
    c: Context, component: int, source: int = -1, time: str = "", place: str = "", tau: float = 0.0, bent: str = ""
) -> Array:
    """Deflection wrongly expected when a component of the sensor is off by 1, by its reading `source`, with time (form
    and tau of `clock`), or with a temperature (lagged by tau hours).

    component  −1: all six, each by its own reading (gain), in proportion to time or a temperature where one is given
    bent       by the square of that reading, "even" or with its sign, "odd": the gain changes with the load; by its
               size, "sided": it is another one for pull than for push
    """
    count = len(c.recording)
    size = np.ones(count) if source < 0 else c.recording.wrench[:, source]
    if bent == "sided":
        size = np.abs(size)
    elif bent:
        size = size * (np.abs(size) if bent == "odd" else size)
    if time:
        size = size * clock(c, time, tau or 1.0)
    if place:
        size = size * temperature(c, place, tau)
    wrench = np.zeros((count, 6))
    if component < 0:
        wrench = size[:, None] * c.recording.wrench
    else:
        wrench[:, component] = size
    return -_expected(c, wrench)


def sensor_off(c: Context, component: int, name: str, knot: int, count: int) -> Array:
    """Deflection wrongly expected when a component of the sensor is off by a smooth function of any column, see
    `covariate`."""
    wrench = np.zeros((len(c.recording), 6))
    wrench[:, component] = covariate(c, name, knot, count)
    return -_expected(c, wrench)


def pulled(c: Context, axis: int, knot: int, count: int) -> Array:
    """Deflection by a force of 1 N on the end effector, along an axis of the base (0, 1, 2) or towards it (3), times a
    smooth function of how far it reaches, see `covariate`."""
    sensor = (c.chain[:, -1] @ c.machine.sensor_in_link)[:, :3, :3]
    to = c.chain[:, 0, :3, 3] - c.chain[:, -1, :3, 3] if axis == 3 else c.chain[:, 0, :3, axis]
    force = to / np.linalg.norm(to, axis=1, keepdims=True) * covariate(c, "reach", knot, count)[:, None]
    wrench = np.concatenate([np.einsum("nji,nj->ni", sensor, force), np.zeros_like(force)], axis=1)
    return -_expected(c, wrench)


def _turned(frame: Array, force: Array, moment: Array) -> Array:
    """Force and moment (N, 3) from base axes into a frame's: (N, 6)."""
    into = np.swapaxes(frame[:, :3, :3], 1, 2)
    return np.concatenate([(into @ force[..., None])[..., 0], (into @ moment[..., None])[..., 0]], axis=1)


def unexplained(
    c: Context, names: list[str], centre: list[float], spread: list[float], low: list[float], high: list[float],
    length: list[float], sites: list[list[float]], frame: int, components: list[int], amplitude: list[float],
    mode: list[list[float]], others: list[dict[str, Any]] | None = None,
) -> Array:  # fmt: skip
    """One direction of a Gaussian process over columns, nothing where the recording it was learnt from had no data.

    mode (C, m) of the process's functions for the components of a frame; amplitude (C,): see `Correction`; others:
    regions of further processes that were learnt beside it, outside of which this one is not used either
    """
    region = region_of({"names": names, "centre": centre, "spread": spread, "low": low, "high": high,
                        "length": length, "sites": sites})  # fmt: skip
    out = np.zeros_like(c.wrenches)
    out[:, frame, components] = region.basis(columns_at(c, region.names)) @ np.array(mode).T
    return out * windows(c, others or [])[:, None, None]


def instead(c: Context, column: dict[str, Any], regions: list[dict[str, Any]]) -> Array:
    """Another column, where all of these regions had data: what else has another value beside a Gaussian process."""
    inner = Column.from_dict(column).value(c)
    return np.asarray(inner * windows(c, regions).reshape(-1, *[1] * (inner.ndim - 1)))


def model_shift(c: Context, theta: list[float]) -> Array:
    """(N, n+1, 6) of the base model's frame terms, with other parameters by `theta` (p,)."""
    out = np.zeros_like(c.wrenches)
    if c.model is None:
        return out
    situation, at = Situation.of(c.recording), 0
    for term, size in zip(c.model.terms, c.model.sizes, strict=False):
        out[:, term.frame] += term.regressors(situation, c.wrenches) @ np.array(theta[at : at + size])
        at += size
    return out


def windows(c: Context, regions: list[dict[str, Any]]) -> Array:
    """(N,) 1 where all regions had data, 0 where one of them had not."""
    out = np.ones(len(c.recording))
    for region in map(region_of, regions):
        out *= region.window(columns_at(c, region.names))
    return out


def region_of(args: dict[str, Any]) -> Region:
    """Of the arguments of `unexplained`."""
    figures = (np.array(args[k], dtype=float) for k in ("centre", "spread", "low", "high", "length", "sites"))
    return Region(tuple(args["names"]), *figures)


def columns_at(c: Context, names: tuple[str, ...]) -> Array:
    """(N, d) columns by name; nan where this recording does not have one."""
    out = np.full((len(c.recording), len(names)), np.nan)
    for k, name in enumerate(names):
        try:
            out[:, k] = named_column(c, name)
        except KeyError:
            continue
    return out


# --- on the measured points: (N, T, 3) ----------------------------------------------------------------------------
def scale(c: Context, place: str = "") -> Array:
    """Distances from the instrument longer by a factor; with a place, per kelvin of that temperature."""
    return _rays(c, place)


def strain(c: Context, first: int, second: int, place: str = "") -> Array:
    """The space around the instrument stretched (twice the same axis) or sheared; per kelvin with a place."""
    rays = _rays(c, place)
    out = np.zeros_like(rays)
    out[..., first], out[..., second] = rays[..., second], rays[..., first]
    return out


def _rays(c: Context, place: str) -> Array:
    """(N, T, 3) from the instrument to the targets; times a temperature with a place."""
    rays = c.points - c.measuring_in_base[:3, 3]
    return np.asarray(rays * temperature(c, place, 0.0)[:, None, None] if place else rays)


def angle_error(c: Context, angle: str, order: int, phase: str) -> Array:
    """The instrument's azimuth or elevation off by the sine or cosine of `order` times itself: its encoders' error. Its
    standing axis is taken for plumb."""
    at, moves = _seen_at(c, angle)
    return np.asarray(moves * (np.sin(order * at) if phase == "sin" else np.cos(order * at))[..., None])


def _seen_at(c: Context, angle: str) -> tuple[Array, Array]:
    """The angle at which the instrument sees every target (N, T), and how that moves as it grows (N, T, 3)."""
    rays = c.points - c.measuring_in_base[:3, 3]
    up = -np.asarray(c.machine.gravity) / np.linalg.norm(c.machine.gravity)
    ahead = c.measuring_in_base[:3, 0] if abs(c.measuring_in_base[:3, 0] @ up) < 0.9 else c.measuring_in_base[:3, 1]
    ahead = ahead - (ahead @ up) * up
    ahead /= np.linalg.norm(ahead)
    height = rays @ up
    level = rays - height[..., None] * up
    away = np.maximum(np.linalg.norm(level, axis=2), 1e-9)
    if angle == "azimuth":
        return np.arctan2(rays @ np.cross(up, ahead), rays @ ahead), np.cross(up, level)
    return np.arctan2(height, away), away[..., None] * up - (height / away)[..., None] * level


def range_error(c: Context, first: int, second: int = -1, target: int = -1) -> Array:
    """Distances longer by a component of the direction in which the end effector's axes see the beam, or by the product
    of two: reflectors whose cube corner or sphere is off, the more the more aslant the beam falls in. target: of one
    reflector; -1: of all alike."""
    beam, seen = _incidence(c)
    by = seen[..., first] * (seen[..., second] if second >= 0 else 1.0)
    if target >= 0:
        by = by * (np.arange(by.shape[1]) == target)
    return np.asarray(beam * by[..., None])


def _incidence(c: Context) -> tuple[Array, Array]:
    """Unit vectors of the beams in the base and in the end effector's axes: (N, T, 3) each."""
    rays = c.points - c.measuring_in_base[:3, 3]
    beam = rays / np.maximum(np.linalg.norm(rays, axis=2, keepdims=True), 1e-9)
    return beam, np.einsum("nji,ntj->nti", c.tips[:, :3, :3], beam)


def refraction(c: Context, place: str, part: int) -> Array:
    """What bends upwards per kelvin: by a coordinate in the measuring frame (part 0 to 2), evenly (3), with the squared
    distance from its origin (4): together with the squared distance from wherever the instrument stands. The beam does
    in air whose temperature changes with height."""
    rays = c.points - c.measuring_in_base[:3, 3]
    up = -np.asarray(c.machine.gravity) / np.linalg.norm(c.machine.gravity)
    parts = (*np.moveaxis(rays, 2, 0), np.ones(rays.shape[:2]), (rays**2).sum(axis=2))
    return np.asarray((parts[part] * temperature(c, place, 0.0)[:, None])[..., None] * up)


def target_shift(
    c: Context, target: int, axis: int, since: float = -1.0, order: int = 0, slow: float = 0.0, name: str = "",
    load: int = -1,
) -> Array:  # fmt: skip
    """One reflector moved along one axis of the end effector, always or from a moment on (hours since the start), at
    once or with a time constant `slow` [h]; in the `order`-th half wave over the recording; with a column; or in
    proportion to a component of the sensor's wrench (by the greatest that this read)."""
    out = np.zeros_like(c.points)
    out[:, target] = c.tips[:, :3, axis]
    if order:
        out = out * clock(c, "cosine", order)[:, None, None]
    if name:
        out = out * covariate(c, name)[:, None, None]
    if load >= 0:
        read = c.recording.wrench[:, load]
        out = out * (read / c.frozen(f"most.read.{load}", float(np.abs(read).max())))[:, None, None]
    if since >= 0:
        out = out * step(c, since)[:, None, None]
    if slow:
        out = out * (1.0 - np.exp(-np.maximum(c.hours - since, 0.0) / slow))[:, None, None]
    return out


FUNCTIONS: dict[str, FunctionOfVisits] = {
    f.__name__: f
    for f in (
        approach, approach_q, reversal, turning, slipping, winding, temperature, temperature_q, link_growth, clock,
        clock_q, step, hopping, seated, settling, wave, wave_q, load, load_q, load_turn, load_power, load_knee,
        load_beyond, load_side, load_side_held, load_bump, load_slip, load_warm, load_legendre, creeping, own_weight,
        hanging, pair, product, covariate, covariate_pair, creep, body_weight, sensor_error, sensor_off, pulled, scale,
        strain, angle_error, range_error, refraction, target_shift, unexplained, instead, model_shift,
    )
}  # fmt: skip
