"""An effect beyond model (17) that a diagnosis found: columns and coefficients, as a calibration carries them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.model import Model
from ppshw.packed import packed, unpacked
from ppshw.recording import Recording
from ppshw.terms.shapes import Column, Context

Array = NDArray[np.float64]
UNNAMED = "unexplained"  # what a correction without a name is called
OF_REFLECTORS = frozenset({"target_shift", "carrier_shift"})  # functions that move no other point
BEYOND_C = 0.1  # what thermometers of a hall read one another apart


@dataclass(frozen=True)
class Effect:
    """name: the contract's; joint: where, None for none; columns with values and standard deviations (k,);
    sentence: what it is in plain words; correlation: (k, k) of the values' errors, empty where they have none;
    mimicked: (k, p) parameters by which the base model would take what it can of each column, of size one; empty where
    that is not known, as of an effect written by hand."""

    name: str
    joint: str | None
    columns: tuple[Column, ...]
    values: tuple[float, ...]
    std: tuple[float, ...]
    sentence: str
    correlation: tuple[tuple[float, ...], ...] = ()
    mimicked: Array = field(default_factory=lambda: np.zeros((0, 0)), compare=False, repr=False)

    @cached_property  # asked for at every setpoint
    def spread(self) -> Array:
        """(k, k) whose rows, each of one independent unit normal, are together how unsure the values are."""
        std = np.array(self.std)
        if not self.correlation:
            return np.diag(std)
        size, ways = np.linalg.eigh(np.array(self.correlation))
        return np.asarray((ways * np.sqrt(np.maximum(size, 0.0))).T * std)

    def mimicked_by(self, count: int) -> Array:
        """(k, count) `mimicked`, by nothing where that is not known."""
        return self.mimicked if self.mimicked.size else np.zeros((len(self.columns), count))

    @cached_property  # asked for at every column of every setpoint
    def of_instrument(self) -> bool:
        """Whether it is an error of the instrument's readings, all of it, and no axis may follow it."""
        return any(column.on == "points" for column in self.columns)

    @property
    def places(self) -> list[str]:
        """The places whose temperature it goes by, each once."""
        return list(dict.fromkeys(str(c.args["place"]) for c in self.columns if c.args.get("place")))

    @property
    def over(self) -> list[str]:
        """The recording's columns of its own (cov_) that it goes by, each once."""
        names = (str(c.args.get("name", "")) for c in self.columns)
        return [name for name in dict.fromkeys(names) if name.startswith("cov_")]

    @property
    def unnamed_over(self) -> list[str]:
        """The recording's columns that a correction without a name goes by, each once."""
        return list(dict.fromkeys(name for c in self.columns for name in c.args.get("names", ())))

    def as_dict(self) -> dict[str, Any]:
        return {
            "effect": self.name, "joint": self.joint, "sentence": self.sentence,
            "columns": [c.as_dict() for c in self.columns], "values": list(self.values), "std": list(self.std),
            "correlation": [list(row) for row in self.correlation],
            "mimicked": packed(self.mimicked),
        }  # fmt: skip

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Effect:
        columns = tuple(Column.from_dict(c) for c in data["columns"])
        values, std = (tuple(float(x) for x in data[key]) for key in ("values", "std"))
        if not len(columns) == len(values) == len(std):
            raise ValueError(f"{len(values)} values for {len(columns)} columns of {data['effect']}")
        correlation = tuple(tuple(float(x) for x in row) for row in data.get("correlation", ()))
        if correlation and np.shape(correlation) != (len(std), len(std)):
            raise ValueError(f"correlation of {data['effect']} is not of {len(std)} by {len(std)}")
        mimicked = unpacked(data["mimicked"]) if "mimicked" in data else np.zeros((0, 0))
        if mimicked.size and len(mimicked) != len(columns):
            raise ValueError(f"mimicked of {data['effect']} is not of {len(columns)} rows")
        return cls(data["effect"], data["joint"], columns, values, std, data["sentence"], correlation, mimicked)


def instrument_error(
    effects: Sequence[Effect], model: Model, theta: Array, recording: Recording, measuring_in_base: Array,
    reference: dict[str, float], points: Array,
) -> Array:  # fmt: skip
    """What an erring instrument adds to its readings of any points, beside the reflectors that identified it.

    points   (N, 3) in the base frame, one per visit [m];  a reflector that moved moves no other point
    returns  (N, 3) in the base frame [m]
    """
    context = Context.of(model, theta, recording, measuring_in_base, dict(reference))
    context = replace(context, points=points[:, None])
    out = np.zeros((len(recording), 1, 3))
    for effect in filter(lambda effect: effect.of_instrument, effects):
        for column, value in zip(effect.columns, effect.values, strict=True):
            of_reflectors = {column.function, column.args.get("column", {}).get("function")} & OF_REFLECTORS
            if column.on != "points" and effect.name == UNNAMED:  # beside structure without a name: the machine's
                continue
            if column.on == "frame":  # a scale about another place than the instrument's shifts all that it sees
                out[:, 0, column.component] += value * column.value(context)
            elif not of_reflectors:
                out += value * column.evaluate(context).reshape(out.shape)
    return np.asarray(out[:, 0])


def is_beyond(here: Array, low: float, high: float) -> NDArray[np.bool_]:
    """Whether thermometers stand where they never stood while an effect was measured, low to high [°C]."""
    return np.asarray((here < low - BEYOND_C) | (here > high + BEYOND_C))
