"""Keys of Bullet's window push joints; without a window there are none."""

from typing import Any

import numpy as np
import pytest

from sb3_stereo.envs.bullet import pybullet
from sb3_stereo.envs.keyboard import BACK, FINE, FORWARD, NEW_EPISODE, action_of, is_down, legend

DOWN, TAPPED, UP = (
    pybullet.KEY_IS_DOWN,
    pybullet.KEY_IS_DOWN | pybullet.KEY_WAS_TRIGGERED | pybullet.KEY_WAS_RELEASED,
    pybullet.KEY_WAS_RELEASED,
)


def keys(text: str, state: int = DOWN) -> dict[int, int]:
    return {ord(key): state for key in text}


@pytest.mark.parametrize("n_joints", range(1, len(FORWARD) + 1))
def test_each_key_pushes_one_joint_one_way(n_joints: int) -> None:
    for joint in range(n_joints):
        pushed = np.eye(n_joints, dtype=np.float32)[joint]
        for text, action in ((FORWARD[joint], pushed), (BACK[joint], -pushed)):
            found = action_of(keys(text), n_joints)
            assert found is not None and found.dtype == np.float32
            np.testing.assert_array_equal(found, action)
            assert action_of(keys(text, UP), n_joints) is None
    for key in FORWARD[n_joints:] + BACK[n_joints:]:
        assert action_of(keys(key), n_joints) is None, "a key of a joint that this arm has not"


def test_several_keys_push_several_joints_and_opposite_ones_none() -> None:
    np.testing.assert_array_equal(action_of(keys("qsr"), 4), [1, -1, 0, 1])
    np.testing.assert_array_equal(action_of(keys("qa"), 4), [0, 0, 0, 0])


def test_a_tap_between_two_looks_counts_and_shift_makes_it_finer() -> None:
    np.testing.assert_array_equal(action_of(keys("q", TAPPED), 4), [1, 0, 0, 0])
    np.testing.assert_array_equal(action_of(keys("qs", TAPPED) | {FINE: DOWN}, 4), [0.25, -0.25, 0, 0])
    assert action_of({FINE: DOWN}, 4) is None


def test_no_two_keys_are_the_same() -> None:
    assert len(FORWARD) == len(BACK) and len({*FORWARD, *BACK, NEW_EPISODE}) == 2 * len(FORWARD) + 1
    assert is_down(keys(NEW_EPISODE, TAPPED), NEW_EPISODE) and not is_down(keys(NEW_EPISODE, UP), NEW_EPISODE)


def test_the_legend_names_every_joint_with_its_keys() -> None:
    lines = legend(["J1", "elbow"]).splitlines()
    assert lines[:2] == ["  J1     q / a", "  elbow  w / s"] and len(lines) == 3


def test_an_environment_without_a_window_has_no_keys(env: Any) -> None:
    assert env.keyboard_events() == {}
