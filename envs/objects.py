"""Objects to pick up: boxes, cylinders and bottles in one Bullet client, and where they stand in an episode."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.bullet import pybullet
from sb3_stereo.envs.colours import COLOURS

Floats = NDArray[np.float64]
Pose = tuple[Any, Any]  # position (3,) in [m] and orientation (x, y, z, w)

SCALES = (0.85, 0.95, 1.05, 1.15)
MASS = 0.05  # [kg], an empty carton's or bottle's; a full one would pull the arm down within every control step
AWAY = -100.0  # [m], the height of what is not needed
AT_REST = (0.0, 0.0, 0.0)
INVISIBLE = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Part:
    """A box or an upright cylinder.

    Attributes:
        geometry: Bullet's number.
        radius: Of the cylinder, or half the width of the box, in [m].
        height: In [m].
        bottom: Height of its bottom above the object's, in [m].
    """

    geometry: int
    radius: float
    height: float
    bottom: float = 0.0


SHAPES = {
    "box": (Part(pybullet.GEOM_BOX, 0.040, 0.12),),
    "cylinder": (Part(pybullet.GEOM_CYLINDER, 0.042, 0.12),),
    "bottle": (Part(pybullet.GEOM_CYLINDER, 0.035, 0.13), Part(pybullet.GEOM_CYLINDER, 0.016, 0.05, 0.13)),
}


@dataclass(frozen=True)
class Model:
    """A shape in one size.

    Attributes:
        shape: Of `SHAPES`.
        scale: Of `SCALES`.
    """

    shape: str
    scale: float

    @property
    def height(self) -> float:
        """In [m]."""
        top = SHAPES[self.shape][-1]
        return self.scale * (top.bottom + top.height)

    @property
    def radius(self) -> float:
        """Of the circle around it, seen from above, in [m]."""
        part = SHAPES[self.shape][0]
        return self.scale * part.radius * (2**0.5 if part.geometry == pybullet.GEOM_BOX else 1.0)


MODELS = tuple(Model(shape, scale) for shape in SHAPES for scale in SCALES)


@dataclass(frozen=True)
class PlacedObject:
    """One object of an episode.

    Attributes:
        number: Of its model in `MODELS`.
        colour: Of `COLOURS`.
        place: Where it stands, (x, y) in [m], world.
        yaw: About the vertical, in [rad].
    """

    number: int
    colour: str
    place: tuple[float, float]
    yaw: float

    @property
    def model(self) -> Model:
        """What it is."""
        return MODELS[self.number]


class Objects:
    """One body of every model, made at once: a saved state must have the bodies of the world.

    Args:
        client: A `BulletClient`.
    """

    def __init__(self, client: Any) -> None:
        self._client = client
        self.bodies = [_add(client, number, model) for number, model in enumerate(MODELS)]
        self.placed: list[int] = []

    def place(self, items: Sequence[PlacedObject]) -> None:
        """Stand these upright on the floor, and put all others away."""
        wanted = {item.number: item for item in items}
        for number, body in enumerate(self.bodies):
            position, yaw = [float(number), 0.0, AWAY], 0.0
            if (item := wanted.get(number)) is not None:
                position, yaw = [*item.place, item.model.height / 2], item.yaw
            quaternion = pybullet.getQuaternionFromEuler((0.0, 0.0, yaw))
            self._client.resetBasePositionAndOrientation(body, position, quaternion)
        self.stop()
        self.show(items)

    def show(self, items: Sequence[PlacedObject]) -> None:
        """Draw these and no others; `place` does, a state of Bullet's does not."""
        colours = {item.number: (*COLOURS[item.colour], 1.0) for item in items}
        for number, body in enumerate(self.bodies):
            self._client.changeVisualShape(body, -1, rgbaColor=colours.get(number, INVISIBLE))
        self.placed = [self.bodies[item.number] for item in items]

    def stop(self) -> None:
        """Bring all to rest where they are."""
        for body in self.bodies:
            self._client.resetBaseVelocity(body, AT_REST, AT_REST)

    def pose(self, number: int) -> Pose:
        """Of the middle of the object of a model."""
        position, orientation = self._client.getBasePositionAndOrientation(self.bodies[number])
        return np.array(position), np.array(orientation)

    def pull(self, acceleration: float) -> None:
        """Let a vertical force, an acceleration in [m/s^2], act on what is placed in the next simulation step."""
        # Bullet's own functions, as in `Arm.push`.
        client = self._client.number
        for body in self.placed:
            middle, _ = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
            force = (0.0, 0.0, MASS * acceleration)
            pybullet.applyExternalForce(body, -1, force, middle, pybullet.WORLD_FRAME, physicsClientId=client)


def _add(client: Any, number: int, model: Model) -> int:
    """Add the body of a model, away from all others, and return it."""
    parts = [
        (part.geometry, *(model.scale * size for size in (part.radius, part.height, part.bottom)))
        for part in SHAPES[model.shape]
    ]
    middles = [[0.0, 0.0, bottom + height / 2 - model.height / 2] for _, _, height, bottom in parts]
    common = {
        "shapeTypes": [geometry for geometry, *_ in parts],
        "halfExtents": [[radius, radius, height / 2] for _, radius, height, _ in parts],
        "radii": [radius for _, radius, *_ in parts],
    }
    lengths = [height for _, _, height, _ in parts]
    solid = client.createCollisionShapeArray(**common, lengths=lengths, collisionFramePositions=middles)
    look = client.createVisualShapeArray(**common, lengths=lengths, visualFramePositions=middles)
    body = int(client.createMultiBody(MASS, solid, look, basePosition=(float(number), 0.0, AWAY)))
    client.changeDynamics(body, -1, linearDamping=0.0, angularDamping=0.0)
    return body
