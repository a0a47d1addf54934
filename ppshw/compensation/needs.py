"""What a column of an effect needs to be known before a setpoint can be computed: a clock, a side, what went before."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from ppshw.terms.effect import Effect
from ppshw.terms.shapes import Column

# Functions of the clock, of it alone or not, and those that need nothing of what went before; all others look back.
BY_CLOCK_ALONE = frozenset({"clock", "step", "hopping", "settling"})
CLOCK = BY_CLOCK_ALONE | {"clock_q"}
AT_ONCE = frozenset({
    "approach", "approach_q", "temperature", "temperature_q", "link_growth", "wave", "wave_q", "load", "load_q",
    "load_near", "load_wave", "load_turn", "bearing", "load_power", "load_knee", "load_beyond", "load_side",
    "load_bump", "load_legendre", "load_warm", "softened", "own_weight", "own_bend", "hanging", "pair", "pair_waves",
    "product", "body_weight", "sensor_error", "weighed", "sensor_off", "pulled", "scale", "target_shift",
    "carrier_shift", "covariate", "covariate_pair", "unexplained", "instead",
})  # fmt: skip
FROM_WAY = frozenset({"reversal", "turning", "slipping", "winding"})  # as far as a joint has gone since it turned back
FROM_APPROACH = frozenset({"approach", "approach_q"}) | FROM_WAY
BEFORE_IT = ("first", "began")  # forms of creep: of what had hung there before the calibration's recording


def joints_of(columns: Iterable[Column], functions: Collection[str]) -> list[int]:
    """Joints that columns with these functions are of, in order."""
    return sorted({int(c.args["joint"]) for c in columns if c.function in functions})


def as_left(effect: Effect) -> bool:
    """Whether it jumped and stays so: a joint's zero, or that of one of the force sensor's channels."""
    jumps = len(effect.columns) == 1 and effect.columns[0].args.get("time") == "step"
    return effect.name == "zero_shift" or (effect.name == "wrench_error" and jumps)


def by_clock(column: Column) -> bool:
    return column.function in CLOCK or bool(column.args.get("time"))


def looks_back(column: Column) -> bool:
    if column.args.get("place") and float(column.args.get("tau", 0.0)) > 0:
        return True
    return column.function not in AT_ONCE and not by_clock(column)
