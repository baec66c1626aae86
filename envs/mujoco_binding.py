"""MuJoCo's Python binding, and the OpenGL context that it draws in."""

import atexit
import os
import sys
from functools import cache
from typing import Any

try:
    import mujoco as mujoco
except ImportError as error:
    raise ValueError(
        "simulator 'mujoco' needs the package mujoco; install it with: pip install 'sb3_stereo[mujoco]'"
    ) from error

NO_OPENGL = (
    "MuJoCo cannot draw, as OpenGL does not work here through {platform} ({reason}); install its library (on Debian "
    "libegl1 and libgl1-mesa-dri), or set MUJOCO_GL to egl, osmesa or glfw, whichever this machine has"
)


def use_opengl() -> None:
    """Make OpenGL draw in this process's own context, without a display.

    Raises:
        ValueError: If there is no OpenGL.
    """
    _context(os.getpid()).make_current()


def canvas(model: Any) -> Any:
    """MuJoCo's `MjrContext`, in which a model is drawn.

    Raises:
        ValueError: If there is no OpenGL.
    """
    use_opengl()
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
