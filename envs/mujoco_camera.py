"""A camera's frames, drawn by MuJoCo's renderer."""

import math
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.cameras import CameraSpec
from sb3_stereo.envs.light import Light
from sb3_stereo.envs.mujoco_binding import mujoco
from sb3_stereo.envs.mujoco_opengl import Canvas, Depth, Frame, check_opengl
from sb3_stereo.envs.sensor import NOTHING


class Renderer:
    """What draws one simulation.

    Args:
        model: MuJoCo's `MjModel`.
        data: Its `MjData`.
    """

    def __init__(self, model: Any, data: Any) -> None:
        check_opengl()
        self._model, self._data = model, data
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 1)
        self._options, self._no_camera = mujoco.MjvOption(), mujoco.MjvCamera()
        flags = mujoco.mjtRndFlag
        for effect in (flags.mjRND_SHADOW, flags.mjRND_REFLECTION, flags.mjRND_HAZE, flags.mjRND_SKYBOX):
            self._scene.flags[effect] = False

    @cached_property
    def _canvas(self) -> Canvas:
        """Made when something is drawn: processes may be forked until then."""
        return Canvas(self._model)

    def close(self) -> None:
        """Free what OpenGL holds."""
        if "_canvas" in vars(self):
            self._canvas.close()

    def draw(self, spec: CameraSpec, light: Light) -> tuple[Frame, Depth]:
        """Draw the bodies as they stand before white: RGB, (height, width, 3), and their depth, (height, width), both
        the lowest row first.
        """
        self._look(spec, light)
        frame, depth = self._canvas.draw(self._scene, spec.width, spec.height)
        # A sky of MuJoCo's would hide what is further away than 0.6 of the far plane.
        nothing = np.multiply(depth >= 1.0, 255, dtype=np.uint8)
        return np.asarray(cv2.bitwise_or(frame, cv2.cvtColor(nothing, cv2.COLOR_GRAY2RGB)), np.uint8), depth

    def bodies(self, spec: CameraSpec) -> NDArray[np.int32]:
        """Which body each pixel of the camera shows, (height, width), the lowest row first."""
        self._look(spec, Light())
        flags, segment, colour = self._scene.flags, mujoco.mjtRndFlag.mjRND_SEGMENT, mujoco.mjtRndFlag.mjRND_IDCOLOR
        flags[segment] = flags[colour] = True
        try:
            colours, _ = self._canvas.draw(self._scene, spec.width, spec.height)
        finally:
            flags[segment] = flags[colour] = False
        numbers = colours.astype(np.int32) @ np.array([1, 256, 65536], np.int32)
        of_shape = np.full(self._scene.ngeom + 1, NOTHING, np.int32)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            of_shape[geom.segid + 1] = self._model.geom_bodyid[geom.objid]
        return np.asarray(of_shape[numbers], np.int32)

    def _look(self, spec: CameraSpec, light: Light) -> None:
        """Put bodies, light and camera into the scene."""
        model, data, scene = self._model, self._data, self._scene
        mujoco.mj_kinematics(model, data)
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(model, data, self._options, None, self._no_camera, everything, scene)
        (lamp,) = scene.lights[: scene.nlight]
        lamp.dir = -np.array(light.direction) / np.linalg.norm(light.direction)
        lamp.ambient, lamp.diffuse, lamp.specular = [light.ambient] * 3, [1.0 - light.ambient] * 3, [0.0] * 3
        forward = np.subtract(spec.target, spec.position)
        forward /= np.linalg.norm(forward)
        up = np.cross(np.cross(forward, spec.up), forward)
        top = spec.near * math.tan(spec.horizontal_fov / 2) * spec.height / spec.width
        for eye in scene.camera:  # both, and MuJoCo draws from between them
            eye.pos, eye.forward, eye.up = spec.position, forward, up / np.linalg.norm(up)
            eye.frustum_center, eye.frustum_bottom, eye.frustum_top = 0.0, -top, top
            eye.frustum_near, eye.frustum_far, eye.orthographic = spec.near, spec.far, 0


class MujocoCamera:
    """A `CameraSpec` in one MuJoCo simulation.

    Args:
        spec: Where it stands and what it sees.
        renderer: What draws it.
    """

    def __init__(self, spec: CameraSpec, renderer: Renderer) -> None:
        self._renderer = renderer
        self.aim(spec, Light())

    def aim(self, spec: CameraSpec, light: Light) -> None:
        """Look from elsewhere, in another light."""
        self.spec, self._light = spec, light

    def draw(self) -> tuple[Frame, Depth, NDArray[np.int32]]:
        """Draw the bodies: colour (height, width, 4) RGBA, depth and body ids (height, width)."""
        picture, depth = self._renderer.draw(self.spec, self._light)
        return _upright(picture), np.flipud(depth), np.flipud(self._renderer.bodies(self.spec))

    def frame(self) -> Frame:
        """The picture, RGBA, shape (height, width, 4), uint8."""
        return _upright(self._renderer.draw(self.spec, self._light)[0])


def _upright(picture: Frame) -> Frame:
    """RGB from the lowest row on as RGBA from the highest row on."""
    return np.asarray(cv2.cvtColor(cv2.flip(picture, 0), cv2.COLOR_RGB2RGBA), np.uint8)
