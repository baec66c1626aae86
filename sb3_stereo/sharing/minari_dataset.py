"""Episodes as a Minari dataset: what the environment showed and was given, to learn from without a simulator.

`recover_environment` of the dataset makes an environment with the same spaces, in which the recorded actions repeat the
episodes. Images are stored as they are, not as JPEG.
"""

import copy
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

from sb3_stereo import __version__
from sb3_stereo.errors import ConfigError
from sb3_stereo.sharing.recording import DatasetWriter, Recorder

if TYPE_CHECKING:
    from minari import MinariDataset
    from minari.data_collector import EpisodeBuffer

FORM = "NAME-vN or GROUP/NAME-vN, of letters, digits, - and _, e.g. wam/reach-v0"


class MinariRecorder(Recorder):
    """Keeps every whole episode, as Minari's buffers."""

    def _episode(self) -> "EpisodeBuffer":
        from minari.data_collector import EpisodeBuffer

        rewards, terminations, truncations = (list(column) for column in zip(*self._results, strict=True))
        known = [key for key in self._infos[0] if all(key in info for info in self._infos)]
        return EpisodeBuffer(
            seed=self._seed,
            observations=columns(self._shown),
            actions=self._actions,
            rewards=rewards,
            terminations=terminations,
            truncations=truncations,
            infos={key: [np.asarray(info[key]) for info in self._infos] for key in known},
        )


def columns(values: Sequence[Any]) -> Any:
    """Return a map of lists for a list of maps, at every depth; Minari's layout."""
    if not isinstance(values[0], dict):
        return list(values)
    return {key: columns([value[key] for value in values]) for key in values[0]}


def check_dataset(name: str) -> None:
    """Raise a ConfigError unless a dataset of that name can be made."""
    try:
        import h5py  # noqa: F401  (Minari imports it when it writes)
        from minari.dataset.minari_dataset import parse_dataset_id
        from minari.storage.datasets_root_dir import get_dataset_path
    except ModuleNotFoundError as error:
        needed, install = str(error.name).partition(".")[0], 'pip install "sb3_stereo[dataset]"'
        raise ConfigError(f"a dataset needs {needed} (Python 3.11 or newer); install it with: {install}") from error
    try:
        parse_dataset_id(name)
    except (TypeError, ValueError) as error:  # TypeError: without a version
        raise ConfigError(f"--dataset is '{name}'; give {FORM}") from error
    try:
        folder = get_dataset_path(name)
    except OSError as error:
        raise ConfigError(f"cannot write a dataset ({error}); choose a folder with MINARI_DATASETS_PATH") from error
    if folder.exists():
        raise ConfigError(
            f"there is a dataset '{name}' in '{folder}' already; choose another name, such as a next version"
        )


class MinariWriter(DatasetWriter):
    """Writes episodes into a new Minari dataset.

    Args:
        name: The dataset's, see `FORM`.
        played_by: Who acts, e.g. an algorithm.
        author: Who made it; None leaves that out.
    """

    recorder = "sb3_stereo.sharing.minari_dataset.MinariRecorder"
    batch = 50
    folder_variable = "MINARI_DATASETS_PATH"

    def __init__(self, name: str, played_by: str, author: str | None = None) -> None:
        check_dataset(name)
        super().__init__(name)
        self._about: dict[str, Any] = {"algorithm_name": played_by, "author": author}
        self._dataset: MinariDataset | None = None

    @property
    def how_to_load(self) -> str:
        """As in `DatasetWriter`."""
        return f"minari.load_dataset({self.name!r})"

    def close(self) -> None:
        """As in `DatasetWriter`; what has been written is whole already."""

    def _append(self, env: gym.Env[Any, Any], episodes: "Sequence[EpisodeBuffer]") -> None:
        if self._dataset is None:
            self._dataset = self._created(env, episodes)
        else:
            self._dataset.storage.update_episodes(episodes)

    def _succeeded(self, episode: "EpisodeBuffer") -> bool:
        return bool(episode.terminations[-1])

    def _created(self, env: gym.Env[Any, Any], episodes: "Sequence[EpisodeBuffer]") -> "MinariDataset":
        import minari

        assert env.spec is not None  # gym.make made it
        spec = copy.deepcopy(env.spec)
        spec.kwargs.pop("render_mode", None)  # a window is for who plays, not for who learns from it
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what a dataset on one's own machine need not tell
            return minari.create_dataset_from_buffers(
                self.name,
                list(episodes),
                env=spec,
                description=f"{spec.id}, played by {self._about['algorithm_name']}",
                requirements=[f"sb3_stereo=={__version__}"],
                jpeg_encoding=False,
                **self._about,
            )
