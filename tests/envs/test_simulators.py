"""What is said of a simulator that is not there; this needs none but Bullet."""

import subprocess
import sys
from importlib.util import find_spec

import pytest

from sb3_stereo.envs.reach import StereoReachEnv


def test_an_unknown_simulator_is_one_sentence() -> None:
    with pytest.raises(ValueError) as error:
        StereoReachEnv(simulator="gazebo")
    assert str(error.value) == "unknown simulator 'gazebo'; simulators are bullet, mujoco"


def run_without(module: str, imported: str = "sys") -> str:
    """What making the environment says where a module is missing, though another has been imported."""
    code = (
        f"import sys, {imported}; sys.modules[{module!r}] = None\n"
        "from sb3_stereo.__main__ import main\n"
        "sys.exit(main(['check', '--env', 'WamStereoReachMujoco-v0']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    return done.stderr


def test_a_missing_package_is_one_sentence() -> None:
    said = "error: simulator 'mujoco' needs the package mujoco; install it with: pip install 'sb3_stereo[mujoco]'\n"
    assert run_without("mujoco") == said


@pytest.mark.skipif(not find_spec("mujoco"), reason="it comes with mujoco")
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere MuJoCo draws in a window's context")
def test_missing_opengl_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "egl")
    assert run_without("mujoco.egl", "mujoco") == (
        "error: MuJoCo cannot draw, as OpenGL does not work here through egl (import of mujoco.egl halted; None in "
        "sys.modules); install its library (on Debian libegl1 and libgl1-mesa-dri), or set MUJOCO_GL to egl, osmesa or "
        "glfw, whichever this machine has\n"
    )
