"""Laws of a gradient step with the policies: learning rates and targets."""

from __future__ import annotations

import copy

import pytest
import torch as th
from policy_cases import BOTH, PAPER, ready_to_train, state
from stable_baselines3 import DDPG
from torch import nn

from sb3_stereo.policies.optim import ScaledAdam


def largest_first_steps(model: DDPG) -> tuple[float, float]:
    """Adam's first step is the learning rate for every weight that has a gradient well above its epsilon."""
    before = [p.clone() for p in model.actor.parameters()], [p.clone() for p in model.critic.parameters()]
    model.train(1, batch_size=8)
    actor, critic = (
        max(float((p - old).detach().abs().max()) for p, old in zip(net.parameters(), olds))
        for net, olds in zip((model.actor, model.critic), before)
    )
    return actor, critic


@BOTH
def test_critic_learns_at_its_own_rate_while_training(policy_kwargs):
    actor, critic = largest_first_steps(ready_to_train(policy_kwargs))
    assert actor == pytest.approx(1e-3, rel=0.01)
    assert critic == pytest.approx(1e-2, rel=0.01)


def test_without_a_rate_of_its_own_the_critic_learns_at_the_actors():
    actor, critic = largest_first_steps(ready_to_train({**PAPER, "qf_learning_rate": None}))
    assert actor == pytest.approx(1e-3, rel=0.01)
    assert critic == pytest.approx(1e-3, rel=0.01)


def test_both_rates_follow_the_schedule():
    model = ready_to_train(PAPER, learning_rate=lambda progress: 1e-3 * (0.5 + 0.5 * progress))
    model._current_progress_remaining = 0.0
    actor, critic = largest_first_steps(model)
    assert actor == pytest.approx(5e-4, rel=0.01)
    assert critic == pytest.approx(5e-3, rel=0.01)


def test_only_the_actor_decays():
    model = ready_to_train({**PAPER, "actor_weight_decay": 0.25})
    assert {group["weight_decay"] for group in model.actor.optimizer.param_groups} == {0.25}
    assert {group["weight_decay"] for group in model.critic.optimizer.param_groups} == {0}


def test_scaled_adam_is_adam_at_the_scaled_rate_after_copying_and_loading():
    def weights(optimizer: th.optim.Optimizer, parameter: nn.Parameter) -> th.Tensor:
        for step in range(3):
            parameter.grad = th.tensor([1.0, -2.0 * step])
            optimizer.step()
        return parameter.detach()

    plain, scaled, loaded = (nn.Parameter(th.ones(2)) for _ in range(3))
    expected = weights(th.optim.Adam([plain], lr=0.03), plain)
    optimizer = ScaledAdam([scaled], lr=0.01, lr_ratio=3.0)
    other = ScaledAdam([loaded], lr=0.5)
    other.load_state_dict(copy.deepcopy(optimizer).state_dict())
    th.testing.assert_close(weights(optimizer, scaled), expected)
    th.testing.assert_close(weights(other, loaded), expected)
    assert optimizer.param_groups[0]["lr"] == 0.01


# --- targets


@BOTH
def test_targets_move_by_tau_once_per_step(policy_kwargs):
    model = ready_to_train(policy_kwargs, tau=0.25)
    old = state(model.policy)
    model.train(1, batch_size=8)
    new = state(model.policy)
    parameters = {name for name, _ in model.policy.named_parameters() if "_target." in name}
    assert any("features_extractor.convs" in name for name in parameters)
    for name in parameters:
        online = name.replace("_target.", ".")
        th.testing.assert_close(new[name], 0.75 * old[name] + 0.25 * new[online])
    for name in new:
        if "_target." in name and "running_" in name:
            assert th.equal(new[name], new[name.replace("_target.", ".")])
