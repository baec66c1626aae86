"""The scripted controller: it reaches, and what it looks for are joint angles at the target."""

from collections.abc import Iterator
from contextlib import closing
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.analysis.jacobian import JacobianController
from benchmarks.analysis.rollouts import play
from sb3_stereo.envs.kinematics import NEAR, end_effector_at, jacobian
from sb3_stereo.evaluation.protocol import random_initial_states


@pytest.fixture(scope="module")
def reach() -> Iterator[gym.Env[Any, Any]]:
    with closing(gym.make("sb3_stereo:WamStereoReachRandom-v1")) as env:
        yield env


@pytest.fixture(scope="module")
def controller(reach: gym.Env[Any, Any]) -> JacobianController:
    return JacobianController(reach.unwrapped)


def test_it_reaches_any_target_in_a_few_steps(reach: gym.Env[Any, Any], controller: JacobianController) -> None:
    score = play(reach, random_initial_states(6, seed=3), controller)
    assert score.success_rate == 1 and score.mean_steps_success < 6 and score.p95_distance_success < 0.07


def test_the_joint_angles_found_put_the_end_effector_at_the_target(
    reach: gym.Env[Any, Any], controller: JacobianController
) -> None:
    env: Any = reach.unwrapped
    for seed in range(5):
        _, info = reach.reset(seed=seed)
        before, here = env.capture(), env.arm.actuated_positions
        joints = controller._joints_at(info["target_position"], here)
        np.testing.assert_array_equal(env.capture(), before)  # the arm itself has not moved
        reach.reset(options={"target_position": info["target_position"]})
        env.arm.rest_at(joints)
        assert np.linalg.norm(env.arm.end_effector_position - info["target_position"]) < NEAR


def test_the_jacobian_is_that_of_the_motion(reach: gym.Env[Any, Any]) -> None:
    reach.reset(seed=0)
    arm: Any = reach.unwrapped.arm  # type: ignore[attr-defined]
    joints, step = np.array([0.3, -0.4, 0.5, 0.9]), np.array([2e-3, -1e-3, 1e-3, 2e-3])
    moved = end_effector_at(arm, joints + step) - end_effector_at(arm, joints)
    np.testing.assert_allclose(moved, jacobian(arm, joints) @ step, atol=1e-5)
