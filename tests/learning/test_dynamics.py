"""Dynamics heads: what they regress, who trains them, and that something is learnt."""

from __future__ import annotations

import copy
from typing import Any

import fake_reach
import gymnasium as gym
import numpy as np
import pytest
import torch as th
from fake_env import FakeImageEnv
from policy_cases import same, state
from stable_baselines3 import DDPG, TD3
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.noise import OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from sb3_stereo.envs.wrappers import QuantizedActions
from sb3_stereo.learning.replay import StereoReplayBuffer
from sb3_stereo.learning.stereo_ddpg import StereoDDPG, StereoTD3
from sb3_stereo.learning.stereo_dqn import StereoDQN
from sb3_stereo.policies.ddpg import StereoDDPGPolicy
from sb3_stereo.policies.dqn import StereoDQNPolicy
from sb3_stereo.policies.dynamics import FORWARD_DYNAMICS, DynamicsHeads, DynamicsSamples

CNN = {"n_filters": 4, "features_dim": 8, "embedding_dim": 3, "input_norm": "pixel"}
POLICY = {"net_arch": [8, 8], "shared_encoder": True, "encoder_loss": "dynamics", "features_extractor_kwargs": CNN}
RUN: dict[str, Any] = {"learning_starts": 30, "batch_size": 8, "buffer_size": 100, "seed": 0}


def ddpg(env: Any = None, algorithm: type[TD3] = StereoDDPG, **settings: Any) -> Any:
    settings = {**RUN, "dynamics_steps": 1, **settings}
    policy_kwargs = copy.deepcopy(POLICY) | settings.pop("policy_kwargs", {})
    return algorithm(StereoDDPGPolicy, env or gym.make(fake_reach.ENV_ID), policy_kwargs=policy_kwargs, **settings)


def dqn(**settings: Any) -> StereoDQN:
    env = QuantizedActions(gym.make(fake_reach.ENV_ID), levels=3)
    policy_kwargs = {"encoder_loss": "critic+dynamics", "features_extractor_kwargs": {**CNN, "hidden_norm": "layer"}}
    return StereoDQN(StereoDQNPolicy, env, policy_kwargs=policy_kwargs, **{**RUN, "train_freq": 1, **settings})


def samples(n: int, **changes: Any) -> DynamicsSamples:
    empty = th.zeros(n, 1, 2, 2)
    fields = {
        "observations": empty,
        "actions": th.rand(n, 4),
        "next_observations": empty,
        "next_offsets": th.rand(n, 2, 2),
    }
    return DynamicsSamples(**{**fields, **changes})


# --- the heads


def test_occluded_markers_are_masked() -> None:
    heads = DynamicsHeads(3, 4, 2, 8, 50.0, inverse_coef=0.0)
    features = th.rand(6, 3)
    hidden = samples(6, next_offsets=th.full((6, 2, 2), th.nan))
    assert heads.loss(features, features, hidden) == 0
    half = th.rand(6, 2, 2)
    half[:, 1] = th.nan
    loss = heads.loss(features, features, samples(6, next_offsets=half))
    loss.backward()
    assert loss > 0 and all(p.grad.isfinite().all() for p in heads.position.parameters())  # type: ignore[union-attr]


def test_the_inverse_model_is_weighted() -> None:
    losses = {}
    for coef in (0.0, 1.0, 2.0):
        th.manual_seed(0)
        heads = DynamicsHeads(3, 4, 2, 8, 50.0, inverse_coef=coef)
        losses[coef] = heads.loss(th.ones(6, 3), th.ones(6, 3), samples(6, actions=th.ones(6, 4))).item()
    assert losses[2.0] - losses[0.0] == pytest.approx(2 * (losses[1.0] - losses[0.0])) and losses[1.0] > losses[0.0]


def test_predictions_are_offsets_and_their_lengths() -> None:
    heads = DynamicsHeads(3, 4, 2, 8)
    predicted = heads.predict_offsets(th.rand(5, 3), th.rand(5, 4))
    assert predicted.shape == (5, heads.prediction_dim)
    offsets, lengths = predicted[:, :4].reshape(5, 2, 2), predicted[:, 4:]
    assert th.allclose(th.hypot(offsets[..., 0], offsets[..., 1]), lengths)


