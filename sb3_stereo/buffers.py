"""Replay buffers for stereo images."""

from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.vec_env import VecNormalize


class MirrorReplayBuffer(ReplayBuffer):
    """Sample every other transition in the mirror, which doubles the experience without a step of interaction.

    With cameras and target placed symmetrically, a scene and its mirror image through the arm's vertical plane are
    the same task: each camera sees, flipped, what the other one saw, and the joints that turn about an axis in that
    plane turn the other way. (A test compares the environment with its mirror image.)

    Args:
        args: As in SB3's `ReplayBuffer`.
        n_views: Views that are stacked in a composite (1, n_views * height, width); mirrored in reverse order.
        mirrored_joints: Components of the action that change sign: J1 and J3 of the WAM.
        kwargs: As in SB3's `ReplayBuffer`.
    """

    def __init__(
        self, *args: Any, n_views: int = 2, mirrored_joints: tuple[int, ...] | list[int] = (0, 2), **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.n_views = n_views
        self.signs = th.ones(self.action_dim, device=self.device)
        self.signs[list(mirrored_joints)] = -1.0

    def _get_samples(self, batch_inds: np.ndarray, env: VecNormalize | None = None) -> ReplayBufferSamples:
        samples = super()._get_samples(batch_inds, env)
        mirrored = th.as_tensor(np.random.random(len(batch_inds)) < 0.5, device=self.device)  # SB3's generator
        return samples._replace(
            observations=self._mirror(samples.observations, mirrored),
            actions=th.where(mirrored[:, None], samples.actions * self.signs, samples.actions),
            next_observations=self._mirror(samples.next_observations, mirrored),
        )

    def _mirror(self, images: th.Tensor, mirrored: th.Tensor) -> th.Tensor:
        """Flip the marked images (batch, 1, n_views * height, width) left to right and swap their views."""
        views = images.unflatten(2, (self.n_views, -1))  # (batch, 1, n_views, height, width)
        flipped = views.flip(2, 4).flatten(2, 3)
        return th.where(mirrored[:, None, None, None], flipped, images)
