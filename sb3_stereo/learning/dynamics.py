"""What an algorithm needs for an encoder that learns from dynamics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch as th

from sb3_stereo.learning.augmentation import ImageAugmentation, Layout
from sb3_stereo.learning.off_policy import OffPolicyMixin
from sb3_stereo.learning.replay import StereoReplayBuffer
from sb3_stereo.policies.ddpg import StereoDDPGPolicy
from sb3_stereo.policies.dqn import StereoDQNPolicy
from sb3_stereo.policies.dynamics import DynamicsHeads, DynamicsSamples
from sb3_stereo.task_interface import agreed_n_views, check_offsets, task_of


class DynamicsMixin(OffPolicyMixin):
    """For algorithms whose policy may have `DynamicsHeads`.

    Args:
        args: Of the algorithm.
        dynamics_steps: Updates of the encoder at each training, as `gradient_steps` counts those of the agent.
        pretraining: As in `OffPolicyMixin`; "dynamics" is the number of updates of the encoder, which come first.
        exploration: As in `OffPolicyMixin`.
        augmentation: Arguments of `ImageAugmentation`: how the images that train the encoder are changed; {} takes its
            defaults. Critic and actor see the features of the images as they are. None changes nothing.
        kwargs: Of the algorithm.

    Raises:
        ValueError: If these settings and the policy's `encoder_loss` contradict each other.
    """

    PRETRAINING = ("dynamics", "agent")
    policy: Any  # with `dynamics` and `encoder`
    replay_buffer: Any  # a `StereoReplayBuffer` where there are heads

    def __init__(
        self,
        *args: Any,
        dynamics_steps: int = 0,
        pretraining: Mapping[str, float] | None = None,
        exploration: Mapping[str, float] | None = None,
        augmentation: Mapping[str, Any] | None = None,
        **kwargs: Any,
    ) -> None:
        if dynamics_steps < 0:
            raise ValueError(f"dynamics_steps must not be negative, got {dynamics_steps}")
        self.dynamics_steps = dynamics_steps
        self.augmentation = None if augmentation is None else dict(augmentation)
        if augmentation is not None:
            ImageAugmentation.of(augmentation)
        super().__init__(*args, pretraining=pretraining, exploration=exploration, **kwargs)

    @property
    def heads(self) -> DynamicsHeads | None:
        """The policy's; None if it has none, as any policy of SB3's."""
        return getattr(self.policy, "dynamics", None)

    def _setup_model(self) -> None:
        is_ours = issubclass(self.policy_class, StereoDDPGPolicy | StereoDQNPolicy)
        loss = self.policy_kwargs.get("encoder_loss", "critic") if is_ours else "critic"
        if loss != "critic":
            self._tell_policy()
        super()._setup_model()
        self._check_dynamics(loss)

    def _tell_policy(self) -> None:
        """Ask the environment for what the heads must know."""
        agreed_n_views(self.env, self.policy_kwargs, "policy_kwargs")
        task = task_of(self.env)
        self.policy_kwargs.setdefault("n_views", task.n_views)
        if issubclass(self.policy_class, StereoDQNPolicy):
            self.policy_kwargs.setdefault("n_joints", task.n_joints)

    def _check_dynamics(self, loss: str) -> None:
        trained = self.dynamics_steps + self._n_pretraining("dynamics") > 0
        heads = self.heads
        if heads is not None and not trained and self.num_timesteps == 0:
            raise ValueError(
                f"encoder_loss is '{loss}', and nothing trains the encoder; "
                "set dynamics_steps, as in dynamics_steps: 2, or encoder_loss to 'critic'"
            )
        if heads is None and trained:
            raise ValueError(
                "dynamics_steps and pretraining.dynamics train an encoder by its auxiliary losses, and "
                f"{self.policy_class.__name__} has none here; set encoder_loss ('dynamics', for DQN 'critic+dynamics') "
                "in policy_kwargs, or leave them out"
            )
        if heads is None and self.augmentation is not None:
            raise ValueError(
                "augmentation changes the images of the encoder's auxiliary losses, and "
                f"{self.policy_class.__name__} has none here; set encoder_loss in policy_kwargs, or leave it out"
            )
        if heads is not None and not isinstance(self.replay_buffer, StereoReplayBuffer):
            raise ValueError(
                f"encoder_loss '{loss}' needs the offsets that a StereoReplayBuffer stores, and replay_buffer_class is "
                f"{type(self.replay_buffer).__name__}; leave replay_buffer_class out"
            )

    def _needs_stereo_replay(self) -> bool:
        return self.policy_kwargs.get("encoder_loss", "critic") != "critic" or super()._needs_stereo_replay()

    def _setup_learn(self, total_timesteps: int, *args: Any, **kwargs: Any) -> Any:
        prepared = super()._setup_learn(total_timesteps, *args, **kwargs)
        if self.heads is not None:
            assert self.env is not None
            check_offsets(self.env, self.heads.n_views, f"encoder_loss '{self.policy.encoder_loss}'")
        return prepared

    def _pretrain(self) -> None:
        if self.heads is not None and self.heads.n_updates == 0:
            self._in_parts("pre-training of the encoder", self._n_pretraining("dynamics"), self._train_dynamics)
        super()._pretrain()

    def _train_dynamics(self, n_updates: int, batch_size: int) -> None:
        """Train the encoder and the heads."""
        for _ in range(n_updates):
            assert self.heads is not None
            samples = self._augmented(self.replay_buffer.sample_dynamics(batch_size))
            loss = self.heads.update(self.policy.encoder, samples)
            self.logger.record("train/dynamics_loss", loss)

    def _augmented(self, samples: DynamicsSamples) -> DynamicsSamples:
        """The samples with images as other worlds would show them."""
        if self.augmentation is None:
            return samples
        augmentation, buffer = ImageAugmentation.of(self.augmentation), self.replay_buffer
        images = th.stack([samples.observations, samples.next_observations]).cpu().numpy()
        changed, offsets = augmentation.change_some(
            images,
            samples.next_offsets.cpu().numpy(),
            augmentation.share_at(self.num_timesteps),
            Layout(buffer.n_views, buffer.views_in_channels, buffer.marker_map),
            np.random.default_rng(np.random.randint(2**31)),
        )
        observations, next_observations = th.from_numpy(changed).to(samples.observations.device)
        next_offsets = th.from_numpy(offsets).to(samples.next_offsets.device)
        return samples._replace(
            observations=observations, next_observations=next_observations, next_offsets=next_offsets
        )

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        state_dicts, variables = super()._get_torch_save_params()
        return [*state_dicts, *(["policy.dynamics.optimizer"] if self.heads else [])], variables
