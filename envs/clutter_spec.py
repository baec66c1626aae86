"""Clutter that an arm has to work among, as ranges from which every episode draws it."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field
from pydantic.dataclasses import dataclass

from sb3_stereo.envs.ranges import Range, check_ranges
from sb3_stereo.envs.specs import plain
from sb3_stereo.envs.validation import STRICT, Flag, Quantity, explained, named

Clearance = Annotated[Quantity, Field(ge=0, le=0.3)]

# What a range must stay within.
BOUNDS = {
    "objects": (0.0, 20.0),
    "occluders": (0.0, 20.0),
    "moving": (0.0, 20.0),
    "size": (0.01, 0.3),
    "speed": (0.01, 10.0),
}


@explained("clutter")
@dataclass(frozen=True, config=STRICT)
class ClutterSpec:
    """From what ranges every episode draws its clutter: boxes, cylinders and balls of random greys.

    Each number is drawn uniformly between its ends. What finds no place within `MAX_DRAWS` draws is left out.

    Attributes:
        objects: How many stand around the arm, within 1.2 m of its base.
        occluders: How many stand out of its reach, before a random camera, and hide the end effector or a joint at some
            pose of the way to the target.
        moving: How many move to and fro on a line of 0.6 to 2 m, before or behind the arm as a camera sees it, out of
            its reach. They touch nothing.
        size: Half of a thing's extent, in [m].
        speed: Of what moves, in [m/s].
        clearance: Least distance of what does not move from the arm at the start of an episode, and on the straight way
            in joint angles from there to a pose with the end effector at the target, in [m].
        solid: Whether the arm collides with objects and occluders.

    Raises:
        ValueError: If a range is empty or reaches beyond what it can be.
    """

    objects: Range = (3, 6)
    occluders: Range = (1, 2)
    moving: Range = (1, 2)
    size: Range = (0.03, 0.12)
    speed: Range = (0.1, 0.4)
    clearance: Clearance = 0.05
    solid: Flag = True

    def __post_init__(self) -> None:
        check_ranges(self, "clutter", BOUNDS)

    @property
    def n_still(self) -> int:
        """Largest number of things that do not move."""
        return round(self.objects[1]) + round(self.occluders[1])

    @property
    def n_things(self) -> int:
        """Largest number of things."""
        return self.n_still + round(self.moving[1])


CLUTTERS = {"default": ClutterSpec()}


def clutter_spec(values: ClutterSpec | Mapping[str, Any] | str | None) -> ClutterSpec | None:
    """Return clutter that is given as itself, a map of its fields, or by a name in `CLUTTERS`.

    Raises:
        ValueError: If there is none, or a field is wrong.
    """
    return None if values is None else named(ClutterSpec, values, CLUTTERS, "clutter", "clutters")


def plain_clutter(values: Any) -> Any:
    """The same as a map of all fields, for a record."""
    spec = clutter_spec(values)
    return None if spec is None else plain(spec)
