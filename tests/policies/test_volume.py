"""Laws of the extractor over a volume of views: what is shared, what is merged, and what a lost view may not do."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch as th
from fake_env import FakeImageEnv
from gymnasium import spaces
from stable_baselines3 import DDPG, DQN
from torch import nn

from sb3_stereo.config.schema import load_config
from sb3_stereo.errors import ConfigError
from sb3_stereo.policies.ddpg import StereoDDPGPolicy
from sb3_stereo.policies.dqn import StereoDQNPolicy
from sb3_stereo.policies.volume import MERGES, VIEW_LAYERS, VolumeCnn

SHAPE = (4, 36, 40)
SPACE = spaces.Box(0, 255, SHAPE, np.uint8)
ORDER = [2, 0, 3, 1]


def images(n: int = 5, seed: int = 0) -> th.Tensor:
    return th.rand(n, *SHAPE, generator=th.Generator().manual_seed(seed))


def small(**kwargs: Any) -> VolumeCnn:
    th.manual_seed(0)
    return VolumeCnn(SPACE, **{"features_dim": 12, "n_filters": 6, "input_norm": "none", **kwargs})


def lost(batch: th.Tensor, view: int, grey: float) -> th.Tensor:
    batch = batch.clone()
    batch[:, view] = grey
    return batch


@pytest.mark.parametrize("merge", MERGES)
@pytest.mark.parametrize("view_layers", VIEW_LAYERS)
@pytest.mark.parametrize("sizes", [(12, None), (None, None), (None, 3), (12, 3)])
def test_features_have_the_announced_size(merge: str, view_layers: str, sizes: tuple[int | None, int | None]) -> None:
    cnn = small(merge=merge, view_layers=view_layers, features_dim=sizes[0], embedding_dim=sizes[1])
    assert cnn(images()).shape == (5, cnn.features_dim)
    if sizes != (None, None):
        assert cnn.features_dim == (sizes[1] or sizes[0])


def test_the_order_of_the_views_has_no_effect_if_all_is_shared() -> None:
    cnn = small(view_layers="shared").eval()
    th.testing.assert_close(cnn(images()[:, ORDER]), cnn(images()))
    attentive = small(view_layers="shared", merge="attention").eval()
    th.testing.assert_close(attentive(images()[:, ORDER]), attentive(images()))


@pytest.mark.parametrize("merge", MERGES)
def test_layers_of_their_own_follow_their_views(merge: str) -> None:
    cnn = small(merge=merge).eval()
    before = cnn(images())
    assert not th.allclose(cnn(images()[:, ORDER]), before, atol=1e-4)
    cnn.fcs = nn.ModuleList(cnn.fcs[view] for view in ORDER)
    th.testing.assert_close(cnn(images()[:, ORDER]), before)


@pytest.mark.parametrize("merge", MERGES)
@pytest.mark.parametrize("view_layers", VIEW_LAYERS)
@pytest.mark.parametrize("input_norm", ["none", "pixel", "channel"])
@pytest.mark.parametrize("training", [False, True])
def test_the_pixels_of_a_lost_view_have_no_influence(
    merge: str, view_layers: str, input_norm: str, training: bool
) -> None:
    found = []
    for grey in (0.0, 0.3, 1.0):
        cnn = small(merge=merge, view_layers=view_layers, input_norm=input_norm)
        cnn(images(seed=1))  # statistics
        batch = lost(images(), 2, grey).requires_grad_()
        features = cnn.train(training)(batch)
        (features * images(5)[:, 0, 0, :12]).sum().backward()  # type: ignore[no-untyped-call]
        assert batch.grad is not None
        assert batch.grad[:, [0, 1, 3]].abs().sum() > 0
        found.append([features.detach(), *(value.clone() for value in cnn.state_dict().values())])
    for one in found[1:]:
        for a, b in zip(one, found[0], strict=True):
            th.testing.assert_close(a, b)


@pytest.mark.parametrize("merge", MERGES)
def test_the_other_views_are_merged_as_if_there_were_no_lost_one(merge: str) -> None:
    """Three views that show the same are as good as four: the mean does not shrink."""
    cnn = small(merge=merge, view_layers="shared").eval()
    same = images()[:, :1].repeat(1, 4, 1, 1)
    th.testing.assert_close(cnn(lost(same, 3, 0.0)), cnn(same))


@pytest.mark.parametrize("merge", MERGES)
def test_without_any_view_features_are_constant_and_gradients_finite(merge: str) -> None:
    cnn = small(merge=merge, hidden_norm="none")
    features = cnn(th.zeros(3, *SHAPE))
    assert th.equal(features, th.zeros(3, 12))
    features.sum().backward()  # type: ignore[no-untyped-call]
    assert all(p.grad is None or p.grad.isfinite().all() for p in cnn.parameters())


def test_gradients_reach_every_view_and_every_weight() -> None:
    cnn = small(merge="attention", embedding_dim=5, input_norm="channel")
    batch = images().requires_grad_()
    (cnn(batch) * images()[:, 0, 0, :5]).sum().backward()  # type: ignore[no-untyped-call]
    assert batch.grad is not None and (batch.grad.abs().sum(dim=(0, 2, 3)) > 0).all()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for name, p in cnn.named_parameters() if "weight" in name)


def test_attention_can_prefer_a_view() -> None:
    cnn = small(merge="attention", features_dim=None).eval()
    assert cnn.scores is not None
    with th.no_grad():
        cnn.scores.weight.copy_(1e3 * th.eye(cnn.features_dim))  # the larger a feature, the more it counts
        cnn.scores.bias.zero_()
    maps = cnn.convs(images().flatten(0, 1)[:, None]).flatten(1).unflatten(0, (5, 4))
    th.testing.assert_close(cnn(images()), maps.amax(dim=1), atol=1e-2, rtol=0)


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"merge": "max"}, "unknown merge 'max'; choices are mean, attention"),
        ({"view_layers": "none"}, "unknown view_layers 'none'; choices are own, shared"),
        ({"input_norm": "pixle"}, "unknown input_norm 'pixle'; choices are channel, pixel, none"),
    ],
)
def test_wrong_settings_are_refused_with_the_choices(kwargs: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as error:
        small(**kwargs)
    assert str(error.value) == message


def test_an_image_of_all_views_is_refused() -> None:
    with pytest.raises(ValueError) as error:
        VolumeCnn(spaces.Box(0, 255, (1, 84, 84), np.uint8))
    assert str(error.value) == (
        "VolumeCnn needs images with a view in each channel, (n_views, height, width), got (1, 84, 84); "
        "set the environment's composite to 'channels'"
    )


class FourViews(FakeImageEnv):
    n_views, views_in_channels = 4, True

    def __init__(self, n_actions: int | None = None) -> None:
        super().__init__(SHAPE, n_actions)


@pytest.mark.parametrize("merge", MERGES)
@pytest.mark.parametrize("algo", [DDPG, DQN])
def test_policies_learn_save_and_load_with_it(algo: Any, merge: str, tmp_path: Any) -> None:
    policy: Any = {DDPG: StereoDDPGPolicy, DQN: StereoDQNPolicy}[algo]
    env = FourViews(3 if algo is DQN else None)
    extractor = {"n_filters": [4, 4, 4], "features_dim": 8, "merge": merge, "embedding_dim": 4}
    kwargs: dict[str, Any] = {"features_extractor_class": VolumeCnn, "features_extractor_kwargs": extractor}
    model = algo(
        policy, env, policy_kwargs=kwargs, learning_starts=4, batch_size=4, buffer_size=50, seed=0, device="cpu"
    )
    before = [parameter.clone() for parameter in model.policy.parameters()]
    model.learn(12)
    assert any(not th.equal(b, p) for b, p in zip(before, model.policy.parameters(), strict=True))
    observation, _ = env.reset(seed=0)
    action = model.predict(observation, deterministic=True)[0]
    model.save(tmp_path / "model")
    np.testing.assert_array_equal(algo.load(tmp_path / "model").predict(observation, deterministic=True)[0], action)


def test_yaml_takes_it_by_its_name_and_refuses_what_it_does_not_know() -> None:
    name = "policy_kwargs.features_extractor_"
    params = {name + "class": "sb3_stereo.VolumeCnn", name + "kwargs.merge": "attention"}
    config = load_config("ddpg", "WamStereoReach-v1", params=params)
    assert config.policy_kwargs["features_extractor_kwargs"]["merge"] == "attention"
    with pytest.raises(ConfigError, match=r"unknown argument of VolumeCnn 'views' .*; allowed are: blur, "):
        load_config("ddpg", "WamStereoReach-v1", params=params | {name + "kwargs.views": "shared"})
    with pytest.raises(ConfigError, match="VolumeCnn: merge must be a text, got 3"):
        load_config("ddpg", "WamStereoReach-v1", params=params | {name + "kwargs.merge": 3})
