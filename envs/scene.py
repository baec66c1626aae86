"""The scene around the arm, in whatever simulator: its floor, and the balls that mark end effector and target."""

import numpy as np
from numpy.typing import NDArray

RED, BLUE, GREY = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0), (0.8, 0.8, 0.8, 1.0)
GRAVITY = (0.0, 0.0, -9.81)  # [m/s^2]
FLOOR_HALF_EXTENTS = (3.0, 3.0, 0.05)  # [m]


def sphere(n_parallels: int = 16, n_meridians: int = 32) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points on the unit sphere (n, 3), and triangles between them (m, 3), their fronts outside."""
    polar, azimuth = np.meshgrid(
        np.linspace(0, np.pi, n_parallels + 1), np.linspace(0, 2 * np.pi, n_meridians, endpoint=False), indexing="ij"
    )
    points = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1)
    numbers = np.arange(points.shape[0] * n_meridians).reshape(-1, n_meridians)
    above, below = numbers[:-1], numbers[1:]
    beside, below_beside = np.roll(above, -1, axis=1), np.roll(below, -1, axis=1)
    triangles = np.concatenate(
        [np.stack([above, below, beside], axis=-1), np.stack([beside, below, below_beside], axis=-1)]
    )
    return points.reshape(-1, 3), triangles.reshape(-1, 3)
