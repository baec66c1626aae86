"""Images as another world would show them: what an encoder must not mistake for a motion of the arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Images = NDArray[np.uint8]
Views = NDArray[np.float32]

BRIGHT = 250  # of 255: what is at least so bright is background, which Bullet leaves white
GREYS = (0.0, 255.0)  # of a background
MAX_CONTRAST = 80.0  # standard deviation within one
N_CELLS = ((2, 3), (4, 6), (8, 12))  # rows and columns of the random grids that are enlarged to a background
WHOLE = ("begin", "end", "shift", "patches")
PATCH_SIDES = (3, 18)  # [px]
N_NORMALS = 1_000_003  # a prime, so that no window of it repeats with an image's rows


@cache
def _normals() -> Views:
    return np.random.default_rng(0).standard_normal(N_NORMALS, np.float32)


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
    """Random changes of images that leave the markers' offsets as they are.

    Each image is changed by itself. A view is a camera: light and background are drawn for each.

    Attributes:
        share: Of the images that are changed at all, in the end.
        begin: Environment steps before any is changed: a clean world is learnt sooner.
        end: Environment steps from which `share` of them are; in between their number grows evenly. 0: at once.
        background: Share of the views whose white background becomes a random smooth field, or a grey.
        gain: Lowest and highest factor of a view's luminance.
        offset: Standard deviation of what is added to a view's luminance, of 255.
        noise: Largest standard deviation of a pixel's noise, of 255.
        shift: Largest shift of all views alike, along rows and columns, in [px].
        patches: Largest number of grey patches per view, which hide what is there.
        probability: Share of the images that each of gain and offset, noise, and shift changes.
    """

    share: float = 0.7
    begin: int = 0
    end: int = 0
    background: float = 0.6
    gain: tuple[float, float] = (0.6, 1.2)
    offset: float = 10.0
    noise: float = 15.0
    shift: int = 3
    patches: int = 2
    probability: float = 0.7

    def __post_init__(self) -> None:
        for name in ("share", "background", "probability"):
            _require(0.0 <= getattr(self, name) <= 1.0, name, getattr(self, name), "a number from 0 to 1")
        for name in ("begin", "end", "offset", "noise", "shift", "patches"):
            _require(getattr(self, name) >= 0, name, getattr(self, name), "a number that is not negative")
        ordered = len(self.gain) == 2 and 0.0 < self.gain[0] <= self.gain[1]
        _require(not self.end or self.begin <= self.end, "end", self.end, f"at least begin, {self.begin}")
        _require(ordered, "gain", list(self.gain), "the lowest and the highest factor, both positive")

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> ImageAugmentation:
        """Return the augmentation that a map from YAML describes.

        Raises:
            ValueError: If a key is unknown or a value impossible.
        """
        known = {field.name: field.type for field in fields(cls)}
        for name, value in values.items():
            if name not in known:
                raise ValueError(f"unknown setting {name!r} of augmentation; choices are {', '.join(known)}")
            numbers = value if name == "gain" and isinstance(value, list | tuple) else [value]
            plain = all(isinstance(n, int | float) and not isinstance(n, bool) for n in numbers)
            whole = name not in WHOLE or float(numbers[0]).is_integer() if plain else False
            _require(whole, name, value, "an integer" if name in WHOLE else "a number")
        given: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
        return cls(**given)

    def share_at(self, timesteps: int) -> float:
        """Share of the images that are changed after so many environment steps."""
        if self.end <= self.begin:
            return self.share * (timesteps >= self.begin)
        return self.share * min(max((timesteps - self.begin) / (self.end - self.begin), 0.0), 1.0)

    def change_some(self, images: Images, share: float, layout: Layout, rng: np.random.Generator) -> Images:
        """Change a share of the images, and leave the others.

        Args:
            images: Shape (n, channels, height, width), uint8.
            share: 0 to 1.
            layout: What the images hold.
            rng: What all draws come from.

        Returns:
            New images of the same shape, uint8.
        """
        chosen = rng.random(len(images)) < share
        changed: Images = images.copy()
        if chosen.any():
            changed[chosen] = self.change(images[chosen], layout, rng)
        return changed

    def change(self, images: Images, layout: Layout, rng: np.random.Generator) -> Images:
        """Change every image; arguments as in `change_some`."""
        n, _, rows, width = images.shape
        height = rows if layout.views_in_channels else rows // layout.n_views
        split = (n, -1, layout.n_views, height, width)
        views = images.reshape(split).astype(np.float32).transpose(0, 2, 1, 3, 4)  # (n, n_views, channels, h, w)
        luminance = views[:, :, ::2] if layout.marker_map else views
        self._replace_backgrounds(luminance, rng)
        self._cover(luminance, rng)
        self._relight(luminance, rng)
        self._shift(views, rng)
        self._add_noise(luminance, rng)
        changed = np.clip(views, 0, 255, out=views).astype(np.uint8).transpose(0, 2, 1, 3, 4)
        return np.asarray(changed.reshape(images.shape), np.uint8)

    def _replace_backgrounds(self, views: Views, rng: np.random.Generator) -> None:
        """Put a random smooth field, or a grey, where a view is white."""
        n, n_views, _, height, width = views.shape
        for image, view in np.argwhere(rng.random((n, n_views)) < self.background):
            cells = N_CELLS[rng.integers(len(N_CELLS))]
            coarse = rng.uniform(*GREYS) + rng.uniform(0, MAX_CONTRAST) * rng.standard_normal(cells)
            field = cv2.resize(coarse.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
            picture = views[image, view]
            np.copyto(picture, np.clip(field, *GREYS)[None], where=picture >= BRIGHT)

    def _cover(self, views: Views, rng: np.random.Generator) -> None:
        """Lay grey patches over the views."""
        n, n_views, _, height, width = views.shape
        low, high = PATCH_SIDES
        counts = rng.integers(0, self.patches + 1, (n, n_views))
        for image, view in np.argwhere(counts):
            for _ in range(counts[image, view]):
                tall, wide = rng.integers(low, high + 1, 2)
                top, left = rng.integers(-low, height), rng.integers(-low, width)
                views[image, view, :, max(top, 0) : top + tall, max(left, 0) : left + wide] = rng.uniform(*GREYS)

    def _relight(self, views: Views, rng: np.random.Generator) -> None:
        """Scale and shift the luminance of some."""
        shape = (*views.shape[:2], 1, 1, 1)
        some = rng.random((len(views), 1, 1, 1, 1)) < self.probability
        views *= np.where(some, rng.uniform(*self.gain, shape), 1.0).astype(np.float32)
        views += np.where(some, self.offset * rng.standard_normal(shape), 0.0).astype(np.float32)

    def _shift(self, views: Views, rng: np.random.Generator) -> None:
        """Move some images, all views alike; the edge repeats."""
        n, _, _, height, width = views.shape
        steps = rng.integers(-self.shift, self.shift + 1, (n, 2))
        rows, columns = np.arange(height), np.arange(width)
        for image in np.flatnonzero((rng.random(n) < self.probability) & steps.any(axis=1)):
            down, right = steps[image]
            moved_rows = np.clip(rows + down, 0, height - 1)
            moved_columns = np.clip(columns + right, 0, width - 1)
            views[image] = views[image][:, :, moved_rows][..., moved_columns]

    def _add_noise(self, views: Views, rng: np.random.Generator) -> None:
        """Add noise, of a strength of its own, to some."""
        size = views[0].size
        for image in np.flatnonzero(rng.random(len(views)) < self.probability):
            start = rng.integers(N_NORMALS)  # a window of ready-made noise: to draw it would take half of the time
            noise = np.take(_normals(), np.arange(start, start + size), mode="wrap").reshape(views[image].shape)
            views[image] += np.float32(rng.uniform(0, self.noise)) * noise


def _require(condition: bool, name: str, value: object, wanted: str) -> None:
    if not condition:
        raise ValueError(f"augmentation: {name} is {value!r}; give {wanted}")
