"""Two agents, one after the other, as the paper proposes for its future work (section 6).

"We propose to decouple the reaching and grasping parts by training a separate network to perform the grasping task once
the end effector has reached the vicinity of the target."
"""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Frame = NDArray[np.uint8]

NO_MARKER = 128  # of the marker map: above it is the hand, below it the target
FAINT = 6  # by which a pixel must differ from it, a tenth of a pixel that is covered
VIEW = (42, 84)  # rows and columns of a view in the composite
FRAME = (240, 320)  # of a camera's frame, in whose pixels distances are told


class Agent(Protocol):
    """What acts on observations: an agent of Stable-Baselines3."""

    def predict(self, observation: Any, *, deterministic: bool = False) -> tuple[Any, Any]:
        """Return an action for an observation, or one for each of a batch."""


class SwitchedAgent:
    """Lets one agent reach and another one grasp, as the distance in the images says at every step.

    The distance is that of the two markers in the second channel of composite "markers", a mean over the views that
    show both. Nothing is remembered: where the hand has lost the object, it reaches for it again.

    Args:
        reacher: Acts as long as the hand is far, or hidden.
        grasper: Acts where it is near. Both have the observations and actions of `WamStereoPick-v0`.
        near: Largest distance that is near, in [px] of a camera's frame; the environment's `rho`.

    Raises:
        ValueError: If `near` is not positive.
    """

    def __init__(self, reacher: Agent, grasper: Agent, near: float = 30.0) -> None:
        if not near > 0.0:
            raise ValueError(f"near is {near!r}; give a positive number of pixels")
        self.reacher, self.grasper, self.near = reacher, grasper, near

    def predict(
        self, observation: Frame, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """The action of whose turn it is, as in Stable-Baselines3.

        Args:
            observation: Shape (2, 42 * n_views, 84), or a batch of them.
            state: Returned as it is, since neither agent has one.
            episode_start: Not used.
            deterministic: Whether the agents act without noise.

        Raises:
            ValueError: If the observation has no channel of markers.
        """
        near = marker_distances(observation) <= self.near  # nan is not near
        if not near.ndim:
            agent = self.grasper if near else self.reacher
            return agent.predict(observation, deterministic=deterministic)[0], state
        reaching, grasping = (
            agent.predict(observation, deterministic=deterministic)[0] for agent in (self.reacher, self.grasper)
        )
        turns = near.reshape(-1, *[1] * (np.ndim(reaching) - 1))
        return np.where(turns, grasping, reaching), state


def marker_distances(observation: Frame) -> Floats:
    """Distance of hand and target in observations, the mean over the views that show both, in [px] of a frame.

    Args:
        observation: Of composite "markers", (..., 2, 42 * n_views, 84), uint8.

    Returns:
        Shape (...), nan where no view shows both.

    Raises:
        ValueError: If the observation has another shape.
    """
    image = np.asarray(observation)
    rows, columns = VIEW
    if image.ndim < 3 or image.shape[-3] != 2 or image.shape[-2] % rows or image.shape[-1] != columns:
        raise ValueError(f"observations have shape {image.shape}; agents are switched with composite 'markers' only")
    maps = image[..., 1, :, :].astype(np.float64) - NO_MARKER
    views = maps.reshape(*maps.shape[:-2], -1, rows, columns)  # (..., n_views, rows, columns)
    offsets = _centres(views) - _centres(-views)
    lengths = np.hypot(offsets[..., 0] * FRAME[1] / columns, offsets[..., 1] * FRAME[0] / rows)
    seen = ~np.isnan(lengths)
    total, n_seen = np.where(seen, lengths, 0.0).sum(axis=-1), seen.sum(axis=-1)
    return np.asarray(np.where(n_seen > 0, total / np.maximum(n_seen, 1), np.nan))


def _centres(maps: Floats) -> Floats:
    """Centres (x, y) of what is positive in maps (..., rows, columns), (..., 2); nan where nothing is."""
    weights = np.where(maps > FAINT, maps, 0.0)
    total = weights.sum(axis=(-2, -1))
    rows, columns = (np.arange(size) for size in maps.shape[-2:])
    x, y = (weights * columns).sum(axis=(-2, -1)), (weights * rows[:, None]).sum(axis=(-2, -1))
    known = np.where(total > 0.0, total, np.nan)
    return np.stack([x / known, y / known], axis=-1)
