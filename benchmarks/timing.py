"""Timing side by side: every candidate in every round, so that what slows the machine slows all of them."""

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from typing import Protocol


class Candidate(Protocol):
    """Something that can be done once, and says how many seconds it took."""

    def __call__(self) -> float:
        """Do it."""


def timed(call: Callable[[], object]) -> Candidate:
    """Make a candidate of a call in this process."""

    def candidate() -> float:
        start = time.perf_counter()
        call()
        return time.perf_counter() - start

    return candidate


def medians(candidates: Mapping[str, Candidate], rounds: int) -> dict[str, float]:
    """Median seconds of each candidate over interleaved rounds, after one that is not counted."""
    seconds: dict[str, list[float]] = {name: [] for name in candidates}
    for number in range(rounds + 1):
        for name, candidate in candidates.items():
            taken = candidate()
            if number > 0:
                seconds[name].append(taken)
    return {name: statistics.median(values) for name, values in seconds.items()}


class Worker:
    """A candidate in a process of its own: `python -m MODULE ARGS` does it once per line that it reads.

    The process prints "ready" first, then the seconds of each time.
    """

    def __init__(self, module: str, *args: str) -> None:
        self.command = f"python -m {' '.join((module, *args))}"
        self.process = subprocess.Popen(
            [sys.executable, "-m", module, *args], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._await()

    def _await(self) -> str:
        assert self.process.stdout is not None
        for line in self.process.stdout:  # libraries may print their own lines
            if line.startswith(("ready", "took ")):
                return line
        raise RuntimeError(f"{self.command} ended before it answered")

    def __call__(self) -> float:
        """Do it once."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return float(self._await().split()[1])

    def close(self) -> None:
        """End the process."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()


def serve(candidate: Candidate) -> None:
    """The other side of `Worker`."""
    print("ready", flush=True)
    for _ in sys.stdin:
        print(f"took {candidate()}", flush=True)
