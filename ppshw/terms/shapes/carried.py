"""What a calibration carries of structure without a name, and how the base model moves beside it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.terms import Situation
from ppshw.terms.gaussian_process import Region
from ppshw.terms.shapes.context import Context
from ppshw.terms.shapes.covariates import columns_at

Array = NDArray[np.float64]


def unexplained(
    c: Context, names: list[str], centre: list[float], spread: list[float], low: list[float], high: list[float],
    length: list[float], sites: list[list[float]], frame: int, components: list[int], amplitude: list[float],
    mode: list[list[float]], others: list[dict[str, Any]] | None = None,
) -> Array:  # fmt: skip
    """One direction of a Gaussian process over columns, nothing where the recording it was learnt from had no data.

    mode (C, m) of the process's functions for the components of a frame; amplitude (C,): see `Correction`; others:
    regions of further processes that were learnt beside it, outside of which this one is not used either
    """
    region = region_of({"names": names, "centre": centre, "spread": spread, "low": low, "high": high,
                        "length": length, "sites": sites})  # fmt: skip
    out = np.zeros_like(c.wrenches)
    out[:, frame, components] = region.basis(columns_at(c, region.names)) @ np.array(mode).T
    return out * windows(c, others or [])[:, None, None]


def model_shift(c: Context, theta: list[float]) -> Array:
    """(N, n+1, 6) of the base model's frame terms, with other parameters by `theta` (p,)."""
    out = np.zeros_like(c.wrenches)
    if c.model is None:
        return out
    situation, at = Situation.of(c.recording), 0
    for term, size in zip(c.model.terms, c.model.sizes, strict=False):
        out[:, term.frame] += term.regressors(situation, c.wrenches) @ np.array(theta[at : at + size])
        at += size
    return out


def windows(c: Context, regions: list[dict[str, Any]]) -> Array:
    """(N,) 1 where all regions had data, 0 where one of them had not."""
    out = np.ones(len(c.recording))
    for region in map(region_of, regions):
        out *= region.window(columns_at(c, region.names))
    return out


def region_of(args: dict[str, Any]) -> Region:
    """Of the arguments of `unexplained`."""
    figures = (np.array(args[k], dtype=float) for k in ("centre", "spread", "low", "high", "length", "sites"))
    return Region(tuple(args["names"]), *figures)
