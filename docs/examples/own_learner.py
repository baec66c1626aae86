"""Another algorithm on our task with our encoder: `python docs/examples/own_learner.py sac 2000`.

The algorithms are SB3's or sb3-contrib's, with a replay buffer that asks the environment for its mirror symmetry. Any
other off-policy algorithm gets it in the same way: `class MyStereoAlgorithm(OffPolicyMixin, MyAlgorithm)`.
"""

import sys

import gymnasium as gym
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm

import sb3_stereo  # registers the environments
from sb3_stereo.policies.extractors import StereoCnn

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {
    "td3": sb3_stereo.StereoTD3,
    "sac": sb3_stereo.StereoSAC,
    "tqc": sb3_stereo.StereoTQC,
    "crossq": sb3_stereo.StereoCrossQ,
    "ppo": PPO,
}
ENCODER = {"hidden_norm": "layer", "blur": 3.0, "downsample": 3, "kernel_sizes": [4, 3, 3], "strides": [2, 2, 1]}
OFF_POLICY = {"buffer_size": 10_000, "learning_starts": 200, "replay_buffer_kwargs": {"success_fraction": 0.1}}


def train(name: str, n_timesteps: int, env_id: str = sb3_stereo.ENV_IDS[0], **settings: object) -> BaseAlgorithm:
    """Train the named algorithm and return the model; the settings are its constructor's."""
    on_policy = name == "ppo"
    encoder = {"input_norm": "none" if on_policy else "pixel", **ENCODER}
    model = ALGORITHMS[name](
        "MlpPolicy",  # "Mlp" is what follows the encoder
        gym.make(env_id),
        gamma=0.7,
        policy_kwargs={"features_extractor_class": StereoCnn, "features_extractor_kwargs": encoder},
        **({} if on_policy else OFF_POLICY) | settings,
    )
    return model.learn(n_timesteps)


if __name__ == "__main__":
    train(sys.argv[1], int(sys.argv[2])).save(f"my_{sys.argv[1]}")
