"""Readings of the paper that are options: in whose pixels success counts, and where episodes begin."""

from collections.abc import Iterator

import numpy as np
import pytest

from sb3_stereo.envs.reach import StereoReachEnv

SCALE = np.array([84 / 320, 42 / 240])  # of a view in the observation, to its camera's frame


@pytest.fixture(scope="module")
def views() -> Iterator[StereoReachEnv]:
    env = StereoReachEnv(success_frame="observation")
    yield env
    env.close()


def episode(env: StereoReachEnv, seed: int) -> Iterator[tuple[bytes, float, bool, np.ndarray]]:
    """Observation, reward, success and offsets of some steps from the same pose with the same actions."""
    observation, info = env.reset(seed=seed, options={"joint_positions": (1.0, 0.4, 0.0, 0.8)})
    yield observation.tobytes(), 0.0, info["is_success"], info["pixel_offsets"]
    for action in np.random.default_rng(seed).uniform(-1, 1, (8, 4)):
        observation, reward, reached, _, info = env.step(action)
        assert reached == info["is_success"]
        yield observation.tobytes(), reward, reached, info["pixel_offsets"]


def test_success_is_judged_in_the_pixels_of_its_frame(env: StereoReachEnv, views: StereoReachEnv) -> None:
    verdicts = set()
    for seed in range(6):
        for strict, wide in zip(episode(env, seed), episode(views, seed), strict=True):
            offsets = strict[3]
            assert strict[2] == (np.linalg.norm(offsets, axis=1).mean() <= 10)
            assert wide[2] == (np.linalg.norm(offsets * SCALE, axis=1).mean() <= 10)
            verdicts.add((strict[2], wide[2]))
    assert (False, True) in verdicts and (False, False) in verdicts and (True, False) not in verdicts


def test_the_success_frame_changes_neither_what_is_seen_nor_other_rewards(
    env: StereoReachEnv, views: StereoReachEnv
) -> None:
    pairs = list(zip(episode(env, 0), episode(views, 0), strict=True))
    assert all(strict[0] == wide[0] for strict, wide in pairs)
    assert all(wide[1] == (1.0 if wide[2] else strict[1]) for strict, wide in pairs[1:])  # a start has no reward


def test_a_hidden_marker_is_no_goal_in_any_frame(views: StereoReachEnv) -> None:
    views.reset(options={"target_position": (0.0, 0.0, 5.0), "joint_positions": (1.0, 0.4, 0.0, 0.8)})  # out of sight
    assert not views.step(np.zeros(4))[2]


def test_random_starts_are_away_from_the_goal_in_its_frame(views: StereoReachEnv) -> None:
    assert not any(views.reset(seed=seed)[1]["is_success"] for seed in range(20))


def test_episodes_begin_at_the_initial_positions_unless_reset_says_otherwise() -> None:
    env = StereoReachEnv(initial_positions=(1.0, 0.4, 0.0, 0.8))
    initial_states = [env.reset(seed=seed)[1]["joint_positions"][:4] for seed in (0, 1, None)]
    np.testing.assert_allclose(initial_states, [(1.0, 0.4, 0.0, 0.8)] * 3)
    elsewhere = env.reset(options={"joint_positions": (0.5, 0.0, 0.0, 1.0)})[1]
    np.testing.assert_allclose(elsewhere["joint_positions"][:4], (0.5, 0.0, 0.0, 1.0))
    env.close()


def test_initial_positions_at_the_goal_are_refused() -> None:
    finder = StereoReachEnv()
    pose = (1.0, 0.4, 0.0, 0.8)
    target = finder.reset(options={"joint_positions": pose})[1]["end_effector_position"]
    finder.close()
    with pytest.raises(ValueError) as error:
        StereoReachEnv(initial_positions=pose, target_position=target)
    assert str(error.value) == (
        "initial_positions (1.0, 0.4, 0.0, 0.8) are a goal already; choose a pose away from the target"
    )


def test_raw_efforts_last_until_the_next_one_replaces_them() -> None:
    """Two equal commands are one of twice the length: nothing stops or holds the arm between them."""
    options = {"gravity_compensation": False, "brake": False}
    ends = []
    for duration, n_steps in ((0.25, 2), (0.5, 1)):
        env = StereoReachEnv(pulse_duration=duration, **options)
        env.reset(options={"joint_positions": (1.0, 0.4, 0.0, 0.8)})
        for _ in range(n_steps):
            info = env.step((0.3, -0.5, 0.2, 0.1))[4]
        ends.append(info["joint_positions"])
        env.close()
    np.testing.assert_array_equal(*ends)
