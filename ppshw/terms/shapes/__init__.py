"""The functions of covariates and history that effects are made of, by name, so that a calibration can carry them.

    context.py        what a function may look at: a recording's visits seen through the base model
    column.py         a function and where it acts; all functions by their names
    covariates.py     a recording's columns by their names, and smooth functions of any of them
    motion.py         where joints stand, from which side they came, what they did since
    time_and_heat.py  the time and temperatures
    loads.py          what acts on a frame, and creep.py: what acted there before
    wrenches.py       the machine's own weight, more of it, what is at the sensor
    sensor.py         the force sensor reads wrong
    instrument.py     the tracker does, or the air between
    reflectors.py     reflectors move
    carried.py        what a calibration carries of structure without a name

A function gives (N,) of the visits, for one component of one frame; (N, n+1, 6), for all frames at once; or (N, T, 3),
for the measured points themselves.
"""

from __future__ import annotations

from ppshw.terms.shapes.column import Column, Key, What
from ppshw.terms.shapes.context import Context
from ppshw.terms.shapes.covariates import named_column

__all__ = ["Column", "Context", "Key", "What", "named_column"]
