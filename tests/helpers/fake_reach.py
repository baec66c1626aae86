"""A reach task without a simulator, with the real one's spaces, resets and info; importing it registers `FakeReach-v0`.

A brightness stands for the first joint, which every action moves by half its first component. The goal is near 0.
"""

from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium import spaces

ENV_ID = "FakeReach-v0"
MAX_STEPS = 5


class FakeReachEnv(gym.Env[np.ndarray, np.ndarray]):
    """See the module; `tolerance` is the largest |J1| that counts as reached."""

    mirrored_joints = (0, 2)
    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"]}

    def __init__(self, tolerance: float = 0.25, render_mode: str | None = None) -> None:
        if tolerance <= 0:
            raise ValueError(f"tolerance must be positive, got {tolerance}")
        self.tolerance = tolerance
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (1, 60, 60), np.uint8)
        self.action_space = spaces.Box(-1.0, 1.0, (4,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        drawn = self.np_random.uniform(-1.0, 1.0, 4)
        self.joints = np.array((options or {}).get("joint_positions", drawn), dtype=float)
        return self._observe(), self._info()

    def step(self, action: np.ndarray) -> Any:
        before = abs(self.joints[0])
        self.joints = self.joints + 0.5 * np.asarray(action)
        info = self._info()
        reward = 1.0 if info["is_success"] else float(before - abs(self.joints[0]))
        return self._observe(), reward, info["is_success"], False, info

    def _observe(self) -> np.ndarray:
        value = np.clip(127 + 60 * self.joints[0], 0, 255)
        return np.full(self.observation_space.shape, value, np.uint8)

    def _info(self) -> dict[str, Any]:
        distance = 100 * abs(self.joints[0])
        is_success = bool(abs(self.joints[0]) <= self.tolerance)
        offsets = np.array([[100 * self.joints[0], 0.0], [np.nan, np.nan]])
        distances = np.array([distance, np.nan])
        return {
            "is_success": is_success,
            "pixel_distances": distances,
            "pixel_offsets": offsets,
            "distance": float(abs(self.joints[0])),
        }


if ENV_ID not in gym.registry:
    gym.register(ENV_ID, entry_point="fake_reach:FakeReachEnv", max_episode_steps=MAX_STEPS)
