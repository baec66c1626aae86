"""The goal-conditioned task is the same task, and what HER relabels is judged as the environment judges it."""

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from sb3_stereo.envs import GOAL_ENV_IDS
from sb3_stereo.envs.goal import PREVIOUS, UNSEEN, StereoReachGoalEnv
from sb3_stereo.envs.reach import StereoReachEnv

V1: dict[str, Any] = {"framing": "close", "markers": "hollow", "rho": 40.0, "distance_scale": 200.0}  # rho: often met


@pytest.fixture(scope="module", params=["sparse", "dense"])
def goal_env(request: pytest.FixtureRequest) -> Iterator[StereoReachGoalEnv]:
    env = StereoReachGoalEnv(reward_type=request.param, **V1)
    yield env
    env.close()


@pytest.fixture(scope="module")
def plain_env() -> Iterator[StereoReachEnv]:
    env = StereoReachEnv(**V1)
    yield env
    env.close()


def transitions(env: StereoReachGoalEnv, n: int) -> Iterator[tuple[dict[str, Any], float, bool, dict[str, Any]]]:
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    for _ in range(n):
        observation, reward, terminated, _, info = env.step(rng.uniform(-1, 1, 4))
        yield observation, reward, terminated, info
        if terminated:
            env.reset()


@pytest.mark.parametrize("env_id", GOAL_ENV_IDS)
def test_the_registered_ones_keep_gymnasiums_rules(env_id: str) -> None:
    env = gym.make(env_id)
    assert env.spec is not None and env.spec.max_episode_steps == 30
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_it_is_the_same_task(goal_env: StereoReachGoalEnv, plain_env: StereoReachEnv) -> None:
    goal_env.reset(seed=3)
    plain_env.reset(seed=3)
    for action in np.random.default_rng(3).uniform(-1, 1, (10, 4)):
        observation, reward, terminated, _, info = goal_env.step(action)
        image, dense, reached, _, plain_info = plain_env.step(action)
        np.testing.assert_array_equal(observation["observation"], image)
        assert terminated == reached == info["is_success"]
        assert reward == (dense if goal_env.reward_type == "dense" else float(reached) - 1)
        both_seen = (observation["achieved_goal"] != UNSEEN) & (observation["desired_goal"] != UNSEEN)
        offsets = observation["achieved_goal"] - observation["desired_goal"]
        np.testing.assert_allclose(offsets[both_seen], plain_info["pixel_offsets"].ravel()[both_seen])


def test_what_a_step_gives_is_what_its_goals_compute(goal_env: StereoReachGoalEnv) -> None:
    verdicts = set()
    for observation, reward, terminated, info in transitions(goal_env, 60):
        goals = observation["achieved_goal"], observation["desired_goal"]
        assert goal_env.compute_reward(*goals, info) == reward
        assert goal_env.compute_terminated(*goals, info) == terminated
        assert goal_env.compute_truncated(*goals, info) is False
        verdicts.add(terminated)
    assert verdicts == {True, False}, "the steps must tell a goal from none"


def test_a_batch_is_judged_as_its_transitions_one_by_one(goal_env: StereoReachGoalEnv) -> None:
    seen = list(transitions(goal_env, 40))
    achieved = np.array([observation["achieved_goal"] for observation, *_ in seen])
    desired = np.roll(achieved, 1, axis=0)  # where the end effector was a step before
    desired[::3] = achieved[::3]
    infos = [info for *_, info in seen]
    rewards = goal_env.compute_reward(achieved, desired, np.array(infos))
    reached = goal_env.compute_terminated(achieved, desired, infos)
    assert rewards.shape == reached.shape == (40,)
    assert rewards.tolist() == [goal_env.compute_reward(*case) for case in zip(achieved, desired, infos, strict=True)]
    visible = (achieved != UNSEEN).all(axis=1)
    assert reached[::3].tolist() == visible[::3].tolist(), "whoever is at the goal has reached it"
    assert (rewards[reached] == rewards[reached].max()).all()


def test_a_view_without_a_marker_is_never_at_a_goal(goal_env: StereoReachGoalEnv) -> None:
    out_of_sight = {"target_position": (0.0, 0.0, 5.0), "joint_positions": (1.0, 0.4, 0.0, 0.8)}
    observation, _ = goal_env.reset(options=out_of_sight)
    assert (observation["desired_goal"] == UNSEEN).all()
    goals = np.full(4, UNSEEN)
    assert not goal_env.compute_terminated(goals, goals, {PREVIOUS: goals})


def test_errors_name_the_choices(goal_env: StereoReachGoalEnv) -> None:
    with pytest.raises(ValueError, match="unknown reward_type 'both'; reward types are sparse, dense"):
        StereoReachGoalEnv(reward_type="both")
    with pytest.raises(ValueError, match=r"composite is 'dict'.*take 'channels'"):
        StereoReachGoalEnv(composite="dict")
    if goal_env.reward_type == "dense":
        with pytest.raises(ValueError, match=r"previous_achieved_goal'\]; set copy_info_dict to true"):
            goal_env.compute_reward(np.zeros((2, 4)), np.ones((2, 4)), [{}, {}])


@pytest.mark.parametrize(("reward_type", "copy_info"), [("sparse", False), ("dense", True)])
def test_sb3s_her_buffer_relabels_unmodified(reward_type: str, copy_info: bool) -> None:
    from stable_baselines3 import SAC, HerReplayBuffer

    env = gym.make("WamStereoReachGoal-v0", reward_type=reward_type, rho=40.0)
    model = SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future", "copy_info_dict": copy_info},
        learning_starts=60,
        buffer_size=100,
        batch_size=8,
        seed=0,
        device="cpu",
    )
    model.learn(62)
    assert model.replay_buffer is not None
    samples = model.replay_buffer.sample(200)
    assert isinstance(samples.next_observations, dict)
    goals = [samples.next_observations[key].numpy().astype(float) for key in ("achieved_goal", "desired_goal")]
    reached = env.unwrapped.compute_terminated(*goals, {})  # type: ignore[attr-defined]
    best = 0.0 if reward_type == "sparse" else 1.0
    np.testing.assert_array_equal(samples.rewards.numpy().ravel()[reached], best)
    assert (samples.rewards.numpy().ravel()[~reached] < best).all()
    assert 0.1 < reached.mean() < 1, "hindsight makes goals of what was reached"
    env.close()
