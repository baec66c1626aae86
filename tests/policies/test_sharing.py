"""Laws of the encoder that two networks share."""

from __future__ import annotations

import copy

import torch as th
from fake_env import FakeImageEnv

from sb3_stereo.policies.extractors import StereoCnn
from sb3_stereo.policies.shared_encoder import SharedEncoderView


def test_a_view_owns_nothing_and_passes_no_gradient():
    encoder = StereoCnn(FakeImageEnv().observation_space, None, n_filters=4, input_norm="pixel", hidden_norm="layer")
    images = th.rand(6, 1, 36, 36, generator=th.Generator().manual_seed(0))
    view = SharedEncoderView(encoder)
    assert not list(view.parameters()) and not view.state_dict()
    features = view(images)
    assert not features.requires_grad and th.equal(features, encoder.eval()(images))


def test_a_copy_of_both_shares_the_copied_encoder():
    encoder = StereoCnn(FakeImageEnv().observation_space, None, n_filters=4)
    twin, view = copy.deepcopy((encoder, SharedEncoderView(encoder)))
    assert view.encoder is twin
