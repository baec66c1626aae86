"""The simulated world of picking up: an arm with a suction cup, and objects that have weight."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sb3_stereo.envs.arm import Arm
from sb3_stereo.envs.bullet import pybullet
from sb3_stereo.envs.bullet_world import BulletWorld
from sb3_stereo.envs.capture import CameraRig, Floats
from sb3_stereo.envs.clutter import Item
from sb3_stereo.envs.objects import Objects, PlacedObject
from sb3_stereo.envs.pick_rig import PickRig
from sb3_stereo.envs.scene import GRAVITY
from sb3_stereo.envs.suction import Suction

UP = np.array([0.0, 0.0, 1.0])
NOWHERE, UPRIGHT = -1000.0, (0.0, 0.0, 0.0, 1.0)  # [m], the height at which nothing is


@dataclass(eq=False)
class PickWorld(BulletWorld):
    """A `World` in which objects stand, and are held by suction.

    Bullet's states hold neither constraints nor colours. Both are kept beside them, and made anew from the same numbers
    when a state is restored; a constraint between multibodies carries nothing from one simulation step to the next.

    Args:
        items: The objects of this episode, the target first; see `arrange`.
    """

    items: tuple[PlacedObject, ...] = ()

    def __post_init__(self) -> None:
        self.sucking = False
        super().__post_init__()
        self.cupped_arm.step = self._step
        self._weigh()
        if self.items:
            self.arrange(self.items)

    def _make_rig(self) -> CameraRig:
        self._client.removeBody(self._scene.markers[1])  # the ball that marks a place to reach
        self.objects = Objects(self._client)
        self.suction = Suction(self._client, self.cupped_arm, self.objects.bodies)
        self.cupped_arm.other_bodies = {body: "an object" for body in self.objects.bodies}
        self._rig = PickRig(self._scene, self.cameras, self.cupped_arm, self.objects)
        return self._rig

    @property
    def cupped_arm(self) -> Arm:
        """The arm, which is Bullet's."""
        assert isinstance(self.arm, Arm)
        return self.arm

    def arrange(self, items: tuple[PlacedObject, ...]) -> None:
        """Stand these objects on the floor, the target first. Where the arm is is then that of no pose: place it."""
        self.suction.release()
        self.items = items
        self._client.restoreState(self._start)
        self.objects.place(items)
        self._rig.aim_at(items[0])
        self._client.removeState(self._start)
        self._start = self._client.saveState()

    def _begin_with(self, items: Sequence[Item], obstacles: Sequence[Item]) -> None:
        super()._begin_with(items, obstacles)
        self._weigh()
        if self.items:
            self.arrange(self.items)

    def place_arm(self, positions: Any) -> bool:
        """As in `World`, with the objects where they stood at first, and none of them held."""
        self.suction.release()
        return super().place_arm(positions)

    def begin_step(self, suction: bool) -> None:
        """Prepare a control step, with suction or without."""
        self.sucking = suction
        self.forget_contacts()

    def forget_contacts(self) -> None:
        """Let what comes next depend on where bodies are and how they move, and on nothing before.

        Bullet goes on with the contact points of two bodies as long as their bounding boxes overlap, and a state of its
        does not bring all of that back (measured: 0.1 mm after three steps). So all are moved apart for a moment.
        """
        client, bodies = self._client, [self._ground, *self.objects.placed]
        poses = [client.getBasePositionAndOrientation(body) for body in bodies]
        speeds = [client.getBaseVelocity(body) for body in bodies]
        for number, body in enumerate(bodies):
            client.resetBasePositionAndOrientation(body, (0.0, 0.0, NOWHERE * (1 + number)), UPRIGHT)
        client.performCollisionDetection()
        for body, pose, speed in zip(bodies, poses, speeds, strict=True):
            client.resetBasePositionAndOrientation(body, *pose)
            client.resetBaseVelocity(body, *speed)

    @property
    def target_position(self) -> Floats:
        """Middle of the target, shape (3,), in [m], world."""
        position: Floats = self.objects.pose(self.items[0].number)[0]
        return position

    @property
    def target_top(self) -> Floats:
        """Middle of the target's upper side while it is upright, shape (3,), in [m], world."""
        return self.target_position + self.items[0].model.height / 2 * UP

    @property
    def holds_target(self) -> bool:
        """Whether the target is held."""
        grip = self.suction.grip
        return grip is not None and grip.body == self.objects.bodies[self.items[0].number]

    def _weigh(self) -> None:
        """Find what the objects lack of their weight: compensating the arm's takes gravity from the whole world."""
        gravity = self._client.getPhysicsEngineParameters()["gravityAccelerationZ"]
        self._missing = GRAVITY[2] - gravity

    def _step(self, client: int) -> None:
        """One simulation step, in place of Bullet's own."""
        if self._missing:
            self.objects.pull(self._missing)
        pybullet.stepSimulation(client)
        self.suction.act(self.sucking)

    # ------------------------------------------------------------------------------------------------ states
    def _beside(self) -> Any:
        return super()._beside(), self.items, self.suction.grip

    def _go_back(self, state: int, beside: Any) -> None:
        episode, self.items, grip = beside
        self.suction.release()
        super()._go_back(state, episode)
        if self.items:
            self.objects.show(self.items)
            self._rig.aim_at(self.items[0])
        self.suction.hold(grip)

    def __getstate__(self) -> dict[str, Any]:
        return super().__getstate__() | {"grip": self.suction.grip}

    def __setstate__(self, state: dict[str, Any]) -> None:
        grip = state.pop("grip")
        super().__setstate__(state)
        self.suction.hold(grip)
