"""The simulated world in MuJoCo."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sb3_stereo.envs.cameras import CameraSpec
from sb3_stereo.envs.clutter import Item, where_of
from sb3_stereo.envs.mujoco_arm import MujocoArm
from sb3_stereo.envs.mujoco_binding import mujoco
from sb3_stereo.envs.mujoco_camera import MujocoCamera, Renderer
from sb3_stereo.envs.mujoco_model import DRAWN, FLOOR, HIDDEN, MARKERS, THING, Around, build_model
from sb3_stereo.envs.scene import GRAVITY, GREY
from sb3_stereo.envs.simulators import Floats
from sb3_stereo.envs.specs import require
from sb3_stereo.envs.world import World

EVERYTHING = mujoco.mjtState.mjSTATE_INTEGRATION  # that a step depends on


class MujocoScene:
    """What is around the arm in one MuJoCo simulation.

    Args:
        model: MuJoCo's `MjModel`.
        data: Its `MjData`.
        renderer: What draws it.
    """

    ground = 0  # MuJoCo's world, which has no other shape

    def __init__(self, model: Any, data: Any, renderer: Renderer) -> None:
        self._model, self._data, self._renderer = model, data, renderer
        red, blue = (int(model.body(name).id) for name in MARKERS)
        self.markers = red, blue

    def camera(self, spec: CameraSpec) -> MujocoCamera:
        """A camera more."""
        return MujocoCamera(spec, self._renderer)

    def place(self, body: int, position: Floats) -> None:
        """Put a marker's middle at a position, (3,), in [m], world."""
        self._data.mocap_pos[self._model.body_mocapid[body]] = position

    def place_things(self, items: Sequence[Item], n_things: int) -> None:
        """Show these things and no others."""
        for number, (position, orientation, item) in enumerate(where_of(items, n_things)):
            body = self._model.body(THING.format(number))
            x, y, z, w = orientation
            self._data.mocap_pos[body.mocapid[0]], self._data.mocap_quat[body.mocapid[0]] = position, (w, x, y, z)
            if item is not None:
                self._model.geom_rgba[body.geomadr[0], :3] = item.colour

    def draw_floor(self, colour: Sequence[float] | None) -> None:
        """Draw the floor in a colour, (3,) from 0 to 1, or with None not at all."""
        floor = self._model.geom(FLOOR)
        self._model.geom_group[floor.id] = HIDDEN if colour is None else DRAWN
        if colour is not None:
            self._model.geom_rgba[floor.id, :3] = colour


class MujocoWorld(World):
    """A `World` in a MuJoCo simulation of its own. A state is an array of numbers."""

    def _build(self) -> tuple[MujocoArm, tuple[MujocoCamera, ...], MujocoScene]:
        way_out = "use render_mode 'rgb_array'"
        require(self.clutter is None, "simulator 'mujoco' has no clutter; leave it out, or take simulator 'bullet'")
        require(not self.in_window, f"simulator 'mujoco' has no window for render_mode 'human'; {way_out}")
        around = Around(self.markers.radii(self.arm_spec), self.markers.hollow_target, self.n_things)
        model = build_model(self.arm_spec, around, self.physics_rate)
        self._model, self._data = model.compiled, mujoco.MjData(model.compiled)
        self._set_gravity((0.0, 0.0, 0.0) if self.weightless else GRAVITY)
        self._renderer = Renderer(self._model, self._data)
        self._things = scene = MujocoScene(self._model, self._data, self._renderer)
        arm = MujocoArm(self.arm_spec, model, self._data)
        if self.damping is not None:
            arm.set_damping(self.damping)
        self._draw_floor(None)
        return arm, tuple(scene.camera(view) for view in self.views), scene

    def _finish_building(self) -> None:
        mujoco.mj_resetData(self._model, self._data)
        self._pristine = self._start = self._state()

    def _set_gravity(self, gravity: Sequence[float]) -> None:
        self._model.opt.gravity[:] = gravity

    def _draw_floor(self, colour: Sequence[float] | None) -> None:
        drawn_anyway = self.floor and self.variation is None
        self._things.draw_floor(GREY[:3] if colour is None and drawn_anyway else colour)

    def _begin_with(self, items: Sequence[Item], obstacles: Sequence[Item]) -> None:
        self._set_state(self._pristine)
        self._things.place_things(items, self.n_things)
        self._start = self._state()

    def _rewind(self) -> None:
        self._set_state(self._start)

    def _state(self) -> Floats:
        state = np.empty(mujoco.mj_stateSize(self._model, EVERYTHING))
        mujoco.mj_getState(self._model, self._data, state, EVERYTHING)
        return state

    def _set_state(self, state: Floats) -> None:
        mujoco.mj_setState(self._model, self._data, state, EVERYTHING)

    def _free_state(self, state: Floats) -> None:
        pass  # an array holds nothing else

    def _record(self) -> Floats:
        return self._state()

    def _set_record(self, record: Floats) -> None:
        way_out = "pickle it again"
        fits = record.shape == self._state().shape
        require(fits, f"{self.arm_spec.urdf!r} has changed since the environment was pickled; {way_out}")
        self._set_state(record)

    def close(self) -> None:
        """Free what MuJoCo's renderer holds; a second call does nothing."""
        self._renderer.close()
