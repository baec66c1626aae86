"""Relabelled samples count as the task's own would for that target, which actor and critic see only as offsets."""

from typing import Any

import fake_reach
import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium.spaces import Box

from sb3_stereo.envs.rewards import OffsetReward
from sb3_stereo.learning.relabelling import RelabelledSamples, RelabellingReplayBuffer
from sb3_stereo.learning.replay import StereoReplayBuffer
from sb3_stereo.learning.stereo_ddpg import StereoDDPG
from sb3_stereo.learning.stereo_dqn import StereoDQN
from sb3_stereo.policies.ddpg import StereoDDPGPolicy

JUDGE = OffsetReward(distance_scale=100.0, rho=10.0, success_scale=np.ones(2))
EPISODE = 5
CNN = {"n_filters": 4, "features_dim": 8, "embedding_dim": 3, "input_norm": "pixel"}
POLICY = {"net_arch": [8, 8], "shared_encoder": True, "encoder_loss": "dynamics", "features_extractor_kwargs": CNN}
RUN: dict[str, Any] = {"learning_starts": 30, "batch_size": 8, "buffer_size": 100, "seed": 0, "dynamics_steps": 1}


class SeenTarget(gym.Wrapper[Any, Any, Any, Any]):
    """`FakeReach` whose second view sees the marker too, and which says how its reward is made."""

    offset_reward = OffsetReward(distance_scale=100.0, rho=25.0, success_scale=np.ones(2))

    def reset(self, **kwargs: Any) -> Any:
        observation, info = self.env.reset(**kwargs)
        self._offsets = self._told(info)
        return observation, info

    def step(self, action: Any) -> Any:
        previous = self._offsets
        observation, _, _, truncated, info = self.env.step(action)
        self._offsets = self._told(info)
        info["previous_pixel_offsets"] = previous
        reward, goal = self.offset_reward(previous, self._offsets)
        return observation, float(reward), bool(goal), truncated, info

    def _told(self, info: dict[str, Any]) -> Any:
        info["pixel_offsets"] = np.nan_to_num(info["pixel_offsets"])
        info["pixel_distances"] = np.nan_to_num(info["pixel_distances"])
        info["target_pixels"] = np.full((2, 2), 60.0)
        return info["pixel_offsets"]


def walk(n_steps: int = 40, **settings: Any) -> RelabellingReplayBuffer:
    """A buffer of random walks of the marker, an episode every few steps; images and actions tell the row."""
    rng = np.random.default_rng(0)
    buffer = RelabellingReplayBuffer(
        n_steps, Box(0, 255, (1, 4, 4), np.uint8), Box(-1, 1, (4,)), device="cpu", offset_reward=JUDGE, **settings
    )
    for row in range(n_steps):
        if row % EPISODE == 0:
            target, before = rng.uniform(0, 100, (2, 2)), rng.uniform(-60, 60, (2, 2))
        after = before + rng.uniform(-30, 30, (2, 2))
        reward, goal = JUDGE(before, after)
        info = {"pixel_offsets": after, "previous_pixel_offsets": before, "target_pixels": target}
        image = np.full((1, 1, 4, 4), row, np.uint8)
        done = np.array([row % EPISODE == EPISODE - 1])
        timeout = {"TimeLimit.truncated": bool(done[0] and not goal)}
        buffer.add(image, image, np.full((1, 4), row / n_steps), np.array([reward]), done, [info | timeout])
        before = after
    return buffer


def rows_of(samples: RelabelledSamples) -> Any:
    return samples.observations[:, 0, 0, 0].numpy().astype(int)


