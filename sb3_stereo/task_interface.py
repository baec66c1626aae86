"""What the learner and the tools ask of an environment."""

from __future__ import annotations

from typing import Any

from stable_baselines3.common.vec_env import VecEnv

OFFSETS = "pixel_offsets"  # the key in `info`: where the end effector is from the target, (n_views, 2) in [px]


def asked(env: VecEnv, attribute: str) -> Any:
    """Return what an environment says of itself, through its wrappers; None if it does not say."""
    return env.get_attr(attribute)[0] if env.has_attr(attribute) else None


def check_views(env: VecEnv, n_views: int, what: str, key: str) -> None:
    """Raise a ValueError if the environment tells of another number of views in its `info`."""
    found = next((len(info[OFFSETS]) for info in env.unwrapped.reset_infos if OFFSETS in info), n_views)
    if found != n_views:
        raise ValueError(f"{what} {n_views}, and the environment has views: {found}; set {key}:{found}")
