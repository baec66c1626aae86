"""The environment: what it promises to Gymnasium, to SB3, and to people."""

import pickle
import warnings
from typing import Any

import cv2
import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gym_check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import sb3_stereo
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.envs.rewards import distance_change, reward

TWO_VIEWS = (240, 640, 3)


@pytest.mark.parametrize("env_id", sb3_stereo.ENV_IDS)
def test_checkers_pass_without_a_warning(env_id: str) -> None:
    env = gym.make(env_id, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gym_check_env(env.unwrapped, skip_render_check=True)  # it would open a window; other tests render
        sb3_check_env(env)
    env.close()


@pytest.mark.parametrize("env_id", sb3_stereo.ENV_IDS)
def test_registered_with_the_papers_shapes_and_a_cap_of_30_steps(env_id: str) -> None:
    env = gym.make(f"sb3_stereo:{env_id}")
    assert env.observation_space == gym.spaces.Box(0, 255, (1, 84, 84), np.uint8)
    assert env.action_space == gym.spaces.Box(-1, 1, (4,), np.float32)
    env.reset(seed=0)
    still = np.zeros(4, np.float32)
    ends = [env.step(still)[2:4] for _ in range(30)]
    assert ends[-1] == (False, True) and ends[:-1] == [(False, False)] * 29
    pickle.loads(pickle.dumps(env.spec)).make().close()
    env.close()


def test_render_is_what_the_observation_was_made_from(env: StereoReachEnv) -> None:
    observation, _ = env.reset(seed=3)
    for action in np.random.default_rng(0).uniform(-1, 1, (5, 4)):
        frames = env.render()
        assert frames is not None and frames.shape == TWO_VIEWS and frames.dtype == np.uint8
        views = [cv2.cvtColor(cv2.resize(view, (84, 42)), cv2.COLOR_RGB2YUV)[..., 0] for view in np.hsplit(frames, 2)]
        np.testing.assert_array_equal(observation[0], np.vstack(views))
        observation, *_ = env.step(action)


def test_render_without_a_mode_is_nothing() -> None:
    env = StereoReachEnv()
    env.reset(seed=0)
    assert env.render() is None
    env.close()
    env.close()  # a second time is fine


def test_reward_is_equation_3_of_the_distances_in_info(env: StereoReachEnv) -> None:
    rng = np.random.default_rng(0)
    rewards = []
    for seed in range(10):
        _, info = env.reset(seed=seed)
        for _ in range(5):
            before = info["pixel_distances"]
            _, value, terminated, truncated, info = env.step(rng.uniform(-1, 1, 4))
            after = info["pixel_distances"]
            assert terminated == info["is_success"] == bool(np.mean(after) <= 10.0)
            assert value == reward(distance_change(before, after, 100.0), terminated)
            assert not truncated
            rewards.append(value)
            if terminated:
                break
    assert min(rewards) < 0 < max(rewards)


def test_pushing_against_all_limits_is_the_redundant_action(env: StereoReachEnv) -> None:
    env.reset(options={"joint_positions": env.arm.limits[:, 0] * [1, 0, 1, 1]})
    for _ in range(4):
        _, value, *_ = env.step([-1, 0, -1, -1])
    assert value == -1.0


def test_blobs_are_where_the_markers_are(env: StereoReachEnv) -> None:
    """Centroids against the projection of the 3-D positions and the renderer's own segmentation."""
    errors = []
    for seed in range(40):
        _, info = env.reset(seed=seed)
        positions = np.stack([info["end_effector_position"], info["target_position"]])
        for view, camera in enumerate(env.cameras):
            frame, _, bodies = camera.draw()
            blobs = sb3_stereo.envs.markers.find_blobs(frame)
            bodies_of_markers = env._world.rig.markers
            for marker, body, expected in zip(blobs, bodies_of_markers, camera.spec.project(positions), strict=True):
                mask = bodies == body
                if np.isnan(marker).any():
                    assert mask.sum() < 12  # a sliver, or nothing
                    continue
                y, x = np.nonzero(mask)
                np.testing.assert_allclose(marker, (x.mean(), y.mean()), atol=0.35)
                if mask.sum() >= 80:  # unoccluded
                    errors.append(np.abs(marker - expected).max())
            assert np.isnan(info["pixel_distances"][view]) == np.isnan(blobs.offset).any()
    assert len(errors) > 30 and max(errors) < 0.5


def test_the_goal_pose_of_the_target_is_the_goal(env: StereoReachEnv) -> None:
    _, info = env.reset(seed=0)
    hand = info["end_effector_position"]
    _, info = env.reset(options={"joint_positions": info["joint_positions"][:4], "target_position": hand})
    assert info["is_success"] and np.mean(info["pixel_distances"]) < 10
    _, value, terminated, *_ = env.step(np.zeros(4))
    assert (value, terminated) == (1.0, True)


def test_random_poses_are_free_within_limits_and_not_yet_at_the_goal(env: StereoReachEnv) -> None:
    low, high = env.arm.limits.T
    poses = []
    for seed in range(60):
        _, info = env.reset(seed=seed)
        q = info["joint_positions"][:4]
        assert np.all((low <= q) & (q <= high)) and not info["is_success"]
        assert info["end_effector_position"][2] > 0 and not env.arm.collides()
        poses.append(q)
    spread = np.ptp(poses, axis=0) / (high - low)
    assert (spread > 0.6).all()


def test_a_floor_is_behind_everything_and_changes_nothing_else() -> None:
    """Drawn once and laid behind the rest, it gives the pixels of drawing everything."""
    bare, floored = StereoReachEnv(), StereoReachEnv(floor=True)
    for seed in range(5):
        bare.reset(seed=seed)
        floored.reset(seed=seed)
        for b, f in zip(bare.cameras, floored.cameras, strict=True):
            things, depth, _ = b.draw()
            frame, (background, background_depth) = f.frame(), f.background
            expected = np.where((background_depth < depth)[..., None], background, things)
            np.testing.assert_array_equal(frame, expected)
            assert (frame != things).any()
    bare.close()
    floored.close()


def test_more_cameras_make_a_taller_composite() -> None:
    left, right = StereoReachEnv().cameras
    env = StereoReachEnv(cameras=(left.spec, right.spec, left.spec), render_mode="rgb_array")
    observation, info = env.reset(seed=0)
    assert observation.shape == (1, 126, 84) and info["pixel_distances"].shape == (3,)
    np.testing.assert_array_equal(observation[:, :42], observation[:, 84:])
    assert env.render().shape == (240, 960, 3)  # type: ignore[union-attr]
    env.close()


def test_raw_effort_lets_the_arm_fall() -> None:
    heights = {}
    for compensated in (True, False):
        env = StereoReachEnv(gravity_compensation=compensated, brake=False)
        _, info = env.reset(options={"joint_positions": (0, 1.0, 0, 0.5)})
        _, _, _, _, after = env.step(np.zeros(4))
        heights[compensated] = after["end_effector_position"][2] - info["end_effector_position"][2]
        env.close()
    assert heights[True] == pytest.approx(0, abs=1e-6)
    assert heights[False] < -0.05


def test_efforts_scale_and_damping_slows() -> None:
    def travel(**options: Any) -> float:
        env = StereoReachEnv(**options)
        _, before = env.reset(options={"joint_positions": (0, 0.3, 0, 0.8)})
        after = env.step([1, 0, 0, 0])[4]
        env.close()
        return float(after["joint_positions"][0] - before["joint_positions"][0])

    normal = travel()
    assert travel(effort_limits=(30, 45, 15, 7.5)) == pytest.approx(1.5 * normal, rel=0.05)
    assert travel(damping=(40, 10, 4, 2)) < 0.5 * normal
    assert travel(pulse_duration=0.25) < 0.6 * normal
    assert travel(physics_rate=960) == pytest.approx(normal, rel=0.02)


@pytest.mark.parametrize("env_id", ["WamStereoReach-v0", "WamStereoReachRandom-v1"])
def test_offsets_alone_decide_reward_and_end(env_id: str) -> None:
    """What relabelled targets are judged by is the task's own reward, and the info says where the target is."""
    env = gym.make(f"sb3_stereo:{env_id}")
    env.action_space.seed(0)
    n_ends = 0
    for seed in range(4):
        _, info = env.reset(seed=seed)
        target, before = info["target_pixels"], info["pixel_offsets"]
        assert "previous_pixel_offsets" not in info
        for _ in range(6):
            _, reward, terminated, _, info = env.step(env.action_space.sample())
            previous = info.get("previous_pixel_offsets", np.full((2, 2), np.nan))
            seen = not np.isnan(before).any()
            assert np.array_equal(previous, before) if seen else np.isnan(previous).all()
            expected = env.get_wrapper_attr("offset_reward")(before, info["pixel_offsets"])
            assert (pytest.approx(reward), terminated) == expected
            before = info["pixel_offsets"]
            still = np.linalg.norm(info["target_pixels"] - target, axis=1)
            assert not (still > 6.0).any(), "px; the arm may hide a part of it"
            n_ends += terminated
            if terminated:
                break
