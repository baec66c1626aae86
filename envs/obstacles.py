"""Clutter that an arm has to work among: what stands around it, hides it from a camera, or moves past."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.cameras import CameraSpec
from sb3_stereo.envs.clutter import CLEAR, Item, draw_look, draw_place, size_of
from sb3_stereo.envs.clutter_spec import ClutterSpec
from sb3_stereo.envs.kinematics import free_way
from sb3_stereo.envs.simulators import SimulatedArm

Floats = NDArray[np.float64]

MIDDLE = np.array([0.0, 0.0, 0.5])  # [m], world, of the workspace
BEYOND = (1.4, 2.2)  # [m] from there: out of the arm's reach
MAX_HEIGHT = 1.4  # [m], of what moves
PATH = (0.3, 1.0)  # [m], half of its line
DIAGONAL = 1.95  # of a box, in half extents; the other shapes are shorter
MAX_DRAWS = 50  # of a place for one thing


@dataclass(frozen=True)
class Obstacle(Item):
    """One thing, and the line on which it moves to and fro.

    Attributes:
        end: Of the line that begins at its position, in [m], world; None for what does not move.
        speed: In [m/s].
    """

    end: tuple[float, ...] | None = None
    speed: float = 0.0

    def at(self, time: float) -> "Obstacle":
        """The same after so long, in [s]."""
        if self.end is None:
            return self
        along = np.subtract(self.end, self.position)
        lengths = time * self.speed / float(np.linalg.norm(along))
        share = 1.0 - abs(1.0 - lengths % 2.0)  # of its line: 0 at first, 1 at the end, and back
        return replace(self, position=tuple((np.array(self.position) + share * along).tolist()))


class _Draw:
    """Draws what things of an episode could be, without end.

    Args:
        spec: What they are drawn from.
        rng: Where.
        views: The cameras.
        arm: Which occluders hide.
        way: Joint angles that it may have, (n_joints,) each, in [rad].
    """

    def __init__(
        self,
        spec: ClutterSpec,
        rng: np.random.Generator,
        views: Sequence[CameraSpec],
        arm: SimulatedArm,
        way: Sequence[Floats],
    ) -> None:
        self._spec, self._rng, self._views, self._arm, self._way = spec, rng, views, arm, way

    def things(self) -> Iterator[Iterator[Obstacle]]:
        """For every thing of an episode, what it could be."""
        spec, rng = self._spec, self._rng
        n_objects, n_occluders, n_moving = (_drawn(ends, rng) for ends in (spec.objects, spec.occluders, spec.moving))
        still = rng.permutation(spec.n_still).tolist()
        moving = (spec.n_still + rng.permutation(spec.n_things - spec.n_still)).tolist()
        for number in still[:n_objects]:
            yield self._standing(number, lambda: draw_place(rng))
        for number in still[n_objects:][:n_occluders]:
            yield self._standing(number, self._place_before_camera)
        for number in moving[:n_moving]:
            yield self._moving(number)

    def _standing(self, number: int, place: Callable[[], Floats]) -> Iterator[Obstacle]:
        while True:
            yield Obstacle(number, tuple(place().tolist()), *draw_look(self._rng))

    def _moving(self, number: int) -> Iterator[Obstacle]:
        """On a horizontal line past the arm, nowhere nearer than its middle."""
        rng = self._rng
        while True:
            angle, height = rng.uniform(0, 2 * np.pi), rng.uniform(0.0, MAX_HEIGHT)
            outward, along = (np.array([np.cos(a), np.sin(a), 0.0]) for a in (angle, angle + np.pi / 2))
            middle = rng.uniform(*BEYOND) * outward + [0.0, 0.0, height]
            reach = rng.uniform(*PATH) * (1 if rng.random() < 0.5 else -1) * along
            start, end = (tuple((middle + way).tolist()) for way in (-reach, reach))
            yield Obstacle(number, start, *draw_look(rng), end, float(rng.uniform(*self._spec.speed)))

    def _place_before_camera(self) -> Floats:
        """A place out of the arm's reach, between a random camera and what it hides from it, shape (3,)."""
        rng = self._rng
        view, seen, distance = self._views[int(rng.integers(len(self._views)))], self._hidden(), rng.uniform(*BEYOND)
        sight = np.subtract(view.position, seen)
        sight /= np.linalg.norm(sight)
        off = seen - MIDDLE
        along = float(sight @ off)
        return np.asarray(seen + (np.sqrt(max(along**2 - off @ off + distance**2, 0.0)) - along) * sight)

    def _hidden(self) -> Floats:
        """Where the end effector or a joint is at a random pose of the way, each as likely, (3,), in [m], world."""
        self._arm.rest_at(self._way[int(self._rng.integers(len(self._way)))])
        joints = self._arm.chain_positions
        if self._rng.random() < 0.5:
            return self._arm.end_effector_position
        return np.asarray(joints[self._rng.integers(len(joints))])


def draw_obstacles(
    spec: ClutterSpec,
    rng: np.random.Generator,
    views: Sequence[CameraSpec],
    target: Floats,
    arm: SimulatedArm,
    is_near: Callable[[Obstacle, float], bool],
) -> tuple[Obstacle, ...]:
    """Draw an episode's clutter. Nothing hides the target at first, and what does not move never does.

    Args:
        spec: What it is drawn from.
        rng: Where.
        views: The cameras.
        target: Shape (3,), in [m], world.
        arm: At the pose where the episode begins, with no clutter around it; it is left elsewhere.
        is_near: Whether a thing would be within a distance in [m] of the arm where that is.
    """

    def stands_free(one: Obstacle) -> bool:
        for pose in way:
            arm.rest_at(pose)
            if is_near(one, spec.clearance):
                return False
        return True

    way = free_way(arm, target, rng)
    drawn = []
    for candidates in _Draw(spec, rng, views, arm, way).things():
        for _, one in zip(range(MAX_DRAWS), candidates):
            free = one.end is not None or stands_free(one)
            if free and not _hides(one, DIAGONAL * size_of(one.number, spec.size), views, target):
                drawn.append(one)
                break
    return tuple(drawn)


def _hides(one: Obstacle, size: float, views: Sequence[CameraSpec], target: Floats) -> bool:
    """Whether a thing of a size in [m] may be before the target, or too near to it, in any view."""
    place = np.array(one.position)
    for view in views:
        gap = float(np.linalg.norm(view.project(place) - view.project(target)))
        if gap < size * view.scale_at(place) + CLEAR * view.scale_at(target):
            return True
    return False


def _drawn(ends: tuple[float, float], rng: np.random.Generator) -> int:
    low, high = (round(end) for end in ends)
    return int(rng.integers(low, high + 1))
