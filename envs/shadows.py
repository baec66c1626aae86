"""Shadows on the floor, the same in every simulator. (TinyRenderer's own darken everything alike.)

A camera far away, where the light comes from, sees what is lit. A point of the floor is in the shadow if that camera
sees a body in its place.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.cameras import CameraSpec
from sb3_stereo.envs.sensor import NOTHING, floor_points
from sb3_stereo.envs.simulators import SimulatedScene

Floats = NDArray[np.float64]

DISTANCE, MIDDLE, EXTENT = 20.0, 0.4, 1.8  # [m]: of the light, of what it looks at above the floor, around that
SIDE = 320  # [px]
LOWEST = 0.3  # of the light's direction: shadows of a lower light would be longer than the floor


class Shadow:
    """The shadow in one light.

    Args:
        scene: What casts it.
        direction: Where the light comes from, shape (3,), world.
        views: The cameras that see the floor.
    """

    def __init__(self, scene: SimulatedScene, direction: Sequence[float], views: Sequence[CameraSpec]) -> None:
        self._ground, self._light = scene.ground, scene.camera(light_camera(direction))
        self._pixels = [self._pixels_of(view) for view in views]

    def masks(self) -> list[NDArray[np.bool_]]:
        """Where each view's pixels, if they show the floor, are in the shadow, (height, width) each."""
        _, _, bodies = self._light.draw()
        casting = np.pad((bodies != NOTHING) & (bodies != self._ground), 1)  # beyond its picture nothing casts
        return [casting[rows, columns] for rows, columns in self._pixels]

    def _pixels_of(self, view: CameraSpec) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows and columns in the padded picture of the light's camera, of every pixel's place on the floor."""
        x, y = floor_points(view)
        pixels = self._light.spec.project(np.stack([x, y, np.zeros_like(x)], axis=-1))
        columns, rows = np.clip(np.rint(np.moveaxis(pixels, -1, 0)), -1, SIDE).astype(np.int64) + 1
        return rows, columns


def light_camera(direction: Sequence[float]) -> CameraSpec:
    """A camera where the light comes from that sees the arm and its surroundings."""
    way = np.array(direction) / np.linalg.norm(direction)
    way[2] = max(way[2], LOWEST)
    target = np.array([0.0, 0.0, MIDDLE])
    up = (1.0, 0.0, 0.0) if abs(way[2]) > 0.99 else (0.0, 0.0, 1.0)
    position = target + DISTANCE * way / np.linalg.norm(way)
    fov = 2 * math.atan(EXTENT / DISTANCE)
    near, far = DISTANCE - 3 * EXTENT, DISTANCE + 3 * EXTENT
    place, aim = tuple(position.tolist()), tuple(target.tolist())
    return CameraSpec("light", place, aim, up, fov, SIDE, SIDE, near, far)
