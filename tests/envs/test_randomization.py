"""Randomised worlds: they are what their ranges say, and everything about determinism holds in them too."""

import copy
import math
import pickle
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sb3_stereo.envs.cameras import CLOSE_PAIR
from sb3_stereo.envs.clutter import CLEAR, size_of
from sb3_stereo.envs.randomization import DEFAULT, Randomization, randomization
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.envs.sensor import draw_picture, floor_pattern

V1: dict[str, Any] = {"framing": "close", "markers": "hollow", "rho": 5.0, "distance_scale": 200.0}
POSE = {"joint_positions": [0.3, 0.4, -0.2, 1.2]}
ACTIONS = np.random.default_rng(5).uniform(-1, 1, (4, 4))
EVERYTHING: dict[str, Any] = {
    "ambient": [0.4, 0.9],
    "light_angle": [0.0, 1.0],
    "shadow": [0.2, 0.6],
    "exposure": [0.7, 1.2],
    "colour_cast": 0.1,
    "noise": [1, 10],
    "blur": [0.5, 1.0],
    "compression": [10, 60],
    "shift": 4,
    "dead_pixels": 0.01,
    "patches": [0, 2],
    "camera_position": [0, 0.05],
    "camera_rotation": [0, 0.01],
    "field_of_view": [0.95, 1.05],
    "effort": [0.8, 1.2],
    "damping": [0.7, 1.3],
    "friction": [0, 0.3],
    "mass": [0.8, 1.2],
    "gravity": [0, 0.1],
    "latency": [0, 0.1],
    "link_colours": [0, 1],
    "floor": 0.5,
    "floor_pattern": 0.5,
    "background": 0.5,
    "clutter": [1, 4],
}
SENSORS = ("exposure", "colour_cast", "noise", "blur", "compression", "shift", "dead_pixels", "patches", "background")
LOOKS = {"ambient": 0.3, "light_angle": 1.0, "link_colours": 1.0, "floor": 1.0, "exposure": 0.7, "colour_cast": 0.3}
ARM = {"effort": 0.5, "damping": 2.0, "friction": 1.0, "mass": 2.0, "gravity": 0.5, "latency": 0.25}


def make(randomize: Any = None, **kwargs: Any) -> StereoReachEnv:
    return StereoReachEnv(**{**V1, **kwargs}, randomize=randomize)


@pytest.fixture(scope="module")
def plain() -> Iterator[StereoReachEnv]:
    env = make()
    yield env
    env.close()


@pytest.fixture(scope="module")
def varied() -> Iterator[StereoReachEnv]:
    env = make(EVERYTHING)
    yield env
    env.close()


def episode(env: StereoReachEnv, **reset: Any) -> list[Any]:
    """Everything that an agent and its judge see."""
    observation, info = env.reset(**reset)
    seen = [observation, *info.values()]
    for action in ACTIONS:
        observation, reward, terminated, _, info = env.step(action)
        seen += [observation, reward, terminated, *info.values()]
    return seen


def rest(env: StereoReachEnv) -> list[Any]:
    return [value for action in ACTIONS for value in (env.step(action)[0], env.step(action)[1])]


def assert_same(one: list[Any], other: list[Any]) -> None:
    for a, b in zip(one, other, strict=True):
        assert_array_equal(a, b)


def differ(one: list[Any], other: list[Any]) -> bool:
    return any(not np.array_equal(a, b, equal_nan=True) for a, b in zip(one, other, strict=True))


def test_ranges_that_change_nothing_are_the_same_task(plain: StereoReachEnv) -> None:
    env = make({})
    for one, other in zip(episode(env, seed=1, options=POSE), episode(plain, seed=1, options=POSE), strict=True):
        assert_allclose(one, other, rtol=1e-9, atol=1e-9)
    env.close()


def test_markers_are_measured_as_well_by_their_bodies_as_by_their_colours(plain: StereoReachEnv) -> None:
    """The judge of a randomised world looks for pixels of the balls, the usual one for red and blue."""
    env = make({})
    rng = np.random.default_rng(0)
    for _ in range(20):
        plain.reset(seed=int(rng.integers(1000)))
        pose = {"joint_positions": plain.arm.actuated_positions}
        offsets = [one.reset(seed=0, options=pose)[1]["pixel_offsets"] for one in (env, plain)]
        assert_allclose(*offsets, atol=1e-9)  # another part of the frame is measured: only rounding differs
    env.close()


