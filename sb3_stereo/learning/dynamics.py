"""Learning to see: the encoder learns from what moved, and not from rewards."""

from __future__ import annotations

from typing import Any

import torch as th
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from sb3_stereo.learning.replay import StereoReplayBuffer
from sb3_stereo.learning.warmup import can_learn
from sb3_stereo.policies.dynamics import Motion, MotionHeads
from sb3_stereo.policies.layers import scale_images
from sb3_stereo.task_interface import OFFSETS, asked, check_views


class MotionLearner:
    """Trains an encoder, and heads on it, with Adam.

    Args:
        encoder: Of images.
        heads: The questions.
        learning_rate: Adam's, for both.
    """

    def __init__(self, encoder: BaseFeaturesExtractor, heads: MotionHeads, learning_rate: float) -> None:
        self.encoder, self.heads = encoder, heads
        self.optimizer = th.optim.Adam([*encoder.parameters(), *heads.parameters()], learning_rate, fused=True)

    def update(self, motion: Motion) -> float:
        """Take one gradient step and return the loss."""
        images = th.cat([motion.observations, motion.next_observations])
        self.encoder.train()
        features, next_features = self.encoder(scale_images(images, self.encoder._observation_space)).chunk(2)
        self.encoder.eval()
        loss = self.heads.loss(features, next_features, motion)
        self.optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        self.optimizer.step()
        return loss.item()


class LearnFromMotion(BaseCallback):
    """Train the encoder on `MotionHeads` between the environment step and SB3's gradient steps.

    For `StereoDDPGPolicy` with `encoder_loss="motion"`, where nothing else trains the encoder, and for DQN, where it
    joins the Q-network's loss. The targets are the actions and `info["pixel_offsets"]`, the same centroids that the
    reward is made from; the agent acts on images alone.

    Args:
        gradient_steps: Updates after every environment step.
        replay_ratio: Updates per random transition before the first action, as in `WarmUp`, which comes after.
        learning_rate: Adam's.
        batch_size: Transitions per update.
        verbose: As in SB3.
    """

    def __init__(
        self,
        gradient_steps: int = 2,
        replay_ratio: float = 3.0,
        learning_rate: float = 1e-3,
        batch_size: int = 100,
        verbose: int = 0,
    ) -> None:
        super().__init__(verbose)
        self.gradient_steps, self.replay_ratio = gradient_steps, replay_ratio
        self.learning_rate, self.batch_size = learning_rate, batch_size
        self.n_updates = 0

    def _on_training_start(self) -> None:
        model: Any = self.model
        if not isinstance(model, DQN) and getattr(model.policy, "motion", None) is None:
            raise ValueError(
                "LearnFromMotion needs DQN, or a StereoDDPGPolicy with encoder_loss 'motion'; set it, or leave it out"
            )
        infos = self.training_env.unwrapped.reset_infos  # a wrapper's own are empty
        if not all(OFFSETS in info for info in infos):
            raise ValueError(
                f"LearnFromMotion needs info['{OFFSETS}'], which this environment does not give; "
                "leave it out and set encoder_loss to 'critic'"
            )
        if not isinstance(model.replay_buffer, StereoReplayBuffer):
            n_joints = asked(self.training_env, "n_joints")
            model.replay_buffer = StereoReplayBuffer.of(
                model,
                n_views=len(infos[0][OFFSETS]),
                views_in_channels=asked(self.training_env, "views_in_channels"),
                n_joints=n_joints,
            )
        if not isinstance(model, DQN):
            heads = model.policy.motion
            check_views(self.training_env, heads.n_views, "the policy has n_views", "policy_kwargs.n_views")
        if self.n_updates == 0:
            self._set_up(model.policy, model.replay_buffer)

    def _set_up(self, policy: Any, buffer: StereoReplayBuffer) -> None:
        heads = getattr(policy, "motion", None)
        encoder = policy.q_net.features_extractor if heads is None else policy.encoder
        if heads is None:
            heads = MotionHeads(encoder.features_dim, buffer.n_joints, buffer.n_views).to(policy.device)
        self.learner = MotionLearner(encoder, heads, self.learning_rate)

    def _on_step(self) -> bool:
        model = self.model
        assert isinstance(model, OffPolicyAlgorithm)
        if can_learn(model):
            if self.n_updates == 0:
                self.train(round(self.replay_ratio * model.learning_starts))
            self.train(self.gradient_steps * self.training_env.num_envs)
        return True

    def state_dict(self) -> dict[str, Any]:
        """Return what the policy does not hold."""
        heads, optimizer = self.learner.heads.state_dict(), self.learner.optimizer.state_dict()
        return {"n_updates": self.n_updates, "heads": heads, "optimizer": optimizer}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a `state_dict`, once the training has been set up."""
        self.n_updates = state["n_updates"]
        self.learner.heads.load_state_dict(state["heads"])
        self.learner.optimizer.load_state_dict(state["optimizer"])

    def train(self, gradient_steps: int) -> None:
        """Take gradient steps on the encoder and the heads."""
        buffer = self.model.replay_buffer  # type: ignore[attr-defined]
        for _ in range(gradient_steps):
            self.logger.record("train/motion_loss", self.learner.update(buffer.sample_motion(self.batch_size)))
        self.n_updates += gradient_steps
