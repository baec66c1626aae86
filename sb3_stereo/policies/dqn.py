"""The policy for SB3's own DQN on stereo images; every argument can be written in YAML."""

from __future__ import annotations

from typing import Any

import torch as th
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.dqn.policies import DQNPolicy, QNetwork
from torch import nn

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

    Raises:
        ValueError: If a choice is unknown.
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
    ) -> None:
        refuse_maps(self, observation_space)
        check_choice("head_init", head_init, INITS)
        self.head_init = head_init
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

    def make_q_net(self) -> QNetwork:
        """Return a new Q-network."""
        q_net = super().make_q_net()
        initialise(q_net.q_net, self.head_init)
        return q_net

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "head_init": self.head_init}
