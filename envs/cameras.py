"""Named cameras: where they stand and what they see."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from sb3_stereo.envs.specs import plain, quoted, read_yaml, require, require_known
from sb3_stereo.envs.validation import STRICT, Integer, Quantity, Text, Vector, explained, from_map

Single = NDArray[np.float32]  # shape (3,)

MAX_SIDE = 4096  # [px], of a frame: 64 MiB
Pixels = Annotated[Integer, Field(ge=1, le=MAX_SIDE)]


@explained("camera")
@dataclass(frozen=True, config=STRICT)
class CameraSpec:
    """A fixed pinhole camera.

    Attributes:
        name: What messages and pictures call the view.
        position: Of the pinhole, in [m], world.
        target: Point in the middle of the picture, in [m], world.
        up: Direction that is up in the picture.
        horizontal_fov: Horizontal field of view in [rad]; the default is Gazebo's.
        width: Of the frame, in [px].
        height: Of the frame, in [px].
        near: Distance of the near plane, in [m].
        far: Distance of the far plane, in [m].

    Raises:
        ValueError: If a value makes no picture.
    """

    name: Text
    position: Vector
    target: Vector = (0.0, 0.0, 0.6)
    up: Vector = (0.0, 0.0, 1.0)
    horizontal_fov: Quantity = math.pi / 3
    width: Pixels = 320
    height: Pixels = 240
    near: Quantity = 0.1
    far: Quantity = 10.0

    def __post_init__(self) -> None:
        this = f"camera {quoted(self.name)}"
        fov = self.horizontal_fov
        require(0.0 < fov < math.pi, f"{this}: horizontal_fov is {fov}; give radians in (0, pi)")
        require(0.0 < self.near < self.far, f"{this}: near {self.near}, far {self.far}; give 0 < near < far")
        forward = np.subtract(self.target, self.position)
        aside = np.linalg.norm(np.cross(forward, self.up))
        require(bool(aside > 0.0), f"{this}: it looks along its up direction {self.up}; choose another up")
        drawable = np.isfinite([*self.view_matrix, *self.projection_matrix]).all()
        require(bool(drawable), f"{this}: a distance or an angle in it is too small to draw with; give a larger one")

    @property
    def view_matrix(self) -> tuple[float, ...]:
        """World to camera, 16 numbers in OpenGL's order."""
        eye, target, up = (np.array(vector, np.float32) for vector in (self.position, self.target, self.up))
        with np.errstate(all="ignore"):  # the constructor refuses what comes of too small a number
            forward = _unit(target - eye)
            aside = _unit(_cross(forward, _unit(up)))
            up = _cross(aside, forward)
            shift = [-_dot(aside, eye), -_dot(up, eye), _dot(forward, eye)]
        axes = np.stack([aside, up, -forward], axis=1)  # (3, 3)
        return tuple(np.block([[axes, np.zeros((3, 1))], [np.array(shift), 1.0]]).ravel().tolist())

    @property
    def projection_matrix(self) -> tuple[float, ...]:
        """Camera to clip space, 16 numbers in OpenGL's order.

        TinyRenderer samples a pixel at its lower left corner. Half a pixel's shift puts the sample in the middle, so
        that mirrored cameras see mirrored pictures.
        """
        aspect = self.width / self.height
        vertical_fov = 2 * math.atan(math.tan(self.horizontal_fov / 2) / aspect)
        # In single precision and in Bullet's order, to the bit.
        tangent = math.tan(float(np.float32(math.pi)) / 180.0 * float(np.float32(math.degrees(vertical_fov))) / 2)
        height = np.float32(1 / tangent if tangent else np.inf)
        near, far = np.array((self.near, self.far), np.float32)
        matrix = np.zeros(16)
        matrix[[0, 5, 11]] = height / np.float32(aspect), height, -1.0
        with np.errstate(all="ignore"):  # as above
            matrix[[10, 14]] = (near + far) / (near - far), np.float32(2.0) * far * near / (near - far)
        matrix[8] = 1 / self.width  # times z, which w is the negative of
        matrix[9] = 1 / self.height
        return tuple(matrix.tolist())

    @property
    def scale(self) -> float:
        """Pixels per metre at the point in the middle of the picture."""
        distance = math.dist(self.position, self.target)
        return self.width / (2 * distance * math.tan(self.horizontal_fov / 2))

    def scale_at(self, point: NDArray[np.float64]) -> float:
        """Pixels per metre at a point before the camera, shape (3,), in [m], world."""
        sight = np.subtract(self.target, self.position)
        depth = float(sight @ np.subtract(point, self.position)) / float(np.linalg.norm(sight))
        return self.width / (2 * depth * math.tan(self.horizontal_fov / 2))

    def sized(self, height: int) -> "CameraSpec":
        """The same camera with a frame of another size, `height` in [px], and the same shape."""
        return replace(self, width=round(self.width * height / self.height), height=height)

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where world points appear in the frame.

        Args:
            points: Shape (..., 3), in [m], world.

        Returns:
            Pixel coordinates (x right, y down, (0, 0) the middle of the first pixel), shape (..., 2).
        """
        matrix = np.reshape(self.projection_matrix, (4, 4)).T @ np.reshape(self.view_matrix, (4, 4)).T
        homogeneous = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1) @ matrix.T
        device = homogeneous[..., :2] / homogeneous[..., 3:]  # in [-1, 1], y up
        shift = np.array([0.0, 1.0])  # TinyRenderer's rows start at the bottom: its sample is one row lower
        return np.asarray((np.array([1.0, -1.0]) * device + 1.0) / 2 * np.array([self.width, self.height]) - shift)


# In single precision and in the order of Bullet's computeViewMatrix, to the bit.
def _unit(vector: Single) -> Single:
    return np.asarray(vector * (np.float32(1.0) / np.sqrt(_dot(vector, vector))))


def _cross(one: Single, other: Single) -> Single:
    (a, b, c), (x, y, z) = one, other
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x], np.float32)


def _dot(one: Single, other: Single) -> Any:
    (a, b, c), (x, y, z) = one, other
    return a * x + b * y + c * z


def stereo_pair(
    distance: float = 4.0, elevation: float = math.radians(15), **fields: Any
) -> tuple[CameraSpec, CameraSpec]:
    """Two cameras in front of the arm, 90 degrees apart: their mean pixel distance follows the distance in space.

    Args:
        distance: To the point that both look at, in [m]. At 4 m a pixel there is 14.4 mm wide, so the goal's 10
            pixels are about 14 cm; much nearer cameras make goals too rare to be found by chance.
        elevation: Above the horizon, in [rad].
        fields: Further ones of both `CameraSpec`s; their target is on the z axis.
    """
    ground = distance * math.cos(elevation)
    height = fields.get("target", CameraSpec.target)[2] + distance * math.sin(elevation)
    side = ground * math.sqrt(0.5)
    return CameraSpec("left", (side, side, height), **fields), CameraSpec("right", (side, -side, height), **fields)


def behind(pair: tuple[CameraSpec, CameraSpec]) -> tuple[CameraSpec, CameraSpec]:
    """Two more cameras, behind the arm: as far from where a `stereo_pair` looks, and higher.

    From 45 degrees above the horizon the shoulder hides little, and no two of the four lines of sight are within 60
    degrees of each other: any two views tell a place in space.
    """
    target = pair[0].target
    distance = math.dist(pair[0].position, target)
    side, height = distance / 2, target[2] + distance * math.sqrt(0.5)
    return (
        replace(pair[0], name="back_left", position=(-side, side, height)),
        replace(pair[1], name="back_right", position=(-side, -side, height)),
    )


STEREO_PAIR = stereo_pair()
# The workspace fills the picture, 7.5 mm per pixel. From twice the distance the scale varies half as much between the
# near and the far end of the workspace, so that a distance in pixels is nearly the same in space anywhere.
CLOSE_PAIR = stereo_pair(8.0, target=(0.0, 0.0, 0.55), horizontal_fov=0.298, near=5.0, far=11.0)
FRAMINGS = {"wide": (*STEREO_PAIR, *behind(STEREO_PAIR)), "close": (*CLOSE_PAIR, *behind(CLOSE_PAIR))}
# In this order the views of a rig are their own mirror images, reversed.
RIGS = {"stereo": ("left", "right"), "four": ("left", "back_left", "back_right", "right")}


def camera_specs(
    cameras: Sequence[CameraSpec | Mapping[str, Any] | str] | str, framing: str = "wide"
) -> tuple[CameraSpec, ...]:
    """Return cameras that are given as themselves, as maps of their fields, by their names in a framing, by the name of
    a rig, or by the path of a YAML file with a list of these.

    Args:
        cameras: At least one, or of `RIGS`.
        framing: Of `FRAMINGS`, whose cameras the names are of.

    Raises:
        ValueError: If there is none, or a field is wrong.
    """
    require_known("framing", framing, FRAMINGS, "framings")
    given = _listed(cameras)
    require(isinstance(given, Sequence) and len(given) > 0, "no cameras; give at least one CameraSpec, or map of one")
    known = FRAMINGS[framing]
    return tuple(_camera_spec(camera, f"camera {number}", known) for number, camera in enumerate(given, start=1))


def _listed(cameras: Any) -> Any:
    if not isinstance(cameras, str):
        return cameras
    return RIGS[cameras] if cameras in RIGS else read_yaml(cameras, "camera")


def plain_cameras(cameras: Sequence[CameraSpec | Mapping[str, Any] | str] | str) -> list[Any]:
    """Return cameras as maps of their fields, for a record; a name stays one, as the framing says whose it is.

    Raises:
        ValueError: If there is none, or a field is wrong.
    """
    given = _listed(cameras)
    specs = camera_specs(given)
    return [name if isinstance(name, str) else plain(spec) for name, spec in zip(given, specs, strict=True)]


def _camera_spec(camera: CameraSpec | Mapping[str, Any] | str, what: str, known: Sequence[CameraSpec]) -> CameraSpec:
    if isinstance(camera, CameraSpec):
        return camera
    if not isinstance(camera, str):
        return from_map(CameraSpec, camera, what)
    named = {spec.name: spec for spec in known}
    require_known("camera", camera, named, "those with a name")
    return named[camera]


def mirror_each_other(cameras: Sequence[CameraSpec]) -> bool:
    """Whether the views in reverse order are the mirror images of all views through the plane y = 0."""
    flip = np.array([1.0, -1.0, 1.0])
    return all(
        np.allclose([a.position * flip, a.target * flip, a.up * flip], [b.position, b.target, b.up])
        and (a.horizontal_fov, a.near, a.far) == (b.horizontal_fov, b.near, b.far)
        for a, b in zip(cameras, reversed(cameras))
    )
