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


@cache
def _context(process: int) -> Any:
    """The context of a process: after a fork its parent's is of no use."""
    platform = os.environ.get("MUJOCO_GL", "").strip().lower() or ("egl" if sys.platform == "linux" else "")
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
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(NO_OPENGL.format(platform=platform or "MuJoCo's default", reason=reason)) from error
    atexit.register(context.free)  # before EGL ends, after which its destructor would print errors
    return context
