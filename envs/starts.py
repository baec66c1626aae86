"""Where episodes begin: the world, the target and the arm's pose, given or drawn."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sb3_stereo.envs.arguments import bounded, vector
from sb3_stereo.envs.capture import Floats
from sb3_stereo.envs.clutter_spec import ClutterSpec
from sb3_stereo.envs.contacts import always_colliding
from sb3_stereo.envs.randomization import Randomization
from sb3_stereo.envs.specs import quoted, require
from sb3_stereo.envs.viewed import ViewedEnv

MAX_DRAWS = 1000  # of an initial pose; about every second WAM pose is free


class StartedEnv(ViewedEnv):
    """An environment whose episodes begin at a free pose away from the goal, drawn by its own generator or given.

    A subclass says when the goal is reached, and captures what the cameras see.
    """

    rho: float
    random_target: bool
    effort_limits: Floats
    randomization: Randomization | None
    clutter: ClutterSpec | None
    camera_loss: float
    _lost: frozenset[int]
    _initial_positions: Floats | None

    def _at_goal(self) -> bool:
        """Whether the latest capture is a goal."""
        raise NotImplementedError

    def _capture(self) -> None:
        """Look."""
        self._captured = self._world.rig.capture(self._target_position)

    def _begin(self, options: Mapping[str, Any]) -> None:
        """Draw the world, place the target, then the arm, then what is around it."""
        self._world.begin(self._draw_lost())
        if self.randomization is not None:
            n_joints, n_links = len(self.effort_limits), self.arm.n_links
            self._world.vary(self.randomization.draw(self.np_random, self._world.views, n_joints, n_links))
        if self.random_target and "target_position" not in options:
            self._draw_target()
        else:
            self._target_position = bounded("target_position", options.get("target_position", self._default_target), 3)
        if self.randomization is not None and self.randomization.n_things:
            self._add_clutter(self.randomization)
        if "joint_positions" in options:
            self._place_arm("joint_positions", options["joint_positions"])
        elif self._initial_positions is not None:
            self._place_arm("initial_positions", self._initial_positions)
        else:
            self._place_arm_at_random()
        if self.clutter is not None:
            self._world.add_clutter(self.np_random, self._target_position)
            self._capture()

    def _draw_lost(self) -> frozenset[int]:
        """Numbers of the views that are lost in this episode."""
        if not self.camera_loss or self.np_random.random() >= self.camera_loss:
            return self._lost
        return self._lost | {int(self.np_random.integers(len(self.cameras)))}

    def _add_clutter(self, ranges: Randomization) -> None:
        """Draw what stands around the arm, clear of the target."""
        variation = self._world.variation
        assert variation is not None  # just drawn
        self._world.vary(ranges.add_clutter(variation, self.np_random, self._target_position))

    def _place_arm(self, name: str, value: ArrayLike) -> None:
        """Rest the arm at the `value` of the option `name`, shape (n_joints,), in [rad], and look."""
        self._rest_arm(name, value)
        self._capture()

    def _rest_arm(self, name: str, value: ArrayLike) -> None:
        """The same without a look."""
        positions = vector(name, value, len(self.arm.limits))
        low, high = self.arm.limits.T
        require(
            bool(np.all((low <= positions) & (positions <= high))),
            f"{name} {positions.tolist()} are outside the limits {self.arm.limits.tolist()}",
        )
        if not self._world.place_arm(positions):
            touching = "; ".join(sorted(self.arm.contacts()))
            clear = "choose a pose clear of the arm itself and the floor"
            raise ValueError(f"{name} {positions.tolist()} collide ({touching}); {clear}")

    def _checked_start(self, value: ArrayLike) -> Floats:
        """`initial_positions`, shape (n_joints,), where the arm is free, and away from a target that is not drawn."""
        self._target_position = self._default_target
        self._place_arm("initial_positions", value)
        away = self.random_target or not self._at_goal()
        require(away, f"initial_positions {quoted(value)} are a goal already; choose a pose away from the target")
        del self._target_position, self._captured  # the episode begins with `reset`
        return self.arm.actuated_positions

    def _place_arm_at_random(self) -> None:
        n_free = 0
        for _ in range(MAX_DRAWS):
            if self._place_arm_anywhere():
                n_free += 1
                self._capture()
                if not self._at_goal():
                    return
        self._check_room(n_free)
        found = f"of {MAX_DRAWS} random poses {n_free} are free of collisions, and none is away from the goal"
        raise ValueError(f"{found}; give the arm more room, or a smaller rho")

    def _draw_target(self) -> None:
        """Put the target where a random free pose reaches it: about nine in ten free WAM poses do."""
        n_free = 0
        for _ in range(MAX_DRAWS):
            if self._place_arm_anywhere():
                n_free += 1
                self._target_position = self.arm.end_effector_position
                self._capture()
                if self._at_goal():
                    return
        self._check_room(n_free)
        raise ValueError(f"no target in {MAX_DRAWS} draws; move the cameras so that all of them see the arm's hand")

    def _check_room(self, n_free: int) -> None:
        """Raise a ValueError that names the links which touch if no random pose was free of collisions."""
        if not n_free:
            low, high = self.arm.limits.T
            poses = self.np_random.uniform(low, high, (MAX_DRAWS // 10, len(low)))
            raise ValueError(always_colliding(self.arm.contacts_at(poses)))

    def _place_arm_anywhere(self) -> bool:
        """Rest the arm at a pose drawn within its limits; return whether it is free there."""
        low, high = self.arm.limits.T
        return self._world.place_arm(self.np_random.uniform(low, high))
