"""Ordinary images in place of rendered frames: files, folders and cameras."""

from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sb3_stereo.errors import ConfigError

Image = NDArray[np.uint8]  # RGB, (height, width, 3)

SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")


class Source(NamedTuple):
    """One view: its images with their names, and how many there are (None for a camera, which has no end)."""

    images: Iterator[tuple[str, Image]]
    length: int | None


def open_source(name: str) -> Source:
    """Open an image file, a folder of images (in the order of their names) or a camera by its index.

    Raises:
        ConfigError: If there is no such file, folder or camera, or nothing in it.
    """
    path = Path(name)
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES)
        if not files:
            raise ConfigError(f"no images in '{path}'; their names must end in {', '.join(SUFFIXES)}")
        return Source(((str(file), read_image(file)) for file in files), len(files))
    if path.is_file():
        return Source(iter([(name, read_image(path))]), 1)
    if not name.isdecimal():
        raise ConfigError(f"no image or folder '{name}'; give a file, a folder or a camera's index such as 0")
    camera = cv2.VideoCapture(int(name))
    if not camera.isOpened():
        raise ConfigError(f"camera {name} cannot be opened; give the index of one that is connected and not in use")
    return Source(_camera_images(name, camera), None)


def _camera_images(name: str, camera: cv2.VideoCapture) -> Iterator[tuple[str, Image]]:
    for number in count(1):
        ok, image = camera.read()
        if not ok:
            raise ConfigError(f"camera {name} gives no images any more; check its cable")
        yield f"camera {name}, image {number}", np.asarray(image[:, :, ::-1], np.uint8)


def read_image(file: Path) -> Image:
    """Read an image file as RGB.

    Raises:
        ConfigError: If it is no image.
    """
    image = cv2.imread(str(file), cv2.IMREAD_COLOR)
    if image is None:
        raise ConfigError(f"'{file}' is not an image that OpenCV reads")
    return np.ascontiguousarray(image[:, :, ::-1], np.uint8)


def image_sets(names: Sequence[str]) -> Iterator[tuple[tuple[str, Image], ...]]:
    """Yield what all views see at a time, in their order, as (name, image) each.

    Raises:
        ConfigError: If a source cannot be opened, or folders have different numbers of images.
    """
    sources = [open_source(name) for name in names]
    lengths = {source.length for source in sources if source.length is not None}
    if len(lengths) > 1:
        found = ", ".join(f"{source.length} in '{name}'" for name, source in zip(names, sources, strict=True))
        raise ConfigError(f"the views have different numbers of images: {found}; give one per view and moment")
    return zip(*(source.images for source in sources))


def fit(image: Image, width: int, height: int) -> Image:
    """Cut the middle of an image to the shape of a frame and scale it to its size; one of that size stays the same."""
    scale = min(image.shape[1] / width, image.shape[0] / height)
    size = round(height * scale), round(width * scale)
    top, left = ((have - want) // 2 for have, want in zip(image.shape, size))
    middle = image[top : top + size[0], left : left + size[1]]
    return np.asarray(cv2.resize(middle, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
