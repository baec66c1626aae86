"""A camera's frames, drawn by Bullet's TinyRenderer."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.bullet import pybullet
from sb3_stereo.envs.cameras import CameraSpec
from sb3_stereo.envs.light import Light

Frame = NDArray[np.uint8]


class Camera:
    """A `CameraSpec` in one Bullet client.

    Args:
        spec: Where it stands and what it sees.
        client: A `BulletClient`.
    """

    def __init__(self, spec: CameraSpec, client: Any) -> None:
        self._client = client  # asked for its number at every draw: once closed, Bullet gives that to another
        self.background: tuple[Frame, NDArray[np.float32]] | None = None  # colour and depth
        self.aim(spec, Light())

    def aim(self, spec: CameraSpec, light: Light) -> None:
        """Look from elsewhere, in another light."""
        self.spec = spec
        self._options = {
            "width": spec.width,
            "height": spec.height,
            "viewMatrix": spec.view_matrix,
            "projectionMatrix": spec.projection_matrix,
            "renderer": pybullet.ER_TINY_RENDERER,
            "lightDirection": light.direction,
            "lightAmbientCoeff": light.ambient,
            "lightDiffuseCoeff": 1.0 - light.ambient,
            "lightSpecularCoeff": 0.0,
            "shadow": 0,  # see `shadows`
        }

    def keep_background(self) -> None:
        """Remember what is in the picture now; `frame` lays it behind what is drawn later.

        The caller then hides the bodies that never move. Exact for fixed lights and no shadows.
        """
        frame, depth, _ = self.draw()
        self.background = frame.copy(), depth.copy()

    def draw(self) -> tuple[Frame, NDArray[np.float32], NDArray[np.int32]]:
        """Draw the bodies: colour (height, width, 4) RGBA, depth and body ids (height, width)."""
        _, _, frame, depth, bodies = pybullet.getCameraImage(**self._options, physicsClientId=self._client.number)
        return frame, depth, bodies

    def frame(self) -> Frame:
        """The picture, RGBA, shape (height, width, 4), uint8."""
        frame, depth, _ = self.draw()
        if self.background is None:
            return frame
        background, background_depth = self.background
        return np.asarray(cv2.copyTo(background, cv2.compare(background_depth, depth, cv2.CMP_LT), frame), np.uint8)
