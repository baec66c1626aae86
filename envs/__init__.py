"""The task: stereo-pixel reaching environments. Importing this registers them and loads neither torch nor PyBullet."""

from gymnasium.envs.registration import register, registry

# The arms are those of `robots.ARMS`; all else is the same: the three arms are of about the same size.
# v1 asks for 5 cm where v0's 10 px are 14 cm, and measures them straight: docs/environment.md.
_V1 = {"framing": "close", "markers": "hollow", "rho": 5.0, "distance_scale": 200.0}
_KWARGS_OF: dict[str, dict[str, object]] = {
    "WamStereoReach-v0": {"arm": "wam"},
    "KukaStereoReach-v0": {"arm": "kuka"},
    "PandaStereoReach-v0": {"arm": "panda"},
    "WamStereoReachRandom-v0": {"arm": "wam", "random_target": True},
    "WamStereoReach-v1": {"arm": "wam", **_V1},
    "KukaStereoReach-v1": {"arm": "kuka", **_V1},
    "PandaStereoReach-v1": {"arm": "panda", **_V1},
    "WamStereoReachRandom-v1": {"arm": "wam", "random_target": True, **_V1},
    "WamStereoReachClutter-v0": {"arm": "wam", "clutter": "default", "min_views": 2, **_V1},
}
ENV_IDS = tuple(_KWARGS_OF)
# Goal-conditioned, for HER: the targets are drawn, as in Gymnasium-Robotics' FetchReach.
_GOAL_KWARGS_OF: dict[str, dict[str, object]] = {
    f"{name}StereoReachGoal-v0": {"arm": name.lower(), "random_target": True, **_V1}
    for name in ("Wam", "Kuka", "Panda")
}
GOAL_ENV_IDS = tuple(_GOAL_KWARGS_OF)
# The same task in another simulator, by the id in Bullet: what is learnt in one can be played in the other.
TWIN_OF = {f"{name}StereoReachMujoco-v0": f"{name}StereoReach-v1" for name in ("Wam", "Kuka", "Panda")}
_MUJOCO_KWARGS_OF = {env_id: {**_KWARGS_OF[twin], "simulator": "mujoco"} for env_id, twin in TWIN_OF.items()}
MUJOCO_ENV_IDS = tuple(TWIN_OF)
MAX_EPISODE_STEPS = 30  # the paper's DQN rows fit failures counted as 25 to 30 steps; a guess of ours


def register_envs() -> None:
    """Register every id of `ENV_IDS`, `GOAL_ENV_IDS` and `MUJOCO_ENV_IDS` with Gymnasium, once."""
    for env_id, kwargs in {**_KWARGS_OF, **_GOAL_KWARGS_OF, **_MUJOCO_KWARGS_OF}.items():
        if env_id not in registry:
            goals = env_id in GOAL_ENV_IDS
            register(
                env_id,
                entry_point=f"sb3_stereo.envs.{'goal:StereoReachGoalEnv' if goals else 'reach:StereoReachEnv'}",
                max_episode_steps=MAX_EPISODE_STEPS,
                kwargs=kwargs,
            )


register_envs()
