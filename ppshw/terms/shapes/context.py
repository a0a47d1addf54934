"""What a shape may look at: a recording's visits seen through the base model."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ppshw.kinematics import frames, point_jacobian, tip_levers
from ppshw.machine import Machine
from ppshw.model import Model
from ppshw.recording import Recording
from ppshw.terms import Situation
from ppshw.terms.earlier import known_from_to
from ppshw.terms.elastic import Compliance
from ppshw.terms.history import hours_since

Array = NDArray[np.float64]
UNTIMED = 0.0  # start of a recording without times
ALONG = 6  # component of a joint's frame: along or about the joint's own axis, where that is none of the frame's


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
        own, reference = reference is None, {} if reference is None else reference
        first = float(recording.time[0]) if np.isfinite(recording.time).all() else UNTIMED
        start = reference.setdefault("start", first)
        hours = hours_since(start, recording.time)
        if (start == UNTIMED) != (first == UNTIMED):  # nobody knows how long after: as if it went on from there
            hours = reference.get("hours", 0.0) + hours_since(first, recording.time)
        if own and len(hours):
            reference.setdefault("hours", float(hours[-1]))
        return cls(
            model.machine, recording, jacobian, wrenches, points, tips, chain, compliances(model, theta, situation),
            measuring_in_base, hours, reference, model,
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

    @property
    def clock(self) -> Array:
        """(N,) hours as far as anything is known of what goes by them (`known_from_to`)."""
        return np.clip(self.hours, *known_from_to(self.reference.get("hours", math.inf), self.hours))

    def levers(self) -> Array:
        """(N, T, 3, 6 + 6n) how points move with the end effector about its origin, and with every joint (`Noise`)."""
        joints = self.jacobian[:, :, 1:].reshape(*self.points.shape, -1)
        return np.concatenate([tip_levers(self.points - self.tips[:, None, :3, 3]), joints], axis=3)

    def direction(self, frame: int, component: int) -> Array:
        """(6,) of a component of a frame; of `ALONG` the frame's joint's own."""
        return np.asarray(self.machine.own_ways[frame - 1] if component == ALONG else np.eye(6)[component])

    def moved(self, frame: int, component: int) -> Array:
        """(N, 3T) how targets move with a frame in one component."""
        if component != ALONG:
            return self.jacobian[:, :, frame, component]
        return np.asarray(self.jacobian[:, :, frame] @ self.direction(frame, component))

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
