"""Laws of the encoder that two networks share, and of the memo of its features."""

from __future__ import annotations

import copy
import gc
import pickle
from functools import partial

import pytest
import torch as th
from fake_env import FakeImageEnv
from stable_baselines3.common.utils import polyak_update

from sb3_stereo.policies.extractors import StereoCnn
from sb3_stereo.policies.shared_encoder import BorrowedEncoder, FeatureMemo


def images() -> th.Tensor:
    return th.rand(6, 1, 36, 36, generator=th.Generator().manual_seed(0))


class CountedEncoder(StereoCnn):
    passes = 0

    def forward(self, observations: th.Tensor) -> th.Tensor:
        self.passes += 1
        return super().forward(observations)


def counted(**kwargs) -> tuple[CountedEncoder, FeatureMemo]:
    encoder = CountedEncoder(
        FakeImageEnv().observation_space, None, n_filters=4, **{"input_norm": "pixel", "hidden_norm": "layer", **kwargs}
    ).eval()
    return encoder, FeatureMemo(encoder)


@th.no_grad()
def test_memo_computes_the_same_tensor_once():
    encoder, memo = counted()
    observations = images()
    first = memo(observations, lambda: encoder(observations))
    assert memo(observations, lambda: encoder(observations)) is first
    assert encoder.passes == 1


@pytest.mark.parametrize(
    "change",
    [
        lambda encoder, observations: encoder.convs[0].weight.mul_(2),
        lambda encoder, observations: polyak_update([th.ones(4)], [encoder.convs[0].bias], 0.5),  # writes to .data
        lambda encoder, observations: encoder.input_norm.running_mean.add_(1),
        lambda encoder, observations: observations.mul_(2),
        lambda encoder, observations: encoder.train(),
    ],
    ids=["weights", "polyak", "statistics", "observations", "mode"],
)
@th.no_grad()
def test_memo_sees_every_change(change):
    encoder, memo = counted()
    observations = images()
    memo(observations, lambda: encoder(observations))
    change(encoder, observations)
    assert th.equal(memo(observations, lambda: encoder(observations)), encoder(observations))
    assert encoder.passes == 3


@th.no_grad()
def test_memo_never_spares_batch_norm_a_training_pass():
    encoder, memo = counted(hidden_norm="batch")
    encoder.train()
    observations = images()
    for _ in range(2):
        memo(observations, lambda: encoder(observations))
    assert encoder.passes == 2


def test_memo_stands_aside_where_a_gradient_is_wanted():
    encoder, memo = counted()
    observations = images()
    for _ in range(2):
        assert memo(observations, lambda: encoder(observations)).requires_grad
    assert encoder.passes == 2


@th.no_grad()
def test_memo_lets_go_with_the_observations_and_copies_start_empty():
    encoder, memo = counted()
    observations = images()
    memo(observations, partial(encoder, observations))
    assert memo._entry is not None
    assert copy.deepcopy(memo)._entry is None
    assert pickle.loads(pickle.dumps(memo))._entry is None
    del observations
    gc.collect()
    assert memo._entry is None


def test_borrowed_encoder_owns_nothing_and_passes_no_gradient():
    encoder, _ = counted()
    borrowed = BorrowedEncoder(encoder)
    assert not list(borrowed.parameters()) and not borrowed.state_dict()
    features = borrowed(images())
    assert not features.requires_grad and th.equal(features, encoder(images()))
