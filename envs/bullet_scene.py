"""The scene in Bullet: the floor, the balls that mark end effector and target, and things that belong to no task."""

from collections.abc import Sequence
from typing import Any

from sb3_stereo.envs.bullet import pybullet
from sb3_stereo.envs.bullet_camera import Camera
from sb3_stereo.envs.cameras import CameraSpec
from sb3_stereo.envs.clutter import AWAY, UPRIGHT, Item, Shape, shape_of, where_of
from sb3_stereo.envs.clutter_spec import ClutterSpec
from sb3_stereo.envs.scene import BLUE, FLOOR_HALF_EXTENTS, GRAVITY, GREY, RED, sphere
from sb3_stereo.envs.simulation import Client
from sb3_stereo.envs.simulators import Floats


class BulletScene:
    """What is around the arm in one Bullet client.

    Args:
        client: A `BulletClient`.
        ground: The floor, which is there before the arm.
        radii: Of the red and of the blue ball, in [m].
        hollow_target: Draw the inside of the blue one only.
        n_things: Of the clutter. They are made at once: a saved state must have the bodies of the world.
        clutter: What the arm works among, likewise; None for nothing.
    """

    def __init__(
        self,
        client: Any,
        ground: int,
        radii: tuple[float, float],
        hollow_target: bool,
        n_things: int,
        clutter: ClutterSpec | None,
    ) -> None:
        self._client, self.ground = client, ground
        add_target = add_hollow_ball if hollow_target else add_ball
        self.markers = add_ball(client, RED, radii[0]), add_target(client, BLUE, radii[1])
        self._things = [_add_thing(client, shape_of(number)) for number in range(n_things)]
        self.obstacles = [] if clutter is None else _add_obstacles(client, clutter)

    def camera(self, spec: CameraSpec) -> Camera:
        """A camera more."""
        return Camera(spec, self._client)

    def place(self, body: int, position: Floats) -> None:
        """Put a marker's middle at a position, (3,), in [m], world."""
        self._client.resetBasePositionAndOrientation(body, position.tolist(), UPRIGHT)

    def place_things(self, items: Sequence[Item], obstacles: Sequence[Item]) -> None:
        """Show these things and obstacles, and no others."""
        for bodies, shown in ((self._things, items), (self.obstacles, obstacles)):
            for body, (position, orientation, item) in zip(bodies, where_of(shown, len(bodies)), strict=True):
                self._client.resetBasePositionAndOrientation(body, position, orientation)
                if item is not None:
                    self._client.changeVisualShape(body, -1, rgbaColor=(*item.colour, 1.0))

    def move(self, obstacles: Sequence[Item]) -> None:
        """Put these obstacles where they are, and leave the others."""
        for one in obstacles:
            self._client.resetBasePositionAndOrientation(self.obstacles[one.number], one.position, one.orientation)


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
    points, triangles = sphere()
    shape = client.createVisualShape(
        pybullet.GEOM_MESH,
        vertices=(radius * points).tolist(),
        indices=triangles[:, ::-1].ravel().tolist(),  # in this order their fronts are inside
        normals=(-points).tolist(),
        uvs=[(0.0, 0.0)] * len(points),  # without them Bullet ignores the normals
        rgbaColor=colour,
    )
    return int(client.createMultiBody(baseVisualShapeIndex=shape))


def _add_thing(client: Any, shape: Shape) -> int:
    look = client.createVisualShape(**_bullet_shape(shape, "length"))
    return int(client.createMultiBody(baseVisualShapeIndex=look, basePosition=AWAY))


def _add_obstacles(client: Any, clutter: ClutterSpec) -> list[int]:
    """Bodies whose distance from the arm is known, whether it touches them or not."""
    bodies = []
    for number in range(clutter.n_things):
        shape = shape_of(number, clutter.size)
        look = client.createVisualShape(**_bullet_shape(shape, "length"))
        body = client.createMultiBody(0.0, client.createCollisionShape(**_bullet_shape(shape, "height")), look, AWAY)
        if not clutter.solid or number >= clutter.n_still:
            client.setCollisionFilterGroupMask(body, -1, 0, 0)
        bodies.append(int(body))
    return bodies


def _bullet_shape(shape: Shape, length: str) -> dict[str, Any]:
    """Bullet's arguments; a cylinder's `length` has another name where it is seen and where it collides."""
    kind, across, height = shape
    shapes: dict[str, dict[str, Any]] = {
        "box": {"shapeType": pybullet.GEOM_BOX, "halfExtents": (across, across, height)},
        "cylinder": {"shapeType": pybullet.GEOM_CYLINDER, "radius": across, length: 2 * height},
        "sphere": {"shapeType": pybullet.GEOM_SPHERE, "radius": across},
    }
    return shapes[kind]
