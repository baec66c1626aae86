"""A ball's centre from its rim, against discs that are drawn pixel by pixel, whole and half hidden."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from sb3_stereo.envs.cameras import CLOSE_PAIR
from sb3_stereo.envs.circles import find_circles

Image = NDArray[np.uint8]

RED, BLUE, GREY = (220, 10, 0), (0, 20, 230), (120, 120, 120)
RADII = (4.7, 6.0)  # [px]
BESIDE = np.array([35.0, 0.0])  # [px]
Y, X = np.mgrid[:60, :80]


def blank(channels: int = 3) -> Image:
    return np.full((60, 80, channels), 255, np.uint8)


def disc(frame: Image, centre: NDArray[np.float64], radius: float, colour: tuple[int, int, int]) -> None:
    """A pixel is the disc's if its middle is."""
    frame[(X - centre[0]) ** 2 + (Y - centre[1]) ** 2 <= radius**2, :3] = colour


def far(rng: np.random.Generator) -> NDArray[np.float64]:
    return rng.uniform((15, 15), (30, 45))


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("radius", [3.5, 4.7, 6.0, 10.0])
def test_the_centre_of_a_disc_is_found_to_a_quarter_of_a_pixel(channels: int, radius: float) -> None:
    rng, errors = np.random.default_rng(0), []
    for _ in range(100):
        frame, red, blue = blank(channels), far(rng), far(rng) + BESIDE
        disc(frame, red, radius, RED)
        disc(frame, blue, radius, BLUE)
        blobs = find_circles(frame, (radius, radius))
        errors += [math.dist(blobs.end_effector, red), math.dist(blobs.target, blue)]
    assert np.mean(errors) < 0.12 and max(errors) < 0.3


def test_what_hides_half_a_disc_moves_its_centroid_but_not_its_centre() -> None:
    rng, errors = np.random.default_rng(1), []
    for _ in range(200):
        frame, centre, angle = blank(), far(rng), rng.uniform(0, 2 * np.pi)
        disc(frame, centre, 6.0, BLUE)
        disc(frame, centre + BESIDE, 4.7, RED)
        beyond = (X - centre[0]) * np.cos(angle) + (Y - centre[1]) * np.sin(angle) > rng.uniform(0.5, 4)
        frame[beyond & (X < 45)] = GREY
        errors.append(math.dist(find_circles(frame, RADII).target, centre))
    assert np.mean(errors) < 0.3 and np.quantile(errors, 0.95) < 0.8


def test_a_disc_in_front_of_another_leaves_both_centres_where_they_are() -> None:
    """At every distance from concentric to apart, and so the offset is that of the centres."""
    rng = np.random.default_rng(2)
    for distance in np.linspace(0, 15, 16):
        errors = []
        for _ in range(40):
            frame, centre, angle = blank(), rng.uniform((30, 25), (50, 35)), rng.uniform(0, 2 * np.pi)
            offset = distance * np.array([np.cos(angle), np.sin(angle)])
            disc(frame, centre, 6.0, BLUE)
            disc(frame, centre + offset, 4.7, RED)
            errors.append(math.dist(find_circles(frame, RADII).offset, offset))
        assert np.mean(errors) < 0.3 and max(errors) < 0.9, distance


def test_a_sliver_and_nothing_are_no_marker() -> None:
    frame = blank()
    disc(frame, np.array([30.0, 30.0]), 6.0, BLUE)
    assert (
        np.isnan(find_circles(frame, RADII).end_effector).all() and np.isfinite(find_circles(frame, RADII).target).all()
    )
    frame[:, :36] = GREY
    assert np.isnan(find_circles(frame, RADII).target).all()
    assert np.isnan(np.stack(find_circles(blank(), RADII))).all()


def test_the_mirrored_image_has_the_mirrored_centres() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        frame, red, blue = blank(), far(rng), far(rng) + BESIDE
        disc(frame, red, 4.7, RED)
        disc(frame, blue, 6.0, BLUE)
        mirrored = np.stack(find_circles(np.ascontiguousarray(frame[:, ::-1]), RADII))
        np.testing.assert_allclose(
            np.array([79, 0]) + np.array([-1, 1]) * mirrored, np.stack(find_circles(frame, RADII)), atol=1e-6
        )


def test_the_middle_of_a_balls_image_is_its_centre_as_far_as_a_pixel_tells() -> None:
    """A ball's outline is where the lines of sight touch it; its image is an ellipse."""
    turn = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    for spec in CLOSE_PAIR:
        for centre in np.random.default_rng(4).uniform((-1, -1, 0), (1, 1, 1.3), (50, 3)):
            away = centre - spec.position
            distance, radius = np.linalg.norm(away), 0.045
            basis = np.linalg.svd(away[None])[2][1:]  # across the line of sight
            middle = centre - away * (radius / distance) ** 2
            outline = middle + radius * math.sqrt(1 - (radius / distance) ** 2) * (
                np.stack([np.cos(turn), np.sin(turn)], axis=1) @ basis
            )
            image = spec.project(outline)
            np.testing.assert_allclose((image.min(0) + image.max(0)) / 2, spec.project(centre), atol=0.01)
            assert abs(np.ptp(image, axis=0) / 2 - 6).max() < 1.3  # about 6 px, larger where it is near
