"""What is simply wrong, looked for before any physics: bad visits, swapped reflectors; and noise that is no bias."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, chi2
from scipy.stats import f as f_distribution

from ppshw.diagnosis.evidence import MOST_OF_NOISE, corrected_residual
from ppshw.diagnosis.workspace import Workspace
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.recording import listed
from ppshw.terms import COMPONENTS

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
TOGETHER = 1e-3  # chance that wrong visits gather at one place of a joint's travel
OF_A_RIDDLE = 5.0  # times its rms: less is what a smooth function may leave of structure without a name
SCATTER = 0.001
LITTLE = 0.05  # of the noise's variance: what swings less than that in a direction swings no less
PLACES, SOME = 12, 5  # along a joint's travel; visits without which one is none
PERMUTATIONS = 1999
SWINGS = tuple(np.geomspace(0.1, 100.0, 16).tolist())  # mean square of a swing, in units of the noise


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

    def others(self, count: int) -> Mask:
        """(count,) which visits are not simply wrong."""
        return ~np.isin(np.arange(count), self.visits)

    def findings(self, rows: NDArray[np.int64], misread: NDArray[np.int64]) -> list[dict[str, Any]]:
        """rows: which visits of the recording those that were looked at are; misread: visits of the recording whose
        wrench is not that of their load, and which were not looked at."""
        visits = sorted([*rows[list(self.visits)].tolist(), *misread.tolist()])
        if not visits:
            return []
        many = f"{len(visits)} visits are" if len(visits) > 1 else "one visit is"
        sentence = f"{many} simply wrong and set aside: {listed(visits)}."
        for visit, names in itertools.islice(self.swapped.items(), 3):
            sentence += f" In visit {rows[visit] + 1} {' and '.join(names)} are swapped."
        if len(misread):
            sentence += f" The force sensor's reading is not that of the load: {listed(misread)}."
        return [
            {
                "effect": "outliers", "joint": None, "frame": None, "component": None, "covariate": "visit",
                "region": [visits[0] + 1, visits[-1] + 1], "visits": [v + 1 for v in visits],
                "parameters": {"visits": {"value": len(visits), "std": 0, "unit": "1"}},
                "p_value": self.p if self.visits else 0.0, "rms_mm": self.size, "weight": 1.0, "alternatives": [],
                "aliases": [], "sentence": sentence,
            }
        ]  # fmt: skip


def gross_errors(space: Workspace) -> GrossErrors:
    """Visits whose residual noise cannot make, by χ² with Bonferroni's correction on a robust scale."""
    weights = np.maximum(space.base.weights, 1e-3)
    residual = corrected_residual(space) / np.sqrt(weights[space.fit])[:, None]
    freedom = 3 * space.recording.seen.sum(axis=1)[space.fit]
    distance = (residual**2).sum(axis=1)
    scale = _scale(distance, freedom)
    tail = chi2.sf(distance / scale, freedom)
    far = distance > _limit(space, distance, freedom, scale)
    if far.mean() > 0.1 or not _wrong(far, distance, freedom, scale):
        return GrossErrors()
    visits = np.flatnonzero(space.fit)[far]
    together, place, by_chance = _at_a_place(space, visits)
    found = GrossErrors(at_a_place=tuple(int(v) for v in visits[together]), place=place, p_place=by_chance)
    visits = visits[~together]
    if not len(visits):
        return found
    left = space.residual()[visits].reshape(-1, 3)
    return replace(
        found,
        visits=tuple(int(v) for v in visits),
        swapped={int(v): names for v in visits if (names := _swap(space, int(v)))},
        size=float(np.sqrt(np.nanmean(np.nansum(left**2, axis=1))) * 1e3),
        p=float(min(1.0, tail.min() * len(distance))),
    )


