"""Compensated setpoints within microseconds, for a controller's cycle and for whole trajectories.

The same correction as compensation.Compensator.for_joints and the same refusals, in compiled code. What a joint's own
position decides (generalized errors, compliances) is tabulated once as piecewise cubics. docs/decisions/
compiled-setpoints.md says why. Needs numba, which `make` installs; elsewhere pip install '.[fast]' in
the project's folder.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ppshw.calibration import Calibration
from ppshw.compensation import Bounds, Compensator
from ppshw.compensation.inverse import amount
from ppshw.errors import CalibrationError, CompensationRefused, PpshwError
from ppshw.kinematics import freedoms
from ppshw.machine import Machine
from ppshw.model import Model
from ppshw.terms import Situation
from ppshw.terms.basis import Interpolated, Polynomial, Smooth
from ppshw.terms.own_motion import OwnMotion

if TYPE_CHECKING:
    from ppshw.compensation.fast_kernel import Allowed, Chain, Functions

Array = NDArray[np.float64]
# A table may be wrong by this much [m, rad] under the largest load that was identified: far below a micrometre.
TABLE_TOLERANCE = 1e-8
MOST_CELLS = 8192


@dataclass(frozen=True)
class FastSetpoints:
    """N setpoints. corrected (N, n) [m, rad], nan where refused; refused (N,); `reason(k)` says why."""

    corrected: Array
    refused: NDArray[np.bool_]
    _wanted: Array
    _payload: Array
    _solved: Array
    _left: Array
    _compensator: Compensator

    def reason(self, k: int) -> str | None:
        """Why row k was refused, in Compensator's words; None where it was not."""
        if not self.refused[k]:
            return None
        refusal = _refusal(self._compensator, self._wanted[k], self._payload[k], self._solved[k], self._left[k])
        return str(refusal)


class FastCompensator:
    """Corrects setpoints of one calibrated machine as Compensator does, some thousand times faster.

    For whole poses, so that it takes six joints: fewer raise CalibrationError.

    Not for two threads at once: it keeps its working memory. Effects that a diagnosis found are not in it, as they look
    back or ask for temperatures, and beside them the base model was fitted with the less: alone it is worse than one
    that was identified without them (1.37 mm beside 0.58, zeros that had jumped). So a calibration with effects is
    refused (CalibrationError), unless `leave_out` asks for its base model; `left_out` says which effects those are.
    """

    def __init__(self, calibration: Calibration, bounds: Bounds | None = None, leave_out: bool = False) -> None:
        try:
            from ppshw.compensation import fast_kernel
        except ImportError as exc:
            how = "pip install '.[fast]' in the project's folder"
            raise PpshwError(f"fast setpoints need numba ({exc}): {how}") from None
        self.calibration = calibration
        self.machine = calibration.machine
        if (ways := freedoms(self.machine)) < 6:
            moved = f"the joints of '{self.machine.name}' move its end effector in {ways} ways"
            raise CalibrationError(f"{moved}, compiled setpoints need all six: use Compensator")
        self.left_out = tuple(effect.sentence for effect in calibration.effects)
        if self.left_out and not leave_out:
            which = ", ".join(dict.fromkeys(effect.name for effect in calibration.effects))
            raise CalibrationError(
                f"compiled setpoints leave out what a diagnosis found ({which}), without which this base model is "
                "worse than one identified alone: expected a calibration of `ppshw identify`, or leave_out=True"
            )
        self._slow = Compensator(replace(calibration, effects=()), bounds)
        self._kernel = fast_kernel
        self._chain = _chain(self.machine)
        self._functions = _functions(calibration)
        self._allowed = _allowed(self._slow)
        self._work = fast_kernel.workspace(self.machine.n)
        self._prove()

    def setpoint(self, wanted: Array, payload: Array) -> Array:
        """wanted (n,) [m, rad] and payload (6,) on the sensor [N, N·m] → corrected (n,). Raises CompensationRefused."""
        wanted, payload = np.array(wanted, dtype=float)[None], np.array(payload, dtype=float)[None]
        solved, left, code = self._run(wanted, payload)
        if code[0] != self._kernel.OK:
            raise _refusal(self._slow, wanted[0], payload[0], solved[0], left[0])
        return np.asarray(solved[0])

    def setpoints(self, wanted: Array, payload: Array) -> FastSetpoints:
        """wanted (N, n) and payload (N, 6), or (6,) for all. Refuses single rows; the whole where shapes are others."""
        wanted, payload = np.ascontiguousarray(wanted, dtype=float), np.asarray(payload, dtype=float)
        if wanted.ndim != 2 or payload.shape not in ((6,), (len(wanted), 6)):
            raise CompensationRefused(
                f"joint values {wanted.shape} and payloads {payload.shape} given, expected (N, {self.machine.n}), and "
                "(N, 6) or (6,)"
            )
        payload = np.ascontiguousarray(np.broadcast_to(payload, (len(wanted), 6)))
        solved, left, code = self._run(wanted, payload)
        refused = code != self._kernel.OK
        corrected = np.where(refused[:, None], np.nan, solved)
        return FastSetpoints(corrected, refused, wanted, payload, solved, left, self._slow)

    def _run(self, wanted: Array, payload: Array) -> tuple[Array, Array, NDArray[np.int64]]:
        if wanted.shape[1] != self.machine.n or payload.shape[1] != 6:
            raise CompensationRefused(
                f"{wanted.shape[1]} joint values and {payload.shape[1]} load components given, "
                f"expected {self.machine.n} and 6"
            )
        solved, left = np.empty_like(wanted), np.zeros((len(wanted), 6))
        code = np.empty(len(wanted), dtype=np.int64)
        self._kernel.correct_all(
            self._chain, self._functions, self._allowed, self._work, wanted, payload, solved, left, code
        )
        return solved, left, code

    def _prove(self) -> None:
        """The tables stand for terms that depend on their own joint and linearly on the wrench. Ask the model itself,
        so that a term of another kind cannot be miscounted in silence."""
        c = self.calibration
        q, payload = _all_over(c, 32)
        expected, _ = c.model.errors(Situation(q, payload), c.theta)
        for k in range(len(q)):
            self._kernel.errors_at(self._chain, self._functions, q[k], payload[k], self._work)
            off = np.abs(self._work.errors - expected[k]).max(axis=1)
            if not off.max() < 10 * TABLE_TOLERANCE:
                frame = self.machine.frame_names[int(off.argmax())]
                raise CalibrationError(
                    f"errors behind '{frame}' do not depend on the joint's position and the wrench alone (off by "
                    f"{off.max():.3g} m or rad): use Compensator"
                )


