"""An arm in Bullet: its specification, its poses, and pulses of effort."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files
from typing import Any

import numpy as np
import pybullet
from numpy.typing import ArrayLike, NDArray

Vector = tuple[float, float, float]
Floats = NDArray[np.float64]

LINK_ORIGIN, LINK_ORIENTATION = 4, 5  # of getLinkState: the URDF frame, not the centre of mass


@dataclass(frozen=True)
class ArmSpec:
    """What the task must know of a robot.

    Attributes:
        urdf: File in `envs/assets`, or any path.
        joints: The actuated joints' names, in the order of the action.
        end_effector_link: Link that carries the red marker.
        end_effector_offset: Middle of the marker in that link's frame, in [m].
        effort_limits: Effort of a full action per actuated joint, in [N m].
        damping: Viscous damping per actuated joint, in [N m s/rad].
        drive_inertia: Rotor inertia seen at a joint, in [kg m^2], as (link, about its x, y and z axis).
        collision_exempt: Pairs of links that may overlap.
        marker_radius: Of both markers, in [m].
    """

    urdf: str
    joints: tuple[str, ...]
    end_effector_link: str
    end_effector_offset: Vector
    effort_limits: tuple[float, ...]
    damping: tuple[float, ...]
    drive_inertia: tuple[tuple[str, Vector], ...] = ()
    collision_exempt: tuple[tuple[str, str], ...] = ()
    marker_radius: float = 0.07


WAM = ArmSpec(
    urdf="wam.urdf",
    joints=("J1", "J2", "J3", "J4"),
    end_effector_link="palm",
    end_effector_offset=(0.0, 0.0, 0.0609),  # d7, libbarrett
    # Chosen, not Barrett's: with this damping a full pulse of 0.5 s moves each joint by about a radian.
    effort_limits=(20.0, 30.0, 10.0, 5.0),
    damping=(8.0, 10.0, 4.0, 2.0),
    # Rotor inertia times the squared gear ratio (AC-02, Barrett's motor page).
    drive_inertia=(
        ("shoulder_yaw", (0.0, 0.0, 0.2052)),
        ("shoulder_pitch_drive", (0.0, 0.1888, 0.0)),
        ("upper_arm", (0.0, 0.0, 0.0669)),
        ("forearm", (0.0, 0.0346, 0.0)),
        ("wrist_yaw", (0.0, 0.0, 0.00323)),
        ("wrist_pitch", (0.0, 0.00323, 0.0)),
        ("palm", (0.0, 0.0, 0.000317)),
    ),
    # The palm's and the wrist's shapes overlap their neighbours' by construction.
    collision_exempt=(("forearm", "wrist_pitch"), ("forearm", "wrist_yaw"), ("shoulder_yaw", "upper_arm")),
)


class Arm:
    """An `ArmSpec` in one Bullet client, fixed to the world at the origin.

    Joints that are not actuated are held at 0.

    Args:
        spec: The robot.
        client: A `BulletClient`.
    """

    def __init__(self, spec: ArmSpec, client: Any) -> None:
        self.spec, self._client = spec, client
        self.body: int = _load(spec.urdf, client)
        infos = [client.getJointInfo(self.body, joint) for joint in range(client.getNumJoints(self.body))]
        self._links = {info[12].decode(): info[0] for info in infos}
        moving = {info[1].decode(): info for info in infos if info[2] != pybullet.JOINT_FIXED}
        for joint in spec.joints:
            _known("joint", joint, moving)
        for link in (spec.end_effector_link, *(link for link, _ in spec.drive_inertia)):
            _known("link", link, self._links)
        self._moving = [info[0] for info in moving.values()]
        self.actuated = [moving[joint][0] for joint in spec.joints]
        self._actuated_of_moving = [self._moving.index(joint) for joint in self.actuated]
        self._hand = self._links[spec.end_effector_link]
        self.limits: Floats = np.array([moving[joint][8:10] for joint in spec.joints])  # (n_joints, 2) [rad]
        self._set_up_joints(spec.damping)
        for link, inertia in spec.drive_inertia:
            self._add_inertia(self._links[link], np.array(inertia))
        for pair in spec.collision_exempt:
            client.setCollisionFilterPair(self.body, self.body, *(self._links[link] for link in pair), 0)

    def _set_up_joints(self, damping: Iterable[float]) -> None:
        client, body = self._client, self.body
        for link in range(-1, client.getNumJoints(body)):
            # Bullet damps free motion by default; only the joints' own damping is wanted.
            client.changeDynamics(body, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0)
        self.set_damping(damping)
        # Bullet's default motors would hold the joints against any effort.
        client.setJointMotorControlArray(
            body, self.actuated, pybullet.VELOCITY_CONTROL, forces=[0.0] * len(self.actuated)
        )
        held = [joint for joint in self._moving if joint not in self.actuated]
        if held:
            client.setJointMotorControlArray(
                body, held, pybullet.POSITION_CONTROL, targetPositions=[0.0] * len(held), forces=[100.0] * len(held)
            )

    def set_damping(self, damping: Iterable[float]) -> None:
        """Set the viscous damping of the actuated joints, in [N m s/rad]."""
        for joint, value in zip(self.actuated, damping, strict=True):
            self._client.changeDynamics(self.body, joint, jointDamping=value)

    def _add_inertia(self, link: int, inertia: Floats) -> None:
        """Add drive inertia, shape (3,), about a link's axes, as far as Bullet allows.

        Bullet has no armature; it keeps a diagonal tensor in the link's principal axes. The sum is exact about the
        joint's axis, and exact altogether where that axis is a principal one; elsewhere a little leaks into the
        others. (J2's axis is no principal axis of its link, so its drive has a massless link to itself.)
        """
        _, _, diagonal, _, orientation, *_ = self._client.getDynamicsInfo(self.body, link)
        principal = np.reshape(self._client.getMatrixFromQuaternion(orientation), (3, 3))
        axis = inertia / inertia.sum()
        share = (principal.T @ axis) ** 2
        added = inertia.sum() * share / np.sum(share**2)
        self._client.changeDynamics(self.body, link, localInertiaDiagonal=list(np.array(diagonal) + added))

    @property
    def joint_positions(self) -> Floats:
        """Of every moving joint, shape (n_moving,), in [rad]."""
        return np.array([state[0] for state in self._client.getJointStates(self.body, self._moving)])

    @property
    def end_effector_position(self) -> Floats:
        """Middle of the end effector's marker, shape (3,), in [m], world."""
        state = self._client.getLinkState(self.body, self._hand, computeForwardKinematics=True)
        return np.array(
            pybullet.multiplyTransforms(
                state[LINK_ORIGIN], state[LINK_ORIENTATION], self.spec.end_effector_offset, (0.0, 0.0, 0.0, 1.0)
            )[0]
        )

    def rest_at(self, positions: ArrayLike) -> None:
        """Put the actuated joints at `positions`, shape (n_joints,), in [rad], the others at 0, all at rest."""
        everywhere = np.zeros(len(self._moving))
        everywhere[self._actuated_of_moving] = positions
        self._client.resetJointStatesMultiDof(self.body, self._moving, everywhere[:, None].tolist())

    def brake(self) -> None:
        """Stop every joint where it is: an ideal brake."""
        self.rest_at(self.joint_positions[self._actuated_of_moving])

    def push(self, efforts: Sequence[float], n_steps: int) -> None:
        """Apply constant efforts to the actuated joints.

        Args:
            efforts: One per actuated joint, in [N m].
            n_steps: Simulation steps to apply them for; Bullet forgets an effort after each.
        """
        # Bullet's own functions: the client's wrapper around each costs a tenth of a simulation step.
        apply, step, client = pybullet.setJointMotorControlArray, pybullet.stepSimulation, self._client.number
        body, joints, torque = self.body, self.actuated, pybullet.TORQUE_CONTROL
        for _ in range(n_steps):
            apply(body, joints, torque, forces=efforts, physicsClientId=client)
            step(client)

    def collides(self) -> bool:
        """Whether the arm touches itself or anything else."""
        self._client.performCollisionDetection()
        return bool(self._client.getContactPoints(self.body))


def _load(urdf: str, client: Any) -> int:
    """Load a file of `envs/assets`, or any other, as a body fixed at the origin."""
    flags = (
        pybullet.URDF_USE_INERTIA_FROM_FILE
        | pybullet.URDF_USE_SELF_COLLISION
        | pybullet.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT
    )
    with as_file(files("sb3_stereo.envs") / "assets") as assets:
        path = assets / urdf  # an absolute path stays itself
        if not path.is_file():
            raise ValueError(f"no robot file '{urdf}'; give a URDF of sb3_stereo.envs/assets or an absolute path")
        return int(client.loadURDF(str(path), useFixedBase=True, flags=flags))


def _known(kind: str, name: str, names: Any) -> None:
    if name not in names:
        raise ValueError(f"unknown {kind} '{name}'; the robot's are {', '.join(names)}")
