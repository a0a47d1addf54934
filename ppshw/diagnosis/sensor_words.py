"""What weighing says of the force sensor, in words."""

from __future__ import annotations

import numpy as np

from ppshw.diagnosis.library.by_instrument import sensor_errors
from ppshw.diagnosis.library.weighing import Weighing, weigh
from ppshw.diagnosis.parameters import misread_name, misread_unit
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.quantities import enumerated
from ppshw.terms.shapes import Context

FEW = 3  # numbers of a form that are worth telling


def against_gravity(c: Context) -> str:
    """By how much the force sensor reads other than rigid payloads weigh, and which error of it that is; "" where it
    does not."""
    found = weigh(c, list(sensor_errors(c)))
    if found is None:
        return ""
    far = [
        f"{WRENCH_COMPONENTS[k]} by {found.by[k]:.2g} {'N' if k < 3 else 'N m'}" for k in np.flatnonzero(found.wrong)
    ]
    return f"{enumerated(far)} rms, {_error(found)}"


def doubt(c: Context) -> str:
    """A warning where the readings say so and nothing else does."""
    if not (said := against_gravity(c)):
        return ""
    return (
        f"the force sensor reads other than what hangs there weighs, {said}: is its zero or a gain off, or are several "
        "payloads of one label?"
    )


def _error(found: Weighing) -> str:
    first = found.forms[0]
    columns, lag = [column.args for column in first.form.columns], first.form.shape.get("lag_h", 0.0)
    if len(columns) <= FEW:
        numbers = [
            f"{misread_name(args, again=len(columns) > 1)} {value:.3g} ± {std:.2g} {unit}".rstrip(" 1")
            for args, value, std, unit in zip(
                columns, first.values, np.sqrt(np.diag(first.covariance)), map(misread_unit, columns), strict=True
            )
        ]
        when = f" from {first.form.shape['time_h']:.2f} h on" if "time_h" in first.form.shape else ""
        said = ", ".join(numbers) + when
    elif first.form.covariate == "load":
        said = "a calibration matrix or zeros of its own"
    elif first.form.covariate.startswith("temp_"):
        said = f"zeros that go with {first.form.covariate}" + f", {lag:g} h late" * (lag > 0)
    elif any(args.get("time") == "step" for args in columns):
        said = "other zeros after every change of the load"
    else:
        said = "zeros that wander with time"
    return said if found.one_form else f"mostly {said}"
