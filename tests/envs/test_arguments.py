"""What is wrong with an argument, an option or an action of the environment is said in one sentence."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sb3_stereo.envs.cameras import STEREO_PAIR
from sb3_stereo.envs.reach import StereoReachEnv

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
            "joint_positions [0.0, 2.0, 0.0, 1.5] collide (forearm and the floor); "
            "choose a pose clear of the arm itself and the floor",
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
        ({"pulse_duration": float("nan")}, "pulse_duration is nan; give a finite number"),
        ({"rho": None}, "rho is None; give a number"),
        ({"rho": 1e9}, "rho is 1e+09; give less than 400 px, the diagonal of a picture"),
        ({"rho": 95, "success_frame": "observation"}, "rho is 95; give less than 94 px, the diagonal of a picture"),
        ({"success_frame": "84x42"}, "unknown success_frame '84x42'; success frames are frame, observation"),
        ({"success_frame": None}, "unknown success_frame None; success frames are frame, observation"),
        ({"initial_positions": (0, 0, 0)}, "initial_positions has shape (3,); give (4,)"),
        (
            {"initial_positions": (0, 3, 0, 0)},
            f"initial_positions [0.0, 3.0, 0.0, 0.0] are outside the limits {LIMITS}",
        ),
        (
            {"initial_positions": (0, 2, 0, 1.5)},
            "initial_positions [0.0, 2.0, 0.0, 1.5] collide (forearm and the floor); "
            "choose a pose clear of the arm itself and the floor",
        ),
        ({"physics_rate": 60}, "physics_rate is 60; give at least 240"),
        ({"physics_rate": 1e6}, "physics_rate is 1000000.0; give at most 100000"),
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
