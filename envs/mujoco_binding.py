"""MuJoCo's Python binding."""

try:
    import mujoco as mujoco
except ImportError as error:
    raise ValueError(
        "simulator 'mujoco' needs the package mujoco; install it with: pip install 'sb3_stereo[mujoco]'"
    ) from error
