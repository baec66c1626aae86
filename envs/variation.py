"""One episode's world, as drawn by `Randomization`."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.cameras import CameraSpec
from sb3_stereo.envs.clutter import Item
from sb3_stereo.envs.light import Light
from sb3_stereo.envs.sensor import Sensor

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Variation:
    """What one episode's world is like.

    Attributes:
        light: Of the scene.
        views: The cameras where they stand.
        sensors: What each of them makes of its picture.
        effort: Factors of the effort limits, shape (n_joints,).
        damping: Factors of the joints' damping, shape (n_joints,).
        friction: Dry friction of the joints, shape (n_joints,), in [N m].
        mass: Factors of the links' masses and inertias, shape (n_links,).
        gravity: Share of the weight that is not compensated.
        latency: Time in which an action has no effect yet, in [s].
        paint: Colours of base and links, shape (n_links + 1, 3), from 0 to 1.
        painted: How far each colour is from its own to the paint, shape (n_links + 1,), 0 to 1.
        floor: Colour of the floor, shape (3,), from 0 to 1; None if it is not drawn.
        clutter: Bodies around the arm.
    """

    light: Light
    views: tuple[CameraSpec, ...]
    sensors: tuple[Sensor, ...]
    effort: Floats
    damping: Floats
    friction: Floats
    mass: Floats
    gravity: float
    latency: float
    paint: Floats
    painted: Floats
    floor: Floats | None
    clutter: tuple[Item, ...]
