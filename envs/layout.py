"""Which objects an episode has, and where they stand: the target first, then distractors that are not it."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass

from sb3_stereo.envs.cameras import CameraSpec
from sb3_stereo.envs.colours import COLOURS
from sb3_stereo.envs.objects import MODELS, SCALES, SHAPES, PlacedObject
from sb3_stereo.envs.specs import quoted, require, require_known
from sb3_stereo.envs.validation import STRICT, Text, explained, from_map

Floats = NDArray[np.float64]

NEAREST, FARTHEST = 0.40, 0.62  # [m] from the base's axis, where a hand that points down reaches the floor
AZIMUTH = 0.9  # [rad] to either side of the x axis
GAP = 0.06  # [m] between two objects, wide enough for the cup
MAX_DRAWS = 1000
MAX_DISTRACTORS = len(COLOURS) - 1


@explained("target")
@dataclass(frozen=True, config=STRICT)
class Target:
    """Which object is the one to pick up.

    Attributes:
        shape: Of `objects.SHAPES`; None to draw it at every reset.
        colour: Of `colours.COLOURS`; None likewise.

    Raises:
        ValueError: If there is no such object.
    """

    shape: Text | None = None
    colour: Text | None = None

    def __post_init__(self) -> None:
        if self.shape is not None:
            require_known("shape of the target", self.shape, SHAPES, "shapes")
        if self.colour is not None:
            require_known("colour of the target", self.colour, COLOURS, "colours")


def target_of(target: Target | Mapping[str, Any] | None) -> Target:
    """The target that is given as itself, as a map of its fields, or as None for one that is drawn.

    Raises:
        ValueError: If there is no such object.
    """
    if isinstance(target, Target):
        return target
    return Target() if target is None else from_map(Target, target, "target")


def checked_distractors(n: int) -> int:
    """The number of distractors if there can be so many."""
    require(0 <= n <= MAX_DISTRACTORS, f"n_distractors is {quoted(n)}; give 0 to {MAX_DISTRACTORS}, as many as colours")
    return n


def draw_items(
    target: Target,
    n_distractors: int,
    place: Floats | None,
    rng: np.random.Generator,
    views: Sequence[CameraSpec],
) -> tuple[PlacedObject, ...]:
    """Draw the target and the distractors, which hide it in no view.

    No two have the same colour; if the target is known by its shape, no distractor has that either.

    Args:
        target: What is known of the target.
        n_distractors: How many there are besides.
        place: Where the target stands, (2,) in [m]; None to draw that too.
        rng: Where all is drawn from.
        views: The cameras.

    Raises:
        ValueError: If the distractors find no room beside the target.
    """
    colours = _first(list(COLOURS), target.colour, rng)
    shape = str(rng.choice(list(SHAPES))) if target.shape is None else target.shape
    others = [model.shape for model in MODELS if target.shape is None or model.shape != shape]
    numbers = [_number(shape, rng)]
    while len(numbers) <= n_distractors:
        number = _number(str(rng.choice(others)), rng)
        if number not in numbers:  # there is one body of each
            numbers.append(number)
    for _ in range(MAX_DRAWS):
        places = [_draw_place(rng) if n or place is None else place for n in range(len(numbers))]
        if _apart(places, numbers) and not any(_hides(places[0], other, views) for other in places[1:]):
            yaws = rng.uniform(-np.pi, np.pi, len(numbers))
            drawn = zip(numbers, colours, places, yaws, strict=False)
            return tuple(
                PlacedObject(number, colour, (float(x), float(y)), float(yaw)) for number, colour, (x, y), yaw in drawn
            )
    raise ValueError(f"no room for {n_distractors} distractors in {MAX_DRAWS} draws; take fewer, or another place")


def _first(names: list[str], wanted: str | None, rng: np.random.Generator) -> list[str]:
    """The names in a random order, the wanted one first if there is one."""
    shuffled = [str(name) for name in rng.permutation(names)]
    return sorted(shuffled, key=lambda name: name != wanted) if wanted is not None else shuffled


def _number(shape: str, rng: np.random.Generator) -> int:
    """The model of a shape in a size that is drawn."""
    return list(SHAPES).index(shape) * len(SCALES) + int(rng.integers(len(SCALES)))


def _draw_place(rng: np.random.Generator) -> Floats:
    """A place in front of the arm, uniform over the area."""
    out = np.sqrt(rng.uniform(NEAREST**2, FARTHEST**2))
    azimuth = rng.uniform(-AZIMUTH, AZIMUTH)
    return np.array([out * np.cos(azimuth), out * np.sin(azimuth)])


def _apart(places: Sequence[Floats], numbers: Sequence[int]) -> bool:
    """Whether there is room between any two."""
    return all(
        np.linalg.norm(places[i] - places[j]) >= MODELS[numbers[i]].radius + MODELS[numbers[j]].radius + GAP
        for i in range(len(places))
        for j in range(i)
    )


def _hides(target: Floats, other: Floats, views: Sequence[CameraSpec]) -> bool:
    """Whether another object is in front of the target in any view."""
    return any(_in_front(target, other, view) for view in views)


def _in_front(target: Floats, other: Floats, view: CameraSpec) -> bool:
    sight = np.subtract(view.target, view.position)[:2]
    nearer = float((target - other) @ sight) > 0.0
    here, there = (view.project(np.array([*place, 0.06])) for place in (target, other))
    return nearer and bool(abs(here[0] - there[0]) / view.scale < 2 * 0.05)
