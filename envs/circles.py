"""A marker's centre from its rim: a circle through what is visible of it, to a fraction of a pixel.

The mean pixel of a ball moves when something hides a part of the ball; the circle through the rest of its rim does
not. (A ball's image is an ellipse, 1 % longer than wide at the edge of v1's frames, and its middle is at most 0.01 px
from where the ball's centre is.)
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.markers import MIN_PIXELS, Blobs, crop_masks, no_blob

Frame = NDArray[np.uint8]
Floats = NDArray[np.float64]
Circle = tuple[float, float, float]  # x and y of the centre, and radius, in [px]

TOLERANCE = 0.8  # [px] from the circle: where pixels end is known to half a pixel, and less well along a diagonal
MIN_ARC = 0.1  # of the rim; less gives a centre that a pixel more or less moves by several
SLACK = 0.15  # of the radius, by which a ball looks larger or smaller at the near and the far end of the workspace
MAX_FITS = 5  # until the points on the circle stay the same; two are usual
MAX_PAIRS = 120

_NEIGHBOURS = np.ones((3, 3), np.uint8)


def find_circles(frame: Frame, radii: tuple[float, float]) -> Blobs:
    """Find the centres of the red (end effector) and the blue (target) ball.

    Args:
        frame: RGB or RGBA image, shape (height, width, 3 or 4), uint8.
        radii: About how large the red and the blue ball look, in [px].
    """
    top, left, (red, blue) = crop_masks(frame)
    corner = np.array([left, top])
    centres = circle_centres(red, blue, radii)
    return Blobs(centres.end_effector + corner, centres.target + corner)


def circle_centres(red: Frame, blue: Frame, radii: tuple[float, float]) -> Blobs:
    """The centres of two markers from where an image is red and where blue.

    Near the target the end effector is in front of it, or within it. So the red rim is wherever red ends, and the blue
    rim is where blue ends and red does not begin.

    Args:
        red: 255 where the end effector is visible, else 0, shape (height, width), uint8.
        blue: Likewise of the target.
        radii: About how large the two look, in [px].
    """
    return Blobs(_centre(red, None, radii[0]), _centre(blue, red, radii[1]))


def _centre(mask: Frame, in_front: Frame | None, radius: float) -> Floats:
    """Centre (x, y) of the ball that is visible in `mask`, shape (2,) in [px]; nan if too little of it is."""
    box = cv2.boundingRect(mask)
    inside = _window(mask, *box)
    if cv2.countNonZero(inside) < MIN_PIXELS:
        return no_blob()
    known = inside if in_front is None else cv2.bitwise_or(inside, cv2.dilate(_window(in_front, *box), _NEIGHBOURS))
    circle = _fit(_rim(inside > 0, known == 0), radius)
    if circle is None:
        return no_blob()
    return np.array([box[0] - 1 + circle[0], box[1] - 1 + circle[1]])  # of the window's corner


def _window(mask: Frame, left: int, top: int, width: int, height: int) -> Frame:
    """The part of `mask` that a box holds, and a pixel more all around, 0 beyond the image."""
    above, before = max(top - 1, 0), max(left - 1, 0)
    window = np.zeros((height + 2, width + 2), np.uint8)
    part = mask[above : top + height + 1, before : left + width + 1]
    y, x = above - top + 1, before - left + 1
    window[y : y + part.shape[0], x : x + part.shape[1]] = part
    return window


def _rim(inside: NDArray[np.bool_], outside: NDArray[np.bool_]) -> Floats:
    """Midpoints (x, y) between pixels inside and their neighbours outside, shape (n, 2), in [px]."""
    rows, columns = np.nonzero((inside[:, 1:] & outside[:, :-1]) | (inside[:, :-1] & outside[:, 1:]))
    rows_above, columns_above = np.nonzero((inside[1:] & outside[:-1]) | (inside[:-1] & outside[1:]))
    points = np.empty((len(rows) + len(rows_above), 2))
    points[: len(rows), 0], points[: len(rows), 1] = columns, rows
    points[: len(rows), 0] += 0.5
    points[len(rows) :, 0], points[len(rows) :, 1] = columns_above, rows_above
    points[len(rows) :, 1] += 0.5
    return points


def _fit(points: Floats, radius: float) -> Circle | None:
    """The circle of about this radius that most of the points are on; the others are where something hides the ball."""
    if len(points) < MIN_ARC * 8 * radius:  # so many ends have the pixels of a whole circle
        return None
    (x, y), enclosing_radius = cv2.minEnclosingCircle(points.astype(np.float32))
    circle, n_points = _settle(points, (x, y, enclosing_radius), radius)
    if n_points < len(points):
        other, n_others = _settle(points, _vote(points, radius), radius)
        if n_others > n_points:
            circle, n_points = other, n_others
    return circle if n_points >= MIN_ARC * 8 * radius else None


def _vote(points: Floats, radius: float) -> Circle | None:
    """Of the circles with this radius through two of the points, that with most points on it and fewest outside."""
    first, second = np.triu_indices(len(points), 1)
    every = slice(None, None, 1 + len(first) // MAX_PAIRS)
    half = (points[second[every]] - points[first[every]]) / 2
    squares = np.einsum("ij,ij->i", half, half)
    apart = (squares < radius**2) & (squares > (radius / 4) ** 2)
    half, squares = half[apart], squares[apart]
    if not len(half):
        return None
    middles = points[first[every]][apart] + half
    across = half[:, ::-1] * (-1.0, 1.0) * np.sqrt(radius**2 / squares - 1.0)[:, None]
    centres = np.concatenate([middles + across, middles - across])
    x, y = points.T
    beyond = np.hypot(x - centres[:, :1], y - centres[:, 1:]) - radius  # (n_circles, n_points)
    votes = np.count_nonzero(np.abs(beyond) < TOLERANCE, axis=1) - np.count_nonzero(beyond > TOLERANCE, axis=1)
    best = int(np.argmax(votes))
    return float(centres[best, 0]), float(centres[best, 1]), radius


def _settle(points: Floats, circle: Circle | None, radius: float) -> tuple[Circle | None, int]:
    """From one circle to that through the points on it, again and again: the last one, and how many are on it."""
    chosen, n_chosen = None, 0
    for _ in range(MAX_FITS):
        if circle is None:
            return None, 0
        offsets = points - circle[:2]
        on_circle = np.abs(np.hypot(offsets[:, 0], offsets[:, 1]) - circle[2]) < TOLERANCE
        n_chosen = int(np.count_nonzero(on_circle))
        if n_chosen < 3 or (chosen is not None and (on_circle == chosen).all()):
            break
        chosen = on_circle
        circle = _circle_through(points[chosen], radius)
    return circle, n_chosen


def _circle_through(points: Floats, radius: float) -> Circle | None:
    """The circle nearest to points (n, 2), its radius within `SLACK` of the one that is given.

    By algebraic least squares in closed form (Kasa 1976). A short arc leaves the radius open; where that comes out
    wrong it is the nearest allowed one, and the centre that of least squares with it (two steps of Gauss and Newton).
    None for points on a line.
    """
    middle = points.mean(axis=0)
    centred = points - middle
    squares = np.einsum("ij,ij->i", centred, centred)
    (xx, xy), (_, yy) = (centred.T @ centred).tolist()
    centre = _solve(xx, xy, yy, *(squares @ centred / 2).tolist())
    if centre is None:
        return None
    x, y = centre
    found = math.sqrt(x * x + y * y + float(squares.mean()))
    allowed = min(max(found, (1 - SLACK) * radius), (1 + SLACK) * radius)
    for _ in range(2 if found != allowed else 0):
        away = centred - (x, y)
        lengths = np.hypot(away[:, 0], away[:, 1])
        away /= lengths[:, None]
        (xx, xy), (_, yy) = (away.T @ away).tolist()
        step = _solve(xx, xy, yy, *((lengths - allowed) @ away).tolist())
        if step is None:
            return None
        x, y = x + step[0], y + step[1]
    return float(middle[0]) + x, float(middle[1]) + y, allowed


def _solve(xx: float, xy: float, yy: float, x: float, y: float) -> tuple[float, float] | None:
    """Solve ((xx, xy), (xy, yy)) z = (x, y) for a positive definite matrix; None if it is nearly singular."""
    determinant = xx * yy - xy * xy
    if determinant < 1e-6 * (xx + yy) ** 2:
        return None
    return (yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant
