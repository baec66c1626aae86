"""The simulated world: an arm on its floor, and the cameras that look at it, in whatever simulator."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from sb3_stereo.envs.cameras import CameraSpec
from sb3_stereo.envs.capture import CameraRig, Floats, Image
from sb3_stereo.envs.clutter import Item
from sb3_stereo.envs.clutter_spec import ClutterSpec
from sb3_stereo.envs.light import Light
from sb3_stereo.envs.marker_specs import MarkerSpec
from sb3_stereo.envs.mirror import mirrored_joints
from sb3_stereo.envs.obstacles import Obstacle, draw_obstacles
from sb3_stereo.envs.robots import ArmSpec
from sb3_stereo.envs.scene import GRAVITY, GREY
from sb3_stereo.envs.shadows import Shadow
from sb3_stereo.envs.simulators import SimulatedArm, SimulatedCamera, SimulatedScene, State
from sb3_stereo.envs.specs import require
from sb3_stereo.envs.variation import Variation

# A light for people, from beside the cameras, and a floor on which the shadow is seen.
SHOWROOM = Light(ambient=0.6, direction=(1.0, -0.6, 2.0), shadow=0.3)
SHOWROOM_FLOOR = (0.86, 0.86, 0.84)


@dataclass(frozen=True, eq=False)
class Episode:
    """What differs from episode to episode, and what changes within one and is no state of the simulator's.

    Attributes:
        variation: What the world is like; see `World.vary`.
        obstacles: Clutter that the arm works among.
        time: Since the episode began, in [s].
        lost: Numbers of the views that are lost.
    """

    variation: Variation | None = None
    obstacles: tuple[Obstacle, ...] = ()
    time: float = 0.0
    lost: frozenset[int] = frozenset()


PLAIN = Episode()


@dataclass(eq=False)
class World(ABC):
    """An arm and its cameras in a simulation of their own. A simulator's subclass fills in the methods at the end.

    A copy, by `copy.deepcopy` or pickling, is another world in the same state: built from the same arguments, then set
    to the simulator's own record of joints, velocities and contacts, with which it moves the same to the bit.

    Args:
        arm_spec: The robot.
        views: The cameras.
        markers: What marks end effector and target.
        physics_rate: Simulation steps per second, in [Hz].
        weightless: Without gravity.
        floor: Draw the floor. It is solid in any case.
        in_window: Show it in the simulator's window.
        damping: Viscous damping per actuated joint, in [N m s/rad]; None for the arm's own.
        n_things: Of the clutter that touches nothing, see `clutter`.
        clutter: What the arm works among is drawn from; None for nothing.
        episode: What differs in this one.
    """

    arm_spec: ArmSpec
    views: tuple[CameraSpec, ...]
    markers: MarkerSpec
    physics_rate: float
    weightless: bool
    floor: bool
    in_window: bool
    damping: Floats | None
    n_things: int = 0
    clutter: ClutterSpec | None = None
    episode: Episode = PLAIN

    def __post_init__(self) -> None:
        self.arm, self.cameras, self._scene = self._build()
        self.rig = self._make_rig()
        self.mirrored_joints = mirrored_joints(self.arm)
        self._finish_building()
        self._saved: WeakKeyDictionary[object, tuple[State, Any]] = WeakKeyDictionary()
        episode, self.episode = self.episode, PLAIN
        self._become(episode)

    @property
    def variation(self) -> Variation | None:
        """What this episode's world is like; None if it is as always."""
        return self.episode.variation

    def begin(self, lost: frozenset[int] = frozenset()) -> None:
        """Become the world of an episode that begins, without clutter yet, in which these views are lost."""
        self._become(replace(PLAIN, variation=self.variation, lost=lost))

    def _become(self, episode: Episode) -> None:
        """Be another episode's world."""
        varied = episode.variation is not self.variation
        self.episode, self.rig.lost = episode, episode.lost
        if episode.variation is not None and varied:
            self.vary(episode.variation)
        elif self.clutter is not None:
            self._set_out()

    def _set_out(self) -> None:
        """Put everything but the arm where this episode has it."""
        items = () if self.variation is None else self.variation.clutter
        self._begin_with(items, [one.at(self.episode.time) for one in self.episode.obstacles])

    def add_clutter(self, rng: np.random.Generator, target: Floats) -> None:
        """Draw what the arm works among, which stays where it is; the target's position is (3,), in [m], world."""
        assert self.clutter is not None  # who has none asks for none
        here, views = self.arm.actuated_positions, [camera.spec for camera in self.cameras]
        obstacles = draw_obstacles(self.clutter, rng, views, target, self.arm, self._is_near_arm)
        self.episode = replace(self.episode, obstacles=obstacles)
        self._set_out()
        self.place_arm(here)

    def advance(self, seconds: float) -> None:
        """Let what moves by itself move on."""
        if self.clutter is not None:
            self.episode = replace(self.episode, time=self.episode.time + seconds)
            moving = [one for one in self.episode.obstacles if one.end is not None]
            self._move([one.at(self.episode.time) for one in moving])

    def _make_rig(self) -> CameraRig:
        """Let the cameras look for the markers."""
        return CameraRig(self._scene, self.cameras, self.arm, self.markers)

    def vary(self, variation: Variation) -> None:
        """Become another episode's world. Where bodies are is then that of no pose: place the arm."""
        self.episode, arm = replace(self.episode, variation=variation), self.arm
        for camera, view in zip(self.cameras, variation.views, strict=True):
            camera.aim(view, variation.light)
        share = variation.gravity if self.weightless else 1.0
        self._set_gravity([share * g for g in GRAVITY])
        arm.scale_masses(variation.mass)
        arm.set_damping(variation.damping * (arm.spec.damping if self.damping is None else self.damping))
        arm.set_friction(variation.friction)
        arm.paint(variation.paint, variation.painted)
        floor_drawn = self._paint_floor()
        self.rig.use_sensors(variation.sensors, variation.light, floor_drawn)
        self._set_out()

    def _paint_floor(self) -> bool:
        """Draw the floor, or not, as this episode has it; without a variation it is a background or not drawn."""
        drawn = None if self.variation is None else self.variation.floor
        if drawn is None and self.variation is not None and self.floor:
            drawn = np.array(GREY[:3])
        self._draw_floor(None if drawn is None else drawn.tolist())
        return drawn is not None

    def draw_from(self, spec: CameraSpec, light: Light | None = None) -> Image:
        """What a camera would see of the bodies as they stand, RGB, (height, width, 3), uint8.

        Args:
            spec: The camera.
            light: Which light there is, with a floor for its shadow; None for the cameras' own, and their floor.
        """
        camera = self._scene.camera(spec)
        if light is None:
            return np.ascontiguousarray(camera.draw()[0][:, :, :3])
        camera.aim(spec, light)
        self._draw_floor(SHOWROOM_FLOOR)
        picture, _, bodies = camera.draw()
        (mask,) = Shadow(self._scene, light.direction, [spec]).masks()
        self._paint_floor()
        shade = np.where(mask & (bodies == self._scene.ground), 1.0 - light.shadow, 1.0)
        return np.asarray(picture[:, :, :3] * shade[:, :, None], np.uint8)

    def place_arm(self, positions: Iterable[float]) -> bool:
        """Rest the arm at `positions` as if nothing had been before; return whether it is free there."""
        self._rewind()  # contacts of the past would change the future
        self.arm.rest_at(positions)
        free = not self.arm.collides()
        self._rewind()
        self.arm.rest_at(positions)
        return free

    def keyboard_events(self) -> dict[int, int] | None:
        """The keys of the window since the last call, code and state, see `keyboard`; None if it was closed."""
        return {}

    # ------------------------------------------------------------------------------------------------ states
    def save(self, key: object) -> None:
        """Keep the state of all bodies and contacts for the very object that is given as its key."""
        self._saved[key] = self._state(), self._beside()

    def restore(self, key: object) -> None:
        """Go back to the state that was saved with `key`, exactly."""
        self._go_back(*self._state_of(key))

    def remove(self, key: object) -> None:
        """Free the state that was saved with `key`."""
        self._free_state(self._state_of(key)[0])
        del self._saved[key]

    def _beside(self) -> Any:
        """What belongs to a state and is not in the simulator's."""
        return self.episode

    def _go_back(self, state: State, beside: Any) -> None:
        """Restore a simulator's state, in the world of its episode, and what was `_beside` it."""
        if beside is not self.episode:
            self._become(beside)
        self._set_state(state)

    def _state_of(self, key: object) -> tuple[State, Any]:
        whose = "the state is another environment's, or removed"
        require(key in self._saved, f"{whose}; give one that save_state of this environment returned")
        return self._saved[key]

    @contextmanager
    def unchanged_by_errors(self) -> Iterator[None]:
        """Go back to the state before if an error is raised within."""
        before, beside = self._state(), self._beside()
        try:
            yield
        except BaseException:
            self._go_back(before, beside)
            raise
        finally:
            self._free_state(before)

    def __getstate__(self) -> dict[str, Any]:
        return {"record": self._record()} | {field.name: getattr(self, field.name) for field in fields(self)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        record = state.pop("record")
        self.__init__(**state)  # type: ignore[misc]
        self._set_record(record)

    # ------------------------------------------------------------------------------------------------ the simulator
    @abstractmethod
    def _build(self) -> tuple[SimulatedArm, tuple[SimulatedCamera, ...], SimulatedScene]:
        """Make the simulation, and in it the arm, the cameras and what is around."""

    @abstractmethod
    def _finish_building(self) -> None:
        """Take this state for that to which `_rewind` goes back."""

    @abstractmethod
    def _set_gravity(self, gravity: Sequence[float]) -> None:
        """Set gravity, (3,), in [m/s^2], world."""

    @abstractmethod
    def _draw_floor(self, colour: Sequence[float] | None) -> None:
        """Draw the floor in a colour, (3,) from 0 to 1, or with None as it is without a variation."""

    @abstractmethod
    def _begin_with(self, items: Sequence[Item], obstacles: Sequence[Item]) -> None:
        """Show these things of the clutter that touches nothing, and of `clutter`; `_rewind` goes back to this."""

    def _move(self, obstacles: Sequence[Item]) -> None:
        """Put these obstacles where they are. Not asked for without `clutter`."""
        raise NotImplementedError

    def _is_near_arm(self, obstacle: Item, distance: float) -> bool:
        """Whether an obstacle is within a distance in [m] of the arm, as that is. Not asked for without `clutter`."""
        raise NotImplementedError

    @abstractmethod
    def _rewind(self) -> None:
        """Forget all contacts and speeds."""

    @abstractmethod
    def _state(self) -> State:
        """Everything that the simulator's next steps depend on."""

    @abstractmethod
    def _set_state(self, state: State) -> None:
        """Go back to a state, exactly."""

    @abstractmethod
    def _free_state(self, state: State) -> None:
        """Free what a state holds."""

    @abstractmethod
    def _record(self) -> Any:
        """The state in a form that another world takes."""

    @abstractmethod
    def _set_record(self, record: Any) -> None:
        """Take another world's state."""

    @abstractmethod
    def close(self) -> None:
        """End the simulation; a second call does nothing."""
