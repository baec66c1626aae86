"""The algorithm without its speed optimisations, to compare what is learnt: a row of `benchmarks.tables.claims`."""

from typing import Any

import torch as th

from sb3_stereo.policies.extractors import StereoCnn


class ReferenceCnn(StereoCnn):
    """`StereoCnn` in torch's own memory layout (NCHW), layer after layer."""

    def forward(self, observations: Any) -> th.Tensor:
        """Map images (batch, channels, height, width) in [0, 1] to (batch, features_dim)."""
        maps = self.convs(self.input_norm(self.blur(observations)))
        features: th.Tensor = self.fc(maps.flatten(start_dim=1))
        return features


REFERENCE = (
    *("--gym-packages", __name__),
    "-params",
    f"policy_kwargs.features_extractor_class:{__name__}.{ReferenceCnn.__name__}",
    "policy_kwargs.optimizer_kwargs.fused:false",
)
