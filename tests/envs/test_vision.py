"""Composite image and blobs against plain OpenCV and hand-made pictures."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from sb3_stereo.envs.composite import HEIGHT, WIDTH, composite, marker_map
from sb3_stereo.envs.markers import MIN_PIXELS, find_blobs, marker_masks

Image = NDArray[np.uint8]


def picture() -> Image:
    return np.full((240, 320, 3), 255, np.uint8)


def luminance(frame: Image) -> Image:
    """The paper's words in plain OpenCV."""
    return cv2.cvtColor(cv2.resize(frame, (84, 42)), cv2.COLOR_RGB2YUV)[:, :, 0]  # type: ignore[return-value]


@pytest.mark.parametrize("channels", [3, 4])
def test_composite_is_plain_opencv_on_random_frames(channels: int) -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        frames = rng.integers(0, 256, (2, 240, 320, channels), dtype=np.uint8)
        expected = np.vstack([luminance(np.ascontiguousarray(frame[:, :, :3])) for frame in frames])
        np.testing.assert_array_equal(composite(frames), expected[None])


def test_views_are_stacked_in_camera_order() -> None:
    black, white = np.zeros((240, 320, 3), np.uint8), picture()
    image = composite([black, white, black])
    assert image.shape == (1, 126, 84)
    assert (image[0, :42].max(), image[0, 42:84].min(), image[0, 84:].max()) == (0, 255, 0)


def test_centroids_are_the_mean_pixels() -> None:
    frame = picture()
    frame[10:20, 30:51] = (200, 0, 0)
    frame[100:103, 200:205] = (0, 0, 220)
    blobs = find_blobs(frame)
    np.testing.assert_allclose(blobs.end_effector, (40.0, 14.5))
    np.testing.assert_allclose(blobs.target, (202.0, 101.0))
    assert np.hypot(*blobs.offset) == pytest.approx(np.hypot(162.0, 86.5))


def test_a_marker_of_too_few_pixels_is_undefined() -> None:
    frame = picture()
    frame[0, : MIN_PIXELS - 1] = (255, 0, 0)
    frame[5:9, 5:9] = (0, 0, 255)
    blobs = find_blobs(frame)
    assert np.isnan(blobs.end_effector).all() and np.isfinite(blobs.target).all()
    assert np.isnan(blobs.offset).all()
    frame[0, MIN_PIXELS - 1] = (255, 0, 0)
    assert np.isfinite(find_blobs(frame).offset).all()


@pytest.mark.parametrize("green", [60, 255])
def test_masks_are_where_the_colours_are_in_plain_numpy(green: int) -> None:
    """Also where next to nothing is dim in green, so that the part looked at is small."""
    frame = np.random.default_rng(green).integers(green, 256, (240, 320, 3), dtype=np.uint8)
    frame[7, 9], frame[200:204, 300] = (255, 0, 0), (0, 0, 255)
    for channel, mask in zip((0, 2), marker_masks(frame), strict=True):
        others = np.delete(frame, channel, axis=2)
        np.testing.assert_array_equal(mask == 255, (frame[:, :, channel] >= 128) & (others <= 70).all(axis=2))
        assert set(np.unique(mask)) <= {0, 255}


def test_the_marker_map_tells_the_centroids() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        frame, (x, y) = picture(), rng.integers(0, (300, 220))
        frame[y : y + 12, x : x + 12] = (255, 0, 0)
        frame[(y + 120) % 220 :, (x + 150) % 300 :][:12, :12] = (0, 0, 255)
        [image] = marker_map([marker_masks(frame)]).astype(float)
        assert image.shape == (HEIGHT, WIDTH)
        for sign, centroid in zip((1, -1), find_blobs(frame), strict=True):
            weights = np.maximum(sign * (image - 128), 0)
            pixel = np.array([weights.sum(0) @ np.arange(WIDTH), weights.sum(1) @ np.arange(HEIGHT)]) / weights.sum()
            found = (pixel + 0.5) * (320 / WIDTH, 240 / HEIGHT) - 0.5
            np.testing.assert_allclose(found, centroid, atol=0.5)


def test_the_marker_map_is_grey_without_markers_and_follows_the_views() -> None:
    red = picture()
    red[100:120, 100:120] = (255, 0, 0)
    image = marker_map([marker_masks(picture()), marker_masks(red)])
    assert image.shape == (1, 2 * HEIGHT, WIDTH)
    assert (image[0, :HEIGHT] == 128).all() and image[0, HEIGHT:].max() == 255 and image.min() == 128


def plain_centroid(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The mean pixel from the moments of the blob's bounding box, in plain OpenCV."""
    pixels = mask.astype(np.uint8)
    x, y, width, height = cv2.boundingRect(pixels)
    moments = cv2.moments(pixels[y : y + height, x : x + width].copy(), binaryImage=True)
    if moments["m00"] < MIN_PIXELS:
        return np.full(2, np.nan)
    return np.array([x + moments["m10"] / moments["m00"], y + moments["m01"] / moments["m00"]])


def random_scene(rng: np.random.Generator, channels: int) -> Image:
    """Rectangles of any colour, many near the thresholds, on white, noise or nothing but themselves."""
    frame = np.full((240, 320, channels), 255, np.uint8)
    if rng.random() < 0.1:
        frame = rng.integers(0, 256, frame.shape, dtype=np.uint8)
    for _ in range(rng.integers(0, 12)):
        x, y, width, height = rng.integers((0, 0, 1, 1), (320, 240, 60, 60))
        frame[y : y + height, x : x + width] = rng.choice([0, 69, 70, 71, 127, 128, 129, 255], channels)
    return frame


@pytest.mark.parametrize("channels", [3, 4])
def test_blobs_are_plain_opencv_to_the_bit_on_random_frames(channels: int) -> None:
    rng = np.random.default_rng(0)
    n_seen = 0
    for _ in range(400):
        frame = random_scene(rng, channels)
        red, green, blue = (frame[:, :, channel] for channel in range(3))
        dim_green = green <= 70
        blobs = find_blobs(frame)
        expected = (
            plain_centroid((red >= 128) & dim_green & (blue <= 70)),
            plain_centroid((blue >= 128) & dim_green & (red <= 70)),
        )
        np.testing.assert_array_equal(blobs, expected)
        n_seen += int(np.isfinite(expected).all(axis=1).sum())
    assert 100 < n_seen < 800  # blobs and hidden ones


def test_no_grey_is_a_marker() -> None:
    greys = np.repeat(np.arange(256, dtype=np.uint8), 3).reshape(16, 16, 3)
    blobs = find_blobs(greys)
    assert np.isnan(blobs.end_effector).all() and np.isnan(blobs.target).all()


def test_swapping_red_and_blue_swaps_the_markers() -> None:
    rng = np.random.default_rng(1)
    frame = picture()
    for colour in ((230, 20, 10), (10, 20, 230)):
        y, x = rng.integers(0, 200, 2)
        frame[y : y + 12, x : x + 9] = colour
    blobs, swapped = find_blobs(frame), find_blobs(np.ascontiguousarray(frame[:, :, ::-1]))
    np.testing.assert_array_equal(blobs.end_effector, swapped.target)
    np.testing.assert_array_equal(blobs.target, swapped.end_effector)
