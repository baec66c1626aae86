"""Picking up: suction, objects, what the cameras judge, and that no past changes an episode."""

import copy
import pickle
import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gym_check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from sb3_stereo.commands.check import main as check
from sb3_stereo.envs import PICK_ENV_IDS
from sb3_stereo.envs.colours import COLOURS
from sb3_stereo.envs.cup_kinematics import joints_for
from sb3_stereo.envs.objects import MASS
from sb3_stereo.envs.pick import StereoPickEnv
from sb3_stereo.envs.pick_world import UP
from sb3_stereo.envs.rewards import lifting

ON, OFF = 1.0, -1.0
GUESS = np.array([0.0, 0.8, 0.0, 1.6, 0.0, 0.7])


@pytest.fixture
def env() -> Iterator[StereoPickEnv]:
    env = StereoPickEnv(n_joints=6)
    yield env
    env.close()


def over(env: StereoPickEnv, height: float) -> np.ndarray:
    """The place at a height in [m] over the middle of the target's upper side, (3,)."""
    return np.asarray(env._world.target_top + height * UP)


def place_cup(env: StereoPickEnv, position: np.ndarray, guess: np.ndarray = GUESS) -> None:
    """Rest the arm with the cup's lip at a position, pointing down."""
    state = env.save_state()
    joints, error = joints_for(env.arm, position, -UP, guess)
    env.restore_state(state)
    env.remove_state(state)
    assert error < 0.01
    env.arm.rest_at(joints)
    env.capture()


def grasped(env: StereoPickEnv, **reset: Any) -> StereoPickEnv:
    """The same environment, the target held where it stands."""
    env.reset(**({"seed": 0} | reset))
    place_cup(env, over(env, 0.002))
    for _ in range(3):
        _, _, _, _, info = env.step(push_down(env, ON))
        if info["holding"]:
            return env
    raise AssertionError("nothing held")


def push_down(env: StereoPickEnv, suction: float) -> np.ndarray:
    """An action that lowers the hand a little."""
    linear, _ = env.arm.cup_jacobian
    lowering = -np.linalg.pinv(linear)[:, 2]
    return np.asarray([*(0.02 * lowering / np.abs(lowering).max()), suction])


def lift(env: StereoPickEnv, height: float) -> dict[str, Any]:
    """Raise what is held by a height in small control steps, and stand still there; the last `info`."""
    start = env._world.target_position[2]
    for _ in range(100):
        missing = height - (env._world.target_position[2] - start)
        if abs(missing) < 0.006:
            break
        linear, _ = env.arm.cup_jacobian
        joints = np.linalg.pinv(linear) @ np.array([0.0, 0.0, np.clip(missing, -0.06, 0.06)])
        env.step([*np.clip(joints, -1.0, 1.0), ON])
    *_, info = env.step([*np.zeros(6), ON])
    return info


