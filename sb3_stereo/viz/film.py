"""Videos of an agent: both views, the measured distances and the network's image, as .mp4 or .gif."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import cv2
import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from PIL import Image as pillow

from sb3_stereo.envs.cameras import CameraSpec
from sb3_stereo.envs.wrappers import WatchedPulses
from sb3_stereo.errors import ConfigError
from sb3_stereo.viz.drawing import COLUMN_HEIGHT, GREEN, Caption, Effort, capture, overview_size, scene

Image = NDArray[np.uint8]

FORMATS = (".gif", ".mp4")
N_PARTS = 6  # pictures of a pulse, which lasts half a second
PAUSE, END = 4, 15  # pictures for which a step's result and an episode's end stand still
GIF_COLOURS, GIF_SCALE = 48, 0.8


# Beside the cameras, nearer and a little higher, so that floor and shadow show how far the hand is from the target.
OVERVIEW = CameraSpec("scene", (2.5, -1.25, 1.45), (0.15, 0.0, 0.65), horizontal_fov=0.78, near=0.5, far=8.0)


class Predictor(Protocol):
    """Acts, as every model of Stable-Baselines3."""

    def predict(self, observation: Any, *, deterministic: bool) -> tuple[Any, Any]:
        """Return the action for an observation, and a state."""


class Writer(Protocol):
    """Takes pictures one by one."""

    def write(self, picture: Image, n: int) -> None:
        """Append an RGB picture that stands for `n` frames; all are of the same size."""

    def close(self) -> None:
        """Finish the file."""


class Filmed(gym.Wrapper[Any, Any, Any, Any]):
    """Hand pictures of every moment to a writer.

    Args:
        env: A `StereoReachEnv`, wrapped or not.
        writer: Of the film.
        zoom: As in `scene`.
    """

    def __init__(self, env: gym.Env[Any, Any], writer: Writer, zoom: float = 1.0) -> None:
        super().__init__(WatchedPulses(env, self._film, N_PARTS))
        self.writer, self.zoom = writer, zoom
        self.steps = 0
        self.efforts: list[Effort] = []

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        self.observation, info = self.env.reset(**kwargs)
        self.steps, self.efforts = 0, []
        self._reward = 0.0
        self._picture(n=PAUSE)
        return self.observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Film a pulse and its result."""
        self.steps += 1
        self.observation, reward, terminated, truncated, info = self.env.step(action)
        self._reward += float(reward)
        verb = self.unwrapped.goal_verb  # type: ignore[attr-defined]
        verdict = verb if info["is_success"] else f"not {verb}" if truncated else ""
        self._picture(verdict, info["is_success"], END if terminated or truncated else PAUSE)
        return self.observation, reward, terminated, truncated, info

    def _film(self, efforts: Sequence[float]) -> None:
        env: Any = self.unwrapped
        shares = np.divide(efforts, env.effort_limits)
        self.efforts = [Effort(*known) for known in zip(env.arm.spec.joints, efforts, shares, strict=True)]
        self._picture()

    def _picture(self, verdict: str = "", good: bool = True, n: int = 1) -> None:
        env: Any = self.unwrapped
        views = capture(self, round(COLUMN_HEIGHT * self.zoom))
        distance = env.success_distances(np.array([view.blobs.offset for view in views])).mean()
        lines = [
            f"step {self.steps}" if self.steps else "start",
            f"reward so far {self._reward:+.2f}",
            f"distance {distance:.1f} px" if np.isfinite(distance) else "a marker is hidden",
            env.goal_text,
        ]
        height, width = overview_size(views)
        overview = env.draw_from(replace(OVERVIEW, width=width, height=height))
        caption = Caption(lines, self.efforts, verdict, good)
        self.writer.write(scene(views, self.observation, caption, self.zoom, overview), n)


