"""Replay of stereo images: mirror-symmetry data augmentation, successes more often, and the markers' offsets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces
from gymnasium.spaces import Discrete
from numpy.typing import NDArray
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.vec_env import VecNormalize

from sb3_stereo.policies.dynamics import DynamicsSamples
from sb3_stereo.task_interface import OFFSETS, OffsetReward

Index = tuple[NDArray[np.int64], NDArray[np.int64]]  # rows and environments, (batch,) each
OWN_SETTINGS = frozenset(
    {
        "relabel_fraction",
        "mirror_probability",
        "success_fraction",
        "mirrored_joints",
        "n_views",
        "views_in_channels",
        "marker_map",
    }
)


class StereoReplayBuffer(ReplayBuffer):
    """Sample some transitions in the mirror, and those that end in success more often.

    With cameras and target placed symmetrically, a scene and its mirror image through the arm's vertical plane are
    the same task: each camera sees, flipped, what the other one saw, and the joints that turn about an axis in that
    plane turn the other way. A test compares the environment with its mirror image.

    With neither, every sample is SB3's own, draw for draw: that of its `ReplayBuffer`, or with `n_steps` that of its
    `NStepReplayBuffer`.

    Args:
        args: As in SB3's `ReplayBuffer`.
        n_views: Views in an image; the mirror reverses their order.
        views_in_channels: Each view is a channel (n_frames * n_views, height, width), and not a part of the rows
            (channels, n_views * height, width). None: if there are as many channels as views.
        marker_map: Every second channel shows where the markers are, and not luminance.
        mirrored_joints: Components of the action that change sign: for most arms the joints that turn about an axis in
            that plane. None if the task has no mirror image.
        offset_reward: The task's, see `StereoTask`; for subclasses.
        n_joints: Components that a discrete action numbers (see `QuantizedActions`); unused for a Box.
        mirror_probability: Fraction of the samples that are mirrored; None takes 0.5, or 0 without a mirror image.
        success_fraction: Fraction of the samples that are transitions into a terminal state, as soon as there is one.
            A random arm reaches the target about once in 300 steps, and what the critic knows of value starts there.
        n_steps: As in SB3's `NStepReplayBuffer`; 1 samples single transitions.
        gamma: The discount of `n_steps`.
        kwargs: As in SB3's `ReplayBuffer`.

    Raises:
        ValueError: If the settings contradict each other or the spaces.
    """

    def __init__(
        self,
        *args: Any,
        n_views: int = 2,
        views_in_channels: bool | None = None,
        marker_map: bool = False,
        mirrored_joints: Sequence[int] | None = None,
        offset_reward: OffsetReward | None = None,
        n_joints: int | None = None,
        mirror_probability: float | None = None,
        success_fraction: float = 0.0,
        n_steps: int = 1,
        gamma: float = 0.99,
        **kwargs: Any,
    ) -> None:
        _check_images(args[1] if len(args) > 1 else kwargs.get("observation_space"))
        super().__init__(*args, **kwargs)
        if mirror_probability is None:
            mirror_probability = 0.0 if mirrored_joints is None else 0.5
        for name, fraction in (("mirror_probability", mirror_probability), ("success_fraction", success_fraction)):
            if not 0.0 <= fraction <= 1.0:
                raise ValueError(f"{name} is {fraction}; give a number from 0 to 1")
        if mirror_probability and mirrored_joints is None:
            raise ValueError(
                f"mirror_probability is {mirror_probability}, but nothing says which joints change sign in the mirror; "
                "set mirrored_joints, or mirror_probability to 0"
            )
        if n_steps < 1 or (n_steps > 1 and self.optimize_memory_usage):
            problem = "give 1 or more" if n_steps < 1 else "set optimize_memory_usage to false for it"
            raise ValueError(f"n_steps is {n_steps}; {problem}")
        self.n_views, self.mirror_probability, self.success_fraction = n_views, mirror_probability, success_fraction
        self.n_steps, self.gamma, self.marker_map = n_steps, gamma, marker_map
        self.offset_reward = offset_reward
        self.views_in_channels = self.obs_shape[0] == n_views if views_in_channels is None else views_in_channels
        split = self.obs_shape[0 if self.views_in_channels else 1]
        if mirror_probability and split % n_views:
            what = "channels" if self.views_in_channels else "rows"
            raise ValueError(f"an image with {split} {what} does not hold {n_views} views; set mirror_probability to 0")
        self.offsets = np.full((self.buffer_size, self.n_envs, n_views, 2), np.nan, np.float32)
        self._set_up_actions(list(mirrored_joints or ()), n_joints)

    def _set_up_actions(self, mirrored: list[int], n_joints: int | None) -> None:
        self.n_joints = self.action_dim
        if isinstance(self.action_space, Discrete):
            if n_joints is None:
                raise ValueError("n_joints is not given; set how many joints a discrete action stands for")
            self.n_joints = n_joints
        self._signs = th.ones(self.n_joints)
        self._signs[mirrored] = -1.0
        if isinstance(self.action_space, Discrete):
            digits = _digits(int(self.action_space.n), self.n_joints)
            levels = int(digits.max()) + 1
            self._joint_actions = (2.0 * digits.T / (levels - 1) - 1.0).astype(np.float32)
            digits[mirrored] = levels - 1 - digits[mirrored]
            self._numbers = th.as_tensor(np.ravel_multi_index(tuple(digits), (levels,) * self.n_joints))

    def add(
        self,
        obs: NDArray[Any],
        next_obs: NDArray[Any],
        action: NDArray[Any],
        reward: NDArray[Any],
        done: NDArray[Any],
        infos: list[dict[str, Any]],
    ) -> None:
        """As in SB3; the offsets in `infos`, if there are any, are stored as well."""
        for env, info in enumerate(infos):
            self.offsets[self.pos, env] = info.get(OFFSETS, np.nan)
        super().add(obs, next_obs, action, reward, done, infos)

    def sample(self, batch_size: int, env: VecNormalize | None = None) -> ReplayBufferSamples:
        """As in SB3, with the fractions of successes and of mirror images."""
        at = self._draw(batch_size, self.success_fraction)
        returns, last, discounts = self._n_step_returns(at, env)
        arrays: tuple[Any, ...] = (
            self._normalize_obs(self.observations[at], env),
            self.actions[at],
            self._normalize_obs(self._next_images(last), env),
            self._terminal(last)[:, None],
            returns,
        )
        self._mirror_some(arrays[:3], (self.mirror, self.mirror_actions, self.mirror))
        samples = ReplayBufferSamples(*(self.to_torch(array, copy=False) for array in arrays))  # they are copies
        return samples if self.n_steps == 1 else samples._replace(discounts=self.to_torch(discounts))

    def sample_dynamics(self, batch_size: int) -> DynamicsSamples:
        """Sample single transitions, mirrored like those of `sample`, without rewards."""
        at = self._draw(batch_size)
        actions = self.actions[at]
        moves = self._joint_actions[actions[:, 0]] if isinstance(self.action_space, Discrete) else actions
        arrays = (self.observations[at], moves, self._next_images(at), self.offsets[at])
        self._mirror_some(arrays, (self.mirror, self.mirror_joint_actions, self.mirror, self.mirror_offsets))
        return DynamicsSamples(*(self.to_torch(array, copy=False) for array in arrays))

    def _draw(self, batch_size: int, success_fraction: float = 0.0) -> Index:
        """Draw transitions, by NumPy's global generator in SB3's order; the successes come first."""
        # SB3's memory saver keeps a next image in the following row, so that a full buffer's newest transition has
        # written over the oldest one's image.
        oldest_is_gone = self.full and self.optimize_memory_usage
        rows = np.random.randint(int(oldest_is_gone), self.size(), batch_size)
        rows = (rows + self.pos) % self.buffer_size if oldest_is_gone else rows
        envs = np.random.randint(0, self.n_envs, batch_size)
        successes = np.argwhere(self._terminal(slice(None))) if success_fraction else np.empty((0, 2))
        successes = successes[successes[:, 0] != self.pos] if oldest_is_gone else successes
        if len(successes):
            n = round(success_fraction * batch_size)
            rows[:n], envs[:n] = successes[np.random.randint(0, len(successes), n)].T
        return rows, envs

    def _n_step_returns(
        self, at: Index, env: VecNormalize | None
    ) -> tuple[NDArray[np.float32], Index, NDArray[np.float32]]:
        """The discounted rewards of up to n steps, the last of these, and the discount of what follows.

        As SB3's `NStepReplayBuffer`: an episode's end, or the newest transition, ends them.
        """
        rows, envs = at
        windows = (rows[:, None] + np.arange(self.n_steps)) % self.buffer_size, envs[:, None]  # (batch, n_steps)
        ends = (self.dones[windows] + self.timeouts[windows] > 0) | (windows[0] == (self.pos - 1) % self.buffer_size)
        last = np.where(ends.any(axis=1), ends.argmax(axis=1), self.n_steps - 1)
        taken = np.arange(self.n_steps) <= last[:, None]
        weights = self.gamma ** np.arange(self.n_steps, dtype=np.float32)
        returns = (self._normalize_reward(self.rewards[windows], env) * weights * taken).sum(axis=1, keepdims=True)
        discounts = self.gamma ** taken.sum(axis=1, keepdims=True).astype(np.float32)
        return returns.astype(np.float32), ((rows + last) % self.buffer_size, envs), discounts

    def _terminal(self, at: Index | slice) -> NDArray[np.float32]:
        """1 for transitions into a terminal state, 0 for others and where only time ran out."""
        terminal: NDArray[np.float32] = self.dones[at] * (1 - self.timeouts[at])
        return terminal

    def _next_images(self, at: Index) -> NDArray[Any]:
        rows, envs = at
        if self.optimize_memory_usage:
            return np.asarray(self.observations[(rows + 1) % self.buffer_size, envs])
        return np.asarray(self.next_observations[at])

    def _mirror_some(self, arrays: Sequence[NDArray[Any]], mirrors: Sequence[Callable[[th.Tensor], th.Tensor]]) -> None:
        """Mirror the same samples in every array, in place: they are copies of the buffer."""
        if not self.mirror_probability:
            return
        chosen = np.flatnonzero(np.random.random(len(arrays[0])) < self.mirror_probability)
        for array, mirror in zip(arrays, mirrors, strict=True):
            array[chosen] = mirror(th.from_numpy(array[chosen])).numpy()  # NumPy's takes a thirtieth of torch's

    def mirror(self, images: th.Tensor) -> th.Tensor:
        """Flip every view left to right and reverse their order, within each frame of a stack.

        Args:
            images: Shape (batch, channels, n_views * height, width), or (batch, n_frames * n_views, height, width) if
                each view is a channel.
        """
        n_images, channels, height, width = images.shape
        if self.views_in_channels:
            frames = images.reshape(n_images, channels // self.n_views, self.n_views, height, width)
            return frames.flip(2, 4).flatten(1, 2)
        views = images.reshape(n_images, channels, self.n_views, height // self.n_views, width)
        return views.flip(2, 4).flatten(2, 3)

    def mirror_actions(self, actions: th.Tensor) -> th.Tensor:
        """The actions (batch, action_dim) that do in the mirror what these do."""
        if isinstance(self.action_space, Discrete):
            numbers: th.Tensor = self._numbers[actions]
            return numbers
        return self.mirror_joint_actions(actions)

    def mirror_joint_actions(self, actions: th.Tensor) -> th.Tensor:
        """The actions of the joints (batch, n_joints) that do in the mirror what these do."""
        return actions * self._signs

    def mirror_offsets(self, offsets: th.Tensor) -> th.Tensor:
        """What the offsets (batch, n_views, 2) are in the mirror: the views swap, and left is right."""
        return offsets.flip(1) * offsets.new_tensor([-1.0, 1.0])


def _digits(n_actions: int, n_joints: int) -> NDArray[np.int64]:
    """For every number of `QuantizedActions` the level of each joint, shape (n_joints, n_actions)."""
    levels = round(n_actions ** (1 / n_joints))
    if levels**n_joints != n_actions:
        raise ValueError(f"{n_actions} actions are not the combinations of {n_joints} joints; set n_joints")
    return np.stack(np.unravel_index(np.arange(n_actions), (levels,) * n_joints)).astype(np.int64)


def _check_images(space: spaces.Space[Any] | None) -> None:
    if isinstance(space, spaces.Dict):
        raise ValueError(
            "a StereoReplayBuffer holds one image per observation, and this environment gives a map of them; "
            "set its composite to 'stack' or 'channels', or leave replay_buffer_kwargs and encoder_loss out"
        )
    if space is not None and len(space.shape or ()) != 3:
        raise ValueError(
            f"a StereoReplayBuffer holds images (channels, height, width), and these observations are {space}; "
            "take SB3's own replay buffer for them"
        )
