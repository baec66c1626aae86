"""Image augmentation changes what another world would change, and nothing that a label says."""

from typing import Any

import numpy as np
import pytest

from sb3_stereo.learning.augmentation import WHITE, ImageAugmentation, Layout

NOTHING: dict[str, Any] = dict.fromkeys(("background", "tone", "offset", "noise", "shift", "zoom", "patches"), 0)
STACK = Layout()


def scene(n: int = 8, channels: int = 1) -> np.ndarray:
    """Both images of n transitions, white, with an arm of two tones in both views."""
    images = np.full((2, n, channels, 84, 84), 255, np.uint8)
    images[..., 10:30, 40:46] = 120
    images[..., 52:72, 20:26] = 90
    return images


def labels(n: int) -> np.ndarray:
    return np.full((n, 2, 2), 10.0, np.float32)


def change(images: np.ndarray, layout: Layout = STACK, seed: int = 0, **settings: Any) -> np.ndarray:
    augmentation = ImageAugmentation.of({**NOTHING, "gain": [1, 1], "probability": 1.0, **settings})
    return augmentation.change(images, labels(images.shape[1]), layout, np.random.default_rng(seed))[0]


def change_all(seed: int) -> np.ndarray:
    return ImageAugmentation().change(scene(), labels(8), STACK, np.random.default_rng(seed))[0]


def test_without_any_change_images_stay_as_they_are() -> None:
    np.testing.assert_array_equal(change(scene()), scene())


def test_the_given_arrays_are_not_written_on() -> None:
    images, offsets = scene(), labels(8)
    ImageAugmentation().change(images, offsets, STACK, np.random.default_rng(0))
    np.testing.assert_array_equal(images, scene())
    np.testing.assert_array_equal(offsets, labels(8))


def test_the_same_generator_gives_the_same_images_and_another_one_others() -> None:
    np.testing.assert_array_equal(change_all(0), change_all(0))
    assert not np.array_equal(change_all(0), change_all(1))


def test_every_image_is_changed_by_itself() -> None:
    changed = change_all(0).reshape(16, -1)
    assert len({image.tobytes() for image in changed}) == len(changed)


@pytest.mark.parametrize("layout", [STACK, Layout(views_in_channels=True)])
def test_a_lost_cameras_view_stays_black(layout: Layout) -> None:
    images = scene().reshape(2, 8, 2, 42, 84) if layout.views_in_channels else scene()
    views = images.reshape(2, 8, 2, 42, 84)
    views[:, ::2, 1] = 0
    changed = ImageAugmentation().change(images, labels(8), layout, np.random.default_rng(0))[0]
    found = changed.reshape(2, 8, 2, 42, 84)
    assert not found[:, ::2, 1].any()
    assert found[:, 1::2, 1].any(axis=(2, 3)).all() and found[:, :, 0].any(axis=(2, 3)).all()


def test_a_background_is_drawn_where_it_was_white_and_nowhere_else() -> None:
    changed = change(scene(), background=1.0)
    arm = scene() < WHITE
    np.testing.assert_array_equal(changed[arm], scene()[arm])
    assert (changed[~arm] != 255).mean() > 0.8


def test_a_tone_is_of_the_links_alone() -> None:
    images = scene()
    images[..., 20, 50] = 30  # a marker
    changed = change(images, tone=1.0)
    arm = (images < WHITE) & (images > 80)
    np.testing.assert_array_equal(changed[~arm], images[~arm])
    assert (changed[arm] != images[arm]).mean() > 0.9


def test_each_view_has_a_light_of_its_own() -> None:
    changed = change(scene(), gain=[0.5, 0.9])
    ratios = changed[..., 0, 15, 42] / 120, changed[..., 0, 60, 22] / 90
    for ratio in ratios:
        assert ((ratio >= 0.48) & (ratio <= 0.9)).all()
    assert np.abs(ratios[0] - ratios[1]).max() > 0.05


