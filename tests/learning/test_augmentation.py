"""Image augmentation changes what another world would change, and nothing that a label says."""

from typing import Any

import numpy as np
import pytest

from sb3_stereo.learning.augmentation import BRIGHT, ImageAugmentation, Layout

NOTHING: dict[str, Any] = {"background": 0, "gain": [1, 1], "offset": 0, "noise": 0, "shift": 0, "patches": 0}
STACK = Layout()


def scene(n: int = 8, channels: int = 1) -> np.ndarray:
    """White images with a dark arm in both views."""
    images = np.full((n, channels, 84, 84), 255, np.uint8)
    images[:, :, 10:30, 40:46] = 90
    images[:, :, 52:72, 20:26] = 60
    return images


def change(images: np.ndarray, layout: Layout = STACK, seed: int = 0, **settings: Any) -> np.ndarray:
    augmentation = ImageAugmentation.of({**NOTHING, "probability": 1.0, **settings})
    return augmentation.change(images, layout, np.random.default_rng(seed))


def test_without_any_change_images_stay_as_they_are() -> None:
    np.testing.assert_array_equal(change(scene()), scene())


def test_the_given_images_are_not_written_on() -> None:
    images = scene()
    ImageAugmentation().change(images, STACK, np.random.default_rng(0))
    np.testing.assert_array_equal(images, scene())


def test_the_same_generator_gives_the_same_images_and_another_one_others() -> None:
    one, same, other = (ImageAugmentation().change(scene(), STACK, np.random.default_rng(seed)) for seed in (0, 0, 1))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)


def test_every_image_is_changed_by_itself() -> None:
    changed = ImageAugmentation().change(scene(), STACK, np.random.default_rng(0))
    assert len({image.tobytes() for image in changed}) == len(changed)


def test_a_background_is_drawn_where_it_was_white_and_nowhere_else() -> None:
    changed = change(scene(), background=1.0)
    arm = scene() < BRIGHT
    np.testing.assert_array_equal(changed[arm], scene()[arm])
    assert (changed[~arm] != 255).mean() > 0.9


def test_each_view_has_a_light_of_its_own() -> None:
    changed = change(scene(), gain=[0.5, 0.9])
    ratios = changed[:, 0, 15, 42] / 90, changed[:, 0, 60, 22] / 60
    for ratio in ratios:
        assert ((ratio >= 0.48) & (ratio <= 0.9)).all()
    assert np.abs(ratios[0] - ratios[1]).max() > 0.05


def test_all_views_are_shifted_alike_and_none_into_another() -> None:
    images = scene()
    images[:, :, 35:42] = 10  # the edge between the views
    changed = change(images, shift=3)
    for image, original in zip(changed[:, 0], images[:, 0], strict=True):
        views, originals = image.reshape(2, 42, 84), original.reshape(2, 42, 84)
        moved = [
            (down, right)
            for down in range(-3, 4)
            for right in range(-3, 4)
            if all(
                np.array_equal(view[6:-6, 6:-6], was[6 + down : 36 + down, 6 + right : 78 + right])
                for view, was in zip(views, originals, strict=True)
            )
        ]
        assert moved
        assert views[1].min() == 60


@pytest.mark.parametrize("name", ["noise", "offset", "patches"])
def test_each_setting_changes_something(name: str) -> None:
    changed = change(scene(), **{name: 2})
    assert not np.array_equal(changed, scene())


def test_noise_is_no_stronger_than_its_limit() -> None:
    grey = np.full((32, 1, 84, 84), 128, np.uint8)
    spread = (change(grey, noise=20).astype(float) - 128).std(axis=(1, 2, 3))
    assert spread.max() < 21 and spread.min() < 5 < spread.max()


def test_views_in_channels_are_changed_like_views_in_rows() -> None:
    images = scene()
    layout = Layout(views_in_channels=True)
    channels = change(images.reshape(8, 2, 42, 84), layout, background=0.5, gain=[0.5, 1], shift=2, patches=2)
    rows = change(images, background=0.5, gain=[0.5, 1], shift=2, patches=2)
    np.testing.assert_array_equal(channels.reshape(rows.shape), rows)


def test_a_marker_map_is_shifted_and_nothing_else() -> None:
    images = scene(channels=2)
    images[:, 1] = 128
    images[:, 1, 20, 40] = images[:, 1, 60, 20] = 255
    layout = Layout(marker_map=True)
    others = {"background": 1.0, "gain": [0.5, 0.9], "offset": 9, "noise": 20, "patches": 2}
    changed = change(images, layout, **others)
    np.testing.assert_array_equal(changed[:, 1], images[:, 1])
    assert not np.array_equal(changed[:, 0], images[:, 0])
    shifted = change(images, layout, shift=3)
    assert not np.array_equal(shifted[:, 1], images[:, 1])


def test_a_share_of_the_images_is_changed() -> None:
    images = scene(400)
    changed = ImageAugmentation(noise=50.0).change_some(images, 0.3, STACK, np.random.default_rng(0))
    share = np.mean([not np.array_equal(one, other) for one, other in zip(changed, images, strict=True)])
    assert 0.2 < share <= 0.37


def test_the_share_grows_from_begin_to_end() -> None:
    growing = ImageAugmentation(share=0.8, begin=1000, end=3000)
    assert [growing.share_at(step) for step in (0, 1000, 2000, 3000, 9000)] == [0.0, 0.0, 0.4, 0.8, 0.8]
    assert ImageAugmentation(share=0.8).share_at(0) == 0.8
    assert [ImageAugmentation(share=0.8, begin=5).share_at(step) for step in (4, 5)] == [0.0, 0.8]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"blur": 1},
            "unknown setting 'blur' of augmentation; choices are share, begin, end, background, gain, offset, noise, "
            "shift, patches, probability",
        ),
        ({"share": 1.5}, "augmentation: share is 1.5; give a number from 0 to 1"),
        ({"shift": 1.5}, "augmentation: shift is 1.5; give an integer"),
        ({"noise": -1}, "augmentation: noise is -1; give a number that is not negative"),
        ({"noise": "much"}, "augmentation: noise is 'much'; give a number"),
        ({"gain": [2, 1]}, "augmentation: gain is [2, 1]; give the lowest and the highest factor, both positive"),
        ({"begin": 3000, "end": 1000}, "augmentation: end is 1000; give at least begin, 3000"),
    ],
)
def test_wrong_settings_are_refused_in_one_sentence(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as caught:
        ImageAugmentation.of(settings)
    assert str(caught.value) == message
