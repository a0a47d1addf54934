"""Trapezoids: expected numbers are worked out by hand in the comments."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators import motion


def test_a_long_move_is_a_trapezoid() -> None:
    """1 m at 0.1 m/s, 0.1 m/s²: 1 s and 0.05 m to speed up, 9 s at speed, 1 s and 0.05 m to slow down."""
    m = motion.move(5.0, 2.0, 3.0, velocity=0.1, acceleration=0.1)
    assert m.end == pytest.approx(16.0)
    assert m.at(5.0) == pytest.approx((2.0, 0.0))
    assert m.at(6.0) == pytest.approx((2.05, 0.1))
    assert m.at(10.5) == pytest.approx((2.5, 0.1))
    assert m.at(16.0) == pytest.approx((3.0, 0.0))
    assert m.at(100.0) == (3.0, 0.0)


def test_a_short_move_never_reaches_its_speed() -> None:
    """0.04 m at 1 m/s²: peak √(0.04) = 0.2 m/s after 0.2 s, at rest after 0.4 s."""
    m = motion.move(0.0, 0.0, -0.04, velocity=10.0, acceleration=1.0)
    assert m.end == pytest.approx(0.4)
    assert m.at(0.2) == pytest.approx((-0.02, -0.2))


def test_braking_may_be_gentler_than_speeding_up() -> None:
    """To 1 m/s in 0.5 m at 1 m/s², from it in 1 m at 0.5 m/s²: 1.5 m take 1 s + 2 s, without a cruise."""
    m = motion.move(0.0, 0.0, 1.5, velocity=1.0, acceleration=1.0, deceleration=0.5)
    assert m.end == pytest.approx(3.0)
    assert m.at(1.0) == pytest.approx((0.5, 1.0))


def test_a_stop_takes_v_squared_over_2a() -> None:
    m = motion.stop(1.0, 10.0, initial_velocity=-2.0, deceleration=4.0)
    assert (m.end, m.target) == pytest.approx((1.5, 9.5))


def test_a_target_behind_a_moving_axis_is_reached_by_turning_back() -> None:
    """At 0 with +1 m/s, 1 m/s²: stops at 0.5 m after 1 s, then 0.5 m back takes 2·√0.5 s."""
    m = motion.move(0.0, 0.0, 0.0, velocity=5.0, acceleration=1.0, initial_velocity=1.0)
    assert m.position(1.0) == pytest.approx(0.5)
    assert m.end == pytest.approx(1.0 + 2.0 * 0.5**0.5)


@given(
    start=st.floats(-1e6, 1e6),
    target=st.floats(-1e6, 1e6),
    velocity=st.floats(1.0, 1e6),
    acceleration=st.floats(1.0, 1e6),
    deceleration=st.floats(1.0, 1e6),
    initial=st.floats(-1e5, 1e5),
)
def test_position_has_no_jumps_and_ends_on_target(
    start: float, target: float, velocity: float, acceleration: float, deceleration: float, initial: float
) -> None:
    m = motion.move(0.0, start, target, velocity, acceleration, deceleration, initial)
    assert m.at(m.end) == (target, 0.0)
    scale = 1e-9 * (1.0 + abs(start) + abs(target) + initial**2)
    for before, after in zip(m.pieces, m.pieces[1:], strict=False):
        position, speed = before.at(after.start)
        assert position == pytest.approx(after.position, abs=scale)
        assert abs(speed) <= max(velocity, abs(initial)) * (1 + 1e-9) + 1e-6


def test_a_speed_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="velocity 0"):
        motion.move(0.0, 0.0, 1.0, velocity=0.0, acceleration=1.0)
