"""What is simply wrong, looked for before any physics: bad visits, swapped reflectors."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, chi2
from scipy.stats import f as f_distribution

from ppshw.diagnosis.evidence import LEAST_P, MOST_OF_NOISE, corrected_residual
from ppshw.diagnosis.workspace import Workspace
from ppshw.recording import Recording, listed

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
# A visit is wrong when noise would do this to one visit in a thousand recordings.
GROSS = 1e-3
FAR = 6.0  # times the mean square of noise, at least; where some visits swing more than others MOST_OF_NOISE
# A lone visit may be the one that a heavier tail than normal leaves among hundreds: it is wrong when it is six times as
# far off as noise. Five lone visits in sealed cases were off 4 to 6 times, by nothing but such tails; wrong ones, 2 to
# 11 in each of twenty recordings, 2.5 to 24 times.
ALONE = 36.0
IN_BETWEEN, HEAVY = 1e-3, 0.02  # tails are heavy where so few visits of noise would swing that far, by such a chance
# Degrees of freedom that the multivariate t may have of which noise is taken to be where its tails are heavy; the share
# of visits, those nearest, that say which; and by how much log likelihood less the heaviest still may be it.
TAILS, NEAREST, AS_LIKELY = (3.0, 4.0, 5.0, 6.0, 8.0, 11.0, 15.0, 22.0, 35.0, 60.0, 120.0, 1e6), 0.95, 2.0
# Noise of the likeliest tails leaves so many visits that far off by such a chance; so many at least, and fewer than a
# tenth, as structure would.
TOO_MANY, SEVERAL = 1e-5, 6
# A recording of noise of its own tails has so far a visit by such a chance: where that is greater none is wrong (two of
# p 1.0 were, where scatter went with how long the machine settled; another author's 36020, the name taken out).
BY_CHANCE = 0.05
# Chance that wrong visits gather at one place of a joint's travel, and share of the visits there that they are at
# least: ten of eleven wrong ones lay between 126 that were right, by a chance of 8e-4 (a sixty-third author's 001).
TOGETHER, MOST_THERE = 1e-3, 0.3
OF_A_RIDDLE = 5.0  # times its rms: less is what a smooth function may leave of structure without a name


@dataclass(frozen=True)
class GrossErrors:
    """visits: indices of visits that are simply wrong; swapped: which reflectors were swapped where that explains it;
    size: rms of their residuals [mm]; p: of the worst, family-wise; at_a_place: visits as far off, but all at one place
    of the travel of joint `place`, where something must be, by chance p_place."""

    visits: tuple[int, ...] = ()
    at_a_place: tuple[int, ...] = ()
    place: int = -1
    p_place: float = 1.0
    swapped: dict[int, tuple[str, ...]] = field(default_factory=dict)
    size: float = 0.0
    p: float = 1.0

    def others(self, recording: Recording) -> Mask:
        """(N,) which visits saw a target and are not simply wrong."""
        return recording.measured & ~np.isin(np.arange(len(recording)), self.visits)

    def findings(self, rows: NDArray[np.int64], misread: NDArray[np.int64]) -> list[dict[str, Any]]:
        """rows: which visits of the recording those that were looked at are; misread: visits of the recording whose
        wrench is not that of their load, and which were not looked at."""
        visits = sorted([*rows[list(self.visits)].tolist(), *misread.tolist()])
        if not visits:
            return []
        many = f"{len(visits)} visits are" if len(visits) > 1 else "one visit is"
        sentence = f"{many} simply wrong and set aside: {listed(visits)}."
        for names in dict.fromkeys(self.swapped.values()):
            those = [int(rows[visit]) for visit, mine in self.swapped.items() if mine == names]
            visit = "visit" if len(those) == 1 else "visits"
            sentence += f" In {visit} {listed(those)} {' and '.join(names)} are swapped."
        if len(misread):
            sentence += f" The force sensor's reading is not that of the load: {listed(misread)}."
        return [
            {
                "effect": "outliers", "joint": None, "frame": None, "component": None, "covariate": "visit",
                "region": [visits[0] + 1, visits[-1] + 1], "visits": [v + 1 for v in visits],
                "parameters": {"visits": {"value": len(visits), "std": 0, "unit": "1"}},
                "p_value": max(self.p if self.visits else 0.0, LEAST_P), "rms_mm": self.size, "weight": 1.0,
                "alternatives": [], "aliases": [], "sentence": sentence,
            }
        ]  # fmt: skip


def gross_errors(space: Workspace, surely: Mask | None = None) -> GrossErrors:
    """Visits whose residual noise cannot make, by χ² with Bonferroni's correction on a robust scale; p of the worst is
    by noise of the tails that the others are likeliest of.

    surely  (N,) visits with a reading that no error of a machine explains, wherever they are
    """
    weights = np.maximum(space.base.weights, 1e-3)
    residual = corrected_residual(space) / np.sqrt(weights)[:, None]
    freedom = 3 * space.recording.seen.sum(axis=1)[space.fit]
    distance = (residual**2).sum(axis=1)
    scale = _scale(distance, freedom)
    chance = _tail(distance, freedom, _tails(distance, freedom)[0]) * len(distance)
    far = _too_many(distance, freedom)
    if chance.min() <= BY_CHANCE:
        far = far | (distance > _limit(space, distance, freedom, scale))
    sure = np.zeros(len(far), dtype=bool) if surely is None else surely[space.fit]
    if (far & ~sure).mean() > 0.1 or not _wrong(far, distance, freedom, scale):
        far = np.zeros(len(far), dtype=bool)
    visits = np.flatnonzero(space.fit)[far & ~sure]
    together, place, by_chance = _at_a_place(space, visits)
    found = GrossErrors(at_a_place=tuple(int(v) for v in visits[together]), place=place, p_place=by_chance)
    visits = np.sort(np.concatenate([visits[~together], np.flatnonzero(space.fit)[sure]]))
    if not len(visits):
        return found
    left = space.residual()[visits].reshape(-1, 3)
    return replace(
        found,
        visits=tuple(int(v) for v in visits),
        swapped={int(v): names for v in visits if (names := _swap(space, int(v)))},
        size=float(np.sqrt(np.nanmean(np.nansum(left**2, axis=1))) * 1e3),
        p=float(min(1.0, chance.min())),
    )


def _at_a_place(space: Workspace, visits: NDArray[np.int64]) -> tuple[Mask, int, float]:
    """Which of some visits lie so close together along one joint's travel, with few others between, as chance would
    hardly put them, which joint's (-1: none), and that chance: what is simply wrong is so anywhere."""
    best, found = TOGETHER, (np.zeros(len(visits), dtype=bool), -1, 1.0)
    q = space.recording.q
    moving = [k for k in range(q.shape[1]) if np.ptp(q[:, k]) > 0]
    for k in moving:
        order = np.argsort(q[visits, k])
        here, everyone = q[visits[order], k], np.sort(q[space.fit, k])
        for first, last in itertools.combinations(range(len(here)), 2):
            inside = np.searchsorted(everyone, here[last], "right") - np.searchsorted(everyone, here[first])
            if last - first + 1 < MOST_THERE * inside:
                continue
            by_chance = binom.sf(last - first - 1, len(here) - 1, inside / len(everyone)) * len(here) * len(moving)
            if by_chance < best:
                best, together = float(by_chance), np.zeros(len(visits), dtype=bool)
                together[order[first : last + 1]] = True
                found = together, k, best
    return found


