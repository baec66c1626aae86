"""Attention and TensorBoard's pictures."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_env import FakeImageEnv
from stable_baselines3 import DDPG, DQN
from tiny_training import tiny_config

from sb3_stereo.config.schema import load_config
from sb3_stereo.policies.ddpg import StereoDDPGPolicy
from sb3_stereo.policies.dqn import StereoDQNPolicy
from sb3_stereo.training import Options, train
from sb3_stereo.viz.saliency import overlaid, saliency

SMALL = {"n_filters": 4, "kernel_sizes": [4, 3], "strides": [2, 2]}


def make(algo: str) -> Any:
    if algo == "dqn":
        kwargs = {"net_arch": [8], "features_extractor_kwargs": SMALL | {"features_dim": 8}}
        return DQN(StereoDQNPolicy, FakeImageEnv(n_actions=3), policy_kwargs=kwargs, buffer_size=10, device="cpu")
    dynamics = {"shared_encoder": True, "encoder_loss": "dynamics"} if algo == "dynamics" else {}
    kwargs = {"net_arch": [8, 8], "features_extractor_kwargs": SMALL, "final_init": 0.5, **dynamics}
    return DDPG(StereoDDPGPolicy, FakeImageEnv(), policy_kwargs=kwargs, buffer_size=10, device="cpu", seed=0)


@pytest.mark.parametrize("algo", ["ddpg", "dynamics", "dqn"])
def test_attention_is_where_pixels_change_the_action_and_are_known_to_change(algo: str) -> None:
    policy = make(algo).policy
    observation = np.random.default_rng(0).integers(0, 256, (1, 36, 36), dtype=np.uint8)
    spread = np.zeros((1, 36, 36), np.float32)
    spread[:, :, 18:] = 50.0
    attention = saliency(policy, observation, spread)
    assert attention.shape == (36, 36) and attention.max() == 1.0
    assert (attention[:, :18] == 0).all()
    assert (saliency(policy, observation, 0 * spread) == 0).all()
    assert all(parameter.grad is None for parameter in policy.parameters())


def test_attention_is_the_gradient_of_the_action() -> None:
    model = make("ddpg")
    policy, rng = model.policy, np.random.default_rng(0)
    observation = rng.integers(50, 200, (1, 36, 36), dtype=np.uint8)
    attention = saliency(policy, observation, np.ones((1, 36, 36), np.float32))

    def effect(pixel: Any) -> float:
        changed = [observation.astype(np.float32) for _ in range(2)]
        for image, sign in zip(changed, (1, -1)):
            image[0][pixel] += 20 * sign
        first, second = (policy.actor(policy.obs_to_tensor(image)[0]).detach().numpy() for image in changed)
        return float(np.linalg.norm(first - second))

    order = np.argsort(attention.ravel())
    weak, strong = ([np.unravel_index(i, (36, 36)) for i in part] for part in (order[:20], order[-20:]))
    assert sum(map(effect, strong)) > 3 * sum(map(effect, weak))


def test_the_overlay_shows_the_image_and_reddens_what_counts() -> None:
    attention = np.zeros((4, 6), np.float32)
    attention[1, 2] = 1.0
    picture = overlaid(np.full((1, 4, 6), 200, np.uint8), attention, factor=2)
    assert picture.shape == (8, 24, 3)
    assert (picture[:, :12] == 200).all()
    assert np.array_equal(picture[2, 16], (220, 0, 0)) and np.ptp(picture[0, 20].astype(int)) == 0


def test_pictures_come_with_each_score_and_change_nothing_that_is_learnt(logs: Path, tmp_path: Path) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    plain, drawn = (
        train(
            tiny_config(),
            Options(seed=3, log_folder=str(logs), eval_freq=15, verbose=0, tensorboard_log=folder),
        ).evaluation
        for folder in (None, str(tmp_path / "tb"))
    )
    assert plain and drawn and plain.scores() == drawn.scores()
    (events,) = (tmp_path / "tb").rglob("events*")
    found = accumulator.EventAccumulator(str(events), size_guidance={"images": 0}).Reload()
    assert [image.step for image in found.Images("pictures/attention")] == [15, 30]
    assert {"eval/success_rate", "eval/mean_return", "eval/mean_q", "eval/mean_action"} <= set(found.Tags()["scalars"])


def test_the_cameras_frames_are_among_the_pictures(logs: Path, tmp_path: Path) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    params = {"learning_starts": 8, "batch_size": 4, "buffer_size": 20, "callback": None}
    config = load_config(
        "ddpg", "WamStereoReach-v0", params=params, n_timesteps=10, env_kwargs={"max_episode_steps": 1}
    )
    train(config, Options(seed=1, log_folder=str(logs), eval_freq=-1, verbose=0, tensorboard_log=str(tmp_path / "tb")))
    (events,) = (tmp_path / "tb").rglob("events*")
    found = accumulator.EventAccumulator(str(events), size_guidance={"images": 0}).Reload()
    assert {image: len(found.Images(image)) for image in found.Tags()["images"]} == {
        "pictures/attention": 1,
        "pictures/stereo": 1,
    }
    assert found.Images("pictures/stereo")[0].width > 960
