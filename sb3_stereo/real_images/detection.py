"""Ordinary images under light that changes: the markers in them, red and blue blobs in HSV, and what the network sees.

The simulated environment keeps its own exact thresholds (`envs/markers.py`): its rewards depend on them.
"""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.composite import Composite
from sb3_stereo.envs.markers import MIN_PIXELS, Blobs

Image = NDArray[np.uint8]  # RGB, (height, width, 3)
Mask = NDArray[np.bool_]

RED_HUE, BLUE_HUE = 0, 120  # in OpenCV's hue, half degrees
HUE_TOLERANCE = 18  # half degrees; noise and JPEG move a pixel's hue, its neighbours keep the blob together
MIN_SATURATION = 90  # of 255; a guess that muted surfaces have less
MIN_COLOUR = 40  # saturation times value, of 255: what is darker has no colour that can be trusted
SHARE = 0.5  # of the strongest colour of its hue: a marker's shaded side has more, a reflection of it less
DENOISING = 5  # [px], of the median filter before the composite; rendered frames hardly change by it
WHITE_SHARE = 0.02  # of the pixels are at least as bright as what counts as white


def find_markers(image: Image) -> Blobs:
    """Find the red (end effector) and the blue (target) marker, the largest blob of each colour.

    Args:
        image: RGB, any size.

    Returns:
        Centroids in the pixels of the image, nan where a marker is hidden.
    """
    return Blobs(*map(_centroid, marker_masks(image)))


def marker_masks(image: Image) -> tuple[Image, Image]:
    """Where the red and where the blue marker is in an RGB image: 255 there, else 0, (height, width) each, uint8."""
    smooth = cv2.medianBlur(white_balanced(image), 3)
    hue, saturation, value = (channel.astype(int) for channel in cv2.split(cv2.cvtColor(smooth, cv2.COLOR_RGB2HSV)))
    colour = saturation * value // 255
    vivid = (saturation >= MIN_SATURATION) & (colour >= MIN_COLOUR)

    def blob(wanted: int) -> Image:
        distance = np.abs((hue - wanted + 90) % 180 - 90)  # hue is an angle
        mask = vivid & (distance <= HUE_TOLERANCE)
        strongest = np.sort(colour[mask])[-2 * MIN_PIXELS :]  # several pixels, lest a single wrong one decide
        return _largest(mask & (colour >= SHARE * strongest[0]) if mask.any() else mask)

    return blob(RED_HUE), blob(BLUE_HUE)


def observe(frames: Sequence[Image], composite: Composite) -> Any:
    """Make the environment's observation of frames with noise.

    A policy has learnt from images without noise; without the median filter a little of it leads the policy astray.

    Args:
        frames: RGB, of the size that the environment's cameras have.
        composite: The environment's.
    """
    return composite([np.asarray(cv2.medianBlur(frame, DENOISING), np.uint8) for frame in frames], marker_masks)


def white_balanced(image: Image) -> Image:
    """Scale the channels so that the brightest part of the image is white; an image with white in it stays the same.

    What colour the light has and how strong it is then no longer matters, as long as something in view is white.
    """
    white = np.percentile(image.reshape(-1, 3), 100 * (1 - WHITE_SHARE), axis=0)
    if (white == 255).all():
        return image
    gains = (255 / np.maximum(white, 1)).astype(np.float32)
    return np.asarray(np.clip(np.rint(image * gains), 0, 255), np.uint8)


def _largest(mask: Mask) -> Image:
    """The largest connected blob alone, 255 there, else 0; nothing if it is too small."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    biggest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])) if count > 1 else 0
    enough = biggest > 0 and stats[biggest, cv2.CC_STAT_AREA] >= MIN_PIXELS
    return np.where(enough & (labels == biggest), 255, 0).astype(np.uint8)


def _centroid(mask: Image) -> NDArray[np.float64]:
    """Mean pixel (x, y), shape (2,), nan if there is none."""
    rows, columns = np.nonzero(mask)
    return np.array([columns.mean(), rows.mean()]) if len(rows) else np.full(2, np.nan)
