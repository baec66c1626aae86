"""Progress for a person: a bar on a terminal, a plain line now and then elsewhere; both say how long it will take."""

import sys
import time
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback


class Bar:
    """Counts towards a total on stderr.

    Args:
        total: Where the count ends.
        unit: What is counted, in the singular.
        bar: True draws a bar with tqdm, False prints lines, None decides by whether stderr is a terminal.
        interval: Seconds between two lines.
        done: Where the count starts.
    """

    def __init__(self, total: int, unit: str, bar: bool | None = None, interval: float = 30.0, done: int = 0) -> None:
        self.total, self.unit, self.interval, self.first = total, unit, interval, done
        self.start = self.last_line = time.monotonic()
        self.pbar = _make_bar(total, unit, done) if (sys.stderr.isatty() if bar is None else bar) else None

    def update(self, done: int, note: str = "") -> None:
        """Show that `done` of the total are done, with a note on how it goes."""
        if self.pbar is not None:
            self.pbar.set_postfix_str(note, refresh=False)
            self.pbar.update(done - self.pbar.n)
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
        if self.pbar is not None:
            self.pbar.close()
            self.pbar = None


class Progress(BaseCallback):
    """Shows steps, recent success rate, speed and the time left of a training.

    Args:
        bar: As in `Bar`.
        interval: As in `Bar`.
    """

    def __init__(self, bar: bool | None = None, interval: float = 30.0) -> None:
        super().__init__()
        self.bar, self.interval = bar, interval
        self.shown: Bar | None = None

    def _on_training_start(self) -> None:
        self.shown = Bar(self.locals["total_timesteps"], "step", self.bar, self.interval, self.num_timesteps)

    def _on_step(self) -> bool:
        if self.shown is not None:
            self.shown.update(self.num_timesteps, f"success {self._success()}")
        return True

    def _on_training_end(self) -> None:
        self.close()

    def close(self) -> None:
        """Leave the bar as it stands; may be called twice."""
        if self.shown is not None:
            self.shown.close()

    def _success(self) -> str:
        """Return the share of the last 100 episodes that reached the goal."""
        recent = self.model.ep_success_buffer
        return f"{100 * sum(recent) / len(recent):.0f} %" if recent else "–"


def say(line: str) -> None:
    """Print a line on stdout, above a bar if there is one."""
    try:
        from tqdm import tqdm
    except ImportError:
        print(line)
    else:
        tqdm.write(line, file=sys.stdout)
    sys.stdout.flush()


def duration(seconds: float) -> str:
    """Return a time in the unit that a person would say."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _make_bar(total: int, unit: str, done: int) -> Any:
    try:
        from tqdm import tqdm
    except ImportError:  # the extra 'progress' is not installed: lines do as well
        return None
    return tqdm(total=total, initial=done, unit=unit, dynamic_ncols=True, smoothing=0.05, file=sys.stderr)
