"""The protocol: numbers worked out by hand, and scores that do not depend on how they are computed."""

import json
from pathlib import Path
from typing import Any

import fake_reach
import numpy as np
import pytest
from stable_baselines3 import DDPG
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

from sb3_stereo.building.factory import make_env
from sb3_stereo.commands.evaluate import json_scores
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation import protocol as evaluation
from sb3_stereo.evaluation.callback import append_row, describe, eval_steps
from sb3_stereo.evaluation.protocol import (
    evaluate,
    evaluate_poses,
    pose_initial_states,
    random_initial_states,
    summarise,
)


class Constant:
    """An agent that always does the same."""

    policy = None

    def __init__(self, action: float) -> None:
        self.action = np.array([action, 0.0, 0.0, 0.0], dtype=np.float32)
        self.policy = self

    def set_training_mode(self, mode: bool) -> None: ...

    def obs_to_tensor(self, observation: Any) -> tuple[Any, bool]:
        return observation, False

    def predict(self, observation: Any, deterministic: bool) -> tuple[np.ndarray, None]:
        assert deterministic
        return self.action, None


def score(action: float, joint: list[float], **kwargs: Any) -> evaluation.Evaluation:
    poses = np.zeros((len(joint), 4))
    poses[:, 0] = joint
    return evaluate_poses(Constant(action), fake_reach.ENV_ID, poses, **kwargs)  # type: ignore[arg-type]


def test_metrics_of_four_episodes_worked_out_by_hand() -> None:
    result = summarise(
        success=np.array([True, False, True, False]),
        steps=np.array([2, 30, 5, 30]),
        pixel_distance=np.array([4.0, 50.0, 8.0, np.nan]),
        returns=np.array([1.5, -2.0, 2.5, 0.0]),
        max_steps=30,
    )
    assert result.success_rate == 0.5
    assert result.mean_steps_success == 3.5
    assert result.mean_steps_capped == 16.75
    assert result.mean_pixel_distance == pytest.approx(62 / 3)
    assert result.mean_return == 0.5
    assert result.n_poses == 4
    assert describe(result) == (
        "reached the target from 2 of 4 poses (50 %), 3.50 steps on average, 16.75 with failures counted as the cap"
    )


def test_distances_in_space_are_those_at_the_goal() -> None:
    success, nothing = np.array([True] * 5 + [False]), np.zeros(6)
    distance = np.array([0.01, 0.02, 0.03, 0.04, 0.06, 0.001])
    result = summarise(success, nothing + 2, nothing, nothing, max_steps=30, distance=distance)
    assert result.median_distance_success == pytest.approx(0.03)
    assert result.p95_distance_success == pytest.approx(0.04 + 0.8 * 0.02)
    assert result.within_5cm == pytest.approx(4 / 6)
    assert describe(result) == (
        "reached the target from 5 of 6 poses (83 %), a median of 3.0 cm from it, 2.00 steps on average, "
        "6.67 with failures counted as the cap"
    )
    none = summarise(~success[:5], nothing[:5], nothing[:5], nothing[:5], max_steps=30, distance=distance[:5])
    assert np.isnan([none.median_distance_success, none.p95_distance_success]).all() and none.within_5cm == 0


def test_an_environment_that_tells_no_distance_in_space_has_none() -> None:
    result = summarise(np.array([True]), np.array([2]), np.array([4.0]), np.array([1.0]), max_steps=30)
    assert np.isnan(result.distance).all()
    assert np.isnan([result.median_distance_success, result.p95_distance_success, result.within_5cm]).all()


def test_a_file_of_scores_keeps_the_columns_it_was_begun_with(tmp_path: Path) -> None:
    file = tmp_path / "evaluations.csv"
    append_row(file, {"timesteps": 1, "old": 2})
    append_row(file, {"timesteps": 3, "new": 4})
    assert file.read_text().splitlines() == ["timesteps,old", "1,2", "3,nan"]


def test_the_final_distance_in_space_is_the_environments() -> None:
    result = score(-1.0, [1.1, 0.6])  # each step moves J1 by -0.5
    np.testing.assert_allclose(result.distance, [0.1, 0.1])
    assert result.median_distance_success == pytest.approx(0.1) and result.within_5cm == 0


def test_without_a_success_its_mean_steps_are_undefined() -> None:
    result = summarise(np.array([False]), np.array([30]), np.array([np.nan]), np.array([0.0]), max_steps=30)
    assert np.isnan(result.mean_steps_success)
    assert np.isnan(result.mean_pixel_distance)
    assert result.mean_steps_capped == 30
    assert json.loads(json.dumps(json_scores(result.scores())))["mean_steps_success"] is None


