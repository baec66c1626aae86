"""Learning from motion: what is asked, who learns, and that something is learnt."""

from __future__ import annotations

from typing import Any

import fake_reach
import gymnasium as gym
import numpy as np
import pytest
import torch as th
from fake_env import FakeImageEnv
from stable_baselines3 import DDPG, DQN
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.callbacks import CallbackList
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from sb3_stereo.envs.wrappers import QuantizedActions
from sb3_stereo.learning.dynamics import LearnFromMotion
from sb3_stereo.learning.replay import StereoReplay, StereoReplayBuffer
from sb3_stereo.learning.warmup import WarmUp
from sb3_stereo.policies.ddpg import StereoDDPGPolicy
from sb3_stereo.policies.dqn import StereoDQNPolicy
from sb3_stereo.policies.dynamics import Motion, MotionHeads

CNN = {"n_filters": 4, "features_dim": 8, "embedding_dim": 3, "input_norm": "pixel"}
POLICY = {"net_arch": [8, 8], "shared_encoder": True, "encoder_loss": "motion", "features_extractor_kwargs": CNN}


def ddpg(env: Any = None, **settings: Any) -> DDPG:
    settings = {"learning_starts": 30, "batch_size": 8, "buffer_size": 100, "seed": 0, **settings}
    return DDPG(StereoDDPGPolicy, env or gym.make(fake_reach.ENV_ID), policy_kwargs=POLICY, **settings)


def motion(n: int, **changes: Any) -> Motion:
    empty = th.zeros(n, 1, 2, 2)
    fields = {
        "observations": empty,
        "efforts": th.rand(n, 4),
        "next_observations": empty,
        "next_offsets": th.rand(n, 2, 2),
    }
    return Motion(**{**fields, **changes})


def test_a_hidden_marker_asks_nothing() -> None:
    heads = MotionHeads(3, 4, 2, 8, 50.0, inverse_coef=0.0)
    features = th.rand(6, 3)
    hidden = motion(6, next_offsets=th.full((6, 2, 2), th.nan))
    assert heads.loss(features, features, hidden) == 0
    half = th.rand(6, 2, 2)
    half[:, 1] = th.nan
    loss = heads.loss(features, features, motion(6, next_offsets=half))
    loss.backward()
    assert loss > 0 and all(p.grad.isfinite().all() for p in heads.position.parameters())  # type: ignore[union-attr]


def test_the_inverse_question_is_weighted() -> None:
    losses = {}
    for coef in (0.0, 1.0, 2.0):
        th.manual_seed(0)
        heads = MotionHeads(3, 4, 2, 8, 50.0, inverse_coef=coef)
        losses[coef] = heads.loss(th.ones(6, 3), th.ones(6, 3), motion(6, efforts=th.ones(6, 4))).item()
    assert losses[2.0] - losses[0.0] == pytest.approx(2 * (losses[1.0] - losses[0.0])) and losses[1.0] > losses[0.0]


def test_the_encoder_learns_where_the_hand_is() -> None:
    """From the fake arm's brightness: the loss falls to a small part."""
    model = ddpg(learning_starts=60)
    callback = LearnFromMotion(gradient_steps=1, replay_ratio=8, batch_size=32)
    losses = []
    original = MotionHeads.loss

    def recorded(self: MotionHeads, *args: Any) -> th.Tensor:
        losses.append(original(self, *args))
        return losses[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MotionHeads, "loss", recorded)
        model.learn(60, callback=callback)
    losses = [loss.item() for loss in losses]
    assert callback.n_updates == len(losses) == 60 * 8 + 1
    assert np.mean(losses[-20:]) < 0.3 * np.mean(losses[:5])


def test_updates_follow_the_random_steps() -> None:
    model = ddpg()
    callback = LearnFromMotion(gradient_steps=2, replay_ratio=0.5, batch_size=4)
    encoder = [p.clone() for p in model.policy.encoder.parameters()]
    model.learn(29, callback=callback)
    assert callback.n_updates == 0
    assert all(map(th.equal, encoder, model.policy.encoder.parameters()))
    model.learn(6, callback=callback, reset_num_timesteps=False)
    assert callback.n_updates == 15 + 2 * 6  # steps 30 to 35
    assert not any(map(th.equal, encoder, model.policy.encoder.parameters()))


