"""Noise that is no bias: scatter that grows with a short settling time, the load or the last move."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.evidence import corrected_residual
from ppshw.diagnosis.library.sampled import nearest_component
from ppshw.diagnosis.weights import OUTSIDE
from ppshw.diagnosis.workspace import Workspace
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.terms import COMPONENTS

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
SCATTER = 0.001
LITTLE = 0.05  # of the noise's variance: what swings less than that in a direction swings no less
PLACES, SOME = 12, 5  # along a joint's travel; visits without which one is none
SHARES = (0.05, 0.2, 0.8)  # of an effect that its form may leave
PERMUTATIONS = 1999
# How much more some visits must swing than others beside other findings: of eight authors' recordings scatter that was
# there beside an effect has 1.97 to 15, and what six effects' forms and wrong visits left 1.26 to 1.82.
BESIDE = 1.9
# How likely a joint swings in its own direction, where its drive is, and how likely the base does, beside any joint;
# and the probability from which on a joint is named.
ALONG_ITS_WAY, OF_THE_BASE, SURELY = 0.9, 0.2, 0.9
SWINGS = tuple(np.geomspace(0.1, 100.0, 16).tolist())  # mean square of a swing, in units of the noise


@dataclass(frozen=True)
class Scatter:
    """finding: the contract's; calming: (N, 3T, 3T) that the whitened noise of a visit is to be multiplied by, to be
    white again."""

    finding: dict[str, Any]
    calming: Array


def scatter_of(
    space: Workspace, seed: int, any_way: bool = False, nameless: bool = False, beside: bool = False
) -> Scatter | None:
    """Does the scatter grow with a short settling time, the load or the length of the move? By random exchange of whole
    visits; the weight is the most that such a p allows at even odds (Sellke, Bayarri & Berger 2001).

    The other way round nothing acts, but scatter that differs by pose looks so: sweeps are short moves in one place.
    What is larger at one place of a joint's travel than with any of these is no scatter either, nor what is larger
    where what was found moves most, which its form leaves.
    What swings may be one link about one axis; where that is likelier than noise that grows in all directions, only
    that direction counts less.

    any_way  also what swings in one direction alone, which is much of it and little of the whole: to be asked when
             what is missing has been found, since a bias that grows with the load swings one way too
    nameless the name is not known: scatter is only looked for over columns as they are
    beside   other things were found: what their forms leave, here and there, makes a little scatter of any kind
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
    places = _standardised(np.column_stack([_places(space), _left_by_forms(space)]), space.fit)[space.fit]
    if p > SCATTER or (places.T @ sizes[:, direction]).max(initial=0.0) > strength[k, direction]:
        return None
    name = _stem(list(columns)[k])
    way = "falls" if name == "settle_s" else "grows"
    more = float(np.exp(np.ptp(matrix[:, k]) * strength[k, direction] * ranges[direction] / 2))
    if beside and more < BESIDE:
        return None
    most, least, std = _ends(space, matrix[:, k])
    finding: dict[str, Any] = {
        "effect": "unsettled", "joint": None, "frame": None, "component": None, "covariate": name,
        "region": None,
        "parameters": {"scatter_ratio": {"value": most / least, "std": std, "unit": "1"}},
        "p_value": p, "rms_mm": 1e3 * math.sqrt(max(most**2 - least**2, 0.0)),
        "weight": round((1 - OUTSIDE) * float(1 / (1 - np.e * p * np.log(p))), 4),
        "alternatives": [], "aliases": [],
        "sentence": f"the scatter {way} with {name} ({1e3 * most:.2g} mm rms in the fifth of the visits where it is "
        f"largest by that, {1e3 * least:.2g} where it is least): noise, not a bias.",
    }  # fmt: skip
    evenly = strength[k, 0] * ranges[0]  # as it would be with noise that grows alike in all directions
    spread = np.exp(whole[:, k] * evenly / 2)
    alike = [size for column, size in columns.items() if _stem(column) == name]
    swings = [_swing(space, along, residual, size - min(float(size.min()), 0.0)) for size in alike]
    swing = max((found for found in swings if found is not None), key=lambda found: found.gain, default=None)
    if swing is None or swing.gain - np.log(swing.tried) < _gain_of(space, residual, spread):
        return Scatter(finding, np.eye(space.rows) / spread[:, None, None])
    if (whose := _whose(space, swing.gains)) is None:
        # which of several frames that move the end effector nearly alike is a guess, so no joint is named
        said = {"frame": space.machine.frame_names[swing.frame], "component": COMPONENTS[swing.component]}
        where = f"; it swings most nearly as {said['frame']} {said['component']} would: noise"
    else:
        joint = space.machine.joint_names[whose[0]]
        said = {"joint": joint, "frame": joint, "component": COMPONENTS[whose[1]]}
        where = f"; {joint} swings, in {said['component']}: noise"
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


