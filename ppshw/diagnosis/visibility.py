"""What a recording can show, before any fit: per effect and joint the share that the base model leaves visible, the
size that would be found, and what it could be taken for.

A form with columns Z moves the reflectors by a field f, the sum of its columns at unit rms. Of its fᵀ R⁻¹ f the base
model leaves the noncentrality λ = fᵀ V⁻¹ f (docs/diagnosis-method.md §2); the score along f is then √λ + N(0, 1). An
effect is found when the evidence of its name reaches what a first finding needs. That evidence grows as a u² − b with
the score u, and b says what the name pays for the forms it tries; so the score needed is known, and 90 % are found from
√λ = u + 1.28 on. λ is that of the search, with its freer prior strengths; shares are those of the base model itself,
with the strengths that it learnt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.evidence import CHUNK, FIRST, LEAST_FIRST, LEAST_SHARE, Name, Tried
from ppshw.diagnosis.kinship import that_hold
from ppshw.diagnosis.library import Candidate
from ppshw.quantities import called

Array = NDArray[np.float64]
Single = NDArray[np.float32]
# Nine draws of ten of a standard normal are above −1.28.
NINE_OF_TEN = 1.28
# Draws of the noise that say which evidence chance alone reaches; what 1 − FIRST of them stay under is good to a third
# of a unit.
NOISE_DRAWS = 199
# Scores at which a name's evidence is looked at, on both sides of where it becomes enough.
LOOKED_AT = (4.0, 6.0)
# √λ needed for a form that the base model takes whole: a middling figure, as nothing can be computed for it.
SEEN_AT = 6.0
NEVER = 1.0  # a size [m] that is no answer
# Names are aliases when so much of what one shows is what another can show as well.
ALIAS = 0.9
OF_RULED_OUT = 48  # forms of the force sensor's error that stand for all, where its readings rule some out
AT_A_TIME = 32  # names of which the scores of all columns are looked at: of all of them they are as much as the columns
# √λ at which a test of exactly the true form finds every other case, family-wise over 35 names, and at which half of
# the recordings would say which of two it is (docs/prove.md, half power).
TOLD_APART = 3.2


@dataclass(frozen=True)
class Alias:
    """Another name a form of which shows nearly what a name's form shows.

    alike  the share of it that it shows too, ALIAS to 1
    apart  √λ of the rest: by how many standard deviations of noise this recording tells them apart, at that form's size
    never  whether machines are known whose form of it nothing that is measured tells from that name's
    """

    name: Name
    alike: float
    apart: float
    never: bool = False

    def as_dict(self) -> dict[str, Any]:
        return {"effect": self.name[0], "joint": self.name[1], "alike": round(self.alike, 3),
                "sqrt_lambda_apart": round(self.apart, 2), "never_told_apart": self.never}  # fmt: skip


def is_told_apart(alias: Mapping[str, Any]) -> bool:
    """Of one in the answer (contract §4), whether this recording tells it from the finding's name."""
    return not alias.get("never_told_apart") and bool(alias["sqrt_lambda_apart"] >= TOLD_APART)


@dataclass(frozen=True)
class Sight:
    """How well one name is seen, its forms weighed by their prior shares.

    name        (effect, joint)
    form        index of its typical form, the one of middling visibility
    share       of the typical form's squared size that is left after the base model; shares: a tenth and nine tenths
                of its forms lie below, the typical one between
    seen_at     √λ of the typical form that 90 % find
    detectable  rms at the reflectors that 90 % find [m], of the typical form; detectables: of its best and worst tenth;
                NEVER where the base model leaves nothing of such a form
    aliases     names a form of which shows ALIAS or more of what the typical form shows
    visible     whether the base model leaves anything of the typical form
    """

    name: Name
    form: int
    share: float
    shares: tuple[float, float]
    seen_at: float
    detectable: float
    detectables: tuple[float, float]
    aliases: tuple[Name, ...]
    visible: bool = True


def visibility(tried: Tried) -> list[dict[str, Any]]:
    """One row per effect and joint (contract §4), of the form of middling visibility; `share_range` and
    `detectable_range_mm`: what four fifths of its forms, weighed by their shares, lie within. Forms that the force
    sensor's readings rule out are no less visible."""
    enough = least(tried)
    seen = {sight.name: sight for sight in sights(tried, enough=enough)}
    if tried.ruled_out:
        names = {(k.effect, k.joint) for k in tried.ruled_out}
        beside = [k for k in tried.candidates if (k.effect, k.joint) in names]
        some, weights = thinned([*beside, *tried.ruled_out], OF_RULED_OUT)
        every = Tried(tried.space, some, tried.unit)
        seen |= {sight.name: sight for sight in sights(every, weights, tried, enough)}
    return [row(sight) for sight in seen.values()]


