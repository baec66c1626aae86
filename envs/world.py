"""The simulated world: an arm on its floor, and the cameras that look at it."""

import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from sb3_stereo.envs.arm import Arm
from sb3_stereo.envs.bullet import pybullet
from sb3_stereo.envs.cameras import Camera, CameraSpec
from sb3_stereo.envs.capture import CameraRig, Floats, Image
from sb3_stereo.envs.clutter import Clutter
from sb3_stereo.envs.marker_specs import MarkerSpec
from sb3_stereo.envs.mirror import mirrored_joints
from sb3_stereo.envs.robots import ArmSpec
from sb3_stereo.envs.scene import GRAVITY, GREY, add_floor, empty_world, paint_floor
from sb3_stereo.envs.shadows import Shadow
from sb3_stereo.envs.specs import quoted, require
from sb3_stereo.envs.variation import Light, Variation

# A light for people, from beside the cameras, and a floor on which the shadow is seen.
SHOWROOM = Light(ambient=0.6, direction=(1.0, -0.6, 2.0), shadow=0.3)
SHOWROOM_FLOOR = (0.86, 0.86, 0.84)


@dataclass(eq=False)
class World:
    """An arm and its cameras in a Bullet client of their own.

    A copy, by `copy.deepcopy` or pickling, is another world in the same state: built from the same arguments, then set
    to Bullet's own record of joints, velocities and contacts, with which it moves the same to the bit.

    Args:
        arm_spec: The robot.
        views: The cameras.
        markers: What marks end effector and target.
        physics_rate: Simulation steps per second, in [Hz].
        weightless: Without gravity.
        floor: Draw the floor. It is solid in any case.
        in_window: Show it in Bullet's window.
        damping: Viscous damping per actuated joint, in [N m s/rad]; None for the arm's own.
        n_things: Of the clutter, see `Clutter`.
        variation: What differs in this episode; see `vary`.
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
    variation: Variation | None = None

    def __post_init__(self) -> None:
        self._client = client = empty_world(self.in_window, self.physics_rate, self.weightless)
        self.cameras = tuple(Camera(view, client) for view in self.views)
        self._ground = ground = add_floor(client, self.cameras, drawn=self.floor, in_window=self.in_window)
        self.arm = Arm(self.arm_spec, client)
        for link in self.arm.fixed_links:  # what stands on the floor touches it in every pose
            client.setCollisionFilterPair(ground, self.arm.body, -1, link, 0)
        if self.damping is not None:
            self.arm.set_damping(self.damping)
        self.mirrored_joints = mirrored_joints(self.arm)
        self.rig = CameraRig(client, self.cameras, self.arm, self.markers)
        self._clutter = Clutter(client, self.n_things)
        self._pristine, self._start = client.saveState(), client.saveState()
        self._saved: WeakKeyDictionary[object, tuple[int, Variation | None]] = WeakKeyDictionary()
        if self.variation is not None:
            self.vary(self.variation)

    def vary(self, variation: Variation) -> None:
        """Become another episode's world. Where bodies are is then that of no pose: place the arm."""
        self.variation, client, arm = variation, self._client, self.arm
        for camera, view in zip(self.cameras, variation.views, strict=True):
            camera.aim(view, variation.light.options)
        share = variation.gravity if self.weightless else 1.0
        client.setGravity(*(share * g for g in GRAVITY))
        arm.scale_masses(variation.mass)
        arm.set_damping(variation.damping * (arm.spec.damping if self.damping is None else self.damping))
        arm.set_friction(variation.friction)
        arm.paint(variation.paint, variation.painted)
        floor_drawn = self._paint_floor()
        self.rig.use_sensors(variation.sensors, self._ground, variation.light, floor_drawn)
        client.removeState(self._start)
        client.restoreState(self._pristine)
        self._clutter.place(variation.clutter)
        self._start = client.saveState()

    def _paint_floor(self) -> bool:
        """Draw the floor, or not, as this episode has it; without a variation it is a background or not drawn."""
        drawn = None if self.variation is None else self.variation.floor
        if drawn is None and self.variation is not None and self.floor:
            drawn = np.array(GREY[:3])
        paint_floor(self._client, self._ground, None if drawn is None else drawn.tolist())
        return drawn is not None

    def draw_from(self, spec: CameraSpec, light: Light | None = None) -> Image:
        """What a camera would see of the bodies as they stand, RGB, (height, width, 3), uint8.

        Args:
            spec: The camera.
            light: Which light there is, with a floor for its shadow; None for the cameras' own, and their floor.
        """
        camera = Camera(spec, self._client)
        if light is None:
            return np.ascontiguousarray(camera.draw()[0][:, :, :3])
        camera.aim(spec, light.options)
        paint_floor(self._client, self._ground, SHOWROOM_FLOOR)
        picture, _, bodies = camera.draw()
        (mask,) = Shadow(self._client, light.direction, [spec]).masks(self._ground)
        self._paint_floor()
        shade = np.where(mask & (bodies == self._ground), 1.0 - light.shadow, 1.0)
        return np.asarray(picture[:, :, :3] * shade[:, :, None], np.uint8)

    def place_arm(self, positions: Iterable[float]) -> bool:
        """Rest the arm at `positions` as if nothing had been before; return whether it is free there."""
        self._client.restoreState(self._start)  # contacts of the past would change the future
        self.arm.rest_at(positions)
        free = not self.arm.collides()
        self._client.restoreState(self._start)
        self.arm.rest_at(positions)
        return free

    def close(self) -> None:
        """Disconnect from Bullet; a second call does nothing."""
        self._client.close()

    # ------------------------------------------------------------------------------------------------ states
    def save(self, key: object) -> None:
        """Keep the state of all bodies and contacts for the very object that is given as its key."""
        self._saved[key] = self._client.saveState(), self.variation

    def restore(self, key: object) -> None:
        """Go back to the state that was saved with `key`, exactly."""
        self._go_back(*self._state_of(key))

    def remove(self, key: object) -> None:
        """Free the state that was saved with `key`."""
        self._client.removeState(self._state_of(key)[0])
        del self._saved[key]

    def _go_back(self, state: int, variation: Variation | None) -> None:
        """Restore a state of Bullet's, in the world of its episode, which it does not hold."""
        if variation is not None and variation is not self.variation:
            self.vary(variation)
        self._client.restoreState(state)

    def _state_of(self, key: object) -> tuple[int, Variation | None]:
        """Bullet's number of a state, of no use alone since another client's are the same, and its variation."""
        whose = "the state is another environment's, or removed"
        require(key in self._saved, f"{whose}; give one that save_state of this environment returned")
        return self._saved[key]

    @contextmanager
    def unchanged_by_errors(self) -> Iterator[None]:
        """Go back to the state before if an error is raised within."""
        before, variation = self._client.saveState(), self.variation
        try:
            yield
        except BaseException:
            self._go_back(before, variation)
            raise
        finally:
            self._client.removeState(before)

    def __getstate__(self) -> dict[str, Any]:
        way_out = "copy one with render_mode None or 'rgb_array'"
        require(not self.in_window, f"an environment in Bullet's window (render_mode 'human') has no copies; {way_out}")
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "state.bullet"  # the only form that another client takes
            self._client.saveBullet(str(file))
            return {"bullet": file.read_bytes()} | {field.name: getattr(self, field.name) for field in fields(self)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        record = state.pop("bullet")
        self.__init__(**state)  # type: ignore[misc]
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "state.bullet"
            file.write_bytes(record)
            try:
                self._client.restoreState(fileName=str(file))
            except pybullet.error as error:
                urdf = quoted(self.arm_spec.urdf)
                raise ValueError(f"{urdf} has changed since the environment was pickled; pickle it again") from error