def test_rewards_and_ends_are_those_of_the_displaced_target() -> None:
    buffer = walk(relabel_fraction=1.0)
    samples = buffer.sample(500)
    rows, moved = rows_of(samples), samples.displacements.numpy()
    before, after = (offsets[rows, 0] - moved for offsets in (buffer.previous_offsets, buffer.offsets))
    rewards, goals = JUDGE(before, after)
    relabelled = (moved != 0).any(axis=(1, 2))
    np.testing.assert_allclose(samples.rewards.numpy()[relabelled, 0], rewards[relabelled], rtol=1e-5)
    np.testing.assert_array_equal(samples.dones.numpy()[relabelled, 0], goals[relabelled])
    assert relabelled.mean() > 0.9 and goals[relabelled].any() and not goals[relabelled].all()


def test_a_displaced_target_is_where_the_end_effector_was() -> None:
    buffer = walk(relabel_fraction=1.0)
    samples = buffer.sample(500)
    rows, moved = rows_of(samples), samples.displacements.numpy()
    hands = (buffer.offsets + buffer.targets)[:, 0]
    there = buffer.targets[rows, 0] + moved
    found = np.abs(hands[None] - there[:, None]).max(axis=(2, 3)) < 1e-3  # (samples, rows)
    relabelled = (moved != 0).any(axis=(1, 2))
    assert found[relabelled].any(axis=1).all()
    same_episode = (np.arange(len(hands)) // EPISODE == rows[:, None] // EPISODE) & (
        np.arange(len(hands)) >= rows[:, None]
    )
    share = (found & same_episode)[relabelled].any(axis=1).mean()
    assert 0.45 < share < 0.75, "half of them from the rest of the episode, and some by chance"


def test_the_others_are_as_they_were_stored() -> None:
    buffer = walk(relabel_fraction=0.5, success_fraction=0.1)
    samples = buffer.sample(1000)
    rows, real = rows_of(samples), (samples.displacements == 0).all(dim=2).all(dim=1).numpy()
    np.testing.assert_allclose(samples.rewards.numpy()[real, 0], buffer.rewards[rows[real], 0])
    terminal = buffer.dones * (1 - buffer.timeouts)
    np.testing.assert_array_equal(samples.dones.numpy()[real, 0], terminal[rows[real], 0])
    assert 0.5 < real.mean() < 0.65
    if terminal.any():
        assert real[:100].all() and samples.dones[:100].all()


def test_a_hidden_marker_keeps_its_target() -> None:
    buffer = walk(relabel_fraction=1.0)
    buffer.offsets[::2, 0, 1] = np.nan
    samples = buffer.sample(500)
    hidden = rows_of(samples) % 2 == 0
    assert (samples.displacements.numpy()[hidden] == 0).all() and samples.rewards.isfinite().all()


def test_a_mirrored_sample_is_judged_the_same() -> None:
    """The mirror image of a displacement is that of the offsets: rewards do not change, images and actions do."""
    buffer = walk(relabel_fraction=1.0, mirrored_joints=(0,), mirror_probability=1.0)
    samples = buffer.sample(300)
    rows = np.rint(samples.actions[:, 1].numpy() * len(buffer.offsets)).astype(int)
    moved = buffer.mirror_offsets(samples.displacements).numpy()
    rewards, _ = JUDGE(buffer.previous_offsets[rows, 0] - moved, buffer.offsets[rows, 0] - moved)
    relabelled = (moved != 0).any(axis=(1, 2))
    np.testing.assert_allclose(samples.rewards.numpy()[relabelled, 0], rewards[relabelled], rtol=1e-4, atol=1e-6)
    assert (samples.actions[:, 0] <= 0).all()


def ddpg(env: Any = None, relabel: bool = True, **settings: Any) -> Any:
    buffer = {"replay_buffer_kwargs": {"relabel_fraction": 0.8}} if relabel else {}
    env = env or SeenTarget(gym.make(fake_reach.ENV_ID))
    return StereoDDPG(StereoDDPGPolicy, env, policy_kwargs=dict(POLICY), **{**RUN, **buffer, **settings})


