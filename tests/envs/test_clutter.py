"""Clutter: it leaves arm and target alone, is the same for the same seed, and hides or blocks as it should."""

import copy
import pickle
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sb3_stereo.envs.cameras import CLOSE_PAIR, FRAMINGS, RIGS, camera_specs, mirror_each_other
from sb3_stereo.envs.clutter import CLEAR
from sb3_stereo.envs.clutter_spec import ClutterSpec, clutter_spec
from sb3_stereo.envs.kinematics import end_effector_at, free_way
from sb3_stereo.envs.obstacles import BEYOND, MIDDLE, Obstacle
from sb3_stereo.envs.reach import StereoReachEnv

V1: dict[str, Any] = {"framing": "close", "markers": "hollow", "rho": 5.0, "distance_scale": 200.0}
ACTIONS = np.random.default_rng(5).uniform(-1, 1, (5, 4))
EMPTY = {"objects": 0, "occluders": 0, "moving": 0}


def make(clutter: Any = "default", **kwargs: Any) -> StereoReachEnv:
    return StereoReachEnv(**{**V1, "min_views": 2, **kwargs}, clutter=clutter)


@pytest.fixture(scope="module")
def cluttered() -> Iterator[StereoReachEnv]:
    env = make()
    yield env
    env.close()


def episode(env: Any, **reset: Any) -> list[Any]:
    """Everything that an agent and its judge see."""
    observation, info = env.reset(**reset)
    return [observation, *info.values(), *rest(env)]


def rest(env: Any) -> list[Any]:
    seen = []
    for action in ACTIONS:
        observation, reward, terminated, _, info = env.step(action)
        seen += [observation, reward, terminated, *info.values()]
    return seen


def assert_same(one: list[Any], other: list[Any]) -> None:
    for a, b in zip(one, other, strict=True):
        assert_array_equal(a, b)


def obstacles(env: StereoReachEnv) -> tuple[Obstacle, ...]:
    return env._world.episode.obstacles


def test_same_seed_gives_same_clutter_whatever_came_before() -> None:
    first, second = make(), make()
    second.reset(seed=8)
    second.step(ACTIONS[0])
    assert_same(episode(first, seed=3), episode(second, seed=3))
    first.reset(seed=3)
    before = obstacles(first)
    first.reset()
    assert obstacles(first) != before
    for env in (first, second):
        env.close()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_has_the_same_future(cluttered: StereoReachEnv, copied: Any) -> None:
    cluttered.reset(seed=1)
    cluttered.step(ACTIONS[3])
    twin = copied(cluttered)
    assert_same([twin.capture(), *rest(twin)], [cluttered.capture(), *rest(cluttered)])
    assert_same(episode(twin), episode(cluttered))  # the next one too
    twin.close()


def test_a_saved_state_has_its_own_clutter_at_its_own_time(cluttered: StereoReachEnv) -> None:
    cluttered.reset(seed=1)
    cluttered.step(ACTIONS[4])
    state = cluttered.save_state()
    expected = [cluttered.capture(), *rest(cluttered)]
    for seed in (2, None):
        if seed is not None:
            cluttered.reset(seed=seed)
        cluttered.restore_state(state)
        assert_same([cluttered.capture(), *rest(cluttered)], expected)
    cluttered.remove_state(state)


def test_a_refused_reset_changes_nothing(cluttered: StereoReachEnv) -> None:
    cluttered.reset(seed=4)
    cluttered.step(ACTIONS[0])
    before = cluttered.capture()
    with pytest.raises(ValueError, match="outside the limits"):
        cluttered.reset(options={"joint_positions": [9, 9, 9, 9]})
    assert_array_equal(cluttered.capture(), before)


