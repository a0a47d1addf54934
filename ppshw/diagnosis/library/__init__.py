"""Every effect that is tried, as candidates: per effect of the contract's table the joints, components and shapes.

    candidate.py         what a candidate is
    sampled.py           where and when a recording can show anything: joints, loads, temperatures, moments
    lost_motion.py       backlash, friction
    by_position.py       periodic errors of a transmission, coupling of one joint to another
    by_load.py           stiffness out of proportion, clearance, compliance that is missing
    creep.py             creep
    weight.py            moving weight
    by_heat_and_time.py  thermal growth, drift
    jumps.py             zeros that shift, reflectors that move
    by_instrument.py     the tracker's scale, the force sensor

Shares are prior weights among the candidates of one effect; what sits in a drive has the joint's own direction alone.
Grids of nonlinear parameters are part of the candidates: the evidence averages over them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType

from ppshw.diagnosis.library.by_heat_and_time import drift, thermal
from ppshw.diagnosis.library.by_instrument import force_sensor, force_sensor_jumps, tracker_scale
from ppshw.diagnosis.library.by_load import clearance, missing_compliance, nonlinear
from ppshw.diagnosis.library.by_position import FineWave, coupling, fine, periodic, periodic_across
from ppshw.diagnosis.library.candidate import Candidate, all_kept
from ppshw.diagnosis.library.creep import creeping, creeping_from_nothing, creeping_though_rigid
from ppshw.diagnosis.library.jumps import Jumps, moved_reflector, zero_shift
from ppshw.diagnosis.library.lost_motion import backlash, friction
from ppshw.diagnosis.library.sampled import moments_about
from ppshw.diagnosis.library.weight import moving_weight
from ppshw.terms.shapes import Context

__all__ = ["LOADS", "NAMES", "Candidate", "library"]
# What may be left out of a diagnosis: every effect of the contract's table but outliers, which are no bias.
NAMES = (
    "backlash", "friction_hysteresis", "thermal_growth", "drift", "tracker_scale", "periodic_transmission",
    "nonlinear_stiffness", "clearance", "cross_coupling", "moving_weight", "wrench_error", "creep", "zero_shift",
    "missing_compliance", "target_moved", "unsettled",
)  # fmt: skip
NOTHING_KNOWN: Mapping[str, float] = MappingProxyType({})
LOADS = frozenset({  # effects that loads make
    "nonlinear_stiffness", "clearance", "creep", "missing_compliance", "wrench_error", "moving_weight",
})  # fmt: skip


@all_kept()
def library(
    c: Context, without: frozenset[str] = frozenset(), moments: Sequence[float] = (),
    periods: Sequence[tuple[str, float]] = (), bands: Sequence[Candidate] = (),
    jumps: Sequence[Jumps] = (), knocks: Sequence[Jumps] = (), lost: Mapping[str, float] = NOTHING_KNOWN,
    loads: Collection[int] = (), creeps: bool = False, fine_waves: Sequence[FineWave] = (),
) -> list[Candidate]:  # fmt: skip
    """All candidates for a recording; shares of an effect add up to one.

    without  effects that are left out
    moments  at which something seems to have happened [h]: what is tried at MOMENTS moments of a recording is tried
             between all visits about them
    periods  of joints that seem to have a wave: what is tried at half waves over the travel is tried between them
    bands    of waves without a name that seem to be there across a joint's own direction: one of them may be all of it
    jumps    moments of several jumps of a joint's zero that the recording speaks for most
    knocks   the same of reflectors
    lost     what joints lose when they turn back [m or rad], as far as it is known: how fast play can be taken up
    loads    components of the wrench that a link seems to give way to out of proportion: tried more finely
    fine_waves  waves that a residual shows most, of those too many to try each
    creeps   whether something seems to creep: its two time constants are tried more finely
    """
    makers = (
        thermal, tracker_scale, coupling, moving_weight, force_sensor, creeping_from_nothing, creeping_though_rigid,
        missing_compliance,
    )  # fmt: skip
    found = [*backlash(c, lost), *friction(c, lost), *(k for make in makers for k in make(c))]
    found += [k for make in (drift, force_sensor_jumps) for k in make(c, moments_about(c, moments))]
    found += creeping(c, creeps)
    found += [k for make in (nonlinear, clearance) for k in make(c, loads)]
    found += moved_reflector(c, moments_about(c, moments), knocks)
    found += [*periodic(c, periods), *periodic_across(c, bands), *fine(c, fine_waves), *zero_shift(c, jumps)]
    found = [k for k in found if k.effect not in without]
    total: dict[str, float] = {}
    for k in found:
        total[k.effect] = total.get(k.effect, 0.0) + k.share
    for k in found:
        k.share /= total[k.effect]
    return found
