"""Arms with more actuated joints, and with a suction cup."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.envs.robots import ARMS, WAM
from sb3_stereo.evaluation.protocol import eval_initial_states


@pytest.mark.parametrize("n_joints", [4, 5, 6, 7])
def test_a_full_action_moves_every_joint_by_about_a_radian(n_joints: int) -> None:
    env = StereoReachEnv(n_joints=n_joints)
    assert env.action_space.shape == (n_joints,)
    for joint in range(n_joints):
        env.reset(options={"joint_positions": (0.0, 0.3, 0.0, 0.5, 0.0, 0.0, 0.0)[:n_joints]})
        before = env.arm.joint_positions
        env.step(np.eye(n_joints)[joint])
        assert 0.7 < (env.arm.joint_positions - before)[joint] < 1.4
    env.close()


def test_four_joints_are_the_default() -> None:
    seen = []
    for kwargs in ({}, {"n_joints": 4}):
        env = StereoReachEnv(**kwargs)
        observation, info = env.reset(seed=3)
        step = env.step(np.full(4, 0.7))
        seen.append([observation.tobytes(), info["joint_positions"].tobytes(), step[0].tobytes(), step[1]])
        env.close()
    assert seen[0] == seen[1]


def test_a_wrist_turns_only_the_hand() -> None:
    env = StereoReachEnv(n_joints=6)
    hands = []
    for wrist in (-1.0, 1.0):
        env.reset(options={"joint_positions": (0.0, 0.5, 0.0, 1.0, 0.0, wrist)})
        hands.append(env.arm.end_effector_position)
    assert np.linalg.norm(hands[0] - hands[1]) == pytest.approx(2 * 0.0609 * np.sin(1.0), abs=1e-3)
    assert env.mirrored_joints is None  # the stops of J5 are not symmetric
    env.close()


@pytest.mark.parametrize(
    ("arm", "n_joints", "message"),
    [
        ("wam", 3, "n_joints is 3, and this arm's is 4 to 7; give that"),
        ("wam", 8, "n_joints is 8, and this arm's is 4 to 7; give that"),
        ("kuka", 5, "n_joints is 5, and this arm's is 4; give that"),
        ("wam", "many", "n_joints is 'many'; give an integer"),
    ],
)
def test_a_wrong_number_of_joints_is_explained(arm: str, n_joints: Any, message: str) -> None:
    with pytest.raises(ValueError) as error:
        StereoReachEnv(arm=arm, n_joints=n_joints)
    assert str(error.value) == message


def test_another_number_of_joints_is_scored_on_seeded_resets() -> None:
    starts = eval_initial_states("WamStereoReach-v0", {"n_joints": 7})
    assert len(starts) == 100 and all(set(start) == {"seed"} for start in starts)
    with gym.make("WamStereoReach-v0", n_joints=7) as env:
        assert env.reset(**starts[0])[1]["joint_positions"][4:].any()


@pytest.mark.parametrize("arm", ARMS)
def test_a_suction_cup_is_a_link_that_changes_no_other(arm: str) -> None:
    envs = [StereoReachEnv(arm=replace(ARMS[arm], suction_cup=length)) for length in (None, 0.08)]
    pose = (0.0, 0.5, 0.0, -1.0) if arm == "panda" else (0.0, 0.5, 0.0, 1.0)
    for env in envs:
        env.reset(options={"joint_positions": pose})
    plain, cupped = envs
    assert plain.arm.cup is None and cupped.arm.cup is not None and cupped.arm.n_links == plain.arm.n_links + 1
    np.testing.assert_allclose(cupped.arm.end_effector_position, plain.arm.end_effector_position, atol=1e-9)
    for env in envs:
        env.close()


def test_joints_that_are_actuated_already_are_no_further_ones() -> None:
    with pytest.raises(ValueError) as error:
        replace(WAM, further_joints=(("J4", (1.0, 1.0)),))
    assert str(error.value) == "further_joints has 'J4', which is actuated; leave it out of one of them"