def test_nothing_is_near_the_arm_or_before_the_target_at_reset(cluttered: StereoReachEnv) -> None:
    """Of 200 episodes: 5 cm to the arm by Bullet's own distances, and in every view 9 cm around the target are free."""
    client, bodies = cluttered._world._client, cluttered._world._things.obstacles  # type: ignore[attr-defined]
    for seed in range(200):
        _, info = cluttered.reset(seed=seed)
        if np.isnan(cluttered._captured.centres[:, 1]).any():
            assert is_hidden_by_the_arm(cluttered.arm.actuated_positions)
        found = obstacles(cluttered)
        assert len(found) >= 4  # hardly ever is there no room
        for one in found:
            assert not client.getClosestPoints(cluttered.arm.body, bodies[one.number], 0.0499)
            for view in CLOSE_PAIR:
                gap = np.linalg.norm(view.project(np.array(one.position)) - view.project(info["target_position"]))
                assert gap / view.scale > CLEAR


def is_hidden_by_the_arm(pose: Any) -> bool:
    """Whether a view lacks the target without any clutter."""
    plain = make(None)
    plain.reset(options={"joint_positions": pose})
    hidden = bool(np.isnan(plain._captured.centres[:, 1]).any())
    plain.close()
    return hidden


def test_what_moves_is_out_of_the_arms_reach_on_all_of_its_way(cluttered: StereoReachEnv) -> None:
    n_moving = 0
    for seed in range(30):
        cluttered.reset(seed=seed)
        for one in obstacles(cluttered):
            if one.end is None:
                assert one.at(7.0) == one
                continue
            n_moving += 1
            path = np.array([one.at(t).position for t in np.linspace(0, 40, 200)])
            assert np.linalg.norm((path - MIDDLE)[:, :2], axis=1).min() >= BEYOND[0] - 1e-9
            steps = np.linalg.norm(np.diff(path, axis=0), axis=1) / (40 / 199)
            assert 0.1 - 1e-9 <= one.speed <= 0.4 + 1e-9 and steps.max() <= one.speed + 1e-9
    assert n_moving >= 30


def test_what_moves_goes_to_its_end_and_back() -> None:
    one = Obstacle(0, (1.0, 2.0, 0.5), (0, 0, 0, 1), (0.5, 0.5, 0.5), (1.0, 4.0, 0.5), 0.5)  # 2 m, 4 s
    for time, y in ((0, 2), (1, 2.5), (4, 4), (6, 3), (8, 2), (9, 2.5)):
        assert_allclose(one.at(time).position, (1.0, y, 0.5))


def test_pictures_of_a_still_arm_change_with_what_moves() -> None:
    moving, still = make(EMPTY | {"moving": 6, "speed": 0.4}), make(EMPTY | {"objects": 6})
    for env, changes in ((moving, True), (still, False)):
        env.reset(seed=0)
        before = env.capture()
        for _ in range(3):
            observation, *_ = env.step(np.zeros(4))
        assert np.array_equal(before, observation) != changes
        env.close()


def test_clutter_that_hides_nothing_changes_no_distance() -> None:
    """At the same poses with and without it, where nothing is before a ball or at its rim."""
    env, plain = make({"solid": False}), make(None)
    n_same = n_seen = 0
    for seed in range(25):
        _, info = env.reset(seed=seed)
        pose = env.arm.actuated_positions
        _, bare = plain.reset(options={"joint_positions": pose})
        for view, (one, other) in enumerate(zip(info["pixel_offsets"], bare["pixel_offsets"], strict=True)):
            frames = [e._captured.frames[view].astype(int) for e in (env, plain)]
            balls = [np.round(c).astype(int) for c in plain._captured.centres[view] if not np.isnan(c).any()]
            covered = any((abs(frames[0] - frames[1])[y - 9 : y + 10, x - 9 : x + 10] > 0).any() for x, y in balls)
            if not covered:
                assert_allclose(one, other, atol=1e-9)
            n_same, n_seen = n_same + (not covered), n_seen + 1
    assert n_same > 0.6 * n_seen
    env.close()
    plain.close()


