"""What the studies do with one simulated positioner: record it, identify it, look at what is missed. Pure functions of
their arguments, so that a job is the same anywhere (ppshw.studies.engine)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppshw.evaluation import figures
from ppshw.identification import identify
from ppshw.studies.bound import bound
from ppshw.studies.simulated import POINT, Trial, designed_campaign, ensemble, make_trial

Array = NDArray[np.float64]
Json = dict[str, Any]


def design(visits: int) -> Json:
    """The campaign that is designed for so many visits; the same for every machine, of which it knows nothing."""
    return {"campaign": designed_campaign(visits)}


def accuracy(
    seed: int, plan: str, visits: int, methods: list[str], machines: int, repeatability_mm: float | None = None,
    campaign: str | None = None,
) -> Json:  # fmt: skip
    """Figures of the residual at the treatment point on unseen visits [mm], by method.

    methods   of `ppshw identify`; machines: how many the bound's prior is estimated from
    returns   visits; nominal, noise (a perfect model), bound and every method: figures, and of the last two also
              model_rms_mm, the same without repeatability and tracker
    """
    repeatability = None if repeatability_mm is None else repeatability_mm / 1e3
    trial = make_trial(seed, plan, visits, repeatability, campaign)
    noise = trial.measured - trial.perfect
    least = bound(ensemble(machines), trial.train, trial.test, trial.machine.point(POINT), trial.scatter)
    return {
        "visits": len(trial.train),
        "nominal": figures(trial.measured - trial.nominal),
        "noise": figures(noise),
        "bound": {**least.figures(noise, seed), "model_rms_mm": least.rms_mm},
        **{method: _missed(trial, method) for method in methods},
    }


def _missed(trial: Trial, method: str) -> dict[str, float]:
    found = identify(trial.machine, trial.train, method)
    model = trial.predicted(found) - trial.perfect
    return {**figures(trial.missed(found)), "model_rms_mm": figures(model)["rms_mm"]}


def residuals(seed: int, plan: str, visits: int, methods: list[str]) -> Json:
    """Every unseen visit's error at the treatment point by its length in whole µm: not compensated, and by method."""
    trial = make_trial(seed, plan, visits)
    out: Json = {"nominal": _lengths(trial.measured - trial.nominal)}
    for method in methods:
        out[method] = _lengths(trial.missed(identify(trial.machine, trial.train, method)))
    return out


def _lengths(errors: Array) -> list[int]:
    lengths: list[int] = np.rint(np.linalg.norm(errors, axis=1) * 1e6).astype(int).tolist()
    return lengths


def directions(seed: int, plan: str, visits: int, method: str) -> Json:
    """Every unseen visit as vectors in the base frame.

    at        (V, 3) where the treatment point should be                     [mm]
    nominal   (V, 3) measured less nominal: not compensated                  [µm]
    residual  (V, 3) measured less predicted                                 [µm]
    model     (V, 3) the same without repeatability and tracker              [µm]
    """
    trial = make_trial(seed, plan, visits)
    found = identify(trial.machine, trial.train, method)
    return {
        "at": _whole(trial.nominal, 1e3),
        "nominal": _whole(trial.measured - trial.nominal, 1e6),
        "residual": _whole(trial.missed(found), 1e6),
        "model": _whole(trial.perfect - trial.predicted(found), 1e6),
    }


def _whole(values: Array, scale: float) -> list[list[int]]:
    rows: list[list[int]] = np.rint(values * scale).astype(int).tolist()
    return rows
