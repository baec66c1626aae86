"""A features extractor over a volume of images: the same convolutions for every view, whose features are merged."""

from __future__ import annotations

from collections.abc import Sequence

import torch as th
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from sb3_stereo.policies.extractors import flat_dim_of, make_convs, make_input_norm
from sb3_stereo.policies.layers import HIDDEN_NORMS, INPUT_NORMS, Blur, check_choice, hidden_norm_layers, initialise

MERGES = ("mean", "attention")
VIEW_LAYERS = ("own", "shared")


class VolumeCnn(BaseFeaturesExtractor):
    """The paper's "volume comprising a set of camera images" (Section 6): a view in each channel.

    Every view passes the same convolutions and a fully connected layer, and the views' features are merged to as many
    as one view has. A view without contrast, as a lost or covered camera gives it, takes no part: its pixels have no
    influence, and the others are merged as if there were no such view.

    Args:
        observation_space: Images (n_views, height, width), the environment's composite "channels".
        features_dim: Size of each view's fully connected layer; None leaves it out and merges the convolutions.
        n_filters: Per convolution, or one number for all of them.
        kernel_sizes: One per convolution.
        strides: One per convolution.
        input_norm: As in `StereoCnn`; the statistics are each view's own.
        hidden_norm: As in `StereoCnn`.
        init: As in `StereoCnn`.
        blur: As in `StereoCnn`.
        downsample: As in `StereoCnn`.
        embedding_dim: Size of a linear layer after the merging; None leaves it out.
        merge: "mean", or "attention": each feature is a weighted mean over the views, and the weights are a softmax of
            scores that a linear layer gives to each view's features.
        view_layers: "own" gives each view a fully connected layer of its own, as the same pixel is another direction in
            space for each camera; "shared" has one for all, and with merge "mean" the order of the views has no effect.

    Raises:
        ValueError: If the space does not have a view in each channel, a choice is unknown, or the per-layer lists
            differ in length.
    """

    def __init__(
        self,
        observation_space: spaces.Box,
        features_dim: int | None = 200,
        n_filters: int | Sequence[int] = 32,
        kernel_sizes: Sequence[int] = (8, 4, 3),
        strides: Sequence[int] = (4, 2, 1),
        input_norm: str = "channel",
        hidden_norm: str = "batch",
        init: str = "fan_in",
        blur: float | None = None,
        downsample: int = 1,
        embedding_dim: int | None = None,
        merge: str = "mean",
        view_layers: str = "own",
    ) -> None:
        shape = _volume_shape(observation_space)
        check_choice("input_norm", input_norm, INPUT_NORMS)
        check_choice("hidden_norm", hidden_norm, HIDDEN_NORMS)
        check_choice("merge", merge, MERGES)
        check_choice("view_layers", view_layers, VIEW_LAYERS)
        blurred = None if blur is None else Blur(shape, blur, downsample)
        n_views, height, width = shape if blurred is None else blurred.shape
        convs = make_convs(1, n_filters, kernel_sizes, strides, batch_norm=hidden_norm == "batch")
        flat_dim = flat_dim_of(convs, (1, height, width))
        view_dim = features_dim or flat_dim
        super().__init__(observation_space, embedding_dim or view_dim)
        self.blur = blurred or nn.Identity()
        self.input_norm = make_input_norm(input_norm, (n_views, height, width))
        self.convs = convs
        n_layers = (n_views if view_layers == "own" else 1) if features_dim is not None else 0
        self.fcs = nn.ModuleList(nn.Linear(flat_dim, view_dim) for _ in range(n_layers))
        self.norms = nn.ModuleList(norm(view_dim) for norm in hidden_norm_layers(hidden_norm) if n_layers)
        self.scores = nn.Linear(view_dim, view_dim) if merge == "attention" else None
        self.embedding = nn.Identity() if embedding_dim is None else nn.Linear(view_dim, embedding_dim)
        initialise(self, init)

    def forward(self, observations: th.Tensor) -> th.Tensor:
        """Map images (batch, n_views, height, width) in [0, 1] to features (batch, features_dim)."""
        seen = _with_contrast(observations)  # (batch, n_views)
        images = self.input_norm(_filled(self.blur(observations), seen))
        maps = self.convs(images.flatten(0, 1)[:, None]).flatten(start_dim=1)  # (batch * n_views, flat_dim)
        features = self._view_features(maps.unflatten(0, seen.shape))  # (batch, n_views, view_dim)
        merged: th.Tensor = self.embedding((features * self._weights(features, seen)).sum(dim=1))
        return merged

    def _view_features(self, maps: th.Tensor) -> th.Tensor:
        """Each view's features (batch, n_views, view_dim) from its maps (batch, n_views, flat_dim)."""
        if not self.fcs:
            return maps
        n_views = maps.shape[1]
        layers = list(self.fcs) * (n_views // len(self.fcs))
        features = th.stack([layer(view) for layer, view in zip(layers, maps.unbind(1), strict=True)], dim=1)
        rows = features.flatten(0, 1)
        for norm in self.norms:
            rows = norm(rows)
        return nn.functional.relu(rows).reshape(features.shape)

    def _weights(self, features: th.Tensor, seen: th.Tensor) -> th.Tensor:
        """Of each view in each feature, (batch, n_views, view_dim or 1): their sum is 1, or 0 if all are lost."""
        seen = seen[:, :, None]
        if self.scores is None:
            return seen / seen.sum(dim=1, keepdim=True).clamp(min=1)
        scores: th.Tensor = self.scores(features).masked_fill(~seen, -th.inf)
        return scores.softmax(dim=1).nan_to_num(0.0)


def _volume_shape(space: spaces.Space) -> tuple[int, int, int]:  # type: ignore[type-arg]
    shape = space.shape or ()
    if len(shape) != 3 or shape[0] < 2:
        raise ValueError(
            f"VolumeCnn needs images with a view in each channel, (n_views, height, width), got {space.shape}; "
            "set the environment's composite to 'channels'"
        )
    return shape[0], shape[1], shape[2]


def _with_contrast(images: th.Tensor) -> th.Tensor:
    """Which views show anything, (batch, n_views), bool."""
    pixels = images.flatten(start_dim=2)
    return pixels.amax(dim=2) > pixels.amin(dim=2)


def _filled(images: th.Tensor, seen: th.Tensor) -> th.Tensor:
    """The images (batch, n_views, height, width) with the batch's mean in place of what is lost.

    So it leaves no trace in the statistics of a normalisation.
    """
    if bool(seen.all()):
        return images
    weights = seen[:, :, None, None].to(images.dtype)
    mean = (images * weights).sum(dim=0) / weights.sum(dim=0).clamp(min=1)
    return th.where(weights > 0, images, mean)