def row(sight: Sight) -> dict[str, Any]:
    """A sight in the contract's words; millimetres, NEVER where no size below would show."""
    sizes = [1e3 * min(x, NEVER) for x in (sight.detectable, *sight.detectables)]
    return {
        "effect": sight.name[0], "joint": sight.name[1], "share": sight.share,
        "detectable_mm": sizes[0],
        "aliases": sorted({effect for effect, _ in sight.aliases if effect != sight.name[0]}),
        "share_range": list(sight.shares), "detectable_range_mm": sizes[1:],
    }  # fmt: skip


def sights(
    tried: Tried, weights: Array | None = None, among: Tried | None = None, enough: float | None = None
) -> list[Sight]:
    """How well every name is seen, given the base model alone.

    weights  (C,) how many forms each candidate stands for; the candidates' shares by default
    among    where the aliases are looked for, where `tried` is only some names
    enough   the evidence that a first finding needs: of `tried` by default
    """
    among = among or tried
    enough = least(tried) if enough is None else enough
    weights = np.array([k.share for k in tried.candidates]) if weights is None else weights
    seen, shares = _of_forms(tried)
    names = [j for j, name in enumerate(tried.names) if name[0] != "nameless"]
    per_column = seen / _widths(tried)
    spread = [_by_visibility(np.flatnonzero(tried.name_of == j), per_column, weights) for j in names]
    forms = np.array([middle for _, middle, _ in spread], dtype=int)
    if not len(forms):
        return []
    needed, alike = np.empty(len(names)), np.empty((len(names), len(among.names)))
    for at in range(0, len(names), AT_A_TIME):
        part = slice(at, at + AT_A_TIME)
        along = directions(tried, forms[part])
        scores = across(tried, along)
        needed[part] = _needed(tried, np.array(names[part]), scores, enough) + NINE_OF_TEN
        alike[part] = mimicked(among, scores if among is tried else across(among, along))
    needed[seen[forms] == 0.0] = SEEN_AT  # nothing of the form is left: for the order of magnitude
    out = []
    for a, (j, three) in enumerate(zip(names, spread, strict=True)):
        sizes = (float(needed[a] * _rms(tried, k) / np.sqrt(seen[k])) if seen[k] > 0.0 else NEVER for k in three)
        worst, typical, best = sizes
        name, middle = tried.names[j], three[1]
        visible, share = bool(seen[middle] > 0.0), float(shares[middle])
        wider = (name, *that_hold(name, tried.space.machine.joint_names[-1]))
        aliases = [
            other for other, how in zip(among.names, alike[a], strict=True) if how > ALIAS and other not in wider
        ]
        low, high = _tenths(tried.name_of == j, shares, weights)
        out.append(
            Sight(
                name, middle, share, (min(low, share), max(high, share)), float(needed[a]), typical,
                (min(best, typical), max(worst, typical)), tuple(aliases) if visible else (), visible,
            )
        )  # fmt: skip
    return out


def least(tried: Tried) -> float:
    """The evidence that a first finding needs: real odds, and more than noise alone reaches.

    The search asks its own recording with random signs (docs/diagnosis-method.md §4); here white noise is asked, before
    any residual.
    """
    rng = np.random.default_rng(NOISE_DRAWS)
    chance = tried.by_name(tried.evidence_alone(tried.laid.of_noise(rng, NOISE_DRAWS).T)).max(axis=1)
    return max(LEAST_FIRST, float(np.quantile(chance, 1.0 - FIRST)))