def test_a_displacement_is_the_same_as_other_offsets() -> None:
    """Actor and critic see a displaced target only by the offsets that the heads read and predict."""
    policy = ddpg().policy
    policy.set_training_mode(False)
    heads, pose, actions = policy.dynamics, th.rand(6, 3), th.rand(6, 4)
    features = th.cat([pose, th.rand(6, 4)], dim=1)
    values, chosen = policy.critic.q_values(features, actions)[0], policy.actor.mu(features)
    at_rest = th.cat([pose, th.zeros(6, 4)], dim=1)
    assert not th.allclose(policy.critic.q_values(at_rest, actions)[0], values)
    for head in (heads.position, heads.forward_model):
        head[-1].bias.data -= 1.0
    further = th.cat([pose, features[:, 3:] - 1.0], dim=1)
    assert th.allclose(policy.critic.q_values(further, actions)[0], values, atol=1e-6)
    assert th.allclose(policy.actor.mu(further), chosen, atol=1e-6)


def test_it_trains_acts_and_is_saved(tmp_path: Any) -> None:
    model = ddpg(pretraining={"dynamics": 1, "agent": 1})
    model.learn(50)
    assert isinstance(model.replay_buffer, RelabellingReplayBuffer) and model._n_updates > 0
    assert not np.isnan(model.replay_buffer.previous_offsets[:50]).any()
    model.save(tmp_path / "model")
    loaded = StereoDDPG.load(tmp_path / "model", device="cpu")
    image = model.observation_space.sample()
    np.testing.assert_array_equal(
        loaded.predict(image, deterministic=True)[0], model.predict(image, deterministic=True)[0]
    )


def test_without_it_nothing_is_different() -> None:
    """A task that says more of itself is learnt as before, to the bit."""
    plain, told = (
        ddpg(env, relabel=False) for env in (gym.make(fake_reach.ENV_ID), SeenTarget(gym.make(fake_reach.ENV_ID)))
    )
    assert type(told.replay_buffer) is StereoReplayBuffer
    assert list(plain.policy.state_dict()) == list(told.policy.state_dict())
    assert all(map(th.equal, plain.policy.state_dict().values(), told.policy.state_dict().values()))


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"replay_buffer_kwargs": {"relabel_fraction": 1.2}}, "relabel_fraction is 1.2; give a number from 0 to 1"),
        ({"n_steps": 3}, "n_steps is 3, and relabelled samples are single transitions; leave it out"),
        ({"env": gym.make(fake_reach.ENV_ID)}, "relabel_fraction needs a reward that offsets decide"),
        (
            {"policy_kwargs": {**POLICY, "encoder_loss": "critic"}, "dynamics_steps": 0},
            "targets are relabelled by StereoDDPG and StereoTD3 with encoder_loss 'dynamics'",
        ),
        (
            {"policy_kwargs": {**POLICY, "relabelling": True}, "replay_buffer_kwargs": {}},
            "targets are relabelled by StereoDDPG and StereoTD3 with encoder_loss 'dynamics'",
        ),
    ],
)
def test_impossible_settings_are_refused(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        arguments = {"replay_buffer_kwargs": {"relabel_fraction": 0.5}, "policy_kwargs": dict(POLICY), **settings}
        env = arguments.pop("env", None) or SeenTarget(gym.make(fake_reach.ENV_ID))
        StereoDDPG(StereoDDPGPolicy, env, **{**RUN, **arguments})


def test_dqn_does_not_relabel() -> None:
    from sb3_stereo.envs.wrappers import QuantizedActions
    from sb3_stereo.policies.dqn import StereoDQNPolicy

    env = QuantizedActions(SeenTarget(gym.make(fake_reach.ENV_ID)), levels=3)
    with pytest.raises(ValueError, match="targets are relabelled by StereoDDPG and StereoTD3"):
        StereoDQN(StereoDQNPolicy, env, buffer_size=50, replay_buffer_kwargs={"relabel_fraction": 0.5})
