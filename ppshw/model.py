"""The full model: a machine and its terms say where targets really are   (paper eq. 17, by the exact product eq. 5)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ppshw.kinematics import frames, point_jacobian, tip_jacobian, tip_levers
from ppshw.machine import Machine
from ppshw.statics import link_wrenches
from ppshw.terms import Fills, FrameTerm, Parameter, Situation
from ppshw.terms.target import TargetOffset

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Linearised:
    """The model about θ₀: targets ≈ positions + design (θ − θ₀).

    positions  (N, T, 3)     targets in the base frame                   [m]
    design     (N, T, 3, p)  per parameter
    levers     (N, T, 3, 6 + 6n)  how targets move with a small displacement of the end effector about its origin, base
               axes, and then with the generalized error of every joint: what `Noise.covariance` needs
    """

    positions: Array
    design: Array
    levers: Array


@dataclass(frozen=True)
class Tangent:
    """How the end effector moves about θ₀, in its own axes about its own origin: all that a rigid body can do.

    tips      (N, 4, 4)       the real end effector in the base
    jacobian  (N, 6, n+1, 6)  per generalized error of every frame               [m/m, m/rad; rad/rad]
    errors    (N, n+1, 6) [m, rad];  wrenches (N, n+1, 6) [N, N·m]
    """

    tips: Array
    jacobian: Array
    errors: Array
    wrenches: Array


@dataclass(frozen=True)
class Model:
    """What is modelled of a machine. Parameters stand in the order of the terms; targets come last.

    terms          acting on frames
    target_offset  None when the machine file's target positions are trusted
    """

    machine: Machine
    terms: tuple[FrameTerm, ...]
    target_offset: TargetOffset | None = None

    def parameters(self) -> list[Parameter]:
        names = self.machine.frame_names
        out = [p for term in self.terms for p in term.parameters(names)]
        return out + (self.target_offset.parameters(names) if self.target_offset else [])

    def targets(self, theta: Array) -> Array:
        """(T, 3) target positions in the end-effector frame, as identified."""
        if self.target_offset is None:
            return self.machine.target_array
        return self.machine.target_array + theta[-self.machine.target_array.size :].reshape(-1, 3)

    def errors(self, situation: Situation, theta: Array) -> tuple[Array, Array]:
        """Generalized errors and link wrenches at the given parameters.

        The wrench depends on where the frames really are, and they depend on the wrench; one repetition leaves less
        than 1 µm at 10 mm of deflection.

        returns  (N, n+1, 6) [m, rad] and (N, n+1, 6) [N, N·m]
        """
        machine = self.machine
        errors: Array | None = None
        for _ in range(2):
            wrenches = link_wrenches(machine, frames(machine, situation.q, errors), situation.payload)
            errors = np.zeros((len(situation), machine.n + 1, 6))
            at = 0
            for term in self.terms:
                d = term.regressors(situation, wrenches)
                m = d.shape[2]
                errors[:, term.frame] += d @ theta[at : at + m]
                at += m
        assert errors is not None
        return errors, wrenches

    def tip_poses(self, situation: Situation, theta: Array) -> Array:
        """The real end-effector frame in the base: (N, 4, 4)."""
        errors, _ = self.errors(situation, theta)
        return frames(self.machine, situation.q, errors)[:, -1] @ self.machine.tip_in_link

    def predict(self, situation: Situation, theta: Array, points: Array | None = None) -> Array:
        """Where points of the end effector (default: the targets) really are: (N, P, 3) in the base frame [m]."""
        tip = self.tip_poses(situation, theta)
        points = self.targets(theta) if points is None else points
        return np.asarray(np.einsum("nij,pj->npi", tip[:, :3, :3], points) + tip[:, None, :3, 3])

    def linearise(self, situation: Situation, theta: Array, points: Array | None = None) -> Linearised:
        """The model and its derivative about `theta` (p,), for the targets or for other points (P, 3).

        The wrenches are held while differentiating: how they change with the errors is of third order.
        """
        errors, wrenches = self.errors(situation, theta)
        chain = frames(self.machine, situation.q, errors)
        tip = chain[:, -1] @ self.machine.tip_in_link
        own = points is None
        points = self.targets(theta) if points is None else points
        positions = np.einsum("nij,pj->npi", tip[:, :3, :3], points) + tip[:, None, :3, 3]
        jacobian = point_jacobian(chain, positions, errors)
        count, size = len(situation), positions.shape[1]
        offsets = None
        if self.target_offset is not None:
            shift = self.target_offset.point_regressors(tip[:, :3, :3])
            offsets = np.zeros((count, size * 3, shift.shape[-1]))
            if own:
                offsets[:] = shift.reshape(count, size * 3, -1)
        flat = jacobian.reshape(count, size * 3, -1, 6)
        design = self.columns(flat, situation, wrenches, offsets)
        joints = jacobian[..., 1:, :].reshape(count, size, 3, -1)
        levers = np.concatenate([tip_levers(positions - tip[:, None, :3, 3]), joints], axis=3)
        return Linearised(positions, design.reshape(count, size, 3, -1), levers)

    def tangent(self, situation: Situation, theta: Array) -> Tangent:
        """What `linearise` says, before it is laid out by parameters: a fiftieth of the numbers."""
        errors, wrenches = self.errors(situation, theta)
        chain = frames(self.machine, situation.q, errors)
        tip = chain[:, -1] @ self.machine.tip_in_link
        return Tangent(tip, tip_jacobian(chain, tip, errors), errors, wrenches)

    def columns(
        self, jacobian: Array, situation: Situation, wrenches: Array, offsets: Array | None = None,
        active: Mask | None = None,
    ) -> Array:  # fmt: skip
        """How R coordinates of every visit move with the parameters.

        jacobian  (N, R, n+1, 6)  with the generalized errors;  wrenches (N, n+1, 6)
        offsets   (N, R, 3T)      with the target offsets, where they are parameters
        active    (p,)            which parameters are wanted; None: all
        returns   (N, R, wanted)
        """
        sizes = self.sizes
        if active is None:
            active = np.ones(sum(sizes), dtype=bool)
        ends = np.cumsum(sizes)
        out = np.empty((*jacobian.shape[:2], int(active.sum())))
        at = 0
        for term, size, end in zip(self.terms, sizes, ends, strict=False):
            which = active[end - size : end]
            wanted = int(which.sum())
            if wanted:
                part = out[:, :, at : at + wanted]
                if isinstance(term, Fills):
                    term.fill(part, jacobian[:, :, term.frame], situation, wrenches, which)
                else:
                    part[:] = (jacobian[:, :, term.frame] @ term.regressors(situation, wrenches))[:, :, which]
            at += wanted
        if self.target_offset is not None and offsets is not None:
            out[:, :, at:] = offsets[:, :, active[ends[-1] - sizes[-1] :]]
        return out

    @cached_property
    def sizes(self) -> list[int]:
        """Number of parameters per term, target offsets last."""
        names = self.machine.frame_names
        terms = [len(term.parameters(names)) for term in self.terms]
        return terms + ([len(self.target_offset.parameters(names))] if self.target_offset else [])
