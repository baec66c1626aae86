"""One Bullet client per environment."""

import os
import sys
from contextlib import nullcontext
from typing import Any, NoReturn

from sb3_stereo.envs.bullet import BulletClient, check_binding, native_output, pybullet

WINDOW = {"cameraDistance": 1.9, "cameraYaw": 62, "cameraPitch": -20, "cameraTargetPosition": (0.15, 0, 0.5)}


class Client(BulletClient):  # type: ignore[misc]
    """A `BulletClient` without its line on standard output, which would break a command's JSON.

    Args:
        gui: Open Bullet's window instead of simulating headless.

    Raises:
        RuntimeError: If a window is asked for and there is no display, or Bullet was built without NumPy.
    """

    def __init__(self, gui: bool = False) -> None:
        self._client = -1  # for __del__, should the next lines raise
        check_binding()
        if gui and sys.platform == "linux" and not os.environ.get("DISPLAY"):
            # Bullet would end the whole process.
            raise RuntimeError(
                "render_mode 'human' needs a display and DISPLAY is not set; use render_mode 'rgb_array'"
            )
        self._shapes: dict[object, object] = {}
        self._pid = os.getpid()
        with native_output(1) if gui else nullcontext():  # what Bullet says of threads and graphics
            self._client = pybullet.connect(pybullet.GUI if gui else pybullet.DIRECT)
        if gui:
            self._show_the_arm()

    def _show_the_arm(self) -> None:
        """Let the window show the workspace as the films do, and leave all letters to whoever reads the keyboard."""
        for unwanted in ("KEYBOARD_SHORTCUTS", "DEPTH_BUFFER_PREVIEW", "SEGMENTATION_MARK_PREVIEW"):
            self.configureDebugVisualizer(getattr(pybullet, f"COV_ENABLE_{unwanted}"), 0)
        self.resetDebugVisualizerCamera(**WINDOW)

    def __reduce_ex__(self, protocol: Any) -> NoReturn:
        raise ValueError("a simulator has no copies of its own; copy the environment")

    @property
    def number(self) -> int:
        """What PyBullet's own functions take as `physicsClientId`."""
        return self._client

    def close(self) -> None:
        """Disconnect; a second call does nothing, nor does one after a person has closed the window."""
        if self._client >= 0 and self.isConnected():
            self.disconnect()
