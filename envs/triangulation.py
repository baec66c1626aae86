"""Where a point is in space that several cameras see: linear triangulation (Hartley & Zisserman, section 12.2)."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.cameras import CameraSpec
from sb3_stereo.envs.specs import require

Floats = NDArray[np.float64]

MIN_ANGLE = 0.1  # [rad] between two lines of sight that tell a depth


def check_views(views: Sequence[CameraSpec]) -> None:
    """Raise a ValueError unless two of the views tell where a point is in space."""
    sights = [np.subtract(view.target, view.position) for view in views]
    cosines = [abs(a @ b) / np.linalg.norm(a) / np.linalg.norm(b) for a in sights for b in sights]
    enough = min(cosines) < np.cos(MIN_ANGLE)
    require(enough, "heights are seen by two cameras that look along different lines; give two such cameras")


def triangulate(views: Sequence[CameraSpec], pixels: Floats) -> Floats:
    """The point whose projections are nearest to where the views see it, in [m], world.

    Args:
        views: The cameras.
        pixels: Where each sees it, as `CameraSpec.project` has it, (n_views, 2); views with nan are left out.

    Returns:
        Shape (3,), nan if fewer than two views see it.
    """
    seen = [(view, pixel) for view, pixel in zip(views, pixels, strict=True) if not np.isnan(pixel).any()]
    if len(seen) < 2:
        return np.full(3, np.nan)
    rows = np.concatenate([_equations(view, pixel) for view, pixel in seen])  # (2 * n_seen, 4)
    point, *_ = np.linalg.lstsq(rows[:, :3], -rows[:, 3], rcond=None)
    return np.asarray(point)


def _equations(view: CameraSpec, pixel: Floats) -> Floats:
    """Two rows that a homogeneous point on the pixel's line of sight makes 0, (2, 4): `CameraSpec.project` inverted."""
    matrix = np.reshape(view.projection_matrix, (4, 4)).T @ np.reshape(view.view_matrix, (4, 4)).T
    x, y = pixel + np.array([0.0, 1.0])
    device = np.array([2 * x / view.width - 1.0, 1.0 - 2 * y / view.height])
    return np.asarray(device[:, None] * matrix[3] - matrix[:2])
