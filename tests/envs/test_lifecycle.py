"""Before the first reset, after a refused one or close, with a state of another: one sentence, and nothing changes."""

import copy
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from hypothesis import given, settings
from hypothesis import strategies as st
from test_copies import DOWN, plain, play, random_actions

from sb3_stereo.envs.bullet import pybullet
from sb3_stereo.envs.reach import StereoReachEnv

NO_EPISODE = "the environment has no episode yet; call reset first"
CLOSED = "the environment is closed; make a new one"
UNKNOWN_STATE = "the state is another environment's, or removed; give one that save_state of this environment returned"

OF_AN_EPISODE: dict[str, Callable[[Any], object]] = {
    "step": lambda env: env.step(np.zeros(4)),
    "capture": lambda env: env.capture(),
    "render": lambda env: env.render(),
    "draw": lambda env: env.draw(),
    "save_state": lambda env: env.save_state(),
}
OF_A_WORLD: dict[str, Callable[[Any], object]] = {
    **OF_AN_EPISODE,
    "reset": lambda env: env.reset(seed=0),
    "restore_state": lambda env: env.restore_state(None),
    "remove_state": lambda env: env.remove_state(None),
    "arm": lambda env: env.arm.joint_positions,
    "cameras": lambda env: env.cameras,
}

# ---------------------------------------------------------------------------------------- too early, too late


@pytest.mark.parametrize("call", OF_AN_EPISODE.values(), ids=OF_AN_EPISODE)
@pytest.mark.parametrize("kwargs", [{}, {"render_mode": "rgb_array", "initial_positions": (0.5, -0.5, 0.0, 1.0)}])
def test_what_needs_an_episode_says_so_before_the_first_reset(kwargs: dict[str, Any], call: Any) -> None:
    env = StereoReachEnv(**kwargs)
    with pytest.raises(ResetNeeded) as refusal:
        call(env)
    assert str(refusal.value) == NO_EPISODE
    assert plain(env.reset(seed=0)) == plain(StereoReachEnv(**kwargs).reset(seed=0))
    call(env)
    env.close()


def test_a_refused_first_reset_begins_no_episode(env: StereoReachEnv) -> None:
    with pytest.raises(ValueError, match="collide"):
        env.reset(seed=0, options={"joint_positions": (0.0, 2.0, 0.0, 3.1)})
    with pytest.raises(ResetNeeded):
        env.step(DOWN)
    assert env._np_random is None


@pytest.mark.parametrize("call", OF_A_WORLD.values(), ids=OF_A_WORLD)
@pytest.mark.parametrize("has_episode", [True, False])
def test_a_closed_environment_says_so_whatever_is_asked(env: StereoReachEnv, has_episode: bool, call: Any) -> None:
    if has_episode:
        env.reset(seed=0)
    env.close()
    env.close()
    with pytest.raises(ClosedEnvironmentError) as refusal:
        call(env)
    assert str(refusal.value) == CLOSED


def test_a_closed_environment_says_so_through_its_wrappers() -> None:
    env: Any = gym.make("sb3_stereo:WamStereoReach-v0", render_mode="rgb_array")
    env.reset(seed=0)
    env.close()
    for call in (lambda: env.step(DOWN), env.reset, env.render):
        with pytest.raises(ClosedEnvironmentError):
            call()
    env.close()


def test_parts_of_a_closed_environment_do_not_touch_another(env: StereoReachEnv) -> None:
    env.reset(seed=0)
    arm, camera = env.arm, env.cameras[0]
    env.close()
    other = StereoReachEnv()
    other.reset(seed=1)
    twin = copy.deepcopy(other)
    for use in (lambda: arm.push([1.0] * 4, 10), camera.frame, arm.brake, lambda: arm.joint_positions):
        with pytest.raises(pybullet.error):
            use()
    assert play(other, random_actions(0, 2)) == play(twin, random_actions(0, 2))
    other.close()
    twin.close()


# ---------------------------------------------------------------------------------------- states of another


