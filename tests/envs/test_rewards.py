"""Eq. 2 and 3 and the goal, without a simulator."""

import numpy as np
import pytest

from sb3_stereo.envs.rewards import OffsetReward, distance_change, is_goal, lengths, reward

NAN = float("nan")


@pytest.mark.parametrize(
    ("changes", "goal", "expected"),
    [
        ((0.3, -0.1), True, 1.0),  # the goal comes first, whatever the changes
        ((0.0, 0.0), True, 1.0),
        ((NAN, NAN), True, 1.0),
        ((0.0, 0.0), False, -1.0),
        ((0.4, NAN), False, 0.4),
        ((NAN, -0.6), False, -0.6),
        ((0.4, 0.2), False, 0.3),
        ((0.4, -0.4), False, 0.0),  # they cancel, but the arm moved
        ((0.0, NAN), False, 0.0),  # the third case, not the second
        ((NAN, 0.0), False, 0.0),
        ((NAN, NAN), False, 0.0),  # our decision: the paper has no case
    ],
)
def test_every_case_of_equation_3(changes: tuple[float, float], goal: bool, expected: float) -> None:
    assert reward(np.array(changes), goal) == pytest.approx(expected)


def test_changes_of_a_path_telescope() -> None:
    path = np.random.default_rng(0).uniform(20, 90, size=(50, 2))
    steps = distance_change(path[:-1], path[1:], scale=100.0)
    np.testing.assert_allclose(steps.sum(0), (path[0] - path[-1]) / 100.0)


def test_a_cycle_earns_nothing() -> None:
    cycle = np.random.default_rng(1).uniform(20, 90, size=(10, 2))
    steps = distance_change(cycle, np.roll(cycle, -1, axis=0), scale=100.0)
    assert sum(reward(step, goal=False) for step in steps) == pytest.approx(0.0)


def test_nearer_is_positive_farther_is_negative_and_swapping_the_ends_swaps_the_sign() -> None:
    near, far = np.array([20.0, 30.0]), np.array([60.0, 80.0])
    assert (distance_change(far, near, 100.0) > 0).all()
    np.testing.assert_array_equal(distance_change(near, far, 100.0), -distance_change(far, near, 100.0))


def test_changes_and_rewards_stay_within_one() -> None:
    rng = np.random.default_rng(2)
    changes = distance_change(rng.uniform(0, 500, (1000, 2)), rng.uniform(0, 500, (1000, 2)), 100.0)
    assert np.abs(changes).max() == 1.0
    assert all(-1.0 <= reward(change, goal=False) <= 1.0 for change in changes)


def test_change_is_undefined_when_the_marker_was_or_is_hidden() -> None:
    changes = distance_change(np.array([NAN, 50.0, 50.0]), np.array([50.0, NAN, 40.0]), 100.0)
    np.testing.assert_array_equal(np.isnan(changes), [True, True, False])


def test_goal_is_the_mean_distance_and_includes_the_threshold() -> None:
    assert is_goal(np.array([5.0, 15.0]), rho=10.0)
    assert not is_goal(np.array([5.0, 15.1]), rho=10.0)


def test_goal_needs_both_distances() -> None:
    assert not is_goal(np.array([0.0, NAN]), rho=10.0)


def test_order_of_the_views_does_not_matter() -> None:
    for changes in np.random.default_rng(3).choice([NAN, -0.5, 0.0, 0.25], size=(100, 2)):
        assert reward(changes, False) == reward(changes[::-1], False)


def test_the_reward_of_offsets_is_that_of_their_lengths() -> None:
    rng = np.random.default_rng(0)
    previous, current = (rng.uniform(-40, 40, (300, 2, 2)) for _ in range(2))
    current[:50] = previous[:50]  # nothing moved
    current[50:60] *= 0.1  # goals
    for offsets in (previous, current):
        offsets[rng.random((300, 2)) < 0.2] = np.nan
    scale = np.array([0.5, 0.25])
    rewards, goals = OffsetReward(30.0, 8.0, scale)(previous, current)
    for one in range(300):
        goal = is_goal(lengths(current[one] * scale), 8.0)
        changes = distance_change(lengths(previous[one]), lengths(current[one]), 30.0)
        assert (rewards[one], goals[one]) == (pytest.approx(reward(changes, goal)), goal)
    assert goals.any() and (rewards == -1.0).any() and (rewards == 0.0).any()
