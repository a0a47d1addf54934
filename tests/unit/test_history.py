"""What effects with a memory remember, against values worked out by hand."""

from __future__ import annotations

import numpy as np

from ppshw.terms.history import hours_since_change, lagged, load_memory, slip


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


def test_a_lag_of_no_time_is_no_lag_and_a_step_is_two_thirds_there_after_one_time_constant() -> None:
    hours = np.linspace(0.0, 2.0, 2001)
    step = np.where(hours > 0.0, 1.0, 0.0)
    assert np.array_equal(lagged(step, hours, 0.0), step)
    after = lagged(step, hours, 0.5)
    assert abs(after[500] - (1 - np.exp(-1.0))) < 2e-3


def test_a_load_change_fades_and_a_new_pose_is_no_load_change() -> None:
    hours = np.array([0.0, 1.0, 2.0, 3.0])
    wrench = np.zeros((4, 6))
    wrench[:, 1] = [-100.0, -300.0, -300.0, -250.0]  # the last one by a new pose alone
    memory = load_memory(wrench, ("a", "b", "b", "b"), hours, 1.0)[:, 1]
    assert np.allclose(memory, [0.0, -200.0, -200.0 * np.exp(-1), -200.0 * np.exp(-2)])


def test_the_time_since_a_load_change_starts_half_way_between_two_visits() -> None:
    found = hours_since_change(("a", "b", "b"), np.array([0.0, 1.0, 2.0]))
    assert np.allclose(found, [0.0, 0.5, 1.5])
