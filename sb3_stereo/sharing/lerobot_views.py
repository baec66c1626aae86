"""What LeRobot's policies are shown of a task: the cameras' pictures, and a state that the pictures alone give.

That state is where the end effector's and the target's marker are in each view, in [px], measured in these very
pictures by their colours; both coordinates are `UNSEEN` where a view does not show the marker. The joint angles, which
LeRobot's datasets of real arms have there, are left out: the task is to act from images.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from sb3_stereo.errors import ConfigError

UNSEEN = -1.0
MARKERS = ("end_effector", "target")


def check_task(env: gym.Env[Any, Any]) -> Any:
    """Return the unwrapped environment, which has cameras with names that LeRobot takes.

    Raises:
        ConfigError: If it has not.
    """
    task: Any = env.unwrapped
    if not hasattr(task, "find_markers"):
        raise ConfigError(f"{task} has no cameras whose pictures LeRobot could have; take an environment of sb3_stereo")
    names = view_names(task)
    if len(set(names)) < len(names) or any("/" in name for name in names):
        raise ConfigError(f"the cameras are {', '.join(names)}; LeRobot wants different names, without a /")
    return task


def view_names(task: Any) -> list[str]:
    """The names of the cameras, in their order."""
    return [camera.spec.name for camera in task.cameras]


def pictures(task: Any) -> dict[str, NDArray[np.uint8]]:
    """The frames of the latest observation by their cameras' names: RGB, (height, width, 3) each, uint8."""
    return dict(zip(view_names(task), task.frames, strict=True))


def state_names(task: Any) -> list[str]:
    """What each component of `state` is, such as `left.target.x`."""
    return [f"{view}.{marker}.{axis}" for view in view_names(task) for marker in MARKERS for axis in "xy"]


def state(task: Any) -> NDArray[np.float32]:
    """Where the markers are in the frames of the latest observation, see above, shape (4 * n_views,), in [px]."""
    centres = [task.find_markers(view, frame) for view, frame in enumerate(task.frames)]
    return np.nan_to_num(np.ravel(centres), nan=UNSEEN).astype(np.float32)
