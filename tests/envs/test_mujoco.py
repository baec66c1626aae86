"""The task in MuJoCo: the same views as in Bullet, and the same laws."""

import copy
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from sb3_stereo.envs import MUJOCO_ENV_IDS, TWIN_OF
from sb3_stereo.envs.reach import StereoReachEnv

pytest.importorskip("mujoco")

from sb3_stereo.envs.mujoco_opengl import check_drawing

V1: dict[str, Any] = {"framing": "close", "markers": "hollow", "rho": 5.0, "distance_scale": 200.0}
HARD = {
    "clutter": (3, 6),
    "shadow": 0.5,
    "floor": 1.0,
    "floor_pattern": 1.0,
    "background": 1.0,
    "friction": (0, 0.5),
    "mass": (0.5, 2.0),
    "gravity": (0, 0.1),
    "latency": (0, 0.1),
    "link_colours": 1.0,
    "light_angle": 1.0,
    "camera_position": 0.05,
    "noise": 5.0,
}
COPIES: dict[str, Callable[[Any], Any]] = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
}


@pytest.fixture(scope="module")
def opengl() -> None:
    """MuJoCo's renderer, or a reason why it is missing here."""
    try:
        check_drawing()
    except ValueError as error:
        pytest.skip(str(error))


@pytest.fixture
def env(opengl: None) -> Iterator[StereoReachEnv]:
    env = StereoReachEnv(render_mode="rgb_array", simulator="mujoco", **V1)
    yield env
    env.close()


@pytest.fixture(scope="module")
def twins(opengl: None) -> Iterator[tuple[StereoReachEnv, StereoReachEnv]]:
    """The task in Bullet, and in MuJoCo."""
    both = StereoReachEnv(**V1), StereoReachEnv(simulator="mujoco", **V1)
    yield both
    for env in both:
        env.close()


