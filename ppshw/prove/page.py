"""The table of `ppshw prove` as markdown and as a page with a picture, which needs nothing else."""

from __future__ import annotations

import html
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ppshw.prove.table import percent, points, single
from ppshw.report.picture import AFTER, FAINT, MARK, Picture, canvas
from ppshw.whole_file import write_text

Json = dict[str, Any]
STYLE = (
    "body{font:15px sans-serif;max-width:70em;margin:2em auto}"
    "td,th{padding:.15em .7em;text-align:left}img{max-width:100%}table{margin-bottom:1em}h2{font-size:1.1em}"
)


def markdown(document: Json) -> str:
    lines = [
        "# Concealed cases",
        "",
        f"{document['cases']} cases, {len(document['lost'])} lost. Shares with their 90 % interval.",
        "",
    ]
    lines += ["## Bars", "", "| bar | met | found |", "|---|---|---|"]
    lines += [f"| {b['what']} | {b['met']} | {b['text']} |" for b in document["bars"]]
    lines += [
        "",
        "## By effect and size",
        "",
        "| effect | size | detected | named | joint | in aliases | wrong name | √λ | bound | realised | s |",
        "|" + "---|" * 11,
    ]
    for r in document["effects"]:
        cells = [
            r["effect"],
            f"{r['size']:g} ×",
            *(_short(r[k]) for k in ("detected", "named", "joint", "in_aliases", "wrong")),
        ]
        cells += [
            _number(r["sqrt_lambda"], ".1f"),
            _number(r["bound"], ".0%"),
            _number(r["realised"], ".0%"),
            _number(r["seconds"], ".1f"),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    lines += ["", "## By visible strength", ""]
    lines += ["| √λ beside priors | detected | bound | named | in aliases | wrong name |", "|" + "---|" * 6]
    for r in document["strengths"]:
        span = f"{r['from']:g} and more" if r["to"] is None else f"{r['from']:g} to {r['to']:g}"
        cells = [
            span,
            _short(r["detected"]),
            _number(r["bound"], ".0%"),
            *(_short(r[k]) for k in ("named", "in_aliases", "wrong")),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    lines += ["", "## Names by their weight", "", "| weight of a name | mean | right |", "|---|---|---|"]
    lines += [
        f"| {r['from']:g} to {r['to']:g} | {r['mean']:.2f} | {percent(r['right'])} |" for r in document["weights"]
    ]
    if document["removed"]:
        lines += ["", "## Names taken out of the library", ""]
        lines += ["| left out | form | names given | unexplained | √λ | left |", "|" + "---|" * 6]
    for r in document["removed"]:
        cells = [r["effect"], r["form"], ", ".join(r["names"]) or "–", "yes" if r["unexplained"] else "no"]
        cells += [_number(r["sqrt_lambda"], ".1f"), _number(r["sqrt_lambda_left"], ".1f")]
        lines.append("| " + " | ".join(cells) + " |")
    lines += ["", *(f"Lost: case {name}, {why}" for name, why in document["lost"].items())]
    return "\n".join(lines) + "\n"


def _short(found: Json) -> str:
    return f"{found['hits']}/{found['of']}" if found["of"] else "–"


def _number(value: float | None, how: str) -> str:
    return "–" if value is None else format(value, how)


def power_picture(document: Json, scores: Sequence[Json]) -> Picture:
    """Found or not against visible strength, with the bound: every case a mark, every bin a share with its interval."""
    strength, detected = points(scores)
    powers = [s["truth"][0]["power"] for s in single(scores) if s["truth"][0]["sqrt_lambda"] is not None]
    with canvas(6.4, 3.6) as c:
        shown = np.clip(strength, 0.0, 20.0)
        jitter = 0.02 * np.random.default_rng(0).normal(size=len(shown))
        c.axes.plot(shown, np.array(detected, dtype=float) + jitter, ".", color=FAINT, ms=4, label="a case")
        order = np.argsort(strength)
        c.axes.plot(shown[order], np.array(powers)[order], color=MARK, label="bound: test of the true form")
        for k, r in enumerate(document["strengths"]):
            among = (np.array(strength) >= r["from"]) & (np.array(strength) < (r["to"] or np.inf))
            at = float(shown[among].mean()) if among.any() else r["from"]
            d = r["detected"]
            c.axes.errorbar(
                at,
                d["share"],
                [[d["share"] - d["low"]], [d["high"] - d["share"]]],
                fmt="o",
                color=AFTER,
                capsize=3,
                label=None if k else "share detected, 90 % interval",
            )
        c.axes.set(
            xlabel="visible strength √λ (20: and more)",
            ylabel="share detected",
            ylim=(-0.08, 1.08),
            xlim=(0, 20.5),
        )
        c.axes.legend(loc="center right")
        half = document["half_power"]
        alt = f"{len(strength)} cases; half of them detected at √λ = {half:.1f}" if half else f"{len(strength)} cases"
        return c.picture("Detected against what could be detected", alt, "Blue: shares with 90 % intervals.")


def write_page(out: Path, document: Json, scores: Sequence[Json]) -> None:
    """prove.md and prove.html, the latter with a picture and nothing from outside."""
    text = markdown(document)
    write_text(out / "prove.md", text)
    drawn = "".join(_figure(p) for p in ([power_picture(document, scores)] if single(scores) else []))
    head = f"<!doctype html><meta charset='utf-8'><title>Concealed cases</title><style>{STYLE}</style>"
    write_text(out / "prove.html", head + _tables(text) + drawn)


def _figure(p: Picture) -> str:
    caption = f"<figcaption>{html.escape(p.title)}. {html.escape(p.note)}</figcaption>"
    return f"<figure><img src='{p.src}' alt='{html.escape(p.alt)}'>{caption}</figure>"


def _tables(text: str) -> str:
    """The markdown that `markdown` writes, and no other, as HTML."""
    out: list[str] = []
    lines = [*text.splitlines(), ""]
    for line, following in pairwise(lines):
        if line.startswith("|---"):
            continue
        if line.startswith("|"):
            tag = "th" if following.startswith("|---") else "td"
            cells = "".join(f"<{tag}>{html.escape(c.strip())}</{tag}>" for c in line.strip("|").split("|"))
            out.append(f"{'<table>' if tag == 'th' else ''}<tr>{cells}</tr>")
            out += [] if following.startswith("|") else ["</table>"]
        elif line.startswith("#"):
            level = line.index(" ")
            out.append(f"<h{level}>{html.escape(line[level + 1 :])}</h{level}>")
        elif line:
            out.append(f"<p>{html.escape(line)}</p>")
    return "".join(out)
