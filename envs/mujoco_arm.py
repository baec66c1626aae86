"""An arm in MuJoCo: its poses, and control steps of constant joint torque."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from sb3_stereo.envs.mujoco_binding import mujoco
from sb3_stereo.envs.mujoco_model import DRAWN, Model
from sb3_stereo.envs.robots import ArmSpec
from sb3_stereo.envs.simulators import Floats


class MujocoArm:
    """An `ArmSpec` in one MuJoCo simulation, fixed to the world.

    Args:
        spec: The robot.
        model: That was built with it.
        data: The state of the simulation.
    """

    def __init__(self, spec: ArmSpec, model: Model, data: Any) -> None:
        self.spec, self.joints, self.limits = spec, model.joints, model.joints.limits
        self._model, self._data = model.compiled, data
        self._links = {body: name for name, body in model.links.items()}
        self._hand = model.links[spec.end_effector_link]
        self._actuated = np.array(self.joints.actuated)
        moving = list(self._links)[1:]
        self._masses = moving, self._model.body_mass[moving].copy(), self._model.body_inertia[moving].copy()
        self._colours = self._model.geom_rgba.copy()
        self._fixed = {body for body in self._links if self._model.body_weldid[body] == 0}
        self.set_damping(spec.damping)

    @property
    def n_links(self) -> int:
        """Links besides the base."""
        return len(self._links) - 1

    def set_damping(self, damping: Iterable[float]) -> None:
        """Set the viscous damping of the actuated joints, in [N m s/rad]; MuJoCo integrates it implicitly."""
        self._model.dof_damping[self._actuated] = list(damping)

    def set_friction(self, friction: Iterable[float]) -> None:
        """Set the dry friction of the actuated joints, in [N m]."""
        self._model.dof_frictionloss[self._actuated] = list(friction)

    def scale_masses(self, factors: Iterable[float]) -> None:
        """Scale masses and inertias of the links, (n_links,), from what they are at first. The pose is lost."""
        links, masses, inertias = self._masses
        scale = np.array(list(factors))
        self._model.body_mass[links], self._model.body_inertia[links] = scale * masses, scale[:, None] * inertias
        mujoco.mj_setConst(self._model, self._data)

    def paint(self, colours: Floats, shares: Floats) -> None:
        """Mix the colours of base and links with others, (n_links + 1, 3) from 0 to 1, in shares (n_links + 1,)."""
        for link, colour, share in zip(self._links, colours, shares, strict=True):
            shapes = self._model.geom_bodyid == link
            self._model.geom_rgba[shapes, :3] = (1.0 - share) * self._colours[shapes, :3] + share * colour

    # ------------------------------------------------------------------------------------------------ poses
    @property
    def base_to_world(self) -> Floats:
        """Rotation of the base, shape (3, 3)."""
        self._place_links()
        return np.array(self._data.xmat[next(iter(self._links))].reshape(3, 3))

    @property
    def joint_positions(self) -> Floats:
        """Of every moving joint, shape (n_moving,), in [rad]."""
        return np.array(self._data.qpos[self.joints.moving])

    @property
    def actuated_positions(self) -> Floats:
        """Of the actuated joints, shape (n_joints,), in [rad]."""
        return np.array(self._data.qpos[self._actuated])

    @property
    def chain_positions(self) -> Floats:
        """Origins of the frames of the links from the end effector's back to the base's, (n_links, 3), [m], world."""
        self._place_links()
        chain, base = [self._hand], next(iter(self._links))
        while (parent := int(self._model.body_parentid[chain[-1]])) > base:
            chain.append(parent)
        return np.array(self._data.xpos[chain])

    @property
    def end_effector_position(self) -> Floats:
        """Middle of the end effector's marker, shape (3,), in [m], world."""
        self._place_links()
        rotation = self._data.xmat[self._hand].reshape(3, 3)
        return np.asarray(self._data.xpos[self._hand] + rotation @ self.spec.end_effector_offset)

    def _place_links(self) -> None:
        mujoco.mj_kinematics(self._model, self._data)  # a simulation step leaves the links where they were before it

    def rest_at(self, positions: Iterable[float]) -> None:
        """Put the actuated joints at `positions`, one each, in [rad], the others where they follow or rest."""
        joints = self.joints
        self._data.qpos[joints.moving] = joints.gearing @ np.array(list(positions)) + joints.offsets
        self._data.qvel[:] = 0.0

    def brake(self) -> None:
        """Stop every joint where it is: an ideal brake."""
        self.rest_at(self.actuated_positions)

    @contextmanager
    def as_it_was(self) -> Iterator[None]:
        """Put the joints back afterwards."""
        positions, speeds = self._data.qpos.copy(), self._data.qvel.copy()
        try:
            yield
        finally:
            self._data.qpos[:], self._data.qvel[:] = positions, speeds

    # ------------------------------------------------------------------------------------------------ motion
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
            n_steps: Simulation steps to apply them for; no effort is left afterwards.
            on_part: Called between the parts of the pulse with the number of parts done; the motion stays the same.
            n_parts: Equal parts of a pulse, to a simulation step.
        """
        for part in range(n_parts):
            if part and on_part:
                on_part(part)
            n = n_steps * (part + 1) // n_parts - n_steps * part // n_parts
            self._data.qfrc_applied[self._actuated] = efforts
            if n:
                mujoco.mj_step(self._model, self._data, n)
        self._data.qfrc_applied[:] = 0.0

    # ------------------------------------------------------------------------------------------------ contacts
    def _touching(self) -> Iterator[tuple[int, int]]:
        """Pairs of bodies that touch, one of which at least is the arm's."""
        mujoco.mj_fwdPosition(self._model, self._data)
        for one, other in self._model.geom_bodyid[self._data.contact.geom].tolist():
            if one in self._links or other in self._links:
                yield one, other

    def collides(self) -> bool:
        """Whether the arm touches itself or anything else."""
        return any(True for _ in self._touching())

    def contacts(self) -> set[str]:
        """What touches: two of the arm's links, or a link and what is not of the arm."""
        return {" and ".join(sorted(self._links.get(body, "the floor") for body in pair)) for pair in self._touching()}

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
        drawn = set(self._model.geom_bodyid[self._model.geom_group == DRAWN].tolist())
        links = [link for link in self._moving_links if link in drawn and not self._has_collision_shape(link)]
        return [self._links[link] for link in links]

    @property
    def _moving_links(self) -> list[int]:
        return [link for link in self._links if link not in self._fixed]

    def _has_collision_shape(self, link: int) -> bool:
        return bool(self._model.geom_contype[self._model.geom_bodyid == link].any())
