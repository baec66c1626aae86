"""Reward and success of the paper, as pure functions of pixel distances.

A distance is `nan` where it is undefined: a view in which the end effector or the target is occluded.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def lengths(offsets: Floats) -> Floats:
    """Lengths of offsets (..., 2), shape (...), nan where undefined; of those from target to end effector, d(t)."""
    return np.asarray(np.hypot(offsets[..., 0], offsets[..., 1]))


def distance_change(previous: Floats, current: Floats, scale: float) -> Floats:
    """Eq. 2: how far the end effector came nearer in each view, normalised to [-1, 1].

    Dividing by one constant (and not by the distance itself) makes the changes of a path add up to the change
    of its ends, so that no cycle earns anything.

    Args:
        previous: d(t-1) per view, shape (..., n_views), in [px], nan where undefined.
        current: d(t) per view, likewise.
        scale: Shift that counts as 1, in [px], positive.

    Returns:
        Changes, shape (..., n_views), nan where either distance is.
    """
    return np.minimum(np.maximum((previous - current) / scale, -1.0), 1.0)  # np.clip takes twice as long


def is_goal(distances: Floats, rho: float, min_views: int | None = None) -> Any:
    """The terminal flag tau (section 3.3): the mean distance over the views that see both markers is at most `rho`.

    Args:
        distances: d(t) per view, shape (..., n_views), in [px].
        rho: Threshold in [px].
        min_views: Fewest defined distances that make a goal; None for all, which is the paper's two.

    Returns:
        Whether it is one, shape (...), bool.
    """
    seen = ~np.isnan(distances)
    n_seen = seen.sum(axis=-1)
    mean = np.where(seen, distances, 0.0).sum(axis=-1) / np.maximum(n_seen, 1)
    return (n_seen >= (distances.shape[-1] if min_views is None else min_views)) & (mean <= rho)


def reward(changes: Floats, goal: bool) -> float:
    """Eq. 3, its cases in the order printed, for any number of views.

    The paper has no case for a step that no view defines: 0. One view undefined and the other one zero is the
    third or fourth case (0), not the second.

    Args:
        changes: Delta d per view of `distance_change`, shape (n_views,).
        goal: tau of `is_goal`.

    Returns:
        A number in [-1, 1].
    """
    if goal:
        return 1.0
    known = changes.tolist()  # so few numbers are faster as Python's
    if not any(known):  # nan is not zero
        return -1.0
    defined = [change for change in known if not math.isnan(change)]
    return sum(defined) / len(defined) if defined else 0.0


@dataclass(frozen=True)
class OffsetReward:
    """The reward of a step, and whether it ends at a goal, from offsets alone: of many transitions, for any target.

    Attributes:
        distance_scale: As `scale` in `distance_change`, in [px].
        rho: As in `is_goal`, in [px] of the success frame.
        success_scale: Pixels of the success frame per pixel of a camera's frame, shape (2,).
        min_views: As in `is_goal`.
    """

    distance_scale: float
    rho: float
    success_scale: Floats
    min_views: int | None = None

    def __call__(self, previous: Floats, current: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Eq. 3 and tau, shape (...) each.

        Args:
            previous: Offsets from target to end effector before the step, shape (..., n_views, 2), in [px], nan where
                undefined.
            current: After it, likewise.
        """
        goals = np.asarray(is_goal(lengths(current * self.success_scale), self.rho, self.min_views))
        changes = distance_change(lengths(previous), lengths(current), self.distance_scale)
        defined = ~np.isnan(changes)
        means = np.where(defined, changes, 0.0).sum(axis=-1) / np.maximum(defined.sum(axis=-1), 1)
        unmoved = (changes == 0.0).all(axis=-1)  # nan is not zero
        return np.where(goals, 1.0, np.where(unmoved, -1.0, means)), goals


def lifting(changes: Floats, rise: float, goal: bool) -> float:
    """Eq. 3 with a height besides: what came nearer in the views, and what was raised.

    Both are changes of quantities that the images have, so the rewards of a path add up to those of its ends: letting
    an object fall costs what raising it earned.

    Args:
        changes: Delta d per view of `distance_change`, shape (n_views,).
        rise: Height that was gained, as a share of what is asked for; nan where undefined.
        goal: Whether the episode has ended with success.

    Returns:
        A number in [-1, 1].
    """
    if goal:
        return 1.0
    if math.isnan(rise):
        return reward(changes, False)
    defined = [change for change in changes.tolist() if not math.isnan(change)]
    if len(defined) == len(changes) and not any(defined) and rise == 0.0:
        return -1.0
    nearer = sum(defined) / len(defined) if defined else 0.0
    return min(max(nearer + rise, -1.0), 1.0)
