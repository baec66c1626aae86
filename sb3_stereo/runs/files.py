"""Files that are whole or not there, whatever happens while they are written."""

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` that takes its name in the end.

    An interruption leaves the old file or the new one, never half of one.
    """
    partial = partial_path(path)
    try:
        yield partial
        publish(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def partial_path(path: Path) -> Path:
    """Return the name under which a file is written before it is whole."""
    return path.with_name(f"{path.stem}.partial{path.suffix}")


def publish(partial: Path, path: Path) -> None:
    """Let a file that is written take its name, on the disk as well: a crash of the machine does not undo it."""
    sync(partial)
    os.replace(partial, path)
    if os.name == "posix":  # elsewhere a folder cannot be opened
        sync(path.parent)


def sync(path: Path) -> None:
    """Wait until a file or folder is on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sha256(path: Path) -> str:
    """Return the hexadecimal digest of a file's bytes."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def sizes(files: Iterable[Path]) -> dict[str, int]:
    """Return the sizes of files in bytes, by their names."""
    return {path.name: path.stat().st_size for path in files}


def cut_back(files: Iterable[Path], sizes: Mapping[str, int]) -> None:
    """Bring files that only grow back to earlier `sizes`; one without a size was not there yet and goes."""
    for path in files:
        size = sizes.get(path.name)
        if size is None:
            path.unlink()
        elif path.stat().st_size > size:
            os.truncate(path, size)
