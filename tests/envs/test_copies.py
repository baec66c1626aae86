"""A copy of an environment is a world of its own, in the same state."""

import copy
import gc
import multiprocessing
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.envs.robots import WAM
from sb3_stereo.envs.wrappers import QuantizedActions, WatchedPulses

COPIES: dict[str, Callable[[Any], Any]] = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
}
VARIANTS: dict[str, dict[str, Any]] = {
    "default": {},
    "floor": {"floor": True, "composite": "dict"},
    "coasting": {"brake": False},
    "falling": {"brake": False, "gravity_compensation": False, "damping": (4, 5, 2, 1)},
    "same start": {"initial_positions": (0.5, -0.5, 0.0, 1.0), "success_frame": "observation"},
    "random target": {"random_target": True, "effort_limits": (5, 5, 5, 5)},
    "panda": {"arm": "panda", "brake": False},
}
DOWN = np.array([0.0, 1.0, 0.0, 0.3])

both_ways = pytest.mark.parametrize("make_copy", COPIES.values(), ids=COPIES)


def plain(value: Any) -> Any:
    """A value that == compares to the bit, NaN included."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return [plain(item) for item in value]
    return value.tobytes() if isinstance(value, np.ndarray) else value


def play(env: Any, actions: Any) -> list[Any]:
    return [plain(env.step(action)) for action in actions]


def random_actions(seed: int, n: int) -> Any:
    return np.random.default_rng(seed).uniform(-1, 1, (n, 4)).astype(np.float32)


@both_ways
@pytest.mark.parametrize("kwargs", VARIANTS.values(), ids=VARIANTS)
def test_a_copy_has_the_same_future_to_the_bit(kwargs: dict[str, Any], make_copy: Callable[[Any], Any]) -> None:
    env = StereoReachEnv(render_mode="rgb_array", **kwargs)
    env.reset(seed=4)
    env.action_space.seed(4)
    play(env, random_actions(0, 3))
    twin = make_copy(env)
    assert plain(twin.render()) == plain(env.render())
    actions = random_actions(1, 4)
    assert play(twin, actions) == play(env, actions)
    assert plain(twin.reset()) == plain(env.reset())  # the draws go on as well
    assert plain(twin.action_space.sample()) == plain(env.action_space.sample())
    env.close()
    twin.close()


@pytest.mark.parametrize("brake", [True, False])
def test_a_copy_has_the_same_future_also_in_contact(brake: bool) -> None:
    env = StereoReachEnv(brake=brake)
    env.reset(options={"joint_positions": (0.0, 1.2, 0.0, 0.3)})
    play(env, [DOWN] * 5)  # into the floor
    assert env.arm.collides()
    twin = copy.deepcopy(env)
    actions = [DOWN, DOWN, *random_actions(2, 4)]
    assert play(twin, actions) == play(env, actions)
    env.close()
    twin.close()


@settings(max_examples=10, deadline=None, derandomize=True)
@given(seed=st.integers(0, 1000), n_before=st.integers(0, 3), brake=st.booleans())
def test_neither_the_original_nor_its_copy_moves_the_other(seed: int, n_before: int, brake: bool) -> None:
    env = StereoReachEnv(brake=brake)
    env.reset(seed=seed)
    play(env, random_actions(seed, n_before))
    twin, judge = copy.deepcopy(env), copy.deepcopy(env)
    play(twin, random_actions(seed + 1, 2))
    twin.reset(seed=0, options={"target_position": (0.3, 0.2, 0.8)})
    twin.close()
    actions = random_actions(seed + 2, 2)
    assert play(env, actions) == play(judge, actions)
    env.close()
    judge.close()


def test_closing_and_collecting_copies_leaves_the_original_and_later_environments_alone() -> None:
    env: Any = gym.make("sb3_stereo:WamStereoReach-v0")
    env.reset(seed=0)
    twin, expected = copy.deepcopy(env), play(copy.deepcopy(env), random_actions(0, 2))
    twin.close()
    later: Any = gym.make("sb3_stereo:WamStereoReach-v0")  # takes the number that Bullet gave the copy
    later.reset(seed=0)
    twin.close()
    del twin
    gc.collect()
    assert play(later, random_actions(0, 2)) == expected
    assert play(env, random_actions(0, 2)) == expected
    env.close()
    later.close()


@both_ways
def test_wrappers_are_copied_with_what_they_count(make_copy: Callable[[Any], Any]) -> None:
    env: Any = QuantizedActions(gym.make("sb3_stereo:WamStereoReach-v0", rho=1.0, max_episode_steps=3))
    env.reset(seed=0)
    env.step(7)
    twin = make_copy(env)
    assert twin.unwrapped is not env.unwrapped
    ends = [play(one, [7, 70]) for one in (env, twin)]
    assert ends[0] == ends[1] and ends[0][-1][3] is True  # truncated
    env.close()
    twin.close()


class Counter:
    """Counts looks."""

    n = 0

    def capture(self, efforts: Any) -> None:
        self.n += 1


def test_a_copy_has_watchers_of_its_own(env: StereoReachEnv) -> None:
    counter = Counter()
    watched = WatchedPulses(env, counter.capture, 4)
    watched.reset(seed=0)
    twin = copy.deepcopy(watched)
    play(twin, [DOWN, DOWN])
    assert counter.n == 0
    watched.step(DOWN)
    assert counter.n == 3
    assert twin._watcher[0].__self__.n == 6  # type: ignore[attr-defined]
    twin.close()


def test_what_was_changed_since_it_was_made_is_copied(env: StereoReachEnv) -> None:
    env.rho = 300.0
    twin = copy.deepcopy(env)
    with pytest.raises(gym.error.ResetNeeded):
        twin.step(DOWN)
    twin.reset(seed=0, options={"joint_positions": (0.0, 0.0, 0.0, 0.0)})
    assert twin.step(np.zeros(4))[2]  # a goal within 300 px
    twin.close()


def step_in_another_process(pickled: bytes) -> list[Any]:
    return play(pickle.loads(pickled), random_actions(0, 2))


def test_a_pickled_environment_goes_on_in_another_process(env: StereoReachEnv) -> None:
    env.reset(seed=3)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        elsewhere = pool.apply(step_in_another_process, (pickle.dumps(env),))
    assert elsewhere == play(env, random_actions(0, 2))


def test_a_robot_that_has_changed_since_it_was_pickled_is_said(tmp_path: Path) -> None:
    urdf = tmp_path / "arm.urdf"
    assets = files("sb3_stereo.envs") / "assets"
    text = (assets / WAM.urdf).read_text(encoding="utf-8")
    urdf.write_text(text)
    (tmp_path / "half_cylinder.obj").write_bytes((assets / "half_cylinder.obj").read_bytes())
    env = StereoReachEnv(arm=replace(WAM, urdf=str(urdf)))
    env.reset(seed=0)
    pickled = pickle.dumps(env)
    pickle.loads(pickled).step(DOWN)
    base = re.findall(r'<link name="([^"]*)"', text)[0]
    joint = f'<joint name="j" type="fixed"><parent link="{base}"/><child link="more"/></joint>'
    urdf.write_text(text.replace("</robot>", f'<link name="more"/>{joint}</robot>'))
    with pytest.raises(ValueError) as refusal:
        pickle.loads(pickled)
    assert str(refusal.value) == f"'{urdf}' has changed since the environment was pickled; pickle it again"
    env.close()


def test_copies_leak_no_simulator() -> None:
    env = StereoReachEnv()
    env.reset(seed=0)
    gc.collect()  # what other tests left frees numbers
    numbers = set()
    for _ in range(5):
        twin = copy.deepcopy(env)
        numbers.add(twin._world._client.number)
        del twin
    assert len(numbers) == 1
    env.close()


@both_ways
def test_a_copy_of_a_closed_environment_is_closed(env: StereoReachEnv, make_copy: Callable[[Any], Any]) -> None:
    env.close()
    with pytest.raises(gym.error.ClosedEnvironmentError, match=r"^the environment is closed; make a new one$"):
        make_copy(env).reset()


@both_ways
def test_a_window_is_not_copied(env: StereoReachEnv, make_copy: Callable[[Any], Any]) -> None:
    env._world.in_window = True  # as with render_mode "human", which needs a display
    with pytest.raises(ValueError) as refusal:
        make_copy(env)
    assert str(refusal.value) == (
        "an environment in Bullet's window (render_mode 'human') has no copies; copy one with render_mode None or "
        "'rgb_array'"
    )


def test_no_copy_shares_a_simulator(env: StereoReachEnv) -> None:
    with pytest.raises(ValueError) as refusal:
        copy.copy(env)
    assert str(refusal.value) == "a shallow copy of an environment would share its simulator; use copy.deepcopy"
    for part in (env.arm, env.cameras[0], env._world.rig):
        for make_copy in COPIES.values():
            with pytest.raises(ValueError) as refusal:
                make_copy(part)
            assert str(refusal.value) == "a simulator has no copies of its own; copy the environment"
