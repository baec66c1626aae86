"""Actor and critic networks: fully connected heads on an encoder, initialised as in the paper."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import ContinuousCritic
from stable_baselines3.common.preprocessing import get_action_dim
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, create_mlp
from stable_baselines3.common.type_aliases import PyTorchObs
from stable_baselines3.td3.policies import Actor
from torch import nn

from sb3_stereo.policies.dynamics import DynamicsHeads
from sb3_stereo.policies.layers import hidden_norm_layers, initialise, scale_images


def _uniform(layer: nn.Module, bound: float) -> None:
    for parameter in layer.parameters():
        nn.init.uniform_(parameter, -bound, bound)


def _features(network: Actor | ContinuousCritic, obs: th.Tensor, encoder: BaseFeaturesExtractor) -> th.Tensor:
    features: th.Tensor = encoder(scale_images(obs, network.observation_space, network.normalize_images))
    return features


class RelativeFeatures(nn.Module):
    """`DynamicsHeads.relative` as a layer; the heads are trained elsewhere."""

    def __init__(self, dynamics: DynamicsHeads) -> None:
        super().__init__()
        self._unregistered = (dynamics,)  # as in `SharedEncoderView`

    def forward(self, features: th.Tensor) -> th.Tensor:
        """Map features with a displacement to such with offsets, of the same shape."""
        return self._unregistered[0].relative(features)


class StereoActor(Actor):
    """Encoder, fully connected hidden layers with normalisation, tanh. Trained by the actor's loss only.

    Args:
        args: As in SB3's `Actor`.
        hidden_norm: Of the hidden layers: "batch", "layer" or "none".
        final_init: The output layer starts in U(+-final_init).
        relabelling: For `RelativeFeatures` of displaced targets; None if targets stay where they are.
        kwargs: As in SB3's `Actor`.
    """

    def __init__(
        self,
        *args: Any,
        hidden_norm: str = "batch",
        final_init: float = 3e-4,
        relabelling: DynamicsHeads | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__(*args, **kwargs)
        self.hidden_norm, self.final_init = hidden_norm, final_init
        layers = create_mlp(
            self.features_dim,
            get_action_dim(self.action_space),
            self.net_arch,
            self.activation_fn,
            squash_output=True,
            post_linear_modules=hidden_norm_layers(hidden_norm),
        )
        self.mu = nn.Sequential(*([RelativeFeatures(relabelling)] if relabelling else []), *layers)
        initialise(self.mu, "fan_in")
        _uniform(self.mu[-2], final_init)

    def extract_features(self, obs: PyTorchObs, features_extractor: BaseFeaturesExtractor) -> th.Tensor:
        """Return features (batch, features_dim), detached if the encoder is a `SharedEncoderView`."""
        assert isinstance(obs, th.Tensor)
        return _features(self, obs, features_extractor)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        data = super()._get_constructor_parameters()
        return {**data, "hidden_norm": self.hidden_norm, "final_init": self.final_init}


@contextmanager
def frozen(*modules: nn.Module) -> Iterator[None]:
    """Let gradients through these modules without any for their parameters, which this loss does not train."""
    trained = [parameter for module in modules for parameter in module.parameters() if parameter.requires_grad]
    for parameter in trained:
        parameter.requires_grad_(False)
    try:
        yield
    finally:
        for parameter in trained:
            parameter.requires_grad_(True)


class QHead(nn.Module):
    """Q(features, action); the action joins after the first hidden layer, the only one that is normalised."""

    def __init__(
        self,
        features_dim: int,
        joining_dim: int,
        net_arch: list[int],
        activation_fn: type[nn.Module],
        hidden_norm: str,
        final_init: float,
    ) -> None:
        super().__init__()
        norms = hidden_norm_layers(hidden_norm)
        before = create_mlp(features_dim, 0, net_arch[:1], activation_fn, post_linear_modules=norms)
        after = create_mlp(net_arch[0] + joining_dim, 1, net_arch[1:], activation_fn)
        self.before, self.after = nn.Sequential(*before), nn.Sequential(*after)
        initialise(self, "fan_in")
        _uniform(self.after[-1], final_init)

    def forward(self, features: th.Tensor, joining: th.Tensor) -> th.Tensor:
        """Map features (batch, features_dim) and what joins them (batch, joining_dim) to values (batch, 1)."""
        values: th.Tensor = self.after(th.cat([self.before(features), joining], dim=1))
        return values


class StereoCritic(ContinuousCritic):
    """`n_critics` heads on one encoder, which only the critic's loss trains.

    As in SB3, the actor's update runs the critic in training mode, so batch normalisation in a critic sees two batches
    per gradient step (`PixelNorm` sees one).

    Args:
        observation_space: Images.
        action_space: Box.
        net_arch: Hidden layers of a head; the action joins after the first.
        features_extractor: The encoder.
        features_dim: Size of its output.
        activation_fn: Of the hidden layers.
        normalize_images: As in SB3.
        n_critics: Number of heads.
        share_features_extractor: As in SB3, always False here.
        hidden_norm: Of the layer before the action joins: "batch", "layer" or "none".
        final_init: The output layers start in U(+-final_init).
        dynamics: Its forward model's predictions join the action. It is trained elsewhere.
        relabelling: The features end with the displacement of the target.
    """

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Box,
        net_arch: list[int],
        features_extractor: BaseFeaturesExtractor,
        features_dim: int,
        activation_fn: type[nn.Module] = nn.ReLU,
        normalize_images: bool = True,
        n_critics: int = 2,
        share_features_extractor: bool = False,
        hidden_norm: str = "batch",
        final_init: float = 3e-4,
        dynamics: DynamicsHeads | None = None,
        relabelling: bool = False,
    ) -> None:
        if not net_arch:
            raise ValueError("the critic needs at least one hidden layer in net_arch: the action joins after the first")
        super().__init__(
            observation_space,
            action_space,
            net_arch,
            features_extractor,
            features_dim,
            activation_fn,
            normalize_images,
            n_critics=0,  # SB3's heads take the action at their input; ours follow
            share_features_extractor=share_features_extractor,
        )
        self.n_critics = n_critics
        self._unregistered = (dynamics,)  # as in `SharedEncoderView`
        self.relabelling = relabelling
        joining_dim = get_action_dim(action_space) + (dynamics.prediction_dim if dynamics else 0)
        for index in range(n_critics):
            head = QHead(features_dim, joining_dim, net_arch, activation_fn, hidden_norm, final_init)
            self.add_module(f"qf{index}", head)
            self.q_networks.append(head)

    def extract_features(self, obs: PyTorchObs, features_extractor: BaseFeaturesExtractor) -> th.Tensor:
        """Return features (batch, features_dim), detached if the encoder is a `SharedEncoderView`."""
        assert isinstance(obs, th.Tensor)
        return _features(self, obs, features_extractor)

    def forward(self, obs: th.Tensor, actions: th.Tensor) -> tuple[th.Tensor, ...]:
        """Return one tensor of values (batch, 1) per head."""
        return self.q_values(self.extract_features(obs, self.features_extractor), actions)

    def q1_forward(self, obs: th.Tensor, actions: th.Tensor) -> th.Tensor:
        """Return the first head's values (batch, 1), with gradient to the actions and nothing else."""
        with th.no_grad():
            features = self.extract_features(obs, self.features_extractor)
        return self.q1_values(features, actions)

    def q_values(self, features: th.Tensor, actions: th.Tensor) -> tuple[th.Tensor, ...]:
        """`forward` from features (batch, features_dim): what the critic's loss trains."""
        features, joining = self._relative(features), self._joining(features, actions)
        return tuple(head(features, joining) for head in self.q_networks)

    def q1_values(self, features: th.Tensor, actions: th.Tensor) -> th.Tensor:
        """`q1_forward` from features (batch, features_dim): what the actor's loss trains by."""
        head = self.q_networks[0]
        with frozen(head):
            joining = self._joining(features.detach(), actions)
            values: th.Tensor = head(self._relative(features.detach()), joining)
        return values

    def _relative(self, features: th.Tensor) -> th.Tensor:
        (dynamics,) = self._unregistered
        return dynamics.relative(features) if dynamics is not None and self.relabelling else features

    def _joining(self, features: th.Tensor, actions: th.Tensor) -> th.Tensor:
        """What joins the features in every head: the actions, and the predicted offsets after them."""
        (dynamics,) = self._unregistered
        if dynamics is None:
            return actions
        displacements: th.Tensor | float = 0.0
        if self.relabelling:
            features, displacements = dynamics.split(features)
        with frozen(dynamics):
            return th.cat([actions, dynamics.predict_offsets(features, actions, displacements)], dim=1)