def test_a_predicted_change_of_features_is_none_without_an_action() -> None:
    features, actions = th.rand(5, 3), th.rand(5, 4)
    heads = DynamicsHeads(3, 4, 2, 8, forward_dynamics="features")
    read = heads.position(features)
    assert th.allclose(heads.offsets_after(features, th.zeros(5, 4)), read, atol=1e-6)
    assert not th.allclose(heads.offsets_after(features, actions), read, atol=1e-3)


def test_an_unknown_forward_dynamics_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^unknown forward_dynamics 'pixels'; choices are offsets, features$"):
        ddpg(policy_kwargs={"forward_dynamics": "pixels"})


@pytest.mark.parametrize("forward_dynamics", FORWARD_DYNAMICS)
def test_the_critic_is_conditioned_on_the_forward_model(forward_dynamics: str) -> None:
    """With everything else the same, a prediction changes Q, and its gradient reaches the action."""
    policy = ddpg(policy_kwargs={"forward_dynamics": forward_dynamics}).policy
    images, action = th.zeros(2, 1, 60, 60, dtype=th.uint8), th.zeros(2, 4, requires_grad=True)
    before = policy.critic(images, action)[0]
    for parameter in policy.dynamics.position.parameters() if forward_dynamics == "features" else ():
        parameter.data += 0.1
    for parameter in policy.dynamics.forward_model.parameters():
        parameter.data += 0.1
    assert not th.equal(before, policy.critic(images, action)[0])
    head = policy.critic.q_networks[0]
    with th.no_grad():
        head.after[0].weight[:, 8:12] = 0  # the action's own way in
    policy.critic.q1_forward(images, action).sum().backward()
    assert action.grad is not None and action.grad.abs().sum() > 0


# --- the update


@pytest.mark.parametrize("forward_dynamics", FORWARD_DYNAMICS)
def test_each_loss_trains_its_own_networks(forward_dynamics: str) -> None:
    model = ddpg(pretraining={"dynamics": 1}, policy_kwargs={"forward_dynamics": forward_dynamics})
    model.learn(34)
    policy = model.policy
    encoder, heads, critic, actor = map(state, (policy.encoder, policy.dynamics, policy.critic, policy.actor))
    model._train_agent(3, 8)
    assert same(encoder, state(policy.encoder)) and same(heads, state(policy.dynamics))
    assert not same(critic, state(policy.critic)) and not same(actor, state(policy.actor))
    critic, actor = state(policy.critic), state(policy.actor)
    model._train_dynamics(1, 8)
    assert same(critic, state(policy.critic)) and same(actor, state(policy.actor))
    assert not any(map(th.equal, encoder.values(), state(policy.encoder).values()))
    trained_elsewhere = [*policy.encoder.parameters(), *policy.dynamics.parameters()]
    assert all(p.requires_grad for p in trained_elsewhere)


@pytest.mark.parametrize(("ours", "theirs"), [(StereoDDPG, DDPG), (StereoTD3, TD3)])
def test_the_agents_update_is_sb3s(ours: type[TD3], theirs: type[TD3]) -> None:
    """On the same batches, several times, with the encoder as it is: only the order of roundings differs."""
    model = ddpg(algorithm=ours, pretraining={"dynamics": 1})
    model.learn(30)
    twin = copy.deepcopy(model.policy.state_dict())
    optimizers = [copy.deepcopy(net.optimizer.state_dict()) for net in (model.actor, model.critic)]

    def trained(train: Any) -> dict[str, th.Tensor]:
        model.policy.load_state_dict(twin)
        for net, saved in zip((model.actor, model.critic), optimizers, strict=True):
            net.optimizer.load_state_dict(copy.deepcopy(saved))
        model._n_updates = 0
        for seed in range(4):
            np.random.seed(seed)
            th.manual_seed(seed)
            train(1, 8)
        return state(model.policy)

    expected = trained(lambda n, size: theirs.train(model, n, size))
    found = trained(model._train_agent)
    assert not same(expected, twin)
    for name in expected:
        th.testing.assert_close(found[name], expected[name], rtol=1e-4, atol=1e-6)