def _ends(space: Workspace, size: Array) -> tuple[float, float, float]:
    """rms [m] of readings in the fifths of the fit visits with the largest and the smallest sizes (F,), and the
    standard deviation of their ratio, by how visits of a fifth differ."""
    left, seen = space.residual()[space.fit].reshape(len(size), -1), space.recording.seen[space.fit].sum(axis=1)
    fifth = max(2, len(size) // 5)
    order = np.argsort(size)
    means, shares = [], []
    for some in (order[-fifth:], order[:fifth]):
        square = np.nansum(left[some] ** 2, axis=1) / np.maximum(seen[some], 1)
        means.append(float(square.mean()))
        shares.append(float(square.var(ddof=1) / fifth / max(square.mean(), 1e-300) ** 2))
    most, least = (max(mean, 1e-300) ** 0.5 for mean in means)
    return most, least, most / least * 0.5 * sum(shares) ** 0.5


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


def _left_by_forms(space: Workspace) -> Array:
    """(N, K) log mean squares of white noise and of a share of what was found, whole and beyond what the base model
    takes: a real effect differs from its form the more, the more it moves."""
    moved = np.stack([space.moved(), space.beyond(space.moved())], axis=2)
    square = ((space.root @ moved) ** 2).mean(axis=1)
    return np.asarray(np.log1p(square[:, :, None] * np.array(SHARES) ** 2).reshape(len(square), -1))


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
    """Where a link swings, how much likelier that is than even noise (log), of how many tried; gains (n+1, 6) of every
    component of every frame; calming as `Scatter`."""

    frame: int
    component: int
    gain: float
    tried: int
    calming: Array
    gains: Array


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
    return _Swing(frame, component, float(gains.max()), gains.size, calming, gains.max(axis=0))


def _whose(space: Workspace, gains: Array) -> tuple[int, int] | None:
    """The joint whose swinging is likelier than that of all others and of the base together, and the component of its
    frame; None where it is not surely. gains (n+1, 6) log likelihoods by which each component's swinging is ahead of
    even noise."""
    prior = np.full(gains.shape, (1.0 - ALONG_ITS_WAY) / 5)
    for k in range(len(prior) - 1):
        prior[k + 1, nearest_component(space.context, k)] = ALONG_ITS_WAY
    prior[0] = OF_THE_BASE / 6
    likely = np.log(prior) + gains
    likely = np.exp(likely - likely.max())
    of_each = likely.sum(axis=1) / likely.sum()
    frame = int(np.argmax(of_each))
    return None if frame == 0 or of_each[frame] < SURELY else (frame - 1, int(np.argmax(likely[frame])))


def _gain_of(space: Workspace, residual: Array, spread: Array) -> float:
    """How much likelier (log) residuals (F, 3T) are with noise that grows alike in all directions (N,) than with even
    noise."""
    freedom = 3 * space.recording.seen.sum(axis=1)[space.fit]
    grows = spread[space.fit]
    return float((0.5 * (residual**2).sum(axis=1) * (1 - 1 / grows**2) - freedom * np.log(grows)).sum())