def test_views_are_shifted_and_none_into_another() -> None:
    images = scene()
    images[..., 35:42, :] = 10  # the edge between the views
    changed = change(images, shift=3).reshape(16, 2, 42, 84)
    for image, original in zip(changed, images.reshape(16, 2, 42, 84), strict=True):
        for view, was in zip(image, original, strict=True):
            assert any(
                np.array_equal(view[6:-6, 6:-6], was[6 + down : 36 + down, 6 + right : 78 + right])
                for down in range(-3, 4)
                for right in range(-3, 4)
            )
        assert image[1].min() == 90


def test_zoom_scales_views_and_offsets_alike_and_both_images_of_a_transition() -> None:
    dots = np.full((2, 8, 1, 84, 84), 255, np.uint8)
    dots[..., 15:19, 35:39] = dots[..., 15:19, 55:59] = 0
    dots[..., 57:61, 35:39] = dots[..., 57:61, 55:59] = 0
    augmentation = ImageAugmentation.of({**NOTHING, "gain": [1, 1], "zoom": 0.2})
    images, offsets = augmentation.change(dots, labels(8), STACK, np.random.default_rng(0))
    np.testing.assert_array_equal(images[0], images[1])
    assert 0.8 <= offsets.min() / 10 < 0.9 and 1.1 < offsets.max() / 10 <= 1.2
    for image, offset in zip(images[1, :, 0], offsets, strict=True):
        for view, zoomed in zip(image.reshape(2, 42, 84), offset, strict=True):
            dark = (255.0 - view).sum(axis=0)
            centres = [np.average(np.arange(84)[half], weights=dark[half]) for half in (slice(46), slice(46, None))]
            np.testing.assert_allclose(centres[1] - centres[0], 20 * zoomed[0] / 10, atol=0.3)


@pytest.mark.parametrize("name", ["noise", "offset", "patches"])
def test_each_setting_changes_something(name: str) -> None:
    assert not np.array_equal(change(scene(), **{name: 2}), scene())


def test_noise_is_no_stronger_than_its_limit() -> None:
    grey = np.full((2, 16, 1, 84, 84), 128, np.uint8)
    spread = (change(grey, noise=20).astype(float) - 128).std(axis=(2, 3, 4))
    assert spread.max() < 21 and spread.min() < 5 < spread.max()


def test_views_in_channels_are_changed_like_views_in_rows() -> None:
    settings = {"background": 0.5, "gain": [0.5, 1], "shift": 2, "zoom": 0.1, "patches": 2}
    channels = change(scene().reshape(2, 8, 2, 42, 84), Layout(views_in_channels=True), **settings)
    rows = change(scene(), **settings)
    np.testing.assert_array_equal(channels.reshape(rows.shape), rows)


def test_a_marker_map_is_moved_with_the_view_and_nothing_else() -> None:
    images = scene(channels=2)
    images[:, :, 1] = 128
    images[:, :, 1, 20, 40] = images[:, :, 1, 60, 20] = 255
    layout = Layout(marker_map=True)
    changed = change(images, layout, background=1.0, tone=0.5, gain=[0.5, 0.9], offset=9, noise=20, patches=2)
    np.testing.assert_array_equal(changed[:, :, 1], images[:, :, 1])
    assert not np.array_equal(changed[:, :, 0], images[:, :, 0])
    assert not np.array_equal(change(images, layout, shift=3)[:, :, 1], images[:, :, 1])


def test_a_share_of_the_transitions_is_changed() -> None:
    images, augmentation = scene(400), ImageAugmentation(noise=50.0)
    changed, offsets = augmentation.change_some(images, labels(400), 0.3, STACK, np.random.default_rng(0))
    same = [[np.array_equal(*pair) for pair in zip(*moment, strict=True)] for moment in zip(changed, images)]
    kept = np.array(same).all(axis=0)
    assert 0.62 < kept.mean() < 0.8
    np.testing.assert_array_equal(offsets[kept], labels(400)[kept])


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
            "unknown setting 'blur' of augmentation; choices are share, begin, end, background, tone, gain, offset, "
            "noise, shift, zoom, patches, probability",
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
