"""Timing side by side: every candidate in every round, so that what slows the machine slows all of them."""

import ctypes
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Protocol


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


class Parts:
    """Stopwatches at some of the calls that a call makes; none of them may be inside another."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def watch(self, part: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """The same call, watched."""
        self.seconds[part] = 0.0

        def watched(*args: Any, **kwargs: Any) -> Any:
            start = time.perf_counter()
            result = call(*args, **kwargs)
            self.seconds[part] += time.perf_counter() - start
            return result

        return watched

    def candidates(self, call: Callable[[], object]) -> dict[str, Candidate]:
        """The call, "all", and after it its parts and the rest, which tell of the latest time only."""
        parts = list(self.seconds)

        def whole() -> float:
            self.seconds = dict.fromkeys(parts, 0.0)
            seconds = timed(call)()
            self.seconds["the rest"] = seconds - sum(self.seconds.values())
            return seconds

        return {"all": whole} | {part: partial(self._latest, part) for part in (*parts, "the rest")}

    def _latest(self, part: str) -> float:
        return self.seconds[part]


def peak_memory() -> float:
    """The most memory that this process has held, in [MiB]; nan where there is no /proc.

    `resource.getrusage` would tell it elsewhere too, but counts what the parent held when it started this process.
    """
    status = Path("/proc/self/status")
    lines = status.read_text(encoding="ascii").splitlines() if status.exists() else []
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM:")), float("nan"))


class Worker:
    """A process that answers names with numbers: `python -m MODULE ARGS`, which calls `serve`.

    It gets ready by itself, several at a time; the first question waits for it.
    """

    def __init__(self, module: str, *args: str) -> None:
        self.command = f"python -m {' '.join((module, *args))}"
        self.process = subprocess.Popen(
            [sys.executable, "-m", module, *args], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    @cached_property
    def names(self) -> list[str]:
        """What it can be asked."""
        return self._answer()

    def _answer(self) -> list[str]:
        assert self.process.stdout is not None
        for line in self.process.stdout:  # libraries may print their own lines
            if line.startswith("answer: "):
                return line.removeprefix("answer: ").strip().split(", ")
        raise RuntimeError(f"{self.command} ended before it answered")

    def ask(self, name: str) -> float:
        """Do what has that name once."""
        if name not in self.names:
            raise KeyError(f"{self.command} answers {', '.join(self.names)}, not {name}")
        assert self.process.stdin is not None
        self.process.stdin.write(f"{name}\n")
        self.process.stdin.flush()
        return float(self._answer()[0])

    def candidate(self, name: str) -> Candidate:
        """What has that name, as a candidate."""
        return partial(self.ask, name)

    def close(self) -> None:
        """End the process."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()

    def __enter__(self) -> "Worker":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def library_lines_to_stderr() -> Iterator[None]:
    """Keep standard output for ours: Bullet prints there from C, below `sys.stdout`."""
    sys.stdout.flush()
    ours = os.dup(1)
    os.dup2(2, 1)
    try:
        yield
    finally:
        ctypes.CDLL(None).fflush(None)  # what C still holds
        os.dup2(ours, 1)
        os.close(ours)


@contextmanager
def on_one_core() -> Iterator[None]:
    """Keep this process on one core, with the threads that libraries start meanwhile; only where the system can."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def serve(candidates: Mapping[str, Candidate]) -> None:
    """The other side of `Worker`: tell the names, then answer each line of standard input."""
    print(f"answer: {', '.join(candidates)}", flush=True)
    for line in sys.stdin:
        print(f"answer: {candidates[line.strip()]()}", flush=True)
