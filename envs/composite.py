"""The observation: the luminance of every view, stacked into one image (section 3.2), arranged otherwise, or with
the markers set off."""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np
from gymnasium.spaces import Box, Dict, Space
from numpy.typing import NDArray

from sb3_stereo.envs.markers import marker_masks
from sb3_stereo.envs.specs import require, require_known

Frame = NDArray[np.uint8]
Observation = Any  # an image (channels, height, width), uint8, or a map of camera names to images

COMPOSITES = ("stack", "channels", "dict", "markers")

IMAGE = "observation"  # the key of a goal environment's image, Gymnasium-Robotics' name

WIDTH, HEIGHT = 84, 42  # of each view in the composite (section 3.2)


def composite(frames: Sequence[Frame]) -> Frame:
    """Resize each view to 84 x 42, convert it to YUV, keep Y and stack the views in camera order.

    Equal, bit for bit, to `cv2.cvtColor(cv2.resize(rgb, (84, 42)), cv2.COLOR_RGB2YUV)[..., 0]` per view.

    Args:
        frames: RGB or RGBA images, each (height, width, 3 or 4), uint8.

    Returns:
        Image of shape (1, 42 * n_views, 84), uint8.
    """
    small = np.empty((HEIGHT * len(frames), WIDTH, frames[0].shape[2]), np.uint8)
    for view, frame in enumerate(frames):
        cv2.resize(frame, (WIDTH, HEIGHT), dst=small[view * HEIGHT : (view + 1) * HEIGHT])
    rgb = cv2.cvtColor(small, cv2.COLOR_RGBA2RGB) if small.shape[2] == 4 else small
    return np.asarray(cv2.extractChannel(cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV), 0), np.uint8)[None]


def marker_map(masks: Sequence[tuple[Frame, Frame]]) -> Frame:
    """Markers at the composite's resolution: 128 where there is none, up to 255 for red, down to 0 for blue.

    A marker covers about four of these pixels, the outer ones in part; averaged over a pixel's area, the map still
    tells its centroid.

    Args:
        masks: Per view where it is red and where blue, 255 there and else 0, each (height, width), uint8.

    Returns:
        Image of shape (1, 42 * n_views, 84), uint8.
    """
    small = [[cv2.resize(mask, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) for mask in view] for view in masks]
    red, blue = np.concatenate(small, axis=1).astype(np.int16)
    return np.asarray(128 + (red - blue) // 2, np.uint8)[None]


class Composite:
    """The observation that frames make, and its space. The luminance is the same in every arrangement.

    "stack" is the paper's image, all views in one channel: (1, 42 * n_views, 84). "channels" is its future work, a
    volume of images: (n_views, 42, 84). A view keeps its 42 rows there, so that only the arrangement differs. "dict"
    maps each camera's name to its image (1, 42, 84). "markers" is the paper's image with a second channel, the
    `marker_map` of the same frames: (2, 42 * n_views, 84).

    Args:
        arrangement: One of `COMPOSITES`.
        names: Of the cameras, in their order.

    Raises:
        ValueError: If the arrangement is unknown, or cameras of a "dict" share a name.
    """

    def __init__(self, arrangement: str, names: Sequence[str]) -> None:
        require_known("composite", arrangement, COMPOSITES, "composites")
        unique = arrangement != "dict" or len(set(names)) == len(names)
        require(unique, f"cameras {', '.join(names)} share a name; composite 'dict' needs one for each")
        self.arrangement, self.names = arrangement, tuple(names)
        one = Box(0, 255, (1, HEIGHT, WIDTH), np.uint8)
        spaces: dict[str, Space[Any]] = {
            "stack": Box(0, 255, (1, HEIGHT * len(names), WIDTH), np.uint8),
            "channels": Box(0, 255, (len(names), HEIGHT, WIDTH), np.uint8),
            "markers": Box(0, 255, (2, HEIGHT * len(names), WIDTH), np.uint8),
            "dict": Dict(OrderedDict((name, one) for name in names)),  # a plain map would be sorted by name
        }
        self.space = spaces[arrangement]

    @property
    def views_in_channels(self) -> bool:
        """Whether each view has a channel of its own."""
        return self.arrangement == "channels"

    def __call__(
        self,
        frames: Sequence[Frame],
        find_masks: Callable[[Frame], tuple[Frame, Frame]] = marker_masks,
    ) -> Observation:
        """Make an observation.

        Args:
            frames: One of each camera, (height, width, 3 or 4), uint8.
            find_masks: Finds the markers in a frame, if the arrangement shows them.
        """
        stack = composite(frames)
        if self.arrangement == "markers":
            return np.concatenate([stack, marker_map([find_masks(frame) for frame in frames])])
        if self.arrangement == "stack":
            return stack
        views = stack.reshape(len(frames), HEIGHT, WIDTH)
        return views if self.arrangement == "channels" else dict(zip(self.names, views[:, None], strict=True))


def as_stack(observation: Observation) -> Frame:
    """One image (1, rows, columns) of an observation in any arrangement: the paper's, left of the markers if any."""
    if isinstance(observation, dict):  # of views, or a goal environment's
        observation = observation.get(IMAGE, observation)
    images = list(observation.values()) if isinstance(observation, dict) else [observation]
    # A channel with more rows than a view is a stack already.
    return np.concatenate([np.concatenate(list(i), axis=int(i.shape[1] > HEIGHT)) for i in images])[None]
