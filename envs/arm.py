"""An arm in Bullet: its poses, and control steps of constant joint torque."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.bullet import pybullet
from sb3_stereo.envs.bullet_urdf import bullet_says, load_urdf
from sb3_stereo.envs.damping import MAX_EXPLICIT_LOSS, ImplicitDamping, JointSpace, explicit_loss
from sb3_stereo.envs.joints import MovingJoint, make_joints
from sb3_stereo.envs.robots import ArmSpec
from sb3_stereo.envs.specs import quoted, require, require_known
from sb3_stereo.envs.suction_cup import CUP_LINK, with_suction_cup
from sb3_stereo.envs.urdf import mimics, read_urdf, urdf_path, without_inertia

Floats = NDArray[np.float64]

MAX_LIMIT = 1000.0  # [rad] or [m], of a joint's position
HOLDING_EFFORT = 100.0  # [N m], of a joint that is not actuated
GEAR_EFFORT = 1e4  # [N m], between a joint and what mimics it
N_POSES = 32  # random ones, whose inertia decides how damping is integrated
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
        self.other_bodies: dict[int, str] = {}  # names of what is neither the arm nor the floor, for messages
        self.step = pybullet.stepSimulation  # with the client's number; a task with bodies of its own does more
        with urdf_path(spec.urdf) as path:
            robot = read_urdf(path)
            with with_suction_cup(spec, path, robot) as extended:
                self.body = load_urdf(client, extended, spec.base_position, spec.base_quaternion, _flags(spec))
        infos = [client.getJointInfo(self.body, joint) for joint in range(client.getNumJoints(self.body))]
        self._links = {info[12].decode(): info[0] for info in infos}
        self._names = {-1: client.getBodyInfo(self.body)[0].decode()} | {i: name for name, i in self._links.items()}
        moving = {info[1].decode(): info for info in infos if info[2] != pybullet.JOINT_FIXED}
        self.fixed_links: list[int] = []  # to the base, which itself is not among them
        for info in infos:
            if info[2] == pybullet.JOINT_FIXED and info[PARENT] in (-1, *self.fixed_links):
                self.fixed_links.append(info[0])
        self._check_names(moving)
        massless = [name for name in without_inertia(robot) if name in self._links]
        for name in massless:  # Bullet would give each 1 kg and 1 kg m^2; a frame at the tool weighs nothing
            client.changeDynamics(self.body, self._links[name], mass=0.0, localInertiaDiagonal=(0.0, 0.0, 0.0))
        self._check_motion(list(moving.values()), massless)
        self.cup = self._links.get(CUP_LINK)  # the link's number; None without a suction cup
        joints = {
            name: MovingJoint(info[0], info[8], info[9], info[2] == pybullet.JOINT_PRISMATIC)
            for name, info in moving.items()
        }
        self.joints = make_joints(spec, joints, mimics(robot, path))
        self.actuated, self.limits = self.joints.actuated, self.joints.limits
        self._moving, self._actuated_of_moving = self.joints.moving, self.joints.actuated_of_moving
        self._hand = self._links[spec.end_effector_link]
        self._set_up_joints()
        if self.cup is not None:  # it touches what is not of the arm alone
            for link in self._names:
                client.setCollisionFilterPair(self.body, self.body, link, self.cup, 0)
        self._drives = [
            (self._links[link], self._add_inertia(self._links[link], np.array(inertia)))
            for link, inertia in spec.drive_inertia
        ]
        self.set_damping(spec.damping)
        links = {name: link for link, name in self._names.items()}
        for pair in spec.collision_exempt:
            client.setCollisionFilterPair(self.body, self.body, *(links[link] for link in pair), 0)
        for link, color in spec.link_colors:
            client.changeVisualShape(self.body, links[link], rgbaColor=(*color, 1.0))
        dynamics = [client.getDynamicsInfo(self.body, link) for link in self._links.values()]
        self._masses = [(info[0], info[2]) for info in dynamics]

    @cached_property
    def _colours(self) -> dict[int, list[tuple[Any, int]]]:
        """The colours of every link's shapes, and the numbers of these, as they are at first."""
        colours: dict[int, list[tuple[Any, int]]] = {}
        for shape in self._client.getVisualShapeData(self.body):
            colours.setdefault(shape[1], []).append((shape[7], len(colours.get(shape[1], ()))))
        return colours

    @property
    def n_links(self) -> int:
        """Links besides the base."""
        return len(self._links)

    def _check_names(self, joints: Iterable[str]) -> None:
        spec = self.spec
        for joint in (*spec.joints, *dict(spec.rest)):
            require_known("joint", joint, joints, "the robot's moving ones")
        for link in (spec.end_effector_link, *dict(spec.drive_inertia)):
            require_known("link", link, self._links, "the robot's moving ones")
        for link in (*(link for pair in spec.collision_exempt for link in pair), *dict(spec.link_colors)):
            require_known("link", link, self._names.values(), "the robot's")

    def _check_motion(self, moving: Sequence[Any], massless: Sequence[str]) -> None:
        """Raise a ValueError if the file's numbers would make poses of NaN."""
        file, names = quoted(self.spec.urdf), [info[1].decode() for info in moving]
        for name, info in zip(names, moving, strict=True):
            simple = info[2] in (pybullet.JOINT_REVOLUTE, pybullet.JOINT_PRISMATIC)
            require(simple, f"joint '{name}' of {file} neither turns nor slides; use revolute and prismatic joints")
            far = max(map(abs, info[8:10])) if info[8] < info[9] else 0.0
            require(far <= MAX_LIMIT, f"joint '{name}' of {file} has a limit of {far}; give at most {MAX_LIMIT:.0f}")
        frames = f" (no <inertial>: {', '.join(massless)})" if massless else ""
        wrong = f"{file} has a mass{frames}, an inertia, an origin or an axis of no robot; check them"
        require(self._moves(len(moving)), wrong)

    def _moves(self, n_moving: int) -> bool:
        """Whether every link is somewhere, and the mass matrix positive definite."""
        client, links = self._client, list(range(self._client.getNumJoints(self.body)))
        states = client.getLinkStates(self.body, links, computeForwardKinematics=True)
        try:
            with bullet_says():  # the reason, over four lines
                mass = np.array(client.calculateMassMatrix(self.body, [0.0] * n_moving))
        except SystemError:  # PyBullet's, in place of its own error
            return False
        finite = np.isfinite([state[LINK_ORIGIN] for state in states]).all() and np.isfinite(mass).all()
        return bool(finite and np.linalg.eigvalsh(mass).min() > 0.0)

    def _set_up_joints(self) -> None:
        client, body, joints = self._client, self.body, self.joints
        for link in range(-1, client.getNumJoints(body)):
            # Bullet damps free motion by default; only the joints' own damping is wanted.
            client.changeDynamics(body, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0)
        # Bullet's default motors would hold the joints against any effort.
        free = [*self.actuated, *(joint for joint, _, _ in joints.geared)]
        client.setJointMotorControlArray(body, free, pybullet.VELOCITY_CONTROL, forces=[0.0] * len(free))
        if held := joints.held:
            targets = [float(joints.offsets[joints.moving.index(joint)]) for joint in held]
            client.setJointMotorControlArray(
                body, held, pybullet.POSITION_CONTROL, targetPositions=targets, forces=[HOLDING_EFFORT] * len(held)
            )
        for joint, leader, mimic in joints.geared:
            here = (0.0, 0.0, 0.0)
            gear = client.createConstraint(body, joint, body, leader, pybullet.JOINT_GEAR, here, here, here)
            target, ratio = mimic.offset, -mimic.multiplier  # of Bullet, whose sum of both speeds is 0
            client.changeConstraint(gear, gearRatio=ratio, relativePositionTarget=target, erp=1, maxForce=GEAR_EFFORT)

    def set_damping(self, damping: Iterable[float]) -> None:
        """Set the viscous damping of the actuated joints, in [N m s/rad].

        Bullet applies it where that is stable at the client's time step in all of `N_POSES` poses.
        """
        values = np.array(list(damping), dtype=np.float64)
        step = self._client.getPhysicsEngineParameters()["fixedTimeStep"]
        space = JointSpace(self._client, self.body, self._moving, self.joints.gearing, self._drives)
        explicit = not values.any() or self._largest_loss(space, values, step) <= MAX_EXPLICIT_LOSS
        implicit = ImplicitDamping(space, self._actuated_of_moving, self.joints.stops, values, step)
        self._damping = None if explicit else implicit
        for joint, value in zip(self.actuated, values, strict=True):
            self._client.changeDynamics(self.body, joint, jointDamping=value if explicit else 0.0)

    def set_friction(self, friction: Iterable[float]) -> None:
        """Set the dry friction of the actuated joints, in [N m]: a motor that can hold them with so much."""
        self._client.setJointMotorControlArray(
            self.body, self.actuated, pybullet.VELOCITY_CONTROL, forces=list(friction)
        )

    def scale_masses(self, factors: Iterable[float]) -> None:
        """Scale masses and inertias of the links, (n_links,), from what they are at first. Set the damping after it."""
        for link, (mass, inertia), factor in zip(self._links.values(), self._masses, factors, strict=True):
            diagonal = [factor * moment for moment in inertia]
            self._client.changeDynamics(self.body, link, mass=factor * mass, localInertiaDiagonal=diagonal)

    def paint(self, colours: Floats, shares: Floats) -> None:
        """Mix the colours of base and links with others, (n_links + 1, 3) from 0 to 1, in shares (n_links + 1,)."""
        for link, colour, share in zip(self._names, colours, shares, strict=True):
            for own, shape in self._colours.get(link, ()):
                mixed = (1.0 - share) * np.array(own[:3]) + share * colour
                self._client.changeVisualShape(self.body, link, shape, rgbaColor=(*mixed, own[3]))

    def _largest_loss(self, space: JointSpace, damping: Floats, step: float) -> float:
        """Of the speed in one step of Bullet's damping, over random poses."""
        low, high = self.limits.T
        poses = np.random.default_rng(0).uniform(low, high, (N_POSES, len(low)))
        with self.as_it_was():
            return max(explicit_loss(self._inertia(space, pose), damping, step) for pose in poses)

    def _inertia(self, space: JointSpace, pose: Floats) -> Floats:
        self.rest_at(pose)
        return space.inertia(space.state()[0])

    @contextmanager
    def as_it_was(self) -> Iterator[None]:
        """Put the joints back afterwards."""
        states = self._client.getJointStates(self.body, self._moving)
        try:
            yield
        finally:
            positions, speeds = ([(state[i],) for state in states] for i in (0, 1))
            self._client.resetJointStatesMultiDof(self.body, self._moving, positions, targetVelocities=speeds)

    def _add_inertia(self, link: int, inertia: Floats) -> Floats:
        """Add drive inertia, shape (3,), about a link's axes, as far as Bullet allows.

        Bullet has no armature; it keeps a diagonal tensor in the link's principal axes. The sum is exact about the
        joint's axis, and exact altogether where that axis is a principal one; elsewhere a little leaks into the
        others. (J2's axis is no principal axis of its link, so its drive has a massless link to itself.)

        Returns:
            What is added about the principal axes, shape (3,).
        """
        _, _, diagonal, _, orientation, *_ = self._client.getDynamicsInfo(self.body, link)
        principal = np.reshape(self._client.getMatrixFromQuaternion(orientation), (3, 3))
        axis = inertia / inertia.sum()
        share = (principal.T @ axis) ** 2
        added = inertia.sum() * share / np.sum(share**2)
        self._client.changeDynamics(self.body, link, localInertiaDiagonal=list(np.array(diagonal) + added))
        return np.asarray(added)

    @property
    def base_to_world(self) -> Floats:
        """Rotation of the base, shape (3, 3)."""
        return np.reshape(self._client.getMatrixFromQuaternion(self.spec.base_quaternion), (3, 3))

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

    @property
    def cup_pose(self) -> tuple[Floats, Floats]:
        """Middle of the suction cup's lip, (3,) in [m], and the direction that it points in, (3,), both world."""
        state = self._client.getLinkState(self.body, self.cup, computeForwardKinematics=True)
        turn = np.reshape(self._client.getMatrixFromQuaternion(state[LINK_ORIENTATION]), (3, 3))
        return np.array(state[LINK_ORIGIN]), turn[:, 2]

    @property
    def cup_jacobian(self) -> tuple[Floats, Floats]:
        """Derivatives by the actuated joints of the lip's position and of the cup's turn, (3, n_joints) each."""
        state = self._client.getLinkState(self.body, self.cup, computeForwardKinematics=True)
        lip = pybullet.invertTransform(state[2], state[3])[0]  # in the inertial frame, which is parallel
        still = [0.0] * len(self._moving)
        matrices = self._client.calculateJacobian(self.body, self.cup, lip, list(self.joint_positions), still, still)
        linear, angular = (np.array(matrix) @ self.joints.gearing for matrix in matrices)
        return linear, angular

    def rest_at(self, positions: Iterable[float]) -> None:
        """Put the actuated joints at `positions`, one each, in [rad], the others where they follow or rest."""
        everywhere = self.joints.gearing @ np.array(list(positions)) + self.joints.offsets
        self._client.resetJointStatesMultiDof(self.body, self._moving, [(position,) for position in everywhere])

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
        apply, step, client = pybullet.setJointMotorControlArray, self.step, self._client.number
        body, joints, torque = self.body, self.actuated, pybullet.TORQUE_CONTROL
        for part in range(n_parts):
            if part and on_part:
                on_part(part)
            for _ in range(n_steps * part // n_parts, n_steps * (part + 1) // n_parts):
                forces = efforts if self._damping is None else self._damping.damped(efforts)
                apply(body, joints, torque, forces=forces, physicsClientId=client)
                step(client)

    def contacts(self) -> set[str]:
        """What touches: two of the arm's links, or a link and what is not of the arm."""
        self._client.performCollisionDetection()
        points = self._client.getContactPoints(self.body)
        return {
            " and ".join(sorted(self._names[link] if body == self.body else self._others(body) for body, link in pair))
            for pair in {((p[1], p[3]), (p[2], p[4])) for p in points}
        }

    def _others(self, body: int) -> str:
        return self.other_bodies.get(body, "the floor")

    def contacts_at(self, poses: Floats) -> list[set[str]]:
        """What touches in each of these poses, (n_poses, n_joints); the arm is left in the last."""
        found = []
        for pose in poses:
            self.rest_at(pose)
            found.append(self.contacts())
        return found

    @property
    def solid(self) -> bool:
        """Whether anything that moves has a collision shape."""
        return any(map(self._has_collision_shape, self._moving_links))

    def without_shapes(self) -> list[str]:
        """Names of the links that move and are drawn, and have no collision shape, so that nothing touches them."""
        drawn = {shape[1] for shape in self._client.getVisualShapeData(self.body)}
        return [self._names[i] for i in self._moving_links if i in drawn and not self._has_collision_shape(i)]

    @property
    def _moving_links(self) -> list[int]:
        return [link for link in self._links.values() if link not in self.fixed_links]

    def _has_collision_shape(self, link: int) -> bool:
        return bool(self._client.getCollisionShapeData(self.body, link))

    def collides(self) -> bool:
        """Whether the arm touches itself or anything else."""
        self._client.performCollisionDetection()
        return bool(self._client.getContactPoints(self.body))


def _flags(spec: ArmSpec) -> int:
    return int(
        pybullet.URDF_USE_INERTIA_FROM_FILE
        | pybullet.URDF_USE_SELF_COLLISION
        | pybullet.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT
        | (pybullet.URDF_IGNORE_VISUAL_SHAPES if spec.simple_shapes else 0)
    )
