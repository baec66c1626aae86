"""Drawn camera images of both markers among skin, lips and clothes, with the true centroids; no photograph is needed.

The skin tones are the ten of the Monk scale (skintone.google, 2022) and six of the Fitzpatrick scale as emoji use them
(Unicode TR 51), and two flushed ones.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]  # RGB, (height, width, 3)
Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]
Colour = tuple[int, int, int]

WIDTH, HEIGHT = 640, 480  # of the camera image, twice a rendered frame's
SCALE = 2  # camera pixels per pixel of a frame

MONK = "f6ede4 f3e7db f7ead0 eadaba d7bd96 a07e56 825c43 604134 3a312a 292420"
FITZPATRICK = "f7dece f3d2a2 d5ab88 af7e57 7c533e c68642"
FLUSHED = "dc7864 c86450"
SKINS: tuple[Colour, ...] = tuple(
    (int(tone[:2], 16), int(tone[2:4], 16), int(tone[4:], 16)) for tone in f"{MONK} {FITZPATRICK} {FLUSHED}".split()
)
LIPS: tuple[Colour, ...] = ((178, 96, 92), (168, 62, 70), (190, 30, 50), (150, 15, 40))
CLOTHES: tuple[Colour, ...] = (
    (60, 80, 140),
    (35, 55, 110),
    (21, 96, 189),
    (110, 150, 210),
    (150, 40, 50),
    (140, 90, 60),
)
REDS: tuple[Colour, ...] = ((225, 20, 20), (200, 38, 42), (175, 15, 30))
BLUES: tuple[Colour, ...] = ((20, 30, 205), (25, 60, 190), (10, 45, 160))


BACKGROUNDS = ("white wall", "wood", "grey room")


class Scene(NamedTuple):
    """A camera image, and where the visible part of each marker is."""

    image: Image
    markers: Floats  # (2, 2): red and blue, (x, y) in [px] of the frame


class Canvas:
    """An image that is painted layer by layer, and what is left to see of each marker.

    Args:
        background: RGB, (height, width, 3).
        rng: Draws shades.
    """

    def __init__(self, background: Floats, rng: np.random.Generator) -> None:
        self.pixels, self.rng = background, rng
        self.markers: list[Mask] = []

    def paint(self, mask: Mask, colour: Colour, shading: float = 0.25) -> None:
        """Paint a surface whose shade falls off in a random direction by up to `shading`."""
        angle = self.rng.uniform(0, 2 * np.pi)
        rows, columns = np.nonzero(mask)
        if not len(rows):
            return
        along = np.cos(angle) * columns + np.sin(angle) * rows
        fall = (along - along.min()) / max(float(np.ptp(along)), 1.0)
        self.pixels[rows, columns] = np.array(colour) * (1 - shading * fall)[:, None]
        for marker in self.markers:
            marker[mask] = False

    def ball(self, centre: Floats, radius: float, colour: Colour) -> None:
        """Paint a marker: a matt ball with light from above and a small highlight; no radius, no marker."""
        if not radius:
            self.markers.append(np.zeros((HEIGHT, WIDTH), bool))
            return
        rows, columns = np.mgrid[:HEIGHT, :WIDTH]
        across, down = (columns - centre[0]) / radius, (rows - centre[1]) / radius
        inside = across**2 + down**2 <= 1
        towards = np.sqrt(np.clip(1 - across**2 - down**2, 0, 1))
        lit = np.clip(0.45 + 0.55 * (0.3 * across - 0.5 * down + 0.81 * towards), 0, 1)[inside, None]
        self.pixels[inside] = np.array(colour) * lit + 60 * np.clip(lit - 0.93, 0, 1) / 0.07
        self.markers.append(inside)


def ellipse(centre: Any, axes: tuple[float, float], angle: float = 0.0) -> Mask:
    """Where an ellipse is: half axes in [px], angle in degrees."""
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    box = ((float(centre[0]), float(centre[1])), (2 * axes[0], 2 * axes[1]), angle)
    cv2.ellipse(mask, box, 1, cv2.FILLED)
    return mask.astype(bool)


def stroke(start: Any, end: Any, width: float) -> Mask:
    """Where a thick line with round ends is."""
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    first, last = (tuple(round(float(value)) for value in point) for point in (start, end))
    cv2.line(mask, first, last, 1, max(2, round(width)))
    return mask.astype(bool)


def face(canvas: Canvas, centre: Any, size: float, skin: Colour) -> None:
    """Paint a face with hair, eyes and lips; `size` is half its height in [px]."""
    dark, red = (45, 32, 26), LIPS[canvas.rng.integers(len(LIPS))]
    x, y = centre
    canvas.paint(ellipse((x, y - 0.25 * size), (0.85 * size, size)), dark)
    canvas.paint(ellipse(centre, (0.72 * size, size)), skin)
    for side in (-1, 1):
        canvas.paint(ellipse((x + 0.4 * side * size, y + 0.25 * size), (0.2 * size, 0.18 * size)), _flushed(skin))
        canvas.paint(ellipse((x + 0.3 * side * size, y - 0.2 * size), (0.12 * size, 0.06 * size)), dark)
    canvas.paint(ellipse((x, y + 0.5 * size), (0.27 * size, 0.1 * size)), red)


def hand(canvas: Canvas, centre: Any, size: float, skin: Colour) -> None:
    """Paint a hand with four fingers and a thumb; `size` is its palm's width in [px]."""
    size *= 0.5
    turn = canvas.rng.uniform(-0.6, 0.6)
    canvas.paint(ellipse(centre, (size, 1.1 * size)), skin)
    for angle in (-0.45, -0.15, 0.15, 0.45, 1.2):
        direction = np.array([np.sin(angle + turn), -np.cos(angle + turn)])
        canvas.paint(stroke(centre + 0.8 * size * direction, centre + 2.2 * size * direction, 0.42 * size), skin)


