"""Whether an agent looks at the image is told by its success when it is shown other episodes."""

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import benchmarks
from benchmarks.analysis import looks
from benchmarks.analysis.baselines import read_lines
from benchmarks.analysis.looks import efforts_of, look
from sb3_stereo.commands import train as train_cli
from sb3_stereo.envs.wrappers import QuantizedActions
from sb3_stereo.evaluation.protocol import random_initial_states
from sb3_stereo.training import session

POSE = (1.0, 0.4, 0.0, 0.8)
ACTIONS = np.array([(1, 0, 0, 0), (-1, 0, 0, 0)], np.float32)


class Agent:
    """A model whose `predict` is a function of the observation."""

    def __init__(self, act: Callable[[Any], Any]) -> None:
        self.act = act

    def predict(self, observation: Any, deterministic: bool) -> tuple[Any, None]:
        assert deterministic
        return self.act(observation), None


def test_who_looks_needs_its_own_images_and_who_does_not_never_notices() -> None:
    with closing(gym.make("sb3_stereo:WamStereoReach-v0", max_episode_steps=1)) as env:
        images, initial_states = [], []
        for action in ACTIONS:
            env.reset(options={"joint_positions": POSE})
            target = env.step(action)[4]["end_effector_position"]
            initial_states.append({"options": {"joint_positions": POSE, "target_position": target}})
            images.append(env.reset(**initial_states[-1])[0])
        seeing = Agent(lambda observation: ACTIONS[int(np.array_equal(observation, images[1]))])
        scores = look(seeing, env, initial_states)
        assert (scores["success_rate"], scores["shuffled_success_rate"]) == (1.0, 0.0)
        assert scores["action_spread"] == 0.25 and scores["most_frequent_action"] == 0.5  # one of four joints: ±1
        scores = look(Agent(lambda observation: ACTIONS[0]), env, initial_states)
        assert scores["success_rate"] == scores["shuffled_success_rate"] == 0.5
        assert scores["action_spread"] == 0.0 and scores["most_frequent_action"] == 1.0


def test_a_run_is_recorded_with_the_steps_that_its_model_was_trained_for(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benchmarks, "RESULTS", tmp_path / "results")
    for module in (looks, session):
        monkeypatch.setattr(module, "eval_initial_states", lambda *_: random_initial_states(2, seed=0))
    arguments = [
        "--algo",
        "dqn",
        "--env",
        "WamStereoReach-v0",
        "-n",
        "6",
        "--seed",
        "3",
        "--eval-freq",
        "-1",
        "--verbose",
        "0",
        "-f",
        str(logs),
    ]
    arguments += ["--env-kwargs", "max_episode_steps:2", "-params", "learning_starts:4", "batch_size:4"]
    assert train_cli.main([*arguments, "buffer_size:50", "callback:null"]) == 0
    run = str(logs / "dqn" / "WamStereoReach-v0_1")
    assert looks.main([run, "--name", "made_up"]) == looks.main([run, "--name", "made_up"]) == 0
    (line,) = read_lines(looks.looks_record())
    assert (line["row"], line["seed"], line["timesteps"]) == ("made_up", "3", "6")


def test_efforts_are_those_that_the_wrappers_make_of_an_action() -> None:
    with closing(gym.make("sb3_stereo:WamStereoReach-v0")) as env:
        np.testing.assert_array_equal(efforts_of(QuantizedActions(env), 80), [1, 1, 1, 1])
        np.testing.assert_array_equal(efforts_of(env, np.array([2.0, 0.5, 0, -3])), [1, 0.5, 0, -1])