@pytest.mark.parametrize("env_id", PICK_ENV_IDS)
def test_checkers_pass_without_a_warning(env_id: str) -> None:
    env = gym.make(env_id, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gym_check_env(env.unwrapped, skip_render_check=True)
        sb3_check_env(env)
    assert env.observation_space.shape == (1, 84, 84) and env.action_space.shape == (7,)
    env.close()


# ---------------------------------------------------------------------------------------------------- suction
def test_suction_that_is_off_never_holds(env: StereoPickEnv) -> None:
    env.reset(seed=0)
    place_cup(env, over(env, 0.002))
    for _ in range(3):
        *_, info = env.step(push_down(env, OFF))
        assert not info["holding"]
    assert env.arm.cup is not None and any("an object" in pair for pair in env.arm.contacts())  # it does touch


def test_suction_holds_nothing_that_it_does_not_touch(env: StereoPickEnv) -> None:
    env.reset(seed=0)
    place_cup(env, over(env, 0.03))
    *_, info = env.step([*np.zeros(6), ON])
    assert not info["holding"]


def test_what_is_held_follows_the_hand(env: StereoPickEnv) -> None:
    grasped(env)
    lip, _ = env.arm.cup_pose
    offset = np.linalg.norm(env._world.target_position - lip)
    for action in np.random.default_rng(0).uniform(-0.3, 0.3, (10, 6)) - [0, 0.2, 0, 0, 0, 0]:
        *_, info = env.step([*action, ON])
        lip, _ = env.arm.cup_pose
        assert info["holding"]
        assert np.linalg.norm(env._world.target_position - lip) == pytest.approx(offset, abs=0.003)


def test_what_is_released_falls(env: StereoPickEnv) -> None:
    grasped(env)
    standing = env._world.target_position[2]
    lift(env, 0.08)
    assert env._world.target_position[2] > standing + 0.06
    *_, info = env.step([*np.zeros(6), OFF])
    assert not info["holding"] and env._world.target_position[2] < standing + 0.01


@pytest.mark.parametrize("direction", [(0, 0, -1), (1, 0, 0), (0, 0.6, -0.8)])
def test_a_force_above_the_breaking_force_tears_off_what_is_held(direction: tuple[float, ...]) -> None:
    held = []
    for share in (0.7, 1.3):
        env = grasped(StereoPickEnv(n_joints=6, breaking_force=15.0, brake=False))
        lift(env, 0.05)
        world = env._world
        client, body = world._client, world.objects.placed[0]
        weight = np.array([0.0, 0.0, -9.81 * MASS])
        force = share * 15.0 * np.array(direction) - weight  # the weight is a part of it
        for _ in range(5):
            env.arm.brake()
            middle, _ = client.getBasePositionAndOrientation(body)
            client.applyExternalForce(body, -1, force.tolist(), middle, 2)
            world.sucking = True
            world.arm.step(client.number)
        held.append(world.holds_target)
        env.close()
    assert held == [True, False]


def test_pressing_does_not_tear_off(env: StereoPickEnv) -> None:
    grasped(env)
    for _ in range(3):
        *_, info = env.step([*np.clip(20 * push_down(env, ON)[:6], -1, 1), ON])
        assert info["holding"]


# ---------------------------------------------------------------------------------------------------- success
@pytest.mark.parametrize(("height", "success"), [(0.0, False), (0.08, False), (0.12, True)])
def test_lifting_by_10_cm_is_success_and_less_is_not(env: StereoPickEnv, height: float, success: bool) -> None:
    grasped(env)
    assert lift(env, height)["is_success"] is success


def test_a_hand_that_is_high_is_no_success(env: StereoPickEnv) -> None:
    env.reset(seed=0)
    place_cup(env, over(env, 0.3))
    *_, terminated, _, info = env.step([*np.zeros(6), ON])
    assert not terminated and not info["is_success"]


@pytest.mark.parametrize("seed", range(2))
def test_heights_in_the_images_are_those_in_space(env: StereoPickEnv, seed: int) -> None:
    grasped(env, seed=seed)
    standing = env._world.target_position[2]
    for height in (0.05, 0.13):
        info = lift(env, height - (env._world.target_position[2] - standing))
        assert info["lifted"] == pytest.approx(env._world.target_position[2] - standing, abs=0.012)


def test_a_lift_earns_what_its_parts_add_up_to_and_a_fall_costs_it() -> None:
    none = np.zeros(2)
    assert lifting(none, 0.3, goal=False) == pytest.approx(0.3)
    assert lifting(none, -0.3, goal=False) == pytest.approx(-0.3)
    assert lifting(np.array([0.2, 0.4]), 0.1, goal=False) == pytest.approx(0.4)
    assert lifting(none, 0.0, goal=False) == -1.0
    assert lifting(none, 0.3, goal=True) == 1.0
    assert lifting(np.array([np.nan, 0.2]), np.nan, goal=False) == pytest.approx(0.2)
    assert lifting(np.array([np.nan, np.nan]), 0.5, goal=False) == pytest.approx(0.5)


# ---------------------------------------------------------------------------------------------------- objects
def test_the_same_seed_gives_the_same_objects_and_others_give_others() -> None:
    env = StereoPickEnv(n_joints=6, n_distractors=2)
    seen = []
    for seed in (1, 2, 1):
        env.reset(seed=seed)
        seen.append(env._world.items)
    assert seen[0] == seen[2] != seen[1]
    env.close()


@pytest.mark.parametrize("target", [None, {"shape": "bottle"}, {"colour": "green"}, {"shape": "box", "colour": "blue"}])
def test_no_distractor_is_the_target(target: dict[str, str] | None) -> None:
    env = StereoPickEnv(n_joints=6, n_distractors=4, target=target)
    for seed in range(10):
        _, info = env.reset(seed=seed)
        wanted, *others = env._world.items
        assert info["target"] == {"shape": wanted.model.shape, "colour": wanted.colour}
        assert info["target"].items() >= (target or {}).items()
        assert len({item.colour for item in env._world.items}) == 5
        if target and "shape" in target:
            assert wanted.model.shape not in {other.model.shape for other in others}
    env.close()


def test_a_distractor_that_is_lifted_is_no_success() -> None:
    env = StereoPickEnv(n_joints=6, n_distractors=1, target={"colour": "blue"})
    env.reset(seed=3)
    world = env._world
    target, other = world.items
    body = world.objects.bodies[other.number]
    world._client.resetBasePositionAndOrientation(body, (*other.place, 0.4), (0, 0, 0, 1))
    env.capture()
    assert not env._at_goal()
    body = world.objects.bodies[target.number]
    world._client.resetBasePositionAndOrientation(body, (*target.place, 0.4), (0, 0, 0, 1))
    env.capture()
    assert env._at_goal()
    env.close()


def test_every_colour_is_found_where_the_target_is() -> None:
    for colour in COLOURS:
        env = StereoPickEnv(n_joints=6, target={"colour": colour}, n_distractors=4)
        for seed in range(3):
            env.reset(seed=seed)
            for camera, (_, seen) in zip(env.cameras, env._captured.centres, strict=True):
                expected = camera.spec.project(env._world.target_position)
                assert np.linalg.norm(seen - expected) < 5.0  # the hand may hide a part
        env.close()


# ---------------------------------------------------------------------------------------------------- histories
def rollout(env: StereoPickEnv, seed: int) -> list[Any]:
    """Everything a learner would see of an episode that grasps, carries, drops and pushes."""
    observation, info = env.reset(seed=seed)
    seen = [observation.tobytes(), info["pixel_distances"].tobytes()]
    place_cup(env, over(env, 0.002))
    return seen + future(env)


def future(env: StereoPickEnv, actions: Any = None) -> list[Any]:
    rng = np.random.default_rng(0)
    seen: list[Any] = []
    for step in range(8):
        action = push_down(env, ON) if step < 2 else [*rng.uniform(-0.5, 0.5, 6), OFF if step == 5 else ON]
        observation, value, terminated, _, info = env.step(action)
        seen += [observation.tobytes(), value, terminated, info["joint_positions"].tobytes(), info["holding"]]
        seen += [info["target_position"].tobytes()]
    return seen


@pytest.mark.parametrize("randomize", [None, "default"])
def test_the_same_seed_gives_the_same_episode_whatever_came_before(randomize: str | None) -> None:
    env = StereoPickEnv(n_joints=6, n_distractors=2, randomize=randomize)
    first = rollout(env, seed=5)
    assert True in first[6::6]  # it does hold
    rollout(env, seed=6)
    assert rollout(env, seed=5) == first
    other = StereoPickEnv(n_joints=6, n_distractors=2, randomize=randomize)
    assert rollout(other, seed=5) == first
    env.close()
    other.close()


@pytest.mark.parametrize("held", [True, False])
def test_copies_and_restored_states_have_the_same_future(held: bool) -> None:
    env = StereoPickEnv(n_joints=6, n_distractors=2)
    grasped(env)
    if not held:
        lift(env, 0.02)
        env.step([*np.full(6, 0.2), OFF])
    state = env.save_state()
    copies = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    expected = future(env)
    env.restore_state(state)
    assert future(env) == expected
    env.reset(seed=9)  # other objects
    env.step([*np.ones(6), ON])
    env.restore_state(state)
    assert future(env) == expected
    for other in copies:
        assert future(other) == expected
        other.close()
    env.close()


def test_a_reset_that_is_refused_changes_nothing(env: StereoPickEnv) -> None:
    grasped(env)
    other = copy.deepcopy(env)
    with pytest.raises(ValueError):
        env.reset(seed=1, options={"joint_positions": (0.0, 2.0, 0.0, 0.5, 0.0, 0.0)})
    assert future(env) == future(other)
    other.close()


# ---------------------------------------------------------------------------------------------------- arguments
def test_a_last_phase_begins_with_the_hand_over_the_target() -> None:
    env = StereoPickEnv(n_joints=6, phase="grasp")
    for seed in range(5):
        _, info = env.reset(seed=seed)
        lip, axis = env.arm.cup_pose
        assert np.linalg.norm(lip - over(env, 0.0)) < 0.12 and axis[2] < -0.9
        assert info["pixel_distances"].mean() <= env.rho
    env.close()


def test_a_first_phase_ends_near_the_target() -> None:
    env = StereoPickEnv(n_joints=6, phase="reach")
    env.reset(seed=0)
    place_cup(env, over(env, 0.05))
    *_, terminated, _, info = env.step([*np.zeros(6), OFF])
    assert terminated and info["is_success"] and not info["holding"]
    env.close()


@pytest.mark.parametrize("arm", ["kuka", "panda"])
def test_other_arms_have_a_cup_too(arm: str) -> None:
    env = StereoPickEnv(arm=arm)
    observation, _ = env.reset(seed=0)
    assert env.step(env.action_space.sample())[0].shape == observation.shape
    env.close()


def test_marked_targets_are_shown_in_the_second_channel() -> None:
    env = StereoPickEnv(n_joints=6, composite="markers", target={"colour": "green"}, n_distractors=2)
    observation, _ = env.reset(seed=0)
    assert observation.shape == (2, 84, 84) and observation[1].min() < 100 < 150 < observation[1].max()
    env.close()


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"target": {"shape": "ball"}}, "unknown shape of the target 'ball'; shapes are box, cylinder, bottle"),
        (
            {"target": {"colour": "red"}},
            "unknown colour of the target 'red'; colours are blue, green, magenta, cyan, yellow",
        ),
        ({"n_distractors": 5}, "n_distractors is 5; give 0 to 4, as many as colours"),
        (
            {"target_position": (0.5, 0, 0.1)},
            "target_position is [0.5, 0.0, 0.1]; objects stand on the floor, so give z 0",
        ),
        ({"phase": "lift"}, "unknown phase 'lift'; phases are reach, grasp"),
        ({"markers": "solid"}, "picking has no 'markers'; leave it out"),
        (
            {"cameras": ["left"]},
            "heights are seen by two cameras that look along different lines; give two such cameras",
        ),
        ({"breaking_force": 0}, "breaking_force is 0; give a positive number"),
    ],
)
def test_a_wrong_argument_is_explained(kwargs: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as error:
        StereoPickEnv(**kwargs)
    assert str(error.value) == message


def test_check_says_that_it_measures_reaching(capsys: pytest.CaptureFixture[str]) -> None:
    assert check(["--env", "WamStereoPick-v0"]) == 2
    assert capsys.readouterr().err == (
        "error: check measures reaching, and WamStereoPick-v0 is a task of picking; "
        "take WamStereoReach-v1 with the same arm and cameras\n"
    )


def test_actions_are_named() -> None:
    env = StereoPickEnv(n_joints=5)
    assert env.action_names == ("J1", "J2", "J3", "J4", "J5", "suction")
    env.close()


def test_episodes_begin_where_they_are_told_to() -> None:
    pose = (0.0, 0.3, 0.0, 0.5, 0.0, 0.0)
    env = StereoPickEnv(n_joints=6, initial_positions=pose)
    _, info = env.reset(seed=0, options={"target_position": (0.5, 0.1, 0.0)})
    np.testing.assert_allclose(info["joint_positions"][:6], pose)
    np.testing.assert_allclose(info["target_position"][:2], (0.5, 0.1))
    env.close()


def test_a_start_that_cannot_be_is_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sb3_stereo.envs.pick.MAX_DRAWS", 10)
    env = StereoPickEnv(n_joints=6, phase="grasp", rho=1.0)
    with pytest.raises(ValueError, match=r"is the hand within rho 1 of the target.*; give a larger rho$"):
        env.reset(seed=0)
    env.close()
    env = StereoPickEnv(arm="kuka", phase="grasp")
    with pytest.raises(ValueError, match=r"^in 10 draws the cup came over the target in no pose.*or more n_joints$"):
        env.reset(seed=0)
    env.close()
