"""`WamStereoReachRandom-v0`: a target at every reset, reachable and seen."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import sb3_stereo  # noqa: F401  (registers)
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.evaluation.protocol import eval_initial_states, eval_poses

ENV_ID = "WamStereoReachRandom-v0"


@pytest.fixture(scope="module")
def env() -> Any:
    env: Any = gym.make(ENV_ID).unwrapped
    yield env
    env.close()


def test_a_target_is_drawn_at_every_reset_and_the_seed_fixes_it(env: StereoReachEnv) -> None:
    targets = [env.reset(seed=0 if first else None)[1]["target_position"] for first in (True, False, False)]
    assert len({tuple(target) for target in targets}) == 3
    again = [env.reset(seed=0 if first else None)[1]["target_position"] for first in (True, False, False)]
    np.testing.assert_array_equal(again, targets)


def test_the_start_is_no_goal_and_the_target_fills_the_workspace(env: StereoReachEnv) -> None:
    infos = [env.reset(seed=seed)[1] for seed in range(40)]
    assert not any(info["is_success"] for info in infos)
    targets = np.array([info["target_position"] for info in infos])
    assert (np.ptp(targets, axis=0) > (1.0, 1.0, 0.6)).all() and (targets[:, 2] > 0).all()


def test_a_pose_reaches_every_target(monkeypatch: pytest.MonkeyPatch, env: StereoReachEnv) -> None:
    drawn = []
    draw = StereoReachEnv._draw_target

    def draw_and_keep(self: StereoReachEnv) -> None:
        draw(self)
        drawn.append(self.arm.actuated_positions)

    monkeypatch.setattr(StereoReachEnv, "_draw_target", draw_and_keep)
    for seed in range(10):
        target = env.reset(seed=seed)[1]["target_position"]
        _, info = env.reset(options={"joint_positions": drawn[-1], "target_position": target})
        assert info["is_success"] and not np.isnan(info["pixel_distances"]).any()


def test_a_target_that_is_told_is_not_drawn(env: StereoReachEnv) -> None:
    told = (0.4, 0.2, 0.7)
    assert tuple(env.reset(seed=0, options={"target_position": told})[1]["target_position"]) == told
    fixed = StereoReachEnv()
    pose = fixed.reset(seed=0)[1]["joint_positions"]
    np.testing.assert_array_equal(
        env.reset(seed=0, options={"target_position": (0.5, 0, 0.6)})[1]["joint_positions"], pose
    )
    fixed.close()


def test_the_task_is_its_own_mirror_image_wherever_the_target_is(env: StereoReachEnv) -> None:
    assert env.mirrored_joints == (0, 2)
    assert StereoReachEnv(target_position=(0.5, 0.1, 0.6)).mirrored_joints is None


def test_the_test_starts_are_a_hundred_pairs_of_pose_and_target(env: StereoReachEnv) -> None:
    initial_states = eval_initial_states(ENV_ID)
    assert eval_poses(ENV_ID).shape == (100, 4) and len(initial_states) == 100
    assert len({tuple(start["options"]["target_position"]) for start in initial_states}) == 100
    for start in initial_states[:5]:
        _, info = env.reset(**start)
        np.testing.assert_array_equal(info["target_position"], start["options"]["target_position"])
        np.testing.assert_allclose(info["joint_positions"][:4], start["options"]["joint_positions"], atol=1e-12)
        assert not info["is_success"]
    assert "target_position" not in eval_initial_states("WamStereoReach-v0")[0]["options"]


def test_a_mirrored_pose_and_target_give_the_mirrored_transition(env: StereoReachEnv) -> None:
    signs, flip = np.array([-1.0, 1.0, -1.0, 1.0]), np.array([1.0, -1.0, 1.0])
    rng = np.random.default_rng(0)
    for seed in range(4):
        _, info = env.reset(seed=seed)
        pose, target, action = env.arm.actuated_positions, info["target_position"], rng.uniform(-1, 1, 4)
        image, reward, *_ = env.step(action)
        env.reset(options={"joint_positions": pose * signs, "target_position": target * flip})
        mirrored, mirrored_reward, *_ = env.step(action * signs)
        back = mirrored.reshape(2, 42, 84)[::-1, :, ::-1].reshape(1, 84, 84)
        assert np.abs(back.astype(float) - image).mean() < 0.5  # of 255; a rendered edge may fall to either side
        assert mirrored_reward == pytest.approx(reward, abs=0.01)
