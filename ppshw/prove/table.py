"""Scores of many cases → counts: the bars with their intervals, effect by size, by visible strength, by weight."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.stats import binomtest

from ppshw.diagnosis.visibility import TOLD_APART

Json = dict[str, Any]
EDGES = (0.0, 2.0, 3.0, 4.0, 5.0, 6.0, 10.0, np.inf)  # of √λ
# Visible strength of an effect: what is left of it once the base model is projected out; and what is left beside a base
# model that its priors hold back, which is more.
STRENGTHS = {"sqrt_lambda_free": "√λ after projection", "sqrt_lambda": "√λ beside priors"}
WEIGHTS = (0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)


def summarise(scores: Sequence[Json]) -> Json:
    """What prove.json holds beside the counts: bars, effects, strengths, weights, half_power (by either strength).

    Cases whose name was taken out of the library count for one bar only.
    """
    removed = [s for s in scores if s.get("spec", {}).get("without")]
    scores = [s for s in scores if s not in removed]
    return {
        "bars": [*_bars(scores), _removed_bar(removed)],
        "removed": [
            {
                "effect": s["spec"]["without"],
                "form": s["truth"][0]["form"],
                "names": s["wrong"],
                "unexplained": s["answer"].get("unexplained") is not None,
                "sqrt_lambda": s["truth"][0].get("sqrt_lambda"),
                "sqrt_lambda_left": s.get("sqrt_lambda_left"),
            }
            for s in removed
        ],
        "effects": _by_effect(scores),
        "strengths": _by_strength(scores),
        "half_power": half_power(*points(scores)),
        "weights": _reliability(scores),
        "seconds": {
            "median": _median([s["seconds"] for s in scores]),
            "max": max((s["seconds"] for s in scores), default=None),
        },
    }


# --- counting -----------------------------------------------------------------------------------------------------
def share(hits: Iterable[bool]) -> Json:
    """How many of how many, and the 90 % interval of Clopper and Pearson: a dozen cases prove little, and say so."""
    marks = [bool(h) for h in hits]
    k, n = sum(marks), len(marks)
    if not n:
        return {"hits": 0, "of": 0, "share": None, "low": None, "high": None}
    low, high = binomtest(k, n).proportion_ci(0.90, method="exact")
    return {"hits": k, "of": n, "share": k / n, "low": float(low), "high": float(high)}


def single(scores: Sequence[Json], size: float | None = None) -> list[Json]:
    """Cases with one effect that has a name, of this size."""
    return [
        s for s in scores if len(s["truth"]) == 1 and s["truth"][0]["known"] and (size is None or s["size"] == size)
    ]


def _bars(scores: Sequence[Json]) -> list[Json]:
    """The bars of docs/figures.md. met: yes, no, or open where there is no such case."""
    strangers = [s for s in scores if s["unknown_ok"] is not None]
    pairs = [s for s in scores if len(s["truth"]) == 2]
    bars = [
        _bar(
            "nulls: anything found",
            "at most",
            0.05,
            [s["false_alarm"] for s in scores if not s["truth"]],
        )
    ]
    for size, wanted in ((0.5, 0.65), (1.0, 0.85), (2.0, 0.95)):
        mine = single(scores, size)
        bar = _bar(f"effect of {size:g} × repeatability: right name", "at least", wanted,
                   [s["named"][0] for s in mine], _bound(mine))  # fmt: skip
        bars.append(_with_what_is_left(bar, [s for s in mine if not s["named"][0]]))
    bars += [
        _bar("effect of 1 × repeatability: right joint when named", "at least", 0.95,
             [s["joint_right"][0] for s in single(scores, 1.0) if s["named"][0]]),
        _with_what_is_left(
            _bar("pair, 1 × each: both named", "at least", 0.75, [all(s["named"]) for s in pairs], _bound(pairs)),
            [s for s in pairs if not all(s["named"])],
        ),
        _bar("outside the catalogue, 1 ×: unexplained, or a fair neighbour", "at least", 0.85,
             [s["unknown_ok"] for s in strangers]),
        _bar("outside the catalogue, 1 ×: located", "at least", 0.80, [s["located"][0] for s in strangers]),
    ]  # fmt: skip
    for key, which in STRENGTHS.items():
        bars += _strength_bars(scores, key, which)
    return [*bars, *_number_bars(scores)]


def _strength_bars(scores: Sequence[Json], key: str, which: str) -> list[Json]:
    strong = [s for s in single(scores) if (s["truth"][0].get(key) or 0) >= 6]
    fair = [s for s in single(scores) if 5 <= (s["truth"][0].get(key) or 0) < 6]
    bars = [
        _bar(f"{which} ≥ 6: detected", "at least", 0.98, [s["detected"] for s in strong]),
        _bar(f"{which} ≥ 6: named within its alias set", "at least", 0.95, [s["in_aliases"][0] for s in strong]),
        _bar(f"{which} ≥ 6: wrong name", "at most", 0.02, [bool(s["wrong"]) for s in strong]),
        _bar(f"{which} 5–6: detected", "at least", 0.93, [s["detected"] for s in fair], _bound(fair)),
    ]
    if strong:
        bars[2]["text"] += f"; outside its alias set {sum(bool(s['wrong_apart']) for s in strong)}"
    half = half_power(*points(scores, key))
    met = "open" if half is None else "yes" if half <= 3.8 else "no"
    return [*bars, {"what": f"half power at {which}", "wanted": "at most 3.8", "met": met, "share": half,
                    "text": "no such √λ" if half is None else f"{half:.1f} (wanted at most 3.8)"}]  # fmt: skip


def _removed_bar(removed: Sequence[Json]) -> Json:
    """Other names for what has none; and how many of them leave so little of the truth that no recording tells."""
    other = [bool(set(s["wrong"]) - {s["spec"]["without"]}) for s in removed]
    bar = _bar("its name taken out of the library: another name", "at most", 0.10, other)
    return _with_what_is_left(bar, [s for s, wrong in zip(removed, other, strict=True) if wrong])


def _with_what_is_left(bar: Json, amiss: Sequence[Json]) -> Json:
    """A bar that also says of how many of its answers that were not right nobody could have told by the recording."""
    left = [s.get("sqrt_lambda_left") for s in amiss]
    bar["nobody_could_tell"] = sum(k is not None and k < TOLD_APART for k in left)
    if amiss:
        bar["text"] += f"; of the rest {bar['nobody_could_tell']} leave √λ < {TOLD_APART:g}"
    return bar


def _number_bars(scores: Sequence[Json]) -> list[Json]:
    realised = [s["held_out"]["realised"] for s in scores if s["held_out"] and s["held_out"]["realised"] is not None]
    longest = max((s["seconds"] for s in scores), default=None)
    gain, out = _median(realised), []
    met = "open" if gain is None else "yes" if gain >= 0.85 else "no"
    text = "no case" if gain is None else f"{100 * gain:.0f} % of {len(realised)} cases, median (wanted at least 85 %)"
    out.append(
        {
            "what": "held-out improvement realised",
            "wanted": "at least 85 %",
            "met": met,
            "share": gain,
            "text": text,
        }
    )
    met = "open" if longest is None else "yes" if longest <= 60 else "no"
    text = "no case" if longest is None else f"{longest:.0f} s (wanted at most 60 s)"
    out.append({"what": "longest diagnosis", "wanted": "at most 60 s", "met": met, "share": longest, "text": text})
    return out


def _bound(scores: Sequence[Json]) -> float | None:
    """The share that somebody would find who knew every form beforehand: the bound's power, of all effects of a case
    together; scatter, which has no such bound, counts as found."""
    every = [np.prod([1.0 if e["power"] is None else e["power"] for e in s["truth"]]) for s in scores]
    return float(np.mean(every)) if every else None


def _bar(what: str, way: str, wanted: float, hits: Sequence[bool], bound: float | None = None) -> Json:
    found = share(hits)
    if not found["of"]:
        return {"what": what, "wanted": f"{way} {100 * wanted:g} %", "met": "open", **found, "text": "no case"}
    met = found["share"] >= wanted if way == "at least" else found["share"] <= wanted
    most = "" if bound is None else f"; the bound {100 * bound:.0f} %"
    text = f"{percent(found)} (wanted {way} {100 * wanted:g} %{most})"
    return {
        "what": what,
        "wanted": f"{way} {100 * wanted:g} %",
        "met": "yes" if met else "no",
        **found,
        "bound": bound,
        "text": text,
    }


def percent(found: Json) -> str:
    if not found["of"]:
        return "–"
    return f"{100 * found['share']:.0f} % of {found['of']}, {100 * found['low']:.0f}–{100 * found['high']:.0f} %"


def _by_effect(scores: Sequence[Json]) -> list[Json]:
    """One row per effect and size, by name."""
    rows = []
    keys = sorted({(s["truth"][0]["effect"], s["size"]) for s in scores if len(s["truth"]) == 1})
    for effect, size in keys:
        mine = [s for s in scores if len(s["truth"]) == 1 and (s["truth"][0]["effect"], s["size"]) == (effect, size)]
        strengths = [s["truth"][0]["sqrt_lambda"] for s in mine if s["truth"][0]["sqrt_lambda"] is not None]
        powers = [s["truth"][0]["power"] for s in mine if s["truth"][0]["power"] is not None]
        realised = [s["held_out"]["realised"] for s in mine if s["held_out"] and s["held_out"]["realised"] is not None]
        rows.append({
            "effect": effect, "size": size, "known": mine[0]["truth"][0]["known"],
            "detected": share(s["detected"] for s in mine),
            "named": share(s["named"][0] for s in mine),
            "joint": share(s["joint_right"][0] for s in mine if s["named"][0]),
            "in_aliases": share(s["in_aliases"][0] for s in mine),
            "located": share(s["located"][0] for s in mine),
            "wrong": share(bool(s["wrong"]) for s in mine),
            "sqrt_lambda": _median(strengths), "bound": float(np.mean(powers)) if powers else None,
            "realised": _median(realised), "seconds": _median([s["seconds"] for s in mine]),
        })  # fmt: skip
    return rows


def _by_strength(scores: Sequence[Json]) -> list[Json]:
    rows = []
    known = [s for s in single(scores) if s["truth"][0]["sqrt_lambda"] is not None]
    for low, high in pairwise(EDGES):
        mine = [s for s in known if low <= s["truth"][0]["sqrt_lambda"] < high]
        if mine:
            rows.append({
                "from": low, "to": None if np.isinf(high) else high,
                "detected": share(s["detected"] for s in mine), "named": share(s["named"][0] for s in mine),
                "in_aliases": share(s["in_aliases"][0] for s in mine),
                "wrong": share(bool(s["wrong"]) for s in mine),
                "bound": float(np.mean([s["truth"][0]["power"] for s in mine])),
            })  # fmt: skip
    return rows


def points(scores: Sequence[Json], key: str = "sqrt_lambda") -> tuple[list[float], list[bool]]:
    known = [s for s in single(scores) if s["truth"][0].get(key) is not None]
    return [s["truth"][0][key] for s in known], [s["detected"] for s in known]


def half_power(strength: Sequence[float], detected: Sequence[bool]) -> float | None:
    """√λ at which half of the cases are detected: a logistic curve through yes and no; None without both, where it does
    not rise, and where that is no √λ between those of the cases (of 24 of which three of the loudest were missed −48).

    A faint ridge (one case's worth) keeps the slope finite where the two do not overlap.
    """
    x, y = np.asarray(strength, dtype=float), np.asarray(detected, dtype=float)
    if not 0 < y.sum() < len(y):
        return None

    def cost(p: np.ndarray[Any, np.dtype[np.float64]]) -> float:
        z = p[1] * (x - p[0])
        return float(np.sum(np.logaddexp(0.0, z) - y * z) + 0.02 * p[1] ** 2)

    fits = [minimize(cost, [start, 1.0], method="Nelder-Mead") for start in (2.0, 4.0, 8.0)]
    half, slope = min(fits, key=lambda f: float(f.fun)).x
    return float(half) if slope > 0.0 and x.min() <= half <= x.max() else None


def _reliability(scores: Sequence[Json]) -> list[Json]:
    """Of the names offered with a weight between two limits: the mean weight, and how many were right."""
    offered = [pair for s in scores for pair in s["weights"]]
    rows = []
    for low, high in pairwise(WEIGHTS):
        mine = [(w, r) for w, r in offered if low < w <= high]
        if mine:
            rows.append(
                {
                    "from": low,
                    "to": high,
                    "mean": float(np.mean([w for w, _ in mine])),
                    "right": share(r for _, r in mine),
                }
            )
    return rows


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) else None
