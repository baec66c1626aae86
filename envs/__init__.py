"""The tasks: reaching and picking by stereo pixels. Importing this registers them, without torch and PyBullet."""

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
# Lifting an object with a suction cup; J6 lets it point down anywhere.
_PICK_KWARGS_OF: dict[str, dict[str, object]] = {"WamStereoPick-v0": {"arm": "wam", "n_joints": 6}}
PICK_ENV_IDS = tuple(_PICK_KWARGS_OF)
MAX_EPISODE_STEPS = 30  # the paper's DQN rows fit failures counted as 25 to 30 steps; a guess of ours
MAX_PICK_STEPS = 50  # about seven times what a scripted policy takes


def register_envs() -> None:
    """Register every id of `ENV_IDS`, `GOAL_ENV_IDS`, `MUJOCO_ENV_IDS` and `PICK_ENV_IDS` with Gymnasium, once."""
    kinds: tuple[tuple[str, int, dict[str, dict[str, object]]], ...] = (
        ("reach:StereoReachEnv", MAX_EPISODE_STEPS, {**_KWARGS_OF, **_MUJOCO_KWARGS_OF}),
        ("goal:StereoReachGoalEnv", MAX_EPISODE_STEPS, _GOAL_KWARGS_OF),
        ("pick:StereoPickEnv", MAX_PICK_STEPS, _PICK_KWARGS_OF),
    )
    for entry_point, max_episode_steps, kwargs_of in kinds:
        for env_id, kwargs in kwargs_of.items():
            if env_id not in registry:
                register(
                    env_id,
                    entry_point=f"sb3_stereo.envs.{entry_point}",
                    max_episode_steps=max_episode_steps,
                    kwargs=kwargs,
                )


register_envs()
