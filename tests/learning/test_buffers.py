"""The mirror: an involution, true to the environment, and taken over without losing anything; goals; what moved."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from fake_env import FakeImageEnv
from gymnasium.spaces import Box, Discrete
from stable_baselines3 import DDPG, DQN, PPO
from stable_baselines3.common.buffers import NStepReplayBuffer, ReplayBuffer

from sb3_stereo.envs.cameras import STEREO_PAIR
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.envs.robots import WAM
from sb3_stereo.envs.wrappers import QuantizedActions
from sb3_stereo.learning.callbacks import StereoReplay
from sb3_stereo.learning.replay import StereoReplayBuffer
from sb3_stereo.learning.stereo_ddpg import StereoDDPG
from sb3_stereo.policies.ddpg import StereoDDPGPolicy
from sb3_stereo.policies.dqn import StereoDQNPolicy

pytestmark = pytest.mark.filterwarnings("ignore:StereoReplay will go:FutureWarning")
IMAGES = Box(0, 255, (1, 8, 6), np.uint8)
SIGNS = np.array([-1.0, 1.0, -1.0, 1.0])


def filled(actions: gym.Space, action: np.ndarray) -> StereoReplayBuffer:  # type: ignore[type-arg]
    buffer = StereoReplayBuffer(10, IMAGES, actions, device="cpu", mirrored_joints=(0, 2), n_joints=4)
    image = np.arange(48, dtype=np.uint8).reshape(1, 1, 8, 6)
    for _ in range(10):
        buffer.add(image, image + 100, action, np.array([0.5]), np.array([False]), [{}])
    return buffer


def test_mirroring_twice_is_nothing() -> None:
    buffer = filled(Box(-1, 1, (4,)), np.ones((1, 4)))
    images, actions = th.rand(5, 1, 8, 6), th.rand(5, 4)
    assert th.equal(buffer.mirror(buffer.mirror(images)), images)
    assert th.equal(buffer.mirror_actions(buffer.mirror_actions(actions)), actions)
    offsets = th.rand(5, 2, 2)
    assert th.equal(buffer.mirror_offsets(buffer.mirror_offsets(offsets)), offsets)


def test_samples_are_the_transition_or_its_mirror_image_as_a_whole() -> None:
    buffer = filled(Box(-1, 1, (4,)), np.array([[0.1, 0.2, 0.3, 0.4]]))
    np.random.seed(0)
    samples = buffer.sample(200)
    plain = th.as_tensor(buffer.observations[0]), th.as_tensor(buffer.next_observations[0])
    n_mirrored = 0
    for obs, action, next_obs in zip(samples.observations, samples.actions, samples.next_observations, strict=True):
        mirrored = bool(action[0] < 0)
        n_mirrored += mirrored
        for image, original in zip((obs, next_obs), plain, strict=True):
            assert th.equal(image[None], buffer.mirror(original) if mirrored else original)
        assert action[1] > 0 and action[3] > 0 and (action[2] < 0) == mirrored
    assert 70 < n_mirrored < 130
    assert th.all(samples.rewards == 0.5)


def test_numbers_are_mirrored_like_the_efforts_they_stand_for() -> None:
    class Arm(gym.Env):  # type: ignore[type-arg]
        action_space, observation_space = Box(-1, 1, (4,)), IMAGES

    env = QuantizedActions(Arm(), levels=3)
    buffer = filled(Discrete(81), np.array([[0]]))
    mirrored = buffer.mirror_actions(th.arange(81)[:, None])[:, 0]
    for number in range(81):
        efforts = env.action(np.int64(number))
        np.testing.assert_array_equal(env.action(np.int64(mirrored[number])), efforts * SIGNS)


@pytest.mark.parametrize("composite", ["stack", "channels", "markers"])
def test_the_environment_is_its_own_mirror_image(composite: str) -> None:
    env = StereoReachEnv(composite=composite)
    space, actions = env.observation_space, env.action_space
    told = {"mirrored_joints": env.mirrored_joints, "views_in_channels": env.views_in_channels}
    buffer = StereoReplayBuffer(1, space, actions, device="cpu", **told)  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    for seed in range(8):
        image, _ = env.reset(seed=seed)
        pose = env.arm.actuated_positions
        action = rng.uniform(-1, 1, 4)
        next_image, reward, *_, after = env.step(action)
        mirrored, _ = env.reset(options={"joint_positions": pose * SIGNS})
        next_mirrored, mirrored_reward, *_, mirrored_after = env.step(action * SIGNS)
        for ours, theirs in ((image, mirrored), (next_image, next_mirrored)):
            difference = buffer.mirror(th.as_tensor(ours[None], dtype=th.float32)).numpy()[0] - theirs
            assert np.abs(difference).mean() < 0.15  # grey levels; other poses differ by 1.5
        assert mirrored_reward == pytest.approx(reward, abs=0.03)  # the wrist's masses are not symmetric
        offsets = buffer.mirror_offsets(th.as_tensor(after["pixel_offsets"][None])).numpy()[0]
        np.testing.assert_allclose(offsets, mirrored_after["pixel_offsets"], atol=2.5)  # [px], as is the difference
    env.close()


@pytest.mark.parametrize(
    "change",
    [
        {"target_position": (0.5, 0.1, 0.6)},
        {"cameras": STEREO_PAIR[:1]},
        {"arm": "kuka"},
        {"arm": "panda"},
        {"arm": replace(WAM, base_position=(0.0, 0.1, 0.0))},
    ],
)
def test_an_environment_that_is_not_its_own_mirror_image_is_not_mirrored(change: dict[str, Any]) -> None:
    env = StereoReachEnv(**change)
    assert env.mirrored_joints is None
    model = DDPG("CnnPolicy", env, buffer_size=10, learning_starts=5)
    model.learn(1, callback=StereoReplay())
    assert model.replay_buffer.mirror_probability == 0.0  # type: ignore[union-attr]
    env.close()


def numbered(n_rows: int, n_envs: int = 1, goals: tuple[int, ...] = (), **kwargs: Any) -> StereoReplayBuffer:
    """Step t of environment e has everywhere the number 10 e + t; those of `goals` end an episode."""
    kwargs = {"mirrored_joints": (0, 2), **kwargs}
    buffer = StereoReplayBuffer(4 * n_envs, IMAGES, Box(-1, 1, (4,)), device="cpu", n_envs=n_envs, **kwargs)
    for step in range(n_rows):
        number = 10 * np.arange(n_envs) + step
        image = np.tile(number[:, None, None, None], (1, 1, 8, 6)).astype(np.uint8)
        infos = [{"pixel_offsets": np.full((2, 2), n + 1.0), "TimeLimit.truncated": bool(n % 2)} for n in number]
        action = np.tile(number[:, None] / 100, (1, 4))
        buffer.add(image, image + 1, action, number * 1.0, np.isin(number, goals) * 1.0, infos)
    return buffer


def assert_same_samples(ours: Any, theirs: Any) -> None:
    for found, expected in zip(ours, theirs, strict=True):
        assert (found is None) == (expected is None)
        assert found is None or (th.equal(found, expected) and found.dtype == expected.dtype)


@pytest.mark.parametrize("n_rows", [3, 6])
@pytest.mark.parametrize("optimize", [False, True])
def test_without_mirror_and_success_fraction_samples_are_sb3s_draw_for_draw(optimize: bool, n_rows: int) -> None:
    memory = {"optimize_memory_usage": optimize, "handle_timeout_termination": not optimize}
    buffer = numbered(n_rows, n_envs=2, mirror_probability=0.0, goals=(4, 5, 13), **memory)
    np.random.seed(0)
    ours = buffer.sample(400)
    np.random.seed(0)
    assert_same_samples(ours, ReplayBuffer.sample(buffer, 400))


@pytest.mark.parametrize("n_rows", [3, 4, 6, 30])
@pytest.mark.parametrize("n_steps", [1, 2, 3, 5])
def test_n_step_samples_are_those_of_sb3s_buffer(n_steps: int, n_rows: int) -> None:
    """Through ends of episodes, timeouts, the newest transition and the buffer's turn."""
    told = {"n_steps": n_steps, "gamma": 0.7, "device": "cpu", "n_envs": 2}
    ours = StereoReplayBuffer(16, IMAGES, Box(-1, 1, (4,)), **told)
    theirs = (ReplayBuffer if n_steps == 1 else NStepReplayBuffer)(
        16, IMAGES, Box(-1, 1, (4,)), **{k: v for k, v in told.items() if n_steps > 1 or k in ("device", "n_envs")}
    )
    rng = np.random.default_rng(n_rows)
    for _ in range(n_rows):
        images = rng.integers(0, 256, (2, 2, *IMAGES.shape), dtype=np.uint8)
        done, late = rng.random(2) < 0.3, rng.random(2) < 0.5
        infos = [{"TimeLimit.truncated": bool(d and cut)} for d, cut in zip(done, late, strict=True)]
        for buffer in (ours, theirs):
            buffer.add(images[0], images[1], images[0, :, 0, :1, :4] / 255, images[1, :, 0, 0, 0] / 9.0, done, infos)
    for seed in range(5):
        np.random.seed(seed)
        expected = theirs.sample(50)
        np.random.seed(seed)
        assert_same_samples(ours.sample(50), expected)


