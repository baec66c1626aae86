"""Episodes as a Minari dataset: what the environment showed and was given, to learn from without a simulator.

Recorded is the environment itself, within the wrappers that an agent has: `recover_environment` of the dataset makes
one with the same spaces, in which the recorded actions repeat the episodes. Images are stored as they are, not as JPEG.
"""

import copy
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

from sb3_stereo import __version__
from sb3_stereo.errors import ConfigError
from sb3_stereo.viz.film import Predictor

if TYPE_CHECKING:
    from minari import MinariDataset
    from minari.data_collector import EpisodeBuffer

RECORDED = "sb3_stereo.sharing.dataset.Recorded"  # its path, as a wrapper of `make_env`
BATCH = 50  # episodes between two writes
FORM = "NAME-vN or GROUP/NAME-vN, of letters, digits, - and _, e.g. wam/reach-v0"


class Recorded(gym.Wrapper[Any, Any, Any, Any]):
    """Keeps every whole episode, as Minari's buffers."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self._episodes: list[EpisodeBuffer] = []

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; one that has not ended is forgotten."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._seed, self._shown, self._infos = seed, [observation], [info]
        self._actions: list[Any] = []
        self._results: list[tuple[float, bool, bool]] = []
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Keep the step, and with the last one the episode."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._shown.append(observation)
        self._infos.append(info)
        self._actions.append(np.array(action, self.action_space.dtype))
        self._results.append((float(reward), bool(terminated), bool(truncated)))
        if terminated or truncated:
            self._episodes.append(self._buffer())
        return observation, reward, terminated, truncated, info

    def take(self) -> "tuple[gym.Env[Any, Any], list[EpisodeBuffer]]":
        """Return the environment that is recorded, and the episodes since the last call."""
        episodes, self._episodes = self._episodes, []
        return self.env, episodes

    def _buffer(self) -> "EpisodeBuffer":
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
    """Raise a ConfigError unless a dataset of that name can be made, before anything is played for it."""
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


class DatasetWriter:
    """Writes episodes into a new dataset of this machine, some at a time.

    Args:
        name: The dataset's, see `check_dataset`.
        played_by: Who acts, e.g. an algorithm.
        author: Who made it; None leaves that out.
    """

    def __init__(self, name: str, played_by: str, author: str | None = None) -> None:
        check_dataset(name)
        self.name, self.n_episodes, self.n_successes = name, 0, 0
        self._about: dict[str, Any] = {"algorithm_name": played_by, "author": author}
        self._dataset: MinariDataset | None = None

    def write(self, env: gym.Env[Any, Any], episodes: "Sequence[EpisodeBuffer]") -> None:
        """Append episodes of an environment.

        Raises:
            ConfigError: If they cannot be written; what is there stays.
        """
        if not episodes:
            return
        try:
            if self._dataset is None:
                self._dataset = self._created(env, episodes)
            else:
                self._dataset.storage.update_episodes(episodes)
        except OSError as error:
            way_out = "choose a folder with MINARI_DATASETS_PATH"
            raise ConfigError(f"cannot write the dataset '{self.name}' ({error}); {way_out}") from error
        self.n_episodes += len(episodes)
        self.n_successes += sum(bool(episode.terminations[-1]) for episode in episodes)

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


def collect(
    model: Predictor,
    env: gym.Env[Any, Any],
    writer: DatasetWriter,
    n_episodes: int,
    seed: int = 0,
    deterministic: bool = True,
    progress: Callable[[int], object] = lambda n_done: None,
) -> None:
    """Play whole episodes into a dataset.

    Args:
        model: The agent.
        env: With a `Recorded` around the environment itself, and the agent's wrappers around that.
        writer: Of the dataset.
        n_episodes: How many.
        seed: Episode i begins with `reset(seed=seed + i)`.
        deterministic: False explores.
        progress: Called with the number of episodes that are done.

    Raises:
        ConfigError: If they cannot be written.
    """
    take = env.get_wrapper_attr("take")
    for number in range(n_episodes):
        observation, _ = env.reset(seed=seed + number)
        ended = False
        while not ended:
            action, _ = model.predict(observation, deterministic=deterministic)
            observation, _, terminated, truncated, _ = env.step(action)
            ended = terminated or truncated
        progress(number + 1)
        if (number + 1) % BATCH == 0 or number + 1 == n_episodes:
            writer.write(*take())