def _flushed(skin: Colour) -> Colour:
    return skin[0], round(0.84 * skin[1]), round(0.86 * skin[2])


def _background(name: str, rng: np.random.Generator) -> Any:
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    light = (1 - 0.15 * columns / WIDTH * rng.uniform(0, 1))[:, :, None]
    if name == "white wall":
        return np.array([250.0, 250.0, 248.0]) * light
    if name == "grey room":
        return np.array([120.0, 122.0, 125.0]) * light + 100 * (rows < 60)[:, :, None]
    grain = 0.5 + 0.5 * np.sin(rows / 9 + 2 * np.sin(columns / 130) + rng.uniform(0, 6))
    wood = np.array([(205, 160, 110), (170, 115, 70), (120, 75, 45)][rng.integers(3)], float)
    return wood * (1 - 0.2 * grain)[:, :, None] * light


def _places(rng: np.random.Generator, room: Sequence[float]) -> list[Floats]:
    """Points that keep the given distances [px] from each other; the first two lie in the middle of the image."""
    while True:
        points = [rng.uniform((70, 60), (WIDTH - 70, HEIGHT - 60)) for _ in room]
        if all(np.hypot(*(points[i] - points[j])) > room[i] + room[j] for i in range(len(room)) for j in range(i)):
            return points


def arm(canvas: Canvas, place: Floats, size: float, skin: Colour) -> None:
    """Paint a bare arm that comes in from below."""
    canvas.paint(stroke(place, place + np.array([canvas.rng.uniform(-80, 80), HEIGHT]), 0.8 * size), skin)


def crop_of_skin(canvas: Canvas, place: Floats, size: float, skin: Colour) -> None:
    """Paint a square or a round patch of skin."""
    canvas.paint(ellipse(place, (size, size)) if canvas.rng.random() < 0.5 else square(place, size), skin)


def lips(canvas: Canvas, place: Floats, size: float, skin: Colour) -> None:
    """Paint nothing but lips, with lipstick or without."""
    mask = ellipse(place, (0.35 * size, 0.14 * size), canvas.rng.uniform(-20, 20))
    canvas.paint(mask, LIPS[canvas.rng.integers(len(LIPS))])


def clothes(canvas: Canvas, place: Floats, size: float, skin: Colour) -> None:
    """Paint a piece of cloth: jeans, shirts, leather."""
    canvas.paint(square(place, 1.1 * size), CLOTHES[canvas.rng.integers(len(CLOTHES))], 0.4)


def nobody(canvas: Canvas, place: Floats, size: float, skin: Colour) -> None:
    """Paint nothing."""


HELD = "hand holds the marker"
COMPANY: dict[str, Callable[[Canvas, Floats, float, Colour], None]] = {
    "nobody": nobody,
    "face": face,
    "hand": hand,
    HELD: nobody,
    "arm": arm,
    "crop of skin": crop_of_skin,
    "lips": lips,
    "clothes": clothes,
}


def _hold(canvas: Canvas, centre: Floats, radius: float, skin: Colour, ball: Callable[[], None]) -> None:
    """Paint a hand behind a marker, the marker, and two finger tips in front of it."""
    hand(canvas, centre + np.array([0, 1.4 * radius]), 2.2 * radius, skin)
    ball()
    for side in (-1, 1):
        tip = centre + radius * np.array([0.75 * side, 0.2])
        canvas.paint(stroke(tip + radius * np.array([0.3 * side, 1.3]), tip, 0.35 * radius), skin)


def draw_scene(
    company: str,
    background: str,
    rng: np.random.Generator,
    covered: float = 0.0,
    visible: tuple[bool, bool] = (True, True),
) -> Scene:
    """Draw a red and a blue marker and who else is in view.

    Args:
        company: One of `COMPANY`.
        background: One of `BACKGROUNDS`.
        rng: Draws places, sizes and colours.
        covered: How much of each marker's width is behind a grey bar, 0 to 1.
        visible: Whether the red and the blue marker are there at all.
    """
    canvas = Canvas(_background(background, rng), rng)
    skin, radius = SKINS[rng.integers(len(SKINS))], rng.uniform(11, 20)
    size = rng.uniform(1.0, 5.0) * radius
    *centres, place = _places(rng, (1.6 * radius, 1.6 * radius, min(1.3 * size, 110)))
    COMPANY[company](canvas, place, size, skin)
    for centre, colours, there in zip(centres, (REDS, BLUES), visible, strict=True):
        ball = partial(canvas.ball, centre, radius if there else 0.0, colours[rng.integers(len(colours))])
        if company == HELD:
            _hold(canvas, centre, radius, skin, ball)
        else:
            ball()
    if covered:
        for centre in centres:
            canvas.paint(square(centre + np.array([2 * radius * (1 - covered), 0]), radius), (90, 90, 95))
    image = np.asarray(np.clip(np.rint(canvas.pixels), 0, 255), np.uint8)
    return Scene(image, np.array([_centroid(marker) for marker in canvas.markers]))


def square(centre: Any, half: float) -> Mask:
    """Where an upright square is: its half side in [px]."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    return np.asarray((np.abs(columns - centre[0]) <= half) & (np.abs(rows - centre[1]) <= half), np.bool_)


def _centroid(marker: Mask) -> Floats:
    rows, columns = np.nonzero(marker)
    where = np.array([columns.mean(), rows.mean()]) if len(rows) else np.full(2, np.nan)
    return (where + 0.5) / SCALE - 0.5
