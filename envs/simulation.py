"""One Bullet client per environment."""

import os
import sys
from typing import Any, NoReturn

from sb3_stereo.envs.bullet import BulletClient, check_binding, pybullet


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
        self._client = pybullet.connect(pybullet.GUI if gui else pybullet.DIRECT)

    def __reduce_ex__(self, protocol: Any) -> NoReturn:
        raise ValueError("a simulator has no copies of its own; copy the environment")

    @property
    def number(self) -> int:
        """What PyBullet's own functions take as `physicsClientId`."""
        return self._client

    def close(self) -> None:
        """Disconnect; a second call does nothing."""
        if self._client >= 0:
            self.disconnect()
