"""Random shifts move every image by itself, in training only, and repeat the border."""

import numpy as np
import pytest
import torch as th
from gymnasium.spaces import Box

from sb3_stereo.policies.random_shift import RandomShift, ShiftedNatureCNN

IMAGES = th.arange(2 * 3 * 10 * 12, dtype=th.float32).reshape(2, 3, 10, 12)


def shifted(image: th.Tensor, down: int, right: int) -> th.Tensor:
    """The image whose border is repeated, cut out anew."""
    rows = th.arange(10).add(down).clamp(0, 9)
    columns = th.arange(12).add(right).clamp(0, 11)
    return image[:, rows][:, :, columns]


def test_every_image_is_shifted_by_up_to_the_pad() -> None:
    th.manual_seed(0)
    found = set()
    for _ in range(200):
        for image, moved in zip(IMAGES, RandomShift(pad=2)(IMAGES)):
            shifts = [(i, j) for i in range(-2, 3) for j in range(-2, 3) if th.equal(shifted(image, i, j), moved)]
            assert len(shifts) == 1
            found.add(shifts[0])
    assert len(found) == 25


def test_images_of_a_batch_are_shifted_differently() -> None:
    th.manual_seed(0)
    moved = RandomShift(pad=4)(IMAGES[:1].expand(20, -1, -1, -1))
    assert len({image.numpy().tobytes() for image in moved}) > 10


def test_nothing_is_shifted_when_an_agent_acts() -> None:
    assert RandomShift().eval()(IMAGES) is IMAGES
    extractor = ShiftedNatureCNN(Box(0, 255, (1, 84, 84), np.uint8), features_dim=8)
    images = th.rand(2, 1, 84, 84)
    assert not th.equal(extractor(images), extractor(images))
    extractor.eval()
    assert th.equal(extractor(images), extractor(images))


def test_a_negative_pad_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^pad is -1; give 0 or more pixels$"):
        RandomShift(-1)
