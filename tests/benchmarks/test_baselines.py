"""Baselines: policies without learning, their search, and their records."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import benchmarks
from benchmarks.analysis import baselines
from benchmarks.analysis.baselines import BASELINES, STRICT, Line, Task, goal_distances, measure, read_lines, task_of
from benchmarks.analysis.constant import Search, any_constant, best_constant, quantised_actions
from benchmarks.analysis.rollouts import BlindSimulation, constant_action, play, random_actions
from sb3_stereo.config import load_config
from sb3_stereo.evaluation.protocol import InitialState, random_initial_states

POSE = (1.0, 0.4, 0.0, 0.8)


@pytest.fixture(scope="module")
def reach() -> Iterator[gym.Env[Any, Any]]:
    with closing(gym.make("sb3_stereo:WamStereoReach-v0", success_frame="observation", max_episode_steps=4)) as env:
        yield env


def start_of(action: tuple[float, ...], env: gym.Env[Any, Any]) -> InitialState:
    """A start from which the action reaches in one step, the target being where it ends."""
    env.reset(options={"joint_positions": POSE})
    info = env.step(np.array(action, np.float32))[4]
    return {"options": {"joint_positions": POSE, "target_position": info["end_effector_position"]}}


def test_a_policy_is_scored_as_its_episodes_go(reach: gym.Env[Any, Any]) -> None:
    start, far = start_of((1, 0, 0, -1), reach), {"options": {"joint_positions": POSE, "target_position": (0, 0, -9)}}
    score = play(reach, [start, far], constant_action(np.array((1, 0, 0, -1), np.float32)))
    assert score.success.tolist() == [True, False] and score.steps.tolist() == [1, 4]
    assert (score.success_rate, score.mean_steps_success, score.mean_steps_capped) == (0.5, 1.0, 2.5)


def test_random_actions_are_those_of_their_seed(reach: gym.Env[Any, Any]) -> None:
    initial_states = random_initial_states(3, seed=5)
    returns = [play(reach, initial_states, random_actions(reach, seed)).returns.tolist() for seed in (0, 0, 1)]
    assert returns[0] == returns[1] != returns[2]


def test_what_is_simulated_blindly_is_what_the_cameras_see(reach: gym.Env[Any, Any]) -> None:
    env: Any = reach.unwrapped
    blind = BlindSimulation(env)
    n_seen = 0
    for seed in range(8):
        _, info = reach.reset(seed=seed)
        state, action = env.save_state(), np.random.default_rng(seed).uniform(-1, 1, 4)
        seen = env.step(action)[4]
        env.restore_state(state)
        blind.push(action)
        np.testing.assert_array_equal(env.arm.end_effector_position, seen["end_effector_position"])
        if np.isfinite(seen["pixel_distances"]).all():
            n_seen += 1
            distance = env.success_distances(seen["pixel_offsets"]).mean()
            assert blind.distance(info["target_position"]) == pytest.approx(distance, abs=0.7)
        env.remove_state(state)
    assert n_seen > 3


@pytest.mark.parametrize("action", [(1, 0, -1, 1), (-1, 1, 0, 0)])
def test_the_best_constant_action_needs_no_more_steps_than_a_known_one(
    reach: gym.Env[Any, Any], action: tuple[float, ...]
) -> None:
    initial_states = [start_of(action, reach)]
    search = Search(reach, initial_states)
    assert search.mean_steps(np.array(action, float)) == 1
    search.close()
    quantised, continuous = best_constant(reach, initial_states)
    for found in (quantised, continuous):
        assert play(reach, initial_states, constant_action(found)).mean_steps_capped == 1
    assert set(quantised.tolist()) <= {-1.0, 0.0, 1.0}


def test_any_constant_action_is_the_mean_over_all_of_a_dqn(
    reach: gym.Env[Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    initial_states = [start_of((1, 0, -1, 1), reach)]
    steps = any_constant(reach, initial_states)
    assert steps.shape == (81, 1)
    known = [action.tolist() for action in quantised_actions(reach)].index([1, 0, -1, 1])
    assert steps[known, 0] == 1 and steps.min() >= 1 and steps.max() == 4  # the cap
    monkeypatch.setattr(Task, "make", lambda task: gym.make("sb3_stereo:WamStereoReach-v0", max_episode_steps=4))
    monkeypatch.setattr(Task, "eval_initial_states", lambda task: initial_states)
    (line,) = BASELINES["any constant"](STRICT, 1)
    assert float(line["success_rate"]) < 1 and line["n_poses"] == "1"


def test_goals_lie_within_what_rho_is_in_space() -> None:
    with closing(gym.make("sb3_stereo:WamStereoReach-v0", rho=20)) as made:
        env: Any = made.unwrapped
        env.reset(seed=0)
        wide = goal_distances(env, np.array([(0.5, 0.0, 0.6)]), 4000)
        env.rho = 10
        near = goal_distances(env, np.array([(0.5, 0.0, 0.6)]), 4000)
    assert 0 < len(near) < len(wide) and near.max() < wide.max()
    # At 4 m a pixel is 14.4 mm wide; one view sees at least the half of a distance that the other hardly sees.
    assert near.max() < 2 * 10 * 0.0144


def test_only_what_is_not_recorded_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmarks, "RESULTS", tmp_path)
    calls: list[str] = []

    def scorer(kind: str) -> Any:
        def score(task: Any, n_workers: int) -> list[Line]:
            calls.append(kind)
            return [{"kind": kind, "baseline": f"{kind} of {task.name}"}]

        return score

    monkeypatch.setattr(baselines, "BASELINES", {kind: scorer(kind) for kind in BASELINES})
    measure(STRICT, ["planner"], n_workers=1)
    measure(STRICT, list(BASELINES), n_workers=1)
    assert calls == ["planner", *(kind for kind in BASELINES if kind != "planner")]
    assert [line["kind"] for line in read_lines(STRICT.record)] == list(BASELINES)


def test_a_configuration_is_of_the_task_that_it_learns() -> None:
    def name(env_id: str, **env_kwargs: Any) -> str | None:
        task = task_of(load_config("ddpg", env_id, env_kwargs=env_kwargs))
        return task and task.name

    assert name("WamStereoReach-v0") == "strict"
    assert name("WamStereoReach-v0", composite="stack") == "strict"  # how it is shown is no other task
    assert name("WamStereoReach-v0", success_frame="observation") == "observation"
    assert name("WamStereoReachRandom-v0") == "random"
    assert name("WamStereoReach-v0", pulse_duration=1.5, target_position=[0.634, 0.421, 0.227]) == "long_pulses"
    assert name("WamStereoReach-v0", rho=20) is None
