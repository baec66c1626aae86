"""Colours that a frame's pixels are told apart by: each channel of them is either full or empty."""

import cv2
import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.markers import BRIGHT, DIM

Frame = NDArray[np.uint8]
Colour = tuple[float, float, float]

HAND: Colour = (1.0, 0.0, 0.0)  # the end effector's marker
COLOURS: dict[str, Colour] = {
    "blue": (0.0, 0.0, 1.0),
    "green": (0.0, 1.0, 0.0),
    "magenta": (1.0, 0.0, 1.0),
    "cyan": (0.0, 1.0, 1.0),
    "yellow": (1.0, 1.0, 0.0),
}


def colour_mask(frame: Frame, colour: Colour) -> Frame:
    """Where a frame has a colour, however it is lit: 255 there, else 0, (height, width), uint8.

    Args:
        frame: RGB or RGBA, (height, width, 3 or 4), uint8.
        colour: Whose channels are 0 or 1.
    """
    lowest = [BRIGHT if channel else 0 for channel in colour]
    highest = [255 if channel else DIM for channel in colour]
    alpha = frame.shape[2] - 3
    return np.asarray(cv2.inRange(frame, (*lowest, *[0] * alpha), (*highest, *[255] * alpha)), np.uint8)
