"""What weighing says of the force sensor, in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppshw.diagnosis.library.by_instrument import sensor_errors
from ppshw.diagnosis.library.weighing import Weighing, weigh
from ppshw.diagnosis.parameter_names import misread_name, misread_unit
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.quantities import enumerated
from ppshw.terms.shapes import Column, Context
from ppshw.terms.shapes.sensor import misread

Array = NDArray[np.float64]
FEW = 3  # numbers of a form that are worth telling


def against_gravity(c: Context) -> str:
    """By how much the force sensor reads other than rigid payloads weigh, and which error of it that is; "" where it
    does not."""
    found = weigh(c, list(sensor_errors(c)))
    if found is None:
        return ""
    by = found.by * found.wrong
    if found.one_form and (numbers := _numbers(found)):  # what no payload weighs may show in other channels
        args = [column.args for column in found.forms[0].form.columns]
        made = sum(number.value * misread(c, **each) for number, each in zip(numbers, args, strict=True))
        by = np.sqrt(np.mean(np.square(made), axis=0))
    far = [f"{WRENCH_COMPONENTS[k]} by {by[k]:.2g} {'N' if k < 3 else 'N m'}" for k in np.flatnonzero(by)]
    return f"{enumerated(far)} rms, {_error(found)}"


def doubt(c: Context) -> str:
    """A warning where the readings say so and nothing else does."""
    if not (said := against_gravity(c)):
        return ""
    return (
        f"the force sensor reads other than what hangs there weighs, {said}: is its zero or a gain off, are several "
        "payloads of one label, or does something besides gravity pull at them?"
    )


def turned(columns: Sequence[Column], values: Array, of_what_hangs: bool = False) -> str:
    """By how much and about which of its axes a force sensor is mounted otherwise than its file says.

    of_what_hangs  values go by what hangs there, not by what is read: then the second is the angle's versine, else less
                   than nothing by as much (`misread`)
    """
    sines = {c.args["turned"]: v for c, v in zip(columns, values, strict=True) if c.args.get("times") != 2}
    versines = {c.args["turned"]: v for c, v in zip(columns, values, strict=True) if c.args.get("times") == 2}
    sign = 1.0 if of_what_hangs else -1.0

    def angle(axis: int) -> float:
        if axis in versines:
            return float(np.degrees(np.arctan2(sines[axis], 1.0 - sign * versines[axis])))
        return float(np.degrees(np.arcsin(np.clip(sines[axis], -1.0, 1.0))))

    angles = [f"{angle(axis):.1f}° about its {'xyz'[axis]}" for axis in sines]
    return f"turned by {enumerated(angles)}"


@dataclass(frozen=True)
class Number:
    """One of the sensor's errors, by its readings: under which name, with its standard deviation and unit."""

    name: str
    value: float
    std: float
    unit: str


def numbers_by_gravity(c: Context) -> list[Number]:
    """What the force sensor's error comes to against gravity; none where it reads what hangs there, or where it takes
    more than a few numbers or several forms to say."""
    found = weigh(c, list(sensor_errors(c)))
    return _numbers(found) if found is not None and found.one_form else []


def _numbers(found: Weighing) -> list[Number]:
    """Of its first form, where that has few columns and is no turn, which has angles."""
    first = found.forms[0]
    columns = [column.args for column in first.form.columns]
    if len(columns) > FEW or "turned" in columns[0]:
        return []
    names = [misread_name(args, again=len(columns) > 1) for args in columns]
    std = np.sqrt(np.diag(first.covariance))
    return list(map(Number, names, first.values.tolist(), std.tolist(), map(misread_unit, columns)))


def _error(found: Weighing) -> str:
    first = found.forms[0]
    columns, lag = [column.args for column in first.form.columns], first.form.shape.get("lag_h", 0.0)
    if "turned" in columns[0]:
        said = f"as if it were mounted {turned(first.form.columns, first.values, of_what_hangs=True)}"
    elif len(columns) <= FEW:
        numbers = [f"{n.name} {n.value:.3g} ± {n.std:.2g} {n.unit}".removesuffix(" 1") for n in _numbers(found)]
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
