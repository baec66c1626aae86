"""Observations without images, for learners that are told what ours must see: they show what seeing costs."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box, Dict
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import ArrayLike, NDArray

from sb3_stereo.envs.composite import IMAGE
from sb3_stereo.envs.goal import StereoReachGoalEnv

GOALS = ("achieved_goal", "desired_goal")


class WithoutImages(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """A goal environment whose observations have the joint angles, or nothing, in place of the image.

    Observation: `Dict` of `achieved_goal` and `desired_goal`, the markers' centres in each view, shape (2 * n_views,),
    from -1 to 1 over the frame (a hidden marker is in the corner, at -1), and with `joints` of `observation`, the
    actuated joints' angles, shape (n_joints,), from -1 to 1 over their limits. Without it `observation` is the
    achieved goal. `compute_reward` and `compute_terminated` take goals in these units.

    Args:
        env: A `StereoReachGoalEnv`, wrapped or not.
        joints: Whether the joint angles are told.

    Raises:
        ValueError: If it is another environment.
    """

    def __init__(self, env: gym.Env[Any, Any], joints: bool = True) -> None:
        RecordConstructorArgs.__init__(self, joints=joints)
        gym.Wrapper.__init__(self, env)
        task = env.unwrapped
        if not isinstance(task, StereoReachGoalEnv):
            raise ValueError(f"WithoutImages needs the goals of WamStereoReachGoal-v0 or its like, got {task}")
        self._limits = task.arm.limits if joints else None
        assert isinstance(env.observation_space, Dict)
        goals = env.observation_space["desired_goal"]
        assert isinstance(goals, Box)
        self._goal_range = goals.low, goals.high
        size = len(goals.low) if self._limits is None else len(self._limits)
        spaces = {IMAGE: size, **dict.fromkeys(GOALS, len(goals.low))}
        self.observation_space = Dict({name: Box(-1.0, 1.0, (n,), np.float64) for name, n in spaces.items()})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """As in Gymnasium."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._told(observation), info

    def step(self, action: Any) -> Any:
        """As in Gymnasium."""
        observation, *rest = self.env.step(action)
        return self._told(observation), *rest

    def compute_reward(self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any) -> Any:
        """As in `StereoReachGoalEnv`, of goals from -1 to 1."""
        return self._task.compute_reward(self._in_pixels(achieved_goal), self._in_pixels(desired_goal), info)

    def compute_terminated(self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any) -> Any:
        """As in `StereoReachGoalEnv`, of goals from -1 to 1."""
        return self._task.compute_terminated(self._in_pixels(achieved_goal), self._in_pixels(desired_goal), info)

    @property
    def _task(self) -> StereoReachGoalEnv:
        task = self.env.unwrapped
        assert isinstance(task, StereoReachGoalEnv)  # checked when it was wrapped
        return task

    def _told(self, observation: dict[str, Any]) -> dict[str, NDArray[np.float64]]:
        told = {name: _scaled(observation[name], *self._goal_range) for name in GOALS}
        joints = self._limits
        told[IMAGE] = told[GOALS[0]] if joints is None else _scaled(self._task.arm.actuated_positions, *joints.T)
        return told

    def _in_pixels(self, goals: ArrayLike) -> NDArray[np.float64]:
        low, high = self._goal_range
        # A hidden marker is exactly at -1, and so is its goal in pixels.
        return np.asarray(low + (np.asarray(goals, np.float64) + 1.0) / 2.0 * (high - low))


def _scaled(values: ArrayLike, low: NDArray[Any], high: NDArray[Any]) -> NDArray[np.float64]:
    """From -1 to 1 between the bounds; joint limits may be passed by what the simulation's solver allows."""
    return np.asarray(np.clip(2.0 * (np.asarray(values, np.float64) - low) / (high - low) - 1.0, -1.0, 1.0))
