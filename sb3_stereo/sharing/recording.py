"""Record the episodes of an agent or a person; how they are kept and written is the format's business.

Recorded is the environment itself, within the wrappers that an agent has: those of its actions and observations are not
part of it.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from sb3_stereo.errors import ConfigError
from sb3_stereo.viz.film import Predictor


class Recorder(gym.Wrapper[Any, Any, Any, Any], ABC):
    """Keeps every whole episode in the form of `_episode`."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self._episodes: list[Any] = []

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; one that has not ended is forgotten."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._seed, self._shown, self._infos = seed, [self._look(observation)], [info]
        self._actions: list[Any] = []
        self._results: list[tuple[float, bool, bool]] = []
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Keep the step, and with the last one the episode."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._shown.append(self._look(observation))
        self._infos.append(info)
        self._actions.append(np.array(action, self.action_space.dtype))
        self._results.append((float(reward), bool(terminated), bool(truncated)))
        if terminated or truncated:
            self._episodes.append(self._episode())
        return observation, reward, terminated, truncated, info

    def take(self) -> tuple[gym.Env[Any, Any], list[Any]]:
        """Return the environment that is recorded, and the episodes since the last call."""
        episodes, self._episodes = self._episodes, []
        return self.env, episodes

    def _look(self, observation: Any) -> Any:
        """What is kept of an observation, or of what the environment shows beside it."""
        return observation

    @abstractmethod
    def _episode(self) -> Any:
        """The episode that has just ended."""


class DatasetWriter(ABC):
    """Writes episodes into a new dataset of this machine, some at a time.

    Args:
        name: The dataset's, as the format has them.

    Attributes:
        recorder: Path of the `Recorder` of the format, as a wrapper of `make_env`.
        batch: Episodes between two writes.
        folder_variable: The environment variable that says where the datasets are.

    Raises:
        ConfigError: If no such dataset can be made, before anything is played for it.
    """

    recorder: str
    batch: int
    folder_variable: str

    def __init__(self, name: str) -> None:
        self.name, self.n_episodes, self.n_successes = name, 0, 0

    def write(self, env: gym.Env[Any, Any], episodes: Sequence[Any]) -> None:
        """Append episodes of an environment.

        Raises:
            ConfigError: If they cannot be written; what is there stays.
        """
        if not episodes:
            return
        try:
            self._append(env, episodes)
        except OSError as error:
            way_out = f"choose a folder with {self.folder_variable}"
            raise ConfigError(f"cannot write the dataset '{self.name}' ({error}); {way_out}") from error
        self.n_episodes += len(episodes)
        self.n_successes += sum(self._succeeded(episode) for episode in episodes)

    @abstractmethod
    def close(self) -> None:
        """Finish the dataset's files; nothing may be written after that."""

    @property
    @abstractmethod
    def how_to_load(self) -> str:
        """The line of Python that loads the dataset."""

    @abstractmethod
    def _append(self, env: gym.Env[Any, Any], episodes: Sequence[Any]) -> None:
        """Write episodes of the recorder."""

    @abstractmethod
    def _succeeded(self, episode: Any) -> bool:
        """Whether an episode ended at the goal."""


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
        env: With the writer's recorder around the environment itself, and the agent's wrappers around that.
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
        if (number + 1) % writer.batch == 0 or number + 1 == n_episodes:
            writer.write(*take())
