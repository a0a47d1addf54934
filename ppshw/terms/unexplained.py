"""What a calibration knows of a correction without a name at some visits: whether it is used there, and how sure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppshw.terms.effect import Effect
from ppshw.terms.shapes import Context
from ppshw.terms.shapes.carried import region_of, windows
from ppshw.terms.shapes.covariates import columns_at

Array = NDArray[np.float64]
USED = 0.5  # share of what the correction may be that its sites determine, from which on it counts as used


@dataclass(frozen=True)
class Unexplained:
    """names of the columns it depends on;  weight (N,) share of the function that data determine, 0 where it is not
    used;  std (N, T) of the targets' positions, by what is not known of it [m]: far from data all it may be"""

    names: tuple[str, ...]
    weight: Array
    std: Array

    def subset(self, rows: NDArray[np.bool_]) -> Unexplained:
        return Unexplained(self.names, self.weight[rows], self.std[rows])

    def as_dict(self) -> dict[str, object]:
        """For `evaluate`: visits where there were no data, and so no correction; millimetres."""
        return {
            "covariates": list(self.names), "visits_without": int((self.weight < USED).sum()),
            "std_mm": float(np.sqrt((self.std**2).mean()) * 1e3),
        }  # fmt: skip


def unexplained_at(effects: Sequence[Effect], context: Context) -> list[Unexplained]:
    """One per correction. A posteriori its components have the covariance, per visit,

        C = diag(σ²) − Σ d dᵀ (1 − s²)        d (C,) of each direction at the visit, s its standard deviation

    because every direction was N(0, 1) before any data, and what no direction reaches stays as it was.
    """
    out = []
    for effect in effects:
        if effect.columns[0].function != "unexplained":
            continue
        args = effect.columns[0].args
        region, frame, components = region_of(args), args["frame"], args["components"]
        covariance = np.zeros((len(context.recording), len(components), len(components)))
        covariance[:] = np.diag(np.square(args["amplitude"]))
        for column, std in zip(effect.columns, effect.std, strict=True):
            if column.function == "unexplained":
                d = column.value(context)[:, frame, components]
                covariance -= (1.0 - std**2) * d[:, :, None] * d[:, None, :]
        moved = context.jacobian[:, :, frame, components]
        variance = np.einsum("nia,nab,nib->ni", moved, covariance, moved).reshape(len(moved), -1, 3).sum(axis=2)
        weight = region.weight(columns_at(context, region.names)) * windows(context, args.get("others", []))
        out.append(Unexplained(region.names, weight, np.sqrt(np.maximum(variance, 0.0))))
    return out