def test_the_critic_knows_where_an_action_leads() -> None:
    """With everything else the same, what is foreseen changes Q, and its gradient reaches the action."""
    policy = ddpg().policy
    policy.set_training_mode(False)
    images, action = th.zeros(2, 1, 60, 60, dtype=th.uint8), th.zeros(2, 4, requires_grad=True)
    before = policy.critic(images, action)[0]
    for parameter in policy.motion.prediction.parameters():
        parameter.data += 0.1
    assert not th.equal(before, policy.critic(images, action)[0])
    head = policy.critic.q_networks[0]
    with th.no_grad():
        head.after[0].weight[:, 8:12] = 0  # the action's own way in
    policy.critic.q1_forward(images, action).sum().backward()
    assert action.grad is not None and action.grad.abs().sum() > 0


def test_what_is_foreseen_are_offsets_and_their_lengths() -> None:
    heads = MotionHeads(3, 4, 2, 8)
    foreseen = heads.foresee(th.rand(5, 3), th.rand(5, 4))
    assert foreseen.shape == (5, heads.foresight_dim)
    offsets, lengths = foreseen[:, :4].reshape(5, 2, 2), foreseen[:, 4:]
    assert th.allclose(th.hypot(offsets[..., 0], offsets[..., 1]), lengths)


@pytest.mark.parametrize("mirrored", [True, False])
def test_it_takes_any_replay_buffer(mirrored: bool) -> None:
    model = ddpg()
    motion = LearnFromMotion(replay_ratio=1, batch_size=4)
    model.learn(32, callback=CallbackList([StereoReplay(), motion] if mirrored else [motion]))
    assert isinstance(model.replay_buffer, StereoReplayBuffer)
    assert model.replay_buffer.mirror_probability == (0.5 if mirrored else 0.0)
    stored = model.replay_buffer.offsets[: model.replay_buffer.size(), 0, 0, 0]
    assert np.isfinite(stored).all() and stored.std() > 0


def test_dqn_learns_to_see_too() -> None:
    env = QuantizedActions(gym.make(fake_reach.ENV_ID), levels=3)
    kwargs = {"features_extractor_kwargs": {**CNN, "hidden_norm": "layer"}}
    model = DQN(StereoDQNPolicy, env, policy_kwargs=kwargs, learning_starts=30, batch_size=8, buffer_size=100)
    before = [p.clone() for p in model.q_net.features_extractor.parameters()]
    model.learn(30, callback=LearnFromMotion(replay_ratio=1, batch_size=4))
    assert not any(map(th.equal, before, model.q_net.features_extractor.parameters()))


def test_wrapped_vector_environments_are_fine() -> None:
    model = ddpg(VecMonitor(DummyVecEnv([lambda: gym.make(fake_reach.ENV_ID)] * 2)))
    callback = LearnFromMotion(replay_ratio=0.5, batch_size=4)
    model.learn(34, callback=callback)
    assert callback.n_updates == 15 + 2 * 2 * 3  # at 30, 32 and 34 steps


@pytest.mark.parametrize("learning_starts", [0, 1, 2])
def test_learning_may_start_at_once(learning_starts: int) -> None:
    env = DummyVecEnv([fake_reach.FakeReachEnv] * 2)
    model = ddpg(env, learning_starts=learning_starts, batch_size=4)
    learn = LearnFromMotion(gradient_steps=1, replay_ratio=1.0, batch_size=4)
    model.learn(8, callback=CallbackList([learn, WarmUp(replay_ratio=1.0)]))
    assert learn.n_updates > 0 and model._n_updates > 0


def test_an_environment_without_offsets_is_refused() -> None:
    model = ddpg(FakeImageEnv())
    with pytest.raises(ValueError, match=r"^LearnFromMotion needs info\['pixel_offsets'\], which this environment "):
        model.learn(5, callback=LearnFromMotion())
    assert type(model.replay_buffer) is ReplayBuffer


def test_a_policy_that_has_no_use_for_it_is_refused() -> None:
    model = DDPG(StereoDDPGPolicy, gym.make(fake_reach.ENV_ID), buffer_size=10)
    with pytest.raises(ValueError, match=r"^LearnFromMotion needs DQN, or a StereoDDPGPolicy with encoder_loss "):
        model.learn(5, callback=LearnFromMotion())
