"""The environment: what it promises to Gymnasium, to SB3, and to people."""

import multiprocessing
import pickle
import warnings
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from typing import Any

import cv2
import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gym_check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env
from stable_baselines3.common.vec_env import SubprocVecEnv

import sb3_stereo
from sb3_stereo.envs.cameras import STEREO_PAIR
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.envs.rewards import distance_change, reward

TWO_VIEWS = (240, 640, 3)


@pytest.fixture
def env() -> Iterator[StereoReachEnv]:
    env = StereoReachEnv(render_mode="rgb_array")
    yield env
    env.close()


def rollout(env: StereoReachEnv, seed: int, n_steps: int = 4) -> list[Any]:
    """Everything a learner would see of one episode."""
    rng = np.random.default_rng(seed)
    observation, info = env.reset(seed=seed)
    seen = [observation.tobytes(), info["pixel_distances"].tobytes()]
    for _ in range(n_steps):
        observation, value, terminated, _, info = env.step(rng.uniform(-1, 1, 4))
        seen += [observation.tobytes(), value, terminated, info["joint_positions"].tobytes()]
    return seen


def rollout_in_new_process(seed: int) -> list[Any]:
    return rollout(StereoReachEnv(), seed)


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


def test_same_seed_gives_same_bytes_whatever_came_before_and_across_processes(env: StereoReachEnv) -> None:
    first = rollout(env, seed=5)
    rollout(env, seed=6)
    assert rollout(env, seed=5) == first
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(rollout_in_new_process, (5,)) == first


def test_two_environments_do_not_touch_each_other(env: StereoReachEnv) -> None:
    alone = rollout(env, seed=7)
    other = StereoReachEnv()
    other.reset(seed=1)
    env.reset(seed=7)
    other.step(np.ones(4))
    assert rollout(env, seed=7) == alone
    other.close()


def test_a_restored_state_has_the_same_future_also_in_contact(env: StereoReachEnv) -> None:
    env.reset(options={"joint_positions": (0.0, 1.2, 0.0, 0.3)})
    down = np.array([0.0, 1.0, 0.0, 0.3])
    for _ in range(5):
        env.step(down)  # into the floor
    assert env.arm.collides()
    state = env.save_state()
    futures = []
    for _ in range(2):
        futures.append([env.step(action)[0].tobytes() for action in np.eye(4)])
        env.restore_state(state)
    assert futures[0] == futures[1]
    env.remove_state(state)


def test_a_restored_state_has_its_own_target_and_frames(env: StereoReachEnv) -> None:
    _, before = env.reset(seed=0, options={"target_position": (0.4, 0.2, 0.7)})
    frames, state = env.render(), env.save_state()
    env.reset(seed=1)
    env.restore_state(state)
    np.testing.assert_array_equal(env.render(), frames)  # type: ignore[arg-type]
    _, _, _, _, info = env.step(np.zeros(4))
    np.testing.assert_array_equal(info["target_position"], before["target_position"])
    np.testing.assert_array_equal(info["pixel_distances"], before["pixel_distances"])


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
            for marker, body, expected in zip(blobs, (env.markers), camera.spec.project(positions), strict=True):
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


def test_works_in_subprocesses() -> None:
    venv = SubprocVecEnv([lambda: gym.make("sb3_stereo:WamStereoReach-v0")] * 2, start_method="spawn")
    venv.seed(0)
    assert venv.reset().shape == (2, 1, 84, 84)
    observations, rewards, *_ = venv.step(np.zeros((2, 4), np.float32))
    assert observations.shape == (2, 1, 84, 84) and rewards.tolist() == [-1.0, -1.0]
    venv.close()


@pytest.mark.slow
def test_a_thousand_resets_leak_nothing(env: StereoReachEnv) -> None:
    import resource

    def peak() -> int:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    for _ in range(100):
        env.reset()
    before = peak()
    for _ in range(1000):
        env.reset()
        state = env.save_state()
        env.step(env.action_space.sample())
        env.remove_state(state)
    assert peak() - before < 4096  # KiB