def plain(value: Any) -> Any:
    """A value that == compares to the bit, NaN included."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return [plain(item) for item in value]
    return value.tobytes() if isinstance(value, np.ndarray) else value


# ---------------------------------------------------------------------------------------------------- views
def test_markers_appear_where_bullet_shows_them(twins: tuple[StereoReachEnv, StereoReachEnv]) -> None:
    bullet, twin = twins
    seen = []
    for seed in range(25):
        _, info = bullet.reset(seed=seed)
        _, info_of_twin = twin.reset(seed=0, options={"joint_positions": bullet.arm.actuated_positions})
        ends = np.stack([info["end_effector_position"], info["target_position"]])
        projected = np.array([camera.spec.project(ends) for camera in twin.cameras])
        seen.append(np.abs(twin._captured.centres - projected).max())
        apart = np.abs(info["pixel_offsets"] - info_of_twin["pixel_offsets"])
        assert np.nanmax(apart) < 1.0
    assert np.mean(np.isnan(seen)) < 0.3  # hidden
    assert np.nanmax(seen) < 1.0


def test_pictures_are_those_of_bullet(twins: tuple[StereoReachEnv, StereoReachEnv]) -> None:
    """Silhouettes to a few pixels, and the luminance of observations within 3 of 255 where both show the arm."""
    bullet, twin = twins
    for seed in range(8):
        observation, _ = bullet.reset(seed=seed)
        same, _ = twin.reset(seed=0, options={"joint_positions": bullet.arm.actuated_positions})
        for one, other in zip(bullet.draw(), twin.draw(), strict=True):
            bodies, bodies_of_twin = (frame[:, :, 1] < 255 for frame in (one, other))
            assert np.mean(bodies & bodies_of_twin) > 0.97 * np.mean(bodies | bodies_of_twin)
        assert np.abs(observation.astype(int) - same).mean(where=observation < 250) < 3.0


def test_a_floor_is_drawn_if_it_is_asked_for(opengl: None) -> None:
    for simulator in ("bullet", "mujoco"):
        env = StereoReachEnv(simulator=simulator, floor=True, **V1)
        env.reset(seed=0)
        corner = env.draw()[0][-1, 0, :3]
        assert (corner < 230).all() and np.ptp(corner) < 3, simulator
        env.close()


def test_pictures_for_people_have_a_shadow(env: StereoReachEnv) -> None:
    env.reset(options={"joint_positions": (0.0, 0.5, 0.0, 0.5)})
    before = plain(env.draw())
    picture = env.draw_from(replace(env.cameras[0].spec, width=640, height=480))
    assert picture.shape == (480, 640, 3)
    shades, counts = np.unique(picture.reshape(-1, 3), axis=0, return_counts=True)
    floor = shades[counts.argmax()]
    assert (picture == (0.7 * floor).astype(np.uint8)).all(axis=-1).sum() > 300
    assert plain(env.draw()) == before  # a larger picture changes none that comes later


# ---------------------------------------------------------------------------------------------------- episodes
@pytest.mark.parametrize("env_id", MUJOCO_ENV_IDS)
def test_the_environments_are_their_twins(opengl: None, env_id: str) -> None:
    env, twin = gym.make(env_id), gym.make(TWIN_OF[env_id])
    check_env(env.unwrapped, skip_render_check=True)
    assert env.observation_space == twin.observation_space and env.action_space == twin.action_space
    assert env.spec is not None and twin.spec is not None
    assert env.spec.max_episode_steps == twin.spec.max_episode_steps
    assert env.unwrapped.mirrored_joints == twin.unwrapped.mirrored_joints
    env.close()
    twin.close()


@pytest.mark.parametrize("env_id", MUJOCO_ENV_IDS)
def test_all_test_poses_are_free(opengl: None, env_id: str) -> None:
    from sb3_stereo.evaluation.protocol import eval_initial_states

    env = gym.make(env_id)
    for start in eval_initial_states(env_id):
        env.reset(**start)
    env.close()


@pytest.mark.parametrize("kwargs", [{}, {"randomize": HARD}], ids=["still", "randomised"])
def test_same_seed_same_episode_whatever_came_before(opengl: None, kwargs: dict[str, Any]) -> None:
    fresh, used = (StereoReachEnv(simulator="mujoco", **V1, **kwargs) for _ in range(2))
    used.reset(options={"joint_positions": (0.0, 1.2, 0.0, 0.3)})
    for _ in range(5):
        used.step((0.0, 1.0, 0.0, 0.3))  # into the floor
    actions = np.random.default_rng(0).uniform(-1, 1, (4, 4))
    episodes = [[plain(env.reset(seed=3)), *(plain(env.step(a)) for a in actions)] for env in (fresh, used)]
    assert episodes[0] == episodes[1]
    fresh.close()
    used.close()


@pytest.mark.parametrize("make_copy", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize(
    "kwargs",
    [{}, {"brake": False, "gravity_compensation": False}, {"randomize": HARD}],
    ids=["still", "free", "varied"],
)
def test_a_copy_has_the_same_future_to_the_bit(
    opengl: None, kwargs: dict[str, Any], make_copy: Callable[[Any], Any]
) -> None:
    env = StereoReachEnv(simulator="mujoco", **V1, **kwargs)
    env.reset(seed=1, options={"joint_positions": (0.0, 1.2, 0.0, 0.3)})
    env.step((0.3, 1.0, 0.2, 0.3))
    twin = make_copy(env)
    actions = np.random.default_rng(1).uniform(-1, 1, (4, 4))
    assert [plain(twin.step(a)) for a in actions] == [plain(env.step(a)) for a in actions]
    assert plain(twin.reset()) == plain(env.reset())
    env.close()
    twin.close()


def test_a_saved_state_is_restored_exactly_with_its_world(opengl: None) -> None:
    env = StereoReachEnv(simulator="mujoco", **V1, brake=False, randomize=HARD)
    env.reset(seed=5)
    env.step((1.0, 0.5, -0.5, 1.0))
    state = env.save_state()
    futures = []
    for seed in (6, 7):
        futures.append([plain(env.step(a)) for a in np.random.default_rng(0).uniform(-1, 1, (3, 4))])
        env.reset(seed=seed)  # another world
        env.restore_state(state)
    assert futures[0] == futures[1]
    env.remove_state(state)
    with pytest.raises(ValueError) as error:
        env.restore_state(state)
    expected = "the state is another environment's, or removed; give one that save_state of this environment returned"
    assert str(error.value) == expected
    env.close()


def test_a_refused_reset_changes_nothing(env: StereoReachEnv) -> None:
    env.reset(seed=0)
    env.step((1.0, 0.0, 0.0, 0.0))
    before = plain(env.draw())
    with pytest.raises(ValueError, match=r"^joint_positions .* collide .*; choose a pose clear of the arm itself and"):
        env.reset(options={"joint_positions": (0.0, 2.0, 0.0, 1.5)})
    assert plain(env.draw()) == before


def test_randomised_worlds_differ_and_show_their_markers(opengl: None) -> None:
    env = StereoReachEnv(simulator="mujoco", **V1, randomize=HARD)
    pictures = set()
    for seed in range(5):
        observation, info = env.reset(seed=seed)
        pictures.add(observation.tobytes())
        for camera, centres in zip(env.cameras, env._captured.centres, strict=True):
            projected = camera.spec.project(info["target_position"])  # which nothing hides but the arm
            assert not np.abs(centres[1] - projected).max() > 1.5
    assert len(pictures) == 5
    env.close()


def test_there_is_no_window(opengl: None, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError) as error:
        StereoReachEnv(render_mode="human", simulator="mujoco")
    expected = "simulator 'mujoco' has no window for render_mode 'human'; use render_mode 'rgb_array'"
    assert str(error.value) == expected


@pytest.mark.skipif(sys.platform != "linux", reason="processes are not forked elsewhere")
def test_a_process_may_be_forked_until_something_is_drawn(opengl: None) -> None:
    code = (
        "import multiprocessing, sys, gymnasium, sb3_stereo\n"
        "def play(results):\n"
        "    try:\n"
        "        results.put(gymnasium.make('WamStereoReachMujoco-v0').reset(seed=0)[0].shape)\n"
        "    except ValueError as error:\n"
        "        results.put(str(error))\n"
        "env, context = gymnasium.make('WamStereoReachMujoco-v0'), multiprocessing.get_context('fork')\n"
        "results = context.Queue()\n"
        "for _ in range(2):\n"
        "    process = context.Process(target=play, args=(results,))\n"
        "    process.start()\n"
        "    print(results.get(timeout=60))\n"
        "    process.join()\n"
        "    env.reset(seed=0)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        "(1, 84, 84)",
        "MuJoCo has drawn in the process that this one was forked from, and OpenGL does not survive that; start "
        "processes by 'forkserver' or 'spawn'",
    ]


def test_any_thread_may_step(env: StereoReachEnv) -> None:
    env.reset(seed=0)
    state = env.save_state()
    expected = plain(env.step((0.3, 0.2, 0.1, 0.0)))
    for _ in range(2):
        env.restore_state(state)
        with ThreadPoolExecutor(1) as thread:
            assert plain(thread.submit(env.step, (0.3, 0.2, 0.1, 0.0)).result()) == expected


def test_mujoco_needs_no_pybullet(opengl: None) -> None:
    code = (
        "import sys; sys.modules['pybullet'] = sys.modules['pybullet_data'] = None\n"
        "import gymnasium, sb3_stereo\n"
        "env = gymnasium.make('WamStereoReachMujoco-v0')\n"
        "env.reset(seed=0)\n"
        "print(env.step(env.action_space.sample())[0].shape)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "(1, 84, 84)\n"
