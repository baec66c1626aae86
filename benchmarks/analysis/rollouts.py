"""Episodes of policies without networks, and simulation without rendering."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from sb3_stereo.evaluation.protocol import Evaluation, InitialState, summarise

Floats = NDArray[np.float64]
Policy = Callable[[Any, Mapping[str, Any]], Any]  # from an observation and `info` to an action


def play(env: gym.Env[Any, Any], initial_states: Sequence[InitialState], policy: Policy) -> Evaluation:
    """Score a policy, one episode from each start."""
    records = [_episode(env, start, policy) for start in initial_states]
    success, steps, pixels, returns, distance = (np.array(column) for column in zip(*records, strict=True))
    return summarise(success, steps, pixels, returns, episode_cap(env), distance=distance)


def episode_cap(env: gym.Env[Any, Any]) -> int:
    """Steps after which an episode is truncated."""
    assert env.spec is not None and env.spec.max_episode_steps is not None  # all registered ones have it
    return env.spec.max_episode_steps


def _episode(env: gym.Env[Any, Any], start: InitialState, policy: Policy) -> tuple[bool, int, float, float, float]:
    """Success, steps, final pixel distance, return and final distance in [m] of one episode."""
    observation, info = env.reset(**start)
    steps, total, ended = 0, 0.0, False
    while not ended:
        observation, reward, terminated, truncated, info = env.step(policy(observation, info))
        steps, total, ended = steps + 1, total + float(reward), terminated or truncated
    return bool(info["is_success"]), steps, float(np.mean(info["pixel_distances"])), total, info["distance"]


def random_actions(env: gym.Env[Any, Any], seed: int) -> Policy:
    """The policy of actions drawn uniformly from the action space."""
    env.action_space.seed(seed)
    return lambda observation, info: env.action_space.sample()


def constant_action(action: Floats) -> Policy:
    """The policy of one action, shape (n_joints,), whatever is seen."""
    return lambda observation, info: action


class BlindSimulation:
    """A `StereoReachEnv` that is stepped without drawing: markers are where they project to, whatever hides them.

    Args:
        env: The environment, without wrappers.
    """

    def __init__(self, env: Any) -> None:
        self.env = env

    def push(self, action: Floats) -> None:
        """Apply one action, shape (n_joints,), in [-1, 1]."""
        env = self.env
        env.arm.push((action * env.effort_limits).tolist(), env.n_pulse_steps)
        if env.braked:
            env.arm.brake()

    def distance(self, target: Floats) -> float:
        """Mean distance of the markers over the views, in [px] of the success frame.

        Args:
            target: Its position, shape (3,), in [m], world.
        """
        return float(self.distances(self.env.arm.end_effector_position, target))

    def distances(self, positions: Floats, target: Floats) -> Floats:
        """The same for end effectors at `positions`, shape (..., 3), in [m], world."""
        cameras = [camera.spec for camera in self.env.cameras]
        offsets = [camera.project(positions) - camera.project(target) for camera in cameras]
        return np.asarray(self.env.success_distances(np.stack(offsets)).mean(axis=0))
