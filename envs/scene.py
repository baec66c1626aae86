"""What is around the arm: the simulated world, its floor, and the balls that mark end effector and target."""

from collections.abc import Sequence
from typing import Any

import pybullet

from sb3_stereo.envs.cameras import Camera
from sb3_stereo.envs.simulation import Client

RED, BLUE, GREY = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0), (0.8, 0.8, 0.8, 1.0)
GRAVITY = (0.0, 0.0, -9.81)  # [m/s^2]
FLOOR_HALF_EXTENTS = (3.0, 3.0, 0.05)  # [m]


def empty_world(gui: bool, physics_rate: float, weightless: bool) -> Client:
    """A client in which nothing is yet, `physics_rate` in [Hz]."""
    client = Client(gui=gui)
    client.setTimeStep(1 / physics_rate)
    client.setGravity(*((0.0, 0.0, 0.0) if weightless else GRAVITY))
    # Without this the order of overlapping pairs, and so a contact's outcome, depends on the past.
    client.setPhysicsEngineParameter(deterministicOverlappingPairs=1)
    return client


def add_floor(client: Any, cameras: Sequence[Camera], drawn: bool, in_window: bool) -> int:
    """Add the floor and return its body.

    Args:
        client: Where nothing that moves has been added yet.
        cameras: Whose background it becomes if it is drawn; that is drawn once, here.
        drawn: Show it. It is solid in any case.
        in_window: Bullet's window is to show it, which knows no backgrounds.
    """
    shape = client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=FLOOR_HALF_EXTENTS)
    look = client.createVisualShape(pybullet.GEOM_BOX, halfExtents=FLOOR_HALF_EXTENTS, rgbaColor=GREY)
    floor = client.createMultiBody(0, shape, look, basePosition=(0.0, 0.0, -FLOOR_HALF_EXTENTS[2]))
    if drawn and in_window:
        return int(floor)
    if drawn:
        for camera in cameras:
            camera.keep_background()
    client.changeVisualShape(floor, -1, rgbaColor=(0.0, 0.0, 0.0, 0.0))  # TinyRenderer skips what is transparent
    return int(floor)


def add_ball(client: Any, colour: tuple[float, ...], radius: float) -> int:
    """Add a ball that touches nothing, its radius in [m], and return its body."""
    shape = client.createVisualShape(pybullet.GEOM_SPHERE, radius=radius, rgbaColor=colour)
    return int(client.createMultiBody(baseVisualShapeIndex=shape))
