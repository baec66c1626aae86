"""Physics and pixels against what is independent of our code: poses at rest, and the reward from the frames alone.

The closed form of the kinematics, energy and limits are in `test_arm.py`, projected positions and the
observation by plain OpenCV in `test_reach.py`.
"""

from typing import Any

import numpy as np
import pytest

from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.envs.robots import ARMS

N_POSES = 8


@pytest.mark.parametrize("arm", ARMS)
def test_gravity_compensation_holds_any_pose(arm: str) -> None:
    env = StereoReachEnv(arm=arm, brake=False)
    for seed in range(N_POSES):
        _, before = env.reset(seed=seed)
        _, _, _, _, after = env.step(np.zeros(4))
        np.testing.assert_allclose(after["joint_positions"], before["joint_positions"], atol=1e-6)
    env.close()


def test_without_compensation_no_pose_is_held() -> None:
    """What the law above would miss if nothing ever moved."""
    env = StereoReachEnv(gravity_compensation=False, brake=False)
    for seed in range(N_POSES):
        _, before = env.reset(seed=seed)
        _, _, _, _, after = env.step(np.zeros(4))
        assert np.abs(after["joint_positions"] - before["joint_positions"]).max() > 1e-3
    env.close()


def centroid(view: np.ndarray, wanted: int) -> np.ndarray:
    """Of a marker in an RGB frame (height, width, 3): channel 0 for red, 2 for blue; nan if there is none."""
    rest = [channel for channel in range(3) if channel != wanted]
    mask = (view[:, :, wanted] >= 128) & (view[:, :, rest] <= 70).all(axis=2)
    y, x = np.nonzero(mask)
    return np.array([x.mean(), y.mean()]) if x.size >= 4 else np.full(2, np.nan)


def distances_in(frame: np.ndarray) -> np.ndarray:
    """d(t) of Eq. 2 for each half of a rendered frame, in [px]."""
    return np.array([np.linalg.norm(centroid(view, 0) - centroid(view, 2)) for view in np.hsplit(frame, 2)])


def equation_3(before: np.ndarray, after: np.ndarray) -> float:
    """The paper's reward, by cases, from the distances before and after."""
    if np.mean(after) <= 10:
        return 1.0
    change = [float(np.clip((b - a) / 100, -1, 1)) for b, a in zip(before, after, strict=True)]
    seen = [c for c in change if not np.isnan(c)]
    if len(seen) == 2 and seen[0] == seen[1] == 0:
        return -1.0
    return sum(seen) / len(seen) if seen else 0.0


def test_reward_is_equation_3_of_the_frames_alone(env: StereoReachEnv) -> None:
    rng, rewards, hidden = np.random.default_rng(1), [], 0
    for seed in range(12):
        env.reset(seed=seed)
        before = distances_in(render(env))
        for _ in range(4):
            _, value, terminated, *_ = env.step(rng.uniform(-1, 1, 4))
            after = distances_in(render(env))
            assert value == pytest.approx(equation_3(before, after), abs=1e-9)
            assert terminated == (np.mean(after) <= 10)
            rewards.append(value)
            hidden += int(np.isnan(after).any())
            before = after
            if terminated:
                break
    assert min(rewards) < 0 < max(rewards)
    assert hidden > 0, "a view without a marker is one of the cases"


def render(env: StereoReachEnv) -> Any:
    frame = env.render()
    assert frame is not None
    return frame
