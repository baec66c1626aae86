"""Random shifts of the images while a network trains (Kostrikov et al. 2020, DrQ): what pixel learners use today."""

from __future__ import annotations

from typing import Any

import torch as th
from gymnasium import spaces
from stable_baselines3.common.torch_layers import NatureCNN
from torch import nn


class RandomShift(nn.Module):
    """Shift every image of a batch by itself, up to `pad` pixels each way; the border is repeated. Only in training.

    Args:
        pad: The largest shift, in [px]; DrQ takes 4.

    Raises:
        ValueError: If it is negative.
    """

    def __init__(self, pad: int = 4) -> None:
        super().__init__()
        if pad < 0:
            raise ValueError(f"pad is {pad}; give 0 or more pixels")
        self.pad = pad

    def forward(self, images: th.Tensor) -> th.Tensor:
        """Images (batch, channels, height, width), shifted in training mode."""
        if not self.training or not self.pad:
            return images
        batch, _, height, width = images.shape
        padded = nn.functional.pad(images, (self.pad,) * 4, mode="replicate")
        down, right = th.randint(2 * self.pad + 1, (2, batch), device=images.device)
        rows = (down[:, None] + th.arange(height, device=images.device))[:, None, :, None]
        columns = (right[:, None] + th.arange(width, device=images.device))[:, None, None, :]
        number = th.arange(batch, device=images.device)[:, None, None, None]
        channel = th.arange(images.shape[1], device=images.device)[None, :, None, None]
        return padded[number, channel, rows, columns]


class ShiftedNatureCNN(NatureCNN):
    """SB3's `NatureCNN`, the network of its `CnnPolicy`, on randomly shifted images.

    Args:
        observation_space: Of images.
        pad: As in `RandomShift`.
        kwargs: Of `NatureCNN`.
    """

    def __init__(self, observation_space: spaces.Box, pad: int = 4, **kwargs: Any) -> None:
        super().__init__(observation_space, **kwargs)
        self.shift = RandomShift(pad)

    def forward(self, observations: th.Tensor) -> th.Tensor:
        """Map images (batch, channels, height, width) to features (batch, features_dim)."""
        features: th.Tensor = super().forward(self.shift(observations))
        return features