def _at_a_place(space: Workspace, visits: NDArray[np.int64]) -> tuple[Mask, int, float]:
    """Which of some visits lie so close together along one joint's travel as chance would hardly put them, which
    joint's (-1: none), and that chance: what is simply wrong is so anywhere."""
    best, found = TOGETHER, (np.zeros(len(visits), dtype=bool), -1, 1.0)
    q = space.recording.q
    moving = [k for k in range(q.shape[1]) if np.ptp(q[:, k]) > 0]
    for k in moving:
        order = np.argsort(q[visits, k])
        here, everyone = q[visits[order], k], np.sort(q[space.fit, k])
        for first, last in itertools.combinations(range(len(here)), 2):
            inside = np.searchsorted(everyone, here[last], "right") - np.searchsorted(everyone, here[first])
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
    scale = float(np.median(distance / freedom)) / f_distribution.median(np.median(freedom), nu)
    return np.asarray(scale * freedom * f_distribution.isf(GROSS / len(distance), freedom, nu))


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
    left = np.nan_to_num(space.residual())
    targets = np.sqrt(np.maximum(space.recording.seen.sum(axis=1), 1))
    size = np.linalg.norm(left, axis=1) / targets
    there = np.linalg.norm(space.beyond(space.moved()), axis=1) / targets
    white = np.einsum("nij,nj->ni", space.root, left)
    freedom = 3 * space.recording.seen.sum(axis=1)
    distance = (white**2).sum(axis=1)
    scale = _scale(distance[space.fit], freedom[space.fit])
    far = (distance > _limit(space, distance, freedom, scale)) & (size > np.maximum(there, OF_A_RIDDLE * riddle))
    far &= np.isin(np.arange(len(far)), gross.visits)
    kept = tuple(int(v) for v in np.flatnonzero(far)) if _wrong(far, distance, freedom, scale) else ()
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


@dataclass(frozen=True)
class Scatter:
    """finding: the contract's; calming: (N, 3T, 3T) that the whitened noise of a visit is to be multiplied by, to be
    white again."""

    finding: dict[str, Any]
    calming: Array


def scatter_of(space: Workspace, seed: int, any_way: bool = False, nameless: bool = False) -> Scatter | None:
    """Does the scatter grow with a short settling time, the load or the length of the move? By random exchange of whole
    visits; the weight is the most that such a p allows at even odds (Sellke, Bayarri & Berger 2001).

    The other way round nothing acts, but scatter that differs by pose looks so: sweeps are short moves in one place.
    What is larger at one place of a joint's travel than with any of these is no scatter either.
    What swings may be one link about one axis; where that is likelier than noise that grows in all directions, only
    that direction counts less.

    any_way  also what swings in one direction alone, which is much of it and little of the whole: to be asked when
             what is missing has been found, since a bias that grows with the load swings one way too
    nameless the name is not known: scatter is only looked for over columns as they are
    """
    whitened = corrected_residual(space)[..., None]
    residual = np.asarray(np.linalg.solve(space.calming[space.fit], whitened), dtype=float)[..., 0]
    along = np.einsum("nij,njfc->nfci", np.linalg.solve(space.calming, space.root), space.context.jacobian)
    columns = _may_scatter(space, nameless)
    whole = _standardised(np.stack(list(columns.values()), axis=1), space.fit)
    matrix = whole[space.fit]
    sizes = _sizes(residual, along[space.fit])[:, : None if any_way else 1]
    ranges = sizes.std(axis=0)
    sizes = sizes / np.maximum(ranges, 1e-12)
    strength = matrix.T @ sizes
    rng = np.random.default_rng(seed)
    null = np.array([(matrix.T @ rng.permutation(sizes)).max() for _ in range(PERMUTATIONS)])
    k, direction = (int(j) for j in np.unravel_index(int(np.argmax(strength)), strength.shape))
    p = (1 + int((null >= strength[k, direction]).sum())) / (PERMUTATIONS + 1)
    places = _standardised(_places(space), space.fit)[space.fit]
    if p > SCATTER or (places.T @ sizes[:, direction]).max(initial=0.0) > strength[k, direction]:
        return None
    name = _stem(list(columns)[k])
    way = "falls" if name == "settle_s" else "grows"
    more = float(np.exp(np.ptp(matrix[:, k]) * strength[k, direction] * ranges[direction] / 2))
    finding: dict[str, Any] = {
        "effect": "unsettled", "joint": None, "frame": None, "component": None, "covariate": name,
        "region": None,
        "parameters": {"scatter_ratio": {"value": more, "std": None, "unit": "1"}},
        "p_value": p, "rms_mm": None, "weight": round(float(1 / (1 - np.e * p * np.log(p))), 4), "alternatives": [],
        "aliases": [],
        "sentence": f"the scatter {way} with {name} (by a factor of {more:.2g} over its range): noise, not a bias.",
    }  # fmt: skip
    evenly = strength[k, 0] * ranges[0]  # as it would be with noise that grows alike in all directions
    spread = np.exp(whole[:, k] * evenly / 2)
    alike = [size for column, size in columns.items() if _stem(column) == name]
    swings = [_swing(space, along, residual, size - min(float(size.min()), 0.0)) for size in alike]
    swing = max((found for found in swings if found is not None), key=lambda found: found.gain, default=None)
    if swing is None or swing.gain - np.log(swing.tried) < _gain_of(space, residual, spread):
        return Scatter(finding, np.eye(space.rows) / spread[:, None, None])
    # which of several frames that move the end effector nearly alike is a guess, so no joint is named
    said = {"frame": space.machine.frame_names[swing.frame], "component": COMPONENTS[swing.component]}
    where = f"; it swings most nearly as {said['frame']} {said['component']} would: noise"
    return Scatter({**finding, **said, "sentence": finding["sentence"].replace(": noise", where)}, swing.calming)


