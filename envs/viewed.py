"""An environment's pictures: what its cameras see, for agents, for tools, and for people."""

import numpy as np
from numpy.typing import ArrayLike

from sb3_stereo.envs.arguments import vector
from sb3_stereo.envs.cameras import CameraSpec
from sb3_stereo.envs.capture import Floats, Image
from sb3_stereo.envs.lifecycle import SimulatedEnv
from sb3_stereo.envs.markers import Blobs
from sb3_stereo.envs.simulators import SimulatedArm, SimulatedCamera
from sb3_stereo.envs.world import SHOWROOM


class ViewedEnv(SimulatedEnv):
    """An environment with an arm and cameras, and the pictures that they give at any time."""

    render_mode: str | None
    _default_target: Floats

    @property
    def arm(self) -> SimulatedArm:
        """The arm."""
        return self._world.arm

    @property
    def cameras(self) -> tuple[SimulatedCamera, ...]:
        """The views, in the order of the composite."""
        return self._world.cameras

    def find_markers(self, view: int, frame: Image) -> Blobs:
        """Measure the markers in a frame.

        Args:
            view: Number of the camera, from 0.
            frame: RGB or RGBA, (height, width, 3 or 4), uint8.
        """
        return self._world.rig.find(view, frame)

    def locate_markers(self, view: int, red: Image, blue: Image) -> Blobs:
        """Measure the markers in an ordinary image as in a rendered frame.

        Args:
            view: Number of the camera, from 0.
            red: 255 where the image shows the end effector's marker, else 0, (height, width) of the frame, uint8.
            blue: Likewise the target's.
        """
        return self._world.rig.locate(view, red, blue)

    def draw(self) -> tuple[Image, ...]:
        """What every camera sees now, also in the middle of a pulse: RGBA, (height, width, 4) each, uint8."""
        return self._world.rig.draw(self._target_position)

    def look(self) -> tuple[tuple[Image, Blobs], ...]:
        """The same pictures, with where the markers are in each as the reward measures it."""
        return self._world.rig.look(self._target_position)

    def draw_larger(self, height: int) -> tuple[Image, ...]:
        """The same as pictures for people: `height` pixels high, as the cameras would see it without their sensors."""
        return tuple(self._world.draw_from(camera.spec.sized(height)) for camera in self.cameras)

    def draw_from(self, camera: CameraSpec) -> Image:
        """What a camera of one's own sees now: floor, light and shadow for people, RGB, (height, width, 3), uint8."""
        return self._world.draw_from(camera, SHOWROOM)

    def draw_pose(self, positions: ArrayLike) -> tuple[Image, ...]:
        """The same of the actuated joints at `positions`, (n_joints,), free or not, with the default target."""
        self.arm.rest_at(vector("positions", positions, len(self.arm.limits)))
        return self._world.rig.draw(self._default_target)

    def keyboard_events(self) -> dict[int, int] | None:
        """The keys of Bullet's window since the last call, see `keyboard`; None once it is closed.

        Without a window (another `render_mode` than "human") there are none.
        """
        return self._world.keyboard_events()

    @property
    def frames(self) -> tuple[Image, ...]:
        """What the cameras saw for the latest observation: RGB, (height, width, 3) each, uint8."""
        return tuple(frame[:, :, :3] for frame in self._captured.frames)

    def render(self) -> Image | None:
        """The frames of the latest observation side by side, RGB, shape (height, sum of widths, 3)."""
        frames = self.frames  # in any mode: it is an error before the first reset
        return np.hstack(frames) if self.render_mode == "rgb_array" else None
