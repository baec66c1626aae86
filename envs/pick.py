"""The picking environment: a suction cup lifts an object that stands among others, all judged by the cameras."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike

from sb3_stereo.envs import rewards
from sb3_stereo.envs.arguments import Positive, vector
from sb3_stereo.envs.capture import Capture, Floats
from sb3_stereo.envs.composite import Observation
from sb3_stereo.envs.cup_kinematics import joints_for
from sb3_stereo.envs.layout import Target, checked_distractors, draw_items, target_of
from sb3_stereo.envs.lifecycle import Lasting
from sb3_stereo.envs.marker_specs import MarkerSpec
from sb3_stereo.envs.pick_rig import HAND_MARKER
from sb3_stereo.envs.pick_world import PickWorld
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.envs.robots import ArmSpec
from sb3_stereo.envs.specs import plain, quoted, require, require_known
from sb3_stereo.envs.starts import MAX_DRAWS
from sb3_stereo.envs.suction import BREAKING_FORCE
from sb3_stereo.envs.triangulation import check_views, triangulate
from sb3_stereo.envs.validation import Integer, fit
from sb3_stereo.envs.world import World

LIFT = 0.10  # [m] that count as lifted
CUP_LENGTH = 0.08  # [m], of an arm that has none of its own
PHASES = ("reach", "grasp")
NOT_HERE = ("markers", "random_target", "success_frame", "clutter", "min_views")  # arguments of the parent
ABOVE, BESIDE, ASLANT = (0.01, 0.07), 0.04, 0.25  # [m] over the target, [m] aside and [rad]: where "grasp" begins
CLOSE_ENOUGH = 0.02  # [m], of inverse kinematics to such a place


class StereoPickEnv(StereoReachEnv):
    """Pick up an object with a suction cup: `StereoReachEnv` with an object in place of the target.

    Objects stand on the floor: boxes, cylinders and bottles of several sizes, each in a colour of its own. The target
    is one of them, which `info["target"]` names. What the lip of the cup touches while there is suction is held by it.

    Action: `Box(-1, 1, (n_joints + 1,), float32)`, the share of each joint's effort limit, and suction: on above 0.
    Observation: as in `StereoReachEnv`; composite "markers" shows the target in place of the blue marker.
    Reward: 1 for success; -1 if nothing has changed; otherwise Eq. 3 of the distance between hand and target in the
    images, and the height that the target has gained in them as a share of `LIFT`.
    Terminated when the target has been lifted by `LIFT`; the height is triangulated from where the cameras see it.

    Args:
        render_mode: As in `StereoReachEnv`.
        arm: Likewise. One without a `suction_cup` gets one of 8 cm.
        n_joints: Likewise.
        target: Which object is to be picked up: a `Target` or a map of its fields, shape and colour. What is not given
            is drawn at every reset.
        n_distractors: Other objects, of other colours, and of other shapes if the target's is given.
        target_position: Where the target stands, in [m], world; its z is 0. None to draw that at every reset.
        breaking_force: Pull or shear that tears an object off the cup, in [N].
        phase: "reach" ends with success where the hand is within `rho` of the target; "grasp" begins there; None is
            both.
        kwargs: Of `StereoReachEnv`.

    Raises:
        ValueError: If an argument makes no task.
    """

    _world: Any
    _standing: Lasting[float] = Lasting()  # the target's height as the first images of an episode have it, in [m]
    _of_episode = (*StereoReachEnv._of_episode, "_standing")

    def __init__(
        self,
        render_mode: str | None = None,
        *,
        target: Target | Mapping[str, Any] | None = None,
        n_distractors: int = 0,
        target_position: ArrayLike | None = None,
        breaking_force: float = BREAKING_FORCE,
        phase: str | None = None,
        framing: str = "close",
        rho: float = 30.0,
        distance_scale: float = 200.0,
        **kwargs: Any,
    ) -> None:
        for name in NOT_HERE:
            require(name not in kwargs, f"picking has no {quoted(name)}; leave it out")
        self.target = target_of(target)
        self.n_distractors = checked_distractors(fit(n_distractors, Integer, "n_distractors"))
        if phase is not None:
            require_known("phase", phase, PHASES, "phases")
        self.phase, self.breaking_force = phase, fit(breaking_force, Positive, "breaking_force")
        self._place = None if target_position is None else _on_the_floor("target_position", target_position)
        kwargs |= {"framing": framing, "rho": rho, "distance_scale": distance_scale, "markers": HAND_MARKER}
        super().__init__(render_mode, random_target=self._place is None, **kwargs)
        check_views(self._world.views)
        self._world.suction.breaking_force = self.breaking_force
        self.action_space = Box(-1.0, 1.0, (len(self.effort_limits) + 1,), np.float32)

    @staticmethod
    def _world_class(simulator: str) -> type[World]:
        require(simulator == "bullet", f"picking is simulated in Bullet only; leave simulator {quoted(simulator)} out")
        return PickWorld

    @staticmethod
    def _arm_spec(arm: ArmSpec | Mapping[str, Any] | str, n_joints: int | None, markers: MarkerSpec) -> ArmSpec:
        spec = StereoReachEnv._arm_spec(arm, n_joints, markers)
        return spec if spec.suction_cup is not None else replace(spec, suction_cup=CUP_LENGTH)

    @staticmethod
    def plain_kwargs(kwargs: Mapping[str, Any]) -> dict[str, Any]:
        """As in `StereoReachEnv`."""
        resolved = StereoReachEnv.plain_kwargs(kwargs)
        return resolved | ({"target": plain(target_of(kwargs["target"]))} if "target" in kwargs else {})

    @property
    def action_names(self) -> tuple[str, ...]:
        """As in `StereoReachEnv`."""
        return (*super().action_names, "suction")

    @property
    def goal_verb(self) -> str:  # type: ignore[override]
        """As in `StereoReachEnv`."""
        return "reached" if self.phase == "reach" else "lifted"

    @property
    def task_description(self) -> str:  # type: ignore[override]
        """As in `StereoReachEnv`, with the episode's object."""
        item = self._world.items[0]
        verb = "Reach" if self.phase == "reach" else "Lift"
        return f"{verb} the {item.colour} {item.model.shape} with the suction cup."

    @property
    def goal_text(self) -> str:
        """As in `StereoReachEnv`."""
        if self.phase == "reach":
            return super().goal_text
        lifted = 100 * (self._height(self._captured) - self._standing)
        seen = f"lifted {round(lifted)} cm" if np.isfinite(lifted) else "the object is hidden"
        return f"{seen} of {100 * LIFT:.0f} cm"

    @property
    def offset_reward(self) -> rewards.OffsetReward | None:
        """As in `StereoReachEnv`; a lift is none of offsets."""
        return super().offset_reward if self.phase == "reach" else None

    # ------------------------------------------------------------------------------------------------ a control step
    def _act(self, action: ArrayLike) -> None:
        share = vector("action", action, len(self.effort_limits) + 1)
        self._world.begin_step(suction=bool(share[-1] > 0.0))
        super()._act(share[:-1])
        if self.braked:
            self._world.objects.stop()  # so that one image tells their state as well

    def _reward(self, previous: Capture, goal: bool) -> float:
        changes = self._changes(previous)
        if self.phase == "reach":
            return rewards.reward(changes, goal)
        rise = (self._height(self._captured) - self._height(previous)) / LIFT
        return rewards.lifting(changes, rise, goal)

    def _at_goal(self) -> bool:
        if self.phase == "reach":
            return super()._at_goal()
        return bool(self._height(self._captured) - self._standing >= LIFT)

    def _height(self, captured: Capture) -> float:
        """Of the target as the cameras see it, in [m]; nan if fewer than two do."""
        views = [camera.spec for camera in self.cameras]
        return float(triangulate(views, captured.centres[:, 1])[2])

    # ------------------------------------------------------------------------------------------------ the start
    def _begin(self, options: Mapping[str, Any]) -> None:
        """Draw the world, stand the objects in it, then place the arm."""
        place = self._place
        if "target_position" in options:
            place = _on_the_floor("target_position", options["target_position"])
        views = self._world.views
        items = draw_items(self.target, self.n_distractors, place, self.np_random, views)
        self._world.arrange(items)
        self._standing = np.nan
        super()._begin({**options, "target_position": self._world.target_position})
        self._standing = self._height(self._captured)

    def _place_arm(self, name: str, value: ArrayLike) -> None:
        super()._place_arm(name, value)
        hidden = np.isnan(self._captured.centres[:, 1]).any()
        require(not hidden, f"with {name} {quoted(value)} a camera does not see the target; choose another pose")

    def _place_arm_at_random(self) -> None:
        n_free = 0
        for _ in range(MAX_DRAWS):
            if self._place_arm_nearby() if self.phase == "grasp" else self._place_arm_anywhere():
                n_free += 1
                self._capture()
                if self._may_begin():
                    return
        raise ValueError(self._no_start(n_free))

    def _no_start(self, n_free: int) -> str:
        """Why there is no pose to begin from, and what to do."""
        if self.phase == "grasp" and not n_free:
            way_out = "give another target_position, or more n_joints"
            return f"in {MAX_DRAWS} draws the cup came over the target in no pose that is free of collisions; {way_out}"
        self._check_room(n_free)
        found = f"of {MAX_DRAWS} random poses {n_free} are free of collisions, and in none"
        if self.phase == "grasp":
            return f"{found} is the hand within rho {self.rho:g} of the target that the cameras see; give a larger rho"
        return f"{found} do the cameras see the target; give another target_position, or move the cameras"

    def _checked_start(self, value: ArrayLike) -> Floats:
        """As in `StereoReachEnv`; there are no objects yet."""
        self._rest_arm("initial_positions", value)
        return self.arm.actuated_positions

    def _may_begin(self) -> bool:
        """Whether an episode may begin as the arm stands."""
        if np.isnan(self._captured.centres[:, 1]).any():
            return False
        near = bool(self.success_distances(self._captured.offsets).mean() <= self.rho)
        return near if self.phase == "grasp" else not (self.phase == "reach" and near)

    def _place_arm_nearby(self) -> bool:
        """Rest the arm with the cup over the target, pointing down at it; return whether it is free there."""
        low, high = self.arm.limits.T
        guess = self.np_random.uniform(low, high)
        offset = self.np_random.uniform((-BESIDE, -BESIDE, ABOVE[0]), (BESIDE, BESIDE, ABOVE[1]))
        slant = self.np_random.uniform(-ASLANT, ASLANT, 2)
        joints, error = joints_for(
            self._world.cupped_arm, self._world.target_top + offset, np.array([*slant, -1.0]), guess
        )
        return error <= CLOSE_ENOUGH and self._world.place_arm(joints)

    # ------------------------------------------------------------------------------------------------ the view
    def _capture(self) -> None:
        self._target_position = self._world.target_position
        super()._capture()

    def _observation(self) -> Observation:
        return self.composite(self._captured.frames, self._world.rig.find_masks)

    def _info(self, goal: bool) -> dict[str, Any]:
        item = self._world.items[0]
        return super()._info(goal) | {
            "target": {"shape": item.model.shape, "colour": item.colour},
            "lifted": self._height(self._captured) - self._standing,
            "holding": self._world.holds_target,
        }


def _on_the_floor(name: str, value: Any) -> Floats:
    """The place (2,) of an object that stands at a position."""
    position = vector(name, value, 3)
    require(position[2] == 0.0, f"{name} is {position.tolist()}; objects stand on the floor, so give z 0")
    return position[:2]
