"""An arm in Bullet: its poses, and pulses of effort."""

import math
import os
from collections.abc import Callable, Iterable, Sequence
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
import pybullet
import pybullet_data
from numpy.typing import NDArray

from sb3_stereo.envs.robots import ArmSpec
from sb3_stereo.envs.specs import quoted, require, require_known, require_readable

Floats = NDArray[np.float64]

MAX_LIMIT = 1000.0  # [rad] or [m], of a joint's position
HOLDING_EFFORT = 100.0  # [N m], of a joint that is not actuated
PARENT = 16  # of getJointInfo
LINK_ORIGIN, LINK_ORIENTATION = 4, 5  # of getLinkState: the URDF frame, not the centre of mass


class Arm:
    """An `ArmSpec` in one Bullet client, fixed to the world.

    Args:
        spec: The robot.
        client: A `BulletClient`.
    """

    def __init__(self, spec: ArmSpec, client: Any) -> None:
        self.spec, self._client = spec, client
        self.body = _load(spec, client)
        infos = [client.getJointInfo(self.body, joint) for joint in range(client.getNumJoints(self.body))]
        self._links = {info[12].decode(): info[0] for info in infos}
        self._names = {-1: client.getBodyInfo(self.body)[0].decode()} | {i: name for name, i in self._links.items()}
        moving = {info[1].decode(): info for info in infos if info[2] != pybullet.JOINT_FIXED}
        self.fixed_links: list[int] = []  # to the base, which itself is not among them
        for info in infos:
            if info[2] == pybullet.JOINT_FIXED and info[PARENT] in (-1, *self.fixed_links):
                self.fixed_links.append(info[0])
        self._check_names(moving)
        self._check_motion(list(moving.values()))
        self._moving = [info[0] for info in moving.values()]
        self.actuated = [moving[joint][0] for joint in spec.joints]
        self._actuated_of_moving = [self._moving.index(joint) for joint in self.actuated]
        rest = dict(spec.rest)
        self._rest = [(rest.get(joint, 0.0),) for joint in moving]  # as Bullet takes them
        self._hand = self._links[spec.end_effector_link]
        self.limits: Floats = np.array([_limits(moving[joint]) for joint in spec.joints])  # (n_joints, 2) [rad]
        self._set_up_joints(spec.damping)
        for link, inertia in spec.drive_inertia:
            self._add_inertia(self._links[link], np.array(inertia))
        links = {name: link for link, name in self._names.items()}
        for pair in spec.collision_exempt:
            client.setCollisionFilterPair(self.body, self.body, *(links[link] for link in pair), 0)
        for link, color in spec.link_colors:
            client.changeVisualShape(self.body, links[link], rgbaColor=(*color, 1.0))

    def _check_names(self, joints: Iterable[str]) -> None:
        spec = self.spec
        for joint in (*spec.joints, *dict(spec.rest)):
            require_known("joint", joint, joints, "the robot's moving ones")
        for link in (spec.end_effector_link, *dict(spec.drive_inertia)):
            require_known("link", link, self._links, "the robot's moving ones")
        for link in (*(link for pair in spec.collision_exempt for link in pair), *dict(spec.link_colors)):
            require_known("link", link, self._names.values(), "the robot's")

    def _check_motion(self, moving: Sequence[Any]) -> None:
        """Raise a ValueError if the file's numbers would make poses of NaN."""
        file, names = quoted(self.spec.urdf), [info[1].decode() for info in moving]
        for name, info in zip(names, moving, strict=True):
            simple = info[2] in (pybullet.JOINT_REVOLUTE, pybullet.JOINT_PRISMATIC)
            require(simple, f"joint '{name}' of {file} neither turns nor slides; use revolute and prismatic joints")
            far = max(map(abs, _limits(info)))
            require(far <= MAX_LIMIT, f"joint '{name}' of {file} has a limit of {far}; give at most {MAX_LIMIT:.0f}")
        require(
            self._moves(len(moving)), f"{file} has a mass, an inertia, an origin or an axis of no robot; check them"
        )

    def _moves(self, n_moving: int) -> bool:
        """Whether every link is somewhere, and the mass matrix positive definite."""
        client, links = self._client, list(range(self._client.getNumJoints(self.body)))
        states = client.getLinkStates(self.body, links, computeForwardKinematics=True)
        try:
            mass = np.array(client.calculateMassMatrix(self.body, [0.0] * n_moving))
        except SystemError:  # PyBullet's, in place of its own error
            return False
        finite = np.isfinite([state[LINK_ORIGIN] for state in states]).all() and np.isfinite(mass).all()
        return bool(finite and np.linalg.eigvalsh(mass).min() > 0.0)

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
            targets = [self._rest[self._moving.index(joint)][0] for joint in held]
            client.setJointMotorControlArray(
                body, held, pybullet.POSITION_CONTROL, targetPositions=targets, forces=[HOLDING_EFFORT] * len(held)
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
    def actuated_positions(self) -> Floats:
        """Of the actuated joints, shape (n_joints,), in [rad]."""
        return self.joint_positions[self._actuated_of_moving]

    @property
    def chain_positions(self) -> Floats:
        """Origins of the frames of the links from the end effector's back to the base's, (n_links, 3), [m], world."""
        chain = [self._hand]
        while (parent := self._client.getJointInfo(self.body, chain[-1])[PARENT]) >= 0:
            chain.append(parent)
        states = self._client.getLinkStates(self.body, chain, computeForwardKinematics=True)
        return np.array([state[LINK_ORIGIN] for state in states])

    @property
    def end_effector_position(self) -> Floats:
        """Middle of the end effector's marker, shape (3,), in [m], world."""
        state = self._client.getLinkState(self.body, self._hand, computeForwardKinematics=True)
        return np.array(
            pybullet.multiplyTransforms(
                state[LINK_ORIGIN], state[LINK_ORIENTATION], self.spec.end_effector_offset, (0.0, 0.0, 0.0, 1.0)
            )[0]
        )

    def rest_at(self, positions: Iterable[float]) -> None:
        """Put the actuated joints at `positions`, one each, in [rad], the others at `rest`, all still."""
        everywhere = self._rest.copy()
        for index, position in zip(self._actuated_of_moving, positions, strict=True):
            everywhere[index] = (position,)
        self._client.resetJointStatesMultiDof(self.body, self._moving, everywhere)

    def brake(self) -> None:
        """Stop every joint where it is: an ideal brake."""
        self.rest_at([state[0] for state in self._client.getJointStates(self.body, self.actuated)])

    def push(
        self,
        efforts: Sequence[float],
        n_steps: int,
        on_part: Callable[[int], object] | None = None,
        n_parts: int = 1,
    ) -> None:
        """Apply constant efforts to the actuated joints.

        Args:
            efforts: One per actuated joint, in [N m].
            n_steps: Simulation steps to apply them for; Bullet forgets an effort after each.
            on_part: Called between the parts of the pulse with the number of parts done; the motion stays the same.
            n_parts: Equal parts of a pulse, to a simulation step.
        """
        # Bullet's own functions: the client's wrapper around each costs a tenth of a simulation step.
        apply, step, client = pybullet.setJointMotorControlArray, pybullet.stepSimulation, self._client.number
        body, joints, torque = self.body, self.actuated, pybullet.TORQUE_CONTROL
        for part in range(n_parts):
            if part and on_part:
                on_part(part)
            for _ in range(n_steps * part // n_parts, n_steps * (part + 1) // n_parts):
                apply(body, joints, torque, forces=efforts, physicsClientId=client)
                step(client)

    def contacts(self) -> set[str]:
        """What touches: two of the arm's links, or a link and what is not of the arm."""
        self._client.performCollisionDetection()
        points = self._client.getContactPoints(self.body)
        return {
            " and ".join(sorted(self._names[link] if body == self.body else "the floor" for body, link in pair))
            for pair in {((p[1], p[3]), (p[2], p[4])) for p in points}
        }

    def collides(self) -> bool:
        """Whether the arm touches itself or anything else."""
        self._client.performCollisionDetection()
        return bool(self._client.getContactPoints(self.body))


def _limits(info: Sequence[Any]) -> tuple[float, float]:
    """Lower and upper limit of a joint's `getJointInfo`; a turn for a joint without limits."""
    low, high = info[8:10]
    return (low, high) if low < high else (-math.pi, math.pi)


def _load(spec: ArmSpec, client: Any) -> int:
    """Load a robot as a body fixed at its base."""
    flags = (
        pybullet.URDF_USE_INERTIA_FROM_FILE
        | pybullet.URDF_USE_SELF_COLLISION
        | pybullet.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT
        | (pybullet.URDF_IGNORE_VISUAL_SHAPES if spec.simple_shapes else 0)
    )
    with as_file(files("sb3_stereo.envs") / "assets") as assets:
        places = assets, Path(pybullet_data.getDataPath()), Path()
        paths = [str(place / spec.urdf) for place in places]  # a full path stays itself
        found = next(filter(os.path.isfile, paths), spec.urdf)
        require_readable(found, "robot", "give a path, or a URDF of envs/assets or of pybullet_data")
        try:
            return int(client.loadURDF(found, spec.base_position, useFixedBase=True, flags=flags))
        except pybullet.error as error:
            refusal = f"Bullet cannot load {quoted(spec.urdf)} ({error}); check it and the meshes it names"
            raise ValueError(refusal) from error
