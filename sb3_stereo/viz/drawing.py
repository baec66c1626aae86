"""Annotated images: the views with the detected markers, the network's image, joint torques and text."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.composite import as_stack
from sb3_stereo.envs.markers import Blobs

Image = NDArray[np.uint8]  # RGB, (height, width, 3)
Colour = tuple[int, int, int]

VIEW_HEIGHT, NETWORK_HEIGHT, LINE_HEIGHT, BORDER, BAR = 360, 252, 34, 12, 90  # [px]
COLUMN_HEIGHT = 260  # [px], of a view beside the whole scene
PAPER: Colour = (238, 238, 238)
FAINT: Colour = (218, 218, 218)
INK, PALE, WHITE, RED, BLUE, GREEN = (
    (40, 40, 40),
    (120, 120, 120),
    (255, 255, 255),
    (190, 0, 0),
    (0, 0, 190),
    (0, 130, 60),
)
FONT = cv2.FONT_HERSHEY_SIMPLEX


class View(NamedTuple):
    """One camera's frame, RGB or RGBA, the markers in it, what it is called, and its pixels per pixel of theirs."""

    name: str
    frame: Image
    blobs: Blobs
    scale: float = 1.0


class Effort(NamedTuple):
    """What one joint is to do: [N m], and the share of its limit, -1 to 1."""

    joint: str
    torque: float
    share: float


def capture(env: Any, height: int | None = None) -> list[View]:
    """What the cameras of a `StereoReachEnv`, wrapped or not, see now, and the markers as its reward finds them.

    Args:
        env: The environment.
        height: Draw the views anew in this height, in [px]; None shows the frames. Those of a randomised environment
            are what its sensors make of the world, and are shown in any case.
    """
    task = env.unwrapped
    names = [camera.spec.name for camera in task.cameras]
    frames, blobs = zip(*task.look(), strict=True)
    if height is None or task.randomization is not None:
        return [View(*view) for view in zip(names, frames, blobs, strict=True)]
    scale = height / task.cameras[0].spec.height
    return [View(*view, scale) for view in zip(names, task.draw_larger(height), blobs, strict=True)]


class Caption(NamedTuple):
    """What the pictures do not say: lines of text, efforts, and how it ended (green if well)."""

    lines: Sequence[str]
    efforts: Sequence[Effort] = ()
    verdict: str = ""
    good: bool = True


