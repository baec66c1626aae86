"""Quantised efforts."""

from typing import Any

import fake_reach
import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack

from sb3_stereo.envs.wrappers import QuantizedActions, StackFrames, WatchedPulses


class Echo(gym.Env[np.ndarray, np.ndarray]):
    """Returns the action it got."""

    observation_space = Box(-5, 5, (4,))

    def __init__(self, action_space: gym.Space[np.ndarray] | None = None) -> None:
        self.action_space = action_space or Box(-1, 1, (4,))

    def step(self, action: np.ndarray):  # type: ignore[no-untyped-def]
        return action, 0.0, False, False, {}


@pytest.mark.parametrize(("levels", "n_actions"), [(2, 16), (3, 81), (5, 625), (7, 2401)])
def test_numbers_and_levels_are_inverse_to_each_other(levels: int, n_actions: int) -> None:
    env = QuantizedActions(Echo(), levels)
    assert env.action_space == Discrete(n_actions)
    numbers = [env.number_of(env.levels_of(number)) for number in range(n_actions)]
    assert numbers == list(range(n_actions))


def test_three_levels_are_back_none_and_forward_with_the_first_joint_highest() -> None:
    env = QuantizedActions(Echo(), levels=3)
    np.testing.assert_array_equal(env.step(np.int64(0))[0], [-1, -1, -1, -1])
    np.testing.assert_array_equal(env.step(np.int64(40))[0], [0, 0, 0, 0])
    np.testing.assert_array_equal(env.step(np.int64(1))[0], [-1, -1, -1, 0])
    np.testing.assert_array_equal(env.step(np.int64(80))[0], [1, 1, 1, 1])


def test_every_action_is_reached_once_and_negating_the_efforts_mirrors_the_number() -> None:
    env = QuantizedActions(Echo(), levels=5)
    efforts = np.array([env.action(np.int64(number)) for number in range(625)])
    assert len(np.unique(efforts, axis=0)) == 625
    np.testing.assert_allclose(efforts, -efforts[::-1])


def test_levels_span_uneven_limits() -> None:
    env = QuantizedActions(Echo(Box(np.array([-2.0, 0.0]), np.array([2.0, 8.0]))), levels=5)
    np.testing.assert_allclose(env.action(np.int64(1)), [-2.0, 2.0])


@pytest.mark.parametrize("action", [-1, 81, 2.5])
def test_an_action_that_is_no_number_of_the_space_is_refused(action: float) -> None:
    with pytest.raises(ValueError, match="it must be an integer from 0 to 80"):
        QuantizedActions(Echo()).action(action)  # type: ignore[arg-type]


def test_what_cannot_be_quantised_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^cannot quantise Discrete\(3\); it takes a bounded one-dimensional Box$"):
        QuantizedActions(Echo(Discrete(3)))  # type: ignore[arg-type]
    message = "^11 levels for 4 joints; take at least 2, and at most 10000 actions in all$"
    with pytest.raises(ValueError, match=message):
        QuantizedActions(Echo(), levels=11)


def test_pulses_that_cannot_be_watched_are_explained(env: Any) -> None:
    with pytest.raises(ValueError) as refusal:
        WatchedPulses(Echo(), print)
    assert str(refusal.value) == f"cannot watch the pulses of {Echo()}; it takes a StereoReachEnv"
    for n_parts in (0, -1, 2.5):
        with pytest.raises(ValueError) as refusal:
            WatchedPulses(env, print, n_parts)  # type: ignore[arg-type]
        assert str(refusal.value) == f"n_parts is {n_parts}; give an integer of at least 1"


def test_stacked_frames_are_those_of_sb3s_vec_frame_stack() -> None:
    def make() -> gym.Env[Any, Any]:
        return gym.make(fake_reach.ENV_ID, tolerance=1e-6)  # else it may end, and the other resets by itself

    ours, theirs = StackFrames(make(), n_frames=3), VecFrameStack(DummyVecEnv([make]), 3)
    assert ours.observation_space == theirs.observation_space
    theirs.seed(1)
    np.testing.assert_array_equal(ours.reset(seed=1)[0], theirs.reset()[0])
    for action in np.linspace(-0.3, 0.3, 4, dtype=np.float32):
        observation = ours.step(np.full(4, action))[0]
        np.testing.assert_array_equal(observation, theirs.step(np.full((1, 4), action))[0][0])


def test_frames_that_are_no_images_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^StackFrames stacks at least one image, got n_frames 2 of Box"):
        StackFrames(gym.make("Pendulum-v1"), 2)