@pytest.mark.parametrize("random_target", [False, True])
def test_same_seed_gives_same_episode_whatever_came_before(random_target: bool) -> None:
    first, second = (make(EVERYTHING, random_target=random_target) for _ in range(2))
    second.reset(seed=8)
    second.step(ACTIONS[0])
    assert_same(episode(first, seed=3), episode(second, seed=3))
    for env in (first, second):
        env.close()


def test_every_episode_is_another_world(varied: StereoReachEnv) -> None:
    images = [varied.reset(seed=seed, options=POSE)[0] for seed in range(3)]
    assert differ(images[:1], images[1:2]) and differ(images[1:2], images[2:])


def test_an_observation_depends_on_the_state_alone(varied: StereoReachEnv) -> None:
    observation, _ = varied.reset(seed=4)
    assert_array_equal(varied.capture(), observation)


def test_a_saved_state_has_its_own_world(varied: StereoReachEnv) -> None:
    varied.reset(seed=1)
    state = varied.save_state()
    expected = rest(varied)
    varied.reset(seed=2)
    varied.restore_state(state)
    assert_same(rest(varied), expected)
    varied.remove_state(state)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_has_the_same_future(varied: StereoReachEnv, copied: Any) -> None:
    varied.reset(seed=6)
    varied.step(ACTIONS[0])
    other = copied(varied)
    assert_same(rest(other), rest(varied))
    other.close()


def test_a_refused_reset_changes_nothing(varied: StereoReachEnv) -> None:
    varied.reset(seed=6)
    state = varied.save_state()
    expected = rest(varied)
    varied.restore_state(state)
    draws = varied.np_random.bit_generator.state
    with pytest.raises(ValueError, match="outside the limits"):
        varied.reset(options={"joint_positions": [9.0, 0.0, 0.0, 0.0]})
    assert varied.np_random.bit_generator.state == draws
    assert_same(rest(varied), expected)
    varied.remove_state(state)


@pytest.mark.parametrize("name", SENSORS)
def test_a_sensor_changes_what_is_seen_and_not_what_is_judged(plain: StereoReachEnv, name: str) -> None:
    env = make({name: 1.0 if name == "background" else EVERYTHING[name]})
    observation, info = env.reset(seed=0, options=POSE)
    clean, clean_info = plain.reset(seed=0, options=POSE)
    assert not np.array_equal(observation, clean)
    assert_array_equal(info["pixel_offsets"], clean_info["pixel_offsets"])
    env.close()


@pytest.mark.parametrize(("name", "value"), LOOKS.items())
def test_light_and_colours_change_what_is_seen_and_nothing_else(plain: StereoReachEnv, name: str, value: Any) -> None:
    env = make({name: value})
    episodes = episode(env, seed=0, options=POSE), episode(plain, seed=0, options=POSE)
    (seen, *changed), (clean, *unchanged) = episodes
    assert not np.array_equal(seen, clean)
    images = [isinstance(value, np.ndarray) and value.dtype == np.uint8 for value in changed]
    states = [[value for value, image in zip(one, images, strict=True) if not image] for one in (changed, unchanged)]
    assert_same(*states)
    env.close()


@pytest.mark.parametrize(("name", "value"), ARM.items())
def test_the_arm_moves_otherwise_and_looks_the_same(plain: StereoReachEnv, name: str, value: Any) -> None:
    env = make({name: value})
    assert_array_equal(env.reset(seed=0, options=POSE)[0], plain.reset(seed=0, options=POSE)[0])
    infos = [one.step(ACTIONS[0])[4] for one in (env, plain)]
    assert not np.allclose(infos[0]["joint_positions"], infos[1]["joint_positions"], atol=1e-4)
    env.close()