def scene(
    views: Sequence[View], observation: Any, caption: Caption, zoom: float = 1.0, overview: Image | None = None
) -> Image:
    """Put everything into one picture: the views above, the observation and the caption below.

    Args:
        views: In camera order.
        observation: What the network sees, in any arrangement.
        caption: The rest.
        zoom: Shows the middle of the views this much larger.
        overview: A picture of the whole scene, RGB, of the size `overview_size`; the views then are in a column.
    """
    above = side_by_side(views, zoom) if overview is None else beside_overview(views, zoom, overview)
    pixels = NETWORK_HEIGHT if overview is None else NETWORK_HEIGHT * 2 // 3
    below = _row([titled("network input", _squares(as_stack(observation)[0], pixels))])
    captions = _caption(caption, (below.shape[0], max(above.shape[1] - below.shape[1], 420)))
    rows = [above, np.hstack([below, captions])]
    width = max(row.shape[1] for row in rows)
    rows = [np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0)), constant_values=PAPER[0]) for row in rows]
    picture: Image = np.vstack(rows)
    return picture[: picture.shape[0] // 2 * 2, : width // 2 * 2]  # films want even sizes


def side_by_side(views: Sequence[View], zoom: float = 1.0) -> Image:
    """Draw the views in a row, each with its name and what is found in it."""
    return _row([titled(view.name, annotated(view, zoom)) for view in views])


def _label_corner(first: Sequence[int], second: Sequence[int], size: tuple[int, int]) -> tuple[int, int]:
    """Where the distance is written, lower left: above both markers, or beside the upper one where that is cut."""
    upper = min(first, second, key=lambda point: point[1])
    if upper[1] >= 46:
        return min(max((first[0] + second[0]) // 2 - 34, 2), size[0] - 74), upper[1] - 26
    beside = upper[0] + 24
    return beside if beside <= size[0] - 74 else upper[0] - 98, max(upper[1] + 6, 20)


def overview_size(views: Sequence[View]) -> tuple[int, int]:
    """Height and width, in [px], of a picture as high as the column of views beside it."""
    height = len(views) * (COLUMN_HEIGHT + LINE_HEIGHT) - LINE_HEIGHT
    return height, height * 4 // 3


def beside_overview(views: Sequence[View], zoom: float, overview: Image) -> Image:
    """The whole scene on the left, and the views below each other on the right."""
    column = np.vstack([titled(view.name, annotated(view, zoom, COLUMN_HEIGHT)) for view in views])
    return _row([titled("scene", overview), column])


def annotated(view: View, zoom: float = 1.0, shown_height: int = VIEW_HEIGHT) -> Image:
    """Scale a view and draw a ring around each blob, the line between them and its length in [px]."""
    height, width = view.frame.shape[:2]
    scale = shown_height / height * zoom
    hidden = np.array([width, height]) * scale * (1 - 1 / zoom) / 2  # left and above of what is shown
    size = round(width * scale / zoom), shown_height
    shift = np.array([[scale, 0, (scale - 1) / 2 - hidden[0]], [0, scale, (scale - 1) / 2 - hidden[1]]])
    picture = cv2.warpAffine(view.frame[:, :, :3], shift, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    points = [np.rint(shift @ [*((centroid + 0.5) * view.scale - 0.5), 1]) for centroid in view.blobs]
    if not np.isnan(points).any():
        first, second = (point.astype(int).tolist() for point in points)
        cv2.line(picture, first, second, INK, 1, cv2.LINE_AA)
        corner = _label_corner(first, second, size)
        cv2.rectangle(picture, corner, (corner[0] + 72, corner[1] - 18), WHITE, cv2.FILLED)
        _write(picture, f"{np.hypot(*view.blobs.offset):.1f} px", corner, INK)
    for point, colour in zip(points, (RED, BLUE), strict=True):
        if not np.isnan(point).any():
            centre = point.astype(int).tolist()
            cv2.circle(picture, centre, 17, colour, 2, cv2.LINE_AA)
            cv2.drawMarker(picture, centre, WHITE, cv2.MARKER_CROSS, 9, 1)
    return np.asarray(picture, np.uint8)


def _squares(luminance: Image, shown_height: int) -> Image:
    """Show every pixel of a grey image (height, width) as a square."""
    factor = max(1, shown_height // luminance.shape[0])
    return np.repeat(np.kron(luminance, np.ones((factor, factor), np.uint8))[:, :, None], 3, axis=2)


def titled(title: str, picture: Image) -> Image:
    """Write what a picture shows above it."""
    framed = _paper(picture.shape[0] + LINE_HEIGHT, picture.shape[1] + BORDER)
    framed[LINE_HEIGHT:, BORDER:] = picture
    _write(framed, title, (BORDER, LINE_HEIGHT - 10), PALE)
    return framed


def _row(pictures: Sequence[Image]) -> Image:
    return np.pad(np.hstack(pictures), ((0, BORDER // 2), (0, BORDER), (0, 0)), constant_values=PAPER[0])


def _caption(caption: Caption, size: tuple[int, int]) -> Image:
    """Write the caption on a paper of the size (height, width)."""
    paper = _paper(*size)
    x, y = 2 * BORDER, LINE_HEIGHT + 18
    for line in caption.lines:
        _write(paper, line, (x, y), INK)
        y += 28
    _write(paper, caption.verdict, (x, size[0] - 3 * BORDER), GREEN if caption.good else RED, 1.3, 3)
    middle = size[1] - 2 * BORDER - 140 - BAR
    for row, effort in enumerate(caption.efforts):
        y = LINE_HEIGHT + 18 + 28 * row
        end = middle + round(BAR * effort.share)
        cv2.rectangle(paper, (middle - BAR, y - 14), (middle + BAR, y), FAINT, cv2.FILLED)  # as far as the limits
        cv2.rectangle(paper, (min(middle, end), y - 14), (max(middle, end), y), PALE, cv2.FILLED)
        cv2.line(paper, (middle, y - 18), (middle, y + 4), INK, 1)
        (name_width, _), _ = cv2.getTextSize(effort.joint, FONT, 0.5, 1)
        _write(paper, effort.joint, (middle - BAR - 20 - name_width, y), PALE, 0.5)
        _write(paper, f"{effort.torque:+.1f} N m", (middle + BAR + 20, y), INK, 0.5)
    return paper


def _paper(height: int, width: int) -> Image:
    return np.full((height, width, 3), PAPER, np.uint8)


def _write(paper: Any, text: str, corner: Sequence[int], colour: Colour, size: float = 0.6, weight: int = 1) -> None:
    cv2.putText(paper, text, corner, FONT, size, colour, weight, cv2.LINE_AA)
