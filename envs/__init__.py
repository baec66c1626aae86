"""The task: stereo-pixel reaching environments. Importing this registers them and loads neither torch nor PyBullet."""

from gymnasium.envs.registration import register, registry

# The arms of `robots.ARMS`; cameras, target and all else are the same: the three arms are of about the same size.
_ARM_OF = {"WamStereoReach-v0": "wam", "KukaStereoReach-v0": "kuka", "PandaStereoReach-v0": "panda"}
ENV_IDS = tuple(_ARM_OF)
MAX_EPISODE_STEPS = 30  # the paper's DQN rows fit failures counted as 25 to 30 steps; a guess of ours


def register_envs() -> None:
    """Register every id of `ENV_IDS` with Gymnasium, once."""
    for env_id, arm in _ARM_OF.items():
        if env_id not in registry:
            register(
                env_id,
                entry_point="sb3_stereo.envs.reach:StereoReachEnv",
                max_episode_steps=MAX_EPISODE_STEPS,
                kwargs={"arm": arm},
            )


register_envs()
