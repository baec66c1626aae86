"""The v0 environments stay what they were: images, offsets and rewards, to the bit."""

import hashlib
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

# Of 4 seeded episodes of 5 random steps each, recorded before v1 existed.
RECORDED = {
    "WamStereoReach-v0": "86aa950281e3257d",
    "KukaStereoReach-v0": "dc33b17fde3734f5",
    "PandaStereoReach-v0": "15bec98b8cbd83d4",
    "WamStereoReachRandom-v0": "8bd4ec92b455017f",
}


def fingerprint(env: Any) -> str:
    """Hash everything a learner gets, and the offsets that its rewards come from."""
    digest, rng = hashlib.sha256(), np.random.default_rng(0)

    def add(observation: Any, info: dict[str, Any], reward: float = 0.0) -> None:
        digest.update(observation.tobytes())
        digest.update(env.render().tobytes())
        digest.update(np.round(info["pixel_offsets"], 9).tobytes())
        digest.update(f"{reward:.9f} {info['is_success']}".encode())

    for seed in range(4):
        add(*env.reset(seed=seed))
        for _ in range(5):
            observation, reward, _, _, info = env.step(rng.uniform(-1, 1, 4))
            add(observation, info, reward)
    return digest.hexdigest()[:16]


@pytest.mark.parametrize("env_id", RECORDED)
def test_v0_gives_the_same_images_offsets_and_rewards_as_ever(env_id: str) -> None:
    env = gym.make(f"sb3_stereo:{env_id}", render_mode="rgb_array").unwrapped
    assert fingerprint(env) == RECORDED[env_id]
    env.close()
