"""A policy that was saved, loaded or copied acts as it did, and learns on."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch as th
from policy_cases import BOTH, EVERY, OURS, make, observations, same, state
from stable_baselines3 import DDPG


@EVERY
def test_learns_saves_and_a_loaded_model_acts_as_saved_and_keeps_training(algorithm, policy_kwargs, tmp_path):
    model = make(algorithm, policy_kwargs)
    start = state(model.policy)
    model.learn(30)
    assert not same(start, state(model.policy))
    assert all(value.isfinite().all() for value in model.policy.state_dict().values())
    model.save(tmp_path / "model")
    loaded = algorithm.load(tmp_path / "model", env=model.get_env())
    assert same(state(model.policy), state(loaded.policy))
    for obs in (observations(), observations(1)[0]):
        expected = model.predict(obs, deterministic=True)[0]
        np.testing.assert_array_equal(loaded.predict(obs, deterministic=True)[0], expected)
    saved = state(loaded.policy)
    loaded.learn(30)
    assert not same(saved, state(loaded.policy))


def test_loaded_model_keeps_both_learning_rates(tmp_path):
    model = make(DDPG, OURS)
    model.learn(20)
    model.save(tmp_path / "model")
    loaded = DDPG.load(tmp_path / "model", env=model.get_env())
    assert loaded.critic.optimizer.param_groups[0]["lr_ratio"] == pytest.approx(10)
    assert loaded.actor.optimizer.param_groups[0]["lr_ratio"] == 1


@EVERY
def test_policy_saved_alone_keeps_every_argument_and_acts_the_same(algorithm, policy_kwargs, tmp_path):
    policy = make(algorithm, policy_kwargs).policy
    policy.save(tmp_path / "policy")
    loaded = type(policy).load(tmp_path / "policy")
    parameters = loaded._get_constructor_parameters()
    for key, value in policy_kwargs.items():
        if key == "features_extractor_kwargs":
            assert parameters[key].items() >= value.items()
        else:
            assert parameters[key] == value
    expected = policy.predict(observations(), deterministic=True)[0]
    np.testing.assert_array_equal(loaded.predict(observations(), deterministic=True)[0], expected)


@BOTH
def test_copied_policy_acts_the_same_and_has_its_own_encoder(policy_kwargs):
    policy = make(DDPG, policy_kwargs).policy
    twin = copy.deepcopy(policy)
    np.testing.assert_array_equal(twin.predict(observations())[0], policy.predict(observations())[0])
    with th.no_grad():
        for parameter in policy.parameters():
            parameter.zero_()
    assert not policy.predict(observations())[0].any()
    assert twin.predict(observations())[0].any()
