"""The observation: the luminance of every view, stacked into one image (section 3.2)."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

Frame = NDArray[np.uint8]

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
