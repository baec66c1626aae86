"""Our DDPG: SB3's, whose encoder learns from dynamics and not from rewards.

One step of a training, in this order:

1. SB3 acts and stores the transition, with the markers' offsets from `info` (`StereoReplayBuffer`). Exploration is
   Ornstein-Uhlenbeck noise times an epsilon that falls (`OffPolicyMixin`).
2. Once, when the random transitions are there: `pretraining["dynamics"]` updates of the encoder for each of them, then
   `pretraining["agent"]` updates of critic and actor (`_on_step`).
3. `train`: `dynamics_steps` updates of the encoder, then `gradient_steps` updates of critic and actor.

Encoder and heads learn from `DynamicsHeads.loss` alone. Critic and actor see the encoder's features as constants.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch as th
from stable_baselines3 import DDPG, TD3
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from torch.nn import functional as F

from sb3_stereo.learning.dynamics import DynamicsMixin
from sb3_stereo.learning.relabelling import RelabelledSamples
from sb3_stereo.policies.actor_critic import StereoCritic
from sb3_stereo.policies.layers import scale_images

ENCODED_AT_ONCE = 4  # batches; more do not fit into a processor's cache


class StereoTD3(DynamicsMixin, TD3):
    """SB3's TD3 with a policy whose encoder learns from dynamics; with any other policy it is SB3's TD3, bit for bit.

    Args:
        args: As in SB3's `TD3`.
        dynamics_steps: Updates of the encoder at each training, as `gradient_steps` counts those of critic and actor.
        pretraining: Updates per initial random transition, once, before the first action that is not random:
            "dynamics" of the encoder, then "agent" of critic and actor.
        exploration: Arguments of `Annealing`: epsilon scales Ornstein-Uhlenbeck noise. None leaves the noise as it is.
        kwargs: As in SB3's `TD3`. Where `replay_buffer_kwargs` or the policy need it, the replay buffer is a
            `StereoReplayBuffer`, and the environment is asked for what it must know.
    """

    critic: StereoCritic
    critic_target: StereoCritic

    def _tell_policy(self) -> None:
        super()._tell_policy()
        if self._relabels:
            self.policy_kwargs.setdefault("relabelling", True)

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        """Update encoder, critic and actor from the replay buffer."""
        self._train_dynamics(self.dynamics_steps, batch_size)
        self._train_agent(gradient_steps, batch_size)

    def _train_agent(self, gradient_steps: int, batch_size: int) -> None:
        """Update critic and actor: one step of each per batch, then their targets."""
        if self.heads is None:
            return super().train(gradient_steps, batch_size)
        self.policy.set_training_mode(True)
        self._update_learning_rate([self.actor.optimizer, self.critic.optimizer])
        actor_losses, critic_losses = [], []
        for batch, features, next_features in self._encoded_batches(gradient_steps, batch_size):
            self._n_updates += 1
            critic_losses.append(self._update_critic(batch, features, next_features))
            if self._n_updates % self.policy_delay == 0:  # never delayed in DDPG
                actor_losses.append(self._update_actor(features))
                self._update_targets()
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/critic_loss", np.mean(critic_losses))
        if actor_losses:
            self.logger.record("train/actor_loss", np.mean(actor_losses))

    def _encoded_batches(
        self, n_batches: int, batch_size: int
    ) -> Iterator[tuple[ReplayBufferSamples | RelabelledSamples, th.Tensor, th.Tensor]]:
        """Sample batches with the features (batch, features_dim) of their observations and next observations.

        Neither critic nor actor changes the encoder, so that several batches are encoded in one pass.
        """
        for start in range(0, n_batches, ENCODED_AT_ONCE):
            n = min(ENCODED_AT_ONCE, n_batches - start)
            batches = [self.replay_buffer.sample(batch_size, self._vec_normalize_env) for _ in range(n)]
            images = th.cat([images for batch in batches for images in (batch.observations, batch.next_observations)])
            with th.no_grad():
                encoded = self.policy.encoder(scale_images(images, self.observation_space)).split(batch_size)
            for batch, *features in zip(batches, encoded[::2], encoded[1::2], strict=True):
                yield batch, *(self._with_displacements(found, batch) for found in features)

    def _with_displacements(self, features: th.Tensor, batch: ReplayBufferSamples | RelabelledSamples) -> th.Tensor:
        """Features followed by the displacement of the target, if the policy's networks take that."""
        if not self.policy.relabelling:
            return features
        assert self.heads is not None and isinstance(batch, RelabelledSamples)
        return th.cat([features, batch.displacements.flatten(1) / self.heads.offset_scale], dim=1)

    def _update_critic(
        self, batch: ReplayBufferSamples | RelabelledSamples, features: th.Tensor, next_features: th.Tensor
    ) -> float:
        """One step on the mean squared error of every Q to r + discount * min Q'(s', pi'(s') + clipped noise)."""
        discount = self.gamma if batch.discounts is None else batch.discounts
        with th.no_grad():
            noise = th.randn_like(batch.actions).mul_(self.target_policy_noise)
            noise = noise.clamp_(-self.target_noise_clip, self.target_noise_clip)  # 0 in DDPG
            next_actions = (self.actor_target.mu(next_features) + noise).clamp(-1, 1)
            next_q = th.cat(self.critic_target.q_values(next_features, next_actions), dim=1)
            target_q = batch.rewards + (1 - batch.dones) * discount * next_q.min(dim=1, keepdim=True).values
        q_values = self.critic.q_values(features, batch.actions)
        loss: Any = sum(F.mse_loss(q, target_q) for q in q_values)
        self.critic.optimizer.zero_grad()
        loss.backward()
        self.critic.optimizer.step()
        return float(loss.detach())

    def _update_actor(self, features: th.Tensor) -> float:
        """One step on -Q1(s, pi(s)), whose gradient passes through critic and forward model and changes neither."""
        loss: Any = -self.critic.q1_values(features, self.actor.mu(features)).mean()
        self.actor.optimizer.zero_grad()
        loss.backward()
        self.actor.optimizer.step()
        return float(loss.detach())

    def _update_targets(self) -> None:
        """Polyak averaging; running statistics are copied, as in SB3."""
        with th.no_grad():
            for net, target in ((self.critic, self.critic_target), (self.actor, self.actor_target)):
                th._foreach_lerp_(list(target.parameters()), list(net.parameters()), self.tau)
            statistics = [*self.critic_batch_norm_stats, *self.actor_batch_norm_stats]
            targets = [*self.critic_batch_norm_stats_target, *self.actor_batch_norm_stats_target]
            for mean_or_variance, target_statistic in zip(statistics, targets, strict=True):
                target_statistic.copy_(mean_or_variance)


class StereoDDPG(StereoTD3, DDPG):
    """`StereoTD3` without its delay and noise, as SB3's DDPG is TD3 without them; the arguments are SB3's `DDPG`'s."""
