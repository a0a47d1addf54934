"""Wanted poses and loads → corrected joint setpoints   (paper figure 3).

compensator.py     one setpoint, what it leaves, how sure it is; what is refused
corrections.py     the setpoints of a run, each with the moves before it
inverse.py         joint values at which the real machine stands where it should
known_effects.py   of the effects that a diagnosis found, what can be known beforehand; past.py: what went before
fast_setpoints.py  the same for controllers, compiled (fast_kernel.py), without effects
"""

from __future__ import annotations

from ppshw.compensation.compensator import Bounds, Circumstances, Compensator, Setpoints
from ppshw.compensation.corrections import Corrections

__all__ = ["Bounds", "Circumstances", "Compensator", "Corrections", "Setpoints"]
