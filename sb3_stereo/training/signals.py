"""Signals during a training run."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


@contextmanager
def signals_interrupt() -> Iterator[None]:
    """Let SIGTERM interrupt as Ctrl-C does."""
    with _handler((signal.SIGTERM,), _interrupt):
        yield


@contextmanager
def signals_ignored() -> Iterator[None]:
    """Let neither Ctrl-C nor SIGTERM interrupt."""
    with _handler((signal.SIGINT, signal.SIGTERM), signal.SIG_IGN):
        yield


@contextmanager
def _handler(numbers: tuple[signal.Signals, ...], handler: Any) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():  # only the main thread may set handlers
        yield
        return
    before = [signal.signal(number, handler) for number in numbers]
    try:
        yield
    finally:
        for number, old in zip(numbers, before, strict=True):
            signal.signal(number, old)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt(signal.Signals(number).name)
