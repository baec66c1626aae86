"""What the markers of end effector and target are, and how an image tells where they are."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass

from sb3_stereo.envs.circles import circle_centres, find_circles
from sb3_stereo.envs.markers import Blobs, blob_centroids, find_blobs
from sb3_stereo.envs.robots import ArmSpec
from sb3_stereo.envs.specs import require_known
from sb3_stereo.envs.validation import STRICT, Flag, PositiveQuantity, Quantity, Text, explained, named

Frame = NDArray[np.uint8]
Radii = tuple[float, float]  # of the red and the blue ball; as they look, in [px]


class Measure(NamedTuple):
    """How an image tells where the markers are."""

    find: Callable[[Frame, Radii], Blobs]  # in a rendered frame
    locate: Callable[[Frame, Frame, Radii], Blobs]  # where an image's red and blue pixels are known: 255 there, else 0


MEASURES = {
    "centroid": Measure(lambda frame, radii: find_blobs(frame), lambda red, blue, radii: blob_centroids(red, blue)),
    "circle": Measure(find_circles, circle_centres),
}


@explained("markers")
@dataclass(frozen=True, config=STRICT)
class MarkerSpec:
    """The two balls that mark end effector and target.

    Attributes:
        measure: "centroid", the mean pixel of what is visible, as in the paper, or "circle", the centre of the circle
            through the visible rim.
        end_effector_radius: In [m]; None for the arm's `marker_radius`.
        target_radius: In [m]; None for the end effector's.
        standoff: How far the red ball is in front of the arm's `end_effector_offset`, along the z axis of the
            end effector's link, in [m]: so far does it stick out of the hand.
        hollow_target: Draw the inside of the target's ball only, its far half as seen from any camera. A ball of the
            end effector that is within it, or in front of it, then stays visible as a whole.

    Raises:
        ValueError: If a value makes no marker.
    """

    measure: Text = "centroid"
    end_effector_radius: PositiveQuantity | None = None
    target_radius: PositiveQuantity | None = None
    standoff: Quantity = 0.0
    hollow_target: Flag = False

    def __post_init__(self) -> None:
        require_known("measure of markers", self.measure, MEASURES, "measures")

    def carried_by(self, arm: ArmSpec) -> ArmSpec:
        """The arm with the end effector's marker where and as large as it is here."""
        x, y, z = arm.end_effector_offset
        radius = arm.marker_radius if self.end_effector_radius is None else self.end_effector_radius
        return replace(arm, end_effector_offset=(x, y, z + self.standoff), marker_radius=radius)

    def radii(self, arm: ArmSpec) -> Radii:
        """Of the red and the blue ball of the arm that carries them, in [m]."""
        return arm.marker_radius, self.target_radius or arm.marker_radius


SOLID = MarkerSpec()
# Measured (docs/environment.md): two radii as small as 320 x 240 frames allow, 4.7 and 6 px, and as near to each other
# as lets the rim of the target be seen around the end effector. Further out the hand hides the ball no less often.
HOLLOW = MarkerSpec("circle", end_effector_radius=0.035, target_radius=0.045, standoff=0.09, hollow_target=True)
MARKERS = {"solid": SOLID, "hollow": HOLLOW}


def marker_spec(markers: MarkerSpec | Mapping[str, Any] | str) -> MarkerSpec:
    """Return markers that are given as themselves, as a map of their fields, or by a name in `MARKERS`.

    Raises:
        ValueError: If there are none, or a field is wrong.
    """
    return named(MarkerSpec, markers, MARKERS, "markers", "markers")
