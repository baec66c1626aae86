"""Features extractors: a small convolutional net over the composite image, with the paper's choices as arguments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch as th
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from sb3_stereo.policies.layers import (
    HIDDEN_NORMS,
    INPUT_NORMS,
    Blur,
    MarkerCentres,
    PixelNorm,
    check_choice,
    hidden_norm_layers,
    initialise,
)


class StereoCnn(BaseFeaturesExtractor):
    """Convolutions and one fully connected layer over one image that holds all views (the paper's Section 4.2).

    Args:
        observation_space: Images (channels, height, width), or a Dict of such, which are stacked in its order.
        features_dim: Size of the fully connected layer; None leaves it out and returns the flattened convolutions.
        n_filters: Per convolution, or one number for all of them.
        kernel_sizes: One per convolution; the paper leaves them open.
        strides: One per convolution.
        input_norm: "channel" is batch normalisation per image channel, "pixel" is `PixelNorm`, or "none".
        hidden_norm: "batch" follows every layer, "layer" only the fully connected one, or "none".
        init: "fan_in" (the paper's DDPG), "orthogonal" or "xavier" (the paper's DQN); see `initialise`.
        autocast: Compute the convolutions in bfloat16; the features stay float32.
        blur: Standard deviation of the `Blur` before everything else, in [px]; None leaves it out.
        downsample: Distance of the pixels that the blur keeps, in [px].
        embedding_dim: Size of a linear layer at the end; few numbers are enough for a pose. None leaves it out.
        marker_views: Views of an image with a marker map (`composite: markers`), whose `MarkerCentres` follow the
            features; None leaves them out.

    Raises:
        ValueError: If the space holds no (channels, height, width) images, a choice is unknown or the per-layer
            lists differ in length.
    """

    def __init__(
        self,
        observation_space: spaces.Box | spaces.Dict,
        features_dim: int | None = 200,
        n_filters: int | Sequence[int] = 32,
        kernel_sizes: Sequence[int] = (8, 4, 3),
        strides: Sequence[int] = (4, 2, 1),
        input_norm: str = "channel",
        hidden_norm: str = "batch",
        init: str = "fan_in",
        autocast: bool = False,
        blur: float | None = None,
        downsample: int = 1,
        embedding_dim: int | None = None,
        marker_views: int | None = None,
    ) -> None:
        shape = shape_of_input = _image_shape(observation_space)
        check_choice("input_norm", input_norm, INPUT_NORMS)
        check_choice("hidden_norm", hidden_norm, HIDDEN_NORMS)
        blurred = None if blur is None else Blur(shape, blur, downsample)
        shape = shape if blurred is None else blurred.shape
        convs = make_convs(shape[0], n_filters, kernel_sizes, strides, batch_norm=hidden_norm == "batch")
        flat_dim = flat_dim_of(convs, shape)
        centres = None if marker_views is None else MarkerCentres(shape_of_input, marker_views)
        super().__init__(
            observation_space, (embedding_dim or features_dim or flat_dim) + (centres.dim if centres else 0)
        )
        self.centres = centres
        self.autocast = autocast
        self.blur = blurred or nn.Identity()
        self.input_norm = make_input_norm(input_norm, shape)
        self.convs = convs
        self.fc = nn.Sequential()
        if features_dim is not None:
            norms = [norm(features_dim) for norm in hidden_norm_layers(hidden_norm)]
            self.fc = nn.Sequential(nn.Linear(flat_dim, features_dim), *norms, nn.ReLU())
        if embedding_dim is not None:
            self.fc.append(nn.Linear(features_dim or flat_dim, embedding_dim))
        initialise(self, init)
        self._laid_out = False

    def forward(self, observations: th.Tensor | dict[str, th.Tensor]) -> th.Tensor:
        """Map images (batch, channels, height, width) in [0, 1], or a map of them, to (batch, features_dim)."""
        if isinstance(observations, dict):  # SB3 may have sorted it
            assert isinstance(self._observation_space, spaces.Dict)
            observations = th.cat([observations[name] for name in self._observation_space.spaces], dim=2)
        if not self._laid_out:  # not at once: PPO initialises anew, and torch's orthogonal_ refuses this layout
            self.convs.to(memory_format=th.channels_last)  # type: ignore[call-overload]  # faster on CPUs
            self._laid_out = True
        images = _channels_last(self.input_norm(self.blur(observations)))
        with th.autocast(images.device.type, dtype=th.bfloat16, enabled=self.autocast):
            maps = self.convs(images)  # (batch, filters, rows, columns)
        if maps.requires_grad:
            maps.register_hook(_channels_last)  # after the flattening it is not, and every ReLU would be slow
        features: th.Tensor = self.fc(maps.float().flatten(start_dim=1))
        return features if self.centres is None else th.cat([features, self.centres(observations)], dim=1)


def _image_shape(space: spaces.Box | spaces.Dict) -> Sequence[int]:
    """Of the one image (channels, height, width) that the observations make."""
    views = list(space.spaces.values()) if isinstance(space, spaces.Dict) else [space]
    shapes = {view.shape for view in views}
    shape = shapes.pop()
    if shapes or shape is None or len(shape) != 3:
        found = ", ".join(str(view.shape) for view in views)
        one = "one shape" if shapes else "shape"
        raise ValueError(f"StereoCnn needs images of {one} (channels, height, width), got {found}")
    channels, height, width = shape
    return channels, height * len(views), width


def _channels_last(images: th.Tensor) -> th.Tensor:
    return images.contiguous(memory_format=th.channels_last)


def make_input_norm(input_norm: str, shape: Sequence[int]) -> nn.Module:
    if input_norm == "pixel":
        return PixelNorm(shape)
    # Without the affine part, which the first convolution has anyway: it would cost that layer's input gradient.
    return nn.BatchNorm2d(shape[0], affine=False) if input_norm == "channel" else nn.Identity()


def make_convs(
    channels: int, n_filters: int | Sequence[int], kernel_sizes: Sequence[int], strides: Sequence[int], batch_norm: bool
) -> nn.Sequential:
    filters = [n_filters] * len(kernel_sizes) if isinstance(n_filters, int) else list(n_filters)
    if not len(filters) == len(kernel_sizes) == len(strides):
        raise ValueError(
            "n_filters, kernel_sizes and strides need one entry per convolution, "
            f"got {len(filters)}, {len(kernel_sizes)} and {len(strides)}"
        )
    layers: list[nn.Module] = []
    for fan, out, kernel, stride in zip([channels, *filters], filters, kernel_sizes, strides):
        norms = [nn.BatchNorm2d(out)] if batch_norm else []
        layers += [nn.Conv2d(fan, out, kernel, stride), *norms, nn.ReLU(inplace=True)]
    return nn.Sequential(*layers)


def flat_dim_of(convs: nn.Sequential, shape: Sequence[int]) -> int:
    """Count the outputs with a dry pass, in evaluation mode: a training pass would enter the running statistics."""
    convs.eval()
    try:
        with th.no_grad():
            flat_dim = convs(th.zeros(1, *shape)).numel()
    except RuntimeError as error:
        raise ValueError(
            f"images of {shape[1]} x {shape[2]} px are too small for these kernels and strides; "
            "take smaller ones or less downsampling"
        ) from error
    convs.train()
    return int(flat_dim)


def refuse_maps(policy: object, space: spaces.Space[Any]) -> None:
    if isinstance(space, spaces.Dict):
        raise ValueError(
            f"{type(policy).__name__} takes one image, and this environment gives a map of {', '.join(space.spaces)}; "
            "set its composite to 'stack' or 'channels', or take MultiInputPolicy with "
            "features_extractor_class: sb3_stereo.policies.extractors.StereoCnn"
        )
