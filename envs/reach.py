"""The reaching environment: act, simulate, look, judge, return."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike

from sb3_stereo.envs import rewards
from sb3_stereo.envs.arguments import (
    Positive,
    bounded,
    check_flags,
    check_pictures,
    check_render_mode,
    checked_min_views,
    checked_reset_options,
    checked_seed,
    lost_views,
    success_scale,
    timing,
    vector,
)
from sb3_stereo.envs.cameras import CameraSpec, camera_specs, mirror_each_other, plain_cameras
from sb3_stereo.envs.capture import Capture, Floats
from sb3_stereo.envs.clutter_spec import ClutterSpec, clutter_spec, plain_clutter
from sb3_stereo.envs.composite import Composite, Observation
from sb3_stereo.envs.marker_specs import MarkerSpec, marker_spec
from sb3_stereo.envs.randomization import Randomization, plain_randomization, randomization
from sb3_stereo.envs.ranges import Probability
from sb3_stereo.envs.robots import ARMS, WAM, ArmSpec, arm_spec
from sb3_stereo.envs.simulators import world_class
from sb3_stereo.envs.specs import plain, quoted, require
from sb3_stereo.envs.starts import StartedEnv
from sb3_stereo.envs.validation import Integer, fit
from sb3_stereo.envs.world import World

PulseWatcher = tuple[Callable[[list[float]], object], int]  # what it calls with the efforts [N m], and parts of a pulse


class StereoReachEnv(StartedEnv):
    """Reach a blue target with a red end effector, seen by static cameras only.

    An action is one pulse of constant joint efforts; between pulses the arm stands still, so that one composite
    image carries the whole state. Paul & Vig (ICCVW 2017), sections 3.1 to 3.3.

    Action: `Box(-1, 1, (n_joints,), float32)`, the share of each joint's effort limit; values outside are clipped.
    Observation: `Box(0, 255, (1, 42 * n_views, 84), uint8)`; other arrangements by `composite`.
    Reward: Eq. 3, see `rewards`. Terminated at the goal only; the registration truncates at 30 steps.

    Args:
        render_mode: None, "rgb_array" (all views side by side), or "human" (Bullet's window; needs a display).
        simulator: Who moves the arm and draws the views: "bullet" (PyBullet), or "mujoco" (extra `mujoco`), see
            docs/environment.md.
        arm: The robot: an `ArmSpec`, a map of its fields, "wam", "kuka", "panda", or the path of a YAML file.
        n_joints: How many of the arm's joints are actuated, 4 to 7 of the WAM's in their order; None for the arm's own.
        cameras: The views, in the order of the composite: `CameraSpec`s, maps of their fields, or "left" and "right"
            for those of the framing's pair, any number of them; or the path of a YAML file with such a list. Goal and
            reward are judged by the same views.
        framing: Which pair "left" and "right" are: "wide", or "close", where the workspace fills the picture.
        markers: What marks end effector and target, and how an image tells where they are: a `MarkerSpec`, a map of
            its fields, "solid" or "hollow".
        composite: How the views make an observation: "stack", "channels", "dict" or "markers", see
            `composite.Composite`.
        target_position: Of the target, in [m], world.
        random_target: Draw the target anew at every reset that does not set it: where the end effector is at a
            random free pose, if that pose is a goal (all cameras see both markers there).
        rho: Mean pixel distance that counts as reached, in [px] (the paper's 10).
        success_frame: In whose pixels `rho` counts: those of the camera's "frame", or those of the "observation", to
            which the frame's centroids are scaled: section 3.2, "320 x 240 RGB images captured by the cameras are
            resized to 84 x 42", read before section 3.3, "we detect these color blobs from the images". The reward's
            changes of distance (Eq. 2) stay in the frame's pixels: their normalisation is free in any case.
        distance_scale: Pixels by which a change of distance is divided (Eq. 2's normalisation): about the largest
            that one pulse makes.
        initial_positions: Of the actuated joints, in [rad], where episodes begin, unless `reset` says otherwise; None
            for random ones. Section 5.1: "when starting from the same initial pose, our agent learns the reaching
            task within just 1500 iterations". A drawn target may be reached there already.
        pulse_duration: How long an action's efforts last, in [s]. The paper does not say: "continuous efforts applied
            at each joint" (section 3.1).
        physics_rate: Simulation steps per second, in [Hz], at least 240.
        effort_limits: Effort of a full action per actuated joint, in [N m], positive; None for the arm's own.
        damping: Viscous damping per actuated joint, in [N m s/rad]; None for the arm's own.
        gravity_compensation: Cancel the arm's weight, as the WAM's controller always does. The compensation is
            ideal: its torques cancel gravity's at every instant, which is the motion without gravity.
        brake: Stop the joints after each pulse. Without it they coast into the next one, and an image no longer
            tells the state. Without gravity compensation as well, an effort lasts until the next one replaces it, as
            in Gazebo's effort controllers ("simulated in Gazebo using ROS Indigo", section 5).
        floor: Draw the floor. It is solid in any case.
        randomize: From which ranges every episode draws its light, sensors, cameras, arm and surroundings: a
            `Randomization`, a map of its fields, or "default"; None for none. Success and reward stay those of the
            markers themselves: where they are visible, in the cameras as they then stand.
        clutter: Boxes, cylinders and balls around the arm, before it and moving past: a `ClutterSpec`, a map of its
            fields, or "default"; None for none.
        min_views: Fewest views that must see both markers for a goal, which is judged by the mean over these; None for
            all views. Two that look at right angles tell a place in space.
        lost_camera: Name of a camera whose picture is black; goal and reward are judged as if it were not.
        camera_loss: Probability that a camera, each as likely, is lost in an episode.

    Raises:
        ValueError: If an argument makes no task.
        RuntimeError: If "human" is asked for and there is no display.
        ImportError: If the simulator's package is missing.
    """

    goal_verb = "reached"  # what a film says of a success
    task_description = "Reach the blue target with the red end effector."  # for learners that read
    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 2}  # noqa: RUF012  (Gymnasium's own type)

    def __init__(
        self,
        render_mode: str | None = None,
        *,
        simulator: str = "bullet",
        arm: ArmSpec | Mapping[str, Any] | str = WAM,
        n_joints: int | None = None,
        cameras: Sequence[CameraSpec | Mapping[str, Any] | str] | str = ("left", "right"),
        framing: str = "wide",
        markers: MarkerSpec | Mapping[str, Any] | str = "solid",
        composite: str = "stack",
        target_position: Sequence[float] = (0.5, 0.0, 0.6),
        random_target: bool = False,
        rho: float = 10.0,
        success_frame: str = "frame",
        distance_scale: float = 100.0,
        initial_positions: Sequence[float] | None = None,
        pulse_duration: float = 0.5,
        physics_rate: float = 240.0,
        effort_limits: Sequence[float] | None = None,
        damping: Sequence[float] | None = None,
        gravity_compensation: bool = True,
        brake: bool = True,
        floor: bool = False,
        randomize: Randomization | Mapping[str, Any] | str | None = None,
        clutter: ClutterSpec | Mapping[str, Any] | str | None = None,
        min_views: int | None = None,
        lost_camera: str | None = None,
        camera_loss: float = 0.0,
    ) -> None:
        check_render_mode(render_mode, self.metadata["render_modes"])
        make_world = self._world_class(simulator)
        rho, distance_scale = fit(rho, Positive, "rho"), fit(distance_scale, Positive, "distance_scale")
        physics_rate, n_pulse_steps = timing(physics_rate, pulse_duration)
        check_flags(gravity_compensation=gravity_compensation, brake=brake, floor=floor, random_target=random_target)
        marks, views = marker_spec(markers), camera_specs(cameras, framing)
        spec = self._arm_spec(arm, n_joints, marks)
        check_pictures(views)
        self._success_scale = success_scale(success_frame, views[0], rho)
        self.render_mode, self.rho, self.distance_scale = render_mode, rho, distance_scale
        self.braked = brake
        self.pulse_duration, self.n_pulse_steps = pulse_duration, n_pulse_steps
        self._default_target = bounded("target_position", target_position, 3)
        self.random_target = random_target
        self.action_space = Box(-1.0, 1.0, (len(spec.joints),), np.float32)
        self.composite = Composite(composite, [view.name for view in views])
        self.observation_space = self.composite.space

        joint_damping = None if damping is None else bounded("damping", damping, len(spec.joints))
        if joint_damping is not None:
            require(joint_damping.min() >= 0, f"damping is {quoted(damping)}; give numbers of at least 0")
        efforts = spec.effort_limits if effort_limits is None else effort_limits
        self.effort_limits = bounded("effort_limits", efforts, len(spec.joints))
        require(self.effort_limits.min() > 0, f"effort_limits are {quoted(efforts)}; give positive numbers")
        self.pulse_watchers: list[PulseWatcher] = []
        self.randomization, self.clutter = randomization(randomize), clutter_spec(clutter)
        self.min_views = checked_min_views(min_views, len(views))
        self._lost, self.camera_loss = lost_views(lost_camera, views), fit(camera_loss, Probability, "camera_loss")
        self._world = make_world(
            spec,
            views,
            marks,
            physics_rate=physics_rate,
            weightless=gravity_compensation,
            floor=floor,
            in_window=render_mode == "human",
            damping=joint_damping,
            n_things=0 if self.randomization is None else self.randomization.n_things,
            clutter=self.clutter,
        )
        self._initial_positions = None if initial_positions is None else self._checked_start(initial_positions)

    @staticmethod
    def _world_class(simulator: str) -> type[World]:
        """What this task is simulated in."""
        return world_class(simulator)

    @staticmethod
    def _arm_spec(arm: ArmSpec | Mapping[str, Any] | str, n_joints: int | None, markers: MarkerSpec) -> ArmSpec:
        """The robot as this task has it."""
        spec = arm_spec(arm)
        return markers.carried_by(spec if n_joints is None else spec.actuating(fit(n_joints, Integer, "n_joints")))

    @staticmethod
    def plain_kwargs(kwargs: Mapping[str, Any]) -> dict[str, Any]:
        """Return the arguments with files replaced by what they hold, so that a record of them is complete.

        Raises:
            ValueError: If a robot or a camera among them is wrong.
        """
        resolved = dict(kwargs)
        if "arm" in kwargs and not (isinstance(kwargs["arm"], str) and kwargs["arm"] in ARMS):
            resolved["arm"] = plain(arm_spec(kwargs["arm"]))
        if "markers" in kwargs and not isinstance(kwargs["markers"], str):
            resolved["markers"] = plain(marker_spec(kwargs["markers"]))
        if "cameras" in kwargs:
            resolved["cameras"] = plain_cameras(kwargs["cameras"])
        if "randomize" in kwargs and not isinstance(kwargs["randomize"], str):
            resolved["randomize"] = plain_randomization(kwargs["randomize"])
        if "clutter" in kwargs and not isinstance(kwargs["clutter"], str):
            resolved["clutter"] = plain_clutter(kwargs["clutter"])
        return resolved

    @property
    def mirrored_joints(self) -> tuple[int, ...] | None:
        """Components of the action that change sign in the mirror image through the plane y = 0.

        None where the task is not its own mirror image: for an arm without one or mounted askew, a fixed target or a
        base beside the plane, or cameras that are not placed in pairs.
        """
        mirrored, beside = self._world.mirrored_joints, not self.random_target and self._default_target[1] != 0.0
        if mirrored is None or beside or not mirror_each_other(self._world.views):
            return None
        return tuple(self.arm.spec.joints.index(joint) for joint in mirrored)

    @property
    def action_names(self) -> tuple[str, ...]:
        """What each component of an action acts on."""
        return self.arm.spec.joints

    @property
    def goal_text(self) -> str:
        """What an episode asks for, in a few words for a film."""
        return f"reached at {self.rho:g} px"

    @property
    def n_views(self) -> int:
        """Views in an observation."""
        return len(self.cameras)

    @property
    def views_in_channels(self) -> bool:
        """Whether an observation has each view in a channel of its own, and not stacked in one image."""
        return self.composite.views_in_channels

    @property
    def marker_map(self) -> bool:
        """Whether an observation has a channel that shows where the markers are."""
        return self.composite.arrangement == "markers"

    @property
    def offset_reward(self) -> rewards.OffsetReward | None:
        """The reward as a function of offsets alone, for any target."""
        return rewards.OffsetReward(self.distance_scale, self.rho, self._success_scale, self.min_views)

    # ------------------------------------------------------------------------------------------------ Gymnasium
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Put the arm at a random free pose away from the goal, or where `options` say.

        Args:
            seed: Of the pose, and before it of the target if that is drawn.
            options: `joint_positions` of the actuated joints, shape (n_joints,), in [rad];
                `target_position`, shape (3,), in [m], for this episode.

        Raises:
            ValueError: If an option is unknown, malformed, outside the joint limits, or a pose that collides; or if
                there is no random pose to begin from. A reset that is refused changes nothing.
        """
        checked = checked_reset_options(options)
        seed = checked_seed(seed)
        with self._unchanged_by_errors():
            super().reset(seed=seed)
            self._begin(checked)
        return self._observation(), self._info(self._at_goal())

    def capture(self) -> Observation:
        """What the cameras see of the arm as it stands, as an observation."""
        self._capture()
        return self._observation()

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Apply one pulse of efforts.

        Args:
            action: Share of each effort limit, shape (n_joints,), clipped to [-1, 1].

        Raises:
            ValueError: If the action has another shape or is not finite.
        """
        previous = self._captured
        self._act(action)
        self._world.advance(self.pulse_duration)
        self._capture()
        goal = self._at_goal()
        info = self._info(goal)
        if not np.isnan(previous.offsets).any():  # NaN is not itself, which Gymnasium's checker takes for chance
            info["previous_pixel_offsets"] = previous.offsets.copy()
        return self._observation(), self._reward(previous, goal), goal, False, info

    def _act(self, action: ArrayLike) -> None:
        """Do what an action says for one control step."""
        efforts = np.clip(vector("action", action, len(self.arm.limits)), -1.0, 1.0) * self.effort_limits
        self._pulse(efforts.tolist())

    def _reward(self, previous: Capture, goal: bool) -> float:
        """Eq. 3 of the way from what was seen before to what is seen now."""
        return rewards.reward(self._changes(previous), goal)

    def _changes(self, previous: Capture) -> Floats:
        """Eq. 2 of the same, (n_views,)."""
        return rewards.distance_change(previous.distances, self._captured.distances, self.distance_scale)

    def _pulse(self, efforts: list[float]) -> None:
        """Apply the efforts, in [N m], as long as a pulse lasts; whoever watches pulses looks on its way."""
        n_parts = math.lcm(*(n for _, n in self.pulse_watchers))
        n_late, variation = 0, self._world.variation
        if variation is not None:
            efforts = (variation.effort * efforts).tolist()
            n_late = min(round(variation.latency * self.n_pulse_steps / self.pulse_duration), self.n_pulse_steps)

        def on_part(part: int) -> None:
            for look, n in self.pulse_watchers:
                if part * n % n_parts == 0:
                    look(efforts)

        if n_late:
            self.arm.push([0.0] * len(efforts), n_late)
        self.arm.push(efforts, self.n_pulse_steps - n_late, on_part, n_parts)
        if self.braked:
            self.arm.brake()

    def success_distances(self, offsets: Floats) -> Floats:
        """The distances whose mean `rho` is compared with.

        Args:
            offsets: From target to end effector in the cameras' frames, shape (..., 2), in [px].

        Returns:
            Their lengths in the success frame, shape (...), in [px].
        """
        return rewards.lengths(offsets * self._success_scale)

    # ------------------------------------------------------------------------------------------------ the view
    def _observation(self) -> Observation:
        return self.composite(self._captured.frames)

    def _at_goal(self) -> bool:
        distances = self.success_distances(self._captured.offsets)
        return bool(rewards.is_goal(distances, self.rho, self.min_views))

    def _info(self, goal: bool) -> dict[str, Any]:
        return {
            "is_success": goal,
            "pixel_distances": self._captured.distances.copy(),
            "pixel_offsets": self._captured.offsets.copy(),
            "target_pixels": self._captured.centres[:, 1].copy(),
            "joint_positions": self.arm.joint_positions,
            "distance": float(np.linalg.norm(self._captured.end_effector_position - self._target_position)),
            "end_effector_position": self._captured.end_effector_position,
            "target_position": self._target_position.copy(),
        }