LIMITS = [[-2.6, 2.6], [-2.0, 2.0], [-2.8, 2.8], [-0.9, 3.1]]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pose": 1}, "unknown reset option 'pose'; options are joint_positions, target_position"),
        (5, "the reset options are 5; give a map of joint_positions, target_position"),
        ({"joint_positions": (0, 0, 0)}, "joint_positions has shape (3,); give (4,)"),
        ({"joint_positions": "up"}, "joint_positions is 'up'; give 4 numbers"),
        ({"joint_positions": (0, 3, 0, 0)}, f"joint_positions [0.0, 3.0, 0.0, 0.0] are outside the limits {LIMITS}"),
        (
            {"joint_positions": (0, 2, 0, 1.5)},
            "joint_positions [0.0, 2.0, 0.0, 1.5] collide; choose a pose clear of the arm itself and the floor",
        ),
        ({"target_position": (0, 0, float("nan"))}, "target_position is [0.0, 0.0, nan]; give finite numbers"),
    ],
)
def test_wrong_reset_options_are_explained(env: StereoReachEnv, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as error:
        env.reset(options=options)
    assert str(error.value) == message
    env.reset(seed=0)  # and nothing is broken


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ([0, 0, 0], "action has shape (3,); give (4,)"),
        ([0, 0, 0, float("inf")], "action is [0.0, 0.0, 0.0, inf]; give finite numbers"),
        ("left", "action is 'left'; give 4 numbers"),
    ],
)
def test_wrong_actions_are_explained(env: StereoReachEnv, action: Any, message: str) -> None:
    env.reset(seed=0)
    with pytest.raises(ValueError) as error:
        env.step(action)
    assert str(error.value) == message


def test_actions_outside_the_space_are_clipped(env: StereoReachEnv) -> None:
    seen = []
    for factor in (1, 10):
        env.reset(seed=0)
        seen.append(env.step(factor * np.array([1, -1, 1, -1]))[0].tobytes())
    assert seen[0] == seen[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"render_mode": "video"}, "unknown render_mode 'video'; it is one of None, 'rgb_array', 'human'"),
        ({"rho": -1}, "rho is -1; give a positive number"),
        ({"pulse_duration": float("nan")}, "pulse_duration is nan; give a positive number"),
        ({"rho": None}, "rho is None; give a positive number"),
        ({"rho": 1e9}, "rho is 1e+09; give less than 400 px, the diagonal of a picture"),
        ({"physics_rate": 60}, "physics_rate is 60; give at least 240 Hz"),
        ({"physics_rate": 1e6}, "physics_rate is 1000000.0; give at most 100000 Hz"),
        (
            {"pulse_duration": 1e6},
            "pulse_duration is 1000000.0, which takes 2.4e+08 simulation steps; "
            "give a shorter one, of at most 100000 steps",
        ),
        ({"brake": "no"}, "brake is 'no'; give true or false"),
        ({"damping": (1, 1, 1, -1)}, "damping is (1, 1, 1, -1); give numbers of at least 0"),
        ({"target_position": (0, 0, 1e9)}, "target_position is [0.0, 0.0, 1000000000.0]; give at most 10000"),
        ({"cameras": ()}, "no cameras; give at least one CameraSpec, or map of one"),
        ({"damping": (1, 2)}, "damping has shape (2,); give (4,)"),
        ({"effort_limits": (1, 2)}, "effort_limits has shape (2,); give (4,)"),
        ({"effort_limits": (1, 2, 0, 1)}, "effort_limits are (1, 2, 0, 1); give positive numbers"),
        (
            {"cameras": (STEREO_PAIR[0], replace(STEREO_PAIR[1], width=160))},
            "cameras of 160 x 240, 320 x 240 px; give all the same size",
        ),
    ],
)
def test_wrong_arguments_are_explained(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as error:
        StereoReachEnv(**arguments)
    assert str(error.value) == message


def test_human_without_a_display_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(RuntimeError) as error:
        StereoReachEnv(render_mode="human")
    assert str(error.value) == "render_mode 'human' needs a display and DISPLAY is not set; use render_mode 'rgb_array'"


@pytest.mark.parametrize("env_id", sb3_stereo.ENV_IDS)
def test_stored_test_poses_are_those_of_their_seed(env_id: str) -> None:
    env: Any = gym.make(env_id).unwrapped
    header, *rows = (files("sb3_stereo.envs") / "assets" / "test_poses" / f"{env_id}.csv").read_text().splitlines()
    targets = ("target_x", "target_y", "target_z") if env.random_target else ()
    assert tuple(header.split(",")) == (*env.arm.spec.joints, *targets)
    drawn = []
    for first in [True] + 99 * [False]:
        _, info = env.reset(seed=2017 if first else None)
        drawn.append([*env.arm.actuated_positions, *(info["target_position"] if targets else ())])
    np.testing.assert_allclose(np.loadtxt(rows, delimiter=","), drawn, atol=5.1e-7)
    env.close()
