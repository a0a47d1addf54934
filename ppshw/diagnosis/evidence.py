"""How much a recording speaks for every candidate, and what noise alone would have made it say.

A candidate's coefficients get a zero-mean normal prior of three amplitudes (a third, one and three times the
repeatability at the reflectors); the log evidence against nothing is

    ½ Sᵀ (I + Λ⁻¹)⁻¹ S − ½ ln det(1 + Λ I)                       per amplitude, averaged

(MacKay 1992). What counts as significant is decided by the greatest evidence anything tried reaches when the visits'
residuals change sign at random, whole visits at a time and corrected for leverage (wild bootstrap; Davidson &
Flachaire 2008), so that pose-dependent noise and the number of things tried are both in the null.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, ndtr

from ppshw.diagnosis.laid import Laid, side_by_side
from ppshw.diagnosis.library.candidate import Candidate, all_kept
from ppshw.diagnosis.workspace import Workspace
from ppshw.terms.shapes import Column, Key

Array = NDArray[np.float64]
# What counts as significant, family-wise: the first finding, another beside it, and more of one that is there. What a
# finding's form leaves is often as loud as p = 0.02, which was asked of others at first, or 1e-3: of nine with a p
# above 1e-4 none was right, of four between that and 1e-5 all (seeds 42 and 57 to 60, the nineteenth and the fortieth
# to forty-fourth author).
FIRST, FURTHER, MORE = 0.05, 1e-4, 1e-3
# No finding without real odds, however quiet the null: e² = 7 to 1 against nothing (of 40 clean recordings three
# reached e, none of them e²; seeds 60500 to 60539), e³ = 20 to 1 beside another finding.
LEAST_FIRST, LEAST_FURTHER = 2.0, 3.0
AMPLITUDES = (1 / 3, 1.0, 3.0)
DRAWS, FEW = 199, 39
LEAST_P = 1e-300  # that is said: its logarithm is a number
PLAIN = 1e-5  # a p that needs no more than a few draws
TOP = 3  # of these, by which their tail is laid
LEAST_SHARE = 3e-4
# Nameless rivals bend as they need; a name has the bare form of the library. One that explains nearly as much is the
# better explanation: real forms differ from the library's by this share of the evidence or so (a guess, seen to be
# needed in sealed cases: logarithmic creep against any function of time).
HANDICAP = 0.7
NEARLY_A_TIE = 0.5  # of log evidence
MOST_OF_NOISE = 15.0  # times its mean square: farther off a visit is simply wrong, however heavy the tails are
TURNED = 0.02  # share of coefficients whose sign is the other than physics says
ROUNDING = 1e-9  # of a Cholesky factor's diagonal
LED = 3.0  # by so much a first column must say more with the others than they do without: else they are no part of it
CHUNK = 512  # candidates at a time
Name = tuple[str, str | None]
Single = NDArray[np.float32]
State = frozenset[tuple[Key, float]]  # what is taken up, with its prior standard deviations


@dataclass
class Batch:
    """Candidates with the same number of columns k: which (C,), columns (C, k)."""

    which: NDArray[np.int64]
    columns: NDArray[np.int64]


class Tried:
    """All candidates over one workspace: their columns laid out, of unit size, and what is left of them beside the base
    model.

    scale, seen  (K,)  of every column: rms at the reflectors per unit [m]; ZᵀV⁻¹Z
    unit         what sizes are measured in, rms at the reflectors [m]: `Workspace.unit`
    without      effects that were left out of the candidates
    ruled_out    candidates that the force sensor's readings leave no room for: not tried
    """

    @all_kept()
    def __init__(
        self, space: Workspace, candidates: Sequence[Candidate], unit: float,
        without: frozenset[str] = frozenset(), ruled_out: Sequence[Candidate] = (),
    ) -> None:  # fmt: skip
        self.without = without
        self.ruled_out = tuple(ruled_out)
        self.candidates = list(candidates)
        self.unit = unit
        self.space = space
        unique: dict[Key, int] = {}
        columns: list[Column] = []
        index = []
        for candidate in candidates:
            found = []
            for column in candidate.columns:
                at = unique.setdefault(column.key, len(columns))
                if at == len(columns):
                    columns.append(column)
                found.append(at)
            index.append(found)
        self.index = [np.array(i) for i in index]
        of_size: dict[int, list[int]] = {}
        for c, columns_of in enumerate(index):
            of_size.setdefault(len(columns_of), []).append(c)
        self._batches = [Batch(np.array(of), np.array([index[c] for c in of])) for _, of in sorted(of_size.items())]
        self._way = np.array([k.way for k in candidates], dtype=float)
        self._led = np.array([k.led for k in candidates], dtype=bool)
        self.log_share = np.log([max(k.share, 1e-300) for k in candidates])
        self.names: list[Name] = list(dict.fromkeys((k.effect, k.joint) for k in candidates))
        position = {n: j for j, n in enumerate(self.names)}
        self.name_of = np.array([position[k.effect, k.joint] for k in candidates])
        self._sorted = np.argsort(self.name_of, kind="stable")
        self._starts = np.searchsorted(self.name_of[self._sorted], np.arange(len(self.names)))
        effects = {effect: e for e, effect in enumerate(dict.fromkeys(effect for effect, _ in self.names))}
        self._effect_of = np.array([effects[effect] for effect, _ in self.names])
        self._nameless = np.array([effect == "nameless" for effect, _ in self.names])
        self._said: dict[State | None, tuple[Array, Array]] = {}
        self._crossed: dict[Key, Single] = {}
        self._values: dict[Key, tuple[Array, Array, Array]] = {}
        self.laid = Laid(space, columns)
        self.scale = self.laid.scale
        self.seen = self.laid.seen()
        # what the base model takes whole leaves nothing but the stiffness of its prior, which is no evidence
        visible = self.seen > LEAST_SHARE * np.maximum(self.laid.plain, 1e-30)
        for batch in self._batches:
            self.log_share[batch.which[~visible[batch.columns].any(axis=1)]] = -np.inf
        self._info0 = [
            self.laid.information(batch.columns) if batch.columns.shape[1] > 1 else self.seen[batch.columns][:, :, None]
            for batch in self._batches
        ]
        self._plain_scores = self.laid.scores()
        self.update()

    def update(self, taken: Sequence[Key] = ()) -> None:
        """Account for what the workspace has taken up now.

        taken  the columns' keys, where a search comes back to them: what is known of a column, and what was said beside
               all of them, is not worked out again
        """
        space = self.space
        self._middle, self._absorbed = space.middle, space.absorbed
        unknown = len(space.middle) > 0 and not taken
        self._state = None if unknown else frozenset(zip(taken, space.taken_prior.tolist(), strict=True))
        self._taken = tuple(taken)
        self._beside: list[Array] | None = None
        self._crossing: Single | None = None

    @property
    def _cross(self) -> Single:
        """(f, K) what those that are taken up have to do with the columns; worked out when it is asked for."""
        if self._crossing is None:
            if self._taken:
                self._crossing = self._crossed_with(self._taken)
            else:
                self._crossing = self.laid.product(self._absorbed).T
        return self._crossing

    def _crossed_with(self, taken: Sequence[Key]) -> Single:
        new = [k for k, key in enumerate(taken) if key not in self._crossed]
        for k, product in zip(new, self.laid.product(self._absorbed[:, new]).T, strict=True):
            self._crossed[taken[k]] = product
        return np.stack([self._crossed[key] for key in taken])

    @property
    def _info(self) -> list[Array]:
        """ZᵀV⁻¹Z of every candidate beside what is taken up, batch by batch; worked out when it is asked for."""
        if self._beside is None:
            self._beside = self._informed() if len(self._middle) else self._info0
        return self._beside

    def _informed(self) -> list[Array]:
        units = np.sqrt(np.diag(self._middle))  # kilograms stand beside radians
        lengths, turn = np.linalg.eigh(self._middle / units[:, None] / units)
        axes = units[:, None] * turn * np.sqrt(np.maximum(lengths, 0.0))
        along = self._cross.T @ axes.astype(np.float32)  # (K, f)
        squares = np.einsum("kf,kf->k", along, along, dtype=float)
        out = [np.empty_like(info) for info in self._info0]
        parts = [
            (k, slice(at, at + CHUNK))
            for k, batch in enumerate(self._batches) for at in range(0, len(batch.which), CHUNK)
        ]  # fmt: skip

        def of_part(j: int) -> None:
            k, part = parts[j]
            columns = self._batches[k].columns[part]
            if columns.shape[1] == 1:
                absorbed = squares[columns][:, :, None]
            else:
                w = along[columns]  # (C, k, f)
                absorbed = w @ np.swapaxes(w, 1, 2)
            np.subtract(self._info0[k][part], absorbed, out=out[k][part])

        side_by_side(of_part, range(len(parts)))
        return out

    def values(self, columns: Sequence[Column]) -> list[tuple[Array, Array, Array]]:
        """What columns do to the reflectors per unit, each worked out once and those that are new at one go: (N, 3T) in
        metres; whitened, and that less what the base model takes of it, (F·3T,) each."""
        if new := list({c.key: c for c in columns if c.key not in self._values}.values()):
            raw = [c.evaluate(self.space.context) for c in new]
            white = self.space.whiten(np.stack(raw, axis=2))
            rows = (np.ascontiguousarray(each.T) for each in (white, self.space.absorb(white)))
            self._values.update(zip((c.key for c in new), zip(raw, *rows, strict=True), strict=True))
        return [self._values[c.key] for c in columns]

    # --- evidence ------------------------------------------------------------------------------------------------
    def evidence(self, scores: Array | Single) -> Array:
        """Log evidence of every candidate for scores (D, K) of all columns: (D, C); −∞ of those that are not asked."""
        out = np.full((len(self.candidates), len(scores)), -np.inf)
        of_columns = np.ascontiguousarray(scores.T)
        parts = [
            (batch, info, slice(at, at + CHUNK))
            for batch, info in zip(self._batches, self._info, strict=True)
            for at in range(0, len(batch.which), CHUNK)
        ]

        def of_part(k: int) -> None:
            batch, info, part = parts[k]
            which, its_scores = batch.which[part], of_columns[batch.columns[part]].astype(float)
            out[which] = self._evidence(info[part], its_scores)
            if self._way[which].any():
                out[which] += _of_its_sign(self._way[which], info[part, 0, :1], its_scores[:, 0])
            if (led := self._led[which]).any():
                adds = out[which[led]] - self._evidence(info[part][led, 1:, 1:], its_scores[led, 1:])
                out[which[led]] = np.where(adds > LED, out[which[led]], adds)

        side_by_side(of_part, range(len(parts)))
        return out.T

    def evidence_alone(self, scores: Array | Single) -> Array:
        """(D, C) evidence given the base model alone, whatever was taken up since."""
        alone = copy.copy(self)
        alone._beside = self._info0
        return alone.evidence(scores)

    def evidence_of(self, name: Name, scores: Array) -> Array:
        """(D,) evidence of one name alone, given the base model alone, for scores (D, K) of all columns."""
        mine = self.name_of == self.names.index(name)
        return np.asarray(logsumexp(self._asking(mine).evidence(scores)[:, mine] + self.log_share[mine], axis=1))

    def evidence_of_names(self, scores: Array | Single) -> Array:
        """(D, names) evidence of every name, −∞ of those without one, given the base model alone, for scores (D, K)."""
        return self.by_name(self._asking(~self._nameless[self.name_of]).evidence(scores))

    def _asking(self, some: NDArray[np.bool_]) -> Tried:
        """The same, given the base model alone, with only some of the candidates (C,) asked."""
        alone = copy.copy(self)
        alone._batches, alone._beside = [], []
        for batch, info in self._among(some):
            alone._batches.append(batch)
            alone._beside.append(info)
        return alone

    def named(self) -> Iterator[tuple[Batch, Array]]:
        """The candidates that have a name, and the information of each, given the base model alone."""
        return self._among(~self._nameless[self.name_of])

    def _among(self, some: NDArray[np.bool_]) -> Iterator[tuple[Batch, Array]]:
        for batch, info in zip(self._batches, self._info0, strict=True):
            inside = some[batch.which]
            if inside.any():
                yield replace(batch, which=batch.which[inside], columns=batch.columns[inside]), info[inside]

    def _evidence(self, info: Array, scores: Array) -> Array:
        """(C, D) for information (C, k, k) and scores (C, k, D): along the axes of the information each amplitude is a
        sum of squares."""
        if info.shape[1] > 1 and scores.shape[2] == 1:
            each = self._of_one(info, scores[:, :, 0])[..., None]
        else:
            each = self._of_many(info, scores)
        most = each.max(axis=1)
        return np.asarray(most + np.log(np.exp(each - most[:, None]).mean(axis=1)))

    def _of_many(self, info: Array, scores: Array) -> Array:
        """(C, 3, D) of each amplitude."""
        k = info.shape[1]
        if k == 1:
            lengths, along = info[:, 0], scores**2
        else:
            lengths, turn = np.linalg.eigh(info)
            along = (np.swapaxes(turn, 1, 2) @ scores) ** 2
        prior = (np.array(AMPLITUDES) * self.unit) ** 2 / k
        whole = 1.0 + prior[:, None] * np.maximum(lengths, 0.0)[:, None]  # (C, 3, k)
        return np.asarray(0.5 * ((prior[:, None] / whole) @ along - np.log(whole).sum(axis=2)[..., None]))

    def _of_one(self, info: Array, scores: Array) -> Array:
        """(C, 3) of each amplitude for scores (C, k), without axes: of the matrix (1 + ΛI, Λ½S; its transpose, c) the
        Cholesky factor's diagonal has the root of c − SᵀΛ½(1 + ΛI)⁻¹Λ½S last, and the determinant in the rest, where
        none is below one: unless rounding has left less than nothing of a candidate, which the axes then tell."""
        count, k = scores.shape
        out = np.empty((count, len(AMPLITUDES)))
        square = np.einsum("ck,ck->c", scores, scores)
        bordered, doubtful = np.empty((count, k + 1, k + 1)), np.zeros(count, dtype=bool)
        for a, amplitude in enumerate(AMPLITUDES):
            prior = (amplitude * self.unit) ** 2 / k
            bordered[:, :k, :k] = prior * info + np.eye(k)
            bordered[:, k, :k] = np.sqrt(prior) * scores
            bordered[:, k, k] = 1.0 + prior * square
            try:
                diagonal = np.diagonal(np.linalg.cholesky(bordered), axis1=1, axis2=2)
            except np.linalg.LinAlgError:
                return self._of_many(info, scores[..., None])[..., 0]
            explained = 1.0 + prior * square - diagonal[:, k] ** 2
            out[:, a] = 0.5 * explained - np.log(diagonal[:, :k]).sum(axis=1)
            doubtful |= diagonal.min(axis=1) < 1.0 - ROUNDING
        out[doubtful] = self._of_many(info[doubtful], scores[doubtful, :, None])[..., 0]
        return out

    def scores(self) -> Array:
        """Zᵀ V⁻¹ y of every column, what was taken up included in V: (K,)."""
        taken_up = self._middle @ (self._absorbed.T @ self.space.y)
        return np.asarray(self._plain_scores - np.einsum("f,fk->k", taken_up, self._cross))  # in double, without a copy

    def fitted(self, candidate: int) -> Array:
        """(k,) coefficients of a candidate's columns beside what is taken up, the widest prior held against them."""
        columns = self.index[candidate]
        batch, info = next(
            (batch, info) for batch, info in zip(self._batches, self._info, strict=True)
            if batch.columns.shape[1] == len(columns)
        )  # fmt: skip
        mine = info[int(np.searchsorted(batch.which, candidate))]
        held = np.eye(len(columns)) * len(columns) / (AMPLITUDES[-1] * self.unit) ** 2
        return np.asarray(np.linalg.solve(mine + held, self.scores()[columns]) / self.scale[columns])

    def by_name(self, evidence: Array) -> Array:
        """Log evidence of every name, its candidates averaged by their shares: (D, C) → (D, names)."""
        weighted = evidence.T[self._sorted]
        weighted += self.log_share[self._sorted, None]
        most = np.maximum.reduceat(weighted, self._starts)
        most = np.where(np.isfinite(most), most, 0.0)
        for mine, at in zip(np.split(weighted, self._starts[1:]), most, strict=True):
            np.subtract(mine, at, out=mine)
        np.exp(weighted, out=weighted)
        with np.errstate(divide="ignore"):
            out = most + np.log(np.add.reduceat(weighted, self._starts))
        return np.where(self._nameless & (out > 0).T, HANDICAP * out.T, out.T)

    def likeliest(self, names: Array) -> int:
        """The best name of the effect that the evidence of all names (names,) speaks for: what cannot be told to sit in
        one joint or the next is no less likely for it. The best name itself where that is nearly a tie."""
        said = np.array([np.logaddexp.reduce(names[self._effect_of == e]) for e in range(self._effect_of.max() + 1)])
        said[self._effect_of[np.argmax(names)]] += NEARLY_A_TIE
        return int(np.argmax(np.where(self._effect_of == int(np.argmax(said)), names, -np.inf)))

    def said(self) -> tuple[Array, Array]:
        """Log evidence of all candidates (C,) and of all names, beside what is taken up; not to be written to."""
        if self._state in self._said:
            return self._said[self._state]
        evidence = self.evidence(self.scores()[None])
        said = evidence[0], self.by_name(evidence)[0]
        for each in said:
            each.flags.writeable = False
        if self._state is not None:
            self._said[self._state] = said
        return said

    def name(self, candidate: int) -> Name:
        """The name of the candidate at an index."""
        return self.names[int(self.name_of[candidate])]

    def strongest(self, evidence: Array, name: int) -> int:
        """The best candidate of the name at this index, for the evidence (C,) of all."""
        return int(np.argmax(np.where(self.name_of == name, evidence + self.log_share, -np.inf)))

    def null(self, residual: Array, rng: np.random.Generator, observed: float = -np.inf) -> Array:
        """The greatest log evidence of any name under random signs of whole visits: (draws,), or the first of them
        where these tell already that nothing like what was observed comes from nothing.

        residual  (F, 3T) whitened and corrected for leverage; a visit that no noise makes counts as if it were just not
                  simply wrong: it was believed because something explains it
        """
        space = self.space
        freedom = 3 * space.recording.seen[space.fit].sum(axis=1)
        size = (residual**2).sum(axis=1) / freedom
        residual = residual * np.sqrt(np.minimum(1.0, MOST_OF_NOISE / np.maximum(size, 1e-30)))[:, None]
        signs = rng.choice(np.array([-1.0, 1.0]), size=(DRAWS, len(residual)))
        few = self.greatest(signs[:FEW, :, None] * residual)
        if p_value(observed, few) < PLAIN:
            return few
        return np.concatenate([few, self.greatest(signs[FEW:, :, None] * residual)])

    def greatest(self, turned: Array) -> Array:
        """(D,) log evidence of the best name of each of D recordings (D, F, 3T), whitened."""
        turned = turned.reshape(len(turned), -1).T
        scores = self.laid.product(self.space.absorb(turned))
        scores -= self._cross.T @ (self._middle @ (self._absorbed.T @ turned)).astype(np.float32)
        return np.asarray(self.by_name(self.evidence(scores.T)).max(axis=1))


