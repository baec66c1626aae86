"""Policies for SB3's own DDPG, TD3 and DQN on stereo images; every argument can be written in YAML."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from typing import Any

import torch as th
from gymnasium import spaces
from stable_baselines3.common.preprocessing import get_action_dim
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule
from stable_baselines3.td3.policies import TD3Policy
from torch import nn

from sb3_stereo.policies.actor_critic import StereoActor, StereoCritic
from sb3_stereo.policies.dynamics import DynamicsHeads
from sb3_stereo.policies.extractors import StereoCnn, refuse_maps
from sb3_stereo.policies.layers import ACTING_STATISTICS, check_choice, statistics_of_each_observation
from sb3_stereo.policies.old_names import rename_keys, renamed_choice
from sb3_stereo.policies.optim import ScaledAdam
from sb3_stereo.policies.shared_encoder import SharedEncoderView

ENCODER_LOSSES = ("critic", "dynamics")


class StereoDDPGPolicy(TD3Policy):
    """Actor and critic of SB3's DDPG and TD3 on images. The defaults are the paper's networks (Sections 4.2 and 5).

    Convolutions are followed by fully connected layers, and the action joins the critic after the first of them (as
    in Lillicrap et al., the paper's [14]). Hidden layers start in U(+-1/sqrt(fan_in)).

    Args:
        observation_space: Images (channels, height, width), uint8.
        action_space: Box in [-1, 1].
        lr_schedule: Of the actor, and of the critic too unless `qf_learning_rate` is given.
        net_arch: Sizes of the fully connected hidden layers, as in SB3. None means [200, 200].
        activation_fn: As in SB3.
        features_extractor_class: `StereoCnn` or a subclass.
        features_extractor_kwargs: For `StereoCnn`, without hidden_norm, which this class sets; features_dim is None
            unless given, since the fully connected layers are in the heads.
        normalize_images: As in SB3.
        optimizer_class: `ScaledAdam` or one with its arguments.
        optimizer_kwargs: As in SB3, for both optimizers.
        n_critics: Heads on the critic's encoder; their minimum is the target.
        share_features_extractor: Must be False; see `shared_encoder`.
        shared_encoder: One encoder, trained by the critic's loss; the actor sees it detached (as in DrQ-v2). False
            gives the actor its own, trained by the actor's loss.
        encoder_loss: What trains the shared encoder: "critic", or "dynamics", the loss of `DynamicsHeads` and nothing
            else, for which `StereoDDPG` or `StereoTD3` must be the algorithm; the critic is then conditioned on the
            forward model's prediction too.
        n_views: Views in the image, for "dynamics"; `StereoDDPG` asks the environment.
        dynamics_learning_rate: Of the encoder and the heads, for "dynamics".
        forward_dynamics: Of the heads, for "dynamics": "offsets" or "features", see `DynamicsHeads`.
        actor_hidden_norm: Follows the actor's hidden layers (and its own convolutions if "batch"): "batch", "layer"
            or "none".
        critic_hidden_norm: The same for the critic and its encoder, up to where the action joins.
        qf_learning_rate: The critic's at the start; it follows the schedule in proportion. None means the actor's.
        actor_weight_decay: L2 in the actor's Adam (Table 1); the critic has none.
        final_init: The output layers start in U(+-final_init).
        acting_statistics: What batch normalisation in the actor uses where it acts: "running" statistics, as in
            PyTorch, or those of the single "observation", as in a network of Torch7 that is left in training mode
            (then the action does not depend on the image; see docs/paper.md).
        relabelling: Actor and critic can be told that the target is displaced, for "dynamics"; `StereoDDPG` sets it for
            a `RelabellingReplayBuffer`.

    Raises:
        ValueError: If a choice is unknown or an argument contradicts another.
    """

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Box,
        lr_schedule: Schedule,
        net_arch: list[int] | dict[str, list[int]] | None = None,
        activation_fn: type[nn.Module] = nn.ReLU,
        features_extractor_class: type[BaseFeaturesExtractor] = StereoCnn,
        features_extractor_kwargs: dict[str, Any] | None = None,
        normalize_images: bool = True,
        optimizer_class: type[th.optim.Optimizer] = ScaledAdam,
        optimizer_kwargs: dict[str, Any] | None = None,
        n_critics: int = 2,
        share_features_extractor: bool = False,
        *,
        shared_encoder: bool = False,
        encoder_loss: str = "critic",
        n_views: int = 2,
        dynamics_learning_rate: float = 1e-3,
        forward_dynamics: str = "offsets",
        actor_hidden_norm: str = "batch",
        critic_hidden_norm: str = "batch",
        qf_learning_rate: float | None = None,
        actor_weight_decay: float = 1e-2,
        final_init: float = 3e-4,
        acting_statistics: str = "running",
        relabelling: bool = False,
    ) -> None:
        if share_features_extractor:
            raise ValueError(
                "share_features_extractor=True would train the encoder by the actor's loss; "
                "use shared_encoder=True, where the critic's loss trains it"
            )
        if "hidden_norm" in (features_extractor_kwargs or {}):
            raise ValueError(
                "features_extractor_kwargs cannot set 'hidden_norm' in this policy; "
                "use actor_hidden_norm and critic_hidden_norm"
            )
        refuse_maps(self, observation_space)
        encoder_loss = renamed_choice("encoder_loss", encoder_loss)
        check_choice("encoder_loss", encoder_loss, ENCODER_LOSSES)
        if encoder_loss == "dynamics" and not shared_encoder:
            raise ValueError("encoder_loss 'dynamics' needs shared_encoder=True")
        if relabelling and encoder_loss != "dynamics":
            raise ValueError(f"relabelling needs the heads of encoder_loss 'dynamics', and it is '{encoder_loss}'")
        self.shared_encoder, self.encoder_loss, self.n_views = shared_encoder, encoder_loss, n_views
        self.dynamics_learning_rate, self.forward_dynamics = dynamics_learning_rate, forward_dynamics
        self.actor_hidden_norm, self.critic_hidden_norm = actor_hidden_norm, critic_hidden_norm
        self.qf_learning_rate, self.actor_weight_decay = qf_learning_rate, actor_weight_decay
        check_choice("acting_statistics", acting_statistics, ACTING_STATISTICS)
        self.final_init, self.acting_statistics, self.relabelling = final_init, acting_statistics, relabelling
        super().__init__(
            observation_space,
            action_space,
            lr_schedule,
            [200, 200] if net_arch is None else net_arch,
            activation_fn,
            features_extractor_class,
            features_extractor_kwargs,
            normalize_images,
            optimizer_class,
            optimizer_kwargs,
            n_critics,
            share_features_extractor,
        )

    def _build(self, lr_schedule: Schedule) -> None:
        self.dynamics: DynamicsHeads | None = None
        if self.encoder_loss == "dynamics":
            self.encoder = self._make_encoder(self.critic_hidden_norm).eval().to(self.device)
            n_joints, dynamics = get_action_dim(self.action_space), self.forward_dynamics
            self.dynamics = DynamicsHeads(self.encoder.features_dim, n_joints, self.n_views, forward_dynamics=dynamics)
            self.dynamics.to(self.device).add_optimizer(self.encoder, self.dynamics_learning_rate)
        self.actor, self.critic = self._make_pair()
        self.actor_target, self.critic_target = self._make_pair()
        self.actor_target.load_state_dict(self.actor.state_dict())
        self.critic_target.load_state_dict(self.critic.state_dict())
        self.actor_target.set_training_mode(False)
        self.critic_target.set_training_mode(False)
        self._make_optimizers(lr_schedule(1))

    def _make_pair(self) -> tuple[StereoActor, StereoCritic]:
        if self.encoder_loss == "dynamics":
            assert self.dynamics is not None
            n_zeros = self.dynamics.offsets_dim if self.relabelling else 0
            views = [SharedEncoderView(self.encoder, n_zeros) for _ in range(2)]
            return self.make_actor(views[0]), self.make_critic(views[1])
        critic = self.make_critic()
        shared = SharedEncoderView(critic.features_extractor) if self.shared_encoder else None
        return self.make_actor(shared), critic

    def set_training_mode(self, mode: bool) -> None:
        """As in SB3, whose algorithms call it before every update.

        Raises:
            ValueError: If the encoder should learn from dynamics, and nothing has trained it yet.
        """
        if mode and self.dynamics is not None and self.dynamics.n_updates == 0:
            raise ValueError(
                "encoder_loss is 'dynamics', and nothing has trained the encoder; "
                "take StereoDDPG or StereoTD3 with dynamics_steps, or set encoder_loss to 'critic'"
            )
        super().set_training_mode(mode)

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> th.Tensor:
        by_itself = self.acting_statistics == "observation"
        with statistics_of_each_observation(self.actor) if by_itself else nullcontext():
            return super()._predict(observation, deterministic)

    def load_state_dict(self, state_dict: Mapping[str, Any], *args: Any, **kwargs: Any) -> Any:
        """As in torch; also of a policy that was saved under the names before version 0.1.0."""
        return super().load_state_dict(rename_keys(state_dict), *args, **kwargs)

    def _make_optimizers(self, learning_rate: float) -> None:
        optimizer: Any = self.optimizer_class
        actor_kwargs = {"weight_decay": self.actor_weight_decay, **self.optimizer_kwargs}
        critic_kwargs = dict(self.optimizer_kwargs)
        # A policy loaded by itself gets SB3's dummy schedule, which is 0.
        if self.qf_learning_rate is not None and learning_rate > 0:
            critic_kwargs["lr_ratio"] = self.qf_learning_rate / learning_rate
        self.actor.optimizer = optimizer(self.actor.parameters(), lr=learning_rate, **actor_kwargs)
        self.critic.optimizer = optimizer(self.critic.parameters(), lr=learning_rate, **critic_kwargs)

    def make_actor(self, features_extractor: BaseFeaturesExtractor | None = None) -> StereoActor:
        """Return a new actor, with its own encoder if none is given."""
        encoder = features_extractor or self._make_encoder(self.actor_hidden_norm)
        kwargs = self._update_features_extractor(self.actor_kwargs, encoder)
        relabelling = self.dynamics if self.relabelling else None
        return StereoActor(
            **kwargs, hidden_norm=self.actor_hidden_norm, final_init=self.final_init, relabelling=relabelling
        ).to(self.device)

    def make_critic(self, features_extractor: BaseFeaturesExtractor | None = None) -> StereoCritic:
        """Return a new critic, with its own encoder if none is given."""
        encoder = features_extractor or self._make_encoder(self.critic_hidden_norm)
        kwargs = self._update_features_extractor(self.critic_kwargs, encoder)
        return StereoCritic(
            **kwargs,
            hidden_norm=self.critic_hidden_norm,
            final_init=self.final_init,
            dynamics=self.dynamics,
            relabelling=self.relabelling,
        ).to(self.device)

    def _make_encoder(self, hidden_norm: str) -> BaseFeaturesExtractor:
        kwargs = {"features_dim": None, **self.features_extractor_kwargs, "hidden_norm": hidden_norm}
        return self.features_extractor_class(self.observation_space, **kwargs)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {
            **super()._get_constructor_parameters(),
            "shared_encoder": self.shared_encoder,
            "encoder_loss": self.encoder_loss,
            "n_views": self.n_views,
            "dynamics_learning_rate": self.dynamics_learning_rate,
            "forward_dynamics": self.forward_dynamics,
            "actor_hidden_norm": self.actor_hidden_norm,
            "critic_hidden_norm": self.critic_hidden_norm,
            "qf_learning_rate": self.qf_learning_rate,
            "actor_weight_decay": self.actor_weight_decay,
            "final_init": self.final_init,
            "acting_statistics": self.acting_statistics,
            "relabelling": self.relabelling,
        }
