"""Heads on the encoder that are trained on what moved."""

from __future__ import annotations

from typing import NamedTuple

import torch as th
from stable_baselines3.common.torch_layers import create_mlp
from torch import nn


class Motion(NamedTuple):
    """Transitions as something that moves."""

    observations: th.Tensor  # (batch, channels, height, width), uint8
    efforts: th.Tensor  # (batch, n_joints), in [-1, 1]
    next_observations: th.Tensor  # like observations
    next_offsets: th.Tensor  # (batch, n_views, 2) in [px], nan where a marker was hidden


class MotionHeads(nn.Module):
    """Three questions about a transition that can only be answered by who sees the arm's pose.

    Where is the end effector? Where will these efforts take it? Which efforts took it from here to there? The
    answers are 2 numbers per view and 1 per joint and transition, while a reward is a single one, and a noisy one.

    Args:
        features_dim: Size of the encoder's output.
        n_joints: Size of the action.
        n_views: Views in the image.
        hidden: Size of each head's hidden layer.
        offset_scale: Pixels that count as 1.
        inverse_coef: Weight of the third question.
    """

    def __init__(
        self,
        features_dim: int,
        n_joints: int,
        n_views: int = 2,
        hidden: int = 200,
        offset_scale: float = 50.0,
        inverse_coef: float = 0.5,
    ) -> None:
        super().__init__()
        self.n_views, self.offset_scale, self.inverse_coef = n_views, offset_scale, inverse_coef
        self.foresight_dim = 3 * n_views
        self.position = nn.Sequential(*create_mlp(features_dim, 2 * n_views, [hidden]))
        self.prediction = nn.Sequential(*create_mlp(features_dim + n_joints, 2 * n_views, [hidden]))
        self.inverse = nn.Sequential(*create_mlp(2 * features_dim, n_joints, [hidden]))

    def foresee(self, features: th.Tensor, efforts: th.Tensor) -> th.Tensor:
        """Where efforts (batch, n_joints) take the end effector: offsets and distances, (batch, foresight_dim)."""
        offsets = self.prediction(th.cat([features, efforts], dim=1))
        return th.cat([offsets, offsets.unflatten(1, (-1, 2)).norm(dim=2)], dim=1)

    def loss(self, features: th.Tensor, next_features: th.Tensor, motion: Motion) -> th.Tensor:
        """Sum of the three mean squared errors; a hidden marker asks nothing.

        Args:
            features: Of the observations, (batch, features_dim).
            next_features: Of the next observations, likewise.
            motion: The transitions.
        """
        offsets = motion.next_offsets.flatten(1) / self.offset_scale
        seen = ~offsets.isnan()
        positions = self.position(next_features), self.prediction(th.cat([features, motion.efforts], dim=1))
        errors = [((answer - offsets.nan_to_num()) * seen).square().mean() for answer in positions]
        efforts = self.inverse(th.cat([features, next_features], dim=1))
        loss: th.Tensor = sum(errors) + self.inverse_coef * nn.functional.mse_loss(efforts, motion.efforts)
        return loss
