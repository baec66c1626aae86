"""The simulator's Python binding. It is imported here alone, so that a fork of it can take its place."""

import ctypes
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

WITHOUT_NUMPY = (
    "this PyBullet was built without NumPy and cannot return images as arrays; install NumPy first, then build it "
    "again: pip install --force-reinstall --no-deps --no-binary pybullet --no-build-isolation pybullet"
)


@contextmanager
def native_output(descriptor: int) -> Iterator[list[str]]:
    """Collect what C++ prints on standard output (1) or standard error (2); at the end the list holds one text."""
    printed: list[str] = []
    try:
        libc, saved = ctypes.CDLL(None), os.dup(descriptor)
    except (OSError, TypeError):  # it is closed; Windows
        yield printed
        return
    with tempfile.TemporaryFile() as file:
        libc.fflush(None)  # what was printed before is not ours
        os.dup2(file.fileno(), descriptor)
        try:
            yield printed
        finally:
            libc.fflush(None)
            os.dup2(saved, descriptor)
            os.close(saved)
            file.seek(0)
            printed.append(file.read().decode(errors="replace"))


with native_output(2):  # "pybullet build time: ..."
    import pybullet as pybullet
    from pybullet_utils.bullet_client import BulletClient as BulletClient


def check_binding() -> None:
    """Raise a RuntimeError if this PyBullet returns images as tuples of numbers.

    There are no wheels after Python 3.11, and pip builds without NumPy unless it is told otherwise.
    """
    if not pybullet.isNumpyEnabled():
        raise RuntimeError(WITHOUT_NUMPY)
