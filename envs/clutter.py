"""Things around the arm that belong to no task: boxes, cylinders and balls."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.cameras import CameraSpec

Floats = NDArray[np.float64]

SIZES = (0.03, 0.12)  # [m], half of what a thing measures
GOLDEN = 0.618  # spreads the sizes evenly, however many things there are
RADIUS, HEIGHT = 1.2, 0.9  # [m], around and above the base
CLEAR = 0.09  # [m] around the target that stay visible
MAX_DRAWS = 50  # of a place that is not before the target
AWAY, UPRIGHT = (0.0, 0.0, -100.0), (0.0, 0.0, 0.0, 1.0)  # where things are that are not needed
KINDS = ("box", "cylinder", "sphere")


@dataclass(frozen=True)
class Item:
    """One thing.

    Attributes:
        number: Which of the scene's it is: that says its shape and its size.
        position: Of its middle, in [m], world.
        orientation: A quaternion (x, y, z, w).
        colour: Red, green, blue, from 0 to 1.
    """

    number: int
    position: tuple[float, ...]
    orientation: tuple[float, ...]
    colour: tuple[float, ...]


def size_of(number: int, sizes: tuple[float, float] = SIZES) -> float:
    """Half of a thing's extent, in [m], of those that there are."""
    return sizes[0] + (sizes[1] - sizes[0]) * (number * GOLDEN % 1.0)


def draw_look(rng: np.random.Generator) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """A random orientation, and a colour near a grey."""
    quaternion, grey = rng.standard_normal(4), rng.uniform(0.1, 0.9)
    colour = np.clip(grey + rng.uniform(-0.15, 0.15, 3), 0.0, 1.0)
    return tuple((quaternion / np.linalg.norm(quaternion)).tolist()), tuple(colour.tolist())


def draw_place(rng: np.random.Generator) -> Floats:
    """A random place around the arm, shape (3,), in [m], world."""
    angle, out = rng.uniform(0, 2 * np.pi), RADIUS * np.sqrt(rng.random())
    return np.array([out * np.cos(angle), out * np.sin(angle), rng.uniform(0.0, HEIGHT)])


class Shape(NamedTuple):
    """A thing's shape: one of `KINDS`, and in [m] the radius, or half a side, across and half the height."""

    kind: str
    across: float
    height: float


def shape_of(number: int, sizes: tuple[float, float] = SIZES) -> Shape:
    """The shape of a thing, of those that there are."""
    size = size_of(number, sizes)
    shapes = Shape("box", size, 1.3 * size), Shape("cylinder", 0.6 * size, 1.5 * size), Shape("sphere", size, size)
    return shapes[number % len(shapes)]


def where_of(items: Sequence[Item], n_things: int) -> list[tuple[tuple[float, ...], tuple[float, ...], Item | None]]:
    """Position, orientation and, if it is shown, the item of each of a scene's things."""
    wanted = {item.number: item for item in items}
    found = [wanted.get(number) for number in range(n_things)]
    return [(AWAY, UPRIGHT, None) if item is None else (item.position, item.orientation, item) for item in found]


def draw_items(
    n: int, n_things: int, rng: np.random.Generator, views: Sequence[CameraSpec], target: Floats
) -> tuple[Item, ...]:
    """Draw where things are, so that they hide the target in no view; one that finds no place is left out.

    Args:
        n: How many.
        n_things: How many there are to choose from.
        rng: Where they are drawn from.
        views: The cameras.
        target: Shape (3,), in [m], world.
    """
    items = []
    for number in rng.permutation(n_things)[:n].tolist():
        position = _draw_place(1.8 * size_of(number) + CLEAR, rng, views, target)
        look = draw_look(rng)
        if position is not None:
            items.append(Item(number, tuple(position.tolist()), *look))
    return tuple(items)


def _draw_place(room: float, rng: np.random.Generator, views: Sequence[CameraSpec], target: Floats) -> Floats | None:
    """A place at least `room`, in [m], beside the line of sight to the target in every view; None if none is found."""
    for _ in range(MAX_DRAWS):
        place = draw_place(rng)
        gaps = [np.linalg.norm(view.project(place) - view.project(target)) / view.scale for view in views]
        if min(gaps) >= room:
            return place
    return None