def test_solid_clutter_stops_the_arm_and_the_other_does_not() -> None:
    """Where the same clutter stands, motions differ if and only if it is solid."""
    many = {"objects": 20, "size": [0.08, 0.12]}
    plain, solid, ghost = make(None), make(many), make(many | {"solid": False})
    blocked = 0
    for seed in range(4):
        pose = {"joint_positions": [0.3, 0.4, -0.2, 1.2]}
        for env in (plain, solid, ghost):
            env.reset(seed=seed, options=pose)
        assert obstacles(solid) == obstacles(ghost)
        for action in np.random.default_rng(seed).choice([-1.0, 1.0], (6, 4)):
            ends = [env.step(action)[4]["joint_positions"] for env in (plain, solid, ghost)]
        assert_array_equal(ends[0], ends[2])
        blocked += not np.array_equal(ends[0], ends[1])
    assert blocked >= 2
    for env in (plain, solid, ghost):
        env.close()


def test_the_way_to_the_target_is_free(cluttered: StereoReachEnv) -> None:
    for seed in range(10):
        _, info = cluttered.reset(seed=seed)
        way_rng = np.random.default_rng(0)
        plain = make(None)
        plain.reset(options={"joint_positions": cluttered.arm.actuated_positions})
        way = free_way(plain.arm, info["target_position"], way_rng)
        assert_allclose(way[0], cluttered.arm.actuated_positions)
        assert np.linalg.norm(end_effector_at(plain.arm, way[-1]) - info["target_position"]) < 0.005
        plain.close()


def test_clutter_stands_between_a_camera_and_the_arm() -> None:
    """Occluders hide the end effector's marker far more often than nothing does."""
    env, plain = make(EMPTY | {"occluders": 8}, cameras="four"), make(None, cameras="four")
    hidden = np.zeros(2)
    for seed in range(40):
        env.reset(seed=seed)
        plain.reset(options={"joint_positions": env.arm.actuated_positions})
        hidden += [np.isnan(e._captured.centres[:, 0]).any(axis=1).sum() for e in (env, plain)]
    assert hidden[0] > hidden[1] + 8
    env.close()
    plain.close()


def test_four_cameras_are_their_own_mirror_image_and_look_from_different_sides() -> None:
    for framing in FRAMINGS:
        views = camera_specs("four", framing)
        assert tuple(view.name for view in views) == RIGS["four"] and mirror_each_other(views)
        sights = [np.subtract(view.target, view.position) for view in views]
        units = [sight / np.linalg.norm(sight) for sight in sights]
        assert_allclose([np.linalg.norm(sight) for sight in sights], np.linalg.norm(sights[0]))
        angles = [np.arccos(abs(a @ b)) for i, a in enumerate(units) for b in units[:i]]
        assert np.degrees(min(angles)) > 59.9


def test_both_markers_are_seen_by_most_of_four_cameras() -> None:
    env = make(None, cameras="four")
    seen = []
    for seed in range(100):
        env.reset(seed=seed)
        seen.append(~np.isnan(env._captured.offsets[:, 0]))
    assert np.mean(seen, axis=0).min() > 0.9 and (np.sum(seen, axis=1) >= 2).mean() > 0.98
    env.close()


def test_a_lost_cameras_picture_is_black_and_the_judge_does_not_mind() -> None:
    whole, lost = make(None, cameras="four"), make(None, cameras="four", lost_camera="back_left")
    for one, other in zip(episode_parts(lost), episode_parts(whole), strict=True):
        image, bare = one[0].reshape(4, 42, 84), other[0].reshape(4, 42, 84)
        assert not image[1].any()
        assert_array_equal(np.delete(image, 1, axis=0), np.delete(bare, 1, axis=0))
        assert_same(one[1:], other[1:])
    assert lost.draw()[1][:, :, :3].max() == 0 and whole.draw()[1][:, :, :3].max() > 0
    whole.close()
    lost.close()


def episode_parts(env: StereoReachEnv) -> list[list[Any]]:
    observation, info = env.reset(seed=5)
    parts = [[observation, *info.values()]]
    for action in ACTIONS:
        observation, reward, terminated, _, info = env.step(action)
        parts.append([observation, reward, terminated, *info.values()])
    return parts


