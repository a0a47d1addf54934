"""Wanted pose and load → corrected joint setpoints   (paper figure 3).

The real machine, as calibrated, is asked where it would go; Newton's method moves the setpoints until it goes where it
should. Joints that move the end effector in fewer than six degrees of freedom cannot put a whole pose right: there the
position of the point that was asked for goes first, and what stays is said. What cannot be honoured is refused with a
reason: nothing is clipped. Of the effects that a diagnosis found those that can be known when a setpoint is computed
are taken out (known_effects.py), the others named, with the reason.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ppshw.calibration import Calibration
from ppshw.compensation.inverse import POSITION_TOLERANCE, EffectErrors, amount, left_of, nominal_joints, solve_pose
from ppshw.compensation.known_effects import KnownEffects, Verdict
from ppshw.compensation.past import Moment, Past, Signs, approach_of
from ppshw.errors import CompensationRefused
from ppshw.kinematics import frames, freedoms, point_jacobian, point_positions, tip_poses
from ppshw.quantities import distance
from ppshw.recording import Around
from ppshw.terms import Situation
from ppshw.transforms import inverse, transform

Array = NDArray[np.float64]
REACHED = 1e-5  # m, rad that a corrected setpoint may leave of a whole pose
# Beside where it starts from a joint with lost motion is at odds: on either side it is too far on the other. Ours.
AT_ITS_START, OVER_A_GAP = 1e-5, 1e-3  # m, rad


@dataclass(frozen=True)
class Bounds:
    """How far a corrected setpoint may lie from the wanted one, and how far outside what was identified one may go.

    travel  [m] per prismatic joint;  angle  [rad] per revolute joint
    joints, loads  share of the identified range of a joint, or load component, that is tolerated beyond its ends:
                   geometry is held there, while deflections go on in proportion
    """

    travel: float = 0.03
    angle: float = 0.03
    joints: float = 0.05
    loads: float = 0.1


@dataclass(frozen=True)
class _Effected:
    """base, errors (1, n+1, 6) without and with the effects; wrenches (1, n+1, 6); chain (1, n+1, 4, 4);
    positions (1, P, 3) of points."""

    base: Array
    wrenches: Array
    errors: Array
    chain: Array
    positions: Array


@dataclass(frozen=True)
class Setpoints:
    """corrected and nominal (n,) [m, rad]; predicted_error (3,) of the point without correction, base axes [m];
    left (6,) of it after correction: the point's position, and the rotation vector of its frame [m, rad];
    std (3,) of the point's position after correction [m]: the model's uncertainty, and what effects may do by what is
    not known; approach (n,) the direction that every joint comes from by, as far as known; effects: what a diagnosis
    had found, taken out or not, and why; at_odds: joints that the setpoint for either side brings from the other, which
    leaves `left`."""

    corrected: Array
    nominal: Array
    predicted_error: Array
    left: Array
    std: Array
    approach: Signs
    effects: tuple[Verdict, ...] = ()
    at_odds: tuple[str, ...] = ()


@dataclass(frozen=True)
class Circumstances:
    """What is known of a move beyond its end and its load. Only effects that a diagnosis found ask for it.

    start       (n,) joint values that the move starts from; None: unknown
    approach    (n,) direction of each joint's final motion where somebody says it, 0: as `run_up` or `start` has it
    run_up      (n,) final motions that a site always has, signed, 0: none [m, rad]
    before      (n,) direction of the motion before, which a joint keeps that does not move
    loaded_for  how long the load has been on [s]; None: unknown. Asked only where there is no past
    lay_before  (6,) what the sensor read at that pose before it was put on; None: unknown, nothing
    """

    start: Array | None = None
    approach: Signs | None = None
    run_up: Array | None = None
    before: Signs | None = None
    around: Around = field(default_factory=Around)
    loaded_for: float | None = None
    lay_before: Array | None = None
    past: Past | None = None

    @property
    def seen_to(self) -> Signs | None:
        """(n,) directions of final motions that somebody sees to, 0 elsewhere; None: of none."""
        if self.run_up is None:
            return self.approach
        always = np.sign(self.run_up).astype(np.int64)
        return always if self.approach is None else np.where(self.approach != 0, self.approach, always)

    @property
    def last_way(self) -> Array | None:
        """(n,) the run-up, 0 where somebody says that a joint comes from its other side: by a way unknown."""
        if self.run_up is None or self.approach is None:
            return self.run_up
        return np.where(np.sign(self.run_up) == self.seen_to, self.run_up, 0.0)


class Compensator:
    """Corrects setpoints of one calibrated machine.

    Six joints and more put the whole end-effector frame right. Fewer, or joints that move it in fewer ways, bring the
    named point to its place, or as near as they go, and turn its frame as far as that allows (`position_first`);
    `Setpoints.left` is what stays.
    """

    def __init__(self, calibration: Calibration, bounds: Bounds | None = None) -> None:
        self.calibration = calibration
        self.machine = calibration.machine
        self.bounds = bounds or Bounds()
        self.position_first = freedoms(self.machine) < 6
        self.known: KnownEffects | None = None
        if calibration.effects:
            self.known = KnownEffects(
                calibration.effects, calibration.model, calibration.laid_at, calibration.reference,
                calibration.measuring_in_base, calibration.temperature_range, calibration.visits,
            )  # fmt: skip

    def for_pose(
        self,
        wanted: Array,
        payload: Array,
        point: str = "tip",
        near: Array | None = None,
        given: Circumstances | None = None,
    ) -> Setpoints:
        """Setpoints that bring a named point's frame to `wanted`.

        wanted   (4, 4) of the point (its axes are the end effector's) in the base frame; a target is where it was
                 identified to be
        payload  (6,) on the sensor, sensor frame, at that pose    [N, N·m]
        Raises CompensationRefused: out of reach of the ideal machine, beyond a limit, outside what was identified (a
        temperature far outside), too large a correction, one that leaves the point farther off than none, or (position
        first) none found.
        """
        offset = transform(np.eye(3), self.calibration.point(point))
        wanted_tip = wanted @ inverse(offset)
        nominal = nominal_joints(self.machine, wanted_tip, near)
        return self._correct(wanted_tip, nominal, payload, point, given or Circumstances())

    def for_joints(
        self, wanted: Array, payload: Array, point: str = "tip", given: Circumstances | None = None
    ) -> Setpoints:
        """Setpoints that bring the real machine where the ideal one would be at joint values `wanted` (n,) [m, rad].

        Payload, point and what is raised as for `for_pose`.
        """
        wanted = np.asarray(wanted, dtype=float)
        return self._correct(tip_poses(self.machine, wanted)[0], wanted, payload, point, given or Circumstances())

    def _correct(
        self, wanted_tip: Array, nominal: Array, payload: Array, point: str, given: Circumstances
    ) -> Setpoints:
        self.refuse_outside(nominal, payload)
        start = nominal[None]
        now, past = self._moment(nominal, payload, given), given.past or Past()
        if self.known is not None:
            self.known.refuse_far(now)
        if self.known is not None and given.past is None:
            past = self.known.loaded_for(now, given.loaded_for, given.start, given.before, given.lay_before)
        where = self.calibration.point(point)[None]
        q, left, now, at_odds = self._solved(wanted_tip, start, now, past, given, where[0])
        self.refuse_correction(q[0], nominal)
        uncorrected = self._effected(replace(now, q=nominal), past, where).positions[0, 0]
        ideal = point_positions(self.machine, start, where)
        variance = self._variance(replace(now, q=q[0]), past, point)
        verdicts = () if self.known is None else tuple(self.known.verdicts(now, past))
        error = uncorrected - ideal[0, 0]
        with_it, without = float(np.linalg.norm(left[0, :3])), float(np.linalg.norm(error))
        if self.position_first and with_it > without + POSITION_TOLERANCE:
            raise CompensationRefused(
                f"the correction would leave '{point}' {distance(with_it)} off, without it is {distance(without)}"
            )
        return Setpoints(
            q[0], nominal, error, -left[0], np.sqrt(np.maximum(variance, 0.0)), now.approach, verdicts, at_odds,
        )  # fmt: skip

    def _moment(self, q: Array, payload: Array, given: Circumstances) -> Moment:
        around = given.around
        load = around.load or ("" if given.past is not None else "now")
        said = around.time, load, around.temperatures
        return Moment(q, _approach(q, given), payload, *said, given.last_way, given.seen_to)

    def _solved(
        self, wanted_tip: Array, start: Array, now: Moment, past: Past, given: Circumstances, where: Array
    ) -> tuple[Array, Array, Moment, tuple[str, ...]]:
        """The setpoints (1, n), what they leave (1, 6), the moment with the approach that they bring about, and the
        joints that are at odds.

        The correction may turn the direction that a joint comes from; then that direction's own correction is taken.
        Where neither direction agrees with itself (a gap that runs ahead, and the joint nearly where it is wanted), or
        the pose cannot be had on either side of where a joint starts from, it is left where it stands, or sent to the
        last one tried, whichever leaves less as it really comes.
        """
        payload, first = now.payload[None], where if self.position_first else None
        tries, odd = [], np.zeros(len(now.q), dtype=bool)
        for _ in range(3):
            q, left = solve_pose(
                self.machine, wanted_tip[None], start, self.calibration, payload, self._effects(now, past), first
            )
            if self.known is None:
                break
            came, now = now.approach, replace(now, approach=_approach(q[0], given))
            odd = self.known.sided & (now.approach != came)
            if not odd.any():
                break
            tries = [q[0]] if given.start is None else [q[0], np.where(odd, given.start, q[0])]
        much = 0.0 if self.position_first else float(np.abs(left).max())
        if much > REACHED:
            odd = self._turning(q[0], given)
            if much > OVER_A_GAP or not odd.any():
                raise CompensationRefused(
                    f"no corrected setpoint was found for the pose: of the nearest {amount(left[0])} are left; "
                    f"'{self.machine.name}' may stand nearly stretched there, or in another singular pose"
                )
            tries = [q[0], np.where(odd, given.start, q[0])]
        if not odd.any():
            return q, left, now, ()
        found = []
        for one in tries:
            now = replace(now, q=one, approach=_approach(one, given))
            effects = self._effects(now, past)
            left = left_of(self.machine, wanted_tip[None], one[None], self.calibration, payload, effects, where)
            found.append((one[None], left, now))
        seen = slice(3 if self.position_first else 6)  # angles count as on a lever of a metre
        nearest = min(found, key=lambda each: float(np.linalg.norm(each[1][0, seen])))
        return *nearest, tuple(name for name, is_odd in zip(self.machine.joint_names, odd, strict=True) if is_odd)

    def _turning(self, q: Array, given: Circumstances) -> NDArray[np.bool_]:
        """(n,) joints with lost motion that would turn just where they start from."""
        if self.known is None or given.start is None:
            return np.zeros(len(q), dtype=bool)
        return np.asarray(self.known.sided & (np.abs(q - given.start) < AT_ITS_START))

    def _effects(self, now: Moment, past: Past) -> EffectErrors | None:
        known = self.known
        if known is None:
            return None
        return lambda q, errors, wrenches: known.errors(replace(now, q=q[0]), past, errors, wrenches)

    def _effected(self, now: Moment, past: Past, where: Array) -> _Effected:
        """Where points of the end effector (1, 3) really are with all that is known, and how they move."""
        q, model = now.q[None], self.calibration.model
        base, wrenches = model.errors(Situation(q, now.payload[None]), self.calibration.theta)
        errors = base if self.known is None else base + self.known.errors(now, past, base, wrenches)
        chain = frames(self.machine, q, errors)
        tip = chain[:, -1] @ self.machine.tip_in_link
        positions = np.einsum("nij,pj->npi", tip[:, :3, :3], where) + tip[:, None, :3, 3]
        return _Effected(base, wrenches, errors, chain, positions)

    def _variance(self, now: Moment, past: Past, point: str) -> Array:
        """(3,) of a point's position [m²]: how unsure the base model and the effects are together, and what effects
        may do by what is not known; of a target also how unsure is where it sits, if the file leaves that open.

        Were an effect larger, the base model would be fitted with the less: of what it has for the effect's part only
        what is beyond that counts. docs/derivations.md (6.2).
        """
        situation = Situation(now.q[None], now.payload[None])
        calibration, where = self.calibration, self.calibration.point(point)[None]
        target = calibration.target_index(point)
        asked_of = where if target is None else None
        design = calibration.model.linearise(situation, calibration.theta, asked_of).design[0, target or 0]
        variance = np.einsum("ip,pq,iq->i", design, self.calibration.covariance, design)
        if self.known is not None:
            here = self._effected(now, past, where)
            jacobian = point_jacobian(here.chain, here.positions, here.errors)[0, 0]
            asked = now, past, here.base, here.wrenches
            effects, instead = self.known.unsure(*asked)
            moved = np.einsum("ifc,kfc->ki", jacobian, effects) - instead @ design.T
            unknown = np.einsum("ifc,kfc->ki", jacobian, self.known.unknown(*asked))
            variance += (moved**2).sum(axis=0) + (unknown**2).sum(axis=0)
        return np.asarray(variance)

    def refuse_outside(self, q: Array, payload: Array) -> None:
        """Raises CompensationRefused for positions (n,) or a sensor's reading (6,) that no measurement covered."""
        outside = self.calibration.outside(q, payload, self.bounds.joints, self.bounds.loads)
        if outside:
            raise CompensationRefused(outside[0])

    def refuse_correction(self, corrected: Array, nominal: Array) -> None:
        """Raises CompensationRefused for setpoints (n,) farther from the nominal than the bounds, or beyond limits."""
        lower, upper = self.machine.limits()
        for k, joint in enumerate(self.machine.joints):
            change = abs(corrected[k] - nominal[k])
            bound = self.bounds.travel if joint.prismatic else self.bounds.angle
            if change > bound:
                raise CompensationRefused(
                    f"joint '{joint.name}' would be corrected by {change:.4g} {joint.unit}, the bound is {bound:g} "
                    f"{joint.unit}"
                )
            if not lower[k] <= corrected[k] <= upper[k]:
                raise CompensationRefused(
                    f"corrected setpoint of joint '{joint.name}' {corrected[k]:.6g} {joint.unit} is beyond its limits "
                    f"{lower[k]:g} … {upper[k]:g}"
                )


def _approach(end: Array, given: Circumstances) -> Signs:
    """(n,) directions that a move to `end` brings about; 0 where nothing says so."""
    before = np.zeros(len(end), dtype=np.int64) if given.before is None else given.before
    found = before if given.start is None else approach_of(given.start, end, before)
    return found if given.seen_to is None else np.where(given.seen_to != 0, given.seen_to, found)
