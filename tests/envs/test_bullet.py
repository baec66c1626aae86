"""The simulator's binding: imported in one place, silently, and refused if it cannot return images as arrays."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from sb3_stereo.envs import bullet
from sb3_stereo.envs.reach import StereoReachEnv

ROOT = Path(__file__).parents[2]


def test_importing_it_prints_nothing() -> None:
    done = subprocess.run([sys.executable, "-c", "import sb3_stereo.envs.bullet"], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_it_is_imported_in_one_place() -> None:
    importing = re.compile(r"^\s*(import|from) pybullet(?!_data)", re.MULTILINE)  # its robots are files, for MuJoCo too
    files = [path for folder in ("envs", "sb3_stereo", "benchmarks") for path in (ROOT / folder).rglob("*.py")]
    found = {path.resolve() for path in files if importing.search(path.read_text(encoding="utf-8"))}
    assert found == {(ROOT / "envs" / "bullet.py").resolve()}


@pytest.mark.parametrize("descriptor", [1, 2])
def test_what_is_printed_below_python_is_collected(descriptor: int, capfd: pytest.CaptureFixture[str]) -> None:
    with bullet.native_output(descriptor) as printed:
        os.write(descriptor, b"from C\n")
    os.write(descriptor, b"later\n")
    assert printed == ["from C\n"]
    assert "later" in "".join(capfd.readouterr())


def test_a_binding_without_numpy_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bullet.pybullet, "isNumpyEnabled", lambda: 0)
    with pytest.raises(RuntimeError) as caught:
        StereoReachEnv()
    assert str(caught.value) == bullet.WITHOUT_NUMPY