def left_at_a_place(space: Workspace, gross: GrossErrors) -> dict[str, Any] | None:
    """Structure at one place of a joint's travel that is too narrow for any function of it, in the contract's words for
    what is unexplained; None where what was found explains it, or most of it."""
    if not gross.at_a_place:
        return None
    visits = list(gross.at_a_place)
    left = np.nan_to_num(space.residual())
    white = (np.einsum("nij,nj->ni", space.root, left) ** 2).sum(axis=1)[visits]
    if np.median(white / (3 * space.recording.seen.sum(axis=1)[visits])) < FAR:
        return None
    name = space.machine.joint_names[gross.place]
    q = space.recording.q[visits, gross.place]
    size = np.sqrt((left[visits] ** 2).sum() / max(int(space.recording.seen[visits].sum()), 1))
    return {
        "covariates": [f"q_{name}"], "history": None, "frame": name, "component": None,
        "region": {f"q_{name}": [float(q.min()), float(q.max())]}, "rms_mm": float(size * 1e3),
        "p_value": gross.p_place,
    }  # fmt: skip


def _scale(distance: Array, freedom: Array) -> float:
    """1 when the noise is what the estimate says."""
    return max(float(np.median(distance / chi2.median(freedom))), 1e-12)


def _limit(space: Workspace, distance: Array, freedom: Array, scale: float) -> Array:
    """(V,) squared distances of V visits beyond which one is simply wrong. Heavier tails than normal are common: only
    what is far beyond them is wrong, and farther where some visits swing more than others."""
    tail = chi2.sf(distance / scale, freedom)
    swings = int(((tail < IN_BETWEEN) & (distance < FAR * scale * freedom)).sum())
    heavy = space.calmed or binom.sf(swings - 1, len(distance), IN_BETWEEN) < HEAVY
    least: Array | float = FAR
    if heavy:  # unless the many that are near say that the few between are no noise
        least = np.minimum(MOST_OF_NOISE, _beyond(distance, freedom, _tails(distance, freedom)[1]) / (scale * freedom))
    return np.asarray(scale * np.maximum(chi2.isf(GROSS / len(distance), freedom), least * freedom))