def scatter_without_a_name(space: Workspace, scatter: Scatter) -> dict[str, Any]:
    """Scatter, in the contract's words for what is unexplained: what it goes with; the rms is of all that is left."""
    left, name = space.residual()[space.fit], scatter.finding["covariate"]
    values = space.recording.settle_s if name == "settle_s" else None
    history = "scatter, not a bias"
    if name == "load":
        name = WRENCH_COMPONENTS[int(np.argmax(space.recording.wrench[:, :3].std(axis=0)))]
    elif name.startswith("move"):
        q = space.recording.q
        pace = np.abs(np.diff(q, axis=0)).mean(axis=0) / np.maximum(np.ptp(q, axis=0), 1e-9)
        joint = space.machine.joint_names[int(np.argmax(pace))] if name == "move length" else name.removeprefix("move_")
        name, history = f"q_{joint}", f"of the last move, {history}"
    return {
        "covariates": [name], "history": history, "frame": scatter.finding["frame"],
        "component": scatter.finding["component"],
        "region": {} if values is None else {name: [float(values.min()), float(values.max())]},
        "rms_mm": float(np.sqrt(np.nansum(left**2) / max(int(space.recording.seen[space.fit].sum()), 1)) * 1e3),
        "p_value": scatter.finding["p_value"],
    }  # fmt: skip


def _may_scatter(space: Workspace, nameless: bool) -> dict[str, Array]:
    """What scatter may grow with, (N,) each; without a name the columns alone, no function of them."""
    r = space.recording
    columns: dict[str, Array] = {}
    if np.isfinite(r.settle_s).all() and np.ptp(r.settle_s) > 0:
        for tau in () if nameless else (1.0, 3.0, 8.0):
            columns[f"settle_s exp(-t/{tau:g} s)"] = np.exp(-r.settle_s / tau)
        columns["settle_s"] = -r.settle_s
    if r.has_wrench and np.ptp(r.wrench, axis=0).max() > 0:
        columns["load"] = np.linalg.norm(r.wrench[:, :3], axis=1)
        if not nameless:
            columns["load squared"] = columns["load"] ** 2
    span = np.maximum(np.ptp(r.q, axis=0), 1e-9)
    moved = np.concatenate([np.zeros((1, r.q.shape[1])), np.abs(np.diff(r.q, axis=0) / span)])
    columns["move length"] = moved.max(axis=1)
    columns |= {f"move_{name}": moved[:, k] for k, name in enumerate(space.machine.joint_names) if moved[:, k].any()}
    rings = [column for column in columns if " exp" in column]
    for name in [name for name in columns if name.startswith("move")]:  # what rings after a long move
        columns |= {f"{name} x {ring}": columns[name] * columns[ring] for ring in rings}
    return columns


def _standardised(columns: Array, fit: Mask) -> Array:
    """Columns (N, K) without their means, of unit length, over the fit visits."""
    columns = columns - columns[fit].mean(axis=0)
    return np.asarray(columns / np.maximum(np.linalg.norm(columns[fit], axis=0), 1e-30))


