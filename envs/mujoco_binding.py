"""MuJoCo's Python binding, and the OpenGL context that it draws in."""

import atexit
import os
import sys
import weakref
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial, wraps
from typing import Any, ParamSpec, TypeVar

try:
    import mujoco as mujoco
except ImportError as error:
    raise ValueError(
        "simulator 'mujoco' needs the package mujoco; install it with: pip install 'sb3_stereo[mujoco]'"
    ) from error

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

NO_OPENGL = (
    "MuJoCo cannot draw, as OpenGL does not work here through {platform} ({reason}); install its library (on Debian "
    "libegl1 and libgl1-mesa-dri), or set MUJOCO_GL to egl, osmesa or glfw, whichever this machine has"
)


def with_opengl(work: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Let a function draw, without a display, whichever thread calls it: in the one that OpenGL's context belongs to.

    It raises a ValueError if there is no OpenGL.
    """

    @wraps(work)
    def drawing(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        return _thread(os.getpid()).submit(_in_context, partial(work, *args, **kwargs)).result()

    return drawing


def _in_context(work: Callable[[], Result]) -> Result:
    _context(os.getpid()).make_current()
    return work()


@cache
def _thread(process: int) -> ThreadPoolExecutor:
    """The thread of a process that draws: a context that is in use in one thread is of no use in another."""
    return ThreadPoolExecutor(1, "opengl")


class Canvas:
    """MuJoCo's `MjrContext`, in which a model is drawn; it is freed with this.

    Raises:
        ValueError: If there is no OpenGL.
    """

    def __init__(self, model: Any) -> None:
        self.context = _make_canvas(model)
        self._free = weakref.finalize(self, _thread(os.getpid()).submit, _in_context, self.context.free)
        self._free.atexit = False  # then there is no thread any more

    def close(self) -> None:
        """Free it; a second call does nothing."""
        self._free()


@with_opengl
def _make_canvas(model: Any) -> Any:
    try:
        return mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
    except mujoco.FatalError as error:  # GLFW without a display says nothing before
        raise ValueError(_refusal(error)) from error


@cache
def _context(process: int) -> Any:
    """The context of a process: after a fork its parent's is of no use."""
    platform = _platform()
    try:
        if platform == "egl":
            from mujoco.egl import GLContext
        elif platform == "osmesa":
            from mujoco.osmesa import GLContext
        else:
            from mujoco import GLContext
        context = GLContext(1, 1)
        context.make_current()
    except Exception as error:  # of any kind: a missing library is an AttributeError of PyOpenGL
        raise ValueError(_refusal(error)) from error
    atexit.register(context.free)  # before EGL ends, after which its destructor would print errors
    return context


def _platform() -> str:
    """How OpenGL is reached; empty for MuJoCo's own choice."""
    return os.environ.get("MUJOCO_GL", "").strip().lower() or ("egl" if sys.platform == "linux" else "")


def _refusal(error: Exception) -> str:
    reason = " ".join(str(error).split()) or type(error).__name__
    return NO_OPENGL.format(platform=_platform() or "MuJoCo's default", reason=reason)
