"""No past, no neighbour and no process changes an episode."""

import multiprocessing
from importlib.resources import files
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.vec_env import SubprocVecEnv

import sb3_stereo
from sb3_stereo.envs.reach import StereoReachEnv


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
