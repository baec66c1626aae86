"""Camera specifications."""

import math
from typing import Any

import numpy as np
import pytest

from sb3_stereo.envs.bullet import pybullet
from sb3_stereo.envs.cameras import STEREO_PAIR, CameraSpec, stereo_pair


def test_the_point_looked_at_is_in_the_middle() -> None:
    for spec in STEREO_PAIR:
        np.testing.assert_allclose(spec.project(np.array(spec.target)), (159.5, 119.5), atol=1e-4)


def test_up_is_up_and_the_field_of_view_is_horizontal() -> None:
    spec = CameraSpec("front", (4.0, 0.0, 0.6))
    above, edge = np.array([0.0, 0.0, 1.0]), np.array([0.0, 4 * math.tan(math.pi / 6), 0.6])
    assert spec.project(above)[1] < 119.5
    assert spec.project(edge)[0] == pytest.approx(319.5, abs=1e-3)


def test_a_pixel_is_14_mm_at_the_arm() -> None:
    spec = CameraSpec("front", (4.0, 0.0, 0.6))
    step = np.array([[0.0, 0.0, 0.6], [0.0, 0.0144, 0.6]])
    assert np.ptp(spec.project(step)[:, 0]) == pytest.approx(1.0, abs=0.01)


def test_the_pair_sees_from_a_right_angle() -> None:
    left, right = (np.subtract(spec.position, spec.target)[:2] for spec in stereo_pair(elevation=0.0))
    assert left @ right == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"horizontal_fov": 4.0}, "camera 'top': horizontal_fov is 4.0; give radians in (0, pi)"),
        ({"width": 0}, "camera 'top': width is 0; give at least 1"),
        ({"width": 10**6}, "camera 'top': width is 1000000; give at most 4096"),
        ({"position": None}, "camera 'top': position is None; give 3 numbers"),
        ({"far": 1e9}, "camera 'top': far is 1000000000.0; give at most 10000"),
        (
            {"horizontal_fov": 1e-300},
            "camera 'top': a distance or an angle in it is too small to draw with; give a larger one",
        ),
        ({"near": 2.0, "far": 1.0}, "camera 'top': near 2.0, far 1.0; give 0 < near < far"),
        ({"target": (0, 0, 0)}, "camera 'top': it looks along its up direction (0.0, 0.0, 1.0); choose another up"),
    ],
)
def test_a_camera_that_sees_nothing_is_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as error:
        CameraSpec("top", **{"position": (0.0, 0.0, 3.0), "target": (0.1, 0.0, 0.0), **arguments})
    assert str(error.value) == message


def test_matrices_are_those_of_bullet_to_the_bit() -> None:
    rng = np.random.default_rng(0)
    for _ in range(300):
        position, target, up = rng.normal(size=(3, 3)) * [[5.0], [0.5], [1.0]]
        fov, near = rng.uniform(0.1, 2.9), rng.uniform(0.01, 5.0)
        width, height = rng.integers(10, 700, 2).tolist()
        spec = CameraSpec("any", tuple(position), tuple(target), tuple(up), fov, width, height, near, near + 3.0)
        assert spec.view_matrix == pybullet.computeViewMatrix(position.tolist(), target.tolist(), up.tolist())
        vertical_fov = math.degrees(2 * math.atan(math.tan(fov / 2) / (width / height)))
        expected = np.array(pybullet.computeProjectionMatrixFOV(vertical_fov, width / height, near, near + 3.0))
        expected[8:10] += 1 / width, 1 / height
        assert spec.projection_matrix == tuple(expected)