def _refusal(slow: Compensator, wanted: Array, payload: Array, solved: Array, left: Array) -> CompensationRefused:
    """The compiled code only says that it refused; Compensator's own checks say why."""
    try:
        slow.refuse_outside(wanted, payload)
        if not np.abs(left).max() > 1e-5:
            slow.refuse_correction(solved, wanted)
    except CompensationRefused as refusal:
        return refusal
    return CompensationRefused(f"the corrected pose cannot be reached: {amount(left)} are left")


def _chain(machine: Machine) -> Chain:
    from ppshw.compensation.fast_kernel import Chain

    def place(pose: Array) -> Array:
        return np.concatenate([pose[:3, :3].ravel(), pose[:3, 3]])

    return Chain(
        np.array([j.prismatic for j in machine.joints]),
        np.array([j.axis for j in machine.joints]),
        np.array([place(j.origin) for j in machine.joints]),
        np.array([[j.mass if machine.bent_by != "payload" else 0.0, *j.com] for j in machine.joints]),
        np.array(machine.gravity, dtype=float),
        place(machine.tip_in_link),
        place(machine.sensor_in_link),
        machine.bent_by == "own",
    )


def _allowed(slow: Compensator) -> Allowed:
    """The ends that Compensator's checks compute, to the last bit."""
    from ppshw.compensation.fast_kernel import Allowed

    c, bounds, machine = slow.calibration, slow.bounds, slow.machine
    identified = (c.identified_joints(bounds.joints), c.identified_loads(bounds.loads))
    ends = [np.array([[each.low - each.slack, each.high + each.slack] for each in some]) for some in identified]
    correction = np.array([bounds.travel if j.prismatic else bounds.angle for j in machine.joints])
    return Allowed(ends[0], ends[1], correction, np.stack(machine.limits(), axis=1))


def _functions(calibration: Calibration) -> Functions:
    """Tabulate every frame's 7 × 6 matrix: errors without load, and per wrench component."""
    from ppshw.compensation.fast_kernel import Functions

    n = calibration.machine.n
    constant = np.zeros((n + 1, 7, 6))
    constant[0] = _matrices(calibration, 0, np.zeros(1))[0]
    scale = np.concatenate([[1.0], _largest_load(calibration)])[:, None]
    columns, breaks, cubics, sizes = [], [], [], [(0, 0, 0)]
    for frame in range(1, n + 1):
        edges, coefficients = _piecewise_cubic(calibration, frame, scale)
        varies = np.flatnonzero((coefficients[:, 1:] != 0.0).any(axis=(0, 1, 3)))
        constant[frame] = coefficients[0, 0]
        constant[frame, varies] = 0.0
        columns.append(varies)
        breaks.append(edges)
        cubics.append(np.swapaxes(coefficients[:, :, varies], 1, 2).ravel())
        sizes.append((len(varies), len(edges), cubics[-1].size))
    first, break_first, cubic_first = np.ascontiguousarray(np.cumsum(sizes, axis=0).T)
    return Functions(
        constant, np.concatenate(columns), first,
        np.concatenate(breaks), break_first, np.concatenate(cubics), cubic_first,
    )  # fmt: skip


