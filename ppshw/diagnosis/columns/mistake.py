"""What is wrong with a column, or with several, and how much better the recording is without it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ppshw.diagnosis.evidence import LEAST_P

# A mistake is said when one column's correction takes the misfit to less than this share of what it was, and the misfit
# was gross: for positions in metres, for wrenches as a share of the wrench itself.
BETTER = 0.2
# Of a joint's sign, and of two that are exchanged: no joint's own error is a slope of -2 or another's position, and
# tilts of short travel move little.
BETTER_SIGN = 0.5
TO, PLURAL = " … ", {"has": "have", "is": "are"}
SIGN = {-1.0: "has the opposite sign"}
LENGTHS = {**SIGN, 1e-3: "is in millimetres, expected metres", 1e3: "is in kilometres, expected metres"}
ANGLES = {**SIGN, float(np.pi / 180): "is in degrees, expected radians"}
AXES = ((0, 1), (0, 2), (1, 2))


@dataclass(frozen=True)
class Mistake:
    """column times factor is what it should have been, None: columns are exchanged; what is wrong, said of one column;
    misfit before and after the correction [m], or shares of the wrench; how columns without a factor were set right."""

    column: str
    factor: float | None
    what: str
    before: float
    after: float
    done: str = "taken the other way round"

    def finding(self) -> dict[str, Any]:
        """In the contract's form (§4), under a name of its own."""
        factor = {} if self.factor is None else {"factor": {"value": self.factor, "std": 0.0, "unit": "1"}}
        were = "they were" if self.several else "it was"
        how = f"{were} {self.done}" if self.factor is None else f"{were} taken times {self.factor:g}"
        return {
            "effect": "column_mistake", "joint": None, "frame": None, "component": None, "covariate": self.column,
            "region": None, "parameters": factor,
            "p_value": LEAST_P, "rms_mm": None, "weight": 1.0, "alternatives": [], "aliases": [],
            "sentence": f"{self.said}; {how}.",
        }  # fmt: skip

    @property
    def asked(self) -> float:
        """To what share of the misfit a correction must take it."""
        return BETTER_SIGN if self.factor in (-1.0, None) and self.column.startswith("q_") else BETTER

    @property
    def said(self) -> str:
        """What is wrong, of one column or of several."""
        if not self.several:
            return f"the column {self.column} {self.what}"
        verb, what = self.what.split(" ", 1)
        return f"the columns {self.column} {PLURAL[verb]} {what}"

    @property
    def several(self) -> bool:
        return self.factor is None or TO in self.column


def from_to(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{names[0]}{TO}{names[-1]}"
