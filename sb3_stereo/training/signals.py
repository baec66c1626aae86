"""Signals during a training run."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from stable_baselines3.common.callbacks import BaseCallback


class Interruptions:
    """Remembers the first Ctrl-C or SIGTERM, and lets it interrupt what may be interrupted.

    Attributes:
        name: The first signal that came, e.g. "SIGINT"; None as long as none has.
    """

    def __init__(self) -> None:
        self.name: str | None = None
        self._interrupts = False

    def run(self, function: Callable[[], None]) -> bool:
        """Call a function, not at all if a signal has come before, and return whether it came to its end.

        Only the first signal interrupts it. What is done afterwards is not interrupted.
        """
        ended = False
        try:
            self._interrupts = True
            if self.name is None:
                function()
                ended = True
            self._interrupts = False
        except KeyboardInterrupt:
            self.name = self.name or signal.SIGINT.name  # one that somebody else raised
        finally:
            self._interrupts = False
        return ended

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        self.name = self.name or signal.Signals(number).name
        if self._interrupts:
            self._interrupts = False
            raise KeyboardInterrupt(self.name)


class StopOnSignal(BaseCallback):
    """Ends the training at the next step if the exception was lost, as in a destructor.

    Args:
        interruptions: The signals of the training.
    """

    def __init__(self, interruptions: Interruptions) -> None:
        super().__init__()
        self.interruptions = interruptions

    def _on_step(self) -> bool:
        if self.interruptions.name is not None:
            raise KeyboardInterrupt(self.interruptions.name)
        return True


@contextmanager
def interruptions() -> Iterator[Interruptions]:
    """Handle Ctrl-C and SIGTERM; they do not interrupt but where it is asked for."""
    found = Interruptions()
    if threading.current_thread() is not threading.main_thread():  # only the main thread may set handlers
        yield found
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    handled = [number for number, handler in before.items() if handler != signal.SIG_IGN]  # a background job's Ctrl-C
    for number in handled:
        signal.signal(number, found.handle)
    try:
        yield found
    finally:
        for number in handled:
            signal.signal(number, before[number] or signal.SIG_DFL)
