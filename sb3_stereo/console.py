"""Human-readable progress: a bar on a terminal, occasional plain lines elsewhere, both with the time left."""

import os
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from rich.progress import Progress


class Bar:
    """Counts towards a total on stderr.

    Args:
        total: Where the count ends.
        unit: What is counted, in the singular.
        bar: True draws a bar with rich, False prints lines, None decides by whether stderr is a terminal.
        interval: Seconds between two lines.
        done: Where the count starts.
    """

    def __init__(self, total: int, unit: str, bar: bool | None = None, interval: float = 30.0, done: int = 0) -> None:
        self.total, self.unit, self.interval, self.first = total, unit, interval, done
        self.start = self.last_line = time.monotonic()
        self.progress = _make_bar(total, unit, done) if (sys.stderr.isatty() if bar is None else bar) else None

    def update(self, done: int, note: str = "") -> None:
        """Show that `done` of the total are done, with a note on how it goes."""
        if self.progress is not None:
            self.progress.update(self.progress.task_ids[0], completed=done, note=note)
        elif time.monotonic() - self.last_line > self.interval:
            self.last_line = time.monotonic()
            speed = f"{(done - self.first) / (self.last_line - self.start):.1f} {self.unit}s/s"
            line = [f"{done}/{self.total} {self.unit}s", *filter(None, [note]), speed, self.left(done)]
            print(", ".join(line), file=sys.stderr, flush=True)

    def left(self, done: int) -> str:
        """Say how long the rest takes at the speed so far."""
        if done == self.first:
            return "time left unknown"
        return f"{duration((time.monotonic() - self.start) / (done - self.first) * (self.total - done))} left"

    def close(self) -> None:
        """Leave the bar as it stands; may be called twice."""
        if self.progress is not None:
            self.progress.stop()
            self.progress = None


def print_line(line: str) -> None:
    """Print a line on stdout at once; on a terminal it stands above the bar."""
    print(line, flush=True)


def duration(seconds: float) -> str:
    """Return a time in the unit that a person would say."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _make_bar(total: int, unit: str, done: int) -> "Progress | None":
    try:
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )
    except ImportError:  # the extra 'progress' is not installed: lines do as well
        return None
    progress = Progress(
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(f"{unit}s"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
        console=Console(stderr=True, force_terminal=True),  # -P draws it in a log, too
        redirect_stdout=sys.stdout.isatty(),  # what is piped must not be drawn on stderr
    )
    progress.add_task("", total=total, completed=done, note="")
    progress.start()
    return progress


def aligned(rows: Sequence[Sequence[str]], right: bool = True) -> str:
    """Return rows of cells as lines, each column as wide as its widest cell."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    side = ">" if right else "<"
    lines = ("  ".join(f"{cell:{side}{width}}" for cell, width in zip(row, widths)) for row in rows)
    return "\n".join(f"  {line.rstrip()}" for line in lines)


def command_line(command: str, *arguments: str) -> str:
    """Return what to type for a command of ours, with or without a checkout."""
    return shlex.join(["python", "-m", "sb3_stereo", command, *arguments])


@contextmanager
def surviving_broken_pipes() -> Iterator[None]:
    """Let a command go on when nobody reads its output any more, as after `| head -1`."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _Pipe(sys.stdout), _Pipe(sys.stderr)
    try:
        yield
        sys.stdout.flush()
    finally:
        sys.stdout, sys.stderr = before


class _Pipe:
    """A stream that leads nowhere once its reader has gone."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        return self._unless_broken(lambda: self._stream.write(text)) or 0

    def flush(self) -> None:
        self._unless_broken(self._stream.flush)

    def _unless_broken(self, call: Callable[[], int | None]) -> int | None:
        try:
            return call()
        except BrokenPipeError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())  # also for what is still in the buffer
            os.close(nowhere)
            return None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
