"""Which effects there are, by the contract's names (§4), and what else may be asked for by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from simulators.concealed import by_load, by_motion, by_place, unknown
from simulators.concealed.scene import Concealed, Scene

Draw = Callable[[Scene, np.random.Generator], Concealed]

KNOWN: dict[str, Draw] = {
    f.__name__: f
    for f in (
        by_motion.backlash, by_motion.friction_hysteresis, by_place.thermal_growth, by_place.drift,
        by_place.tracker_scale, by_motion.periodic_transmission, by_load.nonlinear_stiffness, by_load.clearance,
        by_motion.cross_coupling, by_load.moving_weight, by_load.wrench_error, by_load.creep, by_motion.zero_shift,
        by_load.missing_compliance, by_place.target_moved, by_place.outliers, by_place.unsettled,
    )
}  # fmt: skip
UNKNOWN: dict[str, Draw] = {
    f.__name__: f
    for f in (
        unknown.counterbalance_memory,
        unknown.warm_load,
        unknown.air_conditioning,
        unknown.resonance,
        unknown.swelling,
        unknown.seat,
        unknown.twisted_rails,
    )
}
# Pairs leave out what is noise: a scatter beside a bias is another question.
PAIRED = tuple(name for name in KNOWN if name not in ("outliers", "unsettled", "missing_compliance"))


def chosen(asked: str, rng: np.random.Generator) -> tuple[str, ...]:
    """The names that `asked` stands for: null, pair, unknown, one name, or several joined by plus signs."""
    if asked == "null":
        return ()
    if asked == "pair":
        return tuple(str(x) for x in rng.choice(PAIRED, 2, replace=False))
    if asked == "unknown":
        return (str(rng.choice(list(UNKNOWN))),)
    names = tuple(asked.split("+"))
    for name in names:
        if name not in KNOWN and name not in UNKNOWN:
            raise ValueError(f"no effect {name!r}; there are null, pair, unknown, {', '.join((*KNOWN, *UNKNOWN))}")
    return names
