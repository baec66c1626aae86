"""Layers and initialisations that the networks are built from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch as th
from gymnasium import spaces
from stable_baselines3.common.preprocessing import is_image_space, preprocess_obs
from torch import nn

INPUT_NORMS = ("channel", "pixel", "none")


HIDDEN_NORMS = ("batch", "layer", "none")


INITS = ("fan_in", "orthogonal", "xavier")


ACTING_STATISTICS = ("running", "observation")


def check_choice(name: str, value: str, choices: Sequence[str]) -> None:
    """Raise a ValueError that lists the choices unless `value` is one of them."""
    if value not in choices:
        raise ValueError(f"unknown {name} {value!r}; choices are {', '.join(choices)}")


def initialise(module: nn.Module, init: str) -> None:
    """Draw the weights and biases of every convolution and linear layer inside `module`.

    Args:
        module: Changed in place.
        init: "fan_in" is U(+-1/sqrt(fan_in)) for weights and biases (the paper's Section 5), "orthogonal" has gain
            sqrt(2) and "xavier" is Glorot's uniform one, both with zero biases.
    """
    check_choice("init", init, INITS)
    for layer in module.modules():
        if not isinstance(layer, nn.Conv2d | nn.Linear):
            continue
        bound = layer.weight[0].numel() ** -0.5 if init == "fan_in" else 0.0
        if init == "orthogonal":
            nn.init.orthogonal_(layer.weight, gain=2**0.5)
        elif init == "xavier":
            nn.init.xavier_uniform_(layer.weight)
        else:
            nn.init.uniform_(layer.weight, -bound, bound)
        if layer.bias is not None:
            nn.init.uniform_(layer.bias, -bound, bound)


class Blur(nn.Module):
    """Blur an image with a Gaussian and keep every `downsample`-th row and column.

    A link is one or two pixels wide in the composite, so two near poses hardly share a pixel and a network learns
    memorises each. Blurred, they overlap, and what is learnt of one holds for the other.

    Args:
        shape: Of one image, (channels, height, width).
        sigma: Standard deviation in [px].
        downsample: Distance of the kept pixels in [px], a divisor of height and width; 1 keeps all.
    """

    rows: th.Tensor
    columns: th.Tensor

    def __init__(self, shape: Sequence[int], sigma: float, downsample: int) -> None:
        super().__init__()
        _, height, width = shape
        if sigma <= 0 or downsample < 1 or height % downsample or width % downsample:
            raise ValueError(
                f"cannot blur {height} x {width} px with sigma {sigma} and downsample {downsample}; "
                "sigma must be positive, and downsample a divisor of both sizes"
            )
        # Derived from the arguments, so not part of the state.
        self.register_buffer("rows", _gaussian_columns(height, sigma, downsample), persistent=False)
        self.register_buffer("columns", _gaussian_columns(width, sigma, downsample), persistent=False)
        self.shape = (shape[0], height // downsample, width // downsample)

    def forward(self, images: th.Tensor) -> th.Tensor:
        """Map images (batch, channels, height, width) to (batch, channels, height / downsample, width / downsample)."""
        # Each product has the weights on the right, which makes it one large multiplication and not one per image.
        narrow = (images @ self.columns).transpose(2, 3)  # (batch, channels, columns, height)
        blurred: th.Tensor = (narrow @ self.rows).transpose(2, 3)
        return blurred


def _gaussian_columns(size: int, sigma: float, downsample: int) -> th.Tensor:
    """Weights (size, size / downsample) of a Gaussian around every kept pixel; each column adds up to 1."""
    kept = th.arange(size // downsample) * downsample + (downsample - 1) / 2
    distance = (th.arange(size)[:, None] - kept) / sigma
    # Cut off at 4 sigma: the tails are denormal numbers, which slow the product down many times.
    weights = th.where(distance.abs() <= 4, th.exp(-0.5 * distance**2), 0.0)
    return weights / weights.sum(dim=0)


class PixelNorm(nn.Module):
    """Normalise each pixel by its own running mean and variance, then clip.

    The paper calls the state a 7056-vector (Section 3.2), and this is batch normalisation of that vector without the
    affine part: the static background goes to zero and what moves stands out.

    The running statistics normalise in training mode too (after the batch has updated them), so training and
    evaluation agree. They are updated only by passes in training mode *with gradients enabled*, that is once per
    gradient step, by the pass that trains the encoder; SB3's gradient-free passes leave them alone. The first batch
    replaces the initial values and the next ones are averaged evenly until an update weighs `momentum`.

    Args:
        shape: Of one image, (channels, height, width).
        momentum: Smallest weight of a new batch in the running statistics.
        eps: Added to the variance; 1e-2 is a standard deviation of 0.1 on images in [0, 1].
        clip: Largest absolute output.
    """

    running_mean: th.Tensor  # names with "running_" are what SB3 copies to the target networks
    running_var: th.Tensor
    num_batches_tracked: th.Tensor

    def __init__(self, shape: Sequence[int], momentum: float = 0.02, eps: float = 1e-2, clip: float = 5.0) -> None:
        super().__init__()
        self.momentum, self.eps, self.clip = momentum, eps, clip
        self.register_buffer("running_mean", th.zeros(*shape))
        self.register_buffer("running_var", th.ones(*shape))
        self.register_buffer("num_batches_tracked", th.tensor(0))

    def forward(self, images: th.Tensor) -> th.Tensor:
        """Map images (batch, channels, height, width) to the same shape, in [-clip, clip]."""
        if self.training and th.is_grad_enabled():
            self._update(images)
        normalised = (images - self.running_mean) * (self.running_var + self.eps).rsqrt()
        return normalised.clamp(-self.clip, self.clip)

    @th.no_grad()
    def _update(self, images: th.Tensor) -> None:
        self.num_batches_tracked += 1
        weight = (1.0 / self.num_batches_tracked).clamp(min=self.momentum)
        mean = images.mean(dim=0)
        var = (images - mean).square().mean(dim=0)  # five times faster than th.var_mean over dim 0
        self.running_mean.lerp_(mean, weight)
        self.running_var.lerp_(var, weight)


NO_MARKER, FAINT = 128 / 255, 3 / 255  # values of a marker map; less than FAINT is rounding
SPAN = 2.0  # of the coordinates of `MarkerCentres`, so that they weigh as much as learned features


class MarkerCentres(nn.Module):
    """Where the markers are in each view of a marker map: its centres of mass, as the paper detects colour blobs.

    A convolution finds a place to about a pixel, and learns it from thousands of images; a centre of mass is exact to a
    fraction of one, with nothing to learn. The map is 128 / 255 where there is no marker, more where the end effector's
    is, and less where the target's is (`sb3_stereo.envs.composite.marker_map`).

    Args:
        shape: Of the images, (2 * n_frames, n_views * height, width); every second channel is a map.
        n_views: Views in the rows.

    Raises:
        ValueError: If images of this shape are none with a marker map.
    """

    columns: th.Tensor
    rows: th.Tensor

    def __init__(self, shape: Sequence[int], n_views: int) -> None:
        super().__init__()
        channels, height, width = shape
        if n_views < 1 or channels % 2 or height % n_views:
            raise ValueError(
                f"images of {channels} x {height} x {width} have no marker map of {n_views} views; "
                "set the environment's composite to 'markers', or leave marker_views out"
            )
        self.n_views = n_views
        self.dim = channels // 2 * n_views * 2 * 3
        self.register_buffer("columns", th.linspace(-SPAN, SPAN, width), persistent=False)
        self.register_buffer("rows", th.linspace(-SPAN, SPAN, height // n_views), persistent=False)

    def forward(self, images: th.Tensor) -> th.Tensor:
        """Map images (batch, channels, height, width) in [0, 1] to (batch, dim).

        For every map, view and marker: x and y, from -2 to 2 across the view, and 2 if it is seen. All are 0 if not.
        """
        batch_size, channels, height, width = images.shape
        views = (batch_size, channels // 2, self.n_views, height // self.n_views, width)
        maps = images[:, 1::2].reshape(views) - NO_MARKER
        weights = (th.stack([maps, -maps], dim=3) - FAINT).clamp(min=0.0)  # (..., views, markers, rows, columns)
        mass = weights.sum(dim=(4, 5))
        x = (weights.sum(dim=4) @ self.columns) / mass.clamp(min=FAINT)
        y = (weights.sum(dim=5) @ self.rows) / mass.clamp(min=FAINT)
        return th.stack([x, y, SPAN * (mass > 0.0)], dim=4).flatten(1)


def scale_images(
    observations: th.Tensor, observation_space: spaces.Space[Any], normalize_images: bool = True
) -> th.Tensor:
    """SB3's `preprocess_obs`, but images are divided by 255 in place: one pass over the memory instead of two."""
    if normalize_images and isinstance(observation_space, spaces.Box) and is_image_space(observation_space):
        return observations.to(th.float32, copy=True).div_(255.0)
    scaled = preprocess_obs(observations, observation_space, normalize_images)
    assert isinstance(scaled, th.Tensor)
    return scaled


def hidden_norm_layers(hidden_norm: str) -> list[type[nn.Module]]:
    """Return the module that follows a fully connected layer, as the list that SB3's `create_mlp` takes."""
    check_choice("hidden_norm", hidden_norm, HIDDEN_NORMS)
    layers: dict[str, list[type[nn.Module]]] = {"batch": [nn.BatchNorm1d], "layer": [nn.LayerNorm], "none": []}
    return layers[hidden_norm]


@contextmanager
def statistics_of_each_observation(network: nn.Module) -> Iterator[None]:
    """Let batch normalisation take each observation for a batch of its own, whatever it has learnt.

    That is what a network computes that acts on single images in training mode, the default of Torch7. A fully
    connected layer has one value per channel then, which is its own mean: its normalised output is the bias.
    """

    def normalise(norm: Any, inputs: tuple[th.Tensor], output: th.Tensor) -> th.Tensor:
        (values,) = inputs  # th.group_norm, since PyTorch's BatchNorm and GroupNorm refuse a single value per channel
        return th.group_norm(values, values.shape[1], norm.weight, norm.bias, norm.eps)

    norms = [layer for layer in network.modules() if isinstance(layer, nn.BatchNorm1d | nn.BatchNorm2d)]
    hooks = [norm.register_forward_hook(normalise) for norm in norms]
    try:
        yield
    finally:
        for hook in hooks:
            hook.remove()
