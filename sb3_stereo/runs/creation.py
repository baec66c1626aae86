"""New run directories, created atomically."""

import shlex
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import yaml

from sb3_stereo import __version__
from sb3_stereo.config.schema import Config
from sb3_stereo.errors import ConfigError
from sb3_stereo.runs.directory import ARGUMENTS, env_name, numbers
from sb3_stereo.runs.files import sync
from sb3_stereo.runs.status import LOCK, NEW, STATUS

PACKAGES = ("stable-baselines3", "sb3-contrib", "gymnasium", "torch", "numpy", "opencv-python-headless", "pybullet")


def create_run(
    log_folder: str | Path,
    config: Config,
    args: Mapping[str, Any],
    command: Sequence[str] | None = None,
    claim: Callable[[Path], None] = lambda run: None,
) -> Path:
    """Make and return the directory of the next run, with its records, also if other processes do the same.

    It is written under a hidden name and gets its own in the end, so that no run lacks its records.

    Args:
        log_folder: Where the folder of the algorithm is.
        config: What the run learns.
        args: The arguments of its command.
        command: Its command; None takes that of this process.
        claim: Called with the run's path just before it comes into being, again if that was taken meanwhile.

    Raises:
        ConfigError: If it cannot be written.
    """
    name = env_name(config.env_id)
    records = partial(_write_records, config=config, args=args, command=sys.orig_argv if command is None else command)
    return publish_run(log_folder, config.algo, name, lambda draft: records(draft / name), claim)


def publish_run(
    log_folder: str | Path,
    algo: str,
    name: str,
    fill: Callable[[Path], None],
    claim: Callable[[Path], None] = lambda run: None,
) -> Path:
    """Make and return the directory of the next run of an algorithm: it is there with its content, or not at all.

    Args:
        log_folder: Where the folder of the algorithm is.
        algo: The algorithm.
        name: The environment's in file names; the folder of the run's records has it, too.
        fill: Called with the new directory, in which that folder is, to write what is in them.
        claim: As in `create_run`.

    Raises:
        ConfigError: If it cannot be written.
    """
    parent = Path(log_folder) / algo
    try:
        parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".new-", dir=parent, ignore_cleanup_errors=True) as scratch:
            draft = Path(scratch) / name
            (draft / name).mkdir(parents=True)
            fill(draft)
            return _numbered(draft, parent, claim)
    except OSError as error:
        raise ConfigError(f"cannot write to '{log_folder}' ({error.strerror}); choose a log folder with -f") from error


def _numbered(draft: Path, parent: Path, claim: Callable[[Path], None]) -> Path:
    """Give a directory the next free number."""
    while True:
        run = parent / f"{draft.name}_{max(numbers(parent, draft.name), default=0) + 1}"
        claim(run)
        try:
            draft.rename(run)  # fails where something is, but for an empty folder
        except OSError:
            if not run.exists():
                raise
            continue  # another process was faster
        sync(parent)
        return run


def _write_records(folder: Path, config: Config, args: Mapping[str, Any], command: Sequence[str]) -> None:
    """Write what made the run: resolved configuration, arguments, command and versions."""
    records = {"versions.yml": versions(), "config.yml": config.plain(), ARGUMENTS: dict(args), STATUS: NEW}
    texts = {name: yaml.safe_dump(content, sort_keys=False) for name, content in records.items()}
    for name, text in {**texts, "command.txt": shlex.join(command) + "\n", LOCK: ""}.items():
        (folder / name).write_text(text, encoding="utf-8")
        sync(folder / name)
    sync(folder)


def make_numbered(parent: Path, name: str) -> Path:
    """Make and return the folder `name_N` with the next free number."""
    parent.mkdir(parents=True, exist_ok=True)
    while True:
        folder = parent / f"{name}_{max(numbers(parent, name), default=0) + 1}"
        try:
            folder.mkdir()
        except FileExistsError:  # another process was faster
            continue
        return folder


def versions() -> dict[str, str]:
    """Return the versions of Python, of this package and of what it stands on."""
    found = {"python": sys.version.split()[0], "sb3_stereo": __version__}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:  # e.g. opencv-python instead of its headless sister
            found[name] = "unknown"
    return found
