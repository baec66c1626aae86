"""`evaluate --env` and `--env-kwargs`: a run's agent in another environment than its own."""

import json
from typing import Any

import pytest

from sb3_stereo.commands import evaluate

FLAGS = ("--pretrained", "--poses", "2", "--n-envs", "1", "--num-threads", "1", "--verbose", "0")


def scores(capsys: pytest.CaptureFixture[str], *flags: str) -> dict[str, Any]:
    assert evaluate.main([*FLAGS, "--json", *flags]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_arguments_are_those_of_the_world_that_is_played(capsys: pytest.CaptureFixture[str]) -> None:
    # So much tolerance makes every state a goal: an episode is over after its first step.
    assert scores(capsys, "--env-kwargs", "rho:300")["mean_steps_capped"] != scores(capsys)["mean_steps_capped"]


def test_another_arm_is_played(capsys: pytest.CaptureFixture[str]) -> None:
    assert scores(capsys, "--env", "KukaStereoReach-v1")["success_rate"] < scores(capsys)["success_rate"]


def test_an_agent_that_does_not_fit_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for flags, sentence in (
        (
            ("--env", "KukaStereoReach-v0", "--env-kwargs", "composite:channels"),
            "the observation space of KukaStereoReach-v0 is Box(0, 255, (2, 42, 84), uint8), and the agent's "
            "Box(0, 255, (1, 84, 84), uint8); choose another environment",
        ),
        (
            ("--env-kwargs", "n_joints:5"),
            "the action space of WamStereoReach-v1 is Box(-1.0, 1.0, (5,), float32), and the agent's "
            "Box(-1.0, 1.0, (4,), float32); choose another environment",
        ),
    ):
        assert evaluate.main([*FLAGS, *flags]) == 2
        assert capsys.readouterr().err == f"error: {sentence}\n"
