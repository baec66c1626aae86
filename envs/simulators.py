"""What the task needs of a simulator, and the simulators that there are.

`World` conducts an arm, cameras and a scene; a simulator brings its own of the three, and a subclass of `World`.
"""

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.joints import Joints
from sb3_stereo.envs.light import Light
from sb3_stereo.envs.specs import require_known

if TYPE_CHECKING:
    from sb3_stereo.envs.cameras import CameraSpec
    from sb3_stereo.envs.robots import ArmSpec
    from sb3_stereo.envs.world import World

Floats = NDArray[np.float64]
Frame = NDArray[np.uint8]

# The modules are loaded when they are needed, so that no simulator needs another's package.
_WORLDS = {"bullet": "bullet_world:BulletWorld", "mujoco": "mujoco_world:MujocoWorld"}
SIMULATORS = tuple(_WORLDS)


def world_class(simulator: str) -> "type[World]":
    """Return the `World` of a simulator.

    Raises:
        ValueError: If there is no such simulator.
        ImportError: If its package is missing.
    """
    require_known("simulator", simulator, SIMULATORS, "simulators")
    module, name = _WORLDS[simulator].split(":")
    found: type[World] = getattr(import_module(f"sb3_stereo.envs.{module}"), name)
    return found


class SimulatedArm(Protocol):
    """An `ArmSpec` in a simulator. Angles are in [rad], of sliding joints in [m]; efforts in [N m] or [N]."""

    spec: "ArmSpec"
    joints: Joints
    limits: Floats  # of the actuated joints, (n_joints, 2)

    @property
    def n_links(self) -> int:
        """Links besides the base."""

    @property
    def base_to_world(self) -> Floats:
        """Rotation of the base, (3, 3)."""

    @property
    def joint_positions(self) -> Floats:
        """Of every moving joint, (n_moving,)."""

    @property
    def actuated_positions(self) -> Floats:
        """Of the actuated joints, (n_joints,)."""

    @property
    def chain_positions(self) -> Floats:
        """Origins of the frames of the links from the end effector's back to the base's, (n_links, 3), [m], world."""

    @property
    def end_effector_position(self) -> Floats:
        """Middle of the end effector's marker, (3,), in [m], world."""

    def rest_at(self, positions: Iterable[float]) -> None:
        """Put the actuated joints at `positions` without any speed, the others where they follow or rest."""

    def brake(self) -> None:
        """Stop every joint where it is."""

    def push(
        self,
        efforts: Sequence[float],
        n_steps: int,
        on_part: Callable[[int], object] | None = None,
        n_parts: int = 1,
    ) -> None:
        """Apply constant efforts for `n_steps` simulation steps; call `on_part(part)` between equal parts of them."""

    def as_it_was(self) -> AbstractContextManager[None]:
        """Put the joints back afterwards."""

    def collides(self) -> bool:
        """Whether the arm touches itself or anything else."""

    def contacts(self) -> set[str]:
        """What touches: two of the arm's links, or a link and what is not of the arm."""

    def contacts_at(self, poses: Floats) -> list[set[str]]:
        """What touches in each of these poses, (n_poses, n_joints); the arm is left in the last."""

    @property
    def solid(self) -> bool:
        """Whether anything that moves has a collision shape."""

    def without_shapes(self) -> list[str]:
        """Names of the links that move and are drawn, and have no collision shape."""

    def set_damping(self, damping: Iterable[float]) -> None:
        """Set the viscous damping of the actuated joints, in [N m s/rad]."""

    def set_friction(self, friction: Iterable[float]) -> None:
        """Set the dry friction of the actuated joints, in [N m]."""

    def scale_masses(self, factors: Iterable[float]) -> None:
        """Scale masses and inertias of the links, (n_links,), from what they are at first. Set the damping after it."""

    def paint(self, colours: Floats, shares: Floats) -> None:
        """Mix the colours of base and links with others, (n_links + 1, 3) from 0 to 1, in shares (n_links + 1,)."""


class SimulatedCamera(Protocol):
    """A `CameraSpec` in a simulator, drawn by its renderer."""

    spec: "CameraSpec"

    def aim(self, spec: "CameraSpec", light: Light) -> None:
        """Look from elsewhere, in another light."""

    def draw(self) -> tuple[Frame, NDArray[np.float32], NDArray[np.int32]]:
        """Draw the bodies: colour (height, width, 4) RGBA, depth and body ids (height, width)."""

    def frame(self) -> Frame:
        """The picture that is an observation's, RGBA, shape (height, width, 4), uint8."""


class SimulatedScene(Protocol):
    """What is around the arm: the floor, and the two balls that mark end effector and target."""

    ground: int  # the floor's body id, as `SimulatedCamera.draw` has it
    markers: tuple[int, int]  # likewise of the red and of the blue ball

    def camera(self, spec: "CameraSpec") -> SimulatedCamera:
        """A camera more."""

    def place(self, body: int, position: Floats) -> None:
        """Put a marker's middle at a position, (3,), in [m], world."""


State = Any  # of a simulator, as it keeps it