def test_cameras_are_lost_as_often_as_asked_each_as_likely_and_for_a_whole_episode() -> None:
    env = make(None, camera_loss=0.5)
    n_lost = np.zeros(2)
    for seed in range(200):
        observation, _ = env.reset(seed=seed)
        dark = [not view.any() for view in observation.reshape(2, 42, 84)]
        n_lost += dark
        assert sum(dark) <= 1
        if seed < 20:
            after = env.step(ACTIONS[0])[0].reshape(2, 42, 84)
            assert [not view.any() for view in after] == dark
            twin = copy.deepcopy(env)
            assert_array_equal(twin.capture(), env.capture())
            twin.close()
    assert 80 <= n_lost.sum() <= 120 and n_lost.min() > 30
    env.close()


def test_success_is_judged_by_the_views_that_see_both_markers() -> None:
    """A view is hidden by an object that is put before it: with four cameras the others still judge."""
    views = camera_specs("four", "close")
    for min_views, expected in ((2, True), (4, False)):
        env = make(EMPTY | {"objects": 1, "solid": False}, cameras="four", min_views=min_views)
        env.reset(seed=0)
        way = free_way(env.arm, env._target_position, np.random.default_rng(0))
        env._world.place_arm(way[-1])
        env._capture()
        assert env._at_goal()
        sight = np.array(views[1].position) - env._target_position
        before = tuple((env._target_position + 3.0 * sight / np.linalg.norm(sight)).tolist())
        env._world._move([Obstacle(0, before, (0, 0, 0, 1), (0, 0, 0))])
        env._capture()
        distances = env._captured.distances
        assert np.isnan(distances).tolist() == [False, True, False, False]
        assert env._at_goal() == expected
        env.close()


def test_the_registered_environment_is_v1_with_clutter() -> None:
    env: Any = gym.make("WamStereoReachClutter-v0").unwrapped
    assert env.clutter == ClutterSpec() and (env.min_views, env.rho, env.distance_scale) == (2, 5.0, 200.0)
    assert tuple(camera.spec for camera in env.cameras) == CLOSE_PAIR
    env.close()


def test_a_record_of_the_arguments_holds_all_of_the_clutter() -> None:
    kwargs = StereoReachEnv.plain_kwargs({"clutter": {"moving": 2}})["clutter"]
    assert kwargs["moving"] == [2.0, 2.0] and kwargs["solid"] is True
    assert clutter_spec(kwargs) == ClutterSpec(moving=(2, 2))
    assert StereoReachEnv.plain_kwargs({"clutter": "default"}) == {"clutter": "default"}


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"clutter": "wild"}, "unknown clutter 'wild'; clutters are default"),
        (
            {"clutter": {"objects": [5, 1]}},
            "clutter: objects is [5.0, 1.0]; give the lowest and the highest number, from 0 to 20",
        ),
        ({"clutter": {"solid": "yes"}}, "clutter: solid is 'yes'; give true or false"),
        ({"clutter": {"clearance": 1}}, "clutter: clearance is 1; give at most 0.3"),
        (
            {"clutter": {"boxes": 1}},
            "unknown field of clutter 'boxes'; fields are objects, occluders, moving, size, speed, clearance, solid",
        ),
        ({"min_views": 3}, "min_views is 3; give an integer from 1 to 2, the number of cameras"),
        ({"min_views": 1.5}, "min_views is 1.5; give an integer"),
        ({"lost_camera": "top"}, "unknown lost_camera 'top'; the cameras are left, right"),
        ({"camera_loss": 2}, "camera_loss is 2; give at most 1"),
    ],
)
def test_wrong_arguments_are_refused_in_one_sentence(kwargs: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as caught:
        make(**kwargs)
    assert str(caught.value) == message


def test_mujoco_refuses_clutter() -> None:
    pytest.importorskip("mujoco")
    with pytest.raises(ValueError) as caught:
        make(simulator="mujoco")
    assert str(caught.value) == "simulator 'mujoco' has no clutter; leave it out, or take simulator 'bullet'"
