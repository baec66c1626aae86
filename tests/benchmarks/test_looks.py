"""Whether an agent looks at the image is told by its success when it is shown other episodes."""

from collections.abc import Callable
from contextlib import closing
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.analysis.looks import efforts_of, look
from sb3_stereo.envs.wrappers import QuantizedActions

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
        images, starts = [], []
        for action in ACTIONS:
            env.reset(options={"joint_positions": POSE})
            target = env.step(action)[4]["end_effector_position"]
            starts.append({"options": {"joint_positions": POSE, "target_position": target}})
            images.append(env.reset(**starts[-1])[0])
        seeing = Agent(lambda observation: ACTIONS[int(np.array_equal(observation, images[1]))])
        scores = look(seeing, env, starts)
        assert (scores["success_rate"], scores["shuffled_success_rate"]) == (1.0, 0.0)
        assert scores["action_spread"] == 0.25 and scores["most_frequent_action"] == 0.5  # one of four joints: ±1
        scores = look(Agent(lambda observation: ACTIONS[0]), env, starts)
        assert scores["success_rate"] == scores["shuffled_success_rate"] == 0.5
        assert scores["action_spread"] == 0.0 and scores["most_frequent_action"] == 1.0


def test_efforts_are_those_that_the_wrappers_make_of_an_action() -> None:
    with closing(gym.make("sb3_stereo:WamStereoReach-v0")) as env:
        np.testing.assert_array_equal(efforts_of(QuantizedActions(env), 80), [1, 1, 1, 1])
        np.testing.assert_array_equal(efforts_of(env, np.array([2.0, 0.5, 0, -3])), [1, 0.5, 0, -1])
