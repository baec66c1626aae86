"""Our environments as LeRobot's EnvHub has them: `env.py` of a repository on the Hub, and what it calls.

LeRobot downloads `env.py`, calls its `make_env`, and steps the vector environment that it gets. What policies are shown
has the names that LeRobot's `preprocess_observation` knows: see `lerobot_views`.
"""

import pprint
from collections.abc import Mapping
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box, Dict
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv

import sb3_stereo.envs  # noqa: F401  (registers the environments, in a worker as well)
from sb3_stereo.sharing.lerobot_views import UNSEEN, check_task, pictures, state, view_names

ENV_FILE = "env.py"  # where LeRobot looks
THEIR_OPTION = "lerobot_"  # reset options that begin so are LeRobot's

TEMPLATE = '''"""{env_id} for LeRobot, which loads it with:

    lerobot.envs.make_env("{repo_id}", trust_remote_code=True)

It needs the package sb3_stereo on Python 3.12 or newer.
"""

from sb3_stereo.sharing.lerobot_env import make_vector_env

ENV_ID = "{env_id}"
ENV_KWARGS = {env_kwargs}


def make_env(n_envs=1, use_async_envs=False, cfg=None):
    """Return the environment as LeRobot's make_env does; cfg.task, if there is one, is the id of another."""
    env_id = getattr(cfg, "task", None) or ENV_ID
    return make_vector_env(env_id, ENV_KWARGS if env_id == ENV_ID else {{}}, n_envs, use_async_envs)
'''


def has_env_file(env_id: str) -> bool:
    """Whether it is an environment of ours, which that file can make."""
    return str(gym.spec(env_id).entry_point).startswith("sb3_stereo.envs.")


def env_file(repo_id: str, env_id: str, env_kwargs: Mapping[str, Any]) -> str:
    """Return the text of a repository's `env.py`.

    Args:
        repo_id: The repository, for its docstring.
        env_id: The environment.
        env_kwargs: Its arguments, plain values.
    """
    kwargs = pprint.pformat(dict(env_kwargs), width=100, sort_dicts=False)
    return TEMPLATE.format(repo_id=repo_id, env_id=env_id, env_kwargs=kwargs)


class LeRobotViews(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """An environment of ours with observations for LeRobot.

    Observation: `Dict` of `pixels`, the RGB frame of each camera by its name, (height, width, 3), uint8, and
    `agent_pos`, the state of `lerobot_views`, (4 * n_views,), float32.

    Raises:
        ConfigError: If the environment has no cameras.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        gym.Wrapper.__init__(self, env)
        self._task = check_task(env)
        camera = self._task.cameras[0].spec
        frame = Box(0, 255, (camera.height, camera.width, 3), np.uint8)
        names = view_names(self._task)
        highest = np.tile(np.array([camera.width, camera.height], np.float32), 2 * len(names))
        self.observation_space = Dict(
            {"pixels": Dict({name: frame for name in names}), "agent_pos": Box(UNSEEN, highest, dtype=np.float32)}
        )

    @property
    def task_description(self) -> str:
        """The episode's task, in words."""
        return str(self._task.task_description)

    task = task_description  # LeRobot asks for either name

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """As in Gymnasium; options of LeRobot's own are left out."""
        ours = {name: value for name, value in (options or {}).items() if not name.startswith(THEIR_OPTION)}
        _, info = self.env.reset(seed=seed, options=ours)
        return self._shown(), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """As in Gymnasium."""
        _, reward, terminated, truncated, info = self.env.step(action)
        return self._shown(), reward, terminated, truncated, info

    def _shown(self) -> dict[str, Any]:
        return {"pixels": pictures(self._task), "agent_pos": state(self._task)}


def make_vector_env(
    env_id: str, env_kwargs: Mapping[str, Any], n_envs: int = 1, use_async_envs: bool = False
) -> dict[str, dict[int, VectorEnv]]:
    """Return a vector environment, as LeRobot's suites have them: `{suite: {task number: environment}}`.

    Args:
        env_id: The environment.
        env_kwargs: Its arguments.
        n_envs: How many at once.
        use_async_envs: Step each in a process of its own.
    """
    env_fns = [partial(_make, env_id, dict(env_kwargs))] * n_envs
    mode = AutoresetMode.SAME_STEP  # LeRobot's
    if use_async_envs and n_envs > 1:  # not by fork, which OpenGL does not survive
        return {env_id: {0: AsyncVectorEnv(env_fns, context="forkserver", autoreset_mode=mode)}}
    return {env_id: {0: SyncVectorEnv(env_fns, autoreset_mode=mode)}}


def _make(env_id: str, env_kwargs: dict[str, Any]) -> gym.Env[Any, Any]:
    return LeRobotViews(gym.make(env_id, **env_kwargs))
