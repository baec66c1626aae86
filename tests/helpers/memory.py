"""How much memory something takes, at its highest."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


def _status(name: str) -> float:
    match = re.search(rf"{name}:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert match is not None
    return int(match[1]) / 2**10


@contextmanager
def takes_less_than(limit: float) -> Iterator[None]:
    """Fail if this process grows by `limit` MiB or more in between; needs Linux."""
    try:
        Path("/proc/self/clear_refs").write_text("5")  # the peak is from here on, see proc(5)
    except OSError:
        pytest.skip("there is no peak of the memory here")
    before = _status("VmRSS")
    yield
    assert _status("VmHWM") - before < limit
