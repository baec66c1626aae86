"""Red and blue blobs in a frame: the markers of the end effector and the target (section 3.3)."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Frame = NDArray[np.uint8]
Centroid = NDArray[np.float64]

BRIGHT = 128  # a marker's own channel is at least this, however it is lit
DIM = 70  # and its other two are at most this; every grey misses one of the two
MIN_PIXELS = 4  # fewer are no blob: an occluded marker's rim gives a useless centroid


class Blobs(NamedTuple):
    """Centroids (x, y) in [px], shape (2,), nan where the marker is hidden."""

    end_effector: Centroid
    target: Centroid

    @property
    def offset(self) -> Centroid:
        """From target to end effector in [px], shape (2,), nan when either is hidden; its length is d of Eq. 2."""
        return self.end_effector - self.target


def find_blobs(frame: Frame) -> Blobs:
    """Find the red (end effector) and the blue (target) blob.

    Args:
        frame: RGB or RGBA image, shape (height, width, 3 or 4), uint8.
    """
    red, green, blue = cv2.split(frame)[:3]
    dim_green = green <= DIM
    return Blobs(
        end_effector=_centroid((red >= BRIGHT) & dim_green & (blue <= DIM)),
        target=_centroid((blue >= BRIGHT) & dim_green & (red <= DIM)),
    )


def _centroid(mask: NDArray[np.bool_]) -> Centroid:
    """Mean pixel of `mask`, shape (2,), from moments inside its bounding box only: the mask is nearly empty."""
    pixels = mask.view(np.uint8)
    x, y, width, height = cv2.boundingRect(pixels)
    moments = cv2.moments(np.ascontiguousarray(pixels[y : y + height, x : x + width]), binaryImage=True)
    if moments["m00"] < MIN_PIXELS:
        return np.full(2, np.nan)
    return np.array([x + moments["m10"] / moments["m00"], y + moments["m01"] / moments["m00"]])