def _piecewise_cubic(calibration: Calibration, frame: int, scale: Array) -> tuple[Array, Array]:
    """Edges (M+1,) and coefficients (M, 4, 7, 6) by rising power, in the fewest cells that meet TABLE_TOLERANCE.

    Each cubic meets the function at four points of its cell, both ends included, so that neighbours meet as well.
    """
    knots = _knots(calibration.model, frame, calibration.joint_range[frame - 1])
    at, between = np.array([0.0, 1.0, 2.0, 3.0]) / 3.0, np.array([0.5, 1.5, 2.5]) / 3.0
    solve, powers = np.linalg.inv(np.vander(at, increasing=True)), np.vander(between, 4, increasing=True)
    cells = 16
    while cells <= MOST_CELLS:
        edges = np.unique(np.concatenate([knots, np.linspace(knots[0], knots[-1], cells + 1)]))

        def sampled(u: Array, edges: Array = edges) -> Array:
            x = edges[:-1, None] + np.diff(edges)[:, None] * u
            return _matrices(calibration, frame, x.ravel()).reshape(*x.shape, 7, 6)

        values = sampled(at)
        coefficients = np.einsum("ps,csij->cpij", solve, values)
        coefficients[:, 1:, np.ptp(values, axis=(0, 1)) == 0.0] = 0.0
        off = np.einsum("sp,cpij->csij", powers, coefficients) - sampled(between)
        if np.abs(off * scale).max() < TABLE_TOLERANCE:
            return edges, coefficients
        cells *= 2
    name = calibration.machine.frame_names[frame]
    raise CalibrationError(f"errors behind '{name}' are too rough to tabulate in {MOST_CELLS} cells: use Compensator")


def _knots(model: Model, frame: int, sampled: Array) -> Array:
    """Where a function of this joint may have a kink, and the ends beyond which it is held."""
    knots: list[float] = []
    for term in model.terms:
        if term.frame != frame:
            continue
        function = getattr(term, "basis", term)
        if isinstance(function, Interpolated):
            knots += function.knots
        elif isinstance(function, Smooth | Polynomial | OwnMotion):
            knots += [function.centre - function.half, function.centre + function.half]
    if not knots or max(knots) == min(knots):
        knots += [float(sampled[0]) - 1e-3, float(sampled[1]) + 1e-3]
    return np.unique(knots)


def _matrices(calibration: Calibration, frame: int, x: Array) -> Array:
    """(N,) positions of one joint → (N, 7, 6): the frame's errors without load and per unit of wrench."""
    model, n = calibration.model, calibration.machine.n
    q = np.zeros((len(x), n))
    if frame > 0:
        q[:, frame - 1] = x
    situation = Situation(q, np.zeros((len(x), 6)))
    out = np.zeros((len(x), 7, 6))
    at = 0
    for term in model.terms:
        size = len(term.parameters(model.machine.frame_names))
        own = calibration.theta[at : at + size]
        at += size
        if term.frame != frame:
            continue
        wrenches = np.zeros((len(x), n + 1, 6))
        unloaded = term.regressors(situation, wrenches)
        out[:, 0] += unloaded @ own
        for k in range(6):
            wrenches[:, frame] = np.eye(6)[k]
            out[:, 1 + k] += (term.regressors(situation, wrenches) - unloaded) @ own
    return out


def _largest_load(calibration: Calibration) -> Array:
    """(6,) the most that a link carries within the identified range   [N, N·m]."""
    _, wrenches = calibration.model.errors(Situation(*_all_over(calibration, 64)), calibration.theta)
    return np.asarray(np.abs(wrenches).max(axis=(0, 1)))


def _all_over(calibration: Calibration, count: int) -> tuple[Array, Array]:
    """Joint values (count, n) and payloads (count, 6) from all over the identified range, the same ones every time."""
    rng = np.random.default_rng(0)
    joints, loads = calibration.joint_range, calibration.payload_range
    q = rng.uniform(joints[:, 0], joints[:, 1], (count, len(joints)))
    return q, rng.uniform(loads[:, 0], loads[:, 1], (count, 6))