def _places(space: Workspace) -> Array:
    """Where each joint is along its travel, (N, joints · PLACES or fewer): a hat over every place that was visited."""
    q = space.recording.q[:, np.ptp(space.recording.q, axis=0) > 0]
    along = PLACES * (q - q.min(axis=0)) / np.ptp(q, axis=0)
    hats = np.maximum(1.0 - np.abs(along[:, :, None] - (np.arange(PLACES) + 0.5)), 0.0).reshape(len(q), -1)
    return np.asarray(hats[:, (hats[space.fit] > 0).sum(axis=0) >= SOME])  # a lone visit is no place


def _sizes(residual: Array, along: Array) -> Array:
    """(F, 1 + D) log mean squares of residuals (F, 3T), white but for the scatter, in all directions and in the D
    that a frame's component moves (F, n+1, 6, 3T), less their means."""
    moved = along.reshape(len(along), -1, along.shape[3])
    square = np.einsum("fdi,fi->fd", moved, residual) ** 2
    length = (moved**2).sum(axis=2)
    there = length.min(axis=0) > 1e-9 * length.max()
    every = np.column_stack([(residual**2).mean(axis=1), square[:, there] / length[:, there]])
    sizes = np.log(every + LITTLE)
    return np.asarray(sizes - sizes.mean(axis=0))


def _stem(column: str) -> str:
    """The recording's column, whatever function of it."""
    return column.split(" x ", maxsplit=1)[0].removesuffix(" squared").split(" exp")[0]


@dataclass(frozen=True)
class _Swing:
    """Where a link swings, how much likelier that is than even noise (log), of how many tried; calming as `Scatter`."""

    frame: int
    component: int
    gain: float
    tried: int
    calming: Array


def _swing(space: Workspace, along: Array, residual: Array, size: Array) -> _Swing | None:
    """The component of a frame whose swinging in proportion to a column is likeliest; None where nothing can.

    along     (N, n+1, 6, 3T) what every component of every frame does, whitened for even noise
    residual  (F, 3T) of the fit visits, white but for the swinging;  size (N,) of the swing, in any unit, not negative
    """
    square = (along**2).sum(axis=3) * size[:, None, None] ** 2
    shown = np.einsum("nfci,ni->nfc", along[space.fit], residual) ** 2 * size[space.fit, None, None] ** 2
    mean = square[space.fit].mean(axis=0)
    seen = mean > 1e-9 * mean.max()
    if not mean.max() > 0:
        return None
    gains = np.full((len(SWINGS), *mean.shape), -np.inf)
    for j, ratio in enumerate(SWINGS):
        most = np.where(seen, ratio / np.maximum(mean, 1e-300), 0.0)
        bigger = 1.0 + most * square[space.fit]
        gains[j] = np.where(seen, 0.5 * (shown * most / bigger - np.log(bigger)).sum(axis=0), -np.inf)
    j, frame, component = (int(k) for k in np.unravel_index(int(np.argmax(gains)), gains.shape))
    u = along[:, frame, component]
    length = np.maximum((u**2).sum(axis=1), 1e-30)
    less = 1.0 / np.sqrt(1.0 + SWINGS[j] / mean[frame, component] * square[:, frame, component]) - 1.0
    calming = np.eye(space.rows) + (less / length)[:, None, None] * u[:, :, None] * u[:, None, :]
    # the noise was learnt with the swinging in it
    calm = np.einsum("nij,nj->ni", calming[space.fit], residual)
    calming /= np.sqrt((calm**2).sum() / (3 * space.recording.seen[space.fit].sum()))
    return _Swing(frame, component, float(gains.max()), gains.size, calming)


def _gain_of(space: Workspace, residual: Array, spread: Array) -> float:
    """How much likelier (log) residuals (F, 3T) are with noise that grows alike in all directions (N,) than with even
    noise."""
    freedom = 3 * space.recording.seen.sum(axis=1)[space.fit]
    grows = spread[space.fit]
    return float((0.5 * (residual**2).sum(axis=1) * (1 - 1 / grows**2) - freedom * np.log(grows)).sum())
