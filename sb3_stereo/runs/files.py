"""Atomic file writes: a file is complete or absent, whatever happens while it is written."""

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sb3_stereo.errors import ConfigError


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
    sync(path.parent)


def sync(path: Path) -> None:
    """Wait until a file or folder is on the disk."""
    is_folder = path.is_dir()
    if is_folder and os.name != "posix":  # elsewhere a folder cannot be opened
        return
    descriptor = os.open(path, os.O_RDONLY if is_folder else os.O_RDWR)  # Windows flushes what may be written alone
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write(path: Path, content: bytes) -> None:
    """Write a file as a whole. The bytes of other names of the old file, such as a copy's hard link, stay."""
    with replacing(path) as partial:
        partial.write_bytes(content)


def sha256(path: Path) -> str:
    """Return the hexadecimal digest of a file's bytes."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def cut_back(path: Path, size: int) -> bool:
    """Bring a file that only grows back to an earlier size; return whether it had at least that."""
    before = path.stat()
    if before.st_size > size or before.st_nlink > 1:  # another name of its bytes is a copy's
        with path.open("rb") as file:
            write(path, file.read(size))
    return before.st_size >= size


def refuse_links(folder: Path) -> None:
    """Raise a ConfigError if something in a folder is a link or no file: what is written to it would land elsewhere."""
    for path in sorted(folder.rglob("*")):
        if path.is_symlink():
            raise ConfigError(f"'{path}' is a link, and a training writes there; put what it points to in its place")
        if not path.is_file() and not path.is_dir():
            raise ConfigError(f"'{path}' is neither a file nor a folder, and a training writes there; remove it")


def disk_error(error: BaseException | None) -> OSError | None:
    """Return what the system said, which torch's errors hide; None if the system said nothing."""
    while error is not None and not isinstance(error, OSError):
        error = error.__cause__ or error.__context__
    return error
