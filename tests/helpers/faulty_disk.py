"""A disk on which every kind of write can fail once: the process is killed there, the disk is full, or Ctrl-C comes."""

import builtins
import errno
import io
import os
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


class Killed(BaseException):
    """What nobody catches."""


def kill(disk: "FaultyDisk", call: Callable[[], Any], opens: bool) -> Any:
    disk.is_dead = True
    raise Killed


def kill_after(disk: "FaultyDisk", call: Callable[[], Any], opens: bool) -> Any:
    call()
    disk.is_dead = True
    raise Killed


def fill(disk: "FaultyDisk", call: Callable[[], Any], opens: bool) -> Any:
    if disk.before.startswith(("unlink ", "rmdir ")):  # needs no space
        return call()
    if not opens:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    return _full(call())


def interrupt(disk: "FaultyDisk", call: Callable[[], Any], opens: bool) -> Any:
    for _ in range(2):
        signal.raise_signal(signal.SIGINT)
    return call()


class _Full(io.RawIOBase):
    """A file on a full disk."""

    def __init__(self, file: Any) -> None:
        self.file = file

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return int(self.file.tell())

    def seek(self, *position: int) -> int:
        return int(self.file.seek(*position))

    def write(self, content: Any) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def close(self) -> None:
        self.file.close()
        super().close()


def _full(file: Any) -> Any:
    buffered = io.BufferedWriter(_Full(file), buffer_size=1)  # SB3 takes no other
    return io.TextIOWrapper(buffered, write_through=True) if isinstance(file, io.TextIOBase) else buffered


class FaultyDisk:
    """Lets each different write below a folder go wrong, the first time that it comes up in a chain of processes.

    Writes are different if what is written differs, or what was written just before.

    Args:
        patch: For the functions that write.
        folder: Writes elsewhere are let through.
        fault: What goes wrong.
        chosen: Tells whether the n-th different write goes wrong.
    """

    def __init__(
        self,
        patch: pytest.MonkeyPatch,
        folder: Path,
        fault: Callable[["FaultyDisk", Callable[[], Any], bool], Any],
        chosen: Callable[[int], bool] = lambda n: True,
    ) -> None:
        self.folder, self.fault, self.chosen = str(folder), fault, chosen
        self.seen: dict[tuple[str, str], None] = {}
        self.before = ""
        self.is_dead = False
        for owner, name in (
            *((os, name) for name in ("replace", "rename", "unlink", "rmdir", "mkdir")),
            *((module, "open") for module in (builtins, io)),
        ):
            patch.setattr(owner, name, self._faulty(name, getattr(owner, name)))

    def restart(self) -> None:
        """Begin another process."""
        self.is_dead, self.before = False, ""

    def _faulty(self, name: str, function: Any) -> Any:
        def call(path: Any, *args: Any, **kwargs: Any) -> Any:
            mode = str(args[0] if args else kwargs.get("mode", "r"))
            is_write = name != "open" or bool(set(mode) & set("wax+"))
            if not is_write or not str(path).startswith(self.folder):
                return function(path, *args, **kwargs)
            if self.is_dead:
                raise Killed
            return self._write(f"{name} {_plain(path)}", lambda: function(path, *args, **kwargs), opens=name == "open")

        return call

    def _write(self, label: str, call: Callable[[], Any], opens: bool) -> Any:
        write, self.before = (self.before, label), label
        if write in self.seen:
            return call()
        self.seen[write] = None
        return self.fault(self, call, opens) if self.chosen(len(self.seen)) else call()


def _plain(path: Any) -> str:
    """The name of a file without what differs from run to run."""
    return re.sub(r"-[0-9a-f]{16}|(?<=\.new-).*", "", "/".join(Path(path).parts[-2:]))


def every(n: int, first: int = 1) -> Callable[[int], bool]:
    """Choose each n-th write."""
    return lambda i: i % n == first % n
