"""Laws of the policies: initialisation, where gradients go, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import torch as th
from fake_env import FakeImageEnv
from policy_cases import (
    BOTH,
    EVERY,
    OURS,
    PAPER,
    PAPER_DQN,
    TINY,
    batch_of,
    make,
    observations,
    ready_to_train,
    same,
    state,
)
from stable_baselines3 import DDPG, DQN, TD3
from torch import nn

from sb3_stereo.policies.ddpg import StereoDDPGPolicy
from sb3_stereo.policies.dqn import StereoDQNPolicy
from sb3_stereo.policies.extractors import StereoCnn
from sb3_stereo.policies.layers import statistics_of_each_observation

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
    assert policy.actor_target.features_extractor.encoder is policy.critic_target.features_extractor


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
    policy.critic.q1_forward(obs, policy.actor(obs)).mean().backward()
    assert all(p.grad is None for p in policy.critic.parameters())
    assert all(p.grad is not None for p in policy.actor.parameters())
    sum(policy.critic(obs, actions)).mean().backward()
    assert all(p.grad is not None for p in policy.critic.parameters())
    assert all(p.grad.abs().sum() > 0 for p in policy.critic.features_extractor.parameters())


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


# --- acting


def test_with_the_statistics_of_each_observation_the_action_ignores_the_image():
    """Torch7's default: for a batch of one, a normalised fully connected layer returns its bias."""
    model = make(DDPG, {**PAPER, "acting_statistics": "observation"})
    *_, last_norm, relu, output, tanh = model.policy.actor.mu
    for layer in (last_norm, output):
        nn.init.uniform_(layer.weight), nn.init.uniform_(layer.bias)
    images = observations()
    with th.no_grad():
        expected = tanh(output(relu(last_norm.bias))).numpy()
    for given in (images, images[:1]):
        actions, _ = model.predict(given, deterministic=True)
        assert actions == pytest.approx(np.tile(expected, (len(given), 1)), abs=1e-6)
    model.policy.acting_statistics = "running"
    assert (model.predict(images, deterministic=True)[0].std(axis=0) > 0).any(), "nothing is left behind"


def test_the_statistics_of_each_observation_are_those_of_training_mode_on_a_single_image():
    convs = nn.Sequential(nn.BatchNorm2d(3), nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4))
    images = th.rand(5, 3, 8, 8)
    convs.eval()
    with statistics_of_each_observation(convs), th.no_grad():
        found = convs(images)
    convs.train()
    with th.no_grad():
        expected = th.cat([convs(image[None]) for image in images])
    assert th.allclose(found, expected, atol=1e-5)


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
            {"encoder_loss": "dynamics"},
            "encoder_loss 'dynamics' needs shared_encoder=True",
        ),
        (
            {"encoder_loss": "actor", "shared_encoder": True},
            "unknown encoder_loss 'actor'; choices are critic, dynamics",
        ),
        (
            {"features_extractor_kwargs": {"hidden_norm": "none"}},
            "features_extractor_kwargs cannot set 'hidden_norm' in this policy; "
            "use actor_hidden_norm and critic_hidden_norm",
        ),
        (
            {"acting_statistics": "batch"},
            "unknown acting_statistics 'batch'; choices are running, observation",
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
