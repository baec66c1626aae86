"""Suction: the cup of an arm holds what its lip touches, until it is switched off or overloaded."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.arm import Arm
from sb3_stereo.envs.bullet import pybullet

Floats = NDArray[np.float64]

BREAKING_FORCE = 30.0  # [N], of a cup of 4 cm at a quarter of an atmosphere
MAX_FORCE = 1000.0  # [N] or [N m] of the constraint: so much that it is broken before it gives
LIP = 0.005  # [m] from the lip's plane that still are the lip
TOUCHING = 0.001  # [m] between surfaces that touch
BODY, POINT, DISTANCE = 2, 6, 8  # of getContactPoints: the other's body, the point on it, the gap


@dataclass(frozen=True)
class Grip:
    """What is held.

    Attributes:
        body: Bullet's number.
        in_cup: Position (3,) in [m] and orientation (4,) of the point of contact in the cup's inertial frame.
        in_body: Likewise in the body's.
    """

    body: int
    in_cup: tuple[Any, Any]
    in_body: tuple[Any, Any]


class Suction:
    """The suction of one arm.

    Bullet's states hold no constraints: whoever restores one calls `hold` with the grip of that time, or `release`.

    Args:
        client: A `BulletClient`.
        arm: With a suction cup.
        bodies: All that it can ever hold.
        breaking_force: Pull or shear that tears off what is held, in [N].
    """

    def __init__(self, client: Any, arm: Arm, bodies: Sequence[int], breaking_force: float = BREAKING_FORCE) -> None:
        assert arm.cup is not None
        self._client, self._arm, self._cup, self._bodies = client, arm, arm.cup, bodies
        self._pass_through(None)
        self.breaking_force = breaking_force
        self.grip: Grip | None = None
        self._constraint = -1

    def act(self, on: bool) -> None:
        """What happens after a simulation step: grasp, keep hold, or let go.

        Args:
            on: Whether there is suction.
        """
        if not on:
            self.release()
        elif self.grip is None:
            self.hold(self._touched())
        elif self.load > self.breaking_force:
            self.release()

    @property
    def load(self) -> float:
        """Force that pulls what is held off the cup or aside, in [N]; what presses it on does not count."""
        if self.grip is None:
            return 0.0
        force = np.array(self._client.getConstraintState(self._constraint)[:3])
        _, axis = self._arm.cup_pose
        pull = float(force @ axis)
        return float(np.linalg.norm(force - min(pull, 0.0) * axis))

    def hold(self, grip: Grip | None) -> None:
        """Hold something, and nothing else; None for nothing."""
        self.release()
        if grip is None:
            return
        client, body, cup = self._client, self._arm.body, self._cup
        (place, turn), (place_of_body, turn_of_body) = grip.in_cup, grip.in_body
        here = (0.0, 0.0, 0.0)
        ends = body, cup, grip.body, -1
        self._constraint = client.createConstraint(
            *ends, pybullet.JOINT_FIXED, here, place, place_of_body, turn, turn_of_body
        )
        client.changeConstraint(self._constraint, maxForce=MAX_FORCE)
        self._pass_through(grip.body)
        self.grip = grip

    def release(self) -> None:
        """Let go of what is held, if anything is."""
        if self.grip is None:
            return
        self._client.removeConstraint(self._constraint)
        self._pass_through(None)
        self.grip = None

    def _pass_through(self, held: int | None) -> None:
        """Let the cup touch all but what it holds: a contact beside the constraint would take a share of the load.

        Every call gives the cup and the body new numbers in Bullet's broad phase, which decide whose surface a contact
        is computed on. So all are renumbered, in the same order each time.
        """
        for body in self._bodies:
            self._client.setCollisionFilterPair(self._arm.body, body, self._cup, -1, int(body != held))

    def _touched(self) -> Grip | None:
        """A grip of what the lip touches: the first of the nearest; None if it touches nothing."""
        client, arm = self._client, self._arm
        points = client.getContactPoints(arm.body, linkIndexA=self._cup)
        near = [point for point in points if point[BODY] in self._bodies and point[DISTANCE] <= TOUCHING]
        if not near:
            return None
        lip, axis = arm.cup_pose
        touched = [point for point in near if (np.array(point[POINT]) - lip) @ axis >= -LIP]
        if not touched:
            return None
        point = min(touched, key=lambda point: point[DISTANCE])
        state = client.getLinkState(arm.body, self._cup, computeForwardKinematics=True)
        world = point[POINT], (0.0, 0.0, 0.0, 1.0)
        position, orientation = client.getBasePositionAndOrientation(point[BODY])
        return Grip(point[BODY], _seen_from(state[0], state[1], world), _seen_from(position, orientation, world))


def _seen_from(position: Any, orientation: Any, pose: tuple[Any, Any]) -> tuple[Any, Any]:
    """A pose in the frame of another one."""
    back = pybullet.invertTransform(position, orientation)
    there: tuple[Any, Any] = pybullet.multiplyTransforms(*back, *pose)
    return there
