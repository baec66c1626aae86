"""Policies for SB3's SAC and PPO: their own, with `StereoCnn` as the encoder unless told otherwise.

A class of its own, because YAML for the zoo can name a policy by its dotted path but no encoder.
"""

from __future__ import annotations

from typing import Any

from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.sac.policies import SACPolicy

from sb3_stereo.policies.extractors import StereoCnn


class StereoEncoder:
    """Comes before a policy among the bases and changes the default of its encoder.

    Args:
        args: Of the policy.
        features_extractor_class: As in SB3; `features_extractor_kwargs` are its arguments.
        kwargs: Of the policy.
    """

    def __init__(
        self, *args: Any, features_extractor_class: type[BaseFeaturesExtractor] = StereoCnn, **kwargs: Any
    ) -> None:
        super().__init__(*args, features_extractor_class=features_extractor_class, **kwargs)  # type: ignore[call-arg]


class StereoSACPolicy(StereoEncoder, SACPolicy):
    """SB3's `SACPolicy` on stereo images."""


class StereoPPOPolicy(StereoEncoder, ActorCriticPolicy):
    """SB3's `ActorCriticPolicy`, PPO's, on stereo images."""
