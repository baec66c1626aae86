"""What the cameras see of the end effector and the target, whose markers are balls without collisions."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs import rewards
from sb3_stereo.envs.light import Light
from sb3_stereo.envs.marker_specs import MEASURES, MarkerSpec
from sb3_stereo.envs.markers import Blobs
from sb3_stereo.envs.sensor import Sensor
from sb3_stereo.envs.shadows import Shadow
from sb3_stereo.envs.simulators import SimulatedArm, SimulatedCamera, SimulatedScene

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Capture:
    """One look.

    Attributes:
        frames: RGBA of each view, (height, width, 4), uint8.
        centres: Of the end effector's marker, then of the target's, in each view, (n_views, 2, 2) in [px]; nan where
            it is hidden.
        offsets: Where the end effector is from the target in each view, (n_views, 2) in [px]; nan where a marker is
            hidden.
        end_effector_position: Shape (3,), in [m], world.
    """

    frames: tuple[Image, ...]
    centres: Floats
    offsets: Floats
    end_effector_position: Floats

    @cached_property
    def distances(self) -> Floats:
        """d(t) of Eq. 2, shape (n_views,), in [px]."""
        return rewards.lengths(self.offsets)


class CameraRig:
    """The cameras, and the markers that they look for.

    Args:
        scene: Where the markers are.
        cameras: One per view.
        arm: Whose end effector is marked in red.
        markers: What they are, and how they are measured.
    """

    def __init__(
        self, scene: SimulatedScene, cameras: Sequence[SimulatedCamera], arm: SimulatedArm, markers: MarkerSpec
    ) -> None:
        self._scene, self._cameras, self._arm = scene, cameras, arm
        self.radii, self.markers = markers.radii(arm.spec), scene.markers
        self._measure = MEASURES[markers.measure]
        self._sensors: tuple[Sensor, ...] | None = None
        self._darkness = 0.0
        self._shadow: Shadow | None = None
        self.lost: frozenset[int] = frozenset()  # views whose pictures nobody gets; the judge still has them

    def use_sensors(self, sensors: tuple[Sensor, ...], light: Light, floor_drawn: bool) -> None:
        """See through these sensors, one per camera; markers are then known by their bodies, whatever their colour.

        Args:
            sensors: One per camera.
            light: Of the scene.
            floor_drawn: Whether there is a floor for its shadow to fall on.
        """
        self._sensors, self._darkness = sensors, light.shadow
        shaded = light.shadow > 0.0 and floor_drawn
        self._shadow = Shadow(self._scene, light.direction, [c.spec for c in self._cameras]) if shaded else None

    def _radii_in(self, view: int) -> tuple[float, float]:
        """How large the red and the blue ball look in a view, in [px]."""
        scale = self._cameras[view].spec.scale
        return self.radii[0] * scale, self.radii[1] * scale

    def find(self, view: int, frame: Image) -> Blobs:
        """Where the markers are in a frame of a view, RGB or RGBA, shape (height, width, 3 or 4), uint8."""
        return self._measure.find(frame, self._radii_in(view))

    def locate(self, view: int, red: Image, blue: Image) -> Blobs:
        """Where the markers are in an image like a view's, of which red and blue pixels are known: 255, else 0."""
        return self._measure.locate(red, blue, self._radii_in(view))

    def capture(self, target_position: Floats) -> Capture:
        """Take the frames and measure the markers' offset in each.

        Args:
            target_position: Shape (3,), in [m], world.
        """
        position = self._place_markers(target_position)
        # Each frame is measured while the processor's cache still holds it.
        views = self._see()
        centres = np.array([blobs for _, blobs in views])
        return Capture(tuple(frame for frame, _ in views), centres, centres[:, 0] - centres[:, 1], position)

    def _see(self) -> list[tuple[Image, Blobs]]:
        """Every view's frame, black for one that is lost, and where the markers are in it."""
        views = self._see_all()
        if not self.lost:
            return views
        return [(_black(frame) if n in self.lost else frame, blobs) for n, (frame, blobs) in enumerate(views)]

    def _see_all(self) -> list[tuple[Image, Blobs]]:
        if self._sensors is None:
            return [(frame, self.find(n, frame)) for n, frame in enumerate(camera.frame() for camera in self._cameras)]
        shades: list[Floats] | list[None] = [None] * len(self._cameras)
        if self._shadow is not None:
            shades = [np.where(mask, 1.0 - self._darkness, 1.0) for mask in self._shadow.masks()]
        return [self._sense(n, sensor, shade) for n, (sensor, shade) in enumerate(zip(self._sensors, shades))]

    def _sense(self, view: int, sensor: Sensor, shade: Floats | None) -> tuple[Image, Blobs]:
        """What a sensor sees, and where the markers are: known by their bodies."""
        picture, _, bodies = self._cameras[view].draw()
        red, blue = (np.where(bodies == ball, np.uint8(255), np.uint8(0)) for ball in self.markers)
        return sensor(picture, bodies, self._scene.ground, shade), self.locate(view, red, blue)

    def draw(self, target_position: Floats) -> tuple[Image, ...]:
        """Take the frames only."""
        self._place_markers(target_position)
        if self._sensors is None and not self.lost:
            return tuple(camera.frame() for camera in self._cameras)
        return tuple(frame for frame, _ in self._see())

    def look(self, target_position: Floats) -> tuple[tuple[Image, Blobs], ...]:
        """Take the frames, and measure where the markers are in each."""
        self._place_markers(target_position)
        return tuple(self._see())

    def _place_markers(self, target_position: Floats) -> Floats:
        """Put the red marker where the end effector is, which is returned, and the blue one at the target."""
        end_effector_position = self._arm.end_effector_position
        self.place_markers(end_effector_position, target_position)
        return end_effector_position

    def place_markers(self, *positions: Floats) -> None:
        """Put the red marker at the first and the blue one at the second position, (3,) in [m], world."""
        for ball, position in zip(self.markers, positions, strict=True):
            self._scene.place(ball, position)


def _black(frame: Image) -> Image:
    """A black picture of the same size, as opaque."""
    black = np.zeros_like(frame)
    black[:, :, 3] = 255
    return black