@pytest.mark.parametrize(
    ("randomize", "kwargs"),
    [
        ({"gravity": 1.0}, {"gravity_compensation": False}),
        ({"damping": 2.0}, {"damping": [10.0, 10.0, 6.0, 4.0]}),
        ({"latency": 0.25}, {"pulse_duration": 0.25}),
    ],
)
def test_a_change_of_the_arm_is_that_of_the_argument(randomize: dict[str, Any], kwargs: dict[str, Any]) -> None:
    if "damping" in kwargs:
        arm = make()
        kwargs = {"damping": [2.0 * d for d in arm.arm.spec.damping]}
        arm.close()
    one, other = make(randomize), make(**kwargs)
    for env in (one, other):
        env.reset(seed=0, options=POSE)
    for action in ACTIONS:
        positions = [env.step(action)[4]["joint_positions"] for env in (one, other)]
        assert_allclose(*positions, atol=1e-9)
    one.close()
    other.close()


def test_half_the_effort_is_half_the_action(plain: StereoReachEnv) -> None:
    env = make({"effort": 0.5})
    env.reset(seed=0, options=POSE)
    plain.reset(seed=0, options=POSE)
    positions = env.step(ACTIONS[0])[4]["joint_positions"], plain.step(ACTIONS[0] / 2)[4]["joint_positions"]
    assert_allclose(*positions, atol=1e-12)
    env.close()


def test_friction_holds_a_joint_against_less_effort() -> None:
    env = make({"friction": 3.0})
    env.reset(seed=0, options=POSE)
    before = env.arm.actuated_positions
    env.step(2.0 / env.effort_limits)
    assert_allclose(env.arm.actuated_positions, before, atol=1e-3)
    env.step(np.minimum(1.0, 9.0 / env.effort_limits))
    assert np.abs(env.arm.actuated_positions - before).max() > 0.05
    env.close()


def test_cameras_are_moved_and_turned_by_what_the_ranges_say() -> None:
    ranges = Randomization(camera_position=(0.05, 0.05), camera_rotation=(0.02, 0.02), field_of_view=(1.1, 1.1))
    moved = ranges.draw(np.random.default_rng(0), CLOSE_PAIR, 4, 7).views
    assert moved[0].position != moved[1].position
    for view, nominal in zip(moved, CLOSE_PAIR, strict=True):
        assert_allclose(math.dist(view.position, nominal.position), 0.05)
        assert_allclose(view.horizontal_fov, 1.1 * nominal.horizontal_fov)
        sights = [np.subtract(one.target, one.position) for one in (view, nominal)]
        angle = math.acos(sights[0] @ sights[1] / np.linalg.norm(sights[0]) / np.linalg.norm(sights[1]))
        assert 0.0 < angle <= 0.02 + 1e-9
        frames = [np.array([sight / np.linalg.norm(sight), one.up]) for sight, one in zip(sights, (view, nominal))]
        assert_allclose(frames[0] @ frames[0].T, frames[1] @ frames[1].T, atol=1e-9)  # turned as a whole


def test_drawn_numbers_fill_their_range_and_nothing_else() -> None:
    rng = np.random.default_rng(0)
    ranges = Randomization(effort=(0.8, 1.2), mass=(0.9, 1.1), gravity=(0.1, 0.2))
    drawn = [ranges.draw(rng, CLOSE_PAIR, 4, 7) for _ in range(100)]
    efforts, masses = np.concatenate([v.effort for v in drawn]), np.concatenate([v.mass for v in drawn])
    assert 0.8 <= efforts.min() < 0.81 and 1.19 < efforts.max() <= 1.2
    assert 0.9 <= masses.min() < 0.905 and 1.095 < masses.max() <= 1.1
    assert all(0.1 <= v.gravity <= 0.2 for v in drawn)


def test_clutter_hides_the_target_in_no_view() -> None:
    env = make({"clutter": 8})
    for seed in range(10):
        _, info = env.reset(seed=seed)
        variation = env._world.variation
        assert variation is not None and len(variation.clutter) == 8
        for item in variation.clutter:
            for view in variation.views:
                gap = view.project(np.array(item.position)) - view.project(info["target_position"])
                assert np.linalg.norm(gap) / view.scale > math.sqrt(3) * size_of(item.number) + CLEAR
    env.close()


