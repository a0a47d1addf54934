"""The steps of the paper's identification as matrices   (eqs 18–24; docs/derivations.md §4).

    θ = A y + T x₀

y are the measured pose errors ΔX, x₀ = (ε_g(0), c(0)) what is chosen at home, θ the values at the sampled positions.
Rows of y are scaled to about equal standard deviation: rotations are multiplied by a length.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ppshw.identification.redundancy import independent_columns, solver
from ppshw.identification.sweeps import Sweeps
from ppshw.kinematics import error_jacobian, frames
from ppshw.machine import Machine
from ppshw.recording import Recording
from ppshw.statics import link_wrenches
from ppshw.terms import Situation
from ppshw.terms.basis import Basis, Constant, Interpolated
from ppshw.terms.elastic import Compliance, pattern
from ppshw.terms.geometric import Geometric

Array = NDArray[np.float64]
PaperTerm = Geometric | Compliance
# A parameter is redundant when the kept ones explain all but this share of what it does.
REDUNDANT = 1e-3


def paper_terms(machine: Machine, sweeps: Sweeps) -> tuple[PaperTerm, ...]:
    """Interpolated geometric errors per joint; compliances interpolated where they vary, else constant.

    F_0 gets none: what an error of the base does, ε_1(q_1) can do as well ("F_1 and F_0 are coincident", section 4.1).
    """
    terms: list[PaperTerm] = [Geometric(k + 1, _interpolated(sweeps.knots(k))) for k in range(machine.n)]
    for k, joint in enumerate(machine.joints):
        if joint.elastic is not None:
            basis = _interpolated(sweeps.knots(k, paired=True)) if joint.elastic.varies else Constant()
            terms.append(Compliance(k + 1, pattern(joint.elastic), tuple(joint.elastic.load_indices), basis))
    return tuple(terms)


def _interpolated(knots: tuple[float, ...]) -> Basis:
    return Interpolated(knots) if len(knots) > 1 else Constant()


def choice_names(machine: Machine, terms: tuple[PaperTerm, ...]) -> list[str]:
    """Of x₀, e.g. "vertical.ty(0)" or "longitudinal.C[ty,Fy](0)"."""
    fixed = [replace(term, basis=Constant()) for term in terms]
    return [p.name.removesuffix("[0]") + "(0)" for term in fixed for p in term.parameters(machine.frame_names)]


@dataclass(frozen=True)
class Steps:
    """The process for V visits, P parameters and p₀ choices.

    design   (6V, P)    ΔX = D θ, eq. (17)
    at_home  (6V, p₀)   the same for x₀ if nothing varied: J and M_e
    elastic  (p₀,)      which choices are c(0)
    data     (P, 6V)    A
    start    (P, p₀)    T
    """

    design: sparse.csr_array
    at_home: Array
    elastic: NDArray[np.bool_]
    data: sparse.csr_array
    start: Array


def linear_steps(
    machine: Machine, terms: tuple[PaperTerm, ...], recording: Recording, sweeps: Sweeps, row_scale: Array
) -> Steps:
    """Eqs (20) and (23) at every sampled position, for unit vectors of y and of x₀.

    row_scale  (6,) factors on the components of ΔX
    """
    count, situation = len(recording), Situation.of(recording)
    jacobian = error_jacobian(machine, recording.q).reshape(count, 6, machine.n + 1, 6) * row_scale[:, None, None]
    wrenches = link_wrenches(machine, frames(machine, recording.q), recording.wrench)

    def columns(term: PaperTerm) -> Array:
        return np.asarray(jacobian[:, :, term.frame] @ term.regressors(situation, wrenches))

    blocks = [columns(term) for term in terms]
    fixed = [columns(replace(term, basis=Constant())) for term in terms]
    design = sparse.csr_array(sparse.hstack([sparse.csr_array(b.reshape(6 * count, -1)) for b in blocks]))
    held = sparse.block_diag([np.kron(np.eye(f.shape[2]), np.ones((t.basis.size, 1))) for t, f in zip(terms, fixed, strict=True)])
    held = held.toarray()  # x₀ at every position
    at_home = np.concatenate(fixed, axis=2)
    elastic = np.repeat([isinstance(t, Compliance) for t in terms], [f.shape[2] for f in fixed])
    elastic_row = np.repeat([isinstance(t, Compliance) for t in terms], [b.shape[2] for b in blocks])
    first = np.concatenate([[0], np.cumsum([b.shape[2] for b in blocks])])

    stiff = _Operator(design.shape[1], count)
    bowed = _Operator(design.shape[1], count)
    for k, term in enumerate(terms):
        if isinstance(term, Compliance):
            _compliance_steps(stiff, int(first[k]), term, fixed[k], sweeps)
        else:
            _geometric_steps(bowed, int(first[k]), term, jacobian[:, :, term.frame], sweeps)
    flat_home = at_home.reshape(6 * count, -1)
    pull, push = stiff.matrix(), bowed.matrix()
    start = held * elastic_row[:, None] - pull @ (flat_home * elastic)  # (20)
    bending = design @ sparse.diags_array(elastic_row.astype(float))
    data = pull + push - push @ (bending @ pull)  # (23)
    start += held * ~elastic_row[:, None] - push @ (bending @ start + flat_home * ~elastic)
    return Steps(design, at_home, elastic, sparse.csr_array(data), start)


class _Operator:
    """A sparse (P, 6V) matrix, block by block."""

    def __init__(self, size: int, visits: int) -> None:
        self._shape = (size, 6 * visits)
        self._rows: list[Array] = []
        self._columns: list[Array] = []
        self._values: list[Array] = []

    def add(self, rows: Array, visits: Array, block: Array) -> None:
        """block (len(rows), 6 len(visits))"""
        columns = (6 * visits[:, None] + np.arange(6)).ravel()
        r, c = np.meshgrid(rows, columns, indexing="ij")
        self._rows.append(r.ravel())
        self._columns.append(c.ravel())
        self._values.append(block.ravel())

    def matrix(self) -> sparse.csr_array:
        if not self._rows:
            return sparse.csr_array(self._shape)
        where = np.concatenate(self._rows), np.concatenate(self._columns)
        return sparse.csr_array(sparse.coo_array((np.concatenate(self._values), where), shape=self._shape))


def _compliance_steps(operator: _Operator, first: int, term: Compliance, m_e: Array, sweeps: Sweeps) -> None:
    """DΔX = DM_ei Δc_i at every position of a joint whose compliance varies   (eq. 20).

    m_e  (V, 6, e) ∂ΔX/∂c_i
    """
    if not isinstance(term.basis, Interpolated):
        return
    places = [c for c in sweeps.of_joint(term.frame - 1) if c.paired]
    pairs = [differences(m_e[c.visits]) for c in places]
    common = independent_columns(np.concatenate(pairs), REDUNDANT)
    positions = term.basis.size
    for place, d in zip(places, pairs, strict=True):
        kept = [common[k] for k in independent_columns(d[:, common], REDUNDANT)]
        at = term.basis.knots.index(float(place.q[term.frame - 1]))
        rows = first + np.arange(len(term.elements)) * positions + at
        operator.add(rows, place.visits, solver(d, kept))


def _geometric_steps(operator: _Operator, first: int, term: Geometric, j_i: Array, sweeps: Sweeps) -> None:
    """Δε_gi = J_i⁻¹ (ΔX − M_e c − J ε_g(0)), mean over the visits at each position   (eq. 23).

    j_i  (V, 6, 6)
    """
    if not isinstance(term.basis, Interpolated):
        return
    for place in sweeps.of_joint(term.frame - 1):
        at = term.basis.knots.index(float(place.q[term.frame - 1]))
        rows = first + np.arange(6) * term.basis.size + at
        inverse = np.linalg.inv(j_i[place.visits]) / len(place.visits)
        operator.add(rows, place.visits, np.moveaxis(inverse, 0, 1).reshape(6, -1))


def differences(values: Array) -> Array:
    """Values at one configuration (L, 6, k) less their mean, as (6L, k).

    Least squares over these equals least squares over all pairs W, W₀ of eq. (18), each pair counting the same, and
    takes care that pairs share visits.
    """
    return np.asarray((values - values.mean(axis=0)).reshape(-1, values.shape[-1]))


def from_weight_pairs(steps: Steps, y: Array, terms: tuple[PaperTerm, ...], sweeps: Sweeps) -> tuple[Array, list[int], int]:
    """c^c(0) of eq. (24), redundant parameters zero, and ε_g(0) = 0.

    Every configuration counts where all joints whose compliance varies are at home; the others may be anywhere, since
    their compliance is the same there (section 4.1, "configurations with q_4 different from zero can be used").

    returns  x₀ (p₀,), the columns kept, the number of independent differences
    """
    varying = {t.frame - 1 for t in terms if isinstance(t, Compliance) and isinstance(t.basis, Interpolated)}
    places = [c for c in sweeps.configurations if c.paired and not varying & set(c.away)]
    x0 = np.zeros(len(steps.elastic))
    if not places:
        return x0, [], 0
    c0 = np.flatnonzero(steps.elastic)
    system = np.concatenate([differences(steps.at_home[c.visits][:, :, c0]) for c in places])
    given = np.concatenate([differences(y.reshape(-1, 6, 1)[c.visits]) for c in places])[:, 0]
    kept = independent_columns(system, REDUNDANT)
    x0[c0] = solver(system, kept) @ given
    return x0, [int(c0[k]) for k in kept], sum(len(c.visits) - 1 for c in places)
