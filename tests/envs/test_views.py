"""Views by name, in any number and any arrangement: what the environment shows, and what learners make of it."""

from typing import Any

import numpy as np
import pytest
import torch as th
from fake_env import FakeImageEnv
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env as gym_check_env
from stable_baselines3 import DDPG, DQN
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from sb3_stereo.config.schema import load_config
from sb3_stereo.envs.cameras import STEREO_PAIR, camera_specs
from sb3_stereo.envs.composite import COMPOSITES, Composite, as_stack, composite
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.learning.callbacks import StereoReplay
from sb3_stereo.learning.replay import StereoReplayBuffer
from sb3_stereo.learning.stereo_ddpg import StereoDDPG
from sb3_stereo.policies.ddpg import StereoDDPGPolicy
from sb3_stereo.policies.dqn import StereoDQNPolicy
from sb3_stereo.policies.extractors import StereoCnn

LEFT, RIGHT = STEREO_PAIR
VIEWS = {1: (LEFT,), 3: (LEFT, RIGHT, LEFT), 4: (LEFT, RIGHT, RIGHT, LEFT)}
FRAMES = tuple(np.random.default_rng(0).integers(0, 256, (3, 240, 320, 4), dtype=np.uint8))
NAMES = ("left", "right", "above")


def test_cameras_are_given_by_their_names() -> None:
    assert camera_specs(["left", "left"]) == (LEFT, LEFT)
    assert camera_specs([RIGHT, "left"]) == (RIGHT, LEFT)
    with pytest.raises(ValueError) as error:
        camera_specs(["lfet"])
    assert str(error.value) == "unknown camera 'lfet'; those with a name are left, right, back_left, back_right"


def test_a_record_names_the_cameras_of_the_pair() -> None:
    config = load_config("ddpg", "WamStereoReach-v0", env_kwargs={"cameras": ["right", "right"]})
    assert list(config.env_kwargs["cameras"]) == ["right", "right"]  # which they are depends on the framing


@pytest.mark.parametrize("view", [0, 1])
def test_one_view_twice_is_judged_by_that_view_alone(view: int) -> None:
    both, twice = StereoReachEnv(), StereoReachEnv(cameras=[STEREO_PAIR[view].name] * 2)
    rows = slice(42 * view, 42 * view + 42)
    rng = np.random.default_rng(0)
    for seed in range(5):
        _, info = both.reset(seed=seed)
        pose = info["joint_positions"][:4]
        twice.reset(options={"joint_positions": pose})
        action = rng.uniform(-1, 1, 4)
        image, _, _, _, seen = both.step(action)
        mono, reward, terminated, _, info = twice.step(action)
        np.testing.assert_array_equal(mono[0], np.vstack([image[0, rows]] * 2))
        np.testing.assert_array_equal(info["pixel_offsets"], seen["pixel_offsets"][[view, view]])
        assert terminated == bool(seen["pixel_distances"][view] <= 10) and -1 <= reward <= 1
    assert twice.mirrored_joints is None and both.mirrored_joints == (0, 2)
    both.close()
    twice.close()


@pytest.mark.parametrize("n_views", VIEWS)
@pytest.mark.parametrize("arrangement", ["stack", "channels"])
def test_any_number_of_views_passes_the_checkers(n_views: int, arrangement: str) -> None:
    env = StereoReachEnv(cameras=VIEWS[n_views], composite=arrangement)
    gym_check_env(env, skip_render_check=True)
    sb3_check_env(env)
    _, info = env.reset(seed=0)
    assert info["pixel_distances"].shape == (n_views,)
    env.close()


def test_a_map_of_views_passes_the_checkers() -> None:
    env = StereoReachEnv(composite="dict")
    gym_check_env(env, skip_render_check=True)
    sb3_check_env(env)
    env.close()


def test_every_arrangement_holds_the_same_luminance() -> None:
    stack = composite(FRAMES)
    shapes = {"stack": (1, 126, 84), "channels": (3, 42, 84), "markers": (2, 126, 84)}
    for arrangement in COMPOSITES:
        arrange = Composite(arrangement, NAMES)
        observation = arrange(FRAMES)
        assert arrange.space.contains(observation)
        np.testing.assert_array_equal(as_stack(observation)[:, :, :84], stack)
        if arrangement == "dict":
            assert list(arrange.space) == list(NAMES)  # in the order of the cameras, not of the alphabet
        else:
            assert observation.shape == shapes[arrangement]


