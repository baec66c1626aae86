"""Red and blue blobs in a frame: the markers of the end effector and the target (section 3.3)."""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Frame = NDArray[np.uint8]
Centroid = NDArray[np.float64]

BRIGHT = 128  # a marker's own channel is at least this, however it is lit
DIM = 70  # and its other two are at most this; every grey misses one of the two
MIN_PIXELS = 4  # fewer are no blob: an occluded marker's rim gives a useless centroid

# The highest bit of green in an RGBA pixel read as one number: 0 wherever green is dim, seldom elsewhere.
GREEN_BIT = np.array([0, 128, 0, 0], np.uint8).view(np.uint32)[0]


class Blobs(NamedTuple):
    """Centroids (x, y) in [px], shape (2,), nan where the marker is hidden."""

    end_effector: Centroid
    target: Centroid

    @property
    def offset(self) -> Centroid:
        """From target to end effector in [px], shape (2,), nan when either is hidden; its length is d of Eq. 2."""
        return self.end_effector - self.target


def no_blob() -> Centroid:
    """Where a marker is that is hidden: nan, shape (2,)."""
    return np.full(2, np.nan)


def find_blobs(frame: Frame) -> Blobs:
    """Find the red (end effector) and the blue (target) blob.

    Args:
        frame: RGB or RGBA image, shape (height, width, 3 or 4), uint8.
    """
    top, left, masks = crop_masks(frame)
    return Blobs(*(_centroid(mask, left, top) for mask in masks))


def blob_centroids(red: Frame, blue: Frame) -> Blobs:
    """The centroids of two blobs, each 255 where it is and else 0, (height, width), uint8."""
    return Blobs(_centroid(red, 0, 0), _centroid(blue, 0, 0))


def marker_masks(frame: Frame) -> tuple[Frame, Frame]:
    """Where a frame is red (end effector) and where blue (target): 255 there, else 0, (height, width) each, uint8.

    Args:
        frame: RGB or RGBA image, shape (height, width, 3 or 4), uint8.
    """
    top, left, masks = crop_masks(frame)
    whole = np.zeros((2, *frame.shape[:2]), np.uint8)
    height, width = masks[0].shape
    whole[:, top : top + height, left : left + width] = masks
    return whole[0], whole[1]


def crop_masks(frame: Frame) -> tuple[int, int, tuple[Frame, Frame]]:
    """Top and left of a part of the frame that holds both markers, and where it is red and where blue."""
    rgba = frame if frame.shape[2] == 4 else np.asarray(cv2.cvtColor(frame, cv2.COLOR_RGB2RGBA), np.uint8)
    top, left, part = _where_green_may_be_dim(rgba)
    red = cv2.inRange(part, (BRIGHT, 0, 0, 0), (255, DIM, DIM, 255))
    blue = cv2.inRange(part, (0, 0, BRIGHT, 0), (DIM, DIM, 255, 255))
    return top, left, (np.asarray(red, np.uint8), np.asarray(blue, np.uint8))


def _where_green_may_be_dim(frame: Frame) -> tuple[int, int, Frame]:
    """Top, left and content of the part of an RGBA image outside of which every green is bright.

    One pass over the whole image finds it; all others then see a small part of the pixels.
    """
    pixels = np.ascontiguousarray(frame).view(np.uint32)[:, :, 0]
    rows = np.flatnonzero(~np.bitwise_and.reduce(pixels, axis=1) & GREEN_BIT)
    if not rows.size:
        return 0, 0, frame[:1, :1]
    top, bottom = rows[0], rows[-1] + 1
    columns = np.flatnonzero(~np.bitwise_and.reduce(pixels[top:bottom], axis=0) & GREEN_BIT)
    left, right = columns[0], columns[-1] + 1
    return int(top), int(left), frame[top:bottom, left:right]


def _centroid(mask: NDArray[Any], left: int, top: int) -> Centroid:
    """Mean pixel of `mask`, shape (2,), from moments inside its bounding box only: the mask is nearly empty."""
    x, y, width, height = cv2.boundingRect(mask)
    moments = cv2.moments(np.ascontiguousarray(mask[y : y + height, x : x + width]), binaryImage=True)
    if moments["m00"] < MIN_PIXELS:
        return no_blob()
    return np.array([left + x + moments["m10"] / moments["m00"], top + y + moments["m01"] / moments["m00"]])
