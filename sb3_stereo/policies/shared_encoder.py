"""One encoder for two networks: one owns it, the other reads it."""

from __future__ import annotations

import torch as th
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn


class SharedEncoderView(BaseFeaturesExtractor):
    """An encoder that is trained, saved and averaged elsewhere, read without gradient.

    SB3's algorithms average `critic.parameters()` into the target and train all of them, so an encoder that neither of
    these may touch must not be registered here.

    Args:
        encoder: The encoder.
        n_zeros: That follow the features: by how much the target is displaced, in whatever an agent sees.
    """

    def __init__(self, encoder: BaseFeaturesExtractor, n_zeros: int = 0) -> None:
        super().__init__(encoder._observation_space, encoder.features_dim + n_zeros)
        self.n_zeros = n_zeros
        self._unregistered = (encoder,)  # torch's registry does not look inside a tuple

    @property
    def encoder(self) -> BaseFeaturesExtractor:
        """The encoder itself."""
        return self._unregistered[0]

    def forward(self, observations: th.Tensor) -> th.Tensor:
        """Map images (batch, channels, height, width) in [0, 1] to detached features (batch, features_dim)."""
        with th.no_grad():
            features: th.Tensor = self.encoder(observations)
        return nn.functional.pad(features, (0, self.n_zeros)) if self.n_zeros else features  # pad copies