def _of_forms(tried: Tried) -> tuple[Array, Array]:
    """(C,) what is left of every form, its columns at unit rms and alike, to whoever searches; and the share (C,) that
    the base model itself leaves; 0 of what has no name.

    With G = (1 + s²)^−½ Aᵀz, A = R⁻½ X Λ½ W, AᵀA = diag s² (`laid`), zᵀR⁻¹z = zᵀV⁻¹z + |G|²; and with prior strengths κ
    times smaller, one κ for every parameter, D = κ² − 1 and B = 1 + W s² Wᵀ,

        zᵀV₁⁻¹z = zᵀV⁻¹z + hᵀ (1 + D½ B⁻¹ D½)⁻¹ h,    h = D½ W (1 + s²)^−½ G
    """
    laid, caution = tried.laid, tried.space.caution
    more_free = np.maximum(caution**2 - 1.0, 0.0)
    freed = np.sqrt(more_free)[:, None] * laid.turn / np.sqrt(1.0 + laid.lengths)
    held = freed * np.sqrt(laid.lengths)  # B⁻¹ = 1 − W s² (1 + s²)⁻¹ Wᵀ, whatever W leaves out has s = 0
    inner = np.diag(1.0 + more_free) - held @ held.T
    regained = np.linalg.solve(np.linalg.cholesky(inner), freed).T.astype(np.float32)
    seen, more = np.zeros(len(tried.candidates)), np.zeros((len(tried.candidates), 2))
    for batch, info in tried.named():
        seen[batch.which] = info.sum(axis=(1, 2))
        for at in range(0, len(batch.which), CHUNK):
            part = slice(at, at + CHUNK)
            taken = laid.taken(batch.columns[part]).sum(axis=1)
            more[batch.which[part], 0] = (taken**2).sum(axis=1)
            more[batch.which[part], 1] = ((taken @ regained) ** 2).sum(axis=1)
    plain = np.maximum(seen + more[:, 0], 1e-30)
    shares = (seen + more[:, 1]) / plain
    # of a form of which rounding is all that is left nothing is seen; one that the search does not try, because a
    # single column of it is taken whole, may be found by another form of its name
    return np.where(seen > LEAST_SHARE * plain, seen, 0.0), np.clip(shares, 0.0, 1.0)


def _widths(tried: Tried) -> Array:
    """(C,) number of columns: the mean square of a form whose columns, at unit rms, have nothing in common."""
    return np.array([float(len(i)) for i in tried.index])


def displaced(tried: Tried, form: int) -> Array:
    """(N, 3T) the typical field of a candidate, base axes [m]: its columns at unit rms, alike."""
    candidate, scale = tried.candidates[form], tried.scale[tried.index[form]]
    fields = [column.evaluate(tried.space.context) / s for column, s in zip(candidate.columns, scale, strict=True)]
    return np.asarray(np.sum(fields, axis=0))


def _rms(tried: Tried, form: int) -> float:
    """rms at the reflectors of the same: 1 for a single column."""
    if len(tried.index[form]) == 1:
        return 1.0
    readings = max(int(tried.space.recording.seen.sum()), 1)
    return float(np.sqrt((displaced(tried, form) ** 2).sum() / readings))


def aliases_of(
    tried: Tried, name: Name, form: int | None = None, coefficients: Array | None = None, never: Name | None = None
) -> list[Alias]:
    """Names a form of which shows 90 % or more of what this one shows, given the base model alone.

    form          index of the candidate that stands for the name (a finding's `best`); None: the typical one
    coefficients  of the candidate's columns as fitted; None: all columns alike, at the rms at the reflectors that nine
                  of ten recordings show
    never         a name that nothing tells from this one (`weights.as_well`), the first whatever a form of it shows
    returns       names other than the asked one, the likeliest to be mistaken first; the same effect at another joint
                  counts
    """
    strength = SEEN_AT
    if form is None:
        seen, _ = _of_forms(tried)
        mine = np.flatnonzero(tried.name_of == tried.names.index(name))
        form = _by_visibility(mine, seen / _widths(tried), np.array([k.share for k in tried.candidates]))[1]
    scaled = None if coefficients is None else [coefficients * tried.scale[tried.index[form]]]
    if scaled is not None:
        field = scaled[0] @ tried.laid.rows(tried.index[form])
        strength = float(np.sqrt(max(field @ tried.space.absorb(field[:, None])[:, 0], 0.0)))
    wider = (name, *that_hold(name, tried.space.machine.joint_names[-1]))
    alike = mimicked(tried, across(tried, directions(tried, np.array([form]), scaled)))[0]
    out = [
        Alias(other, float(share), strength * float(np.sqrt(1.0 - share)), other == never)
        for other, share in zip(tried.names, alike, strict=True)
        if other == never or (share > ALIAS and other not in wider and other[0] != "nameless")
    ]
    return sorted(out, key=lambda alias: (not alias.never, -alias.alike))


def alias_words(name: Name, aliases: Sequence[Alias]) -> str:
    """What a finding's sentence says of its aliases; empty without."""
    one = [a for a in aliases if a.never or a.apart < TOLD_APART]
    far = [a for a in aliases if a not in one]
    out = f" This recording cannot tell it from {_listed(name, one)}." if one else ""
    if far:
        least = min(a.apart for a in far)
        apart = f"though such recordings tell them apart by {least:.0f} standard deviations"
        out += f" Nearly like it, {apart}: {_listed(name, far)}."
    return out


def _listed(name: Name, aliases: Sequence[Alias]) -> str:
    said = [called(a.name[0], None if a.name[1] == name[1] else a.name[1]) for a in aliases[:3]]
    return ", ".join(said) + ("" if len(aliases) <= 3 else f" or {len(aliases) - 3} more")