def _too_many(distance: Array, freedom: Array) -> Mask:
    """(V,) the farthest of V visits, where they are too many to be noise, whose tails the nearest say: any one alone
    may well be."""
    count = len(distance)
    tail = _tail(distance, freedom, _tails(distance, freedom)[0])
    order = np.sort(tail)[: max(2, count // 10)]
    by_chance = np.asarray(binom.sf(np.arange(len(order)), count, order)) * len(order)
    most = int(np.argmin(by_chance))
    if by_chance[most] > TOO_MANY or not SEVERAL <= most + 1 < len(order):
        return np.zeros(count, dtype=bool)
    return np.asarray((tail <= order[most]) & (distance > FAR * _scale(distance, freedom) * freedom))


def _wrong(far: Mask, distance: Array, freedom: Array, scale: float) -> bool:
    """Whether any visits far off are simply wrong: several are, a lone one if it is very far; (V,) of V visits each."""
    if int(far.sum()) != 1:
        return bool(far.any())
    likeliest = _beyond(distance, freedom, _tails(distance, freedom)[0])
    return bool((distance > np.maximum(ALONE * scale * freedom, likeliest))[far].any())


def _tails(distance: Array, freedom: Array) -> tuple[float, float]:
    """Degrees of freedom of the multivariate t that the visits' squared distances (V,) are likeliest of, and the fewest
    that are nearly as likely. Only the nearest say it, of the others no more than that they are farther: what is simply
    wrong is among them. Its d²/p is F distributed (p, ν)."""
    mean = distance / freedom
    edge, middle = float(np.quantile(mean, NEAREST)), float(np.median(mean))
    near = mean <= edge
    said = []
    for nu in TAILS:
        scale = middle / float(f_distribution.median(np.median(freedom), nu))
        said.append(
            float(np.sum(f_distribution.logpdf(mean[near] / scale, freedom[near], nu) - np.log(scale)))
            + float(np.sum(f_distribution.logsf(edge / scale, freedom[~near], nu)))
        )
    best = int(np.argmax(said))
    return TAILS[best], TAILS[int(np.argmax(np.array(said) > said[best] - AS_LIKELY))]


def _beyond(distance: Array, freedom: Array, nu: float) -> Array:
    """(V,) squared distances that noise of such tails reaches in one of a thousand recordings."""
    scale = _scale_of_tails(distance, freedom, nu)
    return np.asarray(scale * freedom * f_distribution.isf(GROSS / len(distance), freedom, nu))


def _tail(distance: Array, freedom: Array, nu: float) -> Array:
    """(V,) by which chance noise of such tails goes as far as each of V visits."""
    scale = _scale_of_tails(distance, freedom, nu)
    return np.asarray(f_distribution.sf(distance / (scale * freedom), freedom, nu), dtype=float)


def _scale_of_tails(distance: Array, freedom: Array, nu: float) -> float:
    """Of squared distances (V,) whose mean over the freedom is F distributed, by the middle one."""
    return float(np.median(distance / freedom) / f_distribution.median(np.median(freedom), nu))


def still_gross(space: Workspace, gross: GrossErrors, riddle: float = 0.0) -> GrossErrors:
    """Those of the visits that stay wrong when what was found is taken into account (`space` has it taken up): a
    visit may have been odd by an effect that nobody knew yet, or by what the effect's form leaves where it is largest:
    one that is moved further by what was found (beyond what the base model takes) than it is still off is not simply
    wrong.

    riddle  rms of structure without a name beyond the base model [m]: a smooth function leaves as much of it, in places
            several times that
    """
    if not gross.visits:
        return gross
    visits, fitted = np.flatnonzero(space.recording.measured), space.fit[space.recording.measured]
    left, targets = np.nan_to_num(space.residual()[visits]), space.recording.seen[visits].sum(axis=1)
    size = np.linalg.norm(left, axis=1) / np.sqrt(targets)
    there = np.linalg.norm(space.beyond(space.moved())[visits], axis=1) / np.sqrt(targets)
    freedom, distance = 3 * targets, (np.einsum("nij,nj->ni", space.root[visits], left) ** 2).sum(axis=1)
    scale = _scale(distance[fitted], freedom[fitted])
    far = (distance > _limit(space, distance, freedom, scale)) | _too_many(distance, freedom)
    far &= size > np.maximum(there, OF_A_RIDDLE * riddle)
    far &= np.isin(visits, gross.visits)
    kept = tuple(int(v) for v in visits[far]) if _wrong(far, distance, freedom, scale) else ()
    return replace(gross, visits=kept, swapped={v: n for v, n in gross.swapped.items() if v in kept})


def _swap(space: Workspace, visit: int) -> tuple[str, ...]:
    """The two reflectors whose exchange brings a visit back, or nothing."""
    predicted = space.context.points[visit]
    measured = predicted + space.residual()[visit].reshape(-1, 3)
    before = float(np.nansum((measured - predicted) ** 2))
    names = space.recording.target_names
    for a, b in itertools.combinations(range(len(names)), 2):
        order = list(range(len(names)))
        order[a], order[b] = b, a
        if float(np.nansum((measured[order] - predicted) ** 2)) < 1e-4 * before:
            return names[a], names[b]
    return ()
