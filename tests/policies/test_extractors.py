"""Laws of the features extractor and its normalisation."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch as th
from fake_env import FakeImageEnv
from gymnasium import spaces
from stable_baselines3.common.preprocessing import preprocess_obs
from torch import nn

from sb3_stereo.policies.extractors import StereoCnn
from sb3_stereo.policies.layers import Blur, PixelNorm, initialise, scale_images

SPACE = FakeImageEnv().observation_space


def images(n: int = 6, shape: tuple[int, ...] = (1, 36, 36), seed: int = 0) -> th.Tensor:
    return th.rand(n, *shape, generator=th.Generator().manual_seed(seed))


def small_cnn(**kwargs) -> StereoCnn:
    return StereoCnn(SPACE, **{"features_dim": 12, "n_filters": 6, **kwargs})


@pytest.mark.parametrize("shape", [(1, 84, 84), (1, 36, 36), (2, 36, 44), (3, 60, 36)])
@pytest.mark.parametrize("features_dim", [12, None])
def test_features_have_the_announced_size_for_any_image(shape, features_dim):
    cnn = StereoCnn(spaces.Box(0, 255, shape, np.uint8), features_dim, n_filters=4)
    assert cnn(images(shape=shape)).shape == (6, cnn.features_dim)


@pytest.mark.parametrize("input_norm", ["channel", "pixel", "none"])
@pytest.mark.parametrize("hidden_norm", ["batch", "layer", "none"])
@pytest.mark.parametrize("init", ["fan_in", "orthogonal", "xavier"])
def test_gradients_reach_every_cameras_half_of_the_composite(input_norm, hidden_norm, init):
    th.manual_seed(0)  # six filters can all be dead by chance
    cnn = small_cnn(input_norm=input_norm, hidden_norm=hidden_norm, init=init)
    observations = images().requires_grad_()
    (cnn(observations) * images(6, (12,))).sum().backward()
    assert observations.grad is not None
    upper, lower = observations.grad[:, :, :18], observations.grad[:, :, 18:]
    assert upper.abs().sum() > 0 and lower.abs().sum() > 0


def test_construction_leaves_the_running_statistics_clean():
    for module in small_cnn(features_dim=None).modules():
        if isinstance(module, nn.BatchNorm2d):
            assert module.running_mean.eq(0).all() and module.running_var.eq(1).all()
            assert module.num_batches_tracked == 0


def test_hidden_norm_says_which_layers_are_normalised():
    def norms(hidden_norm: str) -> list[type]:
        modules = small_cnn(input_norm="none", hidden_norm=hidden_norm).modules()
        return [type(m) for m in modules if isinstance(m, nn.BatchNorm1d | nn.BatchNorm2d | nn.LayerNorm)]

    assert norms("batch") == [nn.BatchNorm2d] * 3 + [nn.BatchNorm1d]
    assert norms("layer") == [nn.LayerNorm]
    assert norms("none") == []


def test_fan_in_initialisation_fills_its_bounds():
    layer = nn.Conv2d(8, 32, 4)
    initialise(layer, "fan_in")
    bound = (8 * 4 * 4) ** -0.5
    assert 0.95 * bound < layer.weight.abs().max() <= bound
    assert 0.5 * bound < layer.bias.abs().max() <= bound


def test_orthogonal_initialisation_is_orthogonal_with_gain_root_two():
    layer = nn.Linear(20, 8)
    initialise(layer, "orthogonal")
    th.testing.assert_close(layer.weight @ layer.weight.T, 2 * th.eye(8), atol=1e-5, rtol=0)
    assert layer.bias.eq(0).all()


def test_xavier_initialisation_fills_its_bounds():
    layer = nn.Linear(200, 100)
    initialise(layer, "xavier")
    bound = (6 / 300) ** 0.5
    assert 0.95 * bound < layer.weight.abs().max() <= bound
    assert layer.bias.eq(0).all()


def test_filters_may_differ_by_layer():
    cnn = StereoCnn(SPACE, 12, n_filters=[3, 5, 7])
    assert [layer.out_channels for layer in cnn.convs if isinstance(layer, nn.Conv2d)] == [3, 5, 7]


def test_autocast_gives_nearly_the_same_float32_features():
    cnn = small_cnn(input_norm="pixel", hidden_norm="layer")
    exact = cnn(images())
    cnn.autocast = True
    fast = cnn(images())
    assert fast.dtype == th.float32
    assert not th.equal(fast, exact)
    th.testing.assert_close(fast, exact, atol=0.05, rtol=0.05)


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"input_norm": "pixle"}, "unknown input_norm 'pixle'; choices are channel, pixel, none"),
        ({"hidden_norm": "bn"}, "unknown hidden_norm 'bn'; choices are batch, layer, none"),
        ({"init": "he"}, "unknown init 'he'; choices are fan_in, orthogonal, xavier"),
        (
            {"n_filters": [4, 4]},
            "n_filters, kernel_sizes and strides need one entry per convolution, got 2, 3 and 3",
        ),
    ],
)
def test_wrong_settings_are_refused_with_the_choices(kwargs, message):
    with pytest.raises(ValueError) as error:
        small_cnn(**kwargs)
    assert str(error.value) == message


def test_vectors_are_refused():
    with pytest.raises(ValueError) as error:
        StereoCnn(spaces.Box(0, 255, (84, 84), np.uint8))
    assert str(error.value) == "StereoCnn needs images of shape (channels, height, width), got (84, 84)"


def test_pixel_norm_starts_from_the_first_batch():
    norm, batch = PixelNorm((1, 4, 4)), images(8, (1, 4, 4))
    norm(batch)
    th.testing.assert_close(norm.running_mean, batch.mean(0))
    th.testing.assert_close(norm.running_var, batch.var(0, correction=0))


def test_pixel_norm_averages_evenly_and_then_with_its_momentum():
    norm = PixelNorm((1, 4, 4), momentum=0.25)
    batches = [images(8, (1, 4, 4), seed) for seed in range(5)]
    for batch in batches[:4]:
        norm(batch)
    mean = th.stack([batch.mean(0) for batch in batches[:4]]).mean(0)
    th.testing.assert_close(norm.running_mean, mean)
    norm(batches[4])
    th.testing.assert_close(norm.running_mean, 0.75 * mean + 0.25 * batches[4].mean(0))


def test_pixel_norm_agrees_in_training_and_evaluation():
    norm, batch = PixelNorm((1, 4, 4)), images(8, (1, 4, 4))
    trained = norm(batch)
    assert th.equal(trained, norm.eval()(batch))


def test_pixel_norm_learns_only_from_passes_that_train():
    norm, batch = PixelNorm((1, 4, 4)), images(8, (1, 4, 4))
    with th.no_grad():
        norm(batch)
    norm.eval()(batch)
    assert norm.num_batches_tracked == 0 and norm.running_mean.eq(0).all()


def test_pixel_norm_removes_a_static_background_and_clips():
    norm = PixelNorm((1, 4, 4))
    background = images(1, (1, 4, 4)).repeat(8, 1, 1, 1)
    assert norm(background).abs().max() < 1e-5
    assert norm.eval()(background + 100).eq(5.0).all()


def test_blur_keeps_constants_and_the_middle_of_a_dot() -> None:
    blur = Blur((1, 12, 9), sigma=1.5, downsample=3)
    assert blur(th.full((2, 1, 12, 9), 0.7)).shape == (2, 1, 4, 3)
    th.testing.assert_close(blur(th.full((1, 1, 12, 9), 0.7)), th.full((1, 1, 4, 3), 0.7))
    dot = th.zeros(1, 1, 12, 9)
    dot[0, 0, 4, 7] = 1.0  # in the second of the four rows' and the third of the three columns' middle
    assert int(blur(dot).argmax()) == 1 * 3 + 2


def test_blur_commutes_with_the_mirror() -> None:
    blur, images = Blur((1, 12, 9), sigma=2.0, downsample=3), th.rand(3, 1, 12, 9)
    th.testing.assert_close(blur(images.flip(3)), blur(images).flip(3))


def test_blurred_near_images_are_nearer_than_far_ones() -> None:
    dots = th.zeros(3, 1, 12, 12)
    for image, column in enumerate((2, 3, 9)):
        dots[image, 0, 6, column] = 1.0
    here, near, far = Blur((1, 12, 12), sigma=2.0, downsample=1)(dots)
    assert (here - near).norm() < 0.6 * (here - far).norm()


@pytest.mark.parametrize(("sigma", "downsample"), [(0.0, 1), (1.0, 5), (1.0, 0)])
def test_a_blur_that_does_not_fit_is_explained(sigma: float, downsample: int) -> None:
    message = (
        f"^cannot blur 12 x 9 px with sigma {sigma} and downsample {downsample}; "
        "sigma must be positive, and downsample a divisor of both sizes$"
    )
    with pytest.raises(ValueError, match=message):
        Blur((1, 12, 9), sigma, downsample)


def test_too_small_images_are_explained() -> None:
    message = "^images of 9 x 9 px are too small for these kernels and strides; take smaller ones or less downsampling$"
    with pytest.raises(ValueError, match=message):
        small_cnn(blur=1.0, downsample=4)


def test_blur_is_no_part_of_the_weights() -> None:
    plain = StereoCnn(SPACE, kernel_sizes=(3,), strides=(2,))
    blurred = StereoCnn(SPACE, kernel_sizes=(3,), strides=(2,), blur=1.0)
    assert plain.state_dict().keys() == blurred.state_dict().keys()


@pytest.mark.parametrize("space", [SPACE, spaces.Box(0, 1, (3,), np.float32)])
@pytest.mark.parametrize("normalize_images", [True, False])
def test_scaling_is_sb3s_to_the_bit_and_leaves_its_input_alone(space, normalize_images):
    observations = th.as_tensor(np.stack([space.sample() for _ in range(5)]))
    before = observations.clone()
    scaled = scale_images(observations, space, normalize_images)
    assert scaled.dtype == th.float32
    assert th.equal(scaled, preprocess_obs(observations, space, normalize_images))
    assert th.equal(observations, before)


@pytest.mark.parametrize("hidden_norm", ["batch", "layer", "none"])
def test_gradients_are_those_of_the_plain_layers(hidden_norm):
    """What saves passes over the memory (ReLU in place, gradients in the faster layout) changes no number.

    Batch normalisation sums in the order of the memory, so that with it the last bits may differ.
    """
    cnn = small_cnn(hidden_norm=hidden_norm)
    plain = copy.deepcopy(cnn)
    for relu in (module for module in plain.convs if isinstance(module, nn.ReLU)):
        relu.inplace = False
    cnn(images()).square().sum().backward()
    maps = plain.convs(plain.input_norm(images()).contiguous(memory_format=th.channels_last))
    plain.fc(maps.flatten(start_dim=1)).square().sum().backward()
    for found, expected in zip(cnn.parameters(), plain.parameters(), strict=True):
        if hidden_norm == "batch":
            th.testing.assert_close(found.grad, expected.grad, rtol=1e-3, atol=1e-3)
        else:
            assert th.equal(found.grad, expected.grad)
