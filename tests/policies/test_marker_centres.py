"""`MarkerCentres` finds the markers where the cameras' frames have them."""

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium.spaces import Box

from sb3_stereo.policies.extractors import StereoCnn
from sb3_stereo.policies.layers import NO_MARKER, SPAN, MarkerCentres

FRAME, VIEW = np.array([320, 240]), np.array([84, 42])


def test_centres_are_those_of_the_frames_to_a_fraction_of_a_pixel() -> None:
    env = gym.make("sb3_stereo:WamStereoReachRandom-v1", composite="markers")
    errors = []
    for seed in range(12):
        image, info = env.reset(seed=seed)
        found = MarkerCentres(image.shape, 2)(th.from_numpy(image)[None] / 255).reshape(2, 2, 3).numpy()
        pixels = ((found[:, :, :2] / SPAN + 1) / 2 * (VIEW - 1) + 0.5) * FRAME / VIEW - 0.5
        target = info["target_pixels"]
        expected = np.stack([target + info["pixel_offsets"], target], axis=1)  # (views, markers, 2)
        assert (found[:, :, 2] == SPAN).all()
        errors.append(np.linalg.norm(pixels - expected, axis=2))
    assert np.median(errors) < 0.5 and np.quantile(errors, 0.9) < 3.0, "px of a frame; a composite's pixel has 4 to 6"


def test_a_marker_that_is_not_seen_has_no_place() -> None:
    empty = th.full((2, 2, 84, 84), NO_MARKER)
    assert (MarkerCentres((2, 84, 84), 2)(empty) == 0).all()
    empty[0, 1, 10, 20] = 1.0
    found = MarkerCentres((2, 84, 84), 2)(empty).reshape(2, 2, 2, 3)
    assert found[0, 0, 0, 2] == SPAN and found[0, 0, 0, 0] == pytest.approx((20 / 83 * 2 - 1) * SPAN)
    found[0, 0, 0] = 0
    assert (found == 0).all(), "the other marker, view and image"


def test_they_follow_the_features() -> None:
    space = Box(0, 255, (2, 84, 84), np.uint8)
    cnn = StereoCnn(space, features_dim=8, embedding_dim=3, marker_views=2).eval()
    images = th.rand(5, 2, 84, 84)
    assert cnn(images).shape == (5, cnn.features_dim) == (5, 3 + 12)
    assert th.equal(cnn(images)[:, 3:], MarkerCentres((2, 84, 84), 2)(images))


@pytest.mark.parametrize("shape", [(1, 84, 84), (2, 85, 84)])
def test_images_without_a_map_are_refused(shape: tuple[int, int, int]) -> None:
    with pytest.raises(ValueError, match=r"no marker map of 2 views; set the environment's composite to 'markers'"):
        StereoCnn(Box(0, 255, shape, np.uint8), features_dim=8, marker_views=2)
