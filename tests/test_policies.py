"""Laws of the policies: initialisation, where gradients go, learning rates, targets, saving."""

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

from sb3_stereo.extractors import StereoCnn
from sb3_stereo.optim import ScaledAdam
from sb3_stereo.policies import StereoDDPGPolicy, StereoDQNPolicy

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


# --- construction


@BOTH
def test_targets_start_equal(policy_kwargs):
    policy = make(DDPG, policy_kwargs).policy
    assert same(state(policy.actor), state(policy.actor_target))
    assert same(state(policy.critic), state(policy.critic_target))
    obs = th.as_tensor(observations())
    policy.set_training_mode(False)
    assert th.equal(policy.actor(obs), policy.actor_target(obs))


def test_dqn_target_starts_equal():
    policy = make(DQN, PAPER_DQN).policy
    assert same(state(policy.q_net), state(policy.q_net_target))


@BOTH
def test_output_layers_start_tiny_and_hidden_layers_in_one_over_root_fan_in(policy_kwargs):
    policy = make(DDPG, policy_kwargs).policy
    outputs = [policy.actor.mu[-2], *(head.after[-1] for head in policy.critic.q_networks)]
    for layer in outputs:
        assert 0 < layer.weight.abs().max() <= 3e-4 and 0 < layer.bias.abs().max() <= 3e-4
    hidden = [policy.actor.mu[0], policy.critic.q_networks[0].before[0], policy.critic.q_networks[0].after[0]]
    for layer in hidden:
        bound = layer.in_features**-0.5
        assert 0.8 * bound < layer.weight.abs().max() <= bound and layer.bias.abs().max() <= bound


def test_paper_networks_have_the_papers_layers():
    """Section 4.2: 3 convolutions of 32, two layers of 200, batch norm at the input and after each hidden layer."""
    policy = DDPG(StereoDDPGPolicy, FakeImageEnv(), buffer_size=10).policy

    def layers(module: nn.Module) -> list[str]:
        kinds = nn.Conv2d | nn.Linear | nn.BatchNorm1d | nn.BatchNorm2d | nn.Tanh
        return [type(m).__name__ for m in module.modules() if isinstance(m, kinds)]

    convs = ["BatchNorm2d"] + ["Conv2d", "BatchNorm2d"] * 3
    assert layers(policy.actor) == convs + ["Linear", "BatchNorm1d"] * 2 + ["Linear", "Tanh"]
    assert layers(policy.critic) == [*convs, "Linear", "BatchNorm1d", "Linear", "Linear"]  # none after the action
    assert policy.critic.q_networks[0].after[0].in_features == 200 + 4
    assert len(policy.critic.q_networks) == 1


def test_paper_dqn_is_the_nature_network_with_xavier_weights():
    q_net = DQN(StereoDQNPolicy, FakeImageEnv(n_actions=81), buffer_size=10).policy.q_net
    layers = [m for m in q_net.modules() if isinstance(m, nn.Conv2d | nn.Linear)]
    shapes = [tuple(layer.weight.shape) for layer in layers]
    assert shapes == [(32, 1, 8, 8), (64, 32, 4, 4), (64, 64, 3, 3), (512, 64), (81, 512)]
    for layer in layers:
        receptive = layer.weight[0, 0].numel()
        bound = (6 / ((layer.weight.shape[0] + layer.weight.shape[1]) * receptive)) ** 0.5
        assert 0.95 * bound < layer.weight.abs().max() <= bound and layer.bias.eq(0).all()
    assert not [m for m in q_net.modules() if "Norm" in type(m).__name__]


@EVERY
def test_construction_leaves_running_statistics_clean(algorithm, policy_kwargs):
    for name, value in make(algorithm, policy_kwargs).policy.state_dict().items():
        if "running_" in name:
            assert value.eq(0.0 if name.endswith("mean") else 1.0).all()


def test_shared_encoder_belongs_to_the_critic_alone():
    policy = make(DDPG, OURS).policy
    encoder = {id(p) for p in policy.critic.features_extractor.parameters()}
    assert encoder and not encoder & {id(p) for p in policy.actor.parameters()}
    registered = [id(p) for net in (policy.actor, policy.critic) for p in net.parameters()]
    assert len(registered) == len(set(registered))
    optimised = {id(p) for group in policy.actor.optimizer.param_groups for p in group["params"]}
    assert not encoder & optimised
    assert not [name for name in policy.state_dict() if name.startswith("actor.features_extractor")]
    assert policy.actor_target.features_extractor._lender[0] is policy.critic_target.features_extractor


# --- gradients


@BOTH
def test_actions_and_values_depend_on_both_cameras(policy_kwargs):
    policy = make(DDPG, {**policy_kwargs, "final_init": 1.0}).policy
    policy.set_training_mode(False)
    obs = th.as_tensor(observations(1))
    for half in (slice(0, 18), slice(18, 36)):
        other = obs.clone()
        other[:, :, half] = 255 - other[:, :, half]
        assert not th.equal(policy.actor(obs), policy.actor(other))
        action = th.zeros(1, 4)
        assert not th.equal(policy.critic(obs, action)[0], policy.critic(other, action)[0])


