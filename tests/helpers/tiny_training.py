"""Flags and configurations of training runs that take a second."""

from typing import Any

import fake_reach

from sb3_stereo.config.schema import Config, load_config

SMALL = "policy_kwargs.features_extractor_kwargs.n_filters"
TINY = ["learning_starts:10", "batch_size:4", "buffer_size:50", f"{SMALL}:4"]
QUICK = ["--num-threads", "1", "--device", "cpu", "--gym-packages", "fake_reach"]


def tiny_config(algo: str = "ddpg", n_timesteps: int = 30, **params: Any) -> Config:
    tiny = {"learning_starts": 10, "batch_size": 4, "buffer_size": 50, SMALL: 4}
    return load_config(algo, fake_reach.ENV_ID, params=tiny | params, n_timesteps=n_timesteps)
