"""Observations without images tell what the simulator knows, and judge relabelled goals as the environment does."""

from collections.abc import Iterator

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from sb3_stereo.envs.goal import StereoReachGoalEnv
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.envs.without_images import WithoutImages

GOAL_ID = "WamStereoReachGoal-v0"


@pytest.fixture(scope="module", params=[True, False], ids=["joints", "centres"])
def env(request: pytest.FixtureRequest) -> Iterator[WithoutImages]:
    env = WithoutImages(gym.make(GOAL_ID), joints=request.param)
    yield env
    env.close()


def test_it_keeps_gymnasiums_rules(env: WithoutImages) -> None:
    check_env(env, skip_render_check=True)


@pytest.mark.parametrize("joints", [True, False])
def test_it_tells_the_joint_angles_over_their_limits_or_the_achieved_goal(joints: bool) -> None:
    env = WithoutImages(gym.make(GOAL_ID), joints=joints)
    task = env.unwrapped
    assert isinstance(task, StereoReachGoalEnv)
    env.reset(seed=4)
    low, high = task.arm.limits.T
    for action in np.random.default_rng(4).uniform(-1, 1, (5, 4)):
        observation = env.step(action)[0]
        told = observation["observation"]
        if joints:
            angles = np.clip(task.arm.actuated_positions, low, high)  # the solver passes a limit by a little
            np.testing.assert_allclose(low + (told + 1) / 2 * (high - low), angles, atol=1e-9)
        else:
            np.testing.assert_array_equal(told, observation["achieved_goal"])
    env.close()


def test_goals_are_those_in_pixels_over_the_frame(env: WithoutImages) -> None:
    pixels = env.env
    observation, _ = env.reset(seed=5)
    in_pixels = pixels.reset(seed=5)[0]
    for name in ("achieved_goal", "desired_goal"):
        expected = 2 * (in_pixels[name] + 1) / (np.tile([320, 240], 2) + 1) - 1
        np.testing.assert_allclose(observation[name], expected, atol=1e-12)


def test_a_relabelled_goal_is_judged_as_in_pixels(env: WithoutImages) -> None:
    rng = np.random.default_rng(6)
    env.reset(seed=6)
    goals = np.stack([env.step(rng.uniform(-1, 1, 4))[0]["achieved_goal"] for _ in range(8)])
    near = goals + rng.normal(0, 0.02, goals.shape)
    task = env.unwrapped
    assert isinstance(task, StereoReachGoalEnv)
    low, high = np.full(4, -1.0), np.tile([320.0, 240.0], 2)
    one, other = (low + (each + 1) / 2 * (high - low) for each in (goals, near))
    np.testing.assert_array_equal(env.compute_reward(goals, near, [{}] * 8), task.compute_reward(one, other, [{}] * 8))
    np.testing.assert_array_equal(env.compute_terminated(goals, near, None), task.compute_terminated(one, other, None))
    hidden = np.full(4, -1.0)
    assert not env.compute_terminated(hidden, hidden, None)


def test_it_needs_an_environment_with_goals() -> None:
    env = StereoReachEnv()
    with pytest.raises(ValueError, match="WithoutImages needs the goals of WamStereoReachGoal-v0 or its like"):
        WithoutImages(env)
    env.close()