def thinned(candidates: Sequence[Candidate], most: int = 12) -> tuple[list[Candidate], Array]:
    """At most so many candidates of each name, drawn evenly along their summed shares, and how many draws fell on each.

    The shares stay as they were: a period or a moment that stands for others still pays for them.
    """
    of_name: dict[Name, list[Candidate]] = {}
    for k in candidates:
        of_name.setdefault((k.effect, k.joint), []).append(k)
    kept: list[Candidate] = []
    weights: list[float] = []
    for mine in of_name.values():
        sums = np.cumsum([k.share for k in mine])
        at = np.searchsorted(sums, (np.arange(most) + 0.5) / most * sums[-1])
        chosen, times = np.unique(np.minimum(at, len(mine) - 1), return_counts=True)
        kept += [mine[c] for c in chosen]
        weights += times.tolist()
    return kept, np.array(weights, dtype=float)


def _by_visibility(mine: NDArray[np.int64], seen: Array, weights: Array) -> tuple[int, int, int]:
    """The candidates of a name that a tenth, half and nine tenths of its weight are seen worse than."""
    order = mine[np.argsort(seen[mine], kind="stable")]
    sums = np.cumsum(weights[order])
    at = np.searchsorted(sums, np.array([0.1, 0.5, 0.9]) * sums[-1])
    low, middle, high = order[np.minimum(at, len(order) - 1)]
    return int(low), int(middle), int(high)


def _tenths(mine: NDArray[np.bool_], values: Array, weights: Array) -> tuple[float, float]:
    """What a tenth and nine tenths of the weight lie below."""
    order = np.argsort(values[mine], kind="stable")
    sums = np.cumsum(weights[mine][order])
    at = np.searchsorted(sums, np.array([0.1, 0.9]) * sums[-1])
    low, high = values[mine][order][np.minimum(at, len(order) - 1)]
    return float(low), float(high)


def directions(tried: Tried, forms: NDArray[np.int64], coefficients: Sequence[Array] | None = None) -> Array:
    """(F, R) whitened readings that each form shows, √λ = 1 once the base model had its share.

    coefficients  of each form's columns at unit rms; all alike by default
    """
    out = np.empty((len(forms), len(tried.space.y)))
    for k, form in enumerate(forms):
        columns = tried.laid.rows(tried.index[form])
        out[k] = columns.sum(axis=0) if coefficients is None else coefficients[k] @ columns
    seen = np.einsum("fr,rf->f", out, tried.space.absorb(out.T))
    return np.asarray(out / np.sqrt(np.maximum(seen, 1e-24))[:, None])


def across(tried: Tried, along: Array) -> Single:
    """(F, K) scores of all columns for fields along the directions."""
    return tried.laid.product(tried.space.absorb(along.T)).T


def _needed(tried: Tried, names: NDArray[np.int64], scores: Single, enough: float) -> Array:
    """(F,) the score along each name's form at which the evidence of the name is enough for a first finding."""
    evidence = tried.evidence_of_names(np.concatenate([u * scores for u in LOOKED_AT]))
    values = evidence.reshape(len(LOOKED_AT), len(names), -1)[:, np.arange(len(names)), names]
    one, two = LOOKED_AT
    finite = np.isfinite(values[0]) & np.isfinite(values[1])
    low, high = (np.where(finite, v, 0.0) for v in values)
    slope = (high - low) / (two**2 - one**2)
    good = finite & (slope > 0)
    square = one**2 + (enough - low) / np.where(good, slope, 1.0)
    return np.where(good, np.sqrt(np.clip(square, 1.0, 400.0)), SEEN_AT - NINE_OF_TEN)


def mimicked(tried: Tried, scores: Array | Single) -> Array:
    """(F, names) the largest share of what each direction shows that a single form of another name shows as well:

        gᵀ I⁻¹ g,   g the scores of the form's columns, I their information      (squared multiple correlation)

    0 of what has no name.
    """
    out = np.zeros((len(scores), len(tried.names)))
    for batch, info in tried.named():
        g = scores[:, batch.columns].transpose(1, 2, 0)  # (C, k, F)
        rounding = 1e-6 * np.einsum("ckk->ck", info) + 1e-30
        inner = np.linalg.solve(info + rounding[:, :, None] * np.eye(info.shape[1]), g)
        alike = np.einsum("ckf,ckf->cf", g, inner)
        alike = np.where(np.isfinite(tried.log_share[batch.which])[:, None], alike, 0.0)
        of = tried.name_of[batch.which]
        for j in np.unique(of):
            out[:, j] = np.maximum(out[:, j], alike[of == j].max(axis=0))
    return np.minimum(out, 1.0)
