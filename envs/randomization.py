"""Domain randomisation: ranges from which every episode draws its light, sensors, cameras, arm and surroundings."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass

from sb3_stereo.envs.cameras import CameraSpec
from sb3_stereo.envs.clutter import draw_items
from sb3_stereo.envs.light import Light
from sb3_stereo.envs.ranges import Probability, Range, check_ranges
from sb3_stereo.envs.sensor import Sensor, draw_picture, floor_pattern
from sb3_stereo.envs.specs import plain
from sb3_stereo.envs.validation import STRICT, explained, named
from sb3_stereo.envs.variation import Variation

Floats = NDArray[np.float64]

MAX_DARK, MAX_LIGHT = 0.2, 0.9  # of the greys that links and floor are painted in
TINT = 0.08  # by how much each channel of a paint differs from its grey; more could be a marker's colour


# What a range must stay within; all others begin at 0.
BOUNDS = {
    "ambient": (0.0, 1.0),
    "light_angle": (0.0, math.pi),
    "shadow": (0.0, 1.0),
    "exposure": (0.01, 10.0),
    "colour_cast": (0.0, 1.0),
    "noise": (0.0, 255.0),
    "blur": (0.0, 50.0),
    "compression": (0.0, 99.0),
    "shift": (0.0, 100.0),
    "dead_pixels": (0.0, 1.0),
    "patches": (0.0, 100.0),
    "camera_rotation": (0.0, math.pi),
    "field_of_view": (0.1, 3.0),
    "effort": (0.0, 10.0),
    "damping": (0.0, 10.0),
    "mass": (0.1, 10.0),
    "gravity": (0.0, 1.0),
    "link_colours": (0.0, 1.0),
    "clutter": (0.0, 20.0),
}


@explained("randomize")
@dataclass(frozen=True, config=STRICT)
class Randomization:
    """What differs from episode to episode. The defaults change nothing.

    A range is (lowest, highest), or one number for both; each is drawn uniformly, for every camera, joint or link by
    itself where it belongs to one.

    Attributes:
        ambient: Share of the light that comes from everywhere; the rest comes from one direction.
        light_angle: By which that direction is turned about a random axis, in [rad].
        shadow: Share of the light that a drawn floor loses in the shadow of what is above it.
        exposure: Factor of a camera's brightness.
        colour_cast: Largest share by which each colour of a camera is brighter or darker.
        noise: Standard deviation of the noise of a frame's pixels, of 255.
        blur: Standard deviation of a frame's blur, in [px].
        compression: Loss of JPEG, 100 less its quality; 0 leaves it out.
        shift: Of all frames alike in a random direction, in [px].
        dead_pixels: Share of a frame's pixels that are black.
        patches: Number of grey patches before each lens, rounded; each covers up to a fifth of a frame's width.
        camera_position: Distance by which a camera is moved in a random direction, in [m].
        camera_rotation: Angle by which it is turned about a random axis, in [rad].
        field_of_view: Factor of a camera's.
        effort: Factor of a joint's effort limit.
        damping: Factor of a joint's damping.
        friction: Dry friction of a joint, in [N m].
        mass: Factor of a link's mass and inertia.
        gravity: Share of the weight that is not compensated.
        latency: Time in which an action has no effect yet, in [s], of its pulse.
        link_colours: How far a link's colour is from its own to a random grey, 0 to 1.
        floor: Probability that the floor is drawn, in a random grey.
        floor_pattern: Probability that a floor that is drawn has a pattern: tiles, planks or spots.
        background: Probability that a camera sees a picture in place of white.
        clutter: Number of boxes, cylinders and balls around the arm, rounded. They stand nowhere before the target
            and touch nothing.

    Raises:
        ValueError: If a range is empty or reaches beyond what it can be.
    """

    ambient: Range = (0.75, 0.75)
    light_angle: Range = (0.0, 0.0)
    shadow: Range = (0.0, 0.0)
    exposure: Range = (1.0, 1.0)
    colour_cast: Range = (0.0, 0.0)
    noise: Range = (0.0, 0.0)
    blur: Range = (0.0, 0.0)
    compression: Range = (0.0, 0.0)
    shift: Range = (0.0, 0.0)
    dead_pixels: Range = (0.0, 0.0)
    patches: Range = (0.0, 0.0)
    camera_position: Range = (0.0, 0.0)
    camera_rotation: Range = (0.0, 0.0)
    field_of_view: Range = (1.0, 1.0)
    effort: Range = (1.0, 1.0)
    damping: Range = (1.0, 1.0)
    friction: Range = (0.0, 0.0)
    mass: Range = (1.0, 1.0)
    gravity: Range = (0.0, 0.0)
    latency: Range = (0.0, 0.0)
    link_colours: Range = (0.0, 0.0)
    floor: Probability = 0.0
    floor_pattern: Probability = 0.0
    background: Probability = 0.0
    clutter: Range = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_ranges(self, "randomize", BOUNDS)

    @property
    def n_things(self) -> int:
        """Of which the clutter is chosen: as many as it can be, and at least all shapes."""
        return max(3, round(self.clutter[1])) if self.clutter[1] else 0

    def draw(self, rng: np.random.Generator, views: Sequence[CameraSpec], n_joints: int, n_links: int) -> Variation:
        """Draw one episode's world, without clutter, whose place depends on the target's.

        Args:
            rng: Where all draws come from.
            views: The cameras as they are meant to be.
            n_joints: Actuated joints.
            n_links: Links of the arm besides its base.
        """
        moved = tuple(self._move(view, rng) for view in views)
        shift = rng.uniform(*self.shift) * _direction(rng, 2)
        floor = bool(rng.random() < self.floor)
        pattern = int(rng.integers(2**31)) if rng.random() < self.floor_pattern else None
        return Variation(
            light=self._draw_light(rng),
            views=moved,
            sensors=tuple(self._draw_sensor(view, shift, pattern, rng) for view in moved),
            effort=rng.uniform(*self.effort, n_joints),
            damping=rng.uniform(*self.damping, n_joints),
            friction=rng.uniform(*self.friction, n_joints),
            mass=rng.uniform(*self.mass, n_links),
            gravity=float(rng.uniform(*self.gravity)),
            latency=float(rng.uniform(*self.latency)),
            paint=_greys(rng, n_links + 1),
            painted=rng.uniform(*self.link_colours, n_links + 1),
            floor=_greys(rng, 1)[0] if floor else None,
            clutter=(),
        )

    def add_clutter(self, variation: Variation, rng: np.random.Generator, target: Floats) -> Variation:
        """Draw an episode's clutter.

        Args:
            variation: The episode's world.
            rng: Where all draws come from.
            target: Position of the target, shape (3,), in [m], world.
        """
        items = draw_items(round(rng.uniform(*self.clutter)), self.n_things, rng, variation.views, target)
        return replace(variation, clutter=items)

    def _draw_light(self, rng: np.random.Generator) -> Light:
        ambient, angle = float(rng.uniform(*self.ambient)), rng.uniform(*self.light_angle)
        direction = _turned(np.array(Light().direction), angle, _direction(rng, 3))
        return Light(ambient, tuple(direction.tolist()), float(rng.uniform(*self.shadow)))

    def _move(self, view: CameraSpec, rng: np.random.Generator) -> CameraSpec:
        """A camera out of its place."""
        step = rng.uniform(*self.camera_position) * _direction(rng, 3)
        angle, axis = rng.uniform(*self.camera_rotation), _direction(rng, 3)
        position = np.array(view.position) + step
        sight, up = (_turned(np.array(way), angle, axis) for way in (np.subtract(view.target, view.position), view.up))
        return replace(
            view,
            position=tuple(position.tolist()),
            target=tuple((position + sight).tolist()),
            up=tuple(up.tolist()),
            horizontal_fov=min(view.horizontal_fov * float(rng.uniform(*self.field_of_view)), 3.0),
        )

    def _draw_sensor(self, view: CameraSpec, shift: Floats, pattern: int | None, rng: np.random.Generator) -> Sensor:
        size = view.height, view.width
        cast = rng.uniform(*self.colour_cast) * rng.uniform(-1.0, 1.0, 3)
        n_patches = round(rng.uniform(*self.patches))
        return Sensor(
            gains=rng.uniform(*self.exposure) * (1.0 + cast),
            noise=float(rng.uniform(*self.noise)),
            blur=float(rng.uniform(*self.blur)),
            compression=round(rng.uniform(*self.compression)),
            shift=(round(shift[0]), round(shift[1])),
            dead_pixels=float(rng.uniform(*self.dead_pixels)),
            patches=tuple(_patch(size, rng) for _ in range(n_patches)),
            background=draw_picture(size, rng) if rng.random() < self.background else None,
            floor=None if pattern is None else floor_pattern(view, np.random.default_rng(pattern)),
            seed=int(rng.integers(2**31)),
        )


def _patch(size: tuple[int, int], rng: np.random.Generator) -> tuple[int, int, int, int, int]:
    """Top, left, height, width in [px] and grey of a patch."""
    height, width = size
    tall, wide = rng.integers(width // 60 + 1, width // 5 + 2, 2)
    return int(rng.integers(height)), int(rng.integers(width)), int(tall), int(wide), int(rng.integers(256))


def _greys(rng: np.random.Generator, n: int) -> Floats:
    """Colours near grey, shape (n, 3), from 0 to 1."""
    return rng.uniform(MAX_DARK, MAX_LIGHT, (n, 1)) + rng.uniform(-TINT, TINT, (n, 3))


def _direction(rng: np.random.Generator, n: int) -> Floats:
    """A random unit vector, shape (n,)."""
    vector = rng.standard_normal(n)
    return np.asarray(vector / np.linalg.norm(vector))


def _turned(vector: Floats, angle: float, axis: Floats) -> Floats:
    """A vector, shape (3,), turned about a unit axis, angle in [rad] (Rodrigues)."""
    along = axis * (axis @ vector) * (1 - math.cos(angle))
    return np.asarray(vector * math.cos(angle) + np.cross(axis, vector) * math.sin(angle) + along)


# Ranges in use elsewhere, for one's own rig: docs/robustness.md says what each is for.
DEFAULT = Randomization(
    ambient=(0.5, 0.9),
    light_angle=(0.0, 1.0),
    exposure=(0.8, 1.2),
    colour_cast=(0.0, 0.1),
    noise=(0.0, 10.0),
    camera_position=(0.0, 0.025),
    camera_rotation=(0.0, math.radians(1.0)),
    field_of_view=(0.95, 1.05),
    effort=(0.8, 1.2),
    damping=(0.7, 1.3),
    link_colours=(0.0, 0.5),
    background=0.5,
    floor=0.5,
)
RANDOMIZATIONS = {"default": DEFAULT}


def randomization(values: "Randomization | Mapping[str, Any] | str | None") -> Randomization | None:
    """Return a randomisation that is given as itself, a map of its fields, or by a name in `RANDOMIZATIONS`.

    Raises:
        ValueError: If there is none, or a field is wrong.
    """
    return None if values is None else named(Randomization, values, RANDOMIZATIONS, "randomize", "randomisations")


def plain_randomization(values: Any) -> Any:
    """The same as a map of what differs from no randomisation."""
    spec = randomization(values)
    if spec is None:
        return None
    nominal = asdict(Randomization())
    return {name: plain(value) for name, value in asdict(spec).items() if value != nominal[name]}
