"""Replay of stereo images: every transition in the mirror as well, goals more often, and what was seen to move."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch as th
from gymnasium.spaces import Discrete
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import DictReplayBuffer, ReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.vec_env import VecNormalize

from sb3_stereo.policies.dynamics import Motion
from sb3_stereo.task_interface import OFFSETS, asked, check_views

Index = tuple[NDArray[np.int64], NDArray[np.int64]]  # rows and environments, (batch,) each


class StereoReplayBuffer(ReplayBuffer):
    """Sample some transitions in the mirror, which adds experience without a step of interaction, and goals often.

    With cameras and target placed symmetrically, a scene and its mirror image through the arm's vertical plane are
    the same task: each camera sees, flipped, what the other one saw, and the joints that turn about an axis in that
    plane turn the other way. A test compares the environment with its mirror image.

    Args:
        args: As in SB3's `ReplayBuffer`.
        n_views: Views in an image; the mirror reverses their order.
        views_in_channels: Each view is a channel (n_views, height, width), and not a part of the rows (channels,
            n_views * height, width). None: if there are as many channels as views.
        mirrored_joints: Components of the action that change sign: for most arms the joints that turn about an axis in
            that plane. None if the task has no mirror image.
        n_joints: Components that a discrete action numbers (see `QuantizedActions`); unused for a Box.
        mirror_probability: Share of the samples that are mirrored; None takes 0.5, or 0 without a mirror image.
        goal_share: Share of the samples that are transitions into a terminal state, as soon as there is one. A random
            arm reaches the target about once in 300 steps, and what the critic knows of value starts there.
        kwargs: As in SB3's `ReplayBuffer`.
    """

    def __init__(
        self,
        *args: Any,
        n_views: int = 2,
        views_in_channels: bool | None = None,
        mirrored_joints: Sequence[int] | None = None,
        n_joints: int | None = None,
        mirror_probability: float | None = None,
        goal_share: float = 0.0,
        **kwargs: Any,
    ) -> None:
        super().__init__(*args, **kwargs)
        self._set_up(n_views, views_in_channels, mirrored_joints, n_joints, mirror_probability, goal_share)

    @classmethod
    def of(cls, model: BaseAlgorithm, **settings: Any) -> StereoReplayBuffer:
        """Take over a model's buffer with all its transitions.

        Args:
            model: Whose buffer it is; give it the one that is returned.
            settings: `n_views` and the other arguments of this class that `ReplayBuffer` does not have.

        Raises:
            ValueError: If the model has none.
        """
        if not isinstance(model, OffPolicyAlgorithm) or model.replay_buffer is None:
            raise ValueError(f"a StereoReplayBuffer replaces a replay buffer, and {type(model).__name__} has none")
        if isinstance(model.replay_buffer, DictReplayBuffer):
            raise ValueError(
                "a StereoReplayBuffer holds one image per observation, and this environment gives a map of them; "
                "set its composite to 'stack' or 'channels', or leave StereoReplay and LearnFromMotion out"
            )
        stereo = cls.__new__(cls)
        stereo.__dict__.update(model.replay_buffer.__dict__)
        stereo._set_up(**settings)
        return stereo

    def _set_up(
        self,
        n_views: int = 2,
        views_in_channels: bool | None = None,
        mirrored_joints: Sequence[int] | None = None,
        n_joints: int | None = None,
        mirror_probability: float | None = None,
        goal_share: float = 0.0,
    ) -> None:
        if mirror_probability is None:
            mirror_probability = 0.0 if mirrored_joints is None else 0.5
        for name, share in (("mirror_probability", mirror_probability), ("goal_share", goal_share)):
            if not 0.0 <= share <= 1.0:
                raise ValueError(f"{name} is {share}; give a number from 0 to 1")
        if mirror_probability and mirrored_joints is None:
            raise ValueError(
                f"mirror_probability is {mirror_probability}, but nothing says which joints change sign in the mirror; "
                "set mirrored_joints, or mirror_probability to 0"
            )
        self.n_views, self.mirror_probability, self.goal_share = n_views, mirror_probability, goal_share
        self.views_in_channels = self.obs_shape[0] == n_views if views_in_channels is None else views_in_channels
        self.n_joints = self.action_dim
        if isinstance(self.action_space, Discrete):
            if n_joints is None:
                raise ValueError("n_joints is not given; set how many joints a discrete action stands for")
            self.n_joints = n_joints
        if not hasattr(self, "offsets"):
            self.offsets = np.full((self.buffer_size, self.n_envs, n_views, 2), np.nan, np.float32)
        mirrored = list(mirrored_joints or ())
        self._signs = th.ones(self.n_joints)
        self._signs[mirrored] = -1.0
        if isinstance(self.action_space, Discrete):
            digits = _digits(int(self.action_space.n), self.n_joints)
            levels = int(digits.max()) + 1
            self._efforts = (2.0 * digits.T / (levels - 1) - 1.0).astype(np.float32)
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
        """As in SB3, with the shares of goals and of mirror images."""
        at = self._draw(batch_size, self.goal_share)
        arrays: tuple[Any, ...] = (
            self._normalize_obs(self.observations[at], env),
            self.actions[at],
            self._normalize_obs(self._next_images(at), env),
            self._terminal(at)[:, None],
            self._normalize_reward(self.rewards[at][:, None], env),
        )
        self._mirror_some(arrays[:3], (self.mirror, self.mirror_actions, self.mirror))
        return ReplayBufferSamples(*(self.to_torch(array, copy=False) for array in arrays))  # they are copies

    def sample_motion(self, batch_size: int) -> Motion:
        """Sample transitions, mirrored like those of `sample`, without rewards."""
        at = self._draw(batch_size)
        actions = self.actions[at]
        efforts = self._efforts[actions[:, 0]] if isinstance(self.action_space, Discrete) else actions
        arrays = (self.observations[at], efforts, self._next_images(at), self.offsets[at])
        self._mirror_some(arrays, (self.mirror, self.mirror_efforts, self.mirror, self.mirror_offsets))
        return Motion(*(self.to_torch(array, copy=False) for array in arrays))

    def _draw(self, batch_size: int, goal_share: float = 0.0) -> Index:
        """Draw transitions, by NumPy's global generator as SB3 does; the goals come first."""
        oldest, skipped = self._oldest
        rows = (oldest + np.random.randint(skipped, self.size(), batch_size)) % self.buffer_size
        envs = np.random.randint(0, self.n_envs, batch_size)
        goals = np.argwhere(self._terminal(slice(None))) if goal_share else np.empty((0, 2))
        goals = goals[goals[:, 0] != oldest] if skipped else goals
        if len(goals):
            n_goals = round(goal_share * batch_size)
            rows[:n_goals], envs[:n_goals] = goals[np.random.randint(0, len(goals), n_goals)].T
        return rows, envs

    @property
    def _oldest(self) -> tuple[int, int]:
        """The oldest row, and whether it (1 or 0) is to be skipped.

        SB3's memory saver keeps a next image in the following row, so that a full buffer's newest transition has
        written over the oldest one's image.
        """
        return (self.pos, int(self.optimize_memory_usage)) if self.full else (0, 0)

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
        chosen = np.flatnonzero(np.random.random(len(arrays[0])) < self.mirror_probability)
        for array, mirror in zip(arrays, mirrors, strict=True):
            array[chosen] = mirror(th.from_numpy(array[chosen])).numpy()  # NumPy's takes a thirtieth of torch's

    def mirror(self, images: th.Tensor) -> th.Tensor:
        """Flip every view left to right and reverse their order.

        Args:
            images: Shape (batch, channels, n_views * height, width), or (batch, n_views, height, width) if each view
                is a channel.
        """
        n_images, channels, height, width = images.shape
        if self.views_in_channels:
            return images.flip(1, 3)
        views = images.reshape(n_images, channels, self.n_views, height // self.n_views, width)
        return views.flip(2, 4).flatten(2, 3)

    def mirror_actions(self, actions: th.Tensor) -> th.Tensor:
        """The actions (batch, action_dim) that do in the mirror what these do."""
        if isinstance(self.action_space, Discrete):
            numbers: th.Tensor = self._numbers[actions]
            return numbers
        return self.mirror_efforts(actions)

    def mirror_efforts(self, efforts: th.Tensor) -> th.Tensor:
        """The efforts (batch, n_joints) that do in the mirror what these do."""
        return efforts * self._signs

    def mirror_offsets(self, offsets: th.Tensor) -> th.Tensor:
        """What the offsets (batch, n_views, 2) are in the mirror: the views swap, and left is right."""
        return offsets.flip(1) * offsets.new_tensor([-1.0, 1.0])


def _digits(n_actions: int, n_joints: int) -> NDArray[np.int64]:
    """For every number of `QuantizedActions` the level of each joint, shape (n_joints, n_actions)."""
    levels = round(n_actions ** (1 / n_joints))
    if levels**n_joints != n_actions:
        raise ValueError(f"{n_actions} actions are not the combinations of {n_joints} joints; set n_joints")
    return np.stack(np.unravel_index(np.arange(n_actions), (levels,) * n_joints)).astype(np.int64)


class StereoReplay(BaseCallback):
    """Make a model's replay buffer a `StereoReplayBuffer`, as a YAML file, also the zoo's, can ask for.

    Args:
        n_views: As in `StereoReplayBuffer`.
        mirrored_joints: As in `StereoReplayBuffer`; None asks the environment.
        n_joints: As in `StereoReplayBuffer`; None asks `QuantizedActions`.
        mirror_probability: As in `StereoReplayBuffer`.
        goal_share: As in `StereoReplayBuffer`.
        verbose: As in SB3.
    """

    def __init__(
        self,
        n_views: int = 2,
        mirrored_joints: Sequence[int] | None = None,
        n_joints: int | None = None,
        mirror_probability: float | None = None,
        goal_share: float = 0.0,
        verbose: int = 0,
    ) -> None:
        super().__init__(verbose)
        self.n_views, self.mirrored_joints, self.n_joints = n_views, mirrored_joints, n_joints
        self.mirror_probability, self.goal_share = mirror_probability, goal_share

    def _on_training_start(self) -> None:
        model: Any = self.model
        env = self.training_env
        check_views(env, self.n_views, "StereoReplay has n_views", "callback.StereoReplay.n_views")
        model.replay_buffer = StereoReplayBuffer.of(
            model,
            n_views=self.n_views,
            views_in_channels=asked(env, "views_in_channels"),
            mirrored_joints=asked(env, "mirrored_joints") if self.mirrored_joints is None else self.mirrored_joints,
            n_joints=asked(env, "n_joints") if self.n_joints is None else self.n_joints,
            mirror_probability=self.mirror_probability,
            goal_share=self.goal_share,
        )

    def _on_step(self) -> bool:
        return True
