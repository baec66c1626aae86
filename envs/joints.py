"""Which joints of an arm are actuated, which follow them, and where the others are held."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.robots import ArmSpec
from sb3_stereo.envs.specs import quoted, require
from sb3_stereo.envs.urdf import Mimic

Floats = NDArray[np.float64]

ROUNDING = 1e-9  # [rad] or [m]


class MovingJoint(NamedTuple):
    """A joint as a simulator knows it; positions are in [rad] or [m]."""

    number: int
    low: float  # lowest position; no limit unless it is below the highest
    high: float
    slides: bool


@dataclass(frozen=True)
class Joints:
    """The moving joints: their positions are gearing @ those of the actuated ones + offsets.

    Attributes:
        moving: As the simulator counts them.
        actuated: In the order of the action.
        geared: Those that mimic an actuated one, as (joint, leader, what it mimics).
        gearing: Shape (n_moving, n_joints).
        offsets: Where the held ones are, shape (n_moving,), in [rad] or [m].
        stops: Lowest and highest positions of the actuated ones and of what follows them, infinite without a limit,
            shape (n_joints, 2), in [rad] or [m].
        sliding: Whether each actuated one slides, and does not turn.
    """

    moving: list[int]
    actuated: list[int]
    geared: list[tuple[int, int, Mimic]]
    gearing: Floats
    offsets: Floats
    stops: Floats
    sliding: tuple[bool, ...]

    @property
    def limits(self) -> Floats:
        """Where poses are drawn: the stops, or a turn without any, shape (n_joints, 2), in [rad] or [m]."""
        turn = np.array((-math.pi, math.pi))
        return np.where(np.isfinite(self.stops).all(axis=1, keepdims=True), self.stops, turn)

    @property
    def actuated_of_moving(self) -> list[int]:
        """Indices of the actuated among the moving joints."""
        return [self.moving.index(joint) for joint in self.actuated]

    @property
    def held(self) -> list[int]:
        """Neither actuated nor geared."""
        led = {*self.actuated, *(joint for joint, _, _ in self.geared)}
        return [joint for joint in self.moving if joint not in led]


def make_joints(spec: ArmSpec, moving: Mapping[str, MovingJoint], mimics: Mapping[str, Mimic]) -> Joints:
    """Sort the moving joints.

    Args:
        spec: The arm.
        moving: The moving joints by name, as the simulator orders them.
        mimics: What the mimic joints among them follow.

    Raises:
        ValueError: If a held joint is outside its limits, or a mimic joint is given another angle.
    """
    names, file = list(moving), quoted(spec.urdf)
    gearing, offsets = np.zeros((len(names), len(spec.joints))), np.zeros(len(names))
    stops, rest, geared = [_stops(moving[name]) for name in spec.joints], dict(spec.rest), []
    for row, (name, joint) in enumerate(moving.items()):
        mimic = mimics.get(name)
        if name in spec.joints:
            way_out = f"put {quoted(mimic and mimic.leader)} in its place"
            require(
                mimic is None, f"joint {quoted(name)} of {file} mimics another, so nothing else moves it; {way_out}"
            )
            gearing[row, spec.joints.index(name)] = 1.0
        elif mimic is not None and mimic.leader in spec.joints:
            what = f"rest has {quoted(name)}, which mimics {quoted(mimic.leader)}"
            require(name not in rest, f"{what}; leave it out, as it follows by itself")
            leader = spec.joints.index(mimic.leader)
            gearing[row, leader], offsets[row] = mimic.multiplier, mimic.offset
            stops[leader] = _narrowed(stops[leader], mimic, joint, name)
            geared.append((joint.number, moving[mimic.leader].number, mimic))
        else:
            offsets[row] = _held_at(name, mimic, rest)
            _check_rest(name, float(offsets[row]), joint, mimic, given=name in rest)
    return Joints(
        moving=[joint.number for joint in moving.values()],
        actuated=[moving[name].number for name in spec.joints],
        geared=geared,
        gearing=gearing,
        offsets=offsets,
        stops=np.array(stops),
        sliding=tuple(moving[name].slides for name in spec.joints),
    )


def _stops(joint: MovingJoint) -> tuple[float, float]:
    """Lower and upper limit of a joint, infinite without one."""
    return (joint.low, joint.high) if joint.low < joint.high else (-math.inf, math.inf)


def _narrowed(stops: tuple[float, float], mimic: Mimic, joint: MovingJoint, name: str) -> tuple[float, float]:
    """Stops of a joint that keep what mimics it inside its own."""
    if mimic.multiplier == 0.0:
        return stops
    low, high = sorted((bound - mimic.offset) / mimic.multiplier for bound in _stops(joint))
    both = max(low, stops[0]), min(high, stops[1])
    leader = f"joint {quoted(mimic.leader)} has no position in its limits that"
    require(both[0] < both[1], f"{leader} puts {quoted(name)}, which mimics it, into its own; check both")
    return both


def _held_at(name: str, mimic: Mimic | None, rest: Mapping[str, float]) -> float:
    if mimic is None:
        return rest.get(name, 0.0)
    position = mimic.multiplier * rest.get(mimic.leader, 0.0) + mimic.offset
    angle = rest.get(name, position)
    what = f"rest has {quoted(name)} at {angle:g}, which mimics {quoted(mimic.leader)} and so is at {position:g}"
    require(abs(angle - position) <= ROUNDING, f"{what}; leave it out")
    return position


def _check_rest(name: str, position: float, joint: MovingJoint, mimic: Mimic | None, given: bool) -> None:
    """A simulator would push a joint into its limits, and the arm with it."""
    low, high = joint.low, joint.high
    limited = low < high or low == high != 0.0
    if limited and not low - ROUNDING <= position <= high + ROUNDING:
        by_default = "" if given or mimic else ", as rest does not name it"
        what = f"joint {quoted(name)} is held at {position:g}{by_default}, outside its limits [{low:g}, {high:g}]"
        inside = low if position < low else high
        way_out = f"rest: {{{name}: {inside}}}" if mimic is None else f"another rest of {quoted(mimic.leader)}"
        raise ValueError(f"{what}; give {way_out}")
