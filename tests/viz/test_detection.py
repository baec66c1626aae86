"""Markers among people: the vivid and round blob is the marker, however large the others are; doubts are said."""

from collections import Counter
from itertools import product
from typing import Any

import numpy as np
import pytest

from benchmarks.analysis.detection import PHOTOGRAPHS, among_people, pose_frames, verdicts
from benchmarks.analysis.people import BACKGROUNDS, COMPANY, Canvas, draw_scene, square
from sb3_stereo.envs.markers import find_blobs
from sb3_stereo.real_images.detection import detect, white_balanced
from sb3_stereo.real_images.sources import fit

RED, BLUE = (225, 20, 20), (20, 30, 205)
WHERE = np.array([[150.0, 120.0], [450.0, 320.0], [300.0, 200.0]])  # [px] of the camera image


def in_frame(point: Any) -> Any:
    return (np.asarray(point) + 0.5) / 2 - 0.5


def canvas(grey: float = 240.0) -> Canvas:
    return Canvas(np.full((480, 640, 3), grey), np.random.default_rng(0))


def frame(drawn: Canvas) -> Any:
    return fit(np.asarray(np.clip(drawn.pixels, 0, 255), np.uint8), 320, 240)


@pytest.mark.parametrize("company", COMPANY)
def test_a_marker_among_people_is_found_or_said_to_be_undecided(company: str) -> None:
    seen: Counter[str] = Counter()
    for number, (background, disturb) in enumerate(product(BACKGROUNDS, ("none", "webcam"))):
        rng = np.random.default_rng(number)
        scene = draw_scene(company, background, rng, covered=0.4 * (number // 2 % 2))
        seen.update(verdicts(detect(fit(PHOTOGRAPHS[disturb](scene.image, rng), 320, 240)), scene))
    assert seen["wrong"] == seen["missed"] == 0
    assert seen["right"] > seen["undecided"]


@pytest.mark.slow
@pytest.mark.parametrize("company", COMPANY)
def test_a_marker_among_people_is_never_confidently_wrong_on_a_larger_grid(company: str) -> None:
    right, undecided, _, wrong, *_ = map(int, among_people(company, 1))
    assert wrong == 0 and undecided < 0.25 * right


@pytest.mark.parametrize("company", ["nobody", "hand", "arm", "crop of skin"])
def test_where_no_marker_is_skin_is_not_taken_for_one(company: str) -> None:
    for number in range(3):
        scene = draw_scene(company, "white wall", np.random.default_rng(number), visible=(False, False))
        for disturb in (PHOTOGRAPHS["none"], PHOTOGRAPHS["webcam"]):
            found = detect(fit(disturb(scene.image, np.random.default_rng(number)), 320, 240))
            assert np.isnan(found.markers).all() and not any(mask.any() for mask in found.masks)


@pytest.mark.parametrize("size", [20, 60, 120])
@pytest.mark.parametrize("skin", [(220, 120, 100), (224, 172, 105), (141, 85, 36)])
def test_the_vivid_ball_wins_over_skin_of_any_size(size: int, skin: tuple[int, int, int]) -> None:
    drawn = canvas()
    drawn.paint(square((480, 140), size), skin)
    for centre, colour in zip(WHERE, (RED, BLUE)):
        drawn.ball(centre, 17, colour)
    np.testing.assert_allclose(detect(frame(drawn)).markers, in_frame(WHERE[:2]), atol=2)


@pytest.mark.parametrize("colour", [RED, BLUE])
@pytest.mark.parametrize("grey", [90, 240])
def test_between_two_equal_balls_the_marker_is_undecided_and_both_are_named(
    colour: tuple[int, int, int], grey: float
) -> None:
    drawn = canvas(grey)
    for centre, radius in zip(WHERE, (17, 15)):
        drawn.ball(centre, radius, colour)
    found = detect(frame(drawn))
    number = 0 if colour == RED else 1
    assert np.isnan(found.markers[number]).all() and not found.masks[number].any()
    places = sorted(found.undecided[number], key=lambda place: float(place[0]))
    np.testing.assert_allclose(places, in_frame(WHERE[:2]), atol=2)
    assert found.undecided[1 - number] == []


def test_a_marker_cut_in_two_by_something_in_front_is_one_marker() -> None:
    drawn = canvas()
    drawn.ball(WHERE[0], 24, RED)
    drawn.ball(WHERE[1], 24, BLUE)
    for x, y in WHERE[:2]:
        drawn.pixels[int(y) - 4 : int(y) + 4, int(x) - 40 : int(x) + 40] = 90
    found = detect(frame(drawn))
    assert found.undecided == ([], [])
    assert np.abs(np.array(found.markers) - in_frame(WHERE[:2])).max() < 12


def test_a_surface_that_is_not_white_does_not_change_the_markers_colour() -> None:
    drawn = canvas()
    drawn.pixels[:] = (120, 75, 45)  # dark wood all over
    drawn.ball(WHERE[0], 17, (200, 38, 42))
    drawn.ball(WHERE[1], 17, (25, 60, 190))
    np.testing.assert_allclose(detect(frame(drawn)).markers, in_frame(WHERE[:2]), atol=2)
    gains = white_balanced(np.full((4, 4, 3), (120, 75, 45), np.uint8))[0, 0] / (120, 75, 45)
    assert gains.max() < 1.9 * gains.min()


def test_a_rendered_frame_keeps_its_markers() -> None:
    frames = pose_frames(10)
    found = [detect(image) for image in frames]
    assert all(detection.undecided == ([], []) for detection in found)
    moved = np.array([detection.markers for detection in found]) - [find_blobs(image) for image in frames]
    assert np.nanmedian(np.abs(moved)) < 0.1 and np.nanmax(np.abs(moved)) < 2.2 and np.isnan(moved).mean() < 0.1
