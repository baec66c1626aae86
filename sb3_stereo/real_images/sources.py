"""Ordinary images in place of rendered frames: files, folders and cameras."""

import warnings
from collections.abc import Iterator, Sequence
from io import BytesIO
from itertools import count
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import PIL.Image
from numpy.typing import NDArray
from PIL.Image import DecompressionBombError, DecompressionBombWarning

from sb3_stereo.errors import ConfigError

Image = NDArray[np.uint8]  # RGB, (height, width, 3)

SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")
MAX_BYTES = 500_000_000  # of an image file; an uncompressed one with as many pixels as Pillow accepts has 270 MB


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
    try:
        files = _files(path)
    except OSError as error:
        raise ConfigError(f"'{name}' cannot be read: {error.strerror or error}") from error
    if files is not None:
        return Source(((str(file), read_image(file)) for file in files), len(files))
    if not name.isdecimal():
        raise ConfigError(f"no image or folder '{name}'; give a file, a folder or a camera's index such as 0")
    return Source(_camera_images(name, _open_camera(name)), None)


def _files(path: Path) -> list[Path] | None:
    """The images that a path stands for, None if it does not exist."""
    if not path.is_dir():
        return [path] if path.exists() else None
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES)
    if not files:
        raise ConfigError(f"no images in '{path}'; their names must end in {', '.join(SUFFIXES)}")
    return files


def _open_camera(name: str) -> cv2.VideoCapture:
    try:
        camera = cv2.VideoCapture(int(name))
        if camera.isOpened():
            return camera
    except (cv2.error, ValueError):  # an index with too many digits
        pass
    raise ConfigError(f"camera {name} cannot be opened; give the index of one that is connected and not in use")


def _camera_images(name: str, camera: cv2.VideoCapture) -> Iterator[tuple[str, Image]]:
    for number in count(1):
        ok, image = camera.read()
        if not ok:
            raise ConfigError(f"camera {name} gives no images any more; check its cable")
        yield f"camera {name}, image {number}", np.asarray(image[:, :, ::-1], np.uint8)


def read_image(file: Path) -> Image:
    """Read an image file as RGB.

    Raises:
        ConfigError: If it is no image, damaged, or larger than Pillow accepts; its pixels are then never allocated.
    """
    data = _read_bytes(file)
    try:
        _check(data)
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except (DecompressionBombError, DecompressionBombWarning) as error:
        limit = f"{(PIL.Image.MAX_IMAGE_PIXELS or 0) / 1e6:.0f} million"
        raise ConfigError(f"'{file}' claims to have more than {limit} pixels; make it smaller") from error
    except PIL.UnidentifiedImageError:
        image = None
    except (OSError, SyntaxError, ValueError, ArithmeticError, cv2.error) as error:
        raise ConfigError(f"'{file}' is damaged: {error}") from error
    if image is None:
        raise ConfigError(f"'{file}' is not an image that OpenCV reads")
    return np.ascontiguousarray(image[:, :, ::-1], np.uint8)


def _read_bytes(file: Path) -> bytes:
    """Read a file by its name's bytes: OpenCV itself takes only names in UTF-8."""
    try:
        if not file.is_file():
            raise ConfigError(f"'{file}' is not a file")
        if (size := file.stat().st_size) > MAX_BYTES:
            raise ConfigError(f"'{file}' has {size / 1e6:.0f} MB; give an image of at most {MAX_BYTES / 1e6:.0f} MB")
        return file.read_bytes()
    except OSError as error:
        raise ConfigError(f"'{file}' cannot be read: {error.strerror or error}") from error


def _check(data: bytes) -> None:
    """Raise Pillow's error if an image is too large or cut off, which OpenCV would fill with grey in silence."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # odd metadata do not matter
        warnings.simplefilter("error", DecompressionBombWarning)
        with PIL.Image.open(BytesIO(data)) as image:
            image.load()


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


def make_folder(folder: Path) -> None:
    """Make a folder for images, unless it is there.

    Raises:
        ConfigError: If it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"folder '{folder}' cannot be made: {error.strerror or error}") from error


def write_image(file: Path, image: Image) -> None:
    """Write an RGB image as PNG.

    Raises:
        ConfigError: If it cannot be written.
    """
    try:
        file.write_bytes(cv2.imencode(".png", image[:, :, ::-1])[1].tobytes())
    except OSError as error:
        raise ConfigError(f"'{file}' cannot be written: {error.strerror or error}") from error