def test_encoding_several_batches_at_once_changes_nothing() -> None:
    model = ddpg(pretraining={"dynamics": 1})
    model.learn(30)
    np.random.seed(0)
    together = list(model._encoded_batches(6, 8))
    np.random.seed(0)
    for batch, features, next_features in together:
        alone = model.replay_buffer.sample(8)
        assert th.equal(batch.observations, alone.observations) and th.equal(batch.actions, alone.actions)
        for found, images in ((features, alone.observations), (next_features, alone.next_observations)):
            th.testing.assert_close(found, model.critic.extract_features(images, model.critic.features_extractor))


@pytest.mark.parametrize(("ours", "theirs"), [(StereoDDPG, DDPG), (StereoTD3, TD3)])
def test_without_its_own_settings_it_is_sb3s_bit_for_bit(ours: type[TD3], theirs: type[TD3]) -> None:
    policy_kwargs = {"net_arch": [8, 8], "features_extractor_kwargs": {"n_filters": 4}}

    def trained(algorithm: type[TD3]) -> Any:
        noise = OrnsteinUhlenbeckActionNoise(np.zeros(4), np.full(4, 0.3))
        model = algorithm(StereoDDPGPolicy, FakeImageEnv(), policy_kwargs=policy_kwargs, action_noise=noise, **RUN)
        model.learn(45)
        assert type(model.replay_buffer) is ReplayBuffer
        return state(model.policy)

    assert same(trained(ours), trained(theirs))


def test_the_encoder_learns_where_the_hand_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the fake arm's brightness: the loss falls to a small part."""
    losses: list[float] = []
    original = DynamicsHeads.update
    monkeypatch.setattr(DynamicsHeads, "update", lambda *a: losses.append(original(*a)) or losses[-1])
    ddpg(learning_starts=60, batch_size=32, pretraining={"dynamics": 8}).learn(60)
    assert len(losses) == 60 * 8
    assert np.mean(losses[-20:]) < 0.3 * np.mean(losses[:5])


# --- the order of a training


