"""One encoder for two networks: who owns it, and how its features are computed once."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch as th
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn


class BorrowedEncoder(BaseFeaturesExtractor):
    """The encoder of another network, read without gradient.

    It registers no parameters: the lender alone trains them, saves them and averages them into its target.
    """

    def __init__(self, encoder: BaseFeaturesExtractor) -> None:
        super().__init__(encoder._observation_space, encoder.features_dim)
        self._lender = (encoder,)  # the tuple hides it from torch's registry

    @property
    def lender(self) -> BaseFeaturesExtractor:
        """The encoder itself."""
        return self._lender[0]

    def forward(self, observations: th.Tensor) -> th.Tensor:
        """Map images (batch, channels, height, width) in [0, 1] to detached features (batch, features_dim)."""
        with th.no_grad():
            features: th.Tensor = self._lender[0](observations)
        return features


@dataclass
class _Remembered:
    observations: weakref.ref[th.Tensor]
    key: tuple[int, bool]
    state: list[th.Tensor]
    features: th.Tensor


class FeatureMemo:
    """Remember an encoder's last gradient-free features, so that actor and critic compute them once.

    A hit needs the same observation tensor object, unchanged, and an encoder in the same mode with equal parameters
    and buffers, so the result is bit for bit what a second pass would give. Values are compared, not version
    counters: SB3's Polyak update writes through `.data`, which the counters do not see. An encoder that changes
    itself during the pass (batch normalisation in training mode) never hits. The entry dies with the observations.
    """

    def __init__(self, encoder: nn.Module) -> None:
        self._encoder = encoder
        self._modules = list(encoder.modules())
        self._entry: _Remembered | None = None

    def __call__(self, observations: th.Tensor, compute: Callable[[], th.Tensor]) -> th.Tensor:
        """Return the features of the raw observations (batch, channels, height, width), computed only if needed."""
        if th.is_grad_enabled() or th.is_inference_mode_enabled():
            return compute()
        key = (observations._version, self._encoder.training)
        state = self._state()
        entry = self._entry
        same_call = entry is not None and entry.observations() is observations and entry.key == key
        if entry is not None and same_call and all(map(th.equal, entry.state, state)):
            return entry.features
        before = [tensor.clone() for tensor in state]
        features = compute()
        self._entry = _Remembered(weakref.ref(observations, self._forget), key, before, features)
        return features

    def _state(self) -> list[th.Tensor]:
        """The encoder's parameters and buffers; `Module.parameters` takes longer than to compare them."""
        owned = (tensors for module in self._modules for tensors in (module._parameters, module._buffers))
        return [tensor for tensors in owned for tensor in tensors.values() if tensor is not None]

    def _forget(self, observations: weakref.ref[th.Tensor]) -> None:
        if self._entry is not None and self._entry.observations is observations:
            self._entry = None

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_entry": None}  # copies and pickles start empty