def test_only_a_state_that_is_still_its_own_is_restored_or_removed(env: StereoReachEnv) -> None:
    env.reset(seed=0)
    other = copy.deepcopy(env)
    removed, kept = env.save_state(), env.save_state()
    env.remove_state(removed)
    strangers = [other.save_state(), removed, copy.deepcopy(kept), None, 3, [], "state"]
    twin = copy.deepcopy(env)
    for call in (env.restore_state, env.remove_state):
        for stranger in strangers:
            with pytest.raises(ValueError) as refusal:
                call(stranger)  # type: ignore[arg-type]
            assert str(refusal.value) == UNKNOWN_STATE
    assert play(env, random_actions(0, 2)) == play(twin, random_actions(0, 2))
    env.restore_state(kept)
    assert play(env, random_actions(0, 2)) == play(other, random_actions(0, 2))
    other.close()
    twin.close()


# ---------------------------------------------------------------------------------------- refused resets

COLLIDING = {"joint_positions": (0.0, 2.0, 0.0, 3.1)}
poses = st.lists(st.floats(-4, 4), min_size=4, max_size=4)
bad_seeds = st.integers(max_value=-1) | st.floats() | st.booleans() | st.text(max_size=3) | st.just([1])
bad_numbers = st.lists(st.floats(), max_size=3) | st.just([np.nan] * 4) | st.text(max_size=3) | st.integers()
bad_options = st.one_of(
    st.sampled_from([COLLIDING, {"pose": 1}, {1: 2}, 5, "joints"]),
    st.fixed_dictionaries({"joint_positions": bad_numbers}),
    st.fixed_dictionaries({"target_position": bad_numbers | st.just([1e9, 0, 0])}),
    st.fixed_dictionaries({"joint_positions": poses, "target_position": st.just([0.4, 0.1, 0.5])}),  # most collide
)
resets = st.fixed_dictionaries({}, optional={"seed": st.integers(0, 9) | bad_seeds, "options": bad_options})


@pytest.fixture(scope="module", params=[True, False], ids=["brake", "coasting"])
def pair(request: pytest.FixtureRequest) -> Iterator[tuple[StereoReachEnv, StereoReachEnv]]:
    """Two environments in the same state, between two steps."""
    env = StereoReachEnv("rgb_array", brake=request.param, random_target=True)
    env.reset(seed=2)
    env.step(DOWN)
    twin = copy.deepcopy(env)
    yield env, twin
    env.close()
    twin.close()


@settings(max_examples=30, deadline=None, derandomize=True)
@given(arguments=resets, action=st.integers(0, 100))
def test_a_refused_reset_changes_nothing(pair: Any, arguments: dict[str, Any], action: int) -> None:
    env, twin = pair
    frames = plain(env.render())
    try:
        env.reset(**arguments)
    except ValueError:
        assert plain(env.render()) == frames
        assert env.np_random_seed == twin.np_random_seed
    else:
        twin.reset(**arguments)
    assert env.np_random.bit_generator.state == twin.np_random.bit_generator.state
    assert play(env, random_actions(action, 1)) == play(twin, random_actions(action, 1))


@pytest.mark.parametrize(
    ("random_target", "rho", "message"),
    [(False, 1e5, "none is away from the goal"), (True, 1e5, "none is away from the goal"), (True, -1.0, "no target")],
)
def test_a_reset_that_finds_no_start_changes_nothing(
    random_target: bool, rho: float, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sb3_stereo.envs.starts.MAX_DRAWS", 2)
    env = StereoReachEnv(random_target=random_target)
    env.reset(seed=0)
    play(env, [DOWN])
    twin, generator = copy.deepcopy(env), env.np_random
    env.rho = rho  # every pose is a goal, or none
    with pytest.raises(ValueError, match=message):
        env.reset(seed=5)
    env.rho = twin.rho
    assert env.np_random is generator
    assert play(env, random_actions(0, 2)) == play(twin, random_actions(0, 2))
    assert plain(env.reset()) == plain(twin.reset())
    env.close()
    twin.close()


@pytest.mark.parametrize(
    ("seed", "message"),
    [
        (-1, "seed is -1; give an integer of at least 0, or None"),
        (1.5, "seed is 1.5; give an integer of at least 0, or None"),
        (True, "seed is True; give an integer of at least 0, or None"),
        ("7", "seed is '7'; give an integer of at least 0, or None"),
    ],
)
def test_a_wrong_seed_is_explained(env: StereoReachEnv, seed: Any, message: str) -> None:
    with pytest.raises(ValueError) as refusal:
        env.reset(seed=seed)
    assert str(refusal.value) == message


def test_an_integer_of_numpy_is_a_seed(env: StereoReachEnv) -> None:
    assert plain(env.reset(seed=np.int64(7))) == plain(env.reset(seed=7))  # type: ignore[arg-type]
