"""The task: stereo-pixel reaching environments. Importing this registers them and loads neither torch nor PyBullet."""

from gymnasium.envs.registration import register, registry

# The arms are those of `robots.ARMS`; all else is the same: the three arms are of about the same size.
_KWARGS_OF: dict[str, dict[str, object]] = {
    "WamStereoReach-v0": {"arm": "wam"},
    "KukaStereoReach-v0": {"arm": "kuka"},
    "PandaStereoReach-v0": {"arm": "panda"},
    "WamStereoReachRandom-v0": {"arm": "wam", "random_target": True},
}
ENV_IDS = tuple(_KWARGS_OF)
MAX_EPISODE_STEPS = 30  # the paper's DQN rows fit failures counted as 25 to 30 steps; a guess of ours


def register_envs() -> None:
    """Register every id of `ENV_IDS` with Gymnasium, once."""
    for env_id, kwargs in _KWARGS_OF.items():
        if env_id not in registry:
            register(
                env_id,
                entry_point="sb3_stereo.envs.reach:StereoReachEnv",
                max_episode_steps=MAX_EPISODE_STEPS,
                kwargs=kwargs,
            )


register_envs()