def test_critic_alone_trains_the_shared_encoder():
    model = ready_to_train(OURS)
    policy, (obs, actions) = model.policy, batch_of(model)
    policy.set_training_mode(True)
    encoder = list(policy.critic.features_extractor.parameters())
    policy.critic.q1_forward(obs, policy.actor(obs)).mean().backward()
    assert all(p.grad is None for p in encoder)
    assert all(p.grad is not None for p in policy.actor.parameters())
    policy.critic(obs, actions)[0].mean().backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in encoder)


def test_neither_loss_trains_what_learns_from_motion():
    model = ready_to_train({**OURS, "encoder_loss": "motion"})
    encoder, motion, critic = state(model.policy.encoder), state(model.policy.motion), state(model.critic)
    model.train(3, batch_size=8)
    assert same(encoder, state(model.policy.encoder)) and same(motion, state(model.policy.motion))
    assert not same(critic, state(model.critic))


def test_each_separate_encoder_is_trained_by_its_own_loss():
    model = ready_to_train(PAPER)
    policy, (obs, _) = model.policy, batch_of(model)
    policy.set_training_mode(True)
    policy.critic.q1_forward(obs, policy.actor(obs)).mean().backward()
    assert all(p.grad is not None for p in policy.actor.features_extractor.parameters())
    assert all(p.grad is None for p in policy.critic.features_extractor.parameters())


def test_actor_update_leaves_the_shared_encoder_and_its_statistics_alone():
    model = ready_to_train(OURS)
    policy, (obs, _) = model.policy, batch_of(model)
    policy.set_training_mode(True)
    before = state(policy.critic.features_extractor)
    (-policy.critic.q1_forward(obs, policy.actor(obs)).mean()).backward()
    policy.actor.optimizer.step()
    assert same(before, state(policy.critic.features_extractor))


@pytest.mark.parametrize("shared_encoder", [True, False])
def test_pixel_statistics_see_one_batch_per_gradient_step(shared_encoder):
    model = ready_to_train({**OURS, "shared_encoder": shared_encoder})
    model.train(3, batch_size=8)
    seen = {n: int(v) for n, v in model.policy.state_dict().items() if n.endswith("input_norm.num_batches_tracked")}
    online = {name: count for name, count in seen.items() if "target" not in name}
    assert len(online) == (1 if shared_encoder else 2)
    assert set(online.values()) == {3}


# --- optimizers


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


# --- targets, memo


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


@pytest.mark.parametrize("algorithm", [DDPG, TD3])
@pytest.mark.parametrize("critic_hidden_norm", ["layer", "batch"])
def test_memo_changes_no_bit_of_the_training(algorithm, critic_hidden_norm):
    def trained(memo: bool) -> tuple[dict[str, th.Tensor], int]:
        model = make(algorithm, {**OURS, "critic_hidden_norm": critic_hidden_norm}, gradient_steps=2)
        passes = []
        for net in (model.critic, model.critic_target):
            net.features_extractor.register_forward_hook(lambda *_: passes.append(1))
        if not memo:
            for net in (model.actor, model.critic, model.actor_target, model.critic_target):
                net.memo = None
        model.learn(30)
        return state(model.policy), len(passes)

    with_memo, fewer_passes = trained(memo=True)
    without, passes = trained(memo=False)
    assert same(with_memo, without)
    assert fewer_passes < passes


def test_shared_encoder_runs_three_times_per_gradient_step():
    model = ready_to_train(OURS)
    passes = []
    for net in (model.critic, model.critic_target):
        net.features_extractor.register_forward_hook(lambda *_: passes.append(1))
    model.train(4, batch_size=8)
    assert len(passes) == 3 * 4


# --- learning, saving, loading


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


# --- refusals


@pytest.mark.parametrize(
    ("policy_kwargs", "message"),
    [
        (
            {"share_features_extractor": True},
            "share_features_extractor=True would train the encoder by the actor's loss; "
            "use shared_encoder=True, where the critic's loss trains it",
        ),
        (
            {"encoder_loss": "motion"},
            "encoder_loss 'motion' needs shared_encoder=True",
        ),
        (
            {"encoder_loss": "actor", "shared_encoder": True},
            "unknown encoder_loss 'actor'; choices are critic, motion",
        ),
        (
            {"features_extractor_kwargs": {"hidden_norm": "none"}},
            "features_extractor_kwargs cannot set 'hidden_norm' in this policy; "
            "use actor_hidden_norm and critic_hidden_norm",
        ),
        ({"critic_hidden_norm": "bn"}, "unknown hidden_norm 'bn'; choices are batch, layer, none"),
        (
            {"net_arch": []},
            "the critic needs at least one hidden layer in net_arch: the action joins after the first",
        ),
    ],
)
def test_contradictory_arguments_are_refused(policy_kwargs, message):
    with pytest.raises(ValueError) as error:
        make(DDPG, policy_kwargs)
    assert str(error.value) == message


def test_unknown_head_initialisation_is_refused():
    with pytest.raises(ValueError) as error:
        make(DQN, {"head_init": "he"})
    assert str(error.value) == "unknown head_init 'he'; choices are fan_in, orthogonal, xavier"


def test_extractor_also_works_in_sb3s_own_policies():
    policy_kwargs = {
        "features_extractor_class": StereoCnn,
        "features_extractor_kwargs": {"n_filters": 4, "features_dim": 12},
    }
    TD3("CnnPolicy", FakeImageEnv(), policy_kwargs=policy_kwargs, **TINY).learn(20)
