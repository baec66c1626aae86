"""A tiny image environment: policies are tested without a simulator."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces


class FakeImageEnv(gym.Env[np.ndarray, Any]):
    """Noise images; the reward is larger for small actions, or for action 0.

    Args:
        shape: Of the image, (channels, height, width).
        n_actions: Size of the discrete action space; None means Box(-1, 1, (4,)).
        episode_length: Steps until the episode is truncated.
    """

    def __init__(
        self, shape: tuple[int, int, int] = (1, 36, 36), n_actions: int | None = None, episode_length: int = 5
    ) -> None:
        self.observation_space = spaces.Box(0, 255, shape, np.uint8)
        self.action_space = spaces.Box(-1.0, 1.0, (4,)) if n_actions is None else spaces.Discrete(n_actions)
        self.episode_length = episode_length
        self.step_count = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self.step_count = 0
        return self._image(), {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        self.step_count += 1
        reward = -float(np.square(action).sum())
        return self._image(), reward, False, self.step_count >= self.episode_length, {}

    def _image(self) -> np.ndarray:
        return self.np_random.integers(0, 256, self.observation_space.shape, dtype=np.uint8)
