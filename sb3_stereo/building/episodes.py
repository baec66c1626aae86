"""An episode that another process can continue."""

import time
from typing import Any

import gymnasium as gym
from stable_baselines3.common.vec_env import VecEnv


class ResumableEpisode(gym.Wrapper[Any, Any, Any, Any]):
    """Remembers how the running episode came about: the random generator at its reset, and the actions since.

    Playing them again gives the same state, in another process as well, for every environment that draws from
    `np_random` alone and whose episodes do not depend on what came before them. It is the outermost wrapper, so that
    the other wrappers are replayed too, and stands around SB3's Monitor, whose clock goes on.
    """

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin a new record."""
        generator = self.unwrapped.np_random.bit_generator.state
        self._episode: dict[str, Any] = {"seed": seed, "options": options, "generator": generator, "actions": []}
        return self.env.reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Remember the action."""
        self._episode["actions"].append(action)
        return self.env.step(action)

    def episode(self) -> dict[str, Any]:
        """Return the record of the running episode."""
        return self._episode | {"seconds": time.time() - self.get_wrapper_attr("t_start")}

    def replay(self, episode: dict[str, Any]) -> None:
        """Bring the environment to where the record of an episode ends."""
        self.unwrapped.np_random.bit_generator.state = episode["generator"]
        self.reset(seed=episode["seed"], options=episode["options"])
        for action in episode["actions"]:
            self.step(action)
        self.set_wrapper_attr("t_start", time.time() - episode["seconds"])


def episodes(env: VecEnv) -> list[dict[str, Any]]:
    """Return the records of the running episodes, one per environment."""
    return list(env.env_method("episode"))


def replay(env: VecEnv, records: list[dict[str, Any]]) -> None:
    """Bring every environment to where its record ends."""
    for index, record in enumerate(records):
        env.env_method("replay", record, indices=[index])
