"""What effects with a memory remember, against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from ppshw.terms.history import (
    changed_at,
    followed,
    former,
    hours_since_change,
    lagged,
    load_memory,
    payloads,
    side_held,
    slip,
    way_since_reversal,
    wind_up,
)


def test_a_slipping_spring_follows_small_moves_and_slips_on_large_ones() -> None:
    q = np.array([0.0, 0.5, 0.4, 0.35, 1.0, -1.0, -0.9])
    approach = np.array([1, 1, -1, -1, 1, -1, 1])
    # width 0.2: 0.2 (slipped up), 0.2, 0.1, 0.05, 0.2, -0.2, -0.1
    assert np.allclose(slip(q, approach, 0.2), [1.0, 1.0, 0.5, 0.25, 1.0, -1.0, -0.5])


def test_a_spring_with_hardly_any_width_is_the_sign_of_the_approach() -> None:
    rng = np.random.default_rng(1)
    q = rng.uniform(-1, 1, 50)
    approach = np.sign(np.diff(q, prepend=q[0] - 1)).astype(int)
    assert np.allclose(slip(q, approach, 1e-9), approach)


def test_a_visit_reached_from_the_other_side_has_turned_back_on_its_way() -> None:
    # the setpoint lies higher than the one before, yet it was approached from above
    assert slip(np.array([0.0, 0.5]), np.array([1, -1]), 0.1)[1] == -1.0


def test_what_went_a_little_past_has_taken_up_that_little_only() -> None:
    q, approach = np.array([0.0, 0.5, 0.7]), np.array([1, -1, -1])
    # up to 0.53 and 0.73, then down by 0.03: 0.1 less the way back, of 0.1
    assert np.allclose(slip(q, approach, 0.1, past=0.03), [1.0, 0.7, 0.7])
    assert np.allclose(slip(q, approach, 0.1, past=0.5), [1.0, -1.0, -1.0])
    up, down = 1.0, np.exp(-0.3)  # of the way 0.1
    once = -1.0 + (up + 1.0) * down
    again = 1.0 + (once - 1.0) * np.exp(-2.3)
    assert np.allclose(wind_up(q, approach, 0.1, past=0.03), [1.0, once, -1.0 + (again + 1.0) * down])
    assert np.allclose(wind_up(q, approach, 0.1), [1.0, -1.0, -1.0])


def test_what_was_wound_up_and_let_go_of_while_a_joint_rested_is_wound_up_from_what_is_left() -> None:
    q, approach = np.array([0.0, 0.1, 0.1, 0.3]), np.ones(4, dtype=np.int64)
    left = np.array([1.0, 0.5, 0.2, 1.0])
    once = 1.0 - 0.5 * np.exp(-1.0)
    then = 1.0 - (1.0 - 0.2 * once) * np.exp(-2.0)
    assert np.allclose(wind_up(q, approach, 0.1, left=left), [1.0, once, 0.2 * once, then])


def test_the_way_since_a_joint_turned_back_adds_up_until_it_turns_again() -> None:
    q = np.array([0.0, 0.5, 0.7, 0.4, 0.4, 0.3, 0.6, 0.9])
    approach = np.array([1, 1, 1, -1, -1, -1, 1, -1])  # the last was overshot on the way, nobody knows how far
    assert np.allclose(way_since_reversal(q, approach), [0.0, 0.5, 0.7, 0.3, 0.3, 0.4, 0.3, 0.9])


def test_a_lag_of_no_time_is_no_lag_and_a_step_is_two_thirds_there_after_one_time_constant() -> None:
    hours = np.linspace(0.0, 2.0, 2001)
    step = np.where(hours > 0.0, 1.0, 0.0)
    assert np.array_equal(lagged(step, hours, 0.0), step)
    after = lagged(step, hours, 0.5)
    assert abs(after[500] - (1 - np.exp(-1.0))) < 2e-3


def test_after_a_night_a_lag_has_followed_what_went_straight_on() -> None:
    """From 21 °C to 18 °C with a lag of a quarter of an hour it said 19.5 °C at the first visit."""
    found = lagged(np.array([21.0, 21.0, 18.0]), np.array([0.0, 0.1, 8.1]), 0.25)
    assert found.tolist() == pytest.approx([21.0, 21.0, 18.0 + 0.25 * 3.0 / 8.0], abs=1e-9)
    straight, few = np.linspace(0.0, 3.0, 3001), np.array([0, 700, 800, 2500, 3000])
    often = lagged(straight, straight, 0.4)[few]
    np.testing.assert_allclose(often, lagged(straight[few], straight[few], 0.4), atol=1e-3)


def test_a_load_change_fades_and_the_next_one_adds_to_it() -> None:
    hours = np.array([0.0, 1.0, 2.0, 3.0])
    payload = np.array([[10.0], [30.0], [30.0], [0.0]])
    load = ("a", "b", "b", "c")
    came = changed_at(load, hours, None)
    fading = load_memory(payload, load, hours, came, 1.0, "exponential")[:, 0]
    # put on half way between two visits: 0.5 h, 1.5 h and 2.5 h later
    expected = [0.0, 20 * np.exp(-0.5), 20 * np.exp(-1.5), 20 * np.exp(-2.5) - 30 * np.exp(-0.5)]
    assert np.allclose(fading, expected)
    slowly = load_memory(payload, load, hours, came, 1.0, "log")[:, 0]
    left = [1 - np.log(1 + age) / np.log(9) for age in (0.5, 1.5, 2.5)]  # nothing after eight hours
    assert np.allclose(slowly, [0.0, 20 * left[0], 20 * left[1], 20 * left[2] - 30 * left[0]])
    last = load_memory(payload, load, hours, came, 1.0, "last")[:, 0]  # forgets the change before
    assert np.allclose(last * np.log(9), [0.0, -20 * np.log(1.5), -20 * np.log(2.5), 30 * np.log(1.5)])
    assert np.allclose(load_memory(payload, load, hours, came, 2.0, "first")[:, 0], 10 * np.exp(-hours / 2))


def test_a_payload_is_known_from_what_the_sensor_felt_in_several_poses() -> None:
    g = 9.81 * np.array([[0.0, -1.0, 0.0], [0.1, -0.995, 0.0], [0.0, -0.99, 0.14], [0.0, -1.0, 0.0]])
    first_moment = np.array([5.0, 12.0, 40.0])  # 50 kg at (0.1, 0.24, 0.8) m
    wrench = np.array([[*(50.0 * v), *np.cross(first_moment, v)] for v in g])
    wrench[3] = 0.0  # and nothing under another label
    found = payloads(wrench, ("a", "a", "a", "empty"), g)
    assert np.allclose(found[:3], [50.0, *first_moment])
    assert np.allclose(found[3], 0.0)


def test_a_joint_with_play_stays_on_its_side_until_it_is_pushed_over() -> None:
    load = np.array([2.0, 0.5, -0.5, -2.0, 0.5, 1.5])
    assert side_held(load, 1.0).tolist() == [1, 1, 1, -1, -1, 1]
    assert side_held(np.array([-0.2, 0.1, 3.0]), 1.0).tolist() == [-1, -1, 1]
    assert side_held(np.array([-0.2, 0.1, -3.0]), 1.0, start=1).tolist() == [1, 1, -1]  # as somebody says


def test_the_time_since_a_load_change_starts_half_way_between_two_visits() -> None:
    load, hours = ("a", "b", "b"), np.array([0.0, 1.0, 2.0])
    found = hours_since_change(load, hours, changed_at(load, hours, None))
    assert np.allclose(found, [0.0, 0.5, 1.5])


def test_where_it_is_written_down_how_old_a_load_is_it_came_then() -> None:
    """A pause of an hour before a change: creep was learnt with loads half an hour older than they were, and setpoints
    by the true age were worse than without it (a reviewer's)."""
    load, hours = ("a", "b", "b", "a", "c"), np.array([0.0, 1.0, 2.0, 4.0, 5.0])
    age_s = 3600.0 * np.array([np.nan, 0.1, 1.1, np.nan, 3.0])  # the last one came before the visit that it was not at
    assert changed_at(load, hours, age_s).tolist() == pytest.approx([0.0, 0.9, 1.5, 3.0, 4.0])
    assert hours_since_change(load, hours, changed_at(load, hours, age_s)).tolist() == pytest.approx(
        [0, 0.1, 1.1, 1, 1]
    )
    payload = np.array([[10.0], [30.0], [30.0], [10.0], [0.0]])
    fading = load_memory(payload, load, hours, changed_at(load, hours, age_s), 1.0, "exponential")[:, 0]
    assert fading[:3].tolist() == pytest.approx([0.0, 20 * np.exp(-0.1), 20 * np.exp(-1.1)])


def test_a_link_follows_its_moment_with_a_step_halfway_between_two_visits() -> None:
    hours, moment = np.array([0.0, 2.0, 4.0]), np.array([0.0, 1.0, 1.0])
    came = np.array([0.0, 1.0, 3.0])
    # one time constant of 1 h in the new pose; then two more under the same moment
    assert np.allclose(followed(moment, hours, came, 1.0), [0.0, 1 - np.exp(-1.0), 1 - np.exp(-3.0)])
    both = followed(np.column_stack([moment, 2 * moment]), hours, came, 1.0)
    assert np.allclose(both[:, 1], 2 * followed(moment, hours, came, 1.0))


def test_the_load_before_is_that_of_the_last_label_whatever_hung_there_earlier() -> None:
    mass = np.array([50.0, 50.0, 0.0, 120.0, 120.0, 50.0])
    assert np.allclose(former(mass, ("a", "a", "empty", "b", "b", "a")), [50, 50, 50, 0, 0, 120])