def test_augmentation_changes_what_the_encoder_sees_from_its_first_step_on(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[DynamicsSamples] = []
    update = DynamicsHeads.update
    monkeypatch.setattr(
        DynamicsHeads,
        "update",
        lambda self, encoder, samples: (seen.append(samples), update(self, encoder, samples))[1],
    )
    model = ddpg(augmentation={"begin": 40, "share": 1.0, "zoom": 0.5}, dynamics_steps=1)
    stored: list[DynamicsSamples] = []
    sample = StereoReplayBuffer.sample_dynamics
    monkeypatch.setattr(
        StereoReplayBuffer,
        "sample_dynamics",
        lambda self, batch_size: (stored.append(sample(self, batch_size)), stored[-1])[1],
    )
    model.learn(50)
    same_images = [th.equal(one.observations, other.observations) for one, other in zip(seen, stored, strict=True)]
    same_offsets = [
        np.array_equal(one.next_offsets, other.next_offsets, equal_nan=True)
        for one, other in zip(seen, stored, strict=True)
    ]
    assert same_images == same_offsets == [True] * 9 + [False] * 11
    assert all(th.equal(one.actions, other.actions) for one, other in zip(seen, stored, strict=True))


def test_pretraining_comes_once_the_encoder_first(monkeypatch: pytest.MonkeyPatch) -> None:
    model = ddpg(pretraining={"agent": 0.5, "dynamics": 2}, dynamics_steps=3, gradient_steps=2)
    calls: list[tuple[int, str, int]] = []
    for name in ("_train_dynamics", "_train_agent"):
        original = getattr(model, name)

        def noted(n: int, size: int, name: str = name, original: Any = original) -> None:
            calls.append((model.num_timesteps, name, n))
            original(n, size)

        monkeypatch.setattr(model, name, noted)
    model.learn(32)
    assert calls == [
        (29, "_train_dynamics", 60),
        (29, "_train_agent", 15),
        (31, "_train_dynamics", 3),
        (31, "_train_agent", 2),
        (32, "_train_dynamics", 3),
        (32, "_train_agent", 2),
    ]


@pytest.mark.parametrize("make", [ddpg, dqn])
def test_a_model_that_sb3_saved_and_loaded_goes_on_without_pretraining_again(make: Any, tmp_path: Any) -> None:
    model = make(pretraining={"agent": 0.5, "dynamics": 1}, dynamics_steps=2)
    model.learn(33)
    model.save(tmp_path / "model")
    loaded = type(model).load(tmp_path / "model", env=model.env)
    assert same(state(model.policy), state(loaded.policy))
    assert loaded.policy.dynamics.n_updates == model.policy.dynamics.n_updates == 30 + 2 * 3
    saved, found = (m.policy.dynamics.optimizer.state_dict() for m in (model, loaded))
    assert th.equal(saved["state"][0]["exp_avg"], found["state"][0]["exp_avg"])
    loaded.learn(33)
    assert loaded.policy.dynamics.n_updates == 30 + 2 * 6
    assert loaded._n_updates == 15 + 6


@pytest.mark.parametrize("learning_starts", [0, 1, 2])
def test_learning_may_start_at_once(learning_starts: int) -> None:
    env = DummyVecEnv([fake_reach.FakeReachEnv] * 2)
    model = ddpg(env, learning_starts=learning_starts, batch_size=4, pretraining={"dynamics": 1, "agent": 1})
    model.learn(8)
    assert model.policy.dynamics.n_updates > 0 and model._n_updates > 0


@pytest.mark.parametrize("n_envs", [1, 4])
def test_steps_are_per_training_whatever_the_number_of_environments(n_envs: int) -> None:
    """As SB3 counts `gradient_steps`, so that a YAML file means the same here and in the zoo."""
    env = VecMonitor(DummyVecEnv([lambda: gym.make(fake_reach.ENV_ID)] * n_envs))
    model = ddpg(env, learning_starts=8, dynamics_steps=2, gradient_steps=3)
    model.learn(8 + 3 * n_envs)
    assert (int(model.policy.dynamics.n_updates), model._n_updates) == (2 * 3, 3 * 3)


def test_dqns_encoder_learns_from_both_losses_and_its_heads_are_the_policys() -> None:
    model = dqn(pretraining={"dynamics": 1}, dynamics_steps=1)
    before = state(model.policy.encoder)
    model.learn(30)
    pretrained = state(model.policy.encoder)
    assert not any(map(th.equal, before.values(), pretrained.values()))
    model._train_agent(1, 8)
    assert not same(pretrained, state(model.policy.encoder))
    assert any(name.startswith("dynamics.forward_model") for name in model.policy.state_dict())


def test_gradients_of_one_loss_do_not_leak_into_the_other() -> None:
    def updated(leftover: float) -> dict[str, th.Tensor]:
        model = dqn(pretraining={"dynamics": 1}, dynamics_steps=1)
        model.learn(30)
        for parameter in model.policy.parameters():
            parameter.grad = th.full_like(parameter, leftover)
        np.random.seed(0)
        model._train_dynamics(1, 8)
        assert all(p.grad is None for p in (*model.policy.encoder.parameters(), *model.policy.dynamics.parameters()))
        return state(model.policy)

    assert same(updated(0.0), updated(1.0))


# --- what the environment and the settings say


def test_the_environment_says_how_many_views_there_are() -> None:
    class Mono(fake_reach.FakeReachEnv):
        n_views = 1

        def _info(self) -> dict[str, Any]:
            return {**super()._info(), "pixel_offsets": super()._info()["pixel_offsets"][:1]}

    model = ddpg(Mono(), pretraining={"dynamics": 1})
    model.learn(33)
    assert model.policy.dynamics.n_views == model.replay_buffer.n_views == 1
    with pytest.raises(ValueError) as error:
        ddpg(Mono(), policy_kwargs={"n_views": 2})
    assert str(error.value) == "policy_kwargs: n_views is 2, and the environment has 1; leave it out"


def test_the_replay_buffer_asks_for_the_mirror() -> None:
    buffer = ddpg().replay_buffer
    assert isinstance(buffer, StereoReplayBuffer)
    assert buffer.mirror_probability == 0.5 and buffer._signs.tolist() == [-1, 1, -1, 1]
    assert ddpg(replay_buffer_kwargs={"mirror_probability": 0.0}).replay_buffer.mirror_probability == 0.0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"dynamics_steps": 0},
            "encoder_loss is 'dynamics', and nothing trains the encoder; "
            "set dynamics_steps, as in dynamics_steps: 2, or encoder_loss to 'critic'",
        ),
        (
            {"policy_kwargs": {"encoder_loss": "critic"}},
            "dynamics_steps and pretraining.dynamics train an encoder by its auxiliary losses, and StereoDDPGPolicy "
            "has none here; set encoder_loss ('dynamics', for DQN 'critic+dynamics') in policy_kwargs, "
            "or leave them out",
        ),
        (
            {"replay_buffer_class": ReplayBuffer},
            "encoder_loss 'dynamics' needs the offsets that a StereoReplayBuffer stores, and replay_buffer_class is "
            "ReplayBuffer; leave replay_buffer_class out",
        ),
        ({"dynamics_steps": -1}, "dynamics_steps must not be negative, got -1"),
        ({"augmentation": {"share": 2}}, "augmentation: share is 2; give a number from 0 to 1"),
        (
            {"augmentation": {}, "dynamics_steps": 0, "policy_kwargs": {"encoder_loss": "critic"}},
            "augmentation changes the images of the encoder's auxiliary losses, and StereoDDPGPolicy has none here; "
            "set encoder_loss in policy_kwargs, or leave it out",
        ),
        ({"pretraining": {"encoder": 1}}, "unknown pretraining 'encoder'; choices are dynamics, agent"),
        ({"pretraining": {"agent": -1}}, "pretraining: agent must be a number that is not negative, got -1"),
        (
            {"exploration": {"n_step": 1}},
            "unknown exploration 'n_step'; choices are n_steps, initial_epsilon, final_epsilon, theta",
        ),
        ({"exploration": {"n_steps": 0}}, "n_steps must be positive, got 0"),
    ],
)
def test_contradictory_settings_are_refused_when_the_model_is_made(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as error:
        ddpg(**settings)
    assert str(error.value) == message


@pytest.mark.parametrize("algorithm", [DDPG, TD3])
def test_sb3s_own_algorithm_refuses_an_encoder_that_nothing_has_trained(algorithm: type[TD3]) -> None:
    model = algorithm(StereoDDPGPolicy, gym.make(fake_reach.ENV_ID), policy_kwargs=copy.deepcopy(POLICY), **RUN)
    with pytest.raises(ValueError) as error:
        model.learn(40)
    assert str(error.value) == (
        "encoder_loss is 'dynamics', and nothing has trained the encoder; "
        "take StereoDDPG or StereoTD3 with dynamics_steps, or set encoder_loss to 'critic'"
    )
    assert model._n_updates == 0


def test_an_environment_without_offsets_is_refused() -> None:
    with pytest.raises(ValueError) as error:
        ddpg(FakeImageEnv(shape=(1, 60, 60))).learn(5)
    assert str(error.value) == (
        "encoder_loss 'dynamics' needs info['pixel_offsets'], which this environment does not give; "
        "leave it out and set encoder_loss to 'critic'"
    )


@pytest.mark.parametrize("algorithm", [StereoDDPG, StereoTD3])
def test_sb3s_own_policies_train_as_well(algorithm: type[TD3]) -> None:
    model = algorithm("CnnPolicy", FakeImageEnv(), pretraining={"agent": 0.5}, **RUN)
    model.learn(33)
    assert model._n_updates == 15 + 3
