"""What a camera makes of the picture before it: background, floor, light, optics and noise."""

import zlib
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.cameras import CameraSpec

Frame = NDArray[np.uint8]
Floats = NDArray[np.float64]
Patch = tuple[int, int, int, int, int]  # top, left, height, width in [px], and grey

NOTHING = -1  # Bullet's body id where a camera sees none
PATTERNS = ("tiles", "planks", "spots")


@dataclass(frozen=True, eq=False)
class Sensor:
    """One camera's sensor.

    Its noise depends on the picture and the seed alone, so that a state of the world has one observation.

    Attributes:
        gains: Factors of red, green and blue, shape (3,).
        noise: Standard deviation, of 255.
        blur: Standard deviation, in [px].
        compression: 100 less the quality of JPEG; 0 leaves it out.
        shift: Of the picture, down and right, in [px].
        dead_pixels: Share of pixels that are black.
        patches: Grey patches before the lens.
        background: RGB picture in place of white, (height, width, 3), uint8; None leaves it white.
        floor: Factors of the floor's brightness, (height, width); None leaves it plain.
        seed: Of the noise.
    """

    gains: Floats
    noise: float
    blur: float
    compression: int
    shift: tuple[int, int]
    dead_pixels: float
    patches: tuple[Patch, ...]
    background: Frame | None
    floor: Floats | None
    seed: int

    def __call__(self, frame: Frame, bodies: NDArray[np.int32], floor: int, shade: Floats | None = None) -> Frame:
        """Return what the sensor makes of a frame.

        Args:
            frame: RGBA, (height, width, 4), uint8.
            bodies: Which body each pixel shows, (height, width).
            floor: The floor's.
            shade: Factors of the floor's brightness where something casts a shadow, (height, width); None for none.
        """
        rng = np.random.default_rng((self.seed, zlib.crc32(np.ascontiguousarray(frame).data)))
        image = frame[:, :, :3].astype(np.float32)
        if self.background is not None:
            np.copyto(image, self.background, where=(bodies == NOTHING)[:, :, None])
        if self.floor is not None:
            image *= np.where(bodies == floor, self.floor, 1.0).astype(np.float32)[:, :, None]
        if shade is not None:
            image *= np.where(bodies == floor, shade, 1.0).astype(np.float32)[:, :, None]
        for top, left, height, width, grey in self.patches:
            image[top : top + height, left : left + width] = grey
        image *= self.gains.astype(np.float32)
        if self.blur:
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), self.blur), np.float32)
        if any(self.shift):
            image = _shifted(image, *self.shift)
        if self.noise:
            image += np.float32(self.noise) * rng.standard_normal(image.shape, np.float32)
        if self.dead_pixels:
            image[np.random.default_rng(self.seed).random(image.shape[:2]) < self.dead_pixels] = 0.0
        seen = np.clip(image, 0, 255, out=image).astype(np.uint8)
        return np.dstack([self._compressed(seen), frame[:, :, 3]])

    def _compressed(self, image: Frame) -> Frame:
        if not self.compression:
            return image
        done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 100 - self.compression])
        assert done  # an image in memory always can be
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


def _shifted(image: NDArray[np.float32], down: int, right: int) -> NDArray[np.float32]:
    """The image moved; its edge repeats."""
    rows, columns = (np.clip(np.arange(size) - by, 0, size - 1) for size, by in zip(image.shape, (down, right)))
    return np.asarray(image[rows][:, columns], np.float32)


def draw_picture(size: tuple[int, int], rng: np.random.Generator) -> Frame:
    """A picture like a photograph of a room out of focus: surfaces, things before them, light that falls off.

    Args:
        size: Height and width in [px].
        rng: Where it is drawn from.

    Returns:
        RGB, (height, width, 3), uint8.
    """
    height, width = size
    image = np.full((height, width, 3), rng.uniform(30, 230, 3) * 0.3 + rng.uniform(30, 230) * 0.7, np.float32)
    for _ in range(rng.integers(3, 12)):
        grey, tint = rng.uniform(0, 255), rng.uniform(-25, 25, 3)
        colour = tuple((grey + tint).tolist())
        corner = rng.uniform((-0.2, -0.2), (1.0, 1.0)) * (width, height)
        extent = rng.uniform(0.05, 0.6, 2) * (width, height)
        box = (
            tuple((corner + extent / 2).tolist()),
            tuple(extent.tolist()),
            float(rng.choice([0, rng.uniform(0, 90)])),
        )
        cv2.fillPoly(image, [cv2.boxPoints(box).astype(np.int32)], colour)
    for cells in ((2, 3), (6, 8), (24, 32)):
        octave = rng.standard_normal(cells, np.float32)
        image += rng.uniform(3, 20) * cv2.resize(octave, (width, height), interpolation=cv2.INTER_CUBIC)[:, :, None]
    image = np.asarray(cv2.GaussianBlur(image, (0, 0), float(rng.uniform(0.6, 3.0))), np.float32)
    return np.clip(image, 0, 255).astype(np.uint8)


def floor_pattern(view: CameraSpec, rng: np.random.Generator) -> Floats:
    """How bright each pixel of a camera is if it shows the floor: tiles, planks or spots.

    Args:
        view: The camera.
        rng: Where the pattern is drawn from; the same for all cameras that see the same floor.

    Returns:
        Factors, (height, width).
    """
    contrast, cell, angle = rng.uniform(0.2, 0.6), rng.uniform(0.1, 0.5), rng.uniform(0, np.pi)
    kind = PATTERNS[rng.integers(len(PATTERNS))]
    phases = rng.uniform(0, 100, 2)
    x, y = floor_points(view)
    u = (np.cos(angle) * x + np.sin(angle) * y) / cell + phases[0]
    v = (np.cos(angle) * y - np.sin(angle) * x) / cell + phases[1]
    waves = {
        "tiles": (np.floor(u) + np.floor(v)) % 2,
        "planks": np.abs(np.sin(12.9898 * np.floor(u) + np.floor(v / 6))),
        "spots": (np.sin(3 * u) * np.sin(3 * v) + 1) / 2,
    }
    return np.asarray(1.0 - contrast * waves[kind])


def floor_points(view: CameraSpec) -> tuple[Floats, Floats]:
    """Where each pixel's ray meets the plane z = 0, x and y in [m], (height, width) each; 0 above the horizon."""
    forward = np.subtract(view.target, view.position) / np.linalg.norm(np.subtract(view.target, view.position))
    right = np.cross(forward, view.up) / np.linalg.norm(np.cross(forward, view.up))
    focal = view.width / 2 / np.tan(view.horizontal_fov / 2)  # [px]
    columns = np.arange(view.width) + 0.5 - view.width / 2
    rows = np.arange(view.height) + 0.5 - view.height / 2
    along, down = np.meshgrid(columns / focal, rows / focal)
    rays = forward + along[..., None] * right - down[..., None] * np.cross(right, forward)
    falling = rays[..., 2] < -1e-6
    reach = np.where(falling, -view.position[2] / np.where(falling, rays[..., 2], 1.0), 0.0)
    return view.position[0] + reach * rays[..., 0], view.position[1] + reach * rays[..., 1]
