"""Human-readable progress: a bar on a terminal, occasional plain lines elsewhere, both with the time left."""

import os
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, ClassVar, TextIO

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

    latest: ClassVar["Bar | None"] = None  # that is not closed: of what `phase` shows a part

    def __init__(self, total: int, unit: str, bar: bool | None = None, interval: float = 30.0, done: int = 0) -> None:
        progress = _make_bar() if (sys.stderr.isatty() if bar is None else bar) else None
        self._begin("", total, unit, interval, done, progress)
        Bar.latest = self

    def _begin(self, name: str, total: int, unit: str, interval: float, done: int, progress: "Progress | None") -> None:
        self.name, self.total, self.unit, self.interval, self.first = name, total, unit, interval, done
        self.start = self.last_line = time.monotonic()
        self.progress = progress
        if progress is not None:
            self.task = progress.add_task(name, total=total, completed=done, note=name, unit=f"{unit}s")

    @contextmanager
    def part(self, name: str, total: int, unit: str) -> Iterator["Bar"]:
        """Count something else for a while, below this bar or in lines that begin with its name."""
        part = Bar.__new__(Bar)
        part._begin(name, total, unit, self.interval, 0, self.progress)
        try:
            yield part
        finally:
            if self.progress is not None:
                self.progress.remove_task(part.task)

    def update(self, done: int, note: str = "") -> None:
        """Show that `done` of the total are done, with a note on how it goes."""
        if self.progress is not None:
            self.progress.update(self.task, completed=done, note=note or self.name)
        elif time.monotonic() - self.last_line > self.interval:
            self.last_line = time.monotonic()
            speed = f"{(done - self.first) / (self.last_line - self.start):.1f} {self.unit}s/s"
            line = [f"{done}/{self.total} {self.unit}s", *filter(None, [note]), speed, self.left(done)]
            start = f"{self.name}: " if self.name else ""
            print(start + ", ".join(line), file=sys.stderr, flush=True)

    def left(self, done: int) -> str:
        """Say how long the rest takes at the speed so far."""
        if done == self.first:
            return "time left unknown"
        return f"{duration((time.monotonic() - self.start) / (done - self.first) * (self.total - done))} left"

    def close(self) -> None:
        """Leave the bar as it stands; may be called twice."""
        Bar.latest = None if Bar.latest is self else Bar.latest
        if self.progress is not None:
            self.progress.stop()
            self.progress = None


@contextmanager
def phase(name: str, total: int, unit: str) -> Iterator[Callable[[int], object]]:
    """Show how far something is that interrupts what a bar counts; without a bar nobody wants to know.

    Yields:
        What to call with the number that is done.
    """
    if Bar.latest is None:
        yield lambda done: None
        return
    with Bar.latest.part(name, total, unit) as part:
        yield part.update


def print_line(line: str) -> None:
    """Print a line on stdout at once; on a terminal it stands above the bar."""
    print(line, flush=True)


def duration(seconds: float) -> str:
    """Return a time in the unit that a person would say."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _make_bar() -> "Progress | None":
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
        TextColumn("{task.fields[unit]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
        console=Console(stderr=True, force_terminal=True),  # -P draws it in a log, too
        redirect_stdout=sys.stdout.isatty(),  # what is piped must not be drawn on stderr
    )
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
