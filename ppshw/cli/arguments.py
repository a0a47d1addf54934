"""What the words of a command line mean: the machine, numbers, lengths. Words that mean nothing are bad input."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ppshw.errors import BadInput
from ppshw.quantities import number

LARGEST = 1e9  # that a number may be, in whatever unit


def machine_of(a: argparse.Namespace) -> Any:
    """The machine file of that path, or the one of that name that comes with ppshw."""
    from ppshw.machine import load_machine, shipped_machines

    if Path(a.machine).exists():
        return load_machine(a.machine)
    shipped = {file.stem: file for file in sorted(shipped_machines().glob("*.yaml"))}
    if a.machine not in shipped:
        raise BadInput(f"{a.machine}: no such file, and no machine of that name (there are: {', '.join(shipped)})")
    return load_machine(shipped[a.machine])


def numbers(words: Sequence[str], count: int, what: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """`count` numbers, given as one word or several, with spaces, commas or brackets around them."""
    text = " ".join(words).strip()
    try:
        values = np.array([number(w) for w in text.translate(_BETWEEN_NUMBERS).split()])
    except ValueError:
        raise BadInput(f"{what}: '{text}' holds something that is no number, expected {count} numbers") from None
    if len(values) != count:
        raise BadInput(f"{what}: '{text}' holds {len(values)} values, expected {count} finite numbers")
    for k, value in enumerate(values, start=1):
        if not abs(value) < LARGEST:
            which = f"value {k} of {count}, {value:g}," if count > 1 else f"{value:g}"
            raise BadInput(f"{what}: {which} is no finite number below {LARGEST:g}")
    return values


def joint_values(words: Sequence[str], machine: Any, what: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(n,) within the joints' limits [m, rad]."""
    values = numbers(words, machine.n, what)
    for q, joint, low, high in zip(values, machine.joints, *machine.limits(), strict=True):
        if not low <= q <= high:
            raise BadInput(f"{what} {joint.name}: {q:g} {joint.unit} is outside its limits {low:g} … {high:g}")
    return values


_BETWEEN_NUMBERS = str.maketrans(",;[]()", "      ")


def pairs(words: Sequence[str] | None, names: Sequence[str], what: str, of: str) -> dict[str, float]:
    """NAME=NUMBER words; names: those of a joint, say."""
    return {name: float(values[0]) for name, values in named_numbers(words, names, what, of, "NUMBER").items()}


def named_numbers(
    words: Sequence[str] | None, names: Sequence[str], what: str, of: str, expected: str
) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    """Words of a name and as many numbers as `expected` has, with commas between: R1=HZ,V,DISTANCE."""
    out = {}
    for word in words or ():
        name, _, text = word.strip().rpartition("=") if "=" in word else (word.strip(), "", "")
        if name not in names:
            raise BadInput(f"{what}: no {of} named '{name}', expected one of {', '.join(names) or 'none'}")
        if name in out:
            raise BadInput(f"{what} {name}: given twice, expected one value")
        if not text:
            raise BadInput(f"{what} {name}: no value, expected {name}={expected}")
        out[name] = numbers([text], len(expected.split(",")), f"{what} {name}")
    return out


def positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < math.inf:
        raise ValueError
    return value


def share(text: str) -> float:
    value = float(text)
    if not 0.0 <= value < math.inf:
        raise ValueError
    return value


def whole(text: str) -> int:
    value = int(text)
    if value < 0:
        raise ValueError
    return value


def seed(text: str) -> int:
    return whole(text)


def count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise ValueError
    return value


def length(text: str) -> float:
    """A length with its unit (mm, um, µm, m): without one, metres were meant by nobody."""
    found = _LENGTH.fullmatch(text.strip())
    if found is None:
        raise ValueError
    return positive(found[1]) * {"mm": 1e-3, "um": 1e-6, "µm": 1e-6, "m": 1.0}[found[2]]


_LENGTH = re.compile(r"([0-9.eE+-]+?) *(mm|um|µm|m)")
length.__name__ = "length such as 0.25mm, unit included,"
positive.__name__, whole.__name__ = "positive number", "number (0, 1, 2, …)"  # what argparse calls them
seed.__name__ = "seed (0, 1, 2, …)"
count.__name__, share.__name__ = "number of 1 or more", "share of 0 or more"
