"""Process settings that must come before torch is imported, and the number of threads."""

import ctypes
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import psutil

MAX_THREADS = 4  # four threads give the last gain for batches of 100 small images

# mallopt(3) parameters and values: serve large activations from the heap and keep what is freed.
_MALLOPT = ((-3, 1 << 30), (-1, (1 << 31) - 1), (-2, 1 << 28))  # M_MMAP_THRESHOLD, M_TRIM_THRESHOLD, M_TOP_PAD


def tune_allocator() -> None:
    """Keep freed memory in the process, which makes a gradient step 1.5 to 1.9 times as fast; call before torch.

    glibc returns every activation of about 21 MB to the kernel, and each step then pays tens of thousands of page
    faults. The results stay the same to the bit. Does nothing on systems without glibc.
    """
    os.environ.setdefault("THP_MEM_ALLOC_ENABLE", "1")  # torch's own switch for transparent huge pages
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        for parameter, value in _MALLOPT:
            mallopt(parameter, value)


def _usable() -> list[int]:
    """The cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def available_cores() -> int:
    """Return how many cores this process may use."""
    return len(_usable())


class CoreWatch:
    """Tells the cores that were free for this process, its children included, since it was asked last."""

    def __init__(self) -> None:
        self._process = psutil.Process()
        self._before = self._seconds()

    def _seconds(self) -> tuple[float, float]:
        """A clock, and the seconds that the usable cores were idle or ours, all together."""
        times = psutil.cpu_times(percpu=True)
        idle = sum(times[core].idle + getattr(times[core], "iowait", 0.0) for core in _usable())
        ours = 0.0
        for process in (self._process, *self._process.children(recursive=True)):
            with suppress(psutil.NoSuchProcess):
                ours += sum(process.cpu_times()[:4])  # with those of its children that have ended
        return time.monotonic(), idle + ours

    def free_cores(self) -> int:
        """Return the cores that others have left, between 1 and `MAX_THREADS`."""
        (then, before), (now, after) = self._before, self._seconds()
        self._before = now, after
        return max(1, min(MAX_THREADS, available_cores(), round((after - before) / max(now - then, 1e-9))))


def free_cores(seconds: float = 0.1) -> int:
    """Return the cores that others leave to this process, between 1 and 4, in so many seconds from now.

    Threads beyond the free cores wait for each other, hundreds of times as long as the work takes.
    """
    watch = CoreWatch()
    time.sleep(seconds)
    return watch.free_cores()


def set_threads(num_threads: int = -1) -> int:
    """Set and return torch's number of threads; -1 takes the free cores."""
    import torch as th

    n = num_threads if num_threads > 0 else free_cores()
    th.set_num_threads(n)
    return n


@contextmanager
def threads_for(num_threads: int = -1, interval: float = 5.0) -> Iterator[int]:
    """Set torch's number of threads meanwhile; -1 follows the free cores, as what else runs comes and goes.

    Args:
        num_threads: As of `set_threads`.
        interval: Seconds after which the next gradient step counts the free cores anew.
    """
    import torch as th
    from torch.optim.optimizer import register_optimizer_step_post_hook

    before = th.get_num_threads()
    n = set_threads(num_threads)
    watch, due = CoreWatch(), time.monotonic() + interval

    def follow(*_: object) -> None:
        nonlocal due
        if time.monotonic() >= due:
            set_threads(watch.free_cores())
            due = time.monotonic() + interval

    hook = register_optimizer_step_post_hook(follow) if num_threads <= 0 else None
    try:
        yield n
    finally:
        if hook:
            hook.remove()
        th.set_num_threads(before)