def test_n_step_samples_are_mirrored_as_a_whole() -> None:
    buffer = numbered(3, n_steps=2, gamma=0.5)
    buffer.actions[:] = 0.5
    np.random.seed(0)
    samples = buffer.sample(200)
    mirrored = samples.actions[:, 0] < 0
    assert 70 < mirrored.sum() < 130
    assert set(samples.rewards[~mirrored, 0].tolist()) == set(samples.rewards[mirrored, 0].tolist()) == {0.5, 1.0, 2.0}
    assert samples.discounts is not None and set(samples.discounts[:, 0].tolist()) == {0.25, 0.5}


@pytest.mark.parametrize("n_frames", [1, 2, 3])
def test_a_stack_of_frames_is_mirrored_within_each_frame(n_frames: int) -> None:
    space = Box(0, 255, (2 * n_frames, 8, 6), np.uint8)
    buffer = StereoReplayBuffer(
        1, space, Box(-1, 1, (4,)), device="cpu", views_in_channels=True, mirrored_joints=(0, 2)
    )
    images = th.arange(1, 2 * n_frames + 1, dtype=th.uint8)[None, :, None, None].expand(1, -1, 8, 6)
    assert buffer.mirror(images)[0, :, 0, 0].tolist() == [2, 1, 4, 3, 6, 5][: 2 * n_frames]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"n_steps": 0}, "n_steps is 0; give 1 or more"),
        (
            {"n_steps": 2, "optimize_memory_usage": True, "handle_timeout_termination": False},
            "n_steps is 2; set optimize_memory_usage to false for it",
        ),
        (
            {"views_in_channels": True, "mirrored_joints": (0,)},
            "an image with 1 channels does not hold 2 views; set mirror_probability to 0",
        ),
    ],
)
def test_what_the_buffer_cannot_do_is_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as error:
        StereoReplayBuffer(8, IMAGES, Box(-1, 1, (4,)), device="cpu", **settings)
    assert str(error.value) == message


