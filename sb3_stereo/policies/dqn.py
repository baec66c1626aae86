"""The policy for SB3's own DQN on stereo images; every argument can be written in YAML."""

from __future__ import annotations

from typing import Any

import torch as th
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.dqn.policies import DQNPolicy, QNetwork
from torch import nn

from sb3_stereo.policies.dynamics import DynamicsHeads
from sb3_stereo.policies.extractors import StereoCnn, refuse_maps
from sb3_stereo.policies.layers import INITS, check_choice, initialise
from sb3_stereo.policies.optim import ScaledAdam

# The network of Mnih et al. 2015, which the paper's DQN takes over (Section 4.2) with Xavier weights (Section 5).
NATURE_CNN = {
    "features_dim": 512,
    "n_filters": [32, 64, 64],
    "input_norm": "none",
    "hidden_norm": "none",
    "init": "xavier",
}


ENCODER_LOSSES = ("critic", "critic+dynamics")


class StereoDQNPolicy(DQNPolicy):
    """Q-network of SB3's DQN on images. The defaults are the paper's: the Nature-2015 net with Xavier weights.

    Args:
        observation_space: Images (channels, height, width), uint8.
        action_space: Discrete.
        lr_schedule: As in SB3.
        net_arch: Hidden layers between the features and the output. None means none.
        activation_fn: As in SB3.
        features_extractor_class: `StereoCnn` or a subclass.
        features_extractor_kwargs: For `StereoCnn`; what is left out is `NATURE_CNN`'s.
        normalize_images: As in SB3.
        optimizer_class: As in SB3; Adam, fused.
        optimizer_kwargs: As in SB3.
        head_init: Of the layers after the features: "fan_in", "orthogonal" or "xavier".
        encoder_loss: What trains the encoder: "critic" is the Q-network's loss, "critic+dynamics" also that of
            `DynamicsHeads`, for which `StereoDQN` must be the algorithm.
        n_views: Views in the image, for "critic+dynamics"; `StereoDQN` asks the environment.
        n_joints: Joints that an action moves, for "critic+dynamics"; `StereoDQN` asks `QuantizedActions`.
        dynamics_learning_rate: Of the encoder and the heads, for "critic+dynamics".

    Raises:
        ValueError: If a choice is unknown, or `n_joints` is missing.
    """

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Discrete,
        lr_schedule: Schedule,
        net_arch: list[int] | None = None,
        activation_fn: type[nn.Module] = nn.ReLU,
        features_extractor_class: type[BaseFeaturesExtractor] = StereoCnn,
        features_extractor_kwargs: dict[str, Any] | None = None,
        normalize_images: bool = True,
        optimizer_class: type[th.optim.Optimizer] = ScaledAdam,
        optimizer_kwargs: dict[str, Any] | None = None,
        *,
        head_init: str = "xavier",
        encoder_loss: str = "critic",
        n_views: int = 2,
        n_joints: int | None = None,
        dynamics_learning_rate: float = 1e-3,
    ) -> None:
        refuse_maps(self, observation_space)
        check_choice("head_init", head_init, INITS)
        check_choice("encoder_loss", encoder_loss, ENCODER_LOSSES)
        if encoder_loss != "critic" and n_joints is None:
            raise ValueError(
                f"encoder_loss {encoder_loss!r} needs n_joints, the joints that a discrete action stands for; "
                "give it, or wrap the environment in QuantizedActions"
            )
        self.head_init, self.encoder_loss = head_init, encoder_loss
        self.n_views, self.n_joints, self.dynamics_learning_rate = n_views, n_joints, dynamics_learning_rate
        super().__init__(
            observation_space,
            action_space,
            lr_schedule,
            [] if net_arch is None else net_arch,
            activation_fn,
            features_extractor_class,
            {**NATURE_CNN, **(features_extractor_kwargs or {})},
            normalize_images,
            optimizer_class,
            optimizer_kwargs,
        )

    @property
    def encoder(self) -> BaseFeaturesExtractor:
        """The Q-network's."""
        encoder: BaseFeaturesExtractor = self.q_net.features_extractor
        return encoder

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        self.dynamics: DynamicsHeads | None = None
        if self.encoder_loss != "critic":
            assert self.n_joints is not None
            self.dynamics = DynamicsHeads(self.encoder.features_dim, self.n_joints, self.n_views).to(self.device)
            self.dynamics.add_optimizer(self.encoder, self.dynamics_learning_rate)

    def make_q_net(self) -> QNetwork:
        """Return a new Q-network."""
        q_net = super().make_q_net()
        initialise(q_net.q_net, self.head_init)
        return q_net

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {
            **super()._get_constructor_parameters(),
            "head_init": self.head_init,
            "encoder_loss": self.encoder_loss,
            "n_views": self.n_views,
            "n_joints": self.n_joints,
            "dynamics_learning_rate": self.dynamics_learning_rate,
        }