def _of_its_sign(way: Array, info: Array, scores: Array) -> Array:
    """What it adds to the log evidence (C, D) that a candidate's first coefficient has the sign that physics gives it,
    or has not, for ways (C,), information (C, 1) and scores (C, D): a normal prior twice as high on one side, but for
    what an axis that is turned round in a file would do."""
    z = way[:, None] * scores / np.sqrt(np.maximum(info, 1e-300))
    return np.asarray(np.where(way[:, None] == 0, 0.0, np.log(2.0 * ((1.0 - TURNED) * ndtr(z) + TURNED * ndtr(-z)))))


def p_value(observed: float, null: Array) -> float:
    """Share of the null at or above what was observed. Beyond all but TOP of its draws it falls by e per unit of log
    evidence, and not faster: odds of k to 1 come from nothing at most once in k times (Markov's inequality)."""
    counted = (1 + int((null >= observed).sum())) / (len(null) + 1)
    least = (1 + TOP) / (len(null) + 1)
    if counted > least:
        return float(counted)
    return float(max(least * np.exp(min(np.sort(null)[-TOP] - observed, 0.0)), LEAST_P))


def corrected_residual(space: Workspace) -> Array:
    """(F, 3T) whitened residuals of the fit visits, corrected for leverage per visit: noise alone has unit variance."""
    size = space.rows
    extra = space.absorbed.reshape(len(space.kept), size, space.absorbed.shape[1])
    keep = space.kept - extra @ space.middle @ np.swapaxes(extra, 1, 2)
    values, vectors = np.linalg.eigh(0.5 * (keep + np.swapaxes(keep, 1, 2)))
    root = (vectors / np.sqrt(np.maximum(values, 0.05))[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return np.asarray((root @ space.left().reshape(-1, size, 1))[..., 0])