@pytest.mark.parametrize("algorithm", [StereoDDPG, DDPG])
def test_a_models_n_steps_reach_its_buffer(algorithm: type[DDPG]) -> None:
    kwargs: dict[str, Any] = {"n_steps": 3, "gamma": 0.9, "learning_starts": 5, "batch_size": 4, "buffer_size": 50}
    if algorithm is StereoDDPG:
        kwargs["replay_buffer_kwargs"] = {"success_fraction": 0.1}
    model = algorithm(StereoDDPGPolicy, FakeImageEnv(), **kwargs)
    model.learn(20, callback=StereoReplay() if algorithm is DDPG else None)
    assert isinstance(model.replay_buffer, StereoReplayBuffer)
    assert (model.replay_buffer.n_steps, model.replay_buffer.gamma) == (3, 0.9)
    discounts = model.replay_buffer.sample(200).discounts
    assert discounts is not None and discounts.min() == pytest.approx(0.9**3)


def test_n_steps_that_a_buffer_would_ignore_are_refused() -> None:
    with pytest.raises(ValueError) as error:
        StereoDDPG("CnnPolicy", FakeImageEnv(), n_steps=3, replay_buffer_class=ReplayBuffer, buffer_size=10)
    assert str(error.value) == (
        "n_steps is 3, and ReplayBuffer samples single transitions; leave replay_buffer_class out, or set n_steps to 1"
    )


@pytest.mark.parametrize("optimize", [False, True])
def test_successes_get_their_fraction_and_timeouts_are_none(optimize: bool) -> None:
    memory = {"optimize_memory_usage": optimize, "handle_timeout_termination": not optimize}
    buffer = numbered(6, n_envs=2, mirror_probability=0.0, goals=(2, 4, 13, 15), success_fraction=1.0, **memory)
    # With the memory saver row 2 is gone, and SB3 cannot tell that the odd ones ran out of time.
    goals = {4.0, 13.0, 15.0} if optimize else {2.0, 4.0}
    assert set(buffer.sample(100).rewards[:, 0].tolist()) == goals
    buffer.success_fraction = 0.25
    n_goals = sum(reward in goals for reward in buffer.sample(400).rewards[:, 0].tolist())
    assert 100 < n_goals < 400
    assert not set(buffer.sample_dynamics(400).observations[:, 0, 0, 0].tolist()) <= goals


def test_without_a_goal_yet_the_share_waits() -> None:
    assert set(numbered(3, success_fraction=1.0, mirror_probability=0.0).sample(60).rewards[:, 0].tolist()) == {
        0.0,
        1.0,
        2.0,
    }


