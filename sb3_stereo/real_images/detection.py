"""Marker detection in ordinary images, under changing light and among people, and the observation made from them.

The simulated environment keeps its own exact thresholds (`envs/markers.py`): its rewards depend on them.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.composite import Composite
from sb3_stereo.envs.markers import MIN_PIXELS, Blobs

Image = NDArray[np.uint8]  # RGB, (height, width, 3)
Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]

RED, BLUE = 0, 2  # channels
HUE_TOLERANCE = 18  # OpenCV's half degrees; noise and JPEG move a pixel's hue, its neighbours keep the blob together
MIN_LEAD = 40  # of 255, of a marker's own channel over the next strongest one: a smaller lead is mostly noise
MIN_PURITY = 0.35  # lead / own channel: most skin has less, a marker 0.4 to 1
CORE = 0.5  # of the blob's strongest lead: a marker's shaded side has more, a reflection or skin at its rim less
TYPICAL_PIXELS = (10, 1000)  # a marker covers 4 to 120 in a rendered frame; clothes cover more
MIN_SCORE = 0.31  # of a marker that is certain; `benchmarks.analysis.detection` counts what that costs
CLOSE = 0.6  # of the best score: two candidates closer than that are not told apart
DENOISING = 5  # [px], of the median filter before the composite; rendered frames hardly change by it
WHITE_SHARE = 0.02  # of the pixels are at least as bright as what counts as white
MAX_TINT = 1.8  # between the gains of two channels: more is not the light, but a surface such as dark wood


class Candidate(NamedTuple):
    """A blob that may be a marker."""

    mask: Mask  # (height, width)
    centroid: Floats  # (x, y) in [px], shape (2,)
    radius: float  # [px], of the enclosing circle
    score: float  # 0 to 1, how vivid, round and plausible in size it is


class Detection(NamedTuple):
    """Both markers in one image; each is found, hidden (no candidates) or undecided (candidates, but no centroid)."""

    markers: Blobs  # centroids, nan where hidden or undecided
    masks: tuple[Image, Image]  # where red and where blue: 255 there, else 0, (height, width), uint8
    undecided: tuple[list[Floats], list[Floats]]  # centroids of the one or two best candidates; empty where certain


def detect(image: Image) -> Detection:
    """Find the red (end effector) and the blue (target) marker.

    Of all blobs in a marker's hue the most vivid and roundest is the marker. If another one elsewhere is nearly as
    good, or even the best is a poor one, the marker is undecided.

    Args:
        image: RGB, any size.
    """
    balanced = image.astype(np.float32) * _gains(
        image
    )  # not cut at 255, which would change the hue of what is brighter
    smooth = np.asarray(cv2.medianBlur(balanced, 3), np.float32)
    red, blue = (_decide(_candidates(smooth, channel)) for channel in (RED, BLUE))
    nowhere = np.zeros(image.shape[:2], bool)
    masks = [np.where(best.mask if best else nowhere, 255, 0).astype(np.uint8) for best, _ in (red, blue)]
    centroids = [best.centroid if best else np.full(2, np.nan) for best, _ in (red, blue)]
    return Detection(Blobs(*centroids), (masks[0], masks[1]), (red[1], blue[1]))


def find_markers(image: Image) -> Blobs:
    """Centroids of both markers in the pixels of an RGB image, nan where a marker is hidden or undecided."""
    return detect(image).markers


def marker_masks(image: Image) -> tuple[Image, Image]:
    """Where the red and where the blue marker is in an RGB image: 255 there, else 0, (height, width) each, uint8."""
    return detect(image).masks


def _decide(candidates: Sequence[Candidate]) -> tuple[Candidate | None, list[Floats]]:
    """The marker, or none and the centroids between which the choice is open."""
    ranked = sorted(candidates, key=lambda candidate: candidate.score, reverse=True)
    if not ranked:
        return None, []
    best = ranked[0]
    rivals = [other for other in ranked[1:] if other.score > CLOSE * best.score and not _same_place(best, other)]
    if not rivals and best.score >= MIN_SCORE:
        return best, []
    return None, [candidate.centroid for candidate in (best, *rivals[:1])]


def _same_place(one: Candidate, other: Candidate) -> bool:
    """Whether two blobs may be parts of one marker, with something in front of its middle."""
    return bool(np.hypot(*(one.centroid - other.centroid)) <= one.radius + other.radius)


def _candidates(image: NDArray[np.float32], channel: int) -> list[Candidate]:
    """All blobs in which a channel, `RED` or `BLUE`, is well above the other two."""
    own, others = image[:, :, channel], image[:, :, [other for other in range(3) if other != channel]].max(axis=2)
    lead = own - others
    purity = lead / np.maximum(own, 1)
    hue = cv2.cvtColor(image, cv2.COLOR_RGB2HSV)[:, :, 0] / 2
    distance = np.abs((hue - 60 * channel + 90) % 180 - 90)  # hue is an angle: red is 0, blue 120
    coloured = (lead >= MIN_LEAD) & (purity >= MIN_PURITY) & (distance <= HUE_TOLERANCE)

    count, labels, stats, _ = cv2.connectedComponentsWithStats(_core(coloured, lead).astype(np.uint8))
    found = []
    for label in range(1, count):
        left, top, width, height, area = stats[label]
        if area < MIN_PIXELS:
            continue
        box = slice(top, top + height), slice(left, left + width)
        inside = labels[box] == label
        vividness = np.sqrt(min(1.0, np.median(lead[box][inside]) / 255) * np.median(purity[box][inside]))
        points = np.argwhere(inside)[:, ::-1].astype(np.int32)  # (area, 2), (x, y)
        radius = cv2.minEnclosingCircle(points)[1] + 0.5  # pixels reach half of one beyond their centres
        roundness = min(1.0, area / (np.pi * radius**2))
        plausible = min(1.0, area / TYPICAL_PIXELS[0], TYPICAL_PIXELS[1] / area)
        score = float(vividness * np.sqrt(roundness * plausible))
        found.append(Candidate(labels == label, points.mean(axis=0) + np.array([left, top]), radius, score))
    return found


def _core(coloured: Mask, lead: NDArray[np.float32]) -> Mask:
    """Of each connected part the pixels with at least `CORE` of the strongest lead in that part."""
    count, labels = cv2.connectedComponents(coloured.astype(np.uint8))
    order = np.lexsort((lead.ravel(), labels.ravel()))
    ends = np.cumsum(np.bincount(labels.ravel(), minlength=count))
    starts = np.concatenate([[0], ends[:-1]])
    # Several pixels, lest a single wrong one decide.
    strongest = lead.ravel()[order][np.maximum(ends - 2 * MIN_PIXELS, starts)]
    return np.asarray(coloured & (lead >= CORE * strongest[labels]), np.bool_)


def observe(frames: Sequence[Image], composite: Composite) -> Any:
    """Make the environment's observation of camera images.

    A policy has learnt from images without noise; without the median filter a little of it leads the policy astray.

    Args:
        frames: RGB, of the size that the environment's cameras have.
        composite: The environment's.
    """
    denoised = [np.asarray(cv2.medianBlur(white_balanced(frame), DENOISING), np.uint8) for frame in frames]
    masks = map(marker_masks, frames)  # in the order in which the composite asks for them, if it does
    return composite(denoised, lambda _: next(masks))


def white_balanced(image: Image) -> Image:
    """Scale the channels so that the brightest part of the image is white; an image with white in it stays the same.

    What colour the light has and how strong it is then no longer matters, as long as something in view is white.
    """
    return np.asarray(np.clip(np.rint(image * _gains(image)), 0, 255), np.uint8)


def _gains(image: Image) -> NDArray[np.float32]:
    """Factors of the channels that make the brightest part of an image white, shape (3,)."""
    white = np.percentile(image.reshape(-1, 3), 100 * (1 - WHITE_SHARE), axis=0)
    gains = 255 / np.maximum(white, 1)
    return np.asarray(np.minimum(gains, MAX_TINT * gains.min()), np.float32)
