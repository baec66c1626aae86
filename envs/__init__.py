"""The task: stereo-pixel reaching environments. Importing this registers them and loads neither torch nor PyBullet."""

from gymnasium.envs.registration import register, registry

ENV_IDS = ("WamStereoReach-v0",)
MAX_EPISODE_STEPS = 30  # the paper's DQN rows fit failures counted as 25 to 30 steps; a guess of ours


def register_envs() -> None:
    """Register every id of `ENV_IDS` with Gymnasium, once."""
    for env_id in ENV_IDS:
        if env_id not in registry:
            register(
                env_id,
                entry_point="sb3_stereo.envs.reach:StereoReachEnv",
                max_episode_steps=MAX_EPISODE_STEPS,
            )


register_envs()