def test_the_default_shows_the_papers_stack() -> None:
    env = StereoReachEnv(render_mode="rgb_array")
    observation, _ = env.reset(seed=0)
    np.testing.assert_array_equal(observation, composite(np.hsplit(env.render(), 2)))  # type: ignore[arg-type]
    env.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"composite": "tower"}, "unknown composite 'tower'; composites are stack, channels, dict, markers"),
        (
            {"composite": "dict", "cameras": ["left", "left"]},
            "cameras left, left share a name; composite 'dict' needs one for each",
        ),
    ],
)
def test_wrong_arrangements_are_explained(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as error:
        StereoReachEnv(**arguments)
    assert str(error.value) == message


def test_the_extractor_stacks_a_map_in_its_order_and_not_the_alphabets() -> None:
    one = spaces.Box(0, 255, (1, 42, 84), np.uint8)
    kwargs: dict[str, Any] = {"features_dim": 8, "n_filters": 4}
    th.manual_seed(0)
    stacked = StereoCnn(spaces.Box(0, 255, (1, 126, 84), np.uint8), **kwargs).eval()
    th.manual_seed(0)
    mapped = StereoCnn(Composite("dict", NAMES).space, **kwargs).eval()  # type: ignore[arg-type]
    image = th.rand(2, 1, 126, 84)
    views = dict(zip(NAMES, image.split(42, dim=2), strict=True))
    th.testing.assert_close(mapped(dict(sorted(views.items()))), stacked(image))
    with pytest.raises(ValueError) as error:
        StereoCnn(spaces.Dict({"a": one, "b": spaces.Box(0, 255, (1, 42, 80), np.uint8)}))
    message = "StereoCnn needs images of one shape (channels, height, width), got (1, 42, 84), (1, 42, 80)"
    assert str(error.value) == message


def test_the_mirror_of_channels_is_that_of_the_stack() -> None:
    channels, stack = Composite("channels", NAMES).space, Composite("stack", NAMES).space
    images = th.randint(0, 256, (4, 3, 42, 84), dtype=th.uint8)
    mirrored = []
    for space, batch in ((channels, images), (stack, images.reshape(4, 1, 126, 84))):
        buffer = StereoReplayBuffer(1, space, spaces.Box(-1, 1, (4,)), device="cpu", n_views=3, mirrored_joints=(0, 2))
        mirrored.append(buffer.mirror(batch).reshape(4, 3, 42, 84))
    assert th.equal(*mirrored)


class ArrangedEnv(FakeImageEnv):
    """Noise in the arrangement of two views."""

    mirrored_joints = (0, 2)

    def __init__(self, arrangement: str, n_actions: int | None = None) -> None:
        super().__init__((1, 84, 84), n_actions)
        composite = Composite(arrangement, ("left", "right"))
        self.observation_space = composite.space  # type: ignore[assignment]
        self.views_in_channels = composite.views_in_channels

    def _image(self) -> Any:
        self.observation_space.seed(int(self.np_random.integers(2**31)))
        return self.observation_space.sample()


pytestmark = pytest.mark.filterwarnings("ignore:StereoReplay will go:FutureWarning")
SMALL: dict[str, Any] = {"learning_starts": 4, "batch_size": 4, "buffer_size": 50, "seed": 0, "device": "cpu"}


@pytest.mark.parametrize("arrangement", COMPOSITES)
def test_ddpg_learns_from_every_arrangement(arrangement: str, tmp_path: Any) -> None:
    kwargs: dict[str, Any] = {"features_extractor_kwargs": {"n_filters": 4}, "net_arch": [8, 8]}
    policy: Any = StereoDDPGPolicy
    if arrangement == "dict":
        policy = "MultiInputPolicy"
        kwargs["features_extractor_class"] = StereoCnn
    env = ArrangedEnv(arrangement)
    model = DDPG(policy, env, policy_kwargs=kwargs, **SMALL)
    before = [parameter.clone() for parameter in model.actor.parameters()]
    model.learn(12, callback=None if arrangement == "dict" else StereoReplay())
    assert any(not th.equal(b, p) for b, p in zip(before, model.actor.parameters(), strict=True))
    observation, _ = env.reset(seed=0)
    action = model.predict(observation, deterministic=True)[0]
    model.save(tmp_path / "model")
    np.testing.assert_array_equal(DDPG.load(tmp_path / "model").predict(observation, deterministic=True)[0], action)


WAY_OUT = (
    " takes one image, and this environment gives a map of left, right; set its composite to 'stack' or 'channels', "
    "or take MultiInputPolicy with features_extractor_class: sb3_stereo.policies.extractors.StereoCnn"
)


def test_a_map_of_views_is_refused_where_it_cannot_be_learnt_from() -> None:
    for algo, policy, n_actions in ((DDPG, StereoDDPGPolicy, None), (DQN, StereoDQNPolicy, 3)):
        with pytest.raises(ValueError) as error:
            algo(policy, ArrangedEnv("dict", n_actions), **SMALL)  # type: ignore[operator]
        assert str(error.value) == policy.__name__ + WAY_OUT
    with pytest.raises(ValueError) as error:
        StereoDDPG("MultiInputPolicy", ArrangedEnv("dict"), replay_buffer_kwargs={"success_fraction": 0.1}, **SMALL)
    assert str(error.value) == (
        "a StereoReplayBuffer holds one image per observation, and this environment gives a map of them; "
        "set its composite to 'stack' or 'channels', or leave replay_buffer_kwargs and encoder_loss out"
    )


def test_another_number_of_views_than_the_replays_is_explained() -> None:
    class ThreeViews(FakeImageEnv):
        n_views = 3

    with pytest.raises(ValueError) as error:
        StereoDDPG("CnnPolicy", ThreeViews(), replay_buffer_kwargs={"n_views": 2, "success_fraction": 0.1}, **SMALL)
    assert str(error.value) == "replay_buffer_kwargs: n_views is 2, and the environment has 3; leave it out"
