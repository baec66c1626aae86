"""Replay that sees every transition in the mirror as well."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch as th
from gymnasium.spaces import Discrete
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.vec_env import VecNormalize

WAM_MIRRORED_JOINTS = (0, 2)  # J1 and J3 turn about axes in the arm's vertical plane
WAM_N_JOINTS = 4


class MirrorReplayBuffer(ReplayBuffer):
    """Sample every other transition in the mirror, which doubles the experience without a step of interaction.

    With cameras and target placed symmetrically, a scene and its mirror image through the arm's vertical plane are
    the same task: each camera sees, flipped, what the other one saw, and the joints that turn about an axis in that
    plane turn the other way. A test compares the environment with its mirror image.

    Args:
        args: As in SB3's `ReplayBuffer`.
        n_views: Views stacked in a composite (1, n_views * height, width); the mirror reverses their order.
        mirrored_joints: Components of the action that change sign.
        n_joints: Components that a discrete action numbers (see `QuantizedActions`); unused for a Box.
        kwargs: As in SB3's `ReplayBuffer`.
    """

    def __init__(
        self,
        *args: Any,
        n_views: int = 2,
        mirrored_joints: Sequence[int] = WAM_MIRRORED_JOINTS,
        n_joints: int = WAM_N_JOINTS,
        **kwargs: Any,
    ) -> None:
        super().__init__(*args, **kwargs)
        self._set_up_mirror(n_views, mirrored_joints, n_joints)

    @classmethod
    def of(
        cls, buffer: ReplayBuffer, n_views: int, mirrored_joints: Sequence[int], n_joints: int
    ) -> MirrorReplayBuffer:
        """Take over another buffer with all its transitions."""
        mirror = cls.__new__(cls)
        mirror.__dict__.update(buffer.__dict__)
        mirror._set_up_mirror(n_views, mirrored_joints, n_joints)
        return mirror

    def _set_up_mirror(self, n_views: int, mirrored_joints: Sequence[int], n_joints: int) -> None:
        self.n_views = n_views
        if isinstance(self.action_space, Discrete):
            self._numbers = th.as_tensor(_mirrored_numbers(int(self.action_space.n), n_joints, mirrored_joints))
        else:
            self._signs = th.ones(self.action_dim)
            self._signs[list(mirrored_joints)] = -1.0

    def _get_samples(self, batch_inds: np.ndarray, env: VecNormalize | None = None) -> ReplayBufferSamples:
        samples = super()._get_samples(batch_inds, env)
        chosen = th.as_tensor(np.random.random(len(batch_inds)) < 0.5, device=self.device)  # SB3's generator
        observations, actions, next_observations = samples[:3]
        for tensor, mirror in (
            (observations, self.mirror),
            (actions, self.mirror_actions),
            (next_observations, self.mirror),
        ):
            tensor[chosen] = mirror(tensor[chosen])  # the sample is a copy of the buffer
        return samples

    def mirror(self, images: th.Tensor) -> th.Tensor:
        """Flip every view of (batch, 1, n_views * height, width) left to right and reverse their order."""
        n_images, channels, height, width = images.shape
        views = images.reshape(n_images, channels, self.n_views, height // self.n_views, width)
        return views.flip(2, 4).flatten(2, 3)

    def mirror_actions(self, actions: th.Tensor) -> th.Tensor:
        """The actions (batch, action_dim) that do in the mirror what these do."""
        if isinstance(self.action_space, Discrete):
            numbers: th.Tensor = self._numbers.to(actions.device)[actions]
            return numbers
        return actions * self._signs.to(actions.device)


def _mirrored_numbers(n_actions: int, n_joints: int, mirrored_joints: Sequence[int]) -> np.ndarray:
    """For every number of `QuantizedActions` the number of its mirror image, shape (n_actions,)."""
    levels = round(n_actions ** (1 / n_joints))
    if levels**n_joints != n_actions:
        raise ValueError(f"{n_actions} actions are not the combinations of {n_joints} joints; set n_joints")
    digits = np.stack(np.unravel_index(np.arange(n_actions), (levels,) * n_joints))
    digits[list(mirrored_joints)] = levels - 1 - digits[list(mirrored_joints)]
    return np.asarray(np.ravel_multi_index(tuple(digits), (levels,) * n_joints))


class MirrorExperience(BaseCallback):
    """Make a model's replay buffer a `MirrorReplayBuffer`: the way a YAML file, also the zoo's, can ask for it.

    Args:
        n_views: As in `MirrorReplayBuffer`.
        mirrored_joints: As in `MirrorReplayBuffer`.
        n_joints: As in `MirrorReplayBuffer`.
        verbose: As in SB3.
    """

    def __init__(
        self,
        n_views: int = 2,
        mirrored_joints: Sequence[int] = WAM_MIRRORED_JOINTS,
        n_joints: int = WAM_N_JOINTS,
        verbose: int = 0,
    ) -> None:
        super().__init__(verbose)
        self.n_views, self.mirrored_joints, self.n_joints = n_views, mirrored_joints, n_joints

    def _on_training_start(self) -> None:
        model = self.model
        if not isinstance(model, OffPolicyAlgorithm) or model.replay_buffer is None:
            raise ValueError(f"MirrorExperience needs a replay buffer, and {type(model).__name__} has none")
        model.replay_buffer = MirrorReplayBuffer.of(
            model.replay_buffer, self.n_views, self.mirrored_joints, self.n_joints
        )

    def _on_step(self) -> bool:
        return True
