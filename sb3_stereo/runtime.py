"""Process settings that must come before torch is imported, and the number of threads."""

import ctypes
import os
import sys

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


def available_cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def free_cores() -> int:
    """Return the cores that others leave to this process, between 1 and 4.

    Threads beyond the free cores wait for each other: 12 to 24 times slower was measured.
    """
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    return max(1, min(MAX_THREADS, round(available_cores() - load)))


def set_threads(num_threads: int = -1) -> int:
    """Set and return torch's number of threads; -1 takes the free cores."""
    import torch as th

    n = num_threads if num_threads > 0 else free_cores()
    th.set_num_threads(n)
    return n
