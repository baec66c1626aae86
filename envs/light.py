"""Light of the scene."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Light:
    """Light that comes in part from everywhere and in part from one direction, without highlights.

    The default is mostly ambient: tones stay within a quarter of their nominal luminance, so that shells and markers
    stay apart.

    Attributes:
        ambient: Share that comes from everywhere; the rest comes from one direction.
        direction: Where that is, shape (3,), world.
        shadow: Share of the floor's light that is lost in a shadow on it.
    """

    ambient: float = 0.75
    direction: tuple[float, ...] = (1.0, 0.0, 2.0)
    shadow: float = 0.0
