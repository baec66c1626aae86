"""A memory limit for networks described by settings from elsewhere."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch as th
from torch.overrides import TorchFunctionMode

_FACTORIES = (th.empty, th.zeros, th.ones, th.rand, th.randn, th.eye)  # what modules make their weights with


class _Count(TorchFunctionMode):
    """Counts the bytes of all new tensors."""

    def __init__(self, limit: int) -> None:
        super().__init__()
        self.limit, self.n_bytes = limit, 0

    def __torch_function__(
        self, func: Callable[..., Any], types: Any, args: Sequence[Any] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        made = func(*args, **(kwargs or {}))
        if func in _FACTORIES:
            self.n_bytes += made.numel() * made.element_size()
            if self.n_bytes > self.limit:  # nothing has been written to it yet, so that it took no memory
                raise _TooLargeError
        return made


class _TooLargeError(Exception):
    pass


@contextmanager
def networks_of_at_most(limit: int, path: Path) -> Iterator[None]:
    """Let no more than `limit` bytes of weights be made.

    Args:
        limit: In bytes.
        path: The file that should hold them, for the message.

    Raises:
        ValueError: If more is asked for.
    """
    try:
        with _Count(limit):
            yield
    except _TooLargeError as error:
        what = f"the settings of '{path}' ask for networks of more than {limit / 1e6:.0f} MB"
        raise ValueError(f"{what}, which it does not hold; choose a model of the same settings") from error