def test_a_scripted_agent_gets_the_score_worked_out_by_hand() -> None:
    result = score(-1.0, [1.0, 0.6, -0.5])  # each step moves J1 by -0.5; the goal is |J1| <= 0.25; the cap is 5 steps
    assert result.success.tolist() == [True, True, False]
    assert result.steps.tolist() == [2, 1, 5]
    assert result.pixel_distance == pytest.approx([0.0, 10.0, 300.0])
    assert result.returns == pytest.approx([0.5 + 1.0, 1.0, -2.5])
    assert (result.mean_steps_success, result.mean_steps_capped) == (1.5, pytest.approx(8 / 3))
    assert result.mean_action == 0.25  # one of four joints at full effort


@pytest.mark.parametrize("n_envs", [2, 3, 7])
def test_scores_do_not_depend_on_the_number_of_environments(n_envs: int) -> None:
    joint = np.linspace(-1.0, 1.0, 5).tolist()
    alone, together = score(-1.0, joint), score(-1.0, joint, n_envs=n_envs)
    for key, value in vars(alone).items():
        np.testing.assert_array_equal(value, getattr(together, key))


def test_scores_do_not_depend_on_the_process() -> None:
    joint = [0.9, -0.2, 0.4]
    here, elsewhere = score(-1.0, joint, n_envs=2), score(-1.0, joint, n_envs=2, vec_env_cls=SubprocVecEnv)
    np.testing.assert_equal(here.scores(), elsewhere.scores())


def test_a_network_scores_the_same_in_any_number_of_environments() -> None:
    env_fn = make_env(fake_reach.ENV_ID, {}, ())
    model = DDPG("CnnPolicy", DummyVecEnv([env_fn]), buffer_size=10, seed=0)
    one, four = (evaluate(model, env_fn, random_initial_states(6, seed=1), n_envs) for n_envs in (1, 4))
    assert one.mean_q == pytest.approx(four.mean_q, abs=1e-12)
    assert one.scores() | {"mean_q": 0, "mean_action": 0} == four.scores() | {"mean_q": 0, "mean_action": 0}


def test_random_starts_depend_on_their_seed_alone() -> None:
    assert random_initial_states(3, seed=1) == random_initial_states(3, seed=1) != random_initial_states(3, seed=2)
    env_fn = make_env(fake_reach.ENV_ID, {}, ())
    scores = [
        evaluate(Constant(-1.0), env_fn, random_initial_states(8, seed), n).scores()
        for seed, n in [(1, 1), (1, 3), (2, 1)]
    ]  # type: ignore[arg-type]
    np.testing.assert_equal(scores[0], scores[1])
    assert scores[0]["mean_return"] != scores[2]["mean_return"]


def test_nothing_to_score_is_an_error() -> None:
    with pytest.raises(ConfigError) as error:
        score(0.0, [])
    assert str(error.value) == "there is nothing to evaluate: give at least one pose"


def test_the_test_poses_are_a_hundred_and_come_with_the_package() -> None:
    poses = evaluation.eval_poses("WamStereoReach-v0")
    assert poses.shape == (100, 4)
    assert len(np.unique(poses, axis=0)) == 100
    assert len(evaluation.eval_initial_states("WamStereoReach-v0")) == 100
    assert (
        evaluation.eval_initial_states("WamStereoReach-v0")[0]["options"]["joint_positions"].tolist()
        == poses[0].tolist()
    )


def test_an_environment_without_test_poses_gets_seeded_starts() -> None:
    with pytest.raises(ConfigError) as error:
        evaluation.eval_poses("FakeReach-v0")
    assert str(error.value) == "no test poses for 'FakeReach-v0'; use random ones with --poses N --seed S"
    assert evaluation.eval_initial_states("FakeReach-v0") == random_initial_states(100, seed=0)
    assert evaluation.eval_initial_states("WamStereoReach-v0", {"arm": "kuka"}) == random_initial_states(100, seed=0)


def test_pose_starts_fix_everything_else_by_a_seed() -> None:
    initial_states = pose_initial_states(np.zeros((2, 4)))
    assert [start["seed"] for start in initial_states] == [0, 1]


def test_checkpoints_are_the_papers_below_the_end() -> None:
    assert eval_steps("ddpg", 8500) == (1500, 2000, 5000, 7000)
    assert eval_steps("dqn", 20_000) == (1500, 3500, 5500, 7500, 10_000)
    assert eval_steps("ddpg", 100, eval_freq=40) == (40, 80)
    assert eval_steps("ddpg", 8500, eval_freq=-1) == ()


def test_rows_are_appended_under_one_header(tmp_path: Path) -> None:
    for i in range(2):
        append_row(tmp_path / "table.csv", {"a": i, "b": 0.5})
    assert (tmp_path / "table.csv").read_text().splitlines() == ["a,b", "0,0.5", "1,0.5"]
