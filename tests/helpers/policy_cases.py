"""Tiny models with the policies as they are configured: the paper's, and ours."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
import torch as th
import yaml
from fake_env import FakeImageEnv
from stable_baselines3 import DDPG, DQN, TD3
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from torch import nn

from sb3_stereo.policies.ddpg import StereoDDPGPolicy
from sb3_stereo.policies.dqn import StereoDQNPolicy

TINY = {"buffer_size": 60, "batch_size": 8, "learning_starts": 10, "learning_rate": 1e-3, "seed": 0}
# The two readings as a YAML file would give them, with fewer filters and smaller layers.
PAPER, OURS, PAPER_DQN, OUR_DQN = yaml.safe_load_all(
    """
qf_learning_rate: 0.01
net_arch: [12, 12]
features_extractor_kwargs: {n_filters: 4}
---
shared_encoder: true
n_critics: 2
critic_hidden_norm: layer
qf_learning_rate: 0.01
net_arch: [12, 12]
features_extractor_kwargs: {n_filters: 4, input_norm: pixel, init: orthogonal}
---
{}
---
net_arch: [12]
head_init: fan_in
features_extractor_kwargs: {n_filters: 4, features_dim: 12, input_norm: pixel, hidden_norm: layer, init: orthogonal}
"""
)
BOTH = pytest.mark.parametrize("policy_kwargs", [PAPER, OURS], ids=["paper", "ours"])
EVERY = pytest.mark.parametrize(
    ("algorithm", "policy_kwargs"),
    [(DDPG, PAPER), (DDPG, OURS), (TD3, PAPER), (TD3, OURS), (DQN, PAPER_DQN), (DQN, OUR_DQN)],
    ids=["ddpg-paper", "ddpg-ours", "td3-paper", "td3-ours", "dqn-paper", "dqn-ours"],
)


def make(algorithm: type[OffPolicyAlgorithm], policy_kwargs: dict[str, Any], **settings: Any) -> OffPolicyAlgorithm:
    discrete = algorithm is DQN
    env = FakeImageEnv(n_actions=5 if discrete else None)
    policy = StereoDQNPolicy if discrete else StereoDDPGPolicy
    return algorithm(policy, env, policy_kwargs=copy.deepcopy(policy_kwargs), **{**TINY, **settings})


def ready_to_train(policy_kwargs: dict[str, Any], **settings: Any) -> DDPG:
    """A DDPG model with a full buffer, of which no gradient step has been taken."""
    model = make(DDPG, policy_kwargs, learning_starts=60, **settings)
    model.learn(60)
    model.set_logger(Logger(None, []))
    return model


def state(module: nn.Module) -> dict[str, th.Tensor]:
    return {name: value.clone() for name, value in module.state_dict().items()}


def same(first: dict[str, th.Tensor], second: dict[str, th.Tensor]) -> bool:
    return first.keys() == second.keys() and all(th.equal(first[name], second[name]) for name in first)


def observations(n: int = 6) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (n, 1, 36, 36), dtype=np.uint8)


def batch_of(model: OffPolicyAlgorithm) -> tuple[th.Tensor, th.Tensor]:
    data = model.replay_buffer.sample(8)
    return data.observations, data.actions
