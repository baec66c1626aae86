"""Where a run's TensorBoard files go: a folder that belongs to this run alone."""

import re
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from sb3_stereo.config.schema import Config
from sb3_stereo.errors import ConfigError
from sb3_stereo.runs.creation import make_numbered
from sb3_stereo.runs.directory import env_name
from sb3_stereo.runs.files import cut_back, write

OWNER = "run.txt"  # names the run that the folder belongs to, by its path
INSIDE = "tensorboard"  # in the run's directory
_NAME = re.compile(r"(events\.out\.tfevents\.)(\d+)(\..+)")  # seconds, then machine, process and a counter


@contextmanager
def new_folder(parent: str | None, config: Config) -> Iterator[Path | None]:
    """Make and yield the folder of a new run, numbered as SB3 does; after an error it goes.

    Raises:
        ConfigError: If it cannot be made.
    """
    if not parent:
        yield None
        return
    try:
        folder = make_numbered(Path(parent) / env_name(config.env_id), config.algo.upper()).absolute()
    except OSError as error:
        way_out = "choose a folder for TensorBoard with -tb"
        raise ConfigError(f"cannot write to '{parent}' ({error.strerror}); {way_out}") from error
    try:
        yield folder
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def give(folder: Path, run: Path) -> None:
    """Let a folder belong to a run."""
    write(folder / OWNER, f"{run.resolve()}\n".encode())


def folder_of(run: Path, recorded: str | None) -> Path | None:
    """Return the folder of a run: the recorded one if it belongs to the run, else one inside the run.

    The record of a copy names the folder of its original.

    Args:
        run: The run directory.
        recorded: What the run's record says; None if it writes nothing for TensorBoard.
    """
    if not recorded:
        return None
    try:
        owner = (Path(recorded) / OWNER).read_text(encoding="utf-8").strip()
    except (OSError, ValueError):
        owner = ""
    return Path(recorded) if owner == str(run.resolve()) else run / INSIDE


def event_files(folder: Path | None) -> list[Path]:
    """Return TensorBoard's files in a folder, as it orders them."""
    found = folder.iterdir() if folder and folder.is_dir() else ()
    return sorted(path for path in found if _NAME.fullmatch(path.name))


def event_sizes(folder: Path | None) -> dict[str, int]:
    """Return how large TensorBoard's files are, for `restore_events`."""
    return {key: path.stat().st_size for key, path in _by_process(event_files(folder)).items()}


def restore_events(folder: Path, sizes: Mapping[str, int]) -> list[str]:
    """Bring the files back to earlier sizes, and before the next one in their order; one without a size goes.

    TensorBoard orders them by the second in their names, so a clock that was set back would mix them up.

    Returns:
        The names of files of which something is lost.
    """
    files = _by_process(event_files(folder))
    for key in files.keys() - sizes.keys():
        files.pop(key).unlink()
    lost = [key for key, size in sizes.items() if key not in files or not cut_back(files[key], size)]
    second = int(time.time())
    for path in reversed(files.values()):
        match = _NAME.fullmatch(path.name)
        assert match is not None
        second = min(int(match[2]), second - 1)
        path.rename(path.with_name(f"{match[1]}{second:010d}{match[3]}"))
    return lost


def _by_process(files: list[Path]) -> dict[str, Path]:
    """Files by what their names keep: machine and process, numbered where a process has the same number again."""
    found: dict[str, Path] = {}
    for path in files:
        match = _NAME.fullmatch(path.name)
        assert match is not None
        n_same = sum(key.partition(" ")[0] == match[3] for key in found)
        found[f"{match[3]} {n_same + 1}"] = path
    return found
