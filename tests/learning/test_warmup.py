"""Gradient steps before acting."""

import pytest
from fake_env import FakeImageEnv
from stable_baselines3 import DDPG

from sb3_stereo.learning.warmup import WarmUp
from sb3_stereo.policies.ddpg import StereoDDPGPolicy


@pytest.mark.parametrize(("n_timesteps", "n_updates"), [(9, 0), (10, 5), (12, 7)])
def test_updates_come_once_when_the_random_transitions_are_there(n_timesteps: int, n_updates: int) -> None:
    model = DDPG(StereoDDPGPolicy, FakeImageEnv(), buffer_size=50, learning_starts=10, batch_size=4, seed=0)
    model.learn(n_timesteps, callback=WarmUp(replay_ratio=0.5))
    assert model._n_updates == n_updates  # SB3 itself starts after learning_starts, one update a step