def film(
    model: Predictor, env: gym.Env[Any, Any], file: str | Path, n_episodes: int = 3, seed: int = 0, zoom: float = 1.0
) -> Path:
    """Film whole episodes of an agent.

    Args:
        model: An agent of Stable-Baselines3; its deterministic actions are taken.
        env: A `StereoReachEnv` with all wrappers that the agent knows.
        file: An .mp4 (needs imageio-ffmpeg) or a .gif.
        n_episodes: How many.
        seed: Of the first episode's start.
        zoom: As in `scene`.

    Returns:
        The file.

    Raises:
        ConfigError: If the file cannot be written, or its name has another ending.
    """
    path = Path(file)
    writer = make_writer(path, N_PARTS * env.metadata.get("render_fps", 1))
    try:
        filmed = Filmed(env, writer, zoom)
        for number in range(n_episodes):
            observation, _ = filmed.reset(seed=seed if number == 0 else None)
            ended = False
            while not ended:
                action, _ = model.predict(observation, deterministic=True)
                observation, _, terminated, truncated, _ = filmed.step(action)
                ended = terminated or truncated
    finally:
        writer.close()
    return path


class Mp4:
    """H.264 in an .mp4, which browsers, phones and slides play; by imageio's FFmpeg."""

    def __init__(self, file: Path, fps: float) -> None:
        import imageio_ffmpeg

        self._write_frames = partial(
            imageio_ffmpeg.write_frames,
            str(file),
            fps=fps,
            codec="libx264",
            macro_block_size=2,
            ffmpeg_log_level="error",
        )
        self._writer: Any = None

    def write(self, picture: Image, n: int) -> None:
        """Append an RGB picture that stands for `n` frames; the first one's size is the film's."""
        if self._writer is None:
            height, width, _ = picture.shape
            self._writer = self._write_frames(size=(width, height))
            self._writer.send(None)
        for _ in range(n):
            self._writer.send(np.ascontiguousarray(picture))

    def close(self) -> None:
        """Finish the file."""
        if self._writer is not None:
            self._writer.close()


class Gif:
    """An endless .gif, small enough for a page; by Pillow.

    Args:
        file: What it is written to.
        fps: Pictures per second.
        scale: Of its pictures.
    """

    def __init__(self, file: Path, fps: float, scale: float = GIF_SCALE) -> None:
        self.file, self.fps, self.scale = file, fps, scale
        self._palette: Any = None
        self._pictures: list[Any] = []
        self._milliseconds: list[int] = []

    def write(self, picture: Image, n: int) -> None:
        """Append an RGB picture that stands for `n` frames."""
        small = cv2.resize(picture, None, fx=self.scale, fy=self.scale, interpolation=cv2.INTER_AREA)
        if self._palette is None:  # one for all, so that what stands still costs nothing
            inks = np.full((40, small.shape[1], 3), GREEN, np.uint8)
            self._palette = pillow.fromarray(np.vstack([small, inks])).quantize(GIF_COLOURS)
        image = pillow.fromarray(small)
        self._pictures.append(image.quantize(palette=self._palette, dither=pillow.Dither.NONE))
        self._milliseconds.append(round(1000 * n / self.fps))

    def close(self) -> None:
        """Write the file."""
        if self._pictures:
            first, *others = self._pictures
            times = self._milliseconds
            first.save(self.file, save_all=True, append_images=others, duration=times, loop=0, optimize=True)


def make_writer(file: Path, fps: float) -> Writer:
    """Return the writer for a file's ending.

    Raises:
        ConfigError: If there is none, or the file cannot be written.
    """
    if file.suffix not in FORMATS:
        raise ConfigError(f"cannot write the video '{file}'; the name must end in {', '.join(FORMATS)}")
    if file.is_dir():
        raise ConfigError(f"cannot write the video '{file}', which is a folder; choose another name with --video")
    if not file.parent.is_dir():
        raise ConfigError(f"cannot write '{file}' (no folder '{file.parent}'); choose another with --video")
    _try_writing(file)
    try:
        return Mp4(file, fps) if file.suffix == ".mp4" else Gif(file, fps)
    except ModuleNotFoundError as error:
        raise ConfigError('an .mp4 needs imageio-ffmpeg; install it with: pip install "sb3_stereo[film]"') from error


def _try_writing(file: Path) -> None:
    """Raise a ConfigError if a file cannot be written: FFmpeg would say so only after the first episode."""
    existed = file.exists()
    try:
        file.open("ab").close()
    except OSError as error:
        raise ConfigError(f"cannot write '{file}' ({error.strerror}); choose another with --video") from error
    if not existed:
        file.unlink()
