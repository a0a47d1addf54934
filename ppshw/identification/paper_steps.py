"""The steps of the paper's identification as matrices   (eqs 18–24; docs/derivations.md §4).

    θ = A y + T x₀

y are the measured pose errors ΔX, x₀ = (ε_g(0), c(0)) what is chosen at home, θ the values at the sampled positions.
Rows of y are whitened visit by visit, so that they have unit variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ppshw.identification.redundancy import PLAUSIBLE, Evidence, independent_columns, solver
from ppshw.identification.sweeps import Configuration, Sweeps
from ppshw.kinematics import frames, tip_jacobian
from ppshw.machine import Machine
from ppshw.recording import Recording
from ppshw.statics import link_wrenches
from ppshw.terms import Situation
from ppshw.terms.basis import Basis, Constant, Interpolated
from ppshw.terms.elastic import Compliance, pattern
from ppshw.terms.geometric import Geometric

Array = NDArray[np.float64]
PaperTerm = Geometric | Compliance


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


def choice_names(machine: Machine, terms: Sequence[PaperTerm]) -> list[str]:
    """Of x₀, e.g. "vertical.ty(0)" or "longitudinal.C[ty,Fy](0)"."""
    return [p.name.removesuffix("[0]") + "(0)" for t in terms for p in _fixed(t).parameters(machine.frame_names)]


def _fixed(term: PaperTerm) -> PaperTerm:
    """The same term as if nothing varied."""
    return replace(term, basis=Constant())


@dataclass(frozen=True)
class Regression:
    """Model (17) to first order for V visits, P parameters and p₀ choices at home, rows whitened.

    jacobian          (V, 6, n+1, 6)  J
    design            (6V, P)         ΔX = design · θ
    at_home           (V, 6, p₀)      the same for x₀, if nothing varied: J and M_e
    elastic           (p₀,)           which choices are c(0)
    held              (P, p₀)         x₀ at every sampled position
    plausible         (p₀,)           how large a choice may well be
    theta_at, x0_at   where each term starts
    """

    terms: tuple[PaperTerm, ...]
    jacobian: Array
    design: sparse.csr_array
    at_home: Array
    elastic: NDArray[np.bool_]
    held: Array
    plausible: Array
    theta_at: tuple[int, ...]
    x0_at: tuple[int, ...]

    @classmethod
    def of(cls, machine: Machine, terms: tuple[PaperTerm, ...], recording: Recording, whiten: Array) -> Regression:
        """whiten  (6, 6) on every visit's ΔX"""
        count, situation, chain = len(recording), Situation.of(recording), frames(machine, recording.q)
        jacobian = np.einsum("ij,vjfk->vifk", whiten, tip_jacobian(chain, chain[:, -1] @ machine.tip_in_link))
        wrenches = link_wrenches(machine, chain, recording.wrench)

        def columns(term: PaperTerm) -> Array:
            return np.asarray(jacobian[:, :, term.frame] @ term.regressors(situation, wrenches))

        blocks = [columns(term) for term in terms]
        fixed = [columns(_fixed(term)) for term in terms]
        widths, choices = [b.shape[2] for b in blocks], [f.shape[2] for f in fixed]
        held = np.zeros((sum(widths), sum(choices)))
        theta_at, x0_at = np.cumsum([0, *widths[:-1]]), np.cumsum([0, *choices[:-1]])
        for row, column, width, choice in zip(theta_at, x0_at, widths, choices, strict=True):
            held[row : row + width, column : column + choice] = np.kron(np.eye(choice), np.ones((width // choice, 1)))
        return cls(
            terms,
            jacobian,
            sparse.csr_array(sparse.hstack([sparse.csr_array(b.reshape(6 * count, -1)) for b in blocks])),
            np.concatenate(fixed, axis=2),
            np.repeat([isinstance(t, Compliance) for t in terms], choices),
            held,
            PLAUSIBLE * np.array([p.start for t in terms for p in _fixed(t).parameters(machine.frame_names)]),
            tuple(theta_at.tolist()),
            tuple(x0_at.tolist()),
        )

    def rows_at(self, k: int, position: float) -> NDArray[np.int64]:
        """Where the parameters of term k at a sampled position stand in θ."""
        term = self.terms[k]
        assert isinstance(term.basis, Interpolated)
        elements = len(term.elements) if isinstance(term, Compliance) else 6
        return self.theta_at[k] + np.arange(elements) * term.basis.size + term.basis.knots.index(position)


def differences(values: Array) -> Array:
    """Values at one configuration (L, 6, k) less their mean, as (6L, k).

    Least squares over these equals least squares over all pairs W, W₀ of eq. (18) at this configuration.
    """
    return np.asarray((values - values.mean(axis=0)).reshape(values.shape[0] * values.shape[1], values.shape[-1]))


def pair_places(terms: Sequence[PaperTerm], sweeps: Sweeps) -> list[Configuration]:
    """The configurations of eq. (24): all joints whose compliance varies are at home.

    The others may be anywhere, their compliance is the same there ("configurations with q_4 different from zero can be
    used", section 4.1).
    """
    varying = {t.frame - 1 for t in terms if isinstance(t, Compliance) and isinstance(t.basis, Interpolated)}
    return [c for c in sweeps.configurations if c.paired and not varying & set(c.away)]


def from_weight_pairs(
    regression: Regression, y: Array, places: Sequence[Configuration], by_noise: bool
) -> tuple[Array, list[int]]:
    """c^c(0) of eq. (24), redundant parameters zero, and ε_g(0) = 0.

    y        (V, 6)
    returns  x₀ (p₀,) and the choices that were kept
    """
    x0 = np.zeros(len(regression.elastic))
    elastic = np.flatnonzero(regression.elastic)
    if not places:
        return x0, []
    system = np.concatenate([differences(regression.at_home[c.visits][:, :, elastic]) for c in places])
    given = np.concatenate([differences(y[c.visits, :, None])[:, 0] for c in places])
    kept = independent_columns([system], Evidence([given], regression.plausible[elastic]) if by_noise else None)
    x0[elastic] = solver(system, kept) @ given
    return x0, [int(elastic[k]) for k in kept]


def linear_process(
    regression: Regression, y: Array, x0: Array, sweeps: Sweeps, by_noise: bool
) -> tuple[sparse.csr_array, Array]:
    """A (P, 6V) and T (P, p₀): eqs (20) and (23) at every sampled position.

    Which elements of Δc_i are above noise is decided with the first choice x₀ (p₀,); all else is independent of data.
    """
    varied, moved = _Operator(regression.design.shape), _Operator(regression.design.shape)
    elastic = y - regression.at_home @ (x0 * regression.elastic)
    for k, term in enumerate(regression.terms):
        if not isinstance(term.basis, Interpolated):
            continue
        if isinstance(term, Compliance):
            own = slice(regression.x0_at[k], regression.x0_at[k] + len(term.elements))
            places = [c for c in sweeps.of_joint(term.frame - 1) if c.paired]
            designs = [differences(regression.at_home[c.visits, :, own]) for c in places]
            given = [differences(elastic[c.visits, :, None])[:, 0] for c in places]
            kept = independent_columns(designs, Evidence(given, regression.plausible[own]) if by_noise else None)
            for place, d in zip(places, designs, strict=True):  # (20): DΔX − DM_e c(0) = DM_ei Δc_i
                rows = regression.rows_at(k, float(place.q[term.frame - 1]))
                varied.add(rows, place.visits, solver(d, kept))
        else:
            for place in sweeps.of_joint(term.frame - 1):  # (23), mean over the visits
                inverse = np.linalg.inv(regression.jacobian[place.visits, :, term.frame]) / len(place.visits)
                rows = regression.rows_at(k, float(place.q[term.frame - 1]))
                moved.add(rows, place.visits, np.moveaxis(inverse, 0, 1).reshape(6, -1))
    pull, push = varied.matrix(), moved.matrix()
    at_home = regression.at_home.reshape(-1, len(x0))
    held_c, held_g = regression.held * regression.elastic, regression.held * ~regression.elastic
    of_compliances = (regression.held @ regression.elastic > 0).astype(float)
    bending = regression.design @ sparse.diags_array(of_compliances)  # M_e(q, W) with interpolated c
    # (20): Δc = pull (y − M_e c(0)), then (23): Δε_g = push (y − M_e c − J ε_g(0))
    start_c = held_c - pull @ (at_home * regression.elastic)
    start_g = held_g - push @ (bending @ start_c + at_home * ~regression.elastic)
    return sparse.csr_array(pull + push - push @ (bending @ pull)), start_c + start_g


class _Operator:
    """A sparse (P, 6V) matrix, filled block by block."""

    def __init__(self, design_shape: tuple[int, ...]) -> None:
        self._shape = design_shape[::-1]
        self._blocks: list[tuple[NDArray[np.int64], NDArray[np.int64], Array]] = []

    def add(self, rows: NDArray[np.int64], visits: NDArray[np.int64], block: Array) -> None:
        """block (len(rows), 6 len(visits))"""
        columns = (6 * visits[:, None] + np.arange(6)).ravel()
        r, c = np.meshgrid(rows, columns, indexing="ij")
        self._blocks.append((r.ravel(), c.ravel(), block.ravel()))

    def matrix(self) -> sparse.csr_array:
        if not self._blocks:
            return sparse.csr_array(np.zeros(self._shape))
        rows, columns, values = (np.concatenate(part) for part in zip(*self._blocks, strict=True))
        return sparse.csr_array(sparse.coo_array((values, (rows, columns)), shape=self._shape))
