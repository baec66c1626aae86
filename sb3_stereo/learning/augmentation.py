"""Transitions as another world would show them: what an encoder must not mistake for a motion of the arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Images = NDArray[np.uint8]
Floats = NDArray[np.float32]

WHITE = 250  # of 255: what is at least so bright is background, which Bullet leaves white
DARK = 80  # of 255: what is darker is a marker
GREYS = (0.0, 255.0)
MAX_CONTRAST = 80.0  # standard deviation within a background
N_CELLS = ((2, 3), (4, 6), (8, 12))  # rows and columns of the random grids that are enlarged to a background
MAX_THINGS = 4  # with edges, in a background
N_BACKGROUNDS = 512  # ready-made: each is shifted and turned over at random, and relit with the view
PATCH_SIDES = (3, 18)  # [px]
N_NORMALS = 1_000_003  # a prime, so that no window of it repeats with an image's rows
WHOLE = ("begin", "end", "shift", "patches")
PAIRS = ("gain",)


@dataclass(frozen=True)
class Layout:
    """What an image holds.

    Attributes:
        n_views: Views.
        views_in_channels: Each view is a channel, and not a part of the rows.
        marker_map: Every second channel shows where the markers are, and not luminance.
    """

    n_views: int = 2
    views_in_channels: bool = False
    marker_map: bool = False


@dataclass(frozen=True)
class ImageAugmentation:
    """Random changes of the images of transitions, after which their labels are still right.

    A view is a camera: what is changed is drawn for each by itself. Both images of a transition are changed alike by
    `zoom`, and each by itself by the rest.

    Attributes:
        share: Of the transitions that are changed at all, in the end.
        begin: Environment steps before any is changed: a clean world is learnt sooner.
        end: Environment steps from which `share` of them are; in between their number grows evenly. 0: at once.
        background: Share of the views whose white background becomes another: a grey or a smooth random field,
            perhaps with a floor and with things that have edges.
        tone: How far the luminance of the links goes towards a random grey at most, 0 to 1.
        gain: Lowest and highest factor of a view's luminance.
        offset: Standard deviation of what is added to a view's luminance, of 255.
        noise: Largest standard deviation of a pixel's noise, of 255.
        shift: Largest shift of a view, along rows and columns, in [px].
        zoom: Largest relative change of a view's scale, by which its offsets change as well.
        patches: Largest number of grey patches per view, which hide what is there.
        probability: Share of the changed views or images that each of tone, gain and offset, noise, and shift affects.
    """

    share: float = 0.7
    begin: int = 0
    end: int = 0
    background: float = 0.6
    tone: float = 0.6
    gain: tuple[float, float] = (0.5, 1.4)
    offset: float = 10.0
    noise: float = 15.0
    shift: int = 3
    zoom: float = 0.1
    patches: int = 2
    probability: float = 0.7

    def __post_init__(self) -> None:
        for name in ("share", "background", "tone", "zoom", "probability"):
            _require(0.0 <= getattr(self, name) <= 1.0, name, getattr(self, name), "a number from 0 to 1")
        for name in ("begin", "end", "offset", "noise", "shift", "patches"):
            _require(getattr(self, name) >= 0, name, getattr(self, name), "a number that is not negative")
        ordered = len(self.gain) == 2 and 0.0 < self.gain[0] <= self.gain[1]
        _require(ordered, "gain", list(self.gain), "the lowest and the highest factor, both positive")
        _require(not self.end or self.begin <= self.end, "end", self.end, f"at least begin, {self.begin}")

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> ImageAugmentation:
        """Return the augmentation that a map from YAML describes.

        Raises:
            ValueError: If a key is unknown or a value impossible.
        """
        known = [field.name for field in fields(cls)]
        for name, value in values.items():
            if name not in known:
                raise ValueError(f"unknown setting {name!r} of augmentation; choices are {', '.join(known)}")
            numbers = list(value) if name in PAIRS and isinstance(value, list | tuple) else [value]
            plain = all(isinstance(n, int | float) and not isinstance(n, bool) for n in numbers)
            fitting = plain and (name not in WHOLE or float(numbers[0]).is_integer())
            _require(fitting, name, value, "an integer" if name in WHOLE else "a number")
        given: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
        return cls(**given)

    def share_at(self, timesteps: int) -> float:
        """Share of the transitions that are changed after so many environment steps."""
        if self.end <= self.begin:
            return self.share * (timesteps >= self.begin)
        return self.share * min(max((timesteps - self.begin) / (self.end - self.begin), 0.0), 1.0)

    def change_some(
        self, images: Images, offsets: Floats, share: float, layout: Layout, rng: np.random.Generator
    ) -> tuple[Images, Floats]:
        """Change a share of the transitions, and leave the others.

        Args:
            images: Both of every transition, shape (2, n, channels, height, width), uint8.
            offsets: The markers' in the second ones, shape (n, n_views, 2), in [px].
            share: 0 to 1.
            layout: What the images hold.
            rng: What all draws come from.

        Returns:
            New images and offsets of the same shapes.
        """
        chosen = np.asarray(rng.random(images.shape[1]) < share)
        images, offsets = images.copy(), offsets.copy()
        if chosen.any():
            images[:, chosen], offsets[chosen] = self.change(images[:, chosen], offsets[chosen], layout, rng)
        return images, offsets

    def change(
        self, images: Images, offsets: Floats, layout: Layout, rng: np.random.Generator
    ) -> tuple[Images, Floats]:
        """Change every transition; arguments as in `change_some`."""
        _, n, _, rows, width = images.shape
        height = rows if layout.views_in_channels else rows // layout.n_views
        split = (2 * n, -1, layout.n_views, height, width)
        views = images.reshape(split).astype(np.float32).transpose(0, 2, 1, 3, 4)  # (2 * n, n_views, channels, h, w)
        luminance = views[:, :, ::2] if layout.marker_map else views
        lost = ~luminance.any(axis=(2, 3, 4), keepdims=True)  # a camera that is black shows no noise either
        zooms = rng.uniform(1 - self.zoom, 1 + self.zoom, (n, layout.n_views))
        self._change_tone_and_background(luminance, rng)
        self._warp(views, np.concatenate([zooms, zooms]), rng)
        self._cover(luminance, rng)
        self._relight(luminance, rng)
        self._add_noise(luminance, rng)
        np.copyto(luminance, 0.0, where=lost)
        changed = np.clip(views, 0, 255, out=views).astype(np.uint8).transpose(0, 2, 1, 3, 4)
        return np.asarray(changed.reshape(images.shape), np.uint8), offsets * zooms[:, :, None].astype(np.float32)

    def _change_tone_and_background(self, views: Floats, rng: np.random.Generator) -> None:
        """Mix the links with a grey, and put another background where a view is white."""
        n, n_views = views.shape[:2]
        with_background = rng.random((n, n_views)) < self.background
        with_tone = rng.random((n, n_views)) < (self.probability if self.tone else 0.0)
        for image, view in np.argwhere(with_background | with_tone):
            picture = views[image, view]
            white = picture >= WHITE
            if with_tone[image, view]:
                share = rng.uniform(0, self.tone)
                toned = (1 - share) * picture + share * rng.uniform(*GREYS)
                np.copyto(picture, np.minimum(toned, WHITE - 1), where=(picture > DARK) & ~white)
            if with_background[image, view]:
                np.copyto(picture, _background(picture.shape[1:], rng)[None], where=white)

    def _warp(self, views: Floats, zooms: NDArray[np.float64], rng: np.random.Generator) -> None:
        """Scale every view about its middle, and shift some; the edge repeats."""
        n, n_views, channels, height, width = views.shape
        shifts = rng.integers(-self.shift, self.shift + 1, (n, n_views, 2))
        shifts[rng.random((n, n_views)) >= self.probability] = 0
        middle = (width - 1) / 2, (height - 1) / 2
        for image, view in np.argwhere(shifts.any(axis=2) | (zooms != 1.0)):
            zoom, (right, down) = zooms[image, view], shifts[image, view]
            matrix = np.array(
                [[zoom, 0, (1 - zoom) * middle[0] + right], [0, zoom, (1 - zoom) * middle[1] + down]], np.float64
            )
            for channel in range(channels):
                picture = np.ascontiguousarray(views[image, view, channel])
                warped = cv2.warpAffine(picture, matrix, (width, height), borderMode=cv2.BORDER_REPLICATE)
                views[image, view, channel] = warped

    def _cover(self, views: Floats, rng: np.random.Generator) -> None:
        """Lay grey patches over the views."""
        n, n_views, _, height, width = views.shape
        low, high = PATCH_SIDES
        counts = rng.integers(0, self.patches + 1, (n, n_views))
        for image, view in np.argwhere(counts):
            for _ in range(counts[image, view]):
                tall, wide = rng.integers(low, high + 1, 2)
                top, left = rng.integers(-low, height), rng.integers(-low, width)
                views[image, view, :, max(top, 0) : top + tall, max(left, 0) : left + wide] = rng.uniform(*GREYS)

    def _relight(self, views: Floats, rng: np.random.Generator) -> None:
        """Scale and shift the luminance of some."""
        shape = (*views.shape[:2], 1, 1, 1)
        some = rng.random(shape) < self.probability
        views *= np.where(some, rng.uniform(*self.gain, shape), 1.0).astype(np.float32)
        views += np.where(some, self.offset * rng.standard_normal(shape), 0.0).astype(np.float32)

    def _add_noise(self, views: Floats, rng: np.random.Generator) -> None:
        """Add noise, of a strength of its own, to some images."""
        size = views[0].size
        for image in np.flatnonzero(rng.random(len(views)) < self.probability):
            start = rng.integers(N_NORMALS)  # a window of ready-made noise: to draw it would take half of the time
            noise = np.take(_normals(), np.arange(start, start + size), mode="wrap").reshape(views[image].shape)
            views[image] += np.float32(rng.uniform(0, self.noise)) * noise


@cache
def _normals() -> Floats:
    return np.random.default_rng(0).standard_normal(N_NORMALS, np.float32)


def _background(size: tuple[int, int], rng: np.random.Generator) -> Floats:
    """A random background, (height, width)."""
    picture = _backgrounds(size)[rng.integers(N_BACKGROUNDS)]
    picture = picture[:, ::-1] if rng.random() < 0.5 else picture
    return np.roll(picture, rng.integers(size[1]), axis=1)


@cache
def _backgrounds(size: tuple[int, int]) -> Floats:
    """Ready-made backgrounds, (N_BACKGROUNDS, height, width)."""
    rng = np.random.default_rng(0)
    return np.stack([_draw_background(size, rng) for _ in range(N_BACKGROUNDS)])


def _draw_background(size: tuple[int, int], rng: np.random.Generator) -> Floats:
    """A field, perhaps another one below it as a floor is, and things with edges."""
    height, width = size
    picture = _field(size, rng)
    if rng.random() < 0.5:
        horizon = rng.integers(height // 4, height)
        picture[horizon:] = _field(size, rng)[horizon:]
    for _ in range(rng.integers(0, MAX_THINGS + 1)):
        middle, extent = rng.uniform((0, 0), (width, height)), rng.uniform(2, width / 3, 2)
        box = tuple(middle.tolist()), tuple(extent.tolist()), float(rng.uniform(0, 90))
        cv2.fillPoly(picture, [cv2.boxPoints(box).astype(np.int32)], rng.uniform(*GREYS))
    return np.clip(picture, *GREYS)


def _field(size: tuple[int, int], rng: np.random.Generator) -> Floats:
    """A smooth random field around a grey, of any contrast down to none."""
    cells = N_CELLS[rng.integers(len(N_CELLS))]
    coarse = rng.uniform(*GREYS) + rng.uniform(0, MAX_CONTRAST) * rng.standard_normal(cells)
    return np.asarray(cv2.resize(coarse.astype(np.float32), size[::-1], interpolation=cv2.INTER_CUBIC), np.float32)


def _require(condition: bool, name: str, value: object, wanted: str) -> None:
    if not condition:
        raise ValueError(f"augmentation: {name} is {value!r}; give {wanted}")
