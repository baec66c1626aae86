"""Replay with other targets than the real one: where the end effector has been is a target, in pixels."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecNormalize

from sb3_stereo.learning.replay import Index, StereoReplayBuffer
from sb3_stereo.task_interface import PREVIOUS_OFFSETS, TARGET

AHEAD = 30  # steps after a transition from which a target of the same episode is taken
FROM_EPISODE = 0.5  # of the relabelled samples; the others get a target from anywhere in the buffer


class RelabelledSamples(NamedTuple):
    """SB3's `ReplayBufferSamples`, and for which target they count."""

    observations: th.Tensor
    actions: th.Tensor
    next_observations: th.Tensor
    dones: th.Tensor
    rewards: th.Tensor
    displacements: th.Tensor  # of the target from the one in the images, (batch, n_views, 2) in [px]
    discounts: th.Tensor | None = None


class RelabellingReplayBuffer(StereoReplayBuffer):
    """Hindsight experience replay (Andrychowicz et al. 2017) for targets in images.

    A relabelled sample counts as if the target were where the end effector was once: later in the same episode or, just
    as often, in any other transition. Reward and end are computed for that target; the images stay as they are, and the
    networks are told by how much the target is displaced. A sample in which a marker is hidden keeps its target.

    Args:
        args: As in `StereoReplayBuffer`.
        relabel_fraction: Fraction of the samples that are relabelled, of those that `success_fraction` leaves.
        kwargs: As in `StereoReplayBuffer`.

    Raises:
        ValueError: If the settings contradict each other or the spaces.
    """

    def __init__(self, *args: Any, relabel_fraction: float = 0.8, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        if not 0.0 <= relabel_fraction <= 1.0:
            raise ValueError(f"relabel_fraction is {relabel_fraction}; give a number from 0 to 1")
        if self.offset_reward is None:
            raise ValueError(
                "relabel_fraction needs a reward that offsets decide (the environment's offset_reward), and this "
                "environment has none; leave it out"
            )
        if self.n_steps > 1:
            raise ValueError(f"n_steps is {self.n_steps}, and relabelled samples are single transitions; leave it out")
        self.relabel_fraction = relabel_fraction
        self.previous_offsets, self.targets = self.offsets.copy(), self.offsets.copy()

    def add(
        self,
        obs: NDArray[Any],
        next_obs: NDArray[Any],
        action: NDArray[Any],
        reward: NDArray[Any],
        done: NDArray[Any],
        infos: list[dict[str, Any]],
    ) -> None:
        """As in `StereoReplayBuffer`."""
        for env, info in enumerate(infos):
            self.previous_offsets[self.pos, env] = info.get(PREVIOUS_OFFSETS, np.nan)
            self.targets[self.pos, env] = info.get(TARGET, np.nan)
        super().add(obs, next_obs, action, reward, done, infos)

    def sample(self, batch_size: int, env: VecNormalize | None = None) -> RelabelledSamples:  # type: ignore[override]
        """As in `StereoReplayBuffer`, relabelled."""
        at = self._draw(batch_size, self.success_fraction)
        displacements = self._displacements(at, n_kept=round(self.success_fraction * batch_size))
        rewards, reached = self._judged(at, displacements)
        images = self._normalize_obs(self.observations[at], env), self._normalize_obs(self._next_images(at), env)
        actions = self.actions[at]
        moved: tuple[Any, ...] = (images[0], actions, images[1], displacements)
        self._mirror_some(moved, (self.mirror, self.mirror_actions, self.mirror, self.mirror_offsets))
        arrays: tuple[Any, ...] = (images[0], actions, images[1], reached, self._normalize_reward(rewards, env))
        return RelabelledSamples(*(self.to_torch(array, copy=False) for array in (*arrays, displacements)))

    def _displacements(self, at: Index, n_kept: int) -> NDArray[np.float32]:
        """Of the targets, (batch, n_views, 2) in [px]; 0 for the first `n_kept` and all others that keep theirs."""
        batch_size = len(at[0])
        anywhere = np.random.randint(0, self.size(), batch_size), np.random.randint(0, self.n_envs, batch_size)
        in_episode = np.random.random(batch_size) < FROM_EPISODE
        there = tuple(np.where(in_episode, *pair) for pair in zip(self._later(at), anywhere, strict=True))
        displacements: NDArray[np.float32] = self.offsets[there] + self.targets[there] - self.targets[at]
        kept = np.random.random(batch_size) >= self.relabel_fraction
        kept[:n_kept] = True
        hidden = np.isnan(displacements + self.offsets[at] + self.previous_offsets[at]).any(axis=(1, 2))
        displacements[kept | hidden] = 0.0
        return displacements

    def _later(self, at: Index) -> Index:
        """For each transition one of the same episode, evenly drawn from itself to the last."""
        rows, envs = at
        ahead = (rows[:, None] + np.arange(AHEAD)) % self.buffer_size
        ends = (self.dones[ahead, envs[:, None]] > 0) | (ahead == (self.pos - 1) % self.buffer_size)
        n_left = np.where(ends.any(axis=1), ends.argmax(axis=1), AHEAD - 1)
        return (rows + np.random.randint(0, n_left + 1)) % self.buffer_size, envs

    def _judged(self, at: Index, displacements: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Rewards and ends for these targets, (batch, 1) each; as they were stored where the target is the real one."""
        assert self.offset_reward is not None
        rewards, reached = self.offset_reward(
            self.previous_offsets[at] - displacements, self.offsets[at] - displacements
        )
        real = (displacements == 0.0).all(axis=(1, 2))
        rewards = np.where(real, self.rewards[at], rewards).astype(np.float32)
        return rewards[:, None], np.where(real, self._terminal(at), reached).astype(np.float32)[:, None]
