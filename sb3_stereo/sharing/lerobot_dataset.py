"""Episodes as a LeRobotDataset v3: the cameras' pictures, a state, actions, rewards, and the task in words.

A frame is what was seen before a control step, the step's action and what came of it, under the names that LeRobot's
own recordings of simulated episodes have. Pictures are stored as PNG, to the bit: episodes are a few frames long, and
the markers a few pixels wide, which a video's compression would smear.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

from sb3_stereo.errors import ConfigError
from sb3_stereo.sharing.lerobot_views import check_task, pictures, state, state_names
from sb3_stereo.sharing.recording import DatasetWriter, Recorder

if TYPE_CHECKING:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

Frame = dict[str, Any]

OLDEST = (3, 12)  # Python, of LeRobot
IMAGES, STATE, ACTION = "observation.images", "observation.state", "action"
REWARD, SUCCESS, DONE = "next.reward", "next.success", "next.done"
FORM = "OWNER/NAME, of letters, digits, -, _ and ., e.g. me/wam-reach"


class LeRobotRecorder(Recorder):
    """Keeps every whole episode, as LeRobot's frames.

    Raises:
        ConfigError: If the environment has no cameras, or no whole number of control steps a second.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self._task = check_task(env)
        frames_per_second(self._task)

    def _look(self, observation: Any) -> Frame:
        shown = {f"{IMAGES}.{name}": picture for name, picture in pictures(self._task).items()}
        return {**shown, STATE: state(self._task)}

    def _episode(self) -> list[Frame]:
        text = self._task.task_description
        return [
            {
                **shown,
                ACTION: action,
                REWARD: np.array([reward], np.float32),
                SUCCESS: np.array([info["is_success"]]),
                DONE: np.array([terminated or truncated]),
                "task": text,
            }
            for shown, action, (reward, terminated, truncated), info in zip(
                self._shown[:-1], self._actions, self._results, self._infos[1:], strict=True
            )
        ]


def frames_per_second(task: Any) -> int:
    """Control steps a second, which LeRobot wants as a whole number.

    Raises:
        ConfigError: If it is none.
    """
    rate: float = 1.0 / task.pulse_duration
    if abs(rate - round(rate)) > 1e-6:
        raise ConfigError(
            f"pulse_duration is {task.pulse_duration:g} s, and a LeRobot dataset has a whole number of frames a "
            "second; take 1 s or a half, a third, a quarter, ... of it"
        )
    return round(rate)


def features(task: Any) -> dict[str, dict[str, Any]]:
    """What a frame consists of, in LeRobot's form."""
    camera, names = task.cameras[0].spec, list(task.action_names)
    picture = {"dtype": "image", "shape": (camera.height, camera.width, 3), "names": ["height", "width", "channels"]}
    axes = state_names(task)
    return {
        **{f"{IMAGES}.{name}": dict(picture) for name in pictures(task)},
        STATE: {"dtype": "float32", "shape": (len(axes),), "names": axes},
        ACTION: {"dtype": "float32", "shape": (len(names),), "names": names},
        REWARD: {"dtype": "float32", "shape": (1,), "names": None},
        SUCCESS: {"dtype": "bool", "shape": (1,), "names": None},
        DONE: {"dtype": "bool", "shape": (1,), "names": None},
    }


def check_dataset(name: str) -> Path:
    """Return the folder of a new dataset.

    Raises:
        ConfigError: If there is no LeRobot here, or no dataset of that name can be made.
    """
    if sys.version_info < OLDEST:
        version = ".".join(map(str, sys.version_info[:3]))
        raise ConfigError(
            f"a LeRobot dataset needs Python 3.12 or newer, and this is {version}; install sb3_stereo[lerobot] for a "
            "newer one, or take --format minari"
        )
    try:
        from huggingface_hub.errors import HFValidationError
        from huggingface_hub.utils import validate_repo_id  # type: ignore[attr-defined]
        from lerobot.datasets.lerobot_dataset import LeRobotDataset  # noqa: F401  (imports all that it needs)
        from lerobot.utils.constants import HF_LEROBOT_HOME
    except ImportError as error:  # LeRobot's own, of a package that its extra would bring, is one too
        needed, install = str(error.name or "lerobot").partition(".")[0], 'pip install "sb3_stereo[lerobot]"'
        raise ConfigError(f"a LeRobot dataset needs {needed}; install it with: {install}") from error
    try:
        validate_repo_id(name)
    except HFValidationError as error:
        raise ConfigError(f"--dataset is '{name}'; give {FORM}") from error
    if "/" not in name:
        raise ConfigError(f"--dataset is '{name}'; give {FORM}")
    folder = Path(HF_LEROBOT_HOME) / name
    if folder.exists():
        raise ConfigError(f"there is a dataset '{name}' in '{folder}' already; choose another name")
    return folder


class LeRobotWriter(DatasetWriter):
    """Writes episodes into a new LeRobotDataset.

    Args:
        name: The dataset's, see `FORM`.
    """

    recorder = "sb3_stereo.sharing.lerobot_dataset.LeRobotRecorder"
    batch = 1  # its pictures are large
    folder_variable = "HF_LEROBOT_HOME"

    def __init__(self, name: str) -> None:
        self.folder = check_dataset(name)
        super().__init__(name)
        self._dataset: LeRobotDataset | None = None

    @property
    def how_to_load(self) -> str:
        """As in `DatasetWriter`."""
        return f"lerobot.datasets.LeRobotDataset({self.name!r})"

    def close(self) -> None:
        """As in `DatasetWriter`; without that, LeRobot cannot read the files."""
        if self._dataset is not None:
            self._dataset.finalize()

    def _append(self, env: gym.Env[Any, Any], episodes: Sequence[list[Frame]]) -> None:
        if self._dataset is None:
            self._dataset = self._created(env)
        for episode in episodes:
            for frame in episode:
                self._dataset.add_frame(dict(frame))  # it takes the task out
            self._dataset.save_episode()

    def _succeeded(self, episode: list[Frame]) -> bool:
        return bool(episode[-1][SUCCESS][0])

    def _created(self, env: gym.Env[Any, Any]) -> "LeRobotDataset":
        from datasets import disable_progress_bars
        from lerobot.datasets.lerobot_dataset import LeRobotDataset

        disable_progress_bars()  # one for each episode
        task: Any = env.unwrapped
        assert env.spec is not None  # gym.make made it
        return LeRobotDataset.create(
            self.name,
            frames_per_second(task),
            features(task),
            root=self.folder,
            robot_type=env.spec.id,
            use_videos=False,
            video_backend="pyav",  # never used; to look for another prints pages where FFmpeg's libraries are missing
        )
