"""Wrappers: quantised joint torques for discrete actions, callbacks within a control step, stacked frames."""

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box, Discrete, MultiDiscrete
from gymnasium.wrappers import FrameStackObservation
from numpy.typing import NDArray

MAX_ACTIONS = 10_000  # one output per action: beyond this no Q network is sensible


class QuantizedActions(gym.ActionWrapper[Any, np.int64, NDArray[np.float32]]):
    """Each component of a Box action quantised, all combinations numbered: MultiDiscrete to Discrete.

    The number is the digits of the components in the mixed radix `multi_discrete.nvec`, the first joint highest.

    Args:
        env: Environment with a bounded one-dimensional Box action.
        levels: Evenly spaced values per component from its lowest to its highest, both included; 3 gives full
            effort back, none, full effort forward, and 3 ** 4 = 81 actions.

    Raises:
        ValueError: If the actions cannot be quantised so.
    """

    def __init__(self, env: gym.Env[Any, NDArray[np.float32]], levels: int = 3) -> None:
        super().__init__(env)
        box = env.action_space
        if not isinstance(box, Box) or not box.is_bounded() or len(box.shape) != 1:
            raise ValueError(f"cannot quantise {box}; it takes a bounded one-dimensional Box")
        if levels < 2 or levels ** box.shape[0] > MAX_ACTIONS:
            raise ValueError(
                f"{levels} levels for {box.shape[0]} joints; take at least 2, and at most {MAX_ACTIONS} actions in all"
            )
        self.multi_discrete = MultiDiscrete([levels] * box.shape[0])
        self._n_actions = levels ** box.shape[0]
        self.action_space = Discrete(self._n_actions)
        self._values = np.linspace(box.low, box.high, levels, dtype=np.float32)  # (levels, n_joints)
        self._joints = np.arange(box.shape[0])

    @property
    def n_joints(self) -> int:
        """Components that a number stands for."""
        return len(self._joints)

    def levels_of(self, action: int) -> NDArray[np.int64]:
        """The level of each joint, shape (n_joints,), that the number `action` stands for."""
        return np.array(np.unravel_index(action, self.multi_discrete.nvec), dtype=np.int64)

    def number_of(self, levels: NDArray[np.int64]) -> int:
        """The number that stands for one level per joint, shape (n_joints,); the inverse of `levels_of`."""
        return int(np.ravel_multi_index(tuple(levels), tuple(self.multi_discrete.nvec)))

    def action(self, action: np.int64) -> NDArray[np.float32]:
        """The wrapped environment's action, shape (n_joints,), for a number."""
        if not self.action_space.contains(action):
            raise ValueError(f"action {action!r}; it must be an integer from 0 to {self._n_actions - 1}")
        return self._values[self.levels_of(int(action)), self._joints]


class WatchedPulses(gym.Wrapper[Any, Any, Any, Any]):
    """Interrupt every pulse to look at the arm on its way; the motion and the step stay the same to the bit.

    Args:
        env: A `StereoReachEnv`, wrapped or not, also in another `WatchedPulses`: each looks at its own parts.
        look: Called with the efforts [N m] between the parts of a pulse.
        n_parts: Equal parts of a pulse; it is looked at after each but the last, where the step's own frames are.

    Raises:
        ValueError: If the environment is another one, or `n_parts` is not a positive integer.
    """

    def __init__(self, env: gym.Env[Any, Any], look: Callable[[Sequence[float]], object], n_parts: int = 6) -> None:
        super().__init__(env)
        if not hasattr(self.unwrapped, "pulse_watchers"):
            raise ValueError(f"cannot watch the pulses of {self.unwrapped}; it takes a StereoReachEnv")
        if not isinstance(n_parts, int) or n_parts < 1:
            raise ValueError(f"n_parts is {n_parts!r}; give an integer of at least 1")
        self._watcher = look, n_parts

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and look on the way."""
        watchers: Any = self.unwrapped.pulse_watchers  # type: ignore[attr-defined]
        watchers.append(self._watcher)
        try:
            return self.env.step(action)
        finally:
            watchers.remove(self._watcher)


class StackFrames(gym.Wrapper[Any, Any, Any, Any]):
    """The last images as the channels of one, oldest first, as SB3's `VecFrameStack` has them; black before the first.

    Args:
        env: Whose observations are images, with the channels first or last.
        n_frames: How many.

    Raises:
        ValueError: If the observations are no images.
    """

    def __init__(self, env: gym.Env[Any, Any], n_frames: int) -> None:
        space = env.observation_space
        if not isinstance(space, Box) or len(space.shape) != 3 or n_frames < 1:
            raise ValueError(f"StackFrames stacks at least one image, got n_frames {n_frames} of {space}")
        super().__init__(FrameStackObservation(env, n_frames, padding_type="zero"))
        self._axis = 0 if np.argmin(space.shape) == 0 else -1
        low, high = (np.concatenate([bound] * n_frames, self._axis) for bound in (space.low, space.high))
        self.observation_space = Box(low, high, dtype=space.dtype.type)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """As in Gymnasium."""
        frames, info = self.env.reset(seed=seed, options=options)
        return np.concatenate(frames, self._axis), info

    def step(self, action: Any) -> Any:
        """As in Gymnasium."""
        frames, *rest = self.env.step(action)
        return np.concatenate(frames, self._axis), *rest
