"""Another learner on our task with our encoder: `python docs/examples/own_learner.py sac 2000`.

The learner is SB3's or sb3-contrib's own, unmodified; any other of them goes the same way.
"""

import sys

import gymnasium as gym
from sb3_contrib import TQC, CrossQ
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm

import sb3_stereo  # registers the environments
from sb3_stereo.learning.replay import StereoReplay
from sb3_stereo.policies.extractors import StereoCnn

LEARNERS: dict[str, type[BaseAlgorithm]] = {"td3": TD3, "sac": SAC, "tqc": TQC, "crossq": CrossQ, "ppo": PPO}
ENCODER = {"hidden_norm": "layer", "blur": 3.0, "downsample": 3, "kernel_sizes": [4, 3, 3], "strides": [2, 2, 1]}


def train(name: str, n_timesteps: int, env_id: str = sb3_stereo.ENV_IDS[0], **settings: object) -> BaseAlgorithm:
    """Train the named learner and return the model; the settings are its constructor's."""
    on_policy = name == "ppo"
    if not on_policy:
        settings = {"buffer_size": 10_000, "learning_starts": 200, **settings}
    input_norm = "none" if on_policy else "pixel"
    model = LEARNERS[name](
        "MlpPolicy",  # "Mlp" is what follows the encoder
        gym.make(env_id),
        gamma=0.7,
        policy_kwargs={
            "features_extractor_class": StereoCnn,
            "features_extractor_kwargs": {"input_norm": input_norm, **ENCODER},
        },
        **settings,
    )
    return model.learn(n_timesteps, callback=None if on_policy else StereoReplay(goal_share=0.1))


if __name__ == "__main__":
    train(sys.argv[1], int(sys.argv[2])).save(f"my_{sys.argv[1]}")