def test_clutter_touches_nothing() -> None:
    env, plain = make({"clutter": 12}), make()
    for one in (env, plain):
        one.reset(seed=0, options=POSE)
    for action in ACTIONS:
        assert_array_equal(*(one.step(action)[4]["joint_positions"] for one in (env, plain)))
    env.close()
    plain.close()


def test_a_floor_pattern_lies_on_the_floor() -> None:
    """A point of the floor has the same brightness in both cameras."""
    one, other = (floor_pattern(view, np.random.default_rng(3)) for view in CLOSE_PAIR)
    points = np.column_stack([np.random.default_rng(0).uniform(-0.6, 0.6, (200, 2)), np.zeros(200)])
    brightness = []
    for view, pattern in zip(CLOSE_PAIR, (one, other), strict=True):
        x, y = np.round(view.project(points)).astype(int).T
        inside = (x >= 0) & (x < view.width) & (y >= 0) & (y < view.height)
        assert inside.all()
        brightness.append(pattern[y, x])
    assert np.corrcoef(*brightness)[0, 1] > 0.7  # but for pixels at the edge of a tile


def test_a_shadow_falls_where_the_light_does_not_reach() -> None:
    """The target's, which is a ball in the air: its middle along the light to the floor."""
    target, light = np.array([0.6, 0.5, 0.5]), np.array([1.0, 0.0, 2.0])
    options = {"joint_positions": [0.0, 0.0, 0.0, 0.0], "target_position": target}
    env, plain = make({"shadow": 0.5, "floor": 1.0}), make({"floor": 1.0})
    frames = []
    for one in (env, plain):
        one.reset(seed=0, options=options)
        frames.append([frame[:, :, 0].astype(float) for frame in one._captured.frames])
    for view, shaded, bright in zip(env.cameras, *frames, strict=True):
        column, row = np.rint(view.spec.project(target - light * target[2] / light[2])).astype(int)
        dark = shaded < 0.6 * bright
        assert dark[row, column] and not dark[row - 6, column] and not dark[row, column + 14]
        assert 50 < dark.sum() < 6000
    assert_array_equal(env._captured.offsets, plain._captured.offsets)
    env.close()
    plain.close()


def test_pictures_differ_and_are_no_flat_grey() -> None:
    pictures = [draw_picture((60, 80), np.random.default_rng(seed)) for seed in range(4)]
    assert all(picture.std() > 5 for picture in pictures)
    assert not np.array_equal(pictures[0], pictures[1])


def test_the_default_is_given_by_its_name_and_changes_most_things() -> None:
    assert randomization("default") is DEFAULT
    assert DEFAULT.gravity == (0.0, 0.0) and DEFAULT.effort == (0.8, 1.2)


def test_a_record_of_the_arguments_holds_what_differs() -> None:
    kwargs = StereoReachEnv.plain_kwargs({"randomize": {"noise": 3, "effort": [0.9, 1.1]}})
    assert kwargs == {"randomize": {"noise": [3.0, 3.0], "effort": [0.9, 1.1]}}
    assert StereoReachEnv.plain_kwargs({"randomize": "default"}) == {"randomize": "default"}


@pytest.mark.parametrize(
    ("randomize", "message"),
    [
        ("wild", "unknown randomize 'wild'; randomisations are default"),
        (
            {"noise": [5, 1]},
            "randomize: noise is [5.0, 1.0]; give the lowest and the highest number, from 0 to 255",
        ),
        ({"noise": "much"}, "randomize: noise is 'much'; give a number, or the lowest and the highest one"),
        ({"noise": [1, 2, 3]}, "randomize: noise is [1, 2, 3]; give a number, or the lowest and the highest one"),
        ({"floor": 2}, "randomize: floor is 2; give at most 1"),
        ({"effort": -1}, "randomize: effort is [-1.0, -1.0]; give the lowest and the highest number, from 0 to 10"),
        (3, "randomize is 3; give a map"),
    ],
)
def test_wrong_ranges_are_refused_in_one_sentence(randomize: Any, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        make(randomize)
    assert str(caught.value) == message


def test_an_unknown_field_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(ValueError, match="unknown field of randomize 'nois'; fields are ambient, light_angle,"):
        make({"nois": 3})
