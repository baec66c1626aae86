"""The OpenGL that MuJoCo draws with: without a display, in one thread of a process, whichever thread asks."""

import atexit
import os
import sys
import weakref
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial, wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.mujoco_binding import mujoco
from sb3_stereo.envs.specs import require

Frame = NDArray[np.uint8]
Depth = NDArray[np.float32]
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

NO_OPENGL = (
    "MuJoCo cannot draw, as OpenGL does not work here through {platform} ({reason}); install its library (on Debian "
    "libegl1 and libgl1-mesa-dri), or set MUJOCO_GL to egl, osmesa or glfw, whichever this machine has"
)
FORKED = (
    "MuJoCo has drawn in the process that this one was forked from, and OpenGL does not survive that; start processes "
    "by 'forkserver' or 'spawn'"
)

_drawing: list[int] = []  # numbers of the processes in which a context was made


def check_opengl() -> None:
    """Raise a ValueError if OpenGL's library is missing. Nothing is made yet, so that a process may still be forked."""
    _context_class()


def _with_opengl(work: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Let a function work in the thread that OpenGL's context belongs to."""

    @wraps(work)
    def drawing(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        return _thread(os.getpid()).submit(_in_context, partial(work, *args, **kwargs)).result()

    return drawing


@_with_opengl
def check_drawing() -> None:
    """Raise a ValueError if OpenGL does not work."""


def _in_context(work: Callable[[], Result]) -> Result:
    _context(os.getpid()).make_current()
    return work()


@cache
def _thread(process: int) -> ThreadPoolExecutor:
    """The thread of a process that draws: a context that is in use in one thread is of no use in another."""
    require(not set(_drawing) - {process}, FORKED)
    return ThreadPoolExecutor(1, "opengl")


@cache
def _context(process: int) -> Any:
    """The context of a process."""
    try:
        context = _context_class()(1, 1)
        context.make_current()
    except Exception as error:  # of any kind, as above
        raise ValueError(_refusal(error)) from error
    _drawing.append(process)
    atexit.register(context.free)  # before EGL ends, after which its destructor would print errors
    return context


def _context_class() -> Any:
    platform = _platform()
    try:
        if platform == "egl":
            from mujoco.egl import GLContext
        elif platform == "osmesa":
            from mujoco.osmesa import GLContext
        else:
            from mujoco import GLContext
    except Exception as error:  # of any kind: a missing library is an AttributeError of PyOpenGL
        raise ValueError(_refusal(error)) from error
    return GLContext


def _platform() -> str:
    """How OpenGL is reached; empty for MuJoCo's own choice."""
    return os.environ.get("MUJOCO_GL", "").strip().lower() or ("egl" if sys.platform == "linux" else "")


def _refusal(error: Exception) -> str:
    reason = " ".join(str(error).split()) or type(error).__name__
    return NO_OPENGL.format(platform=_platform() or "MuJoCo's default", reason=reason)


class Canvas:
    """What a model is drawn on, MuJoCo's `MjrContext`; OpenGL frees it when nobody has it any more.

    Args:
        model: MuJoCo's `MjModel`.

    Raises:
        ValueError: If there is no OpenGL.
    """

    def __init__(self, model: Any) -> None:
        self._context = _new_context(model)
        self._size = self._context.offWidth, self._context.offHeight
        self._free = weakref.finalize(self, _thread(os.getpid()).submit, _in_context, self._context.free)
        self._free.atexit = False  # then there is no thread any more

    def close(self) -> None:
        """Free it; a second call does nothing."""
        self._free()

    @_with_opengl
    def draw(self, scene: Any, width: int, height: int) -> tuple[Frame, Depth]:
        """Draw an `MjvScene`: RGB, (height, width, 3), and depth, (height, width), the lowest row first."""
        size = max(self._size[0], width), max(self._size[1], height)
        if size != self._size:
            mujoco.mjr_resizeOffscreen(*size, self._context)
            self._size = size
        view = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)  # another's may be in use
        mujoco.mjr_render(view, scene, self._context)
        frame, depth = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.float32)
        mujoco.mjr_readPixels(frame, depth, view, self._context)
        return frame, depth


@_with_opengl
def _new_context(model: Any) -> Any:
    try:
        return mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
    except mujoco.FatalError as error:  # GLFW without a display says nothing before
        raise ValueError(_refusal(error)) from error
