"""Auxiliary heads on the encoder: where the end effector is, forward dynamics and inverse dynamics."""

from __future__ import annotations

from typing import NamedTuple

import torch as th
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, create_mlp
from torch import nn

from sb3_stereo.policies.layers import check_choice, scale_images

FORWARD_DYNAMICS = ("offsets", "features")


class DynamicsSamples(NamedTuple):
    """Transitions without their rewards."""

    observations: th.Tensor  # (batch, channels, height, width), uint8
    actions: th.Tensor  # (batch, n_joints), in [-1, 1]
    next_observations: th.Tensor  # like observations
    next_offsets: th.Tensor  # (batch, n_views, 2) in [px], nan where a marker was occluded


class DynamicsHeads(nn.Module):
    """Three regressions from the features that can only succeed if these hold the arm's pose.

    `position` reads the marker's offsets from the target, `forward_model` predicts them after an action, and
    `inverse_model` the action between two observations. That is 2 targets per view, twice, and 1 per joint for each
    transition, while a reward is a single one, and a noisy one.

    Args:
        features_dim: Size of the encoder's output.
        n_joints: Size of the action.
        n_views: Views in the image.
        hidden: Size of each head's hidden layer.
        offset_scale: Pixels that count as 1.
        inverse_coef: Weight of the inverse model's loss.
        forward_dynamics: What the forward model predicts after an action: "offsets", or a change of the "features",
            from which `position` reads the offsets. No action, no change: the arm is at rest between two steps, and
            near a target that matters more than what is predicted of large actions.

    Raises:
        ValueError: If `forward_dynamics` is unknown.
    """

    n_updates: th.Tensor
    optimizer: th.optim.Optimizer

    def __init__(
        self,
        features_dim: int,
        n_joints: int,
        n_views: int = 2,
        hidden: int = 200,
        offset_scale: float = 50.0,
        inverse_coef: float = 0.5,
        forward_dynamics: str = "offsets",
    ) -> None:
        super().__init__()
        check_choice("forward_dynamics", forward_dynamics, FORWARD_DYNAMICS)
        self.forward_dynamics = forward_dynamics
        self.n_views, self.offset_scale, self.inverse_coef = n_views, offset_scale, inverse_coef
        self.prediction_dim = 3 * n_views
        self.position = nn.Sequential(*create_mlp(features_dim, 2 * n_views, [hidden]))
        predicted_dim = 2 * n_views if forward_dynamics == "offsets" else features_dim
        self.forward_model = nn.Sequential(*create_mlp(features_dim + n_joints, predicted_dim, [hidden]))
        self.inverse_model = nn.Sequential(*create_mlp(2 * features_dim, n_joints, [hidden]))
        self.register_buffer("n_updates", th.tensor(0))  # saved: pre-training happens once in a model's life

    @property
    def offsets_dim(self) -> int:
        """Size of the marker's offsets in all views."""
        return 2 * self.n_views

    def relative(self, features: th.Tensor) -> th.Tensor:
        """Put the marker's offsets from a displaced target in the place of the displacement.

        Args:
            features: Shape (batch, features_dim + offsets_dim), the displacement behind the encoder's.
        """
        features, displacements = self.split(features)
        with th.no_grad():
            return th.cat([features, self.position(features) - displacements], dim=1)

    def split(self, features: th.Tensor) -> tuple[th.Tensor, th.Tensor]:
        """The encoder's features (batch, features_dim), and the displacement (batch, offsets_dim) behind them."""
        return features[:, : -self.offsets_dim], features[:, -self.offsets_dim :]

    def predict_offsets(
        self, features: th.Tensor, actions: th.Tensor, displacements: th.Tensor | float = 0.0
    ) -> th.Tensor:
        """Offsets after the actions (batch, n_joints), and their lengths: (batch, prediction_dim).

        Args:
            features: Shape (batch, features_dim).
            actions: Shape (batch, n_joints).
            displacements: Of the target, (batch, offsets_dim); 0 leaves it where it is.
        """
        offsets = self.offsets_after(features, actions) - displacements
        return th.cat([offsets, offsets.unflatten(1, (-1, 2)).norm(dim=2)], dim=1)  # type: ignore[no-untyped-call]

    def offsets_after(self, features: th.Tensor, actions: th.Tensor) -> th.Tensor:
        """Predict the marker's offsets (batch, offsets_dim) after actions (batch, n_joints), scaled."""
        acted = th.cat([features, actions], dim=1)
        if self.forward_dynamics == "offsets":
            offsets: th.Tensor = self.forward_model(acted)
            return offsets
        at_rest = th.cat([features, th.zeros_like(actions)], dim=1)
        after, before = self.forward_model(th.cat([acted, at_rest])).chunk(2)
        offsets = self.position(features + after - before)
        return offsets

    def loss(self, features: th.Tensor, next_features: th.Tensor, samples: DynamicsSamples) -> th.Tensor:
        """Sum of the three mean squared errors; occluded markers are masked.

        Args:
            features: Of the observations, (batch, features_dim).
            next_features: Of the next observations, likewise.
            samples: The transitions.
        """
        offsets = samples.next_offsets.flatten(1) / self.offset_scale
        seen = ~offsets.isnan()
        predictions = self.position(next_features), self.offsets_after(features, samples.actions)
        errors = [((predicted - offsets.nan_to_num()) * seen).square().mean() for predicted in predictions]
        actions = self.inverse_model(th.cat([features, next_features], dim=1))
        loss: th.Tensor = sum(errors) + self.inverse_coef * nn.functional.mse_loss(actions, samples.actions)
        return loss

    def add_optimizer(self, encoder: BaseFeaturesExtractor, learning_rate: float) -> None:
        """Give the heads their Adam, which trains the encoder too."""
        parameters = [*encoder.parameters(), *self.parameters()]
        self.optimizer = th.optim.Adam(parameters, learning_rate, fused=True)

    def update(self, encoder: BaseFeaturesExtractor, samples: DynamicsSamples) -> float:
        """Take one gradient step on the encoder and the heads, and return the loss."""
        images = th.cat([samples.observations, samples.next_observations])
        was_training = encoder.training
        encoder.train()
        features, next_features = encoder(scale_images(images, encoder._observation_space)).chunk(2)
        encoder.train(was_training)
        loss = self.loss(features, next_features, samples)
        self.optimizer.zero_grad()  # of DQN's loss, which trains the encoder too
        loss.backward()  # type: ignore[no-untyped-call]
        self.optimizer.step()
        self.optimizer.zero_grad()  # DQN clips by the norm of all gradients of the policy
        self.n_updates += 1
        return loss.item()
