"""Whether a run has ended, and which process holds its lock.

A run is being trained from its first moment until `status.yml` says that it has ended, which is written when everything
else is there. Whatever happens before that, `--resume` brings the directory back to its last snapshot and repeats what
came after it.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import yaml
from filelock import FileLock, Timeout

from sb3_stereo.config.schema import Config
from sb3_stereo.envs import plain_yaml
from sb3_stereo.errors import ConfigError
from sb3_stereo.runs.directory import UNREADABLE, arguments_file, env_name, scores_by_step
from sb3_stereo.runs.files import write

STATUS = "status.yml"
LOCK = "lock"
NEW = {"status": "training"}
ENDED = {"status": "ended"}


def has_ended(run: str | Path, config: Config) -> bool:
    """Return whether a run was trained to its end, evaluated and saved.

    Raises:
        ConfigError: If its status is unreadable.
    """
    file = _status_file(run)
    if not file.is_file():
        return _looks_ended(Path(run), config)
    try:
        status = plain_yaml.read(file)
    except (OSError, ValueError):
        status = None
    if status not in (NEW, ENDED):
        raise ConfigError(f"'{file}' must be 'status: training' or 'status: ended'; write the one that is true there")
    return bool(status == ENDED)


def _looks_ended(run: Path, config: Config) -> bool:
    """Judge a run of before version 0.1.0, which had no status, by its files."""
    if not (run / f"{env_name(config.env_id)}.zip").is_file():
        return False
    try:
        return max(scores_by_step(run), default=0) >= config.n_timesteps
    except (OSError, *UNREADABLE):
        return False


def mark(run: Path, status: dict[str, str]) -> None:
    """Write down the status of a run, `NEW` or `ENDED`."""
    write(_status_file(run), yaml.safe_dump(status).encode())


def _status_file(run: str | Path) -> Path:
    return arguments_file(run).with_name(STATUS)


@contextmanager
def locked(run: str | Path) -> Iterator[None]:
    """Hold a run for this process; the system lets go of it when the process ends, however that happens.

    Raises:
        ConfigError: If another process holds it, or nothing can be written there.
    """
    file = arguments_file(run).with_name(LOCK)
    lock = FileLock(file, timeout=0)
    try:
        if file.exists() and file.stat().st_size > 0:  # opening it would empty it, and its bytes may have another name
            raise ConfigError(f"'{file}' holds something, and a run's lock is empty; remove it")
        lock.acquire()
    except Timeout as error:
        raise ConfigError(f"another process trains '{run}' now; wait for it, or stop it first") from error
    except OSError as error:
        raise ConfigError(f"cannot write to '{run}' ({error.strerror}); see to its permissions and space") from error
    try:
        yield
    finally:
        lock.release()
