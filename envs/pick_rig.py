"""What cameras see of a hand and of the object that it is to pick up."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.arm import Arm
from sb3_stereo.envs.capture import CameraRig
from sb3_stereo.envs.colours import COLOURS, HAND, colour_mask
from sb3_stereo.envs.marker_specs import MarkerSpec
from sb3_stereo.envs.markers import Blobs, blob_centroids
from sb3_stereo.envs.objects import Objects, PlacedObject
from sb3_stereo.envs.simulators import SimulatedCamera, SimulatedScene

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

HAND_MARKER = MarkerSpec(end_effector_radius=0.035)
BEHIND_LIP = 0.045  # [m], the middle of that ball: it leaves a centimetre of the cup, and the wrist hides it seldom


class PickRig(CameraRig):
    """Cameras that look for the end effector's ball and an object, which has a colour that no other has.

    Args:
        scene: Where the ball is.
        cameras: One per view.
        arm: With a suction cup, which is marked in red.
        objects: Of which one is the target.
    """

    def __init__(self, scene: SimulatedScene, cameras: Sequence[SimulatedCamera], arm: Arm, objects: Objects) -> None:
        super().__init__(scene, cameras, arm, HAND_MARKER)
        self._cupped_arm = arm
        self._ball, self._objects = self.markers[0], objects
        self.seek(0, next(iter(COLOURS)))

    def seek(self, number: int, colour: str) -> None:
        """Look for the object of a model, which is painted in a colour."""
        self.markers, self._colour = (self._ball, self._objects.bodies[number]), COLOURS[colour]

    def aim_at(self, item: PlacedObject) -> None:
        """Look for an episode's object."""
        self.seek(item.number, item.colour)

    def find_masks(self, frame: Image) -> tuple[Image, Image]:
        """Where a frame shows the end effector's marker and where the object: 255 there, else 0, (height, width)."""
        return colour_mask(frame, HAND), colour_mask(frame, self._colour)

    def find(self, view: int, frame: Image) -> Blobs:
        """As in `CameraRig`."""
        return blob_centroids(*self.find_masks(frame))

    def _place_markers(self, target_position: Floats) -> Floats:
        """Put the red ball around the cup; where it is then, (3,) in [m], world. The object is where it is."""
        lip, axis = self._cupped_arm.cup_pose
        position: Floats = lip - BEHIND_LIP * axis
        self._scene.place(self._ball, position)
        return position
