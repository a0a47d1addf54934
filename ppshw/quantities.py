"""Numbers with their units, and names, for the eye: what is printed, never what is written for programs; and numbers as
people write them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


def number(text: str) -> float:
    """Of a cell or an argument. Raises ValueError."""
    if "_" in text:  # Python reads 1_000 as a number
        raise ValueError
    return float(text)


def many(count: int, what: str) -> str:
    """`1 visit`, `2 visits`."""
    return f"{count} {what}{'s' * (count != 1)}"


def distance(metres: float) -> str:
    """How far something is off, to three digits and without an exponent: in mm below a metre, else in m.

    What is less than half a nanometre is 0 mm: no arithmetic here is better, let alone a machine.
    """
    return f"{rounded(metres)} m" if abs(metres) >= 1.0 else f"{rounded(round(metres * 1e3, 6))} mm"


def angle(radians: float) -> str:
    """How far something is turned, as `distance` says how far it is off: in mrad below a radian, else in rad."""
    return f"{rounded(radians)} rad" if abs(radians) >= 1.0 else f"{rounded(round(radians * 1e3, 6))} mrad"


def rounded(value: float) -> str:
    """Three digits without an exponent, the rest filled with zeros: 2.62e+03 is 2620, 5e-05 is 0.00005."""
    return np.format_float_positional(float(f"{value:.3g}"), trim="-")


def called(effect: str, joint: str | None = None) -> str:
    """An effect in plain words, and whose it is."""
    words = "no name" if effect == "nameless" else effect.replace("_", " ")
    return f"{words} of {joint}" if joint else words


def value_of(p: Mapping[str, Any]) -> str:
    """A parameter for the eye: lengths in mm or µm, angles in mrad or µrad, to the second digit of what is unsure.

    p  `value`, `unit`, and `std` where it is known, as in a finding's `parameters` (the contract, §4); an amount
       of m/… or rad/… is scaled too, every other unit stays as it is
    """
    value, std, unit = float(p["value"]), abs(float(p.get("std") or 0.0)), "" if p["unit"] == "1" else p["unit"]
    if unit.split("/")[0] in ("m", "rad"):
        factor, prefix = (1e3, "m") if max(abs(value), std) >= 1e-4 or value == std == 0.0 else (1e6, "µ")
        value, std, unit = value * factor, std * factor, prefix + unit
    largest = max(abs(value), std)
    if std > 0.0 and 1e-3 <= largest < 1e6:
        digits = max(0, 1 - math.floor(math.log10(std)))
        text = f"{value:.{digits}f} ± {std:.{digits}f}" if digits <= 6 else f"{value:.4g} ± {std:.1g}"
    else:
        text = f"{value:.4g}" + (f" ± {std:.1g}" if std else "")
    return f"{text} {unit}".strip().replace("-", "−")


def enumerated(words: Sequence[str]) -> str:
    """a, b and c"""
    return " and ".join(word for word in (", ".join(words[:-1]), *words[-1:]) if word)
