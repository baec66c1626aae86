"""The scene around the arm: the simulated world, its floor, and the balls that mark end effector and target."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.bullet import pybullet
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
    paint_floor(client, floor, None)
    return int(floor)


def paint_floor(client: Any, floor: int, colour: Sequence[float] | None) -> None:
    """Draw the floor in a colour, (3,) from 0 to 1, or with None not at all: TinyRenderer skips what is transparent."""
    client.changeVisualShape(floor, -1, rgbaColor=(0.0, 0.0, 0.0, 0.0) if colour is None else (*colour, 1.0))


def add_ball(client: Any, colour: tuple[float, ...], radius: float) -> int:
    """Add a ball that touches nothing, its radius in [m], and return its body."""
    shape = client.createVisualShape(pybullet.GEOM_SPHERE, radius=radius, rgbaColor=colour)
    return int(client.createMultiBody(baseVisualShapeIndex=shape))


def add_hollow_ball(client: Any, colour: tuple[float, ...], radius: float) -> int:
    """Add a ball of which only the inside is drawn: TinyRenderer skips what it would see from behind.

    Its image is that of a ball with what is within it, or in front of its far side, drawn over it. It touches nothing.

    Args:
        client: Where it is added.
        colour: RGBA, from 0 to 1.
        radius: In [m].

    Returns:
        The body.
    """
    points, triangles = _sphere()
    shape = client.createVisualShape(
        pybullet.GEOM_MESH,
        vertices=(radius * points).tolist(),
        indices=triangles[:, ::-1].ravel().tolist(),  # in this order their fronts are inside
        normals=(-points).tolist(),
        uvs=[(0.0, 0.0)] * len(points),  # without them Bullet ignores the normals
        rgbaColor=colour,
    )
    return int(client.createMultiBody(baseVisualShapeIndex=shape))


def _sphere(n_parallels: int = 16, n_meridians: int = 32) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
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