@pytest.mark.parametrize("name", ["success_fraction", "mirror_probability"])
def test_a_share_is_a_number_from_0_to_1(name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name} is 1.5; give a number from 0 to 1$"):
        numbered(1, **{name: 1.5})


@pytest.mark.parametrize("optimize", [False, True])
def test_dynamics_samples_are_one_transition_also_after_the_buffer_went_round(optimize: bool) -> None:
    buffer = numbered(
        6, n_envs=1 if optimize else 2, mirror_probability=0.0, optimize_memory_usage=optimize,
        handle_timeout_termination=not optimize,
    )  # fmt: skip
    samples = buffer.sample_dynamics(300)
    number = samples.observations[:, 0, 0, 0].float()
    assert set(number.tolist()) == ({3.0, 4.0, 5.0} if optimize else {2.0, 3.0, 4.0, 5.0, 12.0, 13.0, 14.0, 15.0})
    assert th.equal(samples.next_observations[:, 0, 0, 0].float(), number + 1)
    assert th.allclose(samples.actions, number[:, None] / 100)
    assert th.equal(samples.next_offsets[:, 1, 1], number + 1)


def test_dynamics_samples_are_mirrored_as_a_whole() -> None:
    samples = numbered(4).sample_dynamics(300)
    mirrored = samples.actions[:, 0] < 0
    assert 100 < mirrored.sum() < 200
    assert th.equal(samples.next_offsets[mirrored][:, :, 0] < 0, th.ones(int(mirrored.sum()), 2, dtype=th.bool))


def test_efforts_of_numbers_are_those_of_the_wrapper() -> None:
    class Arm(gym.Env):  # type: ignore[type-arg]
        action_space, observation_space = Box(-1, 1, (4,)), IMAGES

    env = QuantizedActions(Arm(), levels=3)
    buffer = StereoReplayBuffer(81, IMAGES, Discrete(81), device="cpu", n_joints=4)
    image = np.zeros((1, 1, 8, 6), np.uint8)
    for number in range(81):
        buffer.add(image, image + number, np.array([[number]]), np.zeros(1), np.zeros(1), [{}])
    samples = buffer.sample_dynamics(200)
    for number, efforts in zip(samples.next_observations[:, 0, 0, 0], samples.actions, strict=True):
        np.testing.assert_allclose(efforts, env.action(np.int64(number)))
    assert samples.next_offsets.isnan().all()  # the infos had none


@pytest.mark.parametrize("algorithm", [DDPG, DQN])
def test_the_callback_takes_over_a_models_transitions_and_training_goes_on(algorithm: type[DDPG | DQN]) -> None:
    env = FakeImageEnv(shape=(1, 36, 36), n_actions=9 if algorithm is DQN else None)
    policy = StereoDQNPolicy if algorithm is DQN else StereoDDPGPolicy
    model = algorithm(policy, env, buffer_size=50, learning_starts=5, batch_size=4, seed=0)
    model.learn(10)
    before = model.replay_buffer
    assert isinstance(before, ReplayBuffer)
    n_joints = 2 if algorithm is DQN else 4
    model.learn(10, callback=StereoReplay(None, [0], n_joints), reset_num_timesteps=False)
    after = model.replay_buffer
    assert isinstance(after, StereoReplayBuffer) and after.size() >= 20  # DQN collects four at a time
    np.testing.assert_array_equal(after.observations[:10], before.observations[:10])


def test_what_has_no_mirror_is_explained() -> None:
    with pytest.raises(ValueError, match=r"^82 actions are not the combinations of 4 joints; set n_joints$"):
        StereoReplayBuffer(1, IMAGES, Discrete(82), device="cpu", n_joints=4)
    with pytest.raises(ValueError, match=r"^n_joints is not given; set how many joints a discrete action stands for$"):
        StereoReplayBuffer(1, IMAGES, Discrete(81), device="cpu")
    with pytest.raises(ValueError) as error:
        StereoReplayBuffer(1, IMAGES, Box(-1, 1, (4,)), device="cpu", mirror_probability=0.5)
    assert str(error.value) == (
        "mirror_probability is 0.5, but nothing says which joints change sign in the mirror; "
        "set mirrored_joints, or mirror_probability to 0"
    )
    model = PPO("MlpPolicy", "CartPole-v1", n_steps=8, batch_size=8)
    with pytest.raises(ValueError, match=r"^a StereoReplayBuffer replaces a replay buffer, and PPO has none$"):
        model.learn(8, callback=StereoReplay())
