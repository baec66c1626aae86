"""Progress of a training for a person: a bar on a terminal, a plain line now and then elsewhere."""

import sys
import time
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback


class Progress(BaseCallback):
    """Shows steps, recent success rate and speed on stderr.

    Args:
        bar: True draws a bar with tqdm, False prints lines, None decides by whether stderr is a terminal.
        interval: Seconds between two lines.
    """

    def __init__(self, bar: bool | None = None, interval: float = 30.0) -> None:
        super().__init__()
        self.bar = _make_bar if (sys.stderr.isatty() if bar is None else bar) else None
        self.interval = interval
        self.pbar: Any = None

    def _on_training_start(self) -> None:
        self.total = self.locals["total_timesteps"]
        self.start = self.last_line = time.monotonic()
        self.pbar = self.bar(self.total) if self.bar else None

    def _on_step(self) -> bool:
        if self.pbar is not None:
            self.pbar.set_postfix_str(f"success {self._success()}", refresh=False)
            self.pbar.update(self.num_timesteps - self.pbar.n)
        elif time.monotonic() - self.last_line > self.interval:
            self.last_line = time.monotonic()
            speed = self.num_timesteps / (self.last_line - self.start)
            line = f"{self.num_timesteps}/{self.total} steps, success {self._success()}, {speed:.1f} steps/s"
            print(line, file=sys.stderr, flush=True)
        return True

    def _on_training_end(self) -> None:
        self.close()

    def close(self) -> None:
        """Leave the bar as it stands; may be called twice."""
        if self.pbar is not None:
            self.pbar.close()
            self.pbar = None

    def _success(self) -> str:
        """Return the share of the last 100 episodes that reached the goal."""
        recent = self.model.ep_success_buffer
        return f"{100 * sum(recent) / len(recent):.0f} %" if recent else "–"


def _make_bar(total: int) -> Any:
    try:
        from tqdm import tqdm
    except ImportError:  # the extra 'progress' is not installed: lines do as well
        return None
    return tqdm(total=total, unit="step", dynamic_ncols=True, smoothing=0.05, file=sys.stderr)
